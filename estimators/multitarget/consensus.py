"""Consensus of nodes on what they know: averaging of information with neighbours, rounds, rules, faults, bytes.

Hybrid of consensus on measurements and on information. Every node holds, per target, a *prior pair* ``q = Omega x``,
``Omega = P^-1`` and a *novelty pair* ``dq = sum H' R^-1 z``, ``dOmega = sum H' R^-1 H`` of its own scan. L rounds of
``x_i <- sum_j pi_ij x_j`` mix both; then ``Omega_i + omega_i dOmega_i`` is the posterior. L rounds are linear, so they
are one matrix, the *mixing* (N, N): row i says how much of each node's pair has reached node i.

Source: Battistelli, Chisci, Mugnai, Farina, Graziano (2015). Differs: the rule `safe`, and faults, are ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.checks import check_choice, check_count, check_kind
from jink.estimators.multitarget.faults import Faults
from jink.estimators.multitarget.weights import check_weights

__all__ = ["RULES", "Consensus", "Exchange", "message_bytes", "mixing_matrix", "novelty_weights"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
LEAST_REACH = 1e-6
"""A share of information below which nothing counts as having arrived."""


class Exchange(NamedTuple):
    """What an exchange of L rounds did."""

    mixing: Array  # (N, N) share of each sender's pair in each receiver's, rows sum to 1
    alive: Flags  # (N,) nodes that took part
    messages: int  # sent, lost ones included


def inverse_reach(mixing: Array, holds: Array) -> Array:
    """``omega = 1 / b``, b the share of sensing nodes in what arrived: the average of their information.

    Never counts anything twice; also only ever the weight of one sensor, however many there are. The patent's rule.
    """
    b = mixing @ holds
    return np.where(b > LEAST_REACH, 1.0 / np.maximum(b, LEAST_REACH), 1.0)


def node_count(mixing: Array, holds: Array) -> Array:
    """``omega = N``: the sum, as L grows, of all that is known. Until then near sensors count several times."""
    return np.full(holds.shape, float(len(mixing)))


def one(mixing: Array, holds: Array) -> Array:
    """``omega = 1``: a plain average over nodes, relays included."""
    return np.ones(holds.shape)


def inverse_share(mixing: Array, holds: Array) -> Array:
    """``omega_i = 1 / max_j [mixing]_ij`` over sensing nodes j: the largest weight that counts no sensor twice.

    Tends to N as L grows if the weights are doubly stochastic; a node that is cut off counts its own sensor once.
    """
    share = np.where(holds[None] > 0, mixing[:, :, None], 0.0).max(axis=1)
    return np.where(share > LEAST_REACH, 1.0 / np.maximum(share, LEAST_REACH), 1.0)


RULES: dict[str, Callable[[Array, Array], Array]] = {
    "b": inverse_reach,
    "N": node_count,
    "1": one,
    "safe": inverse_share,
}
"""Weights of the novelty, ``rule(mixing (N, N), holds (N, M)) -> (N, M)``; ``holds``: 1 where a node saw a target."""


def novelty_weights(rule: str, mixing: ArrayLike, holds: ArrayLike) -> Array:
    """Weight omega of the mixed novelty at every node.

    Args:
        rule: a key of `RULES`.
        mixing: (N, N).
        holds: 1 where a node's own scan says something of a target, else 0; (N, M), or (N,) for all targets alike.
    Returns:
        omega, shape of ``holds``.
    Raises:
        ValueError: an unknown rule.
    """
    check_choice("novelty_weights", "rule", rule, RULES)
    seen = np.asarray(holds, dtype=np.float64)
    out = RULES[rule](np.asarray(mixing, dtype=np.float64), seen.reshape(len(seen), -1))
    return out.reshape(seen.shape)


def mixing_matrix(weights: ArrayLike, heard: ArrayLike, lag: ArrayLike | None = None) -> Array:
    """What L rounds of averaging do, as one matrix.

    Model: ``x_i(l+1) = sum_j pi_ij(l) x_j(l - lag_j)``. The weight of a message that did not arrive goes to the node's
    own value, so that every row keeps its sum, and links that fail both ways keep the columns' sums too.

    Args:
        weights: row = the node that averages; (N, N).
        heard: which messages arrive, round, listener, sender; (L, N, N).
        lag: rounds by which a node's messages are late; (N,); None: none.
    Returns:
        (N, N), non-negative, rows sum to 1.
    """
    W, arrives = np.asarray(weights, dtype=np.float64), np.asarray(heard, dtype=bool)
    N, rounds = len(W), len(arrives)
    late = np.zeros(N, dtype=np.int64) if lag is None else np.asarray(lag)
    own = np.eye(N, dtype=bool)
    history = [np.eye(N)]
    for turn in range(rounds):
        sent = turn - late
        there = arrives[np.maximum(sent, 0), :, np.arange(N)].T & (sent >= 0) & ~own
        step = np.where(there, W, 0.0)
        values = history[-1]
        if late.any():
            values = np.stack([history[max(int(sent[j]), 0)][j] for j in range(N)])
        kept = 1.0 - step.sum(axis=1)
        history.append(step @ values + kept[:, None] * history[-1])
    return history[-1]


def message_bytes(states: int, targets: int, rule: str = "b", nodes: int = 0, modes: int = 1) -> int:
    """Length of one message: both pairs of every target in 8-byte reals, symmetric matrices as triangles.

    Args:
        states: n.
        targets: M.
        rule: "b" adds a real per target, "safe" the sender's row of the mixing, a real per node.
        nodes: N.
        modes: J: a bank sends a prior pair per mode, one novelty pair, and, if J > 1, the mode probabilities.
    """
    pair = states + states * (states + 1) // 2
    target = (modes + 1) * pair + (rule == "b") + (modes if modes > 1 else 0)
    return 8 * (targets * target + (nodes if rule == "safe" else 0))


@dataclass(frozen=True, eq=False)
class Consensus:
    """How nodes talk: weights, rounds, rule, and what goes wrong.

    Args:
        weights: row-stochastic and primitive, row = the node that averages; (N, N); a positive weight is a link.
            `weights.metropolis_weights` makes good ones of a network.
        rounds: L, >= 0; 0: nodes on their own.
        rule: weight of the novelty, a key of `RULES`: "safe" the largest that counts nothing twice, "b" the average
            over sensing nodes (the patent's), "N" their sum once L is large, "1" the average over all nodes.
        faults: of nodes and links.

    Raises:
        ValueError: weights that do not lead to one value, an unknown rule, a number out of range.
    """

    weights: Array
    rounds: int = 10
    rule: str = "safe"
    faults: Faults = field(default_factory=Faults)
    _whole: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "weights", check_weights(self.weights))
        check_count("Consensus", "rounds", self.rounds, 0, remedy="Use for example 10.")
        check_choice("Consensus", "rule", self.rule, RULES)
        check_kind("Consensus", "faults", self.faults, Faults, "Faults", "Use Faults() for none.")
        self.faults.check_nodes(len(self.weights))
        put(self, "_whole", np.linalg.matrix_power(self.weights, int(self.rounds)))

    @property
    def nodes(self) -> int:
        """Number of nodes N."""
        return len(self.weights)

    @property
    def adjacency(self) -> Flags:
        """Who listens to whom; (N, N), without the node itself."""
        return np.asarray((self.weights > 0) & ~np.eye(self.nodes, dtype=bool))

    def exchange(self, time: float, number: int) -> Exchange:
        """L rounds at a time, s; ``number`` counts exchanges, each with its own chances of failure."""
        alive = self.faults.alive(time, self.nodes)
        sent = int(self.rounds) * int((self.adjacency & alive).sum())
        if self.faults.none:
            return Exchange(self._whole, alive, sent)
        heard = self.faults.heard(time, number, int(self.rounds), self.adjacency)
        return Exchange(mixing_matrix(self.weights, heard, self.faults.lag(self.nodes)), alive, sent)
