"""Banks of modes at the nodes of a network: prediction, consensus and update of every mode, and what smooths them.

Nodes average the information pair of each mode by itself, and the logarithms of the mode probabilities, which is the
same averaging (of log-densities) for the discrete part. Detections say the same to every mode, so the novelty is one
pair, and the evidence of a mode is what it leaves of the prior,

    ln Lambda_j = 1/2 [ln |Omega_j| - ln |Omega_j + dOmega|] + 1/2 [q+' P+ q+ - q' P q],

Source: Blom, Bar-Shalom (1988); Battistelli and others (2015). Differs: the combination is ours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.compiled import entry_kernel
from jink.estimators.multitarget.information import Information, from_moments, to_moments
from jink.estimators.multitarget.seeing import step_tables
from jink.estimators.multitarget.tables import Moving

__all__ = ["ModeStates", "averaged", "foreseen", "informed", "merged", "smooth_joint"]

Array = NDArray[np.float64]
LEAST = 1e-9
"""Probability below which no mode falls: a mode that is ruled out comes back when the target turns."""


class ModeStates(NamedTuple):
    """Moments by mode; any leading shape, for instance (N, M) nodes and targets."""

    mean: Array  # (..., J, n)
    cov: Array  # (..., J, n, n)
    probs: Array  # (..., J)

    @classmethod
    def alike(cls, mean: Array, cov: Array, probs: Array) -> ModeStates:
        """All modes with the same moments (..., n), (..., n, n) and probabilities (J,)."""
        J = len(probs)
        return cls(
            np.repeat(mean[..., None, :], J, axis=-2),
            np.repeat(cov[..., None, :, :], J, axis=-3),
            np.broadcast_to(probs, (*mean.shape[:-1], J)).copy(),
        )

    def joined(self, other: ModeStates) -> ModeStates:
        """With more targets, on the second axis."""
        return ModeStates(*(np.concatenate(parts, axis=1) for parts in zip(self, other, strict=True)))

    def of_targets(self, which: NDArray[np.bool_]) -> ModeStates:
        """Some of the targets."""
        return ModeStates(*(np.ascontiguousarray(part[:, which]) for part in self))

    def of_node(self, node: int) -> ModeStates:
        """One node."""
        return ModeStates(*(part[node] for part in self))


def merged(modes: ModeStates) -> tuple[Array, Array]:
    """Moments over all modes; (..., n), (..., n, n)."""
    mean = np.einsum("...j,...ja->...a", modes.probs, modes.mean)
    off = modes.mean - mean[..., None, :]
    spread = modes.cov + off[..., :, None] * off[..., None, :]
    return mean, np.einsum("...j,...jab->...ab", modes.probs, spread)


def foreseen(moving: Moving, chain: Array, dt: float, modes: ModeStates) -> tuple[ModeStates, Array]:
    """Prediction over ``dt`` s, and the covariance of the states before and after it.

    Args:
        moving: tables of linear motions.
        chain: Markov matrix of the step, row = from; (J, J).
        dt: s.
        modes: before.

    Returns:
        the modes after; ``cov(x, x+)`` over all modes, (..., n, n).
    """
    F, Q = _steps(moving, dt)
    flow = modes.probs[..., :, None] * chain
    probs = flow.sum(axis=-2)
    share = np.where(probs[..., None, :] > 0, flow / np.maximum(probs[..., None, :], 1e-300), 1.0 / len(chain))
    start = np.einsum("...ji,...ja->...ia", share, modes.mean)
    off = modes.mean[..., :, None, :] - start[..., None, :, :]
    spread = np.einsum("...ji,...jab->...iab", share, modes.cov)
    spread = spread + np.einsum("...ji,...jia,...jib->...iab", share, off, off)
    mean = np.einsum("iab,...ib->...ia", F, start)
    moved = np.einsum("...iab,icb->...iac", spread, F)
    cov = np.einsum("iab,...ibc->...iac", F, moved) + Q
    ahead = ModeStates(mean, 0.5 * (cov + np.swapaxes(cov, -1, -2)), probs)
    before, after = (np.einsum("...i,...ia->...a", probs, part) for part in (start, mean))
    apart = (start - before[..., None, :])[..., :, None] * (mean - after[..., None, :])[..., None, :]
    return ahead, np.einsum("...i,...iab->...ab", probs, moved + apart)


@entry_kernel
def _steps(moving, dt):  # type: ignore[no-untyped-def]
    """Transition and process noise of each mode; (J, n, n), (J, n, n)."""
    J, n = moving.diffusion.shape
    F, Q, x, out = np.zeros((J, n, n)), np.zeros((J, n, n)), np.zeros(n), np.zeros(n)
    above, below = np.zeros(n), np.zeros(n)
    for j in range(J):
        step_tables(moving, j, x, dt, above, below, out, F[j], Q[j])
    return F, Q


def averaged(modes: ModeStates, mixing: Array) -> ModeStates:
    """Consensus on every mode and on the mode probabilities.

    Args:
        modes: (N, M, J, n), ...
        mixing: share of each sender in each receiver; (N, N).
    """
    pair = from_moments(modes.mean, modes.cov)

    def mix(values: Array) -> Array:
        return (mixing @ values.reshape(len(values), -1)).reshape(values.shape)

    mean, cov = to_moments(Information(mix(pair.vector), mix(pair.matrix)))
    log_probs = mix(np.log(np.maximum(modes.probs, LEAST)))
    return ModeStates(mean, cov, _normalised(log_probs))


def informed(modes: ModeStates, vector: Array, matrix: Array) -> tuple[ModeStates, int]:
    """Update of every mode by one information pair.

    Args:
        modes: priors; (..., J, n), ...
        vector, matrix: dq (..., n), dOmega (..., n, n); zero where nothing was seen.

    Returns:
        posteriors, and how many updates found no covariance: their prior stands.
    """
    # About the merged prior, so that places far from the origin cost no digits.
    centre = merged(modes)[0]
    pull = vector - np.einsum("...ab,...b->...a", matrix, centre)
    off = modes.mean - centre[..., None, :]
    prior = from_moments(off, modes.cov)
    q, Omega = prior.vector + pull[..., None, :], prior.matrix + matrix[..., None, :, :]
    mean, cov = to_moments(Information(q, Omega))
    evidence = np.linalg.slogdet(prior.matrix)[1] - np.linalg.slogdet(Omega)[1]
    evidence = evidence + (q * mean).sum(axis=-1) - (prior.vector * off).sum(axis=-1)
    bad = np.asarray(~np.isfinite(mean).all(axis=-1))
    mean, cov = np.where(bad[..., None], off, mean), np.where(bad[..., None, None], modes.cov, cov)
    log_probs = np.log(np.maximum(modes.probs, LEAST)) + np.where(bad, 0.0, 0.5 * evidence)
    return ModeStates(mean + centre[..., None, :], cov, _normalised(log_probs)), int(bad.sum())


def _normalised(log_probs: Array) -> Array:
    probs = np.exp(log_probs - log_probs.max(axis=-1, keepdims=True))
    return np.asarray(probs / probs.sum(axis=-1, keepdims=True))


def smooth_joint(begin: NDArray[np.int64], *paths: Array) -> tuple[Array, Array]:
    """Smoothed moments of one node from stored joint ones: ``G = cov(x, x+) (P-)^-1``, else Rauch, Tung, Striebel.

    Args:
        begin: first time of each target; (M,).
        paths: predictions, posteriors and cov(x(k - 1), x(k)): ahead, ahead_cov, filtered, filtered_cov, cross;
            (M, T, n), (M, T, n, n), (M, T, n), (M, T, n, n), (M, T, n, n).

    Returns:
        (M, T, n), (M, T, n, n).
    """
    ahead, ahead_cov, filtered, filtered_cov, cross = paths
    means, covs = filtered.copy(), filtered_cov.copy()
    for k in range(means.shape[1] - 2, -1, -1):
        there = np.flatnonzero(begin <= k)
        inverse = to_moments(Information(np.zeros(ahead[there, k + 1].shape), ahead_cov[there, k + 1]))[1]
        G = np.nan_to_num(cross[there, k + 1] @ inverse)
        off = means[there, k + 1] - ahead[there, k + 1]
        means[there, k] += np.einsum("mab,mb->ma", G, off)
        extra = G @ (covs[there, k + 1] - ahead_cov[there, k + 1]) @ np.swapaxes(G, -1, -2)
        covs[there, k] += 0.5 * (extra + np.swapaxes(extra, -1, -2))
    return means, covs
