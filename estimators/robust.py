"""Sayed's robust filter: a Kalman filter for a model whose matrices are only known up to a bounded error.

Model: ``x+ = (F + dF) x + (G + dG) u``, ``[dF dG] = M Delta [E_f E_g]``, ``||Delta|| <= 1``; ``z = H x + v``;
``u ~ (0, Q)``, ``v ~ (0, R)``. Each step solves ``min_x max_Delta`` of the regularised least squares problem.

With the regulation ``lambda`` the corrected parameters are those of an ordinary filter that is told two more things:
``0 = E_f x + E_g u`` with covariance ``I / lambda`` (states that excite the model error are unlikely), and
``R^ = R - H M M' H' / lambda``. Both are exact: they are Sayed's formulas after completing the square. So a step is two
linear updates and a prediction, ``lambda = 0`` (H M = 0) is the Kalman filter, and Q may be singular.

P weighs the regularisation; it is no error covariance and its NEES is not calibrated.

Letters as in `kalman`; all matrices here have rows of one padded width, ``work`` is (10, rows, width) scratch.

Source: Sayed (2001), IEEE TAC 46(7), 998-1013. Differs: written as updates instead of corrected matrices.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.compiled import entry_kernel, inner_kernel
from jink.estimators.kalman import predict_linear
from jink.estimators.linalg import (
    cholesky,
    congruence,
    copy_matrix,
    copy_vector,
    mirror,
    multiply,
    padded,
    solve_lower,
    solve_upper,
)

__all__ = [
    "RobustFilter",
    "RobustStep",
    "corrected_noise",
    "excitation",
    "linear_update",
    "optimal_regulation",
    "regulation_bound",
    "robust_predict",
]

Array = NDArray[np.float64]

_SWEEPS = 60
_SEARCH, _HALVINGS = 16.0, 52
_ROUNDED = 1e-9


@inner_kernel
def linear_update(m, P, H, R, v, d, n, work, m_out, P_out):
    """Posterior of ``N(m, P)`` after an innovation ``v`` seen through ``H`` with noise ``R``; returns ``v' S^-1 v``.

    Model: ``K = P H' S^-1``, ``m+ = m + K v``, ``P+ = (I - K H) P (I - K H)' + K R K'``. The Joseph form, because R may
    be tiny next to ``H P H'`` here by design (``I / lambda``). A singular S leaves the prediction, with cost 0.
    """
    cross, S, factor, rows, step, product = work[0], work[1], work[2], work[3], work[4], work[5]
    multiply(H, P, d, n, cross)
    for a in range(d):
        for b in range(S.shape[1]):
            S[a, b] = 0.0
            rows[a, b] = 0.0
        for b in range(d):
            total = R[a, b]
            for c in range(n):
                total += cross[a, c] * H[b, c]
            S[a, b] = total
        rows[a, 0] = v[a]
    copy_vector(m, m_out)
    copy_matrix(P, P_out, n)
    good = cholesky(S, d, factor)
    for a in range(d):
        good = good and factor[a, a] > 0.0
    if not good:
        return 0.0
    solve_lower(factor, d, rows, 1)
    nis = 0.0
    for a in range(d):
        nis += rows[a, 0] * rows[a, 0]
    solve_lower(factor, d, cross, n)
    solve_upper(factor, d, cross, n)  # now K'
    for c in range(n):
        for a in range(d):
            m_out[c] += cross[a, c] * v[a]
        for i in range(S.shape[1]):
            S[c, i] = 0.0
            step[c, i] = 0.0
        for i in range(n):
            kept = 1.0 if i == c else 0.0
            added = 0.0
            for a in range(d):
                kept -= cross[a, i] * H[a, c]
                for b in range(d):
                    added += cross[a, c] * R[a, b] * cross[b, i]
            step[c, i] = kept  # (I - K H)'
            S[c, i] = added
    congruence(step, P, S, n, product, P_out)
    mirror(P_out, n)
    return nis


@inner_kernel
def regulation_bound(HM, R, d, q, work):
    """``lambda_l = || M' H' R^-1 H M ||``: regulation must exceed it; 0 if H M = 0.

    Args:
        HM, R: (d, q) and (d, d); d, q: sizes; work: scratch.

    Returns:
        the largest eigenvalue of a (q, q) matrix, by repeated squaring; infinite if R is no covariance.
    """
    factor, rows, gram = work[0], work[1], work[2]
    if not cholesky(R, d, factor):
        return np.inf
    copy_matrix(HM, rows, d)
    solve_lower(factor, d, rows, q)
    largest = 0.0
    for i in range(q):
        for j in range(q):
            gram[i, j] = 0.0
            for a in range(d):
                gram[i, j] += rows[a, i] * rows[a, j]
        largest = max(largest, gram[i, i])
    if q == 1 or largest == 0.0:
        return largest
    # Power iteration would need a start vector, which could be orthogonal to the answer; the trace does not.
    logarithm, power = 0.0, 1.0
    for _ in range(_SWEEPS):
        trace = 0.0
        for i in range(q):
            trace += gram[i, i]
        logarithm += np.log(trace) / power
        for i in range(q):
            for j in range(q):
                rows[i, j] = gram[i, j] / trace
        for i in range(q):
            for j in range(q):
                gram[i, j] = 0.0
                for k in range(q):
                    gram[i, j] += rows[i, k] * rows[k, j]
        power *= 2.0
    return np.exp(logarithm)


@inner_kernel
def optimal_regulation(S, v, HM, bound, t, d, q, work):
    """The regulation above ``bound`` that minimises ``G(lambda)``, by bisection of ``ln(lambda / lambda_l - 1)``.

    Model: with both innovations stacked (statement, then measurement), ``G = v' (S + diag(I, -H M M' H') / lambda)^-1
    v``. It has one minimum; with ``y`` the solution, its slope has the sign of ``||y_E||^2 - ||M' H' y_z||^2``. A
    slope is known to all digits where values of G near the minimum agree in all of theirs.

    Args:
        S, v: covariance without the terms in lambda (t + d, t + d), innovations in column 0; t, d: their sizes.
        HM, q: (d, q); bound: ``lambda_l`` > 0.
        work: scratch (2, t + d, padded).

    Source: Sayed (2001), eq. 10-13. Differs: the value of the game after completing the square.
    """
    low, high = -_SEARCH, _SEARCH
    factor, y = work[0], work[1]
    size = t + d
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        share = 1.0 / (bound * (1.0 + np.exp(middle)))
        for a in range(size):
            for b in range(size):
                factor[a, b] = S[a, b]
                if a >= t and b >= t:
                    for k in range(q):
                        factor[a, b] -= share * HM[a - t, k] * HM[b - t, k]
            if a < t:
                factor[a, a] += share
        copy_matrix(v, y, size)
        _solve(factor, y, size)
        slope = 0.0
        for a in range(t):
            slope += y[a, 0] * y[a, 0]
        for k in range(q):
            seen = 0.0
            for a in range(d):
                seen += HM[a, k] * y[t + a, 0]
            slope -= seen * seen
        if slope >= 0.0:
            high = middle
        else:
            low = middle
    return bound * (1.0 + np.exp(0.5 * (low + high)))


@inner_kernel
def _solve(S, y, n):
    """``y <- S^-1 y`` for one column, S positive definite, by plain Gauss elimination; S is overwritten."""
    for i in range(n):
        for k in range(i + 1, n):
            share = S[k, i] / S[i, i]
            for c in range(i, n):
                S[k, c] -= share * S[i, c]
            y[k, 0] -= share * y[i, 0]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            y[i, 0] -= S[i, k] * y[k, 0]
        y[i, 0] /= S[i, i]


@inner_kernel
def corrected_noise(R, HM, regulation, d, q, out):
    """``R^ = R - H M M' H' / lambda`` (d, d); R itself where the regulation is 0."""
    share = 1.0 / regulation if regulation > 0.0 else 0.0
    for a in range(d):
        for b in range(d):
            total = 0.0
            for i in range(q):
                total += HM[a, i] * HM[b, i]
            out[a, b] = R[a, b] - share * total


@inner_kernel
def excitation(m, E, regulation, t, n, noise, v):
    """The statement ``0 = E x + N(0, I / lambda)`` as a measurement: its ``noise`` (t, t) and innovation ``v`` (t,)."""
    for a in range(t):
        total = 0.0
        for c in range(n):
            total -= E[a, c] * m[c]
        v[a] = total
        for b in range(noise.shape[1]):
            noise[a, b] = 0.0
        noise[a, a] = 1.0 / regulation


@inner_kernel
def robust_predict(m, P, F_transposed, Q, E, regulation, t, n, work, m_out, P_out):
    """Prediction under model error: ``0 = E x + N(0, I / lambda)``, then ``F m``, ``F P F' + Q``.

    Args:
        m, P: estimate; (n,), (n, n); overwritten.
        F_transposed, Q: transition (transposed) and process noise; (n, n).
        E: excitation of the model error; (t, n).
        regulation: lambda; 0: an ordinary prediction.
        t, n: sizes; work: scratch.
        m_out, P_out: prediction; must not overlap ``m``, ``P``.

    Returns:
        ``m' E' (I / lambda + E P E')^-1 E m``, the cost of the first step.
    """
    cost = 0.0
    if regulation > 0.0:
        noise, v = work[8], work[9, 0]
        excitation(m, E, regulation, t, n, noise, v)
        cost = linear_update(m, P, E, noise, v, t, n, work, m_out, P_out)
        copy_vector(m_out, m)
        copy_matrix(P_out, P, n)
    predict_linear(m, P, F_transposed, Q, n, work[6], m_out, P_out)
    return cost


class _Model(NamedTuple):
    """Padded matrices of one filter; the state is followed by the inputs u where E_g makes them count."""

    F_transposed: Array  # (N, W)
    Q: Array  # (N, W) added by the prediction
    Q_inputs: Array  # (N, W) covariance of the inputs, before the prediction
    H: Array  # (d, W)
    R: Array  # (d, W)
    HM: Array  # (d, W)
    E: Array  # (t, W)


@inner_kernel
def _pass(mean, cov, z, model, regulation, n, q, first, work, means, covs):
    """Both halves of a step, prediction ``first`` or last; half i ends in ``means[i]``, ``covs[i]``; returns the cost.

    One loop, so that the update is compiled once.
    """
    d, t, N = model.H.shape[0], model.E.shape[0], model.F_transposed.shape[0]
    m, P, noise, v = work[9, 1], work[10], work[8], work[9, 0]
    copy_vector(mean, m)
    copy_matrix(cov, P, n)
    total = 0.0
    for half in range(2):
        m_out, P_out = means[half], covs[half]
        predicting = first if half == 0 else not first
        seen, rows, size = model.H, d, n
        if predicting:
            for i in range(n, N):
                m[i] = 0.0
                copy_vector(model.Q_inputs[i], P[i])
            seen, rows, size = model.E, t, N
        if predicting and regulation > 0.0:
            excitation(m, model.E, regulation, t, N, noise, v)
        elif not predicting:
            corrected_noise(model.R, model.HM, regulation, d, q, noise)
            for a in range(d):
                v[a] = z[a]
                for c in range(n):
                    v[a] -= model.H[a, c] * m[c]
        if regulation > 0.0 or not predicting:
            cost = linear_update(m, P, seen, noise, v, rows, size, work, m_out, P_out)
            if first or not predicting:
                total += cost
            copy_vector(m_out, m)
            copy_matrix(P_out, P, size)
        if predicting:
            predict_linear(m, P, model.F_transposed, model.Q, N, work[6], m_out, P_out)
            copy_vector(m_out, m)
            copy_matrix(P_out, P, N)
    return total


@inner_kernel
def _best(mean, cov, z, model, bound, n, q, work, game):
    """`optimal_regulation` of one step in filtered form."""
    d, t, N = model.H.shape[0], model.E.shape[0], model.F_transposed.shape[0]
    m, P, m_next, P_next, spread, cross, seen = work[9, 1], work[10], work[9, 2], work[0], work[1], work[2], work[3]
    S, v = game[3], game[2]
    for i in range(N):
        m[i] = mean[i] if i < n else 0.0
        copy_vector(cov[i] if i < n else model.Q_inputs[i], P[i])
    multiply(model.E, P, t, N, spread)
    multiply(spread, model.F_transposed, t, N, cross)
    predict_linear(m, P, model.F_transposed, model.Q, N, work[6], m_next, P_next)
    multiply(model.H, P_next, d, n, seen)
    for a in range(t):
        v[a, 0] = 0.0
        for i in range(N):
            v[a, 0] -= model.E[a, i] * m[i]
        for b in range(t):
            S[a, b] = 0.0
            for i in range(N):
                S[a, b] += spread[a, i] * model.E[b, i]
        for b in range(d):
            S[a, t + b] = 0.0
            for i in range(n):
                S[a, t + b] += cross[a, i] * model.H[b, i]
            S[t + b, a] = S[a, t + b]
    for a in range(d):
        v[t + a, 0] = z[a]
        for i in range(n):
            v[t + a, 0] -= model.H[a, i] * m_next[i]
        for b in range(d):
            S[t + a, t + b] = model.R[a, b]
            for i in range(n):
                S[t + a, t + b] += seen[a, i] * model.H[b, i]
    return optimal_regulation(S, v, model.HM, bound, t, d, q, game)


@entry_kernel
def _step(mean, cov, z, model, bound, alpha, search, n, q, first, work, game, means, covs):
    """One step in either form; returns the regulation and the cost."""
    regulation = (1.0 + alpha) * bound
    if search and bound > 0.0:
        regulation = _best(mean, cov, z, model, bound, n, q, work, game)
    return regulation, _pass(mean, cov, z, model, regulation, n, q, first, work, means, covs)


@entry_kernel
def _bound(HM, R, d, q, work):
    return regulation_bound(HM, R, d, q, work)


class RobustStep(NamedTuple):
    """What one step gives: the estimate ``x_k|k`` and the prediction ``x_k+1|k``, in the order the form makes them."""

    mean: Array  # (n,) filtered
    cov: Array  # (n, n)
    predicted_mean: Array  # (n,)
    predicted_cov: Array  # (n, n)
    regulation: float  # lambda
    cost: float  # filtered form: G(lambda); prediction form: v' S^-1 v with R^


@dataclass(frozen=True)
class RobustFilter:
    """Sayed's filter for one uncertain linear model.

    Args:
        transition, observation: F (n, n) and H (d, n).
        process_noise, measurement_noise: Q (m, m) and R (d, d).
        error: M; (n, q). Zero, or invisible (H M = 0): the Kalman filter.
        excitation: E_f; (t, n).
        noise_gain: G; (n, m); None: the identity.
        noise_excitation: E_g; (t, m); None: zero.
        alpha: regulation is ``(1 + alpha)`` times its bound; > 0.
        optimise: search the regulation that minimises ``G(lambda)`` by bisection of its slope (filtered form only: the
            prediction form must choose before it sees the measurement).

    Raises:
        ValueError: shapes do not fit, a number is not finite, a noise is no covariance, or ``alpha`` is not positive.
    """

    transition: ArrayLike
    observation: ArrayLike
    process_noise: ArrayLike
    measurement_noise: ArrayLike
    error: ArrayLike
    excitation: ArrayLike
    noise_gain: ArrayLike | None = None
    noise_excitation: ArrayLike | None = None
    alpha: float = 0.5
    optimise: bool = False

    def __post_init__(self) -> None:
        for name in ("transition", "observation", "process_noise", "measurement_noise", "error", "excitation",
                     "noise_gain", "noise_excitation"):  # fmt: skip
            object.__setattr__(self, name, _matrix(name, getattr(self, name)))
        n = _size(self.transition, 0)
        if self.noise_gain is None:
            object.__setattr__(self, "noise_gain", np.eye(n))
        m, d = _size(self.noise_gain, 1), _size(self.measurement_noise, 0)
        q, t = _size(self.error, 1), _size(self.excitation, 0)
        if self.noise_excitation is None:
            object.__setattr__(self, "noise_excitation", np.zeros((t, m)))
        wanted = {
            "transition": (n, n), "observation": (d, n), "process_noise": (m, m), "measurement_noise": (d, d),
            "error": (n, q), "excitation": (t, n), "noise_gain": (n, m), "noise_excitation": (t, m),
        }  # fmt: skip
        for name, shape in wanted.items():
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != shape or 0 in shape or not np.isfinite(value).all():
                raise ValueError(
                    f"RobustFilter: {name} must be finite with shape {shape}; got shape {value.shape}. "
                    "Shapes are F (n, n), G (n, m), H (d, n), M (n, q), E_f (t, n), E_g (t, m)."
                )
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        _check_covariance("RobustFilter: process_noise", self.process_noise, singular=True)
        _check_covariance("RobustFilter: measurement_noise", self.measurement_noise, singular=False)
        if not isinstance(self.optimise, bool):
            raise ValueError(f"RobustFilter: optimise must be True or False; got {self.optimise!r}. Leave it out.")
        number = isinstance(self.alpha, float | int | np.number) and not isinstance(self.alpha, bool)
        if not (number and self.alpha > 0 and math.isfinite(self.alpha)):
            raise ValueError(
                f"RobustFilter: alpha must be > 0 and finite; got {self.alpha!r}. Use 0.5, or optimise=True."
            )

    @property
    def bound(self) -> float:
        """``lambda_l``, which the regulation must exceed; 0: this filter is the Kalman filter."""
        if not (np.any(self.excitation) or np.any(self.noise_excitation)):
            return 0.0  # an error that nothing excites is none: R^ must stay R
        d, q = self._HM.shape
        work = np.zeros((3, max(d, q), padded(max(d, q))))
        HM, R = np.zeros((2, d, work.shape[2]))
        HM[:, :q], R[:, :d] = self._HM, self.measurement_noise
        return float(_bound(HM, R, d, q, work))

    def step_filtered(self, mean: ArrayLike, cov: ArrayLike, measurement: ArrayLike) -> RobustStep:
        """Time and measurement form: from ``x_k|k`` through ``x_k+1|k`` to ``x_k+1|k+1`` with ``z_k+1``."""
        means, covs, regulation, cost = self._run("step_filtered", mean, cov, measurement, True)
        return RobustStep(means[1], covs[1], means[0], covs[0], regulation, cost)

    def step_predicted(self, mean: ArrayLike, cov: ArrayLike, measurement: ArrayLike) -> RobustStep:
        """Prediction form: from ``x_k|k-1`` through ``x_k|k`` with ``z_k`` to ``x_k+1|k``."""
        means, covs, regulation, nis = self._run("step_predicted", mean, cov, measurement, False)
        return RobustStep(means[0], covs[0], means[1], covs[1], regulation, nis)

    @property
    def _HM(self) -> Array:
        return np.asarray(self.observation) @ np.asarray(self.error)

    @functools.cached_property
    def _model(self) -> _Model:
        F, G, H, Q, R, E_f, E_g = (
            np.asarray(getattr(self, name))
            for name in (
                "transition", "noise_gain", "observation", "process_noise", "measurement_noise", "excitation",
                "noise_excitation",
            )
        )  # fmt: skip
        n, m = G.shape
        total = n + m if E_g.any() and self._HM.any() else n
        width = padded(max(total, *self._HM.shape, len(E_f)))

        def place(rows: int, *blocks: tuple[int, int, Array]) -> Array:
            matrix = np.zeros((rows, width))
            for row, column, block in blocks:
                matrix[row : row + block.shape[0], column : column + block.shape[1]] = block
            return matrix

        driven = total > n
        return _Model(
            place(total, (0, 0, F.T), *([(n, 0, G.T)] if driven else [])),
            place(total, *([] if driven else [(0, 0, G @ Q @ G.T)])),
            place(total, *([(n, n, Q)] if driven else [])),
            place(len(R), (0, 0, H)),
            place(len(R), (0, 0, R)),
            place(len(R), (0, 0, self._HM)),
            place(len(E_f), (0, 0, E_f), *([(0, n, E_g)] if driven else [])),
        )

    def _run(
        self, caller: str, mean: ArrayLike, cov: ArrayLike, measurement: ArrayLike, first: bool
    ) -> tuple[Array, Array, float, float]:
        model, q = self._model, self._HM.shape[1]
        n, d = np.shape(self.transition)[0], len(model.R)
        shapes = {"mean": (n,), "cov": (n, n), "measurement": (d,)}
        values = [np.asarray(value, dtype=np.float64) for value in (mean, cov, measurement)]
        for value, (name, shape) in zip(values, shapes.items(), strict=True):
            if value.shape != shape or not np.isfinite(value).all():
                raise ValueError(
                    f"{caller}: {name} must be finite with shape {shape}; got {value.tolist()}. "
                    "Give the components that were measured to a filter of their own H and R."
                )
        _check_covariance(f"{caller}: cov", values[1], singular=True)
        total, width = model.F_transposed.shape
        m, P, means, covs = (np.zeros(width), np.zeros((n, width)), np.zeros((2, width)), np.zeros((2, total, width)))
        m[:n], P[:, :n] = values[0], values[1]
        work = np.zeros((11, max(total, d, len(model.E), 3), width))
        stacked = d + len(model.E)
        game = np.zeros((4, stacked, padded(stacked)))
        search = self.optimise and first
        bound = self.bound
        regulation, cost = _step(
            m, P, values[2], model, bound, self.alpha, search, n, q, first, work, game, means, covs
        )
        return means[:, :n], covs[:, :n, :n], float(regulation), float(cost)


def _matrix(name: str, value: Any) -> Any:
    """The value as an array; None, where it may be left out, stays."""
    if value is None and name.startswith("noise_"):
        return None
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"RobustFilter: {name} must be a matrix of numbers; got {value!r}. Give a list of rows."
        ) from None


def _check_covariance(what: str, matrix: Any, *, singular: bool) -> None:
    """Symmetric and positive (semi)definite, within rounding."""
    matrix = np.asarray(matrix)
    scale = float(np.abs(matrix).max())
    symmetric = bool((np.abs(matrix - matrix.T) <= _ROUNDED * scale).all())
    lowest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min())
    if not symmetric or not (lowest >= -_ROUNDED * scale if singular else lowest > 0.0):
        kind = "semidefinite" if singular else "definite"
        found = f"eigenvalue {lowest:.3g}" if symmetric else "one that is not symmetric"
        raise ValueError(f"{what} must be a covariance, positive {kind}; got {found}. Give variances and covariances.")


def _size(matrix: Any, axis: int) -> int:
    """Length of one axis; 0 for what is no matrix, which fits nothing."""
    shape = np.shape(matrix)
    return int(shape[axis]) if len(shape) == 2 else 0
