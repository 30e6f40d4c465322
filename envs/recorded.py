"""Recorded tracks: CSV and Parquet files in the track format, or near it, to `Tracks`.

The track format is one row per measurement: `t` (seconds or ISO-8601), optionally `track`; a position `x,
y[, z]` (metres) or `lat, lon[, alt]` (degrees, metres; made local metres at the file's first fix), or
`range`, `bearing`, `elevation`, `range_rate` (metres, radians, m/s) seen from `sensor_x, sensor_y[,
sensor_z]`, `sensor_vx`, ...; optionally `sensor`, `sigma_x`, ... (standard deviations), `true_x, true_y[,
true_z]`, `true_vx`, ..., `intent`. An empty cell is a missing component; a row without any is an empty scan
and is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.envs.reading.cells import numbers, seconds, words
from jink.envs.reading.columns import AXES, Choice, choose_columns
from jink.envs.reading.measured import Rows, measured_rows
from jink.envs.reading.tables import Table, load, open_table
from jink.envs.reading.truth_file import interpolate_truth
from jink.estimators.tracks import Tracks

__all__ = ["read_tracks"]

PADDED_LIMIT = 50
"""Refuse files whose padded arrays would have this many times more rows than the file."""


def read_tracks(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    *,
    axes: int | None = None,
    truth: str | Path | None = None,
    truth_columns: Mapping[str, str] | None = None,
    where: Mapping[str, str] | None = None,
    sort: bool = False,
    drop_repeats: bool = False,
    rate_hz: float | None = None,
    height: float | None = None,
    compass: bool = False,
    degrees: bool = False,
    bias: Mapping[str, float] | None = None,
) -> Tracks:
    """Read the tracks of one file; all of it or nothing.

    Columns are recognised by name (`jink.envs.reading.columns`) unless mapped; `notes` of the result says what was
    chosen. Tracks may be interleaved; equal times are allowed. Files with both metres and degrees are read
    in metres.

    Args:
        path: CSV (comma, semicolon or tab; UTF-8) or Parquet file.
        columns: our names to the file's columns, for instance `{"t": "time", "x": "east", "y": "north"}`; an
            empty column means the file has none. Mapping a measurement switches the recognition of others
            off.
        axes: 2 or 3; None: 3 where z, alt or elevation is mapped, a column is called z, or ranges come from
            sensors with heights; 2 otherwise.
        truth: file with the true positions, interpolated linearly to the measurement times and NaN outside
            them.
        truth_columns: as `columns`, for the truth file.
        where: keep only rows whose column has this value, for instance `{"gps_new": "1"}`.
        sort: sort each track by time instead of refusing times that go backwards.
        drop_repeats: leave out rows that repeat the previous measurement of their track exactly (stale
            fixes); otherwise they are kept as measurements.
        rate_hz: rows per second, instead of a time column; each track starts at 0.
        height: height of the target, metres in the sensors' datum: slant ranges become horizontal ones (two
            axes); a range shorter than the height difference counts as missing.
        compass: bearings are clockwise from north (+y), and are turned to counter-clockwise from +x.
        degrees: bearings, elevations and their sigmas are in degrees.
        bias: known constant errors of the sensor, subtracted from its components (metres, m/s, radians), for
            instance `{"range": 2.8}`.

    Returns:
        the tracks in the order they appear, padded; times of ISO files are seconds since 1970 (UTC). Rows
        with sigma columns carry a diagonal `noise`, 1 where the component is missing.

    Raises:
        FileNotFoundError: no such file.
        IsADirectoryError: a folder.
        ValueError: a refused column, cell or row, named by file, row and column.
    """
    if axes not in (None, 2, 3):
        raise ValueError(f"read_tracks: axes must be 2, 3 or None; got {axes}. Use 2 for a plane.")
    if rate_hz is not None and not 0 < rate_hz < np.inf:
        raise ValueError(f"read_tracks: rate_hz must be > 0 and finite; got {rate_hz}. Give rows per second.")
    table = open_table(path)
    choice = choose_columns(table, columns, axes, clock=rate_hz is None)
    if rate_hz is not None:
        choice.columns.pop("t", None)
    needed = list(dict.fromkeys([*choice.columns.values(), *_where_columns(table, where)]))
    data = load(table, needed)
    keep = np.ones(len(data[needed[0]]), dtype=bool)
    for column, value in (where or {}).items():
        keep &= _equals(words(data[column]), value)
    if not keep.any():
        table.refuse(f"have rows where {_pairs(where)}", "none", "Check the value, or leave the filter out.")
    labels, notes = _track_labels(table, choice, data), [f"columns: {_pairs(choice.columns)}"]
    times = seconds(table, choice.columns["t"], data[choice.columns["t"]]) if rate_hz is None else None
    rows = measured_rows(table, choice, data, keep, height=height, compass=compass, degrees=degrees, bias=bias)
    kept = np.flatnonzero(keep)
    codes, ids = pd.factorize(labels[kept])
    if times is None:
        times = np.zeros(len(keep))
        times[kept] = pd.Series(codes).groupby(codes).cumcount().to_numpy() / float(rate_hz or 1.0)
    order = kept[np.lexsort((times[kept], codes) if sort else (codes,))]
    code_of = np.zeros(len(keep), dtype=np.int64)
    code_of[kept] = codes
    _check_clock(table, choice, times, code_of, order)
    if drop_repeats:
        fresh = _fresh(rows, code_of, order)
        notes.append(f"dropped {np.count_nonzero(~fresh)} of {len(order)} rows that repeat the previous measurement")
        order = order[fresh]
    lengths = np.bincount(code_of[order], minlength=len(ids))
    B, T = len(ids), int(lengths.max())
    limit = max(10_000_000, PADDED_LIMIT * len(order))
    if limit < B * T:
        table.refuse("hold tracks of comparable length", f"{B} tracks, the longest {T} rows", "Split the long ones.")
    starts = np.cumsum(lengths) - lengths
    grid = order[starts[:, None] + np.minimum(np.arange(T), lengths[:, None] - 1)]
    padding = np.arange(T) >= lengths[:, None]

    def padded(values: NDArray[np.float64] | None, fill: float | None) -> NDArray[np.float64] | None:
        if values is None:
            return None
        out = values[grid]
        if fill is not None:
            out[padding] = fill
        return out

    position, velocity = _own_truth(table, choice, data)
    true_position, true_velocity = padded(position, np.nan), padded(velocity, np.nan)
    names = tuple(str(name) for name in ids)
    clock = times[grid]
    if truth is not None:
        true_position, true_velocity = interpolate_truth(
            truth, truth_columns, names, clock, lengths, choice.axes, rows.origin, sort=sort
        )
    if rows.origin is not None:
        notes.append(
            f"local metres, east and north of latitude {rows.origin.latitude:.6f}, longitude "
            f"{rows.origin.longitude:.6f}"
        )
    return Tracks(
        ids=names,
        times=clock,
        measurements=np.where(padding[..., None], np.nan, rows.values[grid]),
        sensor=choice.kind,
        lengths=lengths,
        axes=choice.axes,
        noise=padded(rows.noise, None),
        sensor_states=padded(rows.places, None),
        truth=true_position,
        truth_velocity=true_velocity,
        intents=_padded_words(choice, data, "intent", grid, padding),
        sensor_ids=_padded_words(choice, data, "sensor", grid, padding),
        source=Path(path).name,
        notes=tuple(notes),
    )


def _pairs(mapping: Mapping[str, str] | None) -> str:
    return ", ".join(f"{name}={column}" for name, column in (mapping or {}).items())


def _where_columns(table: Table, where: Mapping[str, str] | None) -> list[str]:
    for column in where or {}:
        if column not in table.names:
            table.refuse(
                f"have the column '{column}' to filter by",
                f"columns {table.columns_text}",
                "Name one of them.",
            )
    return list(where or {})


def _equals(cells: NDArray[np.object_], value: str) -> NDArray[np.bool_]:
    """Equal as text, or as numbers ("1" matches "1.0")."""
    same = cells == str(value).strip()
    try:
        number = float(value)
    except ValueError:
        return np.asarray(same)
    return np.asarray(same | (pd.to_numeric(pd.Series(cells), errors="coerce").to_numpy() == number))


def _track_labels(table: Table, choice: Choice, data: dict[str, Any]) -> NDArray[np.object_]:
    column = choice.columns.get("track")
    if column is None:
        return np.full(len(next(iter(data.values()))), table.path.stem, dtype=object)
    labels = words(data[column])
    empty = np.flatnonzero(labels == "")
    if empty.size:
        table.refuse_cell(int(empty[0]), column, "name the track", "an empty cell", "Fill it, or map track= to none.")
    return labels


def _check_clock(
    table: Table,
    choice: Choice,
    times: NDArray[np.float64],
    codes: NDArray[np.int64],
    order: NDArray[np.int64],
) -> None:
    back = np.flatnonzero((np.diff(times[order]) < 0) & (np.diff(codes[order]) == 0))
    if back.size:
        before, row = int(order[back[0]]), int(order[back[0] + 1])
        table.refuse_cell(
            row,
            choice.columns.get("t", "t"),
            "not go backwards within a track",
            f"{times[row]:.10g} after {times[before]:.10g}, {back.size} such rows",
            "Sort the file by time, or use sort=True (--sort).",
        )


def _fresh(rows: Rows, codes: NDArray[np.int64], order: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows that do not repeat the previous measurement of their track, sensor place included."""
    seen = rows.values if rows.places is None else np.concatenate([rows.values, rows.places], axis=1)
    seen = np.nan_to_num(seen[order], nan=np.inf)
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(codes[order]) != 0) | (seen[1:] != seen[:-1]).any(axis=1)
    return new


def _own_truth(
    table: Table, choice: Choice, data: dict[str, Any]
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Truth columns of the measurement file itself."""
    found = []
    for prefix in ("true_", "true_v"):
        names = [choice.columns.get(f"{prefix}{axis}") for axis in AXES[: choice.axes]]
        if any(names) and not all(names):
            wanted = ", ".join(f"{prefix}{axis}" for axis in AXES[: choice.axes])
            table.refuse(f"have all of {wanted} or none", f"columns {table.columns_text}", "Add or unmap them.")
        found.append(np.stack([numbers(table, n, data[n]) for n in names if n], axis=1) if all(names) else None)
    return found[0], found[1]


def _padded_words(
    choice: Choice, data: dict[str, Any], name: str, grid: NDArray[np.int64], padding: NDArray[np.bool_]
) -> NDArray[np.str_] | None:
    if name not in choice.columns:
        return None
    return np.where(padding, "", words(data[choice.columns[name]]).astype(np.str_)[grid])
