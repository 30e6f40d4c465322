"""One time of a distributed tracker: E-steps of the nodes, exchange of information, smoothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jink.estimators.multitarget.information import Information, consensus_update, from_moments, to_moments
from jink.estimators.multitarget.network_bank import ModeStates
from jink.estimators.multitarget.network_state import NetworkState, NodeScans, node_scans
from jink.estimators.multitarget.node_kernels import (
    filter_information,
    local_information,
    predict_targets,
    smooth_back,
)
from jink.estimators.multitarget.pmht import positions_of
from jink.estimators.multitarget.tables import make_sensing

if TYPE_CHECKING:
    from jink.estimators.multitarget.distributed import DistributedPmht

__all__ = ["LEAST_HITS", "NetworkStep"]

Array = NDArray[np.float64]
LEAST_HITS = 0.1
"""Expected detections below which a node's scan says nothing of a target."""


class NetworkStep:
    """The iterations of one time: its paths start as those of the state and are overwritten."""

    def __init__(self, tracker: DistributedPmht, state: NetworkState) -> None:
        self.tracker, self.state = tracker, state
        self.paths = state.paths.copy()
        self.messages = self.exchanges = self.trouble = 0
        self.modes: ModeStates | None = None
        self.first = max(len(state.times) - tracker.exchanged, 0)
        self.begin = np.maximum(state.begin - self.first, 0)
        self.times = state.times[self.first :]
        self.sensing = make_sensing(state.sensors)
        N, M = self.paths.means.shape[:2]
        self.scans = {node: self._scans_of(node) for node in range(N) if node in tracker.node_of}
        T, n = len(self.times), self.paths.means.shape[3]
        self.dq, self.dOmega, self.hits = np.zeros((N, M, T, n)), np.zeros((N, M, T, n, n)), np.zeros((N, M, T))
        self.gate_covs = np.ascontiguousarray(self.paths.covs[:, :, self.first :])

    def iterate(self) -> None:
        """Weigh, exchange and smooth, in the order the tracker says."""
        tracker = self.tracker
        if tracker.order == "V1":
            for node in self.scans:
                self._iterate_alone(node)
            self._fuse(0)
        else:
            for turn in range(tracker.iterations):
                for node in self.scans:
                    path = np.ascontiguousarray(self.paths.means[node, :, self.first :])
                    covs = np.ascontiguousarray(self.paths.covs[node, :, self.first :])
                    self._weigh(node, path, covs, turn, tracker.correction and turn == tracker.iterations - 1)
                self._fuse(turn)
        for node in range(len(self.paths.means)):
            self._smooth(node, 0)

    def _scans_of(self, node: int) -> NodeScans:
        tracker, M = self.tracker, self.paths.means.shape[1]
        path = self.paths.means[node, :, self.first :]
        T, n = path.shape[1:]
        places = positions_of(tracker.moving, np.ascontiguousarray(path.reshape(M * T, n)))
        places = places.reshape(M, T, len(tracker.moving.index) // 2)
        frames = self.state.frames[self.first :]
        return node_scans(frames, self.state.sensors, tracker.node_of, node, places, tracker.gate)

    def _weigh(self, node: int, path: Array, covs: Array, turn: int, corrected: bool) -> None:
        tracker, steps = self.tracker, self.tracker.annealing
        shares, scales = ((1.0,), (1.0,)) if tracker.homothetic is None else tracker.homothetic
        own = self.scans[node]
        local_information(
            tracker.moving, self.sensing, own.sensor, own.places, own.noise, own.detections, own.offsets, own.slot,
            self.begin, path, covs, self.gate_covs[node], own.gates, own.detected, own.density, own.volume,
            steps[turn] if turn < min(len(steps), tracker.iterations - 1) else 1.0, np.log(shares), np.array(scales),
            tracker.adaptive, corrected, self.dq[node], self.dOmega[node], self.hits[node],
        )  # fmt: skip

    def _iterate_alone(self, node: int) -> None:
        """EM of a node over its own scans, from its own fused prediction; the final centroids stay in dq, dOmega."""
        tracker, first = self.tracker, self.first
        path = np.ascontiguousarray(self.paths.means[node, :, first:])
        starts = np.arange(path.shape[0]), np.minimum(self.begin, path.shape[1] - 1)
        prior = (
            np.ascontiguousarray(self.paths.ahead[node, :, first:][starts]),
            np.ascontiguousarray(self.paths.ahead_cov[node, :, first:][starts]),
        )
        covs = self.gate_covs[node].copy()
        work = [np.zeros_like(path), np.zeros_like(covs), np.zeros_like(path), np.zeros_like(covs)]
        for turn in range(tracker.iterations):
            self._weigh(node, path, covs, turn, False)
            self.trouble += filter_information(
                tracker.moving, self.times, *prior, self.begin, self.dq[node], self.dOmega[node], *work
            )
            smooth_back(tracker.moving, self.times, self.begin, *work, path, covs)
        self._weigh(node, path, covs, tracker.iterations, tracker.correction)

    def _fuse(self, turn: int) -> None:
        """Forward through the exchanged times with consensus at each, then smooth every node."""
        tracker, n = self.tracker, self.paths.means.shape[3]
        consensus, N = tracker.consensus, len(self.paths.means)
        T, base = len(self.times), self.first
        for k in range(T):
            now = np.flatnonzero(self.begin <= k)
            if k:
                old = np.flatnonzero(self.begin < k)
                x, P = predict_targets(
                    tracker.moving, self.times[k] - self.times[k - 1],
                    np.ascontiguousarray(self.paths.filtered[:, old, base + k - 1].reshape(-1, n)),
                    np.ascontiguousarray(self.paths.filtered_cov[:, old, base + k - 1].reshape(-1, n, n)),
                )  # fmt: skip
                self.paths.ahead[:, old, base + k] = x.reshape(N, len(old), n)
                self.paths.ahead_cov[:, old, base + k] = P.reshape(N, len(old), n, n)
            number = (self.state.steps * tracker.iterations + turn) * tracker.window + k
            exchange = consensus.exchange(self.state.time, number)
            self.messages += exchange.messages
            self.exchanges += 1
            x, P = self.paths.ahead[:, now, base + k], self._sound(self.paths.ahead_cov[:, now, base + k])
            fused = consensus_update(
                from_moments(x, P),
                Information(self.dq[:, now, k], self.dOmega[:, now, k]),
                np.asarray(self.hits[:, now, k] > LEAST_HITS),
                exchange,
                consensus.rule,
            )
            mean, cov = to_moments(fused)
            bad = np.asarray(np.isnan(mean).any(axis=-1))
            self.trouble += int(bad.sum())
            self.paths.filtered[:, now, base + k] = np.where(bad[..., None], x, mean)
            self.paths.filtered_cov[:, now, base + k] = np.where(bad[..., None, None], P, cov)
        if tracker.order == "V2":
            for node in self.scans:
                self._smooth(node, base)

    def _sound(self, cov: Array) -> Array:
        """Covariances that rounding has not spoilt; spoilt ones, of lost targets, without their correlations."""
        n = cov.shape[-1]
        inverse = to_moments(Information(np.zeros(cov.shape[:-1]), cov))[1]
        bad = np.asarray(~np.isfinite(inverse).all(axis=(-1, -2)))
        if not bad.any():
            return cov
        self.trouble += int(bad.sum())
        variances = np.nan_to_num(np.diagonal(cov, axis1=-2, axis2=-1), nan=1e30, posinf=1e30)
        return np.where(bad[..., None, None], np.clip(variances, 1e-12, 1e30)[..., None] * np.eye(n), cov)

    def _smooth(self, node: int, first: int) -> None:
        """Smoothed path of a node from index ``first`` of the window on."""
        parts = [
            np.ascontiguousarray(part[node, :, first:])
            for part in (
                self.paths.ahead,
                self.paths.ahead_cov,
                self.paths.filtered,
                self.paths.filtered_cov,
                self.paths.means,
                self.paths.covs,
            )
        ]
        begin = np.maximum(self.state.begin - first, 0)
        smooth_back(self.tracker.moving, self.state.times[first:], begin, *parts)
        self.paths.means[node, :, first:], self.paths.covs[node, :, first:] = parts[4], parts[5]
