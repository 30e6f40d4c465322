"""What surges do to one episode after another: compiled, row by row, from given uniforms and normals.

Every law has the same arguments: times (B, T); its own uniforms (B, U) and normals (B, Z); parameters; and what
it changes in place, scale (B, T), bias (B, T, D) in nominal standard deviations, detected (B, T). A dwell is told by
two parameters (`jink.envs.spans.ends_of`), a level too: the lowest, and the logarithm of highest over lowest.
"""

from __future__ import annotations

import math

import numpy as np

from jink.envs.compiled import inner_kernel, kernel

ATTEMPTS = 5  # each of Marsaglia and Tsang's succeeds with probability > 0.95: all fail in 3e-7 of the cases


@inner_kernel
def dwell_time(low, high, u):
    """A dwell from a uniform number: uniform in [low, high], exponential of mean ``low`` where ``high`` < 0."""
    if high < 0.0:
        return -low * math.log1p(-u)
    return low + u * (high - low)


@inner_kernel
def remaining_dwell(low, high, u, v):
    """What is left of a dwell met at a random moment (long ones are met more often)."""
    if high < 0.0:
        return -low * math.log1p(-u)
    return u * math.sqrt(low * low + v * (high * high - low * low))


@kernel
def bursts(times, uniforms, normals, params, scale, bias, detected):
    """Two-state semi-Markov chain, stationary from the start; params: on (2), off (2), level (2), missed."""
    B, T = times.shape
    on_low, on_high, off_low, off_high = params[0], params[1], params[2], params[3]
    level, width, missed = params[4], params[5], params[6] > 0.0
    mean_on = on_low if on_high < 0.0 else 0.5 * (on_low + on_high)
    mean_off = off_low if off_high < 0.0 else 0.5 * (off_low + off_high)
    last = uniforms.shape[1] - 2
    for b in range(B):
        on = uniforms[b, 0] < mean_on / (mean_on + mean_off)
        low, high = (on_low, on_high) if on else (off_low, off_high)
        i = 2
        end = remaining_dwell(low, high, uniforms[b, i], uniforms[b, 1])
        for t in range(T):
            while times[b, t] >= end and i < last:
                on = not on
                low, high = (on_low, on_high) if on else (off_low, off_high)
                i += 2
                end += dwell_time(low, high, uniforms[b, i])
            if on:
                if missed:
                    detected[b, t] = False
                else:
                    scale[b, t] *= level * math.exp(width * uniforms[b, i + 1])


@kernel
def placed_bursts(times, uniforms, normals, params, scale, bias, detected):
    """Bursts of given lengths, each once, in random order and place; params: earliest, level (2), lengths."""
    B, T = times.shape
    count = params.shape[0] - 3
    total = 0.0
    for i in range(count):
        total += params[3 + i]
    for b in range(B):
        free = max(0.0, times[b, T - 1] - params[0] - total)
        for i in range(count):
            u = uniforms[b, 2 * i]
            start = params[0] + free * u
            for j in range(count):
                if uniforms[b, 2 * j] < u:
                    start += params[3 + j]
            factor = params[1] * math.exp(params[2] * uniforms[b, 2 * i + 1])
            for t in range(T):
                if start <= times[b, t] < start + params[3 + i]:
                    scale[b, t] *= factor


@kernel
def outliers(times, uniforms, normals, params, scale, bias, detected):
    """Independent samples; params: probability, level (2)."""
    B, T = times.shape
    for b in range(B):
        for t in range(T):
            if uniforms[b, 2 * t] < params[0]:
                scale[b, t] *= params[1] * math.exp(params[2] * uniforms[b, 2 * t + 1])


@kernel
def ramps(times, uniforms, normals, params, scale, bias, detected):
    """Quiet, rise, hold, fall, quiet, ...; params: quiet (2), rise, hold, fall, peak (2)."""
    B, T = times.shape
    rise, hold, fall = params[2], params[3], params[4]
    last = uniforms.shape[1] - 2
    for b in range(B):
        i = 0
        start = dwell_time(params[0], params[1], uniforms[b, i])
        peak = params[5] * math.exp(params[6] * uniforms[b, i + 1])
        for t in range(T):
            while times[b, t] >= start + rise + hold + fall and i < last:
                i += 2
                start += rise + hold + fall + dwell_time(params[0], params[1], uniforms[b, i])
                peak = params[5] * math.exp(params[6] * uniforms[b, i + 1])
            since = times[b, t] - start
            if 0.0 < since < rise + hold + fall:
                part = min(1.0, since / rise, (rise + hold + fall - since) / fall)
                scale[b, t] *= peak**part


@inner_kernel
def gamma_variate(shape, uniforms, normals, b, i, j):
    """Gamma(shape) by Marsaglia and Tsang (2000) from `ATTEMPTS` pairs and one more uniform."""
    raised = shape if shape >= 1.0 else shape + 1.0
    d = raised - 1.0 / 3.0
    c = 1.0 / math.sqrt(9.0 * d)
    value = d
    for attempt in range(ATTEMPTS):
        x = normals[b, j + attempt]
        v = (1.0 + c * x) ** 3
        if v > 0.0:
            value = d * v
            if math.log(1.0 - uniforms[b, i + attempt]) < 0.5 * x * x + d - d * v + d * math.log(v):
                break
    if shape < 1.0:
        value *= (1.0 - uniforms[b, i + ATTEMPTS]) ** (1.0 / shape)
    return value


@kernel
def heavy_tails(times, uniforms, normals, params, scale, bias, detected):
    """Student-t as a scale mixture: factor nu / chi2_nu, independent samples; params: nu."""
    B, T = times.shape
    nu = params[0]
    for b in range(B):
        for t in range(T):
            i, j = t * (ATTEMPTS + 1), t * ATTEMPTS
            scale[b, t] *= 0.5 * nu / gamma_variate(0.5 * nu, uniforms, normals, b, i, j)


@kernel
def flashes(times, uniforms, normals, params, scale, bias, detected):
    """Periodic, at a random phase; params: period, width, level (2)."""
    B, T = times.shape
    period, width = params[0], params[1]
    for b in range(B):
        phase = uniforms[b, 0] * period
        factor = params[2] * math.exp(params[3] * uniforms[b, 1])
        for t in range(T):
            if np.mod(times[b, t] + phase, period) < width:
                scale[b, t] *= factor


@kernel
def drifts(times, uniforms, normals, params, scale, bias, detected):
    """Ornstein-Uhlenbeck bias of every component, stationary from the start; params: sigma, time constant."""
    B, T, D = bias.shape
    for b in range(B):
        for d in range(D):
            value = params[0] * normals[b, d]
            bias[b, 0, d] += value
            for t in range(1, T):
                dt = times[b, t] - times[b, t - 1]
                kept = math.exp(-dt / params[1])
                fresh = params[0] * math.sqrt(-math.expm1(-2.0 * dt / params[1]))
                value = kept * value + fresh * normals[b, t * D + d]
                bias[b, t, d] += value


@kernel
def walks(times, uniforms, normals, params, scale, bias, detected):
    """Random walk of the bias of every component from zero; params: standard deviation after one second."""
    B, T, D = bias.shape
    for b in range(B):
        for d in range(D):
            value = 0.0
            for t in range(1, T):
                value += params[0] * math.sqrt(times[b, t] - times[b, t - 1]) * normals[b, t * D + d]
                bias[b, t, d] += value
