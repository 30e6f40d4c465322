"""A model of intents in words: what is printed, and the README beside its files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from jink.estimators.tracks import Tracks
from jink.intent.describing import describe_phase
from jink.intent.model import IntentModel
from jink.intent.selection import RESOLVABLE, gain_over_one
from jink.training.intent_graphs import CurvePoint
from jink.training.summary import number, plain_table
from jink.training.wording import counted

__all__ = ["print_model", "print_trained", "write_readme"]


def print_trained(console: Console, report: Any) -> None:
    """Print the summary of one training (`TrainReport`)."""
    tracks = report.tracks
    rows = int(tracks.lengths.sum())
    console.print(
        f"[bold]{escape(tracks.source)}[/bold]: {counted(len(tracks), 'track')}, {rows} rows in {tracks.axes} axes"
    )
    for note in tracks.notes:
        console.print(f"  {escape(note)}", style="dim")
    if report.finished_before:
        console.print("already trained with these tracks and options; --fresh trains again", style="yellow")
    if report.resumed:
        console.print("went on from its checkpoint", style="dim")
    print_model(console, report.model)
    _print_curve(console, report.curve, len(report.model.intents))
    if not report.resolvable:
        console.print(unresolved(report.curve), style="yellow")
    console.print(f"wrote {report.out}: the model, README.md and pictures", markup=False)


def print_model(console: Console, model: IntentModel) -> None:
    """Print the intents, one line each, and how they follow one another."""
    for line in model.describe().splitlines():
        console.print(escape(line))
    if model.noise_sd is not None:
        said = ", ".join(f"{value:.3g}" for value in model.noise_sd)
        console.print(f"measurement noise that was learned: {said} m")
    if len(model.intents) > 1:
        table = plain_table("leaves \\ for", *(escape(intent.name) for intent in model.intents), "after", words=1)
        for i, intent in enumerate(model.intents):
            out = -model.generator[i][i]
            shares = [
                "-" if i == j or out <= 0 else f"{100 * rate / out:.0f} %" for j, rate in enumerate(model.generator[i])
            ]
            table.add_row(escape(intent.name), *shares, model.spell_lasting(i).removeprefix("lasts "))
        console.print(table)


def _print_curve(console: Console, curve: Sequence[CurvePoint], chosen: int) -> None:
    if not curve:
        return
    table = plain_table("intents", "held out, nats per row", "95 % of the difference to the best", "", words=0)
    best = max(point.nats for point in curve)
    for point in sorted(curve):
        mark = "chosen" if point.intents == chosen else ""
        known = math.isfinite(point.low) and math.isfinite(point.high)
        table.add_row(f"{point.intents}", f"{point.nats:.4f}", _span(point, best) if known else "-", mark)
    console.print(table)


def _span(point: CurvePoint, best: float) -> str:
    """The interval of the difference to the best, which has none to itself."""
    return "best" if point.nats == best else f"{point.low - best:+.4f} to {point.high - best:+.4f}"


def unresolved(curve: Sequence[CurvePoint]) -> str:
    """What to say when one intent is all that the tracks show, or all that was asked for."""
    gain = gain_over_one(curve)
    if gain is None:
        return "whether several intents can be told apart here is not known: only one was tried"
    said = f"{gain[0]:+.4f} nat per row (95 %: {gain[1]:+.4f} to {gain[2]:+.4f})"
    return (
        f"several intents are not resolvable here: on held-out pieces of the tracks the best of them brings {said} "
        f"over one, and less than {RESOLVABLE:g} is not enough, so one was kept"
    )


def write_readme(
    path: Path,
    model: IntentModel,
    tracks: Tracks,
    curve: Sequence[CurvePoint],
    resolvable: bool,
    pictures: Sequence[str],
) -> None:
    """Write what a person who finds the folder wants to know; the same model gives the same text."""
    about: Mapping[str, Any] = model.about
    rows = int(tracks.lengths.sum())
    lines = [
        f"# {counted(len(model.intents), 'intent')}",
        "",
        f"Learned from {counted(len(tracks), 'track')} ({rows} rows in {tracks.axes} axes) of {tracks.source}.",
        "",
        *(f"* {line}" for line in model.describe().splitlines()),
        "",
    ]
    if not resolvable:
        lines += [f"Note: {unresolved(curve)}.", ""]
    if model.noise_sd is not None:
        lines += [f"Measurement noise that was learned: {', '.join(f'{v:.3g}' for v in model.noise_sd)} m.", ""]
    lines += _intent_table(model)
    if curve:
        lines += ["| intents | held out, nats per row | 95 % of the difference to the best |", "|---|---|---|"]
        best = max(point.nats for point in curve)
        for point in sorted(curve):
            known = math.isfinite(point.low) and math.isfinite(point.high)
            span = _span(point, best) if known else "-"
            mark = " (chosen)" if point.intents == len(model.intents) else ""
            lines.append(f"| {point.intents}{mark} | {point.nats:.4f} | {span} |")
        lines.append("")
    lines += [f"![{name.removesuffix('.png')}]({name})" for name in pictures]
    lines += [
        "",
        "```",
        "jink show .",
        "jink track FILE --estimator intent-imm --model .",
        "jink segment FILE --model . --out labels.csv",
        "```",
        "",
        f"Made by `{str(about.get('command', 'jink')).replace('`', '')}`.",
        "",
    ]
    part = path.with_name(f".{path.name}.part")
    part.write_text("\n".join(lines), encoding="utf-8")
    part.replace(path)


def _intent_table(model: IntentModel) -> list[str]:
    shares = model.intent_probs(model.mode_shares())
    lines = ["| intent | what it does | how long | share | wobble, m/s^2 per root Hz |", "|---|---|---|---|---|"]
    for i, intent in enumerate(model.intents):
        does = ", then ".join(describe_phase(phase) for phase in intent.phases)
        lasts = model.spell_lasting(i)
        wobble = number(float(np.sqrt(intent.phases[-1].law.wobble)), 3)
        name = intent.name.replace("|", "/")
        lines.append(f"| {name} | {does} | {lasts} | {100 * shares[i]:.0f} % | {wobble} |")
    return [*lines, ""]
