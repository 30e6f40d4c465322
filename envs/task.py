"""What differs between the environments: `Task`. Clocks, seeds and autoreset are everybody's (`jink.envs.rollout`)."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes

__all__ = ["ActionError", "EndsEarly", "Outcome", "Picture", "Task", "TellsAlone"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


class Outcome(NamedTuple):
    """What one decision brought, per target."""

    reward: Array  # (B,)
    lost: NDArray[np.bool_]  # (B,) the track is lost: the episode terminates


class Picture(NamedTuple):
    """What a frame shows of one target: everything up to now; K samples, A axes."""

    title: str
    times: Array  # (K,) s
    truth: Array  # (K, A) m
    seen: Array  # (K, A) measured positions, m; NaN where there is none
    estimate: Array  # (K, A) m; NaN where there is none
    covariance: Array  # (A, A) of the last estimate, m^2; NaN where the task has none
    sensor: Array  # (A,) place of the sensor, m
    intents: tuple[str, ...]
    intent: NDArray[np.int8]  # (K,)
    scale: Array  # (K,) factor on the nominal noise covariance
    choices: tuple[str, ...]  # names of the actions; empty where the action is not a choice
    choice: NDArray[np.int64]  # (K,) action taken, -1 = none yet
    score: Array  # (K,) reward


class ActionError(ValueError):
    """An action that cannot be taken, worded for a batch.

    Args:
        sentence: what is wrong, of all targets.
        alone: the same worded for the only target of a single environment.
    """

    def __init__(self, sentence: str, alone: str = "") -> None:
        super().__init__(sentence)
        self.alone = alone or sentence

    @classmethod
    def shaped(
        cls, caller: str, kind: str, found: NDArray[Any] | None, shape: tuple[int, ...], remedy: str
    ) -> ActionError:
        """Actions of another shape or type; ``kind`` in the plural, ``found`` None: rows of different lengths."""
        got = ["rows of different lengths"] * 2
        if found is not None:
            got = [f"{found.dtype} {found.shape}", f"{found.dtype} {found.shape[1:]}"]
        return cls(
            f"{caller}: action must be {kind} of shape {shape}; got {got[0]}. {remedy}",
            f"{caller}: action must be {kind} of shape {shape[1:]}; got {got[1]}. {remedy}",
        )

    @classmethod
    def valued(cls, caller: str, rule: str, found: Any, row: int, remedy: str) -> ActionError:
        """An action ``found`` for target ``row`` that is out of range."""
        start = f"{caller}: action must {rule}; got {found}"
        return cls(f"{start} for target {row}. {remedy}", f"{start}. {remedy}")


@runtime_checkable
class EndsEarly(Protocol):
    """A `Task` whose rewards depend on how many decisions are left."""

    def end_early(self, rows: Rows, ends: Rows) -> None:
        """Called after `Task.begin`: the episodes of ``rows`` (k,) end at sample ``ends`` (k,), not with their last."""
        ...


@runtime_checkable
class TellsAlone(Protocol):
    """A `Task` with a quicker way to tell about a single target."""

    def info_alone(self, k: int) -> dict[str, Any]:
        """What ``info`` says of the only target: Python numbers, fresh arrays."""
        ...


class Task(Protocol):
    """B targets under one task; every array has one row per target. Row b never depends on the other rows.

    A task holds the episodes of its rows (`begin` copies them in) and reads sample ``k[b]`` of row b when told to.
    """

    observation_space: gymnasium.spaces.Box  # of one target
    action_space: gymnasium.Space[Any]  # of one target

    def check_actions(self, actions: Any, caller: str) -> NDArray[Any]:
        """The actions (B, ...) as an array the task can use, unchanged in value; one sentence for a bad one.

        Raises:
            ValueError: wrong shape or type, not finite, out of range; nothing has changed.
        """
        ...

    def begin(self, rows: Rows, episodes: Episodes) -> None:
        """Rows ``rows`` (k,) start new episodes (k of them); the first sample (0) is ready to be observed."""
        ...

    def step(self, actions: NDArray[Any], k: Rows, live: NDArray[np.bool_]) -> Outcome:
        """Rows marked ``live`` take their decision at sample ``k[b]`` and go on to sample ``k[b] + 1``.

        Rows that are not live are left alone: reward 0, not lost.
        """
        ...

    def observe(self, k: Rows) -> NDArray[Any]:
        """Fresh observations (B, O) of sample ``k[b]``, in the dtype of `observation_space`."""
        ...

    def info(self, k: Rows) -> dict[str, NDArray[Any]]:
        """Fresh arrays (B, ...) about sample ``k[b]``: truth, intent, noise scale and what the task knows."""
        ...

    def picture(self, row: int, k: int) -> Picture:
        """What a frame shows of one target up to sample ``k``."""
        ...
