"""Laws of intents: how a target's shape parameters move, how an intent begins, and how long a phase of it lasts.

Shape parameters are the growth rate g of the speed (1/s) and the turn rate w of the course (rad/s, counter-clockwise
positive; a vector in space). They are the parameters c of the patent's motion function, and their law is f_p.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from jink.estimators.motion import Motion
from jink.estimators.motions.bilinear import bilinear

__all__ = ["Birth", "Law", "Phase"]

_WEIGHT_TOLERANCE = 1e-9
_LARGEST = 1e30


def _number(caller: str, name: str, value: object, rule: str = ">= 0") -> float:
    """A parameter as a float, or one sentence."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if math.isfinite(number) and abs(number) > _LARGEST:
        raise ValueError(
            f"{caller}: {name} must be at most {_LARGEST:g} in size; got {value!r}. Use SI units and radians."
        )
    holds = math.isfinite(number) and not (rule == ">= 0" and number < 0) and not (rule == "> 0" and number <= 0)
    if not holds:
        wanted = "a finite number" if rule == "finite" else f"a finite number {rule}"
        raise ValueError(f"{caller}: {name} must be {wanted}; got {value!r}. Use SI units and radians.")
    return number


@dataclass(frozen=True)
class Law:
    """How velocity and shape parameters of one intent move.

    Model: ``v' = g v + w x v + white acceleration`` (in the plane ``(g + i w) v``), ``g' = growth_rate (growth_mean -
    g) + noise``, ``w' = turn_rate (turn_mean - w) + noise``; with a swing ``w' = u, u' = -W^2 (w - turn_mean) - 2 z W
    u + noise``. Line, acceleration, circle, spiral and weave are special cases.

    Args:
        axes: 2 or 3.
        growth_mean: g is drawn to it; 1/s.
        growth_rate: how fast; 1/s; 0: a random walk.
        growth_noise: density of the white noise on g'; 1/s^3.
        turn_mean: w is drawn to it; rad/s; in space 0.
        turn_rate: how fast; 1/s; 0: a random walk; with a swing 0.
        turn_noise: density of the white noise on w', rad^2/s^3; with a swing on u', rad^2/s^5.
        wobble: density of the white acceleration per axis; m^2/s^3.
        swing: natural rate W (rad/s) and damping z in [0.001, 0.999]; None: no weave.

    Raises:
        ValueError: a parameter is out of range.

    Source: patent CN202211553542, claims 4-6; the bilinear family is ours.
    """

    axes: int = 2
    growth_mean: float = 0.0
    growth_rate: float = 0.0
    growth_noise: float = 0.0
    turn_mean: float = 0.0
    turn_rate: float = 0.0
    turn_noise: float = 0.0
    wobble: float = 1.0
    swing: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        if self.axes not in (2, 3):
            raise ValueError(f"Law: axes must be 2 or 3; got {self.axes!r}. Use 2 for the plane, 3 for space.")
        for name in ("growth_mean", "turn_mean"):
            put(self, name, _number("Law", name, getattr(self, name), "finite"))
        for name in ("growth_rate", "growth_noise", "turn_rate", "turn_noise", "wobble"):
            put(self, name, _number("Law", name, getattr(self, name)))
        if self.axes == 3 and self.turn_mean != 0.0:
            raise ValueError(f"Law: turn_mean must be 0 in space; got {self.turn_mean}. Let the birth spread the turn.")
        if self.swing is None:
            return
        if not isinstance(self.swing, Sequence) or len(self.swing) != 2:
            raise ValueError(
                f"Law: swing must be (natural rate, damping); got {self.swing!r}. Use for instance (0.5, 0.1)."
            )
        natural, damping = _number("Law", "swing rate", self.swing[0], "> 0"), _number("Law", "damping", self.swing[1])
        if not 1e-3 <= damping <= 0.999:
            raise ValueError(f"Law: damping must be in [0.001, 0.999]; got {damping}. A weave swings: use 0.1.")
        if self.turn_rate != 0.0:
            raise ValueError(
                f"Law: turn_rate must be 0 with a swing; got {self.turn_rate}. The swing brings the turn rate back."
            )
        put(self, "swing", (natural, damping))

    @property
    def second_order(self) -> bool:
        """The turn rate has a slope of its own."""
        return self.swing is not None

    def mirrored(self) -> Law:
        """The same law with left and right exchanged."""
        return replace(self, turn_mean=-self.turn_mean)

    def motion(self, birth: Birth, *, slope: bool = False, speed_floor: float = 1.0) -> Motion:
        """The compiled motion function of this law (f_p), beginning as ``birth`` says.

        Args:
            birth: prior of the shape parameters when the intent begins.
            slope: carry the slope of the turn rate even if this law has none (all modes of a bank share a layout).
            speed_floor: m/s; see `bilinear`.
        """
        return bilinear(
            self.axes,
            growth_mean=self.growth_mean,
            growth_rate=self.growth_rate,
            growth_noise=self.growth_noise,
            turn_mean=self.turn_mean,
            turn_rate=self.turn_rate,
            turn_noise=self.turn_noise,
            wobble=self.wobble,
            swing=self.swing,
            slope=slope,
            growth=(birth.growth_mean, birth.growth_sd),
            turn=(birth.turn_mean, birth.turn_sd),
            swing_sd=birth.swing_sd,
            speed_floor=speed_floor,
        )


@dataclass(frozen=True)
class Birth:
    """One Gaussian component of what shape parameters an intent begins with.

    Args:
        weight: share of this component; those of a phase sum to 1.
        growth_mean, growth_sd: of g; 1/s.
        turn_mean, turn_sd: of w (of each component in space, where the mean is 0); rad/s.
        swing_sd: of the slope u of a weave, mean 0; rad/s^2.

    Raises:
        ValueError: a parameter is out of range.
    """

    weight: float = 1.0
    growth_mean: float = 0.0
    growth_sd: float = 0.0
    turn_mean: float = 0.0
    turn_sd: float = 0.0
    swing_sd: float = 0.1

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "weight", _number("Birth", "weight", self.weight, "> 0"))
        for name in ("growth_mean", "turn_mean"):
            put(self, name, _number("Birth", name, getattr(self, name), "finite"))
        for name in ("growth_sd", "turn_sd", "swing_sd"):
            put(self, name, _number("Birth", name, getattr(self, name)))
        if self.weight > 1.0 + _WEIGHT_TOLERANCE:
            raise ValueError(f"Birth: weight must be <= 1; got {self.weight}. Divide by the sum.")

    def mirrored(self) -> Birth:
        """The same component with left and right exchanged."""
        return replace(self, turn_mean=-self.turn_mean)


@dataclass(frozen=True)
class Phase:
    """A stretch of an intent with one law; an ordinary intent has one, a template runs through several.

    Args:
        law: how the target moves.
        births: what it begins with; one or more, weights sum to 1.
        mirrored: every component also exists with left and right exchanged, each with half the weight; 2-D only.
        duration: mean time until the next phase; s; not used by the last phase, which ends as its intent ends.

    Raises:
        ValueError: the parts do not fit.
    """

    law: Law
    births: tuple[Birth, ...] = (Birth(),)
    mirrored: bool = False
    duration: float = 10.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.law, Law):
            raise ValueError(f"Phase: law must be a Law; got {type(self.law).__name__}. Write Law(axes, ...).")
        births = (self.births,) if isinstance(self.births, Birth) else tuple(self.births)
        put(self, "births", births)
        put(self, "mirrored", bool(self.mirrored))
        put(self, "duration", _number("Phase", "duration", self.duration, "> 0"))
        if not births or not all(isinstance(birth, Birth) for birth in births):
            raise ValueError(f"Phase: births must hold one or more Birth; got {births!r}. Write (Birth(),).")
        total = math.fsum(birth.weight for birth in births)
        if abs(total - 1.0) > _WEIGHT_TOLERANCE:
            raise ValueError(f"Phase: births must have weights that sum to 1; got {total:.9g}. Divide by the sum.")
        if self.law.axes == 3 and self.mirrored:
            raise ValueError(
                "Phase: mirrored must be False in space; got True. Turns about any axis are one law there."
            )
        if self.law.axes == 3 and any(birth.turn_mean != 0.0 for birth in births):
            raise ValueError("Phase: births must have turn_mean 0 in space; got another. Use turn_sd.")

    @property
    def signs(self) -> tuple[int, ...]:
        """+1 as written and, if mirrored, -1 for left and right exchanged."""
        return (1, -1) if self.mirrored else (1,)
