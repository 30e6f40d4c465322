"""Communication networks of sensor nodes: who hears whom, which nodes sense, and weights for averaging.

Nodes are numbered from 0. Links are undirected. `Network` is a value; `ring`, `line`, `complete`, `geometric` and
`consensus_network` make some.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import networkx as nx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.multitarget import weights
from jink.estimators.multitarget.weights import second_eigenvalue

__all__ = [
    "CONSENSUS_ROUNDS",
    "CONSENSUS_SENSING",
    "Network",
    "check_weights",
    "complete",
    "consensus_network",
    "geometric",
    "line",
    "metropolis_weights",
    "ring",
    "second_eigenvalue",
]

Array = NDArray[np.float64]

CONSENSUS_SENSING = (1, 8, 10, 15, 19, 26, 27, 35, 37, 41)
"""Sensing nodes of the 50-node network; the source counts from 1: 2, 9, 11, 16, 20, 27, 28, 36, 38, 42."""
CONSENSUS_ROUNDS = 10
"""Exchanges per scan, L, of the published set-up of the 50-node network."""
TRIES = 1000
"""Draws of places before a geometric network gives up on being connected."""


@dataclass(frozen=True)
class Network:
    """Nodes at fixed places, undirected links, and which nodes sense; the others only relay.

    Args:
        positions: one place per node, m; (N, A), A = 2 or 3.
        links: pairs of different nodes; kept once each, smaller number first, in order.
        sensing: nodes with a sensor, in increasing order; at least one.

    Raises:
        ValueError: places that are not finite, a link or sensing node that does not exist, or a network in parts.
    """

    positions: tuple[tuple[float, ...], ...]
    links: tuple[tuple[int, int], ...]
    sensing: tuple[int, ...]

    def __post_init__(self) -> None:
        places = np.asarray(self.positions, dtype=np.float64)
        if places.ndim != 2 or places.shape[1] not in (2, 3) or not np.isfinite(places).all():
            raise ValueError(
                f"Network: positions must be finite with shape (N, 2) or (N, 3); got shape {places.shape}. "
                "Give one place in metres per node."
            )
        nodes = len(places)
        for name, values in (("links", np.asarray(self.links)), ("sensing", np.asarray(self.sensing))):
            if values.size and (values.dtype.kind not in "iu" or values.min() < 0 or values.max() >= nodes):
                raise ValueError(
                    f"Network: {name} must name nodes 0..{nodes - 1}; got {values.tolist()}. Count nodes from 0."
                )
        links = tuple(sorted({(int(min(pair)), int(max(pair))) for pair in self.links}))
        if any(first == second for first, second in links):
            raise ValueError(
                f"Network: links must join different nodes; got {[pair for pair in links if pair[0] == pair[1]]}. "
                "Leave the node itself out; every node keeps its own value anyway."
            )
        if not self.sensing or len(set(self.sensing)) != len(self.sensing):
            raise ValueError(
                f"Network: sensing must name at least one node, each once; got {self.sensing}. "
                "Say which nodes have a sensor."
            )
        object.__setattr__(self, "positions", tuple(tuple(float(value) for value in place) for place in places))
        object.__setattr__(self, "links", links)
        object.__setattr__(self, "sensing", tuple(sorted(int(node) for node in self.sensing)))
        parts = [sorted(part) for part in nx.connected_components(self.graph())]
        if len(parts) > 1:
            raise ValueError(
                f"Network: links must connect all {nodes} nodes; got {len(parts)} parts, one of them "
                f"{min(parts, key=len)[:10]}. Add links or a longer range."
            )

    def __len__(self) -> int:
        return len(self.positions)

    def graph(self) -> nx.Graph:
        """The network for networkx: nodes carry `pos` and `sensing`."""
        graph = nx.Graph()
        for node, place in enumerate(self.positions):
            graph.add_node(node, pos=place, sensing=node in self.sensing)
        graph.add_edges_from(self.links)
        return graph

    @property
    def adjacency(self) -> NDArray[np.bool_]:
        """Who hears whom, without the node itself; (N, N), symmetric."""
        linked = np.zeros((len(self), len(self)), dtype=bool)
        for first, second in self.links:
            linked[first, second] = linked[second, first] = True
        return linked


def metropolis_weights(network: Network) -> Array:
    """Averaging weights every pair of neighbours can agree on alone; (N, N), row = the node that averages.

    Doubly stochastic, symmetric and primitive; see `jink.estimators.multitarget.weights.metropolis_weights`.
    """
    return weights.metropolis_weights(network.adjacency)


def check_weights(values: ArrayLike, network: Network | None = None) -> Array:
    """Refuse weights with which repeated averaging does not bring all nodes to one value.

    Args:
        values: row = the node that averages; (N, N).
        network: if given, weights are positive on its links and the diagonal only.
    Returns:
        the weights as float64.
    Raises:
        ValueError: as `jink.estimators.multitarget.weights.check_weights`.
    """
    return weights.check_weights(values, None if network is None else network.adjacency)


def line(nodes: int, spacing: float = 1000.0, sensing: Sequence[int] | None = None) -> Network:
    """Nodes along the x axis from the origin, each linked to the next; spacing in m; all sense unless named."""
    _check_count("line", nodes, 1)
    places = [(spacing * node, 0.0) for node in range(nodes)]
    return _network(places, list(nx.path_graph(nodes).edges), sensing)


def ring(nodes: int, radius: float = 1000.0, sensing: Sequence[int] | None = None) -> Network:
    """Nodes around a circle of ``radius`` m about the origin, each linked to the next; all sense unless named."""
    _check_count("ring", nodes, 3)
    return _network(_circle(nodes, radius), list(nx.cycle_graph(nodes).edges), sensing)


def complete(nodes: int, radius: float = 1000.0, sensing: Sequence[int] | None = None) -> Network:
    """Nodes around a circle of ``radius`` m about the origin, all linked; all sense unless named."""
    _check_count("complete", nodes, 1)
    return _network(_circle(nodes, radius), list(nx.complete_graph(nodes).edges), sensing)


def geometric(nodes: int, reach: float, side: float, seed: int, sensing: Sequence[int] | None = None) -> Network:
    """Nodes uniform in a square with a corner at the origin, linked within ``reach``; connected.

    Args:
        nodes: number of nodes.
        reach: longest link, m.
        side: of the square, m.
        seed: of the places; places are drawn again, at most 1000 times, until the network is connected.
        sensing: nodes with a sensor; None: all.
    Returns:
        the first connected network.
    Raises:
        ValueError: a number out of range, or no connected network found.
    """
    _check_count("geometric", nodes, 1)
    for name, value in (("reach", reach), ("side", side)):
        if not 0 < value < np.inf:
            raise ValueError(f"geometric: {name} must be finite and > 0; got {value!r}. Give it in metres.")
    generator = np.random.default_rng(seed)
    for _ in range(TRIES):
        places = side * generator.random((nodes, 2))
        graph = nx.random_geometric_graph(nodes, reach, pos={node: tuple(p) for node, p in enumerate(places)})
        if nx.is_connected(graph):
            return _network(places.tolist(), list(graph.edges), sensing)
    raise ValueError(
        f"geometric: reach must connect {nodes} nodes in a square of {side:g} m; got {reach:g} m, in parts after "
        f"{TRIES} draws. Use a longer reach."
    )


def consensus_network() -> Network:
    """A stand-in for the published 50-node network with 10 sensing nodes: same counts, indices and mixing.

    The published places and links are a data file of others, not repeated here. Ours is a geometric network in a
    square of 5 km, links up to 1.2 km, whose seed is chosen so that its Metropolis weights mix as slowly: second
    eigenvalue 0.98351 against 0.98349.

    Source: Garcia-Fernandez, Battistelli (2025), companion code. Differs: places, links and the square are ours.
    """
    return geometric(50, 1200.0, 5000.0, 65, CONSENSUS_SENSING)


def _network(places: Sequence[Sequence[float]], links: list[tuple[int, int]], sensing: Sequence[int] | None) -> Network:
    nodes = tuple(range(len(places))) if sensing is None else tuple(sensing)
    return Network(tuple(tuple(place) for place in places), tuple(links), nodes)


def _circle(nodes: int, radius: float) -> list[tuple[float, float]]:
    angles = 2 * np.pi * np.arange(nodes) / nodes
    return [(radius * float(np.cos(angle)), radius * float(np.sin(angle))) for angle in angles]


def _check_count(caller: str, nodes: int, least: int) -> None:
    if not isinstance(nodes, int | np.integer) or isinstance(nodes, bool) or nodes < least:
        raise ValueError(f"{caller}: nodes must be an integer >= {least}; got {nodes!r}. Give the number of nodes.")
