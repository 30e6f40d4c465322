"""Model error of bounded size: `ModelError`, the uncertainty that robust filters are made for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.envs.streams import Need

__all__ = ["ModelError"]

Array = NDArray[np.float64]
Matrix = tuple[tuple[float, ...], ...]
_KINDS = ("scalar", "matrix")
_REDRAWS = ("step", "episode")


@dataclass(frozen=True, kw_only=True)
class ModelError:
    """Bounded error of a plant: ``[dF dG] = M Delta [E_f E_g]`` with ``||Delta||_2 <= bound``.

    Args:
        gain: M, (n, q).
        of_state: E_f, (t, n).
        of_noise: E_g, (t, n), seen on the unit noises that drive the plant; None: zeros.
        kind: "scalar": Delta is a number, uniform within the bound, times the unit matrix (q = t); "matrix": a random
            direction of spectral norm uniform below the bound.
        redraw: "step": a new Delta every step; "episode": one for the episode.
        fixed: a number that Delta always is (scalar); None: drawn.
        bound: largest norm, at most 1.
    Raises:
        ValueError: shapes that do not fit, an unknown word, a bound outside (0, 1].
    Source: Sayed (2001), IEEE TAC 46(7), model (8).
    """

    gain: Matrix
    of_state: Matrix
    of_noise: Matrix | None = None
    kind: str = "scalar"
    redraw: str = "step"
    fixed: float | None = None
    bound: float = 1.0

    def __post_init__(self) -> None:
        for name in ("gain", "of_state", "of_noise"):
            given = getattr(self, name)
            if given is not None:
                object.__setattr__(self, name, _matrix(name, given))
        for name, words in (("kind", _KINDS), ("redraw", _REDRAWS)):
            if getattr(self, name) not in words:
                raise ValueError(
                    f"ModelError: {name} must be one of {', '.join(words)}; got {getattr(self, name)!r}. Pick one."
                )
        n, q, t = len(self.gain), len(self.gain[0]), len(self.of_state)
        for name, shape in (("of_state", (t, n)), ("of_noise", (t, n))):
            given = getattr(self, name)
            if given is not None and np.shape(given) != shape:
                raise ValueError(
                    f"ModelError: {name} must have shape {shape} beside gain {(n, q)}; got {np.shape(given)}. "
                    "M is (n, q), E_f and E_g are (t, n)."
                )
        if self.kind == "scalar" and q != t:
            raise ValueError(
                f"ModelError: kind must be 'matrix' for gain with {q} columns and of_state with {t} rows; got "
                "'scalar'. A scalar Delta needs as many of both."
            )
        if not 0.0 < self.bound <= 1.0:
            raise ValueError(f"ModelError: bound must be within (0, 1]; got {self.bound!r}. Scale gain instead.")
        if self.fixed is not None and not (self.kind == "scalar" and abs(self.fixed) <= self.bound):
            raise ValueError(
                f"ModelError: fixed must be a number within +-{self.bound:g} and kind 'scalar'; got {self.fixed!r}. "
                "Use fixed=None to draw it."
            )

    def need(self, steps: int) -> Need:
        """Draws for the Deltas of an episode of ``steps`` steps."""
        if self.fixed is not None:
            return Need()
        count = steps if self.redraw == "step" else 1
        size = len(self.gain[0]) * len(self.of_state)
        return Need(uniforms=count, normals=count * size if self.kind == "matrix" else 0)

    def deltas(self, uniforms: Array, normals: Array) -> Array:
        """Delta (B, K, q, t) from draws of the size of `need`; K = 1 where it stays."""
        q, t = len(self.gain[0]), len(self.of_state)
        if self.fixed is not None:
            return np.broadcast_to(self.fixed * np.eye(q), (len(uniforms), 1, q, q)).copy()
        if self.kind == "scalar":
            return self.bound * (2.0 * uniforms - 1.0)[:, :, None, None] * np.eye(q)
        direction = normals.reshape(*uniforms.shape, q, t)
        norm = np.linalg.norm(direction, ord=2, axis=(-2, -1))
        return np.ascontiguousarray(direction * (self.bound * uniforms / norm)[:, :, None, None])


def _matrix(name: str, given: Any) -> Matrix:
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.ndim != 2 or not array.size or not np.isfinite(array).all():
        raise ValueError(f"ModelError: {name} must be a matrix of finite numbers; got {given!r}. Give rows of numbers.")
    return tuple(tuple(row) for row in array.tolist())
