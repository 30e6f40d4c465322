"""Frames of an episode: a map of what happens and, below it, intent, noise and action over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jink.envs.drawing.canvas import INK, UNKNOWN, Box, Canvas, intent_colours, load_pygame
from jink.envs.drawing.map_panel import draw_map
from jink.envs.drawing.side_panel import draw_side
from jink.envs.drawing.strip_panels import (
    Clock,
    draw_actions,
    draw_altitude,
    draw_clock,
    draw_intents,
    draw_noise,
    last_choice,
)
from jink.envs.task import Picture

if TYPE_CHECKING:
    import pygame

__all__ = ["MODES", "Renderer"]

MODES = ("rgb_array", "human")
_SMALLEST = (320, 240)
_ACTION_ROWS = 10
_FARTHEST = 1e15


class Renderer:
    """Draws `Picture`s: as arrays without a display, or in a window.

    A frame is a pure function of its picture: which frames were drawn before does not matter.

    Args:
        size: width, height of a frame in pixels.
        mode: "rgb_array" or "human".
        fps: frames per second of the window.

    Raises:
        ValueError: an unknown mode, a size below 320 x 240, or fps not above 0.
        DependencyNotInstalled: pygame is not there.
    """

    def __init__(self, size: tuple[int, int] = (960, 640), mode: str = "rgb_array", fps: float = 30.0) -> None:
        if mode not in MODES:
            raise ValueError(
                f"Renderer: mode must be one of {', '.join(MODES)}; got '{mode}'. Use rgb_array for files."
            )
        whole = all(isinstance(value, int | np.integer) for value in size)
        if len(size) != 2 or not whole or size[0] < _SMALLEST[0] or size[1] < _SMALLEST[1]:
            raise ValueError(
                f"Renderer: size must be whole pixels, at least {_SMALLEST[0]} x {_SMALLEST[1]}; got {size}. "
                "Use for example (960, 640)."
            )
        if not fps > 0:
            raise ValueError(f"Renderer: fps must be > 0; got {fps}. Use for example 30.")
        load_pygame()
        self.mode, self.size, self.fps = mode, (int(size[0]), int(size[1])), float(fps)
        self._window: pygame.Surface | None = None
        self._clock: Any = None
        self.closed = False
        """Whether the user has closed the window; `show` then does nothing."""

    def frame(self, picture: Picture) -> NDArray[np.uint8]:
        """The picture as an image (height, width, 3)."""
        pixels = load_pygame().image.tobytes(self._draw(picture), "RGB")
        return np.frombuffer(pixels, dtype=np.uint8).reshape(self.size[1], self.size[0], 3).copy()

    def show(self, picture: Picture) -> bool:
        """Show the picture in the window, opened by the first call, and wait until it is time for the next.

        Returns:
            whether the window is still open; the user closes it with its button, Escape or Q.

        Raises:
            OSError: there is no display.
        """
        if self.closed:
            return False
        pg = load_pygame()
        if self._window is None:
            self._open()
        for event in pg.event.get():
            keys = event.type == pg.KEYDOWN and event.key in (pg.K_ESCAPE, pg.K_q)
            if event.type == pg.QUIT or keys:
                self.close()
                self.closed = True
                return False
        assert self._window is not None
        self._window.blit(self._draw(picture), (0, 0))
        pg.display.flip()
        self._clock.tick(self.fps)
        return True

    def close(self) -> None:
        """Close the window if there is one; may be called again."""
        if self._window is not None:
            load_pygame().display.quit()
            self._window = None

    def _open(self) -> None:
        pg = load_pygame()
        try:
            pg.display.init()
            pg.display.set_caption("Jink")
            self._window = pg.display.set_mode(self.size)
        except pg.error as error:
            raise OSError(
                f"Renderer: a display must be there for mode human; got none ({error}). Use mode rgb_array."
            ) from error
        self._clock = pg.time.Clock()

    def _draw(self, picture: Picture) -> pygame.Surface:
        canvas = Canvas(self.size)
        unit = float(np.clip(min(self.size[0] / 960, self.size[1] / 640), 0.5, 8.0))
        _compose(canvas, _checked(picture), unit)
        return canvas.finish()


def _checked(picture: Picture) -> Picture:
    """The picture with what is absurdly far away left out as if it were missing."""
    if not len(picture.times) or picture.truth.shape[1] not in (2, 3):
        raise ValueError(
            f"Renderer: picture must hold samples of 2 or 3 axes; got truth {picture.truth.shape}. Reset first."
        )
    return picture._replace(
        truth=_bounded(picture.truth, _FARTHEST),
        seen=_bounded(picture.seen, _FARTHEST),
        estimate=_bounded(picture.estimate, _FARTHEST),
        sensor=_bounded(picture.sensor, _FARTHEST),
        covariance=_bounded(picture.covariance, _FARTHEST**2),
    )


def _bounded(values: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
    return np.where(np.abs(values) <= limit, values, np.nan)


def _compose(canvas: Canvas, picture: Picture, unit: float) -> None:
    """Header, map, side and strips; the map gets what the strips leave."""
    width, height = canvas.size
    edge, head, labels, aside = 14 * unit, 46 * unit, 122 * unit, 186 * unit
    main = width - 2 * edge - aside - 14 * unit
    colours = intent_colours(picture.intents)
    known = {int(value) for value in np.unique(picture.intent)}
    colours |= dict.fromkeys(known - set(colours), UNKNOWN)
    strips = _strips(picture, unit)
    gap, foot = 8 * unit, 24 * unit
    below = sum(tall for _, tall in strips) + gap * len(strips) + foot
    # A small frame keeps its map: strips shrink before it does.
    shrink = min(1.0, 0.55 * (height - head) / below)
    map_box: Box = (edge, head, main, height - head - shrink * below - 2 * unit)
    _draw_header(canvas, picture, edge, main, head, unit)
    view = draw_map(canvas, picture, map_box, colours, unit)
    side_left = edge + main + 14 * unit
    draw_side(canvas, picture, (side_left, head, aside, map_box[3]), view, colours, unit)
    left = edge + labels
    clock = Clock(picture, left, main - labels)
    first = top = map_box[1] + map_box[3] + shrink * gap
    bottom = top
    for name, tall in strips:
        box: Box = (left, top, main - labels, shrink * tall)
        canvas.text(name, (edge, top + min(shrink * tall / 2, 8 * unit)), 11.5 * unit, INK)
        if name == "altitude":
            draw_altitude(canvas, picture, box, clock, colours, unit)
        elif name == "intent":
            draw_intents(canvas, picture, box, clock, colours, unit)
        elif name == "noise":
            draw_noise(canvas, picture, box, clock, unit)
        else:
            draw_actions(canvas, picture, box, clock, labels - 50 * unit, unit)
        canvas.text(_now(picture, name), (side_left, top + shrink * tall / 2), 11.5 * unit, INK, bold=True, room=aside)
        bottom = top + shrink * tall
        top = bottom + shrink * gap
    draw_clock(canvas, clock, first, bottom, unit)


def _strips(picture: Picture, unit: float) -> list[tuple[str, float]]:
    """Names and heights of the strips that this picture has."""
    found = [("altitude", 74 * unit)] if picture.truth.shape[1] == 3 else []
    found += [("intent", 20 * unit), ("noise", 46 * unit)]
    if picture.choices:
        found.append(("action", 12 * unit * min(max(len(picture.choices), 2), _ACTION_ROWS)))
    return found


def _draw_header(canvas: Canvas, picture: Picture, edge: float, main: float, head: float, unit: float) -> None:
    middle = head / 2
    score = f"score {_number(float(np.nansum(picture.score)))}"
    clock = f"{float(picture.times[-1]) - float(picture.times[0]):.1f} s"
    canvas.text(picture.title, (edge, middle), 15 * unit, INK, bold=True, room=main)
    canvas.text(clock, (edge + main + 14 * unit, middle), 14 * unit, INK, bold=True)
    canvas.text(score, (canvas.size[0] - edge, middle), 14 * unit, INK, align=1.0)


def _now(picture: Picture, strip: str) -> str:
    """The present value, written beside its strip."""
    if strip == "altitude":
        height = float(picture.truth[-1, 2])
        return f"{height:,.4g} m" if np.isfinite(height) else ""
    if strip == "intent":
        return _name(picture.intents, int(picture.intent[-1]))
    if strip == "action":
        taken = last_choice(picture)
        return _name(picture.choices, taken) if taken >= 0 else ""
    scale = float(picture.scale[-1])
    return "" if not np.isfinite(scale) else f"×{scale:,.0f}" if scale >= 100 else f"×{scale:.3g}"


def _name(names: Sequence[str], number: int) -> str:
    return names[number] if 0 <= number < len(names) else "unknown"


def _number(value: float) -> str:
    """A number of at most six figures, with a minus sign that is one."""
    text = f"{value:,.0f}" if abs(value) >= 10_000 else f"{value:.2f}"
    return text.replace("-", "−")
