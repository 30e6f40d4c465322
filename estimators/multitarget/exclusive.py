"""Association where a target gives at most one detection per scan: the marginals of all joint events.

PMHT lets a target own any number of detections, so two targets share what one of them gave. Here the marginals of the
standard model are used in their place: each target is detected once with P_D or missed, each detection has one source.
Targets that share no detection are apart; of a cluster that does, the joint events are counted one by one, or, where
there are too many, weighed by loopy belief propagation, whose cost is linear.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel, inner_kernel

__all__ = ["MOST_EVENTS", "exclude", "one_scan_weights"]

_HIGHEST, _NOTHING = 200.0, 1e-6
MOST_EVENTS = 512
"""Joint events of a cluster and scan that PMHT counts one by one."""


@inner_kernel
def _find(parent, m):
    while parent[m] != m:
        parent[m] = parent[parent[m]]
        m = parent[m]
    return m


@inner_kernel
def _clusters(begins, pairs, M, parent, holder, head, follow):
    """Targets that share detections as chains: ``head[root]``, then ``follow[m]`` until -1."""
    for m in range(M):
        parent[m] = m
        head[m] = -1
        for p in range(begins[m], begins[m + 1]):
            holder[pairs[p]] = -1
    for m in range(M):
        for p in range(begins[m], begins[m + 1]):
            r = pairs[p]
            if holder[r] < 0:
                holder[r] = m
            else:
                parent[_find(parent, m)] = _find(parent, holder[r])
    for m in range(M - 1, -1, -1):
        root = _find(parent, m)
        follow[m] = head[root]
        head[root] = m


@inner_kernel
def _count_events(begins, pairs, head, follow, ratio, missed, used, product, choice, level_of, weight):
    """Marginals over all joint events of a cluster, in place of its weights.

    Model: ``p(event) ~ prod_m (ratio of its pair, or missed_m)``. Depth-first, so memory is that of one event.
    """
    C, m = 0, head
    while m >= 0:
        level_of[C] = m
        for p in range(begins[m], begins[m + 1]):
            weight[p] = 0.0
            used[pairs[p]] = False
        C, m = C + 1, follow[m]
    total, level = 0.0, 0
    product[0], choice[0] = 1.0, -2
    while level >= 0:
        if level == C:
            total += product[C]
            for c in range(C):
                if choice[c] >= 0:
                    weight[choice[c]] += product[C]
            level -= 1
            continue
        m = level_of[level]
        # -2: not begun, -1: missed, then the pairs in turn.
        if choice[level] == -2:
            choice[level] = -1
            product[level + 1] = product[level] * missed[m]
        else:
            after = begins[m]
            if choice[level] >= 0:
                used[pairs[choice[level]]] = False
                after = choice[level] + 1
            while after < begins[m + 1] and used[pairs[after]]:
                after += 1
            if after == begins[m + 1]:
                level -= 1
                continue
            choice[level] = after
            used[pairs[after]] = True
            product[level + 1] = product[level] * ratio[after]
        level += 1
        if level < C:
            choice[level] = -2
    for c in range(C):
        for p in range(begins[level_of[c]], begins[level_of[c] + 1]):
            weight[p] = weight[p] / total if total > 0.0 else 0.0


@inner_kernel
def _propagate(begins, pairs, head, follow, odds, base, missed, rounds, incoming, message, weight):
    """Marginals of a cluster by messages.

    Model: ``mu_mr = psi_m(r) / (psi_m(0) + sum_r'!=r psi_m(r') nu_r'm)``, ``nu_rm = 1 / (lambda + sum_m'!=m mu_m'r)``;
    ``odds`` are psi, ``base`` lambda, on one scale. The weights of a detection are divided by their sum where that is
    above one.
    """
    m = head
    while m >= 0:
        for p in range(begins[m], begins[m + 1]):
            message[p] = 1.0 / base
        m = follow[m]
    for turn in range(rounds + 1):
        m = head
        while m >= 0:
            for p in range(begins[m], begins[m + 1]):
                incoming[pairs[p]] = base
            m = follow[m]
        m = head
        while m >= 0:
            low, high = begins[m], begins[m + 1]
            total = missed[m]
            for p in range(low, high):
                weight[p] = odds[p] * message[p]
                total += weight[p]
            for p in range(low, high):
                if turn == rounds:
                    weight[p] /= total
                else:
                    # Subtracting from the total loses the digits of a dominant pair, so its rest is summed.
                    rest = total - weight[p]
                    if rest < 1e-6 * total:
                        rest = missed[m]
                        for q in range(low, high):
                            if q != p:
                                rest += odds[q] * message[q]
                    weight[p] = odds[p] / rest
                    incoming[pairs[p]] += weight[p]
            m = follow[m]
        if turn < rounds:
            m = head
            while m >= 0:
                for p in range(begins[m], begins[m + 1]):
                    message[p] = 1.0 / max(incoming[pairs[p]] - weight[p], base)
                m = follow[m]
    # Messages that have not settled can give a detection to two targets; a detection has one source at most.
    m = head
    while m >= 0:
        for p in range(begins[m], begins[m + 1]):
            incoming[pairs[p]] = 0.0
        m = follow[m]
    m = head
    while m >= 0:
        for p in range(begins[m], begins[m + 1]):
            incoming[pairs[p]] += weight[p]
        m = follow[m]
    m = head
    while m >= 0:
        for p in range(begins[m], begins[m + 1]):
            weight[p] /= max(incoming[pairs[p]], 1.0)
        m = follow[m]


@entry_kernel
def exclude(offsets, begins, pairs, log_odds, missed, clutter, rounds, most, weight):
    """Marginal probability of each pair under at most one detection per target and one target per detection.

    Model: ``p(a) ~ prod_m psi_m(a_m)`` with ``psi_m(r) = P_D g_mr``, ``psi_m(0) = 1 - P_D``, and lambda for a
    detection without target. Lambda counts as no less than exp(-200) of the likeliest pair of a cluster, exp(-600 / C)
    where the events of its C targets are counted; ``1 - P_D`` as no less than 1e-12. Pairs a million times less likely
    than a miss and a false alarm count for nothing, so that no far detection joins two clusters.

    Args:
        offsets: detections of each scan; (K + 1,).
        begins, pairs: of `find_pairs`.
        log_odds: ``ln(P_D g_mr)`` of each pair; (P,).
        missed: ``1 - P_D``; (K, M).
        clutter: lambda; (K,).
        rounds: exchanges of messages, in clusters of more than ``most`` joint events.
        most: joint events that are counted one by one.
        weight: result; (P,); may not be ``log_odds``.

    Returns:
        targets of the largest cluster that was weighed by messages.

    Source: Fortmann, Bar-Shalom, Scheffe (1983); Williams, Lau (2014). Differs: a fixed number of rounds, and
    then no detection has weights that sum to more than one.
    """
    K, M = missed.shape
    N, P = offsets[K], begins[K * M]
    parent, head, follow = np.zeros(M, dtype=np.int64), np.zeros(M, dtype=np.int64), np.zeros(M, dtype=np.int64)
    choice, level_of, holder = np.zeros(M, dtype=np.int64), np.zeros(M, dtype=np.int64), np.zeros(N, dtype=np.int64)
    product, least, used = np.zeros(M + 1), np.zeros(M), np.zeros(N, dtype=np.bool_)
    odds, message, incoming, found = np.zeros(P), np.zeros(P), np.zeros(N), np.zeros(P)
    start, own, source = np.zeros(M + 1, dtype=np.int64), np.zeros(P, dtype=np.int64), np.zeros(P, dtype=np.int64)
    loopy = 0
    for k in range(K):
        count, log_clutter = 0, np.log(max(clutter[k], 1e-300))
        for m in range(M):
            least[m] = max(missed[k, m], 1e-12)
            least_odds = log_clutter + np.log(_NOTHING * least[m])
            for p in range(begins[k * M + m], begins[k * M + m + 1]):
                weight[p] = 0.0
                if log_odds[p] > least_odds:
                    own[count], source[count] = pairs[p], p
                    count += 1
            start[m + 1] = count
        if count == 0:
            continue
        _clusters(start, own, M, parent, holder, head, follow)
        for root in range(M):
            top, events, C, m = log_clutter, 1.0, 0, head[root]
            while m >= 0:
                for p in range(start[m], start[m + 1]):
                    top = max(top, log_odds[source[p]])
                events *= 1.0 + start[m + 1] - start[m]
                C, m = C + 1, follow[m]
            if events == 1.0:
                continue
            exact = C == 1 or events <= most
            floor = min(_HIGHEST, 3.0 * _HIGHEST / C) if exact else _HIGHEST
            base = max(clutter[k] * np.exp(-top), np.exp(-floor))
            m = head[root]
            while m >= 0:
                for p in range(start[m], start[m + 1]):
                    odds[p] = np.exp(max(log_odds[source[p]] - top, -_HIGHEST)) / (base if exact else 1.0)
                m = follow[m]
            if exact:
                _count_events(start, own, head[root], follow, odds, least, used, product, choice, level_of, found)
            else:
                loopy = max(loopy, C)
                _propagate(start, own, head[root], follow, odds, base, least, rounds, incoming, message, found)
        for p in range(count):
            weight[source[p]] = found[p]
    return loopy


@entry_kernel
def one_scan_weights(begins, pairs, log_density, detected, density, detections, rounds, most):
    """`exclude` of one scan.

    Args:
        begins, pairs: candidates; (M + 1,), (P,).
        log_density: ``ln N(z; h(x), S)`` of each pair; (P,).
        detected, density: P_D (M,), lambda.
        detections: N.
        rounds, most: as of `exclude`.

    Returns:
        weights (P,), targets of the largest cluster that was weighed by messages.
    """
    M = detected.size
    log_odds, weight, missed = np.zeros(pairs.size), np.zeros(pairs.size), np.zeros((1, M))
    for m in range(M):
        missed[0, m] = 1.0 - detected[m]
        for p in range(begins[m], begins[m + 1]):
            log_odds[p] = log_density[p] + np.log(max(detected[m], 1e-300))
    loopy = exclude(
        np.array([0, detections]), begins, pairs, log_odds, missed, np.full(1, density), rounds, most, weight
    )
    return weight, loopy
