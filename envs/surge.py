"""What a noise surge is: what makes a measurement worse than its nominal covariance says.

Model: the error of sample k is ``N(bias_k sigma, scale_k R)`` with R = diag(sigma^2) the sensor's nominal
covariance, unless the sample is missed. A surge changes scale, bias or detection of whole episodes; several combine:
scales multiply, biases add, a sample is detected if all agree. A surge is a frozen dataclass; its draws are data.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from jink.envs.streams import Draws, Need

__all__ = ["CompiledSurge", "Surge"]

Array = NDArray[np.float64]


class Surge(Protocol):
    """A frozen, validated dataclass that changes the noise of episodes."""

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: ``steps`` samples, at most ``duration`` seconds, ``size`` components."""
        ...

    def apply(self, times: Array, draws: Draws, scale: Array, bias: Array, detected: NDArray[np.bool_]) -> None:
        """Change scale (B, T), bias (B, T, D) [nominal sigmas] and detected (B, T) of episodes in place."""
        ...


class CompiledSurge:
    """A surge whose law is compiled: what the kinds share."""

    _law: ClassVar[Callable[..., None]]

    def _params(self) -> tuple[float, ...]:
        """What the law is told."""
        raise NotImplementedError

    def apply(self, times: Array, draws: Draws, scale: Array, bias: Array, detected: NDArray[np.bool_]) -> None:
        """Change scale (B, T), bias (B, T, D) [nominal sigmas] and detected (B, T) of episodes in place."""
        params = np.array(self._params(), dtype=np.float64)
        type(self)._law(times, draws.uniforms, draws.normals, params, scale, bias, detected)
