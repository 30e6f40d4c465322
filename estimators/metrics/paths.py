"""Whole paths: how smooth they are, and which tracks were lost."""

import numpy as np
from numpy.typing import ArrayLike

from jink.estimators.metrics.steps import (
    Floats,
    as_tracks,
    check_shape,
    mean_or_nan,
    root_mean_square,
    step_mask,
)
from jink.estimators.metrics.tracking_errors import errors


def smoothness(
    position: ArrayLike,
    times: ArrayLike | None = None,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> float:
    """Root mean square second difference of the estimated path; needs no truth.

    Model: sqrt(mean |x_{k+1} - 2 x_k + x_{k-1}|^2) in m, or with `times` the divided difference (an
    acceleration, right for uneven sampling). All three points must be finite, inside the track and the mask.

    Args:
        position: (B, T, A) or (T, A) m.
        times: (B, T) or (T,) s; None = plain differences. Triples with repeated times are left out.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to use.
    Returns:
        m, or m/s^2 with `times`; NaN without three consecutive points.
    Raises:
        ValueError: shapes differ.
    Source: the definition is ours.
    """
    x = as_tracks("smoothness", "position", position, 3)
    shape = (x.shape[0], x.shape[1])
    keep = step_mask(shape, lengths, mask) & np.isfinite(x).all(axis=2)
    x = np.where(keep[:, :, None], x, 0.0)
    triple = keep[:, 2:] & keep[:, 1:-1] & keep[:, :-2]
    if times is None:
        second = x[:, 2:] - 2.0 * x[:, 1:-1] + x[:, :-2]
    else:
        t = np.asarray(times, dtype=np.float64)
        t = np.broadcast_to(t, shape) if t.shape == shape[1:] else t
        check_shape("smoothness", "times", t, shape)
        dt = np.diff(t, axis=1)
        triple = triple & (dt[:, 1:] > 0.0) & (dt[:, :-1] > 0.0)
        dt = np.where(dt > 0.0, dt, 1.0)[:, :, None]
        slope = np.diff(x, axis=1) / dt
        second = 2.0 * np.diff(slope, axis=1) / (dt[:, 1:] + dt[:, :-1])
    return float(root_mean_square(np.hypot.reduce(second[triple], axis=1), None))


def lost_tracks(
    estimate: ArrayLike,
    truth: ArrayLike,
    gate: float,
    last: int = 10,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> Floats:
    """Which tracks are lost: position error above `gate` at *every one* of the last `last` scored steps.

    A track that strayed but came back is not lost; one with fewer scored steps is judged by those it has.

    Args:
        estimate: (B, T, A) or (T, A) m.
        truth: same; NaN = unknown, not a scored step.
        gate: m, positive.
        last: number of scored steps that must all fail, >= 1.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to score.
    Returns:
        (B,) 1.0 lost, 0.0 kept, NaN without scored steps; its `nanmean` is the lost-track rate.
    Raises:
        ValueError: shapes differ, gate <= 0 or last < 1.
    Source: the definition is ours.
    """
    if not gate > 0.0 or last < 1:
        raise ValueError(
            f"lost_tracks: gate must be positive and last >= 1; got gate={gate}, last={last}. "
            "A gate of five measurement sigmas and last=10 are usual."
        )
    out = np.full(as_tracks("lost_tracks", "truth", truth, 3).shape[0], np.nan)
    for b, row in enumerate(errors(estimate, truth, lengths, mask)):
        tail = row[~np.isnan(row)][-last:]
        if tail.size:
            out[b] = float(np.all(tail > gate))
    return out


def lost_track_rate(
    estimate: ArrayLike,
    truth: ArrayLike,
    gate: float,
    last: int = 10,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> float:
    """Share of the scored tracks that `lost_tracks` (same arguments) calls lost; NaN if none is scored."""
    lost = lost_tracks(estimate, truth, gate, last, lengths, mask)
    return mean_or_nan(lost[~np.isnan(lost)])
