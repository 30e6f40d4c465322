"""One scan at a time, compiled: candidates of predictions, joint events of a cluster, update by soft choices."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel, inner_kernel
from jink.estimators.multitarget.pmht_kernels import find_pairs, predictive_densities
from jink.estimators.multitarget.seeing import linearise_one
from jink.estimators.multitarget.small import factorise, solve_rows, symmetrise

__all__ = ["find_candidates", "joint_weights", "soft_update"]


@entry_kernel
def find_candidates(moving, sensing, s, place, noise, detections, begin, mean, cov, gate):
    """Detections in the gates of predictions, and how well these explain them.

    Args:
        moving, sensing: tables.
        s, place, noise, detections: sensor, its state (2 A,), R (1, D, D), (N, D).
        begin: 0: the target is there, 1: not yet; (M,).
        mean, cov: predictions; (M, 1, n), (M, 1, n, n).
        gate: D^2.

    Returns:
        begins (M + 1,), pairs (P,), ``ln N(z; h(x), H P H' + R)`` (P,), residual (P, D), ``h(x)`` (M, 1, D) and its
        Jacobian (M, 1, D, n).
    """
    M, n, D = mean.shape[0], mean.shape[2], detections.shape[1]
    kin, above, below = np.zeros(place.size), np.zeros(D), np.zeros(D)
    seen, H = np.zeros((M, 1, D)), np.zeros((M, 1, D, n))
    for m in range(M):
        if begin[m] == 0:
            linearise_one(moving, sensing, s, place, mean[m, 0].copy(), kin, above, below, seen[m, 0], H[m, 0])
    sensor = np.full(1, s)
    begins, pairs = find_pairs(
        detections, np.array([0, detections.shape[0]]), sensor, sensing.sizes, sensing.angular, noise, seen, H, cov,
        begin, np.full(1, gate),
    )  # fmt: skip
    P = pairs.size
    residual, log_density = np.zeros((P, D)), np.zeros(P)
    predictive_densities(
        detections, sensor, sensing.sizes, sensing.angular, noise, seen, H, cov, begins, pairs, np.zeros((D, D)),
        np.zeros((D, D)), np.zeros((D, n)), residual, log_density, np.zeros(P),
    )  # fmt: skip
    return begins, pairs, log_density, residual, seen, H


@entry_kernel
def joint_weights(begins, pairs, ratio, missed, targets, most, weight):
    """Marginals over all joint events of a cluster: every target takes one of its detections or none, none twice.

    Model: ``p(event) ~ prod_m (ratio of its pair, or missed_m)``. Depth-first, so memory is that of one event.

    Args:
        begins, pairs: candidates; (M + 1,), (P,).
        ratio: ``P_D N / lambda`` of each pair; (P,).
        missed: ``1 - P_D``; (M,).
        targets: of the cluster; (C,).
        most: events to count at most.
        weight: result at the pairs of these targets; (P,).

    Returns:
        whether all events were counted; otherwise ``weight`` is left as it is.
    """
    C = targets.size
    choice, product = np.full(C, -2, dtype=np.int64), np.ones(C + 1)
    used = np.zeros(pairs.max() + 1 if pairs.size else 1, dtype=np.bool_)
    marginal = np.zeros(pairs.size)
    total, events, level = 0.0, 0, 0
    while level >= 0:
        if level == C:
            events += 1
            if events > most:
                return False
            total += product[C]
            for c in range(C):
                if choice[c] >= 0:
                    marginal[choice[c]] += product[C]
            level -= 1
            continue
        m = targets[level]
        if choice[level] >= 0:
            used[pairs[choice[level]]] = False
        # -2: not begun, -1: missed, then the pairs in turn.
        after = begins[m] if choice[level] == -1 else choice[level] + 1
        if choice[level] == -2:
            choice[level] = -1
            product[level + 1] = product[level] * missed[m]
            level += 1
            if level < C:
                choice[level] = -2
            continue
        while after < begins[m + 1] and used[pairs[after]]:
            after += 1
        if after == begins[m + 1]:
            choice[level] = -2
            level -= 1
            continue
        choice[level] = after
        used[pairs[after]] = True
        product[level + 1] = product[level] * ratio[after]
        level += 1
        if level < C:
            choice[level] = -2
    for c in range(C):
        for p in range(begins[targets[c]], begins[targets[c] + 1]):
            weight[p] = marginal[p] / total if total > 0.0 else 0.0
    return True


@inner_kernel
def _gain(P, H, R, d, L, HP, gain):
    """``HP``, factor ``L`` of S and ``gain = S^-1 H P``; whether S was positive definite."""
    n = P.shape[0]
    for a in range(d):
        for c in range(n):
            HP[a, c] = 0.0
            for b in range(n):
                HP[a, c] += H[a, b] * P[b, c]
            gain[a, c] = HP[a, c]
    for a in range(d):
        for b in range(d):
            L[a, b] = R[a, b]
            for c in range(n):
                L[a, b] += HP[a, c] * H[b, c]
    good = factorise(L, d, L)
    if good:
        solve_rows(L, d, gain, n)
    return good


@entry_kernel
def soft_update(d, noise, H, begins, residual, weight, mean, cov):
    """Update predictions by weighted detections, in place.

    Model: ``x = x- + K e``, ``e = sum_r w_r e_r``, ``P = P- - (sum w) K S K' + K [sum w e_r e_r' - e e'] K'``; for one
    detection of weight 1 the Kalman filter.

    Args:
        d: components of the sensor.
        noise: R; (D, D).
        H, begins, residual, weight: (M, 1, D, n), (M + 1,), (P, D), (P,).
        mean, cov: (M, 1, n), (M, 1, n, n).

    Returns:
        number of updates that found no covariance; their prediction stands.

    Source: Bar-Shalom, Fortmann (1988), section 6.4. Differs: none.
    """
    M, n, D = mean.shape[0], mean.shape[2], noise.shape[0]
    L, HP, gain, spread, e = np.zeros((D, D)), np.zeros((D, n)), np.zeros((D, n)), np.zeros((D, D)), np.zeros(D)
    trouble = 0
    for m in range(M):
        total = 0.0
        for p in range(begins[m], begins[m + 1]):
            total += weight[p]
        if not total > 0.0:
            continue
        x, P = mean[m, 0], cov[m, 0]
        if not _gain(P, H[m, 0], noise, d, L, HP, gain):
            trouble += 1
            continue
        for a in range(d):
            e[a] = 0.0
            for b in range(d):
                spread[a, b] = 0.0
        for p in range(begins[m], begins[m + 1]):
            for a in range(d):
                e[a] += weight[p] * residual[p, a]
                for b in range(d):
                    spread[a, b] += weight[p] * residual[p, a] * residual[p, b]
        for a in range(d):
            for b in range(d):
                spread[a, b] -= e[a] * e[b]
        for a in range(d):
            for c in range(n):
                x[c] += gain[a, c] * e[a]
                for f in range(n):
                    P[c, f] -= total * gain[a, c] * HP[a, f]
                    for b in range(d):
                        P[c, f] += gain[a, c] * spread[a, b] * gain[b, f]
        symmetrise(P, n)
    return trouble
