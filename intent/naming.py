"""Intents by falling share of time, called after what they do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from jink.intent.describing import sizes, still, weaves
from jink.intent.model import Intent, IntentModel
from jink.intent.sides import spell_length

__all__ = ["named"]


def named(model: IntentModel) -> IntentModel:
    """Intents by falling share of time, called after what they do."""
    order = np.argsort(-model.intent_probs(model.mode_shares()), kind="stable")
    used: dict[str, int] = {}
    intents: list[Intent] = []
    for i in order:
        word = _word(model.intents[i], spell_length(model, int(i), 0))
        used[word] = used.get(word, 0) + 1
        intents.append(replace(model.intents[i], name=word if used[word] == 1 else f"{word} {used[word]}"))
    rates = np.array(model.generator)[np.ix_(order, order)]
    return model.with_(
        intents=tuple(intents),
        generator=tuple(map(tuple, rates.tolist())),
        initial=tuple(np.array(model.initial)[order].tolist()),
    )


def _word(intent: Intent, spell: float) -> str:
    """What an intent does in spells of so many seconds, in a word or two; straight as `describe_phase` has it."""
    if len(intent.phases) > 1:
        return "manoeuvre"
    phase = intent.phases[0]
    if weaves(phase):
        return "weave"
    (_, turn, _), (_, growth, _) = sizes(phase, spell)
    growths = [(birth.growth_mean, birth.growth_sd) for birth in phase.births]
    if still(turn, growth):
        return "straight"
    if turn > growth:
        return "turn"
    signs = {math.copysign(1.0, mean) if abs(mean) > sd else 0.0 for mean, sd in growths}
    return {frozenset({1.0}): "speed up", frozenset({-1.0}): "slow down"}.get(frozenset(signs), "change speed")
