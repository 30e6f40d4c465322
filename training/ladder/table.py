"""The ladder as tables in a terminal, from rows only."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set

import pandas as pd
from rich.console import Console
from rich.table import Table

from jink.training.intervals import FEWEST_RUNS, Measured
from jink.training.ladder.pairing import BASE, Comparison, compare, compare_suites, in_order
from jink.training.ladder.rungs import LADDER
from jink.training.summary import number, plain_table

__all__ = ["print_ladder"]

MARK = " †"
"""Behind an estimator, or a number of it, that calls more than half of its own steps diverged."""
Marked = Set[tuple[str, str]]
_DETAILED = 2
"""Up to so many scenarios have a table each; more of them share one."""
_LEGEND = "1 s: of predictions; NEES: share in its 95 % band; div.: steps called diverged; us: microseconds a step"
_MEANS = ("prediction_rmse", "nees_inside", "lost", "diverged", "microseconds_per_step")


def print_ladder(console: Console, rows: pd.DataFrame) -> None:
    """Errors with intervals and paired differences to imm, failures and cost beside them; then what was left out."""
    found = compare(rows)
    scenarios = list(dict.fromkeys(each.scenario for each in found))
    found = in_order(found, LADDER)
    extra = _extra(rows)
    lost = rows[rows["status"] == "diverged"]
    marked = set(zip(lost["scenario"].astype(str), lost["estimator"].astype(str), strict=True))
    if len(scenarios) <= _DETAILED:
        for scenario in scenarios:
            _print_scenario(console, [each for each in found if each.scenario == scenario], extra, marked)
    else:
        _print_grid(console, found, scenarios, marked)
        _print_suite(console, rows, extra)
    _print_doubts(console, found)
    _print_reasons(console, rows)


def _print_doubts(console: Console, found: list[Comparison]) -> None:
    """Numbers without an interval, and differences that are not over all runs."""
    if any(each.runs < FEWEST_RUNS for each in found):
        console.print(f"fewer than {FEWEST_RUNS} runs have no interval: add --runs", style="yellow")
    for each in found:
        if each.difference is not None and each.pairs < each.runs:
            runs = f"{each.pairs} of {each.runs} runs, which both have"
            text = f"{each.estimator} ({each.scenario}): minus {BASE} over {runs}"
            console.print(text, style="dim", markup=False)


def _extra(rows: pd.DataFrame) -> dict[tuple[str, str, str], float]:
    """Scenario, estimator, metric -> its number, averaged over blocks by their runs."""
    mine = rows[rows["metric"].isin(_MEANS) & (rows["kind"] == "number")]
    weighted: dict[tuple[str, str, str], list[float]] = {}
    for scenario, estimator, metric, value, runs in zip(
        *(mine[name] for name in ("scenario", "estimator", "metric", "value", "runs")), strict=True
    ):
        total = weighted.setdefault((str(scenario), str(estimator), str(metric)), [0.0, 0.0])
        total[0] += runs * (value**2 if metric == "prediction_rmse" else value)
        total[1] += runs
    return {
        key: math.sqrt(top / count) if key[2] == "prediction_rmse" else top / count
        for key, (top, count) in weighted.items()
    }


def _print_scenario(
    console: Console, found: list[Comparison], extra: Mapping[tuple[str, str, str], float], marked: Marked
) -> None:
    first = found[0]
    table = plain_table(
        "estimator", "RMS", "IQM", f"minus {BASE} [95 %]", "1 s", "NEES", "lost", "div.", "us",
        title=f"{first.scenario}: position error in m, {first.runs} runs, ± half of the 95 % interval; paired",
    )  # fmt: skip
    _keep_whole(table)
    for each in found:
        more = {name: extra.get((each.scenario, each.estimator, name), math.nan) for name in _MEANS}
        table.add_row(
            each.estimator + (MARK if (each.scenario, each.estimator) in marked else ""),
            with_half(each.value),
            number(each.iqm.value, 3),
            "" if each.difference is None else bracketed(each.difference, "+", 2),
            number(more["prediction_rmse"], 3),
            _share(more["nees_inside"]),
            _share(more["lost"]),
            _share(more["diverged"]),
            number(more["microseconds_per_step"], 3),
        )
    console.print(table)
    console.print(_LEGEND, style="dim")


def _print_grid(console: Console, found: list[Comparison], scenarios: list[str], marked: Marked) -> None:
    """Estimators by scenarios, in as many tables as the width asks for."""
    numbers = {
        (each.estimator, each.scenario): with_half(each.value)
        + (MARK if (each.scenario, each.estimator) in marked else "")
        for each in found
    }
    names = list(dict.fromkeys(each.estimator for each in found))
    title = f"{found[0].suite}: RMS position m ± half of its 95 % interval, {found[0].runs} runs"
    room = console.width - max(map(len, ("estimator", *names))) - 4
    parts: list[list[str]] = [[]]
    left = room
    for scenario in scenarios:
        width = 3 + max(len(scenario.removesuffix("-v0")), *(len(numbers.get((name, scenario), "-")) for name in names))
        if width > left and parts[-1]:
            parts.append([])
            left = room
        parts[-1].append(scenario)
        left -= width
    for part in parts:
        table = plain_table("estimator", *(name.removesuffix("-v0") for name in part), title=title)
        _keep_whole(table)
        for name in names:
            table.add_row(name, *(numbers.get((name, scenario), "-") for scenario in part))
        console.print(table)
        title = ""


def _print_suite(console: Console, rows: pd.DataFrame, extra: Mapping[tuple[str, str, str], float]) -> None:
    table = plain_table(
        "estimator", f"over {BASE}", "lost", "diverged", "us/step", "scenarios",
        title=f"the whole suite: geometric mean of the ratios to {BASE} [95 %, paired]; means of the rest",
    )  # fmt: skip
    _keep_whole(table)
    overall = in_order(compare_suites(rows), LADDER)
    if not overall:
        console.print(
            f"no {BASE} among the estimators, so nothing to compare with: add --estimator {BASE}", style="dim"
        )
        return
    for each in overall:
        means = {
            name: [value for (_, one, metric), value in extra.items() if one == each.estimator and metric == name]
            for name in _MEANS
        }
        lost, diverged, cost = (
            sum(means[name]) / len(means[name]) if means[name] else math.nan
            for name in ("lost", "diverged", "microseconds_per_step")
        )
        table.add_row(
            each.estimator, bracketed(each.ratio), _share(lost), _share(diverged), number(cost, 3), str(each.scenarios)
        )
    console.print(table)


def _keep_whole(table: Table) -> None:
    """Names and numbers are not broken into lines."""
    for column in table.columns:
        column.no_wrap = True
        column.overflow = "fold"


def with_half(measured: Measured) -> str:
    """Value and half of its interval."""
    half = (measured.high - measured.low) / 2
    shown = number(measured.value, 3)
    return shown if math.isnan(half) else f"{shown} ±{number(half, 2)}"


def bracketed(measured: Measured, sign: str = "", digits: int = 3) -> str:
    """Value [low, high], all with the decimals of the value's or the interval's leading digits."""
    value, _, low, high, _ = measured
    if not math.isfinite(value):
        return str(value)
    scale = max(abs(value), (high - low) / 2 if math.isfinite(high - low) else 0.0)
    decimals = min(4, max(0, digits - 1 - math.floor(math.log10(scale)))) if scale else 0
    shown = f"{value:{sign}.{decimals}f}"
    return shown if math.isnan(low) else f"{shown} [{low:{sign}.{decimals}f}, {high:{sign}.{decimals}f}]"


def _share(value: float) -> str:
    if math.isnan(value):
        return "-"
    return f"{100 * value:.0f} %" if value == 0 or value >= 0.095 else f"{100 * value:.1f} %"


def _print_reasons(console: Console, rows: pd.DataFrame) -> None:
    for status, style in (("skipped", "dim"), ("diverged", "yellow"), ("error", "red")):
        marked = rows[rows["status"] == status]
        for reason, group in marked.groupby("reason" if status != "diverged" else "status", sort=False):
            where: dict[str, list[str]] = {}
            for estimator, scenario in zip(group["estimator"], group["scenario"], strict=True):
                where.setdefault(str(estimator), []).append(str(scenario).removesuffix("-v0"))
            names = ", ".join(f"{name} ({', '.join(dict.fromkeys(some))})" for name, some in where.items())
            why = "more than half of the steps" if status == "diverged" else str(reason)
            sign = MARK.lstrip() + " " if status == "diverged" else ""
            console.print(f"{sign}{status}, {why}: {names}", style=style, markup=False)
