"""Systematic errors that wander."""

from __future__ import annotations

from dataclasses import dataclass

from jink.envs.noise import surge_laws
from jink.envs.noise.spans import check_positive
from jink.envs.streams import Need
from jink.envs.surge import CompiledSurge

__all__ = ["BiasDrift", "BiasWalk"]


@dataclass(frozen=True)
class BiasDrift(CompiledSurge):
    """A slowly wandering systematic error of every component: Ornstein-Uhlenbeck, stationary from the start.

    Model: ``b' = -b / time_constant + noise``, standard deviation ``sigma``, correlation ``exp(-dt / time_constant)``.

    Args:
        sigma: standard deviation, in nominal standard deviations of the sensor.
        time_constant: s.

    Raises:
        ValueError: a value that is not > 0.
    """

    sigma: float = 2.0
    time_constant: float = 20.0
    _law = surge_laws.drifts

    def __post_init__(self) -> None:
        check_positive("BiasDrift", "sigma", self.sigma, "nominal standard deviations")
        check_positive("BiasDrift", "time_constant", self.time_constant, "s")

    def _params(self) -> tuple[float, ...]:
        return (self.sigma, self.time_constant)

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: one per sample and component."""
        return Need(normals=steps * size)


@dataclass(frozen=True)
class BiasWalk(CompiledSurge):
    """A systematic error of every component that walks away from zero (a drifting gyro or clock).

    Args:
        rate: standard deviation after one second, in nominal standard deviations of the sensor; grows as sqrt(t).

    Raises:
        ValueError: ``rate`` is not > 0.
    """

    rate: float = 0.3
    _law = surge_laws.walks

    def __post_init__(self) -> None:
        check_positive("BiasWalk", "rate", self.rate, "nominal standard deviations per square root of a second")

    def _params(self) -> tuple[float, ...]:
        return (self.rate,)

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: one per sample and component."""
        return Need(normals=steps * size)
