"""Expectation-maximisation over one window of scans, and the prediction to the next scan, compiled."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel, inner_kernel
from jink.estimators.multitarget.bank_smoothing import merge, mix, smooth_bank
from jink.estimators.multitarget.exclusive import MOST_EVENTS, exclude
from jink.estimators.multitarget.extrinsic import extrinsic_densities
from jink.estimators.multitarget.pmht_kernels import (
    centroids,
    densities,
    find_pairs,
    noise_tables,
    posterior_priors,
    predictive_densities,
    weigh,
)
from jink.estimators.multitarget.scoring import score_tracks
from jink.estimators.multitarget.seeing import linearise, linearise_one, move_tables, step_tables
from jink.estimators.multitarget.small import sandwich
from jink.estimators.multitarget.smoothing import AROUND, CORRECTED, PLAIN, smooth_target

__all__ = ["fit_window", "foresee", "score_newest"]


@inner_kernel
def _set_priors(detected, density, volume, missed_rule, log_target, log_clutter):
    """``pi_m = P_Dm / (c + sum P_D)``, ``pi_0 = c / (c + sum P_D)``; c = lambda V, times 1 - P_D by the other rule."""
    K, M = detected.shape
    for k in range(K):
        total, best = 0.0, 0.0
        for m in range(M):
            total += detected[k, m]
            best = max(best, detected[k, m])
        clutter = density[k] * volume[k] * (1.0 - best if missed_rule else 1.0)
        norm = max(clutter + total, 1e-300)
        log_clutter[k] = np.log(clutter / norm / volume[k]) if clutter > 0.0 else -np.inf
        for m in range(M):
            log_target[k, m] = np.log(detected[k, m] / norm) if detected[k, m] > 0.0 else -np.inf


@entry_kernel
def fit_window(
    moving, sensing, times, origin, sensor, places, noise, detections, offsets, begin,
    prior_mean, prior_cov, prior_probs, chain, means, covs, gates, detected, density, volume,
    iterations, tolerance, inflations, log_shares, scales, updated, missed_rule, rounds, corrected, adaptive, extrinsic,
):  # fmt: skip
    """EM over K scans for M targets with J modes.

    Args:
        moving, sensing: tables of motion and sensors.
        times, origin, sensor, places, noise: of the scans; (K,), time before the first, (K,), (K, 2 A), (K, D, D).
        detections, offsets: (N, D), (K + 1,).
        begin: first scan of each target; (M,).
        prior_mean, prior_cov, prior_probs: predictions at that scan; (M, J, n), (M, J, n, n), (M, J).
        chain: Markov matrix of the step that ends at each scan; (K, J, J).
        means, covs: paths to start from, and the smoothed result; (M, K, n), (M, K, n, n).
        gates, density, volume: D^2, lambda and V of each scan; (K,).
        detected: P_D; (K, M); 0: out of view.
        iterations, tolerance: most iterations; relative change of the objective that ends them.
        inflations: tau of the first iterations, 1 afterwards; (I,).
        log_shares, scales: homothetic model; (G,).
        updated: priors follow the weights.
        missed_rule: clutter prior times 1 - P_D.
        rounds: 0: PMHT; else at most one detection per target, with so many exchanges.
        corrected: the last pass adds the uncertainty of the assignment to covariances.
        adaptive: in so many first iterations the density is ``N(z; h(x), H P H' + R)``.
        extrinsic: afterwards it is that of `extrinsic_densities`, and updates are those of data association.

    Returns:
        objective of each iterate from the first M-step on (NaN where there was none; (iterations,)), pairs as begins
        (K M + 1,), detections (P,) and weights (P,); hits (M, K); seen (M, K, D); predictions by mode (M, K, J, n),
        (M, K, J, n, n), (M, K, J); filtered moments (M, K, n), (M, K, n, n); what the last scan leaves behind by mode
        (M, J, n), (M, J, n, n), (M, J); centroids as mass (M, K), pull (M, K, D), H (M, K, D, n); counts: iterations,
        unexplained detections, failed updates.
    """
    M, K, n = means.shape
    J, D = prior_mean.shape[1], detections.shape[1]
    N = detections.shape[0]
    wide = max(n, D)
    kin, above, below = np.zeros(places.shape[1]), np.zeros(D), np.zeros(D)
    whiten, log_norm = np.zeros((K, D, D)), np.zeros(K)
    noise_tables(sensing.sizes, sensor, noise, whiten, log_norm)
    linear = moving.linear[0]
    F, Q = np.zeros((J if linear else M, K, n, n)), np.zeros((J if linear else M, K, n, n))
    if linear:
        move_tables(moving, times, origin, np.zeros((4, n)), F, Q)
    seen, H = np.zeros((M, K, D)), np.zeros((M, K, D, n))
    linearise(moving, sensing, sensor, places, means, begin, kin, above, below, seen, H)
    begins, pairs = find_pairs(
        detections, offsets, sensor, sensing.sizes, sensing.angular, noise, seen, H, covs, begin, gates
    )
    P = pairs.size
    log_target, log_clutter = np.zeros((K, M)), np.zeros(K)
    _set_priors(detected, density, volume, missed_rule, log_target, log_clutter)
    residual, log_density, ratio, weight = np.zeros((P, D)), np.zeros(P), np.zeros(P), np.zeros(P)
    peak, total = np.zeros(N), np.zeros(N)
    mass, hits, pull, spread = np.zeros((M, K)), np.zeros((M, K)), np.zeros((M, K, D)), np.zeros((M, K, D, D))
    small, rows, vectors = np.zeros((2, D, D)), np.zeros((3, D, n)), np.zeros((6, wide))
    squares, at, blocks = np.zeros((4, n, n)), np.zeros((M, K, n)), np.zeros((5, D, D))
    mixed_mean, mixed_cov, log_probs = np.zeros((2, J, n)), np.zeros((2, J, n, n)), np.zeros(J)
    jm, jP, probs = np.zeros((M, K, J, n)), np.zeros((M, K, J, n, n)), np.ones((M, K, J))
    pm, pP = np.zeros((M, K, n)), np.zeros((M, K, n, n))
    fm, fP = np.zeros((M, K, n)), np.zeros((M, K, n, n))
    last_mean, last_cov, last_probs = np.zeros((M, J, n)), np.zeros((M, J, n, n)), np.ones((M, J))
    objective = np.full(iterations, np.nan)
    log_volume = np.log(volume)
    energy, before = 0.0, np.nan
    trouble, unexplained, done = 0, 0, 0
    for turn in range(iterations):
        tau = inflations[turn] if turn < inflations.size else 1.0
        if turn > 0:
            linearise(moving, sensing, sensor, places, means, begin, kin, above, below, seen, H)
        if turn < adaptive:
            predictive_densities(
                detections, sensor, sensing.sizes, sensing.angular, noise, seen, H, covs, begins, pairs,
                small[0], small[1], rows[1], residual, log_density, ratio,
            )  # fmt: skip
        elif extrinsic:
            extrinsic_densities(
                detections, sensor, sensing.sizes, sensing.angular, whiten, log_norm, seen, H, begin, begins, pairs,
                means, covs, pm, pP, fm, fP, mass, tau, rows[0], vectors, blocks, residual, log_density, ratio,
            )  # fmt: skip
        else:
            densities(
                detections, sensor, sensing.sizes, sensing.angular, whiten, log_norm, seen, begins, pairs, tau,
                log_shares, scales, residual, log_density, ratio,
            )  # fmt: skip
        value, unexplained = weigh(offsets, begins, pairs, log_density, log_target, log_clutter, peak, total, weight)
        last = turn == iterations - 1
        if turn > 0:
            objective[turn - 1] = value + energy
            change = abs(objective[turn - 1] - before)
            last = last or (
                turn > max(inflations.size, adaptive) and change <= tolerance * max(abs(objective[turn - 1]), 1.0)
            )
            before = objective[turn - 1]
        if rounds > 0:
            for k in range(K):
                for m in range(M):
                    for p in range(begins[k * M + m], begins[k * M + m + 1]):
                        log_density[p] += np.log(max(detected[k, m], 1e-300))
            exclude(offsets, begins, pairs, log_density, 1.0 - detected, density, rounds, MOST_EVENTS, weight)
        if updated:
            posterior_priors(offsets, begins, weight, log_target, log_volume, log_clutter)
        centroids(begins, pairs, sensing.sizes, sensor, residual, weight, ratio, mass, pull, spread, hits)
        at[:] = means
        energy, trouble, final = 0.0, 0, AROUND if extrinsic else CORRECTED if corrected and last else PLAIN
        for m in range(M):
            if begin[m] >= K:
                continue
            if J == 1:
                table = 0 if linear else m
                one, bad = smooth_target(
                    moving, times, F[table], Q[table], prior_mean[m, 0], prior_cov[m, 0], begin[m], sensor,
                    sensing.sizes, noise, H[m], mass[m], pull[m], at[m], spread[m], final,
                    small, rows, vectors, squares, pm[m], pP[m], fm[m], fP[m], means[m], covs[m],
                )  # fmt: skip
                for k in range(begin[m], K):
                    for a in range(n):
                        jm[m, k, 0, a] = pm[m, k, a]
                        for b in range(n):
                            jP[m, k, 0, a, b] = pP[m, k, a, b]
                last_mean[m, 0], last_cov[m, 0] = fm[m, K - 1], fP[m, K - 1]
            else:
                one, bad = smooth_bank(
                    F, Q, chain, prior_mean[m], prior_cov[m], prior_probs[m], begin[m], sensor, sensing.sizes, noise,
                    H[m], mass[m], pull[m], at[m], spread[m], final, small, rows, vectors, squares,
                    mixed_mean, mixed_cov, log_probs, jm[m], jP[m], probs[m], pm[m], pP[m], fm[m], fP[m],
                    means[m], covs[m],
                )  # fmt: skip
                last_mean[m], last_cov[m], last_probs[m] = mixed_mean[1], mixed_cov[1], log_probs
            energy += one
            trouble += bad
        done += 1
        if last:
            break
    return (
        objective, begins, pairs, weight, hits, seen, jm, jP, probs, fm, fP, last_mean, last_cov, last_probs,
        mass, pull, H, np.array([done, unexplained, trouble]),
    )  # fmt: skip


@entry_kernel
def foresee(moving, chain, dt, last_mean, last_cov, last_probs):
    """Prediction of every target over ``dt`` s from what the last scan left behind.

    Args:
        moving: tables of the motion.
        chain: Markov matrix of the step; (J, J).
        dt: s.
        last_mean, last_cov, last_probs: by mode; (M, J, n), (M, J, n, n), (M, J).

    Returns:
        predictions by mode (M, J, n), (M, J, n, n), (M, J); over all modes (M, n), (M, n, n).
    """
    M, J, n = last_mean.shape
    jm, jP, probs = np.zeros((M, J, n)), np.zeros((M, J, n, n)), np.zeros((M, J))
    mean, cov = np.zeros((M, n)), np.zeros((M, n, n))
    F, Q, product = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    above, below = np.zeros(n), np.zeros(n)
    mixed_mean, mixed_cov = np.zeros(n), np.zeros((n, n))
    for m in range(M):
        for i in range(J):
            for j in range(J):
                probs[m, i] += last_probs[m, j] * chain[j, i]
            mix(last_probs[m], chain, i, probs[m, i], last_mean[m], last_cov[m], mixed_mean, mixed_cov)
            step_tables(moving, i, mixed_mean, dt, above, below, jm[m, i], F, Q)
            sandwich(F, mixed_cov, n, product, jP[m, i])
            jP[m, i] += Q
        merge(probs[m], jm[m], jP[m], mean[m], cov[m])
    return jm, jP, probs, mean, cov


@entry_kernel
def score_newest(moving, sensing, s, place, noise, detections, mean, cov, detected, density, gate):
    """`score_tracks` of one scan against predictions: scores (M,), candidates as begins, pairs and ``P_D N``.

    Args:
        moving, sensing: tables.
        s, place, noise, detections: sensor, its state (2 A,), R (D, D), (N, D).
        mean, cov: predictions; (M, n), (M, n, n).
        detected, density, gate: P_D (M,), lambda, D^2.
    """
    M, n = mean.shape
    D = detections.shape[1]
    kin, above, below = np.zeros(place.size), np.zeros(D), np.zeros(D)
    seen, H = np.zeros((M, 1, D)), np.zeros((M, 1, D, n))
    for m in range(M):
        linearise_one(moving, sensing, s, place, mean[m].copy(), kin, above, below, seen[m, 0], H[m, 0])
    offsets, sensor = np.array([0, detections.shape[0]]), np.array([s])
    noises = np.zeros((1, D, D))
    noises[0] = noise
    begins, pairs = find_pairs(
        detections, offsets, sensor, sensing.sizes, sensing.angular, noises, seen, H, cov.copy().reshape((M, 1, n, n)),
        np.zeros(M, dtype=np.int64), np.full(1, gate),
    )  # fmt: skip
    P = pairs.size
    likelihood, score = np.zeros(P), np.zeros(M)
    predictive_densities(
        detections, sensor, sensing.sizes, sensing.angular, noises, seen, H, cov.copy().reshape((M, 1, n, n)),
        begins, pairs, np.zeros((D, D)), np.zeros((D, D)), np.zeros((D, n)), np.zeros((P, D)), likelihood,
        np.zeros(P),
    )  # fmt: skip
    for m in range(M):
        for p in range(begins[m], begins[m + 1]):
            likelihood[p] = detected[m] * np.exp(likelihood[p])
    score_tracks(begins, pairs, detected, density, np.zeros(detections.shape[0]), likelihood, score)
    return score, begins, pairs, likelihood
