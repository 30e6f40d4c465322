"""A network under way as a value: the window of times, the scans of each node in it, and what each node knows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.multitarget.network_bank import ModeStates
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scan

__all__ = ["NetworkState", "NodeScans", "Paths", "frames_of", "node_scans"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Paths(NamedTuple):
    """What N nodes believe of M targets at the T times of the window; n state components."""

    ahead: Array  # predictions; (N, M, T, n)
    ahead_cov: Array  # (N, M, T, n, n)
    filtered: Array  # fused
    filtered_cov: Array
    means: Array  # smoothed
    covs: Array
    cross: Array  # cov(x of the time before, x), of banks; (N, M, T, n, n)

    @classmethod
    def empty(cls, nodes: int, targets: int, n: int) -> Paths:
        """A window without times."""
        path, spread = np.zeros((nodes, targets, 0, n)), np.zeros((nodes, targets, 0, n, n))
        return cls(path, spread, path, spread, path, spread, spread)

    def later(self, mean: Array, cov: Array, cross: Array | None = None) -> Paths:
        """With one more time, predicted to (N, M, n), (N, M, n, n); its covariance with the time before, of banks."""
        new = (mean, cov, mean, cov, mean, cov, np.zeros(cov.shape) if cross is None else cross)
        return Paths(*(np.concatenate([part, one[:, :, None]], axis=2) for part, one in zip(self, new, strict=True)))

    def without_first(self) -> Paths:
        """Without the oldest time."""
        return Paths(*(np.ascontiguousarray(part[:, :, 1:]) for part in self))

    def with_targets(self, more: int) -> Paths:
        """With targets of whom nothing is known yet."""
        return Paths(*(np.concatenate([part, np.zeros((len(part), more, *part.shape[2:]))], axis=1) for part in self))

    def of_targets(self, which: NDArray[np.bool_]) -> Paths:
        """Of some of the targets."""
        return Paths(*(np.ascontiguousarray(part[:, which]) for part in self))

    def copy(self) -> Paths:
        """Arrays of their own."""
        return Paths(*(part.copy() for part in self))


class NetworkState(NamedTuple):
    """N nodes, M targets, T times of the window, n state components."""

    sensors: tuple[ScanSensor, ...]
    time: float  # of the last scans, s
    steps: int
    next_id: int
    ids: Ints  # (M,)
    times: Array  # of the window, s; (T,)
    frames: tuple[tuple[Scan, ...], ...]  # scans of each time, those of dead nodes left out
    begin: Ints  # first time of each target in the window, T: the next; (M,)
    paths: Paths
    last: Array  # what the last time left behind; (N, M, n)
    last_cov: Array
    modes: ModeStates | None = None  # the same by mode, of banks


class NodeScans(NamedTuple):
    """Scans of one node as `local_information` takes them."""

    sensor: Ints
    places: Array
    noise: Array
    detections: Array
    offsets: Ints
    slot: Ints
    gates: Array
    detected: Array
    density: Array
    volume: Array


def node_scans(
    frames: Sequence[Sequence[Scan]],
    sensors: Sequence[ScanSensor],
    node_of: Sequence[int],
    node: int,
    positions: Array,
    gate: float | None,
) -> NodeScans:
    """What a node's sensors reported in some times of the window.

    Args:
        frames: scans of each time.
        sensors: by number.
        node_of: node at which each sensor stands.
        node: whose scans are wanted.
        positions: of the targets as the node believes them, to tell which are in view; (M, times, A) m.
        gate: D^2 where a sensor has none of its own; None: no gate.
    """
    own = [(slot, scan) for slot, frame in enumerate(frames) for scan in frame if node_of[scan.sensor] == node]
    D, A = max(sensor.size for sensor in sensors), sensors[0].model.axes
    K, M = len(own), len(positions)
    counts = [len(scan.detections) for _, scan in own]
    detections, noise = np.zeros((sum(counts), D)), np.tile(np.eye(D), (K, 1, 1))
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    places, detected = np.zeros((K, 2 * A)), np.zeros((K, M))
    for k, (slot, scan) in enumerate(own):
        d = sensors[scan.sensor].size
        detections[offsets[k] : offsets[k + 1], :d] = scan.detections
        noise[k, :d, :d] = scan.noise
        places[k] = scan.sensor_state
        detected[k] = sensors[scan.sensor].detected(positions[:, slot], scan.sensor_state)
    used = [sensors[scan.sensor] for _, scan in own]
    gates = [gate if sensor.gate is None else sensor.gate for sensor in used]
    return NodeScans(
        np.array([scan.sensor for _, scan in own], dtype=np.int64),
        places,
        noise,
        detections,
        offsets,
        np.array([slot for slot, _ in own], dtype=np.int64),
        np.array([np.inf if value is None else value for value in gates], dtype=np.float64),
        detected,
        np.array([sensor.density for sensor in used], dtype=np.float64),
        np.array([sensor.volume for sensor in used], dtype=np.float64),
    )


def frames_of(scans: Sequence[Scan]) -> list[list[Scan]]:
    """Scans grouped by time; they come in time order."""
    frames: list[list[Scan]] = []
    for scan in scans:
        if frames and frames[-1][0].time == scan.time:
            frames[-1].append(scan)
        else:
            frames.append([scan])
    return frames
