"""Targets that change their mind: `Manoeuvres`, a semi-Markov chain of intents within physical limits."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.flight.flying import START_DRAWS, VISIT_DRAWS, fly
from jink.envs.flight.intent_rules import GRAVITY, Intent
from jink.envs.flight.limits import Limits, Start
from jink.envs.streams import Draws, Need
from jink.envs.truth import Truth

__all__ = ["Manoeuvres"]

Array = NDArray[np.float64]
_MOST_ROUNDS = 100_000


class _Tables(NamedTuple):
    """A motion as the compiled pass reads it."""

    start: Array
    limits: Array
    addresses: NDArray[np.int64]
    params: Array
    counts: NDArray[np.int64]
    dwells: Array
    first: Array
    chain: Array


@dataclass(frozen=True, kw_only=True)
class Manoeuvres:
    """A `Motion`: intents that follow one another as a semi-Markov chain.

    Model: on entering intent i its dwell is drawn from ``behaviours[i].dwell``; then intent j follows with probability
    ``transition[i][j]`` (the embedded chain). A trajectory is a function of continuous time, in closed form: what it is
    at one time does not depend on the other times asked for. At a switch time the new intent holds.

    Args:
        axes: 2 or 3.
        behaviours: the intents; names differ.
        transition: row = from, column = to, rows sum to 1; None: uniform over the others. A behaviour that follows
            itself starts afresh without a switch.
        initial: probabilities of the first intent; None: uniform.
        limits: never exceeded.
        start: of an episode.
    Raises:
        ValueError: a value outside its range, or intents that need three axes in two.
    """

    behaviours: tuple[Intent, ...]
    axes: int = 2
    transition: tuple[tuple[float, ...], ...] | None = None
    initial: tuple[float, ...] | None = None
    limits: Limits = field(default_factory=Limits)
    start: Start = field(default_factory=Start)

    def __post_init__(self) -> None:
        if self.axes not in (2, 3):
            raise ValueError(f"Manoeuvres: axes must be 2 or 3; got {self.axes!r}. Count the space dimensions.")
        object.__setattr__(self, "behaviours", tuple(self.behaviours))
        if not self.behaviours or not all(isinstance(each, Intent) for each in self.behaviours):
            raise ValueError(
                f"Manoeuvres: behaviours must be one or more Intents; got {self.behaviours!r}. "
                "Try (Straight(), Turn())."
            )
        if len(set(self.intents)) != len(self.intents) or len(self.intents) > 127:
            raise ValueError(
                f"Manoeuvres: behaviours must have different names, at most 127; got {', '.join(self.intents)}. "
                "Pass name= to tell two of a kind apart."
            )
        flat = [each.name for each in self.behaviours if each.in_space]
        if self.axes == 2 and flat:
            raise ValueError(
                f"Manoeuvres: axes must be 3 for {', '.join(flat)}; got 2. Leave them out, or pass axes=3."
            )
        count = len(self.behaviours)
        if self.transition is not None:
            object.__setattr__(self, "transition", _probabilities("transition", self.transition, (count, count)))
        if self.initial is not None:
            object.__setattr__(self, "initial", _probabilities("initial", self.initial, (count,)))
        low, high = self.limits.speed
        if not low <= self.start.speed[0] <= self.start.speed[1] <= high:
            raise ValueError(
                f"Manoeuvres: start.speed must be within limits.speed {self.limits.speed}; got {self.start.speed}. "
                "Change one of them."
            )
        low, high = self.limits.altitude
        if self.axes == 3 and not low <= self.start.z[0] <= self.start.z[1] <= high:
            raise ValueError(
                f"Manoeuvres: start.z must be within limits.altitude {self.limits.altitude}; got {self.start.z}. "
                "Change one of them."
            )

    @property
    def intents(self) -> tuple[str, ...]:
        """Names of the behaviours, in order."""
        return tuple(each.name for each in self.behaviours)

    def extent(self, duration: float) -> float:
        """Every position of an episode of ``duration`` seconds lies within this of the origin along each axis, m."""
        spans = (self.start.x, self.start.y, self.start.z)[: self.axes]
        return max(abs(value) for pair in spans for value in pair) + self.limits.speed[1] * duration

    def need(self, steps: int, duration: float) -> Need:
        """Draws of one episode; enough for the shortest dwells throughout.

        Raises:
            ValueError: a duration that is negative, or so long that it could hold a hundred thousand intents.
        """
        shortest = min(each.shortest_round for each in self.behaviours)
        if not 0.0 <= duration <= _MOST_ROUNDS * shortest:
            raise ValueError(
                f"Manoeuvres.need: duration must be within 0 and {_MOST_ROUNDS * shortest:g} s, for intents or turns "
                f"as short as {shortest:g} s; got {duration!r}. Raise the shortest dwell or shorten the episode."
            )
        return Need(uniforms=START_DRAWS + (int(duration / shortest) + 2) * self._block)

    def simulate(self, times: Array, draws: Draws) -> Truth:
        """Trajectories at ``times`` (B, T), seconds from the start, non-decreasing; row b uses row b of the draws.

        Raises:
            ValueError: times that are negative, decrease or are not finite, or fewer draws than `need` says.
            RuntimeError: an intent of one's own whose plan leaves its time unfilled.
        """
        times = np.ascontiguousarray(times, dtype=np.float64)
        uniforms = np.ascontiguousarray(draws.uniforms, dtype=np.float64)
        check_times("Manoeuvres.simulate", times)
        B, T = times.shape
        enough = self.need(T, float(times.max(initial=0.0))).uniforms
        if uniforms.shape[0] != B or uniforms.shape[1] < enough:
            raise ValueError(
                f"Manoeuvres.simulate: draws must have {B} rows of {enough} uniforms or more; got {uniforms.shape}. "
                "Draw what need(steps, duration) says, with the duration of the latest time."
            )
        shape = (B, T, self.axes)
        truth = Truth(
            position=np.empty(shape),
            velocity=np.empty(shape),
            acceleration=np.empty(shape),
            intent=np.empty((B, T), dtype=np.int8),
            switch_times=np.full((B, (uniforms.shape[1] - START_DRAWS) // self._block), np.nan),
        )
        unfilled = fly(times, uniforms, self._block, *self._tables, *truth)
        if unfilled >= 0:
            raise RuntimeError(
                f"Manoeuvres.simulate: the plan of {self.intents[unfilled]} must fill its time in rounds of "
                f"{self.behaviours[unfilled].shortest_round:g} s or more; it did not. Wish for now[LEFT] seconds."
            )
        return truth

    @property
    def _block(self) -> int:
        """Uniforms of one round."""
        return VISIT_DRAWS + max(each.uniforms for each in self.behaviours)

    @functools.cached_property
    def _tables(self) -> _Tables:
        count = len(self.behaviours)
        rows = [each.row() for each in self.behaviours]
        params = np.zeros((count, max(1, *(len(row) for row in rows))))
        for row, values in zip(params, rows, strict=True):
            row[: len(values)] = values
        chain = np.ones((count, count)) if self.transition is None else np.array(self.transition)
        if self.transition is None and count > 1:
            np.fill_diagonal(chain, 0.0)
        first = np.ones((1, count)) if self.initial is None else np.array([self.initial])
        limits, start = self.limits, self.start
        return _Tables(
            start=np.array([start.speed, start.heading, start.x, start.y, start.z]),
            limits=np.array([*limits.speed, limits.lateral * GRAVITY, limits.climb, *limits.altitude]),
            addresses=np.array([each.plan.address for each in self.behaviours], dtype=np.int64),
            params=params,
            counts=np.array([each.uniforms for each in self.behaviours], dtype=np.int64),
            dwells=np.array([each.dwell.row() for each in self.behaviours]),
            first=np.cumsum(first / first.sum(), axis=1),
            chain=np.cumsum(chain / chain.sum(1, keepdims=True), axis=1),
        )

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: compiled addresses hold in one process only."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}


def check_times(caller: str, times: Array) -> None:
    """Refuse sample times that are not (B, T), finite, non-negative and non-decreasing.

    Raises:
        ValueError: as said.
    """
    if times.ndim != 2 or not np.isfinite(times).all() or (times < 0).any() or (np.diff(times, axis=1) < 0).any():
        raise ValueError(
            f"{caller}: times must be (B, T) seconds from the start, finite, >= 0, non-decreasing; got shape "
            f"{times.shape}. Sort each row."
        )


def _probabilities(name: str, given: Sequence[Any], shape: tuple[int, ...]) -> tuple[Any, ...]:
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != shape or not (array >= 0).all() or (np.abs(array.sum(-1) - 1.0) > 1e-9).any():
        raise ValueError(
            f"Manoeuvres: {name} must have shape {shape}, entries >= 0 and rows that sum to 1; got {given!r}. "
            "Row = from, column = to."
        )
    values = array.tolist()
    return tuple(tuple(row) for row in values) if len(shape) == 2 else tuple(values)
