"""`jink segment`: which intent each row of a file shows, and where it changes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

from jink.estimators.sensor import Sensor
from jink.estimators.tracks import Tracks
from jink.intent.model import IntentModel
from jink.intent.segmentation import Segmentation, segment
from jink.training.console import check_separate, check_writable, progress, say_when_compiling
from jink.training.models import find_model, sensor_for
from jink.training.pooling import as_positions
from jink.training.running import run_tracks
from jink.training.summary import number, plain_table
from jink.training.track import TrackReport, TrackRequest, read
from jink.training.wording import counted

__all__ = ["SegmentReport", "SegmentRequest", "print_segmented", "segment_file", "write_labels"]

Floats = NDArray[np.float64]
_SHOWN = 12


@dataclass(frozen=True)
class SegmentRequest:
    """What was asked for: how the file is read, which model, where labels and picture go; None means "not given"."""

    reading: TrackRequest
    model: str
    out: Path | None = None
    plot: Path | None = None
    shown: str | None = None
    handed: bool = False


class SegmentReport(NamedTuple):
    """What came out."""

    tracks: Tracks
    model: IntentModel
    found: Segmentation
    wrote: tuple[Path, ...]
    noise: str
    """Standard deviation of a measured position that was used, and where it comes from."""


def segment_file(request: SegmentRequest) -> SegmentReport:
    """Label the rows of a file.

    Args:
        request: what was asked for.

    Returns:
        the labels; files are written where they were asked for.

    Raises:
        ValueError: an option, a file or a model that is refused.
        OSError: a file that cannot be read or written.
    """
    check_writable(request.out, "--out", (".csv", ".parquet"))
    check_writable(request.plot, "--plot", (".png", ".pdf", ".svg"))
    for path, option in ((request.out, "--out"), (request.plot, "--plot")):
        check_separate(path, option, {"the input file": request.reading.file})
    tracks = as_positions(read(request.reading), request.reading.sigma, request.reading.degrees)
    model = find_model(request.model, axes=tracks.axes)
    if request.shown is not None and request.shown not in tracks.ids:
        more = f" and {len(tracks) - 10} more" if len(tracks) > 10 else ""
        raise ValueError(
            f"--show: value must name a track; got '{request.shown}'. There are {', '.join(tracks.ids[:10])}{more}."
        )
    if not np.isfinite(tracks.measurements).all(axis=2).any():
        raise ValueError(
            f"FILE: rows must hold measurements; got none that can be used in {tracks.source}. "
            "Check the columns with --columns."
        )
    sensor, own_noise = sensor_for(model, tracks)
    noise = "of the rows" if own_noise else _noise_words(sensor, model)
    if own_noise:
        model = model.with_(noise_sd=None)  # what the file says of its own rows comes before what was learned
    with say_when_compiling(), progress(f"labels: {tracks.source}"):
        found = segment(model, tracks, sensor, handed=request.handed)
        if request.out is not None:
            write_labels(request.out, tracks, found)
        if request.plot is not None:
            _plot(request.plot, model, tracks, found, request.shown)
    wrote = tuple(path for path in (request.out, request.plot) if path is not None)
    return SegmentReport(tracks, model, found, wrote, noise)


def _noise_words(sensor: Sensor, model: IntentModel) -> str:
    sizes = ", ".join(f"{sigma:.3g}" for sigma in np.sqrt(np.diagonal(sensor.noise)))
    return f"{sizes} m, {'learned with the model' if model.noise_sd is not None else 'estimated from the tracks'}"


def write_labels(path: Path, tracks: Tracks, found: Segmentation) -> None:
    """One row per measurement: track, t, intent, the probability of each, and that it changed since the row before.

    Args:
        path: .csv or .parquet; replaced if it exists, whole or not at all.
        tracks: what was labelled.
        found: labels of these tracks.
    """
    used = tracks.used
    columns: dict[str, Any] = {
        "track": np.repeat(np.array(tracks.ids, dtype=object), tracks.lengths),
        "t": tracks.times[used],
        "intent": np.array(found.names, dtype=object)[found.labels[used]],
    }
    for index, name in enumerate(found.names):
        columns[f"prob_{name}"] = found.probs[used][:, index]
    if found.switches is not None:
        columns["change"] = found.switches[used]
    frame = pd.DataFrame(columns)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.suffix.lower() == ".csv":
            frame.to_csv(part, index=False)
        else:
            frame.to_parquet(part, index=False)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def print_segmented(console: Console, report: SegmentReport) -> None:
    """Print shares, durations and the first change points."""
    tracks, found = report.tracks, report.found
    rows = int(tracks.lengths.sum())
    console.print(
        f"[bold]{escape(tracks.source)}[/bold]: {counted(len(tracks), 'track')}, {rows} rows in {tracks.axes} axes; "
        f"noise {report.noise}"
    )
    runs = [run for b in range(len(tracks)) for run in found.runs(b)]
    table = plain_table("intent", "share of rows", "stretches", "median duration, s")
    for label, name in enumerate(found.names):
        mine = [run.duration for run in runs if run.label == label]
        share = float(np.mean(found.labels[tracks.used] == label)) if rows else 0.0
        table.add_row(
            escape(name), f"{100 * share:.0f} %", f"{len(mine)}", number(np.median(mine) if mine else None, 3)
        )
    console.print(table)
    changes = [(tracks.ids[b], change) for b in range(len(tracks)) for change in found.change_points(b)]
    if changes:
        table = plain_table("track", "change", "t, s", "probability", words=2)
        for name, change in changes[:_SHOWN]:
            words = f"{found.names[change.before]} > {found.names[change.after]}"
            table.add_row(escape(name), escape(words), f"{change.time:.6g}", f"{change.probability:.2f}")
        console.print(table)
    if len(changes) > _SHOWN:
        console.print(f"and {len(changes) - _SHOWN} more changes", style="dim")
    if not changes:
        console.print("no change of intent")
    for path in report.wrote:
        console.print(f"wrote {path}", markup=False)


def _plot(path: Path, model: IntentModel, tracks: Tracks, found: Segmentation, shown: str | None) -> None:
    from jink.training.plotting import plot_track

    sensor, own_noise = sensor_for(model, tracks)
    smoothed = run_tracks(model.estimator(sensor), tracks, use_noise=own_noise, smooth=True)
    report = TrackReport(
        tracks, "intents", found.names, (), smoothed._replace(mode_probs=found.probs), {}, {}, [], 0.0, 0
    )
    b = int(np.argmax(tracks.lengths)) if shown is None else tracks.ids.index(shown)
    plot_track(path, report, shown, [(change.time, change.probability) for change in found.change_points(b)])
