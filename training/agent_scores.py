"""How well a policy plays: errors of whole episodes beside the nominal filter and the oracle, and scores from them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from jink.envs.adaptive_factor import AdaptiveFactorTask
from jink.envs.choosing import choose_source, choose_task
from jink.envs.episodes import Episodes, Source
from jink.envs.streams import make_streams
from jink.estimators.agent.policy import Policy

__all__ = ["Played", "interquartile_mean", "make_source", "play_episodes", "score", "simulate_seeds"]

Floats = NDArray[np.float64]
Act = Callable[[NDArray[Any], NDArray[np.bool_]], NDArray[Any]]
LEAST_GAIN = 0.1
"""The gap between nominal filter and oracle counts as at least this many sigma, as in the environment's reward."""


class Played(NamedTuple):
    """Mean distance to the truth over an episode, m; (E,) each."""

    agent: Floats
    nominal: Floats
    oracle: Floats
    sigma: Floats
    lost: NDArray[np.bool_]


def make_source(suite: str | None = None, scenario: Any = None, tracks: Any = None) -> Source:
    """Episodes as ``gymnasium.make`` would have them."""
    return choose_source(choose_task("adaptive-factor", {}), scenario=scenario, suite=suite, tracks=tracks)


def simulate_seeds(source: Source, seed: int, episodes: int) -> Episodes:
    """The episodes that ``reset(seed=seed)`` of a vector environment starts, target i with ``seed + i``."""
    return source.simulate([make_streams(seeding.np_random(seed + i)[0]) for i in range(episodes)])


def play_episodes(act: Policy | Act, source: Source, episodes: Episodes, **options: Any) -> Played:
    """Play whole episodes side by side; a lost track goes on being counted.

    Args:
        act: a policy, or a function of observations (B, F) and whether they are first (B,) to actions.
        source, episodes: what happens, and from where.
        options: of `AdaptiveFactorTask`, ``continuous`` among them; those of a `Policy` are its own.
    """
    if isinstance(act, Policy):
        options = {"continuous": not act.factors, **act.environment(), **options}
        act = act.act
    count, steps = episodes.times.shape
    task = AdaptiveFactorTask(source, count, lost_after=np.inf, **options)
    task.begin(np.arange(count), episodes)
    k, live, first = np.zeros(count, dtype=np.int64), np.ones(count, dtype=np.bool_), np.ones(count, dtype=np.bool_)
    sums = np.zeros((3, count))
    for _ in range(steps - 1):
        task.step(task.check_actions(act(task.observe(k), first), "step"), k, live)
        k = k + 1
        first = np.zeros(count, dtype=np.bool_)
        told = task.info(k)
        for row, name in enumerate(("error_agent", "error_nominal", "error_oracle")):
            sums[row] += np.nan_to_num(told[name])
    known = np.isfinite(episodes.truth.position[:, :-1]).all(axis=2).sum(axis=1)
    sigma = task.sigma
    means = sums / np.maximum(known, 1)
    return Played(means[0], means[1], means[2], sigma, means[0] > 25.0 * np.maximum(sigma, means[1]))


def score(error: Floats, nominal: Floats, oracle: Floats, sigma: Floats | float = 1.0) -> Floats:
    """0 for the nominal filter, 1 for the oracle; (E,)."""
    return np.asarray((nominal - error) / np.maximum(nominal - oracle, LEAST_GAIN * sigma))


def interquartile_mean(values: Floats, axis: int = -1) -> Floats:
    """Mean of the middle half."""
    ordered = np.sort(values, axis=axis)
    cut = ordered.shape[axis] // 4
    return np.asarray(np.take(ordered, np.arange(cut, ordered.shape[axis] - cut), axis=axis).mean(axis=axis))
