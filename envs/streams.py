"""Randomness as data: named streams from one seed, drawn in whole blocks.

Every episode of one target draws from four generators, so that no choice about the sensor can move the target:
``motion`` (the trajectory), ``times`` (when it is looked at), ``surge`` and ``sensor``. Kernels receive draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["STREAMS", "Draws", "Need", "Streams", "draw", "make_streams"]

STREAMS = ("motion", "times", "surge", "sensor")
Streams = tuple[np.random.Generator, ...]
"""One generator per name of `STREAMS`."""


class Need(NamedTuple):
    """How many draws one episode of one target takes from a stream; always the same number for a scenario."""

    uniforms: int = 0
    normals: int = 0


class Draws(NamedTuple):
    """One row per episode."""

    uniforms: NDArray[np.float64]  # (B, U) in [0, 1)
    normals: NDArray[np.float64]  # (B, Z) standard normal


def make_streams(generator: np.random.Generator) -> Streams:
    """The streams of one target; the same generator state and spawn count give the same streams."""
    return tuple(generator.spawn(len(STREAMS)))


def draw(generators: Sequence[np.random.Generator], need: Need) -> Draws:
    """One block of draws per generator: row ``b`` comes from ``generators[b]`` alone."""
    uniforms = np.empty((len(generators), need.uniforms))
    normals = np.empty((len(generators), need.normals))
    for row, generator in enumerate(generators):
        if need.uniforms:
            generator.random(out=uniforms[row])
        if need.normals:
            generator.standard_normal(out=normals[row])
    return Draws(uniforms, normals)
