"""Distance between a set of estimated targets and the set of true ones: GOSPA with its parts, and OSPA.

Sets are arrays ``(K, T, A)``: K tracks (or N targets), T times, A axes; a track that is not there at a time is NaN,
and a partly finite position is no position. ``(K, A)`` is one time. No estimate is an infinite error here: what does
not exist is a missed target, at the price of the cut-off.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from jink.estimators.checks import check_array, check_number
from jink.estimators.metrics.steps import Floats, Ints

__all__ = ["Gospa", "gospa", "ospa", "target_set"]


LEAST_POWER, MOST_POWER = -280, 280
"""Powers of ten of ``cutoff**order`` beyond which sums over targets leave the range of numbers."""


class Gospa(NamedTuple):
    """GOSPA and what it is made of, at each time; ``distance**order == localisation + missed + false``.

    distance: m. localisation, missed, false: parts, m^order. pairs, missed_count, false_count: how many.
    estimate_of: (N, T) which estimate each target is paired with, -1 none.
    """

    distance: Floats
    localisation: Floats
    missed: Floats
    false: Floats
    pairs: Ints
    missed_count: Ints
    false_count: Ints
    estimate_of: Ints


def gospa(estimate: ArrayLike, truth: ArrayLike, cutoff: float, order: float = 2.0) -> Gospa:
    """Generalised optimal sub-pattern assignment with alpha = 2: location errors, missed and false targets.

    Model: ``d^p = min_gamma sum_{(i,j) in gamma} |x_i - y_j|^p + c^p/2 (K + N - 2 |gamma|)``; gamma pairs each target
    and each estimate at most once. A pair farther apart than c is one miss and one false target.

    Args:
        estimate: (K, T, A) or (K, A) m; NaN = no such track then.
        truth: (N, T, A) or (N, A) m; NaN = no such target then.
        cutoff: c, m, > 0: from here on an estimate is of another target.
        order: p >= 1.
    Returns:
        `Gospa`, fields (T,), or without dimension for one time.
    Raises:
        ValueError: shapes differ, cutoff <= 0, order < 1, or a power of the cut-off that is no number.
    Source: Rahmathullah, Garcia-Fernandez, Svensson (2017), proposition 1. Differs: none.
    """
    x, y = _pair("gospa", estimate, truth, cutoff, order)
    times = x.shape[1]
    located = np.zeros(times)
    estimate_of = np.full((y.shape[0], times), -1, dtype=np.int64)
    counts = np.zeros((2, times), dtype=np.int64)
    for k in range(times):
        rows, columns, cost, present = _assign(x[:, k], y[:, k], cutoff, order)
        paired = cost < cutoff**order
        located[k] = cost[paired].sum()
        counts[:, k] = present
        estimate_of[columns[paired], k] = rows[paired]
    pairs = (estimate_of >= 0).sum(axis=0)
    false_count, missed_count = counts - pairs
    half = 0.5 * cutoff**order
    total = located + half * (missed_count + false_count)
    found = Gospa(
        total ** (1.0 / order),
        located,
        half * missed_count,
        half * false_count,
        pairs,
        missed_count,
        false_count,
        estimate_of,
    )
    return Gospa._make(part[..., 0] for part in found) if np.ndim(truth) == 2 else found


def ospa(estimate: ArrayLike, truth: ArrayLike, cutoff: float, order: float = 2.0) -> Floats:
    """Optimal sub-pattern assignment distance: an average per target, so that many targets weigh no more than few.

    Model: ``d^p = (min_pi sum_{i <= m} min(|x_i - y_pi(i)|, c)^p + c^p (n - m)) / n``, n the larger number, m the
    smaller; 0 if both sets are empty. The cost is raised to p *before* the best assignment is chosen: for p > 1 the
    assignment of least distance is another one, and its value is no minimum.

    Args:
        estimate: (K, T, A) or (K, A) m; NaN = no such track then.
        truth: (N, T, A) or (N, A) m; NaN = no such target then.
        cutoff: c, m, > 0.
        order: p >= 1.
    Returns:
        (T,) m, or without dimension for one time.
    Raises:
        ValueError: as `gospa`.
    Source: Schuhmacher, Vo, Vo (2008), equation (3). Differs: none.
    """
    x, y = _pair("ospa", estimate, truth, cutoff, order)
    out = np.zeros(x.shape[1])
    for k in range(len(out)):
        _, _, cost, (few, many) = _assign(x[:, k], y[:, k], cutoff, order)
        larger = max(few, many)
        if larger:
            out[k] = ((cost.sum() + cutoff**order * abs(few - many)) / larger) ** (1.0 / order)
    return np.asarray(out[0]) if np.ndim(truth) == 2 else out


def target_set(caller: str, name: str, values: ArrayLike) -> Floats:
    """Positions as (K, T, A); a position that is not finite on every axis is NaN on all.

    Raises:
        ValueError: not two or three dimensions, or no axis.
    """
    array = check_array(caller, name, values, "Give positions in metres.")
    if array.ndim == 2:
        array = array[:, None]
    if array.ndim != 3 or array.shape[2] == 0:
        raise ValueError(
            f"{caller}: {name} must have shape (K, T, A), or (K, A) for one time; got {np.shape(values)}. "
            "Put tracks first; an empty set is np.empty((0, T, A))."
        )
    array[~np.isfinite(array).all(axis=2)] = np.nan
    return array


def _pair(caller: str, estimate: ArrayLike, truth: ArrayLike, cutoff: float, order: float) -> tuple[Floats, Floats]:
    remedy = "Use a few standard deviations of the position, in metres."
    c = check_number(caller, "cutoff", cutoff, 0.0, remedy=remedy)
    p = check_number(caller, "order", order, 1.0, least=True, remedy="Use 2.")
    if not LEAST_POWER < p * np.log10(c) < MOST_POWER:
        raise ValueError(
            f"{caller}: cutoff must have a power cutoff**order between 1e{LEAST_POWER} and 1e{MOST_POWER}; got {c:g} "
            f"and order {p:g}. {remedy}"
        )
    x, y = target_set(caller, "estimate", estimate), target_set(caller, "truth", truth)
    if x.shape[1:] != y.shape[1:] or np.ndim(estimate) != np.ndim(truth):
        raise ValueError(
            f"{caller}: estimate and truth must have the same times and axes; got shapes {np.shape(estimate)} and "
            f"{np.shape(truth)}. Only the number of tracks may differ."
        )
    return x, y


def _assign(x: Floats, y: Floats, cutoff: float, order: float) -> tuple[Ints, Ints, Floats, tuple[int, int]]:
    """Rows of x, rows of y and cost min(d, c)^p of the best assignment, and how many there are of each."""
    rows, columns = np.flatnonzero(~np.isnan(x[:, 0])), np.flatnonzero(~np.isnan(y[:, 0]))
    apart = np.linalg.norm(x[rows, None] - y[None, columns], axis=2)
    cost = np.minimum(apart, cutoff) ** order
    first, second = linear_sum_assignment(cost)
    return rows[first], columns[second], cost[first, second], (rows.size, columns.size)
