"""What a sensor of a scene watches: `Box` in the frame of the scene, `Sector` around the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Box", "Region", "Sector"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """All positions between two corners.

    Args:
        low: smallest coordinates, m; (A,).
        high: largest coordinates, m; (A,).

    Raises:
        ValueError: corners not finite, of unlike length, or not in order.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        fits = len(self.low) == len(self.high) and len(self.low) in (2, 3)
        if not fits or not np.isfinite([*self.low, *self.high]).all() or not np.less(self.low, self.high).all():
            raise ValueError(
                f"Box: low and high must be finite, of 2 or 3 coordinates, low < high in each; got {self.low} and "
                f"{self.high}. Give two opposite corners in metres."
            )

    @property
    def axes(self) -> int:
        """Space dimensions, 2 or 3."""
        return len(self.low)

    @property
    def area(self) -> float:
        """Area (m^2) or volume (m^3)."""
        return float(np.prod(np.subtract(self.high, self.low)))

    def contains(self, offset: Array, place: Array) -> NDArray[np.bool_]:
        """Whether targets at ``place + offset`` (..., A) are watched."""
        position = place + offset
        return np.asarray(((position >= self.low) & (position <= self.high)).all(axis=-1))

    def spread(self, uniforms: Array, place: Array) -> Array:
        """Offsets from ``place`` of points uniform in the box, from uniforms in [0, 1); (..., A)."""
        return np.asarray(self.low) + uniforms * np.subtract(self.high, self.low) - place


@dataclass(frozen=True)
class Sector:
    """A ring, or a part of one, around the sensor, in the plane.

    Args:
        range_max: farthest distance, m.
        range_min: nearest distance, m.
        boresight: bearing of the middle, rad counter-clockwise from +x.
        width: opening angle, rad; 2 pi: all around.

    Raises:
        ValueError: distances not in order, or a width outside (0, 2 pi].
    """

    range_max: float
    range_min: float = 0.0
    boresight: float = 0.0
    width: float = 2 * np.pi

    def __post_init__(self) -> None:
        if not 0 <= self.range_min < self.range_max < np.inf:
            raise ValueError(
                f"Sector: range_min and range_max must satisfy 0 <= range_min < range_max < inf; got "
                f"{self.range_min!r} and {self.range_max!r}. Give them in metres."
            )
        if not (0 < self.width <= 2 * np.pi and np.isfinite(self.boresight)):
            raise ValueError(
                f"Sector: width must lie in (0, 2 pi] and boresight be finite; got {self.width!r} and "
                f"{self.boresight!r}. Give both in radians."
            )

    @property
    def axes(self) -> int:
        """Space dimensions: 2."""
        return 2

    @property
    def area(self) -> float:
        """Area in the plane, m^2."""
        return (self.range_max**2 - self.range_min**2) * self.width / 2

    @property
    def polar_area(self) -> float:
        """Extent in range times extent in bearing, m rad."""
        return (self.range_max - self.range_min) * self.width

    def contains(self, offset: Array, place: Array) -> NDArray[np.bool_]:
        """Whether targets at ``offset`` (..., 2) from the sensor are watched."""
        distance = np.hypot(offset[..., 0], offset[..., 1])
        turn = np.arctan2(offset[..., 1], offset[..., 0]) - self.boresight
        away = np.abs(np.pi - np.mod(np.pi - turn, 2 * np.pi))
        return np.asarray((distance >= self.range_min) & (distance <= self.range_max) & (away <= self.width / 2))

    def spread(self, uniforms: Array, place: Array) -> Array:
        """Offsets from the sensor of points uniform in the plane, from uniforms in [0, 1); (..., 2)."""
        near, far = self.range_min**2, self.range_max**2
        return self._points(np.sqrt(near + uniforms[..., 0] * (far - near)), uniforms[..., 1])

    def spread_polar(self, uniforms: Array) -> Array:
        """Offsets from the sensor of points uniform in range and bearing, from uniforms in [0, 1); (..., 2)."""
        distance = self.range_min + uniforms[..., 0] * (self.range_max - self.range_min)
        return self._points(distance, uniforms[..., 1])

    def _points(self, distance: Array, turn: Array) -> Array:
        bearing = self.boresight + (turn - 0.5) * self.width
        return np.stack([distance * np.cos(bearing), distance * np.sin(bearing)], axis=-1)


Region = Box | Sector
