"""One picture of many targets: detections, tracks with their numbers, sensors, truth where it is known."""

from __future__ import annotations

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from jink.training.many_network import links_of, node_ring, sensor_places
from jink.training.plotting import MODE_COLOURS  # its backend draws without a display
from jink.training.track_many import ManyReport
from jink.training.wording import counted

__all__ = ["plot_many"]

_GREY, _BLACK = "#999999", "#000000"
_MARGIN = 0.06
_SIDES = {-1: "right", 0: "center", 1: "left"}
MOST_NAMES = 16
"""Nodes of a network that still get names."""


def plot_many(path: Path, report: ManyReport) -> None:
    """Draw the map.

    Args:
        path: .png, .pdf or .svg; replaced if it exists, whole or not at all.
        report: what `track_many` returned.

    Raises:
        OSError: the file cannot be written.
    """
    ids, tracks = report.tracks
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axis = plt.subplots(figsize=(8.0, 6.5), layout="constrained")
        corners = []
        if report.detections is not None and len(report.detections):
            points = report.detections[np.isfinite(report.detections).all(axis=1), :2]
            if len(points):
                axis.plot(*points.T, ".", color=_GREY, ms=2.5, label="detections", zorder=1, rasterized=True)
                corners.append(np.quantile(points, (0.01, 0.99), axis=0))
        if report.scores is not None:
            for n, true in enumerate(report.scores.truth[..., :2]):
                axis.plot(*true.T, color=_BLACK, lw=3.0, alpha=0.25, label=None if n else "truth", zorder=2)
        for row, name in enumerate(ids):
            place = tracks[row, :, :2]
            known = np.flatnonzero(np.isfinite(place).all(axis=1))
            if not known.size or np.abs(place[known]).max() > 1e15:
                continue
            colour = MODE_COLOURS[row % len(MODE_COLOURS)]
            axis.plot(*place[known].T, color=colour, lw=1.4, label=None if row else "tracks", zorder=3)
            axis.annotate(str(name), place[known[-1]], color=colour, fontsize=8, xytext=(3, 3),
                          textcoords="offset points", zorder=5)  # fmt: skip
            corners.append(np.quantile(place[known], (0.0, 1.0), axis=0))
        for n, sensor in enumerate(sensor_places(report.scans, report.plan)):
            if sensor.moves:
                axis.plot(*sensor.path.T, color=_BLACK, lw=0.8, ls=":", zorder=2)
            label = None if n else "sensors, where they were last"
            axis.plot(*sensor.path[-1], "^", color=_BLACK, ms=5, mfc="none", label=label, zorder=4)
            if len(report.scans.sensors) > 1:
                axis.annotate(sensor.name, sensor.path[-1], fontsize=7, xytext=(4, -8), textcoords="offset points")
            corners.append(np.quantile(sensor.path, (0.0, 1.0), axis=0))
        if corners:
            box = np.vstack(corners)
            low, high = box.min(axis=0), box.max(axis=0)
            half = np.maximum((high - low) / 2 * (1 + 2 * _MARGIN), max(float((high - low).max()) * 0.1, 1.0))
            middle = (low + high) / 2
            axis.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
        axis.set_aspect("equal", adjustable="box")
        axis.set(xlabel="x, m", ylabel="y, m")
        whose = f" of node {report.plan.nodes[0]}" if report.plan is not None else ""
        title = f"{report.estimator} on {report.source}: {counted(len(ids), 'track')}{whose}"
        axis.set_title(title, loc="left", fontsize=9)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)
        if report.plan is not None:
            _draw_network(axis.inset_axes((1.02, 0.0, 0.24, 0.3)), report)
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        try:
            figure.savefig(part, dpi=150, format=path.suffix[1:].lower())
            part.replace(path)
        finally:
            plt.close(figure)
            part.unlink(missing_ok=True)


def _draw_network(axis: Axes, report: ManyReport) -> None:
    """Who talks to whom, on a circle; nodes with a sensor filled, the one whose tracks are drawn ringed."""
    plan = report.plan
    assert plan is not None  # checked by the caller
    places, senses = node_ring(plan), set(plan.sensors.values())
    for first, second in links_of(plan):
        axis.plot(*places[[first, second]].T, color=_GREY, lw=0.8, zorder=1)
    for n, place in enumerate(places):
        side = int(np.sign(np.round(place[0], 1)))
        axis.plot(*place, "o", color=_BLACK, mfc=_BLACK if n in senses else "white", ms=5, zorder=2)
        if len(places) <= MOST_NAMES:
            axis.annotate(plan.nodes[n], 1.35 * place, ha=_SIDES[side], va="center", fontsize=7, zorder=3)
    axis.plot(*places[0], "o", color=MODE_COLOURS[0], mfc="none", ms=10, zorder=3)
    axis.set(xlim=(-1.8, 1.8), ylim=(-1.8, 1.8))
    axis.set_aspect("equal")
    axis.set_axis_off()
    axis.set_title("network: filled nodes sense,\nthe ringed one's tracks are drawn", fontsize=7)
