"""From lessons to a model: one intent, too many, fewer and fewer, more if they pay, the best number, all tracks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.climbing import climb
from jink.intent.diary import Diary
from jink.intent.first_guess import Guess, first_intents, guess, one_intent, restless_intents
from jink.intent.joining import MOST_BIRTHS, closest_joined, tidy
from jink.intent.lessons import Lessons, first_spoiled
from jink.intent.model import Intent, IntentModel
from jink.intent.progress import Progress
from jink.intent.proposals import larger_models
from jink.intent.selection import (
    WORTH,
    CurvePoint,
    choose,
    curve_of,
    freedom,
    row_scores,
    shorter_models,
    smaller_models,
    track_scores,
)

if TYPE_CHECKING:
    from jink.intent.bank_torch import Batch

__all__ = ["Outcome", "Settings", "learn"]

Floats = NDArray[np.float64]
_OUTLIER = 25.0  # nats below the median row
_PASSES, _MOST_OUTLIERS = 12, 0.2
_HOPE = 5.0  # times its charge that a smaller model may lack before it is fitted
_FEWEST_HEAT = 12  # pieces that rivals run over
_RIVALS = 4  # of the larger models tried, how many are fitted further
_FEWER_BIRTHS = 2e-4  # nats per row that a birth component must bring


@dataclass(frozen=True)
class Settings:
    """How much work each stage may do; quasi-Newton steps.

    Args:
        intents: how many; None: chosen.
        most: intents to begin with.
        single, heat, first, fewer, tries, more, last: steps of the stages.
        rounds: how often an intent that may be lacking is looked for.
        rivals: how many of the best smaller models are fitted at each number of intents.
        seconds: processor budget; None: none. Climbs stop when it is spent, so results then depend on the machine.
        threads: parts a batch is cut into; the last digits depend on it.
        device: of the climbs.
        seed: of everything random.
    """

    intents: int | None = None
    most: int = 7
    single: int = 25
    heat: int = 15
    first: int = 70
    fewer: int = 15
    tries: int = 5
    more: int = 25
    rounds: int = 3
    last: int = 40
    rivals: int = 1
    seconds: float | None = None
    threads: int = 2
    device: str = "cpu"
    seed: int = 0


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


class _Stopwatch:
    """Seconds left."""

    def __init__(self, seconds: float | None) -> None:
        self.end = math.inf if seconds is None else time.monotonic() + seconds

    @property
    def over(self) -> bool:
        return time.monotonic() > self.end


class _Trainer:
    """Climbs of one training: the batches, the sizes, what a row costs at most, and who is told."""

    def __init__(self, lessons: Lessons, settings: Settings, tell: Callable[[Progress], None]) -> None:
        self.lessons, self.settings, self.tell = lessons, settings, tell
        self.sigma = None if lessons.noise_sd is None else float(np.mean(lessons.noise_sd))
        self.found: Guess = guess(lessons.pieces, self.sigma)
        self.floor = -math.inf
        self.watch = _Stopwatch(settings.seconds)

    @property
    def speed(self) -> float:
        """Standard deviation of a velocity component before anything is known; m/s."""
        return self.found.sizes.speed / math.sqrt(self.lessons.pieces.axes)

    def set_floor(self, scores: Floats, batch: Batch) -> None:
        """What a row costs at most: a gross outlier then pulls at nothing."""
        detected = batch.detected.cpu().numpy()
        self.floor = float(np.median(scores[detected])) - _OUTLIER if detected.any() else -math.inf

    def with_noise(self, model: IntentModel) -> IntentModel:
        return model if self.lessons.noise_sd is None else model.with_(noise_sd=self.lessons.noise_sd)

    def batch(self, chosen: NDArray[np.int64] | None) -> Batch:
        return self.lessons.batch(chosen, self.speed, self.settings.device)

    def climb(self, model: IntentModel, batch: Batch, stage: str, steps: int, tolerance: float = 1e-5) -> IntentModel:
        def report(step: int, value: float) -> bool:
            self.tell(Progress(stage, step, steps, len(model.intents), value))
            return self.watch.over

        found = climb(
            model,
            batch,
            self.found.sizes,
            steps=steps,
            tolerance=tolerance,
            floor=self.floor,
            threads=self.settings.threads,
            report=report,
        )
        return found.model

    def score(self, model: IntentModel, batch: Batch) -> tuple[Floats, Floats]:
        return track_scores(model, batch, self.floor, self.settings.threads)

    def mean(self, model: IntentModel, batch: Batch) -> float:
        scores, rows = self.score(model, batch)
        return float(scores.sum() / max(float(rows.sum()), 1.0))


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
    trainer = _Trainer(lessons, settings, tell)
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
        model = _fewer_births(trainer, kept.models[count], fit)
        model = tidy(trainer.climb(model, everything, "final", settings.last, 2e-6))
        if wanted is None:
            model = _pruned(trainer, model, everything)
        return model, {"log_likelihood": trainer.mean(model, everything)}

    model, numbers = diary.stage("final", last)
    return Outcome(
        _named(model),
        curve_of(kept.scores, rows, settings.seed),
        resolvable,
        float(numbers["log_likelihood"]),
        left_out,
    )


def _clean(trainer: _Trainer, diary: Diary) -> tuple[int, IntentModel]:
    """Fit one intent; rows it finds absurd are gross outliers: they are left out and it is fitted again."""
    settings, axes = trainer.settings, trainer.lessons.pieces.axes
    everything, left_out = trainer.batch(None), 0
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


def _without_outliers(trainer: _Trainer, model: IntentModel) -> tuple[Tracks, int]:
    """Leave out the first row of every run of absurd ones, again and again: those after it may only suffer from it."""
    pieces, dropped = trainer.lessons.pieces, 0
    rows = int(np.isfinite(pieces.measurements[..., 0]).sum())
    for _ in range(_PASSES):
        batch = trainer.lessons._replace(pieces=pieces).batch(None, trainer.speed, trainer.settings.device)
        scores = row_scores(model, batch, trainer.settings.threads)
        bad = first_spoiled(scores, batch.detected.cpu().numpy(), _OUTLIER)
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


def _many(trainer: _Trainer, diary: Diary, fit: Batch, held: Batch, found: _Found) -> None:
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
    trainer: _Trainer, diary: Diary, name: str, model: IntentModel, fit: Batch, held: Batch, found: _Found, least: int
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


def _larger(trainer: _Trainer, model: IntentModel, fit: Batch) -> IntentModel:
    """The best model with one intent more, fitted."""
    settings = trainer.settings
    tried = _leader(trainer, list(larger_models(model, trainer.found)), settings.tries, _RIVALS, apart=4)
    best = _leader(trainer, tried, 2 * settings.tries, 1)[0]
    return tidy(trainer.climb(best, fit, "more", settings.more))


def _leader(trainer: _Trainer, models: list[IntentModel], steps: int, kept: int, apart: int = 2) -> list[IntentModel]:
    """The best few of many models after some steps on every second (``apart``) of the pieces that are fitted."""
    pieces = trainer.lessons.fit
    some = trainer.batch(pieces[:: min(apart, max(len(pieces) // _FEWEST_HEAT, 1))])
    tried = [trainer.climb(model, some, "heat", steps) for model in models]
    return sorted(tried, key=lambda model: -trainer.mean(model, some))[:kept]


def _smaller(trainer: _Trainer, model: IntentModel, fit: Batch) -> IntentModel:
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


def _pruned(trainer: _Trainer, model: IntentModel, everything: Batch) -> IntentModel:
    """Take intents and phases away from a fitted model while all tracks, charged for parameters, are none the worse.

    Held-out pieces choose the number roughly where they are few; twins that share a law cost nothing to join.
    """
    settings = trainer.settings
    rows = max(float(everything.rows), 1.0)
    while True:
        value = trainer.mean(model, everything)
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
        if begun < value - _HOPE * charge:
            return model
        smaller = tidy(trainer.climb(candidate, everything, "prune", settings.fewer))
        if trainer.mean(smaller, everything) < value - charge:
            return model
        model = smaller
    return model


def _fewer_births(trainer: _Trainer, model: IntentModel, fit: Batch) -> IntentModel:
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


def _named(model: IntentModel) -> IntentModel:
    """Intents by falling share of time, called after what they do."""
    order = np.argsort(-model.intent_probs(model.mode_shares()), kind="stable")
    used: dict[str, int] = {}
    intents: list[Intent] = []
    for i in order:
        word = _word(model.intents[i])
        used[word] = used.get(word, 0) + 1
        intents.append(replace(model.intents[i], name=word if used[word] == 1 else f"{word} {used[word]}"))
    rates = np.array(model.generator)[np.ix_(order, order)]
    return model.with_(
        intents=tuple(intents),
        generator=tuple(map(tuple, rates.tolist())),
        initial=tuple(np.array(model.initial)[order].tolist()),
    )


def _word(intent: Intent) -> str:
    """What an intent does, in a word or two."""
    if len(intent.phases) > 1:
        return "manoeuvre"
    phase = intent.phases[0]
    if phase.law.swing is not None:
        return "weave"
    turn = max(abs(birth.turn_mean) + birth.turn_sd for birth in phase.births)
    growths = [(birth.growth_mean, birth.growth_sd) for birth in phase.births]
    growth = max(abs(mean) + sd for mean, sd in growths)
    if turn < math.radians(1.0) and growth < 0.007:
        return "straight"
    if turn > growth:
        return "turn"
    signs = {math.copysign(1.0, mean) if abs(mean) > sd else 0.0 for mean, sd in growths}
    return {frozenset({1.0}): "speed up", frozenset({-1.0}): "slow down"}.get(frozenset(signs), "change speed")
