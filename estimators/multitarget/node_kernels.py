"""What one node of a network computes, compiled: information in its own scans, and smoothing of fused information.

Letters: K scans of the node, T times of the window, M targets, n state, D components.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel, kernel
from jink.estimators.multitarget.information_kernels import invert
from jink.estimators.multitarget.pmht_kernels import (
    centroids,
    densities,
    find_pairs,
    noise_tables,
    predictive_densities,
    weigh,
)
from jink.estimators.multitarget.seeing import linearise, step_tables
from jink.estimators.multitarget.small import factorise, sandwich, solve_rows, symmetrise

__all__ = ["filter_information", "local_information", "predict_targets", "smooth_back"]


@kernel
def _novelty(mass, pull, spread, corrected, H, R, d, at, L, rows, dq, dOmega):
    """Add ``mass H' V^-1 H`` and ``H' V^-1 (pull + mass H x)``; V = R, or R plus the mean spread of soft detections."""
    n = at.size
    for a in range(d):
        for b in range(d):
            L[a, b] = R[a, b] + (spread[a, b] / mass if corrected else 0.0)
    if not factorise(L, d, L):
        return
    for a in range(d):
        for c in range(n):
            rows[a, c] = H[a, c]
    solve_rows(L, d, rows, n)
    for a in range(d):
        value = pull[a]
        for c in range(n):
            value += mass * H[a, c] * at[c]
        for c in range(n):
            dq[c] += rows[a, c] * value
            for b in range(n):
                dOmega[c, b] += mass * rows[a, c] * H[a, b]


@entry_kernel
def local_information(
    moving, sensing, sensor, places, noise, detections, offsets, slot, begin, means, covs, gate_covs, gates, detected,
    density, volume, inflation, log_shares, scales, adaptive, corrected, dq, dOmega, hits,
):  # fmt: skip
    """E-step of one node over its scans, and what its centroids say about each target at each time of the window.

    Model: ``dOmega = sum_r w_r H' R^-1 H``, ``dq = sum_r w_r H' R^-1 (z_r - h(x) + H x)`` with the weights of PMHT;
    ``corrected``: R grows by ``spread / sum_r w_r``, as detections that may be another's are worth less.

    Args:
        moving, sensing: tables.
        sensor, places, noise, detections, offsets: the node's scans; (K,), (K, 2 A), (K, D, D), (N, D), (K + 1,).
        slot: time of the window that each scan belongs to; (K,).
        begin: first time of each target; (M,).
        means, covs: iterate; (M, T, n), (M, T, n, n).
        gate_covs: covariances for the gates; (M, T, n, n).
        gates, density, volume: D^2, lambda, V of each scan; (K,).
        detected: P_D, 0: out of view; (K, M).
        inflation: tau.
        log_shares, scales: homothetic model; (G,).
        adaptive: densities have the covariance ``H P H' + R`` instead, P of the iterate.
        corrected: see above.
        dq, dOmega, hits: results, zero where nothing was seen; (M, T, n), (M, T, n, n), (M, T).

    Returns:
        log-likelihood of the detections, and how many nothing explains.
    """
    M, T, n = means.shape
    K, D = sensor.size, detections.shape[1]
    dq[:], dOmega[:], hits[:] = 0.0, 0.0, 0.0
    if K == 0:
        return 0.0, 0
    at, first = np.zeros((M, K, n)), np.zeros(M, dtype=np.int64)
    spreads, wide = np.zeros((M, K, n, n)), np.zeros((M, K, n, n))
    for m in range(M):
        for k in range(K):
            at[m, k], spreads[m, k], wide[m, k] = means[m, slot[k]], covs[m, slot[k]], gate_covs[m, slot[k]]
            first[m] += slot[k] < begin[m]
    kin, above, below = np.zeros(places.shape[1]), np.zeros(D), np.zeros(D)
    seen, H = np.zeros((M, K, D)), np.zeros((M, K, D, n))
    linearise(moving, sensing, sensor, places, at, first, kin, above, below, seen, H)
    whiten, log_norm = np.zeros((K, D, D)), np.zeros(K)
    noise_tables(sensing.sizes, sensor, noise, whiten, log_norm)
    begins, pairs = find_pairs(
        detections, offsets, sensor, sensing.sizes, sensing.angular, noise, seen, H, wide, first, gates
    )
    log_target, log_clutter = np.zeros((K, M)), np.zeros(K)
    for k in range(K):
        clutter = density[k] * volume[k]
        norm = clutter
        for m in range(M):
            norm += detected[k, m] if slot[k] >= begin[m] else 0.0
        norm = max(norm, 1e-300)
        log_clutter[k] = np.log(density[k] / norm)
        for m in range(M):
            log_target[k, m] = np.log(detected[k, m] / norm)
    P, N = pairs.size, detections.shape[0]
    residual, log_density, ratio, weight = np.zeros((P, D)), np.zeros(P), np.zeros(P), np.zeros(P)
    L, rows = np.zeros((D, D)), np.zeros((D, n))
    if adaptive:
        predictive_densities(
            detections, sensor, sensing.sizes, sensing.angular, noise, seen, H, spreads, begins, pairs,
            np.zeros((D, D)), L, rows, residual, log_density, ratio,
        )  # fmt: skip
    else:
        densities(
            detections, sensor, sensing.sizes, sensing.angular, whiten, log_norm, seen, begins, pairs, inflation,
            log_shares, scales, residual, log_density, ratio,
        )  # fmt: skip
    value, unexplained = weigh(
        offsets, begins, pairs, log_density, log_target, log_clutter, np.zeros(N), np.zeros(N), weight
    )
    mass, own, pull, spread = np.zeros((M, K)), np.zeros((M, K)), np.zeros((M, K, D)), np.zeros((M, K, D, D))
    centroids(begins, pairs, sensing.sizes, sensor, residual, weight, ratio, mass, pull, spread, own)
    for m in range(M):
        for k in range(first[m], K):
            hits[m, slot[k]] += own[m, k]
            if mass[m, k] > 1e-12:
                _novelty(
                    mass[m, k], pull[m, k], spread[m, k], corrected, H[m, k], noise[k], sensing.sizes[sensor[k]],
                    at[m, k], L, rows, dq[m, slot[k]], dOmega[m, slot[k]],
                )  # fmt: skip
    return value, unexplained


@entry_kernel
def predict_targets(moving, dt, means, covs):
    """Moments of every target ``dt`` s later; (M, n), (M, n, n)."""
    M, n = means.shape
    x, P = np.zeros((M, n)), np.zeros((M, n, n))
    F, Q, product, above, below = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for m in range(M):
        step_tables(moving, 0, means[m].copy(), dt, above, below, x[m], F, Q)
        sandwich(F, covs[m], n, product, P[m])
        P[m] += Q
    return x, P


@entry_kernel
def filter_information(
    moving, times, prior_mean, prior_cov, begin, dq, dOmega, ahead, ahead_cov, filtered, filtered_cov
):
    """Filter every target through information about it.

    Model: ``Omega+ = P-^-1 + dOmega``, ``x+ = x- + P+ (dq - dOmega x-)``. Where a matrix is no covariance the
    prediction stands, and is counted.

    Args:
        moving: tables of the motion.
        times: of the window, s; (T,).
        prior_mean, prior_cov: predictions at each target's first time; (M, n), (M, n, n).
        begin: first time of each target; (M,).
        dq, dOmega: (M, T, n), (M, T, n, n).
        ahead, ahead_cov, filtered, filtered_cov: predictions and posteriors, results; (M, T, n), (M, T, n, n).

    Returns:
        number of updates that found no covariance.
    """
    M, T, n = ahead.shape
    above, below, q, x = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    F, Q, product = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    W, Omega = np.zeros((n, n)), np.zeros((n, n))
    work, factor = np.zeros((n, (n + 7) // 8 * 8)), np.zeros((n, (n + 7) // 8 * 8))
    trouble = 0
    for m in range(M):
        for k in range(begin[m], T):
            if k == begin[m]:
                ahead[m, k], ahead_cov[m, k] = prior_mean[m], prior_cov[m]
            else:
                x[:] = filtered[m, k - 1]
                step_tables(moving, 0, x, times[k] - times[k - 1], above, below, ahead[m, k], F, Q)
                sandwich(F, filtered_cov[m, k - 1], n, product, ahead_cov[m, k])
                ahead_cov[m, k] += Q
            good = invert(ahead_cov[m, k], n, work, factor, W)
            for a in range(n):
                # About the prediction, so that a position far from the origin costs no digits.
                q[a] = dq[m, k, a]
                for b in range(n):
                    q[a] -= dOmega[m, k, a, b] * ahead[m, k, b]
                    Omega[a, b] = W[a, b] + dOmega[m, k, a, b]
            good = good and invert(Omega, n, work, factor, W)
            if not good:
                trouble += 1
                filtered[m, k], filtered_cov[m, k] = ahead[m, k], ahead_cov[m, k]
                continue
            filtered_cov[m, k] = W
            for a in range(n):
                filtered[m, k, a] = ahead[m, k, a]
                for b in range(n):
                    filtered[m, k, a] += W[a, b] * q[b]
    return trouble


@entry_kernel
def smooth_back(moving, times, begin, ahead, ahead_cov, filtered, filtered_cov, means, covs):
    """Smooth every target through stored predictions and posteriors (Rauch, Tung, Striebel).

    Args:
        moving, times, begin, ahead, ahead_cov, filtered, filtered_cov: as `filter_information`.
        means, covs: smoothed moments, results; (M, T, n), (M, T, n, n).
    """
    M, T, n = ahead.shape
    above, below, moved, x = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    F, Q, product, C = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    W, extra = np.zeros((n, n)), np.zeros((n, n))
    work, factor = np.zeros((n, (n + 7) // 8 * 8)), np.zeros((n, (n + 7) // 8 * 8))
    for m in range(M):
        if begin[m] >= T:
            continue
        means[m, T - 1], covs[m, T - 1] = filtered[m, T - 1], filtered_cov[m, T - 1]
        for k in range(T - 2, begin[m] - 1, -1):
            means[m, k], covs[m, k] = filtered[m, k], filtered_cov[m, k]
            if not invert(ahead_cov[m, k + 1], n, work, factor, W):
                continue
            x[:] = filtered[m, k]
            step_tables(moving, 0, x, times[k + 1] - times[k], above, below, moved, F, Q)
            for a in range(n):
                for b in range(n):
                    product[a, b] = 0.0
                    for c in range(n):
                        product[a, b] += filtered_cov[m, k, a, c] * F[b, c]
                    extra[a, b] = covs[m, k + 1, a, b] - ahead_cov[m, k + 1, a, b]
            for a in range(n):
                for b in range(n):
                    C[a, b] = 0.0
                    for c in range(n):
                        C[a, b] += product[a, c] * W[c, b]
            for a in range(n):
                for b in range(n):
                    means[m, k, a] += C[a, b] * (means[m, k + 1, b] - ahead[m, k + 1, b])
            sandwich(C, extra, n, product, W)
            covs[m, k] += W
            symmetrise(covs[m, k], n)
