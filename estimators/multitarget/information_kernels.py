"""Compiled halves of the information form: inverses of many small matrices, and their prediction."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import entry_kernel, inner_kernel
from jink.estimators.linalg import cholesky, mirror, solve_lower, solve_upper

__all__ = ["invert", "moments", "predict_one"]


@inner_kernel
def invert(matrix, n, padded_matrix, factor, out):
    """``out = matrix^-1`` (n, n) of a positive definite matrix, scaled to unit diagonal first; False and NaN if not.

    Metres beside m/s, or a broad prior beside a sharp one, cost no digits that way.

    Args:
        matrix, out: (n, n).
        n: size.
        padded_matrix, factor: scratch; (n, n padded).
    """
    good = True
    for i in range(n):
        good = good and matrix[i, i] > 0.0 and matrix[i, i] < np.inf
    for i in range(n):
        for j in range(n):
            padded_matrix[i, j] = matrix[i, j] / np.sqrt(matrix[i, i] * matrix[j, j]) if good else 0.0
            good = good and abs(padded_matrix[i, j]) < 2.0
    good = good and cholesky(padded_matrix, n, factor)
    for i in range(n):
        good = good and factor[i, i] > 0.0
    for i in range(n):
        for j in range(n):
            padded_matrix[i, j] = 1.0 if i == j else 0.0
    solve_lower(factor, n, padded_matrix, n)
    solve_upper(factor, n, padded_matrix, n)
    for i in range(n):
        for j in range(n):
            out[i, j] = padded_matrix[i, j] / np.sqrt(matrix[i, i] * matrix[j, j]) if good else np.nan
    mirror(out, n)
    return good


@entry_kernel
def moments(q, Omega, mean, cov):
    """``cov = Omega^-1``, ``mean = cov q`` for rows (K, n), (K, n, n)."""
    K, n = q.shape
    work, factor = np.zeros((n, (n + 7) // 8 * 8)), np.zeros((n, (n + 7) // 8 * 8))
    for k in range(K):
        invert(Omega[k], n, work, factor, cov[k])
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += cov[k, i, j] * q[k, j]
            mean[k, i] = total


@entry_kernel
def predict_one(q, Omega, A, Q, q_out, Omega_out):
    """``Omega_out = (A Omega^-1 A' + Q)^-1``, ``q_out = Omega_out A Omega^-1 q`` for rows (K, n), (K, n, n)."""
    K, n = q.shape
    work, factor = np.zeros((n, (n + 7) // 8 * 8)), np.zeros((n, (n + 7) // 8 * 8))
    P, AP, predicted = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    x, Ax = np.zeros(n), np.zeros(n)
    for k in range(K):
        invert(Omega[k], n, work, factor, P)
        for i in range(n):
            x[i] = 0.0
            for j in range(n):
                x[i] += P[i, j] * q[k, j]
                AP[i, j] = 0.0
                for c in range(n):
                    AP[i, j] += A[i, c] * P[c, j]
        for i in range(n):
            Ax[i] = 0.0
            for j in range(n):
                Ax[i] += A[i, j] * x[j]
                predicted[i, j] = Q[i, j]
                for c in range(n):
                    predicted[i, j] += AP[i, c] * A[j, c]
        mirror(predicted, n)
        invert(predicted, n, work, factor, Omega_out[k])
        for i in range(n):
            q_out[k, i] = 0.0
            for j in range(n):
                q_out[k, i] += Omega_out[k, i, j] * Ax[j]
