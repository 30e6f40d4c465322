"""The nine intents: what each wishes to do, from its parameters, uniform draws and the target's situation.

To add one: a planning function, a dataclass with its parameters, a line in `INTENTS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

from jink.envs.compiled import inner_kernel
from jink.envs.flight.dwells import SHORTEST, Dwell
from jink.envs.flight.intent_rules import (
    ALTITUDE,
    CEILING,
    FLOOR,
    GRAVITY,
    LEFT,
    MAX_CLIMB,
    MAX_LATERAL,
    MAX_SPEED,
    MIN_SPEED,
    PLAN,
    SPEED,
    Array,
    Intent,
    Span,
    between,
    hold,
    pick_side,
    swing,
    wish,
    within,
)
from jink.envs.flight.legs import MAX_AMPLITUDE
from jink.estimators.compiled import Callback

__all__ = [
    "INTENTS",
    "Accelerate",
    "Climb",
    "Helix",
    "Jink",
    "Orbit",
    "StopAndGo",
    "Straight",
    "Turn",
    "Weave",
    "make_intent",
]

_STILL = 1e-9  # m/s; below it a target has no turn rate of its own


@inner_kernel
def sharpest(now: Array) -> float:
    """Turn rate at the lateral limit, rad/s."""
    return now[MAX_LATERAL] / max(now[SPEED], _STILL)


def _straight(now: Array, u: Array, params: Array, out: Array) -> None:
    hold(out, now[LEFT])


@dataclass(frozen=True, kw_only=True)
class Straight(Intent):
    """Straight on at constant speed."""

    name: str = "straight"
    plan: ClassVar[Callback] = Callback(_straight, PLAN)


def _accelerate(now: Array, u: Array, params: Array, out: Array) -> None:
    a = between(params[0], params[1], u[0]) * pick_side(u[1], 1.0 - params[2])
    margin = 1e-6 * (now[MAX_SPEED] - now[MIN_SPEED])
    if (a > 0.0 and now[SPEED] >= now[MAX_SPEED] - margin) or (a < 0.0 and now[SPEED] <= now[MIN_SPEED] + margin):
        a = -a
    wish(out, now[LEFT], a, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Accelerate(Intent):
    """Speeds up or brakes along a straight line; constant speed once a limit is reached."""

    name: str = "accelerate"
    dwell: Dwell = field(default_factory=lambda: Dwell(4.0, 1.0))
    acceleration: Span = field(default=(2.0, 8.0), metadata=within("m/s^2"))
    brakes: float = field(default=0.5, metadata=within("(probability)", most=1.0))
    uniforms: ClassVar[int] = 2
    plan: ClassVar[Callback] = Callback(_accelerate, PLAN)


def _turn(now: Array, u: Array, params: Array, out: Array) -> None:
    rate = min(between(params[0], params[1], u[0]), sharpest(now))
    wish(out, now[LEFT], 0.0, rate * pick_side(u[1], params[2]), 0.0)


@dataclass(frozen=True, kw_only=True)
class Turn(Intent):
    """Coordinated turn: constant speed, constant rate."""

    name: str = "turn"
    rate: Span = field(default=(0.05, 0.3), metadata=within("rad/s"))
    left: float = field(default=0.5, metadata=within("(probability)", most=1.0))
    uniforms: ClassVar[int] = 2
    plan: ClassVar[Callback] = Callback(_turn, PLAN)


def _weave(now: Array, u: Array, params: Array, out: Array) -> None:
    rate = 2.0 * math.pi / between(params[2], params[3], u[1])
    amplitude = min(between(params[0], params[1], u[0]), sharpest(now) / rate)
    swing(out, now[LEFT], amplitude * pick_side(u[2], 0.5), rate)


@dataclass(frozen=True, kw_only=True)
class Weave(Intent):
    """Heading swings to both sides of the course, at constant speed."""

    name: str = "weave"
    dwell: Dwell = field(default_factory=lambda: Dwell(15.0, 5.0))
    amplitude: Span = field(default=(0.3, 0.9), metadata=within("rad", most=MAX_AMPLITUDE))
    period: Span = field(default=(4.0, 10.0), metadata=within("s", least=0.01))
    uniforms: ClassVar[int] = 3
    plan: ClassVar[Callback] = Callback(_weave, PLAN)


def _orbit(now: Array, u: Array, params: Array, out: Array) -> None:
    rate = min(now[SPEED] / between(params[0], params[1], u[0]), sharpest(now))
    wish(out, now[LEFT], 0.0, rate * pick_side(u[1], params[2]), 0.0)


@dataclass(frozen=True, kw_only=True)
class Orbit(Intent):
    """Circle of constant radius, held; wider than wished where the speed does not allow it."""

    name: str = "orbit"
    dwell: Dwell = field(default_factory=lambda: Dwell(40.0, 10.0))
    radius: Span = field(default=(500.0, 2000.0), metadata=within("m", least=0.1))
    left: float = field(default=0.5, metadata=within("(probability)", most=1.0))
    uniforms: ClassVar[int] = 2
    plan: ClassVar[Callback] = Callback(_orbit, PLAN)


@inner_kernel
def pitch_over(now: Array, turn: float, fastest: float, angle: float, up: float, out: Array) -> None:
    """Pitch to ``angle``, hold, level off within the time left, turning at ``turn`` throughout.

    The angle is what the time, the limits and the band of altitude allow; the other direction is taken where the
    wished one would leave the band.
    """
    time = now[LEFT]
    spare = math.sqrt(max(sharpest(now) ** 2 - turn * turn, 0.0))
    rate = min(fastest, spare)
    angle = min(min(angle, now[MAX_CLIMB]), 0.5 * rate * time)
    reach = now[SPEED] * time * math.sin(angle)
    above = now[CEILING] - now[ALTITUDE]
    below = now[ALTITUDE] - now[FLOOR]
    side = up
    if reach > (above if up > 0.0 else below):
        side = -up
        if reach > (below if up > 0.0 else above):
            angle = 0.0
    ramp = angle / rate if angle > 0.0 else 0.0
    wish(out, ramp, 0.0, turn, side * rate)
    wish(out, time - 2.0 * ramp, 0.0, turn, 0.0)
    wish(out, ramp, 0.0, turn, -side * rate)


def _climb(now: Array, u: Array, params: Array, out: Array) -> None:
    pitch_over(now, 0.0, params[2], between(params[0], params[1], u[0]), pick_side(u[1], params[3]), out)


@dataclass(frozen=True, kw_only=True)
class Climb(Intent):
    """Climb or dive at constant speed: pitch over, hold the angle, level off (3-D)."""

    name: str = "climb"
    dwell: Dwell = field(default_factory=lambda: Dwell(12.0, 4.0))
    angle: Span = field(default=(0.1, 0.4), metadata=within("rad", most=1.5))
    pitch_rate: float = field(default=0.2, metadata=within("rad/s", least=1e-3))
    up: float = field(default=0.5, metadata=within("(probability)", most=1.0))
    uniforms: ClassVar[int] = 2
    in_space: ClassVar[bool] = True
    plan: ClassVar[Callback] = Callback(_climb, PLAN)


def _helix(now: Array, u: Array, params: Array, out: Array) -> None:
    rate = min(between(params[0], params[1], u[0]), 0.8 * sharpest(now))
    turn = rate * pick_side(u[1], 0.5)
    pitch_over(now, turn, params[4], between(params[2], params[3], u[2]), pick_side(u[3], params[5]), out)


@dataclass(frozen=True, kw_only=True)
class Helix(Intent):
    """Turn with climb or dive at constant speed (3-D); 60 % of the lateral limit stays free for pitching."""

    name: str = "helix"
    dwell: Dwell = field(default_factory=lambda: Dwell(20.0, 6.0))
    rate: Span = field(default=(0.1, 0.4), metadata=within("rad/s"))
    angle: Span = field(default=(0.1, 0.4), metadata=within("rad", most=1.5))
    pitch_rate: float = field(default=0.2, metadata=within("rad/s", least=1e-3))
    up: float = field(default=0.5, metadata=within("(probability)", most=1.0))
    uniforms: ClassVar[int] = 4
    in_space: ClassVar[bool] = True
    plan: ClassVar[Callback] = Callback(_helix, PLAN)


def _jink(now: Array, u: Array, params: Array, out: Array) -> None:
    duration = between(params[2], params[3], u[1])
    if now[LEFT] - duration < params[2]:  # no turn shorter than the shortest
        duration = now[LEFT]
    lateral = min(between(params[0], params[1], u[0]) * GRAVITY, now[MAX_LATERAL])
    rate = min(lateral / max(now[SPEED], _STILL), params[4])
    wish(out, duration, 0.0, rate * pick_side(u[2], 0.5), 0.0)


@dataclass(frozen=True, kw_only=True)
class Jink(Intent):
    """Short hard turns, each to a random side, so as not to be caught."""

    name: str = "jink"
    dwell: Dwell = field(default_factory=lambda: Dwell(6.0, 2.0))
    lateral: Span = field(default=(2.0, 6.0), metadata=within("g"))
    turn_time: Span = field(default=(0.5, 1.5), metadata=within("s", least=SHORTEST))
    fastest: float = field(default=2.0, metadata=within("rad/s"))
    uniforms: ClassVar[int] = 3
    plan: ClassVar[Callback] = Callback(_jink, PLAN)

    @property
    def shortest_round(self) -> float:
        """The shortest turn, s."""
        return min(self.turn_time[0], self.dwell.shortest)


def _stop_and_go(now: Array, u: Array, params: Array, out: Array) -> None:
    brake = between(params[0], params[1], u[0])
    gain = between(params[2], params[3], u[1])
    drop = max(now[SPEED] - max(params[4], now[MIN_SPEED]), 0.0)
    drop = min(drop, now[LEFT] / (1.0 / brake + 1.0 / gain))
    wish(out, drop / brake, -brake, 0.0, 0.0)
    hold(out, now[LEFT] - drop / brake - drop / gain)
    wish(out, drop / gain, gain, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class StopAndGo(Intent):
    """Brakes to near rest, waits, and returns to the speed it had; brakes less where time is short."""

    name: str = "stop-and-go"
    dwell: Dwell = field(default_factory=lambda: Dwell(15.0, 6.0))
    braking: Span = field(default=(2.0, 6.0), metadata=within("m/s^2", least=1e-3))
    starting: Span = field(default=(1.0, 4.0), metadata=within("m/s^2", least=1e-3))
    rest: float = field(default=0.0, metadata=within("m/s"))
    uniforms: ClassVar[int] = 2
    plan: ClassVar[Callback] = Callback(_stop_and_go, PLAN)


INTENTS: dict[str, type[Intent]] = {
    "straight": Straight,
    "accelerate": Accelerate,
    "turn": Turn,
    "weave": Weave,
    "orbit": Orbit,
    "climb": Climb,
    "helix": Helix,
    "jink": Jink,
    "stop-and-go": StopAndGo,
}


def make_intent(kind: str, **parameters: object) -> Intent:
    """The intent of a name in `INTENTS`, its parameters by keyword.

    Raises:
        ValueError: an unknown kind; a parameter outside its range.
        TypeError: a parameter the intent does not have.
    """
    if kind not in INTENTS:
        raise ValueError(f"make_intent: kind must be one of {', '.join(INTENTS)}; got {kind!r}. Pick a listed one.")
    return INTENTS[kind](**parameters)  # type: ignore[arg-type]
