"""One row at a time without laying anything out anew: the arrays a thread streams through."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.records import Inputs, make_outputs
from jink.estimators.reference import Pinned, pin

__all__ = ["Desk", "make_desk"]

Floats = NDArray[np.float64]


class Desk(NamedTuple):
    """Pinned inputs and outputs of one row of one track, and views of what changes from row to row."""

    inputs: Pinned
    outputs: Pinned
    time: Floats  # (1,) s
    measurement: Floats  # (D,)
    noise: Floats  # (D, D)
    sensor: Floats  # (2A,)


def make_desk(measured: int, kin: int, modes: int) -> Desk:
    """A desk for D measured components, 2A kinematics and M modes."""
    inputs = Inputs(
        np.zeros((1, 1)),
        np.zeros((1, 1, measured)),
        np.zeros((1, 1, measured, measured)),
        np.zeros((1, 1, kin)),
        np.zeros((0, 0, modes, modes)),
        np.zeros(1, dtype=np.int64),
        np.ones(1, dtype=np.int64),
    )
    return Desk(
        pin(inputs),
        pin(make_outputs(1, 1, kin, modes)),
        inputs.times[0],
        inputs.measurements[0, 0],
        inputs.noise[0, 0],
        inputs.sensors[0, 0],
    )
