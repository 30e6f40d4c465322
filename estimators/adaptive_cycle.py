"""One step of a one-mode bank that learns or chooses its noise, and the loop over time and tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jink.estimators.adaptive_noise import (
    bounded,
    coloured,
    process_factor,
    sage_husa,
    spread_to_absent,
    variational,
    whitened,
)
from jink.estimators.agent.updating import agent_loses, agent_moves, agent_skip, agent_update, forget
from jink.estimators.compiled import entry_kernel, inner_kernel
from jink.estimators.factors import normalised_innovation
from jink.estimators.fusion import fuse
from jink.estimators.interaction import birth
from jink.estimators.kalman import gaussian_update
from jink.estimators.linalg import cholesky, clear_rows, copy_matrix, copy_rows, copy_vector, padded, solve_lower
from jink.estimators.modes import careful_covariance, measure_mode, predict_mode
from jink.estimators.program import program_at, work_at
from jink.estimators.records import ABSURD, LOCATED, RUNNING
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

__all__ = ["AGENT", "LEARNT", "PROCESS", "RATIO", "SAGE_HUSA", "VARIATIONAL", "WEIGHT", "Settings", "advance"]

SAGE_HUSA, VARIATIONAL, AGENT = range(3)
LEARNT = 2
"""Columns of ``State.nis_average`` that are the bank's own; the learnt ones, or what an agent remembers, follow."""
WEIGHT, PROCESS, RATIO = range(3)
"""Learnt columns: weight w, factor on Q, and from here on the ratio A, row by row."""
_LOST_NIS, _WORST_NIS, _MEMORY = 25.0, 50.0, 0.2
_MATRICES = 13


class Settings(NamedTuple):
    """What the kernels read of a `NoiseAdaptation`."""

    method: int
    forgetting: float
    floor: float
    ceiling: float
    start_weight: float
    iterations: int
    measurement: bool
    process: bool
    restart: bool


@inner_kernel
def _forget_all(settings, learnt, size):
    if settings.method == AGENT:
        forget(learnt, size)
        return
    learnt[WEIGHT], learnt[PROCESS] = settings.start_weight, 1.0
    for i in range(size):
        for k in range(size):
            learnt[RATIO + i * size + k] = 1.0 if i == k else 0.0


@inner_kernel
def _update(settings, program, work, learnt, refusals, room, m, P, sensor, z, d, m_out, P_out):
    """Learn the noise from the ``d`` components present, then update with it.

    Model: `adaptive_noise.sage_husa` or `adaptive_noise.variational`, then the update every Gaussian mode ends with.
    Log density and NIS are those of the prediction: with the noise as it was known before.

    Returns:
        (log density, NIS, whether all went well, what `refusals_agree` found, and how much to widen then).
    """
    n, size = program.sizes[0], z.size
    given, U, C, A, before, used, ratio = room[0], room[1], room[2], room[3], room[4], room[5], room[6]
    v, r = room[7, 0], room[7, 1]
    one, two, three, four = room[8], room[9], room[10], room[11]
    copy_rows(work.R, given, d)
    clear_rows(work.R, d)
    linear, good = measure_mode(program, work, 0, m, P, sensor, z, d)
    copy_rows(work.S, three, d)
    good = cholesky(given, d, U) and good
    whitened(U, three, d, one, C)
    clear_rows(two, d)
    for a in range(d):
        two[a, 0] = work.innovation[0, a]
    solve_lower(U, d, two, 1)
    for a in range(d):
        v[a] = two[a, 0]
    clear_rows(A, d)
    present = work.present
    for i in range(size):
        for k in range(size):
            ratio[i, k] = learnt[RATIO + i * size + k]
    for a in range(d):
        for c in range(d):
            A[a, c] = ratio[present[a], present[c]]
    copy_rows(A, before, d)
    copy_rows(A, used, d)
    for a in range(d):
        for c in range(d):
            work.S[a, c] = three[a, c] + given[a, c]
    found, widen_by = 0, 1.0
    nominal = normalised_innovation(work.innovation[0], three, given, 1.0, d, work.statistic)
    if np.isfinite(nominal):
        found = refusals_agree(refusals, work.statistic[d:], present, nominal, d)
        widen_by = widening(program, work.innovation[0], work.S, given, 1.0, d, work)
    log_density = predicted_nis = 0.0
    lost = False
    weight = settings.forgetting * learnt[WEIGHT] + 1.0
    gain = 1.0 / weight
    for learns in (True, False):  # the update twice: with the noise known before, for its density, and with that learnt
        coloured(U, used, d, one, work.R)
        copy_rows(three, work.S, d)
        for a in range(d):
            for c in range(d):
                work.S[a, c] += work.R[a, c]
        density, nis, fine, lost = gaussian_update(
            m, P, work.R, work.cross, work.S, work.innovation[0], d, n,
            work.factor, work.gain, work.whitened, m_out, P_out,
        )  # fmt: skip
        good = good and fine
        if not learns:
            break
        log_density, predicted_nis = density, nis
        if settings.method == VARIATIONAL:
            good = variational(v, C, d, gain, settings.iterations, A, used, room[12], one, two, four, r) and good
        else:
            sage_husa(v, C, d, gain if settings.measurement else 0.0, A)
        if bounded(A, d, settings.floor, settings.ceiling, one, two, four):
            learnt[WEIGHT] = weight
            spread_to_absent(ratio, before, A, present, d, one, two)
            for i in range(size):
                for k in range(size):
                    learnt[RATIO + i * size + k] = ratio[i, k]
            if settings.method == SAGE_HUSA:
                copy_rows(A, used, d)
        else:
            _forget_all(settings, learnt, size)
            copy_rows(before, used, d)
            good = False
    if settings.process:
        factor = process_factor(m, m_out, work.gain, work.Q[0], n, d, gain, learnt[PROCESS])
        if np.isfinite(factor):
            learnt[PROCESS] = min(max(factor, settings.floor), settings.ceiling)
    if lost:
        careful_covariance(program, work, 0, linear, P, d, P_out)
    return log_density, predicted_nis, good, found, widen_by


@inner_kernel
def _step(settings, chooser, program, work, state, inputs, outputs, room, scratch, features, hidden, b, t):
    """Prediction, learning and update for track ``b`` at row ``t``.

    As `cycle.step` for one mode; a row without a measurement leaves the noise as it is.
    """
    mean, cov, n = state.mean[b, 0], state.cov[b, 0], program.sizes[0]
    learnt = state.nis_average[b, LEARNT:]
    good, lost, found, widen_by = True, False, 0, 1.0
    now = inputs.times[b if inputs.times.shape[0] > 1 else 0, t]
    dt = now - state.time[b]
    if not (dt >= 0.0 and dt < ABSURD):
        dt = 0.0
        good = False
    else:
        state.time[b] = now
    state.phase[b] = RUNNING
    z = inputs.measurements[b, t]
    R = inputs.noise[b if inputs.noise.shape[0] > 1 else 0, t if inputs.noise.shape[1] > 1 else 0]
    sensor = inputs.sensors[b if inputs.sensors.shape[0] > 1 else 0, t if inputs.sensors.shape[1] > 1 else 0]
    d, clean = usable_components(program, work, z, R, sensor)
    m, P = work.predicted_mean[0], work.predicted_cov[0]
    good = predict_mode(program, work, 0, mean, cov, dt, m, P) and good and clean
    if settings.method == AGENT:
        agent_moves(chooser, z.size, n, work.F_transposed[0], learnt, work.vector)
    if settings.process and learnt[PROCESS] != 1.0:
        for i in range(n):
            for k in range(n):
                P[i, k] += (learnt[PROCESS] - 1.0) * work.Q[0, i, k]
    sound = sound_moments(m, P, n, cov)
    if sound == 0:
        widen(state.kin_cov[b])
        lost = True
        birth(program, work, 0, state.kin_mean[b], state.kin_cov[b], m, P)
        if settings.method == AGENT:
            agent_loses(chooser, learnt)
    status, log_likelihood, nis = OK, 0.0, 0.0
    if d > 0:
        if settings.method == AGENT:
            log_likelihood, nis, fine, found, widen_by = agent_update(
                chooser, program, work, learnt, state.refusals[b], room, scratch, features, hidden, m, P, sensor, z, d,
                mean, cov,
            )  # fmt: skip
        else:
            log_likelihood, nis, fine, found, widen_by = _update(
                settings, program, work, learnt, state.refusals[b], room, m, P, sensor, z, d, mean, cov
            )
        sound = sound_moments(mean, cov, n, P)
        good = good and fine and sound == 2
        if sound == 0:
            if not lost:
                widen(state.kin_cov[b])
            lost = True
            birth(program, work, 0, state.kin_mean[b], state.kin_cov[b], mean, cov)
            _forget_all(settings, learnt, z.size)
        else:
            good = believable_parameters(program, 0, mean, cov) and good
        if not np.isfinite(log_likelihood):
            log_likelihood = -ABSURD
            good = False
        if np.isfinite(nis):
            for column in range(LEARNT):
                state.nis_average[b, column] += _MEMORY * (min(nis / d, _WORST_NIS) - state.nis_average[b, column])
        else:
            nis = 0.0
            good = False
    else:
        good = good and sound == 2
        copy_vector(m[:n], mean[:n])
        copy_rows(P, cov, n)
        status = MISSING
        if settings.method == AGENT:
            agent_skip(chooser, z.size, learnt, features, hidden)
    outputs.log_likelihood[b, t] = log_likelihood
    outputs.nis[b, t] = nis
    outputs.nis_dof[b, t] = d
    fused = fuse(program, work, state.mean[b], state.cov[b], state.mode_probs[b], state.kin_mean[b], state.kin_cov[b])
    good = good and fused
    if not good:
        status = REPAIRED
    astray = found & AGREED != 0
    if lost or astray or state.nis_average[b, LEARNT - 1] > _LOST_NIS:
        status = DIVERGED
    if status in (REPAIRED, DIVERGED):
        drop_impossible_correlations(work, state.kin_cov[b])
    again = astray and settings.restart and begin_again(program, work, state, b, widen_by)
    if again:
        _forget_all(settings, learnt, z.size)
    outputs.refused[b, t] = BEGUN if again else found & REFUSED
    outputs.status[b, t] = status


@inner_kernel
def _row(settings, chooser, program, work, state, inputs, outputs, room, scratch, features, hidden, b, t):
    if state.phase[b] == LOCATED:
        outputs.status[b, t] = STARTING
        state.phase[b] = RUNNING
    else:
        _step(settings, chooser, program, work, state, inputs, outputs, room, scratch, features, hidden, b, t)


@entry_kernel
def advance(settings, chooser, program_handle, work_handle, state, inputs, outputs, history, learnt, begin, end):
    """Run tracks ``begin`` to ``end`` through all their rows.

    As `cycle.advance`; with a time axis, ``learnt`` (B, T, learnt columns) receives the learnt columns of every row.
    """
    program, work = program_at(program_handle), work_at(work_handle)
    states, rows, results = by_reference(state), by_reference(inputs), by_reference(outputs)
    size = inputs.measurements.shape[2]
    room = np.zeros((_MATRICES, size + 2, padded(size)))
    scratch = np.zeros((5 * size + 1, max(padded(size), 8)))
    # float32: an agent has learnt from observations of that precision.
    features, hidden = np.zeros(chooser.network.sizes[0], dtype=np.float32), np.zeros((2, chooser.network.sizes.max()))
    for b in range(begin, end):
        for t in range(inputs.first[b], inputs.lengths[b]):
            _row(settings, chooser, program, work, states, rows, results, room, scratch, features, hidden, b, t)
            copy_vector(state.kin_mean[b], outputs.kin_mean[b, t])
            copy_matrix(state.kin_cov[b], outputs.kin_cov[b, t], state.kin_cov.shape[1])
            copy_vector(state.mode_probs[b], outputs.mode_probs[b, t])
            if history.mean.shape[1] > 0:
                copy_vector(state.mean[b, 0], history.mean[b, t, 0])
                copy_rows(state.cov[b, 0], history.cov[b, t, 0], state.mean.shape[2])
            if learnt.shape[1] > 0:
                copy_vector(state.nis_average[b, LEARNT:], learnt[b, t])
