"""Which measured rows lie in the window of a row."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

__all__ = ["windows"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
Batch = tuple[tuple[Integers, Integers], Floats, Integers, Flags]
_FEWEST = 5  # rows of a window: three determine a parabola, two show how well it fits
_CELLS = 20_000  # rows x window rows handled at once: stays in the cache


def windows(times: Floats, asked: Flags, present: Flags, window: float) -> Iterator[Batch]:
    """Windows of the rows asked for, in batches of like size.

    Args:
        times: (B, T), s.
        asked: rows that want a window, (B, T).
        present: measured rows, (B, T).
        window: length, s.

    Yields:
        rows ``(b, t)``, each (K,); where each one's window is centred, s (K,); its measured rows (K, W); which of these
        count (K, W).
    """
    parts = []
    for b in range(len(times)):
        rows = np.flatnonzero(present[b])
        if rows.size < _FEWEST or not asked[b].any():
            continue
        clock, wanted = times[b, rows], np.flatnonzero(asked[b])
        half = 0.5 * window
        middle = times[b, wanted]
        if clock[-1] - clock[0] > window:
            middle = np.clip(middle, clock[0] + half, clock[-1] - half)
        slack = 1e-9 * window
        first = np.searchsorted(clock, middle - half - slack)
        last = np.searchsorted(clock, middle + half + slack, side="right")
        nearest = np.searchsorted(clock, middle)
        short = last - first < _FEWEST
        few = np.clip(nearest - _FEWEST // 2, 0, rows.size - _FEWEST)
        first, last = np.where(short, few, first), np.where(short, few + _FEWEST, last)
        reach = np.stack([clock[first], clock[last - 1]])
        parts.append((np.full(wanted.size, b), wanted, first, last, np.clip(times[b, wanted], *_inner(reach, window))))
    if not parts:
        return
    kept = [np.flatnonzero(present[part[0][0]]) for part in parts]
    longest = max(rows.size for rows in kept)
    table = np.stack([np.pad(rows, (0, longest - rows.size), mode="edge") for rows in kept])
    part = np.repeat(np.arange(len(parts)), [len(column[0]) for column in parts])
    track, t, low, high, centre = (np.concatenate(column) for column in zip(*parts, strict=True))
    sizes = high - low
    sequence = np.argsort(sizes, kind="stable")  # windows of like size together: little padding
    done = 0
    while done < sequence.size:
        widest = int(sizes[sequence[min(done + max(1, _CELLS // int(sizes.max())), sequence.size) - 1]])
        batch = sequence[done : done + max(1, _CELLS // widest)]
        done += batch.size
        width = np.arange(int(sizes[batch].max()))
        inside = width < sizes[batch][:, None]
        columns = np.minimum(low[batch][:, None] + width, high[batch][:, None] - 1)
        yield (track[batch], t[batch]), centre[batch], table[part[batch][:, None], columns], inside


def _inner(reach: Floats, window: float) -> tuple[Floats, Floats]:
    """Where the expansion point of a window may lie: half a window inside the rows it holds, or their middle."""
    half = np.minimum(0.5 * window, 0.5 * (reach[1] - reach[0]))
    return reach[0] + half, reach[1] - half
