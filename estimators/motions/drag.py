"""Coasting against drag: the speed falls, the direction stays."""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import NOISE, TRANSITION, Callback, kernel
from jink.estimators.motion import Motion
from jink.estimators.motions.options import check_axes, check_option, labels_of, units_of
from jink.estimators.motions.series import decay

__all__ = ["drag_coast"]


@kernel
def _speed(x: np.ndarray) -> float:
    total = 0.0
    for i in range(1, x.size, 2):
        total = math.hypot(total, x[i])
    return total


@kernel
def _travel(loss: float) -> float:
    """``log(1 + loss) / loss``: distance over that without drag."""
    return math.log1p(loss) / loss if loss != 0.0 else 1.0


def _drag_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    loss = params[0] * _speed(x) * dt
    reach = dt * _travel(loss)
    keep = 1.0 / (1.0 + loss)
    for i in range(0, x.size, 2):
        v = x[i + 1]
        out[i] = x[i] + reach * v
        out[i + 1] = keep * v


def _drag_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    speed = _speed(x)
    loss = params[0] * speed * dt
    keep = 1.0 / (1.0 + loss)
    lost = loss * keep
    q = params[1] * dt
    # a disturbance s before the end reaches it times (1 - lost s/dt)^2 along the path, ^1 across it
    along_pp = q * dt * dt * (1.0 / 3.0 - lost * (0.5 - 0.2 * lost))
    along_pv = q * dt * (0.5 - lost * (1.0 - lost * (0.75 - 0.2 * lost)))
    along_vv = 0.2 * q * (1.0 + keep * (1.0 + keep * (1.0 + keep * (1.0 + keep))))
    _, g1, g2, g3, _, _, _, _ = decay(3.0 * math.log1p(loss))
    stretch = dt * _travel(loss) * (1.0 + loss)
    across_pp = params[1] * stretch**3 * max(g1 - 2.0 * g2 + 2.0 * g3, 0.0)
    across_pv = params[1] * stretch**2 * (g1 - g2)
    across_vv = q * (1.0 + keep + keep * keep) / 3.0
    for i in range(0, x.size, 2):
        out[i, i] = across_pp
        out[i, i + 1] = across_pv
        out[i + 1, i] = across_pv
        out[i + 1, i + 1] = across_vv
    if speed > 0.0:
        for i in range(0, x.size, 2):
            for j in range(0, x.size, 2):
                both = (x[i + 1] / speed) * (x[j + 1] / speed)
                out[i, j] += (along_pp - across_pp) * both
                out[i, j + 1] += (along_pv - across_pv) * both
                out[i + 1, j] += (along_pv - across_pv) * both
                out[i + 1, j + 1] += (along_vv - across_vv) * both


_DRAG = Callback(_drag_transition, TRANSITION)
_DRAG_NOISE = Callback(_drag_noise, NOISE)


def drag_coast(axes: int = 2, *, drag: float = 1e-3, acceleration_density: float = 1.0) -> Motion:
    """Coasting with drag that grows as the square of the speed.

    Model: ``p' = v, v' = -k |v| v + w``; without noise ``|v|(t) = |v| / (1 + k |v| t)`` and the distance is
    ``log(1 + k |v| t) / k``. ``Q`` is the integral of the flow linearised at the state.

    Args:
        axes: 1, 2 or 3.
        drag: k = drag factor over mass (half of density, drag coefficient and area, over mass); 1/m.
        acceleration_density: of w per axis; m^2/s^3.
    Returns:
        Motion with state ``x vx y vy ...``.
    Raises:
        ValueError: an option is out of range.
    Source: Sun (2025), EstimatorFrame, 2DDMM. Differs: exact flow instead of a constant-acceleration step;
    no outer acceleration.
    """
    caller = "drag_coast"
    axes = check_axes(caller, axes)
    params = (
        check_option(caller, "drag", drag),
        check_option(caller, "acceleration_density", acceleration_density),
    )
    labels = labels_of(axes, " v")
    return Motion(caller, labels, axes, _DRAG, params, units_of(labels), noise=_DRAG_NOISE, jet_order=1)
