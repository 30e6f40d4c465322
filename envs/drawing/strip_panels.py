"""The strips below the map, over time: altitude, intent, noise, action."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jink.envs.drawing.canvas import FAINT, GREY, INK, LINE, PAPER, SURGE, Box, Canvas, Colour, fade
from jink.envs.drawing.map_panel import DOT, metres, thinned
from jink.envs.drawing.viewing import NOMINAL, grow, span, ticks
from jink.envs.task import Picture

__all__ = [
    "Clock",
    "draw_actions",
    "draw_altitude",
    "draw_clock",
    "draw_intents",
    "draw_noise",
    "intent_name",
    "last_choice",
]

Array = NDArray[np.float64]

_DECADES = 4
_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


class Clock:
    """Times as pixels; the axis grows by steps as the episode goes on."""

    def __init__(self, picture: Picture, left: float, width: float) -> None:
        times = np.asarray(picture.times, dtype=np.float64)
        self.begin = float(times[0])
        gaps = np.diff(times)
        gaps = gaps[gaps > 0]
        # What holds from the last sample on is drawn one typical step long; before there is a step, not at all.
        self.hold = float(np.median(gaps)) if gaps.size else 0.0
        self.length = span(max(float(times[-1]) - self.begin + self.hold, 10.0 * (self.hold or 1.0)))
        self.left, self.width = left, width
        self.edges = self.at(np.append(times, times[-1] + self.hold))

    def at(self, times: Array) -> Array:
        """Where times are along the axis, in pixels."""
        return self.left + self.width * (np.asarray(times) - self.begin) / self.length


def runs(values: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of each stretch of equal values."""
    begins = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return list(zip(begins.tolist(), [*begins[1:].tolist(), len(values)], strict=True))


def intent_name(picture: Picture, intent: int) -> str:
    """Name of an intent by its number."""
    return picture.intents[intent] if 0 <= intent < len(picture.intents) else "unknown"


def draw_intents(
    canvas: Canvas, picture: Picture, box: Box, clock: Clock, colours: dict[int, Colour], unit: float
) -> None:
    """Stretches in the colour of the intent, named where there is room."""
    _, top, _, height = box
    size = 10.5 * unit
    for start, stop in runs(np.asarray(picture.intent).astype(np.int64)):
        colour = colours[int(picture.intent[start])]
        left, right = float(clock.edges[start]), float(clock.edges[stop])
        canvas.box((left, top, right - left, height), colour)
        name = intent_name(picture, int(picture.intent[start]))
        if canvas.width(name, size) + 6 * unit <= right - left:
            dark = 0.299 * colour[0] + 0.587 * colour[1] + 0.114 * colour[2] < 125.0
            canvas.text(name, ((left + right) / 2, top + height / 2), size, PAPER if dark else INK, align=0.5)


def draw_noise(canvas: Canvas, picture: Picture, box: Box, clock: Clock, unit: float) -> None:
    """Factor on the noise covariance on a logarithmic scale; ticks on top where nothing was seen."""
    left, top, width, height = box
    scale = np.asarray(picture.scale, dtype=np.float64)
    known = scale[np.isfinite(scale) & (scale > 0)]
    highest = math.log10(float(known.max())) if known.size else 0.0
    decades = max(_DECADES, 2 * math.ceil(min(highest, 12.0) / 2 - 1e-9))
    for decade in (0, decades // 2, decades):
        y = top + height * (1 - decade / decades)
        canvas.line([(left, y), (left + width, y)], LINE, 0.5)
        words = "×1" if decade == 0 else "×10" + str(decade).translate(_SUPERSCRIPTS)
        canvas.text(
            words, (left - 6 * unit, min(max(y, top + 5 * unit), top + height - 4 * unit)), 9.5 * unit, GREY, align=1.0
        )
    level = np.log10(np.clip(np.nan_to_num(scale, nan=1.0, posinf=1e12), 1.0, 10.0**decades)) / decades
    for start, stop in runs(np.round(level * 2000).astype(np.int64)):
        if level[start] > 0.0:
            x, end = float(clock.edges[start]), float(clock.edges[stop])
            tall = float(level[start]) * height
            canvas.box((x, top + height - tall, end - x, tall), SURGE if scale[start] > NOMINAL else fade(SURGE, 0.5))
    canvas.line([(left, top + height), (float(clock.edges[-1]), top + height)], INK, 1.0)
    gone = ~np.isfinite(picture.seen).any(axis=1)
    if not gone.all():
        for row in np.flatnonzero(gone):
            middle = (clock.edges[row] + clock.edges[row + 1]) / 2
            canvas.line([(middle, top), (middle, top + 6 * unit)], INK, 1.2 * unit)


def last_choice(picture: Picture) -> int:
    """The last choice taken, -1 without any: that of the present sample may be still to come."""
    taken = np.flatnonzero(np.asarray(picture.choice)[-2:] >= 0)
    return int(picture.choice[-2:][taken[-1]]) if taken.size else -1


def draw_actions(canvas: Canvas, picture: Picture, box: Box, clock: Clock, room: float, unit: float) -> None:
    """One row per choice, marked while it was taken; names have ``room`` pixels to the left."""
    left, top, width, height = box
    count = len(picture.choices)
    tall = height / count
    choice = np.asarray(picture.choice).astype(np.int64)
    every = math.ceil(9.0 * unit / tall)
    for number, name in enumerate(picture.choices):
        y = top + number * tall
        canvas.box((left, y + 0.5, width, tall - 1.0), FAINT)
        if number % every == 0:
            size, now = min(10.0 * unit, 0.95 * tall * every), number == last_choice(picture)
            canvas.text(
                name, (left - 6 * unit, y + tall / 2), size, INK if now else GREY, align=1.0, bold=bool(now), room=room
            )
    for start, stop in runs(choice):
        if 0 <= choice[start] < count:
            x, end = float(clock.edges[start]), float(clock.edges[stop])
            canvas.box((x, top + choice[start] * tall + 0.5, end - x, tall - 1.0), fade(INK, 0.75))


def draw_altitude(
    canvas: Canvas, picture: Picture, box: Box, clock: Clock, colours: dict[int, Colour], unit: float
) -> None:
    """Height over time: truth in the colours of its intents, measurements, estimate."""
    left, top, width, height = box
    truth, seen, estimate = (np.asarray(rows)[:, 2] for rows in (picture.truth, picture.seen, picture.estimate))
    low, high = _altitudes(picture, truth, seen, estimate)

    def at(values: Array) -> Array:
        return np.clip(top + height * (high - values) / (high - low), top - 20_000.0, top + 20_000.0)

    canvas.box(box, FAINT)
    marks = ticks(low, high, 3)
    for value in marks:
        canvas.line([(left, at(np.array(value))), (left + width, at(np.array(value)))], LINE, 0.5)
        y = min(max(float(at(np.array(value))), top + 4 * unit), top + height - 4 * unit)
        canvas.text(
            metres(value) if value >= 0 else "−" + metres(-value), (left - 6 * unit, y), 9.5 * unit, GREY, align=1.0
        )
    canvas.clip(box)
    rows = thinned(len(picture.times))
    x = clock.edges[:-1][rows]
    intent = np.asarray(picture.intent).astype(np.int64)[rows]
    for start, stop in runs(intent):
        part = slice(start, min(stop + 1, len(rows)))
        canvas.line(
            np.column_stack([x[part], at(truth[rows][part])]), fade(colours[int(intent[start])], 0.8), 3.5 * unit
        )
    for px, py, loud in zip(x, at(seen[rows]), np.asarray(picture.scale)[rows] > NOMINAL, strict=True):
        if np.isfinite(py):
            (canvas.ring if loud else canvas.dot)((px, py), (DOT + 0.8 if loud else 1.6) * unit, fade(GREY, 0.8))
    canvas.line(np.column_stack([x, at(estimate[rows])]), INK, 1.2 * unit)
    canvas.clip(None)


def _altitudes(picture: Picture, truth: Array, seen: Array, estimate: Array) -> tuple[float, float]:
    """Range of the altitude axis, grown as the map's view is."""
    calm = np.where(np.asarray(picture.scale) <= NOMINAL, seen, np.nan)
    order = np.stack([truth, calm, estimate], axis=1).reshape(-1)
    known = np.isfinite(order)
    must = np.tile([True, False, False], len(truth))[known]
    heights = order[known]
    if not heights.size:
        return 0.0, 1.0
    spread = float(np.abs(heights[:4] - heights[0]).max())
    low, high = grow(np.column_stack([np.zeros_like(heights), heights]), must, 3.0 * spread if spread > 0 else 1.0, 1.0)
    return float(low[1]), float(high[1])


def draw_clock(canvas: Canvas, clock: Clock, top: float, bottom: float, unit: float) -> None:
    """The time axis under the strips, and a line through them at the present."""
    marks = ticks(0.0, clock.length, max(2, int(clock.width / (85.0 * unit))))
    for number, seconds in enumerate(marks):
        x = float(clock.at(np.array(clock.begin + seconds)))
        canvas.line([(x, bottom), (x, bottom + 4 * unit)], GREY, 0.8)
        words = f"{seconds:g}" + (" s" if number == len(marks) - 1 else "")
        canvas.text(words, (x, bottom + 12 * unit), 10 * unit, GREY, align=0.5)
    now = float(clock.edges[-1])
    canvas.line([(now, top), (now, bottom)], fade(INK, 0.5), 0.8)
