"""`SceneSensor`: where a sensor of a scene stands, what it watches, how well, how often, and its false alarms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.scenery.regions import Region, Sector
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import make_sensor

__all__ = ["KINDS", "ClutterDensity", "SceneSensor"]

Array = NDArray[np.float64]
KINDS = ("range-bearing", "position")
SPACES = ("measurement", "plane")


class ClutterDensity(NamedTuple):
    """Expected false alarms of one scan around given points, 0 outside the region."""

    measurement: Array  # (...) per m rad for range and bearing, per m^A for positions
    plane: Array  # (...) per m^A


@dataclass(frozen=True)
class SceneSensor:
    """A sensor at a fixed place that reports all it sees of its region once per scan.

    Model: a target in the region is detected with probability P_D, ``z = h(p) + v``, ``v ~ N(0, diag sigma^2)``;
    false alarms per scan are Poisson, uniform in the region. Uniform in range and bearing means crowded near the
    sensor: the density in the plane is the one per m rad divided by the range.

    Args:
        kind: "range-bearing" (m, rad) or "position" (m, in the frame of the scene).
        sigma: standard deviation per component; (D,); m, rad.
        region: what is watched; a `Sector` for range and bearing.
        place: of the sensor, m; (A,).
        period: time between scans, s.
        offset: time of the first scan, s.
        detection: P_D, 0 to 1.
        clutter: expected false alarms per scan.
        clutter_space: "measurement" or "plane": where false alarms are uniform; the same thing for positions.

    Raises:
        ValueError: an unknown kind or space, a number out of range, or a region or place that does not fit.
    """

    kind: str
    sigma: tuple[float, ...]
    region: Region
    place: tuple[float, ...] = (0.0, 0.0)
    period: float = 1.0
    offset: float = 0.0
    detection: float = 1.0
    clutter: float = 0.0
    clutter_space: str = "measurement"

    def __post_init__(self) -> None:
        for name, value, known in (("kind", self.kind, KINDS), ("clutter_space", self.clutter_space, SPACES)):
            if value not in known:
                raise ValueError(f"SceneSensor: {name} must be one of {', '.join(known)}; got {value!r}. Choose one.")
        for name, rule, good in (
            ("period", "be finite and > 0 s", 0 < self.period < np.inf),
            ("offset", "be finite and >= 0 s", 0 <= self.offset < np.inf),
            ("detection", "be a probability", 0 <= self.detection <= 1),
            ("clutter", "be finite and >= 0, false alarms per scan", 0 <= self.clutter < np.inf),
        ):
            if not good:
                raise ValueError(f"SceneSensor: {name} must {rule}; got {getattr(self, name)!r}. Use SI units.")
        if self.kind == "range-bearing" and not isinstance(self.region, Sector):
            raise ValueError(
                f"SceneSensor: region must be a Sector for range and bearing; got {self.region}. "
                "Give its nearest and farthest range."
            )
        if len(self.place) != self.region.axes or not np.isfinite(self.place).all():
            raise ValueError(
                f"SceneSensor: place must be {self.region.axes} finite coordinates, as its region; got {self.place}. "
                "Give it in metres."
            )
        if len(self.sigma) != self.region.axes:
            raise ValueError(
                f"SceneSensor: sigma must have {self.region.axes} entries, one per component; got {self.sigma}. "
                "Give standard deviations in metres and radians."
            )
        _ = self.model

    @property
    def axes(self) -> int:
        """Space dimensions A; also the number of measurement components D."""
        return self.region.axes

    @property
    def model(self) -> Sensor:
        """The same sensor for an estimator."""
        options = {"sigma": self.sigma}
        return make_sensor(self.kind, **options, **({"axes": self.axes} if self.kind == "position" else {}))

    @property
    def volume(self) -> float:
        """Extent V of the region in measurement space, m rad for range and bearing, m^A for positions."""
        if self.kind == "range-bearing" and isinstance(self.region, Sector):
            return self.region.polar_area
        return self.region.area

    def scan_times(self, duration: float) -> Array:
        """Times of the scans up to ``duration`` s, the end included."""
        # A period that divides the duration loses its last scan to rounding without the slack.
        count = np.floor((duration - self.offset) / self.period + 1e-9) + 1
        return self.offset + self.period * np.arange(max(int(count), 0), dtype=np.float64)

    def watches(self, positions: Array) -> NDArray[np.bool_]:
        """Whether targets at ``positions`` (..., A) are in the region; NaN is not."""
        place = np.asarray(self.place)
        return self.region.contains(positions - place, place)

    def measure(self, positions: Array, unit_noise: Array | float = 0.0) -> Array:
        """Measurements of targets at ``positions`` (..., A), with standard normal draws (..., D) for the noise.

        A range that noise made negative is counted from the sensor again, a bearing is wrapped to (-pi, pi].
        """
        noise = np.asarray(self.sigma) * unit_noise
        if self.kind == "position":
            return np.asarray(positions + noise)
        offset = positions - np.asarray(self.place)
        polar = np.stack([np.hypot(offset[..., 0], offset[..., 1]), np.arctan2(offset[..., 1], offset[..., 0])], -1)
        polar = polar + noise
        polar[..., 0] = np.abs(polar[..., 0])
        polar[..., 1] = np.pi - np.mod(np.pi - polar[..., 1], 2 * np.pi)
        return np.asarray(polar)

    def false_alarms(self, uniforms: Array) -> Array:
        """Places (..., A) of false alarms, from uniforms (..., A) in [0, 1)."""
        place = np.asarray(self.place)
        if self.kind == "range-bearing" and self.clutter_space == "measurement" and isinstance(self.region, Sector):
            return place + self.region.spread_polar(uniforms)
        return place + self.region.spread(uniforms, place)

    def clutter_density(self, positions: Array) -> ClutterDensity:
        """Density of false alarms around ``positions`` (..., A), in measurement space and in the plane."""
        distance = np.linalg.norm(positions - np.asarray(self.place), axis=-1)
        inside = self.watches(positions)
        if self.kind == "position":
            per_volume = np.where(inside, self.clutter / self.volume, 0.0)
            return ClutterDensity(per_volume, per_volume)
        distance = np.where(inside, distance, 1.0)
        if self.clutter_space == "plane":
            plane = np.where(inside, self.clutter / self.region.area, 0.0)
            return ClutterDensity(plane * distance, plane)
        polar = np.where(inside, self.clutter / self.volume, 0.0)
        # Infinite at the sensor itself, as it is.
        with np.errstate(divide="ignore", invalid="ignore"):
            return ClutterDensity(polar, np.where(inside, polar / distance, 0.0))
