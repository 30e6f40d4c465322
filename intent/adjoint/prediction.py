"""Unscented prediction of one mode of one track, and back."""

from __future__ import annotations

import math

from jink.estimators.compiled import kernel
from jink.intent.adjoint.noise import add_noise, noise_adjoint
from jink.intent.adjoint.velocities import shapes, shapes_adjoint, velocities, velocities_adjoint

__all__ = ["predict", "predict_adjoint", "upper_adjoint", "upper_factor"]

_ZERO_PIVOT = 1e-14
_NEGATIVE_PIVOT = 1e-9


@kernel
def upper_factor(P, n, upper):
    """Upper Cholesky factor with zero rows where a pivot vanishes; returns whether P was a covariance."""
    good = True
    for i in range(n):
        pivot = P[i, i]
        for k in range(i):
            pivot -= upper[k, i] * upper[k, i]
        good = good and pivot >= -_NEGATIVE_PIVOT * abs(P[i, i])
        scale = 1.0 / math.sqrt(pivot) if pivot > _ZERO_PIVOT * P[i, i] else 0.0
        upper[i, i] = pivot * scale
        for j in range(i + 1, n):
            value = P[i, j]
            for k in range(i):
                value -= upper[k, i] * upper[k, j]
            upper[i, j] = value * scale
        for j in range(i):
            upper[i, j] = 0.0
    return good


@kernel
def upper_adjoint(upper, n, upper_bar, P_bar):
    """Add to the symmetric ``P_bar`` what the derivative by the factor says; ``upper_bar`` is overwritten."""
    for i in range(n - 1, -1, -1):
        pivot = upper[i, i]
        if not pivot > 0.0:
            continue
        scale = 1.0 / pivot
        own = upper_bar[i, i]
        for j in range(i + 1, n):
            upper_bar[i, j] *= scale
            own -= upper_bar[i, j] * upper[i, j]
        own *= 0.5 * scale
        P_bar[i, i] += own
        for k in range(i):
            upper_bar[k, i] -= 2.0 * own * upper[k, i]
        for j in range(i + 1, n):
            value = upper_bar[i, j]
            P_bar[i, j] += 0.5 * value
            P_bar[j, i] += 0.5 * value
            for k in range(i):
                upper_bar[k, i] -= value * upper[k, j]
                upper_bar[k, j] -= value * upper[k, i]


@kernel
def _point(m, upper, n, s, radius, x):
    """Sigma point ``s`` of ``N(m, upper' upper)`` into ``x``."""
    if s == 0:
        for c in range(n):
            x[c] = m[c]
    elif s <= n:
        for c in range(n):
            x[c] = m[c] + radius * upper[s - 1, c]
    else:
        for c in range(n):
            x[c] = m[c] - radius * upper[s - 1 - n, c]


@kernel
def predict(axes, second, row, dt, m, P, n, upper, moved, small, x, m_out, P_out):
    """Predicted mean and covariance; ``upper`` (N, N) and ``moved`` (2 N + 1, N) keep the factor and the deviations."""
    good = upper_factor(P, n, upper)
    radius = math.sqrt(float(n))
    other = 0.5 / n
    end, mean = small[0], small[1]
    for c in range(n):
        m_out[c] = 0.0
    for s in range(2 * n + 1):
        _point(m, upper, n, s, radius, x)
        velocities(axes, second, row, x, end, mean)
        for i in range(axes):
            moved[s, 2 * i] = x[2 * i] + dt * mean[i]
            moved[s, 2 * i + 1] = end[i]
        shapes(axes, second, row, x, moved[s])
        if s > 0:
            for c in range(n):
                m_out[c] += moved[s, c] - moved[0, c]
    for c in range(n):
        m_out[c] = moved[0, c] + other * m_out[c]
        for s in range(2 * n + 1):
            moved[s, c] -= m_out[c]
    for i in range(n):
        for j in range(i, n):
            total = 0.0
            for s in range(1, 2 * n + 1):
                total += moved[s, i] * moved[s, j]
            total = other * total + 2.0 * moved[0, i] * moved[0, j]
            P_out[i, j] = total
            P_out[j, i] = total
    add_noise(axes, second, row, m, small, P_out)
    return good


@kernel
def predict_adjoint(
    axes, second, row, dt, m, n, upper, moved, small, x, x_bar, out_bar, upper_bar,
    m_out_bar, P_out_bar, m_bar, P_bar, row_bar,
):  # fmt: skip
    """Add to ``m_bar``, ``P_bar``, ``row_bar`` what derivatives by the prediction say.

    ``upper`` and ``moved`` are those of `predict`; ``m_out_bar`` is overwritten, ``P_out_bar`` symmetric.
    """
    radius = math.sqrt(float(n))
    other = 0.5 / n
    noise_adjoint(axes, second, row, m, small, P_out_bar, m_bar, row_bar)
    end_bar, mean_bar = small[0], small[1]
    for i in range(n):
        for j in range(n):
            upper_bar[i, j] = 0.0
    for i in range(n):  # deviations of all but the centre sum to zero: only the centre's reaches the mean
        total = 0.0
        for j in range(n):
            total += P_out_bar[i, j] * moved[0, j]
        out_bar[i] = 4.0 * total
        m_out_bar[i] -= 4.0 * total
    for s in range(2 * n + 1):
        if s > 0:
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += P_out_bar[i, j] * moved[s, j]
                out_bar[i] = other * (2.0 * total + m_out_bar[i])
        _point(m, upper, n, s, radius, x)
        for c in range(n):
            x_bar[c] = 0.0
        for i in range(axes):
            x_bar[2 * i] = out_bar[2 * i]
            mean_bar[i] = dt * out_bar[2 * i]
            end_bar[i] = out_bar[2 * i + 1]
        velocities_adjoint(axes, second, row, x, end_bar, mean_bar, x_bar, row_bar)
        shapes_adjoint(axes, second, row, x, out_bar, x_bar, row_bar)
        for c in range(n):
            m_bar[c] += x_bar[c]
        if s > 0:
            k = s - 1 if s <= n else s - 1 - n
            signed = radius if s <= n else -radius
            for c in range(k, n):
                upper_bar[k, c] += signed * x_bar[c]
    # the centre point's weight in the mean is zero, but the others are taken about it: already in their share
    upper_adjoint(upper, n, upper_bar, P_bar)
