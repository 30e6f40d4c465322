"""Motions and a sensor that only published scenarios need, each a few lines over the library's own parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jink.estimators.compiled import NOISE, OBSERVE, TRANSITION, Callback
from jink.estimators.motion import Motion
from jink.estimators.sensor import Sensor

__all__ = ["fixed_step", "pushed", "weighted_sum", "with_diagonal_noise"]

Floats = NDArray[np.float64]


def _push(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = x[0] + dt * (x[1] + 0.5 * dt * params[0])
    out[1] = x[1] + dt * params[0]


def _held_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    variance = params[1] * params[1] * dt * dt
    out[0, 0] = variance * dt * dt / 4.0
    out[0, 1] = out[1, 0] = variance * dt / 2.0
    out[1, 1] = variance


def pushed(name: str, acceleration: float, held_acceleration: float) -> Motion:
    """A line with a known acceleration (m/s^2) plus a random one held over each step (its sd, m/s^2)."""
    return Motion(
        name,
        ("x", "vx"),
        1,
        Callback(_push, TRANSITION),
        (acceleration, held_acceleration),
        noise=Callback(_held_noise, NOISE),
    )


def _diagonal_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    for i in range(x.size):
        out[i, i] = params[i]


_DIAGONAL_NOISE = Callback(_diagonal_noise, NOISE)


def with_diagonal_noise(motion: Motion, variances: Sequence[float]) -> Motion:
    """The motion with the same diagonal process noise at every step, whatever its length.

    The variances come first in `params`; the last one stays last, where turns keep their slowest speed.
    """
    return motion.with_(noise=_DIAGONAL_NOISE, params=(*variances, *motion.params[-1:]))


def _matrix_step(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = params[0] * x[0] + params[1] * x[1]
    out[1] = params[2] * x[0] + params[3] * x[1]


def _rank_one_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    for i in range(2):
        for k in range(2):
            out[i, k] = params[4 + i] * params[4 + k]


_MATRIX_STEP, _RANK_ONE_NOISE = Callback(_matrix_step, TRANSITION), Callback(_rank_one_noise, NOISE)


def fixed_step(name: str, transition: Floats, gain: Floats) -> Motion:
    """Two components on a line that take the same linear step whatever its length.

    Model: ``x[k+1] = F x[k] + g w``, ``w ~ N(0, 1)``.

    Args:
        name: shown in tables.
        transition: F, (2, 2); the components are called `x` and `vx`.
        gain: g, (2,).
    Returns:
        the motion.
    """
    params = (*transition.ravel().tolist(), *gain.tolist())
    return Motion(name, ("x", "vx"), 1, _MATRIX_STEP, params, noise=_RANK_ONE_NOISE, linear=True)


def _see_sum(kin: np.ndarray, sensor: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = params[0] * kin[0] + params[1] * kin[1]


_SEE_SUM = Callback(_see_sum, OBSERVE)


def weighted_sum(row: Floats) -> Sensor:
    """One number: `row` (2,) times position and velocity on a line, with unit noise."""
    return Sensor("weighted-sum", ("z",), ("-",), 1, _SEE_SUM, (1.0,), params=tuple(row.tolist()), linear=True)
