"""Which part of the world a frame shows: views that grow by steps, round numbers, projections."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.task import Picture

__all__ = ["View", "grow", "round_down", "span", "ticks", "view_of", "worth_showing"]

Array = NDArray[np.float64]

NOMINAL = 4.0
"""Measurements noisier than this factor on the covariance do not move the view; the rest would shrink to a dot."""
_MARGIN, _GROWTH, _WILD = 0.05, 1.25, 3.0
_FAR = 20_000.0


class View(NamedTuple):
    """A rectangle of the plane on a rectangle of the frame: centre in metres, pixels per metre, middle in pixels."""

    centre: Array  # (2,) m
    scale: float  # pixels per metre
    middle: tuple[float, float]  # pixels

    def project(self, places: Array) -> Array:
        """Places (..., 2) in metres as pixels, x to the right and y down; far ones stay within what pygame can draw."""
        pixels = (np.asarray(places)[..., :2] - self.centre) * (self.scale, -self.scale) + self.middle
        return np.clip(pixels, -_FAR, _FAR)


def round_down(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``value`` (> 0)."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (5.0, 2.0, 1.0) if factor * power <= value * (1 + 1e-12) or factor == 1.0)


def span(reached: float) -> float:
    """How far a time axis goes that has to show ``reached`` (>= 0): the next of 1, 1.5, 2, 3, 5, 7.5, 10, ..."""
    if reached <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(reached))
    steps = (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0)
    return next(step * power for step in steps if reached <= step * power * (1 + 1e-9) or step == 10.0)


def ticks(low: float, high: float, most: int) -> list[float]:
    """At most ``most`` + 1 round numbers from ``low`` to ``high``, evenly apart."""
    if not high > low:
        return [low]
    step = round_down((high - low) / max(most, 1))
    while (high - low) / step > most:
        step = round_down(step * 2.5)
    first = math.ceil(low / step - 1e-9)
    return [i * step for i in range(first, math.floor(high / step + 1e-9) + 1)]


def worth_showing(picture: Picture) -> tuple[Array, NDArray[np.bool_]]:
    """What the view has to hold, in the order in which it happened: truth, nominal measurements, estimates.

    Returns:
        places (P, 2), and whether each must be shown however far away it is (the truth).
    """
    calm = np.where(np.asarray(picture.scale)[:, None] <= NOMINAL, picture.seen[:, :2], np.nan)
    order = np.stack([picture.truth[:, :2], calm, picture.estimate[:, :2]], axis=1).reshape(-1, 2)
    must = np.tile([True, False, False], len(picture.times))
    kept = np.isfinite(order).all(axis=1)
    return order[kept], must[kept]


def grow(places: Array, must: NDArray[np.bool_], half: float, ratio: float) -> tuple[Array, Array]:
    """The box that shows the places, as it has grown while they came one by one.

    A pure function of what happened so far, so frames do not depend on which frames were drawn before. The box never
    shrinks or slides: where a place leaves it, that side moves out by a good part of its size. A place that is not a
    must and would more than triple the box is left outside.

    Args:
        places: (P, 2), finite.
        must: (P,).
        half: half the height of the first box, m.
        ratio: width to height.

    Returns:
        lower left and upper right corner (2,), (2,).
    """
    reach = np.array([ratio, 1.0]) * half
    low, high = places[0] - reach, places[0] + reach
    rest, forced = places[1:], must[1:]
    while len(rest):
        margin = _MARGIN * (high - low)
        out = np.flatnonzero(((rest < low + margin) | (rest > high - margin)).any(axis=1))
        if not out.size:
            break
        place, size = rest[out[0]], high - low
        needed = np.maximum(high, place) - np.minimum(low, place)
        if forced[out[0]] or (needed <= _WILD * size).all():
            below, above = place < low + margin, place > high - margin
            new = max(_GROWTH, float(np.max(needed / size)) * 1.12)
            wider = size * new
            # The sides that were crossed move; the other axis grows about its middle to keep the proportions.
            share = np.where(below, 1.0, np.where(above, 0.0, 0.5))
            low, high = low - share * (wider - size), high + (1.0 - share) * (wider - size)
        rest, forced = rest[out[0] + 1 :], forced[out[0] + 1 :]
    return low, high


def view_of(picture: Picture, width: float, height: float, middle: tuple[float, float]) -> View:
    """The view of a picture on ``width`` times ``height`` pixels around ``middle``."""
    places, must = worth_showing(picture)
    if not len(places):
        return View(np.zeros(2), height / 20.0, middle)
    low, high = grow(places, must, _first_half(picture, places), width / height)
    size = float(high[1] - low[1])
    return View((low + high) / 2, height / size, middle)


def _first_half(picture: Picture, places: Array) -> float:
    """Half the height of the first view: a few steps of the target, or the spread of the first sample."""
    path = picture.truth[:, :2] if np.isfinite(picture.truth[:, :2]).any() else places
    path = path[np.isfinite(path).all(axis=1)]
    moved = np.linalg.norm(path - path[0], axis=1)
    moved = moved[moved > 1e-9 * max(1.0, float(np.abs(path[0]).max()))]
    first = float(np.linalg.norm(picture.seen[0, :2] - path[0]))
    variance = float(np.max(np.diagonal(picture.covariance)[:2]))
    calm = float(picture.scale[0]) <= NOMINAL and math.isfinite(first)
    found = max(4.0 * float(moved[0]) if moved.size else 0.0, 2.0 * first if calm else 0.0)
    if found <= 0.0 and variance > 0.0:
        found = 3.0 * math.sqrt(variance)
    return found if found > 0.0 else 1.0
