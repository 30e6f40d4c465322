"""Weaving: a sine across a straight course, and its linear relative, an acceleration that swings."""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import ASSEMBLE, KINEMATICS, NOISE, TRANSITION, Callback
from jink.estimators.motion import Motion
from jink.estimators.motions.blocks import add_pair, fill_three
from jink.estimators.motions.cartesian import ACCELERATION_FROM_JET
from jink.estimators.motions.options import check_axes, check_option, labels_of, units_of
from jink.estimators.motions.series import stumpff, swing_moments

__all__ = ["swing", "weave"]

_STEEPEST = 0.95  # largest sideways share of the speed that an assembled weave may have


def _weave_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = x[0] + dt * x[1]
    out[1] = x[1]
    out[2] = x[2] + dt * x[3]
    out[3] = x[3]
    out[4] = x[4]
    out[5] = x[5] + dt * x[6]
    out[6] = x[6]


def _weave_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    q = params[0] * dt
    for i in range(0, 4, 2):
        out[i, i] = q * dt * dt / 3.0
        out[i + 1, i + 1] = q
        add_pair(out, i, i + 1, 0.5 * q * dt)
    out[4, 4] = params[1] * dt
    r = params[2] * dt
    out[5, 5] = r * dt * dt / 3.0
    out[6, 6] = r
    add_pair(out, 5, 6, 0.5 * r * dt)


def _weave_kinematics(x: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    speed = math.hypot(x[1], x[3])
    nx = -x[3] / speed if speed > 0.0 else 0.0
    ny = x[1] / speed if speed > 0.0 else 1.0
    offset = x[4] * math.sin(x[5])
    sideways = x[4] * x[6] * math.cos(x[5])
    out[0] = x[0] + offset * nx
    out[1] = x[2] + offset * ny
    out[2] = x[1] + sideways * nx
    out[3] = x[3] + sideways * ny


def _weave_assemble(kin: np.ndarray, own: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    amplitude = own[0]
    vx = kin[2]
    vy = kin[3]
    speed = math.hypot(vx, vy)
    cosine = math.cos(own[1])
    sideways = amplitude * own[2] * cosine
    most = _STEEPEST * speed
    if abs(sideways) > most:
        amplitude *= most / abs(sideways)
        sideways = most if sideways > 0.0 else -most
    share = sideways / speed if speed > 0.0 else 0.0
    forward = math.sqrt(1.0 - share * share)
    # velocity = course speed (cos, sin) turned left by the angle whose sine is share: turn it back
    lx = forward * (forward * vx + share * vy)
    ly = forward * (forward * vy - share * vx)
    course = forward * speed
    nx = -ly / course if course > 0.0 else 0.0
    ny = lx / course if course > 0.0 else 1.0
    offset = amplitude * math.sin(own[1])
    out[0] = kin[0] - offset * nx
    out[1] = lx
    out[2] = kin[1] - offset * ny
    out[3] = ly
    out[4] = amplitude
    out[5] = own[1]
    out[6] = own[2]


_WEAVE = Callback(_weave_transition, TRANSITION)
_WEAVE_NOISE = Callback(_weave_noise, NOISE)
_WEAVE_KINEMATICS = Callback(_weave_kinematics, KINEMATICS)
_WEAVE_ASSEMBLE = Callback(_weave_assemble, ASSEMBLE)


def weave(
    *,
    acceleration_density: float = 0.1,
    amplitude_density: float = 0.1,
    rate_density: float = 1e-4,
    amplitude: float = 10.0,
    amplitude_sd: float = 5.0,
    rate: float = 0.5,
    rate_sd: float = 0.2,
) -> Motion:
    """Sine across a straight course.

    Model: ``p = l + A sin(phi) n``, ``l' = v_l`` (white acceleration), ``phi' = Omega``; n is left of
    ``v_l``; A and Omega are random walks. A state assembled from a velocity that its amplitude cannot
    explain (sideways speed over 95 % of the speed) gets a smaller amplitude, so that position and velocity
    are kept.

    Args:
        acceleration_density: of the course, per axis; m^2/s^3.
        amplitude_density: of A; m^2/s.
        rate_density: of Omega; rad^2/s^3.
        amplitude: prior mean of A when the intent begins; m.
        amplitude_sd: its standard deviation; m.
        rate: prior mean of Omega; rad/s.
        rate_sd: its standard deviation; rad/s. The phase begins as wide as a uniform one, pi/sqrt(3).
    Returns:
        Motion with state ``xl vxl yl vyl A phi Omega``; the transition is linear, position is not.
    Raises:
        ValueError: an option is out of range.
    Source: patent CN202211553542, claims 4-6 (motion function of parameters); the weave is ours.
    """
    caller = "weave"
    labels = ("xl", "vxl", "yl", "vyl", "A", "phi", "Omega")
    params = (
        check_option(caller, "acceleration_density", acceleration_density),
        check_option(caller, "amplitude_density", amplitude_density),
        check_option(caller, "rate_density", rate_density),
    )
    return Motion(
        caller,
        labels,
        2,
        _WEAVE,
        params,
        units_of(labels),
        noise=_WEAVE_NOISE,
        kinematics=_WEAVE_KINEMATICS,
        assemble=_WEAVE_ASSEMBLE,
        own=("A", "phi", "Omega"),
        jet_order=2,
        birth_mean=(
            check_option(caller, "amplitude", amplitude, "finite"),
            0.0,
            check_option(caller, "rate", rate, "finite"),
        ),
        birth_sd=(
            check_option(caller, "amplitude_sd", amplitude_sd),
            math.pi / math.sqrt(3.0),
            check_option(caller, "rate_sd", rate_sd),
        ),
        linear=True,
        angular=("phi",),
    )


def _swing_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    rate = params[0]
    a = rate * dt
    c0, c1, c2, c3, _, _, _, _ = stumpff(a)
    for i in range(0, x.size, 4):
        v = x[i + 1]
        acceleration = x[i + 2]
        j = x[i + 3]
        out[i] = x[i] + dt * (v + dt * (c2 * acceleration + dt * c3 * j))
        out[i + 1] = v + dt * (c1 * acceleration + dt * c2 * j)
        out[i + 2] = c0 * acceleration + dt * c1 * j
        out[i + 3] = c0 * j - rate * a * c1 * acceleration


def _swing_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    a = params[0] * dt
    _, c1, c2, c3, c4, c5, _, _ = stumpff(a)
    _, d1, _, d3, d4, d5, _, _ = stumpff(2.0 * a)
    vv, pp = swing_moments(a)
    q = params[1] * dt
    q2 = q * dt * dt
    q4 = q2 * dt * dt
    pa = 8.0 * d5 - c4 + c5
    pj = 4.0 * d4 + c4 - c3
    vj = 2.0 * d3 - c3
    for i in range(0, x.size, 4):
        fill_three(
            out,
            i,
            q4 * dt * dt * pp,
            0.5 * q4 * dt * c3 * c3,
            q4 * pa,
            q4 * vv,
            0.5 * q2 * dt * c2 * c2,
            2.0 * q2 * d3,
        )
        add_pair(out, i, i + 3, q2 * dt * pj)
        add_pair(out, i + 1, i + 3, q2 * vj)
        add_pair(out, i + 2, i + 3, 0.5 * q * dt * c1 * c1)
        out[i + 3, i + 3] = 0.5 * q * (1.0 + d1)


_SWING = Callback(_swing_transition, TRANSITION)
_SWING_NOISE = Callback(_swing_noise, NOISE)


def swing(
    axes: int = 2,
    *,
    rate: float = 0.5,
    snap_density: float = 0.1,
    acceleration_sd: float = 2.0,
    jerk_sd: float = 1.0,
) -> Motion:
    """Acceleration that swings at a known rate on each axis: a weave for a Kalman filter.

    Model: ``p' = v, v' = a, a' = j, j' = -rate^2 a + w`` per axis. Any direction, amplitude and phase of a
    weave about a straight course is a state of it, so nothing is ambiguous and nothing is an angle; only the
    rate is fixed.

    Args:
        axes: 1, 2 or 3.
        rate: rad/s; 0 is the limit of white snap.
        snap_density: of w; m^2/s^7.
        acceleration_sd: prior standard deviation of each acceleration when the intent begins; m/s^2.
        jerk_sd: prior standard deviation of each jerk; m/s^3.
    Returns:
        Motion with state ``x vx ax jx y vy ay jy ...``.
    Raises:
        ValueError: an option is out of range.
    Source: Sun (2025), EstimatorFrame, 2DSinM (sine-driven acceleration). Differs: continuous time, amplitude
    and phase in the state.
    """
    caller = "swing"
    axes = check_axes(caller, axes)
    params = (check_option(caller, "rate", rate), check_option(caller, "snap_density", snap_density))
    spreads = (
        check_option(caller, "acceleration_sd", acceleration_sd),
        check_option(caller, "jerk_sd", jerk_sd),
    )
    labels = labels_of(axes, " v a j")
    return Motion(
        caller,
        labels,
        axes,
        _SWING,
        params,
        units_of(labels),
        noise=_SWING_NOISE,
        own_from_jet=ACCELERATION_FROM_JET,
        jet_order=2,
        birth_sd=spreads * axes,
        linear=True,
    )
