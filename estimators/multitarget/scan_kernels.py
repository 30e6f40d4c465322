"""One scan at a time, compiled: candidates of predictions, update by soft choices."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel
from jink.estimators.multitarget.bank_smoothing import merge
from jink.estimators.multitarget.pmht_kernels import find_pairs, predictive_densities
from jink.estimators.multitarget.seeing import linearise_one
from jink.estimators.multitarget.smoothing import AROUND, centroid_update

__all__ = ["find_candidates", "soft_update"]


@entry_kernel
def find_candidates(moving, sensing, s, place, noise, detections, begin, jm, jP, probs, gate):
    """Detections in the gates of predictions, and how well these explain them.

    Args:
        moving, sensing: tables.
        s, place, noise, detections: sensor, its state (2 A,), R (1, D, D), (N, D).
        begin: 0: the target is there, 1: not yet; (M,).
        jm, jP, probs: predictions by mode; (M, J, n), (M, J, n, n), (M, J).
        gate: D^2.

    Returns:
        predictions over all modes (M, 1, n), (M, 1, n, n); begins (M + 1,), pairs (P,),
        ``ln N(z; h(x), H P H' + R)`` (P,), residual (P, D), ``h(x)`` (M, 1, D) and its Jacobian (M, 1, D, n).
    """
    M, n, D = jm.shape[0], jm.shape[2], detections.shape[1]
    mean, cov = np.zeros((M, 1, n)), np.zeros((M, 1, n, n))
    for m in range(M):
        merge(probs[m], jm[m], jP[m], mean[m, 0], cov[m, 0])
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
    return mean, cov, begins, pairs, log_density, residual, seen, H


@entry_kernel
def soft_update(d, noise, H, begins, residual, weight, at, jm, jP, probs):
    """Update predictions by weighted detections.

    Model: ``x = x- + K e``, ``e = sum_r w_r e_r``, ``P = P- - (sum w) K S K' + K [sum w e_r e_r' - e e'] K'``; for one
    detection of weight 1 the Kalman filter. Modes are weighed by ``N(z~; S)^(sum w)``, z~ the mean of the detections.

    Args:
        d: components of the sensor.
        noise: R; (D, D).
        H, begins, residual, weight: (M, 1, D, n), (M + 1,), (P, D), (P,).
        at: where H was taken; (M, 1, n).
        jm, jP, probs: predictions by mode; (M, J, n), (M, J, n, n), (M, J).

    Returns:
        posterior by mode, (M, J, n), (M, J, n, n), (M, J); over all modes (M, 1, n), (M, 1, n, n); and how many
        updates found no covariance; their prediction stands.

    Source: Bar-Shalom, Fortmann (1988), section 6.4. Differs: none.
    """
    M, J, n = jm.shape
    D = noise.shape[0]
    means, covs, posterior = jm.copy(), jP.copy(), probs.copy()
    mean, cov = np.zeros((M, 1, n)), np.zeros((M, 1, n, n))
    small, HP, gain, e = np.zeros((2, D, D)), np.zeros((D, n)), np.zeros((D, n)), np.zeros(D)
    pull, spread = np.zeros(D), np.zeros((D, D))
    trouble = 0
    for m in range(M):
        mass = 0.0
        for a in range(d):
            pull[a] = 0.0
            for b in range(d):
                spread[a, b] = 0.0
        for p in range(begins[m], begins[m + 1]):
            mass += weight[p]
            for a in range(d):
                pull[a] += weight[p] * residual[p, a]
                for b in range(d):
                    spread[a, b] += weight[p] * residual[p, a] * residual[p, b]
        for a in range(d):
            for b in range(d):
                spread[a, b] -= pull[a] * pull[b]
        if mass > 0.0:
            top, total = -np.inf, 0.0
            for j in range(J):
                density, good = centroid_update(
                    jm[m, j], jP[m, j], H[m, 0], noise, d, mass, pull, at[m, 0], spread, AROUND, small, gain, HP, e,
                    means[m, j], covs[m, j],
                )  # fmt: skip
                if not good:
                    trouble += 1
                posterior[m, j] = density + np.log(max(probs[m, j], 1e-9))
                top = max(top, posterior[m, j])
            for j in range(J):
                posterior[m, j] = np.exp(posterior[m, j] - top)
                total += posterior[m, j]
            for j in range(J):
                posterior[m, j] /= total
        merge(posterior[m], means[m], covs[m], mean[m, 0], cov[m, 0])
    return means, covs, posterior, mean, cov, trouble
