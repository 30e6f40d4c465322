"""Left or right: what turn rate an intent keeps over a spell, and whether it stays on one side."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from jink.intent.laws import Birth, Phase

if TYPE_CHECKING:
    from jink.intent.model import IntentModel

__all__ = ["keeps_side", "spell_length", "spell_turn"]

_ENDLESS = 1e9  # s


def spell_length(model: IntentModel, intent: int, phase: int) -> float:
    """Mean time that one draw of shape parameters is kept, s; a renewal ends it, but not the intent (`lasting`)."""
    phases = model.intents[intent].phases
    if phase < len(phases) - 1:
        return phases[phase].duration
    leaving = model.intents[intent].renewal - model.generator[intent][intent]
    return 1.0 / leaving if leaving > 1.0 / _ENDLESS else _ENDLESS


def spell_turn(phase: Phase, birth: Birth, lasts: float) -> tuple[float, float]:
    """Mean and standard deviation of the turn rate averaged over a spell, rad/s.

    Model: ``w' = r (m - w) + noise``, ``w(0) ~ N(b, s^2)``; over L seconds a share ``k = (1 - e^-rL) / (r L)`` of the
    start is kept, the rest is the mean m and what its noise leaves, ``(1 - k) q / (r^2 L)``. A law that forgets nothing
    keeps its start; how far it drifts from there is left out, as it says nothing of sides.

    Args:
        phase: whose law it is.
        birth: one of its components.
        lasts: L, s.
    """
    law = phase.law
    forgotten = law.turn_rate * lasts
    if forgotten < 1e-6:
        return birth.turn_mean, birth.turn_sd
    kept = -math.expm1(-forgotten) / forgotten
    noise = (1.0 - kept) * law.turn_noise / (law.turn_rate**2 * lasts)
    return kept * birth.turn_mean + (1.0 - kept) * law.turn_mean, math.hypot(kept * birth.turn_sd, math.sqrt(noise))


def keeps_side(phase: Phase, birth: Birth, lasts: float, least: float = 1.0) -> bool:
    """Whether the turn of a spell is further than ``least`` standard deviations from none."""
    mean, sd = spell_turn(phase, birth, lasts)
    return abs(mean) > least * sd
