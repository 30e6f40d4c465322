"""Fixed-interval smoothing: Rauch-Tung-Striebel through every pair of modes.

Model: filtering gives ``p(x_k, m_k = j | z_1:k)``. Going back, each pair (mode j at k, mode i during the step to
k + 1) has joint moments of ``x_k`` (in the components of j) and ``x_k+1`` (in those of i): points of ``x_k`` are
converted to i, moved by i, and Q_i added. With ``X`` their cross covariance and ``G = X (P-)^-1``::

    x_k | j, i ~ N(m_j + G (s_i - m-),  P_j + G (S_i - P-) G')
    weight_ji  ~ s_i(k + 1)  Pi_ji mu_j(k) N(s_i; m-, P-) / sum over j

and the smoothed mode j at k is the mixture over i. One mode: the RTS smoother exactly. ``Pi = I``: one RTS smoother
per mode. Source: Rauch, Tung, Striebel (1965); mode recursion Kim (1994) with the density of the smoothed state as in
Barber (2006), expectation correction. Differs: modes may have unlike states, because each gain maps back directly
into the components of j.
"""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import call_transition, entry_kernel, inner_kernel
from jink.estimators.cycle import fuse
from jink.estimators.interaction import convert_point, joint_points, own_prior
from jink.estimators.linalg import cholesky, copy_matrix, copy_vector, solve_lower, wrap_angle
from jink.estimators.markov import transition_matrix
from jink.estimators.modes import process_noise
from jink.estimators.program import BIRTH, make_work
from jink.estimators.reference import by_reference
from jink.estimators.unscented import point_weights, points_mean

__all__ = ["smooth_tracks"]

_LOG_TWO_PI = np.log(2.0 * np.pi)


@inner_kernel
def _joint_step(program, work, i, j, m, P, m_own, P_own, dt, near, ahead_mean, ahead_cov, cross):
    """Moments of mode i at k + 1 and their cross covariance (n_i, n_j) with mode j at k."""
    n, size = program.sizes[j], program.sizes[i]
    born = program.rule == BIRTH
    own_prior(program, i, m_own, P_own, born, work.own_mean, work.own_cov)
    count, good = joint_points(program, work, i, j, m, P, work.own_mean, work.own_cov)
    joint = n + program.drawn[i, j]
    _, centre, other = point_weights(joint, program.tuning[0], program.tuning[1], program.tuning[2])
    moved, points = work.moved, work.points
    converted = work.scaled[0]
    for s in range(count):
        for k in range(program.drawn[i, j]):
            work.own[k] = points[s, n + k]
        if program.gathered[i, j]:
            for c in range(size):
                if program.source[i, j, c] >= 0:
                    converted[c] = points[s, program.source[i, j, c]]
            for k in range(program.own_counts[i]):
                c = program.own_index[i, k]
                if program.source[i, j, c] < 0:
                    converted[c] = work.own[k]
        else:
            convert_point(program, work, i, j, points[s], work.own, converted)
        call_transition(program.transition[i], converted[:size], dt, program.params[i], moved[s, :size])
        for c in range(size):
            if program.angular[i, c]:
                anchor = near[c] if s == 0 else moved[0, c]
                moved[s, c] = anchor + wrap_angle(moved[s, c] - anchor)
    points_mean(moved, count, size, other, ahead_mean)
    for c in range(n):
        work.vector[c] = m[c]
    for a in range(size):
        for c in range(size):
            total = ahead_cov[a, c]
            for s in range(count):
                total += (centre if s == 0 else other) * moved[s, a] * moved[s, c]
            ahead_cov[a, c] = total
        for c in range(n):
            total = 0.0
            for s in range(count):
                total += (centre if s == 0 else other) * moved[s, a] * (points[s, c] - work.vector[c])
            cross[a, c] = total
    return good


@inner_kernel
def _pair(program, work, i, j, m, P, m_own, P_own, dt, s_mean, s_cov, factor, cross, gain, difference, m_out, P_out):
    """Smoothed moments of mode j at k given mode i; returns the log density of the smoothed state of i."""
    n, size = program.sizes[j], program.sizes[i]
    ahead_mean, ahead_cov = work.part_mean[i], work.part_cov[i]
    process_noise(program, work, i, m_own, dt, ahead_cov)
    _joint_step(program, work, i, j, m, P, m_own, P_own, dt, s_mean, ahead_mean, ahead_cov, cross)
    cholesky(ahead_cov, size, factor)
    copy_matrix(cross, gain, size)
    solve_lower(factor, size, gain, n)  # W = U'^-1 X', so that G d = W' U'^-1 d and G P- G' = W' W
    log_determinant = 0.0
    distance = 0.0
    for a in range(size):
        total = s_mean[a] - ahead_mean[a]
        if program.angular[i, a]:
            total = wrap_angle(total)
        for k in range(a):
            total -= factor[k, a] * difference[k]
        difference[a] = total / factor[a, a] if factor[a, a] > 0.0 else 0.0
        if factor[a, a] > 0.0:
            log_determinant += np.log(factor[a, a])
        distance += difference[a] * difference[a]
    for c in range(n):
        total = m[c]
        for a in range(size):
            total += gain[a, c] * difference[a]
        m_out[c] = total
    for a in range(size - 1, -1, -1):  # U^-1 W: the transposed gain
        for c in range(n):
            total = gain[a, c]
            for k in range(a + 1, size):
                total -= factor[a, k] * gain[k, c]
            gain[a, c] = total / factor[a, a] if factor[a, a] > 0.0 else 0.0
    for a in range(size):
        for c in range(n):
            total = 0.0
            for k in range(size):
                total += (s_cov[a, k] - ahead_cov[a, k]) * gain[k, c]
            cross[a, c] = total
    for a in range(n):
        for c in range(n):
            total = P[a, c]
            for k in range(size):
                total += gain[k, a] * cross[k, c]
            P_out[a, c] = total
    for a in range(n):
        for c in range(a):
            P_out[a, c] = P_out[c, a]
    return -0.5 * (size * _LOG_TWO_PI + distance) - log_determinant


@inner_kernel
def _smooth_track(program, work, mean, cov, probs, times, chains, first, last, kin_mean, kin_cov, scratch):
    """Overwrite filtered ``mean``, ``cov``, ``probs`` of rows ``first`` to ``last`` by smoothed ones."""
    modes = program.sizes.size
    pair_mean, pair_cov, weights, factor, cross, gain, difference, next_mean, next_cov = scratch
    for t in range(last - 1, first - 1, -1):
        dt = times[t + 1] - times[t]
        if chains.size > 0:
            copy_matrix(chains[(t + 1) if chains.shape[0] > 1 else 0], work.chain, modes)
        elif program.per_step:
            copy_matrix(program.chain, work.chain, modes)
        else:
            transition_matrix(program.chain, dt, modes, work.chain_scratch, work.chain)
        for i in range(modes):
            top = -np.inf
            for j in range(modes):
                weights[i, j] = -np.inf
                prior = work.chain[j, i] * probs[t, j]
                if prior > 0.0 and probs[t + 1, i] > 0.0:
                    density = _pair(
                        program, work, i, j, mean[t, j], cov[t, j], mean[t, i], cov[t, i], dt,
                        mean[t + 1, i], cov[t + 1, i], factor, cross, gain, difference, pair_mean[i, j], pair_cov[i, j],
                    )  # fmt: skip
                    weights[i, j] = np.log(prior) + density
                    top = max(top, weights[i, j])
            mass = 0.0
            for j in range(modes):
                weights[i, j] = np.exp(weights[i, j] - top) if weights[i, j] > -np.inf else 0.0
                mass += weights[i, j]
            for j in range(modes):
                weights[i, j] = probs[t + 1, i] * weights[i, j] / mass if mass > 0.0 else 0.0
        whole = 0.0
        for j in range(modes):
            n = program.sizes[j]
            mass = 0.0
            for i in range(modes):
                mass += weights[i, j]
            whole += mass
            for c in range(n):
                next_mean[j, c] = mean[t, j, c] if not mass > 0.0 else 0.0
            if not mass > 0.0:
                copy_matrix(cov[t, j], next_cov[j], n)
            else:
                for i in range(modes):
                    for c in range(n):
                        if weights[i, j] > 0.0:
                            next_mean[j, c] += weights[i, j] / mass * pair_mean[i, j, c]
                for a in range(n):
                    for c in range(n):
                        total = 0.0
                        for i in range(modes):
                            if weights[i, j] > 0.0:
                                da = pair_mean[i, j, a] - next_mean[j, a]
                                dc = pair_mean[i, j, c] - next_mean[j, c]
                                total += weights[i, j] / mass * (pair_cov[i, j, a, c] + da * dc)
                        next_cov[j, a, c] = total
            probs[t, j] = mass
        for j in range(modes):
            probs[t, j] = probs[t, j] / whole if whole > 0.0 else 1.0 / modes
            copy_vector(next_mean[j], mean[t, j])
            copy_matrix(next_cov[j], cov[t, j], program.sizes[j])
        fuse(program, work, mean[t], cov[t], probs[t], kin_mean[t], kin_cov[t])


@inner_kernel
def _smooth_all(program, work, history, outputs, inputs, begin, end, scratch):
    for b in range(begin, end):
        row = b if inputs.times.shape[0] > 1 else 0
        chains = inputs.chains[b if inputs.chains.shape[0] > 1 else 0] if inputs.chains.size > 0 else work.no_chains
        _smooth_track(
            program, work, history.mean[b], history.cov[b], outputs.mode_probs[b], inputs.times[row],
            chains, inputs.first[b], inputs.lengths[b] - 1, outputs.kin_mean[b], outputs.kin_cov[b], scratch,
        )  # fmt: skip


@entry_kernel
def smooth_tracks(program, history, outputs, inputs, begin, end):
    """Smooth tracks ``begin`` to ``end`` in place, from the filter's ``history`` and ``outputs``."""
    modes, states = history.mean.shape[2], history.mean.shape[3]
    work = make_work(
        modes, states, program.birth_mean.shape[1], inputs.measurements.shape[2], outputs.kin_mean.shape[2]
    )
    scratch = (
        np.zeros((modes, modes, states)),
        np.zeros((modes, modes, states, states)),
        np.zeros((modes, modes)),
        np.zeros((states, states)),
        np.zeros((states, states)),
        np.zeros((states, states)),
        np.zeros(states),
        np.zeros((modes, states)),
        np.zeros((modes, states, states)),
    )
    _smooth_all(
        by_reference(program), by_reference(work), by_reference(history), by_reference(outputs), by_reference(inputs),
        begin, end, scratch,
    )  # fmt: skip
    return work.F.size + program.sizes.size + scratch[0].size  # used here, so that none is freed earlier
