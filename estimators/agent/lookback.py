"""The last measurement judged again when the next one comes: what one filter believed can be taken back once.

A surge shows itself by two large innovations, not by one; a filter that has believed the first is off when the second
comes. Here an update leaves behind what it did, in the directions in which it moved the state, and the next measurement
says how it should have been: over the pairs of noise levels (then, now), with both innovations.

Model: with ``D = F C T'`` (C the cross covariance of the last update, T, e, u its `beliefs.principal`, F what has
happened since) level l of the last measurement would have moved the prediction by ``D (a_l u - eta)`` and its
covariance by ``D (W - diag(a_l)) D'``, ``a_l = 1 / (e + s_l)``, where eta and W are those that were used. So the
present innovation less what l would have changed is ``v - g (a_l u - eta)``, its covariance ``H P H' + g (W -
diag(a_l)) g' + s R`` with ``g = H D``: 64 densities of a few components instead of eight filters. The last measurement
is then used with the gain and the covariance of the mixture of levels that both innovations speak for. A generalised
pseudo-Bayesian estimator of the second order whose filters are never run; for linear motions.

Source: ours; the collapse is GPB2's (Ackerson & Fu 1970; Blom & Bar-Shalom 1988).
"""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.agent.beliefs import LEVEL_SCALES, LEVELS, passage, principal
from jink.estimators.compiled import inner_kernel
from jink.estimators.factors import normalised_innovation

__all__ = ["carry", "forget_update", "kept_size", "reconsider", "remember_update"]

_CALM, _ORDINARY = 0.9, 4.0
"""Probability of calm, and D^2 per component, at which there is nothing to judge again: it would change the score of an
agent by less than 0.0002, and takes as long as all the rest."""
_NEGLIGIBLE, _OUT_OF_REACH = 1e-4, 60.0
"""A level less probable than this is not looked at again; nor is a present level whose D^2 is by so much larger."""


def kept_size(n: int, components: int) -> int:
    """Numbers kept of an update, of n states and D components: D (n D), W (D D), e, u, eta, components present."""
    return n * components + components * components + 3 * components + 1


@inner_kernel
def forget_update(kept):
    """There is nothing to take back."""
    kept[kept.size - 1] = 0.0


@inner_kernel
def remember_update(kept, n, D, cross, basis, d, believed):
    """Keep what an update did.

    Args:
        kept: of this target; (`kept_size`,).
        n, D: states, components of the sensor.
        cross: ``(P H')'``; (d, n).
        basis, d: of `beliefs.principal`, components present.
        believed: W and, in row d, eta, as `beliefs.overconfidence` gave them.
    """
    first = n * D
    for c in range(d):
        for i in range(n):
            total = 0.0
            for a in range(d):
                total += cross[a, i] * basis[c, a]
            kept[i * D + c] = total
        for k in range(d):
            kept[first + c * D + k] = believed[c, k]
        at = first + D * D + c
        kept[at], kept[at + D], kept[at + 2 * D] = basis[d, c], basis[d + 1, c], believed[d, c]
    kept[kept.size - 1] = d


@inner_kernel
def carry(kept, n, D, F_transposed, moved):
    """``D <- F D``: a prediction moves what the update did along.

    Args:
        kept, n, D: as in `remember_update`.
        F_transposed: (n, n).
        moved: scratch (n,).
    """
    for c in range(int(kept[kept.size - 1])):
        for i in range(n):
            total = 0.0
            for k in range(n):
                total += F_transposed[k, i] * kept[k * D + c]
            moved[i] = total
        for i in range(n):
            kept[i * D + c] = moved[i]


@inner_kernel
def reconsider(kept, n, D, v, HPH, R, d, g, belief, scratch, tilted, basis, change, m, P):
    """Use the last measurement as this one suggests; the prediction changes, the update is kept no longer.

    Args:
        kept, n, D: as in `remember_update`.
        v, HPH, R, d: of the present measurement: innovation, covariance of its prediction, nominal noise, components.
        g: ``H D``; (d, components of the last measurement).
        belief: of the last measurement; (8,).
        scratch: (4 d + 1, padded), rows of at least eight.
        tilted, change: scratch (D, padded).
        basis: scratch (d + 2, padded).
        m, P: prediction; (n,), (n, n); changed in place.

    Returns:
        whether there was something to reconsider and everything was a number.
    """
    last = int(kept[kept.size - 1])
    kept[kept.size - 1] = 0.0
    if last == 0 or (belief[0] > _CALM and normalised_innovation(v, HPH, R, 1.0, d, scratch) < _ORDINARY * d):
        return False
    first = n * D
    e, u, eta = kept[first + D * D :], kept[first + D * D + D :], kept[first + D * D + 2 * D :]
    spreads, seen, weights = scratch[2 * d :], scratch[3 * d :], scratch[4 * d]
    for a in range(d):
        for b in range(d):
            total = HPH[a, b]
            for i in range(last):
                for k in range(last):
                    total += g[a, i] * kept[first + i * D + k] * g[b, k]
            change[a, b] = total
    scale, largest, least, nearest = 1.0, LEVEL_SCALES[LEVELS - 1], np.inf, -1
    for level in range(LEVELS):
        if belief[level] > _NEGLIGIBLE:
            for a in range(d):
                weights[a] = v[a]
                for b in range(d):
                    tilted[a, b] = change[a, b]
            for i in range(last):
                informed = 1.0 / (e[i] + scale)
                moved = informed * u[i] - eta[i]
                for a in range(d):
                    weights[a] -= g[a, i] * moved
                    for b in range(d):
                        tilted[a, b] -= informed * g[a, i] * g[b, i]
            if not principal(weights, tilted, R, d, scratch, basis) < np.inf:
                return False
            distance = 0.0
            for i in range(d):
                spreads[i, level], seen[i, level] = basis[d, i], basis[d + 1, i]
                distance += seen[i, level] * seen[i, level] / (spreads[i, level] + largest)
            if distance < least:
                least, nearest = distance, level
        scale *= 4.0
    total, against = 0.0, 1.0
    for i in range(d):
        against *= spreads[i, nearest] + largest
    for level in range(LEVELS):
        mass, scale = 0.0, 1.0
        if belief[level] > _NEGLIGIBLE:
            for now in range(LEVELS):
                distance, ratio = -least, against
                for i in range(d):
                    informed = 1.0 / (spreads[i, level] + scale)
                    distance += seen[i, level] * seen[i, level] * informed
                    ratio *= informed
                if distance < _OUT_OF_REACH:
                    mass += passage(level, now) * math.exp(-0.5 * distance) * math.sqrt(ratio)
                scale *= 4.0
        weights[level] = belief[level] * mass
        total += weights[level]
    for level in range(LEVELS):
        weights[level] /= total
    for i in range(last):  # the mean gain: row 0; how much it differs from what was used: row 1 of the scratch
        mean, scale = 0.0, 1.0
        for level in range(LEVELS):
            mean += weights[level] / (e[i] + scale)
            scale *= 4.0
        scratch[0, i] = mean * u[i]
        for k in range(i + 1):
            spread, scale = 0.0, 1.0
            for level in range(LEVELS):
                spread += (
                    weights[level] * (u[i] / (e[i] + scale) - scratch[0, i]) * (u[k] / (e[k] + scale) - scratch[0, k])
                )
                scale *= 4.0
            entry = kept[first + i * D + k] + spread
            if i == k:
                entry -= mean
            change[i, k], change[k, i] = entry, entry
        if not (abs(scratch[0, i]) < np.inf and abs(change[i, i]) < np.inf):
            return False
    for r in range(n):
        for i in range(last):
            m[r] += kept[r * D + i] * (scratch[0, i] - eta[i])
        for c in range(r + 1):
            entry = P[r, c]
            for i in range(last):
                for k in range(last):
                    entry += kept[r * D + i] * change[i, k] * kept[c * D + k]
            P[r, c], P[c, r] = entry, entry
    return True
