"""What treated modes do around an ordinary update: noise before it, covariance and density after it."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from jink.estimators.compiled import inner_kernel
from jink.estimators.factors import call_factor, normalised_innovation
from jink.estimators.linalg import copy_rows
from jink.estimators.pieces import MATRIX, PROGRAM, WORK, piece
from jink.estimators.robust import corrected_noise

__all__ = [
    "ADAPTING",
    "ERRING",
    "SCALED",
    "TAILED",
    "adapt_noise",
    "bounded_tails",
    "finish_treated",
    "prepare_noise",
]

SCALED, ADAPTING, TAILED, ERRING = 1, 2, 4, 8
_ADAPTED, _STUDENT = 1, 2
_LOG_TWO_PI = math.log(2.0 * math.pi)


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


@inner_kernel
def _forget_at_most(program, j, scale, P):
    """A covariance multiplied by ``scale`` may not make an own parameter less known than at its birth.

    Of nonlinear modes: a gross outlier multiplies all variances by ``D^2 / (nu + d)``, that of a turn rate as well; a
    few in a row, and sigma points of 1e20 rad/s throw the mode to where no measurement fetches it back.
    """
    n = program.sizes[j]
    for k in range(program.own_counts[j]):
        i = program.own_index[j, k]
        most = max(program.birth_cov[j, k, k], P[i, i] / scale)
        if P[i, i] > most > 0.0:
            shrink = math.sqrt(most / P[i, i])
            for c in range(n):
                P[i, c] *= shrink
                P[c, i] *= shrink


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
    if not program.linear[j]:
        _forget_at_most(program, j, scale, P_out)
    half_determinant = gaussian + 0.5 * (d * _LOG_TWO_PI + nis)  # minus ln|S| / 2
    return (
        program.density_constant[j, d - 1]
        + half_determinant
        + 0.5 * d * np.log(spread)
        - 0.5 * (dof + d) * np.log1p(distance / dof)
    )
