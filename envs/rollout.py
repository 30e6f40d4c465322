"""Episodes of many targets under one task: seeds, clocks, who is over, who starts. The environments are skins of it."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from numpy.typing import NDArray

from jink.envs.ahead import Ahead
from jink.envs.episodes import Source
from jink.envs.halves import in_background
from jink.envs.streams import Streams, make_streams
from jink.envs.task import EndsEarly, Rows, Task

__all__ = ["Rollout", "Step", "TaskFactory", "check_seed"]

TaskFactory = Callable[[Source, int], Task]
"""``factory(source, count)``: a task of that many targets."""
Mask = NDArray[np.bool_]
_LIVE = np.ones(1, dtype=np.bool_)
_CHUNK = 512
"""Episodes simulated at once: what they need beyond what the task keeps is bounded."""


class Step(NamedTuple):
    """What one step brought, per target; fresh arrays."""

    reward: NDArray[np.float64]  # (B,)
    terminated: Mask  # (B,) the track is lost
    truncated: Mask  # (B,) time is up; never together with terminated


class Rollout:
    """B targets under one task, each with its own generator and clock.

    Row b observes sample ``k[b]``. An episode of T samples has T - 1 decisions: `reset` observes sample 0, a decision
    at sample k leads to sample k + 1, the decision at sample T - 2 is the last and the episode is truncated.

    Args:
        make_task: builds the task of ``count`` targets.
        source: where episodes come from.
        count: number of targets B.
        stagger: end each row's first episode at a step of its own, uniform over 1 to T - 1 and drawn from the row's
            generator, so that rows trained together are not all at the same place of an episode.

    Raises:
        ValueError: ``count`` is not a positive integer, or the source has fewer than two samples.
    """

    def __init__(self, make_task: TaskFactory, source: Source, count: int, *, stagger: bool = False) -> None:
        if not isinstance(count, int | np.integer) or isinstance(count, bool) or count < 1:
            raise ValueError(f"make_vec: num_envs must be an integer >= 1; got {count!r}. Give the number of targets.")
        if source.steps < 2:
            raise ValueError(f"make: source must have >= 2 samples per episode; got {source.steps}. Use longer tracks.")
        self.source = source
        self.count = int(count)
        self.stagger = bool(stagger)
        self.task = make_task(source, self.count)
        self.generators: list[np.random.Generator | None] = [None] * self.count
        self.seeds: list[int] = [-1] * self.count
        self._streams: list[Streams | None] = [None] * self.count
        self._ahead = Ahead(self.count, source.steps, source.simulate)
        self._first = np.ones(self.count, dtype=np.bool_)
        self.k: Rows = np.zeros(self.count, dtype=np.int64)
        self._last: Rows = np.zeros(self.count, dtype=np.int64)
        self.over = np.ones(self.count, dtype=np.bool_)
        """Rows whose episode has ended, or never begun."""
        self._all_begun = False
        self._begun = np.zeros(self.count, dtype=np.bool_)

    def generator(self, row: int) -> np.random.Generator:
        """The generator of one row, made from fresh entropy where no seed was given."""
        found = self.generators[row]
        return self._seed(row, *seeding.np_random(None)) if found is None else found

    def set_generator(self, row: int, generator: np.random.Generator) -> None:
        """Episodes of this row come from ``generator`` from its next start on."""
        self._seed(row, generator, -1)

    def _seed(self, row: int, generator: np.random.Generator, seed: int) -> np.random.Generator:
        self.generators[row], self.seeds[row] = generator, seed
        self._streams[row] = None
        self._ahead.forget(row)
        self._first[row] = True
        return generator

    def reset(self, rows: Rows, seeds: Sequence[int | None]) -> None:
        """Start new episodes.

        Args:
            rows: which rows; (k,).
            seeds: one per row of the batch (B,); None continues the row's generator.

        Raises:
            ValueError: a seed is not an integer >= 0; nothing has changed.
        """
        made = [seeding.np_random(check_seed(seed)) for seed in seeds if seed is not None]
        given = [row for row, seed in enumerate(seeds) if seed is not None]
        chosen = set(rows.tolist())
        for row, (generator, seed) in zip(given, made, strict=True):
            if row in chosen:
                self._seed(row, generator, seed)
        self.begin(rows)

    def begin(self, rows: Rows) -> None:
        """Rows ``rows`` start their next episode, each drawn as one block from the row's own streams."""
        steps = self.source.steps
        self._ahead.fill(rows, np.where(self.over, 0, self._last - self.k), self._streams_of)
        ready = self._ahead.ready(rows)
        if ready.any():
            self.task.begin(rows[ready], self._ahead.take(rows[ready]))
        late = rows[~ready]
        parts = [late[begin : begin + _CHUNK] for begin in range(0, len(late), _CHUNK)]
        for one, other in zip_longest(parts[0::2], parts[1::2]):
            later = None if other is None else in_background(self.source.simulate, self._streams_of(other))
            self.task.begin(one, self.source.simulate(self._streams_of(one)))
            if later is not None:
                self.task.begin(other, later.result())
        self.k[rows] = 0
        self._last[rows] = steps - 1
        if self.stagger:
            early = rows[self._first[rows]]
            for row in early.tolist():
                self._last[row] = self.generator(row).integers(1, steps)
            if isinstance(self.task, EndsEarly):
                self.task.end_early(early, self._last[early])
        self._first[rows] = False
        self.over[rows] = False
        if not self._all_begun:
            self._begun[rows] = True
            self._all_begun = bool(self._begun.all())

    def _streams_of(self, rows: Rows) -> list[Streams]:
        found = []
        for row in rows.tolist():
            streams = self._streams[row]
            if streams is None:
                streams = self._streams[row] = make_streams(self.generator(row))
            found.append(streams)
        return found

    def begun_with(self, mask: Mask) -> bool:
        """Whether every row has begun once the rows marked do."""
        return self._all_begun or bool((self._begun | mask).all())

    def need_begun(self, caller: str) -> None:
        """Refuse what needs an episode before there is one.

        Raises:
            ResetNeeded: some row has never been reset.
        """
        if not self._all_begun:
            raise ResetNeeded(f"{caller}: every episode must have begun; none has been started. Call reset first.")

    def step(self, actions: Any) -> Step:
        """Rows that are not over take their decision; the others keep still (reward 0).

        Args:
            actions: (B, ...); those of rows that are over are not looked at.

        Raises:
            ValueError: an action is impossible; nothing has changed.
            ResetNeeded: some row has never been reset.
        """
        if not self._all_begun:
            self.need_begun("step")
        over = self.over
        waiting = bool(over.any())
        checked = self._check(actions, over) if waiting else self.task.check_actions(actions, "step")
        live = ~over
        reward, lost = self.task.step(checked, self.k, live)
        self.k += live
        truncated = (self.k == self._last) & live & ~lost
        self.over = lost | truncated | over
        return Step(np.array(reward), np.array(lost), truncated)

    def step_alone(self, actions: Any) -> tuple[float, bool, bool]:
        """`step` for a batch of one that is not over: the same numbers without the arithmetic of masks.

        Returns:
            Reward, terminated, truncated.

        Raises:
            ValueError: the action is impossible; nothing has changed.
        """
        reward, lost = self.task.step(self.task.check_actions(actions, "step"), self.k, _LIVE)
        terminated = lost.item(0)
        self.k += 1
        truncated = not terminated and self.k.item(0) == self._last.item(0)
        self.over[0] = terminated or truncated
        return reward.item(0), terminated, truncated

    def _check(self, actions: Any, over: Mask) -> NDArray[Any]:
        """A decision nobody takes may be anything: a policy that saw a lost track may well answer NaN."""
        try:
            return self.task.check_actions(actions, "step")
        except ValueError:
            neutral = np.array(actions)
            if neutral.shape[:1] != (self.count,) or neutral.dtype.kind not in "fiu":
                raise
            neutral[over] = 0
            return self.task.check_actions(neutral, "step")


def check_seed(seed: Any) -> int:
    """A seed as a Python integer.

    Raises:
        ValueError: not an integer, or negative.
    """
    try:
        number = -1 if isinstance(seed, bool) else operator.index(seed)
    except TypeError:
        number = -1
    if number < 0:
        raise ValueError(f"reset: seed must be an integer >= 0; got {seed!r}. Leave it out to continue.")
    return number
