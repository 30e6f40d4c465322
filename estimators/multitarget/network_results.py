"""What a network of nodes reports: fused estimates at every node, step by step and as tracks, and what was sent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.multitarget.network_state import NetworkState
from jink.estimators.multitarget.results import kinematic_moments
from jink.estimators.multitarget.tables import Moving

__all__ = ["NetworkFound", "NetworkTracks", "gather_network"]

Array = NDArray[np.float64]


class NetworkFound(NamedTuple):
    """What a step found: N nodes, M targets."""

    time: float
    ids: NDArray[np.int64]  # (M,)
    mean: Array  # fused states; (N, M, n)
    cov: Array  # (N, M, n, n)
    retired: tuple[Array, Array] | None  # smoothed moments of the time that left the window
    messages: int  # sent at this time, by all nodes
    sent_bytes: int
    exchanges: int  # of L rounds each
    trouble: int  # updates without a covariance; the prediction stood in
    hits: Array  # expected detections of each target at this time, of all nodes; (M,)


class NetworkTracks(NamedTuple):
    """Tracks at every node: N nodes, M targets, F times, A axes; position then velocity in covariances."""

    times: Array  # distinct times of scans, s; (F,)
    ids: NDArray[np.int64]  # (M,)
    position: Array  # fused, as it stood at each time; (N, M, F, A) m
    velocity: Array
    covariance: Array  # (N, M, F, 2 A, 2 A)
    smoothed_position: Array  # by the times that followed within the window
    smoothed_velocity: Array
    messages: NDArray[np.int64]  # sent at each time; (F,)
    sent_bytes: NDArray[np.int64]
    trouble: int


def gather_network(moving: Moving, found: Sequence[NetworkFound], state: NetworkState) -> NetworkTracks:
    """Tracks from all steps of targets that were there all along; ``state`` holds the end of the smoothed paths."""
    smoothed = [one.retired for one in found if one.retired is not None]
    smoothed += [(state.paths.means[:, :, k], state.paths.covs[:, :, k]) for k in range(len(state.times))]
    (N, M, n), F, A = state.last.shape, len(found), len(moving.index) // 2

    def kinematics(means: list[Array], covs: list[Array]) -> tuple[Array, Array]:
        x = np.array(means).reshape(F, N, M, n).transpose(1, 2, 0, 3)
        P = np.array(covs).reshape(F, N, M, n, n).transpose(1, 2, 0, 3, 4)
        kin, spread = kinematic_moments(
            moving, np.ascontiguousarray(x).reshape(-1, n), np.ascontiguousarray(P).reshape(-1, n, n)
        )
        return kin.reshape(N, M, F, 2 * A), spread.reshape(N, M, F, 2 * A, 2 * A)

    kin, cov = kinematics([one.mean for one in found], [one.cov for one in found])
    late, _ = kinematics([one[0] for one in smoothed], [one[1] for one in smoothed])
    return NetworkTracks(
        np.array([one.time for one in found]), state.ids, kin[..., :A], kin[..., A:], cov, late[..., :A],
        late[..., A:], np.array([one.messages for one in found], dtype=np.int64),
        np.array([one.sent_bytes for one in found], dtype=np.int64), sum(one.trouble for one in found),
    )  # fmt: skip
