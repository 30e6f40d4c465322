"""What a target does, whoever says so: `Truth`, and `Motion`, the source of it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from jink.envs.streams import Draws, Need

__all__ = ["Motion", "Truth"]

Array = NDArray[np.float64]


class Truth(NamedTuple):
    """Trajectories sampled at given times: B episodes, T samples, A axes; SI.

    `switch_times` holds the times at which the intent changed, in order, padded with NaN: an event between two
    samples is not lost. `intent[b, k]` is the index, in `Motion.intents`, of the intent at sample k.
    """

    position: Array  # (B, T, A) m
    velocity: Array  # (B, T, A) m/s
    acceleration: Array  # (B, T, A) m/s^2
    intent: NDArray[np.int8]  # (B, T)
    switch_times: Array  # (B, S) s, NaN = padding


class Motion(Protocol):
    """A frozen, validated dataclass that turns draws into trajectories."""

    @property
    def axes(self) -> int:
        """Space dimensions, 2 or 3."""
        ...

    @property
    def intents(self) -> tuple[str, ...]:
        """Names that `Truth.intent` points to."""
        ...

    def need(self, steps: int, duration: float) -> Need:
        """Draws of one episode of ``steps`` samples lasting at most ``duration`` seconds."""
        ...

    def simulate(self, times: Array, draws: Draws) -> Truth:
        """Trajectories at ``times`` (B, T), seconds from the start, non-decreasing; row b uses row b of the draws.

        A pure function: the same row of times and draws gives the same bits whatever the other rows hold.
        """
        ...
