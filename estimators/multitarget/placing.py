"""Where a single detection puts a target, with unknown velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scan

__all__ = ["place_detections"]

Array = NDArray[np.float64]


def place_detections(sensor: ScanSensor, scan: Scan, detections: Array, speed: float) -> tuple[Array, Array]:
    """Position from the sensor's `locate`, velocity zero with standard deviation ``speed`` on each axis.

    Args:
        sensor, scan: who saw them, and when; R and the sensor's place are the scan's.
        detections: (n, D).
        speed: m/s.

    Returns:
        position then velocity of those that locate a target; (m, 2 A), (m, 2 A, 2 A).
    """
    A, model = sensor.model.axes, sensor.model
    places: list[Array] = []
    spreads: list[Array] = []
    if model.name == "position" and len(detections):
        places, spreads = list(detections), [scan.noise] * len(detections)
    elif model.name == "range-bearing" and len(detections) and np.count_nonzero(scan.noise) == 2:
        places, spreads = _from_polar(detections, scan.noise, scan.sensor_state)
    elif model.locate is not None:
        for z in detections:
            location = model.locate(model, z, scan.noise, scan.sensor_state)
            if location is not None and np.isfinite(location[0]).all() and np.isfinite(location[1]).all():
                places.append(location[0])
                spreads.append(location[1])
    mean, cov = np.zeros((len(places), 2 * A)), np.zeros((len(places), 2 * A, 2 * A))
    if places:
        mean[:, :A], cov[:, :A, :A] = np.stack(places), np.stack(spreads)
    cov[:, range(A, 2 * A), range(A, 2 * A)] = speed**2
    return mean, cov


def _from_polar(detections: Array, noise: Array, place: Array) -> tuple[list[Array], list[Array]]:
    """`locate_polar` in closed form for independent range and bearing, all detections at once."""
    ranges, bearings, squared = detections[:, 0], detections[:, 1], noise[1, 1]
    ahead = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    along = ranges**2 * (1 - np.exp(-squared)) ** 2 / 2 + noise[0, 0] * (1 + np.exp(-2 * squared)) / 2
    across = (ranges**2 + noise[0, 0]) * (1 - np.exp(-2 * squared)) / 2
    positions = place[:2] + np.exp(-squared / 2) * ranges[:, None] * ahead
    covs = (
        along[:, None, None] * ahead[:, :, None] * ahead[:, None, :]
        + across[:, None, None] * aside[:, :, None] * aside[:, None, :]
    )
    return list(positions), list(covs)
