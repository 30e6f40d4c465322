"""Measurements as positions: what a filter that is linear in position needs, made once per episode.

A position sensor's measurements pass unchanged. Ranges and angles are converted with their exact moments, so the mean
is unbiased and the covariance neither optimistic nor pessimistic; a range rate is left out. A sensor that one
measurement does not locate is refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes
from jink.estimators.locating import locate_polar, locate_position, locate_ray
from jink.estimators.sensor import Sensor

__all__ = ["check_locates", "place_measurements"]

Array = NDArray[np.float64]


def check_locates(caller: str, sensor: Sensor) -> None:
    """Refuse a sensor that does not locate a target with each measurement.

    Raises:
        ValueError: no position can be had from one measurement, or only with the help of a prior.
    """
    if sensor.locate is None or sensor.locate is locate_ray:
        raise ValueError(
            f"{caller}: sensor must locate a target with each measurement; got {sensor.name}. "
            "Use position, ranges, or range with bearing (and elevation)."
        )


def place_measurements(sensor: Sensor, episodes: Episodes) -> tuple[Array, Array]:
    """Measured positions and their nominal covariances.

    Args:
        sensor: of the episodes; must pass `check_locates`.
        episodes: B episodes of T samples.

    Returns:
        positions (B, T, A), NaN where missing, m; covariances (A, A) where all are alike, else (B, T, A, A), m^2.
    """
    z, R, A = episodes.measurements, episodes.nominal_noise, sensor.axes
    if sensor.locate is locate_position:
        return z, R
    if sensor.locate is locate_polar and not np.any(R[:A, :A] - np.diag(np.diag(R)[:A])):
        return _from_polar(z[..., :A], np.diag(R)[:A], episodes.sensor_states[..., :A])
    places, covs = np.full((*z.shape[:2], A), np.nan), np.tile(np.eye(A), (*z.shape[:2], 1, 1))
    for b, k in zip(*np.nonzero(np.isfinite(z).any(axis=2)), strict=True):
        located = None if sensor.locate is None else sensor.locate(sensor, z[b, k], R, episodes.sensor_states[b, k])
        if located is not None:
            places[b, k], covs[b, k] = located
    return places, covs


def _from_polar(z: Array, variances: Array, origin: Array) -> tuple[Array, Array]:
    """`jink.estimators.locating.locate_polar` in closed form, for independent range, bearing (and elevation).

    Model: ``E[cos b] = cos(b) e^(-s/2)``, ``E[cos 2b] = cos(2b) e^(-2s)`` for a bearing of variance s.
    """
    A = z.shape[-1]
    distance, angle = z[..., 0], z[..., 1]
    square = distance * distance + variances[0]
    pull, wide = np.exp(-0.5 * variances[1]), np.exp(-2.0 * variances[1])
    cosine, sine = pull * np.cos(angle), pull * np.sin(angle)
    twice_cosine, twice_sine = wide * np.cos(2.0 * angle), wide * np.sin(2.0 * angle)
    places, covs = np.empty(z.shape), np.empty((*z.shape, A))
    level, level_square = distance, square
    if A == 3:
        elevation = z[..., 2]
        pull, wide = np.exp(-0.5 * variances[2]), np.exp(-2.0 * variances[2])
        high, high_square = pull * np.sin(elevation), 0.5 * (1.0 - wide * np.cos(2.0 * elevation))
        level, level_square = distance * pull * np.cos(elevation), square * (1.0 - high_square)
        both = 0.5 * square * wide * np.sin(2.0 * elevation)
        places[..., 2] = distance * high
        covs[..., 2, 2] = square * high_square - places[..., 2] ** 2
        for axis, share in enumerate((cosine, sine)):
            covs[..., axis, 2] = covs[..., 2, axis] = both * share - level * share * places[..., 2]
    places[..., 0], places[..., 1] = level * cosine, level * sine
    covs[..., 0, 0] = 0.5 * level_square * (1.0 + twice_cosine) - places[..., 0] ** 2
    covs[..., 1, 1] = 0.5 * level_square * (1.0 - twice_cosine) - places[..., 1] ** 2
    covs[..., 0, 1] = covs[..., 1, 0] = 0.5 * level_square * twice_sine - places[..., 0] * places[..., 1]
    seen: NDArray[np.bool_] = np.all(np.isfinite(z), axis=-1)
    return np.where(seen[..., None], places + origin, np.nan), np.where(seen[..., None, None], covs, np.eye(A))
