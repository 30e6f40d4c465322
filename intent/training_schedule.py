"""From lessons to a model: one intent, too many, fewer and fewer, a weave if it pays, the best number, all tracks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.intent.climbing import climb
from jink.intent.diary import Diary
from jink.intent.first_guess import Guess, add_weave, first_intents, guess, one_intent
from jink.intent.joining import MOST_BIRTHS, closest_joined, tidy
from jink.intent.lessons import Lessons, spoiled
from jink.intent.model import Intent, IntentModel
from jink.intent.progress import Progress
from jink.intent.selection import WORTH, CurvePoint, choose, curve_of, row_scores, smaller_models, track_scores

if TYPE_CHECKING:
    from jink.intent.bank_torch import Batch

__all__ = ["Outcome", "Settings", "learn"]

Floats = NDArray[np.float64]
_OUTLIER = 25.0  # nats below the median row
_PERIODS = (0.06, 0.1, 0.16, 0.26)  # of a piece: periods of weaves that are tried
_FEWER_BIRTHS = 2e-4  # nats per row that a birth component must bring


@dataclass(frozen=True)
class Settings:
    """How much work each stage may do; quasi-Newton steps.

    Args:
        intents: how many; None: chosen.
        most: intents to begin with.
        single, first, weave, fewer, last: steps of the stages.
        rivals: how many of the best smaller models are fitted at each number of intents.
        seconds: processor budget; None: none. Climbs stop when it is spent, so results then depend on the machine.
        threads: parts a batch is cut into; the last digits depend on it.
        device: of the climbs.
        seed: of everything random.
    """

    intents: int | None = None
    most: int = 7
    single: int = 25
    first: int = 45
    weave: int = 6
    fewer: int = 15
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

    def __init__(self, lessons: Lessons, found: Guess, settings: Settings, tell: Callable[[Progress], None]) -> None:
        self.lessons, self.found, self.settings, self.tell = lessons, found, settings, tell
        self.floor = -math.inf
        self.watch = _Stopwatch(settings.seconds)

    def with_noise(self, model: IntentModel) -> IntentModel:
        return model if self.lessons.noise_sd is None else model.with_(noise_sd=self.lessons.noise_sd)

    def batch(self, chosen: NDArray[np.int64] | None) -> Batch:
        speed = self.found.sizes.speed / math.sqrt(self.lessons.pieces.axes)
        return self.lessons.batch(chosen, speed, self.settings.device)

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
    sigma = None if lessons.noise_sd is None else float(np.mean(lessons.noise_sd))
    tell(Progress("clusters", 0, 0, 0, math.nan))
    found = guess(lessons.pieces, sigma)
    trainer = _Trainer(lessons, found, settings, tell)
    lessons, left_out, single = _clean(trainer, diary)
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
        return model, {"log_likelihood": trainer.mean(model, everything)}

    model, numbers = diary.stage("final", last)
    return Outcome(
        _named(model),
        curve_of(kept.scores, rows, settings.seed),
        resolvable,
        float(numbers["log_likelihood"]),
        left_out,
    )


def _clean(trainer: _Trainer, diary: Diary) -> tuple[Lessons, int, IntentModel]:
    """Fit one intent; rows it finds absurd are gross outliers and are left out, then it is fitted again."""
    settings, axes = trainer.settings, trainer.lessons.pieces.axes
    model, left_out = trainer.with_noise(one_intent(trainer.found, axes)), 0
    for attempt in range(3):

        def single(start: IntentModel = model, number: int = attempt) -> tuple[IntentModel, dict[str, Any]]:
            steps = settings.single if number == 0 else settings.single // 2
            return trainer.climb(start, trainer.batch(trainer.lessons.fit), "one intent", steps), {}

        everything = trainer.batch(None)
        first = row_scores(model, everything, settings.threads)
        trainer.floor = float(np.median(first[everything.detected.cpu().numpy()])) - _OUTLIER
        model, _ = diary.stage(f"one-intent-{attempt + 1}", single)
        rows = row_scores(model, everything, settings.threads)
        bad = spoiled(trainer.lessons.pieces, rows, _OUTLIER) & everything.detected.cpu().numpy()
        trainer.floor = float(np.median(rows[everything.detected.cpu().numpy()])) - _OUTLIER
        if not bad.any() or bad.mean() > 0.2:
            break
        left_out += int(bad.sum())
        pieces = trainer.lessons.pieces
        trainer.lessons = trainer.lessons._replace(
            pieces=replace(pieces, measurements=np.where(bad[..., None], np.nan, pieces.measurements))
        )
    return trainer.lessons, left_out, model


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
    """Fit too many intents, take one away at a time, and see whether the number chosen so far lacks a weave."""
    settings, axes = trainer.settings, trainer.lessons.pieces.axes

    def first() -> tuple[IntentModel, dict[str, Any]]:
        start = trainer.with_noise(first_intents(trainer.found, axes, settings.most))
        return tidy(trainer.climb(start, fit, "fit", settings.first)), {}

    model, _ = diary.stage("fit", first)
    rows = _reduce(trainer, diary, "fewer", model, fit, held, found)
    if settings.weave == 0:
        return
    count = settings.intents if settings.intents in found.models else choose(found.scores, rows, settings.seed)[0]
    chosen = found.models[max(count, 2)]

    def weave() -> tuple[IntentModel, dict[str, Any]]:
        return _with_weave(trainer, chosen, fit), {}

    model, _ = diary.stage("weave", weave)
    scores, _ = trainer.score(model, held)
    gain = scores - found.scores[len(chosen.intents)]
    error = float(gain.std() * math.sqrt(len(rows)) / rows.sum())
    if float(gain.sum() / rows.sum()) > max(2.0 * error, WORTH):
        _reduce(trainer, diary, "weave-fewer", model, fit, held, found)


def _reduce(
    trainer: _Trainer, diary: Diary, name: str, model: IntentModel, fit: Batch, held: Batch, found: _Found
) -> Floats:
    """From a model down to two intents; returns the measured rows of the held-out tracks."""
    while True:
        count = len(model.intents)
        scores, rows = trainer.score(model, held)
        found.offer(model, scores)
        value = float(scores.sum() / max(float(rows.sum()), 1.0))
        trainer.tell(Progress("merge", 0, 0, count, value, held_out=True))
        if count <= 2:
            return rows

        def fewer(start: IntentModel = model) -> tuple[IntentModel, dict[str, Any]]:
            return _smaller(trainer, start, fit), {}

        model, _ = diary.stage(f"{name}-{count - 1}", fewer)


def _with_weave(trainer: _Trainer, model: IntentModel, fit: Batch) -> IntentModel:
    """The model with one more intent, that weaves: the best of a few periods."""
    settings, sizes = trainer.settings, trainer.found.sizes
    best, candidate = -math.inf, model
    for share in _PERIODS:
        tried = trainer.climb(add_weave(model, sizes, share * sizes.duration), fit, "weave", settings.weave)
        value = trainer.mean(tried, fit)
        if value > best:
            best, candidate = value, tried
    return tidy(trainer.climb(candidate, fit, "weave", settings.fewer))


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
