"""Fixed-interval smoothing of one target through its centroids: forward filter, backward adjoint, no inverse of P or Q.

Forward, with ``(mass, pull)`` of `centroids` linearised at ``x0``:

    S = mass H P- H' + R,   K = P- H' S^-1,   e = pull - mass H (x- - x0),   x = x- + K e,   P = P- - mass K H P-

which is the information update ``Omega + dOmega, q + dq`` and, for mass 1, the Kalman filter. Backward (modified
Bryson-Frazier), ``B = I - mass K H``:

    l = F' l-(k + 1),  L = F' L-(k + 1) F,   x_s = x + P l,  P_s = P - P L P,
    l- = B' l + H' S^-1 e,   L- = B' L B + mass H' S^-1 H   (see `_backward_step` for corrected covariances).

Smoothed process noise is ``Q l-``, so ``ln p(x(1:K))`` needs no inverse of Q either: ``-1/2 (l-' P- l-)(1) - 1/2
sum_k (l-' Q l-)(k)`` plus a constant. Source: Rauch, Tung, Striebel (1965); Bierman (1973). Differs: none.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import inner_kernel
from jink.estimators.multitarget.seeing import step_tables
from jink.estimators.multitarget.small import factorise, sandwich, solve_rows, symmetrise

__all__ = ["AROUND", "CORRECTED", "PLAIN", "centroid_gain", "centroid_update", "smooth_target"]

PLAIN, CORRECTED, AROUND = 0, 1, 2
"""What an update adds to a covariance for the uncertainty of the assignment; see `centroid_update`."""


@inner_kernel
def centroid_gain(x, P, H, R, d, mass, scale, pull, at, L, gain, HP, e):
    """``HP``, factor ``L`` of ``S = scale H P H' + R``, ``gain = S^-1 H P``, ``e``; whether S was positive definite."""
    n = x.size
    for a in range(d):
        e[a] = pull[a]
        for c in range(n):
            e[a] -= mass * H[a, c] * (x[c] - at[c])
            HP[a, c] = 0.0
            for b in range(n):
                HP[a, c] += H[a, b] * P[b, c]
            gain[a, c] = HP[a, c]
    for a in range(d):
        for b in range(d):
            L[a, b] = R[a, b]
            for c in range(n):
                L[a, b] += scale * HP[a, c] * H[b, c]
    good = factorise(L, d, L)
    if good:
        solve_rows(L, d, gain, n)
    return good


@inner_kernel
def _uncertainty(spread, corrected, mass, pull, H, d, x, at, out):
    """Spread of the soft detections that is added to a covariance, into ``out`` (D, D).

    `AROUND`: about the prediction ``h(at) + c``, ``c = H (x - at)``: ``sum w (r - c)(r - c)' - e e'``, of PDA.
    """
    for a in range(d):
        for b in range(d):
            out[a, b] = spread[a, b]
    if corrected == AROUND:
        for a in range(d):
            ca = 0.0
            for c in range(x.size):
                ca += H[a, c] * (x[c] - at[c])
            for b in range(d):
                cb = 0.0
                for c in range(x.size):
                    cb += H[b, c] * (x[c] - at[c])
                out[a, b] += (1.0 - mass) * (mass * ca * cb - pull[a] * cb - ca * pull[b])


@inner_kernel
def centroid_update(x, P, H, R, d, mass, pull, at, spread, corrected, small, gain, HP, e, x_out, P_out):
    """Update of a prediction by a centroid.

    Args:
        x, P: prediction; (n,), (n, n).
        H, R, d: Jacobian (D, n), noise (D, D), components in use.
        mass, pull, at: centroid and where it was linearised; scalar, (D,), (n,).
        spread: of the soft detections, see `centroids`; (D, D).
        corrected: `PLAIN`; `CORRECTED`: add ``K spread K'``, the uncertainty of the assignment, to the covariance;
            `AROUND`: the update of probabilistic data association, ``S = H P H' + R`` whatever the mass.
        small, gain, HP, e: scratch; (2, D, D), (D, n), (D, n), (D,).
        x_out, P_out: posterior; (n,), (n, n); must not overlap the prediction.

    Returns:
        ``ln int N(x; x-, P-) prod_r N(z_r; h(x), R)^i_r dx`` up to what no prediction changes; and whether S was
        positive definite (otherwise the posterior is the prediction).
    """
    n = x.size
    for a in range(n):
        x_out[a] = x[a]
        for b in range(n):
            P_out[a, b] = P[a, b]
    if not mass > 0.0:
        return 0.0, True
    L, shared = small[0], 1.0 if corrected == AROUND else mass
    good = centroid_gain(x, P, H, R, d, mass, shared, pull, at, L, gain, HP, e)
    if not good:
        return 0.0, False
    for a in range(d):
        for c in range(n):
            x_out[c] += gain[a, c] * e[a]
            for b in range(n):
                P_out[c, b] -= mass * gain[a, c] * HP[a, b]
    if corrected:
        extra = small[1]
        _uncertainty(spread, corrected, mass, pull, H, d, x, at, extra)
        for a in range(d):
            for b in range(d):
                for c in range(n):
                    for f in range(n):
                        P_out[c, f] += gain[a, c] * extra[a, b] * gain[b, f]
    symmetrise(P_out, n)
    # e' S^-1 e by forward substitution; HP is free from here on.
    log_density, squared = 0.0, 0.0
    for a in range(d):
        total = e[a]
        for b in range(a):
            total -= L[a, b] * HP[b, 0]
        HP[a, 0] = total / L[a, a]
        squared += HP[a, 0] * HP[a, 0]
        log_density -= np.log(L[a, a]) * (mass if corrected == AROUND else 1.0)
    return log_density - 0.5 * squared / mass, True


@inner_kernel
def _backward_step(x, P, H, R, d, mass, pull, at, spread, corrected, small, rows, e, lam, Lam, B, product, new):
    """Adjoints before the update from those after it, in place; ``rows`` (3, D, n) is scratch.

    ``W = mass S^-1``, less ``S^-1 spread S^-1`` where the filter was corrected: ``B = I - P H' W H`` takes P- to P in
    both cases, and the recursion is the RTS smoother of the filter as it ran.
    """
    n = x.size
    L, HP, solved, WH = small[0], rows[1], rows[0], rows[2]
    shared = 1.0 if corrected == AROUND else mass
    if not mass > 0.0 or not centroid_gain(x, P, H, R, d, mass, shared, pull, at, L, solved, HP, e):
        return
    if corrected:
        _uncertainty(spread, corrected, mass, pull, H, d, x, at, small[1])
    for a in range(d):
        for c in range(n):
            solved[a, c] = H[a, c]
    solve_rows(L, d, solved, n)  # S^-1 H
    for a in range(d):
        for c in range(n):
            WH[a, c] = 0.0
            if corrected:
                for b in range(d):
                    WH[a, c] -= small[1, a, b] * solved[b, c]
    if corrected:
        solve_rows(L, d, WH, n)
    for a in range(d):
        for c in range(n):
            WH[a, c] += mass * solved[a, c]
    for a in range(n):
        for c in range(n):
            B[a, c] = 1.0 if a == c else 0.0
            for b in range(d):
                B[a, c] -= HP[b, a] * WH[b, c]
    for c in range(n):
        total = 0.0
        for a in range(n):
            total += B[a, c] * lam[a]
        for a in range(d):
            total += solved[a, c] * e[a]
        new[c] = total
    for c in range(n):
        lam[c] = new[c]
    for a in range(n):
        for c in range(n):
            total = 0.0
            for b in range(n):
                total += Lam[a, b] * B[b, c]
            product[a, c] = total
    for a in range(n):
        for c in range(a + 1):
            total = 0.0
            for b in range(n):
                total += B[b, a] * product[b, c]
            for b in range(d):
                total += H[b, a] * WH[b, c]
            Lam[a, c] = Lam[c, a] = total


@inner_kernel
def smooth_target(
    moving, times, F, Q, prior_mean, prior_cov, begin, sensor, sizes, noise, H, mass, pull, at, spread, corrected,
    small, rows, vectors, squares, pm, pP, fm, fP, sm, sP,
):  # fmt: skip
    """Filter and smooth one target over the scans ``begin .. K - 1``.

    Args:
        moving, times: tables of the motion, times of the scans (K,).
        F, Q: step that ends at each scan; (K, n, n); filled here where the motion is not linear.
        prior_mean, prior_cov: prediction at scan ``begin``; (n,), (n, n).
        sensor, sizes, noise: (K,), (S,), (K, D, D).
        H, mass, pull, at, spread, corrected: as `centroid_update`, per scan; (K, D, n), (K,), (K, D), (K, n), ...
        small, rows, vectors, squares: scratch; (2, D, D), (3, D, n), (6, max(n, D)), (4, n, n).
        pm, pP, fm, fP, sm, sP: predicted, filtered, smoothed means (K, n) and covariances (K, n, n).

    Returns:
        ``ln p(x(begin : K))`` of the smoothed path up to a constant, and how many updates found no covariance.
    """
    K, n = pm.shape
    gain, HP = rows[0], rows[1]
    e, lam, new = vectors[0], vectors[1, :n], vectors[2, :n]
    product, Lam, B, extra = squares[0], squares[1], squares[2], squares[3]
    trouble = 0
    for k in range(begin, K):
        if k == begin:
            for a in range(n):
                pm[k, a] = prior_mean[a]
                for b in range(n):
                    pP[k, a, b] = prior_cov[a, b]
        else:
            if moving.linear[0]:
                for a in range(n):
                    pm[k, a] = 0.0
                    for b in range(n):
                        pm[k, a] += F[k, a, b] * fm[k - 1, b]
            else:
                dt = times[k] - times[k - 1]
                step_tables(moving, 0, fm[k - 1], dt, vectors[3, :n], vectors[4, :n], pm[k], F[k], Q[k])
            sandwich(F[k], fP[k - 1], n, product, pP[k])
            for a in range(n):
                for b in range(n):
                    pP[k, a, b] += Q[k, a, b]
        _, good = centroid_update(
            pm[k], pP[k], H[k], noise[k], sizes[sensor[k]], mass[k], pull[k], at[k], spread[k], corrected,
            small, gain, HP, e, fm[k], fP[k],
        )  # fmt: skip
        if not good:
            trouble += 1
    energy = 0.0
    for a in range(n):
        lam[a] = 0.0
        for b in range(n):
            Lam[a, b] = 0.0
    for k in range(K - 1, begin - 1, -1):
        if k < K - 1:
            for c in range(n):
                new[c] = 0.0
                for a in range(n):
                    new[c] += F[k + 1, a, c] * lam[a]
            for c in range(n):
                lam[c] = new[c]
            for a in range(n):
                for c in range(n):
                    product[a, c] = 0.0
                    for b in range(n):
                        product[a, c] += Lam[a, b] * F[k + 1, b, c]
            for a in range(n):
                for c in range(a + 1):
                    total = 0.0
                    for b in range(n):
                        total += F[k + 1, b, a] * product[b, c]
                    extra[a, c] = extra[c, a] = total
            for a in range(n):
                for c in range(n):
                    Lam[a, c] = extra[a, c]
        for a in range(n):
            sm[k, a] = fm[k, a]
            for b in range(n):
                sm[k, a] += fP[k, a, b] * lam[b]
        sandwich(fP[k], Lam, n, product, extra)
        for a in range(n):
            for b in range(n):
                sP[k, a, b] = fP[k, a, b] - extra[a, b]
        _backward_step(
            pm[k], pP[k], H[k], noise[k], sizes[sensor[k]], mass[k], pull[k], at[k], spread[k], corrected,
            small, rows, e, lam, Lam, B, product, new,
        )  # fmt: skip
        for a in range(n):
            for b in range(n):
                energy += lam[a] * lam[b] * (pP[k, a, b] if k == begin else Q[k, a, b])
    return -0.5 * energy, trouble
