"""How much each track is worth: what the newest scan says for and against it, beside clutter and the other tracks."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import kernel
from jink.estimators.multitarget.small import factorise

__all__ = ["score_tracks"]

_LOG_TWO_PI = np.log(2.0 * np.pi)


@kernel
def score_tracks(
    k, begins, pairs, first, d, noise, residual, H, covs, detected, density, S, L, HP, v, explained, likelihood, score
):
    """Log-likelihood ratio of scan ``k`` with and without each track.

    Model: ``s_m = ln[1 - P_D + P_D sum_r N(z_r; h(x-_m), S) / f_r]``, where ``f_r = lambda + sum_p!=m P_D N_pr``
    explains detection r without track m: of two tracks on one target neither is worth much, and a detection that
    another track explains better is no proof.

    Args:
        k: the scan.
        begins, pairs, first: candidates, and the first pair that ``residual`` and ``likelihood`` have room for.
        d: components of the scan's sensor.
        noise: R; (D, D).
        residual: of predictions; (P, D).
        H, covs: Jacobian and predicted covariance; (M, D, n), (M, n, n).
        detected, density: P_D of each target (M,), 0: out of view; lambda.
        S, L, HP, v: scratch; (D, D), (D, D), (D, n), (D,).
        explained, likelihood: scratch per detection and pair; (N,), (P,).
        score: result; (M,); 0 for a target out of view.
    """
    M, n = covs.shape[0], covs.shape[1]
    for m in range(M):
        for p in range(begins[k * M + m], begins[k * M + m + 1]):
            explained[pairs[p]] = density
    for m in range(M):
        low, high = begins[k * M + m], begins[k * M + m + 1]
        if low == high:
            continue
        for a in range(d):
            for c in range(n):
                HP[a, c] = 0.0
                for b in range(n):
                    HP[a, c] += H[m, a, b] * covs[m, b, c]
        for a in range(d):
            for b in range(d):
                S[a, b] = noise[a, b]
                for c in range(n):
                    S[a, b] += HP[a, c] * H[m, b, c]
        good = factorise(S, d, L)
        for p in range(low, high):
            value = 0.0
            if good:
                value = -0.5 * d * _LOG_TWO_PI
                for a in range(d):
                    v[a] = residual[p - first, a]
                    for b in range(a):
                        v[a] -= L[a, b] * v[b]
                    v[a] /= L[a, a]
                    value -= 0.5 * v[a] * v[a] + np.log(L[a, a])
                value = detected[m] * np.exp(value)
            likelihood[p - first] = value
            explained[pairs[p]] += value
    for m in range(M):
        total = 1.0 - detected[m]
        for p in range(begins[k * M + m], begins[k * M + m + 1]):
            rest = max(explained[pairs[p]] - likelihood[p - first], density)
            # Without clutter a lone detection is proof; a finite one, so that a later silence can outweigh it.
            total += likelihood[p - first] / max(rest, 1e-6 * likelihood[p - first], 1e-300)
        score[m] = np.log(max(total, 1e-12))
