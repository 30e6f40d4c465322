"""What is examined, the tracks it is examined on, and what a check raises."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.api import Estimates
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import make_sensor
from jink.estimators.status import STATUS_NAMES

__all__ = [
    "SENSORS",
    "Broken",
    "Case",
    "NotAsked",
    "Subject",
    "checked_sensor",
    "columns_of",
    "finite_of",
    "make_case",
    "must_be_known",
    "same",
]

Floats = NDArray[np.float64]
SPEED, SIGMA_M = 20.0, 5.0
_FAR = np.array([800.0, 600.0, 300.0])
SENSORS: dict[str, tuple[float, ...]] = {
    "position": (SIGMA_M,),
    "range-bearing": (SIGMA_M, 0.005),
    "range-bearing-elevation": (SIGMA_M, 0.005, 0.005),
    "range-bearing-rate": (SIGMA_M, 0.005, 0.5),
}
"""Sensors that `jink check` can put before an estimator -> standard deviations, m, rad, m/s."""


class Broken(Exception):  # noqa: N818 - an outcome, not an error
    """What was found instead, and how to mend it."""

    def __init__(self, found: str, remedy: str) -> None:
        super().__init__(found)
        self.remedy = remedy


class NotAsked(Exception):  # noqa: N818 - an outcome, not an error
    """Why the check does not apply."""


class Case(NamedTuple):
    """B tracks of T rows: what was measured, when, and where the targets were."""

    measurements: Floats  # (B, T, D)
    times: Floats  # (B, T)
    truth: Floats  # (B, T, A)


class Subject(NamedTuple):
    """An estimator under examination: `make` gives a new one each time, for `sensor`."""

    name: str
    make: Callable[[], Any]
    sensor: Sensor
    case: Case

    def run(self, measurements: Floats | None = None, times: Floats | None = None, **more: Any) -> Estimates:
        """A new estimator's estimates of the case, or of other measurements."""
        z = self.case.measurements if measurements is None else measurements
        estimates: Estimates = self.make().run(z, self.case.times if times is None else times, **more)
        return estimates

    @property
    def streams(self) -> bool:
        """Whether it takes one measurement at a time."""
        made = self.make()
        return bool(getattr(made, "streams", hasattr(made, "step")))


def make_case(sensor: Sensor, seed: int = 0, tracks: int = 3, rows: int = 40, dt: float = 0.5) -> Case:
    """Targets that fly straight, and turn in the last third, seen by a sensor in the origin.

    Args:
        sensor: one of `SENSORS`.
        seed: of places, headings and noise.
        tracks, rows: B, T.
        dt: s between rows.
    """
    rng = np.random.default_rng(seed)
    axes = sensor.axes
    heading = rng.uniform(0.0, 2.0 * np.pi, size=(tracks, 1))
    turning = np.clip(np.arange(rows) - 2 * rows // 3, 0, None) * 0.1 * dt
    angle = heading + turning
    velocity = np.zeros((tracks, rows, axes))
    velocity[..., 0], velocity[..., 1] = SPEED * np.cos(angle), SPEED * np.sin(angle)
    truth = _FAR[:axes] + rng.normal(scale=50.0, size=(tracks, 1, axes)) + np.cumsum(velocity, axis=1) * dt
    z = np.zeros((tracks, rows, sensor.size))
    still = np.zeros(2 * axes)
    for b in range(tracks):
        for t in range(rows):
            sensor.observe.function(np.concatenate([truth[b, t], velocity[b, t]]), still, sensor.params, z[b, t])
    z += rng.normal(size=z.shape) * np.asarray(sensor.sigma)
    return Case(z, np.tile(np.arange(rows) * dt, (tracks, 1)), truth)


def checked_sensor(name: str, axes: int) -> Sensor:
    """The sensor of a name.

    Raises:
        ValueError: not one of `SENSORS`, or other axes than it has.
    """
    if name not in SENSORS:
        raise ValueError(f"--sensor: name must be one of {', '.join(SENSORS)}; got '{name}'. Use position.")
    if name == "position":
        if axes not in (2, 3):
            raise ValueError(f"--axes: value must be 2 or 3; got {axes}. Use 2 for a plane.")
        return make_sensor(name, axes=axes, sigma=SENSORS[name][0])
    return make_sensor(name, sigma=SENSORS[name])


def same(left: Estimates, right: Estimates, rows: Any = ..., tolerance: float = 0.0) -> str:
    """Where two results first differ, "" where they do not; NaN equals NaN.

    Args:
        left, right: the results.
        rows: index into the leading axes.
        tolerance: relative, for what need not agree to the last bit.
    """
    for name, a, b in zip(Estimates._fields, left, right, strict=True):
        x, y = np.asarray(a)[rows], np.asarray(b)[rows]
        if x.shape != y.shape:
            return f"{name} has shape {x.shape} against {y.shape}"
        close = np.isclose(x, y, rtol=tolerance, atol=tolerance, equal_nan=True) if tolerance else _equal(x, y)
        if not close.all():
            at = tuple(int(i) for i in np.argwhere(~close)[0])
            return f"{name}{list(at) if at else ''}: {x[at].item()!r} against {y[at].item()!r}"
    return ""


def _equal(x: Any, y: Any) -> Any:
    return (x == y) | (np.isnan(x) & np.isnan(y))


def columns_of(estimates: Estimates, change: Callable[[Any], Any]) -> Estimates:
    """The same with each column changed."""
    return Estimates(*(change(np.asarray(column)) for column in estimates))


def must_be_known(estimates: Estimates) -> None:
    """Raise `Broken` where a status is none of ours."""
    codes = np.unique(estimates.status)
    if not np.isin(codes, range(len(STATUS_NAMES))).all():
        raise Broken(f"status holds {codes.tolist()}", "Use 0 ok, 1 repaired, 2 missing, 3 diverged, 4 starting.")


def finite_of(estimates: Estimates) -> str:
    """The first number that is NaN or infinite where one must not be; "" without any.

    Velocity and covariance that are not reported at all are NaN throughout, and that is allowed.
    """
    for name, column in zip(Estimates._fields, estimates, strict=True):
        values = np.asarray(column, dtype=np.float64)
        optional = name in ("velocity", "covariance")
        if values.size == 0 or (optional and not np.isfinite(values).any()):
            continue
        if name == "covariance":  # of the position alone: that of the velocity may be left out
            axes = values.shape[-1] // 2
            if not np.isfinite(values[..., axes:, axes:]).any():
                values = values[..., :axes, :axes]
        if not np.isfinite(values).all():
            at = [int(i) for i in np.argwhere(~np.isfinite(values))[0]]
            return f"{name}{at} is {values[tuple(at)]}"
    return ""
