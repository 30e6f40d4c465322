"""The report: one HTML file that needs nothing else, made from rows alone."""

from __future__ import annotations

import html
import json
import math
from importlib import resources
from pathlib import Path
from typing import Any

import pandas as pd
from plotly.offline import get_plotlyjs

from jink.training.ladder.scores import METRICS, Metric
from jink.training.report.overview import overview
from jink.training.report.plots import plots
from jink.training.report.scenes import Scene, collect
from jink.training.report.sections import bar, header, section
from jink.training.report.words import failed, footer, provenance, reading

__all__ = ["make_page", "write_report"]

_FIRST = ("joint", "surge", "switch")
"""Suites one wants to see first."""


def write_report(rows: pd.DataFrame, out: Path, title: str = "Jink benchmark", source: str = "") -> None:
    """Write the page; a reader finds the old file or the whole new one.

    Args:
        rows: of `jink bench`.
        out: .html file.
        title: heading of the page.
        source: names of the files that the rows come from.

    Raises:
        ValueError: there are no rows.
        OSError: it cannot be written.
    """
    page = make_page(rows, title, source)
    part = out.with_name(f"{out.name}.part")
    try:
        part.write_text(page, encoding="utf-8")
        part.replace(out)
    finally:
        part.unlink(missing_ok=True)


def make_page(rows: pd.DataFrame, title: str = "Jink benchmark", source: str = "") -> str:
    """The page as text; arguments and errors as `write_report`."""
    if rows.empty:
        raise ValueError("report: rows must not be empty; got none. Run jink bench --out rows.parquet first.")
    scenes, failures = collect(rows)
    first = min(range(len(scenes)), key=lambda i: _rank(scenes[i], i))
    facts = {"scenes": len(scenes), "first": first}
    parts = [
        _head(title),
        f'<body><a class="skip" href="#main">To the results</a>{header(rows, scenes, failures, title, source)}',
        bar(scenes, first),
        '<main id="main">',
        overview(rows, scenes),
        '<div id="board"></div>',  # of whichever scenario is shown
        "".join(section(scene, index) for index, scene in enumerate(scenes)),
        plots(),
        failed(failures),
        reading(),
        provenance(rows),
        "</main>",
        footer(source),
        '<div id="said" class="skip" role="status" aria-live="polite"></div>',
        _data("facts", facts),
        *(_data(f"scene-{index}", _plain(scene)) for index, scene in enumerate(scenes)),
        f"<script>{get_plotlyjs()}</script>",
        f"<script>{_own('report.js')}</script></body></html>\n",
    ]
    return "".join(parts)


def _rank(scene: Scene, index: int) -> tuple[int, int]:
    usual = _FIRST.index(scene.suite) if scene.suite in _FIRST else len(_FIRST)
    return (usual if scene.simulated else len(_FIRST) + 1), index


def _own(name: str) -> str:
    return (resources.files("jink.training.report") / name).read_text(encoding="utf-8")


def _data(name: str, value: Any) -> str:
    # "</script" and "<!--" would end or hide the element, whatever string they stand in.
    text = json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{text}</script>'


def _plain(scene: Scene) -> dict[str, Any]:
    """A scene as its plots want it."""
    named: dict[str, Metric] = {
        **METRICS,
        "microseconds_per_step": Metric("us", "once", "time of one step, one thread"),
    }
    metrics = {
        name: {"unit": metric.unit, "line": metric.line[:1].upper() + metric.line[1:]}
        for name, metric in named.items()
        if sum(1 for rung in scene.rungs if math.isfinite(rung.values.get(name, (math.nan,))[0])) > 1
    }
    rungs = [
        {"name": rung.estimator, "family": rung.family, "status": rung.status,
         "values": {name: [_finite(v) for v in triple] for name, triple in rung.values.items() if name in metrics}}
        for rung in scene.rungs
        if rung.values
    ]  # fmt: skip
    return {"scenario": scene.scenario, "metrics": metrics, "rungs": rungs, "curves": scene.curves, "play": scene.play}


def _finite(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None


def _head(title: str) -> str:
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        # Nothing outside this file is ever asked for, and the browser holds us to it.
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'unsafe-inline'; "
        "style-src 'unsafe-inline'; img-src data: blob:\">"
        f'<link rel="icon" href="data:,"><title>{html.escape(title)}</title><style>{_own("report.css")}</style></head>'
    )
