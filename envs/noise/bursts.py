"""Surges that last: bursts, dropouts, ramps and flashes."""

from __future__ import annotations

from dataclasses import dataclass

from jink.envs.noise import surge_laws
from jink.envs.noise.spans import (
    DwellLaw,
    Level,
    check_between,
    check_dwell,
    check_level,
    check_positive,
    cycles_within,
    ends_of,
    level_of,
)
from jink.envs.streams import Need
from jink.envs.surge import CompiledSurge

__all__ = ["Dropouts", "Glint", "MarkovBursts", "PlacedBursts", "Ramp"]


@dataclass(frozen=True)
class MarkovBursts(CompiledSurge):
    """Bursts that come and go: a two-state chain in continuous time, stationary from the start.

    Model: quiet (factor 1) and surge alternate; each surge has its own factor.

    Args:
        on: dwell in a surge: mean of an exponential law (then Markov), or (low, high) of a uniform one; s.
        off: dwell between surges, likewise; s.
        scale: factor on R: fixed, or (low, high) of a log-uniform law.

    Raises:
        ValueError: a dwell or factor that is not > 0, or a reversed range.
    """

    on: DwellLaw = (0.5, 5.0)
    off: DwellLaw = (0.5, 5.0)
    scale: Level = (4.0, 1e4)
    _law = surge_laws.bursts

    def __post_init__(self) -> None:
        for name, check in (("on", check_dwell), ("off", check_dwell), ("scale", check_level)):
            object.__setattr__(self, name, check("MarkovBursts", name, getattr(self, name)))

    def _params(self) -> tuple[float, ...]:
        return (*ends_of(self.on), *ends_of(self.off), *level_of(self.scale), 0.0)

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: the first state, then two for each of enough dwells."""
        return Need(uniforms=2 + 4 * cycles_within(duration, self.on, self.off))


@dataclass(frozen=True)
class Dropouts(CompiledSurge):
    """Bursts of missed detections: nothing is measured while the chain of `MarkovBursts` is on.

    Args:
        on: dwell in a dropout: mean of an exponential law, or (low, high) of a uniform one; s.
        off: dwell between dropouts, likewise; s.

    Raises:
        ValueError: a dwell that is not > 0, or a reversed range.
    """

    on: DwellLaw = 1.0
    off: DwellLaw = 10.0
    _law = surge_laws.bursts

    def __post_init__(self) -> None:
        for name in ("on", "off"):
            object.__setattr__(self, name, check_dwell("Dropouts", name, getattr(self, name)))

    def _params(self) -> tuple[float, ...]:
        return (*ends_of(self.on), *ends_of(self.off), 1.0, 0.0, 1.0)

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: the first state, then two for each of enough dwells."""
        return Need(uniforms=2 + 4 * cycles_within(duration, self.on, self.off))


@dataclass(frozen=True)
class PlacedBursts(CompiledSurge):
    """A known number of bursts of known length in every episode, in random order at random times, never overlapping.

    Args:
        lengths: one per burst; s.
        scale: factor on R: fixed, or (low, high) of a log-uniform law.
        earliest: no burst before; s.

    Raises:
        ValueError: a length or factor that is not > 0, or bursts that do not fit into an episode.
    """

    lengths: tuple[float, ...] = (5.0, 1.0)
    scale: Level = 25.0
    earliest: float = 1.0
    _law = surge_laws.placed_bursts

    def __post_init__(self) -> None:
        object.__setattr__(self, "lengths", tuple(self.lengths))
        for length in self.lengths:
            check_positive("PlacedBursts", "lengths", length, "s")
        object.__setattr__(self, "scale", check_level("PlacedBursts", "scale", self.scale))
        check_between("PlacedBursts", "earliest", self.earliest, 0.0, unit="s")

    def _params(self) -> tuple[float, ...]:
        return (self.earliest, *level_of(self.scale), *self.lengths)

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: place and factor of each burst."""
        total = self.earliest + sum(self.lengths)
        if total > duration:
            raise ValueError(
                f"PlacedBursts: lengths must fit after `earliest` into an episode of {duration:g} s; got {total:g} s. "
                "Shorten them or take more steps."
            )
        return Need(uniforms=2 * len(self.lengths))


@dataclass(frozen=True)
class Ramp(CompiledSurge):
    """Noise that grows and falls gradually (weather, a closing glint, a fading link).

    Model: quiet, then the factor's logarithm rises linearly to the peak, holds and falls; then quiet again.

    Args:
        quiet: dwell before each ramp: mean of an exponential law, or (low, high) of a uniform one; s.
        rise, hold, fall: lengths; s; rise and fall > 0, hold >= 0.
        scale: factor on R at the peak: fixed, or (low, high) of a log-uniform law.

    Raises:
        ValueError: a value out of range.
    """

    quiet: DwellLaw = (2.0, 10.0)
    rise: float = 3.0
    hold: float = 1.0
    fall: float = 3.0
    scale: Level = (25.0, 1e3)
    _law = surge_laws.ramps

    def __post_init__(self) -> None:
        object.__setattr__(self, "quiet", check_dwell("Ramp", "quiet", self.quiet))
        check_positive("Ramp", "rise", self.rise, "s")
        check_positive("Ramp", "fall", self.fall, "s")
        check_between("Ramp", "hold", self.hold, 0.0, unit="s")
        object.__setattr__(self, "scale", check_level("Ramp", "scale", self.scale))

    def _params(self) -> tuple[float, ...]:
        return (*ends_of(self.quiet), self.rise, self.hold, self.fall, *level_of(self.scale))

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: two for each of enough ramps."""
        ramp = self.rise + self.hold + self.fall
        return Need(uniforms=2 * cycles_within(duration, self.quiet, (ramp, ramp)))


@dataclass(frozen=True)
class Glint(CompiledSurge):
    """Periodic flashes (a rotating target, sun on waves) with a random phase.

    Args:
        period: from flash to flash; s.
        width: of a flash; s, at most the period.
        scale: factor on R, one per episode: fixed, or (low, high) of a log-uniform law.

    Raises:
        ValueError: a value that is not > 0, or a width above the period.
    """

    period: float = 4.0
    width: float = 0.5
    scale: Level = 100.0
    _law = surge_laws.flashes

    def __post_init__(self) -> None:
        check_positive("Glint", "period", self.period, "s")
        check_positive("Glint", "width", self.width, "s")
        check_between("Glint", "width", self.width, 0.0, self.period, "s, at most the period")
        object.__setattr__(self, "scale", check_level("Glint", "scale", self.scale))

    def _params(self) -> tuple[float, ...]:
        return (self.period, self.width, *level_of(self.scale))

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: phase and factor."""
        return Need(uniforms=2)
