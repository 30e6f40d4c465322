"""Checks of vector environments in each autoreset mode; each passes, or raises what it found."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers

from jink.envs.conformance.comparing import arrays_of, difference, rows_of
from jink.envs.conformance.playing import Env, Failed, Mode, Skipped, Subject, mode_of, play, same_play

__all__ = ["MODE_CHECKS"]


def check_results(subject: Subject, mode: Mode) -> str:
    """Shapes, types and membership of what reset and step return."""
    env = subject.make(mode)
    n = env.num_envs
    for call, result in play(env, subject.seed, min(subject.steps, 100)):
        if not isinstance(result[-1], dict):
            raise Failed(f"infos must be a dict; at {call}, got {type(result[-1]).__name__}.")
        if result[0] not in env.observation_space:
            raise Failed(f"observations must lie in observation_space; at {call}, they do not.")
        if len(result) == 5:
            for name, value, kinds in zip(("rewards", "terminated", "truncated"), result[1:4], ("f", "b", "b")):
                if not isinstance(value, np.ndarray) or value.shape != (n,) or value.dtype.kind != kinds:
                    raise Failed(f"{name} must be an array ({n},) of kind {kinds}; at {call}, got {value!r}.")
    return "shapes, types and spaces fit"


def check_fresh(subject: Subject, mode: Mode) -> str:
    """What was returned stays as it was."""
    kept: list[tuple[str, Any, Any]] = []
    for call, result in play(subject.make(mode), subject.seed, min(subject.steps, 60)):
        for old_call, old, _ in kept[-3:]:
            for place, array in arrays_of(result):
                if shared := next((p for p, a in arrays_of(old) if np.shares_memory(a, array)), None):
                    raise Failed(f"arrays must be fresh; result{place} of {call} is result{shared} of {old_call}.")
        kept.append((call, result, copy.deepcopy(result)))
    for call, result, copied in kept:
        if text := difference(result, copied, "result"):
            raise Failed(f"what {call} returned must stay as it was; later {text}.")
    return "arrays are fresh and stay as they were"


def check_masks(subject: Subject, mode: Mode) -> str:
    """Every info is an array, one entry per environment, beside a mask."""
    env, found = subject.make(mode), set()
    for call, result in play(env, subject.seed, subject.steps):
        found |= _masks(result[-1], env.num_envs, call)
    if not found:
        raise Skipped("there are no infos")
    return f"{len(found)} infos, each beside its mask"


def _masks(infos: dict[str, Any], n: int, call: str) -> set[str]:
    for key, value in infos.items():
        if key.startswith("_") and key[1:] in infos:
            continue
        mask = infos.get(f"_{key}")
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (n,):
            raise Failed(f"infos['_{key}'] must be a bool array ({n},) beside infos['{key}']; at {call}, got {mask!r}.")
        if isinstance(value, dict):
            _masks(value, n, call)
        elif not isinstance(value, np.ndarray) or len(value) != n:
            raise Failed(f"infos['{key}'] must be an array with {n} entries; at {call}, got {type(value).__name__}.")
    return {key for key in infos if not key.startswith("_")}


def check_autoreset(subject: Subject, mode: Mode) -> str:
    """What happens after the end of an episode is what the mode says."""
    env = subject.make(mode)
    ended, ends = np.zeros(env.num_envs, dtype=np.bool_), 0
    for call, result in play(env, subject.seed, subject.steps):
        if len(result) == 2:
            continue
        _, rewards, terminated, truncated, infos = result
        now = terminated | truncated
        if mode_of(env) is AutoresetMode.NEXT_STEP and (np.any(rewards[ended] != 0) or np.any(now[ended])):
            raise Failed(f"the step after an end must only reset, with reward 0; at {call}, it did not.")
        if mode_of(env) is AutoresetMode.SAME_STEP and now.any():
            last = infos.get("final_obs")
            if last is None or "final_info" not in infos or not np.array_equal(infos.get("_final_obs"), now):
                raise Failed(
                    f"infos must hold final_obs and final_info of those that ended; at {call}, {sorted(infos)}."
                )
            if any(last[row] not in env.single_observation_space for row in np.flatnonzero(now)):
                raise Failed(f"final_obs must lie in single_observation_space; at {call}, it does not.")
        ended, ends = now, ends + int(now.sum())
    if not ends:
        raise Skipped(f"no episode ended within {subject.steps} steps")
    return f"{ends} ends of episodes handled"


def check_reset_mask(subject: Subject, mode: Mode) -> str:
    """A masked reset starts the marked environments and leaves the others where they are."""
    env = subject.make(mode)
    if mode_of(env) is not AutoresetMode.DISABLED:
        raise Skipped("only asked of Disabled")
    if env.num_envs < 2:
        raise Skipped("one environment has no neighbours")
    results = [copy.deepcopy(result) for _, result in play(env, subject.seed, 2)]
    mask = np.zeros(env.num_envs, dtype=np.bool_)
    mask[0] = True
    options = {"reset_mask": mask}
    observations, infos = env.reset(options=dict(options))
    for row in range(1, env.num_envs):
        if text := difference(rows_of(results[-1][0], row, len(mask)), rows_of(observations, row, len(mask)), "it"):
            raise Failed(f"a masked reset must leave others alone; row {row}: {text}.")
    if any(not np.array_equal(value, mask) for key, value in infos.items() if key.startswith("_")):
        raise Failed("infos of a masked reset must be those of the environments it started; the masks differ.")
    return "others stay where they are"


def check_singles(subject: Subject, mode: Mode) -> str:
    """Native equals SyncVectorEnv of single environments, bit for bit."""
    native = subject.make(mode)
    return same_play(native, subject.make_sync(mode_of(native)), subject, "native against SyncVectorEnv")


def check_wrappers(subject: Subject, mode: Mode) -> str:
    """Gymnasium's vector wrappers work on it wherever they accept the mode."""
    names = []
    lengths = np.zeros(subject.make(mode).num_envs, dtype=np.int64)
    skip = np.zeros(len(lengths), dtype=np.bool_)
    env: Env = wrappers.RecordEpisodeStatistics(subject.make(mode))
    for call, result in play(env, subject.seed, subject.steps):
        if len(result) == 2:
            lengths[skip] = 0
            skip[:] = False
            continue
        now = result[2] | result[3]
        lengths = np.where(skip, 0, lengths + 1)
        if now.any() and not np.array_equal(result[4]["episode"]["l"][now], lengths[now]):
            raise Failed(
                f"RecordEpisodeStatistics must count {lengths[now]}; at {call}, {result[4]['episode']['l'][now]}."
            )
        if mode_of(env) is AutoresetMode.SAME_STEP:
            lengths[now] = 0
        else:
            skip = now
    names.append("RecordEpisodeStatistics")
    env = wrappers.DictInfoToList(wrappers.ClipReward(subject.make(mode), -0.5, 0.5))
    for call, result in play(env, subject.seed, min(subject.steps, 50)):
        if not isinstance(result[-1], list) or len(result[-1]) != env.num_envs:
            raise Failed(f"DictInfoToList must give one dict each; at {call}, it did not.")
        if len(result) == 5 and np.any(np.abs(result[1]) > 0.5):
            raise Failed(f"ClipReward must clip; at {call}, got {result[1]}.")
    names += ["ClipReward", "DictInfoToList"]
    if mode_of(env) is AutoresetMode.NEXT_STEP and isinstance(env.single_observation_space, Box):
        for _ in play(wrappers.NormalizeObservation(subject.make(mode)), subject.seed, min(subject.steps, 50)):
            pass
        names.append("NormalizeObservation")
    return ", ".join(names)


MODE_CHECKS: dict[str, Callable[[Subject, Mode], str]] = {
    "results": check_results,
    "fresh arrays": check_fresh,
    "info masks": check_masks,
    "autoreset": check_autoreset,
    "reset mask": check_reset_mask,
    "singles": check_singles,
    "wrappers": check_wrappers,
}
"""Name -> check."""
