"""`Path`: a target that flies given legs, the same every time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jink.envs.literature.published_legs import Leg
from jink.envs.streams import Draws, Need
from jink.envs.truth import Array, Truth

__all__ = ["Path"]


@dataclass(frozen=True)
class Path:
    """A fixed path in the plane of legs at constant acceleration or constant turn rate; a `Motion`.

    The last leg goes on beyond its duration. A sample on a boundary belongs to the leg that begins there.

    Args:
        position: at time 0, m; (2,).
        velocity: at time 0, m/s; (2,).
        legs: flown in order; a leg's mode is the intent.

    Raises:
        ValueError: no legs, or a start that is not four finite numbers.
    """

    position: tuple[float, float]
    velocity: tuple[float, float]
    legs: tuple[Leg, ...] = (Leg(1.0, "straight"),)

    def __post_init__(self) -> None:
        start = (*self.position, *self.velocity)
        if len(start) != 4 or not np.isfinite(start).all() or not self.legs:
            raise ValueError(
                f"Path: position and velocity must be two finite numbers each and legs must not be empty; got "
                f"{self.position}, {self.velocity}, {len(self.legs)} legs. Give (x, y) and (vx, vy)."
            )

    @property
    def axes(self) -> int:
        """Space dimensions: 2."""
        return 2

    @property
    def intents(self) -> tuple[str, ...]:
        """Modes of the legs in the order they first appear."""
        return tuple(dict.fromkeys(leg.mode for leg in self.legs))

    def need(self, steps: int, duration: float) -> Need:
        """Nothing is drawn."""
        return Need()

    def simulate(self, times: Array, draws: Draws) -> Truth:
        """The path at ``times`` (B, T), seconds since its start; every row flies the same path."""
        times = np.asarray(times, dtype=np.float64)
        begins = np.cumsum([0.0, *(leg.duration for leg in self.legs[:-1])])
        owner = np.searchsorted(begins, times, side="right") - 1
        position, velocity, acceleration = (np.empty((*times.shape, 2)) for _ in range(3))
        state = np.array([self.position[0], self.velocity[0], self.position[1], self.velocity[1]])
        names = self.intents
        codes = np.array([names.index(leg.mode) for leg in self.legs], dtype=np.int8)
        for index, leg in enumerate(self.legs):
            rows = owner == index
            flown = leg.propagate(state, times[rows] - begins[index])
            position[rows], velocity[rows] = flown[:, [0, 2]], flown[:, [1, 3]]
            turning = leg.turn_rate * np.stack([-flown[:, 3], flown[:, 1]], axis=-1)
            acceleration[rows] = turning + np.asarray(leg.acceleration)
            state = leg.propagate(state, np.array([leg.duration]))[0]
        switches = begins[1:][np.diff(codes) != 0]
        seen = np.where(switches <= times.max(axis=1, initial=-np.inf)[:, None], switches, np.nan)
        return Truth(position, velocity, acceleration, codes[owner], seen)
