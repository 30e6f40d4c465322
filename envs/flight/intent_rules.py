"""What every intent shares: `Intent`, its validated parameters, and what its planning function sees and writes.

An intent's planning function writes one *round* of wishes (duration, acceleration, turn rate, ...). The simulator
turns wishes into legs: it carries position, speed, heading and climb over, and holds the limits whatever was wished.
"""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields
from typing import Any, ClassVar

import numpy as np
from numba import types
from numpy.typing import NDArray

from jink.envs.compiled import inner_kernel
from jink.envs.flight.dwells import Dwell
from jink.estimators import compiled
from jink.estimators.compiled import Callback

__all__ = ["GRAVITY", "PLAN", "Intent", "between", "hold", "pick_side", "swing", "wish", "within"]

Array = NDArray[np.float64]
Span = tuple[float, float]
GRAVITY = 9.80665

_VECTOR = types.Array(types.float64, 1, "C")
PLAN = types.void(_VECTOR, _VECTOR, _VECTOR, _VECTOR)
"""``plan(now, u, params, out)``: situation (NOW_SIZE,), uniforms (uniforms,), `Intent.row`; wishes through `wish`."""
call_plan = compiled.call_observe  # takes the same four vectors

SPEED, HEADING, CLIMB, ALTITUDE, LEFT = 0, 1, 2, 3, 4
MIN_SPEED, MAX_SPEED, MAX_LATERAL, MAX_CLIMB, FLOOR, CEILING = 5, 6, 7, 8, 9, 10
NOW_SIZE = 11
"""Situation of a target: m/s, rad, rad, m, seconds left in the intent; its limits: m/s, m/s, m/s^2, rad, m, m."""

MAX_WISHES = 5
WISH_SIZE = 6
OUT_SIZE = 1 + MAX_WISHES * WISH_SIZE
"""Wishes: their number, then duration, acceleration, turn rate, pitch rate, swing amplitude, swing rate of each."""


@inner_kernel
def between(low: float, high: float, u: float) -> float:
    """Quantile ``u`` of the uniform distribution."""
    return low + (high - low) * u


@inner_kernel
def pick_side(u: float, probability: float) -> float:
    """+1 with the given probability, else -1."""
    return 1.0 if u < probability else -1.0


@inner_kernel
def wish(out: Array, duration: float, acceleration: float, turn: float, pitch: float) -> None:
    """Append a leg that speeds up, turns and pitches; s, m/s^2, rad/s, rad/s. Nothing for a duration of 0."""
    if duration > 0.0:
        at = 1 + int(out[0]) * WISH_SIZE
        out[at] = duration
        out[at + 1] = acceleration
        out[at + 2] = turn
        out[at + 3] = pitch
        out[at + 4] = 0.0
        out[at + 5] = 1.0
        out[0] += 1.0


@inner_kernel
def hold(out: Array, duration: float) -> None:
    """Append a leg straight on at the present speed."""
    wish(out, duration, 0.0, 0.0, 0.0)


@inner_kernel
def swing(out: Array, duration: float, amplitude: float, rate: float) -> None:
    """Append a leg whose heading swings about the present one; s, rad (at most a quarter turn), rad/s."""
    at = 1 + int(out[0]) * WISH_SIZE
    wish(out, duration, 0.0, 0.0, 0.0)
    out[at + 4] = amplitude
    out[at + 5] = rate


def within(unit: str, least: float = 0.0, most: float = math.inf) -> dict[str, Any]:
    """What makes a field a parameter: its unit and range. A pair is drawn anew each time, uniform between the two."""
    return {"unit": unit, "least": least, "most": most}


@dataclass(frozen=True, kw_only=True)
class Intent:
    """What a target is up to, with the distributions of its parameters.

    Args:
        name: what `Truth.intent` calls it; lets one motion hold two intents of a kind.
        dwell: how long it lasts.
    Raises:
        ValueError: a parameter outside its range.
    """

    name: str = "straight"
    dwell: Dwell = field(default_factory=Dwell)

    uniforms: ClassVar[int] = 0  # drawn for every round
    in_space: ClassVar[bool] = False  # needs three dimensions
    plan: ClassVar[Callback]

    def __post_init__(self) -> None:
        caller = type(self).__name__
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"{caller}: name must be a non-empty string; got {self.name!r}. Use the default.")
        if not isinstance(self.dwell, Dwell):
            raise ValueError(f"{caller}: dwell must be a Dwell; got {self.dwell!r}. Try Dwell(mean=10.0).")
        for entry in fields(self):
            if entry.metadata:
                object.__setattr__(self, entry.name, _checked(caller, entry, getattr(self, entry.name)))

    @property
    def shortest_round(self) -> float:
        """The shortest time between two calls of the planning function, s."""
        return self.dwell.shortest

    def row(self) -> tuple[float, ...]:
        """The parameters in the order of their declaration, as the planning function reads them."""
        values: list[float] = []
        for entry in fields(self):
            if entry.metadata:
                value = getattr(self, entry.name)
                values.extend(value if isinstance(value, tuple) else (value,))
        return tuple(values)


def _checked(caller: str, entry: Field[Any], value: Any) -> float | Span:
    least, most, unit = entry.metadata["least"], entry.metadata["most"], entry.metadata["unit"]
    pair = isinstance(entry.default, tuple)
    try:
        numbers = tuple(float(x) for x in value) if pair else (float(value),)
    except (TypeError, ValueError):
        numbers = ()
    good = len(numbers) == 1 + pair and all(math.isfinite(x) and least <= x <= most for x in numbers)
    if not good or numbers[0] > numbers[-1]:
        kind = "two increasing numbers" if pair else "a number"
        bounds = f"within {least:g} and {most:g}" if math.isfinite(most) else f"of {least:g} or more"
        raise ValueError(
            f"{caller}: {entry.name} must be {kind} {bounds} {unit}; got {value!r}. The default is {entry.default!r}."
        )
    return (numbers[0], numbers[1]) if pair else numbers[0]
