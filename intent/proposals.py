"""Intents that a model may lack: a weave of some period, a turn or a change of speed of some size."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from jink.intent.first_guess import STILL, Guess, law_like, level
from jink.intent.joining import settled
from jink.intent.laws import Birth, Phase
from jink.intent.model import Intent, IntentModel

__all__ = ["larger_models"]

_PERIODS = (0.06, 0.1, 0.16, 0.26)  # of a piece
_TURNS = (0.3, 0.85)  # quantiles of what windows show
_GROWTHS = (0.1, 0.35, 0.75)
_SHARE = 0.15  # of all switches


def larger_models(model: IntentModel, found: Guess) -> Iterator[IntentModel]:
    """The model with one more intent, one after the other.

    Args:
        model: with one intent or more.
        found: what windows of the tracks show.
    """
    sizes, flat = found.sizes, model.axes == 2
    still_growth, still_turn = STILL * sizes.growth, STILL * sizes.turn
    for share in _PERIODS:
        natural = 2.0 * math.pi / (share * sizes.duration)
        birth = Birth(1.0, 0.0, still_growth, 0.0, sizes.turn, swing_sd=0.5 * sizes.turn * natural)
        yield _with_intent(model, Phase(law_like(model.axes, sizes, (natural, 0.05)), (birth,)))
    law = law_like(model.axes, sizes)
    for q in _TURNS:
        rate = level(found.turns, q, sizes.turn)
        birth = Birth(1.0, 0.0, still_growth, rate if flat else 0.0, 0.4 * rate if flat else rate)
        yield _with_intent(model, Phase(law, (birth,), mirrored=flat))
    for q in _GROWTHS:
        size = level(np.abs(found.growths), q, sizes.growth)
        births = tuple(Birth(0.5, side * size, 0.4 * size, 0.0, still_turn) for side in (1.0, -1.0))
        yield _with_intent(model, Phase(law, births))


def _with_intent(model: IntentModel, phase: Phase) -> IntentModel:
    """One more intent, that takes a share of every switch and leads everywhere."""
    names = [intent.name for intent in model.intents]
    name = next(letter for letter in map(chr, range(ord("a"), ord("z") + 1)) if letter not in names)
    count, old = len(model.intents), np.array(model.generator)
    leaving = -np.diag(old) if count > 1 else np.full(1, 1.0 / phase.duration)
    rates = np.zeros((count + 1, count + 1))
    rates[:count, :count] = (old - np.diag(np.diag(old))) * (1.0 - _SHARE)
    rates[:count, count] = leaving * (_SHARE if count > 1 else 1.0)
    rates[count, :count] = float(np.median(leaving)) / count
    np.fill_diagonal(rates, -rates.sum(axis=1))
    made = model.with_(
        intents=(*model.intents, Intent(name, (phase,))),
        generator=tuple(map(tuple, rates.tolist())),
        initial=(*(np.array(model.initial) * (1.0 - _SHARE)).tolist(), _SHARE),
    )
    return settled(made)
