"""How many clusters: the Bayesian information criterion, which the baselines share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

__all__ = ["best_of"]

Found = TypeVar("Found")


def best_of(
    climb: Callable[[int], tuple[float, int, Found]], sizes: Sequence[int], data: float
) -> tuple[Found, int, list[tuple[int, float]]]:
    """The size with the smallest ``-2 log L + parameters log n``.

    Args:
        climb: number of clusters to log-likelihood, number of parameters, and what was found.
        sizes: numbers to try.
        data: independent data n.

    Returns:
        what was found, its size, and the curve: size and criterion of each.

    Source: Schwarz (1978).
    """
    best: tuple[float, int, Found] | None = None
    curve = []
    for size in sizes:
        score, parameters, found = climb(size)
        criterion = -2.0 * score + parameters * float(np.log(max(data, 2.0)))
        curve.append((size, criterion))
        if best is None or criterion < best[0]:
            best = (criterion, size, found)
    if best is None:
        raise ValueError("best_of: sizes must hold at least one number; got none. Try 1 to 8.")
    return best[2], best[1], curve
