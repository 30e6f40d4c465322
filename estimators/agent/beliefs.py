"""What one filter believes about the noise level of a measurement, and the covariance that is honest about it.

Levels are factors on R. After every detection the belief moves on by a chain (one step per detection, whatever the
sampling) and is weighed by the densities of the filter's own innovation: a bank of noise levels whose members all
share the one filter's prediction.
"""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import inner_kernel
from jink.estimators.linalg import diagonalise

__all__ = [
    "LEVELS",
    "LEVEL_SCALES",
    "advised_inflation",
    "believe",
    "forget_levels",
    "overconfidence",
    "passage",
    "principal",
]

LEVEL_SCALES = tuple(4.0**level for level in range(8))
"""1, 4, ..., 16384: in steps of four, as in `jink.estimators.joint`."""
LEVELS = len(LEVEL_SCALES)
CALM, STAY, SURGE, BACK = 0.98, 0.95, 0.02 / 7, 0.7
"""Chance per detection to stay calm, to stay at a level, to rise to a given level; share of ends that end in calm."""
_OTHER = (1.0 - STAY) * (1.0 - BACK) / (LEVELS - 2)


@inner_kernel
def forget_levels(belief):
    """Calm with nine chances in ten, else any level."""
    belief[0] = 0.9
    for level in range(1, LEVELS):
        belief[level] = 0.1 / (LEVELS - 1)


@inner_kernel
def passage(before, now):
    """Chance to be at level ``now`` one detection after level ``before``."""
    if before == 0:
        return CALM if now == 0 else SURGE
    if now == 0:
        return (1.0 - STAY) * BACK
    return STAY if now == before else _OTHER


@inner_kernel
def principal(v, HPH, R, d, scratch, basis):
    """Axes in which R is one and H P H' diagonal: every level's covariance is diagonal there.

    Model: ``T R T' = I``, ``T HPH T' = diag(e)``, so that ``(HPH + s R)^-1 = T' diag(1 / (e + s)) T`` whatever s:
    one decomposition serves all levels.

    Args:
        v, HPH, R, d: innovation, covariance of the predicted measurement, nominal noise, number of components.
        scratch: (2 d, padded); overwritten.
        basis: result; (d + 2, padded): T, then e, then ``u = T v``. Where there is none, e is no number.

    Returns:
        ``v' R^-1 v``; not finite where there is none.
    """
    lower, turned, spread, u = scratch, scratch[d:], basis[d], basis[d + 1]
    spread[0] = np.nan
    for i in range(d):
        for j in range(i + 1):
            entry = R[i, j]
            for k in range(j):
                entry -= lower[i, k] * lower[j, k]
            if j < i:
                lower[i, j] = entry / lower[j, j]
            elif entry > 0.0:
                lower[i, i] = math.sqrt(entry)
            else:
                return np.nan
    for c in range(d):  # L^-1 HPH, then L^-1 (L^-1 HPH)'
        for i in range(d):
            entry = HPH[i, c]
            for k in range(i):
                entry -= lower[i, k] * turned[k, c]
            turned[i, c] = entry / lower[i, i]
    for r in range(d):
        for i in range(d):
            entry = turned[r, i]
            for k in range(i):
                entry -= lower[i, k] * turned[r, k]
            turned[r, i] = entry / lower[i, i]
    for i in range(d):
        for k in range(i):  # what rounding did to the symmetry
            turned[i, k] = turned[k, i] = 0.5 * (turned[i, k] + turned[k, i])
    diagonalise(turned, basis, d)
    for i in range(d):
        spread[i] = max(turned[i, i], 0.0)
    for c in range(d):  # T = Q' L^-1: its rows are the t_c with L' t_c = q_c
        for i in range(d - 1, -1, -1):
            entry = basis[i, c]
            for k in range(i + 1, d):
                entry -= lower[k, i] * basis[k, c]
            basis[i, c] = entry / lower[i, i]
    for i in range(d):
        for k in range(i):
            basis[i, k], basis[k, i] = basis[k, i], basis[i, k]
    total = 0.0
    for i in range(d):
        u[i] = 0.0
        for k in range(d):
            u[i] += basis[i, k] * v[k]
        total += u[i] * u[i] + 0.0 * spread[i]
    if not total < np.inf:
        spread[0] = np.nan
    return total


@inner_kernel
def believe(basis, d, belief, scratch):
    """Move the belief (8,) on by one detection and weigh it by ``N(v; 0, H P H' + s R)``, s over the levels.

    Args:
        basis, d: of `principal`, where it found one; number of components.
        belief: probabilities of the levels; updated.
        scratch: (1, at least 8).
    """
    spread, u, weights = basis[d], basis[d + 1], scratch[0]
    calm, total = belief[0], 0.0
    for level in range(LEVELS):
        total += belief[level]
    surging = total - calm
    belief[0] = CALM * calm + (1.0 - STAY) * BACK * surging
    for level in range(1, LEVELS):
        here = belief[level]
        belief[level] = SURGE * calm + STAY * here + _OTHER * (surging - here)
    # The last level has the least distance: against it no weight overflows, and its own is never zero.
    least, largest = 0.0, LEVEL_SCALES[LEVELS - 1]
    for i in range(d):
        least += u[i] * u[i] / (spread[i] + largest)
    total, scale = 0.0, 1.0
    for level in range(LEVELS):
        distance, ratio = 0.0, 1.0
        for i in range(d):
            variance = spread[i] + scale
            distance += u[i] * u[i] / variance
            ratio *= (spread[i] + largest) / variance
        weights[level] = belief[level] * math.exp(0.5 * (least - distance)) * math.sqrt(ratio)
        total += weights[level]
        scale *= 4.0
    for level in range(LEVELS):
        belief[level] = max(weights[level] / total, 1e-12)


@inner_kernel
def advised_inflation(HPH, R, d, belief):
    """The factor on R whose gain is the mean of the gains of all levels: best for this measurement alone.

    Model: ``1 / (p + s) = sum_l b_l / (p + s_l)``, p the mean of ``(H P H')_ii / R_ii``: exact for one component, and
    for several where H P H' is a multiple of R.
    """
    uncertainty = 0.0
    for i in range(d):
        uncertainty += HPH[i, i] / R[i, i]
    uncertainty /= d
    mean, scale = 0.0, 1.0
    for level in range(LEVELS):
        mean += belief[level] / (uncertainty + scale)
        scale *= 4.0
    advice = 1.0 / mean - uncertainty
    return advice if advice > 1.0 else 1.0


@inner_kernel
def overconfidence(basis, d, chosen, belief, scratch, believed, excess):
    """By how much an update with the noise ``chosen`` believes its estimate too much, given the belief.

    Model: the mixture of the levels has, about the estimate made, ``P+ = P - C W C'`` with ``C = P H'`` and
    ``W = sum_l b_l (S_l^-1 - (S_l^-1 - S~^-1) v v' (S_l^-1 - S~^-1))``; ``excess = S~^-1 - W``, so that
    ``P+ = P - C S~^-1 C' + C excess C'``. Summed in the axes of `principal`.

    Args:
        basis, d: of `principal`, number of components.
        chosen: the noise of the update; (d, d).
        belief: of this measurement.
        scratch: (2 d, padded).
        believed: result: W (d, d) and, in row d, ``S~^-1 v``, both in the axes of `principal`.
        excess: result; (d, d).

    Returns:
        whether all matrices were covariances; if not, the excess is zero.
    """
    axes, spread, u, inverse = basis, basis[d], basis[d + 1], scratch[d:]
    if not _chosen_inverse(axes, spread, chosen, d, scratch, inverse):
        for i in range(d):
            for k in range(d):
                excess[i, k] = 0.0
        return False
    for i in range(d):  # S~^-1 v into column 0
        total = 0.0
        for k in range(d):
            total += inverse[i, k] * u[k]
        scratch[i, 0] = total
    for i in range(d):
        for k in range(i + 1):
            informed, apart, scale = 0.0, 0.0, 1.0
            for level in range(LEVELS):
                ours, theirs = 1.0 / (spread[i] + scale), 1.0 / (spread[k] + scale)
                informed += belief[level] * ours
                apart += belief[level] * (ours * u[i] - scratch[i, 0]) * (theirs * u[k] - scratch[k, 0])
                scale *= 4.0
            entry = inverse[i, k] + apart
            if i == k:
                entry -= informed
            excess[i, k], excess[k, i] = entry, entry
            believed[i, k] = believed[k, i] = inverse[i, k] - entry
        believed[d, i] = scratch[i, 0]
    for i in range(d):  # back: T' excess T
        for c in range(d):
            scratch[i, c] = 0.0
            for k in range(d):
                scratch[i, c] += excess[i, k] * axes[k, c]
    for r in range(d):
        for c in range(d):
            excess[r, c] = 0.0
            for i in range(d):
                excess[r, c] += axes[i, r] * scratch[i, c]
    return True


@inner_kernel
def _chosen_inverse(axes, spread, chosen, d, work, out):
    """``(T (H P H' + chosen) T')^-1`` into ``out`` (d, d); ``work`` (d, padded) is overwritten."""
    for i in range(d):
        for c in range(d):
            work[i, c] = 0.0
            for k in range(d):
                work[i, c] += axes[i, k] * chosen[k, c]
    for i in range(d):
        for c in range(d):
            out[i, c] = spread[i] if i == c else 0.0
            for k in range(d):
                out[i, c] += work[i, k] * axes[c, k]
    for i in range(d):  # Cholesky factor of out into work
        for j in range(i + 1):
            entry = out[i, j]
            for k in range(j):
                entry -= work[i, k] * work[j, k]
            if j < i:
                work[i, j] = entry / work[j, j]
            elif entry > 0.0 and entry < np.inf:
                work[i, i] = math.sqrt(entry)
            else:
                return False
    for c in range(d):  # a column of the inverse by two triangular solves
        for i in range(d):
            entry = 1.0 if i == c else 0.0
            for k in range(i):
                entry -= work[i, k] * out[k, c]
            out[i, c] = entry / work[i, i]
        for i in range(d - 1, -1, -1):
            entry = out[i, c]
            for k in range(i + 1, d):
                entry -= work[k, i] * out[k, c]
            out[i, c] = entry / work[i, i]
    return True
