"""The unscented transform and the two places a filter uses it.

Points are rows: ``points[0] = m``, ``points[i], points[n + i] = m +- radius U[i-1]`` with ``P = U' U``. The points
are redrawn from the prediction before the measurement, so that Q is seen by the measurement moments.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import call_transition, kernel
from jink.estimators.linalg import centre_rows, cholesky, clear_tails, copy_rows, offset_rows, outer_add

__all__ = ["draw_points", "point_weights", "points_covariance", "points_mean", "unscented_predict"]


@kernel
def point_weights(n, alpha, beta, kappa):
    """Radius of the sigma points and weights: (radius, centre in the covariance, every other).

    Model: ``lambda = alpha^2 (n + kappa) - n``; ``w0m = lambda / (n + lambda)``, ``w0c = w0m + 1 - alpha^2 + beta``,
    ``wi = 1 / (2 (n + lambda))``, radius ``sqrt(n + lambda)``.
    Source: Wan & van der Merwe (2000); CN202211553542 claim 3, A2-A4. Differs: none.
    """
    spread = alpha * alpha * (n + kappa)
    return np.sqrt(spread), (spread - n) / spread + 1.0 - alpha * alpha + beta, 0.5 / spread


@kernel
def draw_points(m, upper, n, radius, points):
    """Sigma points of ``N(m, upper' upper)`` into ``points`` (2 n + 1, n)."""
    for c in range(n):
        points[0, c] = m[c]
    offset_rows(upper, n, radius, points)


@kernel
def points_mean(points, count, n, other, mean):
    """Weighted mean of the points, taken about the centre point; then ``points`` hold deviations from it.

    The weights sum to one, so ``w0 X_0 + w sum X_i = X_0 + w sum (X_i - X_0)``, with less rounding. The padding of
    ``points`` is zero (`clear_tails` before they were written).
    """
    centre_rows(points, count, n, other, mean)


@kernel
def points_covariance(points, count, n, centre, other, out):
    """``out += sum_s wc[s] points[s] points[s]'`` of deviations; the centre point has its own weight."""
    outer_add(out, points, points, 0, 1, centre, n)
    outer_add(out, points, points, 1, count, other, n)


@kernel
def unscented_predict(transition, params, dt, m, P, Q, n, tuning, upper, points, moved, m_out, P_out):
    """Predicted mean and covariance of a nonlinear transition; returns whether P was positive semidefinite.

    Model: ``m- = sum wm f(X_i)``, ``P- = sum wc (f(X_i) - m-)(f(X_i) - m-)' + Q``.

    Args:
        transition, params, dt: address of ``f``, its constants, seconds.
        m, P, Q: posterior and process noise; (n,), (n, n), (n, n).
        tuning: alpha, beta, kappa; (3,).
        upper, points, moved: scratch (n, n), (2 n + 1, n) twice.
        m_out, P_out: prediction; must not overlap ``m``, ``P``.

    Source: Julier & Uhlmann (2004); CN202211553542 claim 3, A2-A6. Differs: mean taken about the centre
    point (less rounding).
    """
    good = cholesky(P, n, upper)
    radius, centre, other = point_weights(n, tuning[0], tuning[1], tuning[2])
    draw_points(m, upper, n, radius, points)
    count = 2 * n + 1
    clear_tails(moved, count, n)
    for s in range(count):
        call_transition(transition, points[s, :n], dt, params, moved[s, :n])
    points_mean(moved, count, n, other, m_out)
    copy_rows(Q, P_out, n)
    points_covariance(moved, count, n, centre, other, P_out)
    return good
