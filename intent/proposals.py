"""Intents that a model may lack: a weave of some period, a turn or a change of speed of some size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jink.intent.first_guess import STILL, Guess, law_like, level
from jink.intent.joining import settled
from jink.intent.laws import Birth, Phase
from jink.intent.model import Intent, IntentModel

__all__ = ["larger_models"]

_PERIODS = (0.08, 0.14, 0.24)  # of a piece
_SPELL = 2.5  # periods that a weave lasts
_GROWTH = 0.35  # quantile of what windows show
_NARROW, _WIDE = 0.2, 0.6  # spreads of the two parts of a split birth, as shares of its own
_SHARE = 0.15  # of all switches


def larger_models(model: IntentModel, found: Guess) -> Iterator[IntentModel]:
    """The model with one more intent, one after the other.

    Weaves of a few periods, and of the period that turns to and fro would make; changes of speed; and every intent
    split into one that hardly changes speed and one that does.

    Args:
        model: with one intent or more.
        found: what windows of the tracks show.
    """
    sizes = found.sizes
    naturals = [2.0 * math.pi / (share * sizes.duration) for share in _PERIODS]
    naturals += [-math.pi * model.generator[i][i] for i in range(len(model.intents)) if _turns(model.intents[i])]
    for natural in naturals:
        if natural <= 0.0:
            continue
        birth = Birth(1.0, 0.0, STILL * sizes.growth, 0.0, 1.5 * sizes.turn, swing_sd=0.5 * sizes.turn * natural)
        phase = Phase(law_like(model.axes, sizes, (natural, 0.05)), (birth,))
        yield _with_intent(model, phase, _SPELL * 2.0 * math.pi / natural)
    size = level(np.abs(found.growths), _GROWTH, sizes.growth)
    births = tuple(Birth(0.5, side * size, 0.4 * size, 0.0, STILL * sizes.turn) for side in (1.0, -1.0))
    yield _with_intent(model, Phase(law_like(model.axes, sizes), births))
    for i in range(len(model.intents)):
        split = _split(model, i)
        if split is not None:
            yield split


def _turns(intent: Intent) -> bool:
    phase = intent.phases[0]
    return len(intent.phases) == 1 and phase.mirrored and phase.law.swing is None


def _split(model: IntentModel, number: int) -> IntentModel | None:
    """One intent as two: its speed hardly changes, or it does, either way."""
    intent = model.intents[number]
    phase = intent.phases[0]
    widest = max(phase.births, key=lambda birth: birth.weight * birth.growth_sd)
    if len(intent.phases) > 1 or widest.growth_sd <= 0.0:
        return None
    narrow = tuple(replace(birth, growth_sd=_NARROW * birth.growth_sd) for birth in phase.births)
    law = replace(phase.law, growth_noise=_NARROW**2 * phase.law.growth_noise)
    intents = list(model.intents)
    intents[number] = replace(intent, phases=(replace(phase, births=narrow, law=law),))
    sides = tuple(
        replace(
            widest,
            weight=0.5,
            growth_mean=widest.growth_mean + side * 1.2 * widest.growth_sd,
            growth_sd=_WIDE * widest.growth_sd,
        )
        for side in (1.0, -1.0)
    )
    lasting = -1.0 / model.generator[number][number] if len(model.intents) > 1 else None
    return _with_intent(model.with_(intents=tuple(intents)), replace(phase, births=sides), lasting)


def _with_intent(model: IntentModel, phase: Phase, lasting: float | None = None) -> IntentModel:
    """One more intent, that takes a share of every switch and leads everywhere; ``lasting`` s, or as long as others."""
    names = [intent.name for intent in model.intents]
    name = next(letter for letter in map(chr, range(ord("a"), ord("z") + 1)) if letter not in names)
    count, old = len(model.intents), np.array(model.generator)
    leaving = -np.diag(old) if count > 1 else np.full(1, 1.0 / phase.duration)
    rates = np.zeros((count + 1, count + 1))
    rates[:count, :count] = (old - np.diag(np.diag(old))) * (1.0 - _SHARE)
    rates[:count, count] = leaving * (_SHARE if count > 1 else 1.0)
    rates[count, :count] = (float(np.median(leaving)) if lasting is None else 1.0 / lasting) / count
    np.fill_diagonal(rates, -rates.sum(axis=1))
    made = model.with_(
        intents=(*model.intents, Intent(name, (phase,))),
        generator=tuple(map(tuple, rates.tolist())),
        initial=(*(np.array(model.initial) * (1.0 - _SHARE)).tolist(), _SHARE),
    )
    return settled(made)
