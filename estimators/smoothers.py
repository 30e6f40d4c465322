"""Fixed-interval smoothing of a bank: Rauch-Tung-Striebel through every pair of modes.

Filtering gives ``p(x_k, m_k = j | z_1:k)``. Each pair (mode j at k, mode i during the step to k + 1) has joint
moments of ``x_k`` (in the components of j) and ``x_k+1`` (in those of i): points of ``x_k`` are converted to i, moved
by i, and Q_i added; ``m_ji``, ``P_ji`` is the prediction, ``G = X' P_ji^-1`` the smoother gain. The future reaches
mode i at k + 1 as the likelihood

    L_i(x) = N(x; s_i, S_i) / N(x; p_i, P_i),   p_i, P_i = moments of sum_j w_j|i N(m_ji, P_ji)

(smoothed over predicted). Every pair is updated by that likelihood alone, ``s_ji, S_ji``, so no mode has to explain
what another predicted, and weights follow from how well each pair explains it:

    x_k | j, i ~ N(m_j + G (s_ji - m_ji), P_j + G (S_ji - P_ji) G'),   weight_ji = s_i(k + 1) w_j|i int N_ji L_i / sum_j

Mode j at k is the mixture of its pairs. One mode: the RTS smoother exactly. ``Pi = I``: one RTS smoother per mode.
Source: Rauch, Tung, Striebel (1965); pairs as in Kim (1994) and Nadarajah et al. (2012). Differs: unlike states (each
gain maps straight back into the components of j), and the likelihood in place of the smoothed state itself: with the
latter, pairs that predicted something else are dragged along and the recursion can run away.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from jink.estimators.compiled import call_transition, entry_kernel, inner_kernel
from jink.estimators.fusion import fuse
from jink.estimators.interaction import convert_point, joint_points, own_prior
from jink.estimators.linalg import (
    cholesky,
    clear_tails,
    copy_matrix,
    copy_vector,
    diagonalise,
    solve_lower,
    solve_upper,
    wrap_angle,
)
from jink.estimators.markov import transition_matrix
from jink.estimators.modes import process_noise
from jink.estimators.program import BIRTH, program_at, work_at
from jink.estimators.records import ABSURD
from jink.estimators.reference import record_type, reference_reader
from jink.estimators.restarting import BEGUN, REFUSED
from jink.estimators.soundness import drop_impossible_correlations, loosen_correlations
from jink.estimators.status import DIVERGED, MISSING, OK, REPAIRED
from jink.estimators.unscented import point_weights, points_mean

__all__ = ["Smoother", "make_smoother", "smooth_tracks"]


class Smoother(NamedTuple):
    """Scratch of the smoother; pairs are indexed (mode at k, mode at k + 1)."""

    pair_mean: NDArray[np.float64]  # (M, M, N)
    pair_cov: NDArray[np.float64]  # (M, M, N, N)
    weights: NDArray[np.float64]  # (M, M)
    priors: NDArray[np.float64]  # (M,)
    ahead_mean: NDArray[np.float64]  # (M, N)
    ahead_cov: NDArray[np.float64]  # (M, N, N)
    back_mean: NDArray[np.float64]  # (M, N)
    back_cov: NDArray[np.float64]  # (M, N, N)
    cross: NDArray[np.float64]  # (M, N, N)
    squares: NDArray[np.float64]  # (8, N, N)
    vectors: NDArray[np.float64]  # (5, N)


def make_smoother(modes: int, states: int) -> Smoother:
    """Scratch for M modes of N padded components."""
    square = (states, states)
    return Smoother(
        np.zeros((modes, modes, states)),
        np.zeros((modes, modes, *square)),
        np.zeros((modes, modes)),
        np.zeros(modes),
        np.zeros((modes, states)),
        np.zeros((modes, *square)),
        np.zeros((modes, states)),
        np.zeros((modes, *square)),
        np.zeros((modes, *square)),
        np.zeros((8, *square)),
        np.zeros((5, states)),
    )


SMOOTHER = record_type("smoother", lambda: make_smoother(0, 0))
STACKS = types.Array(types.float64, 4, "C")
CODES = types.Array(types.int8, 1, "C")
smoother_at = reference_reader(SMOOTHER)

_UNINFORMED = 1.0 - 1e-12


@inner_kernel
def _received(program, work, i, j, x, own, out):
    """A state of mode j, with own parameters drawn for mode i, in the components of mode i."""
    if not program.gathered[i, j]:
        for k in range(program.drawn[i, j]):
            work.own[k] = own[k]
        convert_point(program, work, i, j, x, work.own, out)
        return
    for c in range(program.sizes[i]):
        if program.source[i, j, c] >= 0:
            out[c] = x[program.source[i, j, c]]
    for k in range(program.drawn[i, j]):
        if program.source[i, j, program.own_index[i, k]] < 0:
            out[program.own_index[i, k]] = own[k]


@inner_kernel
def _pair_prediction(program, work, i, j, m, P, m_own, P_own, dt, near, ahead_mean, ahead_cov, cross):
    """Prediction of mode i from mode j, and its cross covariance (n_i, n_j) with the state of j."""
    n, size = program.sizes[j], program.sizes[i]
    moved, points, converted = work.moved, work.points, work.scaled[0]
    own_prior(program, i, m_own, P_own, program.rule == BIRTH, work.own_mean, work.own_cov)
    _received(program, work, i, j, m, work.own_mean, converted)
    process_noise(program, work, i, converted, dt, ahead_cov)
    count, good = joint_points(program, work, i, j, m, P, work.own_mean, work.own_cov)
    joint = n + program.drawn[i, j]
    _, centre, other = point_weights(joint, program.tuning[0], program.tuning[1], program.tuning[2])
    clear_tails(moved, count, size)
    for s in range(count):
        for k in range(program.drawn[i, j]):
            work.own[k] = points[s, n + k]
        _received(program, work, i, j, points[s], work.own, converted)
        call_transition(
            program.transition[i], converted[:size], dt, program.params[i, : program.param_counts[i]], moved[s, :size]
        )
        for c in range(size):
            if program.angular[i, c]:
                anchor = near[c] if s == 0 else moved[0, c]
                moved[s, c] = anchor + wrap_angle(moved[s, c] - anchor)
    points_mean(moved, count, size, other, ahead_mean)
    for a in range(size):
        for c in range(size):
            value = 0.0
            for s in range(count):
                value += (centre if s == 0 else other) * moved[s, a] * moved[s, c]
            ahead_cov[a, c] += value
        for c in range(n):
            value = 0.0
            for s in range(count):
                value += (centre if s == 0 else other) * moved[s, a] * (points[s, c] - m[c])
            cross[a, c] = value
    return good


@inner_kernel
def _future_likelihood(p, P, s, S, n, angular, factor, A, V, rows, values, noises):
    """The future as independent scalar measurements ``rows[d] (x - p) = values[d] + N(0, noises[d])``; their count.

    In coordinates where ``P = I``, ``S`` has eigenvalues ``a``: information ``1/a - 1``, so the measurement has
    variance ``a / (1 - a)`` and value ``s / (1 - a)``. Directions with ``a >= 1`` learned nothing from the future.
    """
    cholesky(P, n, factor)
    copy_matrix(S, A, n)
    solve_lower(factor, n, A, n)
    for a in range(n):
        for c in range(a):
            A[a, c], A[c, a] = A[c, a], A[a, c]
    solve_lower(factor, n, A, n)
    for a in range(n):
        for c in range(a):
            A[a, c] = A[c, a] = 0.5 * (A[a, c] + A[c, a])
    diagonalise(A, V, n)
    count = 0
    for d in range(n):
        eigenvalue = max(A[d, d], 1e-15)
        if eigenvalue < _UNINFORMED:
            for a in range(n):
                rows[a, 0] = V[a, d]
            solve_upper(factor, n, rows, 1)
            value = 0.0
            for a in range(n):
                difference = wrap_angle(s[a] - p[a]) if angular[a] else s[a] - p[a]
                value += rows[a, 0] * difference
            for a in range(n):
                V[a, count] = rows[a, 0]
            values[count] = value / (1.0 - eigenvalue)
            noises[count] = eigenvalue / (1.0 - eigenvalue)
            count += 1
    return count


@inner_kernel
def _pair_update(program, i, p, directions, values, noises, count, n, m, P, gain):
    """Update ``N(m, P)`` of a pair by the scalar measurements; returns their log density."""
    log_density = 0.0
    for d in range(count):
        variance = noises[d]
        residual = values[d]
        for a in range(n):
            gain[a] = 0.0
            for c in range(n):
                gain[a] += P[a, c] * directions[c, d]
            variance += directions[a, d] * gain[a]
            residual -= directions[a, d] * (wrap_angle(m[a] - p[a]) if program.angular[i, a] else m[a] - p[a])
        if variance > 0.0:
            for a in range(n):
                m[a] += gain[a] * residual / variance
                for c in range(n):
                    P[a, c] -= gain[a] * gain[c] / variance
            log_density -= 0.5 * (residual * residual / variance + np.log(variance))
    return log_density


@inner_kernel
def _carry_back(m, P, n, ahead_mean, ahead_cov, s, S, size, cross, factor, gain, product, m_out, P_out):
    """``m + G (s - m-)``, ``P + G (S - P-) G'`` with ``G = cross' (P-)^-1``; whether that is a covariance."""
    cholesky(ahead_cov, size, factor)
    copy_matrix(cross, gain, size)
    solve_lower(factor, size, gain, n)
    solve_upper(factor, size, gain, n)
    for c in range(n):
        value = m[c]
        for a in range(size):
            value += gain[a, c] * (s[a] - ahead_mean[a])
        m_out[c] = value
    for a in range(size):
        for c in range(n):
            value = 0.0
            for k in range(size):
                value += (S[a, k] - ahead_cov[a, k]) * gain[k, c]
            product[a, c] = value
    for a in range(n):
        for c in range(a, n):
            value = P[a, c]
            for k in range(size):
                value += gain[k, a] * product[k, c]
            P_out[a, c] = P_out[c, a] = value
    sound = cholesky(P_out, n, factor)
    for a in range(n):
        sound = sound and abs(m_out[a]) < ABSURD and 0.0 <= P_out[a, a] < ABSURD * ABSURD
    if not sound:  # digits lost: what the filter knew stays true
        copy_vector(m, m_out)
        copy_matrix(P, P_out, n)
    return sound


@inner_kernel
def _mixture(weights, means, covs, modes, n, mean, cov):
    for a in range(n):
        mean[a] = 0.0
        for j in range(modes):
            if weights[j] > 0.0:
                mean[a] += weights[j] * means[j, a]
    for a in range(n):
        for c in range(n):
            cov[a, c] = 0.0
            for j in range(modes):
                if weights[j] > 0.0:
                    cov[a, c] += weights[j] * (covs[j, a, c] + (means[j, a] - mean[a]) * (means[j, c] - mean[c]))


@inner_kernel
def _smooth_track(
    program, work, scratch, mean, cov, probs, times, chains, first, last, kin_mean, kin_cov, status, refused
):
    """Overwrite filtered ``mean``, ``cov``, ``probs`` of rows ``first`` to ``last`` by smoothed ones.

    A bank that began again took nothing along from before: rows up to there, and those just before whose measurements
    were refused, because the bank was lost already, learn nothing from later ones.
    """
    modes = program.sizes.size
    pair_mean, pair_cov, weights, priors = scratch.pair_mean, scratch.pair_cov, scratch.weights, scratch.priors
    ahead_mean, ahead_cov, cross = scratch.ahead_mean, scratch.ahead_cov, scratch.cross
    back_mean, back_cov, squares, vectors = scratch.back_mean, scratch.back_cov, scratch.squares, scratch.vectors
    factor, A, V, rows, gain, product = squares[0], squares[1], squares[2], squares[3], squares[4], squares[5]
    p, s, values, noises, line = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    P, S = squares[6], squares[7]
    lost = False
    for t in range(last - 1, first - 1, -1):
        lost = refused[t + 1] == BEGUN or (lost and (refused[t + 1] == REFUSED or status[t + 1] == MISSING))
        if lost:
            continue
        dt = times[t + 1] - times[t]
        work.cached_dt[modes] = np.nan
        if chains.size > 0:
            copy_matrix(chains[(t + 1) if chains.shape[0] > 1 else 0], work.chain, modes)
        elif program.per_step:
            copy_matrix(program.chain, work.chain, modes)
        else:
            transition_matrix(program.chain, dt, modes, work.chain_scratch, work.chain)
        good = True
        for i in range(modes):
            size = program.sizes[i]
            mass = 0.0
            for j in range(modes):
                priors[j] = work.chain[j, i] * probs[t, j] if probs[t + 1, i] > 0.0 else 0.0
                mass += priors[j]
            for j in range(modes):
                weights[i, j] = 0.0
                if priors[j] > 0.0:
                    priors[j] /= mass
                    _pair_prediction(
                        program, work, i, j, mean[t, j], cov[t, j], mean[t, i], cov[t, i], dt, mean[t + 1, i],
                        ahead_mean[j], ahead_cov[j], cross[j],
                    )  # fmt: skip
            if not mass > 0.0:
                continue
            _mixture(priors, ahead_mean, ahead_cov, modes, size, p, P)
            count = _future_likelihood(
                p, P, mean[t + 1, i], cov[t + 1, i], size, program.angular[i], factor, A, V, rows, values, noises
            )
            top = -np.inf
            for j in range(modes):
                if priors[j] > 0.0:
                    copy_vector(ahead_mean[j], s)
                    copy_matrix(ahead_cov[j], S, size)
                    log_density = _pair_update(program, i, p, V, values, noises, count, size, s, S, line)
                    weights[i, j] = np.log(priors[j]) + log_density
                    top = max(top, weights[i, j])
                    sound = _carry_back(
                        mean[t, j], cov[t, j], program.sizes[j], ahead_mean[j], ahead_cov[j], s, S, size, cross[j],
                        factor, gain, product, pair_mean[j, i], pair_cov[j, i],
                    )  # fmt: skip
                    good = good and sound
            mass = 0.0
            for j in range(modes):
                weights[i, j] = np.exp(weights[i, j] - top) if priors[j] > 0.0 else 0.0
                mass += weights[i, j]
            if not 0.0 < mass < np.inf:  # no pair explains the future: keep what the filter thought of them
                good = False
                mass = 1.0
                copy_vector(priors, weights[i])
            for j in range(modes):
                weights[i, j] *= probs[t + 1, i] / mass
        whole = 0.0
        for j in range(modes):
            n = program.sizes[j]
            mass = 0.0
            for i in range(modes):
                mass += weights[i, j]
            for i in range(modes):
                priors[i] = weights[i, j] / mass if mass > 0.0 else 0.0
            if mass > 0.0:
                _mixture(priors, pair_mean[j], pair_cov[j], modes, n, back_mean[j], back_cov[j])
            else:
                copy_vector(mean[t, j], back_mean[j])
                copy_matrix(cov[t, j], back_cov[j], n)
            probs[t, j] = mass
            whole += mass
        for j in range(modes):
            probs[t, j] /= whole
            copy_vector(back_mean[j], mean[t, j])
            copy_matrix(back_cov[j], cov[t, j], program.sizes[j])
        good = fuse(program, work, mean[t], cov[t], probs[t], kin_mean[t], kin_cov[t]) and good
        if not good and status[t] == OK:
            status[t] = REPAIRED
        if status[t] in (REPAIRED, DIVERGED):
            drop_impossible_correlations(work, kin_cov[t])
            loosen_correlations(kin_cov[t])


@entry_kernel
def smooth_tracks(program_handle, work_handle, scratch_handle, history, outputs, inputs, begin, end):
    """Smooth tracks ``begin`` to ``end`` in place, from the filter's ``history`` and ``outputs``."""
    program, work, scratch = program_at(program_handle), work_at(work_handle), smoother_at(scratch_handle)
    for b in range(begin, end):
        row = b if inputs.times.shape[0] > 1 else 0
        chains = inputs.chains[b if inputs.chains.shape[0] > 1 else 0] if inputs.chains.size > 0 else work.no_chains
        _smooth_track(
            program, work, scratch, history.mean[b], history.cov[b], outputs.mode_probs[b], inputs.times[row],
            chains, inputs.first[b], inputs.lengths[b] - 1, outputs.kin_mean[b], outputs.kin_cov[b],
            outputs.status[b], outputs.refused[b],
        )  # fmt: skip
