"""How much each track is worth: what the newest scan says for and against it, beside clutter and the other tracks."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel, inner_kernel

__all__ = ["assign_in_order", "score_tracks"]


@inner_kernel
def score_tracks(begins, pairs, detected, density, explained, likelihood, score):
    """Log-likelihood ratio of one scan with and without each track.

    Model: ``s_m = ln[1 - P_D + P_D sum_r N(z_r; h(x-_m), S) / f_r]``, where ``f_r = lambda + sum_p!=m P_D N_pr``
    explains detection r without track m: of two tracks on one target neither is worth much, and a detection that
    another track explains better is no proof.

    Args:
        begins, pairs: candidates of `find_pairs` for this scan alone; (M + 1,), (P,).
        detected, density: P_D of each target (M,), 0: out of view; lambda.
        explained: scratch per detection; (N,).
        likelihood: ``P_D N_mr``; (P,).
        score: result; (M,); 0 for a target out of view.
    """
    M = detected.size
    for r in range(explained.size):
        explained[r] = density
    for p in range(begins[M]):
        explained[pairs[p]] += likelihood[p]
    for m in range(M):
        total = 1.0 - detected[m]
        for p in range(begins[m], begins[m + 1]):
            rest = max(explained[pairs[p]] - likelihood[p], density)
            # Without clutter a lone detection is proof; a finite one, so that a later silence can outweigh it.
            total += likelihood[p] / max(rest, 1e-6 * likelihood[p], 1e-300)
        score[m] = np.log(max(total, 1e-12))


@entry_kernel
def assign_in_order(order, target, pairs, targets, detections):
    """Detections to targets one to one: pairs take each other in the given order while both are free.

    Args:
        order: of the pairs, the surest first; (P,).
        target, pairs: of each pair; (P,).
        targets, detections: how many there are.

    Returns:
        the pair each target took, -1: none, (M,); whether each detection was taken, (N,).
    """
    taken, used = np.full(targets, -1), np.zeros(detections, dtype=np.bool_)
    for p in order:
        if taken[target[p]] < 0 and not used[pairs[p]]:
            taken[target[p]] = p
            used[pairs[p]] = True
    return taken, used
