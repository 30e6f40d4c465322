"""Whether what somebody's estimator says of a moment depends on what was measured later: then it is no filter."""

from __future__ import annotations

import numpy as np

from jink.envs.episodes import Episodes
from jink.estimators.api import Estimates
from jink.training.contract.subject import same
from jink.training.ladder.rungs import Follower

__all__ = ["foresight"]


def foresight(follower: Follower, episodes: Episodes, found: Estimates) -> str:
    """Why estimates may not stand beside those of filters; "" where they may.

    The second half of the measurements is changed, and nothing may change in the first half: neither the estimates nor
    the predictions. One look; `jink check` has the whole contract.

    Args:
        follower: under examination.
        episodes: what it followed.
        found: its estimates of them.
    """
    if text := same(found, follower.estimate(episodes)):
        return (
            f"a second run of the same measurements gives {text}; seed what is random and keep nothing between runs "
            "(jink check says more)"
        )
    cut = episodes.times.shape[1] // 2
    changed = episodes.measurements.copy()
    changed[:, cut:] = 1.1 * changed[:, cut:] + 3.0
    other = episodes._replace(measurements=changed)
    again = follower.estimate(other)
    if text := same(found, again, rows=(slice(None), slice(0, cut))):
        return f"it looks ahead: later measurements change an earlier {text}; estimate a row from rows up to it"
    one, two = (follower.read(each, said).forecast for each, said in ((episodes, found), (other, again)))
    if one is not None and two is not None and not np.array_equal(one[:, :cut], two[:, :cut], equal_nan=True):
        return "it looks ahead: later measurements change an earlier prediction; predict a row from rows up to it"
    return ""
