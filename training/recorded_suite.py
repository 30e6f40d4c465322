"""Recorded tracks in a folder: which files, read how, and the errors or predictions of each estimator."""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jink.training.track import TrackReport, TrackRequest

__all__ = ["ESTIMATORS", "RecordedFile", "list_files", "score_report"]

ESTIMATORS = ("raw", "kf-cv", "imm", "intent-imm")
"""Columns of the table; `raw` is the measurement itself."""


@dataclass(frozen=True)
class Reading:
    """How files of one kind are read.

    Args:
        pattern: shell pattern of the path inside the data folder.
        options: fields of `TrackRequest`; ``{stem}`` in `truth` is the file's name up to its last underscore part.
        skip: why such files are no tracks to estimate; empty: they are.
    """

    pattern: str
    options: tuple[tuple[str, Any], ...] = ()
    skip: str = ""


def _reading(pattern: str, /, skip: str = "", **options: Any) -> Reading:
    return Reading(pattern, tuple(options.items()), skip)


_UWB: dict[str, Any] = {"axes": 2, "truth": "{stem}_truth.csv", "truth_columns": "t=time_aligned"}
READINGS = (
    _reading("*_truth.csv", "truth of other files"),
    _reading("*_odometry.csv", "odometry, not a track"),
    _reading("uwb_outdoor/*_lsq_position.csv", **_UWB),
    _reading("uwb_outdoor/*_ranges.csv", **_UWB, height=1.1, gate=True),
    _reading("plaza_range/*_ranges.csv", sort=True, truth="{stem}_truth.csv", bias=("range=2.8",)),
    _reading("aircraft_adsb/*.csv", columns="z=alt_m", where=("fresh=1",)),
    _reading("rockets/*.csv", columns="alt=gps_altitude", where=("gps_new=1",)),
    _reading("dancing_bees/*.csv", rate_hz=30.0),
    _reading("autoferry/*.csv", "clutter and several targets: needs data association"),
    _reading("published_scenarios/*.csv", "noise-free paths: see --suite published"),
)
"""One table: the first pattern that fits a file counts; a file that fits none is read without flags."""
_SUFFIXES = (".csv", ".parquet")


class RecordedFile(NamedTuple):
    """A file of the folder: its name in tables, the request that reads it, or why it is skipped."""

    name: str
    request: TrackRequest | None
    reason: str


def list_files(folder: Path) -> list[RecordedFile]:
    """The files of a folder in order, and the patterns of the table that no file fits.

    Args:
        folder: searched with its subfolders.

    Raises:
        ValueError: no such folder, or no CSV or Parquet file in it.
    """
    if not folder.is_dir():
        raise ValueError(f"--data: folder must exist; got {folder}. Name the folder of recorded tracks.")
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SUFFIXES and path.is_file())
    if not paths:
        raise ValueError(f"--data: folder must hold CSV or Parquet files; got none in {folder}. Name another.")
    found, seen = [], set()
    for path in paths:
        name = path.relative_to(folder).as_posix()
        reading = next((r for r in READINGS if fnmatch.fnmatch(name, r.pattern)), Reading("*"))
        seen.add(reading.pattern)
        if reading.skip:
            found.append(RecordedFile(name, None, reading.skip))
            continue
        found.append(_request(path, name, dict(reading.options)))
    for reading in READINGS:
        if reading.pattern not in seen and not reading.skip:
            found.append(RecordedFile(reading.pattern, None, "no such file in the folder"))
    return found


def _request(path: Path, name: str, options: dict[str, Any]) -> RecordedFile:
    truth = options.get("truth")
    if truth is not None:
        stem = path.stem.removesuffix("_position").rpartition("_")[0]
        options["truth"] = path.with_name(truth.format(stem=stem))
        if not options["truth"].is_file():
            return RecordedFile(name, None, f"its truth {options['truth'].name} is not there")
    return RecordedFile(name, TrackRequest(file=path, **options), "")


def score_report(report: TrackReport | None, raw: dict[str, float]) -> dict[str, tuple[float, str]]:
    """Metrics of one cell, with units.

    Args:
        report: of an estimator; None for the raw measurement.
        raw: errors of the measurements; empty without truth.

    Returns:
        position errors where there is truth, prediction measures everywhere but for raw; empty if neither.
    """
    scores = raw if report is None else report.scores
    values = {
        name: (scores[key], unit)
        for name, key, unit in (
            ("position_rmse", "position_rmse_m", "m"),
            ("position_median", "position_median_m", "m"),
            ("position_peak", "position_peak_m", "m"),
            ("position_nees", "position_nees", ""),
        )
        if key in scores
    }
    if report is not None:
        values |= {
            "log_likelihood_trimmed": (_trimmed_log_likelihood(report), "nat"),
            "log_likelihood_per_step": (scores["log_likelihood_per_step"], "nat"),
            "nis_per_component": (scores["nis_per_dof"], ""),
            "nis_inside": (scores["nis_inside"], ""),
            "diverged_share": (scores["diverged_steps"] / max(scores["steps"], 1.0), ""),
            "microseconds_per_step": (1e6 * report.seconds / max(scores["steps"], 1.0), "us"),
        }
    return values


def _trimmed_log_likelihood(report: TrackReport) -> float:
    """Mean log-likelihood of the one-step predictions without the worst 1 %, where gross errors live; nat."""
    measured = report.tracks.used & (np.asarray(report.estimates.nis_dof) > 0)
    values = np.sort(np.asarray(report.estimates.log_likelihood)[measured])
    return float(values[len(values) // 100 :].mean()) if values.size else float("nan")
