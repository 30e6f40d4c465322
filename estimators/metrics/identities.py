"""Whether each target keeps one track: identity switches, breaks, time held, losses, and tracks of nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from jink.estimators.checks import check_count, check_number
from jink.estimators.metrics.steps import Floats, Ints
from jink.estimators.metrics.target_sets import target_set

__all__ = ["Identities", "identities"]


class Identities(NamedTuple):
    """Per target (N,) unless said otherwise.

    switches: how often a target's track is another than the one that held it before.
    breaks: how often a target that was held is not, while it is there, and is held again later.
    held: share of the target's times at which some track holds it; NaN if it is never there.
    lost: 1.0 if no track holds it at its last times, 0.0 if one does, NaN if it is never there.
    false_tracks: number of tracks that hold nothing at more than half of their times.
    track_of: (N, T) which track holds the target, -1 none.
    """

    switches: Ints
    breaks: Ints
    held: Floats
    lost: Floats
    false_tracks: int
    track_of: Ints


def identities(estimate: ArrayLike, truth: ArrayLike, gate: float, last: int = 10) -> Identities:
    """Follow which track holds which target.

    A pair stays together from one time to the next as long as it is closer than the gate; what is left over is paired
    so that as many as possible are, at the least sum of squared distances. So two tracks that swap targets count as
    two switches, when the tracks leave the gate, and a track that strays for a moment beside a better one does not.

    Args:
        estimate: (K, T, A) m; row = identity of a track; NaN = not there.
        truth: (N, T, A) m; NaN = not there.
        gate: m, > 0.
        last: times at the end of a target's life that decide whether it is lost, >= 1.
    Returns:
        `Identities`.
    Raises:
        ValueError: shapes differ, gate <= 0 or last < 1.
    Source: Bernardin, Stiefelhagen (2008), section 2.1. Differs: squared distances; breaks, losses and false tracks
    are ours.
    """
    check_number("identities", "gate", gate, 0.0, 1e140, remedy="Use the cut-off of GOSPA, in metres.")
    check_count("identities", "last", last, 1, remedy="Use 10.")
    x, y = target_set("identities", "estimate", estimate), target_set("identities", "truth", truth)
    if x.shape[1:] != y.shape[1:]:
        raise ValueError(
            f"identities: estimate and truth must have the same times and axes; got shapes {x.shape} and {y.shape}. "
            "Only the number of tracks may differ."
        )
    track_of = _follow(x, y, gate)
    there = ~np.isnan(y[:, :, 0])
    switches, breaks = (np.zeros(len(y), dtype=np.int64) for _ in range(2))
    held, lost = np.full(len(y), np.nan), np.full(len(y), np.nan)
    for n in range(len(y)):
        tracks = track_of[n, there[n]]
        if not tracks.size:
            continue
        when = np.flatnonzero(tracks >= 0)
        switches[n] = np.count_nonzero(np.diff(tracks[when]))
        breaks[n] = np.count_nonzero(np.diff(when) > 1)
        held[n] = when.size / tracks.size
        lost[n] = float((tracks[-last:] < 0).all())
    exists = (~np.isnan(x[:, :, 0])).sum(axis=1)
    busy = np.array([(track_of == k).sum() for k in range(len(x))], dtype=np.int64)
    return Identities(switches, breaks, held, lost, int(np.count_nonzero(2 * busy < exists)), track_of)


def _follow(x: Floats, y: Floats, gate: float) -> Ints:
    """Track of each target at each time; (N, T)."""
    track_of = np.full(y.shape[:2], -1, dtype=np.int64)
    targets = np.arange(len(y))
    for k in range(y.shape[1]):
        apart = np.linalg.norm(x[:, None, k] - y[None, :, k], axis=2)
        near = apart < gate  # NaN is not near
        if k:
            held = track_of[:, k - 1]
            stays = held >= 0
            stays[stays] = near[held[stays], targets[stays]]
            track_of[stays, k] = held[stays]
        free_x, free_y = np.setdiff1d(np.arange(len(x)), track_of[:, k]), np.flatnonzero(track_of[:, k] < 0)
        part = np.ix_(free_x, free_y)
        # Dearer than any sum of gated pairs: the number of pairs counts before their distance.
        price = gate**2 * (min(free_x.size, free_y.size) + 1)
        cost = np.where(near[part], apart[part] ** 2, price)
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if near[part][row, column]:
                track_of[free_y[column], k] = free_x[row]
    return track_of
