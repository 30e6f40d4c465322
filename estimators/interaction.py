"""Where the modes' states meet: mixing, births, jet conversions and resets between unlike states.

``to`` is the mode that receives (index p), ``old`` the mode that gives (index q). A converted state is ``x_pq``:
the old mode's estimate expressed in the receiving mode's components.
"""

from __future__ import annotations

from numba import types

from jink.estimators.compiled import call_assemble, call_own, call_transition, inner_kernel
from jink.estimators.kinematics import kinematics_of
from jink.estimators.linalg import average, cholesky, clear_rows, clear_tails, copy_rows, outer_add, wrap_angle
from jink.estimators.pieces import MATRIX, PROGRAM, STACK, VECTOR, WORK, piece
from jink.estimators.program import BIRTH, NONE, RESET
from jink.estimators.unscented import draw_points, point_weights, points_covariance, points_mean

__all__ = ["birth", "convert", "convert_point", "interact"]

_INSTANT = 1e-3


@inner_kernel
def convert_point(program, work, p, q, x, own, out):
    """One old state ``x`` of mode ``q`` as a state of mode ``p`` with own parameters ``own`` (overwritten)."""
    kin = work.kin.size
    kinematics_of(program, q, x, work.kin)
    if program.use_acceleration[p, q]:
        n = program.sizes[q]
        for i in range(kin):
            work.jet[i] = work.kin[i]
        ahead, behind = work.ahead, work.behind
        call_transition(
            program.transition[q], x[:n], _INSTANT, program.params[q, : program.param_counts[q]], work.vector[:n]
        )
        kinematics_of(program, q, work.vector, ahead)
        call_transition(
            program.transition[q], x[:n], -_INSTANT, program.params[q, : program.param_counts[q]], work.vector[:n]
        )
        kinematics_of(program, q, work.vector, behind)
        for i in range(kin // 2):
            work.jet[kin + i] = (ahead[kin // 2 + i] - behind[kin // 2 + i]) / (2.0 * _INSTANT)
        call_own(
            program.own_from_jet[p],
            work.jet,
            program.params[p, : program.param_counts[p]],
            own[: program.own_counts[p]],
        )
    assemble(program, p, work.kin, own, out)


@inner_kernel
def assemble(program, p, kin, own, out):
    """State of mode ``p`` from kinematics (2A,) and own parameters (K,)."""
    count = program.own_counts[p]
    if program.kin_index[p, 0] >= 0:
        for i in range(kin.size):
            out[program.kin_index[p, i]] = kin[i]
        for k in range(count):
            out[program.own_index[p, k]] = own[k]
    else:
        call_assemble(
            program.assemble[p], kin, own[:count], program.params[p, : program.param_counts[p]], out[: program.sizes[p]]
        )


@inner_kernel
def own_prior(program, p, m, P, born, mean, cov):
    """Own parameters of mode ``p``: its birth prior if ``born``, else its present estimate."""
    for k in range(program.own_counts[p]):
        mean[k] = program.birth_mean[p, k] if born else m[program.own_index[p, k]]
        for i in range(program.own_counts[p]):
            cov[k, i] = program.birth_cov[p, k, i] if born else P[program.own_index[p, k], program.own_index[p, i]]


@inner_kernel
def joint_points(program, work, p, q, m, P, own_mean, own_cov):
    """Points of the old state ``N(m, P)`` of mode ``q`` beside own parameters of mode ``p``; returns their count."""
    n = program.sizes[q]
    count = program.drawn[p, q]
    joint = n + count
    good = cholesky(P, n, work.upper)
    for i in range(n):
        for c in range(n, joint):
            work.upper[i, c] = 0.0
        work.vector[i] = m[i]
    factor = work.own_factor
    for k in range(count):
        work.vector[n + k] = own_mean[k]
    good = cholesky(own_cov, count, factor) and good
    for k in range(count):
        for c in range(joint):
            work.upper[n + k, c] = factor[k, c - n] if c >= n else 0.0
    radius, _, _ = point_weights(joint, program.tuning[0], program.tuning[1], program.tuning[2])
    draw_points(work.vector, work.upper, joint, radius, work.points)
    return 2 * joint + 1, good


@piece(
    types.boolean, PROGRAM, WORK, types.int64, types.int64, VECTOR, MATRIX, VECTOR, MATRIX, VECTOR, VECTOR, MATRIX
)  # fmt: skip
def convert(program, work, p, q, m, P, own_mean, own_cov, near, m_out, P_out):
    """Mean and covariance of a state of mode ``q`` as a state of mode ``p``, by the unscented transform.

    Model: ``c = Gamma_p(J_q(x), own)`` with ``x ~ N(m, P)`` and independent ``own ~ N(own_mean, own_cov)``.
    Angles are averaged around ``near``, the receiving mode's own state.
    Source: Yuan et al. (2012), Granstrom et al. (2015) for unequal states. Differs: own parameters
    that the jet determines are computed, others are drawn.
    """
    n = program.sizes[q]
    size = program.sizes[p]
    count, good = joint_points(program, work, p, q, m, P, own_mean, own_cov)
    clear_tails(work.moved, count, size)
    for s in range(count):
        for k in range(program.drawn[p, q]):
            work.own[k] = work.points[s, n + k]
        convert_point(program, work, p, q, work.points[s], work.own, work.moved[s])
        for i in range(size):
            if program.angular[p, i]:
                anchor = near[i] if s == 0 else work.moved[0, i]
                work.moved[s, i] = anchor + wrap_angle(work.moved[s, i] - anchor)
    joint = n + program.drawn[p, q]
    _, centre, other = point_weights(joint, program.tuning[0], program.tuning[1], program.tuning[2])
    points_mean(work.moved, count, size, other, m_out)
    clear_rows(P_out, size)
    points_covariance(work.moved, count, size, centre, other, P_out)
    return good


@inner_kernel
def _gather(program, p, q, m, P, own_m, own_P, born, m_out, P_out):
    """Convert by choosing components; those without a source come from own parameters, uncorrelated."""
    size = program.sizes[p]
    for i in range(size):
        from_i = program.source[p, q, i]
        m_out[i] = m[from_i] if from_i >= 0 else own_m[i]
        for k in range(size):
            from_k = program.source[p, q, k]
            if from_i >= 0 and from_k >= 0:
                P_out[i, k] = P[from_i, from_k]
            elif from_i < 0 and from_k < 0 and not born:
                P_out[i, k] = own_P[i, k]
            else:
                P_out[i, k] = 0.0
    if born:
        for k in range(program.own_counts[p]):
            i = program.own_index[p, k]
            if program.source[p, q, i] < 0:
                m_out[i] = program.birth_mean[p, k]
                for other in range(program.own_counts[p]):
                    c = program.own_index[p, other]
                    if program.source[p, q, c] < 0:
                        P_out[i, c] = program.birth_cov[p, k, other]


@piece(types.boolean, PROGRAM, WORK, types.int64, VECTOR, MATRIX, VECTOR, MATRIX)
def birth(program, work, p, kin_mean, kin_cov, m_out, P_out):
    """Begin mode ``p`` at kinematics ``N(kin_mean, kin_cov)`` with own parameters from its birth prior."""
    kin = kin_mean.size
    size = program.sizes[p]
    count = program.own_counts[p]
    for i in range(P_out.shape[0]):
        m_out[i] = 0.0
        for k in range(P_out.shape[1]):
            P_out[i, k] = 0.0
    if program.kin_index[p, 0] >= 0:
        for a in range(kin):
            m_out[program.kin_index[p, a]] = kin_mean[a]
            for b in range(kin):
                P_out[program.kin_index[p, a], program.kin_index[p, b]] = kin_cov[a, b]
        for k in range(count):
            m_out[program.own_index[p, k]] = program.birth_mean[p, k]
            for i in range(count):
                P_out[program.own_index[p, k], program.own_index[p, i]] = program.birth_cov[p, k, i]
        return True
    joint = kin + count
    square, mean = work.joint_square, work.vector
    for i in range(joint):
        for k in range(joint):
            square[i, k] = 0.0
    for a in range(kin):
        mean[a] = kin_mean[a]
        for b in range(kin):
            square[a, b] = kin_cov[a, b]
    for k in range(count):
        mean[kin + k] = program.birth_mean[p, k]
        for i in range(count):
            square[kin + k, kin + i] = program.birth_cov[p, k, i]
    good = cholesky(square, joint, work.upper)
    radius, centre, other = point_weights(joint, program.tuning[0], program.tuning[1], program.tuning[2])
    points = work.points
    draw_points(mean, work.upper, joint, radius, points)
    clear_tails(work.moved, 2 * joint + 1, size)
    for s in range(2 * joint + 1):
        assemble(program, p, points[s, :kin], points[s, kin:joint], work.moved[s])
        for i in range(size):
            if program.angular[p, i] and s > 0:
                work.moved[s, i] = work.moved[0, i] + wrap_angle(work.moved[s, i] - work.moved[0, i])
    points_mean(work.moved, 2 * joint + 1, size, other, m_out)
    points_covariance(work.moved, 2 * joint + 1, size, centre, other, P_out)
    return good


@inner_kernel
def _moment_match(program, work, p, means, covs, n, m_out, P_out):
    """Mean and covariance of the mixture ``sum_q weights[q] N(means[q], covs[q])`` for mode ``p``."""
    modes, weights, spreads, scaled = program.sizes.size, work.weights, work.points, work.scaled
    widening = program.spread_scale[p]
    for i in range(n):
        total = 0.0
        for q in range(modes):
            if weights[q] > 0.0:
                total += weights[q] * means[q, i]
        m_out[i] = total
    average(covs, weights, modes, n, P_out)
    for q in range(modes):
        weight = weights[q]
        for i in range(n):
            spread = means[q, i] - m_out[i] if weight > 0.0 else 0.0
            spreads[q, i] = spread
            scaled[q, i] = weight * spread * widening
    outer_add(P_out, scaled, spreads, 0, modes, 1.0, n)


@inner_kernel
def _collapse(program, work, mean, cov, probs):
    """Moments of each intent over its noise levels into ``work.predicted_*`` of its first mode; all modes' priors."""
    modes, weights, chain = program.sizes.size, work.weights, work.chain
    for p in range(modes):
        total = 0.0
        for q in range(modes):
            total += chain[q, p] * probs[q]
        work.prior[p] = total
    for p in range(modes):
        if program.leader[p] != p:
            continue
        n = program.sizes[p]
        total, heaviest = 0.0, p
        for q in range(modes):
            weights[q] = probs[q] if program.leader[q] == p else 0.0
            total += weights[q]
            if weights[q] > weights[heaviest]:
                heaviest = q
        if not total > 0.0:
            weights[p] = total = 1.0
        for q in range(modes):
            weights[q] /= total
            if weights[q] > 0.0:
                for i in range(n):
                    work.part_mean[q, i] = mean[q, i]
                    if program.angular[p, i]:
                        work.part_mean[q, i] = mean[heaviest, i] + wrap_angle(mean[q, i] - mean[heaviest, i])
        _moment_match(program, work, p, work.part_mean, cov, n, work.predicted_mean[p], work.predicted_cov[p])


@inner_kernel
def _weigh_intents(program, work, probs, p):
    """Joint probability of each intent before, at its first mode, and intent ``p`` now, into ``work.weights``."""
    modes, weights, chain = program.sizes.size, work.weights, work.chain
    for q in range(modes):
        weights[q] = 0.0
    total = 0.0
    for q in range(modes):
        share = 0.0
        for now in range(modes):
            if program.leader[now] == p:
                share += chain[q, now] * probs[q]
        weights[program.leader[q]] += share
        total += share
    return total


@piece(types.boolean, PROGRAM, WORK, MATRIX, STACK, VECTOR)
def interact(program, work, own_mean, own_cov, probs):
    """Prior mode probabilities, and each mode's starting point for this step.

    Model: ``cbar_p = sum_q Pi[q, p] mu_q``; weights ``mu_q|p = Pi[q, p] mu_q / cbar_p``; mode ``p`` starts from the
    moments of the mixture of all converted states. With rules ``none`` and ``reset`` it starts from its own.
    Where modes of one intent share their prediction, intents take the place of modes: levels are collapsed first.
    Fills ``work.prior`` (M,), ``work.mixed_mean``, ``work.mixed_cov``; returns whether all went well.
    Source: Blom & Bar-Shalom (1988). Differs: unlike states are converted first; births are ours.
    """
    modes, weights, chain = program.sizes.size, work.weights, work.chain
    good = True
    mean, cov = own_mean, own_cov
    if program.shared:
        _collapse(program, work, mean, cov, probs)
        mean, cov = work.predicted_mean, work.predicted_cov
    for p in range(modes):
        if program.leader[p] != p:
            continue
        n = program.sizes[p]
        total = 0.0
        if program.shared:
            total = _weigh_intents(program, work, probs, p)
        else:
            for q in range(modes):
                weights[q] = chain[q, p] * probs[q]
                total += weights[q]
            work.prior[p] = total
        separate = program.rule == NONE or program.rule == RESET or not total > 0.0
        if not separate:
            others = 0.0
            for q in range(modes):
                weights[q] /= total
                if q != p:
                    others += weights[q]
            separate = not others > 0.0
        if separate:
            for i in range(n):
                work.mixed_mean[p, i] = mean[p, i]
            copy_rows(cov[p], work.mixed_cov[p], n)
            continue
        if program.same_layout:
            _moment_match(program, work, p, mean, cov, n, work.mixed_mean[p], work.mixed_cov[p])
            continue
        born = program.rule == BIRTH
        for q in range(modes):
            if weights[q] > 0.0:
                if program.gathered[p, q]:
                    _gather(program, p, q, mean[q], cov[q], mean[p], cov[p], born, work.part_mean[q], work.part_cov[q])
                else:
                    own_prior(program, p, mean[p], cov[p], born, work.own_mean, work.own_cov)
                    good = (
                        convert(
                            program, work, p, q, mean[q], cov[q], work.own_mean, work.own_cov, mean[p],
                            work.part_mean[q], work.part_cov[q],
                        )
                        and good
                    )  # fmt: skip
                for i in range(n):
                    if program.angular[p, i]:
                        work.part_mean[q, i] = mean[p, i] + wrap_angle(work.part_mean[q, i] - mean[p, i])
        _moment_match(program, work, p, work.part_mean, work.part_cov, n, work.mixed_mean[p], work.mixed_cov[p])
    return good
