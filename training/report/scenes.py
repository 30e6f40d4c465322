"""From rows to what the report shows: one `Scene` for each scenario, with its ladder, curves and playback."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jink.training.intervals import Measured
from jink.training.ladder.pairing import BASE, compare
from jink.training.ladder.rungs import FACTORS, LADDER
from jink.training.ladder.scores import METRICS
from jink.training.report.plain import rounded
from jink.training.report.playback import playback_of

__all__ = ["FAMILIES", "MAIN", "Failure", "Number", "Rung", "Scene", "collect"]

MAIN = "position_rmse"
FAMILIES: dict[str, str] = {
    "raw": "measurement",
    **dict.fromkeys(("kf-cv", "kf-ca", "singer", "ukf-ct"), "single filter"),
    **dict.fromkeys((*FACTORS, "sage-husa", "vb-noise"), "adaptive filter"),
    **dict.fromkeys(("imm", "student-t-imm", "robust-imm"), "bank"),
    **dict.fromkeys(("intent-imm", "joint-imm", "agent"), "Jink"),
    **dict.fromkeys(("oracle", "bound"), "limit"),
}
"""Estimator -> family: colour and marker in the plots. All others are "other"."""
_TIMED = "microseconds_per_step"
_COMPARED = (MAIN, "velocity_rmse", "prediction_rmse", "peak_after_switch", "peak_in_surge", "nees", "lost")
"""Metrics that are compared with the base, by paired intervals."""
Triple = tuple[float, float, float]


class Number(NamedTuple):
    """One number of a cell, with what makes it again."""

    metric: str
    value: float
    low: float
    high: float
    unit: str
    interval: str
    published: Triple
    runs: int
    seed: int
    command: str


class Rung(NamedTuple):
    """One estimator on one scenario; numbers over all its runs, differences to the base paired by seed."""

    estimator: str
    family: str
    status: str
    reason: str
    runs: int
    values: dict[str, Triple]
    iqm: Triple | None
    difference: dict[str, Triple]
    ratio: Triple | None
    numbers: tuple[Number, ...]

    @property
    def verdict(self) -> str:
        """Against the base: better, worse, level, or "" where there is nothing to compare."""
        found = self.difference.get(MAIN)
        if found is None or not np.isfinite(found).all():
            return ""
        return "better" if found[2] < 0 else "worse" if found[1] > 0 else "level"


class Failure(NamedTuple):
    """A cell that was skipped, ended in an error, or diverged."""

    suite: str
    scenario: str
    estimator: str
    status: str
    reason: str
    command: str


class Scene(NamedTuple):
    """One scenario of one suite."""

    suite: str
    scenario: str
    title: str
    rungs: tuple[Rung, ...]
    curves: dict[str, Any]
    play: dict[str, Any] | None

    @property
    def simulated(self) -> bool:
        """Whether its rows hold runs, so that there is a ladder."""
        return any(rung.values for rung in self.rungs)


def collect(rows: pd.DataFrame) -> tuple[tuple[Scene, ...], tuple[Failure, ...]]:
    """Scenes in the order of the rows, and everything that did not come out.

    Args:
        rows: of `jink bench`, one or several files of it; of a cell computed twice, the later one counts.
    """
    rows = rows.sort_values("started", kind="stable").reset_index(drop=True)
    compared: dict[tuple[str, str, str], dict[str, Any]] = {}
    for metric in METRICS:
        base = BASE if metric in _COMPARED else ""
        with np.errstate(all="ignore"):  # ratios of zeros: nothing lost over nothing lost
            found = compare(rows, metric, base=base)
        for one in found:
            compared.setdefault((one.suite, one.scenario, one.estimator), {})[metric] = one
    scenes = []
    for (suite, scenario), mine in rows.groupby(["suite", "scenario"], sort=False):
        rungs = [
            _rung(str(name), _latest(part), compared.get((str(suite), str(scenario), str(name)), {}))
            for name, part in mine.groupby("estimator", sort=False)
            if name != "truth"
        ]
        rungs.sort(key=lambda rung: _place(rung.estimator))
        scenes.append(
            Scene(str(suite), str(scenario), _title(mine), tuple(rungs), _curves(mine), playback_of(mine, _place))
        )
    return tuple(scenes), tuple(_failures(rows))


def _place(estimator: str) -> tuple[int, str]:
    """From the measurement up to the bound; strangers below the limits."""
    if estimator in LADDER:
        return LADDER.index(estimator), ""
    return LADDER.index("oracle") - 1, estimator


def _latest(part: pd.DataFrame) -> pd.DataFrame:
    """Rows of the blocks of one estimator; of a block computed twice, those of the later time."""
    last = part.groupby(["runs", "seed"])["started"].transform("max")
    return part[part["started"] == last]


def _rung(name: str, part: pd.DataFrame, compared: Mapping[str, Any]) -> Rung:
    numbers = part[(part["kind"] == "number") & (part["metric"] != "")]
    values = {metric: _triple(one.value) for metric, one in compared.items()}
    # Committed rows may keep the runs of the main metric only: the others are then the numbers of their cells.
    for metric, cells in numbers.groupby("metric", sort=False):
        if metric in METRICS and len(cells) == 1 and not math.isfinite(values.get(str(metric), (math.nan,))[0]):
            values[str(metric)] = tuple(float(cells[name].iloc[0]) for name in ("value", "low", "high"))  # type: ignore[assignment]
    timed = numbers[numbers["metric"] == _TIMED]["value"]
    if len(timed):
        values[_TIMED] = (float(timed.mean()), math.nan, math.nan)
    main = compared.get(MAIN)
    worst = part.iloc[int(np.argmax(part["status"].map({"ok": 0, "diverged": 1, "skipped": 2, "error": 3}).to_numpy()))]
    return Rung(
        estimator=name,
        family=FAMILIES.get(name.partition("@")[0], "other"),
        status=str(worst["status"]),
        reason=str(worst["reason"]),
        runs=main.runs if main is not None else int(part["runs"].iloc[0]),
        values=values,
        iqm=None if main is None else _triple(main.iqm),
        difference={metric: _triple(one.difference) for metric, one in compared.items() if one.difference is not None},
        ratio=None if main is None or main.ratio is None else _triple(main.ratio),
        numbers=tuple(_number(row) for row in numbers.to_dict("records")),
    )


def _number(row: Mapping[Any, Any]) -> Number:
    return Number(
        str(row["metric"]),
        float(row["value"]),
        float(row["low"]),
        float(row["high"]),
        str(row["unit"]),
        str(row["interval"]),
        (float(row["published"]), float(row["published_low"]), float(row["published_high"])),
        int(row["runs"]),
        int(row["seed"]),
        str(row["command"]),
    )


def _triple(measured: Measured) -> Triple:
    return float(measured.value), float(measured.low), float(measured.high)


def _title(mine: pd.DataFrame) -> str:
    """What the scenario says it is; "" where its rows do not tell."""
    for text in mine["parameters"].unique():
        told = json.loads(text).get("scenario")
        if isinstance(told, dict) and told.get("title"):
            return str(told["title"])
    return ""


def _curves(mine: pd.DataFrame) -> dict[str, Any]:
    """Metric -> unit, times, band and one line for each estimator; lines of several blocks are those of the last."""
    found: dict[str, Any] = {}
    curves = mine[mine["kind"] == "curve"]
    order = sorted(curves["estimator"].unique(), key=_place)
    for metric, some in curves.groupby("metric", sort=False):
        latest = {row["estimator"]: row for row in some.to_dict("records")}
        first = next(iter(latest.values()))
        found[str(metric)] = {
            "unit": first["unit"],
            "low": _plain(first["low"]),
            "high": _plain(first["high"]),
            "lines": {
                name: [rounded(latest[name]["at"]), rounded(latest[name]["samples"])]
                for name in order
                if name in latest
            },
        }
    return found


def _failures(rows: pd.DataFrame) -> Iterable[Failure]:
    keys = ["suite", "scenario", "estimator", "runs", "seed"]
    last = rows.drop_duplicates(keys, keep="last")
    for row in last[last["status"] != "ok"].to_dict("records"):
        yield Failure(*(str(row[name]) for name in Failure._fields))


def _plain(value: Any) -> float | None:
    return float(f"{value:.4g}") if value is not None and math.isfinite(value) else None
