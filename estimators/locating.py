"""How one measurement locates a target: positions as they are, polar ones by their exact moments."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from jink.estimators.multilateration import checked_location
from jink.estimators.sensing import see_ranges
from jink.estimators.sensor import Location, Sensor

Array = NDArray[np.float64]


def locate_position(sensor: Sensor, z: Array, R: Array, sensor_state: Array) -> Location | None:
    """The measured position itself."""
    return checked_location(np.array(z, dtype=np.float64), np.array(R, dtype=np.float64))


def locate_polar(sensor: Sensor, z: Array, R: Array, sensor_state: Array) -> Location | None:
    """Place of a range, bearing (and elevation) from the sensor."""
    size = sensor.axes
    return _from_polar(z[:size], R[:size, :size], sensor_state[:size])


def locate_ray(sensor: Sensor, z: Array, R: Array, sensor_state: Array) -> Location | None:
    """Place along a bearing (and elevation), at the distance that ``params`` expects (mean, sd)."""
    size = sensor.axes
    polar = np.concatenate(([sensor.params[0]], z[: size - 1]))
    noise = np.zeros((size, size))
    noise[0, 0] = sensor.params[1] ** 2
    noise[1:, 1:] = R[: size - 1, : size - 1]
    return _from_polar(polar, noise, sensor_state[:size])


@cache
def _quadrature(dimension: int, order: int = 9) -> tuple[Array, Array]:
    """Gauss-Hermite points (S, dimension) and weights (S,) of the standard normal."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(order)
    grids = np.meshgrid(*[nodes] * dimension, indexing="ij")
    products = np.meshgrid(*[weights / weights.sum()] * dimension, indexing="ij")
    return np.stack([grid.ravel() for grid in grids], axis=1), np.prod(products, axis=0).ravel()


def _from_polar(polar: Array, noise: Array, origin: Array) -> Location | None:
    """Mean and covariance of the place whose range, bearing (, elevation) are ``N(polar, noise)``.

    Model: ``E[p | z]`` and ``cov[p | z]`` with ``p = origin + r u(angles)``, all directions alike beforehand.
    The mean is pulled towards the sensor by ``exp(-sigma^2 / 2)``; without it the covariance would be
    optimistic wherever the arc bends by more than the range noise. With an independent bearing, this is
    ``r^2 (1 - e^-s)^2 / 2 + sigma_r^2 (1 + e^-2s) / 2`` along and
    ``(r^2 + sigma_r^2) (1 - e^-2s) / 2`` across the line of sight, ``s = sigma^2``.

    Source: Lerro, Bar-Shalom (1993), IEEE TAES 29(3), 1015-1022, exact moments of converted measurements.
    Differs: expectation over the target given the measurement (the pull multiplies), not over the measurement
    given the target (Longbin et al. 1998, where it divides); by quadrature, so that any R and elevation do.
    """
    if not (np.isfinite(polar).all() and np.isfinite(noise).all()):
        return None
    try:
        root = np.linalg.cholesky(noise)
    except np.linalg.LinAlgError:
        return None
    points, weights = _quadrature(len(polar))
    samples = polar + points @ root.T
    distance, angle = samples[:, 0], samples[:, 1]
    if len(polar) == 2:
        places = np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
    else:
        ground = distance * np.cos(samples[:, 2])
        places = np.stack([ground * np.cos(angle), ground * np.sin(angle), distance * np.sin(samples[:, 2])], axis=1)
    mean = weights @ places
    deviations = places - mean
    return checked_location(origin + mean, (weights[:, None] * deviations).T @ deviations)


def reference_places(sensor: Sensor, z: Array, sensor_state: Array) -> Array:
    """Places that the present components of ``z`` refer to: anchors heard, else the sensor; (K, A)."""
    if sensor.observe.function is see_ranges:
        return np.asarray(sensor.params).reshape(-1, sensor.axes)[np.isfinite(z)]
    return sensor_state[None, : sensor.axes]
