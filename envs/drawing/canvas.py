"""Drawing with pygame: a canvas of twice the size that is smoothed down, text, colours told apart by everybody."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pygame

__all__ = [
    "FAINT",
    "GREY",
    "INK",
    "INTENT_COLOURS",
    "LINE",
    "PAPER",
    "SURGE",
    "UNKNOWN",
    "Box",
    "Canvas",
    "Colour",
    "fade",
    "intent_colours",
    "load_pygame",
]

Array = NDArray[np.float64]
Colour = tuple[int, int, int]
Box = tuple[float, float, float, float]  # left, top, width, height

PAPER: Colour = (255, 255, 255)
INK: Colour = (24, 24, 24)
GREY: Colour = (105, 105, 105)
LINE: Colour = (214, 214, 214)
FAINT: Colour = (246, 246, 244)
SURGE: Colour = (213, 94, 0)  # vermillion of Okabe and Ito's palette, kept for noise

_OTHERS: tuple[Colour, ...] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (153, 153, 51),
    (51, 34, 136),
    (136, 34, 85),
    (120, 90, 60),
)
"""Okabe and Ito's palette without vermillion (noise), black (the estimate) and yellow (too pale for a path), and four
of Tol's muted colours."""
INTENT_COLOURS: dict[str, Colour] = dict(
    zip(
        ("straight", "turn", "accelerate", "weave", "orbit", "climb", "helix", "jink", "stop-and-go"),
        _OTHERS,
        strict=True,
    )
)
UNKNOWN: Colour = (170, 170, 170)
_TWICE = 2


def load_pygame() -> ModuleType:
    """Pygame, without its greeting.

    Raises:
        DependencyNotInstalled: it is not there.
    """
    import os

    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise DependencyNotInstalled(
            "Renderer: pygame must be installed to draw frames; got none. Run pip install 'jink[render]'."
        ) from error
    return pygame


def fade(colour: Colour, share: float, paper: Colour = PAPER) -> Colour:
    """A colour mixed with the paper: 0 is the paper, 1 the colour."""
    mixed = [round(share * c + (1.0 - share) * p) for c, p in zip(colour, paper, strict=True)]
    return mixed[0], mixed[1], mixed[2]


def intent_colours(intents: Sequence[str]) -> dict[int, Colour]:
    """Colour of each intent by its number, the same for a name wherever it occurs; -1 is an unknown one."""
    spare = [colour for colour in _OTHERS if colour not in {INTENT_COLOURS.get(name) for name in intents}]
    found: dict[int, Colour] = {-1: UNKNOWN}
    taken = 0
    for number, name in enumerate(intents):
        colour = INTENT_COLOURS.get(name)
        if colour is None:
            # A second round through the palette is darker.
            colour = fade(spare[taken % len(spare)], 0.6 ** (taken // len(spare)), (0, 0, 0)) if spare else UNKNOWN
            taken += 1
        found[number] = colour
    return found


@cache
def _font(size: int, bold: bool) -> pygame.font.Font:
    """DejaVu Sans as matplotlib ships it: the same letters on every machine, Greek included."""
    pg = load_pygame()
    pg.font.init()
    found = importlib.util.find_spec("matplotlib")
    folder = Path(str(found.origin)).parent / "mpl-data" / "fonts" / "ttf" if found else Path()
    file = folder / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
    return pg.font.Font(str(file) if file.is_file() else None, size)


class Canvas:
    """What one frame is drawn on; lengths and places are pixels of the finished frame, with fractions.

    Shapes are drawn at twice the size and smoothed down, text is set afterwards at its own size.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.pg: Any = load_pygame()
        self.size = size
        self._big = self.pg.Surface((_TWICE * size[0], _TWICE * size[1]), 0, 32)
        self._big.fill(PAPER)
        self._texts: list[tuple[pygame.Surface, tuple[float, float]]] = []

    def clip(self, box: Box | None) -> None:
        """Shapes from now on stay inside the box; None: anywhere."""
        self._big.set_clip(None if box is None else self.pg.Rect(*(round(_TWICE * value) for value in box)))

    def box(self, box: Box, colour: Colour, *, rounding: float = 0.0) -> None:
        """A filled rectangle; at least one pixel of the doubled canvas wide."""
        left, top, width, height = (_TWICE * value for value in box)
        right, bottom = round(left + width), round(top + height)
        area = (round(left), round(top), max(right - round(left), 1), max(bottom - round(top), 1))
        self.pg.draw.rect(self._big, colour, area, border_radius=round(_TWICE * rounding))

    def line(self, places: Any, colour: Colour, width: float = 1.0) -> None:
        """A path through places (K, 2) with round joints; NaN interrupts it."""
        points: Array = _TWICE * np.asarray(places, dtype=np.float64).reshape(-1, 2)
        thick = max(1, round(_TWICE * width))
        known = np.isfinite(points[:, 0]) & np.isfinite(points[:, 1])
        for part in np.split(np.arange(len(points)), np.flatnonzero(np.diff(known)) + 1):
            if part.size < 2 or not known[part[0]]:
                continue
            path = points[part]
            self.pg.draw.lines(self._big, colour, False, path.tolist(), thick)
            if thick > 3:
                for place in path:
                    self.pg.draw.circle(self._big, colour, place.tolist(), thick / 2)

    def dot(self, place: Any, radius: float, colour: Colour) -> None:
        """A filled disc."""
        self.pg.draw.circle(self._big, colour, _doubled(place), _TWICE * radius)

    def ring(self, place: Any, radius: float, colour: Colour, width: float = 1.5) -> None:
        """A circle."""
        self.pg.draw.circle(self._big, colour, _doubled(place), _TWICE * radius, max(1, round(_TWICE * width)))

    def area(self, places: Any, colour: Colour) -> None:
        """A filled polygon (K, 2)."""
        self.pg.draw.polygon(self._big, colour, (_TWICE * np.asarray(places, dtype=np.float64)).tolist())

    def width(self, text: str, size: float, *, bold: bool = False) -> float:
        """How wide a text will be."""
        return float(_font(_pixels(size), bold).size(text)[0])

    def text(
        self,
        text: str,
        place: tuple[float, float],
        size: float,
        colour: Colour = INK,
        *,
        align: float = 0.0,
        bold: bool = False,
        room: float | None = None,
    ) -> None:
        """A line of text whose middle line is at the height of ``place``.

        Args:
            text: what to say.
            place: where.
            size: of the letters.
            colour: of the letters.
            align: 0: begins at the place, 0.5: is centred, 1: ends there.
            bold: heavier letters.
            room: widest it may be; longer texts end in an ellipsis. None: as wide as it is.
        """
        if room is not None and self.width(text, size, bold=bold) > room:
            while text and self.width(text + "…", size, bold=bold) > room:
                text = text[:-1].rstrip()
            text = text + "…" if text else ""
        if not text:
            return
        image = _font(_pixels(size), bold).render(text, True, colour)
        self._texts.append((image, (place[0] - align * image.get_width(), place[1] - image.get_height() / 2)))

    def finish(self) -> pygame.Surface:
        """The frame."""
        surface = self.pg.transform.smoothscale(self._big, self.size)
        for image, (left, top) in self._texts:
            surface.blit(image, (round(left), round(top)))
        return surface


def _doubled(place: Any) -> tuple[float, float]:
    return _TWICE * float(place[0]), _TWICE * float(place[1])


def _pixels(size: float) -> int:
    return max(6, round(size))
