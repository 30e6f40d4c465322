"""`DistributedPmht`: nodes with sensors of their own follow the same targets and talk to their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.checks import check_choice, check_count, check_kind, check_number
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.multitarget.consensus import Consensus, message_bytes
from jink.estimators.multitarget.network_bank import ModeStates, foreseen, merged
from jink.estimators.multitarget.network_bank_step import BankStep
from jink.estimators.multitarget.network_results import NetworkFound, NetworkTracks, gather_network
from jink.estimators.multitarget.network_state import NetworkState, Paths, frames_of
from jink.estimators.multitarget.network_step import NetworkStep
from jink.estimators.multitarget.node_kernels import predict_targets
from jink.estimators.multitarget.pmht import KnownTracks, check_annealing, check_homothetic, check_motions
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scan, Scans, check_scan, check_sensors
from jink.estimators.multitarget.tables import Moving, make_moving
from jink.estimators.multitarget.tracked import state_moments

__all__ = ["ORDERS", "DistributedPmht"]

Array = NDArray[np.float64]
ORDERS = ("V1", "V2")


@dataclass(frozen=True, eq=False)
class DistributedPmht:
    """PMHT at every node of a network, joined by consensus on information.

    Model: each node weighs the detections of its own sensors with the states it believes, and makes of the centroids
    information about each target; consensus with neighbours adds up what all nodes found. "V1", the patent's order:
    a node iterates by itself, then all fuse once. "V2": nodes fuse in every iteration, so that each weighs its
    detections with what all know; ``iterations`` times the messages.

    Args:
        motion: how targets move; several linear ones with the same state: the modes of a bank at every node, each with
            a prior of its own that nodes average, and one novelty.
        consensus: weights, rounds, rule of the novelty, faults.
        node_of: node at which each sensor stands; one per sensor of the scans.
        order: one of `ORDERS`.
        window: times that are smoothed together, at least 1.
        exchanged: newest times whose association is iterated and sent anew at each step, 1 to ``window``. More costs as
            many times the bytes and loses targets in clutter; see the results.
        iterations: of EM at each step before the weights that are sent, at least 1. More make a node surer of its own
            choice before it has heard others.
        annealing: factors on R in the first iterations, decreasing to 1; with ``adaptive=False``, several iterations.
        homothetic: shares and factors on R of the target density; None: plain; with ``adaptive=False``.
        gate: D^2 beyond which a detection is no candidate; None: all are. A sensor's own gate comes first.
        adaptive: densities of the E-step know how uncertain the state is; else the plain ones of PMHT, R alone.
        correction: what a node sends is worth less where the assignment is uncertain.
        chain: Markov chain of the modes; None: each lasts 10 s on average.

    Raises:
        ValueError: an option out of range or without effect, or a node that does not exist.

    Source: CN115508822B S1-S4; Battistelli and others (2015). Differs: information form without division by the
    weights; V2, the times sent anew and the correction are ours.
    """

    motion: Motion | Sequence[Motion]
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
    chain: MarkovChain | None = None

    def __post_init__(self) -> None:
        me = "DistributedPmht"
        object.__setattr__(self, "motion", check_motions(me, self.motion, self.chain))
        check_kind(me, "consensus", self.consensus, Consensus, "a Consensus", "Use Consensus(metropolis_weights(...)).")
        check_choice(me, "order", self.order, ORDERS)
        for name, most in (("window", np.inf), ("exchanged", self.window), ("iterations", np.inf)):
            check_count(me, name, getattr(self, name), 1, most, remedy="Give a count.")
        object.__setattr__(self, "node_of", self._checked_nodes())
        if self.gate is not None:
            check_number(me, "gate", self.gate, 0.0, infinite=True, remedy="Use 25, or None for none.")
        check_annealing(me, self.annealing)
        check_homothetic(me, self.homothetic)
        self._check_effect()
        J = len(self.moving.linear)
        if J > 1 and self.exchanged > 1:
            raise ValueError(
                f"DistributedPmht: exchanged must be 1 with a bank, whose earlier modes are not kept; got "
                f"{self.exchanged}. Leave it out."
            )

    def _checked_nodes(self) -> tuple[int, ...]:
        last = self.consensus.nodes - 1
        good = isinstance(self.node_of, Sequence | np.ndarray) and len(self.node_of) > 0
        if not good or not all(isinstance(node, int | np.integer) and 0 <= node <= last for node in self.node_of):
            raise ValueError(
                f"DistributedPmht: node_of must name nodes 0..{last}, one per sensor; got {self.node_of}. Use the "
                "sensing nodes of the network, in the order of the sensors."
            )
        return tuple(int(node) for node in self.node_of)

    def _check_effect(self) -> None:
        """Refuse what would do nothing."""
        for name, given in (("annealing", len(self.annealing) > 0), ("homothetic", self.homothetic is not None)):
            if given and self.adaptive:
                raise ValueError(
                    f"DistributedPmht: {name} must be left out with adaptive densities, which do not use it; got "
                    f"{getattr(self, name)!r}. Give adaptive=False as well."
                )
        if len(self.annealing) and self.iterations == 1:
            raise ValueError(
                f"DistributedPmht: annealing must come with iterations > 1, as the last has none; got "
                f"{self.annealing!r} and 1. Give more iterations."
            )

    @classmethod
    def centralised(cls, motion: Motion | Sequence[Motion], sensors: int, **options: Any) -> DistributedPmht:
        """The reference: one node that has the scans of all sensors, or of the only one, and nobody to talk to.

        Args:
            motion: how targets move.
            sensors: number of sensors.
            options: as of the class.
        """
        return cls(motion, Consensus(np.ones((1, 1)), 0), (0,) * sensors, **options)

    @cached_property
    def moving(self) -> Moving:
        """Tables of the motions."""
        return make_moving(self.motions)

    @property
    def motions(self) -> tuple[Motion, ...]:
        """The modes."""
        return tuple(self.motion)  # type: ignore[arg-type]

    @cached_property
    def markov(self) -> MarkovChain:
        """Chain of the modes."""
        count = len(self.motions)
        if self.chain is not None:
            return self.chain
        return MarkovChain.from_sojourns([10.0] * count) if count > 1 else MarkovChain.per_step([[1.0]])

    def start(self, sensors: ScanSensor | Sequence[ScanSensor], known: KnownTracks) -> NetworkState:
        """Begin with targets that all nodes know under the same number.

        Args:
            sensors: those that will scan.
            known: the targets.

        Raises:
            ValueError: sensors without a node, or space dimensions that differ.
        """
        me = "DistributedPmht.start"
        every = check_sensors(me, sensors)
        check_kind(me, "known", known, KnownTracks, "KnownTracks", "Give their mean, cov and time.")
        axes = {self.motions[0].axes, known.mean.shape[1] // 2, *(sensor.model.axes for sensor in every)}
        if len(every) != len(self.node_of) or len(axes) > 1:
            raise ValueError(
                f"{me}: sensors must be one per entry of node_of, {len(self.node_of)}, in the space "
                f"of motion and targets; got {len(every)} and dimensions {sorted(axes)}. Fit them."
            )
        N, n = self.consensus.nodes, self.motions[0].size
        mean, cov = state_moments(self.motions[0], known.mean, known.cov)
        M = len(mean)
        return NetworkState(
            every, known.time, 0, M + 1, np.arange(1, M + 1), np.zeros(0), (), np.zeros(M, dtype=np.int64),
            Paths.empty(N, M, n), np.tile(mean, (N, 1, 1)), np.tile(cov, (N, 1, 1, 1)), self._fresh(mean, cov),
        )  # fmt: skip

    def _fresh(self, mean: Array, cov: Array) -> ModeStates | None:
        """New targets by mode, at every node; None: there is one mode."""
        if len(self.motions) == 1:
            return None
        N = self.consensus.nodes
        return ModeStates.alike(np.tile(mean, (N, 1, 1)), np.tile(cov, (N, 1, 1, 1)), self.markov.stationary())

    def admit(self, state: NetworkState, known: KnownTracks) -> NetworkState:
        """New targets that all nodes are told of under the same numbers; they begin at the next scans.

        Args:
            state: of `start` or the last step.
            known: the targets; their time is that of the state.

        Raises:
            ValueError: another time or space dimension.
        """
        me = "DistributedPmht.admit"
        check_kind(me, "known", known, KnownTracks, "KnownTracks", "Give their mean, cov and time.")
        if known.time != state.time or known.mean.shape[1] != 2 * self.motions[0].axes:
            raise ValueError(
                f"{me}: known must be of {state.time:g} s and {self.motions[0].axes} dimensions; got "
                f"{known.time:g} s and shape {known.mean.shape}. Predict them to the last scan."
            )
        return self._admitted(state, known.mean, known.cov)

    def _admitted(self, state: NetworkState, mean: Array, cov: Array) -> NetworkState:
        """`admit` of position and velocity as a tracker has them, which rounding may have spoilt."""
        mean, cov = state_moments(self.motions[0], mean, cov)
        N, more = self.consensus.nodes, len(mean)
        fresh = self._fresh(mean, cov)
        return state._replace(
            modes=None if state.modes is None or fresh is None else state.modes.joined(fresh),
            ids=np.append(state.ids, state.next_id + np.arange(more)),
            next_id=state.next_id + more,
            begin=np.append(state.begin, np.full(more, len(state.times))),
            last=np.concatenate([state.last, np.tile(mean, (N, 1, 1))], axis=1),
            last_cov=np.concatenate([state.last_cov, np.tile(cov, (N, 1, 1, 1))], axis=1),
            paths=state.paths.with_targets(more),
        )

    def dismiss(self, state: NetworkState, ids: ArrayLike) -> NetworkState:
        """Targets that all nodes are told to forget, by id; ids that are not there are ignored."""
        stays = ~np.isin(state.ids, np.asarray(ids))
        return state._replace(
            ids=state.ids[stays],
            begin=state.begin[stays],
            paths=state.paths.of_targets(stays),
            modes=None if state.modes is None else state.modes.of_targets(stays),
            last=np.ascontiguousarray(state.last[:, stays]),
            last_cov=np.ascontiguousarray(state.last_cov[:, stays]),
        )

    def step(self, state: NetworkState, scans: Sequence[Scan]) -> tuple[NetworkState, NetworkFound]:
        """Take in the scans of one time, of as many nodes as have one.

        Args:
            state: of `start` or the last step.
            scans: of one time, not older than the last.

        Returns:
            the new state and what was found.

        Raises:
            ValueError: scans of several times, older than the last, of an unknown sensor, or not what it measures.
        """
        remedy = "Group scans of one time with frames_of."
        check_kind("DistributedPmht.step", "scans", scans, Sequence, "a sequence of scans", remedy)
        for scan in scans:
            check_scan("DistributedPmht.step", scan, state.sensors, state.time)
        return self._taken(state, scans)

    def _taken(self, state: NetworkState, scans: Sequence[Scan]) -> tuple[NetworkState, NetworkFound]:
        """`step` with scans that have been checked."""
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
        run = NetworkStep(self, state) if state.modes is None else BankStep(self, state)
        run.iterate()
        consensus, modes = self.consensus, len(self.motions)
        length = message_bytes(self.motions[0].size, len(state.ids), consensus.rule, consensus.nodes, modes)
        state = state._replace(
            paths=run.paths,
            last=np.ascontiguousarray(run.paths.filtered[:, :, -1]),
            last_cov=np.ascontiguousarray(run.paths.filtered_cov[:, :, -1]),
            steps=state.steps + 1,
            modes=run.modes,
        )
        return state, NetworkFound(
            time, state.ids, state.last, state.last_cov, retired, run.messages, run.messages * length, run.exchanges,
            run.trouble, run.hits[:, :, -1].sum(axis=0),
        )  # fmt: skip

    def run(self, scans: Scans, known: KnownTracks) -> NetworkTracks:
        """Take in all scans; equal to a loop of `step`.

        Args:
            scans: in time order; those of one time are taken together.
            known: the targets; their time is not after the first scan.

        Returns:
            tracks at every node.
        """
        me = "DistributedPmht.run"
        check_kind(me, "scans", scans, Scans, "Scans", "Make them with Scans.from_arrays or Scans.from_frame.")
        state, found = self.start(scans.sensors, known), []
        for frame in frames_of(list(scans)):
            state, one = self._taken(state, frame)
            found.append(one)
        return gather_network(self.moving, found, state)

    def _extended(self, state: NetworkState, time: float, scans: tuple[Scan, ...]) -> NetworkState:
        """The window with one more time, which every node predicts every target to."""
        N, M, n = state.last.shape
        modes, dt = state.modes, time - state.time
        if modes is not None:
            modes, cross = foreseen(self.moving, self.markov.at(dt) if dt > 0 else np.eye(len(self.motions)), dt, modes)
            paths = state.paths.later(*merged(modes), cross)
            return state._replace(
                time=time, times=np.append(state.times, time), frames=(*state.frames, scans), paths=paths, modes=modes
            )
        x, P = predict_targets(
            self.moving, time - state.time, state.last.reshape(-1, n), state.last_cov.reshape(-1, n, n)
        )
        paths = state.paths.later(x.reshape(N, M, n), P.reshape(N, M, n, n))
        return state._replace(time=time, times=np.append(state.times, time), frames=(*state.frames, scans), paths=paths)


def _slid(state: NetworkState) -> tuple[NetworkState, tuple[Array, Array]]:
    """The window without its first time, and the smoothed moments of that time."""
    gone = state.paths.means[:, :, 0], state.paths.covs[:, :, 0]
    later = state._replace(
        times=state.times[1:],
        frames=state.frames[1:],
        begin=np.maximum(state.begin - 1, 0),
        paths=state.paths.without_first(),
    )
    return later, gone
