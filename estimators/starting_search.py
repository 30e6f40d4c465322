"""Where the fit of a track's first rows begins to look, and whether what it found is good enough."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from jink.estimators.sensor import Sensor
from jink.estimators.starting_fit import Window

Array = NDArray[np.float64]
_SMALL, _FAIR = 0.05, 0.5  # position sd over distance: accepted at once, accepted when rows run out
_RIVAL = 9.0  # difference in chi-square below which another place explains the rows as well


def candidates(window: Window) -> Array:
    """Starts of the search: around the first reference place, in the directions and distances known."""
    sensor = window.sensor
    axes = sensor.axes
    row, place = window.z[0], window.references[0]
    seen = _seen(sensor, row)
    spread = float(np.ptp(window.states[:, :axes], axis=0).max() + np.ptp(window.references, axis=0).max())
    if window.area is not None:
        spread += window.area[1]
    base = max(spread, window.speed * float(-window.lags[0]), *sensor.sigma, 1.0)
    distances = [abs(seen["rangem"])] if "rangem" in seen else [base * k for k in (1.0, 4.0, 16.0)]
    directions = np.array(_directions(axes))
    if "bearingrad" in seen:
        tilt = seen.get("elevationrad", 0.0)
        ray = [math.cos(seen["bearingrad"]), math.sin(seen["bearingrad"])]
        ground = math.cos(tilt) if axes == 3 else 1.0
        directions = np.array([[ground * ray[0], ground * ray[1], math.sin(tilt)][:axes]])
        distances = distances if "rangem" in seen else [base * k for k in (0.5, 2.0, 8.0, 32.0, 128.0)]
    starts = [place + distance * directions for distance in distances]
    if window.area is not None:
        starts.append(window.area[0][None])
    places = np.concatenate(starts)
    return np.concatenate([places, np.zeros_like(places)], axis=1)


def _seen(sensor: Sensor, row: Array) -> dict[str, float]:
    """Present components by first word of the label and unit ("rangem"); of many ranges the first."""
    seen: dict[str, float] = {}
    for label, unit, value in zip(sensor.labels, sensor.units, row, strict=True):
        if np.isfinite(value):
            seen.setdefault(label.split()[0] + unit, float(value))
    return seen


def _directions(axes: int) -> list[list[float]]:
    if axes == 1:
        return [[1.0], [-1.0]]
    if axes == 2:
        # Off the axes: a start exactly on a mirror line of the anchors would never leave it.
        return [[math.cos(0.1 + k * math.pi / 6), math.sin(0.1 + k * math.pi / 6)] for k in range(12)]
    corners = [corner for corner in itertools.product((-1.0, 0.05, 1.03), repeat=3) if math.hypot(*corner) > 0.5]
    return [[value / math.hypot(*corner) for value in corner] for corner in corners]


def judge(window: Window, solutions: Array, costs: Array, information: Array, last: bool) -> tuple[Array, Array] | None:
    """Mean (2 A,) and covariance (2 A, 2 A) of the best solution if it is good enough to start from."""
    axes = window.sensor.axes
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]) or np.linalg.cond(_scaled(information[best])) > 1e12:
        return None
    mean, cov = solutions[best], np.linalg.inv(information[best])
    # Misfit beyond chance means R or straight flight is wrong: say so in the covariance. The prior counts as
    # A more numbers, the solution takes 2 A.
    spare = max(window.numbers - axes, 1)
    if costs[best] > chi2.ppf(0.999, spare):
        cov = cov * (costs[best] / spare)
    sd = math.sqrt(max(float(np.linalg.eigvalsh(cov[:axes, :axes])[-1]), 0.0))
    distance = float(np.linalg.norm(mean[:axes] - window.references, axis=1).max())
    limit = (_FAIR if last else _SMALL) * distance
    if window.sensor.linear:
        limit = max(limit, 3.0 * max(window.sensor.sigma))
    if not sd <= limit:
        return None
    rivals = _rivals(solutions, costs, best, cov[:axes, :axes], axes)
    if rivals and (not last or len(rivals) > 1):
        return None
    for rival in rivals:
        weight = 1.0 / (1.0 + math.exp(0.5 * (costs[rival] - costs[best])))
        cov = cov + weight * np.outer(solutions[rival] - mean, solutions[rival] - mean)
    return mean, 0.5 * (cov + cov.T)


def _scaled(information: Array) -> Array:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    return np.asarray(information * scale * scale[:, None])


def _rivals(solutions: Array, costs: Array, best: int, cov: Array, axes: int) -> list[int]:
    """Solutions that explain the rows nearly as well from another place, one of each cluster."""
    near = np.linalg.inv(cov)
    kept: list[int] = [best]
    for s in np.argsort(costs):
        if not costs[s] - costs[best] < _RIVAL:
            break
        offsets = solutions[s, :axes] - solutions[kept, :axes]
        if np.all(np.einsum("ki,ij,kj->k", offsets, near, offsets) > 9.0):
            kept.append(int(s))
    return kept[1:]
