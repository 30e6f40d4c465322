"""Mode probabilities against the true modes: accuracy, Brier and logarithmic score."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from jink.estimators.metrics.steps import Floats, Ints, as_tracks, check_shape, mean_or_nan, step_mask


def encode_modes(labels: ArrayLike, names: Sequence[str]) -> Ints:
    """Integers of mode labels, -1 for labels that are not in `names`.

    Args:
        labels: (B, T) strings; "" = unknown.
        names: mode names, in the order of the columns of `mode_probs`.
    Returns:
        (B, T) integers.
    Source: this package's track format. Differs: none.
    """
    text = np.asarray(labels, dtype=np.str_)
    out = np.full(text.shape, -1, dtype=np.int64)
    for index, name in enumerate(names):
        out[text == name] = index
    return out


def known_modes(
    caller: str,
    mode_probs: ArrayLike,
    true_modes: ArrayLike,
    lengths: ArrayLike | None,
    mask: ArrayLike | None,
) -> tuple[Floats, Ints]:
    """Probabilities (K, M) and true modes (K,) of the K steps whose mode is known."""
    probs = as_tracks(caller, "mode_probs", mode_probs, 3)
    modes = as_tracks(caller, "true_modes", true_modes, 2)
    check_shape(caller, "true_modes", modes, (probs.shape[0], probs.shape[1]))
    modes = np.where(np.isfinite(modes), modes, -1.0)
    if np.any(modes >= probs.shape[2]):
        raise ValueError(
            f"{caller}: true_modes must be below the number of modes {probs.shape[2]}; got {modes.max():g}. "
            "Count modes from 0 and mark unknown steps with -1."
        )
    keep = step_mask((probs.shape[0], probs.shape[1]), lengths, mask) & (modes >= 0)
    return probs[keep], modes[keep].astype(np.int64)


def mode_accuracy(
    mode_probs: ArrayLike,
    true_modes: ArrayLike,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> float:
    """Share of steps whose most probable mode is the true one (a tie counts for the lower index).

    Args:
        mode_probs: (B, T, M) or (T, M).
        true_modes: (B, T) or (T,) integers 0..M-1; negative or NaN = unknown.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to count.
    Returns:
        0 to 1; NaN if no mode is known.
    Raises:
        ValueError: shapes differ or a mode is too large.
    Source: definition.
    """
    probs, modes = known_modes("mode_accuracy", mode_probs, true_modes, lengths, mask)
    return mean_or_nan(probs.argmax(axis=1) == modes) if modes.size else float("nan")


def brier_score(
    mode_probs: ArrayLike,
    true_modes: ArrayLike,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> float:
    """Mean squared error of the mode probabilities, summed over modes; arguments as `mode_accuracy`.

    Model: mean_k sum_j (mu_j - [j = true])^2, from 0 (sure and right) to 2 (sure and wrong); uniform: 1 -
    1/M.

    Returns:
        the score; NaN if no mode is known.
    Source: Brier (1950). Differs: original multi-class form, twice the two-class textbook form.
    """
    probs, modes = known_modes("brier_score", mode_probs, true_modes, lengths, mask)
    return mean_or_nan(np.sum((probs - np.eye(probs.shape[1])[modes]) ** 2, axis=1))


def log_score(
    mode_probs: ArrayLike,
    true_modes: ArrayLike,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    floor: float = 1e-12,
) -> float:
    """Mean of -ln(probability of the true mode), nats; arguments as `mode_accuracy`.

    Args:
        mode_probs: (B, T, M) or (T, M).
        true_modes: (B, T) or (T,); negative or NaN = unknown.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to count.
        floor: probabilities below it are read as it, so one dead mode does not make the score infinite.
    Returns:
        0 is perfect, ln M is uniform; NaN if no mode is known.
    Raises:
        ValueError: shapes differ, a mode is too large or floor is not positive.
    Source: Good (1952), logarithmic score. Differs: sign (smaller is better) and the floor.
    """
    if not floor > 0.0:
        raise ValueError(f"log_score: floor must be positive; got {floor}. Use 1e-12.")
    probs, modes = known_modes("log_score", mode_probs, true_modes, lengths, mask)
    return mean_or_nan(-np.log(np.maximum(probs[np.arange(modes.size), modes], floor)))


def true_mode_probability(
    mode_probs: ArrayLike,
    true_modes: ArrayLike,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> float:
    """Mean probability given to the true mode; arguments as `mode_accuracy`; NaN if no mode is known.

    Source: definition.
    """
    probs, modes = known_modes("true_mode_probability", mode_probs, true_modes, lengths, mask)
    return mean_or_nan(probs[np.arange(modes.size), modes])
