"""Statistics of weighted rows, as the bootstrap needs them; weights of one give the plain statistic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.training.intervals import Floats, Statistic

__all__ = ["interquartile_mean", "largest", "mean", "median", "ratio", "root_mean", "root_mean_peak", "trimmed_mean"]


def mean(values: Floats) -> Statistic:
    """Mean of (n,) values; NaN ones do not count."""
    known = ~np.isnan(values)
    return lambda weights: _divide(weights[:, known] @ values[known], weights[:, known].sum(1))


def root_mean(squares: Floats) -> Statistic:
    """Root of the mean of (n,) squares; NaN ones do not count."""
    inner = mean(squares)
    return lambda weights: np.sqrt(inner(weights))


def root_mean_peak(squares: Floats) -> Statistic:
    """Largest over samples of the root of the mean over runs; (n, T) squares."""
    return lambda weights: np.sqrt((weights @ squares).max(1) / weights.sum(1))


def ratio(top: Floats, bottom: Floats) -> Statistic:
    """Sum of (n,) values over the sum of others."""
    return lambda weights: _divide(weights @ top, weights @ bottom)


def interquartile_mean(values: Floats) -> Statistic:
    """Mean of the middle half of (n,) values; NaN ones do not count."""
    order, present = _ascending(values)

    def statistic(weights: Floats) -> Floats:
        taken = weights[:, order]
        reached = np.cumsum(taken, axis=1)
        total = reached[:, -1:] if len(present) else np.zeros((len(weights), 1))
        low, high = np.maximum(reached - taken, 0.25 * total), np.minimum(reached, 0.75 * total)
        kept = np.maximum(high - low, 0.0)
        # Not a product with the values: an infinite one outside of the middle would make it NaN.
        sums = np.where(kept > 0, kept * np.where(kept > 0, present, 0.0), 0.0).sum(axis=1)
        return _divide(sums, kept.sum(axis=1))

    return statistic


def largest(values: Floats) -> Statistic:
    """Largest of (n,) values with any weight; NaN ones do not count."""
    known = ~np.isnan(values)
    return lambda weights: np.where(weights[:, known] > 0, values[known], -np.inf).max(1, initial=-np.inf)


def median(values: Floats) -> Statistic:
    """Median of (n,) values; NaN ones do not count."""
    order, present = _ascending(values)

    def statistic(weights: Floats) -> Floats:
        if not len(present):
            return np.full(len(weights), np.nan)
        reached = np.cumsum(weights[:, order], axis=1)
        half = reached[:, -1:] / 2
        low, high = (reached < half).sum(1), (reached <= half).sum(1)
        return np.asarray((present[low] + present[np.minimum(high, len(present) - 1)]) / 2)

    return statistic


def trimmed_mean(values: Floats, share: float = 0.01) -> Statistic:
    """Mean of (n,) values without the lowest `share` of them; NaN ones do not count."""
    order, present = _ascending(values)

    def statistic(weights: Floats) -> Floats:
        taken = weights[:, order]
        reached = np.cumsum(taken, axis=1)
        kept = np.clip(reached - np.floor(share * reached[:, -1:]), 0.0, taken)
        return _divide(kept @ present, kept.sum(1))

    return statistic


def _ascending(values: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Order of the values that are not NaN, and these values in it."""
    order = np.argsort(values)
    order = order[: len(values) - int(np.isnan(values).sum())]
    return order, values[order]


def _divide(top: Floats, bottom: Floats) -> Floats:
    return np.asarray(np.divide(top, bottom, out=np.full(len(top), np.nan), where=bottom > 0))
