"""One target as a Gymnasium environment."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from jink.envs.choosing import choose_source, choose_task
from jink.envs.frames import FPS, RENDER_MODES, Frames
from jink.envs.rollout import Rollout, TaskFactory
from jink.envs.task import ActionError, TellsAlone

__all__ = ["TargetEnv"]

_TRUTH = np.dtype(np.bool_)
_ROW = np.zeros(1, dtype=np.int64)


class TargetEnv(gymnasium.Env[NDArray[Any], Any]):
    """One target under a task; observation, action and reward are the task's.

    Args:
        task: name of a task (see `jink.envs.registration.TASKS`) or a function ``(source, count) -> Task``.
        scenario: name of a scenario or a `Scenario`; None: the task's own.
        suite: name of a suite: every episode draws one of its scenarios.
        tracks: recorded tracks instead of a simulation: a file or `Tracks`.
        stagger: end the first episode after a seed at a random step, for training.
        render_mode: None, "rgb_array" or "human".
        options: options of the task and parameters of the scenario, by name.

    Raises:
        ValueError: an unknown name, contradictory options, or a value out of range.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": list(RENDER_MODES), "render_fps": FPS}  # type: ignore[misc]

    def __init__(
        self,
        task: str | TaskFactory,
        *,
        scenario: Any = None,
        suite: str | None = None,
        tracks: Any = None,
        stagger: bool = False,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        chosen = choose_task(task, options)
        source = choose_source(chosen, scenario=scenario, suite=suite, tracks=tracks)
        self._rollout = Rollout(chosen.make, source, 1, stagger=stagger)
        self._alone = self._rollout.task if isinstance(self._rollout.task, TellsAlone) else None
        self._frames = Frames(render_mode)
        self.render_mode = render_mode
        self.observation_space = self._rollout.task.observation_space
        self.action_space = self._rollout.task.action_space

    @property
    def rollout(self) -> Rollout:
        """The episode under way: its task, source and clock."""
        return self._rollout

    @property
    def np_random(self) -> np.random.Generator:
        """The generator every episode is drawn from."""
        return self._rollout.generator(0)

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self._rollout.set_generator(0, value)

    @property
    def np_random_seed(self) -> int:
        """Seed of the generator; -1 where a generator was set directly."""
        self._rollout.generator(0)
        return self._rollout.seeds[0]

    @property
    def _np_random(self) -> np.random.Generator | None:  # type: ignore[override]
        """Gymnasium's checker and wrappers look here."""
        return self._rollout.generators[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: None continues the generator: a new episode every time.
            options: none are known.

        Returns:
            The first observation and its info.

        Raises:
            ValueError: the seed is not an integer >= 0, or there are options.
        """
        if options:
            raise ValueError(f"reset: options must be empty; got {sorted(options)}. Choose a scenario in make.")
        self._rollout.reset(_ROW, [seed])
        if self.render_mode == "human":
            self._frames.show(self._rollout, 0)
        return self._observe()

    def step(self, action: Any) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """One decision.

        Args:
            action: of the action space.

        Returns:
            Next observation, reward, terminated (the track is lost), truncated (time is up), info.

        Raises:
            ValueError: the action is impossible; the episode is where it was.
            ResetNeeded: before reset, or after the end of an episode.
        """
        rollout = self._rollout
        if rollout.over.item(0):
            rollout.need_begun("step")
            raise ResetNeeded("step: the episode must be under way; it is over. Call reset to start the next one.")
        batch = action[None] if isinstance(action, np.ndarray) else [action]
        try:
            reward, terminated, truncated = rollout.step_alone(batch)
        except ActionError as error:
            raise ValueError(error.alone) from None
        observation, info = self._observe()
        if self.render_mode == "human":
            self._frames.show(rollout, 0)
        return observation, reward, terminated, truncated, info

    def _observe(self) -> tuple[NDArray[Any], dict[str, Any]]:
        task, k = self._rollout.task, self._rollout.k
        info = first_row(task.info(k)) if self._alone is None else self._alone.info_alone(k.item(0))
        return task.observe(k)[0], info

    def render(self) -> Any:
        """The picture of the present moment: (H, W, 3) uint8 for "rgb_array", None for "human".

        Raises:
            ResetNeeded: before reset.
        """
        return self._frames.render(self, self._rollout, 0)

    def close(self) -> None:
        """Close the window, if any; may be called again."""
        self._frames.close()


def first_row(info: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Infos of one target: numbers as NumPy scalars, truth values as bool, vectors as arrays."""
    return {name: value.item(0) if value.dtype is _TRUTH else value[0] for name, value in info.items()}
