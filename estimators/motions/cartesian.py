"""Straight motions: constant velocity and constant acceleration.

Each axis is a chain of integrators fed by white noise. The process noise is the exact integral of the flow,
so cutting a step in two changes nothing.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import NOISE, OWN, TRANSITION, Callback
from jink.estimators.motion import Motion
from jink.estimators.motions.blocks import fill_three
from jink.estimators.motions.options import check_axes, check_option, labels_of, units_of

__all__ = ["ACCELERATION_FROM_JET", "constant_acceleration", "constant_velocity"]


def _velocity_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    for i in range(0, x.size, 2):
        out[i] = x[i] + dt * x[i + 1]
        out[i + 1] = x[i + 1]


def _velocity_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    density = params[0]
    held = params[1] * params[1] * dt * dt
    pp = density * dt * dt * dt / 3.0 + held * dt * dt / 4.0
    pv = density * dt * dt / 2.0 + held * dt / 2.0
    vv = density * dt + held
    for i in range(0, x.size, 2):
        out[i, i] = pp
        out[i, i + 1] = pv
        out[i + 1, i] = pv
        out[i + 1, i + 1] = vv


_VELOCITY = Callback(_velocity_transition, TRANSITION)
_VELOCITY_NOISE = Callback(_velocity_noise, NOISE)


def constant_velocity(axes: int = 2, *, acceleration_density: float = 1.0, held_acceleration: float = 0.0) -> Motion:
    """Straight flight at constant speed, disturbed by white acceleration.

    Model: ``p' = v, v' = w`` per axis; ``Q = q [dt^3/3, dt^2/2; dt^2/2, dt]``, plus ``G G' sigma_a^2`` with
    ``G = (dt^2/2, dt)`` for an acceleration that is held over each step (then, and only then, the length of
    the steps matters).

    Args:
        axes: 1, 2 or 3.
        acceleration_density: q; m^2/s^3.
        held_acceleration: sigma_a, the "discrete white noise acceleration" of the textbooks; m/s^2.
    Returns:
        Motion with state ``x vx y vy ...``.
    Raises:
        ValueError: an option is out of range.
    Source: Bar-Shalom, Li, Kirubarajan (2001) 6.2.2, 6.3.2. Differs: none.
    """
    caller = "constant_velocity"
    axes = check_axes(caller, axes)
    params = (
        check_option(caller, "acceleration_density", acceleration_density),
        check_option(caller, "held_acceleration", held_acceleration),
    )
    labels = labels_of(axes, " v")
    return Motion(
        caller,
        labels,
        axes,
        _VELOCITY,
        params,
        units_of(labels),
        noise=_VELOCITY_NOISE,
        jet_order=1,
        linear=True,
    )


def _acceleration_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    for i in range(0, x.size, 3):
        a = x[i + 2]
        out[i] = x[i] + dt * (x[i + 1] + 0.5 * dt * a)
        out[i + 1] = x[i + 1] + dt * a
        out[i + 2] = a


def _acceleration_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    q = params[0] * dt
    for i in range(0, x.size, 3):
        fill_three(out, i, q * dt**4 / 20.0, q * dt**3 / 8.0, q * dt * dt / 6.0, q * dt * dt / 3.0, q * dt / 2.0, q)


def _acceleration_from_jet(jet: np.ndarray, params: np.ndarray, own: np.ndarray) -> None:
    axes = jet.size // 3
    stride = own.size // axes
    for axis in range(axes):
        own[axis * stride] = jet[2 * axes + axis]


_ACCELERATION = Callback(_acceleration_transition, TRANSITION)
_ACCELERATION_NOISE = Callback(_acceleration_noise, NOISE)
ACCELERATION_FROM_JET = Callback(_acceleration_from_jet, OWN)
"""Own parameters ``ax, ..., ay, ...``: the accelerations come from the jet, what lies between is kept."""


def constant_acceleration(axes: int = 2, *, jerk_density: float = 1.0, acceleration_sd: float = 2.0) -> Motion:
    """Constant acceleration, disturbed by white jerk (Wiener-process acceleration).

    Model: ``p' = v, v' = a, a' = w`` per axis.

    Args:
        axes: 1, 2 or 3.
        jerk_density: q; m^2/s^5.
        acceleration_sd: prior standard deviation of each acceleration when the intent begins; m/s^2.
    Returns:
        Motion with state ``x vx ax y vy ay ...``.
    Raises:
        ValueError: an option is out of range.
    Source: Bar-Shalom, Li, Kirubarajan (2001) 6.2.3. Differs: none.
    """
    caller = "constant_acceleration"
    axes = check_axes(caller, axes)
    density = check_option(caller, "jerk_density", jerk_density)
    spread = check_option(caller, "acceleration_sd", acceleration_sd)
    labels = labels_of(axes, " v a")
    return Motion(
        caller,
        labels,
        axes,
        _ACCELERATION,
        (density,),
        units_of(labels),
        noise=_ACCELERATION_NOISE,
        own_from_jet=ACCELERATION_FROM_JET,
        jet_order=2,
        birth_sd=(spread,) * axes,
        linear=True,
    )
