"""One Kalman step for one track: prediction by a matrix, and the update every Gaussian mode ends with.

Letters: m, P mean and covariance; F, Q transition and process noise; H, R observation and measurement noise;
v, S innovation and its covariance. Cross covariances are stored as rows: ``cross = (P H')'`` (d, n).
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import kernel
from jink.estimators.linalg import (
    cholesky,
    clear_rows,
    congruence,
    copy_rows,
    mirror,
    outer_add,
    solve_lower,
    solve_upper,
)

__all__ = ["gaussian_update", "posterior_from_deviations", "predict_linear"]

_CANCELLED = 1e-6
_LOG_TWO_PI = np.log(2.0 * np.pi)


@kernel
def predict_linear(m, P, F_transposed, Q, n, product, m_out, P_out):
    """``m_out = F m``, ``P_out = F P F' + Q``; outputs must not overlap inputs."""
    for i in range(n):
        total = 0.0
        for k in range(n):
            total += F_transposed[k, i] * m[k]
        m_out[i] = total
    congruence(F_transposed, P, Q, n, product, P_out)


@kernel
def gaussian_update(m, P, R, cross, S, v, d, n, factor, gain, whitened, m_out, P_out):
    """Posterior of a jointly Gaussian state and measurement, and the log density of the innovation.

    Model: ``K = cross' S^-1``, ``m+ = m + K v``, ``P+ = P - K S K'``, computed as ``P - W'W`` (exactly symmetric).
    Where that cancels more than six digits (of a variance, or of S down to R) the result says so, and
    `posterior_from_deviations` gives the covariance as a sum of squares instead.

    Args:
        m, P: prediction; (n,), (n, n).
        R: measurement noise of the components present; (d, d).
        cross: ``(P H')'``; (d, n).
        S, v: innovation covariance and innovation; (d, d), (d,).
        d, n: sizes.
        factor, gain, whitened: scratch (d, d), (d, n), (d, 8); ``factor`` returns the Cholesky factor of S.
        m_out, P_out: posterior; (n,), (n, n); must not overlap ``m``, ``P``; the prediction if S is no covariance.

    Returns:
        log density ``ln N(v; 0, S)``, ``v' S^-1 v``, whether S was positive definite, whether digits were lost.

    Source: Bar-Shalom, Li, Kirubarajan (2001) 5.2. Differs: none.
    """
    for i in range(n):
        m_out[i] = m[i]
    copy_rows(P, P_out, n)
    good = cholesky(S, d, factor)
    determinant, log_determinant = 1.0, 0.0
    for i in range(d):
        good = good and factor[i, i] > 0.0
        determinant *= factor[i, i]
        if not 1e-100 < determinant < 1e100:
            log_determinant += np.log(determinant)
            determinant = 1.0
    if not good:
        return -np.inf, 0.0, False, False
    nis = 0.0
    for i in range(d):
        total = v[i]
        for k in range(i):
            total -= factor[k, i] * whitened[k, 0]
        whitened[i, 0] = total / factor[i, i]
        nis += whitened[i, 0] * whitened[i, 0]
    copy_rows(cross, gain, d)
    solve_lower(factor, d, gain, n)
    for j in range(n):
        total = 0.0
        for i in range(d):
            total += gain[i, j] * whitened[i, 0]
        m_out[j] += total
    outer_add(P_out, gain, gain, 0, d, -1.0, n)
    mirror(P_out, n)  # rounding in the large P is asymmetry in a small P+
    lost = False
    for i in range(n):
        lost = lost or P_out[i, i] < _CANCELLED * P[i, i]
    for i in range(d):
        lost = lost or R[i, i] < _CANCELLED * factor[i, i] * factor[i, i]
    return -0.5 * (d * _LOG_TWO_PI + nis) - log_determinant - np.log(determinant), nis, True, lost


@kernel
def posterior_from_deviations(points, seen, count, centre, other, R, cross, factor, d, n, gain, P_out):
    """``P+ = sum_s w_s e_s e_s' + K R K'`` with ``e_s = x_s - K y_s``: the Joseph form over points.

    A sum of squares cannot turn indefinite, whatever cancels: it keeps 1e-18 next to 1e8, where ``P - K S K'`` leaves
    1e-8. For a linear measurement the rows of a root of P serve as points.

    Args:
        points, seen: deviations of state and measurement; (S, n), (S, d); ``points`` become ``e_s``.
        count, centre, other: number of points, weight of the first and of the others.
        R, cross, factor: noise (d, d), ``(P H')'`` (d, n; overwritten), Cholesky factor of S (d, d; overwritten).
        d, n, gain: sizes, scratch (d, n).
        P_out: posterior covariance; (n, n).
    """
    copy_rows(cross, gain, d)
    solve_lower(factor, d, gain, n)
    solve_upper(factor, d, gain, n)
    for s in range(count):
        for c in range(n):
            for a in range(d):
                points[s, c] -= seen[s, a] * gain[a, c]
    cholesky(R, d, factor)
    for a in range(d):
        for c in range(n):
            cross[a, c] = 0.0
            for k in range(a, d):
                cross[a, c] += factor[a, k] * gain[k, c]
    clear_rows(P_out, n)
    outer_add(P_out, cross, cross, 0, d, 1.0, n)
    outer_add(P_out, points, points, 0, 1, centre, n)
    outer_add(P_out, points, points, 1, count, other, n)
    mirror(P_out, n)
