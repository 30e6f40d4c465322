"""Whole suites at a glance: the mean ratio to the base, and how often each estimator won and lost."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from jink.training.ladder.pairing import BASE, Overall, compare_suites
from jink.training.report.scenes import FAMILIES, MAIN, Scene
from jink.training.report.tables import Cell, digits, interval, table

__all__ = ["overview"]

_FEWEST = 2
"""Scenarios of a suite that make an overview worth while."""


def overview(rows: pd.DataFrame, scenes: Sequence[Scene]) -> str:
    """One table for each suite with several scenarios; "" without any.

    Args:
        rows: of `jink bench`.
        scenes: of the same rows.
    """
    with np.errstate(all="ignore"):
        found = compare_suites(rows)
    parts = []
    for suite in dict.fromkeys(scene.suite for scene in scenes if scene.simulated):
        members = [scene for scene in scenes if scene.suite == suite and scene.simulated]
        if len(members) < _FEWEST:
            continue
        ratios = {one.estimator: one for one in found if one.suite == suite}
        order = list(dict.fromkeys(rung.estimator for scene in members for rung in scene.rungs if MAIN in rung.values))
        body = []
        for name in order:
            verdicts = [rung.verdict for scene in members for rung in scene.rungs if rung.estimator == name]
            one = ratios.get(name)
            counts = {word: verdicts.count(word) for word in ("better", "level", "worse")}
            body.append(
                (
                    [
                        Cell(html.escape(name)),
                        interval(None if one is None else (one.ratio.value, one.ratio.low, one.ratio.high)),
                        *(
                            Cell(f'<span class="{word if n else ""}">{n}</span>', float(n))
                            for word, n in counts.items()
                        ),
                        Cell(str(0 if one is None else one.scenarios)),
                        _missing(one),
                    ],
                    "base" if name == BASE else "",
                )
            )
        headings = [
            "estimator", f"error over that of {BASE} [95 %]", "▼ better", "= level", "▲ worse", "scenarios", "missing",
        ]  # fmt: skip
        caption = f"Suite {suite}: geometric mean over its scenarios; below 1 is better than {BASE}."
        parts.append(
            f"<details><summary>{html.escape(suite)}, {len(members)} scenarios: {_best(ratios)}</summary>"
            f"{table(caption, headings, body)}</details>"
        )
    return f'<h2 id="overview">Suites</h2>{"".join(parts)}' if parts else ""


def _missing(one: Overall | None) -> Cell:
    """How many scenarios an estimator has no rows of; their names on request."""
    names = () if one is None else one.missing
    return Cell(f'<span title="{html.escape(", ".join(names), quote=True)}">{len(names) or "none"}</span>', len(names))


def _best(ratios: Mapping[str, Overall]) -> str:
    """The three smallest ratios of estimators that have rows of every scenario; limits left out."""
    known = [one for one in ratios.values() if FAMILIES.get(one.estimator) != "limit" and not one.missing]
    known = [one for one in known if np.isfinite(one.ratio.value)]
    first = sorted(known, key=lambda one: one.ratio.value)[:3]
    return ", ".join(f"{html.escape(one.estimator)} {digits(one.ratio.value)}" for one in first) + f" of {BASE}"
