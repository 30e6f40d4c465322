"""Joint probabilistic data association: every detection weighs as much as it is likely, over all joint events."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jink.estimators.multitarget.exclusive import one_scan_weights
from jink.estimators.multitarget.one_scan import Candidates, OneScanTracker

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
    weight, loopy = one_scan_weights(
        offered.begins, offered.pairs, offered.log_density, offered.detected, offered.density, offered.detections, 50,
        most,
    )  # fmt: skip
    if loopy:
        warnings.warn(
            f"Jpda: {loopy} targets share detections in more than {most} ways; they are weighed by belief "
            "propagation. Use a smaller gate, or Pmht.",
            RuntimeWarning,
            stacklevel=2,
        )
    return np.asarray(weight)
