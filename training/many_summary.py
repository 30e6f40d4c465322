"""What `jink track` prints of many targets."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.markup import escape

from jink.estimators.multitarget.open_tracks import OpenTracks
from jink.training.summary import number, plain_table
from jink.training.track_many import ManyReport
from jink.training.wording import counted

__all__ = ["dropped_words", "print_many"]

MOST_ROWS = 20


def dropped_words(report: ManyReport) -> str:
    """What was left out of the file, and why; empty where nothing was."""
    found = report.scans.cleaning
    kinds = (
        (found.not_finite, "incomplete or absurd"),
        (found.repeated, "repeated within a scan"),
        (found.reordered, "scans sorted in"),
    )
    return ", ".join(f"{count} {why}" for count, why in kinds if count)


def print_many(console: Console, report: ManyReport) -> None:
    """Print the summary of one run."""
    scans, found = report.scans, report.found
    empty = int((scans.counts == 0).sum())
    console.print(
        f"[bold]{escape(report.source)}[/bold]: {counted(len(scans), 'scan')}{f' ({empty} empty)' if empty else ''} of "
        f"{counted(len(scans.sensors), 'sensor')}, {counted(len(scans.detections), 'detection')}, "
        f"{scans.sensors[0].model.name} in {scans.axes} axes"
    )
    for note in report.notes:
        console.print(f"  {escape(note)}", style="dim")
    dropped = dropped_words(report)
    console.print(f"left out: {dropped or 'nothing'}", style="yellow" if dropped else "dim")
    if not report.locates:
        console.print("one detection of this sensor locates nothing, so no track can begin", style="yellow")
    table = plain_table("parameter", "from", "value", "unit", words=2)
    for name, value, unit, origin in report.parameters:
        table.add_row(escape(name), origin, "by row" if origin == "file" else number(value), unit)
    console.print(table)
    if isinstance(found, OpenTracks):
        plan = report.plan
        nodes = len(plan.nodes) if plan is not None else 0
        console.print(
            f"[bold]{report.estimator}[/bold]: {counted(len(report.tracks[0]), 'track')} at {counted(nodes, 'node')}; "
            f"{int(found.sent_bytes.sum()):,} bytes in {int(found.messages.sum()):,} messages"
        )
    else:
        taken = float(found.hits.sum())
        rest = max(len(scans.detections) - taken, 0.0)
        console.print(
            f"[bold]{report.estimator}[/bold]: {counted(len(report.tracks[0]), 'track')}; {taken:.0f} of "
            f"{len(scans.detections)} detections are theirs, {rest:.0f} false or not yet explained"
        )
    trouble = int(found.trouble) if isinstance(found, OpenTracks) else int(found.counts[:, 2].sum())
    if trouble:
        console.print(f"{trouble} updates failed; the prediction stood in", style="yellow")
    console.print(f"{1e3 * report.seconds / max(len(scans), 1):.2f} ms per scan", style="dim")
    _print_tracks(console, report)
    _print_scores(console, report)


def _print_tracks(console: Console, report: ManyReport) -> None:
    frame = report.frame
    if "node" in frame.columns and len(frame):
        frame = frame[frame["node"] == frame["node"].iloc[0]]
    table = plain_table("track", "from s", "to s", "scans", "missing", "speed m/s", words=1)
    groups = list(frame.groupby("track", sort=True))
    for track, rows in groups[:MOST_ROWS]:
        velocity = rows[[name for name in ("vx", "vy", "vz") if name in rows]].to_numpy()
        table.add_row(
            str(track), number(float(rows["t"].iloc[0]), 6), number(float(rows["t"].iloc[-1]), 6), str(len(rows)),
            str(int((rows["status"] == "missing").sum())),
            number(float(np.median(np.linalg.norm(velocity, axis=1))), 3),
        )  # fmt: skip
    if groups:
        console.print(table)
    if len(groups) > MOST_ROWS:
        console.print(f"and {counted(len(groups) - MOST_ROWS, 'more track')}", style="dim")


def _print_scores(console: Console, report: ManyReport) -> None:
    scores = report.scores
    if scores is None:
        return
    distance, kept = scores.gospa, scores.kept
    console.print(
        f"against truth, cut-off {number(scores.cutoff, 3)} m ({scores.origin}): "
        f"GOSPA {number(float(distance.distance.mean()), 3)} m; "
        f"{distance.missed_count.mean():.2f} missed and {distance.false_count.mean():.2f} false per scan; "
        f"{int(kept.breaks.sum())} breaks, {int(kept.switches.sum())} identity switches; held "
        + ", ".join(number(100 * float(share), 3) + " %" for share in kept.held[:MOST_ROWS])
    )
