"""From modes to one answer: the bank's own innovation, its mode probabilities, its position and velocity."""

from __future__ import annotations

import numpy as np
from numba import types

from jink.estimators.compiled import inner_kernel
from jink.estimators.linalg import cholesky, copy_vector
from jink.estimators.modes import mode_kinematics
from jink.estimators.pieces import MATRIX, PROGRAM, STACK, VECTOR, WORK, piece

__all__ = ["bank_nis", "fuse", "mode_posterior", "posterior_nis"]


@inner_kernel
def bank_nis(work, S_modes, modes, d):
    """Innovation of the whole bank squared over its covariance: moments of the mixture of predicted measurements.

    ``S_modes`` are the modes' (M, d, d), with whatever noise. Leaves them in ``work.sensed``, ``work.S``, and
    ``L^-1 v`` in ``work.whitened``.
    """
    prior, innovation, S = work.prior, work.innovation, work.S
    mean, factor, whitened = work.sensed, work.factor, work.whitened
    for a in range(d):
        value = 0.0
        for j in range(modes):
            value += prior[j] * innovation[j, a]
        mean[a] = value
    for a in range(d):
        for b in range(d):
            value = 0.0
            for j in range(modes):
                da = innovation[j, a] - mean[a]
                db = innovation[j, b] - mean[b]
                value += prior[j] * (S_modes[j, a, b] + da * db)
            S[a, b] = value
    if not cholesky(S, d, factor):
        return 0.0, False
    nis = 0.0
    for a in range(d):
        value = mean[a]
        for k in range(a):
            value -= factor[k, a] * whitened[k, 0]
        if not factor[a, a] > 0.0:
            return 0.0, False
        whitened[a, 0] = value / factor[a, a]
        nis += whitened[a, 0] * whitened[a, 0]
    return nis, np.isfinite(nis)


@inner_kernel
def posterior_nis(work, modes):
    """NIS of a bank of noise levels: ``sum_j p_j v_j' S_j^-1 v_j`` with the posterior probabilities p, not floored.

    Its mean is d where the bank's mixture holds, as ``E[p_j(z) D_j^2(z)] = prior_j E[D_j^2 | j] = prior_j d``; the
    moments of the mixture would say less, for the highest level, however improbable, dominates their S.
    """
    prior, log_density = work.prior, work.log_density
    top = -np.inf
    for j in range(modes):
        if prior[j] > 0.0:
            top = max(top, log_density[j])
    if not abs(top) < np.inf:
        return 0.0, False
    nis, mass = 0.0, 0.0
    for j in range(modes):
        weight = prior[j] * np.exp(log_density[j] - top) if prior[j] > 0.0 else 0.0
        if weight > 0.0:
            nis += weight * work.nis[j]
            mass += weight
    nis /= mass
    return nis, np.isfinite(nis)


@inner_kernel
def mode_posterior(program, work, modes, probs):
    """Mode probabilities ``prior_j exp(log_density_j) / sum``, floored; returns the log likelihood of the bank.

    The largest log density is taken out first, so nothing under- or overflows. A mode with zero prior stays at zero.
    """
    prior, log_density = work.prior, work.log_density
    top = -np.inf
    for j in range(modes):
        if prior[j] > 0.0:
            top = max(top, log_density[j])
    if not abs(top) < np.inf:
        copy_vector(prior, probs)
        return top
    mass = 0.0
    for j in range(modes):
        probs[j] = prior[j] * np.exp(log_density[j] - top) if prior[j] > 0.0 else 0.0
        mass += probs[j]
    log_likelihood = top + np.log(mass)
    floored = 0.0
    for j in range(modes):
        probs[j] /= mass
        if probs[j] < program.min_prob and prior[j] > 0.0:
            probs[j] = program.min_prob
        floored += probs[j]
    for j in range(modes):
        probs[j] /= floored
    return log_likelihood


@piece(types.boolean, PROGRAM, WORK, MATRIX, STACK, VECTOR, VECTOR, MATRIX)
def fuse(program, work, mean, cov, probs, kin_mean, kin_cov):
    """Moments of the bank's position and velocity; returns whether all went well."""
    modes, kin = program.sizes.size, kin_mean.size
    means, covs = work.kin_modes, work.kin_covs
    good = True
    for a in range(kin):
        kin_mean[a] = 0.0
    for j in range(modes):
        good = mode_kinematics(program, work, j, mean[j], cov[j], means[j], covs[j]) and good
        for a in range(kin):
            kin_mean[a] += probs[j] * means[j, a]
    for a in range(kin):
        for b in range(a + 1):  # one triangle: a covariance is symmetric to the last bit
            value = 0.0
            for j in range(modes):
                value += probs[j] * (covs[j, a, b] + (means[j, a] - kin_mean[a]) * (means[j, b] - kin_mean[b]))
            kin_cov[a, b] = kin_cov[b, a] = value
    return good
