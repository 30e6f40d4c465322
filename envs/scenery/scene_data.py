"""What a simulated scene gives: scans in time order with truth beside them, as arrays and in the track format."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.estimators.tracks_padding import pad

if TYPE_CHECKING:
    from jink.envs.scenes import Scene

__all__ = ["CLUTTER", "PADDING", "SceneData", "SceneTruth"]

Array = NDArray[np.float64]
CLUTTER, PADDING = -1, -2
"""Origins that are no target."""
AXES = "xyz"


class SceneTruth(NamedTuple):
    """True targets at the scans: N targets, S scans, A axes; NaN and intent -1 where a target is not there."""

    position: Array  # (N, S, A) m
    velocity: Array  # (N, S, A) m/s
    alive: NDArray[np.bool_]  # (N, S)
    intent: NDArray[np.int8]  # (N, S), index into the intents of the target's motion
    switch_times: tuple[Array, ...]  # per target, s


@dataclass(frozen=True, eq=False)
class SceneData:
    """One run of a scene: S scans, at most `Mmax` measurements each, D components, N targets, A axes; SI.

    Args:
        scene: what was simulated; sensors and their clutter densities are there.
        times: of the scans, never decreasing, s; (S,).
        sensor: which sensor made each scan; (S,).
        measurements: NaN from `count` on; (S, Mmax, D).
        count: measurements of each scan; (S,).
        noise: measurement noise covariance R of each scan; (S, D, D).
        origin: target of each measurement, -1 = clutter, -2 = padding; (S, Mmax).
        truth: the targets at the scans.
    """

    scene: Scene
    times: Array
    sensor: NDArray[np.int64]
    measurements: Array
    count: NDArray[np.int64]
    noise: Array
    origin: NDArray[np.int64]
    truth: SceneTruth

    @classmethod
    def gather(
        cls,
        scene: Scene,
        times: Array,
        sensor: NDArray[np.int64],
        truth: SceneTruth,
        scan: NDArray[np.int64],
        values: Array,
        origin: NDArray[np.int64],
    ) -> SceneData:
        """Sort measurements (K, D) of given scans (K,) and origins (K,) into padded scans."""
        order = np.lexsort((values[:, 0], scan))
        scan = scan[order]
        count = np.bincount(scan, minlength=len(times))
        column = np.arange(len(scan)) - (np.cumsum(count) - count)[scan]
        widest = int(count.max(initial=0))
        measurements = np.full((len(times), widest, scene.axes), np.nan)
        measurements[scan, column] = values[order]
        labels = np.full((len(times), widest), PADDING)
        labels[scan, column] = origin[order]
        noise = np.stack([one.model.noise for one in scene.sensors])[sensor]
        return cls(scene, times, sensor, measurements, count, noise, labels, truth)

    def __len__(self) -> int:
        return len(self.times)

    def scan(self, k: int) -> Array:
        """Measurements of one scan; (count, D)."""
        return self.measurements[k, : self.count[k]]

    @property
    def places(self) -> Array:
        """Where the sensor of each scan stands, m; (S, A)."""
        return np.array([sensor.place for sensor in self.scene.sensors], dtype=np.float64)[self.sensor]

    def to_frame(self, kind: str | None = None) -> pd.DataFrame:
        """All measurements in the track format; an empty scan is a row without values.

        Args:
            kind: of the sensors whose scans are wanted; None: the only kind there is.

        Returns:
            columns t, sensor, the components with their sigmas, the sensor's place, and per measurement its `origin`
            (-1 = clutter) and the truth and velocity of that target. Readers take the columns they know.

        Raises:
            ValueError: the scene has sensors of several kinds and none is named, or no sensor of this kind.
        """
        kind, scans = self._scans_of("to_frame", kind)
        rows = np.repeat(scans, np.maximum(self.count[scans], 1))
        first = np.searchsorted(rows, rows, side="left")
        column = np.arange(len(rows)) - first
        empty = self.count[rows] == 0
        width = self.measurements.shape[1]
        values = np.full((len(rows), self.scene.axes), np.nan)
        origin = np.full(len(rows), PADDING)
        if width:
            values[~empty] = self.measurements[rows[~empty], column[~empty]]
            origin[~empty] = self.origin[rows[~empty], column[~empty]]
        model = next(sensor for sensor in self.scene.sensors if sensor.kind == kind).model
        sigmas = np.sqrt(np.diagonal(self.noise, axis1=1, axis2=2))[rows]
        frame: dict[str, object] = {"t": self.times[rows], "sensor": [f"s{index}" for index in self.sensor[rows]]}
        frame |= {label: values[:, d] for d, label in enumerate(model.labels)}
        frame |= {f"sigma_{label}": np.where(empty, np.nan, sigmas[:, d]) for d, label in enumerate(model.labels)}
        if kind != "position":
            frame |= {f"sensor_{AXES[a]}": self.places[rows, a] for a in range(self.scene.axes)}
        for prefix, source in (("true_", self.truth.position), ("true_v", self.truth.velocity)):
            there = np.where((origin >= 0)[:, None], source[origin, rows], np.nan)
            frame |= {f"{prefix}{AXES[a]}": there[:, a] for a in range(self.scene.axes)}
        labels = [self._intent(int(n), int(k)) for n, k in zip(origin, rows, strict=True)]
        frame |= {"intent": labels, "origin": pd.array(origin, dtype="Int64")}
        out = pd.DataFrame(frame)
        out.loc[empty, "origin"] = pd.NA
        return out

    def _scans_of(self, caller: str, kind: str | None) -> tuple[str, NDArray[np.int64]]:
        kinds = list(dict.fromkeys(sensor.kind for sensor in self.scene.sensors))
        if (kind is None and len(kinds) > 1) or (kind is not None and kind not in kinds):
            raise ValueError(
                f"SceneData.{caller}: kind must be one of {', '.join(kinds)}, as tracks hold what one kind of sensor "
                f"measures; got {kind!r}. Ask for one kind at a time."
            )
        kind = kind or kinds[0]
        chosen = np.array([sensor.kind == kind for sensor in self.scene.sensors])[self.sensor]
        return kind, np.flatnonzero(chosen)

    def _intent(self, target: int, scan: int) -> str:
        if target < 0:
            return ""
        return self.scene.targets[target].motion.intents[self.truth.intent[target, scan]]

    def truth_frame(self) -> pd.DataFrame:
        """True tracks at the distinct scan times: track, t, x, y[, z], vx, vy[, vz], intent."""
        frames = []
        _, firsts = np.unique(self.times, return_index=True)
        for target in range(len(self.scene.targets)):
            rows = firsts[self.truth.alive[target, firsts]]
            frame: dict[str, object] = {"track": [f"target-{target}"] * len(rows), "t": self.times[rows]}
            frame |= {AXES[a]: self.truth.position[target, rows, a] for a in range(self.scene.axes)}
            frame |= {f"v{AXES[a]}": self.truth.velocity[target, rows, a] for a in range(self.scene.axes)}
            frame["intent"] = [self._intent(target, int(k)) for k in rows]
            frames.append(pd.DataFrame(frame))
        return pd.concat(frames, ignore_index=True)

    def to_tracks(self, kind: str | None = None) -> Tracks:
        """Each target with its own detections, as if association were perfect: what an oracle would be given.

        Args:
            kind: of the sensors whose scans are wanted; None: the only kind there is.

        Returns:
            one track per target, named `target-0`, ..., with a row per scan while it was there; a miss is NaN.

        Raises:
            ValueError: as `to_frame`, or a target that no scan falls upon.
        """
        kind, scans = self._scans_of("to_tracks", kind)
        tracks = []
        for target in range(len(self.scene.targets)):
            rows = scans[self.truth.alive[target, scans]]
            if not rows.size:
                raise ValueError(
                    f"SceneData.to_tracks: every target must live through a scan; got target {target} in none. "
                    "Let it live longer."
                )
            own = np.full((len(rows), self.scene.axes), np.nan)
            scan, column = np.nonzero(self.origin[rows] == target)
            own[scan] = self.measurements[rows[scan], column]
            tracks.append((rows, own))
        still = np.zeros((len(self), self.scene.axes))
        found = Tracks.from_arrays(
            [own for _, own in tracks],
            [self.times[rows] for rows, _ in tracks],
            sensor=kind,
            axes=self.scene.axes,
            ids=[f"target-{target}" for target in range(len(tracks))],
            sensor_states=[np.hstack([self.places, still])[rows] for rows, _ in tracks],
            truth=[self.truth.position[n, rows] for n, (rows, _) in enumerate(tracks)],
            truth_velocity=[self.truth.velocity[n, rows] for n, (rows, _) in enumerate(tracks)],
            intents=[np.array([self._intent(n, int(k)) for k in rows]) for n, (rows, _) in enumerate(tracks)],
            source=self.scene.id,
        )
        noise = pad([self.noise[rows] for rows, _ in tracks], found.times.shape[1], found.lengths, None)
        return replace(found, noise=noise)
