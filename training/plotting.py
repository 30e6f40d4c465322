"""One picture of one track: where it was measured, where it was, and what it was doing."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from jink.envs.estimates_file import STATUS_NAMES
from jink.training.running import raw_positions
from jink.training.track import TrackReport

__all__ = ["plot_track"]

Floats = NDArray[np.float64]

MODE_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#F0E442", "#000000")
"""Okabe and Ito's palette, told apart with any colour vision."""
_MEASURED, _TRUE, _BROKEN = "#999999", "#000000", "#D55E00"
_ELLIPSES = 14
_MAX_COLUMNS, _COLUMNS = 500, 250
"""Tracks of more rows are drawn in bins, each two or three pixels wide."""
_MARGIN = 0.06
_PANEL_RATIO = 1.3


def plot_track(
    path: Path, report: TrackReport, shown: str | None = None, changes: Sequence[tuple[float, float]] = ()
) -> None:
    """Draw map, height (three axes), error (with truth) and mode ribbon of one track.

    Args:
        path: .png, .pdf or .svg; replaced if it exists, whole or not at all.
        report: what `track` returned.
        shown: name of the track; None: the one with most rows.
        changes: time, s, and probability of each change to mark above the ribbon.

    Raises:
        ValueError: no such track.
        OSError: the file cannot be written.
    """
    tracks = report.tracks
    if shown is not None:
        tracks.subset([shown])
    b = int(np.argmax(tracks.lengths)) if shown is None else tracks.ids.index(shown)
    T = int(tracks.lengths[b])
    clock, unit = _clock(tracks.times[b, :T])
    truth = None if tracks.truth is None else tracks.truth[b, :T]
    error = None if truth is None else np.linalg.norm(np.asarray(report.estimates.position)[b, :T] - truth, axis=1)
    strips = [
        name
        for name, wanted in (
            ("height", tracks.axes == 3),
            ("error", error is not None and np.isfinite(error).any()),
            ("modes", len(report.modes) > 1),
        )
        if wanted
    ]
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, panels = plt.subplots(
            1 + len(strips),
            1,
            figsize=(8.0, 6.0 + 1.2 * len(strips)),
            height_ratios=[5.0, *([1.0] * len(strips))],
            layout="constrained",
            squeeze=False,
        )
        axes = dict(zip(("map", *strips), panels[:, 0], strict=True))
        _draw_map(axes["map"], report, b, T)
        if "height" in axes:
            _draw_height(axes["height"], report, b, T, clock)
        if "error" in axes and error is not None:
            axes["error"].plot(clock, error, color=MODE_COLOURS[0], lw=0.9)
            axes["error"].set(ylabel="error, m", ylim=(0, None))
        if "modes" in axes:
            _draw_ribbon(axes["modes"], report, b, T, clock)
            at = np.interp([time for time, _ in changes], tracks.times[b, :T], clock)
            for place, (_, probability) in zip(at, changes, strict=True):
                axes["modes"].plot([place, place], [1.0, 1.05 + 0.25 * probability], "k-", lw=1.0, clip_on=False)
        for name in strips:
            axes[name].set_xlim(clock[0], clock[-1] if clock[-1] > clock[0] else clock[0] + 1)
            axes[name].tick_params(labelbottom=name == strips[-1])
        if strips:
            axes[strips[-1]].set_xlabel(f"time, {unit}")
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        try:
            figure.savefig(part, dpi=150, format=path.suffix[1:].lower())
            part.replace(path)
        finally:
            plt.close(figure)
            part.unlink(missing_ok=True)


def _clock(times: Floats) -> tuple[Floats, str]:
    """Time since the first row, in the unit that reads best."""
    elapsed = times - times[0]
    for size, unit in ((7200.0, "h"), (300.0, "min")):
        if elapsed[-1] >= size:
            return elapsed / (3600.0 if unit == "h" else 60.0), unit
    return elapsed, "s"


def _draw_map(axis: Any, report: TrackReport, b: int, T: int) -> None:
    tracks, estimates = report.tracks, report.estimates
    known = np.asarray(estimates.status)[b, :T] != STATUS_NAMES.index("starting")
    place = np.where(known[:, None], np.asarray(estimates.position)[b, :T, :2], np.nan)
    raw = raw_positions(tracks)
    frame = [place[known]]
    if tracks.truth is not None:
        true = tracks.truth[b, :T, :2]
        frame.append(true[np.isfinite(true).all(axis=1)])
        axis.plot(*true.T, color=_TRUE, lw=2.6, alpha=0.35, label="truth", zorder=2)
    corners = np.concatenate(frame) if any(len(part) for part in frame) else np.zeros((1, 2))
    # Inner 99.8 %: one wild estimate must not shrink the picture to a dot.
    low, high = np.quantile(corners, 0.001, axis=0), np.quantile(corners, 0.999, axis=0)
    size = float(max(*(high - low), 1e-9))
    outside = 0
    if raw is not None:
        points = raw[b, :T, :2]
        points = points[np.isfinite(points).all(axis=1)]
        inside = (np.abs(points - (low + high) / 2) <= size * (0.5 + _MARGIN)).all(axis=1)
        outside = int((~inside).sum())
        axis.plot(*points[inside].T, ".", color=_MEASURED, ms=3, label="measured", zorder=1, rasterized=T > 5000)
    elif tracks.sensor_states is not None:
        places = np.unique(tracks.sensor_states[b, :T, :2], axis=0)
        axis.plot(*places.T, "^", color=_TRUE, ms=6, mfc="none", label="sensors", zorder=1)
        low, high = np.minimum(low, places.min(axis=0)), np.maximum(high, places.max(axis=0))
        size = float(max(*(high - low), 1e-9))
    _draw_estimate(axis, report, b, T, place)
    _draw_ellipses(axis, np.asarray(estimates.covariance)[b, :T, :2, :2], place, size)
    for forecast in report.forecasts:
        if forecast.track == tracks.ids[b]:
            axis.plot(*forecast.mean[:2], "*", color=_BROKEN, ms=10, label="forecast", zorder=5)
    middle, half = (low + high) / 2, (high - low) / 2 + _MARGIN * size
    # As wide as the panel, so that the map lines up with the strips below it.
    half = np.maximum(half, [_PANEL_RATIO * half[1], half[0] / _PANEL_RATIO])
    scale, unit = (1e-3, "km") if size > 20_000.0 else (1.0, "m")
    axis.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
    axis.set_aspect("equal", adjustable="box")
    for side, name in ((axis.xaxis, "x"), (axis.yaxis, "y")):
        side.set_major_locator(MaxNLocator(7))
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{scale * value:g}"))
        side.set_label_text(f"{name}, {unit}")
    several = f", one of {len(tracks)} tracks" if len(tracks) > 1 else ""
    left = f"; {outside} measurements outside the picture" if outside else ""
    axis.set_title(f"{report.estimator} on {tracks.source}: {tracks.ids[b]}{several}{left}", loc="left", fontsize=9)
    axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)


def _draw_estimate(axis: Any, report: TrackReport, b: int, T: int, place: Floats) -> None:
    """The estimated path, in the colour of the most probable mode of each step, or of each bin of a long track."""
    probs = np.asarray(report.estimates.mode_probs)[b, :T]
    _, bins, shares = _bin_modes(report.tracks.times[b, :T], probs)
    best = np.argmax(shares, axis=1)[bins]
    pieces = np.stack([place[:-1], place[1:]], axis=1)
    whole = np.isfinite(pieces).all(axis=(1, 2))
    several = len(report.modes) > 1
    for mode, name in enumerate(report.modes):
        rows = whole & (best[1:] == mode)
        label = name if several else "estimated"
        colour = MODE_COLOURS[mode % len(MODE_COLOURS)]
        axis.add_collection(LineCollection(pieces[rows], colors=colour, lw=1.3, label=label, zorder=3))
    lost = np.asarray(report.estimates.status)[b, :T] == STATUS_NAMES.index("diverged")
    if lost.any():
        axis.plot(*place[lost].T, "x", color=_BROKEN, ms=5, label="diverged", zorder=4)


def _draw_ellipses(axis: Any, covariance: Floats, place: Floats, size: float) -> None:
    """Two-sigma ellipses at even distances along the path, enlarged by a round number where too small to see."""
    usable = np.isfinite(place).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    rows = np.flatnonzero(usable)
    if len(rows) < 2:
        return
    path = np.cumsum(np.linalg.norm(np.diff(place[rows], axis=0, prepend=place[rows[:1]]), axis=1))
    rows = np.unique(
        rows[np.searchsorted(path, np.linspace(0, path[-1], _ELLIPSES), side="left").clip(0, len(rows) - 1)]
    )
    values, vectors = np.linalg.eigh(covariance[rows])
    radii = 2.0 * np.sqrt(np.maximum(values, 0.0))
    typical = float(np.median(radii[:, 1])) / size
    factor = 1.0
    if 0 < typical < 0.008:
        factor = next((f for f in (2, 5, 10, 20, 50, 100, 200, 500, 1000) if f * typical >= 0.012), 1000.0)
    angles = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    label = "2-sigma ellipse" + (f", {factor:g} times" if factor > 1 else "")
    axis.add_collection(
        EllipseCollection(
            2 * factor * radii[:, 1],
            2 * factor * radii[:, 0],
            angles,
            units="xy",
            offsets=place[rows],
            offset_transform=axis.transData,
            facecolors="none",
            edgecolors=_TRUE,
            linewidths=0.8,
            zorder=4,
        )
    )
    axis.plot([], [], "o", mfc="none", mec=_TRUE, mew=0.8, ms=7, label=label)


def _draw_height(axis: Any, report: TrackReport, b: int, T: int, clock: Floats) -> None:
    raw = raw_positions(report.tracks)
    known = np.asarray(report.estimates.status)[b, :T] != STATUS_NAMES.index("starting")
    height = np.where(known, np.asarray(report.estimates.position)[b, :T, 2], np.nan)
    if raw is not None:
        axis.plot(clock, raw[b, :T, 2], ".", color=_MEASURED, ms=2, rasterized=T > 5000)
    if report.tracks.truth is not None:
        axis.plot(clock, report.tracks.truth[b, :T, 2], color=_TRUE, lw=2.2, alpha=0.35)
    axis.plot(clock, height, color=MODE_COLOURS[0], lw=1.0)
    axis.set_ylabel("z, m")


def _bin_modes(clock: Floats, probs: Floats) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Mode probabilities in as many bins of equal time as can be told apart in print; short tracks row by row.

    Args:
        clock: time of each row; (T,).
        probs: (T, M).

    Returns:
        where bins begin (K,), the bin of each row (T,), mean probabilities of each bin (K, M); empty bins left out.
    """
    if len(clock) <= _MAX_COLUMNS or clock[-1] <= clock[0]:
        return clock, np.arange(len(clock)), probs
    width = (clock[-1] - clock[0]) / _COLUMNS
    column = np.minimum((clock - clock[0]) // width, _COLUMNS - 1).astype(np.int64)
    kept, bins, counts = np.unique(column, return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(bins, weights=p) for p in probs.T], axis=1)
    # The last bin is drawn to the last row, as stackplot's steps end where they begin.
    edges = np.append(clock[0] + kept * width, clock[-1])
    shares = sums / counts[:, None]
    return edges, bins, np.concatenate([shares, shares[-1:]])


def _draw_ribbon(axis: Any, report: TrackReport, b: int, T: int, clock: Floats) -> None:
    """Mode probabilities, stacked to one; of a long track their means over bins."""
    edges, _, shares = _bin_modes(clock, np.asarray(report.estimates.mode_probs)[b, :T])
    colours = [MODE_COLOURS[mode % len(MODE_COLOURS)] for mode in range(len(report.modes))]
    axis.stackplot(edges, shares.T, colors=colours, step="post", lw=0)
    axis.set(ylabel="mode", ylim=(0, 1), yticks=(0, 1))
