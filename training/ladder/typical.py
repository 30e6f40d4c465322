"""What every estimator is told of a scenario's targets: physical scales, from episodes that no table shows."""

from __future__ import annotations

import functools
import math

import numpy as np
from gymnasium.utils import seeding

from jink.envs.episodes import Episodes
from jink.envs.scenario import Scenario
from jink.envs.scenarios import make_scenario
from jink.envs.streams import make_streams
from jink.estimators.recipes import Scales

__all__ = ["EVALUATION_END", "EVALUATION_SEED", "TRAINING_SEED", "simulate_runs", "typical_scales"]

EVALUATION_SEED, EVALUATION_END, TRAINING_SEED = 100_000, 1_000_000, 50_000
"""First run of a table unless told otherwise, one after the last that it may have, and the first run of what settings
are chosen on. Run i has the seed of the first plus i; nothing that is learned or tuned uses seeds from 100 000 to
999 999."""
_RUNS = 16


def simulate_runs(scenario: Scenario, runs: int, seed: int) -> Episodes:
    """Episodes: row i is the first episode of an environment that is reset with ``seed + i``."""
    return scenario.simulate([make_streams(seeding.np_random(seed + i)[0]) for i in range(runs)])


def typical_scales(scenario: Scenario) -> Scales:
    """Speed and time between switches of sixteen training episodes, and the acceleration that `filter_noise` says."""
    return _typical(scenario.id) if make_scenario(scenario.id) == scenario else _measured(scenario)


@functools.cache
def _typical(name: str) -> Scales:
    return _measured(make_scenario(name))


def _measured(scenario: Scenario) -> Scales:
    episodes = simulate_runs(scenario, _RUNS, TRAINING_SEED)
    seconds = float(np.sum(episodes.times[:, -1] - episodes.times[:, 0]))
    stays = _RUNS + int(np.isfinite(episodes.truth.switch_times).sum())
    return Scales(
        acceleration=math.sqrt(scenario.filter_noise),
        speed=float(np.sqrt(np.mean(np.square(episodes.truth.velocity)))),
        sojourn=seconds / stays,
    )
