"""Hard association: each target takes one detection, or none."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel
from jink.estimators.linalg import wrap_angle
from jink.estimators.multitarget.bank_smoothing import merge
from jink.estimators.multitarget.seeing import linearise_one
from jink.estimators.multitarget.smoothing import PLAIN, centroid_update

__all__ = ["absorb"]


@entry_kernel
def absorb(moving, sensing, s, place, noise, detections, choice, jm, jP, probs):
    """Extended Kalman update of every mode of every target by its own detection.

    Args:
        moving, sensing: tables.
        s, place, noise: sensor, its state (2 A,), R (D, D).
        detections, choice: (N, D); index of each target's detection, -1: none; (M,).
        jm, jP, probs: predictions by mode; (M, J, n), (M, J, n, n), (M, J).

    Returns:
        posterior by mode; (M, J, n), (M, J, n, n), (M, J).
    """
    M, J, n = jm.shape
    D, d = detections.shape[1], sensing.sizes[s]
    mean, cov, posterior = jm.copy(), jP.copy(), probs.copy()
    kin, above, below, seen, H = np.zeros(place.size), np.zeros(D), np.zeros(D), np.zeros(D), np.zeros((D, n))
    small, gain, HP, e, pull = np.zeros((2, D, D)), np.zeros((D, n)), np.zeros((D, n)), np.zeros(D), np.zeros(D)
    spread, x, P = np.zeros((D, D)), np.zeros(n), np.zeros((n, n))
    for m in range(M):
        if choice[m] < 0:
            continue
        merge(probs[m], jm[m], jP[m], x, P)
        linearise_one(moving, sensing, s, place, x, kin, above, below, seen, H)
        for a in range(d):
            pull[a] = detections[choice[m], a] - seen[a]
            if sensing.angular[s, a]:
                pull[a] = wrap_angle(pull[a])
        top = -np.inf
        for j in range(J):
            density, _ = centroid_update(
                jm[m, j], jP[m, j], H, noise, d, 1.0, pull, x, spread, PLAIN, small, gain, HP, e, mean[m, j], cov[m, j]
            )
            posterior[m, j] = density + np.log(max(probs[m, j], 1e-9))
            top = max(top, posterior[m, j])
        total = 0.0
        for j in range(J):
            posterior[m, j] = np.exp(posterior[m, j] - top)
            total += posterior[m, j]
        for j in range(J):
            posterior[m, j] /= total
    return mean, cov, posterior
