"""What a policy sees of a sample, as numbers it can undo exactly: `Layout`, and what a nominal error is."""

from __future__ import annotations

import math
from typing import NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes, Source
from jink.envs.estimate_scoring import elapsed
from jink.estimators.locating import locate_ray
from jink.estimators.sensor import Sensor

__all__ = ["BOUND", "Layout", "Seen", "nominal_sigma", "seen_positions", "since_switch"]

Array = NDArray[np.float64]
BOUND = 2.0**20
"""Observations are cut off here: spaces want finite bounds, and no plausible measurement is a million scenes away."""


class Seen(NamedTuple):
    """What observations say, in SI units; leading axes as the observations."""

    measurement: Array  # (..., D), NaN where missing
    step: Array  # (...,) s since the previous sample
    sensor_state: Array  # (..., 2 A) position, velocity; zeros where the sensor's place plays no part


class Layout(NamedTuple):
    """How a sample becomes an observation: measurement, time step, detected[, sensor].

    Scales are powers of two, so that dividing and multiplying by them changes no digit.
    """

    axes: int
    size: int  # D
    scale: float  # m; at least twice the extent of the source
    speed_scale: float  # m/s
    units: Array  # (D,) what each component was divided by
    placed: bool  # the sensor's own position, velocity are part of the observation

    @classmethod
    def of(cls, source: Source) -> Layout:
        """The layout for a source; the same for every source with this sensor and extent."""
        sensor = source.sensor
        scale = 2.0 ** math.ceil(math.log2(2.0 * source.extent))
        speed = 2.0 ** round(math.log2(scale) / 2.0)
        units = np.array([{"m": scale, "m/s": speed}.get(unit, 1.0) for unit in sensor.units])
        return cls(source.axes, sensor.size, scale, speed, units, not sensor.linear and sensor.name != "ranges")

    @property
    def width(self) -> int:
        """Numbers in an observation."""
        return 2 * self.size + 1 + (2 * self.axes if self.placed else 0)

    def space(self) -> gymnasium.spaces.Box:
        """The observation space of one target."""
        low, high = np.full(self.width, -BOUND), np.full(self.width, BOUND)
        low[self.size : 2 * self.size + 1] = 0.0
        high[self.size + 1 : 2 * self.size + 1] = 1.0
        return gymnasium.spaces.Box(low, high, dtype=np.float64)

    def observe(self, episodes: Episodes) -> Array:
        """Observations (B, T, O) of whole episodes."""
        D = self.size
        seen = np.zeros((*episodes.times.shape, self.width))
        there = ~np.isnan(episodes.measurements)
        np.divide(episodes.measurements, self.units, out=seen[:, :, :D], where=there)
        seen[:, 1:, D] = np.diff(episodes.times, axis=1)
        seen[:, :, D + 1 : 2 * D + 1] = there
        if self.placed:
            seen[:, :, 2 * D + 1 :] = episodes.sensor_states / self._sensor_units
        return np.clip(seen, -BOUND, BOUND, out=seen)

    def read(self, observations: Array) -> Seen:
        """Undo `observe`: SI units, NaN where nothing was measured."""
        D = self.size
        z = np.where(observations[..., D + 1 : 2 * D + 1] > 0.0, observations[..., :D] * self.units, np.nan)
        if self.placed:
            return Seen(z, observations[..., D], observations[..., 2 * D + 1 :] * self._sensor_units)
        return Seen(z, observations[..., D], np.zeros((*observations.shape[:-1], 2 * self.axes)))

    @property
    def _sensor_units(self) -> Array:
        return np.repeat([self.scale, self.speed_scale], self.axes)


def nominal_sigma(sensor: Sensor, separation: Array) -> Array:
    """Root mean square position error of one measurement in nominal noise.

    Model: ``sigma^2 = A mean_i s_i^2`` over the components that see position, with ``s_i`` the sigma of a distance
    or range times the sigma of an angle (horizontal range for a bearing seen with an elevation); exact for positions
    and, to first order, for range with bearing (and elevation).
    A sensor of range rates alone is given ``s = sigma x 1 s``.

    Args:
        sensor: what is measured.
        separation: target minus sensor; (..., A); m.

    Returns:
        m; (...).
    """
    distance = np.maximum(np.sqrt(np.square(separation).sum(axis=-1)), 1.0)
    fixed = [sigma for sigma, unit in zip(sensor.sigma, sensor.units, strict=True) if unit == "m"]
    turning = [
        (label, sigma)
        for label, sigma, unit in zip(sensor.labels, sensor.sigma, sensor.units, strict=True)
        if unit == "rad"
    ]
    if not fixed and not turning:
        fixed = list(sensor.sigma)
    level = (
        np.maximum(np.hypot(separation[..., 0], separation[..., 1]), 1.0) if "elevation" in sensor.labels else distance
    )
    share = sensor.axes / (len(fixed) + len(turning))
    total = np.asarray(math.fsum(s * s for s in fixed))
    for label, sigma in turning:
        total = total + np.square(sigma * (level if label == "bearing" else distance))
    return np.asarray(np.sqrt(share * total))


def since_switch(times: Array, switch_times: Array) -> Array:
    """Time since the last change of intent, or since the start at time 0.

    Args:
        times: the moments asked about, in order; (B, T); s.
        switch_times: in order, NaN = padding; (B, S); s.

    Returns:
        (B, T); s.
    """
    since = np.empty(times.shape)
    elapsed(np.ascontiguousarray(times), np.ascontiguousarray(switch_times), since)
    return since


def seen_positions(sensor: Sensor, measurements: Array, sensor_states: Array) -> Array:
    """Where measurements alone place the target; NaN where they do not, for instance along a bearing.

    Args:
        sensor: what is measured.
        measurements: (T, D).
        sensor_states: (T, 2 A).

    Returns:
        (T, A); m.
    """
    places = np.full((len(measurements), sensor.axes), np.nan)
    if sensor.locate is not None and sensor.locate is not locate_ray:
        for t, (z, state) in enumerate(zip(measurements, sensor_states, strict=True)):
            located = sensor.locate(sensor, z, sensor.noise, state)
            if located is not None:
                places[t] = located[0]
    return places
