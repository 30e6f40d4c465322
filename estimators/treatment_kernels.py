"""What treated modes do around an ordinary update: noise before it, covariance and density after it."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from jink.estimators.compiled import call_observe, inner_kernel
from jink.estimators.factors import call_factor, normalised_innovation
from jink.estimators.kalman import gaussian_update
from jink.estimators.kinematics import kinematics_of
from jink.estimators.linalg import copy_rows, copy_vector, multiply, wrap_angle
from jink.estimators.pieces import MATRIX, PROGRAM, VECTOR, WORK, piece
from jink.estimators.robust import corrected_noise, regulation_bound
from jink.estimators.unscented import point_weights

__all__ = [
    "ADAPTING",
    "ERRING",
    "SCALED",
    "TAILED",
    "adapt_noise",
    "bounded_tails",
    "finish_treated",
    "hedge",
    "prepare_noise",
]

SCALED, ADAPTING, TAILED, ERRING = 1, 2, 4, 8
_ADAPTED, _STUDENT = 1, 2
_LOG_TWO_PI = math.log(2.0 * math.pi)
_SMALL_STEP = 1e-4


def bounded_tails(v, HPH, R, nis, thresholds, work, out):
    """``R~ = R / l`` of Student-t measurement noise, of signature `FACTOR`; thresholds are dof and iterations.

    ``l = (nu + d) / (nu + tr{(e e' + H P+ H') R^-1})``; with ``y = S^-1 v``, ``S = HPH + R / l``, the posterior
    residual is ``R y / l`` and ``H P+ H' = R / l - R S^-1 R / l^2``, so the trace is
    ``(y' R y - tr(S^-1 R)) / l^2 + d / l``.
    """
    d = v.size
    dof = thresholds[0]
    share = 1.0
    for _ in range(int(thresholds[1])):
        distance = normalised_innovation(v, HPH, R, 1.0 / share, d, work)
        if not distance < np.inf:
            break
        total = d / share
        for column in range(d + 1):  # S^-1 R column by column, then S^-1 v
            for i in range(d):
                seen = v[i] if column == d else R[i, column]
                for k in range(i):
                    seen -= work[i, k] * work[d + k, 0]
                work[d + i, 0] = seen / work[i, i]
            for i in range(d - 1, -1, -1):
                for k in range(i + 1, d):
                    work[d + i, 0] -= work[k, i] * work[d + k, 0]
                work[d + i, 0] /= work[i, i]
            if column < d:
                total -= work[d + column, 0] / (share * share)
        for i in range(d):
            for k in range(d):
                total += work[d + i, 0] * R[i, k] * work[d + k, 0] / (share * share)
        share = (dof + d) / (dof + max(total, 0.0))
    for i in range(d):
        for k in range(d):
            out[i, k] = R[i, k] / share


@piece(types.void, PROGRAM, WORK, types.int64, types.int64)
def prepare_noise(program, work, j, d):
    """R of mode ``j``: the level's, and under model error ``R^ = R - H M M' H' / lambda``; keeps the nominal one."""
    R, kept, own, scale = work.R, work.noise_kept, work.noise_own, program.noise_scale[j]
    for a in range(d):
        for b in range(d):
            kept[a, b] = R[a, b]
            own[a, b] = scale * R[a, b]
            R[a, b] = own[a, b]
    if program.treated[j] & ERRING:
        corrected_noise(own, work.seen_error, work.regulation[j], d, program.error_count[j], R)


@inner_kernel
def _cap(R_new, R, cap, d):
    """Shrink rows and columns of R~ whose variance exceeds ``cap`` times that of R."""
    for a in range(d):
        most = cap * R[a, a]
        if R_new[a, a] > most:
            shrink = math.sqrt(most / R_new[a, a])
            for b in range(d):
                R_new[a, b] *= shrink
                R_new[b, a] *= shrink


@piece(types.float64, PROGRAM, WORK, types.int64, types.int64)
def adapt_noise(program, work, j, d):
    """Put R~ in the place of R, in ``work.R`` and ``work.S``, after `measure_mode`; returns the mode's log density.

    The statistic uses the nominal R, so that chi-square thresholds mean what they say.
    """
    S, R, own, HPH, R_new = work.S, work.R, work.noise_own, work.HPH, work.noise_new
    v, scratch = work.innovation[j], work.statistic
    for a in range(d):
        for b in range(d):
            HPH[a, b] = S[a, b] - R[a, b]
    nis = normalised_innovation(v, HPH, own, 1.0, d, scratch)
    if not nis < np.inf:
        return 0.0
    log_density = 0.0
    for a in range(d):
        log_density -= np.log(scratch[a, a])
    if program.density[j] == _STUDENT:
        dof = program.dof[j]
        log_density += program.density_constant[j, d - 1] - 0.5 * (dof + d) * np.log1p(nis / dof)
    else:
        log_density -= 0.5 * (d * _LOG_TWO_PI + nis)
    call_factor(program.factor[j], v[:d], HPH, R, nis, program.thresholds[j, d - 1], scratch, R_new)
    _cap(R_new, own, program.cap[j], d)
    for a in range(d):
        for b in range(d):
            R[a, b] = R_new[a, b]
            S[a, b] = HPH[a, b] + R_new[a, b]
    return log_density


@piece(types.float64, PROGRAM, WORK, types.int64, types.int64, types.float64, types.float64, types.float64, MATRIX)
def finish_treated(program, work, j, d, nominal, gaussian, nis, P_out):
    """Restore R, finish a Student-t update; returns the log density that weighs mode ``j``.

    Model: in covariances, ``P+ <- c (nu + D^2) / (nu + d) (P - K S K')`` with ``D^2 = T v' S^-1 v``,
    ``T = nu / (nu - 2)``, c of the dof reset; density ``St(v; 0, S / T, nu)``.
    Source: CN109491241B; Roth, Ozkan, Gustafsson (2013). Differs: covariances in place of scale matrices.
    """
    copy_rows(work.noise_kept, work.R, d)
    treated = program.treated[j]
    if treated & ADAPTING:
        return gaussian if program.density[j] == _ADAPTED else nominal
    if not treated & TAILED:
        return gaussian
    dof = program.dof[j]
    spread = dof / (dof - 2.0)
    distance = spread * nis
    scale = program.reset_scale[j, d - 1] * (dof + distance) / (dof + d)
    n = program.sizes[j]
    for i in range(n):
        for k in range(n):
            P_out[i, k] *= scale
    half_determinant = gaussian + 0.5 * (d * _LOG_TWO_PI + nis)  # minus ln|S| / 2
    return (
        program.density_constant[j, d - 1]
        + half_determinant
        + 0.5 * d * np.log(spread)
        - 0.5 * (dof + d) * np.log1p(distance / dof)
    )


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


@piece(types.void, PROGRAM, WORK, types.int64, VECTOR, MATRIX, VECTOR, types.int64, VECTOR, MATRIX)
def hedge(program, work, j, m, P, sensor, d, m_next, P_next):
    """Robust prediction of mode ``j``, right after `predict_mode`: the model error is unlikely to be excited.

    Model: ``0 = E_f x + E_g w + N(0, I / lambda)`` updates the prediction ``f(x) + w``; the cross covariance of
    ``f(x)`` with x is ``F P`` or, for sigma points, that of the points. ``lambda = 0`` where ``H M = 0``.

    Args:
        m, P: estimate before the prediction.
        sensor, d: sensor state, number of components present.
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
    regulation = (1.0 + program.alpha[j]) * regulation_bound(work.seen_error, work.robust_noise, d, q, work.robust)
    work.regulation[j] = 0.0
    if not 0.0 < regulation < np.inf:
        return
    work.regulation[j] = regulation
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
        noise[a, a] = 1.0 / regulation
        S[a, a] = noise[a, a]
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
    gaussian_update(
        m_next, P_next, noise, cross, S, v, t, n, work.hedge_factor, work.hedge_gain, work.hedge_whitened,
        work.part_mean[j], work.part_cov[j],
    )  # fmt: skip
    copy_vector(work.part_mean[j], m_next)
    copy_rows(work.part_cov[j], P_next, n)
