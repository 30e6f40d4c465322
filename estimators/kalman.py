"""One Kalman step for one track: prediction by a matrix, and the update every Gaussian mode ends with.

Letters: m, P mean and covariance; F, Q transition and process noise; H, R observation and measurement noise;
v, S innovation and its covariance. Cross covariances are stored as rows: ``cross = (P H')'`` (d, n).
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import kernel
from jink.estimators.linalg import cholesky, congruence, copy_matrix, mirror, outer_add, solve_lower, solve_upper

__all__ = ["gaussian_update", "predict_linear"]

_CANCELLED = 1e-6
_LOG_TWO_PI = np.log(2.0 * np.pi)


@kernel
def predict_linear(m, P, F, F_transposed, Q, n, product, m_out, P_out):
    """``m_out = F m``, ``P_out = F P F' + Q``; outputs must not overlap inputs."""
    for i in range(n):
        total = 0.0
        for k in range(n):
            total += F[i, k] * m[k]
        m_out[i] = total
    congruence(F, F_transposed, P, Q, n, product, P_out)


@kernel
def gaussian_update(m, P, H, linear, R, cross, S, v, d, n, factor, gain, whitened, m_out, P_out):
    """Posterior of a jointly Gaussian state and measurement, and the log density of the innovation.

    Model: ``K = cross' S^-1``, ``m+ = m + K v``, ``P+ = P - K S K'``, computed as ``P - W'W`` (exactly symmetric).
    Where that cancels more than six digits of a variance and H exists, the Joseph form
    ``(I - K H) P (I - K H)' + K R K'`` replaces it: it keeps 1e-18 next to 1e8, where the short form leaves 1e-8.

    Args:
        m, P: prediction; (n,), (n, n).
        H: observation matrix; (d, n); read only if ``linear``.
        linear: whether ``cross = H P`` holds exactly.
        R: measurement noise of the components present; (d, d).
        cross: ``(P H')'``; (d, n).
        S, v: innovation covariance and innovation; (d, d), (d,).
        d, n: sizes.
        factor, gain, whitened: scratch (d, d), (d, n), (d, 8).
        m_out, P_out: posterior; (n,), (n, n); ``P_out`` must not overlap ``P``.

    Returns:
        log density ``ln N(v; 0, S)``, ``v' S^-1 v``, and whether S was positive definite. Otherwise outputs equal
        the prediction.
    Source: Bar-Shalom, Li, Kirubarajan (2001) 5.2; Joseph form 5.2.3. Differs: none.
    """
    for i in range(n):
        m_out[i] = m[i]
    copy_matrix(P, P_out, n)
    good = cholesky(S, d, factor)
    determinant = 1.0
    for i in range(d):
        determinant *= factor[i, i]
    if not good or not determinant > 0.0:
        return -np.inf, 0.0, False
    nis = 0.0
    for i in range(d):
        total = v[i]
        for k in range(i):
            total -= factor[k, i] * whitened[k, 0]
        whitened[i, 0] = total / factor[i, i]
        nis += whitened[i, 0] * whitened[i, 0]
    copy_matrix(cross, gain, d)
    solve_lower(factor, d, gain, n)
    for j in range(n):
        total = 0.0
        for i in range(d):
            total += gain[i, j] * whitened[i, 0]
        m_out[j] += total
    outer_add(P_out, gain, gain, d, -1.0, n)
    if linear:
        lost = False
        for i in range(n):
            lost = lost or P_out[i, i] < _CANCELLED * P[i, i]
        if lost:
            _joseph(P, H, R, cross, factor, d, n, gain, P_out)
    return -0.5 * (d * _LOG_TWO_PI + nis) - np.log(determinant), nis, True


@kernel
def _joseph(P, H, R, cross, factor, d, n, gain, P_out):
    """``P_out = (I - K H) P (I - K H)' + K R K'`` as ``A + (R K' - H A')' K'`` with ``A = P - K cross``."""
    copy_matrix(P, P_out, n)
    copy_matrix(cross, gain, d)
    solve_lower(factor, d, gain, n)
    solve_upper(factor, d, gain, n)
    outer_add(P_out, gain, cross, d, -1.0, n)
    for i in range(d):
        for j in range(n):
            total = 0.0
            for k in range(d):
                total += R[i, k] * gain[k, j]
            for k in range(n):
                total -= P_out[j, k] * H[i, k]
            cross[i, j] = total
    outer_add(P_out, cross, gain, d, 1.0, n)
    mirror(P_out, n)
