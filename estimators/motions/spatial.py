"""Coordinated turn in space, about any axis."""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import NOISE, OWN, TRANSITION, Callback, kernel
from jink.estimators.motion import Motion
from jink.estimators.motions.options import check_option, units_of
from jink.estimators.motions.series import stumpff

__all__ = ["spatial_turn"]

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
def _cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> tuple[float, float, float]:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@kernel
def _rodrigues(x: np.ndarray, dt: float, out: np.ndarray) -> None:
    wx = x[6]
    wy = x[7]
    wz = x[8]
    vx = x[1]
    vy = x[3]
    vz = x[5]
    _, c1, c2, c3 = _first_stumpff(math.sqrt(wx * wx + wy * wy + wz * wz) * dt)
    tx, ty, tz = _cross(wx, wy, wz, vx, vy, vz)
    nx, ny, nz = _cross(wx, wy, wz, tx, ty, tz)
    d2 = dt * dt * c2
    d1 = dt * c1
    d3 = dt * dt * dt * c3
    out[0] = x[0] + dt * vx + d2 * tx + d3 * nx
    out[1] = vx + d1 * tx + d2 * nx
    out[2] = x[2] + dt * vy + d2 * ty + d3 * ny
    out[3] = vy + d1 * ty + d2 * ny
    out[4] = x[4] + dt * vz + d2 * tz + d3 * nz
    out[5] = vz + d1 * tz + d2 * nz
    out[6] = wx
    out[7] = wy
    out[8] = wz


@kernel
def _first_stumpff(a: float) -> tuple[float, float, float, float]:
    """``c_0 .. c_3`` with one sine and cosine, for the hot path."""
    square = a * a
    if square < 0.25:
        c3 = 1.0 - square * (1.0 / 156.0)
        c3 = 1.0 - square * (1.0 / 110.0) * c3
        c3 = 1.0 - square * (1.0 / 72.0) * c3
        c3 = 1.0 - square * (1.0 / 42.0) * c3
        c3 = (1.0 - square * (1.0 / 20.0) * c3) / 6.0
        c2 = 1.0 - square * (1.0 / 182.0)
        c2 = 1.0 - square * (1.0 / 132.0) * c2
        c2 = 1.0 - square * (1.0 / 90.0) * c2
        c2 = 1.0 - square * (1.0 / 56.0) * c2
        c2 = 1.0 - square * (1.0 / 30.0) * c2
        c2 = 0.5 * (1.0 - square * (1.0 / 12.0) * c2)
        return 1.0 - square * c2, 1.0 - square * c3, c2, c3
    c0 = math.cos(a)
    c1 = math.sin(a) / a
    return c0, c1, (1.0 - c0) / square, (1.0 - c1) / square


def _turn_transition(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    _rodrigues(x, dt, out)


@kernel
def _add_acceleration(density: float, dt: float, wx: float, wy: float, wz: float, out: np.ndarray) -> None:
    a = math.sqrt(wx * wx + wy * wy + wz * wz) * dt
    _, _, _, c3, c4, c5, _, _ = stumpff(a)
    q = density * dt
    w = (wx * dt, wy * dt, wz * dt)
    for i in range(3):
        p = 2 * i
        out[p, p] += 2.0 * q * dt * dt * c3
        out[p + 1, p + 1] += q
        # position against velocity: int s - W s^2 c2 + W W s^3 c3, where W W = w w' - a^2
        out[p, p + 1] += q * dt * (0.5 - a * a * c4)
        for j in range(3):
            out[p, 2 * j] += 2.0 * q * dt * dt * c5 * w[i] * w[j]
            _add_above(out, p, 2 * j + 1, q * dt * c4 * w[i] * w[j])
        j = (i + 1) % 3
        k = (i + 2) % 3
        _add_above(out, p, 2 * j + 1, q * dt * c3 * w[k])
        _add_above(out, p, 2 * k + 1, -q * dt * c3 * w[j])


@kernel
def _add_above(out: np.ndarray, i: int, j: int, value: float) -> None:
    """Add to the one of (i, j) and (j, i) that lies above the diagonal."""
    out[min(i, j), max(i, j)] += value


@kernel
def _add_rate(
    density: float,
    s: float,
    wx: float,
    wy: float,
    wz: float,
    vx: float,
    vy: float,
    vz: float,
    out: np.ndarray,
) -> None:
    """Add the effect of white rate noise that came ``s`` before the end, on and above the diagonal."""
    _, c1, c2, c3, c4, c5, _, _ = stumpff(math.sqrt(wx * wx + wy * wy + wz * wz) * s)
    tx, ty, tz = _cross(wx, wy, wz, vx, vy, vz)
    nx, ny, nz = _cross(wx, wy, wz, tx, ty, tz)
    w = (wx, wy, wz)
    s2 = s * s
    # derivatives of c_k along w: (k c_(k+2) - c_(k+1)) s^2 (w . dw)
    e1 = s2 * s * (c3 - c2)
    e2 = s2 * s2 * (2.0 * c4 - c3)
    e3 = s2 * s2 * s * (3.0 * c5 - c4)
    for axis in range(3):
        dx = 1.0 if axis == 0 else 0.0
        dy = 1.0 if axis == 1 else 0.0
        dz = 1.0 if axis == 2 else 0.0
        ax, ay, az = _cross(dx, dy, dz, vx, vy, vz)
        bx, by, bz = _cross(dx, dy, dz, tx, ty, tz)
        cx, cy, cz = _cross(wx, wy, wz, ax, ay, az)
        along = w[axis]
        px = s2 * c2 * ax + e2 * along * tx + s2 * s * c3 * (bx + cx) + e3 * along * nx
        py = s2 * c2 * ay + e2 * along * ty + s2 * s * c3 * (by + cy) + e3 * along * ny
        pz = s2 * c2 * az + e2 * along * tz + s2 * s * c3 * (bz + cz) + e3 * along * nz
        ux = s * c1 * ax + e1 * along * tx + s2 * c2 * (bx + cx) + e2 * along * nx
        uy = s * c1 * ay + e1 * along * ty + s2 * c2 * (by + cy) + e2 * along * ny
        uz = s * c1 * az + e1 * along * tz + s2 * c2 * (bz + cz) + e2 * along * nz
        g = (px, ux, py, uy, pz, uz)
        for i in range(6):
            for j in range(i, 6):
                out[i, j] += density * g[i] * g[j]
            out[i, 6 + axis] += density * g[i]
        out[6 + axis, 6 + axis] += density


def _turn_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    wx = x[6]
    wy = x[7]
    wz = x[8]
    _add_acceleration(params[0], dt, wx, wy, wz, out)
    rate = math.sqrt(wx * wx + wy * wy + wz * wz)
    tx, ty, tz = _cross(wx, wy, wz, x[1], x[3], x[5])
    nx, ny, nz = _cross(wx, wy, wz, tx, ty, tz)
    for node in range(8):
        s = _NODES[node] * dt
        elapsed = dt - s
        _, c1, c2, _ = _first_stumpff(rate * elapsed)
        d1 = elapsed * c1
        d2 = elapsed * elapsed * c2
        _add_rate(
            params[1] * dt * _WEIGHTS[node],
            s,
            wx,
            wy,
            wz,
            x[1] + d1 * tx + d2 * nx,
            x[3] + d1 * ty + d2 * ny,
            x[5] + d1 * tz + d2 * nz,
            out,
        )
    for i in range(9):
        for j in range(i):
            out[i, j] = out[j, i]


def _turn_from_jet(jet: np.ndarray, params: np.ndarray, own: np.ndarray) -> None:
    floor = params[2]
    scale = 1.0 / max(jet[3] * jet[3] + jet[4] * jet[4] + jet[5] * jet[5], floor * floor)
    wx, wy, wz = _cross(jet[3], jet[4], jet[5], jet[6], jet[7], jet[8])
    own[0] = scale * wx
    own[1] = scale * wy
    own[2] = scale * wz


_TURN = Callback(_turn_transition, TRANSITION)
_TURN_NOISE = Callback(_turn_noise, NOISE)
_TURN_FROM_JET = Callback(_turn_from_jet, OWN)


def spatial_turn(
    *,
    acceleration_density: float = 1.0,
    rate_density: float = 1e-3,
    rate_sd: float = 0.3,
    speed_floor: float = 1.0,
) -> Motion:
    """Coordinated turn in space about an axis of its own.

    Model: ``p' = v, v' = w x v + u, w' = n``; white u and n (three components each). Exact by Rodrigues'
    formula; constant speed; with w not across v the path is a helix. The noise of the rate is integrated
    with eight Gauss points: relative error below 1e-9 up to a turn of 4 rad in one step, positive
    semi-definite always.

    Args:
        acceleration_density: of u; m^2/s^3.
        rate_density: of n; rad^2/s^3.
        rate_sd: prior standard deviation of each component of the rate when the intent begins (mean 0);
            rad/s.
        speed_floor: below this speed an acceleration says little about the rate; m/s.
    Returns:
        Motion with state ``x vx y vy z vz wx wy wz``.
    Raises:
        ValueError: an option is out of range.
    Source: Bar-Shalom, Li, Kirubarajan (2001) 11.7.2 carried to space. Differs: a jet gives the part of w
    across v; the part along v is 0.
    """
    caller = "spatial_turn"
    labels = ("x", "vx", "y", "vy", "z", "vz", "wx", "wy", "wz")
    params = (
        check_option(caller, "acceleration_density", acceleration_density),
        check_option(caller, "rate_density", rate_density),
        check_option(caller, "speed_floor", speed_floor, "> 0"),
    )
    return Motion(
        caller,
        labels,
        3,
        _TURN,
        params,
        units_of(labels),
        noise=_TURN_NOISE,
        own_from_jet=_TURN_FROM_JET,
        jet_order=2,
        birth_sd=(check_option(caller, "rate_sd", rate_sd),) * 3,
    )
