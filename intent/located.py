"""Measurements as positions with covariance: what the encoder fits its windows to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.estimators.sensors import make_sensor
from jink.estimators.tracks import Tracks

__all__ = ["information", "locate", "noise_sigma"]

Floats = NDArray[np.float64]
_NORMAL_MEDIAN = 0.6745  # of |N(0, 1)|
_LOCATING = ("range-bearing", "range-bearing-elevation", "range-bearing-rate", "range-bearing-elevation-rate")


def locate(tracks: Tracks, noise_sd: float | None = None) -> tuple[Floats, Floats]:
    """Positions and their covariances, one per row.

    A sensor that locates the target alone (range and bearing) is converted row by row; a position is taken as it is.
    Without any given noise, one standard deviation for all axes is estimated by `noise_sigma`.

    Args:
        tracks: what was measured; B tracks, T rows, A axes.
        noise_sd: standard deviation of a position per axis, m; None: that of the tracks. Other sensors need the noise
            of the tracks.

    Returns:
        positions (B, T, A), m, NaN = missing component; covariances (B, T, A, A), m^2.

    Raises:
        ValueError: the sensor cannot locate a target from one row, or a noise is not positive.
    """
    axes = tracks.axes
    if noise_sd is not None and not 0.0 < noise_sd < np.inf:
        raise ValueError(
            f"encode: noise_sd must be > 0 and finite; got {noise_sd}. Give metres, or None to estimate it."
        )
    if tracks.sensor == "position":
        if noise_sd is not None or tracks.noise is None:
            sigma = np.full(axes, noise_sd) if noise_sd is not None else noise_sigma(tracks)
            return tracks.measurements, np.broadcast_to(np.diag(sigma**2), (*tracks.times.shape, axes, axes))
        return tracks.measurements, tracks.noise
    if tracks.sensor not in _LOCATING or tracks.noise is None:
        what = "noise, one covariance per row" if tracks.sensor in _LOCATING else "positions"
        raise ValueError(
            f"encode: tracks of a {tracks.sensor} sensor must carry {what}; got none. "
            "Smooth them with a tracking filter first and give its positions and covariances."
        )
    sensor = make_sensor(tracks.sensor, sigma=[1.0] * tracks.measurements.shape[2])
    find = sensor.locate
    positions = np.full((*tracks.times.shape, axes), np.nan)
    covs = np.broadcast_to(np.eye(axes), (*tracks.times.shape, axes, axes)).copy()
    at_origin = np.zeros(2 * axes)
    for b, t in np.argwhere(np.isfinite(tracks.measurements).any(axis=2) & tracks.used):
        place = at_origin if tracks.sensor_states is None else tracks.sensor_states[b, t]
        found = None if find is None else find(sensor, tracks.measurements[b, t], tracks.noise[b, t], place)
        if found is not None:
            positions[b, t], covs[b, t] = found
    return positions, covs


def noise_sigma(tracks: Tracks) -> Floats:
    """Standard deviation of each position component, m; (A,).

    Model: a value minus the cubic through its two neighbours on either side; median of the absolute remainders over
    what white noise of unit variance would leave. Curvature of the path does not enter up to its third derivative, so
    only motion that changes within four rows makes this an over-estimate.

    Args:
        tracks: position tracks; missing rows are left out.

    Returns:
        > 0 each; a hundredth of the spread of the values where too few rows or only zeros remain.

    Source: the median absolute deviation. Differs: remainders of a cubic at irregular times.
    """
    sigma = np.empty(tracks.measurements.shape[2])
    for d in range(sigma.size):
        parts = [np.empty(0)]
        for track in tracks:
            present = np.isfinite(track.measurements[:, d])
            times, values = track.times[present], track.measurements[present, d]
            fresh = np.concatenate([[True], np.diff(times) > 0]) if times.size else np.empty(0, dtype=bool)
            times, values = times[fresh], values[fresh]
            if times.size >= 5:
                parts.append(_remainders(times, values))
        found = np.abs(np.concatenate(parts))
        centre = float(np.median(found)) / _NORMAL_MEDIAN if found.size else 0.0
        spread = np.nanstd(tracks.measurements[..., d]) if np.isfinite(tracks.measurements[..., d]).any() else 0.0
        sigma[d] = centre or 1e-2 * float(spread) or 1.0
    return sigma


def _remainders(times: Floats, values: Floats) -> Floats:
    nodes = np.stack([times[k : times.size - 4 + k] for k in (0, 1, 3, 4)])
    at = times[2:-2]
    weights = np.ones_like(nodes)
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[i] *= (at - nodes[j]) / (nodes[i] - nodes[j])
    known = np.stack([values[k : values.size - 4 + k] for k in (0, 1, 3, 4)])
    return np.asarray((values[2:-2] - (weights * known).sum(axis=0)) / np.sqrt(1.0 + (weights**2).sum(axis=0)))


def information(positions: Floats, covs: Floats) -> Floats:
    """Inverse covariance of the measured components of each row, 0 for missing ones; (..., A, A), 1/m^2.

    Raises:
        ValueError: a covariance is not positive definite.
    """
    present = np.isfinite(positions)
    axes = positions.shape[-1]
    out = np.zeros((*positions.shape, axes))
    codes = present @ (1 << np.arange(axes))
    for code in np.unique(codes[codes > 0]):
        rows = np.nonzero(codes == code)
        kept = np.flatnonzero((code >> np.arange(axes)) & 1)
        block = covs[rows][:, kept[:, None], kept]
        try:
            np.linalg.cholesky(block)
        except np.linalg.LinAlgError as trouble:
            raise ValueError(
                f"encode: noise must be positive definite; got one of {len(block)} rows that is not ({trouble}). "
                "Give variances > 0."
            ) from trouble
        inverse = np.zeros((len(block), axes, axes))
        inverse[:, kept[:, None], kept] = np.linalg.inv(block)
        out[rows] = inverse
    return out
