"""The law of learned intents: speed that grows and a course that turns, both at rates that remember their mean.

One family holds straight flight, acceleration, circles, spirals and weaves. The shape parameters (growth rate and
turn rate) move linearly whatever the target does, so their own flow, its integrals over a step and the covariance
of what disturbs them depend on the step's length only; velocity and position follow from the integrals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jink.estimators.compiled import NOISE, OWN, TRANSITION, Callback, kernel
from jink.estimators.motion import Motion
from jink.estimators.motions.blocks import add_pair
from jink.estimators.motions.correlated import decayed_noise
from jink.estimators.motions.options import check_axes, check_option, labels_of
from jink.estimators.motions.series import decay

__all__ = ["LARGEST_GROWTH", "bilinear", "impulse_response", "swing_noise"]

LARGEST_GROWTH = 20.0
"""Speed grows by at most exp(this) in one step: a rate extrapolated over a long gap must stay a number."""
_NODES = (
    0.019855071751231884,
    0.10166676129318664,
    0.2372337950418355,
    0.4082826787521751,
    0.5917173212478249,
    0.7627662049581645,
    0.8983332387068134,
    0.9801449282487681,
)
_WEIGHTS = (
    0.05061426814518813,
    0.11119051722668724,
    0.15685332293894363,
    0.181341891689181,
    0.181341891689181,
    0.15685332293894363,
    0.11119051722668724,
    0.05061426814518813,
)


@kernel
def impulse_response(x: float, damping: float) -> tuple[float, float, float, float]:
    """``h', h, int h, int int h`` of a damped swing after a unit kick, in units of its natural rate.

    Model: ``h'' = -h - 2 z h'`` with ``h(0) = 0, h'(0) = 1`` at ``x = W t``, divided by ``1, x, x^2, x^3``: entire
    functions that are ``1, 1, 1/2, 1/6`` at zero.
    """
    if x < 1.0:
        before = 0.0
        term = 1.0  # (-x)^j U_j(z) / (j + 1)!, U_j the Chebyshev polynomials of the second kind
        h = 0.0
        first = 0.0
        second = 0.0
        for j in range(20):
            h += term
            first += term / (j + 2)
            second += term / ((j + 2) * (j + 3))
            following = -x / (j + 2) * (2.0 * damping * term + x / (j + 1) * before)
            before = term
            term = following
        return 1.0 - x * (2.0 * damping * h + x * first), h, first, second
    share = math.sqrt(1.0 - damping * damping)
    fade = math.exp(-damping * x)
    sine = fade * math.sin(share * x) / share
    slope = fade * math.cos(share * x) - damping * sine
    h = sine / x
    first = (1.0 - slope - 2.0 * damping * sine) / (x * x)
    second = (1.0 - h - 2.0 * damping * x * first) / (x * x)
    return slope, h, first, second


@kernel
def swing_noise(
    x: float, damping: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """``int_0^1`` of the products of ``(r^3 f_3, r^2 f_2, r f_1, f_0)(x r)``, the parts of `impulse_response`.

    Order: 33, 32, 31, 30, 22, 21, 20, 11, 10, 00. By quadrature for a short step, else in closed form from the
    stationary variances.
    """
    if x < 1.0:
        s33 = s32 = s31 = s30 = s22 = s21 = s20 = s11 = s10 = s00 = 0.0
        for node in range(8):
            r = _NODES[node]
            f0, f1, f2, f3 = impulse_response(x * r, damping)
            f1 *= r
            f2 *= r * r
            f3 *= r * r * r
            weight = _WEIGHTS[node]
            s33 += weight * f3 * f3
            s32 += weight * f3 * f2
            s31 += weight * f3 * f1
            s30 += weight * f3 * f0
            s22 += weight * f2 * f2
            s21 += weight * f2 * f1
            s20 += weight * f2 * f0
            s11 += weight * f1 * f1
            s10 += weight * f1 * f0
            s00 += weight * f0 * f0
        return s33, s32, s31, s30, s22, s21, s20, s11, s10, s00
    f0, f1, f2, f3 = impulse_response(x, damping)
    double = 2.0 * damping
    square = x * x
    # of the swing itself, from stationary variances; with the driving noise n and its integral
    kept = f0 + double * x * f1
    s11 = (1.0 - kept * kept - square * f1 * f1) / (2.0 * double * square * x)
    s10 = 0.5 * f1 * f1
    s00 = (1.0 - f0 * f0 - square * f1 * f1) / (2.0 * double * x)
    n0, n1 = f1, f2
    m0, m1 = f1 - f2, f2 - f3
    s20 = (n0 - s00 - double * x * s10) / square
    s21 = (n1 - s10 - double * x * s11) / square
    n2 = (1.0 - n0 - double * x * n1) / square
    m2 = (0.5 - m0 - double * x * m1) / square
    s22 = (n2 - s20 - double * x * s21) / square
    s30 = (m0 - s10 - double * x * s20) / square
    s31 = (m1 - s11 - double * x * s21) / square
    s32 = (m2 - s21 - double * x * s22) / square
    m3 = (1.0 / 3.0 - m1 - double * x * m2) / square
    s33 = (m3 - s31 - double * x * s32) / square
    return s33, s32, s31, s30, s22, s21, s20, s11, s10, s00


@kernel
def _remember(mean: float, rate: float, dt: float, value: float) -> tuple[float, float]:
    """A value that returns to its mean at ``rate``: integral over ``dt`` and value at its end."""
    _, g1, _, _, _, _, _, _ = decay(rate * dt)
    return mean * dt + dt * g1 * (value - mean), value - rate * dt * g1 * (value - mean)


@kernel
def _swing(
    mean: float, natural: float, damping: float, dt: float, value: float, slope: float
) -> tuple[float, float, float]:
    """A value that swings about its mean: integral over ``dt``, value and slope at its end."""
    x = natural * dt
    f0, f1, f2, f3 = impulse_response(x, damping)
    offset = value - mean
    integral = dt * (value - x * x * f3 * offset + dt * f2 * slope)
    end = value - x * x * f2 * offset + dt * f1 * slope
    return integral, end, f0 * slope - natural * x * f1 * offset


@kernel
def _plane_factors(growth: float, angle: float) -> tuple[float, float, float, float]:
    """Real and imaginary part of ``e^z`` and of ``(e^z - 1)/z``, ``z = growth + i angle``."""
    half = math.sin(0.5 * angle)
    factor = math.exp(growth)
    sine = factor * math.sin(angle)
    x = math.expm1(growth) * math.cos(angle) - 2.0 * half * half
    size = growth * growth + angle * angle
    if size < 1e-30:
        return 1.0 + growth, angle, 1.0 + 0.5 * growth, 0.5 * angle
    return x + 1.0, sine, (x * growth + sine * angle) / size, (sine * growth - x * angle) / size


@kernel
def _space_factors(growth: float, angle: float) -> tuple[float, float, float, float, float, float]:
    """Coefficients of ``v``, ``a x v``, ``a x (a x v)`` in the turned and grown velocity, and in its mean.

    ``growth`` and ``angle`` are integrals over the step, ``a`` the vector of length ``angle``.
    """
    factor = math.exp(growth)
    square = angle * angle
    size = growth * growth + square
    half = math.sin(0.5 * angle)
    if angle < 1e-8:
        sinc = 1.0
        c2 = 0.5
    else:
        sinc = math.sin(angle) / angle
        c2 = 2.0 * (half / angle) * (half / angle)
    if size < 0.25:
        # sum over k of the real polynomials z^k = R + i angle S, growth^k - R = angle^2 T
        power, real, imaginary, defect = 1.0, 1.0, 0.0, 0.0
        along, across, twice = 1.0, 0.0, 0.0
        scale = 1.0
        for k in range(1, 17):
            defect = growth * defect + imaginary
            real, imaginary = growth * real - square * imaginary, growth * imaginary + real
            power *= growth
            scale /= k + 1
            along += scale * power
            across += scale * imaginary
            twice += scale * defect
        return factor, factor * sinc, factor * c2, along, across, twice
    along = math.expm1(growth) / growth if growth != 0.0 else 1.0
    across = (growth * factor * sinc - math.expm1(growth) + factor * square * c2) / size
    twice = (along + growth * factor * c2 - factor * sinc) / size
    return factor, factor * sinc, factor * c2, along, across, twice


@kernel
def _end_and_mean(growth: float, ax: float, ay: float, az: float, x: np.ndarray) -> tuple[
    float, float, float, float, float, float
]:  # fmt: skip
    """Velocity at the end of a step in space, and its mean over the step."""
    e0, e1, e2, m0, m1, m2 = _space_factors(growth, math.sqrt(ax * ax + ay * ay + az * az))
    vx = x[1]
    vy = x[3]
    vz = x[5]
    tx = ay * vz - az * vy
    ty = az * vx - ax * vz
    tz = ax * vy - ay * vx
    nx = ay * tz - az * ty
    ny = az * tx - ax * tz
    nz = ax * ty - ay * tx
    return (
        e0 * vx + e1 * tx + e2 * nx,
        e0 * vy + e1 * ty + e2 * ny,
        e0 * vz + e1 * tz + e2 * nz,
        m0 * vx + m1 * tx + m2 * nx,
        m0 * vy + m1 * ty + m2 * ny,
        m0 * vz + m1 * tz + m2 * nz,
    )


@kernel
def _turn(params: np.ndarray, second: bool, mean: float, dt: float, w: float, u: float) -> tuple[float, float, float]:
    """One turn component: integral, value and slope after ``dt``; a slope that drives nothing forgets itself."""
    if params[7] > 0.0:
        return _swing(mean, params[7], params[8], dt, w, u)
    integral, end = _remember(mean, params[4], dt, w)
    return integral, end, u * math.exp(-dt) if second else 0.0


def _plane_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    second = x.size > 6
    growth, g = _remember(params[0], params[1], dt, x[4])
    angle, w, u = _turn(params, second, params[3], dt, x[5], x[6] if second else 0.0)
    er, ei, mr, mi = _plane_factors(min(growth, LARGEST_GROWTH), angle)
    vx = x[1]
    vy = x[3]
    out[0] = x[0] + dt * (mr * vx - mi * vy)
    out[1] = er * vx - ei * vy
    out[2] = x[2] + dt * (mi * vx + mr * vy)
    out[3] = ei * vx + er * vy
    out[4] = g
    out[5] = w
    if second:
        out[6] = u


def _space_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    second = x.size > 10
    growth, g = _remember(params[0], params[1], dt, x[6])
    ax, wx, ux = _turn(params, second, 0.0, dt, x[7], x[10] if second else 0.0)
    ay, wy, uy = _turn(params, second, 0.0, dt, x[8], x[11] if second else 0.0)
    az, wz, uz = _turn(params, second, 0.0, dt, x[9], x[12] if second else 0.0)
    ex, ey, ez, mx, my, mz = _end_and_mean(min(growth, LARGEST_GROWTH), ax, ay, az, x)
    out[0] = x[0] + dt * mx
    out[1] = ex
    out[2] = x[2] + dt * my
    out[3] = ey
    out[4] = x[4] + dt * mz
    out[5] = ez
    out[6] = g
    out[7] = wx
    out[8] = wy
    out[9] = wz
    if second:
        out[10] = ux
        out[11] = uy
        out[12] = uz


@kernel
def _shape_noise(
    density: float, rate: float, natural: float, damping: float, dt: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Covariance of (double integral, integral, value, slope) of one shape parameter over ``dt``, upper rows."""
    q = density * dt
    square = dt * dt
    if natural > 0.0:
        s33, s32, s31, s30, s22, s21, s20, s11, s10, s00 = swing_noise(natural * dt, damping)
        return (
            q * square * square * square * s33,
            q * square * square * dt * s32,
            q * square * square * s31,
            q * square * dt * s30,
            q * square * square * s22,
            q * square * dt * s21,
            q * square * s20,
            q * square * s11,
            q * dt * s10,
            q * s00,
        )
    pp, pv, pa, vv, va, aa = decayed_noise(rate * dt)
    return (
        q * square * square * pp,
        q * square * dt * pv,
        q * square * pa,
        0.0,
        q * square * vv,
        q * dt * va,
        0.0,
        q * aa,
        0.0,
        0.0,
    )


@kernel
def _add_wobble(density: float, dt: float, axes: int, out: np.ndarray) -> None:
    for i in range(0, 2 * axes, 2):
        out[i, i] += density * dt * dt * dt / 3.0
        add_pair(out, i, i + 1, 0.5 * density * dt * dt)
        out[i + 1, i + 1] += density * dt


@kernel
def _add_growth(params: np.ndarray, dt: float, axes: int, m: tuple[float, float, float], e: tuple[float, float, float],
                out: np.ndarray) -> None:  # fmt: skip
    """Noise of the growth rate: along the mean velocity ``m`` for position, the last one ``e`` for velocity."""
    pp, pv, pa, _, vv, va, _, aa, _, _ = _shape_noise(params[2], params[1], 0.0, 0.0, dt)
    own = 2 * axes
    for i in range(axes):
        p = 2 * i
        for j in range(axes):
            q = 2 * j
            out[p, q] += pp * (m[i] * m[j])
            out[p, q + 1] += pv * (m[i] * e[j])
            out[q + 1, p] += pv * (m[i] * e[j])
            out[p + 1, q + 1] += vv * (e[i] * e[j])
        add_pair(out, p, own, pa * m[i])
        add_pair(out, p + 1, own, va * e[i])
    out[own, own] += aa


def _plane_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    second = x.size > 6
    growth, _ = _remember(params[0], params[1], dt, x[4])
    angle, _, _ = _turn(params, second, params[3], dt, x[5], x[6] if second else 0.0)
    er, ei, mr, mi = _plane_factors(min(growth, LARGEST_GROWTH), angle)
    mx = mr * x[1] - mi * x[3]
    my = mi * x[1] + mr * x[3]
    ex = er * x[1] - ei * x[3]
    ey = ei * x[1] + er * x[3]
    _add_wobble(params[6], dt, 2, out)
    _add_growth(params, dt, 2, (mx, my, 0.0), (ex, ey, 0.0), out)
    pp, pv, pa, pu, vv, va, vu, aa, au, uu = _shape_noise(params[5], params[4], params[7], params[8], dt)
    # a quarter turn to the left of both velocities
    left = (-my, mx)
    last = (-ey, ex)
    for i in range(2):
        p = 2 * i
        for j in range(2):
            q = 2 * j
            out[p, q] += pp * (left[i] * left[j])
            out[p, q + 1] += pv * (left[i] * last[j])
            out[q + 1, p] += pv * (left[i] * last[j])
            out[p + 1, q + 1] += vv * (last[i] * last[j])
        add_pair(out, p, 5, pa * left[i])
        add_pair(out, p + 1, 5, va * last[i])
        if second:
            add_pair(out, p, 6, pu * left[i])
            add_pair(out, p + 1, 6, vu * last[i])
    out[5, 5] += aa
    if second:
        add_pair(out, 5, 6, au)
        out[6, 6] += uu if params[7] > 0.0 else -math.expm1(-2.0 * dt)


def _space_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    second = x.size > 10
    growth, _ = _remember(params[0], params[1], dt, x[6])
    ax, _, _ = _turn(params, second, 0.0, dt, x[7], x[10] if second else 0.0)
    ay, _, _ = _turn(params, second, 0.0, dt, x[8], x[11] if second else 0.0)
    az, _, _ = _turn(params, second, 0.0, dt, x[9], x[12] if second else 0.0)
    ex, ey, ez, mx, my, mz = _end_and_mean(min(growth, LARGEST_GROWTH), ax, ay, az, x)
    m = (mx, my, mz)
    e = (ex, ey, ez)
    _add_wobble(params[6], dt, 3, out)
    _add_growth(params, dt, 3, m, e, out)
    pp, pv, pa, pu, vv, va, vu, aa, au, uu = _shape_noise(params[5], params[4], params[7], params[8], dt)
    slope = uu if params[7] > 0.0 else -math.expm1(-2.0 * dt)
    mm = mx * mx + my * my + mz * mz
    me = mx * ex + my * ey + mz * ez
    ee = ex * ex + ey * ey + ez * ez
    for i in range(3):
        p = 2 * i
        out[p, p] += pp * mm
        out[p + 1, p + 1] += vv * ee
        add_pair(out, p, p + 1, pv * me)
        # sum over the axes of (e_k x a)(e_k x b)' = (a b) 1 - b a'
        for j in range(3):
            q = 2 * j
            out[p, q] -= pp * (m[i] * m[j])
            out[p + 1, q + 1] -= vv * (e[i] * e[j])
            out[p, q + 1] -= pv * (e[i] * m[j])
            out[q + 1, p] -= pv * (e[i] * m[j])
        j = (i + 1) % 3
        k = (i + 2) % 3
        # component j of e_i x a is -a_k, component k is a_j
        add_pair(out, 2 * j, 7 + i, -pa * m[k])
        add_pair(out, 2 * k, 7 + i, pa * m[j])
        add_pair(out, 2 * j + 1, 7 + i, -va * e[k])
        add_pair(out, 2 * k + 1, 7 + i, va * e[j])
        out[7 + i, 7 + i] += aa
        if second:
            add_pair(out, 2 * j, 10 + i, -pu * m[k])
            add_pair(out, 2 * k, 10 + i, pu * m[j])
            add_pair(out, 2 * j + 1, 10 + i, -vu * e[k])
            add_pair(out, 2 * k + 1, 10 + i, vu * e[j])
            add_pair(out, 7 + i, 10 + i, au)
            out[10 + i, 10 + i] += slope


def _shape_from_jet(jet: np.ndarray, params: np.ndarray, own: np.ndarray) -> None:
    axes = jet.size // 3
    square = 0.0
    along = 0.0
    for i in range(axes):
        square += jet[axes + i] * jet[axes + i]
        along += jet[axes + i] * jet[2 * axes + i]
    square = max(square, params[9] * params[9])
    own[0] = along / square
    if axes == 2:
        own[1] = (jet[2] * jet[5] - jet[3] * jet[4]) / square
    else:
        own[1] = (jet[4] * jet[8] - jet[5] * jet[7]) / square
        own[2] = (jet[5] * jet[6] - jet[3] * jet[8]) / square
        own[3] = (jet[3] * jet[7] - jet[4] * jet[6]) / square


_TRANSITIONS = {2: Callback(_plane_transition, TRANSITION), 3: Callback(_space_transition, TRANSITION)}
_NOISES = {2: Callback(_plane_noise, NOISE), 3: Callback(_space_noise, NOISE)}
_FROM_JET = Callback(_shape_from_jet, OWN)


def bilinear(
    axes: int = 2,
    *,
    growth_mean: float = 0.0,
    growth_rate: float = 0.0,
    growth_noise: float = 1e-5,
    turn_mean: float = 0.0,
    turn_rate: float = 0.0,
    turn_noise: float = 1e-4,
    wobble: float = 1.0,
    swing: Sequence[float] | None = None,
    slope: bool = False,
    growth: tuple[float, float] = (0.0, 0.02),
    turn: tuple[float, float] = (0.0, 0.3),
    swing_sd: float = 0.1,
    speed_floor: float = 1.0,
) -> Motion:
    """Velocity that grows at a rate g and turns at a rate w, which return to their means or swing about them.

    Model: ``v' = g v + w x v + n`` (in the plane ``(g + i w) v``), ``g' = growth_rate (growth_mean - g) + n_g``,
    ``w' = turn_rate (turn_mean - w) + n_w``; or, with a swing (W, z), ``w' = u, u' = -W^2 (w - turn_mean) - 2 z W u +
    n_u``. Velocity turns and grows by the exact integrals of g and w; position follows with their means over the
    step: exact for constant g and w. Noise of g and w acts along and across the mean velocity of the step on
    position and the last one on velocity: exact to first order in the turn of one step, positive semidefinite for
    any.

    Args:
        axes: 2 or 3.
        growth_mean: g is drawn to it; 1/s.
        growth_rate: how fast; 1/s; 0: g is a random walk.
        growth_noise: white noise on g'; 1/s^3.
        turn_mean: w is drawn to it, counter-clockwise positive; rad/s; in space 0 (no direction is special).
        turn_rate: how fast; 1/s; with a swing 0.
        turn_noise: white noise on w' (on each component in space), rad^2/s^3; with a swing on u', rad^2/s^5.
        wobble: white acceleration per axis; m^2/s^3.
        swing: natural rate W (rad/s) and damping z in [0.001, 0.999] of a weave; None: w has no slope of its own.
        slope: carry u without a swing too: a unit-variance component that nothing else sees, so that all modes of a
            bank have the same components.
        growth: mean and standard deviation of g when the intent begins; 1/s.
        turn: the same of w; rad/s; in space of each component, mean 0.
        swing_sd: standard deviation of u when a weave begins; rad/s^2.
        speed_floor: below this speed an acceleration says little about g and w; m/s.
    Returns:
        Motion with state ``x vx y vy g w [u]`` or ``x vx y vy z vz g wx wy wz [ux uy uz]``.
    Raises:
        ValueError: an option is out of range.
    Source: patent CN202211553542, claims 4-6 (state of motion parameters, learned law of their change); Singer (1970)
    for the memory of g and w. Differs: the family and its exact steps are ours.
    """
    caller = "bilinear"
    axes = check_axes(caller, axes, (2, 3))
    natural, damping = 0.0, 0.5
    if swing is not None:
        if not isinstance(swing, Sequence) or len(swing) != 2:
            raise ValueError(f"{caller}: swing must be (natural rate, damping); got {swing!r}. Give rad/s and 0.1.")
        natural = check_option(caller, "swing natural rate", swing[0], "> 0")
        damping = check_option(caller, "swing damping", swing[1], "> 0")
        if not 1e-3 <= damping <= 0.999:
            raise ValueError(
                f"{caller}: swing damping must be in [0.001, 0.999]; got {damping}. A weave swings: use 0.1."
            )
        if turn_rate != 0.0:
            raise ValueError(
                f"{caller}: turn_rate must be 0 with a swing; got {turn_rate}. The swing's damping does it."
            )
    if axes == 3 and (turn_mean != 0.0 or turn[0] != 0.0):
        raise ValueError(
            f"{caller}: turn_mean and the mean of turn must be 0 with axes=3; got {turn_mean} and {turn[0]}. "
            "Use standard deviations."
        )
    params = (
        check_option(caller, "growth_mean", growth_mean, "finite"),
        check_option(caller, "growth_rate", growth_rate),
        check_option(caller, "growth_noise", growth_noise),
        check_option(caller, "turn_mean", turn_mean, "finite"),
        check_option(caller, "turn_rate", turn_rate),
        check_option(caller, "turn_noise", turn_noise),
        check_option(caller, "wobble", wobble),
        natural,
        damping,
        check_option(caller, "speed_floor", speed_floor, "> 0"),
    )
    turns = 1 if axes == 2 else 3
    own: tuple[str, ...] = ("g", "w") if axes == 2 else ("g", "wx", "wy", "wz")
    units: tuple[str, ...] = ("m", "m/s") * axes + ("1/s",) + ("rad/s",) * turns
    birth_mean: tuple[float, ...] = (
        check_option(caller, "growth mean", growth[0], "finite"),
        *(check_option(caller, "turn mean", turn[0], "finite"),) * turns,
    )
    birth_sd: tuple[float, ...] = (
        check_option(caller, "growth sd", growth[1]),
        *(check_option(caller, "turn sd", turn[1]),) * turns,
    )
    if swing is not None or slope:
        own += ("u",) if axes == 2 else ("ux", "uy", "uz")
        units += ("rad/s^2",) * turns
        birth_mean += (0.0,) * turns
        birth_sd += (check_option(caller, "swing_sd", swing_sd) if swing is not None else 1.0,) * turns
    return Motion(
        caller,
        labels_of(axes, " v") + own,
        axes,
        _TRANSITIONS[axes],
        params,
        units,
        noise=_NOISES[axes],
        own_from_jet=_FROM_JET,
        jet_order=2,
        birth_mean=birth_mean,
        birth_sd=birth_sd,
    )
