"""Tables of the suites, made from rows only."""

from __future__ import annotations

import math
from pathlib import PurePosixPath
from typing import Any

import pandas as pd
from rich.console import Console
from rich.markup import escape

from jink.training.recorded_suite import ESTIMATORS
from jink.training.summary import number, plain_table

__all__ = ["print_many_suite", "print_published", "print_recorded"]


def print_published(console: Console, rows: pd.DataFrame) -> None:
    """Ours beside the published numbers, with half of our 95 % interval; then scenarios without any."""
    ok = rows[rows["metric"] != ""]
    known = ok[ok["published"].notna()]
    table = plain_table(
        "scenario", "estimator", "metric", "ours", "published", "off by", "±95 %", "unit", "runs",
        title="published results", words=3,
    )  # fmt: skip
    last = ""
    for row in known.itertuples():
        spread = ""
        if not math.isnan(_number(row.published_high)):
            spread = f" ±{(_number(row.published_high) - _number(row.published_low)) / 2:.2g}"
        published, value = _number(row.published), _number(row.value)
        table.add_row(
            str(row.scenario) if row.scenario != last else "",
            str(row.estimator),
            str(row.metric),
            number(value),
            number(published) + spread,
            f"{100 * (value / published - 1):+.1f} %",
            _spread(row).strip() or "-",
            str(row.unit),
            str(row.runs),
        )
        last = str(row.scenario)
    if len(known):
        console.print(table)
    others = ok[ok["published"].isna() & (ok["metric"] == "position_rms")]
    if len(others):
        shown = others.assign(shown=[number(_number(row.value), 3) + _spread(row, 1) for row in others.itertuples()])
        pivot = shown.pivot_table(index="scenario", columns="estimator", values="shown", aggfunc="last", sort=False)
        title = "position error without published numbers, m (± half of the 95 % interval)"
        table = plain_table("scenario", *map(str, pivot.columns), title=title)
        for scenario, values in pivot.fillna("-").iterrows():
            table.add_row(str(scenario), *map(str, values))
        console.print(table)
    _print_reasons(console, rows)


def print_recorded(console: Console, rows: pd.DataFrame) -> None:
    """Errors where there is truth; log-likelihood and NIS of one-step predictions elsewhere."""
    with_truth = set(rows.loc[rows["metric"] == "position_rmse", "scenario"])
    _print_grid(
        console,
        rows[rows["scenario"].isin(with_truth)],
        "position error against truth, m: root mean square ± half of its 95 % interval (median)",
        ESTIMATORS,
        ("position_rmse", "position_median"),
    )
    _print_grid(
        console,
        rows[~rows["scenario"].isin(with_truth)],
        "one-step prediction: log-likelihood per step without the worst 1 %, nat (share in the 95 % band)",
        ESTIMATORS[1:],
        ("log_likelihood_trimmed", "nis_inside"),
    )
    skipped = rows[
        (rows["status"] == "skipped") & ~rows["scenario"].isin(set(rows.loc[rows["status"] == "ok", "scenario"]))
    ]
    for reason, group in skipped.groupby("reason", sort=False):
        names = ", ".join(dict.fromkeys(_short(name) for name in group["scenario"]))
        console.print(f"skipped, {escape(str(reason))}: {escape(names)}", style="dim")
    _print_reasons(console, rows)


def print_many_suite(console: Console, rows: pd.DataFrame) -> None:
    """GOSPA with half of its 95 % interval, its parts in numbers of targets, identity switches and time."""
    values = rows[rows["metric"] != ""]
    table = plain_table(
        "scene", "tracker", "GOSPA m", "missed", "false", "switches", "breaks", "ms/scan", "runs",
        title="many targets from detections alone; means over scans and runs", words=2,
    )  # fmt: skip
    last = ""
    for (scene, tracker), cell in values.groupby(["scenario", "estimator"], sort=False):
        by_metric = {row.metric: row for row in cell.itertuples()}
        if "gospa" not in by_metric:
            continue
        shown = [number(_number(by_metric["gospa"].value), 3) + _spread(by_metric["gospa"])]
        shown += [number(_number(by_metric[name].value), 2) for name in ("missed", "false", "switches", "breaks")]
        shown += [number(_number(by_metric["time"].value), 2), str(by_metric["gospa"].runs)]
        table.add_row(str(scene) if scene != last else "", str(tracker), *shown)
        last = str(scene)
    if len(values):
        console.print(table)
    _print_reasons(console, rows)


def _print_grid(
    console: Console, rows: pd.DataFrame, title: str, estimators: tuple[str, ...], metrics: tuple[str, str]
) -> None:
    values = rows[rows["metric"].isin(metrics)]
    if values.empty:
        return
    table = plain_table("file", *estimators, title=title)
    cells = {(row.scenario, row.estimator, row.metric): row for row in values.itertuples()}
    for scenario in dict.fromkeys(values["scenario"]):
        shown = []
        for estimator in estimators:
            first, second = (cells.get((scenario, estimator, metric)) for metric in metrics)
            if first is None or second is None:
                shown.append("-")
            else:
                shown.append(f"{number(_number(first.value))}{_spread(first)} ({number(_number(second.value), 3)})")
        table.add_row(escape(_short(scenario)), *shown)
    console.print(table)


def _print_reasons(console: Console, rows: pd.DataFrame) -> None:
    for status, style in (("diverged", "yellow"), ("error", "red")):
        marked = rows[rows["status"] == status]
        for (scenario, reason), group in marked.groupby(["scenario", "reason"], sort=False):
            names = ", ".join(dict.fromkeys(map(str, group["estimator"])))
            console.print(f"{status}: {_short(scenario)} ({names}): {reason}", style=style, markup=False)


def _short(scenario: Any) -> str:
    """A file without its folder; a pattern as it is."""
    name = str(scenario)
    return name if "*" in name else PurePosixPath(name).name


def _spread(row: Any, digits: int = 2) -> str:
    """Half of the interval, short; nothing where there is none."""
    half = (_number(row.high) - _number(row.low)) / 2
    return "" if math.isnan(half) else f" ±{number(half, digits)}"


def _number(value: Any) -> float:
    return float(value)
