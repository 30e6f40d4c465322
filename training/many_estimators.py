"""Trackers of many targets by name, from the same scales as the recipes for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from jink.envs.reading.graph_file import NetworkPlan
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.motions import constant_velocity, known_turn
from jink.estimators.multitarget.distributed import DistributedPmht
from jink.estimators.multitarget.gnn import Gnn
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.jpda import Jpda
from jink.estimators.multitarget.open_network import OpenNetwork
from jink.estimators.multitarget.pmht import Pmht

__all__ = ["MANY", "NETWORKED", "ManyScales", "ManyTracker"]

ManyTracker = Pmht | Gnn | Jpda | OpenNetwork
WOBBLE = 0.05
"""A straight leg of a bank wobbles with this share of the target's acceleration, as in the recipes for one target."""


@dataclass(frozen=True)
class ManyScales:
    """What a tracker is told of the targets.

    Args:
        axes: space dimensions.
        acceleration: typical, m/s^2.
        speed: typical along an axis, m/s.
        turn_rate: of the turns of a bank, rad/s, both ways; several: a pair of turns for each; None: no bank.
        sojourn: mean time between changes of a bank's mode, s.
        window: scans that PMHT explains together.
        gate: standard deviations beyond which a detection is no candidate.
        patience: a track ends after this long without a detection, s; in a network a node's own track.
        plan: network and the node of each sensor, in their order.
    """

    axes: int
    acceleration: float
    speed: float
    turn_rate: float | tuple[float, ...] | None = None
    sojourn: float = 10.0
    window: int = 10
    gate: float = 5.0
    patience: float = 20.0
    plan: tuple[NetworkPlan, tuple[int, ...]] | None = None

    @property
    def motion(self) -> Motion:
        """White acceleration strong enough for the manoeuvres."""
        return constant_velocity(self.axes, acceleration_density=self.acceleration**2)

    @property
    def motions(self) -> tuple[tuple[Motion, ...], MarkovChain | None]:
        """Straight flight and turns to both sides with their chain; without a turn rate the one motion."""
        if self.turn_rate is None:
            return (self.motion,), None
        rates = (self.turn_rate,) if isinstance(self.turn_rate, int | float) else self.turn_rate
        every = (0.0, *(sign * rate for rate in rates for sign in (1.0, -1.0)))
        quiet = max(WOBBLE * self.acceleration, 1e-9) ** 2
        bank = tuple(known_turn(rate, acceleration_density=quiet) for rate in every)
        return bank, MarkovChain.from_sojourns([self.sojourn] * len(bank))

    @property
    def dismissal(self) -> float:
        """A network dismisses a target after this long without a node's own track near it, s."""
        return self.patience / 4

    @property
    def initiation(self) -> Initiation:
        """How tracks begin and end."""
        return Initiation(speed=self.speed, patience=self.patience)


def pmht(scales: ManyScales) -> Pmht:
    """Probabilistic multi-hypothesis tracker: a window of scans explained together by EM; a bank with a turn rate."""
    options = {"window": scales.window, "gate": scales.gate**2, "initiation": scales.initiation}
    return Pmht(*scales.motions, **options)  # type: ignore[arg-type]


def gnn(scales: ManyScales) -> Gnn:
    """Global nearest neighbour: each track takes the detection of the best joint assignment."""
    return Gnn(*scales.motions, gate=scales.gate**2, initiation=scales.initiation)


def jpda(scales: ManyScales) -> Jpda:
    """Joint probabilistic data association: each track takes every detection by its probability."""
    return Jpda(*scales.motions, gate=scales.gate**2, initiation=scales.initiation)


def distributed_pmht(scales: ManyScales) -> OpenNetwork:
    """PMHT at the nodes of a network that exchange information with their neighbours."""
    assert scales.plan is not None  # checked by the caller, which knows the option's name
    plan, node_of = scales.plan
    motions, chain = scales.motions
    network = DistributedPmht(
        motions, plan.consensus(), node_of, window=scales.window, gate=scales.gate**2, chain=chain
    )
    return OpenNetwork(network, scales.initiation, patience=scales.dismissal)


MANY: dict[str, Callable[[ManyScales], ManyTracker]] = {
    "pmht": pmht,
    "gnn": gnn,
    "jpda": jpda,
    "distributed-pmht": distributed_pmht,
}
"""Trackers by the names of the command line."""
NETWORKED = ("distributed-pmht",)
"""Those that need a network."""
