"""What the simulator hands to everybody: `Episodes`, and `Source`, whatever makes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from jink.envs.streams import Streams
from jink.envs.truth import Truth
from jink.estimators.sensor import Sensor

__all__ = ["Episodes", "Source"]

Array = NDArray[np.float64]


class Episodes(NamedTuple):
    """Simulated or recorded episodes: B episodes, T samples, A axes, D measurement components; SI.

    Row b depends on its own draws alone. A missing component of a measurement is NaN. ``noise`` is the covariance the
    measurement error really had, given everything that scales it; a filter is told ``nominal_noise``.
    """

    times: Array  # (B, T) s, when the target was seen; times[:, 0] = 0
    delivery_times: Array  # (B, T) s, when each measurement reaches the tracker: `times + latency`
    truth: Truth  # at `times`
    delivered: Truth  # at `delivery_times`; `truth` itself without a latency
    measurements: Array  # (B, T, D)
    detected: NDArray[np.bool_]  # (B, T) whether any component is there
    scale: Array  # (B, T) factor on the nominal noise covariance, >= 0
    bias: Array  # (B, T, D) systematic part of the measurement error, in units of the measurement
    noise: Array  # (B, T, D, D)
    nominal_noise: Array  # (D, D)
    sensor_states: Array  # (B, T, 2 A) the sensor's own position, velocity
    prior_mean: Array  # (B, 2 A) what is known of position, velocity at times[:, 0] before any measurement
    prior_cov: Array  # (2 A, 2 A)


class Source(Protocol):
    """Whatever gives episodes to an environment: a `Scenario`, or recorded tracks."""

    @property
    def id(self) -> str:
        """Name with version."""
        ...

    @property
    def axes(self) -> int:
        """Space dimensions, 2 or 3."""
        ...

    @property
    def sensor(self) -> Sensor:
        """What is measured, with its nominal noise."""
        ...

    @property
    def intents(self) -> tuple[str, ...]:
        """Names that `Truth.intent` points to."""
        ...

    @property
    def steps(self) -> int:
        """Samples of an episode; an environment makes ``steps - 1`` decisions with it."""
        ...

    @property
    def extent(self) -> float:
        """Positions stay within this distance of the origin along every axis, m."""
        ...

    @property
    def filter_noise(self) -> float:
        """White acceleration a sensible constant-velocity filter assumes here (spectral density), m^2/s^3."""
        ...

    def simulate(self, streams: Sequence[Streams]) -> Episodes:
        """One episode per entry; the generators advance by the same amount every time."""
        ...
