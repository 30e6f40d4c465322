"""Recorded directions as tracks: what a target's body does when its place is not the point."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.tracks import Tracks

__all__ = ["heading_tracks"]

Floats = NDArray[np.float64]
_ERROR = 0.05


def heading_tracks(
    headings: ArrayLike, times: ArrayLike, *, error: float = _ERROR, ids: tuple[str, ...] = ()
) -> Tracks:
    """Tracks of a point that follows a recorded direction at 1 m/s: turning of the body is turning of its path.

    Row k lies ``dt`` metres from the row before, in the direction recorded at k; so a body that turns is an arc, one
    that shakes a weave, whichever way it drifts. An error of a direction stays in the path for good and is motion to a
    filter; only what a straight step misses of an arc is new in every row, and ``error`` stands for that.

    Args:
        headings: direction of each row, rad, counter-clockwise from x; (T,) or (B, T); NaN where none was recorded: the
            point then follows the next one.
        times: s, increasing; (T,) or (B, T).
        error: standard deviation of a row's place, as a share of its step.
        ids: names of the tracks.

    Returns:
        tracks with noise for every row; a row without a direction is missing.

    Raises:
        ValueError: shapes that do not fit, fewer than two rows, times that do not increase, or an error not above 0.
    """
    angle = np.array(headings, dtype=np.float64, ndmin=2)
    if angle.ndim != 2 or angle.shape[1] < 2:
        raise ValueError(
            f"heading_tracks: headings must be (T,) or (B, T) with T >= 2; got {np.shape(headings)}. One angle per row."
        )
    clock = np.asarray(times, dtype=np.float64)
    if clock.shape not in ((angle.shape[1],), angle.shape):
        raise ValueError(
            f"heading_tracks: times must be ({angle.shape[1]},) or {angle.shape}; got {clock.shape}. One time per row."
        )
    clock = np.broadcast_to(clock, angle.shape)
    steps = np.diff(clock, axis=1)
    if not (steps > 0).all():
        raise ValueError("heading_tracks: times must increase and be finite; got others. Sort the rows.")
    if not 0.0 < error < np.inf:
        raise ValueError(f"heading_tracks: error must be > 0 and finite; got {error}. Use 0.05.")
    seen = np.isfinite(angle)
    reach = _since_seen(clock, steps, seen)
    ahead = np.where(seen, angle, 0.0)
    moved = np.where(seen, reach, 0.0)[..., None] * np.stack([np.cos(ahead), np.sin(ahead)], axis=2)
    path = np.where(seen[..., None], np.cumsum(moved, axis=1), np.nan)
    noise = (error * reach)[..., None, None] ** 2 * np.eye(2)
    return Tracks.from_arrays(path, clock, noise=noise, ids=ids or None)


def _since_seen(clock: Floats, steps: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Seconds since the row before, or the last one with a direction; (B, T)."""
    out = np.concatenate([steps[:, :1], steps], axis=1)
    for b, row in enumerate(seen):
        at = np.flatnonzero(row)
        out[b, at[1:]] = np.diff(clock[b, at])
    return out
