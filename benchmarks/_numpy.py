"""The textbook in plain NumPy: it defines the right estimates and is itself one row of the table.

Leading axes are tracks; the algebra is that of Blom and Bar-Shalom (1988) for the bank and of
Wan and van der Merwe (2000) for the filter (alpha 1, beta 2, kappa 0, points redrawn after adding Q).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from _problem import Case, Problem, Result, array_trig, constant_velocity_matrix, move, to_result

Motion = Callable[[np.ndarray, float], np.ndarray]


def sigma_points(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Give the 2 N + 1 points (B, S, N) of N(mean, cov)."""
    n = mean.shape[-1]
    spread = np.sqrt(n) * np.swapaxes(np.linalg.cholesky(cov), -1, -2)
    centre = mean[:, None, :]
    return np.concatenate([centre, centre + spread, centre - spread], axis=1)


def weights(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Give the mean and covariance weights (S,) for alpha 1, beta 2, kappa 0."""
    mean, cov = np.full(2 * n + 1, 0.5 / n), np.full(2 * n + 1, 0.5 / n)
    mean[0], cov[0] = 0.0, 2.0
    return mean, cov


def covariance(first: np.ndarray, second: np.ndarray, wc: np.ndarray) -> np.ndarray:
    """Weighted sum of outer products of deviations (B, S, I), (B, S, J): (B, I, J)."""
    return np.swapaxes(first * wc[:, None], -1, -2) @ second


def correct(mean, cov, z, z_mean, s_cov, cross):  # type: ignore[no-untyped-def]
    """Condition on z: posterior mean, covariance and log-likelihood."""
    innovation = z - z_mean
    solved = np.linalg.solve(s_cov, np.swapaxes(cross, -1, -2))
    mean = mean + (np.swapaxes(solved, -1, -2) @ innovation[..., None])[..., 0]
    cov = cov - cross @ solved
    nis = (innovation * np.linalg.solve(s_cov, innovation[..., None])[..., 0]).sum(-1)
    log_det = np.linalg.slogdet(s_cov)[1]
    return (
        mean,
        0.5 * (cov + np.swapaxes(cov, -1, -2)),
        -0.5 * (nis + log_det + z.shape[-1] * np.log(2 * np.pi)),
    )


def ukf_step(mean, cov, z, dt, motion: Motion, q, r, position):  # type: ignore[no-untyped-def]
    """One unscented predict and update of every track."""
    wm, wc = weights(mean.shape[-1])
    points = motion(sigma_points(mean, cov), dt)
    mean = np.einsum("s,bsn->bn", wm, points)
    deviation = points - mean[:, None]
    cov = covariance(deviation, deviation, wc) + q
    points = sigma_points(mean, cov)
    seen = points[..., position]
    z_mean = np.einsum("s,bsd->bd", wm, seen)
    z_deviation = seen - z_mean[:, None]
    s_cov = covariance(z_deviation, z_deviation, wc) + r
    return correct(mean, cov, z, z_mean, s_cov, covariance(points - mean[:, None], z_deviation, wc))


def kf_step(mean, cov, z, dt, q, r, position):  # type: ignore[no-untyped-def]
    """One linear predict and update of every track."""
    f, h = constant_velocity_matrix(dt), np.eye(4)[list(position)]
    mean, cov = mean @ f.T, f @ cov @ f.T + q
    return correct(mean, cov, z, mean @ h.T, h @ cov @ h.T + r, cov @ h.T)


def mix(means, covs, mode_probs, transition):  # type: ignore[no-untyped-def]
    """Mix the modes' (B, M, N) states: starting points of each mode and the predicted probabilities."""
    predicted = mode_probs @ transition
    share = transition[None] * mode_probs[:, :, None] / predicted[:, None, :]
    mixed = np.einsum("bij,bin->bjn", share, means)
    deviation = means[:, :, None] - mixed[:, None]
    spread = np.einsum("bij,bijn,bijm->bjnm", share, deviation, deviation)
    return mixed, np.einsum("bij,binm->bjnm", share, covs) + spread, predicted


def combine(means, covs, mode_probs):  # type: ignore[no-untyped-def]
    """Moment-match the modes of every track."""
    mean = np.einsum("bj,bjn->bn", mode_probs, means)
    deviation = means - mean[:, None]
    return mean, np.einsum("bj,bjnm->bnm", mode_probs, covs) + np.einsum(
        "bj,bjn,bjm->bnm", mode_probs, deviation, deviation
    )


def run(problem: Problem) -> Result:
    """Run all tracks of the problem and return the final fused estimates."""
    motions = [
        lambda s, dt, mode=mode: np.stack(move(mode, np.moveaxis(s, -1, 0), dt, array_trig), axis=-1)
        for mode in problem.modes
    ]
    b, m = problem.tracks, len(problem.modes)
    means = np.repeat(problem.prior_mean[:, None], m, axis=1)
    covs = np.broadcast_to(problem.prior_cov, (b, m, *problem.prior_cov.shape))
    mode_probs = np.broadcast_to(problem.mode_probs, (b, m))
    mean, cov = problem.prior_mean, np.broadcast_to(problem.prior_cov, (b, *problem.prior_cov.shape))
    noises, r, position = problem.process_noises(), problem.noise, list(problem.position_index)
    for k, dt in enumerate(np.diff(problem.times)):
        z = problem.measurements[:, k + 1]
        if problem.workload == "kf":
            mean, cov, _ = kf_step(mean, cov, z, dt, noises[k, 0], r, position)
            continue
        if problem.workload == "ukf":
            mean, cov, _ = ukf_step(mean, cov, z, dt, motions[0], noises[k, 0], r, position)
            continue
        mixed, mixed_covs, predicted = mix(means, covs, mode_probs, problem.mode_transition)
        steps = [
            ukf_step(mixed[:, j], mixed_covs[:, j], z, dt, motions[j], noises[k, j], r, position) for j in range(m)
        ]
        means, covs = np.stack([s[0] for s in steps], 1), np.stack([s[1] for s in steps], 1)
        score = np.stack([s[2] for s in steps], 1) + np.log(predicted)
        mode_probs = np.exp(score - score.max(1, keepdims=True))
        mode_probs = mode_probs / mode_probs.sum(1, keepdims=True)
        mean, cov = combine(means, covs, mode_probs)
    return to_result(problem, mean, cov, mode_probs)


def make(problem: Problem, stepwise: bool = False) -> Case:
    """Prepare the problem; stepping from Python is what this does in any case."""
    return Case(run=lambda: run(problem))
