"""Recorded tracks in a folder: which files, read how, and the errors or predictions of each estimator."""

from __future__ import annotations

import fnmatch
import shlex
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from jink.training.track import TrackRequest

__all__ = ["ESTIMATORS", "UNGATED", "RecordedFile", "list_files", "list_flags"]

ESTIMATORS = ("raw", "kf-cv", "imm", "intent-imm")
"""Columns of the table; `raw` is the measurement itself."""
UNGATED = " without --gate"
"""Ends the name of a second reading of a file whose flags hold --gate: what the gate is worth."""


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
        request = found[-1].request
        if request is not None and request.gate:
            found.append(RecordedFile(name + UNGATED, replace(request, gate=False), ""))
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


def list_flags(request: TrackRequest) -> str:
    """The flags of `jink track` that read a file as a request does; files by their name only."""
    words = []
    for field in fields(request):
        value = getattr(request, field.name)
        if field.name in ("file", "estimator") or value == field.default:
            continue
        flag = f"--{field.name.replace('_', '-')}"
        for one in value if isinstance(value, tuple) else (value,):
            words += [flag] if one is True else [flag, one.name if isinstance(one, Path) else f"{one}"]
    return shlex.join(words)
