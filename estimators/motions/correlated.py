"""Motions whose last derivative forgets itself: Singer (acceleration) and correlated jerk.

Each axis is a chain of integrators fed by a first-order Markov process. The process noise is the exact
integral of the flow in forms that hold for any step, so cutting a step in two changes nothing.
"""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import NOISE, TRANSITION, Callback, kernel
from jink.estimators.motion import Motion
from jink.estimators.motions.blocks import add_pair, fill_three
from jink.estimators.motions.cartesian import ACCELERATION_FROM_JET
from jink.estimators.motions.options import check_axes, check_option, labels_of, units_of
from jink.estimators.motions.series import decay

__all__ = ["jerk", "singer"]


def _singer_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    g0, g1, g2, _, _, _, _, _ = decay(params[0] * dt)
    for i in range(0, x.size, 3):
        v = x[i + 1]
        a = x[i + 2]
        out[i] = x[i] + dt * (v + dt * g2 * a)
        out[i + 1] = v + dt * g1 * a
        out[i + 2] = g0 * a


@kernel
def decayed_noise(x: float) -> tuple[float, float, float, float, float, float]:
    """``int_0^1`` of the products of ``(r^2 g_2, r g_1, g_0)(x r)``: pp, pv, pa, vv, va, aa."""
    _, g1, g2, g3, g4, _, _, _ = decay(x)
    d0, d1, _, d3, _, d5, _, _ = decay(2.0 * x)
    if x < 2.0:
        pp = 16.0 * d5 - 2.0 * g4
        pa = 4.0 * d3 - g2
        vv = 4.0 * d3 - 2.0 * g3
    else:
        e = math.exp(-x)
        pp = (((x / 3.0 - 1.0) * x + 1.0 - 2.0 * e) * x + 0.5 * (1.0 - d0)) / x**5
        pa = (0.5 * (1.0 - d0) - x * e) / x**3
        vv = (x - 2.0 * (1.0 - e) + 0.5 * (1.0 - d0)) / x**3
    return pp, 0.5 * g2 * g2, pa, vv, 0.5 * g1 * g1, d1


def _singer_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    pp, pv, pa, vv, va, aa = decayed_noise(params[0] * dt)
    q = params[1] * dt
    square = dt * dt
    for i in range(0, x.size, 3):
        fill_three(
            out,
            i,
            q * square * square * pp,
            q * square * dt * pv,
            q * square * pa,
            q * square * vv,
            q * dt * va,
            q * aa,
        )


_SINGER = Callback(_singer_transition, TRANSITION)
_SINGER_NOISE = Callback(_singer_noise, NOISE)


def singer(
    axes: int = 2,
    *,
    time_constant: float = 20.0,
    acceleration_sd: float = 2.0,
    jerk_density: float | None = None,
) -> Motion:
    """Exponentially correlated acceleration (Singer): it forgets itself after ``time_constant``.

    Model: ``p' = v, v' = a, a' = -a/tau + w`` per axis, ``q = 2 sigma_m^2 / tau``. ``tau = inf`` with a
    ``jerk_density`` is constant acceleration. Evasive aircraft: tau 10-20 s; lazy turns 60 s; turbulence 1 s.

    Args:
        axes: 1, 2 or 3.
        time_constant: tau; s; may be inf.
        acceleration_sd: sigma_m, steady standard deviation of each acceleration and its birth prior; m/s^2.
        jerk_density: q, if it is to be given directly; m^2/s^5.
    Returns:
        Motion with state ``x vx ax y vy ay ...``.
    Raises:
        ValueError: an option is out of range.
    Source: Singer (1970). Differs: process noise in forms that hold for any dt / tau.
    """
    caller = "singer"
    axes = check_axes(caller, axes)
    rate = _decay_rate(caller, time_constant)
    spread = check_option(caller, "acceleration_sd", acceleration_sd)
    density = 2.0 * rate * spread**2 if jerk_density is None else check_option(caller, "jerk_density", jerk_density)
    labels = labels_of(axes, " v a")
    return Motion(
        caller,
        labels,
        axes,
        _SINGER,
        (rate, density),
        units_of(labels),
        noise=_SINGER_NOISE,
        own_from_jet=ACCELERATION_FROM_JET,
        jet_order=2,
        birth_sd=(spread,) * axes,
        linear=True,
    )


def _decay_rate(caller: str, time_constant: float) -> float:
    if time_constant == math.inf:
        return 0.0
    return 1.0 / check_option(caller, "time_constant", time_constant, "> 0")


def _jerk_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    g0, g1, g2, g3, _, _, _, _ = decay(params[0] * dt)
    for i in range(0, x.size, 4):
        v = x[i + 1]
        a = x[i + 2]
        j = x[i + 3]
        out[i] = x[i] + dt * (v + dt * (0.5 * a + dt * g3 * j))
        out[i + 1] = v + dt * (a + dt * g2 * j)
        out[i + 2] = a + dt * g1 * j
        out[i + 3] = g0 * j


def _jerk_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    r = params[0] * dt
    vv, va, vj, aa, aj, jj = decayed_noise(r)
    e, g1, g2, g3, _, g5, _, g7 = decay(r)
    d0, _, _, _, _, _, _, d7 = decay(2.0 * r)
    if r < 2.0:
        pp = 64.0 * d7 - 2.0 * g7 - g5
        pj = g3 * g1 - 0.5 * g2 * g2
    else:
        pp = ((((r / 20.0 - 0.25) * r + 2.0 / 3.0) * r - 1.0 + e) * r + 1.0) * r
        pp = (pp - 2.0 * (1.0 - e) + 0.5 * (1.0 - d0)) / r**7
        pj = (0.5 * (1.0 + d0) - e * (1.0 + 0.5 * r * r)) / r**4
    pv = 0.5 * g3 * g3
    pa = g3 * g2 - vv
    q = params[1] * dt
    for i in range(0, x.size, 4):
        fill_three(
            out,
            i,
            q * dt**6 * pp,
            q * dt**5 * pv,
            q * dt**4 * pa,
            q * dt**4 * vv,
            q * dt**3 * va,
            q * dt**2 * aa,
        )
        add_pair(out, i, i + 3, q * dt**3 * pj)
        add_pair(out, i + 1, i + 3, q * dt**2 * vj)
        add_pair(out, i + 2, i + 3, q * dt * aj)
        out[i + 3, i + 3] = q * jj


_JERK = Callback(_jerk_transition, TRANSITION)
_JERK_NOISE = Callback(_jerk_noise, NOISE)


def jerk(
    axes: int = 2,
    *,
    time_constant: float = 5.0,
    jerk_sd: float = 1.0,
    acceleration_sd: float = 2.0,
    snap_density: float | None = None,
) -> Motion:
    """Exponentially correlated jerk, for targets whose acceleration itself ramps.

    Model: ``p' = v, v' = a, a' = j, j' = -j/tau + w`` per axis, ``q = 2 sigma_j^2 / tau``.

    Args:
        axes: 1, 2 or 3.
        time_constant: tau; s; may be inf (then give ``snap_density``).
        jerk_sd: sigma_j, steady standard deviation of each jerk and its birth prior; m/s^3.
        acceleration_sd: prior standard deviation of each acceleration when the intent begins; m/s^2.
        snap_density: q, if it is to be given directly; m^2/s^7.
    Returns:
        Motion with state ``x vx ax jx y vy ay jy ...``.
    Raises:
        ValueError: an option is out of range.
    Source: Mehrotra, Mahapatra (1997). Differs: process noise in forms that hold for any dt / tau.
    """
    caller = "jerk"
    axes = check_axes(caller, axes)
    rate = _decay_rate(caller, time_constant)
    spread = check_option(caller, "jerk_sd", jerk_sd)
    start = check_option(caller, "acceleration_sd", acceleration_sd)
    density = 2.0 * rate * spread**2 if snap_density is None else check_option(caller, "snap_density", snap_density)
    labels = labels_of(axes, " v a j")
    return Motion(
        caller,
        labels,
        axes,
        _JERK,
        (rate, density),
        units_of(labels),
        noise=_JERK_NOISE,
        own_from_jet=ACCELERATION_FROM_JET,
        jet_order=2,
        birth_sd=(start, spread) * axes,
        linear=True,
    )
