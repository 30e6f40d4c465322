"""Baseline: cut tracks at change points of their shape parameters, then cluster the pieces."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from jink.estimators.tracks import Tracks
from jink.intent.baselines.change_points import Piece, cut_tracks
from jink.intent.baselines.choosing import best_of
from jink.intent.segmentation import Segmentation

__all__ = ["SegmentCluster"]

Floats = NDArray[np.float64]
_SWEEPS = 200


@dataclass
class SegmentCluster:
    """Segment, then cluster: two steps that do not talk to each other.

    Model: penalised cost cuts tracks into pieces of constant (g, w); a Gaussian mixture with the variance of every
    piece taken away clusters their (g, |w|), each piece weighing its share of time.

    Args:
        intents: how many clusters; None: by the Bayesian information criterion, up to `most`.
        strength: penalty of a piece, 1 = Bayesian information criterion.
        window: of the encoder, s; None: chosen from the tracks.
        noise_sd: standard deviation of a position, m; None: that of the tracks.
        most: largest number of clusters tried.
        restarts: starting points for every number.
        seed: of the starting points.
    """

    intents: int | None = None
    strength: float = 1.0
    window: float | None = None
    noise_sd: float | None = None
    most: int = 8
    restarts: int = 4
    seed: int = 0
    curve_: list[tuple[int, float]] = field(default_factory=list, init=False)

    def fit(self, tracks: Tracks) -> SegmentCluster:
        """Cut and cluster."""
        cut = cut_tracks(tracks, self.strength, self.window, self.noise_sd)
        self.window_ = cut.features.window
        pieces = [piece for piece in cut.pieces if np.isfinite(piece.var).all()]
        if not pieces:
            raise ValueError("SegmentCluster: tracks must show a direction somewhere; got none. Use a longer window.")
        x, var = np.array([p.mean for p in pieces]), np.array([p.var for p in pieces])
        time = np.array([tracks.times[p.track, p.last] - tracks.times[p.track, p.first] for p in pieces])
        weight = np.maximum(time, 1e-9) / max(float(time.mean()), 1e-9)
        generator = np.random.default_rng([self.seed, 0x5EC])

        def climb(count: int) -> tuple[float, int, tuple[Floats, Floats, Floats]]:
            runs = [_mixture(x, var, weight, count, generator) for _ in range(self.restarts)]
            score, *found = max(runs, key=lambda run: run[0])
            return score, 5 * count - 1, (found[0], found[1], found[2])

        sizes = [self.intents] if self.intents else list(range(1, min(self.most, len(pieces)) + 1))
        self._found, self.intents_, self.curve_ = best_of(climb, sizes, len(pieces))
        self.mean_, self._noise = self._found[1], float(np.median(var[:, 1]))
        return self

    def segment(self, tracks: Tracks, *, handed: bool = False) -> Segmentation:
        """Labels of tracks by the clusters found; ``handed``: left and right of a cluster away from 0 are labels."""
        cut = cut_tracks(tracks, self.strength, self.window_, self.noise_sd)
        K = self.intents_
        turning = self._found[1][:, 1] ** 2 > self._found[2][:, 1] + 4.0 * self._noise  # |noise| has a mean too
        sided = np.flatnonzero(turning & handed)
        probs = np.zeros((*tracks.times.shape, K + len(sided)))
        switches = np.zeros(tracks.times.shape)
        for piece in cut.pieces:
            row = np.concatenate([self._memberships(piece), np.zeros(len(sided))])
            if piece.side < 0:
                row[K:], row[sided] = row[sided], 0.0
            probs[piece.track, piece.first : piece.last + 1] = row
            if piece.first > 0:
                switches[piece.track, piece.first] = 1.0 - float(probs[piece.track, piece.first - 1] @ row)
        return Segmentation.of_probs(probs, tracks.times, tracks.lengths, switches=switches)

    def _memberships(self, piece: Piece) -> Floats:
        shares, mean, spread = self._found
        if not np.isfinite(piece.var).all():
            return shares
        logs = _logs(piece.mean[None], piece.var[None], shares, mean, spread)[0]
        return np.asarray(np.exp(logs - logsumexp(logs)))


def _logs(x: Floats, var: Floats, shares: Floats, mean: Floats, spread: Floats) -> Floats:
    total = var[:, None] + spread
    squares = (x[:, None] - mean) ** 2 / total + np.log(2.0 * np.pi * total)
    return np.asarray(np.log(shares) - 0.5 * squares.sum(axis=2))


def _mixture(
    x: Floats, var: Floats, weight: Floats, count: int, generator: np.random.Generator
) -> tuple[float, Floats, Floats, Floats]:
    """Score, shares (K,), means (K, 2) and variances (K, 2) by EM with the variance of each datum."""
    scale = np.maximum(x.var(axis=0), 1e-12)
    mean = x[generator.choice(len(x), count, replace=len(x) < count, p=weight / weight.sum())].copy()
    spread, shares = np.tile(0.1 * scale, (count, 1)), np.full(count, 1.0 / count)
    floor = np.minimum(0.05**2 * np.median(var, axis=0), 1e-2 * scale)
    before = score = -np.inf
    for _ in range(_SWEEPS):
        logs = _logs(x, var, shares, mean, spread)
        row = logsumexp(logs, axis=1)
        score = float(weight @ row)
        r = np.exp(logs - row[:, None]) * weight[:, None]
        mass = np.maximum(r.sum(axis=0), 1e-9)
        gain = spread / (var[:, None] + spread)
        hidden = mean + gain * (x[:, None] - mean)
        rest = spread * (1.0 - gain)
        mean = np.einsum("nk,nkd->kd", r, hidden) / mass[:, None]
        spread = np.einsum("nk,nkd->kd", r, (hidden - mean) ** 2 + rest) / mass[:, None]
        spread, shares = np.maximum(spread, floor), mass / mass.sum()
        if score - before < 1e-6 * abs(score):
            break
        before = score
    return score, shares, mean, spread
