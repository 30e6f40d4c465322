"""Measurement of a position by one mode, and the mode probabilities; and back."""

from __future__ import annotations

import math

from jink.estimators.compiled import kernel

__all__ = ["posterior", "posterior_adjoint", "update", "update_adjoint"]

_LOG_TWO_PI = math.log(2.0 * math.pi)


@kernel
def _inverse(axes, S, out):
    """Inverse of a symmetric 2 x 2 or 3 x 3 matrix by its Cholesky factor; (half log determinant, whether definite)."""
    a = S[0, 0]
    if not a > 0.0:
        return 0.0, False
    l00 = math.sqrt(a)
    l10 = S[0, 1] / l00
    b = S[1, 1] - l10 * l10
    if not b > 0.0:
        return 0.0, False
    l11 = math.sqrt(b)
    half = math.log(l00) + math.log(l11)
    i00 = 1.0 / l00
    i11 = 1.0 / l11
    i10 = -l10 * i00 * i11
    if axes == 2:
        out[0, 0] = i00 * i00 + i10 * i10
        out[0, 1] = i10 * i11
        out[1, 0] = out[0, 1]
        out[1, 1] = i11 * i11
        return half, True
    l20 = S[0, 2] / l00
    l21 = (S[1, 2] - l20 * l10) / l11
    c = S[2, 2] - l20 * l20 - l21 * l21
    if not c > 0.0:
        return 0.0, False
    l22 = math.sqrt(c)
    i22 = 1.0 / l22
    i21 = -l21 * i11 * i22
    i20 = -(l20 * i00 + l21 * i10) * i22
    out[0, 0] = i00 * i00 + i10 * i10 + i20 * i20
    out[0, 1] = i10 * i11 + i20 * i21
    out[0, 2] = i20 * i22
    out[1, 1] = i11 * i11 + i21 * i21
    out[1, 2] = i21 * i22
    out[2, 2] = i22 * i22
    out[1, 0] = out[0, 1]
    out[2, 0] = out[0, 2]
    out[2, 1] = out[1, 2]
    return half + math.log(l22), True


@kernel
def update(axes, n, m, P, z, R, inverse, gain, white, m_out, P_out):
    """Posterior of a position measurement; returns (log density, whether the innovation had a covariance).

    ``inverse`` (A, A) returns ``S^-1``, ``gain`` (N, A) the gain, ``white`` (A,) ``S^-1 v``; ``P_out`` may be ``P``.
    """
    for a in range(axes):
        for b in range(axes):
            gain[a, b] = P[2 * a, 2 * b] + R[a, b]
    half, good = _inverse(axes, gain, inverse)
    if not good:
        return 0.0, False
    nis = 0.0
    for a in range(axes):
        total = 0.0
        for b in range(axes):
            total += inverse[a, b] * (z[b] - m[2 * b])
        white[a] = total
        nis += total * (z[a] - m[2 * a])
    for i in range(n):
        for a in range(axes):
            total = 0.0
            for b in range(axes):
                total += P[i, 2 * b] * inverse[b, a]
            gain[i, a] = total
    for i in range(n):
        total = 0.0
        for a in range(axes):
            total += P[i, 2 * a] * white[a]
        m_out[i] = m[i] + total
        for j in range(i, n):
            value = P[i, j]
            for a in range(axes):
                value -= gain[i, a] * P[2 * a, j]
            P_out[i, j] = value
    for i in range(n):
        for j in range(i):
            P_out[i, j] = P_out[j, i]
    return -0.5 * (axes * _LOG_TWO_PI + nis) - half, True


@kernel
def update_adjoint(axes, n, P, inverse, gain, white, density_bar, m_bar, P_bar, through, S_bar, R_bar):
    """From derivatives by the posterior, in place, those by the prediction; added to ``R_bar`` (A, A).

    ``through`` (N, A) and ``S_bar`` (A, A) are scratch; ``P_bar`` symmetric.
    """
    for i in range(n):
        for a in range(axes):
            total = 0.0
            for j in range(n):
                total += P_bar[i, j] * gain[j, a]
            through[i, a] = total
    for a in range(axes):
        for b in range(axes):
            total = 0.5 * density_bar * (white[a] * white[b] - inverse[a, b])
            for i in range(n):
                total += gain[i, a] * through[i, b] - 0.5 * m_bar[i] * (gain[i, a] * white[b] + gain[i, b] * white[a])
            S_bar[a, b] = total
    for a in range(axes):
        for b in range(axes):
            R_bar[a, b] += S_bar[a, b]
    # of the cross covariance P[:, position]: m_bar white' - 2 P_bar gain, half of it on either side
    for i in range(n):
        for a in range(axes):
            value = 0.5 * m_bar[i] * white[a] - through[i, a]
            P_bar[i, 2 * a] += value
            P_bar[2 * a, i] += value
    for a in range(axes):
        for b in range(axes):
            P_bar[2 * a, 2 * b] += S_bar[a, b]
    for a in range(axes):
        total = -density_bar * white[a]
        for i in range(n):
            total += gain[i, a] * m_bar[i]
        white[a] = total
    for a in range(axes):
        m_bar[2 * a] -= white[a]


@kernel
def posterior(prior, density, temper, floor, modes, probs):
    """Mode probabilities from tempered log densities, floored; returns the log likelihood of the row."""
    top = -math.inf
    for p in range(modes):
        if prior[p] > 0.0:
            top = max(top, temper * density[p])
    mass = 0.0
    for p in range(modes):
        probs[p] = prior[p] * math.exp(temper * density[p] - top) if prior[p] > 0.0 else 0.0
        mass += probs[p]
    total = 0.0
    for p in range(modes):
        probs[p] /= mass
        if prior[p] > 0.0 and probs[p] < floor:
            probs[p] = floor
        total += probs[p]
    for p in range(modes):
        probs[p] /= total
    return (top + math.log(mass)) / temper


@kernel
def posterior_adjoint(prior, density, temper, floor, modes, probs_bar, value_bar, share, prior_bar, density_bar):
    """From derivatives by the probabilities and by the row's log likelihood, those by priors and densities.

    Writes ``prior_bar`` and ``density_bar``; ``share`` (M,) is scratch.
    """
    top = -math.inf
    for p in range(modes):
        if prior[p] > 0.0:
            top = max(top, temper * density[p])
    mass = 0.0
    for p in range(modes):
        share[p] = prior[p] * math.exp(temper * density[p] - top) if prior[p] > 0.0 else 0.0
        mass += share[p]
    total = 0.0
    inner = 0.0
    for p in range(modes):
        share[p] /= mass
        kept = floor if prior[p] > 0.0 and share[p] < floor else share[p]
        total += kept
        inner += probs_bar[p] * kept
    inner /= total
    mean = 0.0
    for p in range(modes):
        floored = prior[p] > 0.0 and share[p] < floor
        prior_bar[p] = 0.0 if floored else (probs_bar[p] - inner) / total
        mean += prior_bar[p] * share[p]
    for p in range(modes):
        e_bar = (prior_bar[p] - mean + value_bar / temper) / mass
        if prior[p] > 0.0:
            prior_bar[p] = e_bar * math.exp(temper * density[p] - top)
            density_bar[p] = temper * e_bar * share[p] * mass
        else:
            prior_bar[p] = 0.0
            density_bar[p] = 0.0
