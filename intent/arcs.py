"""Arcs of constant shape parameters through a position: displacement, velocity, and how they depend on the start.

In the plane of v and a, with complex numbers along v and across it, ``lambda = a / v = g + i |w|`` and

    d(s) = s phi(lambda s) v,   phi(z) = (e^z - 1) / z;      d'(s) = e^(lambda s) v.

Both are analytic in v and a, so a derivative is a complex factor too (``re P + im R``: P projects onto the plane, R
turns by 90 degrees in it); perpendicular to the plane, d is ``alpha v + beta a`` with scalars that do not change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Plane", "arc", "carried", "plane_of", "shape_of"]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
_TINY = 1e-300


class Plane(NamedTuple):
    """Where arcs run: lambda (K,), speed (K,), unit vectors along v and across it (K, A)."""

    rate: Complexes
    speed: Floats
    along: Floats
    across: Floats


def plane_of(v: Floats, a: Floats) -> Plane:
    """The plane of velocity and acceleration (K, A); in 2-D the turn keeps its sign."""
    speed = np.sqrt(np.maximum(np.sum(v * v, axis=1), _TINY))
    along = v / speed[:, None]
    growth = np.sum(along * a, axis=1) / speed
    if v.shape[1] == 2:
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    else:
        side = a - (growth * speed)[:, None] * along
        least = np.eye(3)[np.argmin(np.abs(along), axis=1)]  # any perpendicular serves where a is along v
        size = np.linalg.norm(side, axis=1, keepdims=True)
        side = np.where(size > 1e-12 * np.linalg.norm(a, axis=1, keepdims=True), side, np.cross(along, least))
        across = side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), _TINY)
    return Plane(growth + 1j * np.sum(across * a, axis=1) / speed, speed, along, across)


def _functions(z: Complexes) -> tuple[Complexes, Complexes]:
    """``phi(z) = (e^z - 1) / z`` and its derivative, by their series near 0."""
    near = np.abs(z) < 1e-3  # below it four terms of the series are exact to rounding
    safe = np.where(near, 1.0, z)
    grown = np.expm1(safe)
    phi = np.where(near, 1.0 + z * (1 / 2 + z * (1 / 6 + z / 24)), grown / safe)
    slope = np.where(near, 1 / 2 + z * (1 / 3 + z * (1 / 8 + z / 30)), (grown + 1.0 - phi) / safe)
    return phi, slope


def arc(v: Floats, a: Floats, s: Floats) -> tuple[Floats, Floats, Floats]:
    """Displacement after ``s`` and its derivatives with respect to v and a.

    Args:
        v: velocity (K, A), m/s.
        a: acceleration (K, A), m/s^2.
        s: times (K, W), s.

    Returns:
        d (K, W, A), m; derivatives (K, W, A, A) with respect to v and to a; rows are components of d.
    """
    at = plane_of(v, a)
    z = at.rate[:, None] * s
    phi, slope = _functions(z)
    reach = s * phi
    d = reach.real[..., None] * v[:, None] + (reach.imag * at.speed[:, None])[..., None] * at.across[:, None]
    by_v, by_a = reach - s * z * slope, s**2 * slope
    alpha = beta = None
    if v.shape[1] == 3:
        g, turn = at.rate.real[:, None], at.rate.imag[:, None]
        straight = np.abs(turn * s) < 1e-4
        beta = np.where(straight, by_a.real, reach.imag / np.where(straight, 1.0, turn))
        alpha = reach.real - g * beta
    return d, _spread(at, by_v, alpha), _spread(at, by_a, beta)


def _spread(at: Plane, factor: Complexes, rest: Floats | None) -> Floats:
    """Complex factors in the plane, and in space ``rest`` perpendicular to it, as matrices (K, W, A, A)."""
    A = at.along.shape[1]
    e, f = at.along, at.across
    flat = e[:, :, None] * e[:, None, :] + f[:, :, None] * f[:, None, :]
    turn = f[:, :, None] * e[:, None, :] - e[:, :, None] * f[:, None, :]
    out = factor.real[..., None, None] * flat[:, None] + factor.imag[..., None, None] * turn[:, None]
    if rest is not None:
        out += rest[..., None, None] * (np.eye(A) - flat)[:, None]
    return np.asarray(out)


def carried(jet: Floats, s: Floats) -> tuple[Floats, Floats]:
    """Position and velocity ``s`` (K,) seconds along the arcs of jets (K, 3 A), and their Jacobian (K, 2 A, 3 A)."""
    A = jet.shape[1] // 3
    p, v, a = jet[:, :A], jet[:, A : 2 * A], jet[:, 2 * A :]
    d, by_v, by_a = (part[:, 0] for part in arc(v, a, s[:, None]))
    at = plane_of(v, a)
    z = at.rate * s
    grown = np.exp(z)
    ahead = grown.real[:, None] * v + (grown.imag * at.speed)[:, None] * at.across
    J = np.zeros((len(jet), 2 * A, 3 * A))
    J[:, range(A), range(A)] = 1.0
    J[:, :A, A : 2 * A], J[:, :A, 2 * A :] = by_v, by_a
    slope_v, slope_a = grown * (1.0 - z), s * grown
    flat = at.along[:, :, None] * at.along[:, None, :] + at.across[:, :, None] * at.across[:, None, :]
    turn = at.across[:, :, None] * at.along[:, None, :] - at.along[:, :, None] * at.across[:, None, :]
    out = np.eye(A) - flat  # zero in the plane
    straight = np.abs(at.rate.imag * s) < 1e-4
    beta = np.where(straight, s * grown.real, grown.imag / np.where(straight, 1.0, at.rate.imag))
    alpha = grown.real - at.rate.real * beta
    for columns, factor, rest in ((slice(A, 2 * A), slope_v, alpha), (slice(2 * A, 3 * A), slope_a, beta)):
        J[:, A:, columns] = (
            factor.real[:, None, None] * flat + factor.imag[:, None, None] * turn + rest[:, None, None] * out
        )
    return np.concatenate([p + d, ahead], axis=1), J


def shape_of(v: Floats, a: Floats) -> tuple[Floats, Floats]:
    """Shape parameters ``(g, w)`` of velocity and acceleration (K, A), and the Jacobian (K, E, 2 A)."""
    K, A = v.shape
    square = np.maximum(np.sum(v * v, axis=1), _TINY)[:, None]
    growth = np.sum(v * a, axis=1, keepdims=True) / square
    J = np.zeros((K, 2 if A == 2 else 4, 2 * A))
    J[:, 0, :A] = (a - 2.0 * growth * v) / square
    J[:, 0, A:] = v / square
    if A == 2:
        turn = (v[:, :1] * a[:, 1:] - v[:, 1:] * a[:, :1]) / square
        J[:, 1, :2] = (np.stack([a[:, 1], -a[:, 0]], axis=1) - 2.0 * turn * v) / square
        J[:, 1, 2:] = np.stack([-v[:, 1], v[:, 0]], axis=1) / square
    else:
        turn = np.cross(v, a) / square
        J[:, 1:, :3] = (-_cross_matrix(a) - 2.0 * turn[:, :, None] * v[:, None, :]) / square[..., None]
        J[:, 1:, 3:] = _cross_matrix(v) / square[..., None]
    return np.concatenate([growth, turn], axis=1), J


def _cross_matrix(u: Floats) -> Floats:
    """``[u x]``; (K, 3, 3)."""
    out = np.zeros((len(u), 3, 3))
    out[:, 2, 1], out[:, 0, 2], out[:, 1, 0] = u[:, 0], u[:, 1], u[:, 2]
    out[:, 1, 2], out[:, 2, 0], out[:, 0, 1] = -u[:, 0], -u[:, 1], -u[:, 2]
    return out
