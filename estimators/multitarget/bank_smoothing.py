"""Fixed-interval smoothing of one manoeuvring target through its centroids: IMM filter forward, one smoother back.

Forward: the interacting multiple model filter over J linear modes with one state layout, each updated by the same
centroid. Backward: the filter's own joint moments of ``x(k)`` and ``x(k + 1)``, all modes together,

    X = sum_j c_j [P0_j F_j' + (m0_j - m)(m-_j - m-)'],   G = X (P-)^-1,   x_s = m + G (x_s(k + 1) - m-),

so the smoother leans on the modes as the filter weighed them. One mode: the RTS smoother.
Source: Blom, Bar-Shalom (1988); Rauch, Tung, Striebel (1965). Differs: one backward pass on merged moments instead of
one per pair of modes, which can drag a pair along with a future it never predicted.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import inner_kernel
from jink.estimators.multitarget.small import factorise, sandwich, solve_rows, symmetrise
from jink.estimators.multitarget.smoothing import centroid_update

__all__ = ["merge", "mix", "smooth_bank"]

_LEAST = 1e-9


@inner_kernel
def merge(probs, means, covs, mean, cov):
    """Moments of a mixture."""
    J, n = means.shape
    for a in range(n):
        mean[a] = 0.0
        for j in range(J):
            mean[a] += probs[j] * means[j, a]
    for a in range(n):
        for b in range(n):
            cov[a, b] = 0.0
    for j in range(J):
        for a in range(n):
            for b in range(n):
                cov[a, b] += probs[j] * (covs[j, a, b] + (means[j, a] - mean[a]) * (means[j, b] - mean[b]))


@inner_kernel
def smooth_bank(
    F, Q, chain, prior_mean, prior_cov, prior_probs, begin, sensor, sizes, noise, H, mass, pull, at, spread, corrected,
    small, rows, vectors, squares, mixed_mean, mixed_cov, log_probs, jm, jP, probs, pm, pP, fm, fP, sm, sP,
):  # fmt: skip
    """Filter and smooth one target with J modes over the scans ``begin .. K - 1``.

    Args:
        F, Q: step that ends at each scan, by mode; (J, K, n, n).
        chain: mode probabilities after that step given those before it, row = from; (K, J, J).
        prior_mean, prior_cov, prior_probs: prediction of each mode at scan ``begin``; (J, n), (J, n, n), (J,).
        begin, sensor, sizes, noise, H, mass, pull, at, spread, corrected: as `smooth_target`.
        small, rows, vectors, squares, mixed_mean, mixed_cov, log_probs: scratch; (2, D, D), (3, D, n), (6, max(n, D)),
            (4, n, n), (2, J, n), (2, J, n, n), (J,).
        jm, jP, probs: predictions by mode and their probabilities; (K, J, n), (K, J, n, n), (K, J).
        pm, pP, fm, fP, sm, sP: predicted, filtered, smoothed moments over all modes; (K, n), (K, n, n).

    Returns:
        0.0 (no path of a mixture has a density in closed form), and how many updates found no covariance.
    """
    K, J, n = jm.shape
    gain, HP, e = rows[0], rows[1], vectors[0]
    product, X, G, extra = squares[0], squares[1], squares[2], squares[3]
    updated_mean, updated_cov = mixed_mean[1], mixed_cov[1]
    trouble = 0
    # sP holds the joint moments X on the way forward; the way back reads row k before it writes it.
    for k in range(begin, K):
        if k == begin:
            for j in range(J):
                probs[k, j] = prior_probs[j]
                for a in range(n):
                    jm[k, j, a] = prior_mean[j, a]
                    for b in range(n):
                        jP[k, j, a, b] = prior_cov[j, a, b]
        merge(probs[k], jm[k], jP[k], pm[k], pP[k])
        top = -np.inf
        for j in range(J):
            density, good = centroid_update(
                jm[k, j], jP[k, j], H[k], noise[k], sizes[sensor[k]], mass[k], pull[k], at[k], spread[k], corrected,
                small, gain, HP, e, updated_mean[j], updated_cov[j],
            )  # fmt: skip
            if not good:
                trouble += 1
            log_probs[j] = density + np.log(max(probs[k, j], _LEAST))
            top = max(top, log_probs[j])
        total = 0.0
        for j in range(J):
            log_probs[j] = np.exp(log_probs[j] - top)
            total += log_probs[j]
        for j in range(J):
            log_probs[j] /= total
        merge(log_probs, updated_mean, updated_cov, fm[k], fP[k])
        if k + 1 < K:
            for i in range(J):
                probs[k + 1, i] = 0.0
                for j in range(J):
                    probs[k + 1, i] += log_probs[j] * chain[k + 1, j, i]
                mix(log_probs, chain[k + 1], i, probs[k + 1, i], updated_mean, updated_cov, mixed_mean[0, i],
                     mixed_cov[0, i])  # fmt: skip
                for a in range(n):
                    jm[k + 1, i, a] = 0.0
                    for b in range(n):
                        jm[k + 1, i, a] += F[i, k + 1, a, b] * mixed_mean[0, i, b]
                sandwich(F[i, k + 1], mixed_cov[0, i], n, product, jP[k + 1, i])
                for a in range(n):
                    for b in range(n):
                        jP[k + 1, i, a, b] += Q[i, k + 1, a, b]
            merge(probs[k + 1], jm[k + 1], jP[k + 1], pm[k + 1], pP[k + 1])
            for a in range(n):
                for b in range(n):
                    sP[k, a, b] = 0.0
            for i in range(J):
                for a in range(n):
                    for b in range(n):
                        value = (mixed_mean[0, i, a] - fm[k, a]) * (jm[k + 1, i, b] - pm[k + 1, b])
                        for c in range(n):
                            value += mixed_cov[0, i, a, c] * F[i, k + 1, b, c]
                        sP[k, a, b] += probs[k + 1, i] * value
    for a in range(n):
        sm[K - 1, a] = fm[K - 1, a]
        for b in range(n):
            sP[K - 1, a, b] = fP[K - 1, a, b]
    for k in range(K - 2, begin - 1, -1):
        for a in range(n):
            for b in range(n):
                X[a, b] = sP[k, b, a]  # (P-)^-1 X' is G'
                G[a, b] = 0.0
        good = factorise(pP[k + 1], n, G)
        if good:
            solve_rows(G, n, X, n)
            for a in range(n):
                for b in range(n):
                    G[a, b] = X[b, a]
        else:
            trouble += 1
            for a in range(n):
                for b in range(n):
                    G[a, b] = 0.0
        for a in range(n):
            sm[k, a] = fm[k, a]
            for b in range(n):
                sm[k, a] += G[a, b] * (sm[k + 1, b] - pm[k + 1, b])
                extra[a, b] = sP[k + 1, a, b] - pP[k + 1, a, b]
        sandwich(G, extra, n, product, X)
        for a in range(n):
            for b in range(n):
                sP[k, a, b] = fP[k, a, b] + X[a, b]
        symmetrise(sP[k], n)
    return 0.0, trouble


@inner_kernel
def mix(probs, chain, i, prob, means, covs, mean, cov):
    """Moments that mode ``i`` starts a step from; ``prob`` is its probability after the step."""
    J, n = means.shape
    for a in range(n):
        mean[a] = 0.0
        for b in range(n):
            cov[a, b] = 0.0
    for j in range(J):
        share = probs[j] * chain[j, i] / prob if prob > 0.0 else 1.0 / J
        for a in range(n):
            mean[a] += share * means[j, a]
    for j in range(J):
        share = probs[j] * chain[j, i] / prob if prob > 0.0 else 1.0 / J
        for a in range(n):
            for b in range(n):
                cov[a, b] += share * (covs[j, a, b] + (means[j, a] - mean[a]) * (means[j, b] - mean[b]))
