"""`evaluate`: how well a policy does on the episodes of given seeds, in any Gymnasium environment."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, NamedTuple, Protocol

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

__all__ = ["Evaluation", "Policy", "evaluate"]

_ERRORS = ("error", "error_agent")


class Policy(Protocol):
    """A policy with a memory per target."""

    def act(self, observations: NDArray[Any], first: NDArray[np.bool_]) -> NDArray[Any]:
        """Actions (B, ...) for observations (B, O); ``first`` (B,) marks targets that have just started."""
        ...


class Evaluation(NamedTuple):
    """What came of E episodes; step arrays end in NaN where an episode was shorter than T decisions."""

    seeds: NDArray[np.int64]  # (E,)
    returns: NDArray[np.float64]  # (E,) sum of rewards
    lengths: NDArray[np.int64]  # (E,) decisions
    terminated: NDArray[np.bool_]  # (E,) the track was lost
    rewards: NDArray[np.float64]  # (E, T)
    errors: NDArray[np.float64]  # (E, T) of the info asked for; NaN where the environment tells none


class _Tape:
    """Rewards and errors of one episode."""

    def __init__(self) -> None:
        self.rewards: list[float] = []
        self.errors: list[float] = []
        self.terminated = False
        self.over = False

    def note(self, reward: float, error: float, terminated: bool, truncated: bool) -> None:
        self.rewards.append(reward)
        self.errors.append(error)
        self.terminated, self.over = terminated, terminated or truncated


def evaluate(
    env: gymnasium.Env[Any, Any] | VectorEnv[Any, Any, Any],
    policy: Policy | Callable[[NDArray[Any]], Any],
    episodes: int = 100,
    seed: int = 0,
    *,
    error: str | None = None,
) -> Evaluation:
    """Play whole episodes; episode e is the one ``reset(seed=seed + e)`` starts, in single and vector environments.

    Args:
        env: single, or a vector environment in any autoreset mode.
        policy: a `Policy`, or a function from what ``reset`` and ``step`` of this environment return to its actions,
            for instance ``lambda observation: model.predict(observation, deterministic=True)[0]``.
        episodes: E, >= 1.
        seed: of the first episode.
        error: name of the info to keep as ``errors``; None: "error", else "error_agent", else none.

    Returns:
        rewards, errors and ends of the episodes.

    Raises:
        ValueError: ``episodes`` is not an integer >= 1, or a step's info has no ``error``.
    """
    if not isinstance(episodes, int | np.integer) or isinstance(episodes, bool) or episodes < 1:
        raise ValueError(f"evaluate: episodes must be an integer >= 1; got {episodes!r}. Give how many to play.")
    tapes: list[_Tape] = []
    if isinstance(env, VectorEnv):
        while len(tapes) < episodes:
            tapes += _play_batch(env, policy, seed + len(tapes), error)
    else:
        tapes = [_play(env, policy, seed + number, error) for number in range(episodes)]
    tapes = tapes[:episodes]
    lengths = np.array([len(tape.rewards) for tape in tapes])
    rewards, errors = np.full((2, episodes, int(lengths.max())), np.nan)
    for row, tape in enumerate(tapes):
        rewards[row, : lengths[row]] = tape.rewards
        errors[row, : lengths[row]] = tape.errors
    return Evaluation(
        np.arange(seed, seed + episodes),
        np.array([np.sum(tape.rewards) for tape in tapes]),
        lengths,
        np.array([tape.terminated for tape in tapes]),
        rewards,
        errors,
    )


def _error_name(error: str | None, told: Collection[str]) -> str:
    """The info that is the error, of those a step told."""
    if error is None:
        return next((name for name in _ERRORS if name in told), _ERRORS[0])
    if error not in told:
        names = ", ".join(sorted(name for name in told if not name.startswith(("_", "final_")))) or "none"
        raise ValueError(f"evaluate: error must be the name of an info; got {error!r}. The environment tells {names}.")
    return error


def _play(env: gymnasium.Env[Any, Any], policy: Any, seed: int, error: str | None) -> _Tape:
    tape, first = _Tape(), np.ones(1, dtype=np.bool_)
    observation, _ = env.reset(seed=seed)
    while not tape.over:
        action = policy.act(observation[None], first)[0] if hasattr(policy, "act") else policy(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        wrong = float(info.get(_error_name(error, info), np.nan))
        tape.note(float(reward), wrong, bool(terminated), bool(truncated))
        first = np.zeros(1, dtype=np.bool_)
    return tape


def _play_batch(env: VectorEnv[Any, Any, Any], policy: Any, seed: int, error: str | None) -> list[_Tape]:
    """The first episode of every target; those that are over play on unseen until the last one is."""
    mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
    tapes = [_Tape() for _ in range(env.num_envs)]
    observations, _ = env.reset(seed=seed)
    first = np.ones(env.num_envs, dtype=np.bool_)
    ended = np.zeros(env.num_envs, dtype=np.bool_)
    while not all(tape.over for tape in tapes):
        if mode is AutoresetMode.DISABLED and ended.any():
            observations, _ = env.reset(options={"reset_mask": ended})
            first = ended
        actions = policy.act(observations, first) if hasattr(policy, "act") else policy(observations)
        observations, rewards, terminated, truncated, infos = env.step(actions)
        told = infos.get("final_info", {})
        name = _error_name(error, {*infos, *told})
        errors = np.array(infos.get(name, np.full(env.num_envs, np.nan)), dtype=np.float64)
        if name in told:
            errors = np.where(told[f"_{name}"], told[name], errors)
        for row, tape in enumerate(tapes):
            if not tape.over:
                tape.note(float(rewards[row]), float(errors[row]), bool(terminated[row]), bool(truncated[row]))
        before, ended = ended, terminated | truncated
        starts = {AutoresetMode.NEXT_STEP: before, AutoresetMode.SAME_STEP: ended}
        first = starts.get(mode, np.zeros_like(ended))
    return tapes
