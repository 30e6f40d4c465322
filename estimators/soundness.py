"""What numbers are fit for use: measurements before a step, moments after it."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import inner_kernel
from jink.estimators.linalg import cholesky, total
from jink.estimators.records import ABSURD

__all__ = [
    "believable_parameters",
    "drop_impossible_correlations",
    "loosen_correlations",
    "sound_moments",
    "usable_components",
    "widen",
]

_FLOOR = 1e-14
_ROUNDED = 1e-9
_BELIEVABLE = 50.0
_LOOSENED = 1e-5


@inner_kernel
def usable_components(program, work, z, R, sensor):
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
def sound_moments(m, P, n, P_before):
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
def believable_parameters(program, j, m, P):
    """Whether own parameters of a nonlinear mode stayed within 50 standard deviations of their birth prior.

    One that did not is born anew, uncorrelated. A gross innovation may throw a turn rate to many turns per sample:
    sampled, such a turn looks like any motion there is, so no measurement ever brings it back.
    """
    believable = True
    if program.linear[j]:
        return True
    n = program.sizes[j]
    for k in range(program.own_counts[j]):
        i, variance = program.own_index[j, k], program.birth_cov[j, k, k]
        far = abs(m[i] - program.birth_mean[j, k])
        most = _BELIEVABLE * _BELIEVABLE * variance
        if variance > 0.0 and not program.angular[j, i] and not (far * far <= most and P[i, i] <= most):
            for c in range(n):
                P[i, c] = P[c, i] = 0.0
            m[i], P[i, i] = program.birth_mean[j, k], variance
            believable = False
    return believable


@inner_kernel
def drop_impossible_correlations(work, kin_cov):
    """Make a covariance that rounding left indefinite diagonal (of a lost track, with variances 1e40 apart)."""
    kin, square = kin_cov.shape[0], work.joint_square
    for a in range(kin):
        for b in range(kin):
            square[a, b] = kin_cov[a, b]
    if not cholesky(square, kin, work.upper):
        for a in range(kin):
            for b in range(kin):
                if a != b:
                    kin_cov[a, b] = 0.0


@inner_kernel
def loosen_correlations(kin_cov):
    """Take 1e-5 off every correlation: ``(1 - e) C + e D`` with the diagonal D is definite where C is to rounding.

    A zero pivot hides off-diagonals of the size of its square root, so a factor alone does not see what rounding took.
    """
    for a in range(kin_cov.shape[0]):
        for b in range(kin_cov.shape[0]):
            if a != b:
                kin_cov[a, b] *= 1.0 - _LOOSENED


@inner_kernel
def widen(kin_cov):
    """Ten times the standard deviations, within what numbers bear."""
    size = 0.0
    for a in range(kin_cov.shape[0]):
        size = max(size, kin_cov[a, a])
    if size < ABSURD:  # all or nothing: a covariance scaled in parts is none
        for a in range(kin_cov.shape[0]):
            for b in range(kin_cov.shape[0]):
                kin_cov[a, b] *= 100.0
