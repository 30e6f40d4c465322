"""Recorded tracks made ready for windows: rows of all tracks end to end, with a truth for every row."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.sampling import TICK
from jink.estimators.recipes import make_estimator
from jink.estimators.sensor import Sensor
from jink.estimators.tracks import Track, Tracks

__all__ = ["TruthRows", "Windows", "find_windows", "mean_acceleration_density", "residual_sigma", "truth_rows"]

Array = NDArray[np.float64]


class TruthRows(NamedTuple):
    """Rows of all tracks, one track after the other: K rows, A axes, D components; SI."""

    track: NDArray[np.int64]  # (K,)
    run: NDArray[np.int64]  # (K,) rows of one run follow each other without a hole
    clock: Array  # (K,) s since the first row of its track, in whole ticks
    measurements: Array  # (K, D)
    noise: Array | None  # (K, D, D)
    sensor_states: Array  # (K, 2 A)
    position: Array  # (K, A)
    velocity: Array  # (K, A)
    acceleration: Array  # (K, A)
    intent: NDArray[np.int8]  # (K,)


class Windows(NamedTuple):
    """Where episodes can begin, and what became of each track."""

    starts: NDArray[np.int64]  # (W,) first rows
    refused: tuple[str, ...]  # one sentence part per track without a window


def truth_rows(
    tracks: Tracks, kind: str, intents: tuple[str, ...], max_gap: float, sensor: Sensor | None, acceleration: float
) -> TruthRows:
    """Lay the rows of all tracks end to end and give each a true position, velocity and acceleration.

    Velocities are the recorded ones where every row has one, else central differences of positions over the two gaps
    beside a row; accelerations are differences of velocities. Rows without a truth end a run, as does a gap.

    Args:
        tracks: recorded.
        kind: "recorded" truth, "measured" positions, or "smoothed" ones.
        intents: labels, in the order of the codes.
        max_gap: longest gap within a run, s.
        sensor: of the tracks, for the smoother.
        acceleration: typical acceleration for the smoother, m/s^2.
    Returns:
        the rows that have a truth.
    """
    A = tracks.axes
    smooth = None
    if kind == "smoothed" and sensor is not None:
        estimator = make_estimator("kf-cv", sensor, acceleration=acceleration)
        smooth = estimator.smooth(tracks.measurements, tracks.times, tracks.noise, tracks.sensor_states, tracks.lengths)
    parts: list[TruthRows] = []
    run = 0
    for b, track in enumerate(tracks):
        rows = len(track.times)
        position, velocity = _truth_of(track, kind)
        if smooth is not None:
            position, velocity = smooth.position[b, :rows], smooth.velocity[b, :rows]
        there = np.flatnonzero(np.isfinite(position).all(axis=1))
        if not there.size:
            continue
        gaps = np.rint(np.diff(track.times, prepend=track.times[:1]) / TICK) * TICK
        clock = np.cumsum(gaps)[there]
        # A measured truth has no rows where nothing was measured, so its holes are in time only.
        holes = (np.diff(there) > 1) & (kind == "recorded")
        runs = run + np.concatenate([[0], np.cumsum(holes | (np.diff(clock) > max_gap))])
        run = int(runs[-1]) + 1
        position = position[there]
        speeds = None if velocity is None else velocity[there]
        if speeds is None or not np.isfinite(speeds).all():
            speeds = _rates(runs, clock, position)
        states = track.sensor_states
        labels = np.zeros(rows, dtype=np.int8) if track.intents is None else _codes(track.intents, intents)
        parts.append(
            TruthRows(
                np.full(there.size, b),
                runs,
                clock,
                track.measurements[there],
                None if track.noise is None else track.noise[there],
                np.zeros((there.size, 2 * A)) if states is None else states[there],
                position,
                speeds,
                _rates(runs, clock, speeds),
                labels[there],
            )
        )
    if not parts:
        parts = [_no_rows(tracks)]
    noises = [part.noise for part in parts if part.noise is not None]
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in TruthRows._fields if name != "noise"
    }
    return TruthRows(noise=np.concatenate(noises) if noises else None, **joined)


def _no_rows(tracks: Tracks) -> TruthRows:
    A, D = tracks.axes, tracks.measurements.shape[2]
    whole, none = np.empty(0, dtype=np.int64), np.empty((0, A))
    return TruthRows(
        whole, whole, np.empty(0), np.empty((0, D)), None, np.empty((0, 2 * A)), none, none, none, np.empty(0, np.int8)
    )


def _truth_of(track: Track, kind: str) -> tuple[Array, Array | None]:
    if kind == "recorded" and track.truth is not None:
        return track.truth, track.truth_velocity
    return track.measurements, None


def _codes(labels: NDArray[np.str_], intents: tuple[str, ...]) -> NDArray[np.int8]:
    found = np.searchsorted(np.asarray(intents), np.where(labels == "", "unlabelled", labels))
    return found.astype(np.int8)


def _rates(runs: NDArray[np.int64], clock: Array, values: Array) -> Array:
    """Derivatives (K, A) within each run; rows at one time share theirs, a run at a single time has none."""
    rates = np.zeros_like(values)
    edges = np.flatnonzero(np.diff(runs, prepend=-1, append=-1))
    for begin, end in pairwise(edges):
        times, first, back = np.unique(clock[begin:end], return_index=True, return_inverse=True)
        if len(times) > 1:
            order: Literal[1, 2] = 2 if len(times) > 2 else 1
            rates[begin:end] = np.gradient(values[begin:end][first], times, axis=0, edge_order=order)[back]
    return rates


def find_windows(rows: TruthRows, tracks: Tracks, steps: int) -> Windows:
    """All rows from which ``steps`` rows follow in one run and take some time."""
    last = np.arange(len(rows.run)) + steps - 1
    fits = last < len(rows.run)
    end = np.where(fits, last, 0)
    whole = fits & (rows.run[end] == rows.run)
    starts = np.flatnonzero(whole & (rows.clock[end] > rows.clock))
    refused = []
    for b in sorted(set(range(len(tracks))) - set(rows.track[starts].tolist())):
        own = rows.run[rows.track == b]
        longest = int(np.bincount(own - own[0]).max()) if own.size else 0
        why = "take no time" if longest >= steps else f"are fewer than {steps}"
        refused.append(
            f"track '{tracks.ids[b]}' has {int(tracks.lengths[b])} rows, of which {longest} in a row with a true "
            f"position and no long gap, and these {why}"
        )
    return Windows(starts, tuple(refused))


def residual_sigma(rows: TruthRows, sensor: Sensor) -> Array:
    """Robust standard deviation of recorded errors, 1.4826 median |z - h(truth)| per component; (D,)."""
    # Evenly chosen: enough for a median to 3 %, and a long file costs no more than a short one.
    chosen = np.unique(np.linspace(0, len(rows.run) - 1, 5000).astype(np.int64))
    errors = np.empty((len(chosen), sensor.size))
    params, out = np.asarray(sensor.params or (0.0,)), np.empty(sensor.size)
    for index, k in enumerate(chosen):
        state = np.concatenate([rows.position[k], rows.velocity[k]])
        sensor.observe.function(state, rows.sensor_states[k], params, out)
        errors[index] = rows.measurements[k] - out
    angular = np.asarray(sensor.angular)
    errors[:, angular] = np.pi - np.mod(np.pi - errors[:, angular], 2 * np.pi)
    return np.asarray(1.4826 * np.nanmedian(np.abs(errors), axis=0))


def mean_acceleration_density(rows: TruthRows, lag: int) -> float:
    """White acceleration that moves mean velocities as much as recorded, m^2/s^3.

    Model: means of the velocity over neighbouring spans tau differ by ``(2/3) q tau`` per axis if acceleration is
    white with density q (variance of the difference).
    """
    K = len(rows.run)
    first = np.arange(max(K - 2 * lag, 0))
    middle, last = first + lag, first + 2 * lag
    spans = np.stack([rows.clock[middle] - rows.clock[first], rows.clock[last] - rows.clock[middle]])
    use = (rows.run[first] == rows.run[last]) & (spans > 0).all(axis=0)
    if not use.any():
        return 0.0
    first, middle, last, spans = first[use], middle[use], last[use], spans[:, use, None]
    change = (rows.position[last] - rows.position[middle]) / spans[1] - (
        rows.position[middle] - rows.position[first]
    ) / spans[0]
    # For unlike spans the variance is q (tau_1 + tau_2) / 3.
    return float(3.0 * np.square(change).mean(axis=1).sum() / spans.sum())
