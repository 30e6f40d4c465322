"""`jink train intents`: from tracks to a folder that holds the intents behind them, with pictures and a summary."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import os
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.devices import check_device
from jink.intent.model import IntentModel
from jink.intent.model_file import save_model
from jink.intent.progress import Progress
from jink.training.console import say_when_compiling
from jink.training.intent_graphs import CurvePoint, plot_curve, plot_graph
from jink.training.intent_pictures import plot_clusters, plot_rollouts
from jink.training.intent_summary import write_readme
from jink.training.models import sensor_for
from jink.training.pooling import digest_of, gather
from jink.training.running import run_tracks
from jink.training.track import TrackRequest
from jink.training.training_folder import WORK, abandon, finish, finished_model, prepare
from jink.training.training_log import TrainingLog
from jink.training.wording import in_own_words

__all__ = ["PICTURES", "TrainReport", "TrainRequest", "train_intents"]

PICTURES = ("clusters.png", "rollouts.png", "likelihood.png", "graph.png")
_COMMAND = 1000


@dataclass(frozen=True)
class TrainRequest:
    """What was asked for; None means "not given".

    Args:
        sources: files, scenarios, suites.
        out: folder of the model, made where it does not exist.
        intents: how many; None: chosen by held-out likelihood.
        noise: measurement noise per axis, m; "learn"; None: that of the tracks, else estimated from them.
        seconds: time for fitting, s; None: the learner's own.
        tracks: simulated tracks of each scenario.
        steps: samples of each; None: the scenario's own.
        seed: of simulation and learning.
        device: "cpu" or "cuda".
        fresh: begin anew where another or an unfinished training lies.
        reading: how files are read.

    Raises:
        ValueError: a value out of range.
    """

    sources: tuple[str, ...]
    out: Path = Path("model")
    intents: int | None = None
    noise: float | str | None = None
    seconds: float | None = None
    tracks: int = 128
    steps: int | None = None
    seed: int = 0
    device: str = "cpu"
    fresh: bool = False
    reading: TrackRequest = field(default_factory=lambda: TrackRequest(Path()))

    def __post_init__(self) -> None:
        if not self.sources:
            raise ValueError("SOURCES: one or more must be given; got none. Name a file, a scenario or a suite.")
        limits = {"intents": 1, "tracks": 2, "steps": 10, "seed": 0}
        for name, low in limits.items():
            value = getattr(self, name)
            if value is not None and value < low:
                raise ValueError(f"--{name}: value must be >= {low}; got {value}. Leave it out if in doubt.")
        if self.seconds is not None and not 0.0 < self.seconds < math.inf:
            raise ValueError(f"--seconds: value must be > 0; got {self.seconds:g}. Leave it out if in doubt.")
        object.__setattr__(self, "noise", _noise(self.noise))


class TrainReport(NamedTuple):
    """What came out: the model, what it was learned from, its curve, and where it lies."""

    model: IntentModel
    tracks: Tracks
    curve: tuple[CurvePoint, ...]
    resolvable: bool
    out: Path
    resumed: bool
    finished_before: bool


def train_intents(request: TrainRequest) -> TrainReport:
    """Learn the intents of tracks and write them with pictures and a summary.

    A training that was killed goes on from its last checkpoint when the same command is given again, to the same
    files; a finished one is only shown.

    Args:
        request: what was asked for.

    Returns:
        what came out.

    Raises:
        ValueError: an option, a file or a name that is refused; or another training in the folder.
        ModuleNotFoundError: torch is not installed.
        OSError: a file cannot be read or written.
    """
    with say_when_compiling():
        tracks = gather(request.sources, request.reading, count=request.tracks, steps=request.steps, seed=request.seed)
        _check_motion(tracks)
        key = _key(request, tracks)
        out = request.out
        done = finished_model(out, key, request.fresh)
        if done is not None:
            curve, resolvable = _remembered(done.about)
            return TrainReport(done, tracks, curve, resolvable, out, False, True)
        resumed = prepare(out, key, PICTURES, request.fresh)
        work = out / WORK
        try:
            with TrainingLog(work / "progress.jsonl", out / "tensorboard") as log:
                learner = _make_learner(request, tracks, work / "learner", log)
                with in_own_words("SOURCES"):
                    learner.fit(tracks)
                trace = log.trace()
        except ValueError:
            if not resumed:  # what was refused must not stand in the way of the corrected command
                abandon(out)
            raise
        model, curve = _with_provenance(learner, request, tracks, key), _curve(learner)
        save_model(model, out)
        _draw(out, model, tracks, trace, curve)
        resolvable = bool(getattr(learner, "resolvable_", True))
        write_readme(out / "README.md", model, tracks, curve, resolvable, PICTURES)
        finish(out, key)
    return TrainReport(model, tracks, curve, resolvable, out, resumed, False)


def _check_motion(tracks: Tracks) -> None:
    """Refuse positions that never change: any law explains them, without noise, infinitely well."""
    most = 0
    for track in tracks:
        seen = track.measurements[np.isfinite(track.measurements).all(axis=1)]
        most = max(most, len(seen))
        if not len(seen) or (seen != seen[0]).any():
            return
    if most < 2:
        raise ValueError(
            f"SOURCES: tracks must have two measured rows at least; got one in each of {tracks.source}. "
            "Check the track column with --columns."
        )
    raise ValueError(
        f"SOURCES: positions must change within a track; got the same one in every row of {tracks.source}. "
        "Check the columns with --columns."
    )


def _make_learner(request: TrainRequest, tracks: Tracks, checkpoint: Path, log: Callable[[Progress], None]) -> Any:
    try:
        import torch
    except ModuleNotFoundError as error:
        raise ValueError(
            "train intents: torch must be installed to learn; got none. Run pip install 'jink[learn]'."
        ) from error
    from jink.intent.learner import IntentLearner

    with in_own_words("--device", options=("device",)):
        check_device(request.device)
    # On matrices this small a second thread costs more than it gains.
    torch.set_num_threads(1)
    options: dict[str, Any] = {} if request.seconds is None else {"seconds": request.seconds}
    return IntentLearner(
        axes=tracks.axes,
        intents=request.intents,
        seed=request.seed,
        noise_sd=request.noise,
        device=request.device,
        progress=log,
        checkpoint=checkpoint,
        **options,
    )


def _noise(value: float | str | None) -> float | str | None:
    """The value of --noise: a number, "learn", or nothing."""
    if value is None or value == "learn":
        return value
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise ValueError(f"--noise: value must be metres > 0 or learn; got '{value}'. Write for example --noise 15.")
    return number


def _key(request: TrainRequest, tracks: Tracks) -> str:
    """What decides the outcome: data and options, not where things lie."""
    asked = {k: v for k, v in asdict(replace(request, sources=("",))).items() if k not in ("out", "fresh", "reading")}
    text = json.dumps({"asked": asked, "tracks": digest_of(tracks)}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _curve(learner: Any) -> tuple[CurvePoint, ...]:
    """The selection curve of a learner, by whatever name it calls its columns."""
    return tuple(CurvePoint(int(row[0]), *(float(value) for value in tuple(row)[1:4])) for row in learner.curve_)


def _with_provenance(learner: Any, request: TrainRequest, tracks: Tracks, key: str) -> IntentModel:
    """The model with where it comes from: nothing that another run of the same command would not say."""
    versions = {"python": platform.python_version()}
    for name in ("jink", "numba", "numpy", "torch"):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    model: IntentModel = learner.model_
    about = {
        **{name: value for name, value in model.about.items() if name not in ("seconds", "started")},
        "seed": request.seed,
        "command": command(sys.argv[1:]),
        "versions": versions,
        "tracks": {
            "source": tracks.source[:200],
            "tracks": len(tracks),
            "rows": int(tracks.lengths.sum()),
            "sha256": digest_of(tracks),
        },
        "curve": [[None if math.isnan(value) else value for value in map(float, point)] for point in _curve(learner)],
        "resolvable": bool(getattr(learner, "resolvable_", True)),
        "request": key,
    }
    return model.with_(about=about)


def command(arguments: list[str]) -> str:
    """The command line with folders cut off."""
    short = [Path(a).name or a if os.sep in a else a for a in arguments]
    return "".join(c if c.isprintable() else "?" for c in " ".join(["jink", *short]))[:_COMMAND]


def _remembered(about: Any) -> tuple[tuple[CurvePoint, ...], bool]:
    rows = about.get("curve", [])
    curve = tuple(CurvePoint(int(n), *(math.nan if v is None else v for v in rest)) for n, *rest in rows)
    return curve, bool(about.get("resolvable", True))


def _draw(
    out: Path, model: IntentModel, tracks: Tracks, trace: Sequence[Progress], curve: Sequence[CurvePoint]
) -> None:
    clusters, rollouts, likelihood, graph = (out / name for name in PICTURES)
    plot_rollouts(rollouts, model)
    plot_graph(graph, model)
    plot_curve(likelihood, trace, curve, len(model.intents))
    plot_clusters(clusters, model, tracks, intent_labels(model, tracks))


def intent_labels(model: IntentModel, tracks: Tracks) -> NDArray[np.int64]:
    """The likeliest intent of each row given the whole track; (B, T); -1 in padding."""
    sensor, use_noise = sensor_for(model, tracks)
    found = run_tracks(model.estimator(sensor), tracks, use_noise=use_noise, smooth=True)
    labels = model.intent_probs(found.mode_probs).argmax(axis=2)
    return np.where(tracks.used, labels, -1)
