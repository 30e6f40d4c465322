"""Global nearest neighbour: the one assignment of detections to tracks that explains a scan best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from jink.estimators.multitarget.one_scan import Candidates, OneScanTracker

__all__ = ["Gnn", "assign"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gnn(OneScanTracker):
    """Tracks that each take the detection of the best joint assignment, or none.

    Model: the assignment with the largest ``prod_m [P_D N(z; h(x-), S) / lambda, or 1 - P_D]``; then one Kalman update.
    Without clutter lambda counts as 1e-12 of the likeliest pair, so that all detections that can be are assigned.

    Source: Blackman, Popoli (1999), section 6.4. Differs: none.
    """

    def weights(self, offered: Candidates) -> Array:
        """1 for the pairs of the best assignment, else 0; (P,)."""
        return assign(offered)


def assign(offered: Candidates) -> Array:
    """1 for the pairs of the assignment with the largest likelihood, else 0; (P,)."""
    M, pairs = len(offered.detected), offered.pairs
    target = np.repeat(np.arange(M), np.diff(offered.begins))
    floor = offered.log_density.max(initial=-np.inf) + np.log(1e-12)
    if not np.isfinite(floor):
        return np.zeros(len(pairs))
    log_clutter = np.log(offered.density) if offered.density > 0 else floor
    with np.errstate(divide="ignore"):
        gain = np.log(offered.detected[target]) + offered.log_density - log_clutter
        missed = np.log(np.maximum(1.0 - offered.detected, 1e-12))
    # What cannot be is dearer than everything that can be together.
    worst = np.abs(gain[np.isfinite(gain)]).sum() + np.abs(missed).sum() + 1.0
    # Only detections that someone wants get a column.
    wanted, column = np.unique(pairs, return_inverse=True)
    cost = np.full((M, wanted.size + M), worst)
    good = np.isfinite(gain)
    cost[target[good], column[good]] = -gain[good]
    cost[np.arange(M), wanted.size + np.arange(M)] = -missed
    rows, columns = linear_sum_assignment(cost)
    chosen = np.full(M, -1)
    chosen[rows] = columns
    return (good & (chosen[target] == column)).astype(np.float64)
