"""Numbers as JSON has them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

__all__ = ["rounded"]


def rounded(values: Any, digits: int = 4) -> list[float | None]:
    """Plain numbers of a few digits; None for NaN and infinity, which JSON does not have."""
    array = np.asarray(values, dtype=np.float64)
    return [float(f"{v:.{digits}g}") if math.isfinite(v) else None for v in array.tolist()]
