"""The end of the page: failures, how to read it, provenance."""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Sequence

import pandas as pd

from jink.training.ladder.pairing import BASE
from jink.training.ladder.scores import METRICS, Metric
from jink.training.report.scenes import Failure
from jink.training.report.tables import failures_table

__all__ = ["failed", "footer", "provenance", "reading"]


def failed(failures: Sequence[Failure]) -> str:
    """What did not come out."""
    if not failures:
        return '<h2 id="failures">Failures</h2><p>None: no cell was skipped, failed or diverged.</p>'
    return (
        '<h2 id="failures">Failures</h2><p>Diverged: more than half of the steps were called lost by the estimator '
        "itself; its numbers stay in the tables. Skipped and failed cells have none.</p>" + failures_table(failures)
    )


def reading() -> str:
    """How to read it, and what each metric is."""
    lines = "".join(
        f"<dt>{html.escape(_labelled(name, metric))}</dt><dd>{html.escape(metric.line)}</dd>"
        for name, metric in METRICS.items()
    )
    return (
        '<h2 id="reading">How to read</h2><p>All estimators see the same truth and the same noise: run <i>i</i> has '
        f"seed <i>first seed + i</i> for each of them. Differences to {BASE} are therefore paired, and “better” and "
        "“worse” mean that the 95 % interval of the paired difference lies on one side of zero; “level” is all else. "
        "IQM is the mean of the middle half of the runs. The oracle is told the noise of every sample, and the intent; "
        "the bound is what no unbiased estimator can beat.</p><details><summary>What each metric is</summary>"
        f'<dl class="facts">{lines}</dl></details>'
    )


def _labelled(name: str, metric: Metric) -> str:
    return name.replace("_", " ") + (f", {metric.unit}" if metric.unit else "")


def provenance(rows: pd.DataFrame) -> str:
    """What the rows were made by and with."""

    def listed(name: str) -> str:
        return "<br>".join(html.escape(_readable(text)) for text in sorted(set(map(str, rows[name])))[:12])

    facts = [
        ("sources", listed("commit")),
        ("versions", listed("versions")),
        ("machine", listed("machine")),
        ("suites", listed("suite")),
        ("computed", f"{html.escape(str(rows['started'].min()))} to {html.escape(str(rows['started'].max()))}"),
        ("rows", f"{len(rows)}"),
    ]
    cells = "".join(
        f"<details><summary>{html.escape(name)}</summary><pre>{html.escape(text)}</pre></details>"
        for name, text in _parameters(rows)
    )
    listing = "".join(f"<dt>{name}</dt><dd>{text}</dd>" for name, text in facts)
    return (
        f'<h2 id="provenance">Provenance</h2><dl class="facts">{listing}</dl>'
        f"<details><summary>Parameters of every cell</summary>{cells}</details>"
    )


def _parameters(rows: pd.DataFrame) -> Iterator[tuple[str, str]]:
    """What each scenario is, once, and then what each of its estimators was told besides."""
    told = rows.drop_duplicates(["suite", "scenario", "estimator"])
    for (suite, scenario), mine in told.groupby(["suite", "scenario"], sort=False):
        seen: set[str] = set()
        for estimator, text in mine[["estimator", "parameters"]].itertuples(index=False, name=None):
            for key, value in json.loads(text or "{}").items():
                line = json.dumps(value, separators=(", ", ": "))
                if key == "scenario" and line not in seen:
                    seen.add(line)
                    yield f"{suite}: {scenario}", line
            rest = {key: value for key, value in json.loads(text or "{}").items() if key != "scenario"}
            yield f"{suite}: {scenario}, {estimator}", json.dumps(rest, separators=(", ", ": "))


def _readable(text: str) -> str:
    """JSON as words; anything else as it is."""
    try:
        told = json.loads(text)
    except ValueError:
        return text
    return ", ".join(f"{key} {value}" for key, value in told.items()) if isinstance(told, dict) else text


def footer(source: str) -> str:
    """How the page was made."""
    made = (
        f"jink report {html.escape(source)} --out report.html"
        if source
        else "jink report rows.parquet --out report.html"
    )
    return f'<footer class="quiet small">This page needs no network. Made by <code>{made}</code>.</footer>'
