"""Tracks of different lengths to one padded array."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def as_list(value: ArrayLike | Sequence[ArrayLike], ndim: int) -> list[NDArray[np.float64]]:
    """Tracks of `ndim` dimensions from one track, a batch or a list."""
    if isinstance(value, np.ndarray):
        return [value] if value.ndim == ndim else list(value)
    items = [np.asarray(item) for item in value]  # type: ignore[union-attr]
    return [np.asarray(value)] if items and items[0].ndim == ndim - 1 else items


def pad(
    tracks: list[NDArray[np.float64]], T: int, rows: NDArray[np.int64], fill: float | str | None
) -> NDArray[np.float64]:
    """Stack tracks of different lengths; None repeats the last row as padding."""
    if [len(track) for track in tracks] != rows.tolist():
        raise ValueError(
            f"Tracks.from_arrays: arrays must have one entry per measurement row, {rows.tolist()[:10]}; got "
            f"{[len(track) for track in tracks][:10]}. Give every array the leading shape of measurements."
        )
    width = [
        np.concatenate(
            [track, np.repeat(track[-1:] if fill is None else _filling(track, fill), T - len(track), axis=0)]
        )
        for track in tracks
    ]
    return np.stack(width)


def _filling(track: NDArray[np.float64], fill: float | str) -> NDArray[np.float64]:
    return np.full((1, *track.shape[1:]), fill, dtype=None if isinstance(fill, str) else np.float64)
