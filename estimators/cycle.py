"""One step of the bank for one track, and the only loop over time and tracks."""

from __future__ import annotations

import numpy as np
from numba import types

from jink.estimators.compiled import entry_kernel, inner_kernel
from jink.estimators.fusion import bank_nis, fuse, mode_posterior, posterior_nis
from jink.estimators.hedging import hedge
from jink.estimators.interaction import birth, convert, interact, own_prior
from jink.estimators.linalg import copy_matrix, copy_rows, copy_vector
from jink.estimators.markov import transition_matrix
from jink.estimators.modes import predict_mode, update_mode
from jink.estimators.pieces import MATRIX, PROGRAM, STACK, VECTOR, WORK, piece
from jink.estimators.program import RESET, program_at, work_at
from jink.estimators.records import ABSURD, INPUTS, LOCATED, OUTPUTS, RUNNING, STATE, inputs_at, outputs_at
from jink.estimators.reference import by_reference
from jink.estimators.restarting import AGREED, BEGUN, REFUSED, begin_again, refusals_agree, widening
from jink.estimators.soundness import (
    believable_parameters,
    drop_impossible_correlations,
    sound_moments,
    usable_components,
    widen,
)
from jink.estimators.status import DIVERGED, MISSING, OK, REPAIRED, STARTING
from jink.estimators.treatment_kernels import ERRING

__all__ = ["advance", "advance_one", "begin_tracks"]

_LOST_NIS = 25.0
_WORST_NIS, _WORST_JUDGED = 250.0, 50.0
_MEMORY = 0.2
_TOGETHER = 8


@inner_kernel
def _step_chain(program, work, inputs, b, t, dt):
    """Mode transition matrix of this step into ``work.chain``."""
    modes = program.sizes.size
    if inputs.chains.size > 0:
        work.cached_dt[modes] = np.nan
        row = inputs.chains[b if inputs.chains.shape[0] > 1 else 0, t if inputs.chains.shape[1] > 1 else 0]
        copy_matrix(row, work.chain, modes)
    elif program.per_step:
        copy_matrix(program.chain, work.chain, modes)
    elif work.cached_dt[modes] != dt:
        if program.outer_chain.size > 0:
            _product_chain(program, work, dt)
        else:
            transition_matrix(program.chain, dt, modes, work.chain_scratch, work.chain)
        work.cached_dt[modes] = dt


@inner_kernel
def _product_chain(program, work, dt):
    """Transition matrix of independent chains: the Kronecker product of theirs, far cheaper than that of the sum."""
    outer, inner, scratch = work.product_chains[0], work.product_chains[1], work.product_chains[2]
    intents, levels = program.outer_chain.shape[0], program.inner_chain.shape[0]
    transition_matrix(program.outer_chain, dt, intents, scratch, outer)
    transition_matrix(program.inner_chain, dt, levels, scratch, inner)
    for i in range(intents):
        for k in range(intents):
            for a in range(levels):
                for b in range(levels):
                    work.chain[i * levels + a, k * levels + b] = outer[i, k] * inner[a, b]


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
    z = inputs.measurements[b, t]
    R = inputs.noise[b if inputs.noise.shape[0] > 1 else 0, t if inputs.noise.shape[1] > 1 else 0]
    sensor = inputs.sensors[b if inputs.sensors.shape[0] > 1 else 0, t if inputs.sensors.shape[1] > 1 else 0]
    d, clean = usable_components(program, work, z, R, sensor)
    good = good and clean
    shared = program.shared and state.phase[b] == RUNNING  # a prior is still each mode's own
    if state.phase[b] == RUNNING:
        _step_chain(program, work, inputs, b, t, dt)
        good = interact(program, work, mean, cov, probs) and good
    else:
        for j in range(modes):
            work.prior[j] = probs[j]
            for i in range(program.sizes[j]):
                work.mixed_mean[j, i] = mean[j, i]
            copy_rows(cov[j], work.mixed_cov[j], program.sizes[j])
        state.phase[b] = RUNNING
    lost = False
    for j in range(modes):
        leader = program.leader[j] if shared else j
        m, P = work.predicted_mean[leader], work.predicted_cov[leader]
        n = program.sizes[j]
        sound = 2
        if leader == j:
            good = predict_mode(program, work, j, work.mixed_mean[j], work.mixed_cov[j], dt, m, P) and good
            sound = sound_moments(m, P, n, work.mixed_cov[j])
        if sound == 0:
            if not lost:
                widen(state.kin_cov[b])
            lost = True
            birth(program, work, j, state.kin_mean[b], state.kin_cov[b], m, P)
        work.log_density[j] = 0.0
        work.nis[j] = d
        if d > 0:
            if program.treated[j] & ERRING:
                hedge(program, work, j, work.mixed_mean[j], work.mixed_cov[j], sensor, z, d, m, P)
            density, nis, fine = update_mode(program, work, j, m, P, sensor, z, d, mean[j], cov[j])
            work.log_density[j] = density
            work.nis[j] = nis
            sound = sound_moments(mean[j], cov[j], n, P)
            good = good and fine and sound == 2
            if sound != 0:
                good = believable_parameters(program, j, mean[j], cov[j]) and good
            if sound == 0:
                if not lost:
                    widen(state.kin_cov[b])
                lost = True
                birth(program, work, j, state.kin_mean[b], state.kin_cov[b], mean[j], cov[j])
                work.log_density[j] = -np.inf
            elif np.isfinite(nis):
                state.nis_average[b, j] += _MEMORY * (min(nis / d, _WORST_NIS) - state.nis_average[b, j])
        else:
            good = good and sound == 2
            for i in range(n):
                mean[j, i] = m[i]
            copy_rows(P, cov[j], n)
    status, found, widen_by = OK, 0, 1.0
    if d > 0:
        nis, fine = posterior_nis(work, modes) if program.levelled else bank_nis(work, work.S_modes, modes, d)
        log_likelihood = mode_posterior(program, work, modes, probs)
        if not np.isfinite(log_likelihood):
            log_likelihood = -ABSURD
            good = False
        if fine:
            worst = _WORST_JUDGED if program.forgiving else _WORST_NIS
            state.nis_average[b, modes] += _MEMORY * (min(nis / d, worst) - state.nis_average[b, modes])
        else:
            nis = 0.0
            good = False
        outputs.log_likelihood[b, t] = log_likelihood
        outputs.nis[b, t] = nis
        outputs.nis_dof[b, t] = d
        if program.watched:
            calm, fine = bank_nis(work, work.S_calm, modes, d)
            if fine:
                found = refusals_agree(state.refusals[b], work.whitened, work.present, calm, d)
                widen_by = widening(program, work.sensed, work.S, work.R, program.calm, d, work)
        if program.rule == RESET:
            good = _restart_poor_modes(program, work, mean, cov, probs, state.nis_average[b]) and good
    else:
        copy_vector(work.prior, probs)
        outputs.log_likelihood[b, t] = 0.0
        outputs.nis[b, t] = 0.0
        outputs.nis_dof[b, t] = 0
        status = MISSING
    astray = found & AGREED != 0
    good = fuse(program, work, mean, cov, probs, state.kin_mean[b], state.kin_cov[b]) and good
    if not good:
        status = REPAIRED
    if lost or astray or state.nis_average[b, modes] > _LOST_NIS:
        status = DIVERGED
    if status in (REPAIRED, DIVERGED):
        drop_impossible_correlations(work, state.kin_cov[b])
    again = astray and program.restart and begin_again(program, work, state, b, widen_by)
    outputs.refused[b, t] = BEGUN if again else found & REFUSED
    outputs.status[b, t] = status


@inner_kernel
def _row(program, work, state, inputs, outputs, b, t):
    """One step, or the row at which a start from measurements is itself the estimate."""
    if state.phase[b] == LOCATED:
        outputs.status[b, t] = STARTING
        state.phase[b] = RUNNING
    else:
        step(program, work, state, inputs, outputs, b, t)


@inner_kernel
def _write(state, outputs, history, b, t):
    copy_vector(state.kin_mean[b], outputs.kin_mean[b, t])
    copy_matrix(state.kin_cov[b], outputs.kin_cov[b, t], state.kin_cov.shape[1])
    copy_vector(state.mode_probs[b], outputs.mode_probs[b, t])
    if history.mean.shape[1] > 0:
        copy_matrix(state.mean[b], history.mean[b, t], state.mean.shape[1])
        for j in range(state.mean.shape[1]):
            copy_rows(state.cov[b, j], history.cov[b, t, j], state.mean.shape[2])


@entry_kernel
def advance(program_handle, work_handle, state, inputs, outputs, history, begin, end):
    """Run tracks ``begin`` to ``end`` through all their rows, writing into ``state``, ``outputs`` and ``history``.

    A few tracks go through time together: those that share their times share the tables of each time step.
    """
    program, work = program_at(program_handle), work_at(work_handle)
    states, rows, results, kept = (
        by_reference(state),
        by_reference(inputs),
        by_reference(outputs),
        by_reference(history),
    )
    for low in range(begin, end, _TOGETHER):
        high = min(low + _TOGETHER, end)
        earliest, latest = inputs.first[low], inputs.lengths[low]
        for b in range(low + 1, high):
            earliest, latest = min(earliest, inputs.first[b]), max(latest, inputs.lengths[b])
        for t in range(earliest, latest):
            for b in range(low, high):
                if not inputs.first[b] <= t < inputs.lengths[b]:
                    continue
                _row(program, work, states, rows, results, b, t)
                _write(states, results, kept, b, t)


@entry_kernel
def advance_one(program_handle, work_handle, inputs_handle, outputs_handle, state):
    """One row of one track, for streaming: inputs and outputs are laid out once and enter as integers."""
    outputs = outputs_at(outputs_handle)
    program, work, states = program_at(program_handle), work_at(work_handle), by_reference(state)
    _row(program, work, states, inputs_at(inputs_handle), outputs, 0, 0)


@entry_kernel
def begin_tracks(program_handle, work_handle, kin_mean, kin_cov, chosen, state):
    """Begin the ``chosen`` modes (M,) of every track at a position and velocity: a start is a birth of all intents."""
    program, work = program_at(program_handle), work_at(work_handle)
    for b in range(state.mean.shape[0]):
        for j in range(state.mean.shape[1]):
            if chosen[j]:
                birth(program, work, j, kin_mean[b], kin_cov[b], state.mean[b, j], state.cov[b, j])
        copy_vector(kin_mean[b], state.kin_mean[b])
        copy_matrix(kin_cov[b], state.kin_cov[b], state.kin_cov.shape[1])
