"""Rows so far off that they would spoil the very scales by which an outlier is told."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks

__all__ = ["absurd_rows"]

_REACH = 0.9  # quantile of the distances from the middle of a track that is the size of the scene
_JUMP = 1000.0  # sizes of the scene that no target travels between two rows


def absurd_rows(tracks: Tracks) -> NDArray[np.bool_]:
    """Measured rows that no path leads to: far outside the scene, and reached by a jump of a thousand scenes.

    The size of the scene is a high quantile, over all tracks, of the distance from the median position of the track. A
    track is cut where it jumps by more than a thousand sizes per usual time step; the parts that lie as far as that
    from its median in every row are absurd. A target that rests nine tenths of the time and then leaves goes step by
    step, so it is kept. Milder outliers are left to the likelihood.

    Args:
        tracks: positions, a row whole or missing.

    Returns:
        (B, T); nothing where more than one row in ten is off, or where nothing moves: there is no scale then.
    """
    measured = np.isfinite(tracks.measurements).all(axis=2) & tracks.used
    away = np.full(measured.shape, np.nan)
    for b, rows in enumerate(measured):
        if rows.any():
            places = tracks.measurements[b, rows]
            away[b, rows] = np.linalg.norm(places - np.median(places, axis=0), axis=1)
    absurd = np.zeros_like(measured)
    scene = float(np.quantile(away[measured], _REACH)) if measured.any() else 0.0
    if not scene > 0.0:
        return absurd
    steps = [np.diff(tracks.times[b, rows]) for b, rows in enumerate(measured)]
    moving = np.concatenate(steps)
    usual = float(np.median(moving[moving > 0.0])) if (moving > 0.0).any() else 1.0
    for b in np.flatnonzero(np.nanmax(np.where(measured, away, 0.0), axis=1) > _JUMP * scene).tolist():
        rows = np.flatnonzero(measured[b])
        jumps = np.linalg.norm(np.diff(tracks.measurements[b, rows], axis=0), axis=1)
        part = np.concatenate([[0], np.cumsum(jumps > _JUMP * scene * np.maximum(steps[b] / usual, 1.0))])
        near = np.unique(part[away[b, rows] <= _JUMP * scene])
        absurd[b, rows] = ~np.isin(part, near)
    return absurd
