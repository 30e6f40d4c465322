"""Small dense algebra of association: measurement-sized factors and congruences of plain, unpadded matrices."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import inner_kernel

__all__ = ["factorise", "sandwich", "solve_rows", "symmetrise"]


@inner_kernel
def factorise(A, n, L):
    """Lower Cholesky factor of the first n rows of ``A`` into ``L``; whether A was positive definite."""
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@inner_kernel
def solve_rows(L, n, rows, columns):
    """``rows <- (L L')^-1 rows`` for ``rows`` (n, columns), in place."""
    for i in range(n):
        for c in range(columns):
            total = rows[i, c]
            for k in range(i):
                total -= L[i, k] * rows[k, c]
            rows[i, c] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        for c in range(columns):
            total = rows[i, c]
            for k in range(i + 1, n):
                total -= L[k, i] * rows[k, c]
            rows[i, c] = total / L[i, i]


@inner_kernel
def sandwich(F, P, n, product, out):
    """``out = F P F'``, exactly symmetric; ``product`` (n, n) is scratch, ``out`` must not overlap ``P``."""
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += F[i, k] * P[k, j]
            product[i, j] = total
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += product[i, k] * F[j, k]
            out[i, j] = total
            out[j, i] = total


@inner_kernel
def symmetrise(P, n):
    """``P <- (P + P') / 2``."""
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
