"""Place of a target from its distances to several anchors, by weighted least squares."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from jink.estimators.sensor import Location, Sensor

Array = NDArray[np.float64]


def locate_ranges(sensor: Sensor, z: Array, R: Array, sensor_state: Array) -> Location | None:
    """Weighted least squares from at least A + 1 ranges.

    A mirror image that explains the ranges almost as well (anchors on a line or a plane) is not chosen, but
    the covariance is widened to the second moment about the chosen place, so that both lie inside it.

    Source: Gauss-Newton with step control; starts on both sides of the anchors' best plane.
    """
    axes = sensor.axes
    seen = np.isfinite(z)
    if seen.sum() < axes + 1:
        return None
    anchors = np.asarray(sensor.params).reshape(-1, axes)[seen]
    if len(np.unique(anchors, axis=0)) < axes:
        return None
    ranges_seen, noise = z[seen], R[np.ix_(seen, seen)]
    try:
        whiten = np.linalg.inv(np.linalg.cholesky(noise))
    except np.linalg.LinAlgError:
        return None
    fits = sorted(
        (_fit_ranges(start, anchors, ranges_seen, whiten) for start in _range_starts(anchors, ranges_seen)),
        key=lambda fit: fit[1],
    )
    place, cost, information = fits[0]
    values, vectors = np.linalg.eigh(information)
    # In the plane of its anchors a range changes with the square of the height: sd sqrt(2 r sigma), not inf.
    worst = math.sqrt(float(np.max(np.diag(noise))))
    floor = 1.0 / (2.0 * float(np.max(np.abs(ranges_seen))) * worst + 1e-300)
    values = np.maximum(values, floor)
    spare = len(ranges_seen) - axes
    if cost > _surprising(spare):
        values = values * (spare / cost)
    cov = (vectors / values) @ vectors.T
    rival = next((fit for fit in fits[1:] if ((fit[0] - place) @ vectors) ** 2 @ values > 4.0), None)
    if rival is not None and rival[1] - cost < 18.0:
        weight = 1.0 / (1.0 + math.exp(0.5 * (rival[1] - cost)))
        cov = cov + weight * np.outer(rival[0] - place, rival[0] - place)
    return checked_location(place, cov)


@cache
def _surprising(dof: int) -> float:
    return float(chi2.ppf(0.999, dof))


def _range_starts(anchors: Array, distances: Array) -> list[Array]:
    """Linear multilateration in the anchors' plane, then both heights over it, and a point on it."""
    centre = anchors.mean(axis=0)
    relative = anchors - centre
    _, singular, frame = np.linalg.svd(relative, full_matrices=True)
    squares = np.sum(relative**2, axis=1) - distances**2
    flat = relative @ frame[:-1].T
    foot = np.linalg.lstsq(2.0 * flat, squares - squares.mean(), rcond=1e-9)[0]
    normal = frame[-1]
    base = centre + foot @ frame[:-1]
    height2 = float(np.mean(distances**2 - np.sum((anchors - base) ** 2, axis=1)))
    height = math.sqrt(height2) if height2 > 0 else 0.05 * float(np.mean(np.abs(distances)))
    starts = [base + height * normal, base - height * normal]
    if singular[-1] > 1e-6 * singular[0]:
        starts.append(centre + np.linalg.lstsq(2.0 * relative, squares - squares.mean(), rcond=None)[0])
    return starts


def _fit_ranges(start: Array, anchors: Array, distances: Array, whiten: Array) -> tuple[Array, float, Array]:
    """Place, chi-square and information (A, A) after damped Gauss-Newton from ``start``."""
    place, damping = start, 1e-9
    residual, slope = _range_residual(place, anchors, distances, whiten)
    for _ in range(50):
        information = slope.T @ slope
        ridge = (damping * np.trace(information) + 1e-300) * np.eye(len(place))
        step = np.linalg.solve(information + ridge, -slope.T @ residual)
        trial_residual, trial_slope = _range_residual(place + step, anchors, distances, whiten)
        if trial_residual @ trial_residual <= residual @ residual:
            place, residual, slope, damping = place + step, trial_residual, trial_slope, max(0.2 * damping, 1e-12)
        else:
            damping = max(damping, 1e-6) * 8.0
        if step @ information @ step < 1e-12:
            break
    return place, float(residual @ residual), slope.T @ slope


def _range_residual(place: Array, anchors: Array, distances: Array, whiten: Array) -> tuple[Array, Array]:
    offset = place - anchors
    length = np.linalg.norm(offset, axis=1)
    return whiten @ (length - distances), whiten @ (offset / np.maximum(length, 1e-12)[:, None])


def checked_location(mean: Array, cov: Array) -> Location | None:
    """A finite mean with its symmetric covariance, or None."""
    if np.isfinite(mean).all() and np.isfinite(cov).all():
        return mean, 0.5 * (cov + cov.T)
    return None
