"""Results as rows of a Parquet file: one per number, appended cell by cell, with all that made them."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import shlex
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from jink.training.intervals import Measured
from jink.training.locking import alone

__all__ = [
    "KINDS",
    "Cell",
    "append_rows",
    "finished_cells",
    "hash_files",
    "make_rows",
    "provenance",
    "read_rows",
    "write_rows",
]

COLUMNS = {
    "suite": "string", "scenario": "string", "estimator": "string", "kind": "string", "metric": "string",
    "value": "float64", "low": "float64", "high": "float64", "interval": "string", "unit": "string",
    "statistic": "string", "at": "object", "samples": "object",
    "published": "float64", "published_low": "float64", "published_high": "float64",
    "status": "string", "reason": "string", "runs": "int64", "seed": "int64", "parameters": "string",
    "steps": "int64", "seconds": "float64", "started": "string", "command": "string", "commit": "string",
    "data": "string", "versions": "string", "machine": "string",
}  # fmt: skip
_NEWER = {"data": "", "kind": "number", "statistic": "", "at": None, "samples": None}
"""Columns that older files lack, and what they then hold."""
PACKAGES = ("estimators", "intent", "envs", "training")
KINDS = ("number", "curve", "track")
"""A number of a cell; values against time; one series of the one run that is played back."""
_DAMAGED = "Make it again with jink bench, or choose another --out."
STATUSES = ("ok", "diverged", "skipped", "error")


class Cell(NamedTuple):
    """One estimator on one scenario: what is computed once and then skipped."""

    suite: str
    scenario: str
    estimator: str
    runs: int
    seed: int
    commit: str
    data: str = ""
    """Short hash of the recorded files, empty where nothing was read."""


def read_rows(path: Path) -> pd.DataFrame:
    """The rows of a file; none where it does not exist yet.

    Raises:
        ValueError: the file holds something else.
    """
    if not path.exists():
        return pd.DataFrame({name: pd.Series(dtype=kind) for name, kind in COLUMNS.items()})
    try:
        rows = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"--out: file must be Parquet rows of jink bench; got {path.name} ({error}). Choose another --out."
        ) from error
    for name, value in _NEWER.items():
        if name not in rows.columns:
            rows[name] = value  # without `data`: of unknown files, so never taken for finished ones
    missing = [name for name in COLUMNS if name not in rows.columns]
    if missing:
        raise ValueError(
            f"--out: file must have the columns of jink bench; got {path.name} without {', '.join(missing)}. "
            "Choose another --out."
        )
    try:
        rows = rows[list(COLUMNS)].astype(COLUMNS)
    except (TypeError, ValueError) as error:
        raise ValueError(f"--out: {path.name} must hold numbers where they belong; got {error}. {_DAMAGED}") from error
    if found := _damage(rows):
        raise ValueError(f"--out: rows of {path.name} must be whole; got {found}. {_DAMAGED}")
    return rows


def _damage(rows: pd.DataFrame) -> str:
    """What is wrong with rows that have all columns and kinds; "" where nothing is."""
    for name in ("parameters", "versions", "machine"):
        for text in rows[name].dropna().unique():
            try:
                json.loads(text or "{}")
            except ValueError:
                return f"{name} that are not JSON: {text[:40]!r}"
    lengths = rows["samples"].map(lambda one: -1 if one is None else len(one))
    number = rows["kind"] == "number"
    short = rows[number & (lengths >= 0) & (lengths != rows["runs"])]
    if len(short):
        row = short.iloc[0]
        return f"{len(row['samples'])} samples of {row['runs']} runs ({row['estimator']}, {row['metric']})"
    at = rows["at"].map(lambda one: -1 if one is None else len(one))
    torn = rows[~number & (at != lengths)]
    if len(torn):
        return f"times and samples of different length ({torn.iloc[0]['estimator']}, {torn.iloc[0]['metric']})"
    return ""


def finished_cells(rows: pd.DataFrame) -> set[Cell]:
    """Cells that need no second run; those that ended in an error or were skipped are tried again."""
    done = rows[~rows["status"].isin(["error", "skipped"])]
    return {Cell(*values) for values in done[list(Cell._fields)].itertuples(index=False, name=None)}


def append_rows(path: Path, new: pd.DataFrame) -> None:
    """Add rows to a file, replacing those of the same cells; a reader finds the old file or the new one.

    Args:
        path: Parquet file, made where it does not exist.
        new: rows from `make_rows`.

    Raises:
        ValueError: the file holds something else.
        OSError: it cannot be written.
    """
    keys = list(Cell._fields)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    # Another process may add rows between our reading and our replacing: they would be lost.
    with alone(path):
        old = read_rows(path)
        again = pd.MultiIndex.from_frame(old[keys]).isin(pd.MultiIndex.from_frame(new[keys]))
        try:
            write_rows(part, pd.concat([old[~again], new], ignore_index=True))
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


def write_rows(path: Path, rows: pd.DataFrame) -> None:
    """Rows as Parquet; numbers against time and runs as lists of single-precision numbers."""
    kinds = {"string": pa.string(), "float64": pa.float64(), "int64": pa.int64(), "object": pa.list_(pa.float32())}
    schema = pa.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
    pq.write_table(pa.Table.from_pandas(rows[list(COLUMNS)], schema, preserve_index=False), path, compression="zstd")


def make_rows(
    cell: Cell,
    values: Mapping[str, Measured],
    *,
    status: str = "ok",
    reason: str = "",
    published: Mapping[str, tuple[float, float, float]] | None = None,
    parameters: Mapping[str, Any] | None = None,
    steps: int = 0,
    seconds: float = 0.0,
    started: str = "",
    more: Sequence[Mapping[str, Any]] = (),
) -> pd.DataFrame:
    """Rows of one cell.

    Args:
        cell: what was computed.
        values: metric to number with unit and interval; empty: one row that only carries the status.
        status: ok, diverged, skipped or error.
        reason: why, where it is not ok.
        published: metric to value, low and high end to compare with (NaN = none).
        parameters: resolved parameters of scenario and estimator.
        steps: track-steps computed.
        seconds: wall time.
        started: from `now`.
        more: columns of further rows (``kind``, ``metric``, ``unit``, ``at``, ``samples``, ...).

    Returns:
        the rows, with their provenance.

    Raises:
        ValueError: an unknown status.
    """
    if status not in STATUSES:
        raise ValueError(f"make_rows: status must be one of {', '.join(STATUSES)}; got '{status}'. Use one of them.")
    common = {
        **provenance(),
        **cell._asdict(),
        "command": command_of(cell),
        "status": status,
        "reason": reason,
        "parameters": json.dumps(parameters or {}, sort_keys=True, default=str),
        "steps": steps,
        "seconds": seconds,
        "started": started or now(),
        "kind": "number",
        "statistic": "",
        "at": None,
        "samples": None,
    }
    none = {"value": math.nan, "low": math.nan, "high": math.nan, "interval": "", "published": math.nan}
    none |= {"published_low": math.nan, "published_high": math.nan, "unit": ""}
    nothing = {} if more else {"": Measured(math.nan, "", interval="no number")}
    records: list[dict[str, Any]] = []
    for metric, measured in (values or nothing).items():
        known = (published or {}).get(metric, (float("nan"),) * 3)
        numbers = dict(zip(("published", "published_low", "published_high"), known, strict=True))
        records.append(common | numbers | {"metric": metric, **measured._asdict()})
    records += [common | none | dict(row) for row in more]
    return pd.DataFrame(records)[list(COLUMNS)].astype(COLUMNS)


def now() -> str:
    """UTC time to the second, ISO 8601."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@functools.cache
def provenance() -> dict[str, str]:
    """Commit, versions and machine; no host names, users or folders."""
    versions = {"python": platform.python_version()}
    for name in ("jink", "numba", "numpy", "pandas", "scipy"):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    machine = {"cpu": _cpu(), "cores": os.cpu_count() or 0, "system": platform.system(), "bits": platform.machine()}
    return {
        "commit": commit(),
        "versions": json.dumps(versions, sort_keys=True),
        "machine": json.dumps(machine, sort_keys=True),
    }


def command_of(cell: Cell) -> str:
    """The command that makes exactly this cell."""
    words = ["jink", "bench", "--suite", cell.suite]
    words += ["--data", "DIR"] if cell.suite == "recorded" else []
    words += ["--scenario", cell.scenario, "--estimator", cell.estimator]
    words += [] if cell.suite == "recorded" else ["--runs", str(cell.runs), "--seed", str(cell.seed)]
    return shlex.join(words)


@functools.cache
def commit() -> str:
    """Commit of the source tree this package runs from; where files differ from it, "+" and their hash follow.

    Outside of a tree: "sources " and the hash of the installed files.
    """
    here = Path(__file__).resolve().parent

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(here), *arguments], capture_output=True, text=True, timeout=10, check=True
        )
        return done.stdout.strip()

    try:
        # An installed copy may lie inside some other project's tree, whose commit would say nothing.
        if not (Path(git("rev-parse", "--show-toplevel")) / "training" / Path(__file__).name).is_file():
            return f"sources {_sources()}"
        changed = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "HEAD") + (f"+{_sources()}" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return f"sources {_sources()}"


def _sources() -> str:
    """Short hash of all `*.py` of the installed packages of jink."""
    specs = [importlib.util.find_spec(f"jink.{name}") for name in PACKAGES]
    roots = [Path(place) for spec in specs if spec for place in spec.submodule_search_locations or ()]
    return hash_files(*(path for root in roots for path in sorted(root.rglob("*.py"))))


def hash_files(*paths: Path) -> str:
    """Short hash of the contents of files, in this order; "" without any."""
    if not paths:
        return ""
    total = hashlib.sha256()
    for path in paths:
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()[:12]


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        return platform.processor()
    return platform.processor()
