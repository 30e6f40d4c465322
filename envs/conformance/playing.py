"""Playing a vector environment with random actions, and comparing two of them: what its conformance test rests on."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import concatenate, create_empty_array

from jink.envs.conformance.comparing import difference

__all__ = ["Env", "Failed", "Mode", "Skipped", "Subject", "batch_actions", "mode_of", "play", "same_play"]

Mode = AutoresetMode | None
Env = VectorEnv[Any, Any, Any]


class Failed(Exception):  # noqa: N818 - an outcome, not an error
    """What was found instead, in one sentence."""


class Skipped(Exception):  # noqa: N818 - an outcome, not an error
    """Why the check does not apply."""


class Subject(NamedTuple):
    """What is examined."""

    make: Callable[[Mode], Env]  # None: its own autoreset mode
    make_sync: Callable[[Mode], Env]  # the same of single environments; raises `Skipped`
    seed: int
    steps: int


def mode_of(env: Env) -> Any:
    """The autoreset mode an environment declares."""
    return env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)


def batch_actions(env: Env, actions: list[Any]) -> Any:
    """Single actions as one action of the vector environment."""
    empty: Any = create_empty_array(env.single_action_space, env.num_envs)
    return concatenate(env.single_action_space, actions, empty)


def play(env: Env, seed: int, steps: int) -> Iterator[tuple[str, Any]]:
    """Reset and step with random actions; the actions of row i follow from ``seed + i`` alone.

    Yields:
        what was called, and what it returned.
    """
    spaces = [copy.deepcopy(env.single_action_space) for _ in range(env.num_envs)]
    for row, space in enumerate(spaces):
        space.seed(seed + row)
    yield "reset", env.reset(seed=seed)
    ended = np.zeros(env.num_envs, dtype=np.bool_)
    for t in range(steps):
        if mode_of(env) is AutoresetMode.DISABLED and ended.any():
            yield f"reset before step {t}", env.reset(options={"reset_mask": ended.copy()})
        result = env.step(batch_actions(env, [space.sample() for space in spaces]))
        ended = np.logical_or(result[2], result[3])
        yield f"step {t}", result


def same_play(a: Env, b: Env, subject: Subject, what: str) -> str:
    """Compare two environments call by call.

    Returns:
        how much was compared.

    Raises:
        Failed: at the first difference.
    """
    steps = ends = lost = 0
    for (call, left), (_, right) in zip(play(a, subject.seed, subject.steps), play(b, subject.seed, subject.steps)):
        names = (
            ("observations", "rewards", "terminated", "truncated", "infos")
            if len(left) == 5
            else ("observations", "infos")
        )
        for name, x, y in zip(names, left, right):
            if text := difference(x, y, name):
                raise Failed(f"{what}: at {call}, {text}.")
        if len(left) == 5:
            steps, ends, lost = steps + 1, ends + int(np.sum(left[2] | left[3])), lost + int(np.sum(left[2]))
    return f"{steps} steps, {ends} ends of episodes, {lost} of them terminations"
