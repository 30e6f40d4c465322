"""Groups of what an agent sees in the view `levels`, by name, so that a training can hide some of them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from jink.estimators.agent.beliefs import LEVELS
from jink.estimators.agent.looking import LEVELS_SIZE

__all__ = ["GROUPS", "shown_columns"]

_BELIEF = 12
GROUPS: dict[str, range] = {
    "innovation": range(2),
    "share": range(2, 3),
    "averages": range(3, 9),
    "direction": range(9, 11),
    "gap": range(11, 12),
    "belief": range(_BELIEF, _BELIEF + LEVELS),
    "advice": range(_BELIEF + LEVELS, _BELIEF + LEVELS + 1),
    "used": range(_BELIEF + LEVELS + 1, LEVELS_SIZE),
}
"""Columns of the observation: size of the innovation against its covariance and against R; share of the prediction in
that covariance; averages of both sizes; how far innovations point one way; time since the last detection; belief about
the noise level; the inflation that follows from it; the inflation used last."""


def shown_columns(hidden: Collection[str]) -> NDArray[np.bool_]:
    """Which columns of the view `levels` stay when the groups of these names are hidden; (F,)."""
    shown = np.ones(LEVELS_SIZE, dtype=np.bool_)
    for name in hidden:
        shown[list(GROUPS[name])] = False
    return shown
