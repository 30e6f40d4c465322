"""The head of the page and the tables of each scenario."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

import pandas as pd

from jink.training.ladder.pairing import BASE
from jink.training.report.scenes import MAIN, Failure, Rung, Scene
from jink.training.report.tables import board, digits, numbers_table, plain_board

__all__ = ["bar", "header", "section"]


def header(rows: pd.DataFrame, scenes: Sequence[Scene], failures: Sequence[Failure], title: str, source: str) -> str:
    """Title, counts of wins and losses, and a warning where versions are mixed."""
    ladders = [scene for scene in scenes if scene.simulated]
    against = [rung for scene in ladders for rung in scene.rungs if rung.verdict and rung.family != "limit"]
    verdicts = {name: sum(rung.verdict == name for rung in against) for name in ("better", "worse", "level")}
    broken = {name: sum(f.status == name for f in failures) for name in ("diverged", "error", "skipped")}
    estimators = {rung.estimator for scene in scenes for rung in scene.rungs}
    runs = max((rung.runs for scene in ladders for rung in scene.rungs), default=0)
    cards = [
        (f"{len(scenes)}", "scenario" if len(scenes) == 1 else "scenarios"),
        (f"{len(estimators)}", "estimators"),
        (f"{runs}" if runs else "–", "runs each, at most"),
    ]
    if against:
        cards.append(
            (f"{verdicts['better']} / {verdicts['worse']} / {verdicts['level']}", f"better / worse / level than {BASE}")
        )
    cards.append(
        (f"{broken['diverged']} / {broken['error']} / {broken['skipped']}", "diverged / failed / skipped cells")
    )
    tiles = "".join(f'<div class="card"><b>{value}</b><span>{text}</span></div>' for value, text in cards)
    commits = sorted(set(map(str, rows["commit"])))
    mixed = ""
    if len(commits) > 1:
        mixed = (
            f'<p class="notice">These rows come from {len(commits)} versions of the sources; differences between '
            "estimators may be differences between versions. See Provenance.</p>"
        )
    made = f"from {html.escape(source)}, " if source else ""
    return (
        f'<header><h1>{html.escape(title)}</h1><p class="quiet">Made {made}rows of '
        f"{html.escape(str(rows['started'].min())[:10])} to {html.escape(str(rows['started'].max())[:10])}. Everything "
        "below is made from these rows; every number has the command that makes it again.</p>"
        f'<div class="cards">{tiles}</div>{mixed}</header>'
    )


def bar(scenes: Sequence[Scene], first: int) -> str:
    """Choice of the scenario and links."""
    options = "".join(
        f'<option value="{i}"{" selected" if i == first else ""}>{html.escape(scene.suite)}: '
        f"{html.escape(scene.scenario)}</option>"
        for i, scene in enumerate(scenes)
    )
    links = "".join(
        f'<a href="#{name}">{text}</a>'
        for name, text in (
            ("board", "Leaderboard"),
            ("plots", "Plots"),
            ("play-part", "Playback"),
            ("failures", "Failures"),
            ("reading", "How to read"),
            ("provenance", "Provenance"),
        )
    )
    return (
        f'<div class="bar"><div><label for="scene">Scenario</label><select id="scene">{options}</select>'
        f'<nav aria-label="Sections">{links}</nav><button type="button" id="theme">Light / dark</button></div></div>'
    )


def section(scene: Scene, index: int) -> str:
    """Tables of one scenario."""
    title = f"<p>{html.escape(scene.title)}.</p>" if scene.title else ""
    suite = f'<span class="quiet small">suite {html.escape(scene.suite)}</span>'
    top = f"<h2>{html.escape(scene.scenario)} {suite}</h2>"
    if not scene.simulated:
        return f'<section data-scene="{index}">{top}{title}{plain_board(scene)}</section>'
    return (
        f'<section data-scene="{index}">{top}{title}<p>{_sentence(scene)}</p>{board(scene)}'
        f"<details><summary>Every number with its command</summary>{numbers_table(scene)}</details></section>"
    )


def _sentence(scene: Scene) -> str:
    """What happened, wins and losses alike."""
    contenders = [rung for rung in scene.rungs if rung.family != "limit" and MAIN in rung.values]
    if not contenders:
        return "No estimator has a position error here."
    best = min(contenders, key=lambda rung: rung.values[MAIN][0])
    said = [f"Smallest position error: <b>{html.escape(best.estimator)}</b>, {_with_band(best)}"]
    oracle = next((rung for rung in scene.rungs if rung.estimator == "oracle" and MAIN in rung.values), None)
    if oracle is not None:
        said.append(f"the oracle has {_with_band(oracle)}")
    names = {v: [html.escape(r.estimator) for r in scene.rungs if r.verdict == v and r.family != "limit"] for v in
             ("better", "worse", "level")}  # fmt: skip
    text = "; ".join(said) + "."
    if any(names.values()):
        told = [f"{word} {', '.join(names[word]) or 'nobody'}" for word in ("better", "level", "worse")]
        text += f" Against {BASE}, by paired 95 % intervals: {'; '.join(told)}."
    return text


def _with_band(rung: Rung) -> str:
    value, low, high = rung.values[MAIN]
    band = f" [{digits(low)}, {digits(high)}]" if math.isfinite(low) else ""
    return f"{digits(value)}{band} m"
