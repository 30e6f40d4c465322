"""One time of a distributed tracker whose targets manoeuvre: as `NetworkStep`, with a bank of modes in the M-step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jink.estimators.multitarget.information import Information, mixed_novelty
from jink.estimators.multitarget.network_bank import ModeStates, averaged, informed, merged, smooth_joint
from jink.estimators.multitarget.network_state import NetworkState
from jink.estimators.multitarget.network_step import LEAST_HITS, NetworkStep

if TYPE_CHECKING:
    from jink.estimators.multitarget.distributed import DistributedPmht

__all__ = ["BankStep"]


class BankStep(NetworkStep):
    """The iterations of one time; only the newest is exchanged, as earlier modes are gone."""

    def __init__(self, tracker: DistributedPmht, state: NetworkState) -> None:
        super().__init__(tracker, state)
        assert state.modes is not None
        self.ahead = state.modes._replace(cov=self._sound(state.modes.cov))
        self.modes: ModeStates = self.ahead

    def _iterate_alone(self, node: int) -> None:
        tracker, own = self.tracker, self.ahead.of_node(node)
        path, covs = self.paths.means[node, :, self.first :].copy(), self.gate_covs[node].copy()
        for turn in range(tracker.iterations):
            self._weigh(node, path, covs, turn, False)
            updated, bad = informed(own, self.dq[node, :, 0], self.dOmega[node, :, 0])
            path[:, 0], covs[:, 0] = merged(updated)
            self.trouble += bad
        self._weigh(node, path, covs, tracker.iterations, tracker.correction)

    def _fuse(self, turn: int) -> None:
        tracker, consensus = self.tracker, self.tracker.consensus
        exchange = consensus.exchange(self.state.time, self.state.steps * tracker.iterations + turn)
        self.messages += exchange.messages
        self.exchanges += 1
        prior = averaged(self.ahead, exchange.mixing)
        bad = ~np.isfinite(prior.mean).all(axis=(-1, -2, -3))
        self.trouble += int(bad.sum())
        if bad.any():
            prior = ModeStates(
                *(
                    np.where(bad.reshape(bad.shape + (1,) * (own.ndim - bad.ndim)), own, both)
                    for own, both in zip(self.ahead, prior, strict=True)
                )
            )
        novelty = mixed_novelty(
            Information(self.dq[:, :, 0], self.dOmega[:, :, 0]), np.asarray(self.hits[:, :, 0] > LEAST_HITS),
            exchange, consensus.rule,
        )  # fmt: skip
        self.modes, failed = informed(prior, novelty.vector, novelty.matrix)
        self.trouble += failed
        self.paths.filtered[:, :, -1], self.paths.filtered_cov[:, :, -1] = merged(self.modes)
        if tracker.order == "V2":
            for node in self.scans:
                self._smooth(node, self.first)

    def _smooth(self, node: int, first: int) -> None:
        own = self.paths
        parts = (own.ahead, own.ahead_cov, own.filtered, own.filtered_cov, own.cross)
        begin = np.maximum(self.state.begin - first, 0)
        means, covs = smooth_joint(begin, *(part[node, :, first:] for part in parts))
        self.paths.means[node, :, first:], self.paths.covs[node, :, first:] = means, covs
