"""What the bank does with one mode: kinematics, process noise, prediction, and measurement of a prediction."""

from __future__ import annotations

from numba import types

from jink.estimators.compiled import call_noise, call_observe, call_transition, inner_kernel
from jink.estimators.kalman import gaussian_update, posterior_from_deviations, predict_linear
from jink.estimators.kinematics import kinematics_of
from jink.estimators.linalg import (
    cholesky,
    clear_rows,
    clear_tails,
    copy_rows,
    multiply,
    offset_rows,
    outer_add,
    wrap_angle,
)
from jink.estimators.pieces import MATRIX, PROGRAM, VECTOR, WORK, piece
from jink.estimators.treatment_kernels import ADAPTING, adapt_noise, finish_treated, prepare_noise
from jink.estimators.unscented import draw_points, point_weights, points_mean, unscented_predict

__all__ = ["measure_mode", "mode_kinematics", "predict_mode", "process_noise", "update_mode"]

_NODES = (0.1127016653792583, 0.5, 0.8872983346207417)
_NODE_WEIGHTS = (0.2777777777777778, 0.4444444444444444, 0.2777777777777778)


@inner_kernel
def process_noise(program, work, j, x, dt, Q):
    """Process noise of mode ``j`` over ``dt`` from state ``x`` into ``Q`` (n, n).

    Without a closed form: ``Q = int_0^dt Phi(s) diag(diffusion) Phi(s)' ds`` by three-point Gauss-Legendre (exact
    for polynomial flows up to constant acceleration), columns of ``Phi`` by central differences.
    """
    n = program.sizes[j]
    clear_rows(Q, n)
    weight = program.process_scale[j]
    if program.noise[j] != 0:
        call_noise(program.noise[j], x[:n], dt, program.params[j, : program.param_counts[j]], Q[:n, :n])
        if weight != 1.0:
            for i in range(n):
                for k in range(n):
                    Q[i, k] *= weight
        return
    params = program.params[j, : program.param_counts[j]]
    for c in range(n):
        density = program.diffusion[j, c]
        if density > 0.0:
            step = 1e-5 * (1.0 + abs(x[c]))
            for node in range(3):
                duration = dt * _NODES[node]
                for i in range(n):
                    work.points[0, i] = x[i]
                work.points[0, c] = x[c] + step
                call_transition(program.transition[j], work.points[0, :n], duration, params, work.moved[0, :n])
                work.points[0, c] = x[c] - step
                call_transition(program.transition[j], work.points[0, :n], duration, params, work.moved[1, :n])
                scale = dt * _NODE_WEIGHTS[node] * density / (4.0 * step * step) * weight
                for i in range(n):
                    slope = work.moved[0, i] - work.moved[1, i]
                    for k in range(n):
                        Q[i, k] += scale * slope * (work.moved[0, k] - work.moved[1, k])


@inner_kernel
def transition_tables(program, work, j, dt):
    """F' and Q of a linear mode, computed only when ``dt`` changed (at the zero state: all are alike)."""
    if work.cached_dt[j] == dt:
        return
    n = program.sizes[j]
    unit, address, params, rows = (
        work.vector,
        program.transition[j],
        program.params[j, : program.param_counts[j]],
        work.F_transposed[j],
    )
    for c in range(n):
        unit[c] = 0.0
    for c in range(n):
        unit[c] = 1.0
        call_transition(address, unit[:n], dt, params, rows[c, :n])
        unit[c] = 0.0
    process_noise(program, work, j, unit, dt, work.Q[j])
    work.cached_dt[j] = dt


@piece(types.boolean, PROGRAM, WORK, types.int64, VECTOR, MATRIX, types.float64, VECTOR, MATRIX)
def predict_mode(program, work, j, m, P, dt, m_out, P_out):
    """Prediction of mode ``j`` over ``dt`` seconds; returns whether P was positive semidefinite.

    A linear motion costs what a Kalman filter costs: for it the unscented transform is exact and equals ``F m``,
    ``F P F' + Q``.
    """
    n = program.sizes[j]
    if program.linear[j]:
        transition_tables(program, work, j, dt)
        predict_linear(m, P, work.F_transposed[j], work.Q[j], n, work.product, m_out, P_out)
        return True
    process_noise(program, work, j, m, dt, work.Q[j])
    return unscented_predict(
        program.transition[j], program.params[j, : program.param_counts[j]], dt, m, P, work.Q[j], n, program.tuning,
        work.upper, work.points, work.moved, m_out, P_out,
    )  # fmt: skip


@piece(
    types.Tuple((types.boolean, types.boolean)), PROGRAM, WORK, types.int64, VECTOR, MATRIX, VECTOR, VECTOR, types.int64
)  # fmt: skip
def measure_mode(program, work, j, m, P, sensor, z, d):
    """Innovation, its covariance and the cross covariance of mode ``j`` with the ``d`` components present.

    Fills ``work.innovation[j]``, ``work.S``, ``work.cross``, ``work.H``; returns (linear, good). Points are redrawn
    from the prediction, so Q is seen. Angles are averaged about the centre point and wrapped.
    """
    n = program.sizes[j]
    present, kin, index = work.present, work.kin, program.kin_index[j]
    S, R, H, cross, innovation = work.S, work.R, work.H, work.cross, work.innovation[j]
    angular = program.sensor_angular
    if program.sensor_linear and index[0] >= 0:
        matrix, wide = program.sensor_matrix, P.shape[1]
        for a in range(d):
            for c in range(wide):
                H[a, c] = 0.0
                cross[a, c] = 0.0
            predicted = 0.0
            for i in range(kin.size):
                entry = matrix[present[a], i]
                if entry != 0.0:
                    row = index[i]
                    H[a, row] = entry
                    predicted += entry * m[row]
                    for c in range(wide):
                        cross[a, c] += entry * P[row, c]
            v = z[present[a]] - predicted
            innovation[a] = wrap_angle(v) if angular[present[a]] else v
        for a in range(d):
            for b in range(d):
                value = R[a, b]
                for i in range(kin.size):
                    entry = matrix[present[b], i]
                    if entry != 0.0:
                        value += entry * cross[a, index[i]]
                S[a, b] = value
        return True, True
    points, seen, sensed, mean = work.points, work.seen, work.sensed, work.vector
    observe, params = program.observe, program.sensor_params
    upper = work.upper
    good = cholesky(P, n, upper)
    radius, centre, other = point_weights(n, program.tuning[0], program.tuning[1], program.tuning[2])
    draw_points(m, upper, n, radius, points)
    count = 2 * n + 1
    clear_tails(seen, count, d)
    for s in range(count):
        kinematics_of(program, j, points[s], kin)
        call_observe(observe, kin, sensor, params, sensed)
        for a in range(d):
            value = sensed[present[a]]
            if s > 0 and angular[present[a]]:
                value = seen[0, a] + wrap_angle(value - seen[0, a])
            seen[s, a] = value
    points_mean(seen, count, d, other, mean)
    for a in range(d):
        v = z[present[a]] - mean[a]
        innovation[a] = wrap_angle(v) if angular[present[a]] else v
        for s in range(n):
            work.gain[a, s] = other * radius * (seen[1 + s, a] - seen[1 + n + s, a])
    copy_rows(R, S, d)
    outer_add(S, seen, seen, 0, 1, centre, d)
    outer_add(S, seen, seen, 1, count, other, d)
    multiply(work.gain, upper, d, n, cross)  # the root, not points - m: next to a large m those have lost its digits
    return False, good


@piece(types.void, PROGRAM, WORK, types.int64, types.boolean, MATRIX, types.int64, MATRIX)
def careful_covariance(program, work, j, linear, P, d, P_out):
    """Posterior covariance of mode ``j`` where the short form cancels; after `measure_mode` and the update."""
    n, root, points, seen, H = program.sizes[j], work.upper, work.points, work.seen, work.H
    if linear:
        radius, centre, other, count = 1.0, 1.0, 1.0, n
        cholesky(P, n, root)
        copy_rows(root, points, n)
        for s in range(n):
            for a in range(d):
                seen[s, a] = 0.0
                for c in range(n):
                    seen[s, a] += H[a, c] * root[s, c]
    else:
        radius, centre, other = point_weights(n, program.tuning[0], program.tuning[1], program.tuning[2])
        count = 2 * n + 1
        for c in range(n):
            points[0, c] = 0.0
        offset_rows(root, n, radius, points)
    posterior_from_deviations(
        points, seen, count, centre, other, work.R, work.cross, work.factor, d, n, work.gain, P_out
    )  # fmt: skip


_UPDATED = types.Tuple((types.float64, types.float64, types.boolean))


@piece(_UPDATED, PROGRAM, WORK, types.int64, VECTOR, MATRIX, VECTOR, VECTOR, types.int64, VECTOR, MATRIX)
def update_mode(program, work, j, m, P, sensor, z, d, m_out, P_out):
    """Posterior of mode ``j`` given the ``d`` components present; returns (log density, NIS, whether all went well)."""
    treated, density = program.treated[j], 0.0
    if treated:
        prepare_noise(program, work, j, d)
    linear, good = measure_mode(program, work, j, m, P, sensor, z, d)
    if program.watched:
        calm = work.noise_kept if treated else work.R
        for a in range(d):
            for b in range(d):
                work.S_calm[j, a, b] = work.S[a, b] - work.R[a, b] + program.calm * calm[a, b]
    if treated & ADAPTING:
        density = adapt_noise(program, work, j, d)
    copy_rows(work.S, work.S_modes[j], d)
    log_density, nis, definite, lost = gaussian_update(
        m, P, work.R, work.cross, work.S, work.innovation[j], d, program.sizes[j],
        work.factor, work.gain, work.whitened, m_out, P_out,
    )  # fmt: skip
    if lost:
        careful_covariance(program, work, j, linear, P, d, P_out)
    if treated:
        log_density = finish_treated(program, work, j, d, density, log_density, nis, P_out)
    return log_density, nis, good and definite


@piece(types.boolean, PROGRAM, WORK, types.int64, VECTOR, MATRIX, VECTOR, MATRIX)
def mode_kinematics(program, work, j, m, P, mean_out, cov_out):
    """Mean (2A,) and covariance (2A, 2A) of position and velocity of mode ``j`` (unscented where nonlinear)."""
    kin, index = mean_out.size, program.kin_index[j]
    if index[0] >= 0:
        for a in range(kin):
            row = index[a]
            mean_out[a] = m[row]
            for b in range(kin):
                cov_out[a, b] = P[row, index[b]]
        return True
    n = program.sizes[j]
    good = cholesky(P, n, work.upper)
    radius, centre, other = point_weights(n, program.tuning[0], program.tuning[1], program.tuning[2])
    draw_points(m, work.upper, n, radius, work.points)
    count = 2 * n + 1
    clear_tails(work.moved, count, kin)
    for s in range(count):
        kinematics_of(program, j, work.points[s], work.kin)
        for a in range(kin):
            work.moved[s, a] = work.kin[a]
    points_mean(work.moved, count, kin, other, work.vector)
    for a in range(kin):
        mean_out[a] = work.vector[a]
        for b in range(kin):
            total = 0.0
            for s in range(count):
                total += (centre if s == 0 else other) * work.moved[s, a] * work.moved[s, b]
            cov_out[a, b] = total
    return good
