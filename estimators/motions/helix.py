"""Helix about a vertical axis: climb in a circle. Counter-clockwise positive, seen from above."""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import ASSEMBLE, KINEMATICS, NOISE, TRANSITION, Callback
from jink.estimators.motion import Motion
from jink.estimators.motions.blocks import add_pair
from jink.estimators.motions.options import check_option, units_of
from jink.estimators.motions.polar import centre_form
from jink.estimators.motions.turns import RATE_FROM_JET

__all__ = ["helix"]


def _helix_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = x[0]
    out[1] = x[1]
    out[2] = x[2] + x[6] * dt
    out[3] = x[3]
    out[4] = x[4] + x[5] * dt
    out[5] = x[5]
    out[6] = x[6]


def _helix_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    rate = params[2] * dt
    climb = params[3] * dt
    out[0, 0] = params[0] * dt
    out[1, 1] = params[0] * dt
    out[2, 2] = climb * dt * dt / 3.0
    out[3, 3] = params[1] * dt
    out[4, 4] = rate * dt * dt / 3.0
    out[5, 5] = rate
    out[6, 6] = climb
    add_pair(out, 4, 5, 0.5 * rate * dt)
    add_pair(out, 2, 6, 0.5 * climb * dt)


def _helix_kinematics(x: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    cosine = x[3] * math.cos(x[4])
    sine = x[3] * math.sin(x[4])
    out[0] = x[0] + cosine
    out[1] = x[1] + sine
    out[2] = x[2]
    out[3] = -x[5] * sine
    out[4] = x[5] * cosine
    out[5] = x[6]


def _helix_assemble(kin: np.ndarray, own: np.ndarray, params: np.ndarray, out: np.ndarray) -> None:
    xc, yc, rho, theta, w = centre_form(kin[0], kin[1], kin[3], kin[4], own[0], params[4])
    out[0] = xc
    out[1] = yc
    out[2] = kin[2]
    out[3] = rho
    out[4] = theta
    out[5] = w
    out[6] = kin[5]


_HELIX = Callback(_helix_transition, TRANSITION)
_HELIX_NOISE = Callback(_helix_noise, NOISE)
_HELIX_KINEMATICS = Callback(_helix_kinematics, KINEMATICS)
_HELIX_ASSEMBLE = Callback(_helix_assemble, ASSEMBLE)


def helix(
    *,
    centre_density: float = 1.0,
    radius_density: float = 1.0,
    rate_density: float = 1e-4,
    climb_density: float = 0.1,
    rate: float = 0.1,
    rate_sd: float = 0.05,
    slowest_rate: float = 1e-3,
    speed_floor: float = 1.0,
) -> Motion:
    """Climb or descend in a circle about a vertical axis.

    Model: ``p = (xc + rho cos theta, yc + rho sin theta, z), theta' = w, z' = vz``; xc, yc, rho, w and vz
    are random walks. As in `circle`, the sign of the rate is that of the prior until a jet says otherwise.

    Args:
        centre_density: of each coordinate of the centre; m^2/s.
        radius_density: m^2/s.
        rate_density: rad^2/s^3.
        climb_density: white vertical acceleration; m^2/s^3.
        rate: prior mean of the rate when the intent begins; rad/s, counter-clockwise positive seen from
            above.
        rate_sd: its standard deviation; rad/s.
        slowest_rate: a smaller rate is replaced by this one when a state is assembled; rad/s.
        speed_floor: below this horizontal speed an acceleration says little about the rate; m/s.
    Returns:
        Motion with state ``xc yc z rho theta w vz``; the transition is linear, position is not.
    Raises:
        ValueError: an option is out of range.
    Source: patent CN202211553542, claims 4-6 (motion function of parameters); the helix is ours.
    """
    caller = "helix"
    labels = ("xc", "yc", "z", "rho", "theta", "w", "vz")
    params = (
        check_option(caller, "centre_density", centre_density),
        check_option(caller, "radius_density", radius_density),
        check_option(caller, "rate_density", rate_density),
        check_option(caller, "climb_density", climb_density),
        check_option(caller, "slowest_rate", slowest_rate, "> 0"),
        check_option(caller, "speed_floor", speed_floor, "> 0"),
    )
    return Motion(
        caller,
        labels,
        3,
        _HELIX,
        params,
        units_of(labels),
        noise=_HELIX_NOISE,
        kinematics=_HELIX_KINEMATICS,
        assemble=_HELIX_ASSEMBLE,
        own=("w",),
        own_from_jet=RATE_FROM_JET,
        jet_order=2,
        birth_mean=(check_option(caller, "rate", rate, "finite"),),
        birth_sd=(check_option(caller, "rate_sd", rate_sd),),
        linear=True,
        angular=("theta",),
    )
