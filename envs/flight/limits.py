"""Where episodes begin and what no target exceeds: `Start` and `Limits`."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

__all__ = ["Limits", "Start"]

Span = tuple[float, float]


def _pair(given: Any) -> Span:
    """Two floats; NaN, which no rule accepts, for anything else."""
    try:
        low, high = given
        return float(low), float(high)
    except (TypeError, ValueError):
        return math.nan, math.nan


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What no target ever exceeds.

    Args:
        speed: lowest and highest, m/s.
        lateral: acceleration across the path, g.
        climb: angle from the horizontal, rad (3-D).
        altitude: band that climbs, dives and helices respect, m (3-D).
    Raises:
        ValueError: a value outside its range.
    """

    speed: Span = (0.0, 300.0)
    lateral: float = 6.0
    climb: float = 0.6
    altitude: Span = (-math.inf, math.inf)

    def __post_init__(self) -> None:
        speed, altitude = _pair(self.speed), _pair(self.altitude)
        if not 0.0 <= speed[0] <= speed[1] < math.inf or speed[1] <= 0.0:
            raise ValueError(
                f"Limits: speed must be two numbers 0 <= lowest <= highest, m/s; got {self.speed!r}. Try (0.0, 300.0)."
            )
        if not 0.0 < self.lateral < math.inf:
            raise ValueError(f"Limits: lateral must be positive, in g; got {self.lateral!r}. Try 6.0.")
        if not 0.0 <= self.climb <= 1.5:
            raise ValueError(f"Limits: climb must be within 0 and 1.5 rad; got {self.climb!r}. Try 0.6.")
        if not altitude[0] < altitude[1]:
            raise ValueError(
                f"Limits: altitude must be two increasing numbers in m; got {self.altitude!r}. Lowest first."
            )
        object.__setattr__(self, "speed", speed)
        object.__setattr__(self, "altitude", altitude)


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where an episode begins, in level flight: uniform between two numbers each.

    Args:
        speed: m/s.
        heading: rad, counter-clockwise from +x.
        x, y, z: m.
    Raises:
        ValueError: not two increasing finite numbers.
    """

    speed: Span = (50.0, 150.0)
    heading: Span = (-math.pi, math.pi)
    x: Span = (-1000.0, 1000.0)
    y: Span = (-1000.0, 1000.0)
    z: Span = (1000.0, 3000.0)

    def __post_init__(self) -> None:
        for entry in fields(self):
            given = getattr(self, entry.name)
            low, high = _pair(given)
            if not -math.inf < low <= high < math.inf:
                raise ValueError(
                    f"Start: {entry.name} must be two increasing finite numbers; got {given!r}. "
                    "Give the same number twice for a fixed value."
                )
            object.__setattr__(self, entry.name, (low, high))
