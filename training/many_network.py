"""Where a picture of many targets puts the nodes and links of a network, and the sensors at places of their own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.reading.graph_file import NetworkPlan
from jink.estimators.multitarget.scans import Scans

__all__ = ["SensorPlaces", "links_of", "node_ring", "sensor_places"]

Array = NDArray[np.float64]


class SensorPlaces(NamedTuple):
    """Where a sensor was, in order of time."""

    name: str
    path: Array  # m; (K, 2)
    moves: bool


def node_ring(plan: NetworkPlan) -> Array:
    """Nodes on a circle of radius 1, the first on top, clockwise, as no file says where they are; (N, 2)."""
    angle = 0.5 * np.pi - 2.0 * np.pi * np.arange(len(plan.nodes)) / len(plan.nodes)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def links_of(plan: NetworkPlan) -> NDArray[np.int64]:
    """Pairs of nodes that talk, smaller number first; (L, 2)."""
    linked = plan.weights > 0
    return np.argwhere(np.triu(linked | linked.T, 1))


def sensor_places(scans: Scans, plan: NetworkPlan | None) -> Iterator[SensorPlaces]:
    """Sensors that the file gives a place, with the node at which they stand where there is a network."""
    if not (scans.sensor_states[:, :2] != 0).any():
        return
    for s, sensor in enumerate(scans.sensors):
        path = scans.sensor_states[scans.sensor == s, :2]
        if len(path):
            node = "" if plan is None or sensor.name not in plan.sensors else plan.nodes[plan.sensors[sensor.name]]
            name = f"{sensor.name} at {node}" if node else sensor.name
            yield SensorPlaces(name, path, bool((path != path[0]).any()))
