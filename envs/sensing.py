"""How a target is seen: a sensor of the core on a platform, with missed detections, lost components and latency."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.noise.spans import check_between, check_positive
from jink.envs.sensing_laws import carry, see
from jink.envs.streams import Draws, Need
from jink.envs.truth import Truth
from jink.estimators.sensor import Sensor

__all__ = ["Platform", "Sensing", "Sight"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Platform:
    """What carries a sensor: fixed places, or an own ship on a straight or weaving course.

    Model: ``place + velocity t + weave sin(2 pi t / period)`` to the left of the course (of +x for a fixed place).

    Args:
        places: one place (A,), or several that take turns sample by sample (anchors); (P, A); m; () = the origin.
        velocity: (A,); m/s; () = at rest.
        weave: amplitude across the course, so that angles alone can tell the distance; m.
        period: of the weave; s.

    Raises:
        ValueError: places or a velocity that are not finite or differ in length, a weave < 0, a period not > 0.
    """

    places: tuple[tuple[float, ...], ...] = ()
    velocity: tuple[float, ...] = ()
    weave: float = 0.0
    period: float = 60.0

    def __post_init__(self) -> None:
        try:
            places = np.atleast_2d(np.array(self.places, dtype=np.float64))
            velocity = np.array(self.velocity, dtype=np.float64)
        except (TypeError, ValueError):
            places, velocity = np.full((1, 1), np.nan), np.empty(0)
        lengths = {size for size in (places.shape[-1], velocity.size) if size}
        fits = places.ndim == 2 and velocity.ndim == 1 and lengths <= {2, 3} and len(lengths) <= 1
        if not fits or not np.isfinite(places).all() or not np.isfinite(velocity).all():
            raise ValueError(
                f"Platform: places and velocity must be finite and have the target's axes; got {self.places!r} and "
                f"{self.velocity!r}. Give 2 or 3 numbers each."
            )
        object.__setattr__(self, "places", tuple(tuple(row) for row in places.tolist() if row))
        object.__setattr__(self, "velocity", tuple(velocity.tolist()))
        check_between("Platform", "weave", self.weave, 0.0, unit="m")
        check_positive("Platform", "period", self.period, "s")

    @property
    def axes(self) -> int | None:
        """Space dimensions, None where nothing says so."""
        row = self.places[0] if self.places else self.velocity
        return len(row) or None

    def states(self, times: Array, axes: int) -> Array:
        """Positions and velocities at ``times`` (B, T), seconds; (B, T, 2 A)."""
        states = np.empty((*times.shape, 2 * axes))
        places = np.array(self.places or [[0.0] * axes], dtype=np.float64)
        velocity = np.array(self.velocity or [0.0] * axes, dtype=np.float64)
        carry(times, places, velocity, float(self.weave), float(self.period), states)
        return states


class Sight(NamedTuple):
    """What the sensor made of trajectories."""

    measurements: Array  # (B, T, D), NaN = missing
    noise: Array  # (B, T, D, D)
    sensor_states: Array  # (B, T, 2 A)


@dataclass(frozen=True)
class Sensing:
    """A sensor and the conditions under which it works.

    Model: ``z = h(kin, platform) + bias + v``, ``v ~ N(0, scale R)``, angles wrapped to (-pi, pi].

    Args:
        sensor: one of the core's; its sigma is the nominal noise.
        platform: what carries it.
        detection_probability: of a sample, in [0, 1]; surges can lower it further.
        component_loss: probability that one component of a detected sample is missing, in [0, 1].
        latency: from the moment a target is seen until the tracker has the measurement; s.

    Raises:
        ValueError: a value out of range, or a platform of other axes than the sensor's.
    """

    sensor: Sensor
    platform: Platform = field(default_factory=Platform)
    detection_probability: float = 1.0
    component_loss: float = 0.0
    latency: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.sensor, Sensor):
            raise ValueError(
                f"Sensing: sensor must be a Sensor of jink.estimators; got {self.sensor!r}. Use make_sensor(name)."
            )
        check_between("Sensing", "detection_probability", self.detection_probability, 0.0, 1.0, "parts of one")
        check_between("Sensing", "component_loss", self.component_loss, 0.0, 1.0, "parts of one")
        check_between("Sensing", "latency", self.latency, 0.0, unit="s")
        if self.platform.axes not in (None, self.sensor.axes):
            raise ValueError(
                f"Sensing: platform must have the sensor's {self.sensor.axes} axes; got {self.platform.axes}. "
                f"Give places of {self.sensor.axes} numbers."
            )

    def need(self, steps: int) -> Need:
        """Draws of one episode: the prior's first, then the noise's; the same whatever is missed."""
        size = self.sensor.size
        return Need(uniforms=steps * (1 + size), normals=2 * self.sensor.axes + steps * size)

    def prior(self, truth: Truth, draws: Draws, sigma: tuple[float, float]) -> tuple[Array, Array]:
        """What is known at the first sample: mean (B, 2 A) drawn around the truth, covariance (2 A, 2 A)."""
        A = self.sensor.axes
        deviations = np.repeat(np.asarray(sigma, dtype=np.float64), A)
        start = np.concatenate([truth.position[:, 0], truth.velocity[:, 0]], axis=1)
        return start + deviations * draws.normals[:, : 2 * A], np.diag(deviations**2)

    def look(
        self, times: Array, truth: Truth, draws: Draws, scale: Array, bias: Array, detected: NDArray[np.bool_]
    ) -> Sight:
        """Measure trajectories.

        Args:
            times: (B, T); s.
            truth: trajectories at ``times``.
            draws: of this sensing's `need`.
            scale: factor on the nominal covariance; (B, T).
            bias: nominal sigmas in, units of the measurement out; (B, T, D); changed in place.
            detected: what surges left in; whether any component is there out; (B, T); changed in place.

        Returns:
            measurements, their covariances and the sensor's own states.
        """
        sensor, (B, T) = self.sensor, times.shape
        D, A = sensor.size, sensor.axes
        sight = Sight(np.empty((B, T, D)), np.empty((B, T, D, D)), self.platform.states(times, A))
        see(
            truth.position,
            truth.velocity,
            draws.uniforms,
            draws.normals,
            2 * A,
            scale,
            bias,
            detected,
            sight.sensor_states,
            sensor.observe.address,
            np.array(sensor.params or (0.0,), dtype=np.float64),
            np.array(sensor.sigma, dtype=np.float64),
            np.array(sensor.angular, dtype=np.bool_),
            float(self.detection_probability),
            float(self.component_loss),
            np.empty(2 * A),
            sight.measurements,
            sight.noise,
        )
        return sight
