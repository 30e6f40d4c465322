"""Tracks of many targets as a table and as a file: one row per track and scan."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.estimators.multitarget.open_tracks import OpenTracks
from jink.estimators.multitarget.results import MultiTracks
from jink.estimators.multitarget.scans import Scans

__all__ = ["network_frame", "track_frame", "write_frame"]

Array = NDArray[np.float64]
AXES = "xyz"


def track_frame(found: MultiTracks, scans: Scans, smooth: bool = False) -> pd.DataFrame:
    """One row per track and scan.

    Columns: track, scan, t, sensor, x, y[, z], vx, ..., sd_x, ..., sd_vx, ..., the covariances cov_x_y, ...; hits,
    the expected number of the track's detections in the scan; status: starting at its first scan, ok, missing where
    hits is at most one half, diverged where its numbers are not finite or a variance is negative.

    Args:
        found: what a tracker returned.
        scans: that it was given.
        smooth: states that later scans within the window have improved.
    """
    mean, cov = (found.smoothed_mean, found.smoothed_cov) if smooth else (found.mean, found.cov)
    names = np.array([sensor.name for sensor in scans.sensors], dtype=object)
    first = _first_rows(found.id)
    columns: dict[str, Any] = {
        "track": found.id, "scan": found.scan, "t": found.time, "sensor": names[scans.sensor[found.scan]],
    }  # fmt: skip
    columns |= _states(mean, cov) | {"hits": found.hits}
    columns["status"] = _status(mean, cov, first, found.hits > 0.5)
    return pd.DataFrame(columns)


def network_frame(found: OpenTracks, nodes: tuple[str, ...]) -> pd.DataFrame:
    """One row per node, track and time; as `track_frame`, with the column node in place of sensor.

    A time has the scans of all nodes: hits is the expected number of detections of the target in all of them, the same
    at every node, and the target is missing where that is at most one half.
    """
    parts = []
    first = _first_rows(found.id)
    for index, node in enumerate(nodes):
        mean, cov = found.mean[index], found.cov[index]
        columns: dict[str, Any] = {
            "node": np.full(len(found.id), node, dtype=object), "track": found.id, "scan": found.frame,
            "t": found.times[found.frame],
        }  # fmt: skip
        columns |= _states(mean, cov) | {"hits": found.hits}
        columns["status"] = _status(mean, cov, first, found.hits > 0.5)
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def _states(mean: Array, cov: Array) -> dict[str, Array]:
    width = mean.shape[1]
    labels = [f"{v}{axis}" for v in ("", "v") for axis in AXES[: width // 2]]
    variances = np.diagonal(cov, axis1=1, axis2=2)
    sigma = np.sqrt(np.where(variances >= 0, variances, np.nan))
    columns = {label: mean[:, i] for i, label in enumerate(labels)}
    columns |= {f"sd_{label}": sigma[:, i] for i, label in enumerate(labels)}
    return columns | {f"cov_{labels[i]}_{labels[j]}": cov[:, i, j] for i in range(width) for j in range(i + 1, width)}


def _first_rows(ids: NDArray[np.int64]) -> NDArray[np.bool_]:
    first = np.zeros(len(ids), dtype=bool)
    first[np.unique(ids, return_index=True)[1]] = True
    return first


def _status(mean: Array, cov: Array, first: NDArray[np.bool_], seen: NDArray[np.bool_]) -> NDArray[np.object_]:
    status = np.where(seen, "ok", "missing").astype(object)
    status[first] = "starting"
    good = np.isfinite(mean).all(axis=1) & np.isfinite(cov).all(axis=(1, 2))
    status[~(good & (np.diagonal(cov, axis1=1, axis2=2) >= 0).all(axis=1))] = "diverged"
    return status


def write_frame(path: Path, frame: pd.DataFrame) -> None:
    """Write a table; a reader finds either the whole file or none.

    Args:
        path: file ending in .csv or .parquet; replaced if it exists.
        frame: what to write.

    Raises:
        OSError: the file cannot be written.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        if path.suffix.lower() == ".csv":
            frame.to_csv(part, index=False)
        else:
            frame.to_parquet(part, index=False)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
