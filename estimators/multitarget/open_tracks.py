"""What a network reports whose targets come and go: rows of target and time, at every node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.checks import check_count

__all__ = ["OpenFound", "OpenTracks", "gather_open"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class OpenFound(NamedTuple):
    """What one time gives: N nodes, M targets, A axes; position then velocity."""

    time: float
    ids: Ints  # (M,)
    mean: Array  # (N, M, 2 A)
    cov: Array  # (N, M, 2 A, 2 A)
    supported: NDArray[np.bool_]  # whether some node's own track is near; (M,)
    hits: Array  # expected detections of each target at this time, of all nodes; (M,)
    begun: Ints
    ended: Ints
    messages: int  # announcements included
    sent_bytes: int
    trouble: int


class OpenTracks(NamedTuple):
    """Tracks at every node: one row per target and time, R rows in order of time; N nodes, F times, A axes."""

    frame: Ints  # index of the time; (R,)
    id: Ints  # (R,)
    mean: Array  # fused, as it stood then; (N, R, 2 A)
    cov: Array  # (N, R, 2 A, 2 A)
    supported: NDArray[np.bool_]  # whether some node's own track was near; (R,)
    hits: Array  # expected detections of the target at this time, of all nodes; (R,)
    times: Array  # (F,)
    messages: Ints  # (F,)
    sent_bytes: Ints  # (F,)
    trouble: int

    def sets(self, node: int = 0) -> tuple[Ints, Array]:
        """Tracks of a node as sets for GOSPA: ids (M,), positions (M, F, A), NaN where a track is not there.

        Raises:
            ValueError: a node that does not exist.
        """
        check_count("OpenTracks.sets", "node", node, 0, len(self.mean) - 1, remedy="Count nodes from 0.")
        ids, row = np.unique(self.id, return_inverse=True)
        A = self.mean.shape[2] // 2
        out = np.full((len(ids), len(self.times), A), np.nan)
        out[row, self.frame] = self.mean[node, :, :A]
        return ids, out


def gather_open(found: Sequence[OpenFound], nodes: int, axes: int) -> OpenTracks:
    """Rows of all times."""
    none = np.zeros(0, dtype=np.int64)
    frame = np.repeat(np.arange(len(found)), [len(one.ids) for one in found])
    return OpenTracks(
        frame,
        np.concatenate([none, *(one.ids for one in found)]),
        np.concatenate([np.zeros((nodes, 0, 2 * axes)), *(one.mean for one in found)], axis=1),
        np.concatenate([np.zeros((nodes, 0, 2 * axes, 2 * axes)), *(one.cov for one in found)], axis=1),
        np.concatenate([np.zeros(0, dtype=bool), *(one.supported for one in found)]),
        np.concatenate([np.zeros(0), *(one.hits for one in found)]),
        np.array([one.time for one in found], dtype=np.float64),
        np.array([one.messages for one in found], dtype=np.int64),
        np.array([one.sent_bytes for one in found], dtype=np.int64),
        sum(one.trouble for one in found),
    )
