"""How far the nodes of a network are from one estimate."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from jink.estimators.metrics.steps import Floats

__all__ = ["disagreement"]


def disagreement(estimates: ArrayLike) -> Floats:
    """Mean squared distance of the nodes' estimates from their mean.

    Model: ``1/N sum_i |x_i - xbar|^2``, ``xbar = 1/N sum_i x_i``; the root of it is a distance.

    Args:
        estimates: nodes first, components last, for instance positions (N, T, A); NaN = this node has none and does
            not count.
    Returns:
        shape without first and last axis; unit squared; NaN where no node has an estimate.
    Raises:
        ValueError: fewer than two dimensions.
    Source: definition.
    """
    x = np.asarray(estimates, dtype=np.float64)
    if x.ndim < 2:
        raise ValueError(
            f"disagreement: estimates must have nodes first and components last; got shape {x.shape}. "
            "Give for instance (N, T, A)."
        )
    there = np.asarray(np.isfinite(x).all(axis=-1))
    count = there.sum(axis=0)
    known = np.where(there[..., None], x, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = known.sum(axis=0) / count[..., None]
        squares = np.where(there, ((known - mean) ** 2).sum(axis=-1), 0.0)
        return np.asarray(squares.sum(axis=0) / count)
