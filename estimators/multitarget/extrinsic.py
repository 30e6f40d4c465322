"""Turbo PMHT: a scan's detections are weighed by what all the other scans of the window say of a target.

PMHT weighs a detection by a path that this detection has already bent, so a wrong choice confirms itself. Here the
path without the scan is taken: the smoothed state less the scan's own part, which is what took the prediction to the
filtered state. At the newest scan this is the prediction, and a window of one scan is data association proper.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import inner_kernel, kernel
from jink.estimators.linalg import wrap_angle
from jink.estimators.multitarget.small import factorise, solve_rows, symmetrise

__all__ = ["extrinsic_densities"]


@inner_kernel
def _inverse(A, n, L, out):
    """``out = A^-1`` (n, n) by the factor ``L``; whether A was positive definite."""
    good = factorise(A, n, L)
    if good:
        for a in range(n):
            for b in range(n):
                out[a, b] = 1.0 if a == b else 0.0
        solve_rows(L, n, out, n)
        symmetrise(out, n)
    return good


@inner_kernel
def _seen_cov(rows, P, d, out):
    """``out = G P G'`` with ``G = rows`` (d, n)."""
    n = P.shape[0]
    for a in range(d):
        for b in range(a + 1):
            total = 0.0
            for c in range(n):
                for f in range(n):
                    total += rows[a, c] * P[c, f] * rows[b, f]
            out[a, b] = out[b, a] = total


@inner_kernel
def _seen_off(rows, x, centre, d, out):
    """``out = G (x - centre)``."""
    for a in range(d):
        out[a] = 0.0
        for c in range(x.size):
            out[a] += rows[a, c] * (x[c] - centre[c])


@inner_kernel
def _without(sP, pm, pP, fm, fP, sm, G, d, factor, before, after, out, y, work):
    """Covariance ``out`` of ``G x`` and its mean ``y`` relative to ``G sm`` without a scan; False: not to be had.

    Model: ``out^-1 = (G P_s G')^-1 - [(G P G')^-1 - (G P- G')^-1]``, the means likewise.
    """
    _seen_cov(G, pP, d, out)
    if not _inverse(out, d, factor, before):
        return False
    _seen_cov(G, fP, d, out)
    if not _inverse(out, d, factor, after):
        return False
    # The scan's own part of the information mean, with its sign changed; the smoothed mean is the origin.
    _seen_off(G, pm, sm, d, y)
    for a in range(d):
        work[a] = 0.0
        for b in range(d):
            work[a] += before[a, b] * y[b]
    _seen_off(G, fm, sm, d, y)
    for a in range(d):
        for b in range(d):
            work[a] -= after[a, b] * y[b]
    for a in range(d):
        for b in range(d):
            before[a, b] -= after[a, b]
    _seen_cov(G, sP, d, out)
    if not _inverse(out, d, factor, after):
        return False
    for a in range(d):
        for b in range(d):
            after[a, b] += before[a, b]
    if not _inverse(after, d, factor, out):
        return False
    for a in range(d):
        y[a] = 0.0
        for b in range(d):
            y[a] += out[a, b] * work[b]
    return True


@kernel
def extrinsic_densities(
    detections, sensor, sizes, angular, whiten, log_norm, seen, H, begin, begins, pairs, sm, sP, pm, pP, fm, fP, mass,
    inflation, G, vectors, blocks, residual, log_density, ratio,
):  # fmt: skip
    """As `densities`, with ``g = N(z; h(x), H P H' + R)``, x and P of the target without the scan.

    Args:
        detections, sensor, sizes, angular, whiten, log_norm, seen, H, begins, pairs: as `densities` and `find_pairs`.
        begin: first scan of each target; (M,).
        sm, sP, pm, pP, fm, fP, mass: of the last pass: smoothed, where ``h`` was linearised; predicted; filtered;
            weight of the centroid; (M, K, n), (M, K, n, n), (M, K).
        inflation: tau.
        G, vectors, blocks: scratch; (D, n), (2, D) or more, (5, D, D).
        residual, log_density, ratio: as `densities`; ratio is 1.

    Source: Ruan, Willett (2004). Differs: what a scan itself said is taken out in the space of its measurements, with
    the moments of the filter as it ran.
    """
    M, K, n = sm.shape
    factor, before, after, cov, L = blocks[0], blocks[1], blocks[2], blocks[3], blocks[4]
    y, work = vectors[0], vectors[1]
    for k in range(K):
        s, d = sensor[k], sizes[sensor[k]]
        for m in range(M):
            low, high = begins[k * M + m], begins[k * M + m + 1]
            if low == high or k < begin[m]:
                continue
            for a in range(d):
                for c in range(n):
                    G[a, c] = 0.0
                    for b in range(a + 1):
                        G[a, c] += whiten[k, a, b] * H[m, k, b, c]
            found = False
            if not mass[m, k] > 0.0:
                _seen_cov(G, sP[m, k], d, cov)
                for a in range(d):
                    y[a] = 0.0
                found = True
            elif k < K - 1:
                found = _without(
                    sP[m, k], pm[m, k], pP[m, k], fm[m, k], fP[m, k], sm[m, k], G, d, factor, before, after, cov, y,
                    work,
                )  # fmt: skip
            if not found:
                _seen_cov(G, pP[m, k], d, cov)
                _seen_off(G, pm[m, k], sm[m, k], d, y)
            for a in range(d):
                cov[a, a] += inflation
            good = factorise(cov, d, L)
            base = log_norm[k]
            for a in range(d):
                base -= np.log(L[a, a]) if good else 0.0
            for p in range(low, high):
                for a in range(d):
                    v = detections[pairs[p], a] - seen[m, k, a]
                    residual[p, a] = wrap_angle(v) if angular[s, a] else v
                value = base
                for a in range(d):
                    v = -y[a]
                    for b in range(a + 1):
                        v += whiten[k, a, b] * residual[p, b]
                    for b in range(a):
                        v -= L[a, b] * work[b]
                    work[a] = v / L[a, a] if good else 0.0
                    value -= 0.5 * work[a] * work[a]
                log_density[p] = value if good else -np.inf
                ratio[p] = 1.0
