"""The two steps of EM for mixtures whose data have a covariance each and whose components are mirrored pairs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["densities", "improved"]

Floats = NDArray[np.float64]


def _spread(var: Floats, size: int) -> Floats:
    """Diagonal of V of each component; (K, E')."""
    return np.concatenate([var[:, :1], np.repeat(var[:, 1:], size - 1, axis=1)], axis=1)


def _inverted(S: Floats) -> tuple[Floats, Floats]:
    """Inverse and log determinant; in the plane by hand, which is several times faster than by library."""
    if S.shape[-1] != 2:
        return np.asarray(np.linalg.inv(S), dtype=np.float64), np.asarray(np.linalg.slogdet(S)[1])
    det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    out = np.empty_like(S)
    out[..., 0, 0], out[..., 1, 1] = S[..., 1, 1] / det, S[..., 0, 0] / det
    out[..., 0, 1] = out[..., 1, 0] = -S[..., 0, 1] / det
    return out, np.log(det)


def _sides(mean: Floats, size: int) -> list[tuple[float, Floats]]:
    """Centres of a component: both sides in the plane, one in space."""
    return [(s, np.array([mean[0], s * mean[1]])) for s in (1.0, -1.0)] if size == 2 else [(1.0, np.r_[mean[0], 0, 0])]


def densities(x: Floats, C: Floats, mean: Floats, var: Floats) -> tuple[Floats, Floats, list[Floats]]:
    """Log densities (B, T, K), the probability of the left side (B, T, K), and inverses of C + V."""
    size, K = x.shape[-1], len(mean)
    logs, left = np.empty((*x.shape[:-1], K)), np.ones((*x.shape[:-1], K))
    spread, inverses = _spread(var, size), []
    for k in range(K):
        inverse, log_det = _inverted(C + np.diag(spread[k]))
        constant = -0.5 * (log_det + size * np.log(2.0 * np.pi))
        both = [constant - 0.5 * _square(x - centre, inverse) for _, centre in _sides(mean[k], size)]
        logs[..., k] = both[0] if size == 3 else np.logaddexp(both[0], both[1]) - np.log(2.0)
        if size == 2:
            left[..., k] = np.exp(both[0] - logs[..., k] - np.log(2.0))
        inverses.append(inverse)
    return logs, left, inverses


def _square(e: Floats, inverse: Floats) -> Floats:
    return np.asarray(np.sum(e * np.sum(inverse * e[..., None, :], axis=-1), axis=-1))


def improved(
    x: Floats, weights: Floats, left: Floats, inverses: list[Floats], mean: Floats, var: Floats, smallest: Floats
) -> tuple[Floats, Floats]:
    """Means and variances (K, 2) that maximise the expected log-likelihood (M step).

    Args:
        x: values (B, T, E').
        weights: responsibilities times news; (B, T, K).
        left, inverses: from `densities` at ``mean`` and ``var``.
        mean, var: where the step begins; (K, 2).
        smallest: least variance; (2,).
    """
    size = x.shape[-1]
    spread = _spread(var, size)
    new_mean, new_var = mean.copy(), var.copy()
    for k in range(len(new_mean)):
        total = float(weights[..., k].sum())
        if not total > 1e-3:
            continue
        gain = spread[k][:, None] * inverses[k]
        rest = spread[k] - np.diagonal(gain, axis1=-2, axis2=-1) * spread[k]
        centre, parts = np.zeros(size), []
        for sign, middle in _sides(mean[k], size):
            hidden = middle + np.sum(gain * (x - middle)[..., None, :], axis=-1)
            if sign < 0:
                hidden = hidden * [1.0, -1.0]
            share = weights[..., k] * (left[..., k] if sign > 0 else 1.0 - left[..., k])
            centre = centre + np.einsum("bt,bti->i", share, hidden) / total
            parts.append((share, hidden))
        centre[1:] = abs(centre[1]) if size == 2 else 0.0
        square = np.zeros(size)
        for share, hidden in parts:
            square = square + np.einsum("bt,bti->i", share, (hidden - centre) ** 2 + rest) / total
        new_mean[k] = centre[:2]
        new_var[k] = max(square[0], smallest[0]), max(float(np.mean(square[1:])), smallest[1])
    return new_mean, new_var
