"""The prediction of a mode whose model is off by a bounded amount: Sayed's filter inside the bank."""

from __future__ import annotations

import numpy as np
from numba import types

from jink.estimators.compiled import call_observe, inner_kernel
from jink.estimators.kalman import gaussian_update
from jink.estimators.kinematics import kinematics_of
from jink.estimators.linalg import cholesky, copy_rows, copy_vector, multiply, solve_lower, solve_upper, wrap_angle
from jink.estimators.modes import measure_mode
from jink.estimators.pieces import MATRIX, PROGRAM, VECTOR, WORK, piece
from jink.estimators.robust import optimal_regulation, regulation_bound
from jink.estimators.unscented import point_weights

__all__ = ["hedge"]

_SMALL_STEP = 1e-4


@inner_kernel
def _seen_error(program, work, j, m, sensor, d):
    """``H M`` (d, q) of mode ``j`` into ``work.seen_error``: exact for a linear sensor, else differences at ``m``."""
    seen, present, kin, index = work.seen_error, work.present, work.kin, program.kin_index[j]
    error, n = program.error[j], program.sizes[j]
    exact = program.sensor_linear and index[0] >= 0
    for k in range(program.error_count[j]):
        if exact:
            for a in range(d):
                seen[a, k] = 0.0
                for i in range(kin.size):
                    seen[a, k] += program.sensor_matrix[present[a], i] * error[index[i], k]
            continue
        largest, size = 0.0, 1.0
        for i in range(n):
            largest = max(largest, abs(error[i, k]))
            size = max(size, abs(m[i]))
        step = _SMALL_STEP * size / largest if largest > 0.0 else 0.0
        for side in range(2):
            for i in range(n):
                work.vector[i] = m[i] + (step if side == 0 else -step) * error[i, k]
            kinematics_of(program, j, work.vector, kin)
            call_observe(program.observe, kin, sensor, program.sensor_params, work.sensed)
            for a in range(d):
                value = work.sensed[present[a]]
                if side == 0:
                    seen[a, k] = value
                    continue
                difference = seen[a, k] - value
                if program.sensor_angular[present[a]]:
                    difference = wrap_angle(difference)
                seen[a, k] = difference / (2.0 * step) if step > 0.0 else 0.0


@inner_kernel
def _best_regulation(program, work, j, bound, sensor, z, d, m, P):
    """The regulation that minimises ``G(lambda)`` of mode ``j``, given the prediction ``N(m, P)`` before hedging.

    Stacks the statement (its covariance without ``I / lambda`` in ``work.hedge_seen``, its cross covariance with the
    prediction in ``work.hedge_cross``) and the measurement, which a nonlinear sensor sees by statistical linearisation.
    """
    t, n = program.excitation_count[j], program.sizes[j]
    S, v, square = work.game[3], work.game[2], work.product
    linear, _ = measure_mode(program, work, j, m, P, sensor, z, d)
    for a in range(t):
        v[a, 0] = work.hedge_innovation[a]
        for b in range(t):
            S[a, b] = work.hedge_seen[a, b]
    if not linear:
        cholesky(P, n, work.upper)
    for b in range(d):
        for i in range(n):
            square[i, 0] = work.H[b, i] if linear else work.cross[b, i]
        if not linear:
            solve_lower(work.upper, n, square, 1)
            solve_upper(work.upper, n, square, 1)
        for a in range(t):
            S[a, t + b] = 0.0
            for i in range(n):
                S[a, t + b] += work.hedge_cross[a, i] * square[i, 0]
            S[t + b, a] = S[a, t + b]
        for a in range(d):
            S[t + a, t + b] = work.S[a, b] - work.R[a, b] + work.noise_own[a, b]
        v[t + b, 0] = work.innovation[j, b]
    return optimal_regulation(S, v, work.seen_error, bound, t, d, program.error_count[j], work.game)


@piece(types.void, PROGRAM, WORK, types.int64, VECTOR, MATRIX, VECTOR, VECTOR, types.int64, VECTOR, MATRIX)
def hedge(program, work, j, m, P, sensor, z, d, m_next, P_next):
    """Robust prediction of mode ``j``, right after `predict_mode`: the model error is unlikely to be excited.

    Model: ``0 = E_f x + E_g w + N(0, I / lambda)`` updates the prediction ``f(x) + w``; the cross covariance of
    ``f(x)`` with x is ``F P`` or, for sigma points, that of the points. ``lambda = 0`` where ``H M = 0``.

    Args:
        m, P: estimate before the prediction.
        sensor, z, d: sensor state, measurement, number of components present.
        m_next, P_next: prediction; overwritten.

    Source: Sayed (2001). Differs: the corrected matrices written as an update; nonlinear f linearised statistically.
    """
    n, t, q = program.sizes[j], program.excitation_count[j], program.error_count[j]
    E_f, E_g, Q = program.excitation[j], program.noise_excitation[j], work.Q[j]
    own, scale = work.noise_own, program.noise_scale[j]
    _seen_error(program, work, j, m_next, sensor, d)
    for a in range(d):
        for b in range(own.shape[1]):
            own[a, b] = scale * work.R[a, b] if b < d else 0.0
    for a in range(d):
        for k in range(q, work.seen_error.shape[1]):
            work.seen_error[a, k] = 0.0
    copy_rows(own, work.robust_noise, d)
    bound = regulation_bound(work.seen_error, work.robust_noise, d, q, work.robust)
    work.regulation[j] = 0.0
    if not 0.0 < bound < np.inf:
        return
    cross, noise, S, v = work.hedge_cross, work.hedge_noise, work.hedge_seen, work.hedge_innovation
    states = cross.shape[1]
    spread = work.hedge_gain  # E_f P, then E_g Q
    for a in range(t):
        v[a] = 0.0
        for c in range(n):
            v[a] -= E_f[a, c] * m[c]
        for c in range(states):
            cross[a, c] = 0.0
            spread[a, c] = 0.0
        for b in range(S.shape[1]):
            S[a, b] = 0.0
            noise[a, b] = 0.0
        for c in range(n):
            for i in range(n):
                spread[a, c] += E_f[a, i] * P[i, c]
    for a in range(t):
        for b in range(t):
            for c in range(n):
                S[a, b] += spread[a, c] * E_f[b, c]
    if program.linear[j]:
        multiply(spread, work.F_transposed[j], t, n, cross)
    else:
        radius, _, other = point_weights(n, program.tuning[0], program.tuning[1], program.tuning[2])
        for i in range(n):
            for a in range(t):
                lever = 0.0
                for c in range(n):
                    lever += E_f[a, c] * work.upper[i, c]
                lever *= other * radius
                for c in range(n):
                    cross[a, c] += lever * (work.moved[1 + i, c] - work.moved[1 + n + i, c])
    for a in range(t):
        for c in range(n):
            driven = 0.0
            for i in range(n):
                driven += E_g[a, i] * Q[i, c]
            cross[a, c] += driven
            for b in range(t):
                S[a, b] += driven * E_g[b, c]
    regulation = (1.0 + program.alpha[j]) * bound
    if program.optimise[j]:
        regulation = _best_regulation(program, work, j, bound, sensor, z, d, m_next, P_next)
    work.regulation[j] = regulation
    for a in range(t):
        noise[a, a] = 1.0 / regulation
        S[a, a] += noise[a, a]
    gaussian_update(
        m_next, P_next, noise, cross, S, v, t, n, work.hedge_factor, work.hedge_gain, work.hedge_whitened,
        work.part_mean[j], work.part_cov[j],
    )  # fmt: skip
    copy_vector(work.part_mean[j], m_next)
    copy_rows(work.part_cov[j], P_next, n)
