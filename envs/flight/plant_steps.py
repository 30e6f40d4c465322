"""Compiled steps of a linear plant with bounded model error."""

from __future__ import annotations

import math

import numpy as np

from jink.envs.compiled import entry_kernel, inner_kernel

VELOCITY, ACCELERATION = 2, 3
"""States per axis: white acceleration drives position and velocity, white jerk drives acceleration too."""


@inner_kernel
def _fill(F, G, per_axis, density, dt):
    """Transition and noise gain over ``dt``: ``G G'`` is the exact covariance of the integrated white noise.

    Cholesky factors of ``[[1/3, 1/2], [1/2, 1]]`` and ``[[1/20, 1/8, 1/6], [1/8, 1/3, 1/2], [1/6, 1/2, 1]]`` with
    the powers of ``dt`` taken out.
    """
    n = F.shape[0]
    root = math.sqrt(density * dt)
    for i in range(n):
        for j in range(n):
            F[i, j] = 1.0 if i == j else 0.0
            G[i, j] = 0.0
    for i in range(0, n, per_axis):
        F[i, i + 1] = dt
        if per_axis == VELOCITY:
            G[i, i] = root * dt / math.sqrt(3.0)
            G[i + 1, i] = root * math.sqrt(3.0) / 2.0
            G[i + 1, i + 1] = root / 2.0
        else:
            F[i, i + 2] = 0.5 * dt * dt
            F[i + 1, i + 2] = dt
            G[i, i] = root * dt * dt / math.sqrt(20.0)
            G[i + 1, i] = root * dt * math.sqrt(20.0) / 8.0
            G[i + 1, i + 1] = root * dt / math.sqrt(48.0)
            G[i + 2, i] = root * math.sqrt(20.0) / 6.0
            G[i + 2, i + 1] = root * math.sqrt(48.0) / 12.0
            G[i + 2, i + 2] = root / 3.0


@entry_kernel
def run_plant(dt, per_axis, density, F, G, M, Ef, Eg, delta, noise, states):
    """States (B, T, n) from ``states[:, 0]``: ``x+ = (F + M Delta Ef) x + (G + M Delta Eg) u``.

    dt: (B, T - 1) s; a step of 0 changes nothing. per_axis: `VELOCITY` or `ACCELERATION`: F and G are filled in for
    each ``dt``; 0: they are given. delta: (B, T - 1 or 1, q, t). noise: u, (B, T - 1, m).
    """
    rows, steps = dt.shape
    n = F.shape[0]
    m = noise.shape[2]
    q = M.shape[1]
    seen = np.empty(Ef.shape[0])
    F = F.copy()
    G = G.copy()
    for b in range(rows):
        filled = -1.0
        for k in range(steps):
            h = dt[b, k]
            if h == 0.0:
                for i in range(n):
                    states[b, k + 1, i] = states[b, k, i]
                continue
            if per_axis > 0 and h != filled:
                _fill(F, G, per_axis, density, h)
                filled = h
            for i in range(seen.size):
                total = 0.0
                for j in range(n):
                    total += Ef[i, j] * states[b, k, j]
                for j in range(m):
                    total += Eg[i, j] * noise[b, k, j]
                seen[i] = total
            at = min(k, delta.shape[1] - 1)
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += F[i, j] * states[b, k, j]
                for j in range(m):
                    total += G[i, j] * noise[b, k, j]
                for j in range(q):
                    error = 0.0
                    for c in range(seen.size):
                        error += delta[b, at, j, c] * seen[c]
                    total += M[i, j] * error
                states[b, k + 1, i] = total
