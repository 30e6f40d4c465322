"""A film of many targets: scan by scan the detections, the tracks with their recent path, ellipse and number."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from jink.envs.drawing.canvas import FAINT, GREY, INK, INTENT_COLOURS, LINE, Canvas, fade, load_pygame
from jink.envs.drawing.map_panel import SIGMAS, grid_step, metres
from jink.envs.drawing.viewing import View
from jink.estimators.multitarget.open_tracks import OpenTracks
from jink.training.many_network import links_of, node_ring, sensor_places
from jink.training.recording import record
from jink.training.track_many import ManyReport
from jink.training.wording import counted

__all__ = ["film_many", "frames_of"]

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]
SIZE, EDGE, HEAD = (960, 640), 14.0, 46.0
MOST_FRAMES, FILM_S = 300, 20.0
_TAIL, _FADING = 40, 4
MOST_NAMES = 16
_COLOURS = tuple(INTENT_COLOURS.values())


def film_many(path: Path, report: ManyReport) -> int:
    """Write the film.

    Args:
        path: .mp4 or .gif: all frames; .png: the last one.
        report: what `track_many` returned.

    Returns:
        number of frames.

    Raises:
        ValueError: nothing to show, or the package that draws or writes it is not there.
        OSError: the file cannot be written.
    """
    frames = min(len(report.times), MOST_FRAMES)
    try:
        load_pygame()
        return record(path, frames_of(report), float(np.clip(frames / FILM_S, 4.0, 30.0)))
    except DependencyNotInstalled as error:
        raise ValueError(str(error)) from error


def frames_of(report: ManyReport) -> Iterator[Frame]:
    """Frames at all times, or at as many evenly spread ones as a film holds."""
    ids, tracks = report.tracks
    width, height = SIZE[0] - 2 * EDGE, SIZE[1] - HEAD - EDGE
    view = _view(report, tracks[..., :2], width, height)
    K = len(report.times)
    for k in np.unique(np.linspace(0, K - 1, min(K, MOST_FRAMES)).astype(np.int64)) if K else ():
        canvas = Canvas(SIZE)
        box = (EDGE, HEAD, width, height)
        canvas.box(box, FAINT)
        canvas.clip(box)
        _draw_grid(canvas, view, box)
        _draw_detections(canvas, view, report, int(k))
        for row, name in enumerate(ids):
            _draw_track(canvas, view, report, tracks[row, :, :2], int(name), int(k), _COLOURS[row % len(_COLOURS)])
        _draw_sensors(canvas, view, report)
        canvas.clip(None)
        if report.plan is not None:
            _draw_network(canvas, report)
        now = int(np.isfinite(tracks[:, k, 0]).sum()) if len(ids) else 0
        whose = f", tracks of node {report.plan.nodes[0]}" if report.plan is not None else ""
        canvas.text(f"{report.estimator} on {report.source}{whose}", (EDGE, HEAD / 2), 16, bold=True, room=0.6 * width)
        words = f"{report.times[k]:.6g} s, {counted(now, 'track')}, grid {metres(grid_step(view, 1.0))}"
        canvas.text(words, (SIZE[0] - EDGE, HEAD / 2), 14, GREY, align=1.0)
        pixels = load_pygame().image.tobytes(canvas.finish(), "RGB")
        yield np.frombuffer(pixels, dtype=np.uint8).reshape(SIZE[1], SIZE[0], 3).copy()


def _view(report: ManyReport, tracks: Array, width: float, height: float) -> View:
    """What shows all tracks, or all detections where there are none."""
    places = tracks[np.isfinite(tracks).all(axis=-1)]
    if not len(places) and report.detections is not None:
        places = report.detections[np.isfinite(report.detections).all(axis=1), :2]
    places = places[(np.abs(places) < 1e15).all(axis=1)]
    low, high = (places.min(axis=0), places.max(axis=0)) if len(places) else (np.zeros(2), np.ones(2))
    size = np.maximum(1.15 * (high - low), 0.05 * max(float((high - low).max()), 1.0))
    return View((low + high) / 2, float(min(width / size[0], height / size[1])), (SIZE[0] / 2, HEAD + height / 2))


def _draw_grid(canvas: Canvas, view: View, box: tuple[float, float, float, float]) -> None:
    left, top, width, height = box
    step = grid_step(view, 1.0)
    half = np.array([width, height]) / (2.0 * view.scale)
    for axis in (0, 1):
        first = math.ceil((view.centre[axis] - half[axis]) / step)
        for line in range(first, first + int(2 * half[axis] / step) + 1):
            place = view.project(np.full(2, line * step))[axis]
            ends = [(place, top), (place, top + height)] if axis == 0 else [(left, place), (left + width, place)]
            canvas.line(ends, fade(LINE, 0.65), 0.5)


def _draw_detections(canvas: Canvas, view: View, report: ManyReport, k: int) -> None:
    """Those of this time dark, those of the last few ever paler."""
    if report.detections is None:
        return
    scans = report.scans
    for back in range(_FADING, -1, -1):
        if k < back:
            continue
        # Scans at one time are one time to a network.
        same = np.flatnonzero(scans.times == report.times[k - back]) if isinstance(report.found, OpenTracks) else [k]
        for scan in np.asarray(same if back == 0 or isinstance(report.found, OpenTracks) else [k - back]):
            for place in report.detections[scans.offsets[scan] : scans.offsets[scan + 1], :2]:
                if np.isfinite(place).all():
                    canvas.dot(view.project(place), 2.6, fade(GREY, 0.9 ** (4 * back)))


def _draw_sensors(canvas: Canvas, view: View, report: ManyReport) -> None:
    """Sensors as hollow triangles where they were last, with their path."""
    for sensor in sensor_places(report.scans, report.plan):
        place = view.project(sensor.path[-1])
        if sensor.moves:
            canvas.line(view.project(sensor.path), fade(INK, 0.3), 1.0)
        corners = np.array([[0.0, -6.0], [5.2, 3.0], [-5.2, 3.0], [0.0, -6.0]])
        canvas.line(place + corners, INK, 1.5)


def _draw_network(canvas: Canvas, report: ManyReport) -> None:
    """Who talks to whom, in the lower right corner; nodes with a sensor dark, the one whose tracks are shown ringed."""
    plan = report.plan
    assert plan is not None  # checked by the caller
    middle = np.array([SIZE[0] - EDGE - 100.0, SIZE[1] - EDGE - 65.0])
    places, senses = middle + 38.0 * node_ring(plan) * (1.0, -1.0), set(plan.sensors.values())
    for first, second in links_of(plan):
        canvas.line(places[[first, second]], fade(GREY, 0.7), 1.0)
    for n, place in enumerate(places):
        canvas.dot(place, 4.0, INK if n in senses else fade(GREY, 0.5))
        if len(places) <= MOST_NAMES:
            side = float(np.sign(np.round((place[0] - middle[0]) / 38.0, 1)))
            name = middle + 1.4 * (place - middle)
            canvas.text(plan.nodes[n], (float(name[0]), float(name[1])), 11, INK, align=0.5 - 0.5 * side)
    angle = np.linspace(0.0, 2.0 * math.pi, 25)
    canvas.line(places[0] + 7.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), _COLOURS[0], 1.5)


def _draw_track(
    canvas: Canvas, view: View, report: ManyReport, path: Array, name: int, k: int, colour: tuple[int, int, int]
) -> None:
    if not np.isfinite(path[k]).all():
        return
    canvas.line(view.project(path[max(k - _TAIL, 0) : k + 1]), colour, 2.0)
    cov = _covariance(report, name, k)
    if cov is not None and np.isfinite(cov).all():
        values, vectors = np.linalg.eigh(0.5 * (cov + cov.T))
        angle = np.linspace(0.0, 2.0 * math.pi, 49)
        round_ = np.stack([np.cos(angle), np.sin(angle)], axis=1) * SIGMAS * np.sqrt(np.maximum(values, 0.0))
        canvas.line(view.project(path[k] + round_ @ vectors.T), colour, 1.0)
    place = view.project(path[k])
    canvas.dot(place, 4.0, colour)
    canvas.text(str(name), (float(place[0]) + 8, float(place[1]) - 8), 13, INK)


def _covariance(report: ManyReport, name: int, k: int) -> Array | None:
    found = report.found
    if isinstance(found, OpenTracks):
        row = np.flatnonzero((found.frame == k) & (found.id == name))
        return found.cov[0, row[0], :2, :2] if row.size else None
    row = np.flatnonzero((found.scan == k) & (found.id == name))
    return found.cov[row[0], :2, :2] if row.size else None
