"""Next episodes, simulated before they are needed and many at a time.

Row b of `Episodes` depends on the streams of target b alone, so when it is simulated, and beside whom, changes no bit.
A call for four targets costs as much Python as one for sixty, so whoever starts a few episodes asks at the same time
for those of the targets that will end next.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes, join, pick
from jink.envs.streams import Streams
from jink.envs.task import Rows

__all__ = ["Ahead"]

_WINDOW = 64
"""Episodes simulated together."""
_WORTH_IT = 256
"""Targets from which a few ends a step are usual."""
_SOON = 8
"""Targets within this part of an episode of their end are worth asking for: theirs are needed soon, so few wait."""


class Ahead:
    """Episodes that wait for their targets, at most one for each.

    Args:
        count: number of targets B.
        steps: samples of an episode.
        simulate: episodes of streams.
    """

    def __init__(self, count: int, steps: int, simulate: Callable[[Sequence[Streams]], Episodes]) -> None:
        self._soon, self._simulate = steps // _SOON, simulate
        self._batches: dict[int, Episodes] = {}
        self._left: dict[int, int] = {}
        self._batch, self._place = np.full(count, -1), np.zeros(count, dtype=np.int64)
        self._made = 0

    def ready(self, rows: Rows) -> NDArray[np.bool_]:
        """Whether the next episode of each row waits; (k,)."""
        return self._batch[rows] >= 0

    def forget(self, row: int) -> None:
        """The streams of a row have been replaced: what was simulated from the old ones is not its next episode."""
        if self._batch[row] >= 0:
            self._drop(np.array([row]))

    def fill(self, rows: Rows, remaining: Rows, streams_of: Callable[[Rows], list[Streams]]) -> None:
        """Have the episodes of ``rows`` ready, and those of others that will end soon; many rows are left alone.

        Args:
            rows: that start now; (k,).
            remaining: decisions left of every target, (B,); of those that are over anything below one.
            streams_of: the streams of rows.
        """
        wanted = rows[~self.ready(rows)]
        if len(self._batch) < _WORTH_IT or len(wanted) == 0 or len(rows) >= _WINDOW:
            return
        soon = np.flatnonzero((remaining > 0) & (remaining <= self._soon) & (self._batch < 0))
        first = np.argsort(remaining[soon], kind="stable")[: _WINDOW - len(wanted)]
        chosen = np.concatenate([wanted, soon[first]])
        self._batches[self._made] = self._simulate(streams_of(chosen))
        self._left[self._made] = len(chosen)
        self._batch[chosen], self._place[chosen] = self._made, np.arange(len(chosen))
        self._made += 1

    def take(self, rows: Rows) -> Episodes:
        """The episodes that waited for ``rows``, in their order; they wait no longer."""
        numbers = self._batch[rows]
        of_batch = [(number, np.flatnonzero(numbers == number)) for number in np.unique(numbers).tolist()]
        parts = [pick(self._batches[number], self._place[rows[at]]) for number, at in of_batch]
        found = parts[0]
        if len(parts) > 1:
            found = pick(join(parts), np.argsort(np.concatenate([at for _, at in of_batch])))
        self._drop(rows)
        return found

    def _drop(self, rows: Rows) -> None:
        for number in self._batch[rows].tolist():
            self._left[number] -= 1
            if self._left[number] == 0:
                del self._left[number], self._batches[number]
        self._batch[rows] = -1
