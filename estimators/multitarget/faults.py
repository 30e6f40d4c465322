"""`Faults`: messages that get lost, links that fail, nodes that die and return, nodes that lag; all as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.estimators.checks import check_array, check_count, check_number

__all__ = ["Faults"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
ROWS = {"broken": (4, (0, 1)), "dead": (3, (0,)), "delays": (2, (0, 1)), "lost": (4, (1, 2, 3))}
"""Numbers of a row, and which of them are whole: nodes and rounds."""


@dataclass(frozen=True)
class Faults:
    """What goes wrong in a network, when; the same for the same seed, whatever else is simulated.

    Args:
        message_loss: chance that a message is lost, each direction and round for itself.
        link_failure: chance that a link is down, both ways, during a whole exchange.
        broken: (node, node, begin, end): links that are down, both ways, from ``begin`` to before ``end``, s.
        dead: (node, begin, end): nodes that neither measure, send nor listen from ``begin`` to before ``end``, s.
        delays: (node, rounds): what a node sends arrives so many rounds late, or not at all in this exchange.
        lost: (time, round, to, from): single messages that are lost; rounds count from 0.
        seed: of the chances, >= 0.

    Raises:
        ValueError: a chance outside [0, 1], a span that ends before it begins, a negative delay or seed.
    """

    message_loss: float = 0.0
    link_failure: float = 0.0
    broken: Sequence[tuple[int, int, float, float]] = ()
    dead: Sequence[tuple[int, float, float]] = ()
    delays: Sequence[tuple[int, int]] = ()
    lost: Sequence[tuple[float, int, int, int]] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("message_loss", "link_failure"):
            check_number("Faults", name, getattr(self, name), 0.0, 1.0, least=True, remedy="Give a probability.")
        for name, (width, whole) in ROWS.items():
            object.__setattr__(self, name, _rows(name, getattr(self, name), width, whole))
        check_count("Faults", "seed", self.seed, 0, remedy="Give a seed.")
        if any(not row[-2] < row[-1] for row in (*self.broken, *self.dead)):
            raise ValueError(
                f"Faults: broken and dead must end after they begin; got {self.broken} and {self.dead}. Use np.inf "
                "for good."
            )
        if any(rounds < 0 for _, rounds in self.delays):
            raise ValueError(f"Faults: delays must be >= 0; got {self.delays}. Count rounds.")

    def check_nodes(self, nodes: int) -> None:
        """Refuse faults of nodes that do not exist.

        Raises:
            ValueError: a node outside 0..nodes - 1.
        """
        named = [node for row in self.broken for node in row[:2]] + [row[0] for row in self.dead]
        named += [row[0] for row in self.delays] + [node for row in self.lost for node in row[2:]]
        if any(not 0 <= node < nodes for node in named):
            raise ValueError(f"Faults: nodes must lie in 0..{nodes - 1}; got {sorted(set(named))}. Count from 0.")

    @property
    def none(self) -> bool:
        """Whether nothing ever fails."""
        chances = self.message_loss + self.link_failure
        return chances == 0 and not (self.broken or self.dead or self.lost or any(rounds for _, rounds in self.delays))

    def alive(self, time: float, nodes: int) -> Flags:
        """Nodes that work at a time; (N,)."""
        works = np.ones(nodes, dtype=bool)
        for node, begin, end in self.dead:
            works[node] &= not begin <= time < end
        return works

    def heard(self, time: float, exchange: int, rounds: int, adjacency: Flags) -> Flags:
        """Which messages arrive.

        Args:
            time: of the scan, s.
            exchange: number of the exchange; each has its own chances.
            rounds: L.
            adjacency: who hears whom; (N, N).
        Returns:
            round, node that listens, node that sends; (L, N, N).
        """
        nodes = len(adjacency)
        works = self.alive(time, nodes)
        link = adjacency & works[:, None] & works
        for first, second, begin, end in self.broken:
            if begin <= time < end:
                link[first, second] = link[second, first] = False
        random = np.random.default_rng(np.random.SeedSequence(entropy=self.seed, spawn_key=(exchange,)))
        if self.link_failure:
            up = np.triu(random.random((nodes, nodes)) >= self.link_failure, 1)
            link &= up | up.T
        heard = np.repeat(link[None], rounds, axis=0)
        if self.message_loss:
            heard &= random.random(heard.shape) >= self.message_loss
        for when, turn, to, sender in self.lost:
            if when == time and 0 <= turn < rounds:
                heard[int(turn), int(to), int(sender)] = False
        return heard

    def lag(self, nodes: int) -> NDArray[np.int64]:
        """Rounds by which what each node sends arrives late; (N,)."""
        late = np.zeros(nodes, dtype=np.int64)
        for node, rounds in self.delays:
            late[node] = rounds
        return late


def _rows(name: str, given: Any, width: int, whole: tuple[int, ...]) -> tuple[tuple[Any, ...], ...]:
    """Rows of numbers, nodes and rounds as integers."""
    remedy = "Write ((1, 2),) for one row." if width == 2 else "Write a row in two pairs of parentheses."
    table = check_array("Faults", name, given, remedy)
    if table.size == 0:
        return ()
    if table.ndim != 2 or table.shape[1] != width or np.isnan(table).any():
        raise ValueError(f"Faults: {name} must have {width} numbers per row; got {given!r}. {remedy}")
    counts = table[:, whole]
    if not np.isfinite(counts).all() or (counts != np.floor(counts)).any():
        raise ValueError(f"Faults: {name} must have whole numbers for nodes and rounds; got {given!r}. Count from 0.")
    return tuple(tuple(int(v) if i in whole else float(v) for i, v in enumerate(row)) for row in table)
