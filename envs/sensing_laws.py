"""From draws to times, places and measurements: compiled, row by row."""

from __future__ import annotations

import math

from jink.envs.compiled import kernel
from jink.estimators.compiled import call_observe
from jink.estimators.linalg import wrap_angle


@kernel
def poisson_gaps(uniforms, mean, longest, limit, gaps):
    """Exponential gaps (B, T - 1) given that they lie below ``longest``; together never above ``limit``."""
    B, T = gaps.shape
    reach = math.expm1(-longest / mean)
    for b in range(B):
        total = 0.0
        for t in range(T):
            gaps[b, t] = -mean * math.log1p(uniforms[b, t] * reach)
            total += gaps[b, t]
        if total > limit:
            for t in range(T):
                gaps[b, t] *= limit / total


@kernel
def carry(times, places, velocity, amplitude, period, states):
    """Positions and velocities (B, T, 2 A) of a platform at ``times``; the places (P, A) take turns."""
    B, T = times.shape
    P, A = places.shape
    speed = math.hypot(velocity[0], velocity[1])
    left_x, left_y = (-velocity[1] / speed, velocity[0] / speed) if speed > 0.0 else (0.0, 1.0)
    rate = 2.0 * math.pi / period
    for b in range(B):
        for k in range(T):
            t = times[b, k]
            for axis in range(A):
                states[b, k, axis] = places[k % P, axis] + velocity[axis] * t
                states[b, k, A + axis] = velocity[axis]
            if amplitude > 0.0:
                aside, swing = amplitude * math.sin(rate * t), amplitude * rate * math.cos(rate * t)
                states[b, k, 0] += left_x * aside
                states[b, k, 1] += left_y * aside
                states[b, k, A] += left_x * swing
                states[b, k, A + 1] += left_y * swing


@kernel
def see(
    position,
    velocity,
    uniforms,
    normals,
    skip,
    scale,
    bias,
    detected,
    states,
    address,
    params,
    sigma,
    angular,
    probability,
    loss,
    kin,
    measurements,
    noise,
):
    """Measurements ``h(kin, sensor) + sigma (bias + sqrt(scale) n)``, missed with ``1 - probability``.

    uniforms (B, T + T D): detection, then one per component for its loss; normals (B, skip + T D). In place: bias
    (nominal sigmas in, units of the measurement out), detected; out: measurements (B, T, D), noise (B, T, D, D).
    """
    B, T, D = measurements.shape
    A = position.shape[2]
    for b in range(B):
        for t in range(T):
            for axis in range(A):
                kin[axis] = position[b, t, axis]
                kin[A + axis] = velocity[b, t, axis]
            z = measurements[b, t]
            call_observe(address, kin, states[b, t], params, z)
            seen = detected[b, t] and uniforms[b, t] < probability
            some = False
            root = math.sqrt(scale[b, t])
            for d in range(D):
                bias[b, t, d] *= sigma[d]
                value = z[d] + bias[b, t, d] + sigma[d] * root * normals[b, skip + t * D + d]
                kept = seen and uniforms[b, T + t * D + d] >= loss
                z[d] = (wrap_angle(value) if angular[d] else value) if kept else math.nan
                some = some or kept
                for e in range(D):
                    noise[b, t, d, e] = 0.0
                noise[b, t, d, d] = sigma[d] * sigma[d] * scale[b, t]
            detected[b, t] = some


@kernel
def merge(times, latency, both, seen, delivered):
    """Times and times + latency (B, T) in one order, into (B, 2 T); and the columns at which each of them went."""
    B, T = times.shape
    for b in range(B):
        early, late = 0, 0
        for column in range(2 * T):
            if early < T and times[b, early] <= times[b, late] + latency:
                both[b, column] = times[b, early]
                seen[b, early] = column
                early += 1
            else:
                both[b, column] = times[b, late] + latency
                delivered[b, late] = column
                late += 1


@kernel
def pick(columns, position, velocity, acceleration, intent, out):
    """The samples of a path at ``columns`` (B, T), into the four arrays of ``out``."""
    B, T = columns.shape
    A = position.shape[2]
    for b in range(B):
        for k in range(T):
            column = columns[b, k]
            for axis in range(A):
                out[0][b, k, axis] = position[b, column, axis]
                out[1][b, k, axis] = velocity[b, column, axis]
                out[2][b, k, axis] = acceleration[b, column, axis]
            out[3][b, k] = intent[b, column]
