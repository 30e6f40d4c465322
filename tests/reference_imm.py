"""Textbook Kalman and IMM filters in plain numpy, all runs at once: the second opinion for published numbers.

Written from Blom and Bar-Shalom (1988) alone and slow on purpose; it shares no code with the package. B runs,
T samples, M modes, N state, D measurement. The first sample is an update without a prediction;
`start_used=True` says that the start already contains it.
"""

from typing import NamedTuple

import numpy as np


class Modes(NamedTuple):
    """M linear modes over one common state."""

    transition: np.ndarray  # (M, N, N)
    drift: np.ndarray  # (M, N)
    process_noise: np.ndarray  # (M, N, N)
    observation: np.ndarray  # (D, N)
    noise: np.ndarray  # (D, D)


def update(mean, cov, z, observation, noise):
    """One Kalman update; returns mean (..., N), cov (..., N, N) and the log likelihood (...)."""
    v = z - mean @ observation.T
    s = observation @ cov @ observation.T + noise
    k = np.swapaxes(np.linalg.solve(s, observation @ cov), -1, -2)
    mean = mean + np.einsum("...ij,...j->...i", k, v)
    rest = np.eye(cov.shape[-1]) - k @ observation
    cov = rest @ cov @ np.swapaxes(rest, -1, -2) + k @ noise @ np.swapaxes(k, -1, -2)
    d2 = np.einsum("...i,...i->...", v, np.linalg.solve(s, v[..., None])[..., 0])
    return mean, cov, -0.5 * (d2 + np.linalg.slogdet(2 * np.pi * s)[1])


def run_kalman(modes, z, mean, cov, mode=None, start_used=False):
    """Kalman filter; `mode` (B, T) names the mode of each step (default: mode 0 throughout).

    Returns the filtered means (B, T, N) and covariances (B, T, N, N).
    """
    runs, steps = z.shape[:2]
    mode = np.zeros((runs, steps), dtype=int) if mode is None else mode
    means, covs = [], []
    for k in range(steps):
        if k > 0:
            f, q = modes.transition[mode[:, k]], modes.process_noise[mode[:, k]]
            mean = np.einsum("bij,bj->bi", f, mean) + modes.drift[mode[:, k]]
            cov = f @ cov @ np.swapaxes(f, -1, -2) + q
        if k > 0 or not start_used:
            mean, cov, _ = update(mean, cov, z[:, k], modes.observation, modes.noise)
        means.append(mean)
        covs.append(cov)
    return np.stack(means, 1), np.stack(covs, 1)


def mix(mu, pi, mean, cov, known):
    """IMM mixing; `known` (M, N) marks the components that a mode determines.

    A component unknown to the source is filled with the target's own mean and covariance block, cross-blocks
    zero.
    """
    b, m, n = mean.shape
    predicted = mu @ pi
    weight = pi[None] * mu[:, :, None] / predicted[:, None, :]  # (B, from, to)
    source_mean = np.where(known[:, None], mean[:, :, None], mean[:, None, :])  # (B, from, to, N)
    both = known[:, :, None] & known[:, None, :]
    neither = ~known[:, :, None] & ~known[:, None, :]
    source_cov = both[:, None] * cov[:, :, None] + neither[:, None] * cov[:, None, :]
    mixed = np.einsum("bij,bijn->bjn", weight, source_mean)
    d = source_mean - mixed[:, None]
    return (
        predicted,
        mixed,
        np.einsum("bij,bijkl->bjkl", weight, source_cov + d[..., :, None] * d[..., None, :]),
    )


def run_imm(modes, pi, mu, z, mean, cov, known=None, start_used=False):
    """IMM filter of Blom and Bar-Shalom (1988) from one common start.

    Returns fused means (B, T, N), covariances (B, T, N, N) and mode probabilities (B, T, M).
    """
    runs, steps = z.shape[:2]
    m, n = modes.drift.shape
    known = np.ones((m, n), dtype=bool) if known is None else known
    mu = np.broadcast_to(mu, (runs, m))
    mean = np.broadcast_to(mean[..., None, :], (runs, m, n))
    cov = np.broadcast_to(cov[..., None, :, :], (runs, m, n, n))
    out_mean, out_cov, out_mu = [], [], []
    for k in range(steps):
        if k > 0:
            mu, mean, cov = mix(mu, pi, mean, cov, known)
            mean = np.einsum("mij,bmj->bmi", modes.transition, mean) + modes.drift
            cov = modes.transition @ cov @ np.swapaxes(modes.transition, -1, -2) + modes.process_noise
        if k > 0 or not start_used:
            mean, cov, log_l = update(mean, cov, z[:, k, None], modes.observation, modes.noise)
            log_mu = log_l + np.log(mu)
            mu = np.exp(log_mu - log_mu.max(-1, keepdims=True))
            mu = mu / mu.sum(-1, keepdims=True)
        fused = np.einsum("bm,bmn->bn", mu, mean)
        d = mean - fused[:, None]
        out_mean.append(fused)
        out_cov.append(np.einsum("bm,bmij->bij", mu, cov + d[..., :, None] * d[..., None, :]))
        out_mu.append(mu)
    return np.stack(out_mean, 1), np.stack(out_cov, 1), np.stack(out_mu, 1)


def two_point(z, dt, sigma):
    """Start from z[:, 0] and z[:, 1]: state (x, vx, y, vy) at sample 1, mean (B, 4) and covariance (4, 4)."""
    v = (z[:, 1] - z[:, 0]) / dt
    mean = np.stack([z[:, 1, 0], v[:, 0], z[:, 1, 1], v[:, 1]], -1)
    return mean, np.kron(np.eye(2), sigma**2 * np.array([[1, 1 / dt], [1 / dt, 2 / dt**2]]))


def dwna(dt, sigma):
    """White acceleration held over a step, (x, vx, y, vy)."""
    g = np.array([dt**2 / 2, dt])
    return np.kron(np.eye(2), sigma**2 * np.outer(g, g))


def turn(dt, rate):
    """Known-rate turn over (x, vx, y, vy), counter-clockwise positive; rate 0 is a straight line."""
    if rate == 0:
        return np.kron(np.eye(2), [[1, dt], [0, 1]])
    s, c = np.sin(rate * dt), np.cos(rate * dt)
    return np.array([[1, s / rate, 0, -(1 - c) / rate], [0, c, 0, -s], [0, (1 - c) / rate, 1, s / rate], [0, s, 0, c]])
