"""What stands beside the map: the key to its marks, the intents, the scale bar."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from jink.envs.drawing.canvas import GREY, INK, Box, Canvas, Colour, fade
from jink.envs.drawing.map_panel import DOT, SIGMAS, grid_step, last_estimate, metres, ring_radius, triangle
from jink.envs.drawing.strip_panels import intent_name
from jink.envs.drawing.viewing import View
from jink.envs.task import Picture

__all__ = ["draw_side"]

_ROW = 18.0
_ICON = 26.0


def draw_side(canvas: Canvas, picture: Picture, box: Box, view: View, colours: dict[int, Colour], unit: float) -> None:
    """Draw key, intents and scale bar into a box of the frame."""
    left, top, width, height = box
    row, icon, size = _ROW * unit, _ICON * unit, 11.5 * unit
    bar_top = top + height - 16 * unit
    y = top + row / 2
    room = width - icon - 8 * unit
    for draw, words in _key(canvas, picture, colours, unit):
        if y > bar_top - row:
            break
        draw(np.array([left + icon / 2, y]))
        canvas.text(words, (left + icon + 8 * unit, y), size, INK, room=room)
        y += row
    y += 8 * unit
    seen = [int(value) for value in dict.fromkeys(np.asarray(picture.intent).tolist())]
    now = int(picture.intent[-1])
    for number, intent in enumerate(seen):
        if y > bar_top - (2 if number < len(seen) - 1 else 1) * row:
            if y <= bar_top - row:
                canvas.text(f"and {len(seen) - number} more", (left + icon + 8 * unit, y), size, GREY)
            break
        canvas.box((left + icon / 2 - 8 * unit, y - 5 * unit, 16 * unit, 10 * unit), colours[intent], rounding=2 * unit)
        canvas.text(intent_name(picture, intent), (left + icon + 8 * unit, y), size, INK, bold=intent == now, room=room)
        y += row
    above = ", seen from above" if picture.truth.shape[1] == 3 else ""
    _draw_bar(canvas, view, (left, bar_top), width, above, unit)


def _key(
    canvas: Canvas, picture: Picture, colours: dict[int, Colour], unit: float
) -> list[tuple[Callable[[np.ndarray], None], str]]:
    """Icons and words of the marks that this picture can hold."""
    colour = colours[int(picture.intent[-1])]
    rows: list[tuple[Callable[[np.ndarray], None], str]] = []

    def path(place: np.ndarray) -> None:
        for part in range(4):
            x = place[0] + (part - 2) * 6.5 * unit
            canvas.line([(x, place[1]), (x + 6.5 * unit, place[1])], fade(colour, 0.4 + 0.2 * part), 6.5 * unit)

    def ellipse(place: np.ndarray) -> None:
        angle = np.linspace(0.0, 2 * np.pi, 40, endpoint=False)
        corners = place + np.column_stack([11.0 * np.cos(angle), 5.5 * np.sin(angle)]) * unit
        canvas.area(corners, fade(INK, 0.12))
        canvas.line(np.vstack([corners, corners[:1]]), INK, unit)

    def estimate(place: np.ndarray) -> None:
        canvas.line([(place[0] - 13 * unit, place[1]), (place[0] + 13 * unit, place[1])], INK, 1.3 * unit)
        canvas.line([(place[0], place[1] - 5 * unit), (place[0], place[1] + 5 * unit)], INK, 1.6 * unit)

    def missed(place: np.ndarray) -> None:
        canvas.line([(place[0], place[1] - 4 * unit), (place[0], place[1] + 4 * unit)], INK, 1.2 * unit)

    if np.isfinite(picture.truth).any():
        rows.append((path, "true path"))
    rows.append((lambda place: canvas.dot(place, DOT * unit, GREY), "measured"))
    rows.append((lambda place: canvas.ring(place, ring_radius(1e3) * unit, GREY, 1.2 * unit), "measured in a surge"))
    rows.append((missed, "not detected"))
    last = last_estimate(picture)
    off = picture.estimate[last] - picture.truth[last]
    rows.append(
        (estimate, f"estimate, {metres(float(np.linalg.norm(off)))} off" if np.isfinite(off).all() else "estimate")
    )
    if np.isfinite(picture.covariance).all():
        rows.append((ellipse, f"its {SIGMAS:g}σ ellipse"))
    if np.isfinite(picture.sensor).all():
        rows.append((lambda place: triangle(canvas, place, unit), "sensor"))
    return rows


def _draw_bar(canvas: Canvas, view: View, place: tuple[float, float], width: float, above: str, unit: float) -> None:
    """The scale bar: one step of the map's grid."""
    step = grid_step(view, unit)
    length = min(step * view.scale, width)
    x, y = place
    canvas.line([(x, y), (x + length, y)], INK, 2 * unit)
    for end in (x, x + length):
        canvas.line([(end, y - 4 * unit), (end, y + 4 * unit)], INK, 1.5 * unit)
    canvas.text(metres(step) + above, (x, y + 12 * unit), 11 * unit, INK)
