"""Maximum likelihood by scoring: slopes of every row's log-likelihood, their second moments as curvature.

The bank's likelihood is a product over rows of predictive densities, so the slopes of single rows are uncorrelated at
the truth and the sum of their outer products estimates the Fisher information: a Newton method without second
derivatives. Differences through the compiled bank are cheap enough to be its slopes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Point", "climb", "slopes"]

Floats = NDArray[np.float64]
Objective = Callable[[Floats], Floats]
"""Parameters (K,) to log-likelihoods of n independent or predictive pieces (n,)."""

_STEP = 1e-3
_DAMPINGS = (1e-3, 1e3)


class Point(NamedTuple):
    """Where a climb stands: parameters, mean log-likelihood with prior, damping, and what was gained last."""

    at: Floats
    value: float
    damping: float
    gain: float


def slopes(objective: Objective, at: Floats, base: Floats, free: NDArray[np.bool_], step: float = _STEP) -> Floats:
    """Slopes of every piece by forward differences; (n, K), zero where a parameter is not free."""
    found = np.zeros((base.size, at.size))
    for k in np.flatnonzero(free):
        moved = at.copy()
        moved[k] += step
        found[:, k] = (objective(moved) - base) / step
    return found


def climb(
    objective: Objective,
    start: Floats,
    *,
    centre: Floats,
    width: Floats,
    free: NDArray[np.bool_] | None = None,
    iterations: int = 10,
    tolerance: float = 1e-4,
    largest: float | Floats = 1.0,
    damping: float = 0.01,
) -> Iterator[Point]:
    """Climb the penalised likelihood, one yield per accepted step.

    Model: maximise ``sum_n l_n(x) - 0.5 |(x - centre) / width|^2``; step ``(J'J + W^-2 + damping diag)^-1 gradient``,
    each component cut to its ``largest``.

    Args:
        objective: log-likelihoods of the pieces.
        start: parameters; (K,).
        centre, width: Gaussian prior of the parameters; (K,).
        free: which may move; None: all.
        iterations: at most so many steps.
        tolerance: stop when a step gains less, in the units of the mean over pieces.
        largest: longest step of each parameter; (K,).
        damping: Levenberg-Marquardt, at the start.

    Source: Berndt, Hall, Hall, Hausman (1974). Differs: damping, prior, bounded steps.
    """
    at = np.array(start, dtype=np.float64)
    free = np.ones(at.size, np.bool_) if free is None else free
    precision = 1.0 / np.square(width)

    def penalty(x: Floats) -> float:
        return 0.5 * float(np.sum(precision * np.square(x - centre)))

    base = objective(at)
    pieces = max(base.size, 1)
    value = float(base.sum()) - penalty(at)
    yield Point(at.copy(), value / pieces, damping, np.inf)
    for _ in range(iterations):
        found = slopes(objective, at, base, free)
        gradient = found.sum(axis=0) - precision * (at - centre)
        curvature = found.T @ found + np.diag(precision)
        scale = np.diag(np.diag(curvature))
        gain = -np.inf
        while damping <= _DAMPINGS[1]:
            move = np.where(free, np.linalg.solve(curvature + damping * scale, gradient), 0.0)
            move = np.clip(move, -np.asarray(largest), largest)
            trial = objective(at + move)
            reached = float(trial.sum()) - penalty(at + move)
            if np.isfinite(reached) and reached > value:
                gain = (reached - value) / pieces
                at, base, value = at + move, trial, reached
                damping = max(damping / 5.0, _DAMPINGS[0])
                break
            damping *= 4.0
        if not np.isfinite(gain):
            return
        yield Point(at.copy(), value / pieces, damping, gain)
        if gain < tolerance:
            return
