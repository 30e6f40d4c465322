"""Paths as text: braille letters, eight dots each, for terminals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["sketch"]

Floats = NDArray[np.float64]
_BRAILLE = 0x2800
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bit of the dot in row, column of a letter."""


def sketch(paths: Sequence[Floats], width: int = 24, height: int = 7) -> list[str]:
    """Paths in the plane, seen from above, as lines of text with equal scales along x and y.

    Args:
        paths: (T, 2 or more) each; only x and y are drawn; m.
        width, height: letters.

    Returns:
        `height` lines of `width` letters.
    """
    points = np.concatenate([_densified(path[:, :2], 4 * (width + height)) for path in paths])
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.array([2 * width, 4 * height])
    scale = float(np.min((size - 1) / np.maximum(high - low, 1e-9)))
    spare = (size - 1 - scale * (high - low)) / 2
    columns, rows = np.rint((points - low) * scale + spare).astype(np.int64).T
    rows = size[1] - 1 - rows
    canvas = np.zeros((height, width), dtype=np.int64)
    np.bitwise_or.at(canvas, (rows // 4, columns // 2), _DOTS[rows % 4, columns % 2])
    return ["".join(chr(_BRAILLE + int(bits)) for bits in line) for line in canvas]


def _densified(path: Floats, count: int) -> Floats:
    """Points at equal distances along a path."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, path[:, axis]) for axis in range(2)], axis=1)
