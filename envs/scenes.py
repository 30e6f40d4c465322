"""Scenes of several targets and sensors: missed detections, false alarms, births and deaths, a network of sensors.

`simulate_scene(scene, seed)` draws from named streams, one generator per target and sensor of each: ``truth``,
``detection``, ``noise`` and ``clutter``. Changing the clutter moves neither a target nor a detection, changing a sensor
moves no target, with one exception: a `LinearPlant` draws its noise from one scan time to the next.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jink.envs.networks import Network
from jink.envs.scenery.scene_data import SceneData, SceneTruth
from jink.envs.scenery.scene_sensors import SceneSensor
from jink.envs.streams import draw
from jink.envs.truth import Motion

__all__ = ["STREAMS", "Scene", "SceneTarget", "simulate_scene"]

Array = NDArray[np.float64]
STREAMS = ("truth", "detection", "noise", "clutter")


@dataclass(frozen=True)
class SceneTarget:
    """One target: how it moves, from where, and when it is there.

    Args:
        motion: trajectory in the target's own time and frame; time 0 is its birth.
        birth: s.
        death: s; the target is seen up to and including this time; inf: to the end.
        place: where the origin of the motion's frame lies in the scene, m; (A,); None: at the scene's origin.
        heading: the motion's frame is turned by this angle, rad counter-clockwise seen from above.

    Raises:
        ValueError: a time, place or angle out of range.
    """

    motion: Motion
    birth: float = 0.0
    death: float = np.inf
    place: tuple[float, ...] | None = None
    heading: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.birth < self.death:
            raise ValueError(
                f"SceneTarget: birth and death must satisfy 0 <= birth < death; got {self.birth!r} and "
                f"{self.death!r}. Give them in seconds."
            )
        place = (0.0,) * self.motion.axes if self.place is None else tuple(float(value) for value in self.place)
        if len(place) != self.motion.axes or not np.isfinite([*place, self.heading]).all():
            raise ValueError(
                f"SceneTarget: place must be {self.motion.axes} finite coordinates and heading finite; got "
                f"{self.place} and {self.heading!r}. Use metres and radians."
            )
        object.__setattr__(self, "place", place)

    def put(self, vectors: Array, shift: bool) -> Array:
        """Vectors (..., A) of the motion's frame in the frame of the scene; positions are shifted too."""
        out = np.array(vectors)
        if self.heading:
            c, s = np.cos(self.heading), np.sin(self.heading)
            out[..., :2] = np.stack(
                [c * vectors[..., 0] - s * vectors[..., 1], s * vectors[..., 0] + c * vectors[..., 1]], axis=-1
            )
        return out + np.asarray(self.place) if shift else out


@dataclass(frozen=True)
class Scene:
    """Targets, sensors and, where the sensors talk to each other, their network.

    Args:
        id: name, ends in a version -vN.
        title: one line for tables.
        source: where the numbers come from, and which are our choice.
        duration: s; scans lie in [0, duration].
        targets: at least one.
        sensors: at least one; sensor k stands at the k-th sensing node of the network.
        network: who talks to whom; None: everybody sends to one centre.

    Raises:
        ValueError: an id without version, targets and sensors of unlike dimension, no scan, or a network that does
            not fit the sensors.
    """

    id: str
    title: str
    source: str
    duration: float
    targets: tuple[SceneTarget, ...]
    sensors: tuple[SceneSensor, ...]
    network: Network | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9-]+-v\d+", self.id):
            raise ValueError(f"Scene: id must be lower-case words and a version; got {self.id!r}. Use name-v0.")
        if not 0 < self.duration < np.inf:
            raise ValueError(f"{self.id}: duration must be finite and > 0; got {self.duration!r}. Give it in seconds.")
        if not self.targets or not self.sensors:
            raise ValueError(
                f"{self.id}: targets and sensors must not be empty; got {len(self.targets)} and {len(self.sensors)}. "
                "Give at least one of each."
            )
        axes = [target.motion.axes for target in self.targets] + [sensor.axes for sensor in self.sensors]
        if len(set(axes)) > 1:
            raise ValueError(
                f"{self.id}: targets and sensors must have the same space dimensions; got {axes}. Use 2 or 3 for all."
            )
        late = [sensor.offset for sensor in self.sensors if sensor.offset > self.duration]
        if late:
            raise ValueError(
                f"{self.id}: sensors must scan within {self.duration:g} s; got offset={late[0]:g}. Start them earlier."
            )
        if self.network is not None:
            nodes = [self.network.positions[node] for node in self.network.sensing]
            if [tuple(sensor.place) for sensor in self.sensors] != nodes:
                raise ValueError(
                    f"{self.id}: sensors must stand at the network's sensing nodes, in their order; got "
                    f"{[sensor.place for sensor in self.sensors][:3]} for {nodes[:3]}. Use the network's places."
                )

    @property
    def axes(self) -> int:
        """Space dimensions A, 2 or 3; also the number of measurement components D."""
        return self.targets[0].motion.axes


def simulate_scene(scene: Scene, seed: int) -> SceneData:
    """Fly the targets and let every sensor scan.

    Detections and false alarms of a scan come in the order of their first component, so their order tells nothing.

    Args:
        scene: what is simulated.
        seed: the experiment's seed, >= 0.
    Returns:
        truth at the scans and the measurements; the same bits for the same scene and seed.
    Raises:
        ValueError: seed out of range.
    """
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or seed < 0:
        raise ValueError(f"simulate_scene: seed must be an integer >= 0; got {seed!r}. Pass for example seed=0.")
    clocks = [sensor.scan_times(scene.duration) for sensor in scene.sensors]
    owner = np.repeat(np.arange(len(clocks)), [len(clock) for clock in clocks])
    order = np.lexsort((owner, np.concatenate(clocks)))
    times, sensor_of = np.concatenate(clocks)[order], owner[order]
    truth = _fly(scene, seed, times)
    found: list[tuple[NDArray[np.int64], Array, NDArray[np.int64]]] = []
    for index, sensor in enumerate(scene.sensors):
        scans = np.flatnonzero(sensor_of == index)
        for target in range(len(scene.targets)):
            found.append(_detect(sensor, truth, seed, index, target, scans))
        found.append(_false_alarms(sensor, seed, index, scans))
    scan, values, origin = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return SceneData.gather(scene, times, sensor_of, truth, scan, values, origin)


def _generator(seed: int, stream: str, *index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(STREAMS.index(stream), *index)))


def _fly(scene: Scene, seed: int, times: Array) -> SceneTruth:
    shape = (len(scene.targets), len(times))
    position, velocity = (np.full((*shape, scene.axes), np.nan) for _ in range(2))
    intent, alive = np.full(shape, -1, dtype=np.int8), np.zeros(shape, dtype=bool)
    switches = []
    for index, target in enumerate(scene.targets):
        rows = np.flatnonzero((times >= target.birth) & (times <= target.death))
        alive[index, rows] = True
        # Scans at one time are one look at the target, so that another sensor on the same clock does not move it.
        own, back = np.unique(times[rows] - target.birth, return_inverse=True)
        if not rows.size:
            switches.append(np.empty(0))
            continue
        need = target.motion.need(own.size, min(target.death, scene.duration) - target.birth)
        flown = target.motion.simulate(own[None], draw([_generator(seed, "truth", index)], need))
        position[index, rows] = target.put(flown.position[0], shift=True)[back]
        velocity[index, rows] = target.put(flown.velocity[0], shift=False)[back]
        intent[index, rows] = flown.intent[0, back]
        # NaN, the padding, is not <= anything.
        switches.append(flown.switch_times[0][flown.switch_times[0] <= own[-1]] + target.birth)
    return SceneTruth(position, velocity, alive, intent, tuple(switches))


def _detect(
    sensor: SceneSensor, truth: SceneTruth, seed: int, index: int, target: int, scans: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Draws are made for every scan, so that births, deaths and P_D move no other detection."""
    lucky = _generator(seed, "detection", index, target).random(scans.size) < sensor.detection
    unit = _generator(seed, "noise", index, target).standard_normal((scans.size, sensor.axes))
    position = truth.position[target, scans]
    seen = truth.alive[target, scans] & lucky & sensor.watches(position)
    return scans[seen], sensor.measure(position[seen], unit[seen]), np.full(int(seen.sum()), target)


def _false_alarms(
    sensor: SceneSensor, seed: int, index: int, scans: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    generator = _generator(seed, "clutter", index)
    counts = generator.poisson(sensor.clutter, scans.size)
    places = sensor.false_alarms(generator.random((int(counts.sum()), sensor.axes)))
    return np.repeat(scans, counts), sensor.measure(places), np.full(len(places), -1)
