"""Who plays an environment: estimators, fixed choices, chance; by name."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from jink.envs.adaptive_factor import AdaptiveFactorTask
from jink.envs.episodes import Source
from jink.envs.manoeuvring_target import ManoeuvringTargetTask
from jink.envs.policies import EstimatorPolicy
from jink.envs.streams import make_streams
from jink.envs.task import Task
from jink.estimators.agent.policy import Policy
from jink.estimators.agent.policy_file import POLICY_FILE, find_policy, pretrained_policies
from jink.estimators.api import BankEstimator
from jink.estimators.recipes import RECIPES, make_estimator
from jink.training.loading import is_spec, make_named
from jink.training.outside_policy import OutsidePolicy

__all__ = ["Player", "default_player", "find_agent", "make_agent_player", "make_player", "player_names", "scales_of"]

Player = Callable[[NDArray[Any]], Any]
"""From an observation to an action; remembers its own past, so one episode each."""
_EPISODES, _SEED = 8, 0
_USUAL = "mahalanobis"


class Scales(NamedTuple):
    """What `make_estimator` wants to know of a target."""

    acceleration: float  # m/s^2
    speed: float  # m/s
    sojourn: float  # s


def player_names(env: gymnasium.Env[Any, Any]) -> tuple[str, ...]:
    """Names that `make_player` knows for this environment."""
    task = _task(env)
    if isinstance(task, ManoeuvringTargetTask):
        return ("imm", *(name for name in RECIPES if name != "imm"), "none", "random")
    choices = _choices(env)
    return (*choices, "random") if choices else ("none", "random")


def default_player(env: gymnasium.Env[Any, Any]) -> str:
    """Who plays when nobody is named."""
    names = player_names(env)
    return _USUAL if _USUAL in names else names[0]


def make_player(name: str, env: gymnasium.Env[Any, Any], seed: int) -> Player:
    """A player for one episode.

    Args:
        name: an estimator's ("imm", "kf-cv", ..., or file.py:make; it estimates from the observations), a choice's
            (it is taken every time), "none" (repeats the measured position, or leaves the noise as it is) or "random".
        env: a single environment of Jink.
        seed: of "random".

    Returns:
        the player.

    Raises:
        ValueError: a name this environment does not know.
    """
    names = player_names(env)
    if is_spec(name):
        return _make_outside(name, env)
    if name not in names:
        raise ValueError(
            f"play: policy must be one of {', '.join(names)}; got '{name}'. Choose one that fits {_id(env)}."
        )
    choices = _choices(env)
    if name == "random":
        env.action_space.seed(seed)
        return lambda observation: env.action_space.sample()
    if name in choices:
        return lambda observation: choices.index(name)
    if name == "none":
        task = _task(env)
        if isinstance(task, ManoeuvringTargetTask):
            return _Repeater(task)
        # The least log inflation: the noise stays nominal.
        least = np.full(env.action_space.shape or (), -1.0, dtype=env.action_space.dtype)
        return lambda observation: least
    source = env.unwrapped.rollout.source  # type: ignore[attr-defined]
    return EstimatorPolicy(make_estimator(name, source.sensor, **scales_of(source)._asdict()), env)


def find_agent(name: str | None) -> Policy | None:
    """The agent of that folder or name, None where it is none; errors as `find_policy`."""
    if name is None:
        return None
    names_one = name in pretrained_policies() or Path(name).is_dir() or Path(name).name == POLICY_FILE
    return find_policy(name, "play") if names_one else None


def make_agent_player(agent: Policy, env: gymnasium.Env[Any, Any]) -> Player:
    """An agent as a player of an environment that was made with its options.

    Raises:
        ValueError: an environment whose actions it does not take, or another number of observations.
    """
    choices = bool(_choices(env))
    if not isinstance(_task(env), AdaptiveFactorTask) or choices != bool(agent.factors):
        fits = f"jink/AdaptiveFactor{'' if agent.factors else 'Continuous'}-v0"
        raise ValueError(f"play: environment must be {fits} for this agent; got {_id(env)}. Play {fits}.")
    return lambda observation: agent.act(observation[None])[0]


def _make_outside(spec: str, env: gymnasium.Env[Any, Any]) -> Player:
    """A third party's estimator as a player."""
    if not isinstance(_task(env), ManoeuvringTargetTask):
        raise ValueError(
            f"play: policy must be one of {', '.join(player_names(env))}; got '{spec}', an estimator. Choose one of "
            "them, or play ManoeuvringTarget-v0."
        )
    source = env.unwrapped.rollout.source  # type: ignore[attr-defined]
    estimator = make_named(spec, source.sensor, **scales_of(source)._asdict())
    if isinstance(estimator, BankEstimator):
        return EstimatorPolicy(estimator, env)
    return OutsidePolicy(estimator, _task(env).layout)  # type: ignore[attr-defined]


class _Repeater:
    """Says that the target is where it was last measured; the origin before that, or where no position is measured."""

    def __init__(self, task: ManoeuvringTargetTask) -> None:
        self.task = task
        self.last = np.zeros(task.source.axes)

    def __call__(self, observation: NDArray[Any]) -> NDArray[np.float64]:
        from jink.envs.observing import seen_positions

        seen = self.task.layout.read(np.asarray(observation, dtype=np.float64)[None])
        place = seen_positions(self.task.source.sensor, seen.measurement, seen.sensor_state)[0]
        self.last = np.where(np.isfinite(place), place, self.last)
        return np.clip(self.last / self.task.layout.scale, -1.0, 1.0)


def scales_of(source: Source) -> Scales:
    """Physical scales of a source's targets, from a few of its episodes.

    The acceleration is the one whose square is the noise that a constant-velocity filter should assume there.
    """
    streams = [make_streams(seeding.np_random(_SEED + row)[0]) for row in range(_EPISODES)]
    episodes = source.simulate(streams)
    speed = float(np.sqrt(np.nanmean(np.square(episodes.truth.velocity))))
    seconds = float(np.sum(episodes.times[:, -1] - episodes.times[:, 0]))
    stays = _EPISODES + int(np.isfinite(episodes.truth.switch_times).sum())
    return Scales(
        acceleration=math.sqrt(source.filter_noise),
        speed=speed if math.isfinite(speed) and speed > 0.0 else 10.0,
        sojourn=seconds / stays if seconds > 0.0 else 10.0,
    )


def _task(env: gymnasium.Env[Any, Any]) -> Task:
    task: Task = env.unwrapped.rollout.task  # type: ignore[attr-defined]
    return task


def _choices(env: gymnasium.Env[Any, Any]) -> tuple[str, ...]:
    """Names of the actions where they are a choice."""
    if not isinstance(env.action_space, gymnasium.spaces.Discrete):
        return ()
    return tuple(factor.name for factor in getattr(_task(env), "factors", ()))


def _id(env: gymnasium.Env[Any, Any]) -> str:
    return env.spec.id if env.spec is not None else "this environment"
