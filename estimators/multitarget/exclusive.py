"""Association where a target gives at most one detection per scan: loopy belief propagation over candidate pairs.

PMHT lets a target own any number of detections, so two targets share what one of them gave. Here the marginals of the
standard model are used in their place: each target is detected once with P_D or missed, each detection has one source.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import kernel

__all__ = ["exclude"]

_HIGHEST = 200.0


@kernel
def exclude(offsets, begins, pairs, log_odds, missed, clutter, rounds, incoming, message, weight):
    """Marginal probability of each pair under at most one detection per target and one target per detection.

    Model: ``p(a) ~ prod_m psi_m(a_m)`` with ``psi_m(r) = P_D g_mr``, ``psi_m(0) = 1 - P_D``, and lambda for a
    detection without target. Messages ``mu_mr = psi_m(r) / (psi_m(0) + sum_r'!=r psi_m(r') nu_r'm)``,
    ``nu_rm = 1 / (lambda + sum_m'!=m mu_m'r)``.

    Args:
        offsets: detections of each scan; (K + 1,).
        begins, pairs: of `find_pairs`.
        log_odds: ``ln(P_D g_mr)`` of each pair; (P,).
        missed: ``1 - P_D``; (K, M).
        clutter: lambda; (K,).
        rounds: exchanges of messages.
        incoming: scratch per detection; (N,).
        message: scratch per pair; (P,).
        weight: result; (P,); may not be ``log_odds``.

    Source: Williams, Lau (2014). Differs: a fixed number of rounds; densities below exp(-200) of the likeliest of a
    scan count as such.
    """
    K, M = missed.shape
    for k in range(K):
        first, last = begins[k * M], begins[(k + 1) * M]
        if first == last:
            continue
        top = np.log(max(clutter[k], 1e-300))
        for p in range(first, last):
            top = max(top, log_odds[p])
        base = max(clutter[k] * np.exp(-top), np.exp(-_HIGHEST))
        for p in range(first, last):
            message[p] = 1.0 / base
        for turn in range(rounds + 1):
            for r in range(offsets[k], offsets[k + 1]):
                incoming[r] = base
            for m in range(M):
                low, high = begins[k * M + m], begins[k * M + m + 1]
                total = max(missed[k, m], 1e-12)
                for p in range(low, high):
                    weight[p] = np.exp(max(log_odds[p] - top, -_HIGHEST)) * message[p]
                    total += weight[p]
                if turn == rounds:
                    for p in range(low, high):
                        weight[p] /= total
                else:
                    for p in range(low, high):
                        # Subtracting from the total loses the digits of a dominant pair, so its rest is summed.
                        rest = total - weight[p]
                        if rest < 1e-6 * total:
                            rest = max(missed[k, m], 1e-12)
                            for q in range(low, high):
                                if q != p:
                                    rest += weight[q]
                        weight[p] = np.exp(max(log_odds[p] - top, -_HIGHEST)) / rest
                        incoming[pairs[p]] += weight[p]
            if turn < rounds:
                for p in range(first, last):
                    message[p] = 1.0 / max(incoming[pairs[p]] - weight[p], base)
