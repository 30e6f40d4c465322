"""Picking and joining episodes."""

from __future__ import annotations

import numpy as np
import pytest
from straight_source import Straight
from test_adaptive_factor import episodes_of

from jink.envs.episodes import join, pick
from jink.envs.scenarios import make_scenario


def same(a, b):
    for name in a._fields:
        x, y = getattr(a, name), getattr(b, name)
        if name in ("truth", "delivered"):
            same(x, y)
        elif name == "switch_times":  # padding follows the longest row
            width = max(x.shape[1], y.shape[1])
            x, y = (np.pad(z, ((0, 0), (0, width - z.shape[1])), constant_values=np.nan) for z in (x, y))
            np.testing.assert_array_equal(x, y)
        else:
            np.testing.assert_array_equal(x, y, err_msg=name)


@pytest.mark.parametrize("options", [{}, {"latency": 0.3}])
def test_parts_of_episodes_joined_again_are_the_episodes(options):
    whole = episodes_of(make_scenario("switch-v0", steps=60, **options), 7)
    order = np.array([4, 0, 6, 2, 1, 5, 3])
    parts = [pick(whole, order[:3]), pick(whole, order[3:4]), pick(whole, order[4:])]
    back = pick(join(parts), np.argsort(order))
    same(back, whole)
    assert (back.delivered is back.truth) == (whole.delivered is whole.truth) == (not options)
    parts[0].measurements[:] = 0.0  # a copy
    same(back, whole)


def test_episodes_of_other_sources_are_refused():
    ours, other = episodes_of(Straight(steps=10), 2), episodes_of(Straight(steps=10, sigma=3.0), 2)
    with pytest.raises(ValueError, match="join: nominal_noise must be the same"):
        join([ours, other])
