"""Truth from its own file, brought to the measurement times."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jink.envs.reading.cells import numbers, seconds, words
from jink.envs.reading.columns import AXES, choose_columns
from jink.envs.reading.geodesy import Origin
from jink.envs.reading.measured import measured_rows
from jink.envs.reading.tables import load, open_table

Floats = NDArray[np.float64]


def interpolate_truth(
    path: str | Path,
    columns: Mapping[str, str] | None,
    ids: tuple[str, ...],
    times: Floats,
    lengths: NDArray[np.int64],
    axes: int,
    origin: Origin | None,
    *,
    sort: bool = False,
) -> tuple[Floats, Floats | None]:
    """Read true positions and interpolate them linearly to the measurement times, never beyond their ends.

    Tracks are matched by name, or directly where both files hold one track. Truth rows without a position are
    skipped; velocities are used where the file has `vx, vy[, vz]`.

    Args:
        path: CSV or Parquet file.
        columns: our names to its columns; None: recognise.
        ids: names of the measured tracks; (B,).
        times: seconds; (B, T).
        lengths: rows of each measured track; (B,).
        axes: 2 or 3.
        origin: local frame of the measurements where they came as degrees, else None.
        sort: sort truth by time instead of refusing.

    Returns:
        positions (B, T, A) and velocities (B, T, A) or None; NaN where the truth says nothing.

    Raises:
        ValueError: a refused column or cell, another frame than the measurements', no common track or time.
    """
    table = open_table(path)
    choice = choose_columns(table, columns, axes, flag="--truth-columns", truth=True)
    if choice.kind != "position":
        table.refuse("hold true positions", f"columns {table.columns_text}", "Map x and y with --truth-columns.")
    if choice.geographic != (origin is not None):
        frames = ("degrees", "metres") if choice.geographic else ("metres", "degrees")
        table.refuse(
            f"use the frame of the measurements, {frames[1]}",
            frames[0],
            "Map the matching columns of both files.",
        )
    data = load(table, list(dict.fromkeys(choice.columns.values())))
    clock = seconds(table, choice.columns["t"], data[choice.columns["t"]])
    everything = np.ones(len(clock), dtype=bool)
    values = measured_rows(table, choice, data, everything, origin=origin).values
    speeds = [choice.columns.get(f"v{axis}") for axis in AXES[:axes]]
    if all(speeds):
        values = np.concatenate([values] + [numbers(table, n, data[n])[:, None] for n in speeds if n], axis=1)
    labels = np.full(len(clock), "", dtype=object)
    if "track" in choice.columns:
        labels = words(data[choice.columns["track"]])
    out = np.full((*times.shape, values.shape[1]), np.nan)
    single = len(ids) == 1 and len(set(labels)) == 1
    found = False
    for b, name in enumerate(ids):
        rows = np.flatnonzero((single | (labels == name)) & np.isfinite(values[:, :axes]).all(axis=1))
        found |= bool(rows.size)
        if sort:
            rows = rows[np.argsort(clock[rows], kind="stable")]
        back = np.flatnonzero(np.diff(clock[rows]) < 0)
        if back.size:
            before, row = int(rows[back[0]]), int(rows[back[0] + 1])
            table.refuse_cell(
                row,
                choice.columns["t"],
                "not go backwards within a track",
                f"{clock[row]:.10g} after {clock[before]:.10g}",
                "Sort the file by time, or use sort=True (--sort).",
            )
        if rows.size:
            T = int(lengths[b])
            for column in range(values.shape[1]):
                out[b, :T, column] = np.interp(
                    times[b, :T], clock[rows], values[rows, column], left=np.nan, right=np.nan
                )
    if not found:
        table.refuse(
            "hold true positions of the measured tracks, named alike",
            f"none of {', '.join(ids[:5])}",
            "Map track with --truth-columns.",
        )
    if np.isnan(out[..., 0]).all():
        table.refuse(
            f"cover measurement times, {np.min(times):.6g}..{np.max(times):.6g} s",
            f"{clock.min():.6g}..{clock.max():.6g} s",
            "Map the matching time columns.",
        )
    return out[..., :axes], out[..., axes:] if all(speeds) else None
