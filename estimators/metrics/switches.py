"""How long after a true mode switch the mode probabilities follow."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jink.estimators.metrics.modes import known_modes
from jink.estimators.metrics.steps import Floats, Ints, as_tracks, check_shape, step_mask


class Switches(NamedTuple):
    """One row per true switch: track (S,), step (S,), delay (S,) in seconds; NaN delay = never detected."""

    track: Ints
    step: Ints
    delay_s: Floats


def switch_delays(
    mode_probs: ArrayLike,
    true_modes: ArrayLike,
    times: ArrayLike,
    lengths: ArrayLike | None = None,
    threshold: float | None = None,
) -> Switches:
    """Time from each true mode switch to its detection.

    A switch is a step whose mode is known and differs from the known mode one step before. It is detected at
    the first step, from the switch on and while the new mode lasts, at which the new mode is the most
    probable one (or reaches `threshold`). Already preferring the new mode gives delay 0; leaving it
    undetected gives NaN.

    Args:
        mode_probs: (B, T, M) or (T, M).
        true_modes: (B, T) or (T,) integers; negative or NaN = unknown.
        times: (B, T) or (T,) s.
        lengths: (B,) valid rows per track.
        threshold: probability in (0, 1] that counts as detection; None = most probable mode.
    Returns:
        Switches, in order of track and step; empty if there is none.
    Raises:
        ValueError: shapes differ, a mode is too large or threshold lies outside (0, 1].
    Source: the definition is ours.
    """
    if threshold is not None and not 0.0 < threshold <= 1.0:
        raise ValueError(f"switch_delays: threshold must lie in (0, 1]; got {threshold}. Use None for the top mode.")
    probs = as_tracks("switch_delays", "mode_probs", mode_probs, 3)
    modes = as_tracks("switch_delays", "true_modes", true_modes, 2)
    clock = np.asarray(times, dtype=np.float64)
    if clock.shape == modes.shape[1:]:
        clock = np.broadcast_to(clock, modes.shape)
    known_modes("switch_delays", probs, modes, lengths, None)
    check_shape("switch_delays", "times", clock, modes.shape)
    inside = step_mask((modes.shape[0], modes.shape[1]), lengths)
    known = np.where(inside & np.isfinite(modes) & (modes >= 0), modes, -1).astype(np.int64)
    change = (known[:, 1:] != known[:, :-1]) & (known[:, 1:] >= 0) & (known[:, :-1] >= 0)
    tracks, steps = np.nonzero(change)
    steps = steps + 1
    delays = np.full(tracks.size, np.nan)
    for i, (b, k) in enumerate(zip(tracks, steps, strict=True)):
        new = known[b, k]
        left = np.nonzero(known[b, k:] != new)[0]
        end = k + int(left[0]) if left.size else known.shape[1]
        p = probs[b, k:end]
        found = np.nonzero(p.argmax(axis=1) == new if threshold is None else p[:, new] >= threshold)[0]
        if found.size:
            delays[i] = clock[b, k + int(found[0])] - clock[b, k]
    return Switches(tracks.astype(np.int64), steps.astype(np.int64), delays)
