"""`DistributedPmht`: nodes with sensors of their own follow the same targets and talk to their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.motion import Motion
from jink.estimators.multitarget.consensus import Consensus, message_bytes
from jink.estimators.multitarget.information import Information, consensus_update, from_moments, to_moments
from jink.estimators.multitarget.network_state import NetworkState, NodeScans, frames_of, node_scans
from jink.estimators.multitarget.node_kernels import (
    filter_information,
    local_information,
    predict_targets,
    smooth_back,
)
from jink.estimators.multitarget.pmht import KnownTracks, positions_of
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scan, Scans
from jink.estimators.multitarget.tables import Moving, make_moving, make_sensing
from jink.estimators.multitarget.tracked import state_moments

__all__ = ["ORDERS", "DistributedPmht", "NetworkFound", "NetworkTracks"]

Array = NDArray[np.float64]
ORDERS = ("V1", "V2")
LEAST_HITS = 0.1
"""Expected detections below which a node's scan says nothing of a target."""


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


@dataclass(frozen=True, eq=False)
class DistributedPmht:
    """PMHT at every node of a network, joined by consensus on information.

    Model: each node weighs the detections of its own sensors with the states it believes, and makes of the centroids
    information about each target; consensus with neighbours adds up what all nodes found. "V1", the patent's order:
    a node iterates by itself, then all fuse once. "V2": nodes fuse in every iteration, so that each weighs its
    detections with what all know; ``iterations`` times the messages.

    Args:
        motion: how targets move; one motion.
        consensus: weights, rounds, rule of the novelty, faults.
        node_of: node at which each sensor stands; one per sensor of the scans.
        order: one of `ORDERS`.
        window: times that are smoothed together, at least 1.
        exchanged: newest times whose association is iterated and sent anew at each step, 1 to ``window``.
        iterations: of EM at each step before the weights that are sent, at least 1. More make a node surer of its own
            choice before it has heard others.
        annealing: factors on R in the first iterations, decreasing to 1.
        homothetic: shares and factors on R of the target density; None: plain.
        gate: D^2 beyond which a detection is no candidate; None: all are. A sensor's own gate comes first.
        adaptive: densities of the E-step know how uncertain the state is; else the plain ones of PMHT, R alone.
        correction: what a node sends is worth less where the assignment is uncertain.

    Raises:
        ValueError: an option out of range, or a node that does not exist.

    Source: CN115508822B S1-S4; Battistelli and others (2015). Differs: information form without division by the
    weights; V2, the times sent anew and the correction are ours.
    """

    motion: Motion
    consensus: Consensus
    node_of: Sequence[int]
    order: str = "V1"
    window: int = 5
    exchanged: int = 1
    iterations: int = 1
    annealing: tuple[float, ...] = ()
    homothetic: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    gate: float | None = 25.0
    correction: bool = True
    adaptive: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "node_of", tuple(int(node) for node in self.node_of))
        if self.order not in ORDERS:
            raise ValueError(
                f"DistributedPmht: order must be one of {', '.join(ORDERS)}; got {self.order!r}. Choose one."
            )
        for name, most in (("window", np.inf), ("exchanged", self.window), ("iterations", np.inf)):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or not 1 <= value <= most:
                raise ValueError(
                    f"DistributedPmht: {name} must be an integer from 1 to {most}; got {value!r}. Give a count."
                )
        if not self.node_of or not all(0 <= node < self.consensus.nodes for node in self.node_of):
            raise ValueError(
                f"DistributedPmht: node_of must name nodes 0..{self.consensus.nodes - 1}, one per sensor; got "
                f"{self.node_of}. Use the sensing nodes of the network, in the order of the sensors."
            )
        if self.gate is not None and not self.gate > 0:
            raise ValueError(f"DistributedPmht: gate must be > 0; got {self.gate!r}. Use 25, or None for none.")
        _ = self.moving

    @classmethod
    def centralised(cls, motion: Motion, sensors: int, **options: Any) -> DistributedPmht:
        """The reference: one node that has the scans of all sensors, or of the only one, and nobody to talk to.

        Args:
            motion: how targets move.
            sensors: number of sensors.
            options: as of the class.
        """
        return cls(motion, Consensus(np.ones((1, 1)), 0), (0,) * sensors, **options)

    @cached_property
    def moving(self) -> Moving:
        """Tables of the motion."""
        return make_moving((self.motion,))

    def start(self, sensors: ScanSensor | Sequence[ScanSensor], known: KnownTracks) -> NetworkState:
        """Begin with targets that all nodes know under the same number.

        Args:
            sensors: those that will scan.
            known: the targets.

        Raises:
            ValueError: sensors without a node, or space dimensions that differ.
        """
        every = (sensors,) if isinstance(sensors, ScanSensor) else tuple(sensors)
        axes = {self.motion.axes, known.mean.shape[1] // 2, *(sensor.model.axes for sensor in every)}
        if len(every) != len(self.node_of) or len(axes) > 1:
            raise ValueError(
                f"DistributedPmht.start: sensors must be one per entry of node_of, {len(self.node_of)}, in the space "
                f"of motion and targets; got {len(every)} and dimensions {sorted(axes)}. Fit them."
            )
        N, n = self.consensus.nodes, self.motion.size
        mean, cov = state_moments(self.motion, known.mean, known.cov)
        M = len(mean)
        path, spread = np.zeros((N, M, 0, n)), np.zeros((N, M, 0, n, n))
        return NetworkState(
            every, known.time, 0, np.arange(1, M + 1), np.zeros(0), (), np.zeros(M, dtype=np.int64),
            path, spread, path, spread, path, spread, np.tile(mean, (N, 1, 1)), np.tile(cov, (N, 1, 1, 1)),
        )  # fmt: skip

    def step(self, state: NetworkState, scans: Sequence[Scan]) -> tuple[NetworkState, NetworkFound]:
        """Take in the scans of one time, of as many nodes as have one.

        Args:
            state: of `start` or the last step.
            scans: of one time, not older than the last.

        Returns:
            the new state and what was found.

        Raises:
            ValueError: scans of several times, or older than the last.
        """
        times = {scan.time for scan in scans}
        if len(times) != 1 or min(times) < state.time:
            raise ValueError(
                f"DistributedPmht.step: scans must be of one time, no older than {state.time:g} s; got "
                f"{sorted(times)}. Group them with frames_of."
            )
        time = times.pop()
        alive = self.consensus.faults.alive(time, self.consensus.nodes)
        kept = tuple(scan for scan in scans if alive[self.node_of[scan.sensor]])
        state, retired = _slid(state) if len(state.times) == self.window else (state, None)
        state = self._extended(state, time, kept)
        run = _Step(self, state)
        run.iterate()
        messages, exchanges = run.messages, run.exchanges
        length = message_bytes(self.motion.size, len(state.ids), self.consensus.rule, self.consensus.nodes)
        state = state._replace(
            filtered=run.filtered, filtered_cov=run.filtered_cov, ahead=run.ahead, ahead_cov=run.ahead_cov,
            means=run.means, covs=run.covs, last=run.filtered[:, :, -1], last_cov=run.filtered_cov[:, :, -1],
            steps=state.steps + 1,
        )  # fmt: skip
        return state, NetworkFound(
            time, state.ids, state.last, state.last_cov, retired, messages, messages * length, exchanges, run.trouble
        )

    def run(self, scans: Scans, known: KnownTracks) -> NetworkTracks:
        """Take in all scans; equal to a loop of `step`.

        Args:
            scans: in time order; those of one time are taken together.
            known: the targets; their time is not after the first scan.

        Returns:
            tracks at every node.
        """
        from jink.estimators.multitarget.results import kinematic_moments

        state = self.start(scans.sensors, known)
        found, smoothed = [], []
        for frame in frames_of(list(scans)):
            state, one = self.step(state, frame)
            found.append(one)
            if one.retired is not None:
                smoothed.append(one.retired)
        smoothed += [(state.means[:, :, k], state.covs[:, :, k]) for k in range(len(state.times))]
        N, M, n, F, A = self.consensus.nodes, len(state.ids), self.motion.size, len(found), self.motion.axes

        def kinematics(means: list[Array], covs: list[Array]) -> tuple[Array, Array]:
            x = np.array(means).reshape(F, N, M, n).transpose(1, 2, 0, 3)
            P = np.array(covs).reshape(F, N, M, n, n).transpose(1, 2, 0, 3, 4)
            kin, spread = kinematic_moments(
                self.moving, np.ascontiguousarray(x.reshape(-1, n)), np.ascontiguousarray(P.reshape(-1, n, n))
            )
            return kin.reshape(N, M, F, 2 * A), spread.reshape(N, M, F, 2 * A, 2 * A)

        kin, cov = kinematics([one.mean for one in found], [one.cov for one in found])
        late, _ = kinematics([one[0] for one in smoothed], [one[1] for one in smoothed])
        return NetworkTracks(
            np.array([one.time for one in found]), state.ids, kin[..., :A], kin[..., A:], cov, late[..., :A],
            late[..., A:], np.array([one.messages for one in found], dtype=np.int64),
            np.array([one.sent_bytes for one in found], dtype=np.int64), sum(one.trouble for one in found),
        )  # fmt: skip

    def _extended(self, state: NetworkState, time: float, scans: tuple[Scan, ...]) -> NetworkState:
        """The window with one more time, which every node predicts every target to."""
        N, M, n = state.last.shape
        x, P = predict_targets(
            self.moving, time - state.time, state.last.reshape(-1, n), state.last_cov.reshape(-1, n, n)
        )
        x, P = x.reshape(N, M, 1, n), P.reshape(N, M, 1, n, n)
        grown = {
            name: np.concatenate([getattr(state, name), part], axis=2)
            for name, part in (
                ("ahead", x), ("ahead_cov", P), ("filtered", x), ("filtered_cov", P), ("means", x), ("covs", P),
            )
        }  # fmt: skip
        return state._replace(time=time, times=np.append(state.times, time), frames=(*state.frames, scans), **grown)


class _Step:
    """The iterations of one time; arrays of the state are copied and overwritten."""

    def __init__(self, tracker: DistributedPmht, state: NetworkState) -> None:
        self.tracker, self.state = tracker, state
        self.ahead, self.ahead_cov = state.ahead.copy(), state.ahead_cov.copy()
        self.filtered, self.filtered_cov = state.filtered.copy(), state.filtered_cov.copy()
        self.means, self.covs = state.means.copy(), state.covs.copy()
        self.messages = self.exchanges = self.trouble = 0
        self.first = max(len(state.times) - tracker.exchanged, 0)
        self.begin = np.maximum(state.begin - self.first, 0)
        self.times = state.times[self.first :]
        self.sensing = make_sensing(state.sensors)
        N, M = self.means.shape[:2]
        self.scans = {node: self._scans_of(node) for node in range(N) if node in tracker.node_of}
        T, n = len(self.times), self.means.shape[3]
        self.dq, self.dOmega, self.hits = np.zeros((N, M, T, n)), np.zeros((N, M, T, n, n)), np.zeros((N, M, T))
        self.gate_covs = np.ascontiguousarray(self.covs[:, :, self.first :])

    def iterate(self) -> None:
        tracker = self.tracker
        if tracker.order == "V1":
            for node in self.scans:
                self._iterate_alone(node)
            self._fuse(0)
        else:
            for turn in range(tracker.iterations):
                for node in self.scans:
                    path = np.ascontiguousarray(self.means[node, :, self.first :])
                    covs = np.ascontiguousarray(self.covs[node, :, self.first :])
                    self._weigh(node, path, covs, turn, tracker.correction and turn == tracker.iterations - 1)
                self._fuse(turn)
        for node in range(len(self.means)):
            self._smooth(node, 0)

    def _scans_of(self, node: int) -> NodeScans:
        tracker, M = self.tracker, self.means.shape[1]
        path = self.means[node, :, self.first :]
        T, n = path.shape[1:]
        places = positions_of(tracker.moving, np.ascontiguousarray(path.reshape(M * T, n))).reshape(M, T, -1)
        frames = self.state.frames[self.first :]
        return node_scans(frames, self.state.sensors, tracker.node_of, node, places, tracker.gate)  # type: ignore[arg-type]

    def _weigh(self, node: int, path: Array, covs: Array, turn: int, corrected: bool) -> None:
        tracker, steps = self.tracker, self.tracker.annealing
        shares, scales = ((1.0,), (1.0,)) if tracker.homothetic is None else tracker.homothetic
        own = self.scans[node]
        local_information(
            tracker.moving, self.sensing, own.sensor, own.places, own.noise, own.detections, own.offsets, own.slot,
            self.begin, path, covs, self.gate_covs[node], own.gates, own.detected, own.density, own.volume,
            steps[turn] if turn < min(len(steps), tracker.iterations - 1) else 1.0, np.log(shares), np.array(scales),
            tracker.adaptive, corrected, self.dq[node], self.dOmega[node], self.hits[node],
        )  # fmt: skip

    def _iterate_alone(self, node: int) -> None:
        """EM of a node over its own scans, from its own fused prediction; the final centroids stay in dq, dOmega."""
        tracker, first = self.tracker, self.first
        path = np.ascontiguousarray(self.means[node, :, first:])
        starts = np.arange(path.shape[0]), np.minimum(self.begin, path.shape[1] - 1)
        prior = (
            np.ascontiguousarray(self.ahead[node, :, first:][starts]),
            np.ascontiguousarray(self.ahead_cov[node, :, first:][starts]),
        )
        covs = self.gate_covs[node].copy()
        work = [np.zeros_like(path), np.zeros_like(covs), np.zeros_like(path), np.zeros_like(covs)]
        for turn in range(tracker.iterations):
            self._weigh(node, path, covs, turn, False)
            self.trouble += filter_information(
                tracker.moving, self.times, *prior, self.begin, self.dq[node], self.dOmega[node], *work
            )
            smooth_back(tracker.moving, self.times, self.begin, *work, path, covs)
        self._weigh(node, path, covs, tracker.iterations, tracker.correction)

    def _fuse(self, turn: int) -> None:
        """Forward through the exchanged times with consensus at each, then smooth every node."""
        tracker, n = self.tracker, self.means.shape[3]
        consensus, N = tracker.consensus, len(self.means)
        T, base = len(self.times), self.first
        for k in range(T):
            now = np.flatnonzero(self.begin <= k)
            if k:
                old = np.flatnonzero(self.begin < k)
                x, P = predict_targets(
                    tracker.moving, self.times[k] - self.times[k - 1],
                    np.ascontiguousarray(self.filtered[:, old, base + k - 1].reshape(-1, n)),
                    np.ascontiguousarray(self.filtered_cov[:, old, base + k - 1].reshape(-1, n, n)),
                )  # fmt: skip
                self.ahead[:, old, base + k] = x.reshape(N, len(old), n)
                self.ahead_cov[:, old, base + k] = P.reshape(N, len(old), n, n)
            number = (self.state.steps * tracker.iterations + turn) * tracker.window + k
            exchange = consensus.exchange(self.state.time, number)
            self.messages += exchange.messages
            self.exchanges += 1
            x, P = self.ahead[:, now, base + k], self.ahead_cov[:, now, base + k]
            fused = consensus_update(
                from_moments(x, P),
                Information(self.dq[:, now, k], self.dOmega[:, now, k]),
                self.hits[:, now, k] > LEAST_HITS,
                exchange,
                consensus.rule,
            )
            mean, cov = to_moments(fused)
            bad = np.isnan(mean).any(axis=-1)
            self.trouble += int(bad.sum())
            self.filtered[:, now, base + k] = np.where(bad[..., None], x, mean)
            self.filtered_cov[:, now, base + k] = np.where(bad[..., None, None], P, cov)
        if tracker.order == "V2":
            for node in self.scans:
                self._smooth(node, base)

    def _smooth(self, node: int, first: int) -> None:
        """Smoothed path of a node from index ``first`` of the window on."""
        parts = [
            np.ascontiguousarray(part[node, :, first:])
            for part in (self.ahead, self.ahead_cov, self.filtered, self.filtered_cov, self.means, self.covs)
        ]
        begin = np.maximum(self.state.begin - first, 0)
        smooth_back(self.tracker.moving, self.state.times[first:], begin, *parts)
        self.means[node, :, first:], self.covs[node, :, first:] = parts[4], parts[5]


def _slid(state: NetworkState) -> tuple[NetworkState, tuple[Array, Array]]:
    """The window without its first time, and the smoothed moments of that time."""
    names = ("ahead", "ahead_cov", "filtered", "filtered_cov", "means", "covs")
    cut = {name: np.ascontiguousarray(getattr(state, name)[:, :, 1:]) for name in names}
    gone = state.means[:, :, 0], state.covs[:, :, 0]
    return (
        state._replace(times=state.times[1:], frames=state.frames[1:], begin=np.maximum(state.begin - 1, 0), **cut),
        gone,
    )
