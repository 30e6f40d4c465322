"""Turns in the plane by their geometry: speed and heading, or a centre and a radius."""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import ASSEMBLE, KINEMATICS, NOISE, TRANSITION, Callback, kernel
from jink.estimators.motion import Motion
from jink.estimators.motions.blocks import add_outer, add_pair
from jink.estimators.motions.options import check_option, units_of
from jink.estimators.motions.series import half_turn, stumpff, swing_moments
from jink.estimators.motions.turns import RATE_FROM_JET, rate_noise

__all__ = ["centre_form", "circle", "polar_turn"]


def _polar_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    s = x[2]
    psi = x[3]
    w = x[4]
    a = w * dt
    sinc, _, _ = half_turn(a)
    chord = s * dt * sinc
    middle = psi + 0.5 * a
    out[0] = x[0] + chord * math.cos(middle)
    out[1] = x[1] + chord * math.sin(middle)
    out[2] = s
    out[3] = psi + a
    out[4] = w


def _polar_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    s = x[2]
    a = x[4] * dt
    psi = x[3] + a
    hx = math.cos(psi)
    hy = math.sin(psi)
    _, _, c2, c3, _, _, _, _ = stumpff(a)
    _, _, _, d3, _, _, _, _ = stumpff(2.0 * a)
    across, _ = swing_moments(a)
    # speed noise displaces along the heading and, in a turn, to the right of it
    q = params[0] * dt
    along = q * dt * c2
    right = q * dt * a * c3
    out[2, 2] += q
    add_pair(out, 0, 2, along * hx + right * hy)
    add_pair(out, 1, 2, along * hy - right * hx)
    add_outer(
        out,
        0,
        1,
        hx,
        hy,
        2.0 * q * dt * dt * d3,
        -0.5 * q * dt * dt * a * c2 * c2,
        q * dt * dt * a * a * across,
    )
    plw, pbw, plv, pbv, ll, lb, bb = rate_noise(a)
    r = params[1] * dt
    lx = -hy
    ly = hx
    out[4, 4] += r
    out[3, 3] += r * dt * dt / 3.0
    add_pair(out, 3, 4, 0.5 * r * dt)
    r2 = r * dt * dt * s
    add_pair(out, 0, 4, r2 * (plw * lx - pbw * ly))
    add_pair(out, 1, 4, r2 * (plw * ly + pbw * lx))
    add_pair(out, 0, 3, r2 * dt * (plv * lx - pbv * ly))
    add_pair(out, 1, 3, r2 * dt * (plv * ly + pbv * lx))
    r4 = r2 * s * dt * dt
    add_outer(out, 0, 1, lx, ly, r4 * ll, r4 * lb, r4 * bb)


def _polar_kinematics(x: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = x[0]
    out[1] = x[1]
    out[2] = x[2] * math.cos(x[3])
    out[3] = x[2] * math.sin(x[3])


def _polar_assemble(kin: np.ndarray, own: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = kin[0]
    out[1] = kin[1]
    out[2] = math.hypot(kin[2], kin[3])
    out[3] = math.atan2(kin[3], kin[2])
    out[4] = own[0]


_POLAR = Callback(_polar_transition, TRANSITION)
_POLAR_NOISE = Callback(_polar_noise, NOISE)
_POLAR_KINEMATICS = Callback(_polar_kinematics, KINEMATICS)
_POLAR_ASSEMBLE = Callback(_polar_assemble, ASSEMBLE)


def polar_turn(
    *,
    speed_density: float = 1.0,
    rate_density: float = 1e-3,
    rate: float = 0.0,
    rate_sd: float = 0.3,
    speed_floor: float = 1.0,
) -> Motion:
    """Coordinated turn with speed, heading and an estimated rate: for targets that keep their speed.

    Model: ``p' = s (cos psi, sin psi), s' = u, psi' = w, w' = n``; white u and n.

    Args:
        speed_density: of u; m^2/s^3.
        rate_density: of n; rad^2/s^3.
        rate: prior mean of the turn rate when the intent begins; rad/s, counter-clockwise positive.
        rate_sd: its standard deviation; rad/s.
        speed_floor: below this speed an acceleration says little about the rate; m/s.
    Returns:
        Motion with state ``x y s psi w``; psi counter-clockwise from +x, unwrapped.
    Raises:
        ValueError: an option is out of range.
    Source: Bar-Shalom, Li, Kirubarajan (2001) 11.7.2, polar velocity. Differs: noise integrated along the
    flow.
    """
    caller = "polar_turn"
    labels = ("x", "y", "s", "psi", "w")
    params = (
        check_option(caller, "speed_density", speed_density),
        check_option(caller, "rate_density", rate_density),
        check_option(caller, "speed_floor", speed_floor, "> 0"),
    )
    return Motion(
        caller,
        labels,
        2,
        _POLAR,
        params,
        units_of(labels),
        noise=_POLAR_NOISE,
        kinematics=_POLAR_KINEMATICS,
        assemble=_POLAR_ASSEMBLE,
        own=("w",),
        own_from_jet=RATE_FROM_JET,
        jet_order=2,
        birth_mean=(check_option(caller, "rate", rate, "finite"),),
        birth_sd=(check_option(caller, "rate_sd", rate_sd),),
        angular=("psi",),
    )


def _circle_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = x[0]
    out[1] = x[1]
    out[2] = x[2]
    out[3] = x[3] + x[4] * dt
    out[4] = x[4]


def _circle_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    rate = params[2] * dt
    out[0, 0] = params[0] * dt
    out[1, 1] = params[0] * dt
    out[2, 2] = params[1] * dt
    out[3, 3] = rate * dt * dt / 3.0
    out[4, 4] = rate
    add_pair(out, 3, 4, 0.5 * rate * dt)


def _circle_kinematics(x: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    cosine = x[2] * math.cos(x[3])
    sine = x[2] * math.sin(x[3])
    out[0] = x[0] + cosine
    out[1] = x[1] + sine
    out[2] = -x[4] * sine
    out[3] = x[4] * cosine


@kernel
def centre_form(
    x: float, y: float, vx: float, vy: float, w: float, slowest: float
) -> tuple[float, float, float, float, float]:
    """``xc yc rho theta w`` of the circle through a position with a velocity; at least ``slowest``."""
    if abs(w) < slowest:
        w = -slowest if w < 0.0 else slowest
    theta = math.atan2(-vx, vy) if w > 0.0 else math.atan2(vx, -vy)
    return x - vy / w, y + vx / w, math.hypot(vx, vy) / abs(w), theta, w


def _circle_assemble(kin: np.ndarray, own: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    xc, yc, rho, theta, w = centre_form(kin[0], kin[1], kin[2], kin[3], own[0], params[3])
    out[0] = xc
    out[1] = yc
    out[2] = rho
    out[3] = theta
    out[4] = w


_CIRCLE = Callback(_circle_transition, TRANSITION)
_CIRCLE_NOISE = Callback(_circle_noise, NOISE)
_CIRCLE_KINEMATICS = Callback(_circle_kinematics, KINEMATICS)
_CIRCLE_ASSEMBLE = Callback(_circle_assemble, ASSEMBLE)


def circle(
    *,
    centre_density: float = 1.0,
    radius_density: float = 1.0,
    rate_density: float = 1e-4,
    rate: float = 0.1,
    rate_sd: float = 0.05,
    slowest_rate: float = 1e-3,
    speed_floor: float = 1.0,
) -> Motion:
    """Circle about a centre that hardly moves: loiter, orbit, thermal.

    Model: ``p = c + rho (cos theta, sin theta), theta' = w``; c, rho and w are random walks. The sign of the
    rate is that of the prior until a jet says otherwise; for a turn of either sign use `coordinated_turn`.

    Args:
        centre_density: of each coordinate of the centre; m^2/s.
        radius_density: m^2/s.
        rate_density: rad^2/s^3.
        rate: prior mean of the rate when the intent begins; rad/s, counter-clockwise positive.
        rate_sd: its standard deviation; rad/s.
        slowest_rate: a smaller rate is replaced by this one when a state is assembled, for its circle would
            be immense; rad/s.
        speed_floor: below this speed an acceleration says little about the rate; m/s.
    Returns:
        Motion with state ``xc yc rho theta w``; the transition is linear, position is not.
    Raises:
        ValueError: an option is out of range.
    Source: patent CN202211553542, claims 4-6 (motion function of parameters); the circle is ours.
    """
    caller = "circle"
    labels = ("xc", "yc", "rho", "theta", "w")
    params = (
        check_option(caller, "centre_density", centre_density),
        check_option(caller, "radius_density", radius_density),
        check_option(caller, "rate_density", rate_density),
        check_option(caller, "slowest_rate", slowest_rate, "> 0"),
        check_option(caller, "speed_floor", speed_floor, "> 0"),
    )
    return Motion(
        caller,
        labels,
        2,
        _CIRCLE,
        params,
        units_of(labels),
        noise=_CIRCLE_NOISE,
        kinematics=_CIRCLE_KINEMATICS,
        assemble=_CIRCLE_ASSEMBLE,
        own=("w",),
        own_from_jet=RATE_FROM_JET,
        jet_order=2,
        birth_mean=(check_option(caller, "rate", rate, "finite"),),
        birth_sd=(check_option(caller, "rate_sd", rate_sd),),
        linear=True,
        angular=("theta",),
    )
