"""Weights with which the nodes of a network average: Metropolis weights, and the check of given ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.checks import check_array

__all__ = ["check_weights", "metropolis_weights", "second_eigenvalue"]

Array = NDArray[np.float64]


def metropolis_weights(adjacency: ArrayLike) -> Array:
    """Averaging weights every pair of neighbours can agree on alone.

    Model: ``pi_ij = 1 / (1 + max(d_i, d_j))`` for a link, ``pi_ii = 1 - sum_j pi_ij``, d = number of neighbours.
    Doubly stochastic and symmetric; primitive if the network is connected, as every ``pi_ii > 0``.

    Args:
        adjacency: who hears whom, symmetric; the diagonal plays no part; (N, N) bool.
    Returns:
        weights, row = the node that averages; (N, N).
    Raises:
        ValueError: not square or not symmetric.
    Source: Xiao, Boyd (2004). Differs: none.
    """
    linked = check_array("metropolis_weights", "adjacency", adjacency, "Give one row per node.") != 0
    if linked.ndim != 2 or linked.shape[0] != linked.shape[1] or (linked != linked.T).any():
        raise ValueError(
            f"metropolis_weights: adjacency must be symmetric with shape (N, N); got shape {linked.shape}. "
            "Both ends of a link hear each other."
        )
    np.fill_diagonal(linked, False)
    degree = linked.sum(axis=1)
    weights = np.where(linked, 1.0 / (1.0 + np.maximum(degree[:, None], degree[None, :])), 0.0)
    np.fill_diagonal(weights, 1.0 - weights.sum(axis=1))
    return weights


def second_eigenvalue(weights: ArrayLike) -> float:
    """Largest modulus among the eigenvalues but one: L averagings shrink disagreement by its L-th power.

    Args:
        weights: row-stochastic; (N, N).
    """
    moduli = np.sort(np.abs(np.linalg.eigvals(np.asarray(weights, dtype=np.float64))))
    return float(moduli[-2]) if len(moduli) > 1 else 0.0


def check_weights(weights: ArrayLike, adjacency: ArrayLike | None = None) -> Array:
    """Refuse weights with which repeated averaging does not bring all nodes to one value.

    Args:
        weights: row = the node that averages; (N, N).
        adjacency: if given, weights are positive on these links and the diagonal only; (N, N) bool.
    Returns:
        the weights as float64.
    Raises:
        ValueError: not square and finite, a negative entry, a row that does not sum to 1 within 1e-9, a pattern that
            is not primitive, or a weight between nodes that are not linked.
    """
    matrix = check_array("check_weights", "weights", weights, "Give one row and one column per node.")
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size or not np.isfinite(matrix).all():
        raise ValueError(
            f"check_weights: weights must be finite with shape (N, N), N >= 1; got shape {matrix.shape}. "
            "Give one row and one column per node."
        )
    if (matrix < 0).any() or np.abs(matrix.sum(axis=1) - 1).max(initial=0) > 1e-9:
        row = int(np.argmax(np.maximum(np.abs(matrix.sum(axis=1) - 1), -matrix.min(axis=1))))
        raise ValueError(
            f"check_weights: weights must be >= 0 with rows that sum to 1; got row {row} with sum "
            f"{matrix[row].sum():.9g}, smallest entry {matrix[row].min():.9g}. Divide each row by its sum."
        )
    if not _is_primitive(matrix > 0):
        raise ValueError(
            "check_weights: weights must be primitive, some power with no zero at all; got a pattern whose every "
            "power has zeros. Connect the network, and give each node a weight for itself."
        )
    if adjacency is not None:
        linked = np.asarray(adjacency, dtype=bool)
        if linked.shape != matrix.shape:
            raise ValueError(
                f"check_weights: weights must have shape {linked.shape}, one row per node; got {matrix.shape}. "
                "Use metropolis_weights."
            )
        strange = np.argwhere((matrix > 0) & ~linked & ~np.eye(len(linked), dtype=bool))
        if strange.size:
            raise ValueError(
                f"check_weights: weights must be zero between nodes without a link; got a weight from "
                f"{strange[0][1]} to {strange[0][0]}. Use metropolis_weights."
            )
    return matrix


def _is_primitive(pattern: NDArray[np.bool_]) -> bool:
    """Wielandt: a primitive N x N pattern has no zero in any power from N^2 - 2 N + 2 on."""
    power, exponent = pattern.astype(np.float64), 1
    while exponent < len(pattern) ** 2 - 2 * len(pattern) + 2:
        power, exponent = (power @ power > 0).astype(np.float64), 2 * exponent
    return bool((power > 0).all())
