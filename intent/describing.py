"""Intents in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from jink.intent.laws import Phase
from jink.intent.sides import spell_turn

__all__ = ["describe_intent", "describe_phase", "say_lasting", "sizes", "still", "weaves"]

_STILL_TURN = math.radians(1.0)  # rad/s: slower than this nobody calls a turn
_STILL_GROWTH = 0.007  # 1/s
_STILL_SWAY = math.radians(2.0)  # rad: a course that sways by less is a straight line that trembles
_RIVAL = 3.0
_ENDLESS = 1e9  # s
_FOR_EVER = 1e6  # s


def describe_intent(
    number: int, name: str, phases: Sequence[Phase], spells: Sequence[float], lasting: str, share: float
) -> str:
    """One line: what it does, for how long, how often.

    Args:
        number: shown first.
        name: shown if it says more than the number.
        phases: of the intent.
        spells: how long each phase keeps what it began with; s.
        lasting: how long the intent lasts, from `say_lasting`.
        share: of the time in the long run.
    """
    label = f"intent {number}" if name in (f"intent {number}", str(number)) else f"intent {number} ({name})"
    doing = ", then ".join(describe_phase(phase, spell) for phase, spell in zip(phases, spells, strict=True))
    return f"{label}: {doing}, {lasting}, {100 * share:.0f} % of the time"


def say_lasting(seconds: float, seen: bool) -> str:
    """A mean duration in words.

    Args:
        seconds: inf: for ever.
        seen: it was counted on tracks; else it is what a chain implies, and the words say so.
    """
    if seconds >= _FOR_EVER:
        return "never ends"
    return f"lasts {_short(seconds)} s" + ("" if seen else " by its chain")


def weaves(phase: Phase) -> bool:
    """A weave that shows: one that hardly moves the course is a straight line that trembles."""
    swing = phase.law.swing
    return swing is not None and max(abs(b.turn_mean) + b.turn_sd for b in phase.births) > _STILL_SWAY * swing[0]


def sizes(phase: Phase, spell: float = math.inf) -> tuple[tuple[float, float, int], tuple[float, float, int]]:
    """Turn rate (rad/s; none where it swings) and growth (1/s) of spells: smallest and largest size, common sign."""
    growth = _span([(b.growth_mean, b.growth_sd) for b in phase.births], phase.law.growth_mean)
    turn = _span([spell_turn(phase, birth, min(spell, _ENDLESS)) for birth in phase.births], 0.0)
    return (turn if phase.law.swing is None else (0.0, 0.0, 0)), growth


def still(turn: float, growth: float) -> bool:
    """Whether sizes of turn rate (rad/s) and growth (1/s) are so small that a person says straight."""
    return turn <= _STILL_TURN and growth <= _STILL_GROWTH


def describe_phase(phase: Phase, spell: float = math.inf) -> str:
    """What a target does in one phase that lasts ``spell`` seconds; turn rates are those of whole spells."""
    law = phase.law
    if law.swing is not None and weaves(phase):
        period = 2.0 * math.pi / law.swing[0]
        fastest = max(abs(mean) + sd for mean, sd in (spell_turn(phase, birth, 0.0) for birth in phase.births))
        return f"weave of {_short(period)} s, up to {_short(math.degrees(fastest))} deg/s"
    (low_turn, high_turn, sign), (low, high, growing) = sizes(phase, spell)
    parts = []
    turning, changing = not still(high_turn, 0.0), not still(0.0, high)
    if turning and changing:
        turning, changing = high_turn * _RIVAL > high, high * _RIVAL > high_turn
    if turning:
        side = "either way" if phase.mirrored or sign == 0 else ("to the left" if sign > 0 else "to the right")
        parts.append(f"turn, {_range(math.degrees(low_turn), math.degrees(high_turn))} deg/s {side}")
    if changing:
        word = "speed up or slow down" if growing == 0 else ("speed up" if growing > 0 else "slow down")
        parts.append(f"{word}, {_range(100 * low, 100 * high)} %/s")
    return " and ".join(parts) or "straight"


def _span(components: Sequence[tuple[float, float]], mean: float) -> tuple[float, float, int]:
    """Smallest and largest size within one standard deviation, and the common sign (0: both occur)."""
    low = min(max(abs(centre) - sd, 0.0) for centre, sd in components)
    high = max(max(abs(centre) + sd for centre, sd in components), abs(mean))
    signs = {0 if abs(centre) <= sd else int(math.copysign(1, centre)) for centre, sd in components}
    return low, high, signs.pop() if len(signs) == 1 else 0


def _range(low: float, high: float) -> str:
    return f"{_short(low)}-{_short(high)}" if _short(low) != _short(high) else _short(high)


def _short(value: float) -> str:
    return f"{value:.2g}" if value < 100 else f"{value:.0f}"
