"""Kernels of `jink/AdaptiveFactor-v0`: a decision, the two references it is measured against, and what is seen next.

A row of `samples` is one sample of one target, a row of `memory` one target; columns are named below and shared with
`adaptive_factor`. The samples that are next are fetched a few targets ahead: without that, half of a step was spent
waiting for memory. Reference and agent go through the same functions by address and through `math.hypot`, so that
equal choices give equal bits.
"""

from __future__ import annotations

import math

from jink.envs.compiled import fetch, inner_kernel, kernel
from jink.envs.loop_filter import call_innovate, call_predict, call_start, call_update
from jink.estimators.agent.beliefs import overconfidence
from jink.estimators.agent.lookback import forget_update, reconsider, remember_update
from jink.estimators.agent.looking import (
    BELIEF,
    DRIFT,
    LEVELS_SIZE,
    NIS,
    PLAIN_VIEW,
    begin_memory,
    look,
    look_away,
    note_used,
)
from jink.estimators.factors import call_factor

__all__ = ["begin_rows", "step_rows", "tell_rows"]

# Columns of a sample; then true position, measured position, estimate, A each.
TIME, SCALE, INTENT, NOMINAL, ORACLE, CHOICE, SCORE, FIRST = range(8)
# Columns of a target's memory; then true position, estimate, A each. What the agent remembers is in `looks`.
GAIN, SIGMA, STREAK, ERROR_AGENT, ERROR_NOMINAL, ERROR_ORACLE, INFLATION, PLACE = range(8)
# Entries of the settings.
LOST_AFTER, LOST_STEPS, LOWEST, HIGHEST, LOSS, FLOOR, VIEW, HONEST, INFORMED, LOOKBACK = range(10)
DISTANCE, SQUARED, LOG, REGRET, LOG_REGRET = range(5)
_NOISE, _CHOSEN = 0, 1
_SCRATCH, _HPH, _WANTED, _PART, _VECTOR, _REFERENCE, _CROSS, _EXCESS, _BELIEVED, _SLOPE, _TILTED, _CHANGE = range(
    11, 23
)
TOLD, TOLD_BOUND = 5, 30.0
"""Columns for a critic at the end of an observation, and their largest magnitude."""
_AHEAD, _LINE = 4, 8
"""Targets between the one whose samples are fetched and the one that steps; numbers in a cache line."""
WORK = 23
"""Matrices (16, 8) of scratch: 11 for the filter, the rest for these kernels."""


@inner_kernel
def _loss(error, sigma, kind):
    relative = error / sigma
    if kind == SQUARED:
        return relative * relative
    if kind in (LOG, LOG_REGRET):
        return math.log1p(relative * relative)
    return relative


@inner_kernel
def _load_noise(noises, i, k, scalar, A, out):
    """Nominal noise of a sample into ``out`` (A, 8); one for all targets and samples if ``scalar``."""
    row, column = (0, 0) if scalar else (i, k)
    for a in range(A):
        for b in range(A):
            out[a, b] = noises[row, column, a * A + b]


@inner_kernel
def _count(z, A):
    d = 0
    for a in range(A):
        if not math.isnan(z[a]):
            d += 1
    return d


@inner_kernel
def _pack(matrix, begin, v, A, out):
    """Rows ``begin`` to ``begin + A`` of ``matrix`` without the missing components of the innovation ``v``."""
    i = 0
    for a in range(A):
        if not math.isnan(v[a]):
            j = 0
            for b in range(A):
                if not math.isnan(v[b]):
                    out[i, j] = matrix[begin + a, b]
                    j += 1
            i += 1


@inner_kernel
def _inflate(state, inflation, A, work):
    """The noise to use is ``inflation`` times the one the filter wants adapted."""
    for a in range(A):
        for b in range(A):
            work[_CHOSEN, a, b] = inflation * state[3 * A + 3 + a, b]


@inner_kernel
def _adapt(factor, thresholds, nis, d, A, state, work):
    """The noise to use by a factor into ``work[_CHOSEN]``; returns ``tr R~ / tr R``."""
    at = 2 * A + 2
    chosen, scratch = work[_CHOSEN], work[_SCRATCH]
    before, after = 0.0, 0.0
    if d == A:
        call_factor(
            factor, state[at, :A], state[at + 1 :], state[at + 1 + A :], nis, thresholds[d - 1], scratch, chosen
        )
        for a in range(A):
            before += state[at + 1 + A + a, a]
            after += chosen[a, a]
        return after / before
    HPH, wanted, part, v = work[_HPH], work[_WANTED], work[_PART], work[_VECTOR, 0, :d]
    _pack(state, at + 1, state[at], A, HPH)
    _pack(state, at + 1 + A, state[at], A, wanted)
    _pack_vector(state[at], A, v)
    call_factor(factor, v, HPH, wanted, nis, thresholds[d - 1], scratch, part)
    i = 0
    for a in range(A):
        for b in range(A):
            chosen[a, b] = 0.0
        if not math.isnan(state[at, a]):
            before += wanted[i, i]
            after += part[i, i]
            j = 0
            for b in range(A):
                if not math.isnan(state[at, b]):
                    chosen[a, b] = part[i, j]
                    j += 1
            i += 1
    return after / before


@inner_kernel
def _error(sample, state, A):
    error = math.hypot(sample[FIRST] - state[0, 0], sample[FIRST + 1] - state[0, 1])
    if A == 3:
        error = math.hypot(error, sample[FIRST + 2] - state[0, 2])
    return error


@inner_kernel
def _pack_vector(v, A, out):
    """The components of ``v`` that are not missing."""
    i = 0
    for a in range(A):
        if not math.isnan(v[a]):
            out[i] = v[a]
            i += 1


@inner_kernel
def _look(
    filters, A, modes, settings, state, sample, seen, params, actions, choice, shown, work, basis, kept, features
):
    """What the agent sees of a sample before it decides: `looking.look`, the filter's modes, the last action."""
    z = sample[FIRST + A : FIRST + 2 * A]
    at, R, present = 2 * A + 2, work[_NOISE], work[_VECTOR, 1]
    view = int(settings[VIEW])
    d = 0
    for a in range(A):
        if not math.isnan(z[a]):
            present[d] = a
            d += 1
    if d > 0:
        call_innovate(filters[1], state, z, params, work[:11])
        if settings[LOOKBACK] > 0.0 and _take_back(A, state, seen, d, present, basis, kept, work):
            call_innovate(filters[1], state, z, params, work[:11])
        if d == A:
            look(view, state[at], state[at + 1 :], R, d, present, A, seen, work[_SCRATCH], basis, features)
        else:
            _pack_vector(state[at], A, work[_VECTOR, 0])
            _pack(state, at + 1, state[at], A, work[_HPH])
            _pack(R, 0, state[at], A, work[_PART])
            look(view, work[_VECTOR, 0], work[_HPH], work[_PART], d, present, A, seen, work[_SCRATCH], basis, features)
    else:
        look_away(view, seen, A, features)
    at = 2 * A + 5 if view == PLAIN_VIEW else LEVELS_SIZE
    for j in range(modes):
        features[at + j] = state[2 * A + 1, j]
    at += modes
    if view == PLAIN_VIEW:
        if actions == 0:
            features[at] = shown
        for j in range(actions):
            features[at + j] = 1.0 if j == choice else 0.0


@inner_kernel
def _take_back(A, state, seen, d, present, basis, kept, work):
    """`lookback.reconsider` for a state of position and velocity; returns whether it has changed."""
    at, slope = 2 * A + 2, work[_SLOPE]
    for i in range(d):
        for c in range(A):
            slope[i, c] = kept[int(present[i]) * A + c]
    _pack_vector(state[at], A, work[_VECTOR, 0])
    _pack(state, at + 1, state[at], A, work[_HPH])
    _pack(work[_NOISE], 0, state[at], A, work[_PART])
    return reconsider(
        kept, 2 * A, A, work[_VECTOR, 0], work[_HPH], work[_PART], d, slope, seen[BELIEF:DRIFT], work[_SCRATCH],
        work[_TILTED], basis, work[_CHANGE], state[0], state[1 : 1 + 2 * A],
    )  # fmt: skip


@inner_kernel
def _move_along(A, dt, kept):
    """What the last update did, `dt` seconds later: positions follow velocities."""
    for i in range(A * A):
        kept[i] += dt * kept[A * A + i]


@inner_kernel
def _tell_critic(scale, mine, features):
    """What only a simulator knows, into the last `TOLD` columns; 0 where the truth is not known."""
    at, sigma, gain = features.size - TOLD, mine[SIGMA], mine[GAIN]
    told = (
        math.log(0.01 + mine[ERROR_AGENT] / sigma),
        math.log(0.01 + mine[ERROR_ORACLE] / sigma),
        math.log(max(scale, 1.0)),
        math.log(gain),
        min(max((mine[ERROR_AGENT] - mine[ERROR_ORACLE]) / sigma / gain, -10.0), TOLD_BOUND),
    )
    for i in range(TOLD):
        value = min(max(told[i], -TOLD_BOUND), TOLD_BOUND)
        features[at + i] = 0.0 if math.isnan(told[i]) else value


@inner_kernel
def _prepare_honesty(A, state, seen, basis, d, work):
    """``C = P H'`` and by how much the update to come will be too sure, before it changes the state; if it is known."""
    at, excess, cross = 2 * A + 2, work[_EXCESS], work[_CROSS]
    if d == A:
        sure = overconfidence(basis, d, work[_CHOSEN], seen[BELIEF:DRIFT], work[_SCRATCH], work[_BELIEVED], excess)
    else:
        _pack(work[_CHOSEN], 0, state[at], A, work[_WANTED])
        sure = overconfidence(basis, d, work[_WANTED], seen[BELIEF:DRIFT], work[_SCRATCH], work[_BELIEVED], excess)
    i = 0
    for a in range(A):
        if not math.isnan(state[at, a]):
            for c in range(2 * A):
                cross[i, c] = state[1 + a, c]
            i += 1
    return sure


@inner_kernel
def _be_honest(A, state, d, work):
    """``P + C excess C'``: see `beliefs.overconfidence`."""
    excess, cross, part = work[_EXCESS], work[_CROSS], work[_SCRATCH]
    for i in range(d):
        for c in range(2 * A):
            part[i, c] = 0.0
            for k in range(d):
                part[i, c] += excess[i, k] * cross[k, c]
    for c in range(2 * A):
        for r in range(c + 1):
            total = state[1 + r, c]
            for i in range(d):
                total += cross[i, r] * part[i, c]
            state[1 + r, c] = total
            state[1 + c, r] = total


@inner_kernel
def _reference(filters, A, kind, prior, noises, row, scalar, samples, params, settings, sigma, work):
    """One reference through an episode: nominal R (kind 0) or the true one (1); returns the sum of its losses."""
    steps = samples.shape[0]
    state = work[_REFERENCE, : 4 * A + 3]
    total = 0.0
    _load_noise(noises, row, 0, scalar, A, work[_NOISE])
    call_start(filters[0], prior, params, state)
    for k in range(steps - 1):
        sample = samples[k]
        z = sample[FIRST + A : FIRST + 2 * A]
        if _count(z, A) > 0:
            if not scalar:
                _load_noise(noises, row, k, False, A, work[_NOISE])
            call_innovate(filters[1], state, z, params, work[:11])
            _inflate(state, 1.0 if kind == 0 else sample[SCALE], A, work)
            call_update(filters[2], state, params, work[:11])
        error = _error(sample, state, A)
        sample[NOMINAL + kind] = error
        if not math.isnan(sample[FIRST]):
            total += _loss(error, sigma, settings[LOSS])
        call_predict(filters[3], state, samples[k + 1, TIME] - sample[TIME], params, work[:11])
    return total


@inner_kernel
def _load(i, A, times, scale, intent, position, places, samples):
    """One episode into the records of its samples."""
    for k in range(samples.shape[0]):
        sample = samples[k]
        sample[TIME], sample[SCALE], sample[INTENT] = times[i, k], scale[i, k], intent[i, k]
        sample[NOMINAL], sample[ORACLE], sample[CHOICE], sample[SCORE] = 0.0, 0.0, -1.0, 0.0
        for a in range(A):
            sample[FIRST + a] = position[i, k, a]
            sample[FIRST + A + a] = places[i, k, a]
            sample[FIRST + 2 * A + a] = math.nan


@kernel
def begin_rows(
    begin, end, rows, A, modes, actions, filters, params, settings, times, scale, intent, position, places, priors,
    noises, scalar, states, samples, memory, looks, bases, keeps, features, work,
):  # fmt: skip
    """Targets ``rows[begin:end]`` start: both references run through the episode, then the first sample is seen."""
    steps = samples.shape[1]
    for i in range(begin, end):
        row = rows[i]
        mine, episode = memory[row], samples[row]
        _load(i, A, times, scale, intent, position, places, episode)
        mine[SIGMA] = _mean_sigma(noises, row, scalar, A, steps)
        gain = 0.0
        for kind in range(2):
            total = _reference(
                filters, A, kind, priors[i], noises, row, scalar, episode, params, settings, mine[SIGMA], work
            )
            gain += total if kind == 0 else -total
        mine[GAIN] = max(gain / (steps - 1), settings[FLOOR])
        first = episode[0]
        call_start(filters[0], priors[i], params, states[row])
        error = _error(first, states[row], A)
        for a in range(A):
            mine[PLACE + a] = first[FIRST + a]
            mine[PLACE + A + a] = states[row, 0, a]
        mine[ERROR_AGENT], mine[ERROR_NOMINAL], mine[ERROR_ORACLE] = error, error, error
        mine[STREAK], mine[INFLATION] = 0.0, 1.0
        begin_memory(looks[row])
        forget_update(keeps[row])
        _load_noise(noises, row, 0, scalar, A, work[_NOISE])
        _look(
            filters, A, modes, settings, states[row], first, looks[row], params, actions, -1, -1.0, work, bases[row],
            keeps[row], features[row],
        )  # fmt: skip
        if settings[INFORMED] > 0.0:
            _tell_critic(first[SCALE], mine, features[row])


@kernel
def tell_rows(
    at,
    A,
    samples,
    memory,
    looks,
    time,
    scale,
    intent,
    detected,
    nis,
    agent,
    nominal,
    oracle,
    inflation,
    position,
    estimate,
):
    """What `AdaptiveFactorTask.info` returns."""
    for row in range(at.shape[0]):
        sample, mine = samples[row, at[row]], memory[row]
        time[row], scale[row], intent[row] = sample[TIME], sample[SCALE], int(sample[INTENT])
        detected[row], nis[row] = _count(sample[FIRST + A : FIRST + 2 * A], A) > 0, looks[row, NIS]
        agent[row], nominal[row], oracle[row] = mine[ERROR_AGENT], mine[ERROR_NOMINAL], mine[ERROR_ORACLE]
        inflation[row] = mine[INFLATION]
        for a in range(A):
            position[row, a] = mine[PLACE + a]
            estimate[row, a] = mine[PLACE + A + a]


@inner_kernel
def _mean_sigma(noises, row, scalar, A, steps):
    """Root mean nominal variance of a position component over an episode, m."""
    total, count = 0.0, 1 if scalar else steps
    for k in range(count):
        for a in range(A):
            total += noises[0 if scalar else row, k, a * A + a]
    return math.sqrt(total / (A * count))


@kernel
def step_rows(
    begin, end, live, at, ends, choices, inflations, A, modes, actions, filters, factors, thresholds, params, settings,
    noises, scalar, states, samples, memory, looks, bases, keeps, features, reward, lost, work,
):  # fmt: skip
    """Targets ``begin`` to ``end`` that are live take their decision at sample ``at`` and see the next one."""
    _load_noise(noises, begin, 0, scalar, A, work[_NOISE])
    steps, width = samples.shape[1], samples.shape[2]
    for row in range(begin, end):
        coming = row + _AHEAD
        if coming < end:
            item = (coming * steps + at[coming]) * width
            for line in range(0, 2 * width + _LINE, _LINE):
                fetch(samples, min(item + line, samples.size - 1))
        reward[row] = 0.0
        lost[row] = False
        if not live[row]:
            continue
        k, mine, state, seen = at[row], memory[row], states[row], looks[row]
        sample = samples[row, k]
        d, used = _count(sample[FIRST + A : FIRST + 2 * A], A), inflations[row]
        if d > 0:
            if choices[row] < 0:
                _inflate(state, used, A, work)
            else:
                used = _adapt(factors[choices[row]], thresholds[choices[row]], seen[NIS], d, A, state, work)
            note_used(seen, used)
            if settings[HONEST] > 0.0:
                sure = _prepare_honesty(A, state, seen, bases[row], d, work)
                if sure and settings[LOOKBACK] > 0.0:
                    remember_update(keeps[row], 2 * A, A, work[_CROSS], bases[row], d, work[_BELIEVED])
            call_update(filters[2], state, params, work[:11])
            if settings[HONEST] > 0.0:
                _be_honest(A, state, d, work)
        else:
            used = 1.0
        error = _error(sample, state, A)
        nominal = sample[NOMINAL]
        base = sample[ORACLE] if settings[LOSS] >= REGRET else nominal
        gained = _loss(base, mine[SIGMA], settings[LOSS]) - _loss(error, mine[SIGMA], settings[LOSS])
        score = gained / mine[GAIN]
        # Not min and max: an error that is no number must not earn the best reward.
        if not score > settings[LOWEST]:
            score = settings[LOWEST]
        score = min(score, settings[HIGHEST])
        if math.isnan(sample[FIRST]):
            score = 0.0
        elif error <= settings[LOST_AFTER] * max(mine[SIGMA], nominal):
            mine[STREAK] = 0.0
        else:
            mine[STREAK] += 1.0
        if mine[STREAK] >= settings[LOST_STEPS]:
            lost[row] = True
            score = settings[LOWEST] * (ends[row] - k)
        reward[row] = score
        sample[CHOICE], sample[SCORE] = choices[row], score
        mine[ERROR_AGENT], mine[ERROR_NOMINAL], mine[ERROR_ORACLE] = error, nominal, sample[ORACLE]
        mine[INFLATION] = used
        for a in range(A):
            mine[PLACE + a] = sample[FIRST + a]
            mine[PLACE + A + a] = state[0, a]
            sample[FIRST + 2 * A + a] = state[0, a]
        after = samples[row, k + 1]
        call_predict(filters[3], state, after[TIME] - sample[TIME], params, work[:11])
        if settings[LOOKBACK] > 0.0:
            _move_along(A, after[TIME] - sample[TIME], keeps[row])
        if not scalar:
            _load_noise(noises, row, k + 1, False, A, work[_NOISE])
        shown = math.log(inflations[row]) / math.log(1e6) * 2.0 - 1.0 if actions == 0 else 0.0
        _look(
            filters, A, modes, settings, state, after, seen, params, actions, choices[row], shown, work, bases[row],
            keeps[row], features[row],
        )  # fmt: skip
        if settings[INFORMED] > 0.0:
            _tell_critic(after[SCALE], mine, features[row])
