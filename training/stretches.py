"""Pieces of tracks, and what the pieces say about noise and speed before any filter has run."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from jink.estimators.sensor import Sensor
from jink.estimators.tracks import Tracks

__all__ = ["cut_stretches", "rough_sigma", "rough_speed", "smallest_steps"]

Floats = NDArray[np.float64]

_STRETCH = 250
"""Rows of a stretch: long enough to start on ranges, short enough to sample a long flight in several places."""


def cut_stretches(tracks: Tracks, steps: int) -> Tracks:
    """Stretches of at most 250 rows spread evenly over all tracks, about `steps` rows together.

    Args:
        tracks: what was measured.
        steps: rows wanted, > 0; fewer are returned where there are fewer.

    Returns:
        the stretches as tracks of their own, without truth and labels.

    Raises:
        ValueError: no track has three rows with a measurement.
    """
    present = np.isfinite(tracks.measurements).any(axis=2) & tracks.used
    spans: list[tuple[int, int, int]] = []
    for b, length in enumerate(tracks.lengths):
        for first in range(0, int(length), _STRETCH):
            last = min(first + _STRETCH, int(length))
            if np.count_nonzero(present[b, first:last]) >= 3:
                spans.append((b, first, last))
    if not spans:
        raise ValueError(
            "cut_stretches: tracks must hold three measurements in a row of one track; got "
            f"{np.count_nonzero(present)} in all. Give --sigma, --acceleration and --speed."
        )
    mean_rows = np.mean([last - first for _, first, last in spans])
    count = int(np.clip(round(steps / mean_rows), 1, len(spans)))
    chosen = [spans[int((index + 0.5) * len(spans) / count)] for index in range(count)]
    T = max(last - first for _, first, last in chosen)
    rows = np.array([b for b, _, _ in chosen])[:, None]
    grid = np.stack([np.minimum(first + np.arange(T), last - 1) for _, first, last in chosen])
    lengths = np.array([last - first for _, first, last in chosen])
    padding = np.arange(T) >= lengths[:, None]
    return Tracks(
        ids=tuple(f"{tracks.ids[b]}:{first}" for b, first, _ in chosen),
        times=tracks.times[rows, grid],
        measurements=np.where(padding[..., None], np.nan, tracks.measurements[rows, grid]),
        sensor=tracks.sensor,
        lengths=lengths,
        axes=tracks.axes,
        noise=None if tracks.noise is None else tracks.noise[rows, grid],
        sensor_states=None if tracks.sensor_states is None else tracks.sensor_states[rows, grid],
        source=tracks.source,
    )


def _series(tracks: Tracks, component: int, angular: bool) -> Iterator[tuple[Floats, Floats]]:
    """Times and values of one component, track by track and, where sensors stand apart, place by place."""
    for track in tracks:
        places = np.zeros(len(track.times), dtype=np.int64)
        if track.sensor_states is not None:
            places = np.unique(track.sensor_states[:, : tracks.axes], axis=0, return_inverse=True)[1].ravel()
            if len(np.unique(places)) > 20:  # a moving sensor: its places are no series of their own
                places[:] = 0
        for place in np.unique(places):
            rows = (places == place) & np.isfinite(track.measurements[:, component])
            values = track.measurements[rows, component]
            if len(values) >= 3:
                yield track.times[rows], np.unwrap(values) if angular else values


def rough_sigma(tracks: Tracks, sensor: Sensor) -> Floats:
    """Upper guess of each component's standard deviation: how far a value lies from its neighbours' line.

    Args:
        tracks: what was measured.
        sensor: its sensor, any sigma.

    Returns:
        one per component, > 0; (D,); the component's unit.
    """
    guesses = np.empty(sensor.size)
    for d in range(sensor.size):
        bends = [np.empty(0)]
        for times, values in _series(tracks, d, sensor.angular[d]):
            before, after = np.diff(times)[:-1], np.diff(times)[1:]
            usable = (before > 0) & (after > 0)
            share = before[usable] / (before + after)[usable]
            middle = (1 - share) * values[:-2][usable] + share * values[2:][usable]
            bends.append((values[1:-1][usable] - middle) / np.sqrt(1 + share**2 + (1 - share) ** 2))
        found = np.abs(np.concatenate(bends))
        spread = np.nanstd(tracks.measurements[..., d])
        # 0.6745: the median of |N(0, 1)|. A median of 0 means that most values repeat: take the moving rest.
        centre = float(np.median(found)) if found.size else 0.0
        if centre == 0.0 and (found > 0).any():
            centre = float(np.median(found[found > 0]))
        guesses[d] = centre / 0.6745 or 1e-2 * spread or 1.0
    return guesses


def smallest_steps(tracks: Tracks, sensor: Sensor) -> Floats:
    """Quantisation of each component: the 1 % quantile of its non-zero changes; (D,); 0 where nothing changes."""
    steps = np.zeros(sensor.size)
    for d in range(sensor.size):
        changes = [np.abs(np.diff(values)) for _, values in _series(tracks, d, sensor.angular[d])]
        moved = np.concatenate([np.empty(0), *changes])
        moved = moved[moved > 0]
        steps[d] = np.quantile(moved, 0.01) if moved.size else 0.0
    return steps


def rough_speed(tracks: Tracks, sensor: Sensor, sigma: Floats) -> float | None:
    """Root mean square speed per axis, from displacements that stand well above the noise.

    Args:
        tracks: what was measured.
        sensor: its sensor; locates positions where it can, else ranges give the radial speed.
        sigma: standard deviation per component; (D,).

    Returns:
        m/s, > 0; None where the sensor measures neither positions nor ranges, or nothing moves.
    """
    located = [_located(track.times, track.measurements, track.sensor_states, sensor) for track in tracks]
    series = [pair for pair in located if len(pair[0]) >= 3]
    axes = sensor.axes
    if not series:
        if "range" not in sensor.labels:
            return None
        d = sensor.labels.index("range")
        series = [(times, values[:, None]) for times, values in _series(tracks, d, False)]
        axes = 1
    noise = float(np.max(sigma[[unit == "m" for unit in sensor.units]], initial=0.0))
    for lag in (1, 2, 4, 8, 16, 32, 64, 128):
        moves, spans = [np.empty(0)], [np.empty(0)]
        for times, places in series:
            span = times[lag:] - times[:-lag]
            kept = span > 0
            moves.append(np.linalg.norm(places[lag:] - places[:-lag], axis=1)[kept])
            spans.append(span[kept])
        move, span = np.concatenate(moves), np.concatenate(spans)
        if not move.size:
            break
        speeds = move / span
        speeds = np.minimum(speeds, np.quantile(speeds, 0.95))
        typical = float(np.sqrt(np.mean(speeds**2) / axes))
        if np.quantile(move, 0.75) > 6 * noise:
            return typical or None
    moving = [
        np.linalg.norm(np.quantile(places, 0.95, axis=0) - np.quantile(places, 0.05, axis=0)) / (times[-1] - times[0])
        for times, places in series
        if times[-1] > times[0]
    ]
    return float(np.median(moving)) or None if moving else None


def _located(times: Floats, measurements: Floats, states: Floats | None, sensor: Sensor) -> tuple[Floats, Floats]:
    """Times and positions of the rows that locate the target alone; (K,), (K, A)."""
    if sensor.locate is None:
        return np.empty(0), np.empty((0, sensor.axes))
    if sensor.name == "position":
        whole = np.isfinite(measurements).all(axis=1)
        return times[whole], measurements[whole]
    found, places = [], []
    at_rest = np.zeros(2 * sensor.axes)
    for row, z in enumerate(measurements):
        location = sensor.locate(sensor, z, sensor.noise, at_rest if states is None else states[row])
        if location is not None:
            found.append(times[row])
            places.append(location[0])
    return np.array(found), np.array(places).reshape(-1, sensor.axes)
