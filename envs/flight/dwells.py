"""How long an intent lasts: `Dwell`, a distribution drawn by its inverse from one uniform number."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jink.envs.compiled import kernel

__all__ = ["DWELLS", "SHORTEST", "Dwell", "draw_dwell"]

DWELLS = ("fixed", "uniform", "exponential", "weibull")
SHORTEST = 1e-3
"""No intent and no turn of a jink is shorter than this, s."""


@dataclass(frozen=True)
class Dwell:
    """Time from entering an intent to leaving it.

    Model: ``minimum + (mean - minimum) X`` with ``E X = 1``: ``X`` is 1 (fixed), uniform on (0, 2), exponential, or
    Weibull of the given shape. So ``mean`` is the mean of the dwell itself, the minimum included.

    Args:
        mean: s.
        minimum: s; never less than this (fixed: not used, the dwell is ``mean``).
        kind: one of `DWELLS`.
        shape: Weibull only: 1 is exponential, larger more regular, smaller more bursty.
    Raises:
        ValueError: an unknown kind or a number outside its range.
    """

    mean: float = 10.0
    minimum: float = 1.0
    kind: str = "exponential"
    shape: float = 2.0

    def __post_init__(self) -> None:
        if self.kind not in DWELLS:
            raise ValueError(
                f"Dwell: kind must be one of {', '.join(DWELLS)}; got {self.kind!r}. Use 'exponential' if in doubt."
            )
        if not (SHORTEST <= self.mean < math.inf):
            raise ValueError(f"Dwell: mean must be {SHORTEST:g} s or more, finite; got {self.mean!r}. Give seconds.")
        if self.kind != "fixed" and not (SHORTEST <= self.minimum <= self.mean):
            raise ValueError(
                f"Dwell: minimum must be within {SHORTEST:g} s and the mean of {self.mean:g} s; got "
                f"{self.minimum!r}. Lower it, or raise the mean."
            )
        if not (0.2 <= self.shape <= 50.0):
            raise ValueError(f"Dwell: shape must be within 0.2 and 50; got {self.shape!r}. 1 is exponential.")

    @property
    def shortest(self) -> float:
        """The shortest dwell there can be, s."""
        return self.mean if self.kind == "fixed" else self.minimum

    def row(self) -> tuple[float, float, float, float]:
        """The numbers `draw_dwell` reads."""
        kind = float(DWELLS.index(self.kind))
        scale = 1.0 / math.gamma(1.0 + 1.0 / self.shape) if self.kind == "weibull" else 1.0
        return kind, self.shortest, (self.mean - self.shortest) * scale, 1.0 / self.shape


@kernel
def draw_dwell(row: NDArray[np.float64], u: float) -> float:
    """The dwell at quantile ``u`` in [0, 1); ``row`` from `Dwell.row`."""
    kind: float = row[0]
    if kind == 0.0:
        x = 0.0
    elif kind == 1.0:
        x = 2.0 * u
    else:
        x = -math.log1p(-u)
        if kind == 3.0:
            x = x ** row[3]
    return row[1] + row[2] * x
