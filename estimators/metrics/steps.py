"""Which steps of a track are scored, and the shape checks that all measures share."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]
Ints: TypeAlias = NDArray[np.int64]


def as_tracks(caller: str, name: str, values: ArrayLike, ndim: int) -> Floats:
    """Give a float array with its track axis, `ndim` dimensions in all."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == ndim - 1:
        array = array[None]
    if array.ndim != ndim:
        letters = ("B", "T", "A", "A")[:ndim]
        shape = f"({', '.join(letters)})"
        raise ValueError(
            f"{caller}: {name} must have shape {shape}; got {np.shape(values)}. Put tracks first, then time."
        )
    return array


def check_shape(caller: str, name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Refuse an array of another shape than `shape`."""
    if array.shape != shape:
        raise ValueError(
            f"{caller}: {name} must have shape {shape}; got {array.shape}. Give both for the same tracks and times."
        )


def check_level(caller: str, level: float) -> None:
    """Refuse a probability outside (0, 1)."""
    if not 0.0 < level < 1.0:
        raise ValueError(f"{caller}: level must lie in (0, 1); got {level}. Use 0.95 for a 95 % band.")


def step_mask(shape: tuple[int, int], lengths: ArrayLike | None = None, mask: ArrayLike | None = None) -> Bools:
    """Steps that belong to a track and are asked for.

    Args:
        shape: (B, T).
        lengths: valid rows per track; (B,) integers; None means all T.
        mask: steps to keep; (B, T) or (T,) booleans; None means all.
    Returns:
        (B, T) booleans.
    Raises:
        ValueError: a shape does not fit, or a length lies outside [0, T].
    Source: this package's track format. Differs: none.
    """
    keep = np.ones(shape, dtype=np.bool_)
    if lengths is not None:
        rows = np.atleast_1d(np.asarray(lengths))
        if rows.shape != shape[:1] or np.any(rows < 0) or np.any(rows > shape[1]):
            raise ValueError(
                f"step_mask: lengths must be ({shape[0]},) integers in [0, {shape[1]}]; "
                f"got {rows.tolist()[:8]}. Give one length per track."
            )
        keep &= np.arange(shape[1]) < rows[:, None]
    if mask is not None:
        given = np.asarray(mask, dtype=np.bool_)
        if given.shape not in (shape, shape[1:]):
            raise ValueError(
                f"step_mask: mask must have shape {shape} or {shape[1:]}; got {given.shape}. Give one boolean per step."
            )
        keep &= given
    return keep


def scored_steps(
    estimate: Floats, known: Floats, lengths: ArrayLike | None, mask: ArrayLike | None
) -> tuple[Bools, Bools]:
    """Steps to score, and those of them whose estimate is finite; (B, T) each."""
    scored: Bools = step_mask((known.shape[0], known.shape[1]), lengths, mask) & np.asarray(
        np.isfinite(known).all(axis=2)
    )
    usable: Bools = scored & np.asarray(np.isfinite(estimate).all(axis=2))
    return scored, usable


def root_mean_square(values: Floats, axis: int | None) -> Floats:
    """Root of the mean square of the values that are not NaN; NaN where there is none."""
    present = ~np.isnan(values)
    count = present.sum(axis=axis)
    # Scaling by the largest value keeps squares of diverged tracks from overflowing to inf.
    finite = values[np.isfinite(values)]
    scale = float(np.max(np.abs(finite), initial=0.0)) or 1.0
    total = np.where(present, values / scale, 0.0) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(scale * np.sqrt(total.sum(axis=axis) / count))


def mean_or_nan(values: NDArray[Any]) -> float:
    """Mean, NaN of nothing."""
    return float(np.mean(values)) if values.size else float("nan")
