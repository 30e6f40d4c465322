"""Tables of the report as HTML: readable without a script, sorted by one."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from jink.training.ladder.pairing import BASE
from jink.training.ladder.scores import METRICS
from jink.training.report.scenes import MAIN, Failure, Rung, Scene, Triple

__all__ = ["board", "failures_table", "numbers_table", "plain_board", "table"]

_SHARES = ("nees_inside", "nis_inside", "intent_accuracy", "surge_accuracy", "lost", "diverged", "repaired")
_ARROWS = {"better": "▼ better", "worse": "▲ worse", "level": "= level"}
_COLUMNS = (
    "velocity_rmse", "prediction_rmse", "peak_after_switch", "peak_in_surge", "nees_inside", "nis_inside",
    "intent_accuracy", "intent_delay", "surge_accuracy", "lost", "diverged",
)  # fmt: skip
"""Of the leaderboard, after the position error; those that no estimator has are left out."""


class Cell(NamedTuple):
    """What a cell shows (HTML), and what it is sorted by."""

    shown: str
    by: float | str = ""


def table(caption: str, headings: Sequence[str], rows: Iterable[tuple[Sequence[Cell], str]], words: int = 1) -> str:
    """A sortable table in a frame that scrolls sideways.

    Args:
        caption: what it holds.
        headings: the first heads the row.
        rows: cells, and the class of the row.
        words: how many columns from the left hold words.
    """
    head = "".join(
        f'<th scope="col"{_words(i, words)}><button type="button" class="sort">{html.escape(h)}</button></th>'
        for i, h in enumerate(headings)
    )
    body = "".join(
        f'<tr class="{kind}">' + "".join(_cell(cell, i, words) for i, cell in enumerate(cells)) + "</tr>"
        for cells, kind in rows
    )
    name = html.escape(caption, quote=True)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{name}"><table><caption>{html.escape(caption)}'
        f"</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _words(column: int, words: int) -> str:
    return ' class="words"' if column < words else ""


def _cell(cell: Cell, column: int, words: int) -> str:
    by = "" if isinstance(cell.by, float) and not math.isfinite(cell.by) else cell.by
    value = f' data-v="{html.escape(str(by), quote=True)}"' if by != "" or isinstance(cell.by, float) else ""
    if column == 0:
        return f'<th scope="row"{value}>{cell.shown}</th>'
    return f"<td{_words(column, words)}{value}>{cell.shown}</td>"


def board(scene: Scene) -> str:
    """The leaderboard of a simulated scenario, from the measurement to the bound."""
    metrics = [name for name in _COLUMNS if any(name in rung.values for rung in scene.rungs)]
    timed = any("microseconds_per_step" in rung.values for rung in scene.rungs)
    headings = ["estimator", "position error, m [95 %]", "IQM, m", f"against {BASE}", f"difference to {BASE}, m [95 %]"]
    headings += (
        ["command", "state"] + [_heading(name) for name in metrics] + (["us a step"] if timed else []) + ["runs"]
    )
    rows = [(_board_row(rung, metrics, timed), "base" if rung.estimator == BASE else "") for rung in scene.rungs]
    return table(
        "Click a heading to sort. Intervals are bootstraps over runs, differences paired by seed.", headings, rows
    )


def _board_row(rung: Rung, metrics: Sequence[str], timed: bool) -> list[Cell]:
    difference, verdict = rung.difference.get(MAIN), rung.verdict
    cells = [
        Cell(html.escape(rung.estimator)),
        interval(rung.values.get(MAIN)),
        interval(rung.iqm, band=False),
        Cell(f'<span class="{verdict}">{_ARROWS[verdict]}</span>' if verdict else "–", verdict),
        interval(difference, signed=True),
    ]
    kind = "" if rung.status == "ok" else ' class="worse"'
    state = f'<span{kind} title="{html.escape(rung.reason, quote=True)}">{rung.status}</span>'
    commands = list(dict.fromkeys(number.command for number in rung.numbers))
    cells += [command("\n".join(commands), short=True), Cell(state, rung.status)]
    cells += [interval(rung.values.get(name), band=False, share=name in _SHARES) for name in metrics]
    if timed:
        cells.append(interval(rung.values.get("microseconds_per_step"), band=False))
    return [*cells, Cell(str(rung.runs), float(rung.runs))]


def plain_board(scene: Scene) -> str:
    """A scenario without runs: its numbers, published ones beside them."""
    compared = any(math.isfinite(n.published[0]) for rung in scene.rungs for n in rung.numbers)
    headings = ["estimator", "metric", "value [95 %]", "unit"] + (["published", "off by"] if compared else [])
    rows = []
    for rung in scene.rungs:
        if not rung.numbers:
            state = f'<span class="worse">{rung.status}</span> <span class="quiet">{html.escape(rung.reason)}</span>'
            blank = [Cell("–")] * (len(headings) - 2)
            rows.append(([Cell(html.escape(rung.estimator)), Cell(state), *blank, Cell("")], ""))
        for number in rung.numbers:
            cells = [
                Cell(html.escape(rung.estimator)),
                Cell(number.metric.replace("_", " ")),
                interval((number.value, number.low, number.high)),
                Cell(html.escape(number.unit)),
            ]
            if compared:
                known = number.published
                off = 100.0 * (number.value / known[0] - 1.0) if math.isfinite(known[0]) and known[0] else math.nan
                cells += [interval(known), Cell(f"{off:+.1f} %" if math.isfinite(off) else "–", off)]
            rows.append(([*cells, command(number.command)], ""))
    return table(f"All numbers of {scene.scenario}.", [*headings, "command"], rows, words=2)


def numbers_table(scene: Scene) -> str:
    """Every number of a scenario with what makes it again."""
    rows = [
        (
            [
                Cell(html.escape(rung.estimator)),
                Cell(number.metric.replace("_", " ")),
                interval((number.value, number.low, number.high)),
                Cell(html.escape(number.unit)),
                Cell(html.escape(number.interval)),
                Cell(str(number.runs), float(number.runs)),
                Cell(str(number.seed), float(number.seed)),
                command(number.command, short=True),
            ],
            "",
        )
        for rung in scene.rungs
        for number in rung.numbers
    ]
    headings = ["estimator", "metric", "value [95 %]", "unit", "interval", "runs", "first seed", "command"]
    return table(f"{len(rows)} numbers, one cell each; the command of each can be copied.", headings, rows, words=2)


def failures_table(failures: Sequence[Failure]) -> str:
    """What was skipped, ended in an error, or diverged."""
    rows = [
        (
            [Cell(html.escape(f.estimator)), Cell(html.escape(f.scenario)), Cell(html.escape(f.suite)),
             Cell(f'<span class="worse">{f.status}</span>', f.status), Cell(html.escape(f.reason)), command(f.command)],
            "",
        )
        for f in failures
    ]  # fmt: skip
    headings = ["estimator", "scenario", "suite", "state", "why", "command"]
    return table(f"{len(rows)} cells.", headings, rows, words=5)


def interval(triple: Triple | None, *, band: bool = True, signed: bool = False, share: bool = False) -> Cell:
    """A number with its interval; a dash where it was not measured."""
    if triple is None or math.isnan(triple[0]):
        return Cell("–", math.nan)
    value, low, high = (100.0 * np.asarray(triple)).tolist() if share else triple
    text = digits(value, signed) + (" %" if share else "")
    if band and math.isfinite(low) and math.isfinite(high):
        text += f' <span class="band">[{digits(low, signed)}, {digits(high, signed)}]</span>'
    return Cell(text, value)


def digits(value: float, signed: bool = False) -> str:
    """Four digits, as one reads them."""
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:+.4g}" if signed else f"{value:.4g}"
    if "e" in text and abs(value) >= 1e4:
        text = f"{value:+,.0f}" if signed else f"{value:,.0f}"
    return text.replace("-", "−")


def command(text: str, short: bool = False) -> Cell:
    """A command, and a button that copies it; only the button where there is little room."""
    if not text:
        return Cell("")
    safe = html.escape(text, quote=True)
    first = html.escape(text.partition("\n")[0])
    more = text.count("\n")
    shown = "" if short else f' <code title="{safe}">{first}</code>' + (f" and {more} more" if more else "")
    button = f'<button type="button" class="copy" data-copy="{safe}" aria-label="Copy the command">'
    return Cell(f"{button}Copy</button>{shown}")


def _heading(metric: str) -> str:
    unit = "%" if metric in _SHARES else METRICS[metric].unit
    return metric.replace("_", " ") + (f", {unit}" if unit else "")
