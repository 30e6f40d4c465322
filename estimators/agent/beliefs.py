"""What one filter believes about the noise level of a measurement, and the covariance that is honest about it.

Levels are factors on R. After every detection the belief moves on by a chain (one step per detection, whatever the
sampling) and is weighed by the densities of the filter's own innovation: a bank of noise levels whose members all
share the one filter's prediction.
"""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import inner_kernel
from jink.estimators.factors import normalised_innovation

__all__ = ["LEVELS", "LEVEL_SCALES", "advised_inflation", "believe", "forget_levels", "overconfidence"]

LEVEL_SCALES = tuple(4.0**level for level in range(8))
"""1, 4, ..., 16384: in steps of four, as in `jink.estimators.joint`."""
LEVELS = len(LEVEL_SCALES)
CALM, STAY, SURGE, BACK = 0.98, 0.95, 0.02 / 7, 0.4
"""Chance per detection to stay calm, to stay at a level, to rise to a given level; share of ends that end in calm."""
_OTHER = (1.0 - STAY) * (1.0 - BACK) / (LEVELS - 2)


@inner_kernel
def forget_levels(belief):
    """Calm with nine chances in ten, else any level."""
    belief[0] = 0.9
    for level in range(1, LEVELS):
        belief[level] = 0.1 / (LEVELS - 1)


@inner_kernel
def believe(v, HPH, R, d, belief, scratch):
    """Move the belief (8,) on by one detection and weigh it by ``N(v; 0, H P H' + s R)``, s over the levels.

    Args:
        v, HPH, R, d: innovation, covariance of the predicted measurement, nominal noise, number of components.
        belief: probabilities of the levels; updated; left at its prediction where no density is a number.
        scratch: (2 d + 1, padded), rows of at least eight.
    """
    weights = scratch[2 * d]
    calm, total = belief[0], 0.0
    for level in range(LEVELS):
        total += belief[level]
    surging = total - calm
    belief[0] = CALM * calm + (1.0 - STAY) * BACK * surging
    for level in range(1, LEVELS):
        here = belief[level]
        belief[level] = SURGE * calm + STAY * here + _OTHER * (surging - here)
    best, scale = -np.inf, 1.0
    for level in range(LEVELS):
        distance = normalised_innovation(v, HPH, R, scale, d, scratch)
        determinant = 1.0
        for i in range(d):
            determinant *= scratch[i, i]
        weights[level] = -0.5 * distance - math.log(determinant) + math.log(belief[level])
        if not weights[level] > -np.inf:  # also where it is no number
            weights[level] = -np.inf
        best = max(best, weights[level])
        scale *= 4.0
    if not best > -np.inf:
        return
    total = 0.0
    for level in range(LEVELS):
        weights[level] = math.exp(weights[level] - best)
        total += weights[level]
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
def overconfidence(v, HPH, R, chosen, d, belief, scratch, excess):
    """By how much an update with the noise ``chosen`` believes its estimate too much, given the belief.

    Model: the mixture of the levels has, about the estimate made, ``P+ = P - C W C'`` with ``C = P H'`` and
    ``W = sum_l b_l (S_l^-1 - (S_l^-1 - S~^-1) v v' (S_l^-1 - S~^-1))``; ``excess = S~^-1 - W``, so that
    ``P+ = P - C S~^-1 C' + C excess C'``.

    Args:
        v, HPH, R, chosen, d: innovation, predicted covariance, nominal and chosen noise, components.
        belief: of this measurement.
        scratch: (5 d + 1, padded).
        excess: result; (d, d).

    Returns:
        whether all matrices were covariances; if not, the excess is zero.
    """
    inverse, ours, seen = scratch[2 * d :], scratch[3 * d :], scratch[4 * d :]
    good = _inverse(v, HPH, chosen, 1.0, d, scratch, ours)
    for i in range(d):
        seen[i, 0] = 0.0
        for k in range(d):
            seen[i, 0] += ours[i, k] * v[k]
            excess[i, k] = ours[i, k]
    scale = 1.0
    for level in range(LEVELS):
        good = _inverse(v, HPH, R, scale, d, scratch, inverse) and good
        for i in range(d):
            seen[i, 1] = -seen[i, 0]
            for k in range(d):
                seen[i, 1] += inverse[i, k] * v[k]
        for i in range(d):
            for k in range(d):
                excess[i, k] -= belief[level] * (inverse[i, k] - seen[i, 1] * seen[k, 1])
        scale *= 4.0
    for i in range(d):
        for k in range(d):
            good = good and abs(excess[i, k]) < np.inf
    if not good:
        for i in range(d):
            for k in range(d):
                excess[i, k] = 0.0
    return good


@inner_kernel
def _inverse(v, HPH, R, scale, d, scratch, out):
    """``(H P H' + scale R)^-1``; (d, d)."""
    if not normalised_innovation(v, HPH, R, scale, d, scratch) < np.inf:
        return False
    for c in range(d):
        for i in range(d):  # L^-1, column by column
            total = 1.0 if i == c else 0.0
            for k in range(c, i):
                total -= scratch[i, k] * scratch[d + k, c]
            scratch[d + i, c] = total / scratch[i, i] if i >= c else 0.0
    for i in range(d):
        for j in range(d):
            total = 0.0
            for k in range(max(i, j), d):
                total += scratch[d + k, i] * scratch[d + k, j]
            out[i, j] = total
    return True
