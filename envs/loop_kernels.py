"""Kernels of the filters in the loop: constant velocity with white acceleration, plain and with bounded model error.

Their state is laid out in `loop_filter`. It is ``[p, v]``, so ``H = [I 0]`` and F are never multiplied out. Parameters
of the plain filter: entry (0, 0) is the spectral density q. Those of the robust one go on with alpha, the sizes t of
E_f and q of M; E_f is in the next t rows, ``H M`` in the A rows after it.
"""

from __future__ import annotations

import math

from numba import njit

from jink.envs.compiled import inner_kernel
from jink.estimators.compiled import COMPILE_OPTIONS
from jink.estimators.robust import corrected_noise, excitation, linear_update, regulation_bound

__all__ = [
    "innovate_plain",
    "innovate_robust",
    "predict_plain",
    "predict_robust",
    "start_plain",
    "update_plain",
]


unrolled_kernel = njit(
    nogil=True, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True, **COMPILE_OPTIONS
)
"""As `inner_kernel`, but always copied into the caller: with a constant A its loops vanish (half the time)."""


def start_plain(prior, params, state):
    """The prior is the state."""
    for i in range(state.shape[0]):
        for j in range(8):
            state[i, j] = prior[i, j] if i < prior.shape[0] else 0.0


@unrolled_kernel
def _innovate(state, z, R, A):
    at = 2 * A + 2
    for i in range(A):
        state[at, i] = z[i] - state[0, i]
        for j in range(A):
            state[at + 1 + i, j] = state[1 + i, j]
            state[at + 1 + A + i, j] = R[i, j]


def innovate_plain(state, z, params, work):
    """``v = z - p``; ``H P H'`` is the covariance of p."""
    if z.shape[0] == 2:
        _innovate(state, z, work[0], 2)
    else:
        _innovate(state, z, work[0], 3)


@unrolled_kernel
def _update(state, R, A, cross, factor):
    """``P+ = P - W'W``, ``m+ = m + W' L^-1 v`` with ``L L' = S``, ``W = L^-1 H P``, in place.

    A missing component has a zero row in ``L^-1``, and so have all that follows from it.
    """
    n, at = 2 * A, 2 * A + 2
    for i in range(A):
        innovation, pivot, scale = state[at, i], state[1 + i, i] + R[i, i], 0.0
        for j in range(i):
            total = state[1 + i, j] + R[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = total * factor[j, 7]
            pivot -= factor[i, j] * factor[i, j]
            innovation -= factor[i, j] * cross[j, 7]
        if pivot > 0.0 and not math.isnan(innovation):
            scale = 1.0 / math.sqrt(pivot)
            cross[i, 7] = innovation * scale
        else:
            cross[i, 7] = 0.0
        factor[i, 7] = scale
        for c in range(n):
            total = state[1 + i, c]
            for k in range(i):
                total -= factor[i, k] * cross[k, c]
            cross[i, c] = total * scale
    for c in range(n):
        for i in range(A):
            state[0, c] += cross[i, c] * cross[i, 7]
        for r in range(c + 1):
            total = state[1 + r, c]
            for i in range(A):
                total -= cross[i, r] * cross[i, c]
            state[1 + r, c] = total
            state[1 + c, r] = total


def update_plain(state, params, work):
    """The Kalman update."""
    if state.shape[0] == 11:
        _update(state, work[1], 2, work[2], work[3])
    else:
        _update(state, work[1], 3, work[2], work[3])


@unrolled_kernel
def _move(state, dt, density, A):
    """``F = [I dt I; 0 I]`` and ``Q = density [dt^3/3 dt^2/2; dt^2/2 dt]`` per axis, in place."""
    half, third = 0.5 * dt * dt * density, dt * dt * dt * density / 3.0
    for i in range(A):
        state[0, i] += dt * state[0, A + i]
        for j in range(i, A):
            pv, vp, vv = state[1 + i, A + j], state[1 + j, A + i], state[1 + A + i, A + j]
            pp = state[1 + i, j] + dt * (pv + vp) + dt * dt * vv
            pv += dt * vv
            vp += dt * vv
            if i == j:
                pp += third
                pv += half
                vp = pv
                state[1 + A + i, A + i] = vv + dt * density
            state[1 + i, j] = pp
            state[1 + j, i] = pp
            state[1 + i, A + j] = pv
            state[1 + A + j, i] = pv
            state[1 + j, A + i] = vp
            state[1 + A + i, j] = vp


def predict_plain(state, dt, params, work):
    """The Kalman prediction."""
    if state.shape[0] == 11:
        _move(state, dt, params[0, 0], 2)
    else:
        _move(state, dt, params[0, 0], 3)


@inner_kernel
def _correct(state, params, A, work):
    """Regulation from the nominal R, kept in the state's memory, and the corrected noise R^."""
    t, q, R = int(params[0, 2]), int(params[0, 3]), work[0]
    HM = params[1 + t :]
    regulation = (1.0 + params[0, 1]) * regulation_bound(HM, R, A, q, work[2:])
    if not regulation < math.inf:
        regulation = 0.0
    state[2 * A + 1, 7] = regulation
    corrected_noise(R, HM, regulation, A, q, state[3 * A + 3 :])


def innovate_robust(state, z, params, work):
    """As `innovate_plain`, with R^ for R."""
    _innovate(state, z, work[0], z.shape[0])
    _correct(state, params, z.shape[0], work)


@inner_kernel
def _discount(state, params, A, work):
    """States that excite the model error are unlikely: ``0 = E_f x`` with covariance ``I / lambda``."""
    n, t = 2 * A, int(params[0, 2])
    regulation = state[2 * A + 1, 7]
    if regulation > 0.0:
        E, noise, v, m, P = params[1:], work[8], work[9, 0], work[9, 1], work[10]
        for c in range(8):
            m[c] = state[0, c]
            for i in range(n):
                P[i, c] = state[1 + i, c]
        excitation(m, E, regulation, t, n, noise, v)
        linear_update(m, P, E, noise, v, t, n, work[2:], state[0], state[1:])


def predict_robust(state, dt, params, work):
    """Sayed's prediction."""
    A = (state.shape[0] - 3) // 4
    _discount(state, params, A, work)
    _move(state, dt, params[0, 0], A)
