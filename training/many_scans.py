"""Rows of a file as scans, and what the file itself says of clutter, detection probability and speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.multitarget.gnn import Gnn
from jink.estimators.multitarget.results import MultiTracks
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scans
from jink.estimators.tracks import Tracks
from jink.training.many_estimators import ManyScales
from jink.training.tuning import sensor_of

__all__ = ["Guesses", "group_rows", "guess", "patience_of", "sensors_of", "with_numbers"]

Array = NDArray[np.float64]
SPEEDS = (3.0, 10.0, 30.0, 100.0, 300.0)
"""Tried, m/s, where nobody gave one."""
FIRST_DETECTION, LEAST_CLUTTER = 0.9, 0.05
MOST_SCANS, SILENT_SCANS = 300, 12
SPEED_TO_ACCELERATION = 20.0
"""A target is taken to need this long, s, to gain or lose its speed."""


class Guesses(NamedTuple):
    """Numbers from the file itself."""

    speed: float  # m/s
    acceleration: float  # m/s^2
    detection: tuple[float, ...]  # P_D of each sensor
    clutter: tuple[float, ...]  # false alarms per scan of each sensor


def sensors_of(tracks: Tracks, sigma: Sequence[float], names: Sequence[str]) -> tuple[ScanSensor, ...]:
    """A sensor per name; each watches the span of what it measured, and half of that may be false.

    Args:
        tracks: the file, as one track.
        sigma: standard deviation of each component.
        names: of the sensors.
    """
    model = sensor_of(tracks, tuple(sigma))
    owner = _names(tracks)
    found = []
    for name in names:
        own = tracks.measurements[0][owner == name]
        own = own[np.isfinite(own).all(axis=1) & (np.abs(own) < 1e30).all(axis=1)]
        scans = max(len(np.unique(tracks.times[0][owner == name])), 1)
        clutter = max(len(own) / scans / 2.0, LEAST_CLUTTER)
        extent = [_extent(own[:, d], model.units[d] == "rad") for d in range(model.size)]
        volume = float(np.prod(np.maximum(extent, 6.0 * np.asarray(sigma))))
        found.append(ScanSensor(model, FIRST_DETECTION, clutter, min(volume, 1e300), name=name))
    return tuple(found)


def _extent(values: Array, angular: bool) -> float:
    """Span of values; of angles the turn without its widest gap."""
    if len(values) < 2:
        return 0.0
    if not angular:
        return float(np.ptp(values))
    around = np.sort(np.mod(values, 2 * np.pi))
    return float(2 * np.pi - np.max(np.diff(around, append=around[0] + 2 * np.pi)))


def _names(tracks: Tracks) -> NDArray[np.str_]:
    ids = tracks.sensor_ids
    return np.full(tracks.times.shape[1], "", dtype=np.str_) if ids is None else np.asarray(ids[0], dtype=np.str_)


def group_rows(tracks: Tracks, sensors: tuple[ScanSensor, ...], use_noise: bool) -> Scans:
    """Rows that share time and sensor are a scan; a row without any value is an empty one.

    Args:
        tracks: the file, as one track in order of time.
        sensors: by name.
        use_noise: whether a scan has the root mean square of its rows' own sigmas.
    """
    names = [sensor.name for sensor in sensors]
    owner = np.array([names.index(name) if name in names else 0 for name in _names(tracks)], dtype=np.int64)
    times, values = tracks.times[0], tracks.measurements[0]
    order = np.lexsort((owner, times))
    key = np.stack([times[order], owner[order]], axis=1)
    starts = np.flatnonzero(np.append(True, (np.diff(key, axis=0) != 0).any(axis=1)))
    groups = np.split(order, starts[1:])
    there = ~np.isnan(values).all(axis=1)
    states, noise = None, None
    if tracks.sensor_states is not None:
        # A row without values may not say where the sensor is.
        states = np.stack([tracks.sensor_states[0][rows[np.argmax(there[rows])]] for rows in groups])
    if use_noise and tracks.noise is not None:
        whole = np.isfinite(values).all(axis=1)
        noise = np.stack(
            [
                tracks.noise[0][rows[whole[rows]]].mean(axis=0) if whole[rows].any() else sensors[owner[rows[0]]].noise
                for rows in groups
            ]
        )
    return Scans.from_arrays(
        times[order][starts], [values[rows[there[rows]]] for rows in groups], sensors, sensor=owner[order][starts],
        sensor_states=states, noise=noise,
    )  # fmt: skip


def patience_of(scans: Scans) -> float:
    """How long a track may be silent: some scans of the slowest sensor; s."""
    gaps = [np.median(np.diff(np.unique(scans.times[scans.sensor == s]))) for s in range(len(scans.sensors))
            if len(np.unique(scans.times[scans.sensor == s])) > 1]  # fmt: skip
    return SILENT_SCANS * float(max(gaps, default=1.0))


def guess(scans: Scans, speed: float | None, acceleration: float | None, scales: ManyScales) -> Guesses:
    """Speed, clutter and detection probability from quick passes over the first scans.

    Model: of `SPEEDS` that with which nearest-neighbour tracks explain most detections; the speed is then theirs,
    clutter what they leave unexplained, detection what they find of their targets.

    Args:
        scans: with first guesses of the sensors.
        speed: m/s; None: to be found.
        acceleration: m/s^2; None: a twentieth of the speed per second.
        scales: the rest.
    """
    head = scans.select(np.arange(min(len(scans), MOST_SCANS)))
    best: tuple[float, float, MultiTracks | None] = (-1.0, speed or SPEEDS[1], None)
    for tried in SPEEDS if speed is None else (speed,):
        told = replace(scales, speed=tried, acceleration=acceleration or tried / SPEED_TO_ACCELERATION)
        tracked = Gnn(told.motion, gate=told.gate**2, initiation=told.initiation).run(head)
        explained = float(tracked.hits.sum())
        # A wider guess must explain clearly more: it also takes in more clutter.
        if explained > 1.05 * best[0] + 1e-9 or best[2] is None:
            best = explained, tried, tracked
    _, chosen, found = best
    if speed is None and found is not None and len(found.mean):
        velocity = found.mean[found.hits > 0.5, scans.axes :]
        velocity = velocity[np.isfinite(velocity).all(axis=1)]
        # Sensible also where a narrow first guess found the tracks all the same.
        chosen = float(np.clip(np.sqrt(np.mean(velocity**2)), 1e-3, 1e4)) if len(velocity) > 10 else chosen
    detection, clutter = [], []
    for s, sensor in enumerate(scans.sensors):
        mine = np.flatnonzero(head.sensor == s)
        if found is None or not mine.size:
            detection.append(sensor.detection)
            clutter.append(sensor.clutter)
            continue
        rows = np.isin(found.scan, mine) & ~_silent(found)
        hits = found.hits[rows]
        detection.append(float(np.clip(hits.mean(), 0.3, 0.99)) if hits.size > 10 else sensor.detection)
        taken = float(found.hits[np.isin(found.scan, mine)].sum())
        clutter.append(max((float(head.counts[mine].sum()) - taken) / mine.size, LEAST_CLUTTER))
    return Guesses(chosen, acceleration or chosen / SPEED_TO_ACCELERATION, tuple(detection), tuple(clutter))


def _silent(found: MultiTracks) -> NDArray[np.bool_]:
    """Rows after the last detection of their track: it may have gone."""
    last = {int(track): int(scan) for track, scan in zip(found.id[found.hits > 0.5], found.scan[found.hits > 0.5],
                                                          strict=True)}  # fmt: skip
    return np.array([scan > last.get(int(t), -1) for t, scan in zip(found.id, found.scan, strict=True)], dtype=bool)


def with_numbers(scans: Scans, detection: Sequence[float], clutter: Sequence[float]) -> Scans:
    """The same scans of sensors with other numbers."""
    told = zip(scans.sensors, detection, clutter, strict=True)
    return replace(scans, sensors=tuple(replace(one, detection=d, clutter=c) for one, d, c in told))
