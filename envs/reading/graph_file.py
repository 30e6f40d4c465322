"""A communication network from a JSON file: nodes, where the sensors stand, links, optionally weights.

```json
{
  "nodes": ["mast", "buoy", "relay"],
  "sensors": {"radar": "mast", "lidar": "buoy"},
  "links": [["mast", "buoy"], ["buoy", "relay"]],
  "weights": [[0.7, 0.3, 0.0], [0.3, 0.4, 0.3], [0.0, 0.3, 0.7]],
  "rounds": 10,
  "rule": "safe"
}
```

`nodes` are names, or their number (then they are called 0, 1, ...). `sensors` says at which node each sensor of the
scans stands; a node without one relays. `links` work both ways. Optional: `weights`, row = the node that averages, in
the order of the nodes, zero where there is no link (default: Metropolis weights); `rounds` of exchange per scan;
`rule` of the novelty.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.multitarget.consensus import RULES, Consensus
from jink.estimators.multitarget.weights import check_weights, metropolis_weights

__all__ = ["NetworkPlan", "read_graph"]

REQUIRED, OPTIONAL = ("nodes", "sensors", "links"), ("weights", "rounds", "rule")
MOST_NODES, MOST_ROUNDS = 1000, 10_000


class NetworkPlan(NamedTuple):
    """Who talks to whom, and who has which sensor."""

    nodes: tuple[str, ...]
    sensors: dict[str, int]  # node of each sensor, by name
    weights: NDArray[np.float64]  # (N, N), row = the node that averages
    rounds: int
    rule: str

    def consensus(self) -> Consensus:
        """How the nodes talk, without faults."""
        return Consensus(self.weights, self.rounds, self.rule)


def read_graph(path: str | Path) -> NetworkPlan:
    """Read a network; see the module for the format.

    Args:
        path: JSON file.

    Returns:
        the network.

    Raises:
        FileNotFoundError: no such file.
        ValueError: no JSON, an unknown or missing entry, a node that does not exist, or weights and links with which
            averaging does not bring all nodes to one value.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"read_graph: path must name an existing file; got {path}. Check the spelling.")
    try:
        # JSON itself knows no NaN.
        found = json.loads(path.read_bytes(), parse_constant=lambda word: word)
    except (ValueError, RecursionError) as error:
        raise _refusal(path, "be JSON text", str(error)[:100], "See docs/multi_target.md for an example") from error
    if not isinstance(found, dict):
        raise _refusal(path, "hold one object", type(found).__name__, f"Give {', '.join(REQUIRED)}")
    unknown = sorted(set(found) - {*REQUIRED, *OPTIONAL})
    missing = [name for name in REQUIRED if name not in found]
    if unknown or missing:
        got = f"unknown {', '.join(unknown)}" if unknown else f"no {', '.join(missing)}"
        raise _refusal(
            path, f"have {', '.join(REQUIRED)} and may have {', '.join(OPTIONAL)}", got, "Correct the entries"
        )
    nodes = _nodes(path, found["nodes"])
    index = {name: number for number, name in enumerate(nodes)}
    sensors = _sensors(path, found["sensors"], index)
    weights = _weights(path, found.get("weights"), _links(path, found["links"], index), nodes)
    rounds, rule = found.get("rounds", 10), found.get("rule", "safe")
    rule = "1" if _whole(rule, 1, 1) else rule
    if not _whole(rounds, 0, MOST_ROUNDS):
        raise _refusal(path, f"have whole rounds from 0 to {MOST_ROUNDS}", rounds, "Use for example 10")
    if rule not in list(RULES):
        raise _refusal(path, f"have one of the rules {', '.join(RULES)}", rule, "Choose one")
    return NetworkPlan(nodes, sensors, weights, rounds, rule)


def _refusal(path: Path, rule: str, got: object, remedy: str) -> ValueError:
    text = " ".join(str(got).split())[:200]
    return ValueError(f"read_graph: {path.name} must {rule}; got {text}. {remedy}.")


def _whole(value: Any, low: int, high: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _nodes(path: Path, value: Any) -> tuple[str, ...]:
    if _whole(value, 1, MOST_NODES):
        return tuple(str(number) for number in range(value))
    good = isinstance(value, list) and 1 <= len(value) <= MOST_NODES and all(isinstance(name, str) for name in value)
    if not good or len(set(value)) < len(value):
        raise _refusal(path, f"name 1 to {MOST_NODES} nodes, each once, or give their number", value, "Use a list")
    return tuple(value)


def _node(path: Path, value: Any, index: dict[str, int]) -> int:
    name = str(value) if _whole(value, 0, MOST_NODES) else value
    if not isinstance(name, str) or name not in index:
        raise _refusal(path, "use the nodes it names", value, f"Nodes: {', '.join(list(index)[:20])}")
    return index[name]


def _sensors(path: Path, value: Any, index: dict[str, int]) -> dict[str, int]:
    if not isinstance(value, dict) or not value:
        raise _refusal(path, "say in sensors at which node each sensor stands", value, 'Write {"radar": "mast"}')
    return {name: _node(path, node, index) for name, node in value.items()}


def _links(path: Path, value: Any, index: dict[str, int]) -> NDArray[np.bool_]:
    linked = np.zeros((len(index), len(index)), dtype=bool)
    pairs = value if isinstance(value, list) else [None]
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2:
            raise _refusal(path, "list links as pairs of nodes", pair, 'Write [["mast", "buoy"]]')
        first, second = (_node(path, end, index) for end in pair)
        if first == second:
            raise _refusal(path, "link different nodes", pair, "Leave it out; a node keeps its own value anyway")
        linked[first, second] = linked[second, first] = True
    return linked


def _weights(path: Path, value: Any, linked: NDArray[np.bool_], nodes: tuple[str, ...]) -> NDArray[np.float64]:
    apart = _unreached(linked)
    if apart.size:
        raise ValueError(
            f"read_graph: {path.name} must link all nodes, over others if need be; got {apart.size} that the first "
            f"cannot reach, such as {nodes[apart[0]]}. Add a link."
        )
    if value is None:
        weights: Any = metropolis_weights(linked)
    else:
        try:
            weights = np.array(value, dtype=np.float64)
        except (ValueError, TypeError) as error:
            raise _refusal(path, "have weights as rows of numbers", value, "Give one row per node") from error
    try:
        return check_weights(weights, linked)
    except ValueError as error:
        rule = str(error).partition(": ")[2].partition(" must ")[2]
        rule = f"are {rule.removeprefix('be ')}" if rule.startswith("be ") else rule
        raise ValueError(f"read_graph: {path.name} must have weights and links that {rule}") from error


def _unreached(linked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Nodes that the first cannot reach."""
    reached = np.arange(len(linked)) == 0
    for _ in range(len(linked)):
        reached = reached | linked[reached].any(axis=0)
    return np.flatnonzero(~reached)
