"""The two-state example on which robust filters are compared."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.flight.model_error import ModelError
from jink.envs.plants import check_draws, run_error_plant
from jink.envs.streams import Draws, Need

__all__ = ["ROBUST_EXAMPLE", "RobustRun", "robust_example_need", "simulate_robust_example"]

Array = NDArray[np.float64]


class RobustRun(NamedTuple):
    """Runs of the robust filter's example: B runs, T samples."""

    state: Array  # (B, T, 2)
    measurements: Array  # (B, T, 1)
    delta: Array  # (B, T - 1 or 1)


_F = np.array([[0.9802, 0.0196], [0.0, 0.9802]])
_Q = np.array([[1.9608, 0.0195], [0.0195, 1.9605]])
_H = np.array([[1.0, -1.0]])
ROBUST_EXAMPLE = ModelError(gain=((0.0198,), (0.0,)), of_state=((0.0, 5.0),))
"""Model error of the example; replace ``redraw`` or ``fixed`` for one Delta per episode."""


def robust_example_need(steps: int, error: ModelError = ROBUST_EXAMPLE) -> Need:
    """Draws of one run of ``steps`` samples of `simulate_robust_example`."""
    extra = error.need(steps - 1)
    return Need(uniforms=extra.uniforms, normals=3 * steps + extra.normals)


def simulate_robust_example(steps: int, draws: Draws, error: ModelError = ROBUST_EXAMPLE) -> RobustRun:
    """The two-state example on which robust filters are compared; no position and velocity, so no `Motion`.

    Model: ``x+ = (F + M Delta E_f) x + u``, ``z = (1, -1) x + v``, ``cov u = Q``, ``var v = 1``, ``x[0]`` unit normal.

    Args:
        steps: samples T >= 1.
        draws: rows of the size of `robust_example_need`.
        error: Delta's distribution; `dataclasses.replace` `ROBUST_EXAMPLE`.
    Returns:
        `RobustRun`.
    Raises:
        ValueError: no steps, draws of another size, or an error of another plant.
    Source: Xie, Soh, de Souza (1994); Sayed (2001) section VI. Differs: none.
    """
    if steps < 1:
        raise ValueError(f"simulate_robust_example: steps must be 1 or more; got {steps!r}. Count the samples.")
    if len(error.gain) != 2:
        raise ValueError(
            f"simulate_robust_example: error must act on 2 states; got a gain of {len(error.gain)} rows. "
            "Replace fields of ROBUST_EXAMPLE."
        )
    B = len(draws.normals)
    check_draws("simulate_robust_example", draws, robust_example_need(steps, error), B)
    normals = draws.normals
    states = np.empty((B, steps, 2))
    states[:, 0] = normals[:, :2]
    noise = np.ascontiguousarray(normals[:, 2 : 2 * steps]).reshape(B, steps - 1, 2)
    delta = error.deltas(draws.uniforms, normals[:, 3 * steps :])
    gain = np.linalg.cholesky(_Q)
    run_error_plant(np.ones((B, steps - 1)), 0, 0.0, _F, gain, error, delta, noise, states)
    z = states @ _H.T + normals[:, 2 * steps : 3 * steps, None]
    return RobustRun(states, z, delta[:, :, 0, 0])
