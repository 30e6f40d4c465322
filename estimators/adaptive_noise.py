"""Learning the noise on the way: Sage-Husa and variational Bayes, for one track, one measurement at a time.

Letters: ``R = U'U`` is the noise that comes with a measurement and ``A`` the learnt ratio: the noise used is
``U' A U``, so ``A = I`` trusts the sensor, and an R that changes from row to row keeps its meaning. In units of ``U``
the innovation is ``v``, the part of its covariance that the prediction explains ``C = H P H'``, and ``S = C + A``.
The weight ``w`` is the number of measurements that ``A`` is worth: ``w <- forgetting w + 1`` with each one used; its
inverse is the gain ``g``. Matrices have rows padded to eight, as everywhere.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import inner_kernel
from jink.estimators.linalg import cholesky, clear_rows, copy_rows, diagonalise, mirror, solve_lower, solve_upper, total

__all__ = ["bounded", "coloured", "process_factor", "sage_husa", "spread_to_absent", "variational", "whitened"]

_ROUNDED = 1e-12


@inner_kernel
def coloured(U, A, d, half, out):
    """``out = U' A U``: noise in units of the measurement."""
    clear_rows(out, d)
    for i in range(d):
        for k in range(d):
            half[i, k] = 0.0
            for c in range(k + 1):
                half[i, k] += A[i, c] * U[c, k]
    for i in range(d):
        for k in range(i + 1):
            for c in range(i + 1):
                out[i, k] += U[c, i] * half[c, k]
            out[k, i] = out[i, k]


@inner_kernel
def whitened(U, M, d, half, out):
    """``out = U'^-1 M U^-1`` for symmetric M."""
    copy_rows(M, half, d)
    solve_lower(U, d, half, d)
    clear_rows(out, d)
    for i in range(d):
        for k in range(d):
            out[i, k] = half[k, i]
    solve_lower(U, d, out, d)
    mirror(out, d)


@inner_kernel
def sage_husa(v, C, d, gain, A):
    """Innovation-based estimate of the noise, made before the state is updated.

    Model: ``A <- A + g (v v' - C - A)``; ``E[v v'] = C + A`` when the filter is consistent.
    One ``v v' - C`` is no covariance: a short memory needs the floor of `bounded`.

    Args:
        v: innovation; (d,).
        C: explained covariance; (d, d).
        d, gain: size, g.
        A: ratio, before and after; (d, d).

    Source: Sage & Husa (1969), JACC, 760-769; Mehra (1972), IEEE TAC 17(5). Differs: in units of R; the weight
    starts at a worth given to the sensor's R (zero gives the usual gain ``(1 - b) / (1 - b^(k + 1))``).
    """
    for i in range(d):
        for k in range(d):
            A[i, k] += gain * (v[i] * v[k] - C[i, k] - A[i, k])


@inner_kernel
def variational(v, C, d, gain, iterations, A, used, before, factor, left, right, r):
    """Fixed point between the state and an inverse-Wishart noise, each given the other.

    Model: ``A_0 = (1 - g) A``; then ``iterations`` times, with ``S = C + A_i``, ``r = A_i S^-1 v`` and
    ``M = A_i S^-1 C S^-1 A_i + C S^-1 A_i S^-1 C`` (residual and measured covariance after an update with ``A_i``),
    ``A_(i+1) = (1 - g) A + g (r r' + M)``. The state is then updated with the last but one.

    Args:
        v: innovation; (d,).
        C: explained covariance; (d, d).
        d, gain, iterations: size, g, number of iterations (>= 1).
        A: ratio, before and after; (d, d).
        used: the ratio to update the state with; (d, d).
        before, factor, left, right, r: scratch (d, d), and (d,) for the last.

    Returns:
        Whether every S was a covariance.

    Source: Sarkka & Nummenmaa (2009), IEEE TAC 54(3), 596-600 (one component: ``A = beta / alpha``, ``w = 2 alpha``);
    Sarkka & Hartikainen (2013), MLSP (``A = V / (nu - d - 1)``, ``w = nu - d - 1``). Differs: the residual of a
    nonlinear sensor is that of its linearisation by sigma points about the prediction, not about each posterior.
    """
    good = True
    for i in range(d):
        for k in range(d):
            before[i, k] = (1.0 - gain) * A[i, k]
            A[i, k] = before[i, k]
    for _ in range(iterations):
        copy_rows(A, used, d)
        copy_rows(C, left, d)
        for i in range(d):
            for k in range(d):
                left[i, k] += used[i, k]
        good = cholesky(left, d, factor) and good
        copy_rows(C, left, d)
        copy_rows(used, right, d)
        solve_lower(factor, d, left, d)
        solve_upper(factor, d, left, d)
        solve_lower(factor, d, right, d)
        solve_upper(factor, d, right, d)
        for i in range(d):
            r[i] = 0.0
            for k in range(d):
                r[i] += right[k, i] * v[k]
        for i in range(d):
            for k in range(d):
                A[i, k] = before[i, k] + gain * r[i] * r[k]
        _add_congruence(right, C, d, gain, factor, A)
        _add_congruence(left, used, d, gain, factor, A)
        mirror(A, d)
    return good


@inner_kernel
def _add_congruence(X, M, d, scale, product, out):
    """``out += scale X' M X``: with two of them, a sum of squares that stays positive whatever cancels."""
    for i in range(d):
        for k in range(d):
            product[i, k] = 0.0
            for c in range(d):
                product[i, k] += M[i, c] * X[c, k]
    for i in range(d):
        for k in range(d):
            for c in range(d):
                out[i, k] += scale * X[c, i] * product[c, k]


@inner_kernel
def bounded(A, d, floor, ceiling, shifted, factor, V):
    """Put the eigenvalues of A between ``floor`` and ``ceiling``; returns whether A was finite.

    Directions are kept, so whatever the units or the correlation of R, the noise used stays between ``floor R`` and
    ``ceiling R``. ``shifted``, ``factor``, ``V`` are scratch (d, d).
    """
    if not np.isfinite(total(A, d)):
        return False
    inside = True
    for end in range(2):
        clear_rows(shifted, d)
        for i in range(d):
            for k in range(d):
                shifted[i, k] = A[i, k] if end == 0 else -A[i, k]
            shifted[i, i] += -floor if end == 0 else ceiling
            inside = inside and shifted[i, i] >= 0.0
        inside = inside and cholesky(shifted, d, factor)
    if inside:
        return True
    copy_rows(A, shifted, d)
    diagonalise(shifted, V, d)
    for i in range(d):
        for k in range(i + 1):
            A[i, k] = 0.0
            for c in range(d):
                A[i, k] += V[i, c] * min(max(shifted[c, c], floor), ceiling) * V[k, c]
            A[k, i] = A[i, k]
    return True


@inner_kernel
def spread_to_absent(A, before, after, present, d, factor, rows):
    """What the components present have learnt, carried into the whole ratio by regression.

    Model: with the block of those present going from ``A_pp`` to ``N`` and ``B = A_pp^-1 A_pa``:
    ``A_pa <- N B``, ``A_aa <- A_aa + B' (N - A_pp) B``. It keeps A a covariance; uncorrelated components stay as
    they are. (For an inverse Wishart, ``B`` and ``A_aa - A_ap B`` are independent of the block observed.)

    Args:
        A: whole ratio; (D, D).
        before, after: ``A_pp`` and ``N``; (d, d).
        present, d: components present.
        factor, rows: scratch (D, D).
    """
    size = A.shape[0]
    if d < size:
        cholesky(before, d, factor)
        clear_rows(rows, d)
        for a in range(d):
            for c in range(size):
                rows[a, c] = A[present[a], c]
        solve_lower(factor, d, rows, size)
        solve_upper(factor, d, rows, size)
        for i in range(size):
            for k in range(size):
                for a in range(d):
                    for c in range(d):
                        A[i, k] += rows[a, i] * (after[a, c] - before[a, c]) * rows[c, k]
    for a in range(d):
        for c in range(d):
            A[present[a], present[c]] = after[a, c]


@inner_kernel
def process_factor(m, m_out, gain_rows, Q, n, d, gain, factor):
    """Factor on Q that the corrections ask for.

    Model: ``(K v)_i^2`` has expectation ``u_i = (K S K')_ii``, and their difference is what Sage and Husa add to Q;
    in units of ``Q_ii``, averaged over components with weights ``(Q_ii / u_i)^2`` (its inverse variance).

    Args:
        m, m_out: mean before and after the update; (n,).
        gain_rows: rows whose squares sum to ``K S K'``; (d, n).
        Q: process noise of this step; (n, n).
        n, d, gain: sizes, g.
        factor: present factor.

    Returns:
        The new factor, not bounded yet.

    Source: Sage & Husa (1969). Differs: one factor for all of Q, as Q depends on the time step and often on the state.
    """
    weight = change = 0.0
    for i in range(n):
        u = 0.0
        for a in range(d):
            u += gain_rows[a, i] * gain_rows[a, i]
        if Q[i, i] > _ROUNDED * u and u > 0.0:
            part = Q[i, i] / u
            correction = m_out[i] - m[i]
            weight += part * part
            change += part * (correction * correction / u - 1.0)
    return factor + gain * change / weight if weight > 0.0 else factor
