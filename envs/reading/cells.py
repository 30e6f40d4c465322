"""Columns of a table as numbers, seconds or words; a cell that cannot be one is refused by row and column."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from jink.envs.reading.tables import Table, is_number

MISSING_WORDS = ("", "nan", "-nan", "na", "n/a", "null", "none")


def numbers(table: Table, column: str, array: pa.ChunkedArray) -> NDArray[np.float64]:
    """A column as float64, empty cells NaN.

    Raises:
        ValueError: a cell that is neither a finite number nor empty.
    """
    if pa.types.is_string(array.type) or pa.types.is_large_string(array.type):
        values = _text_to_numbers(table, column, array)
    elif pa.types.is_integer(array.type) or pa.types.is_floating(array.type) or pa.types.is_decimal(array.type):
        values = _to_numpy(pc.cast(array, pa.float64(), safe=False))
    else:
        table.refuse(f"hold numbers in column '{column}'", str(array.type), "Map another column with --columns.")
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        row = int(infinite[0])
        table.refuse_cell(row, column, "be a finite number or empty", values[row], "Correct or empty the cell.")
    return values


def _to_numpy(array: pa.ChunkedArray) -> NDArray[np.float64]:
    return np.array(pc.fill_null(array, float("nan")).to_numpy(), dtype=np.float64)


def _text_to_numbers(table: Table, column: str, array: pa.ChunkedArray) -> NDArray[np.float64]:
    try:
        return _to_numpy(pc.cast(array, pa.float64()))
    except pa.ArrowInvalid:
        trimmed = pc.utf8_trim_whitespace(array)
    words = pc.utf8_lower(trimmed)
    missing = pc.fill_null(pc.is_in(words, value_set=pa.array(MISSING_WORDS)), True)
    trimmed = pc.if_else(missing, None, trimmed)
    try:
        return _to_numpy(pc.cast(trimmed, pa.float64()))
    except pa.ArrowInvalid:
        parsed = pd.to_numeric(pd.Series(trimmed.to_pylist(), dtype=object), errors="coerce").to_numpy(np.float64)
    bad = np.flatnonzero(np.isnan(parsed) & ~np.asarray(missing.to_numpy(), dtype=bool))
    if bad.size:
        row = int(bad[0])
        table.refuse_cell(
            row,
            column,
            "be a finite number or empty",
            f"'{array[row].as_py()}'",
            "Correct or empty the cell.",
        )
    return parsed


def seconds(table: Table, column: str, array: pa.ChunkedArray) -> NDArray[np.float64]:
    """A time column in seconds.

    Numbers are taken as they are, ISO-8601 texts and timestamps as seconds since 1970 (UTC). A time without a
    zone is read as UTC. Float64 resolves 0.24 microseconds at today's dates.

    Raises:
        ValueError: an empty cell, or one that is neither a number nor an ISO-8601 time.
    """
    if pa.types.is_timestamp(array.type) or pa.types.is_date(array.type):
        values = _epoch_seconds(pd.to_datetime(array.to_pandas(), utc=True))
    else:
        text = pa.types.is_string(array.type) or pa.types.is_large_string(array.type)
        first = next((cell for item in array if (cell := item.as_py()) and cell.strip()), "0") if text else "0"
        if is_number(first) or not re.match(r"\s*\d{4}-?\d{2}-?\d{2}", first):
            values = numbers(table, column, array)
        else:
            values = _epoch_seconds(pd.to_datetime(array.to_pandas(), format="ISO8601", utc=True, errors="coerce"))
    bad = np.flatnonzero(np.isnan(values))
    if bad.size:
        row = int(bad[0])
        got = array[row].as_py()
        table.refuse_cell(
            row,
            column,
            "be a time (seconds, or ISO-8601 like the first row)",
            "an empty cell" if got is None else f"'{got}'",
            "Correct the cell or remove the row.",
        )
    return values


def _epoch_seconds(times: pd.Series) -> NDArray[np.float64]:
    since = times - pd.Timestamp(0, tz="UTC")
    return np.asarray(since.dt.total_seconds().to_numpy(dtype=np.float64, na_value=np.nan))


def words(array: pa.ChunkedArray) -> NDArray[np.object_]:
    """A column as trimmed text, empty cells as the empty string."""
    text = pc.cast(array, pa.string()) if not pa.types.is_string(array.type) else array
    return np.asarray(pc.fill_null(pc.utf8_trim_whitespace(text), "").to_numpy(), dtype=object)
