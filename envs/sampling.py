"""When a target is looked at: regular, jittered or irregular times.

Gaps are whole multiples of `TICK`, so sums and differences of times are exact in float64 for a day and a half: a
regular sampling has one dt, bit for bit, and ``t[k] - t[k-1]`` gives the gap that was drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from jink.envs.noise.spans import check_between, check_positive
from jink.envs.sensing_laws import poisson_gaps
from jink.envs.streams import Draws, Need

__all__ = ["SAMPLINGS", "TICK", "Irregular", "Jittered", "Regular", "Sampling", "make_sampling"]

Array = NDArray[np.float64]
TICK = 2.0**-36
"""Resolution of times, 15 ps."""


class Sampling(Protocol):
    """A frozen, validated dataclass that turns draws into times."""

    @property
    def steps(self) -> int:
        """Samples T of an episode."""
        ...

    @property
    def duration(self) -> float:
        """No episode lasts longer; s."""
        ...

    def need(self) -> Need:
        """Draws of one episode."""
        ...

    def times(self, draws: Draws) -> Array:
        """Times (B, T) in seconds, strictly increasing from 0."""
        ...


def _check(caller: str, steps: int, dt: float) -> None:
    if not isinstance(steps, int | np.integer) or isinstance(steps, bool) or steps < 2:
        raise ValueError(f"{caller}: steps must be an integer >= 2; got {steps!r}. Give the samples of an episode.")
    check_positive(caller, "dt", dt, "s")
    check_between(caller, "dt", dt, 1e3 * TICK, unit="s")


def _sum(gaps: Array) -> Array:
    """Times (B, T) from gaps (B, T - 1), each at least one tick."""
    times = np.zeros((gaps.shape[0], gaps.shape[1] + 1))
    np.cumsum(np.maximum(np.rint(gaps / TICK), 1.0) * TICK, axis=1, out=times[:, 1:])
    return times


@dataclass(frozen=True)
class Regular:
    """One sample every ``dt`` seconds.

    Args:
        steps: samples of an episode, >= 2.
        dt: gap; s.

    Raises:
        ValueError: a value out of range.
    """

    steps: int = 200
    dt: float = 0.1

    def __post_init__(self) -> None:
        _check("Regular", self.steps, self.dt)

    @property
    def duration(self) -> float:
        """Length of an episode; s."""
        return (self.steps - 1) * (self.dt + TICK)

    def need(self) -> Need:
        """No draws."""
        return Need()

    def times(self, draws: Draws) -> Array:
        """Times (B, T) in seconds from 0."""
        return np.tile(_sum(np.full((1, self.steps - 1), self.dt)), (len(draws.uniforms), 1))


@dataclass(frozen=True)
class Jittered:
    """A regular clock whose ticks come early or late, each by itself (a busy bus, a scanning antenna).

    Model: ``t_k = k dt + jitter u_k``, u uniform in (-1, 1), then moved so that t_0 = 0.

    Args:
        steps: samples of an episode, >= 2.
        dt: mean gap; s.
        jitter: largest displacement; s; at most 0.45 dt, so that order is kept.

    Raises:
        ValueError: a value out of range.
    """

    steps: int = 200
    dt: float = 0.1
    jitter: float = 0.02

    def __post_init__(self) -> None:
        _check("Jittered", self.steps, self.dt)
        check_between("Jittered", "jitter", self.jitter, 0.0, 0.45 * self.dt, "s, at most 0.45 dt")

    @property
    def duration(self) -> float:
        """No episode lasts longer; s."""
        return (self.steps - 1) * (self.dt + TICK) + 2.0 * self.jitter

    def need(self) -> Need:
        """One draw per sample."""
        return Need(uniforms=self.steps)

    def times(self, draws: Draws) -> Array:
        """Times (B, T) in seconds from 0."""
        return _sum(self.dt + 2.0 * self.jitter * np.diff(draws.uniforms, axis=1))


@dataclass(frozen=True)
class Irregular:
    """Looks at random moments: a Poisson process (tasks of a shared radar, fixes that arrive when they can).

    Model: gaps are exponential, given that they lie in (0, longest).

    Args:
        steps: samples of an episode, >= 2.
        dt: mean of the exponential before gaps above `longest` are excluded; s.
        longest: s; None: 6 dt, which lowers the mean by 1.5 %.

    Raises:
        ValueError: a value out of range.
    """

    steps: int = 200
    dt: float = 0.1
    longest: float | None = None

    def __post_init__(self) -> None:
        _check("Irregular", self.steps, self.dt)
        if self.longest is not None:
            check_between("Irregular", "longest", self.longest, self.dt, unit="s, at least dt")

    @property
    def _longest(self) -> float:
        return 6.0 * self.dt if self.longest is None else self.longest

    @property
    def duration(self) -> float:
        """No episode lasts longer (ten standard deviations above the mean); s."""
        gaps = self.steps - 1
        return min(gaps * self._longest, (gaps + 10.0 * math.sqrt(gaps)) * self.dt) + gaps * TICK

    def need(self) -> Need:
        """One draw per gap."""
        return Need(uniforms=self.steps - 1)

    def times(self, draws: Draws) -> Array:
        """Times (B, T) in seconds from 0."""
        gaps = np.empty_like(draws.uniforms)
        limit = self.duration - gaps.shape[1] * TICK
        poisson_gaps(draws.uniforms, float(self.dt), float(self._longest), limit, gaps)
        return _sum(gaps)


SAMPLINGS: dict[str, type[Sampling]] = {"regular": Regular, "jittered": Jittered, "irregular": Irregular}
"""Kinds by registry name."""


def make_sampling(name: str, **options: Any) -> Sampling:
    """A sampling by its registry name, its parameters by keyword.

    Raises:
        ValueError: an unknown name, or a parameter out of range.
        TypeError: a parameter the sampling does not have.
    """
    if name not in SAMPLINGS:
        raise ValueError(f"make_sampling: name must be one of {', '.join(SAMPLINGS)}; got {name!r}. Use one of them.")
    return SAMPLINGS[name](**options)
