"""Trackers that decide scan by scan: shared loop of prediction, candidates, choice of weights, update."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.pmht import KnownTracks, Pmht, PmhtState
from jink.estimators.multitarget.results import Fit, Found, MultiTracks
from jink.estimators.multitarget.scan_kernels import find_candidates, soft_update
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scan, Scans
from jink.estimators.multitarget.tracked import TrackSet, Window

__all__ = ["Candidates", "OneScanTracker"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Candidates(NamedTuple):
    """What a scan offers: M targets, N detections, P pairs; pairs of target m are ``begins[m] : begins[m + 1]``."""

    begins: Ints  # (M + 1,)
    pairs: Ints  # detection of each pair; (P,)
    log_density: Array  # ln N(z; h(x), H P H' + R); (P,)
    detected: Array  # P_D, 0: out of view; (M,)
    density: float  # lambda
    detections: int  # N


@dataclass(frozen=True, eq=False)
class _Loop(Pmht):
    """The loop of PMHT over windows of one scan, with weights chosen by a function."""

    choose: Callable[[Candidates], Array] = field(kw_only=True)
    name: str = field(kw_only=True)

    @property
    def _caller(self) -> str:
        return self.name

    def _fit(self, state: PmhtState, window: Window, tracks: TrackSet, iterations: int) -> Fit:
        index = int(window.sensor[0])
        sensor = state.sensors[index]
        M = len(tracks.ids)
        priors = tracks.prior_mean, tracks.prior_cov, tracks.prior_probs
        ahead, spread, begins, pairs, log_density, residual, seen, H = find_candidates(
            self.moving, state.sensing, index, window.places[0], window.noise, window.detections, tracks.begin, *priors,
            self.gate_of(sensor),
        )  # fmt: skip
        detected = np.where(tracks.begin == 0, tracks.detected[:, 0], 0.0)
        offered = Candidates(begins, pairs, log_density, detected, sensor.density, len(window.detections))
        weight = self.choose(offered) if pairs.size else np.zeros(0)
        last_mean, last_cov, last_probs, means, covs, trouble = soft_update(
            sensor.size, window.noise[0], H, begins, residual, weight, ahead, *priors
        )
        tracks.means[:], tracks.covs[:] = means, covs
        owner = np.repeat(np.arange(M), np.diff(begins))
        hits = np.bincount(owner, weight, minlength=M).astype(np.float64)[:, None]
        mass, pull = np.zeros((M, 1)), np.zeros((M, 1, residual.shape[1]))
        return Fit(
            np.full(1, np.nan), begins, pairs, weight, hits, seen, priors[0][:, None], priors[1][:, None],
            priors[2][:, None], means, covs, last_mean, last_cov, last_probs, mass, pull, H, np.array([1, 0, trouble]),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class OneScanTracker:
    """Kalman filters (extended for what is not linear) and one decision per scan.

    Args:
        motion: how targets move; several linear ones with the same state: the modes of an interacting multiple model.
        chain: Markov chain of the modes; None: each lasts 10 s on average.
        gate: D^2 beyond which a detection is no candidate; None: all are. A sensor's own gate comes first.
        initiation: how tracks begin and end, the same as of `Pmht`; None: the known ones stay, no others come.

    Raises:
        ValueError: an option out of range.
    """

    motion: Motion | Sequence[Motion]
    chain: MarkovChain | None = None
    gate: float | None = 25.0
    initiation: Initiation | None = field(default_factory=Initiation)

    def __post_init__(self) -> None:
        _ = self._loop  # which checks the options

    def weights(self, offered: Candidates) -> Array:
        """Probability of each pair; (P,)."""
        raise NotImplementedError

    @cached_property
    def _loop(self) -> _Loop:
        return _Loop(
            self.motion,
            self.chain,
            window=1,
            iterations=1,
            gate=self.gate,
            initiation=self.initiation,
            choose=self.weights,
            name=type(self).__name__,
        )

    def start(
        self, sensors: ScanSensor | tuple[ScanSensor, ...], time: float, known: KnownTracks | None = None
    ) -> PmhtState:
        """Begin before the first scan; as `Pmht.start`."""
        return self._loop.start(sensors, time, known)

    def step(self, state: PmhtState, scan: Scan) -> tuple[PmhtState, Found]:
        """Take in one scan; as `Pmht.step`."""
        return self._loop.step(state, scan)

    def run(self, scans: Scans, known: KnownTracks | None = None) -> MultiTracks:
        """Take in all scans; as `Pmht.run`. Nothing is smoothed: both paths of the result are the filter's."""
        return self._loop.run(scans, known)
