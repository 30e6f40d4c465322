"""Turns in the plane, counter-clockwise positive, with Cartesian velocity: known rate and estimated rate.

A turn moves along arcs exactly. Process noise is white acceleration and white change of rate, carried along
the flow linearised at the state: ``Q(a + b) = Phi_b Q(a) Phi_b' + Q(b)`` holds for any state and any cut of
the step. The one thing a cut changes is that a filter re-linearises at its new estimate.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import NOISE, OWN, TRANSITION, Callback, kernel
from jink.estimators.motion import Motion
from jink.estimators.motions.blocks import add_outer, add_pair
from jink.estimators.motions.options import check_option, units_of
from jink.estimators.motions.series import half_turn, stumpff, swing_moments

__all__ = ["RATE_FROM_JET", "coordinated_turn", "known_turn", "rate_noise"]


@kernel
def rotate(x: np.ndarray, dt: float, w: float, out: np.ndarray) -> None:
    """Move ``x vx y vy`` along an arc of rate ``w`` for ``dt``."""
    sinc, cosine, sine = half_turn(w * dt)
    vx = x[1]
    vy = x[3]
    chord = dt * sinc
    along = chord * cosine
    across = chord * sine
    turned = 2.0 * sine * cosine
    kept = 1.0 - 2.0 * sine * sine
    out[0] = x[0] + along * vx - across * vy
    out[1] = kept * vx - turned * vy
    out[2] = x[2] + across * vx + along * vy
    out[3] = turned * vx + kept * vy


@kernel
def add_acceleration_noise(density: float, dt: float, w: float, out: np.ndarray) -> None:
    """Add white acceleration on both axes, turned with the target, to the block of ``x vx y vy``."""
    a = w * dt
    _, _, c2, c3, _, _, _, _ = stumpff(a)
    vv = density * dt
    pp = 2.0 * vv * dt * dt * c3
    pv = vv * dt * c2
    cross = vv * dt * a * c3
    for i in range(0, 4, 2):
        out[i, i] += pp
        out[i + 1, i + 1] += vv
        add_pair(out, i, i + 1, pv)
    add_pair(out, 0, 3, cross)
    add_pair(out, 1, 2, -cross)


@kernel
def rate_noise(a: float) -> tuple[float, float, float, float, float, float, float]:
    """Moments of a white rate noise for unit density, step and speed.

    A rate error dw held for s displaces the target by ``s^2 (c_2 L - a c_3 B) dw`` with L left of the
    heading at the end and B backwards (both of the length of the speed), and its velocity by ``s L dw``.
    Order: ``pL w, pB w, pL vL, pB vL, pL pL, pL pB, pB pB``.
    """
    _, _, _, c3, c4, c5, _, _ = stumpff(a)
    ll, third = swing_moments(a)
    lb = -0.5 * a * c3 * c3
    bb = a * a * third
    return c3, -a * c4, c3 - c4, -a * (c4 - c5), ll, lb, bb


def _known_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    rotate(x, dt, params[0], out)


def _known_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    add_acceleration_noise(params[1], dt, params[0], out)
    held = params[2] * params[2] * dt * dt
    for i in range(0, 4, 2):
        out[i, i] += held * dt * dt / 4.0
        add_pair(out, i, i + 1, held * dt / 2.0)
        out[i + 1, i + 1] += held


_KNOWN = Callback(_known_transition, TRANSITION)
_KNOWN_NOISE = Callback(_known_noise, NOISE)


def known_turn(rate: float = 0.1, *, acceleration_density: float = 1.0, held_acceleration: float = 0.0) -> Motion:
    """Coordinated turn at a known rate: linear.

    Model: ``p' = v, v' = rate J v + w`` with ``J`` a quarter turn counter-clockwise; ``rate = 0`` is
    straight flight.

    Args:
        rate: rad/s, counter-clockwise positive.
        acceleration_density: white acceleration on each axis; m^2/s^3.
        held_acceleration: standard deviation of an acceleration held over each step (``G = (dt^2/2, dt)`` as
            in published benchmarks; then the length of the steps matters); m/s^2.
    Returns:
        Motion with state ``x vx y vy``.
    Raises:
        ValueError: an option is out of range.
    Source: Bar-Shalom, Li, Kirubarajan (2001) 11.7. Differs: the white noise turns with the target.
    """
    caller = "known_turn"
    labels = ("x", "vx", "y", "vy")
    params = (
        check_option(caller, "rate", rate, "finite"),
        check_option(caller, "acceleration_density", acceleration_density),
        check_option(caller, "held_acceleration", held_acceleration),
    )
    return Motion(caller, labels, 2, _KNOWN, params, units_of(labels), noise=_KNOWN_NOISE, jet_order=1, linear=True)


def _turn_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    w = x[4]
    rotate(x, dt, w, out)
    out[4] = w


def _turn_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    w = x[4]
    a = w * dt
    add_acceleration_noise(params[0], dt, w, out)
    plw, pbw, plv, pbv, ll, lb, bb = rate_noise(a)
    _, cosine, sine = half_turn(a)
    turned = 2.0 * sine * cosine
    kept = 1.0 - 2.0 * sine * sine
    # left of the heading at the end of the step, times speed; backwards is a further quarter turn
    lx = -(turned * x[1] + kept * x[3])
    ly = kept * x[1] - turned * x[3]
    q = params[1] * dt
    q2 = q * dt * dt
    q3 = q2 * dt
    ux = plv * lx - pbv * ly
    uy = plv * ly + pbv * lx
    out[4, 4] += q
    add_pair(out, 0, 4, q * dt * dt * (plw * lx - pbw * ly))
    add_pair(out, 2, 4, q * dt * dt * (plw * ly + pbw * lx))
    add_pair(out, 1, 4, 0.5 * q * dt * lx)
    add_pair(out, 3, 4, 0.5 * q * dt * ly)
    add_outer(out, 1, 3, lx, ly, q2 / 3.0, 0.0, 0.0)
    add_pair(out, 0, 1, q3 * ux * lx)
    add_pair(out, 0, 3, q3 * ux * ly)
    add_pair(out, 2, 1, q3 * uy * lx)
    add_pair(out, 2, 3, q3 * uy * ly)
    add_outer(out, 0, 2, lx, ly, q3 * dt * ll, q3 * dt * lb, q3 * dt * bb)


def _rate_from_jet(jet: np.ndarray, params: np.ndarray, own: np.ndarray) -> None:
    axes = jet.size // 3
    vx = jet[axes]
    vy = jet[axes + 1]
    floor = params[params.size - 1]
    own[0] = (vx * jet[2 * axes + 1] - vy * jet[2 * axes]) / max(vx * vx + vy * vy, floor * floor)


_TURN = Callback(_turn_transition, TRANSITION)
_TURN_NOISE = Callback(_turn_noise, NOISE)
RATE_FROM_JET = Callback(_rate_from_jet, OWN)
"""Turn rate ``(v x a)_z / max(v^2, speed_floor^2)``; ``speed_floor`` is the last of the motion's params."""


def coordinated_turn(
    *,
    acceleration_density: float = 1.0,
    rate_density: float = 1e-3,
    rate: float = 0.0,
    rate_sd: float = 0.3,
    speed_floor: float = 1.0,
) -> Motion:
    """Coordinated turn whose rate is estimated, with Cartesian velocity.

    Model: ``p' = v, v' = w J v + u, w' = n``; white u (both axes) and n. Rate noise bends the path, so ``Q``
    depends on the velocity.

    Args:
        acceleration_density: of u; m^2/s^3.
        rate_density: of n; rad^2/s^3.
        rate: prior mean of the turn rate when the intent begins; rad/s, counter-clockwise positive.
        rate_sd: its standard deviation; rad/s.
        speed_floor: below this speed an acceleration says little about the rate; m/s.
    Returns:
        Motion with state ``x vx y vy w``.
    Raises:
        ValueError: an option is out of range.
    Source: Bar-Shalom, Li, Kirubarajan (2001) 11.7.2. Differs: noise integrated along the
    flow.
    """
    caller = "coordinated_turn"
    labels = ("x", "vx", "y", "vy", "w")
    params = (
        check_option(caller, "acceleration_density", acceleration_density),
        check_option(caller, "rate_density", rate_density),
        check_option(caller, "speed_floor", speed_floor, "> 0"),
    )
    return Motion(
        caller,
        labels,
        2,
        _TURN,
        params,
        units_of(labels),
        noise=_TURN_NOISE,
        own_from_jet=RATE_FROM_JET,
        jet_order=2,
        birth_mean=(check_option(caller, "rate", rate, "finite"),),
        birth_sd=(check_option(caller, "rate_sd", rate_sd),),
    )
