"""Estimates in information form, for every node and target at once: ``Omega = P^-1``, ``q = Omega x``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.multitarget.consensus import Exchange, novelty_weights
from jink.estimators.multitarget.information_kernels import moments, predict_one

__all__ = ["Information", "consensus_update", "from_moments", "mixed_novelty", "predict_information", "to_moments"]

Array = NDArray[np.float64]


class Information(NamedTuple):
    """Information pairs; any leading shape, for instance (N, M) nodes and targets."""

    vector: Array  # (..., n) q
    matrix: Array  # (..., n, n) Omega


def to_moments(pair: Information) -> tuple[Array, Array]:
    """Mean ``Omega^-1 q`` (..., n) and covariance (..., n, n); NaN where Omega is not positive definite."""
    return _invert("to_moments", pair.vector, pair.matrix)


def from_moments(mean: ArrayLike, cov: ArrayLike) -> Information:
    """The pair of a mean (..., n) and a covariance (..., n, n), or of one covariance (n, n) for all.

    Raises:
        ValueError: shapes do not fit, or a covariance is not positive definite.
    """
    x = np.asarray(mean, dtype=np.float64)
    P = np.broadcast_to(np.asarray(cov, dtype=np.float64), (*x.shape, x.shape[-1]))
    matrix = _invert("from_moments", np.zeros(x.shape), P)[1]
    if not np.isfinite(matrix).all():
        raise ValueError(
            "from_moments: cov must be positive definite; got one that is not, or not finite. Give every "
            "component a variance > 0."
        )
    return Information(np.einsum("...ij,...j->...i", matrix, x), matrix)


def predict_information(pair: Information, transition: ArrayLike, process_noise: ArrayLike) -> Information:
    """The pair one step later.

    Model: ``Omega' = (A Omega^-1 A' + Q)^-1``, ``q' = Omega' A x``; for regular Q the same as
    ``W - W A (Omega + A' W A)^-1 A' W`` with ``W = Q^-1``, but it asks for no inverse of Q.

    Args:
        pair: (..., n), (..., n, n); Omega positive definite.
        transition: A; (n, n).
        process_noise: Q, positive semidefinite, may be singular or zero; (n, n).
    Returns:
        the predicted pairs; NaN where Omega or ``A Omega^-1 A' + Q`` is not positive definite.
    Raises:
        ValueError: shapes do not fit.
    Source: Battistelli and others (2015), table I. Differs: the form above.
    """
    q, Omega = _checked("predict_information", pair.vector, pair.matrix)
    n = q.shape[-1]
    A, Q = (np.ascontiguousarray(value, dtype=np.float64) for value in (transition, process_noise))
    if A.shape != (n, n) or Q.shape != (n, n):
        raise ValueError(
            f"predict_information: transition and process_noise must have shape ({n}, {n}); got {A.shape} and "
            f"{Q.shape}. Give one for all."
        )
    out = Information(np.empty(q.shape), np.empty(Omega.shape))
    flat = out.vector.reshape(-1, n), out.matrix.reshape(-1, n, n)
    predict_one(q.reshape(-1, n), Omega.reshape(-1, n, n), A, Q, *flat)
    return out


def consensus_update(
    prior: Information, novelty: Information, holds: ArrayLike, exchange: Exchange, rule: str
) -> Information:
    """Posterior of every node after an exchange: mixed prior plus omega times mixed novelty.

    Args:
        prior: of every node and target; (N, M, n), (N, M, n, n); Omega positive definite.
        novelty: of every node's own scan, zero where it saw nothing; same shapes.
        holds: 1 where a node's own scan says something of a target, else 0; (N, M).
        exchange: what L rounds did, `Consensus.exchange`.
        rule: weight of the novelty, a key of `RULES`.
    Returns:
        posterior pairs. A node that is not alive has its prior.
    """
    q, Omega = _checked("consensus_update", prior.vector, prior.matrix)
    found = mixed_novelty(novelty, holds, exchange, rule)
    return Information(_mix(exchange, q) + found.vector, _mix(exchange, Omega) + found.matrix)


def mixed_novelty(novelty: Information, holds: ArrayLike, exchange: Exchange, rule: str) -> Information:
    """What every node adds to its mixed prior: omega times mixed novelty; arguments as of `consensus_update`."""
    dq, dOmega = _checked("consensus_update", novelty.vector, novelty.matrix)
    omega = novelty_weights(rule, exchange.mixing, np.asarray(holds, dtype=np.float64))
    # A dead node mixes nothing, so its row is its own; its sensor is dead as well.
    omega = np.where(exchange.alive[:, None], omega, 0.0)
    return Information(omega[..., None] * _mix(exchange, dq), omega[..., None, None] * _mix(exchange, dOmega))


def _mix(exchange: Exchange, values: Array) -> Array:
    return (exchange.mixing @ values.reshape(len(values), -1)).reshape(values.shape)


def _checked(caller: str, vector: ArrayLike, matrix: ArrayLike) -> tuple[Array, Array]:
    q, Omega = np.ascontiguousarray(vector, dtype=np.float64), np.ascontiguousarray(matrix, dtype=np.float64)
    if q.ndim < 1 or Omega.shape != (*q.shape, q.shape[-1]):
        raise ValueError(
            f"{caller}: matrix must have shape (..., n, n) beside a vector (..., n); got {Omega.shape} and {q.shape}. "
            "Give one matrix per vector."
        )
    return q, Omega


def _invert(caller: str, vector: ArrayLike, matrix: ArrayLike) -> tuple[Array, Array]:
    q, Omega = _checked(caller, vector, matrix)
    n = q.shape[-1]
    mean, cov = np.empty(q.shape), np.empty(Omega.shape)
    moments(q.reshape(-1, n), Omega.reshape(-1, n, n), mean.reshape(-1, n), cov.reshape(-1, n, n))
    return mean, cov
