"""Many targets as one native Gymnasium vector environment: one compiled step for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from jink.envs.choosing import choose_source, choose_task
from jink.envs.frames import Frames
from jink.envs.rollout import Rollout, TaskFactory, check_seed
from jink.envs.single import TargetEnv

__all__ = ["TargetVectorEnv"]

Infos = dict[str, Any]
Stepped = tuple[NDArray[Any], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Infos]


class TargetVectorEnv(VectorEnv[NDArray[Any], Any, NDArray[Any]]):
    """B targets under a task: bit for bit what `gymnasium.vector.SyncVectorEnv` of B single environments gives.

    Args:
        task: as in `TargetEnv`.
        num_envs: number of targets B.
        autoreset_mode: what happens after an episode's end: "NextStep" (the next step starts the new episode, its
            action is ignored), "SameStep" (it starts at once; the last observation is in ``infos["final_obs"]``) or
            "Disabled" (``reset(options={"reset_mask": mask})`` starts it).
        scenario, suite, tracks, stagger, options: as in `TargetEnv`.
        infos: False: infos hold the last observations of episodes that end at once and nothing else, which is all that
            learning needs.
        render_mode: None, "rgb_array" (one frame per target) or "human" (the first target).

    Raises:
        ValueError: as `TargetEnv`, or an unknown autoreset mode.
    """

    def __init__(
        self,
        task: str | TaskFactory,
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        scenario: Any = None,
        suite: str | None = None,
        tracks: Any = None,
        stagger: bool = False,
        infos: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self._tells = bool(infos)
        self.autoreset_mode = as_autoreset_mode(autoreset_mode)
        chosen = choose_task(task, options)
        source = choose_source(chosen, scenario=scenario, suite=suite, tracks=tracks)
        self._rollout = Rollout(chosen.make, source, num_envs, stagger=stagger)
        self._frames = Frames(render_mode)
        self._every = np.arange(self._rollout.count)
        self.num_envs = self._rollout.count
        self.render_mode = render_mode
        self.metadata = {**TargetEnv.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = self._rollout.task.observation_space
        self.single_action_space = self._rollout.task.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @property
    def rollout(self) -> Rollout:
        """The episodes under way: their task, source and clocks."""
        return self._rollout

    @property  # type: ignore[override]
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """One generator per target."""
        return tuple(self._rollout.generator(row) for row in range(self.num_envs))

    @np_random.setter  # type: ignore[override]
    def np_random(self, value: Sequence[np.random.Generator]) -> None:
        for row, generator in enumerate(value):
            self._rollout.set_generator(row, generator)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """One seed per target."""
        return tuple(self._rollout.seeds) if self.np_random else ()

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], Infos]:
        """Start new episodes.

        Args:
            seed: s: target i uses ``s + i``; a list: one seed (or None) per target; None: generators continue.
            options: ``reset_mask``, an array (B,) of bool with at least one True: only those targets start.

        Returns:
            Observations of all targets; infos of those that started.

        Raises:
            ValueError: a seed, the mask or the name of an option is wrong; nothing has changed.
        """
        mask = self._check_options(options)
        self._rollout.reset(self._every if mask is None else np.flatnonzero(mask), self._seeds(seed))
        self._show()
        k = self._rollout.k
        told = with_masks(self._rollout.task.info(k), mask) if self._tells else {}
        return self._rollout.task.observe(k), told

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, list | tuple | np.ndarray):
            if len(seed) != self.num_envs:
                raise ValueError(
                    f"reset: seed must have one entry per target, {self.num_envs}; got {len(seed)}. "
                    "Give one integer to use seed, seed + 1, ..."
                )
            return list(seed)
        first = check_seed(seed)
        return [first + row for row in range(self.num_envs)]

    def _check_options(self, options: dict[str, Any] | None) -> NDArray[np.bool_] | None:
        if not options:
            return None
        if set(options) != {"reset_mask"}:
            raise ValueError(f"reset: options must be reset_mask alone; got {sorted(options)}. Remove the others.")
        mask = options["reset_mask"]
        fits = isinstance(mask, np.ndarray) and mask.shape == (self.num_envs,) and mask.dtype == np.bool_
        if not fits or not mask.any():
            raise ValueError(
                f"reset: reset_mask must be a NumPy array ({self.num_envs},) of bool with at least one True; "
                f"got {mask!r}. Use for example terminated | truncated."
            )
        if not self._rollout.begun_with(mask):
            raise ResetNeeded("reset: every target must have begun once; some have not. Call reset without a mask.")
        return np.array(mask)

    def step(self, actions: Any) -> Stepped:
        """One decision of every target.

        Args:
            actions: one per target, (B, ...), of the batched action space.

        Returns:
            Observations, rewards, terminated, truncated, infos; fresh arrays.

        Raises:
            ValueError: an action is impossible; nothing has changed.
            ResetNeeded: before reset, or (autoreset disabled) while a target's episode is over.
        """
        rollout, mode = self._rollout, self.autoreset_mode
        waiting = rollout.over
        if mode is AutoresetMode.DISABLED and waiting.any():
            rollout.need_begun("step")
            rows = np.flatnonzero(waiting)
            shown = ", ".join(map(str, rows[:10])) + (", ..." if len(rows) > 10 else "")
            raise ResetNeeded(
                f"step: every episode must be under way; over: target {shown}. Call reset with a reset_mask first."
            )
        reward, terminated, truncated = rollout.step(actions)
        infos: Infos = {}
        if mode is AutoresetMode.NEXT_STEP:
            if waiting.any():
                rollout.begin(np.flatnonzero(waiting))
        elif mode is AutoresetMode.SAME_STEP and rollout.over.any():
            infos = self._finish(rollout.over)
        if self._tells:
            infos.update(with_masks(rollout.task.info(rollout.k)))
        self._show()
        return rollout.task.observe(rollout.k), reward, terminated, truncated, infos

    def _finish(self, over: NDArray[np.bool_]) -> Infos:
        """Last observations and infos of the targets marked, which start again at once."""
        task, k, rows = self._rollout.task, self._rollout.k, np.flatnonzero(over)
        last = np.full(self.num_envs, None, dtype=object)
        for row, observation in zip(rows.tolist(), task.observe(k)[rows], strict=True):
            last[row] = observation
        infos: Infos = {"final_obs": last, "_final_obs": over.copy()}
        if self._tells:
            infos |= {"final_info": with_masks(task.info(k), over), "_final_info": over.copy()}
        self._rollout.begin(rows)
        return infos

    def _show(self) -> None:
        if self.render_mode == "human":
            self._frames.show(self._rollout, 0)

    def render(self) -> tuple[Any, ...] | None:
        """One frame per target for "rgb_array"; None for "human"."""
        if self.render_mode != "rgb_array":
            self._frames.render(self, self._rollout, 0)
            return None
        return tuple(self._frames.render(self, self._rollout, row) for row in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if any."""
        self._frames.close()


def with_masks(info: dict[str, NDArray[Any]], mask: NDArray[np.bool_] | None = None) -> Infos:
    """Gymnasium's layout: every array beside ``_name``, who has it; zeros for those who have not."""
    infos: Infos = {}
    if mask is None:
        masks = np.ones((len(info), len(next(iter(info.values()), ()))), dtype=np.bool_)
        for (name, value), row in zip(info.items(), masks, strict=True):
            infos[name], infos[f"_{name}"] = value, row
        return infos
    for name, value in info.items():
        value[~mask] = 0
        infos[name], infos[f"_{name}"] = value, mask.copy()
    return infos


def as_autoreset_mode(mode: str | AutoresetMode) -> AutoresetMode:
    """The mode itself, by its value ("NextStep") or its name ("NEXT_STEP").

    Raises:
        ValueError: no such mode.
    """
    for known in AutoresetMode:
        if mode is known or mode in (known.value, known.name):
            return known
    names = ", ".join(known.value for known in AutoresetMode)
    raise ValueError(f"make_vec: autoreset_mode must be one of {names}; got {mode!r}. NextStep is Gymnasium's default.")
