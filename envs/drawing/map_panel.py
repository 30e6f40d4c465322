"""The map of a frame: true path, measurements, estimate with its ellipse, sensor; seen from above."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jink.envs.drawing.canvas import FAINT, GREY, INK, LINE, PAPER, Box, Canvas, Colour, fade
from jink.envs.drawing.viewing import NOMINAL, View, round_down, view_of
from jink.envs.task import Picture

__all__ = ["DOT", "SIGMAS", "draw_map", "grid_step", "last_estimate", "metres", "ring_radius", "thinned", "triangle"]

Array = NDArray[np.float64]

SIGMAS = 2.0
"""Standard deviations the ellipse is drawn at."""
MOST = 3000
"""Longer tracks are drawn with every second, third, ... sample."""
DOT = 2.2
_RECENT, _OLD = 40.0, 0.45
_FADES = 8
_POINTERS = 5
_GRID = 85.0


def draw_map(canvas: Canvas, picture: Picture, box: Box, colours: dict[int, Colour], unit: float) -> View:
    """Draw the map into a box of the frame.

    Args:
        canvas: what to draw on.
        picture: what to show; at least one sample.
        box: left, top, width, height in pixels.
        colours: of the intents, -1 = not known.
        unit: size of everything, 1 = a frame 960 pixels wide.

    Returns:
        the view, for what has to line up with it.
    """
    left, top, width, height = box
    view = view_of(picture, width, height, (left + width / 2, top + height / 2))
    canvas.box(box, FAINT)
    canvas.clip(box)
    _draw_grid(canvas, view, box, unit)
    corners = _ellipse(picture)
    if corners is not None:
        canvas.area(view.project(corners), fade(INK, 0.12))
    rows = thinned(len(picture.times))
    _draw_truth(canvas, picture, view, colours, rows, unit)
    _draw_seen(canvas, picture, view, rows, unit)
    _draw_estimate(canvas, picture, view, rows, unit)
    if corners is not None:
        outline = view.project(corners)
        canvas.line(np.vstack([outline, outline[:1]]), INK, 1.0 * unit)
    _draw_now(canvas, picture, view, colours, unit)
    _draw_outside(canvas, picture, view, box, unit)
    canvas.clip(None)
    _draw_sensor(canvas, picture, view, box, unit)
    return view


def _whole_box(view: View, box: Box) -> tuple[Array, Array]:
    """Lower left and upper right corner of a box of the frame, m."""
    half = np.array([box[2], box[3]]) / (2.0 * view.scale)
    return view.centre - half, view.centre + half


def thinned(count: int) -> NDArray[np.int64]:
    """Which of ``count`` samples are drawn: all, or every n-th and always the last."""
    stride = -(-count // MOST)
    return np.arange((count - 1) % stride, count, stride)


def grid_step(view: View, unit: float) -> float:
    """Distance of the grid lines, and length of the scale bar; a round number of metres."""
    return round_down(1.7 * _GRID * unit / view.scale)


def last_estimate(picture: Picture) -> int:
    """The sample of the last estimate there is, -1 without any: a task may not have one of the present sample yet."""
    known = np.flatnonzero(np.isfinite(picture.estimate).all(axis=1))
    return int(known[-1]) if known.size else -1


def metres(value: float) -> str:
    """A length in the unit that reads best: 2.5 mm, 40 m, 12 km."""
    for size, name in ((1e3, "km"), (1.0, "m"), (1e-2, "cm"), (1e-3, "mm")):
        if abs(value) >= size * 0.9995:
            shown = value / size
            return f"{shown:,.0f} {name}" if abs(shown) >= 99.95 else f"{shown:.3g} {name}"
    return "0 m" if value == 0.0 else f"{value:.1e} m"


def ring_radius(scale: float) -> float:
    """Radius of a measurement by its noise: larger by a step per power of ten of the covariance."""
    decades = math.log10(scale) if scale > 1.0 and math.isfinite(scale) else 0.0
    return DOT + 1.1 * min(decades, 5.0)


def _draw_grid(canvas: Canvas, view: View, box: Box, unit: float) -> None:
    low, high = _whole_box(view, box)
    step = grid_step(view, unit)
    left, top, width, height = box
    for axis in (0, 1):
        for number in range(math.ceil(low[axis] / step), math.floor(high[axis] / step) + 1):
            place = view.project(np.full(2, number * step))[axis]
            ends = [(place, top), (place, top + height)] if axis == 0 else [(left, place), (left + width, place)]
            canvas.line(ends, fade(LINE, 0.65), 0.5)


def _ellipse(picture: Picture) -> Array | None:
    """Corners (72, 2) of the ellipse of the last estimate, m; None where it has none."""
    last, cov = last_estimate(picture), np.asarray(picture.covariance)[:2, :2]
    if last < 0 or not np.isfinite(cov).all():
        return None
    middle = picture.estimate[last, :2]
    values, vectors = np.linalg.eigh(0.5 * (cov + cov.T))
    angle = np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) * np.sqrt(np.maximum(values, 0.0))
    return middle + SIGMAS * circle @ vectors.T


def _draw_truth(
    canvas: Canvas, picture: Picture, view: View, colours: dict[int, Colour], rows: NDArray[np.int64], unit: float
) -> None:
    """The true path in the colours of its intents, paler the older."""
    if len(rows) < 2:
        return
    path = view.project(picture.truth[rows])
    age = rows[-1] - rows[:-1]
    level = np.ceil(np.maximum(1.0 - age / _RECENT, 0.0) * _FADES).astype(np.int64)
    intent = np.asarray(picture.intent)[rows[:-1]].astype(np.int64)
    begins = np.flatnonzero(np.diff(intent * 100 + level, prepend=-10_000))
    for start, stop in zip(begins, [*begins[1:], len(rows) - 1], strict=True):
        share = _OLD + (1.0 - _OLD) * level[start] / _FADES
        canvas.line(path[start : stop + 1], fade(colours[int(intent[start])], share, FAINT), 6.5 * unit)


def _draw_estimate(canvas: Canvas, picture: Picture, view: View, rows: NDArray[np.int64], unit: float) -> None:
    """The estimated path; what is long past is thin, so that the true path shows on long tracks."""
    path = view.project(picture.estimate[rows])
    past = int(np.searchsorted(rows, rows[-1] - _RECENT))
    canvas.line(path[: past + 1], fade(INK, 0.6), 0.9 * unit)
    canvas.line(path[past:], PAPER, 2.6 * unit)
    canvas.line(path[past:], INK, 1.3 * unit)


def _draw_seen(canvas: Canvas, picture: Picture, view: View, rows: NDArray[np.int64], unit: float) -> None:
    """Measurements: discs, and rings that grow with the noise where it was larger than nominal."""
    places = view.project(picture.seen[rows])
    last = rows[-1]
    for row, place in zip(rows, places, strict=True):
        if not np.isfinite(place).all():
            continue
        colour = fade(GREY, _OLD + (1.0 - _OLD) * max(0.0, 1.0 - (last - row) / _RECENT), FAINT)
        scale = float(picture.scale[row])
        if scale > NOMINAL:
            canvas.ring(place, ring_radius(scale) * unit, colour, 1.2 * unit)
        else:
            canvas.dot(place, DOT * unit, colour)


def _draw_now(canvas: Canvas, picture: Picture, view: View, colours: dict[int, Colour], unit: float) -> None:
    """Where the target, the measurement and the estimate are now."""
    truth, seen = (view.project(rows[-1]) for rows in (picture.truth, picture.seen))
    last = last_estimate(picture)
    if np.isfinite(truth).all():
        canvas.dot(truth, 6.5 * unit, PAPER)
        canvas.dot(truth, 5.5 * unit, colours[int(picture.intent[-1])])
    if np.isfinite(seen).all():
        canvas.ring(seen, (ring_radius(float(picture.scale[-1])) + 1.5) * unit, INK, 1.4 * unit)
    if last >= 0:
        estimate, arm = view.project(picture.estimate[last]), 6.0 * unit
        for across in (np.array([arm, 0.0]), np.array([0.0, arm])):
            canvas.line([estimate - across, estimate + across], INK, 1.6 * unit)


def _draw_outside(canvas: Canvas, picture: Picture, view: View, box: Box, unit: float) -> None:
    """Rings with an arrow on the edge for the latest measurements that lie outside the map."""
    count = len(picture.times)
    for row in range(max(0, count - _POINTERS), count):
        place = view.project(picture.seen[row])
        if np.isfinite(place).all() and not _inside(place, box):
            colour = fade(INK if row == count - 1 else GREY, (_POINTERS - count + 1.0 + row) / _POINTERS, FAINT)
            tip, aim = _arrow(canvas, place, box, colour, 0.8 * unit)
            canvas.ring(tip - 12.0 * unit * aim, 4.0 * unit, colour, 1.4 * unit)


def _draw_sensor(canvas: Canvas, picture: Picture, view: View, box: Box, unit: float) -> None:
    """A triangle where the sensor is, or an arrow with its distance from the target where that is off the map."""
    sensor = np.asarray(picture.sensor, dtype=np.float64)[:2]
    if not np.isfinite(sensor).all():
        return
    place = view.project(sensor)
    if _inside(place, box):
        triangle(canvas, place, unit)
        return
    tip, aim = _arrow(canvas, place, box, INK, unit)
    known = [row[-1, :2] for row in (picture.truth, picture.estimate) if np.isfinite(row[-1, :2]).all()]
    far = f" {metres(float(np.linalg.norm(sensor - known[0])))}" if known else ""
    words, size = f"sensor{far}", 11.0 * unit
    half = canvas.width(words, size) / 2
    left, top, width, height = box
    # Along the arrow until the words are clear of its head, whichever side of the map it is on.
    clear = min((half + 11 * unit) / max(abs(aim[0]), 1e-9), 13 * unit / max(abs(aim[1]), 1e-9))
    middle = tip - aim * (clear + 4.0 * unit)
    x = min(max(middle[0], left + half + 6 * unit), left + width - half - 6 * unit)
    y = min(max(middle[1], top + 10 * unit), top + height - 10 * unit)
    canvas.box((x - half - 2 * unit, y - 7 * unit, 2 * half + 4 * unit, 14 * unit), FAINT)
    canvas.text(words, (x, y), size, GREY, align=0.5)


def triangle(canvas: Canvas, place: Array, unit: float) -> None:
    """The mark of a sensor."""
    corners = np.array([[0.0, -6.5], [6.0, 4.5], [-6.0, 4.5]])
    canvas.area(place + 1.35 * unit * corners, PAPER)
    canvas.area(place + unit * corners, INK)


def _arrow(canvas: Canvas, place: Array, box: Box, colour: Colour, unit: float) -> tuple[Array, Array]:
    """An arrow head on the edge of the box towards a place outside; its tip and direction."""
    middle = np.array([box[0] + box[2] / 2, box[1] + box[3] / 2])
    reach = np.array([box[2], box[3]]) / 2 - 3.0 * unit
    away = place - middle
    tip = middle + away * float(np.min(reach / np.maximum(np.abs(away), 1e-9)))
    aim = away / np.linalg.norm(away)
    side = np.array([-aim[1], aim[0]])
    base = tip - 8.0 * unit * aim
    canvas.area([tip, base + 4.0 * unit * side, base - 4.0 * unit * side], colour)
    return tip, aim


def _inside(place: Array, box: Box) -> bool:
    return bool(box[0] <= place[0] <= box[0] + box[2] and box[1] <= place[1] <= box[1] + box[3])
