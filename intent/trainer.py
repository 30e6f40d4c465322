"""The climbs of one training: its batches, its sizes, what a row costs at most, and who is told."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jink.intent.climbing import climb
from jink.intent.first_guess import Guess, guess
from jink.intent.lessons import Lessons
from jink.intent.model import IntentModel
from jink.intent.progress import Progress
from jink.intent.selection import track_scores

if TYPE_CHECKING:
    from jink.intent.bank_torch import Batch

__all__ = ["Settings", "Trainer"]

Floats = NDArray[np.float64]
_OUTLIER = 25.0  # nats below the median row


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


class _Stopwatch:
    """Seconds left."""

    def __init__(self, seconds: float | None) -> None:
        self.end = math.inf if seconds is None else time.monotonic() + seconds

    @property
    def over(self) -> bool:
        return time.monotonic() > self.end


class Trainer:
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
        """The model, with the noise that is to be learned."""
        return model if self.lessons.noise_sd is None else model.with_(noise_sd=self.lessons.noise_sd)

    def batch(self, chosen: NDArray[np.int64] | None) -> Batch:
        """Some pieces, or all, as the twin takes them."""
        return self.lessons.batch(chosen, self.speed, self.settings.device)

    def climb(self, model: IntentModel, batch: Batch, stage: str, steps: int, tolerance: float = 1e-5) -> IntentModel:
        """A model after so many steps on a batch."""

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
        """Log-likelihood and measured rows of each track; (B,) twice."""
        return track_scores(model, batch, self.floor, self.settings.threads)

    def mean(self, model: IntentModel, batch: Batch, *, whole: bool = False) -> float:
        """Log-likelihood per measured row, nats; ``whole``: without the floor that outliers get."""
        scores, rows = track_scores(model, batch, -math.inf if whole else self.floor, self.settings.threads)
        return float(scores.sum() / max(float(rows.sum()), 1.0))
