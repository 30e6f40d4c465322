"""Baseline: Gaussian mixture of regressions over pieces of tracks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from jink.estimators.tracks import Tracks
from jink.intent.baselines.change_points import Pieces, cut_tracks
from jink.intent.baselines.choosing import best_of
from jink.intent.segmentation import Segmentation

__all__ = ["RegressionMixture"]

Floats = NDArray[np.float64]
_SWEEPS = 100
_FEWEST = 4


class _Curve(NamedTuple):
    """A piece in its own frame: regressors (n, P) and values (n, A), over which rows of which track, its weight."""

    track: int
    first: int
    last: int
    design: Floats
    values: Floats


@dataclass
class RegressionMixture:
    """Mixture of polynomial regressions: every piece of a track is one curve out of K families.

    Model: a piece, moved to its start, turned to its first heading, mirrored to turn left and divided by its speed,
    is ``z(t) = X(t) beta_k + N(0, s_k^2)`` with X the powers 1 to `degree` of time; pieces come from change points.

    Args:
        intents: how many families; None: by the Bayesian information criterion, up to `most`.
        degree: of the polynomials.
        strength, window, noise_sd: of the change points; see `SegmentCluster`.
        most: largest number tried.
        restarts: starting points for every number.
        seed: of the starting points.

    Source: Gaffney, Smyth (1999). Differs: pieces of tracks in a frame of their own instead of whole tracks.
    """

    intents: int | None = None
    degree: int = 3
    strength: float = 1.0
    window: float | None = None
    noise_sd: float | None = None
    most: int = 8
    restarts: int = 4
    seed: int = 0
    curve_: list[tuple[int, float]] = field(default_factory=list, init=False)

    def fit(self, tracks: Tracks) -> RegressionMixture:
        """Cut, and fit the families by EM."""
        cut = cut_tracks(tracks, self.strength, self.window, self.noise_sd)
        self.window_ = cut.features.window
        curves = self._curves(tracks, cut)
        if not curves:
            raise ValueError("RegressionMixture: tracks must show a direction somewhere; got none. Widen the window.")
        generator = np.random.default_rng([self.seed, 0x63F])
        values = tracks.axes
        rows = float(sum(len(curve.values) for curve in curves))

        def climb(count: int) -> tuple[float, int, tuple[Floats, Floats, Floats]]:
            runs = [_families(curves, count, generator) for _ in range(self.restarts)]
            score, *found = max(runs, key=lambda run: run[0])
            return score, count * (self.degree * values + 2) - 1, (found[0], found[1], found[2])

        sizes = [self.intents] if self.intents else list(range(1, min(self.most, len(curves)) + 1))
        self._found, self.intents_, self.curve_ = best_of(climb, sizes, rows)
        return self

    def segment(self, tracks: Tracks) -> Segmentation:
        """Labels of tracks by the families found in `fit`."""
        cut = cut_tracks(tracks, self.strength, self.window_, self.noise_sd)
        probs = np.broadcast_to(self._found[0], (*tracks.times.shape, self.intents_)).copy()
        switches = np.zeros(tracks.times.shape)
        for curve in self._curves(tracks, cut):
            logs = np.log(self._found[0]) + _logs(curve, *self._found[1:])
            probs[curve.track, curve.first : curve.last + 1] = np.exp(logs - logsumexp(logs))
        for piece in cut.pieces:
            if piece.first > 0:
                before, after = probs[piece.track, piece.first - 1], probs[piece.track, piece.first]
                switches[piece.track, piece.first] = 1.0 - float(before @ after)
        return Segmentation.of_probs(probs, tracks.times, tracks.lengths, switches=switches)

    def _curves(self, tracks: Tracks, cut: Pieces) -> list[_Curve]:
        features, curves = cut.features, []
        A = tracks.axes
        for piece in cut.pieces:
            rows = np.arange(piece.first, piece.last + 1)
            rows = rows[features.valid[piece.track, rows]]
            if rows.size < _FEWEST:
                continue
            where = features.mean[piece.track, rows, :A]
            v = features.velocity[piece.track, rows[0]]
            speed = float(np.linalg.norm(v))
            if not speed > 0:
                continue
            time = tracks.times[piece.track, rows] - tracks.times[piece.track, rows[0]]
            along = (where - where[0]) @ (v / speed) / speed
            off = (where - where[0]) / speed - along[:, None] * (v / speed)
            if A == 2:
                across = off @ np.array([-v[1], v[0]]) / speed
                across = across * (np.sign(across[-1]) or 1.0)
            else:
                across = np.linalg.norm(off, axis=1)
            design = np.stack([time**p for p in range(1, self.degree + 1)], axis=1)
            curves.append(_Curve(piece.track, piece.first, piece.last, design, np.stack([along, across], axis=1)))
        return curves


def _logs(curve: _Curve, beta: Floats, var: Floats) -> Floats:
    """Log density of a curve under each family; (K,)."""
    residual = curve.values - np.einsum("np,kpa->kna", curve.design, beta)
    n = curve.values.size
    return np.asarray(-0.5 * (np.sum(residual**2, axis=(1, 2)) / var + n * np.log(2.0 * np.pi * var)))


def _families(curves: list[_Curve], K: int, generator: np.random.Generator) -> tuple[float, Floats, Floats, Floats]:
    """Score, shares (K,), coefficients (K, P, 2) and variances (K,) by EM."""
    grams = np.array([c.design.T @ c.design for c in curves])
    crosses = np.array([c.design.T @ c.values for c in curves])
    squares = np.array([float(np.sum(c.values**2)) for c in curves])
    sizes = np.array([float(c.values.size) for c in curves])
    ridge = 1e-9 * np.trace(grams.mean(axis=0)) * np.eye(grams.shape[1])
    r = np.zeros((len(curves), K))
    r[np.arange(len(curves)), generator.integers(0, K, len(curves))] = 1.0
    longest = generator.choice(len(curves), K, replace=len(curves) < K, p=sizes / sizes.sum())
    r[longest, np.arange(K)] = 10.0
    before = score = -np.inf
    floor = 1e-6 * squares.sum() / sizes.sum()
    shares, beta, var = np.ones(K) / K, np.zeros((K, *crosses.shape[1:])), np.ones(K)
    for _ in range(_SWEEPS):
        shares = (r.sum(axis=0) + 1e-3) / (r.sum() + 1e-3 * K)
        for k in range(K):
            gram, cross = np.einsum("n,nij->ij", r[:, k], grams), np.einsum("n,nia->ia", r[:, k], crosses)
            beta[k] = np.linalg.solve(gram + ridge, cross)
            left = r[:, k] @ squares - 2.0 * np.sum(beta[k] * cross) + np.sum(beta[k] * (gram @ beta[k]))
            var[k] = max(left / max(float(r[:, k] @ sizes), 1e-9), floor)
        logs = np.log(shares) + np.array([_logs(curve, beta, var) for curve in curves])
        row = logsumexp(logs, axis=1)
        r, score = np.exp(logs - row[:, None]), float(row.sum())
        if score - before < 1e-6 * abs(score):
            break
        before = score
    return score, shares, beta, var
