"""Estimates to a CSV or Parquet file, one row per measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from jink.estimators.status import STATUS_NAMES
from jink.estimators.tracks import Tracks

if TYPE_CHECKING:
    from jink.estimators.metrics import EstimatesLike

__all__ = ["STATUS_NAMES", "write_estimates"]


def write_estimates(
    path: str | Path,
    tracks: Tracks,
    estimates: EstimatesLike,
    modes: Sequence[str] = (),
    readings: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write estimates, padding left out; a reader finds either the whole file or none.

    Columns: track, t, x, y[, z], vx, vy[, vz], sd_x, ..., sd_vx, ..., nis, status, the readings, then `mode_<name>`,
    the probability of each mode. CSV numbers carry 17 digits where needed, so reading them back is exact.

    Args:
        path: file ending in .csv or .parquet; replaced if it exists.
        tracks: what was measured, B tracks.
        estimates: what an estimator's `run` or `smooth` returned for these tracks.
        modes: names of the modes; empty: mode_1, mode_2, ...
        readings: further columns (B, T) by name, for instance surge_probability.

    Raises:
        ValueError: another suffix, a folder that does not exist, or estimates of other tracks.
    """
    path = Path(path)
    if path.suffix.lower() not in {".csv", ".parquet"}:
        raise ValueError(f"write_estimates: path must end in .csv or .parquet; got {path.name}. Choose one of them.")
    if not path.parent.is_dir():
        raise ValueError(f"write_estimates: path must lie in an existing folder; got {path}. Make {path.parent} first.")
    position, mode_probs = np.asarray(estimates.position), np.asarray(estimates.mode_probs)
    B, T = tracks.times.shape
    if position.shape != (B, T, tracks.axes):
        raise ValueError(
            f"write_estimates: estimates must have positions of shape {(B, T, tracks.axes)}; got "
            f"{position.shape}. "
            "Pass the tracks that were estimated."
        )
    if modes and len(modes) != mode_probs.shape[-1]:
        raise ValueError(
            f"write_estimates: modes must have {mode_probs.shape[-1]} names; got {len(modes)}. Use the estimator's."
        )
    used = tracks.used
    labels = "xyz"[: tracks.axes]
    columns: dict[str, Any] = {"track": np.repeat(np.array(tracks.ids, dtype=object), tracks.lengths)}
    columns["t"] = tracks.times[used]
    columns |= {name: position[used][:, a] for a, name in enumerate(labels)}
    columns |= {f"v{name}": np.asarray(estimates.velocity)[used][:, a] for a, name in enumerate(labels)}
    variances = np.diagonal(np.asarray(estimates.covariance), axis1=-2, axis2=-1)[used]
    deviations = np.sqrt(np.maximum(variances, 0.0))
    names = [f"sd_{name}" for name in labels] + [f"sd_v{name}" for name in labels]
    columns |= {name: deviations[:, index] for index, name in enumerate(names)}
    columns["nis"] = np.asarray(estimates.nis)[used]
    columns["status"] = np.array(STATUS_NAMES, dtype=object)[np.asarray(estimates.status)[used]]
    columns |= {name: np.asarray(values)[used] for name, values in (readings or {}).items()}
    for index in range(mode_probs.shape[-1]):
        columns[f"mode_{modes[index] if modes else index + 1}"] = mode_probs[used][:, index]
    frame = pd.DataFrame(columns)
    part = path.with_name(path.name + ".part")
    try:
        if path.suffix.lower() == ".csv":
            frame.to_csv(part, index=False)
        else:
            frame.to_parquet(part, index=False)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
