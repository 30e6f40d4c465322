"""`IntentLearner`: from unlabelled noisy tracks to a bank of intents, with the manners of scikit-learn."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jink.estimators.bank import Bank
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks
from jink.intent.devices import check_device
from jink.intent.diary import Diary
from jink.intent.lessons import make_lessons, positions_of
from jink.intent.model import IntentModel
from jink.intent.options import check_options
from jink.intent.progress import Progress
from jink.intent.selection import CurvePoint
from jink.intent.training_schedule import Settings, learn

if TYPE_CHECKING:
    from jink.intent.segmentation import Segmentation

__all__ = ["IntentLearner"]


class IntentLearner:
    """Learns how many intents there are, what each does, and how they follow one another.

    Model: that of `IntentModel`; its numbers maximise the marginal likelihood of the measured positions in the very
    bank that will use them, its structure is the smallest that explains tracks which were not fitted.

    Args:
        axes: 2 or 3.
        intents: how many; None: chosen by held-out likelihood.
        seconds: budget, s; None: as long as it takes. With a budget the result depends on the machine.
        seed: of everything random; same seed, same tracks, same bits.
        noise_sd: standard deviation of a measured position per axis, m; "learn": learned; None: the noise of the
            tracks, or learned where they carry none.
        device: "cpu", or "cuda" for torch's operations on a GPU.
        threads: parts that tracks are cut into for as many cores; the last digits depend on it.
        progress: called with a `Progress` after every step.
        checkpoint: folder for finished stages; a killed fit goes on from there to the same result.
        **work: fields of `Settings` (quasi-Newton steps of the stages).

    Attributes (after `fit`):
        model_: the `IntentModel`. curve_: `CurvePoint` of every number of intents. resolvable_: several intents
        explain held-out tracks better than one does. log_likelihood_: of all rows, nats per row. left_out_: rows
        ignored as gross outliers.

    Raises:
        ValueError: an option out of range, or a device that is not there.

    Source: patent CN202211553542, claims 2, 4, 5. Differs: the likelihood of the bank instead of distances of curves.
    """

    def __init__(
        self,
        axes: int = 2,
        intents: int | None = None,
        *,
        seconds: float | None = None,
        seed: int = 0,
        noise_sd: float | str | None = None,
        device: str = "cpu",
        threads: int = 2,
        progress: Callable[[Progress], Any] | None = None,
        checkpoint: str | Path | None = None,
        **work: int,
    ) -> None:
        check_options(axes, intents, seconds, seed, noise_sd, device, {"threads": threads, **work})
        check_device(device)
        self.axes, self.noise_sd, self.progress, self.checkpoint = axes, noise_sd, progress, checkpoint
        self.settings = Settings(
            intents=intents, seconds=seconds, seed=int(seed), device=device, threads=int(threads), **work
        )

    def fit(self, tracks: Tracks) -> IntentLearner:
        """Learn from tracks; labels and truth in them are not looked at.

        Args:
            tracks: measured positions, or measurements of a sensor that locates the target from one row; rows may be
                missing, times irregular, tracks of unlike length.

        Returns:
            self.

        Raises:
            ValueError: other axes, too little to learn from, a sensor that does not locate, a checkpoint of another
                training.
            ModuleNotFoundError: torch is not installed (``pip install 'jink[learn]'``).
        """
        if tracks.axes != self.axes:
            raise ValueError(
                f"IntentLearner.fit: tracks must have {self.axes} axes; got {tracks.axes}. Make the learner with "
                f"axes={tracks.axes}."
            )
        lessons = make_lessons(tracks, self.settings.seed, self.noise_sd)
        diary = Diary(self.checkpoint, self._key(tracks))
        outcome = learn(lessons, self.settings, diary, self.progress or _silent)
        self.curve_: tuple[CurvePoint, ...] = outcome.curve
        self.resolvable_: bool = outcome.resolvable
        self.log_likelihood_: float = outcome.log_likelihood
        self.left_out_: int = outcome.left_out
        self.model_: IntentModel = outcome.model.with_(
            about={
                "seed": self.settings.seed,
                "tracks": len(tracks),
                "rows": int(tracks.used.sum()),
                "left_out": outcome.left_out,
                "resolvable": outcome.resolvable,
                "log_likelihood": outcome.log_likelihood,
                "curve": [list(point) for point in outcome.curve],
            }
        )
        return self

    def score(self, tracks: Tracks) -> float:
        """Mean log-likelihood per measured row, nats, of tracks under the learned bank (of positions in metres).

        Raises:
            ValueError: as `fit`; or not fitted yet.
        """
        model = self._fitted("score")
        learned = model.noise_sd
        places = positions_of(tracks, float(np.mean(learned)) if learned is not None else _number(self.noise_sd))
        from jink.intent.bank_torch import make_batch
        from jink.intent.selection import row_scores

        noise = places.noise if learned is None else np.array(learned)
        if noise is None:
            raise AssertionError("positions without covariance")
        batch = make_batch(places.measurements, places.times, noise, places.lengths, speed=model.speed)
        scores = row_scores(model, batch, self.settings.threads)
        return float(scores.sum() / max(batch.rows, 1))

    def segment(self, tracks: Tracks) -> Segmentation:
        """Which intent each row belongs to, from the whole of each track; see `jink.intent.segmentation.segment`.

        Positions have the noise that was learned; else the one this learner was given; else their own.
        """
        from jink.intent.segmentation import segment

        model, sensor = self._fitted("segment"), None
        if tracks.sensor == "position" and model.noise_sd is None and _number(self.noise_sd) is not None:
            sensor, tracks = self._sensor(), dataclasses.replace(tracks, noise=None)
        return segment(model, tracks, sensor)

    def bank(self, sensor: Sensor | None = None, **options: object) -> Bank:
        """The bank of the learned intents, for `BankEstimator`; see `IntentModel.bank`.

        Without a sensor: positions with the noise that was learned, else the one this learner was given.
        """
        model = self._fitted("bank")
        return model.bank(self._sensor() if sensor is None and model.noise_sd is None else sensor, **options)

    def _sensor(self) -> Sensor | None:
        """Positions with the noise this learner was given; None: it was given none."""
        sigma = _number(self.noise_sd)
        return None if sigma is None else position(self.axes, sigma)

    def _fitted(self, caller: str) -> IntentModel:
        if not hasattr(self, "model_"):
            raise ValueError(f"IntentLearner.{caller}: the learner must be fitted first; got none. Call fit(tracks).")
        return self.model_

    def _key(self, tracks: Tracks) -> str:
        """Digest of what decides the outcome."""
        digest = hashlib.sha256()
        options = {**dataclasses.asdict(self.settings), "axes": self.axes, "noise_sd": self.noise_sd}
        digest.update(json.dumps(options, sort_keys=True).encode())
        for value in (tracks.times, tracks.measurements, tracks.noise, tracks.sensor_states, tracks.lengths):
            digest.update(b"none" if value is None else np.ascontiguousarray(value).tobytes())
        digest.update(tracks.sensor.encode())
        return digest.hexdigest()


def _silent(_: Progress) -> None:
    """Nobody listens."""


def _number(value: float | str | None) -> float | None:
    return None if value is None or isinstance(value, str) else float(value)
