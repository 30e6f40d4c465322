"""Joint probabilistic data association: every detection weighs as much as it is likely, over all joint events."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jink.estimators.multitarget.exclusive import exclude
from jink.estimators.multitarget.one_scan import Candidates, OneScanTracker
from jink.estimators.multitarget.scan_kernels import joint_weights

__all__ = ["Jpda", "marginals"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Jpda(OneScanTracker):
    """Tracks that take every detection in their gate by its marginal probability, and its uncertainty with it.

    Model: ``p(event | z) ~ prod_m [P_D N(z; h(x-), S) / lambda, or 1 - P_D]`` over events in which no detection is of
    two targets; exact within clusters of targets that share detections. The number of events grows exponentially with
    a cluster: one of more than ``most`` is weighed by loopy belief propagation instead, with a warning.

    Args:
        most: joint events of a cluster that are counted one by one.

    Source: Fortmann, Bar-Shalom, Scheffe (1983); Williams, Lau (2014). Differs: none.
    """

    most: int = 1_000_000

    def weights(self, offered: Candidates) -> Array:
        """Marginal probability of each pair; (P,)."""
        return marginals(offered, self.most)


def marginals(offered: Candidates, most: int = 1_000_000) -> Array:
    """Marginal probability of each pair over all joint events; (P,)."""
    M, begins, pairs = len(offered.detected), offered.begins, offered.pairs
    target = np.repeat(np.arange(M), np.diff(begins))
    # One constant in all ratios of a detection cancels; without clutter lambda is a trace of the likeliest pair.
    top = offered.log_density.max(initial=-np.inf)
    if not np.isfinite(top):
        return np.zeros(len(pairs))
    clutter = max(offered.density * np.exp(-top), 1e-12)
    ratio = offered.detected[target] * np.exp(offered.log_density - top) / clutter
    missed = np.maximum(1.0 - offered.detected, 1e-12)
    joined = coo_array((np.ones(len(pairs)), (target, M + pairs)), shape=(M + offered.detections,) * 2)
    label = connected_components(joined, directed=False)[1][:M]
    weight = np.zeros(len(pairs))
    for cluster in np.unique(label[np.diff(begins) > 0]):
        targets = np.flatnonzero(label == cluster)
        if not joint_weights(begins, pairs, ratio, missed, targets, most, weight):
            warnings.warn(
                f"Jpda: {targets.size} targets share detections in more than {most} ways; they are weighed by belief "
                "propagation. Use a smaller gate, or Pmht.",
                RuntimeWarning,
                stacklevel=2,
            )
            own = np.isin(target, targets)
            found = np.zeros(len(pairs))
            exclude(
                np.array([0, offered.detections]), begins, pairs, np.log(np.maximum(ratio * clutter, 1e-300)),
                np.ascontiguousarray(missed[None]), np.full(1, clutter), 50, np.zeros(offered.detections),
                np.zeros(len(pairs)), found,
            )  # fmt: skip
            weight[own] = found[own]
    return weight
