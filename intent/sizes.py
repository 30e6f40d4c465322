"""Typical sizes of what is learned, so that one step of an optimiser means the same for every number."""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["Sizes"]

_UNSEEN = 1e-6  # share of a typical change that no track would show


class Sizes(NamedTuple):
    """Of a set of tracks.

    speed: root mean square, m/s; growth: of the growth rate, 1/s; turn: of the turn rate, rad/s; acceleration: m/s^2;
    duration: of a track, s; step: median time step, s.
    """

    speed: float
    growth: float
    turn: float
    acceleration: float
    duration: float
    step: float

    def units(self) -> dict[str, float]:
        """Unit of each parameter of the twin that is no logarithm; in the twin's own units."""
        return {
            "birth_growth": self.growth / 0.02,
            "growth_mean": self.growth / 0.02,
            "birth_turn": self.turn / 0.1,
            "turn_mean": self.turn / 0.1,
        }

    def floors(self) -> dict[str, float]:
        """Least values of logarithms: less noise than this is not seen in a whole track."""
        return {
            "log_wobble": math.log(_UNSEEN * self.acceleration**2 * self.step),
            "log_growth_noise": math.log(_UNSEEN * self.growth**2 / self.duration),
            "log_turn_noise": math.log(_UNSEEN * self.turn**2 / self.duration),
            "log_birth_growth_sd": math.log(2e-3 * self.growth),
            "log_birth_turn_sd": math.log(2e-3 * self.turn),
            "log_rates": math.log(1e-4 / self.duration),
            "log_renewal": math.log(1e-4 / self.duration),
        }

    def ceilings(self) -> dict[str, float]:
        """Greatest values of logarithms.

        An intent that ends sooner than two steps on explains a row, not a motion; a weave that is faster than half a
        period per step is seen as a slower one; what is forgotten within a tenth of a step is white noise.
        """
        return {
            "log_rates": math.log(0.5 / self.step),
            "log_renewal": math.log(0.5 / self.step),
            "log_natural": math.log(math.pi / self.step),
            "log_growth_rate": math.log(10.0 / self.step),
            "log_turn_rate": math.log(10.0 / self.step),
        }
