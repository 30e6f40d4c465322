"""`OpenNetwork`: a network of nodes whose targets come and go, found by the nodes' own trackers.

Every sensing node also runs a tracker of its own on its own scans, and compares its confirmed tracks with what the
network believes. A track of its own that is near no target of the network is announced and admitted everywhere under
one number; a target that no node's own track has been near for a while is dismissed everywhere. Announcements are
small and pass every link once; they are counted, and taken to reach all nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from jink.estimators.checks import check_kind, check_number
from jink.estimators.multitarget.distributed import DistributedPmht
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.network_state import NetworkState, frames_of
from jink.estimators.multitarget.one_scan import OneScanTracker
from jink.estimators.multitarget.open_tracks import OpenFound, OpenTracks, gather_open
from jink.estimators.multitarget.pmht import KnownTracks, Pmht, PmhtState
from jink.estimators.multitarget.results import kinematic_moments
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scan, Scans

__all__ = ["OpenNetwork", "OpenState", "match"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class OpenState(NamedTuple):
    """Everything between two times."""

    network: NetworkState
    local: dict[int, PmhtState]  # by sensing node
    supported: Array  # when a node's own track was last near each target, s; (M,)


@dataclass(frozen=True, eq=False)
class OpenNetwork:
    """Distributed PMHT that finds its targets itself.

    Model: node i's own track x_i and target j of the network are one if ``(x_i - y_j)' (P_i + P_j)^-1 (x_i - y_j)``,
    position and velocity, is below ``near``; each of a node's tracks supports one target at most, as many as possible,
    older targets first. P_i and P_j count as independent, which they are not: the test errs towards "one".

    Args:
        tracker: the network.
        initiation: how each node's own tracks begin and end.
        near: D^2 below which a node's track and a target are one.
        patience: a target that no node's track supports for so long is dismissed, s.
        local: tracker of each node by itself; None: `Pmht` with motion, window and gate of the network.

    Raises:
        ValueError: a number out of range.

    Source: ours.
    """

    tracker: DistributedPmht
    initiation: Initiation = field(default_factory=Initiation)
    near: float = 25.0
    patience: float = 10.0
    local: Pmht | OneScanTracker | None = None

    def __post_init__(self) -> None:
        me = "OpenNetwork"
        check_kind(me, "tracker", self.tracker, DistributedPmht, "a DistributedPmht", "Give the network.")
        check_kind(me, "initiation", self.initiation, Initiation, "an Initiation", "Use Initiation(speed=20.0).")
        for name, remedy in (("near", "Use 25."), ("patience", "Use 10 s.")):
            check_number(me, name, getattr(self, name), 0.0, infinite=True, remedy=remedy)
        kinds = (Pmht, OneScanTracker, type(None))
        check_kind(me, "local", self.local, kinds, "a Pmht, Gnn or Jpda, or None", "Leave it out.")

    @cached_property
    def finder(self) -> Pmht | OneScanTracker:
        """The tracker of a node by itself."""
        if self.local is not None:
            return self.local
        own = self.tracker
        return Pmht(own.motion, own.chain, window=own.window, gate=own.gate, initiation=self.initiation)

    def start(self, sensors: ScanSensor | Sequence[ScanSensor], time: float) -> OpenState:
        """Begin without targets.

        Args:
            sensors: those that will scan.
            time: s; of the first scans.
        """
        check_number("OpenNetwork.start", "time", time, remedy="Give seconds.")
        width = 2 * self.tracker.motions[0].axes
        nobody = KnownTracks(np.zeros((0, width)), np.eye(width), float(time))
        every = (sensors,) if isinstance(sensors, ScanSensor) else tuple(sensors)
        network = self.tracker.start(every, nobody)
        nodes = sorted(set(self.tracker.node_of))
        return OpenState(network, {node: self.finder.start(every, time) for node in nodes}, np.zeros(0))

    def step(self, state: OpenState, scans: Sequence[Scan]) -> tuple[OpenState, OpenFound]:
        """Take in the scans of one time; as `DistributedPmht.step`.

        Returns:
            the new state and what was found, targets that begin or end at this time included.

        Raises:
            ValueError: as `DistributedPmht.step`.
        """
        tracker = self.tracker
        network, found = tracker.step(state.network, scans)
        hits = found.hits
        alive = tracker.consensus.faults.alive(found.time, tracker.consensus.nodes)
        local, supported = dict(state.local), state.supported.copy()
        begun: list[int] = []
        words = said = 0
        # Any order will do as long as all nodes use the same.
        for node in sorted({tracker.node_of[scan.sensor] for scan in scans}):
            if not alive[node]:
                continue
            first_scan, *others = (scan for scan in scans if tracker.node_of[scan.sensor] == node)
            local[node], own = self.finder.step(local[node], first_scan)
            for scan in others:
                local[node], own = self.finder.step(local[node], scan)
            owner = match(own.now.mean, own.now.cov, *self._beliefs(network, node), self.near)
            supported[owner[owner >= 0]] = found.time
            fresh = owner < 0
            if fresh.any():
                first = network.next_id
                network = tracker._admitted(network, own.now.mean[fresh], own.now.cov[fresh])
                hits = np.append(hits, np.zeros(int(fresh.sum())))
                begun += range(first, network.next_id)
                supported = np.append(supported, np.full(int(fresh.sum()), found.time))
            width = own.now.mean.shape[1]
            words += len(owner) + int(fresh.sum()) * (width + width * (width + 1) // 2)
            said += bool(len(owner))
        stays = found.time - supported <= self.patience
        ended = network.ids[~stays]
        if ended.size:
            network = tracker.dismiss(network, ended)
        links = int((tracker.consensus.adjacency & alive & alive[:, None]).sum())
        mean, cov = self._moments(network)
        return OpenState(network, local, supported[stays]), OpenFound(
            found.time, network.ids, mean, cov, supported[stays] == found.time, hits[stays],
            np.array(begun, dtype=np.int64), ended, found.messages + said * links,
            found.sent_bytes + 8 * words * links, found.trouble,
        )  # fmt: skip

    def run(self, scans: Scans) -> OpenTracks:
        """Take in all scans; those of one time are taken together.

        Args:
            scans: in time order.

        Returns:
            tracks at every node.
        """
        remedy = "Make them with Scans.from_arrays or Scans.from_frame."
        check_kind("OpenNetwork.run", "scans", scans, Scans, "Scans", remedy)
        found = []
        if len(scans):
            state = self.start(scans.sensors, float(scans.times[0]))
            for frame in frames_of(list(scans)):
                state, one = self.step(state, frame)
                found.append(one)
        return gather_open(found, self.tracker.consensus.nodes, scans.axes)

    def _beliefs(self, network: NetworkState, node: int) -> tuple[Array, Array]:
        """Position and velocity of all targets as a node believes them; (M, 2 A), (M, 2 A, 2 A)."""
        mean, cov = network.last[node], network.last_cov[node]
        return kinematic_moments(self.tracker.moving, np.ascontiguousarray(mean), np.ascontiguousarray(cov))

    def _moments(self, network: NetworkState) -> tuple[Array, Array]:
        N, M, n = network.last.shape
        mean, cov = kinematic_moments(
            self.tracker.moving, network.last.reshape(N * M, n), network.last_cov.reshape(N * M, n, n)
        )
        width = mean.shape[1]
        return mean.reshape(N, M, width), cov.reshape(N, M, width, width)


def match(mean: Array, cov: Array, targets: Array, target_covs: Array, near: float) -> Ints:
    """Which target each track is: one to one, as many as possible, earlier targets first, then the nearest.

    Args:
        mean, cov: tracks; (K, w), (K, w, w).
        targets, target_covs: (M, w), (M, w, w), oldest first.
        near: D^2 below which they can be one.

    Returns:
        (K,), -1: none.
    """
    K, M = len(mean), len(targets)
    owner = np.full(K, -1)
    if not K or not M:
        return owner
    off = mean[:, None] - targets[None]
    inverse = np.linalg.pinv(cov[:, None] + target_covs[None], hermitian=True)
    distance = np.einsum("kmi,kmij,kmj->km", off, inverse, off)
    # An earlier target outweighs any sum of distances; one pair more outweighs any age.
    price = near * (min(K, M) + 1)
    cost = np.where(distance < near, distance + price * np.arange(M), price * (M + 1) * (min(K, M) + 1))
    rows, columns = linear_sum_assignment(cost)
    good = distance[rows, columns] < near
    owner[rows[good]] = columns[good]
    return owner
