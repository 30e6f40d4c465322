"""What travels in and out of the compiled cycle: state, inputs, outputs and history of B tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.reference import record_type, reference_reader

__all__ = [
    "ABSURD",
    "INPUTS",
    "LOCATED",
    "OUTPUTS",
    "PRIOR",
    "RUNNING",
    "STATE",
    "History",
    "Inputs",
    "Outputs",
    "State",
    "inputs_at",
    "make_outputs",
    "make_state",
    "outputs_at",
]

PRIOR, RUNNING, LOCATED = range(3)

ABSURD = 1e30
"""No measurement, place or mean is this large: such numbers are broken, and their squares must stay finite."""

Floats = NDArray[np.float64]


class State(NamedTuple):
    """Everything a bank knows about B tracks between two steps (a value: steps return a new one).

    ``kin_mean``, ``kin_cov`` are the fused position and velocity; ``time`` is the last time seen; ``phase`` is
    `PRIOR` before the first update of a given prior, `LOCATED` right after a start from measurements, else `RUNNING`.
    """

    mean: Floats  # (B, M, N)
    cov: Floats  # (B, M, N, N)
    mode_probs: Floats  # (B, M)
    kin_mean: Floats  # (B, 2A)
    kin_cov: Floats  # (B, 2A, 2A)
    nis_average: Floats  # (B, M + 1) running mean of NIS per component: each mode, then the bank
    refusals: Floats  # (B, 2 + D) of refused measurements: see `restarting.refusals_agree`
    time: Floats  # (B,)
    phase: NDArray[np.int64]  # (B,)
    layout: NDArray[np.int64]  # (1,) which bank's components these are


class Inputs(NamedTuple):
    """Measurements of B tracks; axes of length 1 are shared by all tracks or times; size 0 means absent."""

    times: Floats  # (1 or B, T)
    measurements: Floats  # (B, T, D)
    noise: Floats  # (1 or B, 1 or T, D, D)
    sensors: Floats  # (1 or B, 1 or T, 2A)
    chains: Floats  # (0, 0, M, M) or (1 or B, 1 or T, M, M): mode transition of each step
    first: NDArray[np.int64]  # (B,) first row to process
    lengths: NDArray[np.int64]  # (B,) one past the last


class Outputs(NamedTuple):
    """What every estimator reports, per track and time."""

    kin_mean: Floats  # (B, T, 2A)
    kin_cov: Floats  # (B, T, 2A, 2A)
    mode_probs: Floats  # (B, T, M)
    log_likelihood: Floats  # (B, T)
    nis: Floats  # (B, T)
    nis_dof: NDArray[np.int64]  # (B, T)
    status: NDArray[np.int8]  # (B, T)
    refused: NDArray[np.int8]  # (B, T) 1: measurement refused, 2: and the bank began again; see `restarting`


class History(NamedTuple):
    """Filtered mode states of every step, for the smoothers; time axis of length 0 when not wanted."""

    mean: Floats  # (B, T, M, N)
    cov: Floats  # (B, T, M, N, N)


def make_outputs(tracks: int, rows: int, kin: int, modes: int) -> Outputs:
    """Empty outputs of B tracks, T rows, 2A kinematics, M modes."""
    return Outputs(
        kin_mean=np.zeros((tracks, rows, kin)),
        kin_cov=np.zeros((tracks, rows, kin, kin)),
        mode_probs=np.zeros((tracks, rows, modes)),
        log_likelihood=np.zeros((tracks, rows)),
        nis=np.zeros((tracks, rows)),
        nis_dof=np.zeros((tracks, rows), dtype=np.int64),
        status=np.zeros((tracks, rows), dtype=np.int8),
        refused=np.zeros((tracks, rows), dtype=np.int8),
    )


def make_state(tracks: int, modes: int, states: int, kin: int, measured: int) -> State:
    """A state of B tracks about which nothing is known: M modes, N padded components, 2A kinematics, D measured."""
    return State(
        mean=np.zeros((tracks, modes, states)),
        cov=np.zeros((tracks, modes, states, states)),
        mode_probs=np.full((tracks, modes), 1.0 / max(modes, 1)),
        kin_mean=np.zeros((tracks, kin)),
        kin_cov=np.zeros((tracks, kin, kin)),
        nis_average=np.ones((tracks, modes + 1)),
        refusals=np.zeros((tracks, 2 + measured)),
        time=np.zeros(tracks),
        phase=np.full(tracks, RUNNING, dtype=np.int64),
        layout=np.zeros(1, dtype=np.int64),
    )


def _example_inputs() -> Inputs:
    four, indices = np.zeros((0, 0, 0, 0)), np.zeros(0, dtype=np.int64)
    return Inputs(np.zeros((0, 0)), np.zeros((0, 0, 0)), four, np.zeros((0, 0, 0)), four, indices, indices)


STATE = record_type("state", lambda: make_state(0, 0, 0, 0, 0))
INPUTS = record_type("inputs", _example_inputs)
OUTPUTS = record_type("outputs", lambda: make_outputs(0, 0, 0, 0))
inputs_at = reference_reader(INPUTS)
outputs_at = reference_reader(OUTPUTS)
