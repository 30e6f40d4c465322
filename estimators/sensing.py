"""What the sensors see: plain functions in Numba's subset, compiled when a kernel first needs them.

Each writes the noise-free measurement of kinematics ``kin`` (target position, velocity) from ``sensor`` (its
own position, velocity) into ``out``. Geometry is always target minus sensor; bearing is counter-clockwise
from +x, elevation is up from the horizontal plane, range rate is positive when the target recedes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def see_position(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Position (A,)."""
    for axis in range(kin.shape[0] // 2):
        out[axis] = kin[axis]


def see_range_bearing(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Range, bearing; in the plane."""
    dx, dy = kin[0] - sensor[0], kin[1] - sensor[1]
    out[0] = math.hypot(dx, dy)
    out[1] = math.atan2(dy, dx)


def see_range_bearing_elevation(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Slant range, bearing, elevation."""
    dx, dy, dz = kin[0] - sensor[0], kin[1] - sensor[1], kin[2] - sensor[2]
    ground = math.hypot(dx, dy)
    out[0] = math.hypot(ground, dz)
    out[1] = math.atan2(dy, dx)
    out[2] = math.atan2(dz, ground)


def see_bearing(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Bearing."""
    out[0] = math.atan2(kin[1] - sensor[1], kin[0] - sensor[0])


def see_bearing_elevation(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Bearing, elevation."""
    dx, dy = kin[0] - sensor[0], kin[1] - sensor[1]
    out[0] = math.atan2(dy, dx)
    out[1] = math.atan2(kin[2] - sensor[2], math.hypot(dx, dy))


def see_ranges(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Distance to each anchor; ``params`` holds the anchors, (D, A) in rows."""
    axes = kin.shape[0] // 2
    for anchor in range(out.shape[0]):
        distance = 0.0
        for axis in range(axes):
            distance = math.hypot(distance, kin[axis] - params[anchor * axes + axis])
        out[anchor] = distance


def see_range(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Range."""
    distance = 0.0
    for axis in range(kin.shape[0] // 2):
        distance = math.hypot(distance, kin[axis] - sensor[axis])
    out[0] = distance


def see_range_rate(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Range rate."""
    axes = kin.shape[0] // 2
    distance = 0.0
    for axis in range(axes):
        distance = math.hypot(distance, kin[axis] - sensor[axis])
    out[0] = 0.0
    if distance > 0.0:
        for axis in range(axes):
            closing = (kin[axis] - sensor[axis]) / distance
            out[0] += closing * (kin[axes + axis] - sensor[axes + axis])


def see_range_bearing_rate(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Range, bearing, range rate; in the plane."""
    dx, dy = kin[0] - sensor[0], kin[1] - sensor[1]
    distance = math.hypot(dx, dy)
    out[0] = distance
    out[1] = math.atan2(dy, dx)
    out[2] = 0.0
    if distance > 0.0:
        out[2] = dx / distance * (kin[2] - sensor[2]) + dy / distance * (kin[3] - sensor[3])


def see_range_range_rate(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Range, range rate."""
    axes = kin.shape[0] // 2
    distance = 0.0
    for axis in range(axes):
        distance = math.hypot(distance, kin[axis] - sensor[axis])
    out[0] = distance
    out[1] = 0.0
    if distance > 0.0:
        for axis in range(axes):
            out[1] += (kin[axis] - sensor[axis]) / distance * (kin[axes + axis] - sensor[axes + axis])


def see_range_bearing_elevation_rate(kin: Array, sensor: Array, params: Array, out: Array) -> None:
    """Slant range, bearing, elevation, range rate."""
    dx, dy, dz = kin[0] - sensor[0], kin[1] - sensor[1], kin[2] - sensor[2]
    ground = math.hypot(dx, dy)
    distance = math.hypot(ground, dz)
    out[0] = distance
    out[1] = math.atan2(dy, dx)
    out[2] = math.atan2(dz, ground)
    out[3] = 0.0
    if distance > 0.0:
        out[3] = (dx * (kin[3] - sensor[3]) + dy * (kin[4] - sensor[4]) + dz * (kin[5] - sensor[5])) / distance
