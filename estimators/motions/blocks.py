"""Writing symmetric blocks of a covariance."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import kernel

__all__ = ["add_outer", "add_pair", "fill_three"]


@kernel
def add_pair(out: np.ndarray, i: int, j: int, value: float) -> None:
    """Add ``value`` to the entries (i, j) and (j, i), ``i != j``."""
    out[i, j] += value
    out[j, i] += value


@kernel
def add_outer(out: np.ndarray, i: int, j: int, ux: float, uy: float, first: float, cross: float, second: float) -> None:
    """Add ``first u u' + cross (u n' + n u') + second n n'`` at rows i, j; ``n`` is ``u`` turned left."""
    out[i, i] += first * ux * ux - 2.0 * cross * ux * uy + second * uy * uy
    out[j, j] += first * uy * uy + 2.0 * cross * ux * uy + second * ux * ux
    add_pair(out, i, j, (first - second) * ux * uy + cross * (ux * ux - uy * uy))


@kernel
def fill_three(out: np.ndarray, i: int, pp: float, pv: float, pa: float, vv: float, va: float, aa: float) -> None:
    """Write one symmetric 3 by 3 block at row ``i``."""
    out[i, i] = pp
    out[i, i + 1] = pv
    out[i + 1, i] = pv
    out[i, i + 2] = pa
    out[i + 2, i] = pa
    out[i + 1, i + 1] = vv
    out[i + 1, i + 2] = va
    out[i + 2, i + 1] = va
    out[i + 2, i + 2] = aa
