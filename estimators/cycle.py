"""One step of the bank for one track, and the only loop over time and tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from jink.estimators.compiled import entry_kernel, inner_kernel
from jink.estimators.interaction import birth, convert, interact, own_prior
from jink.estimators.linalg import cholesky, copy_matrix, copy_vector, total
from jink.estimators.markov import transition_matrix
from jink.estimators.modes import mode_kinematics, predict_mode, update_mode
from jink.estimators.pieces import MATRIX, PROGRAM, STACK, VECTOR, WORK, piece
from jink.estimators.program import RESET, program_at, work_at
from jink.estimators.reference import by_reference, record_type
from jink.estimators.status import DIVERGED, MISSING, OK, REPAIRED, STARTING

__all__ = [
    "ABSURD",
    "DIVERGED",
    "MISSING",
    "OK",
    "REPAIRED",
    "STARTING",
    "History",
    "Inputs",
    "Outputs",
    "State",
    "advance",
    "make_outputs",
    "make_state",
]


PRIOR, RUNNING, LOCATED = range(3)

ABSURD = 1e30
"""No measurement, place or mean is this large: such numbers are broken, and their squares must stay finite."""
_LOST_NIS = 25.0
_WORST_NIS = 250.0
_MEMORY = 0.2
_FLOOR = 1e-14
_ROUNDED = 1e-9

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
    )


def make_state(tracks: int, modes: int, states: int, kin: int) -> State:
    """A state of B tracks, M modes, N padded components, 2A kinematics, about which nothing is known."""
    return State(
        mean=np.zeros((tracks, modes, states)),
        cov=np.zeros((tracks, modes, states, states)),
        mode_probs=np.full((tracks, modes), 1.0 / max(modes, 1)),
        kin_mean=np.zeros((tracks, kin)),
        kin_cov=np.zeros((tracks, kin, kin)),
        nis_average=np.ones((tracks, modes + 1)),
        time=np.zeros(tracks),
        phase=np.full(tracks, RUNNING, dtype=np.int64),
        layout=np.zeros(1, dtype=np.int64),
    )


def _example_inputs() -> Inputs:
    four, indices = np.zeros((0, 0, 0, 0)), np.zeros(0, dtype=np.int64)
    return Inputs(np.zeros((0, 0)), np.zeros((0, 0, 0)), four, np.zeros((0, 0, 0)), four, indices, indices)


STATE = record_type("state", lambda: make_state(0, 0, 0, 0))
INPUTS = record_type("inputs", _example_inputs)
OUTPUTS = record_type("outputs", lambda: make_outputs(0, 0, 0, 0))


@inner_kernel
def _step_chain(program, work, inputs, b, t, dt):
    """Mode transition matrix of this step into ``work.chain``."""
    modes = program.sizes.size
    if inputs.chains.size > 0:
        row = inputs.chains[b if inputs.chains.shape[0] > 1 else 0, t if inputs.chains.shape[1] > 1 else 0]
        copy_matrix(row, work.chain, modes)
    elif program.per_step:
        copy_matrix(program.chain, work.chain, modes)
    elif work.cached_dt[modes] != dt:
        transition_matrix(program.chain, dt, modes, work.chain_scratch, work.chain)
        work.cached_dt[modes] = dt


@inner_kernel
def _present(program, work, z, R, sensor):
    """How many components can be used, and whether any was refused; fills ``work.present``, ``work.R``."""
    present, noise = work.present, work.R
    d = 0
    clean = True
    placed = True
    if not program.sensor_linear:
        for i in range(sensor.size):
            placed = placed and abs(sensor[i]) < ABSURD
    for i in range(z.size):
        usable = abs(z[i]) < ABSURD and placed
        variance = R[i, i]
        sound = np.isfinite(variance) and variance > 0.0
        if usable and sound:
            present[d] = i
            d += 1
        if not np.isnan(z[i]) and not (usable and sound):
            clean = False
    coupled = False
    for a in range(d):
        noise[a, a] = R[present[a], present[a]]
        for b in range(a):
            entry, twin = R[present[a], present[b]], R[present[b], present[a]]
            if not abs(entry - twin) <= _ROUNDED * (abs(entry) + abs(twin)):
                entry = 0.0
                clean = False
            noise[a, b] = noise[b, a] = entry
            coupled = coupled or entry != 0.0
    if coupled and not cholesky(noise, d, work.factor):
        clean = False
        for a in range(d):
            for b in range(a):
                noise[a, b] = noise[b, a] = 0.0
    return d, clean


@inner_kernel
def _sound(m, P, n, P_before):
    """Whether numbers are usable (0 no, 1 yes after repair, 2 yes); a variance lost to rounding gets a floor."""
    result = 2
    size = 0.0
    for i in range(n):
        size += abs(m[i]) + abs(P[i, i])
    if not size < ABSURD * ABSURD or not np.isfinite(total(P, n)):
        return 0
    for i in range(n):
        if P[i, i] < 0.0 or (P[i, i] == 0.0 and P_before[i, i] > 0.0):
            for k in range(n):
                P[i, k] = 0.0
                P[k, i] = 0.0
            P[i, i] = max(_FLOOR * abs(P_before[i, i]), 0.0)
            result = 1
    return result


@inner_kernel
def _widen(kin_cov):
    """Ten times the standard deviations, within what numbers bear."""
    size = 0.0
    for a in range(kin_cov.shape[0]):
        size = max(size, kin_cov[a, a])
    if size < ABSURD:  # all or nothing: a covariance scaled in parts is none
        for a in range(kin_cov.shape[0]):
            for b in range(kin_cov.shape[0]):
                kin_cov[a, b] *= 100.0


@inner_kernel
def _bank_nis(work, modes, d):
    """Innovation of the whole bank squared over its covariance: moments of the mixture of predicted measurements."""
    prior, innovation, S_modes, S = work.prior, work.innovation, work.S_modes, work.S
    mean, factor, whitened = work.sensed, work.factor, work.whitened
    for a in range(d):
        value = 0.0
        for j in range(modes):
            value += prior[j] * innovation[j, a]
        mean[a] = value
    for a in range(d):
        for b in range(d):
            value = 0.0
            for j in range(modes):
                da = innovation[j, a] - mean[a]
                db = innovation[j, b] - mean[b]
                value += prior[j] * (S_modes[j, a, b] + da * db)
            S[a, b] = value
    if not cholesky(S, d, factor):
        return 0.0, False
    nis = 0.0
    for a in range(d):
        value = mean[a]
        for k in range(a):
            value -= factor[k, a] * whitened[k, 0]
        if not factor[a, a] > 0.0:
            return 0.0, False
        whitened[a, 0] = value / factor[a, a]
        nis += whitened[a, 0] * whitened[a, 0]
    return nis, np.isfinite(nis)


@inner_kernel
def _mode_posterior(program, work, modes, probs):
    """Mode probabilities ``prior_j exp(log_density_j) / sum``, floored; returns the log likelihood of the bank.

    The largest log density is taken out first, so nothing under- or overflows. A mode with zero prior stays at zero.
    """
    prior, log_density = work.prior, work.log_density
    top = -np.inf
    for j in range(modes):
        if prior[j] > 0.0:
            top = max(top, log_density[j])
    if not abs(top) < np.inf:
        copy_vector(prior, probs)
        return top
    mass = 0.0
    for j in range(modes):
        probs[j] = prior[j] * np.exp(log_density[j] - top) if prior[j] > 0.0 else 0.0
        mass += probs[j]
    log_likelihood = top + np.log(mass)
    floored = 0.0
    for j in range(modes):
        probs[j] /= mass
        if probs[j] < program.min_prob and prior[j] > 0.0:
            probs[j] = program.min_prob
        floored += probs[j]
    for j in range(modes):
        probs[j] /= floored
    return log_likelihood


@piece(types.boolean, PROGRAM, WORK, MATRIX, STACK, VECTOR, VECTOR, MATRIX)
def fuse(program, work, mean, cov, probs, kin_mean, kin_cov):
    """Moments of the bank's position and velocity; returns whether all went well."""
    modes, kin = program.sizes.size, kin_mean.size
    means, covs = work.kin_modes, work.kin_covs
    good = True
    for a in range(kin):
        kin_mean[a] = 0.0
    for j in range(modes):
        good = mode_kinematics(program, work, j, mean[j], cov[j], means[j], covs[j]) and good
        for a in range(kin):
            kin_mean[a] += probs[j] * means[j, a]
    for a in range(kin):
        for b in range(kin):
            value = 0.0
            for j in range(modes):
                value += probs[j] * (covs[j, a, b] + (means[j, a] - kin_mean[a]) * (means[j, b] - kin_mean[b]))
            kin_cov[a, b] = value
    return good


@piece(types.boolean, PROGRAM, WORK, MATRIX, STACK, VECTOR, VECTOR)
def _restart_poor_modes(program, work, mean, cov, probs, nis_average):
    """Rule ``reset``: a mode that lost is begun again from the best one."""
    modes = probs.size
    best = 0
    for j in range(modes):
        if probs[j] > probs[best]:
            best = j
    good = True
    for p in range(modes):
        if p != best and (probs[p] < program.reset_prob or nis_average[p] > program.reset_nis):
            own_prior(program, p, mean[p], cov[p], True, work.own_mean, work.own_cov)
            good = (
                convert(
                    program, work, p, best, mean[best], cov[best], work.own_mean, work.own_cov, mean[p],
                    work.part_mean[p], work.part_cov[p],
                )
                and good
            )  # fmt: skip
            for i in range(program.sizes[p]):
                mean[p, i] = work.part_mean[p, i]
                for k in range(cov.shape[2]):
                    cov[p, i, k] = work.part_cov[p, i, k]
            nis_average[p] = 1.0
    return good


@piece(types.void, PROGRAM, WORK, STATE, INPUTS, OUTPUTS, types.int64, types.int64)
def step(program, work, state, inputs, outputs, b, t):
    """Interaction, prediction, update, probabilities and fusion for track ``b`` at row ``t``.

    Source: Blom & Bar-Shalom (1988). Differs: logs, unlike states, partial and missing measurements
    (which leave probabilities at their prediction), and a status instead of an exception.
    """
    modes = program.sizes.size
    mean, cov, probs = state.mean[b], state.cov[b], state.mode_probs[b]
    good = True
    now = inputs.times[b if inputs.times.shape[0] > 1 else 0, t]
    dt = now - state.time[b]
    if not (dt >= 0.0 and dt < ABSURD):
        dt = 0.0
        good = False
    else:
        state.time[b] = now
    if state.phase[b] == RUNNING:
        _step_chain(program, work, inputs, b, t, dt)
        good = interact(program, work, mean, cov, probs) and good
    else:
        for j in range(modes):
            work.prior[j] = probs[j]
            for i in range(program.sizes[j]):
                work.mixed_mean[j, i] = mean[j, i]
            copy_matrix(cov[j], work.mixed_cov[j], program.sizes[j])
        state.phase[b] = RUNNING
    z = inputs.measurements[b, t]
    R = inputs.noise[b if inputs.noise.shape[0] > 1 else 0, t if inputs.noise.shape[1] > 1 else 0]
    sensor = inputs.sensors[b if inputs.sensors.shape[0] > 1 else 0, t if inputs.sensors.shape[1] > 1 else 0]
    d, clean = _present(program, work, z, R, sensor)
    good = good and clean
    lost = False
    for j in range(modes):
        m, P = work.predicted_mean[j], work.predicted_cov[j]
        n = program.sizes[j]
        good = predict_mode(program, work, j, work.mixed_mean[j], work.mixed_cov[j], dt, m, P) and good
        sound = _sound(m, P, n, work.mixed_cov[j])
        if sound == 0:
            if not lost:
                _widen(state.kin_cov[b])
            lost = True
            birth(program, work, j, state.kin_mean[b], state.kin_cov[b], m, P)
        work.log_density[j] = 0.0
        if d > 0:
            density, nis, fine = update_mode(program, work, j, m, P, sensor, z, d, mean[j], cov[j])
            work.log_density[j] = density
            sound = _sound(mean[j], cov[j], n, P)
            good = good and fine and sound == 2
            if sound == 0:
                if not lost:
                    _widen(state.kin_cov[b])
                lost = True
                birth(program, work, j, state.kin_mean[b], state.kin_cov[b], mean[j], cov[j])
                work.log_density[j] = -np.inf
            elif np.isfinite(nis):
                state.nis_average[b, j] += _MEMORY * (min(nis / d, _WORST_NIS) - state.nis_average[b, j])
        else:
            good = good and sound == 2
            for i in range(n):
                mean[j, i] = m[i]
            copy_matrix(P, cov[j], n)
    status = OK
    if d > 0:
        nis, fine = _bank_nis(work, modes, d)
        log_likelihood = _mode_posterior(program, work, modes, probs)
        if not np.isfinite(log_likelihood):
            log_likelihood = -ABSURD
            good = False
        if fine:
            state.nis_average[b, modes] += _MEMORY * (min(nis / d, _WORST_NIS) - state.nis_average[b, modes])
        else:
            nis = 0.0
            good = False
        outputs.log_likelihood[b, t] = log_likelihood
        outputs.nis[b, t] = nis
        outputs.nis_dof[b, t] = d
        if program.rule == RESET:
            good = _restart_poor_modes(program, work, mean, cov, probs, state.nis_average[b]) and good
    else:
        copy_vector(work.prior, probs)
        outputs.log_likelihood[b, t] = 0.0
        outputs.nis[b, t] = 0.0
        outputs.nis_dof[b, t] = 0
        status = MISSING
    good = fuse(program, work, mean, cov, probs, state.kin_mean[b], state.kin_cov[b]) and good
    if not good:
        status = REPAIRED
    if lost or state.nis_average[b, modes] > _LOST_NIS:
        status = DIVERGED
    outputs.status[b, t] = status


@inner_kernel
def _write(state, outputs, history, b, t):
    copy_vector(state.kin_mean[b], outputs.kin_mean[b, t])
    copy_matrix(state.kin_cov[b], outputs.kin_cov[b, t], state.kin_cov.shape[1])
    copy_vector(state.mode_probs[b], outputs.mode_probs[b, t])
    if history.mean.shape[1] > 0:
        copy_matrix(state.mean[b], history.mean[b, t], state.mean.shape[1])
        for j in range(state.mean.shape[1]):
            copy_matrix(state.cov[b, j], history.cov[b, t, j], state.mean.shape[2])


@entry_kernel
def advance(program_handle, work_handle, state, inputs, outputs, history, begin, end):
    """Run tracks ``begin`` to ``end`` through all their rows, writing into ``state``, ``outputs`` and ``history``."""
    program, work = program_at(program_handle), work_at(work_handle)
    states, rows, results, kept = (
        by_reference(state),
        by_reference(inputs),
        by_reference(outputs),
        by_reference(history),
    )
    for b in range(begin, end):
        work.cached_dt[work.cached_dt.size - 1] = (
            np.nan
        )  # the chain's scratch is shared with forced chains and forecasts
        for t in range(inputs.first[b], inputs.lengths[b]):
            if state.phase[b] == LOCATED:  # the start's own position and velocity are the estimate
                outputs.status[b, t] = STARTING
                state.phase[b] = RUNNING
            else:
                step(program, work, states, rows, results, b, t)
            _write(states, results, kept, b, t)


@entry_kernel
def begin_tracks(program_handle, work_handle, kin_mean, kin_cov, state):
    """Begin every mode of every track at its position and velocity: a start is a birth of all intents."""
    program, work = program_at(program_handle), work_at(work_handle)
    for b in range(state.mean.shape[0]):
        for j in range(state.mean.shape[1]):
            birth(program, work, j, kin_mean[b], kin_cov[b], state.mean[b, j], state.cov[b, j])
        copy_vector(kin_mean[b], state.kin_mean[b])
        copy_matrix(kin_cov[b], state.kin_cov[b], state.kin_cov.shape[1])
