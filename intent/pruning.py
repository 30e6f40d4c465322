"""Taking away what a fitted model does not need: births that say the same, intents, phases of templates."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from jink.intent.joining import MOST_BIRTHS, closest_joined, tidy
from jink.intent.model import IntentModel
from jink.intent.selection import freedom, shorter_models, smaller_models
from jink.intent.trainer import Trainer

if TYPE_CHECKING:
    from jink.intent.bank_torch import Batch

__all__ = ["fewer_births", "pruned"]

_HOPE = 5.0  # times its charge that a smaller model may lack before it is fitted
_FEWER_BIRTHS = 2e-4  # nats per row that a birth component must bring


def pruned(trainer: Trainer, model: IntentModel, everything: Batch) -> IntentModel:
    """Take intents and phases away from a fitted model while all tracks, charged for parameters, are none the worse.

    Held-out pieces choose the number roughly where they are few; twins that share a law cost nothing to join.
    """
    settings = trainer.settings
    rows = max(float(everything.rows), 1.0)
    while True:
        values = _values(trainer, model, everything)
        simpler = list(smaller_models(model)) if len(model.intents) > 2 else []
        simpler += shorter_models(model)
        if not simpler:
            return model
        ranked = sorted(
            ((trainer.mean(candidate, everything), how, candidate) for how, candidate in simpler),
            key=lambda entry: (-entry[0], entry[1]),
        )
        begun, _, candidate = ranked[0]
        charge = 0.5 * (freedom(model) - freedom(candidate)) * math.log(rows) / rows
        if begun < values[0] - _HOPE * charge:
            return model
        smaller = tidy(trainer.climb(candidate, everything, "prune", settings.fewer))
        if any(new < old - charge for new, old in zip(_values(trainer, smaller, everything), values, strict=True)):
            return model
        model = smaller


def _values(trainer: Trainer, model: IntentModel, everything: Batch) -> tuple[float, float]:
    """Nats per row with the floor that outliers get and without: rare phases show in the second alone."""
    return trainer.mean(model, everything), trainer.mean(model, everything, whole=True)


def fewer_births(trainer: Trainer, model: IntentModel, fit: Batch) -> IntentModel:
    """Join births of one phase that say the same: every component is a mode, and modes cost time."""
    value = trainer.mean(model, fit)
    for i in range(len(model.intents)):
        for k in range(len(model.intents[i].phases)):
            for _ in range(MOST_BIRTHS):
                phase = model.intents[i].phases[k]
                if len(phase.births) < 2:
                    break
                births = tuple(closest_joined(list(phase.births)))
                phases = list(model.intents[i].phases)
                phases[k] = replace(phase, births=births)
                intents = list(model.intents)
                intents[i] = replace(intents[i], phases=tuple(phases))
                tried = model.with_(intents=tuple(intents))
                reached = trainer.mean(tried, fit)
                if reached < value - _FEWER_BIRTHS:
                    break
                model, value = tried, reached
    return tidy(model)
