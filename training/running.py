"""Tracks through an estimator in portions, so that a progress bar can move and Ctrl-C is heard."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from jink.estimators.sensors import make_sensor
from jink.estimators.starting import MAX_ROWS
from jink.estimators.tracks import Tracks

__all__ = ["Forecast", "forecast_ends", "gate_tracks", "raw_positions", "run_tracks"]

Floats = NDArray[np.float64]

_PORTION = 200_000
"""Track-steps of one call: a fraction of a second."""


_INCREDIBLE, _PATIENCE, _STARTING = 1e-5, 5, 4


class Forecast(NamedTuple):
    """Where one track will be: its name, time s, position mean (A,) m and covariance (A, A) m^2."""

    track: str
    time: float
    mean: Floats
    covariance: Floats


def run_tracks(
    estimator: Any,
    tracks: Tracks,
    *,
    use_noise: bool = True,
    smooth: bool = False,
    advance: Callable[[int], None] | None = None,
) -> Any:
    """Estimates of all tracks.

    Args:
        estimator: from `make_estimator`.
        tracks: B tracks of T rows.
        use_noise: whether the tracks' own covariances are used; False: the sensor's.
        smooth: use all measurements of a track for each of its estimates.
        advance: called with the rows done after each portion.

    Returns:
        `Estimates`, (B, T, ...).
    """
    B, T = tracks.times.shape
    call = estimator.smooth if smooth else estimator.run
    size = max(1, _PORTION // max(T, 1))
    parts = []
    for first in range(0, B, size):
        rows = slice(first, first + size)
        noise = tracks.noise if use_noise else None
        states = tracks.sensor_states
        parts.append(
            call(
                tracks.measurements[rows],
                tracks.times[rows],
                noise=None if noise is None else noise[rows],
                sensor_states=None if states is None else states[rows],
                lengths=tracks.lengths[rows],
            )
        )
        if advance is not None:
            advance(int(tracks.lengths[rows].sum()))
    if len(parts) == 1:
        return parts[0]
    return type(parts[0])(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def gate_tracks(
    estimator: Any,
    tracks: Tracks,
    *,
    use_noise: bool = True,
    advance: Callable[[int], None] | None = None,
) -> tuple[Tracks, int]:
    """The tracks without measurements that their own past makes incredible.

    A row whose NIS exceeds the chi-square quantile 1 - 1e-5 becomes a missing one; after five such rows in a
    row the next is believed, for then it is the estimate that is wrong.

    Args:
        estimator: from `make_estimator`, run step by step.
        tracks: what was measured.
        use_noise: as for `run_tracks`.
        advance: called with the rows of each track when it is taken up.

    Returns:
        tracks with NaN instead of the outliers, and how many rows that were.
    """
    cleaned = tracks.measurements.copy()
    limits = chi2.isf(_INCREDIBLE, np.arange(1, tracks.measurements.shape[2] + 1))
    rejected = 0
    for b, track in enumerate(tracks):
        if advance is not None:
            advance(len(track.times))
        noise = track.noise if use_noise else None
        states = track.sensor_states
        head = slice(0, MAX_ROWS + 1)
        begun = estimator.run(
            track.measurements[head],
            track.times[head],
            None if noise is None else noise[head],
            None if states is None else states[head],
        )
        first = int(np.argmax(begun.status[0] != _STARTING)) + 1
        if first >= len(track.times) or not begun.nis_dof[0].any():
            continue
        head = slice(0, first)
        state = estimator.start(
            track.measurements[head],
            track.times[head],
            None if noise is None else noise[head],
            None if states is None else states[head],
        )
        refused = 0
        for row in range(first, len(track.times)):
            z, time = track.measurements[row], track.times[row]
            R, place = None if noise is None else noise[row], None if states is None else states[row]
            following, estimate = estimator.step(state, z, time, R, place)
            dof = int(estimate.nis_dof)
            if dof and estimate.nis > limits[dof - 1] and refused < _PATIENCE:
                following, _ = estimator.step(state, np.full_like(z, np.nan), time, R, place)
                cleaned[b, row] = np.nan
                refused += 1
                rejected += 1
            elif dof:
                refused = 0
            state = following
    return replace(tracks, measurements=cleaned), rejected


def forecast_ends(
    estimator: Any,
    tracks: Tracks,
    horizon: float,
    *,
    use_noise: bool = True,
    advance: Callable[[int], None] | None = None,
) -> list[Forecast]:
    """Where each track will be, `horizon` seconds after its last row.

    Args:
        estimator: from `make_estimator`.
        tracks: what was measured.
        horizon: s, >= 0.
        use_noise: as for `run_tracks`.
        advance: called with the rows of each track when it is taken up.

    Returns:
        one per track that could be started.
    """
    found = []
    for track in tracks:
        if advance is not None:
            advance(len(track.times))
        noise = track.noise if use_noise else None
        try:
            state = estimator.start(track.measurements, track.times, noise=noise, sensor_states=track.sensor_states)
        except ValueError:
            continue  # its rows do not locate it: such a track has no end to start from
        mean, covariance = estimator.forecast(state, horizon)
        found.append(Forecast(track.id, float(track.times[-1] + horizon), mean, covariance))
    return found


def raw_positions(tracks: Tracks) -> Floats | None:
    """Positions that the measurements give without a filter; (B, T, A), NaN where they do not; metres.

    Returns:
        positions, or None where a row of this sensor does not locate the target.
    """
    if tracks.sensor == "position":
        return tracks.measurements
    labels = make_sensor(tracks.sensor).labels if tracks.sensor.startswith("range-bearing") else ()
    if "bearing" not in labels:
        return None
    reach, bearing = tracks.measurements[..., 0], tracks.measurements[..., 1]
    elevation = tracks.measurements[..., 2] if "elevation" in labels else np.zeros_like(reach)
    ground = reach * np.cos(elevation)
    places = np.stack([ground * np.cos(bearing), ground * np.sin(bearing), reach * np.sin(elevation)], axis=-1)
    places = places[..., : tracks.axes]
    if tracks.sensor_states is not None:
        places = places + tracks.sensor_states[..., : tracks.axes]
    return np.asarray(places)
