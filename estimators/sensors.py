"""Sensor library: what each sensor measures and its default noise.

Geometry is always target minus sensor. Bearing is counter-clockwise from +x, elevation is up from the
horizontal plane, range rate is positive when the target recedes and counts the sensor's own velocity.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jink.estimators import sensing
from jink.estimators.compiled import OBSERVE, Callback
from jink.estimators.locating import locate_polar, locate_position
from jink.estimators.multilateration import locate_ranges
from jink.estimators.sensor import Sensor
from jink.estimators.sensor_parts import check_axes, check_sigmas, from_angles, from_components

__all__ = [
    "SENSORS",
    "bearing",
    "bearing_elevation",
    "make_sensor",
    "position",
    "range_bearing",
    "range_bearing_elevation",
    "range_bearing_elevation_rate",
    "range_bearing_rate",
    "range_only",
    "range_range_rate",
    "range_rate",
    "ranges",
]

AXES = "xyz"


def position(axes: int = 2, sigma: float | Sequence[float] = 1.0) -> Sensor:
    """Cartesian position in the common frame; the sensor's own place plays no part.

    Args:
        axes: space dimensions A (1, 2 or 3).
        sigma: standard deviation, one for all axes or (A,); m.

    Raises:
        ValueError: ``axes`` or ``sigma`` out of range.
    """
    check_axes("position", axes, (1, 2, 3))
    labels, units = tuple(AXES[:axes]), ("m",) * axes
    return Sensor(
        "position",
        labels,
        units,
        axes,
        Callback(sensing.see_position, OBSERVE),
        check_sigmas("position", sigma, labels, units),
        linear=True,
        locate=locate_position,
    )


def range_bearing(sigma: Sequence[float] = (1.0, 0.01)) -> Sensor:
    """Range and bearing in the plane, from the sensor's place.

    Args:
        sigma: standard deviations of range and bearing; (2,); m, rad.

    Raises:
        ValueError: ``sigma`` out of range.
    """
    return from_components("range-bearing", ("range", "bearing"), 2, sensing.see_range_bearing, sigma, locate_polar)


def range_bearing_elevation(sigma: Sequence[float] = (1.0, 0.01, 0.01)) -> Sensor:
    """Slant range, bearing and elevation in space, from the sensor's place.

    Args:
        sigma: standard deviations of range, bearing, elevation; (3,); m, rad, rad.

    Raises:
        ValueError: ``sigma`` out of range.
    """
    labels = ("range", "bearing", "elevation")
    return from_components(
        "range-bearing-elevation", labels, 3, sensing.see_range_bearing_elevation, sigma, locate_polar
    )


def range_bearing_rate(sigma: Sequence[float] = (1.0, 0.01, 0.1)) -> Sensor:
    """Range, bearing and range rate in the plane (Doppler radar), from the sensor's place and velocity.

    Args:
        sigma: standard deviations of range, bearing, range rate; (3,); m, rad, m/s.

    Raises:
        ValueError: ``sigma`` out of range.
    """
    labels = ("range", "bearing", "range rate")
    return from_components("range-bearing-rate", labels, 2, sensing.see_range_bearing_rate, sigma, locate_polar)


def range_bearing_elevation_rate(sigma: Sequence[float] = (1.0, 0.01, 0.01, 0.1)) -> Sensor:
    """Slant range, bearing, elevation and range rate in space, from the sensor's place and velocity.

    Args:
        sigma: standard deviations of range, bearing, elevation, range rate; (4,); m, rad, rad, m/s.

    Raises:
        ValueError: ``sigma`` out of range.
    """
    labels = ("range", "bearing", "elevation", "range rate")
    see = sensing.see_range_bearing_elevation_rate
    return from_components("range-bearing-elevation-rate", labels, 3, see, sigma, locate_polar)


def bearing(sigma: float | Sequence[float] = 0.01, range_prior: Sequence[float] | None = None) -> Sensor:
    """Bearing in the plane, from the sensor's place.

    Args:
        sigma: standard deviation; rad.
        range_prior: mean and standard deviation of a target's distance when first seen; (2,); m. With it one
            bearing starts a track along its ray; None: a track starts once a moving sensor has triangulated.

    Raises:
        ValueError: ``sigma`` or ``range_prior`` out of range.
    """
    return from_angles("bearing", ("bearing",), 2, sensing.see_bearing, sigma, range_prior)


def bearing_elevation(sigma: float | Sequence[float] = 0.01, range_prior: Sequence[float] | None = None) -> Sensor:
    """Bearing and elevation in space (camera, infrared), from the sensor's place.

    Args:
        sigma: standard deviation, one for both or (2,); rad.
        range_prior: as for `bearing`.

    Raises:
        ValueError: ``sigma`` or ``range_prior`` out of range.
    """
    return from_angles(
        "bearing-elevation", ("bearing", "elevation"), 3, sensing.see_bearing_elevation, sigma, range_prior
    )


def ranges(anchors: ArrayLike, sigma: float | Sequence[float] = 0.1) -> Sensor:
    """Distances to fixed anchors, all in one measurement; a component may be missing (NaN).

    Args:
        anchors: places; (D, A); m.
        sigma: standard deviation, one for all anchors or (D,); m.

    Raises:
        ValueError: ``anchors`` is not a finite (D, 2) or (D, 3) array, or ``sigma`` out of range.
    """
    places = np.asarray(anchors, dtype=np.float64)
    fits = places.ndim == 2 and places.shape[0] > 0 and places.shape[1] in (2, 3)
    if not fits or not np.isfinite(places).all():
        raise ValueError(
            f"ranges: anchors must be finite with shape (D, 2) or (D, 3); got shape {places.shape}. "
            "Give one place in metres per anchor."
        )
    labels = tuple(f"range {index}" for index in range(len(places)))
    units = ("m",) * len(places)
    sigmas = check_sigmas("ranges", sigma, labels, units)
    params = tuple(float(value) for value in places.ravel())
    callback = Callback(sensing.see_ranges, OBSERVE)
    return Sensor("ranges", labels, units, places.shape[1], callback, sigmas, params, locate=locate_ranges)


def range_only(axes: int = 2, sigma: float | Sequence[float] = 0.1) -> Sensor:
    """Distance to the place given with each measurement (its ``sensor_states`` row): one anchor at a time.

    Args:
        axes: space dimensions A (2 or 3).
        sigma: standard deviation; m.

    Raises:
        ValueError: ``axes`` or ``sigma`` out of range.
    """
    check_axes("range_only", axes, (2, 3))
    sigmas = check_sigmas("range_only", sigma, ("range",), ("m",))
    return Sensor("range", ("range",), ("m",), axes, Callback(sensing.see_range, OBSERVE), sigmas)


def range_rate(axes: int = 2, sigma: float | Sequence[float] = 0.1) -> Sensor:
    """Range rate alone (Doppler): velocity relative to the sensor along the line of sight, positive receding.

    Args:
        axes: space dimensions A (2 or 3).
        sigma: standard deviation; m/s.

    Raises:
        ValueError: ``axes`` or ``sigma`` out of range.
    """
    check_axes("range_rate", axes, (2, 3))
    sigmas = check_sigmas("range_rate", sigma, ("range rate",), ("m/s",))
    return Sensor("range-rate", ("range rate",), ("m/s",), axes, Callback(sensing.see_range_rate, OBSERVE), sigmas)


def range_range_rate(axes: int = 2, sigma: Sequence[float] = (0.1, 0.1)) -> Sensor:
    """Range and range rate without an angle, from the place and velocity given with each measurement.

    Args:
        axes: space dimensions A (2 or 3).
        sigma: standard deviations of range and range rate; (2,); m, m/s.

    Raises:
        ValueError: ``axes`` or ``sigma`` out of range.
    """
    check_axes("range_range_rate", axes, (2, 3))
    return from_components("range-range-rate", ("range", "range rate"), axes, sensing.see_range_range_rate, sigma, None)


SENSORS: dict[str, Callable[..., Sensor]] = {
    "position": position,
    "range-bearing": range_bearing,
    "range-bearing-elevation": range_bearing_elevation,
    "range-bearing-rate": range_bearing_rate,
    "range-bearing-elevation-rate": range_bearing_elevation_rate,
    "bearing": bearing,
    "bearing-elevation": bearing_elevation,
    "ranges": ranges,
    "range": range_only,
    "range-rate": range_rate,
    "range-range-rate": range_range_rate,
}
"""Factories by registry name."""


def make_sensor(name: str, **options: Any) -> Sensor:
    """A sensor by its registry name.

    Args:
        name: a key of `SENSORS`; underscores may stand for hyphens.
        options: arguments of the factory, for instance ``sigma``.

    Returns:
        The sensor.

    Raises:
        ValueError: unknown name, unknown or missing option, or a value out of range.
    """
    factory = SENSORS.get(str(name).replace("_", "-"))
    if factory is None:
        raise ValueError(f"make_sensor: name must be a known sensor; got {name!r}. Use one of {', '.join(SENSORS)}.")
    signature = inspect.signature(factory)
    try:
        signature.bind(**options)
    except TypeError as error:
        raise ValueError(
            f"make_sensor: options of {name!r} must fit {name}{_plain(signature)}; "
            f"got {sorted(options)} ({error}). Rename, add or remove one."
        ) from None
    return factory(**options)


def _plain(signature: inspect.Signature) -> str:
    parts = (
        parameter.name if parameter.default is parameter.empty else f"{parameter.name}={parameter.default}"
        for parameter in signature.parameters.values()
    )
    return f"({', '.join(parts)})"
