"""What `jink track` prints: what was read, what was assumed, what came out."""

from __future__ import annotations

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from jink.envs.estimates_file import STATUS_NAMES
from jink.training.doubts import nis_verdict, outlier_hint
from jink.training.track import TrackReport

__all__ = ["number", "plain_table", "print_report"]


def plain_table(*headings: str, title: str = "", words: int = 1) -> Table:
    """A table in the house style: one rule under the headings, `words` left-aligned columns, then numbers."""
    table = Table(box=box.SIMPLE_HEAD, title=title or None, title_justify="left", title_style="bold", pad_edge=False)
    for index, heading in enumerate(headings):
        table.add_column(heading, justify="left" if index < words else "right")
    return table


def number(value: float | None, digits: int = 4) -> str:
    """A number as one reads it; a dash where there is none."""
    if value is None or np.isnan(value):
        return "-"
    return f"{value:.{digits}g}" if abs(value) < 10**digits else f"{value:,.0f}"


def print_report(console: Console, report: TrackReport) -> None:
    """Print the summary of one run."""
    tracks, scores = report.tracks, report.scores
    rows = int(tracks.lengths.sum())
    spans = [float(t.times[-1] - t.times[0]) for t in tracks if len(t.times)]
    gaps = np.diff(tracks.times, axis=1)[tracks.used[:, 1:]]
    empty = rows - int((np.isfinite(tracks.measurements).any(axis=2) & tracks.used).sum())
    plural = "track" if len(tracks) == 1 else "tracks"
    console.print(
        f"[bold]{escape(tracks.source)}[/bold]: {len(tracks)} {plural}, {rows} rows"
        f"{f' ({empty} empty)' if empty else ''}, {tracks.sensor} in {tracks.axes} axes, "
        f"{_duration(max(spans, default=0.0))}{' at most' if len(tracks) > 1 else ''}, "
        f"every {number(float(np.median(gaps)) if gaps.size else None, 3)} s"
    )
    for note in tracks.notes:
        console.print(f"  {escape(note)}", style="dim")
    for doubt in report.doubts:
        console.print(escape(doubt), style="yellow")
    table = plain_table("parameter", "from", "value", "unit", words=2)
    for name, value, unit, origin in report.parameters:
        table.add_row(name, origin, "by row" if origin == "file" else number(value), unit)
    console.print(table)
    _print_outcome(console, report)
    if "position_rmse_m" in scores:
        _print_errors(console, report)
    for forecast in report.forecasts[:5]:
        place = ", ".join(f"{value:.6g}" for value in forecast.mean)
        spread = ", ".join(f"{value:.3g}" for value in np.sqrt(np.diag(forecast.covariance)))
        console.print(f"forecast of {escape(forecast.track)} at {forecast.time:.6g} s: ({place}) m, sd ({spread}) m")
    if len(report.forecasts) > 5:
        console.print(f"and {len(report.forecasts) - 5} more tracks", style="dim")


def _print_outcome(console: Console, report: TrackReport) -> None:
    scores, used = report.scores, report.tracks.used
    status = np.asarray(report.estimates.status)[used]
    counts = np.bincount(status.astype(np.int64), minlength=len(STATUS_NAMES))
    steps = max(int(counts.sum()), 1)
    console.print(
        f"[bold]{report.estimator}[/bold]: "
        + ", ".join(f"{count} {name}" for name, count in zip(STATUS_NAMES, counts, strict=True) if count)
        + f"; {1e6 * report.seconds / steps:.2f} us per step, starting included"
    )
    low, high, mean = scores["nis_low"], scores["nis_high"], scores["nis_per_dof"]
    verdict = nis_verdict(mean, low, high, scores["nis_inside"])
    if np.isnan(mean):
        console.print("no innovations reported: consistency cannot be judged")
    else:
        console.print(
            f"NIS per component {number(mean, 3)}, expected {number(low, 3)} to {number(high, 3)}: {verdict}; "
            f"{100 * scores['nis_inside']:.0f} % of steps inside their 95 % band; "
            f"log-likelihood {number(scores['log_likelihood_per_step'])} per step"
        )
    noise = report.noise
    if noise is not None and noise.intents:
        console.print(
            "time in intents: "
            + ", ".join(f"{escape(name)} {100 * share:.0f} %" for name, share in noise.intents.items())
        )
    elif len(report.modes) > 1:
        known = used & (np.asarray(report.estimates.status) != STATUS_NAMES.index("starting"))
        shares = np.asarray(report.estimates.mode_probs)[known].mean(axis=0) if known.any() else []
        console.print(
            "time in modes: "
            + ", ".join(
                f"{escape(name)} {100 * share:.0f} %" for name, share in zip(report.modes, shares, strict=False)
            )
        )
    for sentence in noise.sentences if noise is not None else ():
        console.print(escape(sentence))
    if report.rejected:
        console.print(f"{report.rejected} measurements left out by --gate")
    hint = outlier_hint(report.tracks, report.estimates, gated=report.rejected > 0)
    if hint:
        console.print(hint, style="yellow")
    lost = int(counts[STATUS_NAMES.index("diverged")])
    if lost:
        console.print(f"{lost} steps are marked diverged: do not use their estimates", style="yellow")


def _print_errors(console: Console, report: TrackReport) -> None:
    scores, raw, axes = report.scores, report.raw_scores, report.tracks.axes
    table = plain_table("error against truth", "measured", "estimated", "unit")
    for key, name in (
        ("position_rmse_m", "position, root mean square"),
        ("position_median_m", "position, median"),
        ("position_peak_m", "position, peak"),
    ):
        table.add_row(name, number(raw.get(key)), number(scores[key]), "m")
    if "velocity_rmse_m_s" in scores:
        table.add_row("velocity, root mean square", "-", number(scores["velocity_rmse_m_s"]), "m/s")
    table.add_row(f"position NEES (expected {axes})", "-", number(scores["position_nees"], 3), "")
    table.add_row("rows compared", number(raw.get("scored_steps"), 6), number(scores["scored_steps"], 6), "")
    console.print(table)


def _duration(seconds: float) -> str:
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.3g} s"
