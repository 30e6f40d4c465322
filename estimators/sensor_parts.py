"""What the factories of sensors share: units, checked options, and ways to put a sensor together."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from jink.estimators.compiled import OBSERVE, Callback
from jink.estimators.locating import locate_ray
from jink.estimators.sensor import Location, Sensor

UNITS = {"range": "m", "bearing": "rad", "elevation": "rad", "range rate": "m/s"}


def from_components(
    name: str,
    labels: tuple[str, ...],
    axes: int,
    see: Callable[..., None],
    sigma: float | Sequence[float],
    locate: Callable[..., Location | None] | None,
    params: tuple[float, ...] = (),
) -> Sensor:
    """A sensor whose labels say its units; angular components are those in radians."""
    units = tuple(UNITS[label] for label in labels)
    angular = tuple(unit == "rad" for unit in units)
    sigmas = check_sigmas(name.replace("-", "_"), sigma, labels, units)
    callback = Callback(see, OBSERVE)
    return Sensor(name, labels, units, axes, callback, sigmas, params, angular=angular, locate=locate)


def from_angles(
    name: str,
    labels: tuple[str, ...],
    axes: int,
    see: Callable[..., None],
    sigma: float | Sequence[float],
    range_prior: Sequence[float] | None,
) -> Sensor:
    """A sensor of angles alone; a prior of the distance, if given, lets one measurement locate."""
    if range_prior is None:
        return from_components(name, labels, axes, see, sigma, None)
    values = np.asarray(range_prior, dtype=np.float64)
    if values.shape != (2,) or not np.isfinite(values).all() or (values <= 0).any():
        raise ValueError(
            f"{name.replace('-', '_')}: range_prior must be (mean, sd), both > 0 and finite; "
            f"got {range_prior!r}. Give metres, for instance (5000, 2000)."
        )
    return from_components(name, labels, axes, see, sigma, locate_ray, (float(values[0]), float(values[1])))


def check_axes(caller: str, axes: int, allowed: tuple[int, ...]) -> None:
    """Refuse a number of space dimensions that the sensor does not have."""
    if axes not in allowed:
        raise ValueError(
            f"{caller}: axes must be one of {', '.join(map(str, allowed))}; got {axes!r}. "
            "Use the target's space dimensions."
        )


def check_sigmas(
    caller: str, sigma: float | Sequence[float], labels: tuple[str, ...], units: tuple[str, ...]
) -> tuple[float, ...]:
    """One positive, finite standard deviation per component."""
    kinds = len(set(units))
    wanted = ", ".join(f"{label} in {unit}" for label, unit in zip(labels, units, strict=True))
    try:
        values = np.asarray(sigma, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty((0,))
    if values.ndim == 0 and kinds == 1:
        values = np.full(len(labels), float(values))
    if values.shape != (len(labels),) or not np.isfinite(values).all() or (values <= 0).any():
        either = "one value > 0 or " if kinds == 1 and len(labels) > 1 else ""
        raise ValueError(
            f"{caller}: sigma must be {either}{len(labels)} finite value(s) > 0; got {sigma!r}. "
            f"Give standard deviations: {wanted}."
        )
    return tuple(float(value) for value in values)
