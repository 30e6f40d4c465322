"""From lessons to a model: one intent, too many, fewer and fewer, more if they pay, the best number, all tracks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.diary import Diary
from jink.intent.endings import with_endings
from jink.intent.first_guess import first_intents, guess, one_intent, restless_intents
from jink.intent.joining import tidy
from jink.intent.lessons import Lessons, first_spoiled
from jink.intent.model import IntentModel
from jink.intent.naming import named
from jink.intent.progress import Progress
from jink.intent.proposals import larger_models
from jink.intent.pruning import fewer_births, pruned
from jink.intent.selection import (
    WORTH,
    CurvePoint,
    choose,
    curve_of,
    row_scores,
    smaller_models,
)
from jink.intent.trainer import Settings, Trainer

if TYPE_CHECKING:
    from jink.intent.bank_torch import Batch

__all__ = ["Outcome", "Settings", "learn"]

Floats = NDArray[np.float64]
_ABSURD = 25.0  # nats below the median row
_PASSES, _MOST_OUTLIERS = 12, 0.2
_FEWEST_HEAT = 12  # pieces that rivals run over
_RIVALS = 4  # of the larger models tried, how many are fitted further


class Outcome(NamedTuple):
    """What was learned.

    Model, selection curve, whether intents can be told apart, mean log-likelihood of all rows, and how many rows were
    left out as gross outliers.
    """

    model: IntentModel
    curve: tuple[CurvePoint, ...]
    resolvable: bool
    log_likelihood: float
    left_out: int


def learn(lessons: Lessons, settings: Settings, diary: Diary, tell: Callable[[Progress], None]) -> Outcome:
    """The whole schedule; every stage is written to the diary as it ends.

    Args:
        lessons: from `make_lessons`.
        settings: how much work to do.
        diary: of this training.
        tell: called with the progress.

    Source: DESIGN of Jink; smaller models by likelihood on tracks that were not fitted.
    """
    tell(Progress("clusters", 0, 0, 0, math.nan))
    trainer = Trainer(lessons, settings, tell)
    left_out, single = _clean(trainer, diary)
    lessons = trainer.lessons
    fit, held = trainer.batch(lessons.fit), trainer.batch(lessons.held)
    scores, rows = trainer.score(single, held)
    kept = _Found({1: single}, {1: scores})
    if settings.intents != 1:
        _many(trainer, diary, fit, held, kept)
    wanted = settings.intents
    if wanted is None:
        count, resolvable = choose(kept.scores, rows, settings.seed)
    elif wanted in kept.models:
        count, resolvable = wanted, wanted > 1
    else:
        raise ValueError(
            f"IntentLearner: intents must be one of {', '.join(map(str, sorted(kept.models)))} for these tracks; got "
            f"{wanted}. Leave it out to have it chosen."
        )
    everything = trainer.batch(None)

    def last() -> tuple[IntentModel, dict[str, Any]]:
        model = fewer_births(trainer, kept.models[count], fit)
        model = tidy(trainer.climb(model, everything, "final", settings.last, 2e-6))
        if wanted is None:
            model = pruned(trainer, model, everything)
        return model, {"log_likelihood": trainer.mean(model, everything)}

    model, numbers = diary.stage("final", last)
    return Outcome(
        with_endings(named(model), trainer.lessons.pieces, settings.threads),
        curve_of(kept.scores, rows, settings.seed),
        resolvable,
        float(numbers["log_likelihood"]),
        left_out,
    )


def _clean(trainer: Trainer, diary: Diary) -> tuple[int, IntentModel]:
    """Fit one intent; rows it finds absurd are gross outliers: they are left out and it is fitted again."""
    settings, axes = trainer.settings, trainer.lessons.pieces.axes
    everything, left_out = trainer.batch(None), trainer.lessons.left_out
    model = trainer.with_noise(one_intent(trainer.found, axes))
    for attempt in range(2):
        trainer.set_floor(row_scores(model, everything, settings.threads), everything)

        def single(start: IntentModel = model) -> tuple[IntentModel, dict[str, Any]]:
            return trainer.climb(start, trainer.batch(trainer.lessons.fit), "one intent", settings.single), {}

        model, _ = diary.stage(f"one-intent-{attempt + 1}", single)
        pieces, dropped = _without_outliers(trainer, model) if attempt == 0 else (trainer.lessons.pieces, 0)
        everything = trainer.batch(None)
        if not dropped:
            break
        left_out += dropped
        trainer.lessons = trainer.lessons._replace(pieces=pieces)
        trainer.found = guess(pieces, trainer.sigma)
        model, everything = trainer.with_noise(one_intent(trainer.found, axes)), trainer.batch(None)
    trainer.set_floor(row_scores(model, everything, settings.threads), everything)
    return left_out, model


def _without_outliers(trainer: Trainer, model: IntentModel) -> tuple[Tracks, int]:
    """Leave out the first row of every run of absurd ones, again and again: those after it may only suffer from it."""
    pieces, dropped = trainer.lessons.pieces, 0
    rows = int(np.isfinite(pieces.measurements[..., 0]).sum())
    for _ in range(_PASSES):
        batch = trainer.lessons._replace(pieces=pieces).batch(None, trainer.speed, trainer.settings.device)
        scores = row_scores(model, batch, trainer.settings.threads)
        bad = first_spoiled(scores, batch.detected.cpu().numpy(), _ABSURD)
        if not bad.any():
            return pieces, dropped
        dropped += int(bad.sum())
        pieces = replace(pieces, measurements=np.where(bad[..., None], np.nan, pieces.measurements))
    return (pieces, dropped) if dropped < _MOST_OUTLIERS * rows else (trainer.lessons.pieces, 0)


class _Found(NamedTuple):
    """What the stages found: by number of intents, the model and the held-out scores of its tracks."""

    models: dict[int, IntentModel]
    scores: dict[int, Floats]

    def offer(self, model: IntentModel, scores: Floats) -> None:
        """Keep a model if it is the best of its number of intents."""
        count = len(model.intents)
        if count not in self.scores or scores.sum() > self.scores[count].sum():
            self.models[count], self.scores[count] = model, scores


def _many(trainer: Trainer, diary: Diary, fit: Batch, held: Batch, found: _Found) -> None:
    """Fit too many intents, take one away at a time, and see whether the number chosen so far lacks one."""
    settings, axes = trainer.settings, trainer.lessons.pieces.axes

    def first() -> tuple[IntentModel, dict[str, Any]]:
        starts = [start(trainer.found, axes, settings.most) for start in (first_intents, restless_intents)]
        start = _leader(trainer, [trainer.with_noise(start) for start in starts], settings.heat, 1)[0]
        return tidy(trainer.climb(start, fit, "fit", settings.first)), {}

    model, _ = diary.stage("fit", first)
    rows = _reduce(trainer, diary, "fewer", model, fit, held, found, 2)
    for attempt in range(settings.rounds):
        wanted = settings.intents
        count = choose(found.scores, rows, settings.seed)[0] if wanted is None else wanted - 1
        count = max(2, min(count, max(found.models)))
        if count not in found.models:
            return
        base, before = found.models[count], found.scores[count]

        def larger(start: IntentModel = base) -> tuple[IntentModel, dict[str, Any]]:
            return _larger(trainer, start, fit), {}

        model, _ = diary.stage(f"more-{attempt + 1}", larger)
        gain = trainer.score(model, held)[0] - before
        error = float(gain.std() * math.sqrt(len(rows)) / rows.sum())
        if float(gain.sum() / rows.sum()) <= max(2.0 * error, WORTH):
            return
        _reduce(trainer, diary, f"fewer-{attempt + 1}", model, fit, held, found, max(2, count - 1))


def _reduce(
    trainer: Trainer, diary: Diary, name: str, model: IntentModel, fit: Batch, held: Batch, found: _Found, least: int
) -> Floats:
    """From a model down to ``least`` intents; returns the measured rows of the held-out tracks."""
    while True:
        count = len(model.intents)
        scores, rows = trainer.score(model, held)
        found.offer(model, scores)
        value = float(scores.sum() / max(float(rows.sum()), 1.0))
        trainer.tell(Progress("merge", 0, 0, count, value, held_out=True))
        if count <= least:
            return rows

        def fewer(start: IntentModel = model) -> tuple[IntentModel, dict[str, Any]]:
            return _smaller(trainer, start, fit), {}

        model, _ = diary.stage(f"{name}-{count - 1}", fewer)


def _larger(trainer: Trainer, model: IntentModel, fit: Batch) -> IntentModel:
    """The best model with one intent more, fitted."""
    settings = trainer.settings
    tried = _leader(trainer, list(larger_models(model, trainer.found)), settings.tries, _RIVALS, apart=4)
    best = _leader(trainer, tried, 2 * settings.tries, 1)[0]
    return tidy(trainer.climb(best, fit, "more", settings.more))


def _leader(trainer: Trainer, models: list[IntentModel], steps: int, kept: int, apart: int = 2) -> list[IntentModel]:
    """The best few of many models after some steps on every second (``apart``) of the pieces that are fitted."""
    pieces = trainer.lessons.fit
    some = trainer.batch(pieces[:: min(apart, max(len(pieces) // _FEWEST_HEAT, 1))])
    tried = [trainer.climb(model, some, "heat", steps) for model in models]
    return sorted(tried, key=lambda model: -trainer.mean(model, some))[:kept]


def _smaller(trainer: Trainer, model: IntentModel, fit: Batch) -> IntentModel:
    """The best model with one intent less, fitted."""
    settings = trainer.settings
    ranked = sorted(
        ((trainer.mean(candidate, fit), how, candidate) for how, candidate in smaller_models(model)),
        key=lambda entry: (-entry[0], entry[1]),
    )
    best, chosen = -math.inf, None
    for _, _, candidate in ranked[: settings.rivals]:
        tried = tidy(trainer.climb(candidate, fit, "merge", settings.fewer))
        value = trainer.mean(tried, fit)
        if value > best:
            best, chosen = value, tried
    if chosen is None:
        raise AssertionError("every model of two or more intents has a smaller one")
    return chosen
