"""Intents that a model may lack: a weave of some period, a turn or a change of speed of some size, part of another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jink.intent.first_guess import STILL, Guess, law_like, level, shaky, weave_of, weave_periods
from jink.intent.joining import settled
from jink.intent.laws import Birth, Phase
from jink.intent.model import Intent, IntentModel

__all__ = ["larger_models"]

_SPELL = 2.5  # periods that a weave lasts
_TURNS = (0.3, 0.85)  # quantiles of what windows show
_GROWTHS = (0.1, 0.35, 0.75)
_NARROW, _WIDE = 0.2, 0.6  # spreads of the two parts of a split birth, as shares of its own
_SHARE = 0.15  # of all switches


def larger_models(model: IntentModel, found: Guess) -> Iterator[IntentModel]:
    """The model with one more intent, one after the other.

    Weaves of many periods; turns that keep their rate and turns that shake about it; changes of speed; and every intent
    split into one that hardly changes speed and one that does.

    Args:
        model: with one intent or more.
        found: what windows of the tracks show.
    """
    sizes, flat = found.sizes, model.axes == 2
    still_growth, still_turn = STILL * sizes.growth, STILL * sizes.turn
    for period in weave_periods(sizes):
        yield _with_intent(model, weave_of(model.axes, sizes, period), _SPELL * period)
    law = law_like(model.axes, sizes)
    for q in _TURNS:
        rate = level(found.turns, q, sizes.turn)
        birth = Birth(1.0, 0.0, still_growth, rate if flat else 0.0, 0.4 * rate if flat else rate)
        yield _with_intent(model, Phase(law, (birth,), mirrored=flat))
    if flat:
        yield _with_intent(model, shaky(sizes, level(found.turns, _TURNS[1], sizes.turn)))
    for q in _GROWTHS:
        size = level(np.abs(found.growths), q, sizes.growth)
        births = tuple(Birth(0.5, side * size, 0.4 * size, 0.0, still_turn) for side in (1.0, -1.0))
        yield _with_intent(model, Phase(law, births))
    for i in range(len(model.intents)):
        split = _split(model, i)
        if split is not None:
            yield split


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
    lasts = -1.0 / model.generator[number][number] if len(model.intents) > 1 else None
    return _with_intent(model.with_(intents=tuple(intents)), replace(phase, births=sides), lasts)


def _with_intent(model: IntentModel, phase: Phase, lasts: float | None = None) -> IntentModel:
    """One more intent, that takes a share of every switch and leads everywhere; ``lasts`` s, or as long as others."""
    names = [intent.name for intent in model.intents]
    name = next(letter for letter in map(chr, range(ord("a"), ord("z") + 1)) if letter not in names)
    count, old = len(model.intents), np.array(model.generator)
    leaving = -np.diag(old) if count > 1 else np.full(1, 1.0 / phase.duration)
    rates = np.zeros((count + 1, count + 1))
    rates[:count, :count] = (old - np.diag(np.diag(old))) * (1.0 - _SHARE)
    rates[:count, count] = leaving * (_SHARE if count > 1 else 1.0)
    rates[count, :count] = (float(np.median(leaving)) if lasts is None else 1.0 / lasts) / count
    np.fill_diagonal(rates, -rates.sum(axis=1))
    made = model.with_(
        intents=(*model.intents, Intent(name, (phase,))),
        generator=tuple(map(tuple, rates.tolist())),
        initial=(*(np.array(model.initial) * (1.0 - _SHARE)).tolist(), _SHARE),
    )
    return settled(made)
