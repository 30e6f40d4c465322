"""Association of PMHT, compiled: candidates, E-step, centroids, information pairs.

Candidate pairs (target, detection) are stored scan by scan, then target by target: those of target m in scan k are
``pairs[begins[k * M + m] : begins[k * M + m + 1]]``, indices of detections. Without gates every detection is a
candidate of every target; with gates cost follows the number of pairs.

Letters: K scans, N detections, M targets, D components, n state, P pairs. Arrays are C-contiguous float64 or int64.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel, inner_kernel, kernel
from jink.estimators.linalg import wrap_angle
from jink.estimators.multitarget.small import factorise

__all__ = [
    "centroids",
    "densities",
    "find_pairs",
    "information_pairs",
    "noise_tables",
    "posterior_priors",
    "predictive_densities",
    "weigh",
]

_LOG_TWO_PI = np.log(2.0 * np.pi)


@kernel
def noise_tables(sizes, sensor, noise, whiten, log_norm):
    """``whiten = L^-1`` with ``R = L L'`` and ``log_norm = -ln det(2 pi R) / 2`` of each scan.

    Args:
        sizes, sensor: components of each sensor, sensor of each scan; (S,), (K,).
        noise: R; (K, D, D).
        whiten, log_norm: results; (K, D, D), zero beyond the sensor's components; (K,).
    """
    for k in range(sensor.size):
        d = sizes[sensor[k]]
        L = whiten[k]
        for a in range(L.shape[0]):
            for b in range(L.shape[0]):
                L[a, b] = 0.0
        factorise(noise[k], d, L)
        log_norm[k] = -0.5 * d * _LOG_TWO_PI
        for a in range(d):
            log_norm[k] -= np.log(L[a, a])
        for c in range(d):
            L[c, c] = 1.0 / L[c, c]
            for a in range(c + 1, d):
                total = L[a, c] * L[c, c]
                for b in range(c + 1, a):
                    total += L[a, b] * L[b, c]
                L[a, c] = -total / L[a, a]


@entry_kernel
def find_pairs(detections, offsets, sensor, sizes, angular, noise, seen, H, covs, begin, gates):
    """Candidates: ``D^2 = v' (H P H' + R)^-1 v <= gate``.

    Detections of a scan stand in increasing order of their first component, so that only those near a target are
    looked at (not where the first component is an angle).

    Args:
        detections, offsets: (N, D), (K + 1,).
        sensor, sizes, angular: sensor of each scan (K,); components of each sensor (S,), which are angles (S, D).
        noise: R; (K, D, D).
        seen, H: ``h(x)`` and Jacobian; (M, K, D), (M, K, D, n).
        covs: P of the states; (M, K, n, n).
        begin: first scan of each target; (M,).
        gates: D^2 per scan, inf: all detections; (K,).

    Returns:
        begins (K M + 1,), pairs (P,).
    """
    M, K, D = seen.shape
    n = H.shape[3]
    begins = np.zeros(K * M + 1, dtype=np.int64)
    pairs = np.empty(max(64, 2 * detections.shape[0]), dtype=np.int64)
    S, L, HP, v = np.zeros((D, D)), np.zeros((D, D)), np.zeros((D, n)), np.zeros(D)
    count = 0
    for k in range(K):
        d, s = sizes[sensor[k]], sensor[k]
        for m in range(M):
            first, last = offsets[k], offsets[k + 1]
            if k < begin[m]:
                first = last
            closed = gates[k] < np.inf
            if closed and first < last:
                for a in range(d):
                    for c in range(n):
                        HP[a, c] = 0.0
                        for b in range(n):
                            HP[a, c] += H[m, k, a, b] * covs[m, k, b, c]
                for a in range(d):
                    for b in range(d):
                        S[a, b] = noise[k, a, b]
                        for c in range(n):
                            S[a, b] += HP[a, c] * H[m, k, b, c]
                if not factorise(S, d, L):
                    closed = False
                elif not angular[s, 0]:
                    reach = np.sqrt(gates[k] * S[0, 0])
                    low, high = first, last
                    while low < high:
                        middle = (low + high) // 2
                        if detections[middle, 0] < seen[m, k, 0] - reach:
                            low = middle + 1
                        else:
                            high = middle
                    first, high = low, last
                    while low < high:
                        middle = (low + high) // 2
                        if detections[middle, 0] <= seen[m, k, 0] + reach:
                            low = middle + 1
                        else:
                            high = middle
                    last = low
            if count + last - first > pairs.size:
                wider = np.empty(2 * (count + last - first), dtype=np.int64)
                wider[:count] = pairs[:count]
                pairs = wider
            for r in range(first, last):
                distance = 0.0
                if closed:
                    for a in range(d):
                        v[a] = detections[r, a] - seen[m, k, a]
                        if angular[s, a]:
                            v[a] = wrap_angle(v[a])
                        for b in range(a):
                            v[a] -= L[a, b] * v[b]
                        v[a] /= L[a, a]
                        distance += v[a] * v[a]
                if not closed or distance <= gates[k]:
                    pairs[count] = r
                    count += 1
            begins[k * M + m + 1] = count
    return begins, pairs[:count].copy()


@kernel
def densities(
    detections, sensor, sizes, angular, whiten, log_norm, seen, begins, pairs, inflation, log_shares, scales,
    residual, log_density, ratio,
):  # fmt: skip
    """How well each candidate target explains a detection.

    Model: the homothetic density ``g = sum_g rho_g N(z; h(x), kappa_g^2 tau R)``; plain PMHT: one g, rho = kappa = 1.
    Its information relative to ``R^-1`` is ``sum_g p_g / (kappa_g^2 tau)`` with p_g the share of each component.

    Args:
        detections, sensor, sizes, angular: as `find_pairs`.
        whiten, log_norm: of `noise_tables`.
        seen: ``h(x)``; (M, K, D).
        begins, pairs: of `find_pairs`.
        inflation: tau, 1 but while annealing.
        log_shares, scales: ``ln rho_g``, ``kappa_g^2``; (G,).
        residual: ``z_r - h(x_m)``, angles wrapped; (P, D).
        log_density, ratio: ``ln g`` and its relative information; (P,).

    Source: Rago, Willett, Streit (1995). Differs: none.
    """
    M, K = seen.shape[0], seen.shape[1]
    G = scales.size
    for k in range(K):
        s, d = sensor[k], sizes[sensor[k]]
        for m in range(M):
            for p in range(begins[k * M + m], begins[k * M + m + 1]):
                r = pairs[p]
                distance = 0.0
                for a in range(d):
                    v = detections[r, a] - seen[m, k, a]
                    residual[p, a] = wrap_angle(v) if angular[s, a] else v
                for a in range(d):
                    v = 0.0
                    for b in range(a + 1):
                        v += whiten[k, a, b] * residual[p, b]
                    distance += v * v
                best = -np.inf
                for g in range(G):
                    scale = scales[g] * inflation
                    best = max(best, log_shares[g] - 0.5 * (d * np.log(scale) + distance / scale))
                mixture, informed = 0.0, 0.0
                if best > -np.inf:
                    for g in range(G):
                        scale = scales[g] * inflation
                        share = np.exp(log_shares[g] - 0.5 * (d * np.log(scale) + distance / scale) - best)
                        mixture += share
                        informed += share / scale
                ratio[p] = informed / mixture if mixture > 0.0 else 0.0
                log_density[p] = log_norm[k] + best + np.log(mixture) if mixture > 0.0 else -np.inf


@inner_kernel
def predictive_densities(
    detections, sensor, sizes, angular, noise, seen, H, covs, begins, pairs, S, L, HP, residual, log_density, ratio
):
    """As `densities`, with the uncertainty of the state: ``g = N(z; h(x), H P H' + R)``.

    PMHT proper knows R only, so a prediction that is off by more than the noise of a good sensor finds no detection.

    Args:
        detections, sensor, sizes, angular, noise, seen, H, covs: as `find_pairs`.
        begins, pairs: of `find_pairs`.
        S, L, HP: scratch; (D, D), (D, D), (D, n).
        residual, log_density: as `densities`.
        ratio: 1 everywhere; (P,).
    """
    M, K, n = covs.shape[0], covs.shape[1], covs.shape[2]
    for k in range(K):
        s, d = sensor[k], sizes[sensor[k]]
        for m in range(M):
            low, high = begins[k * M + m], begins[k * M + m + 1]
            if low == high:
                continue
            for a in range(d):
                for c in range(n):
                    HP[a, c] = 0.0
                    for b in range(n):
                        HP[a, c] += H[m, k, a, b] * covs[m, k, b, c]
            for a in range(d):
                for b in range(d):
                    S[a, b] = noise[k, a, b]
                    for c in range(n):
                        S[a, b] += HP[a, c] * H[m, k, b, c]
            good = factorise(S, d, L)
            for p in range(low, high):
                value = -0.5 * d * _LOG_TWO_PI
                for a in range(d):
                    v = detections[pairs[p], a] - seen[m, k, a]
                    residual[p, a] = wrap_angle(v) if angular[s, a] else v
                for a in range(d):
                    v = residual[p, a]
                    for b in range(a):
                        v -= L[a, b] * HP[b, 0]
                    HP[a, 0] = v / L[a, a]  # HP is free from here on
                    value -= 0.5 * HP[a, 0] * HP[a, 0] + np.log(L[a, a])
                log_density[p] = value if good else -np.inf
                ratio[p] = 1.0


@kernel
def weigh(offsets, begins, pairs, log_density, log_target, log_clutter, peak, total, weight):
    """E-step: posterior probability that each candidate target is the source of a detection, in logs.

    Model: ``w_mr = pi_m g(z_r; x_m) / (pi_0 / V + sum_p pi_p g(z_r; x_p))``.

    Args:
        offsets: detections of each scan; (K + 1,).
        begins, pairs, log_density: of `find_pairs` and `densities`.
        log_target: ln pi_m; (K, M).
        log_clutter: ``ln(pi_0 / V)``, -inf: no clutter; (K,).
        peak, total: scratch per detection; (N,).
        weight: w; (P,).

    Returns:
        observed-data log-likelihood ``sum_r ln(pi_0 / V + sum_p pi_p g)``, and how many detections nothing explains
        (no clutter and no candidate); these add nothing to the sum.

    Source: Streit, Luginbuhl (1995). Differs: none.
    """
    K, M = log_target.shape
    for k in range(K):
        for r in range(offsets[k], offsets[k + 1]):
            peak[r] = log_clutter[k]
            total[r] = 0.0
        for m in range(M):
            for p in range(begins[k * M + m], begins[k * M + m + 1]):
                weight[p] = log_target[k, m] + log_density[p]
                peak[pairs[p]] = max(peak[pairs[p]], weight[p])
    for p in range(begins[K * M]):
        if weight[p] > -np.inf:
            total[pairs[p]] += np.exp(weight[p] - peak[pairs[p]])
    log_likelihood, unexplained = 0.0, 0
    for k in range(K):
        for r in range(offsets[k], offsets[k + 1]):
            if peak[r] > -np.inf:
                if log_clutter[k] > -np.inf:
                    total[r] += np.exp(log_clutter[k] - peak[r])
                log_likelihood += peak[r] + np.log(total[r])
            else:
                unexplained += 1
    for p in range(begins[K * M]):
        r = pairs[p]
        weight[p] = np.exp(weight[p] - peak[r]) / total[r] if weight[p] > -np.inf else 0.0
    return log_likelihood, unexplained


@kernel
def centroids(begins, pairs, sizes, sensor, residual, weight, ratio, mass, pull, spread, hits):
    """Synthetic measurement of each target and scan, without dividing by a vanishing weight.

    The pair ``(mass, pull) = (sum_r i_r, sum_r i_r (z_r - h(x)))``, ``i_r`` = weight times ratio, says all: centroid
    ``h(x) + pull / mass`` with noise ``R / mass``.

    Args:
        begins, pairs: of `find_pairs`.
        sizes, sensor: (S,), (K,).
        residual, ratio, weight: of `densities` and `weigh`; (P, D), (P,), (P,).
        mass, pull: (M, K), (M, K, D).
        spread: ``sum_r i_r e_r e_r' - e e' / max(sum_r i_r, 1)`` with ``e = sum_r i_r e_r``; (M, K, D, D).
        hits: ``sum_r w_r``, expected number of detections of the target; (M, K).
    """
    M, K, D = pull.shape
    for k in range(K):
        d = sizes[sensor[k]]
        for m in range(M):
            mass[m, k] = 0.0
            hits[m, k] = 0.0
            for a in range(D):
                pull[m, k, a] = 0.0
                for b in range(D):
                    spread[m, k, a, b] = 0.0
            for p in range(begins[k * M + m], begins[k * M + m + 1]):
                informed = weight[p] * ratio[p]
                mass[m, k] += informed
                hits[m, k] += weight[p]
                for a in range(d):
                    pull[m, k, a] += informed * residual[p, a]
                    for b in range(d):
                        spread[m, k, a, b] += informed * residual[p, a] * residual[p, b]
            for a in range(d):
                for b in range(d):
                    spread[m, k, a, b] -= pull[m, k, a] * pull[m, k, b] / max(mass[m, k], 1.0)


@kernel
def information_pairs(mass, pull, H, whiten, means, begin, weighted, dq, domega):
    """``dOmega = mass H' R^-1 H``, ``dq = H' R^-1 (pull + mass H x)``: centroids as information about the state.

    For several sensors at one time, or nodes of a network, these add up; a target without detections gives zeros.

    Args:
        mass, pull: of `centroids`; (M, K), (M, K, D).
        H: Jacobian at ``means``; (M, K, D, n), zero beyond the sensor's components.
        whiten: of `noise_tables`; (K, D, D).
        means: where ``h`` was linearised; (M, K, n).
        begin: first scan of each target; (M,); scans before it give zeros.
        weighted: scratch (D, n).
        dq, domega: (M, K, n), (M, K, n, n).
    """
    M, K, D = pull.shape
    n = means.shape[2]
    for m in range(M):
        for k in range(K):
            for c in range(n):
                dq[m, k, c] = 0.0
                for e in range(n):
                    domega[m, k, c, e] = 0.0
            if k >= begin[m]:
                for a in range(D):
                    for c in range(n):
                        weighted[a, c] = 0.0
                        for b in range(a + 1):
                            weighted[a, c] += whiten[k, a, b] * H[m, k, b, c]
                for a in range(D):
                    value = 0.0
                    for b in range(a + 1):
                        value += whiten[k, a, b] * pull[m, k, b]
                    for c in range(n):
                        value += mass[m, k] * weighted[a, c] * means[m, k, c]
                    for c in range(n):
                        dq[m, k, c] += weighted[a, c] * value
                        for e in range(n):
                            domega[m, k, c, e] += mass[m, k] * weighted[a, c] * weighted[a, e]


@inner_kernel
def posterior_priors(offsets, begins, weight, log_target, log_volume, log_clutter):
    """Priors of the next iteration from the weights: ``pi_m(t) = sum_r w_mr / n(t)``; empty scans keep theirs.

    Args:
        offsets, begins, weight: as in `weigh`.
        log_target, log_clutter: updated; (K, M), (K,).
        log_volume: ``ln V`` of each scan; (K,).

    Source: Streit, Luginbuhl (1995). Differs: none.
    """
    K, M = log_target.shape
    for k in range(K):
        n = offsets[k + 1] - offsets[k]
        if n > 0:
            clutter = 1.0
            for m in range(M):
                share = 0.0
                for p in range(begins[k * M + m], begins[k * M + m + 1]):
                    share += weight[p]
                log_target[k, m] = np.log(share / n) if share > 0.0 else -np.inf
                clutter -= share / n
            # Rounding may leave a little below zero; a scan that had no clutter before has none now.
            if log_clutter[k] > -np.inf:
                log_clutter[k] = np.log(max(clutter, 1e-300)) - log_volume[k]
