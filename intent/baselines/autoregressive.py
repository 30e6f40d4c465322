"""Baseline: sticky autoregressive hidden Markov model on ego-centric increments."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.baselines.choosing import best_of
from jink.intent.features import encode
from jink.intent.hidden_chain import smooth_labels
from jink.intent.segmentation import Segmentation
from jink.intent.window import choose_window

__all__ = ["StickyRegression", "egocentric"]

Floats = NDArray[np.float64]
_ORDERS = 4
_TOLD = 3.0  # nats by which one spell favours its own side
_NEWS = 0.4  # of a window: features this far apart are nearly independent


def egocentric(tracks: Tracks, window: float, noise_sd: float | None = None) -> Floats:
    """Change of velocity per second in the frame of the velocity, over the speed; (B, T, 2), 1/s.

    Along, and across (to the left; in space its size): growth and turn rate as the encoder sees them in a window. NaN
    where the window knows no direction, and in rows whose window is mostly that of a row before: their difference is
    the smoothing, not the target.
    """
    features = encode(tracks, window, noise_sd)
    eta = features.eta
    across = eta[..., 1:] if features.axes == 2 else np.linalg.norm(eta[..., 1:], axis=-1, keepdims=True)
    sure = features.valid & (features.speed_ratio > 2.0) & _apart(tracks, _NEWS * window)
    return np.where(sure[..., None], np.concatenate([eta[..., :1], across], axis=-1), np.nan)


def _apart(tracks: Tracks, gap: float) -> NDArray[np.bool_]:
    """Rows at least ``gap`` seconds from the last one taken; (B, T)."""
    out = np.zeros(tracks.times.shape, dtype=np.bool_)
    for b, length in enumerate(tracks.lengths):
        last = -np.inf
        for t in range(length):
            if tracks.times[b, t] >= last + gap * (1.0 - 1e-9):
                out[b, t], last = True, tracks.times[b, t]
    return out


class _States(NamedTuple):
    """Regression (K, P, D) on [1, past values], covariance (K, D, D), Markov matrix (S, S), start (S,)."""

    weights: Floats
    cov: Floats
    chain: Floats
    initial: Floats


@dataclass
class StickyRegression:
    """Sticky AR-HMM: ``y_t = A_k [1, y_t-1, .., y_t-r] + N(0, S_k)``, labels k by a Markov chain that likes to stay.

    Expectation-maximisation of the posterior mode: inverse-Wishart on S, a ridge on A, and ``sticky`` extra expected
    self-transitions per row of the chain. With ``mirrored`` every state has a twin whose across components are
    negated, with the same parameters and label.

    Args:
        intents: how many states; None: by the Bayesian information criterion, up to `most`.
        order: r, past values; None: 0 to 3, whichever the criterion prefers (for a series: past windows of the encoder
            say little that is new).
        sticky: extra self-transitions.
        mirrored: tie left and right; only for increments that change sign under a mirror image.
        across: which components a mirror image negates; None: the second.
        window: of the encoder, s; None: chosen from the tracks. Only where no series is given.
        noise_sd: standard deviation of a position, m; None: that of the tracks.
        most: largest number of states tried.
        restarts: starting points for every number.
        seed: of the starting points.

    Source: Fox, Sudderth, Jordan, Willsky (2011), sticky HDP-AR-HMM. Differs: a finite number of states chosen by BIC,
    the mode instead of draws, mirrored twins.
    """

    intents: int | None = None
    order: int | None = 0
    sticky: float = 50.0
    mirrored: bool = False
    across: tuple[int, ...] | None = None
    window: float | None = None
    noise_sd: float | None = None
    most: int = 6
    restarts: int = 4
    sweeps: int = 60
    seed: int = 0
    curve_: list[tuple[int, float]] = field(default_factory=list, init=False)

    def fit(self, tracks: Tracks, series: Floats | None = None) -> StickyRegression:
        """Learn from tracks; ``series`` (B, T, D): increments of another kind, for instance in a given body frame."""
        if series is None:
            self.window_ = choose_window(tracks, self.noise_sd) if self.window is None else self.window
        y = self._series(tracks, series)
        flat = y[np.isfinite(y).all(axis=2)]
        if len(flat) < 20:
            raise ValueError(f"StickyRegression: tracks must give 20 increments; got {len(flat)}. Give more tracks.")
        self.centre_, self.scale_ = flat.mean(axis=0), np.maximum(flat.std(axis=0), 1e-12)
        if self.mirrored:
            self.centre_ = self.centre_ * (self._signs(y.shape[2]) > 0)
        y = (y - self.centre_) / self.scale_
        generator = np.random.default_rng([self.seed, 0xA12])
        best = None
        orders = range(_ORDERS) if self.order is None else (self.order,)
        common = _past(y, max(orders), tracks.lengths)[1]  # the criterion compares the same rows
        for order in orders:
            x, known = _past(y, order, tracks.lengths)[0], common

            def climb(count: int, x: Floats = x, known: NDArray[np.bool_] = known) -> tuple[float, int, _States]:
                runs = [self._climb(x, y, known, tracks.lengths, count, generator) for _ in range(self.restarts)]
                score, states = max(runs, key=lambda run: run[0])
                D, P = y.shape[2], x.shape[2]
                return score, count * (P * D + D * (D + 1) // 2) + count * (count - 1), states

            sizes = [self.intents] if self.intents else list(range(1, self.most + 1))
            states, size, curve = best_of(climb, sizes, float(known.sum()))
            criterion = min(value for _, value in curve)
            if best is None or criterion < best[0]:
                best = (criterion, order, size, states, curve)
        assert best is not None
        _, self.order_, self.intents_, self._states, self.curve_ = best
        return self

    def segment(self, tracks: Tracks, series: Floats | None = None, *, handed: bool = False) -> Segmentation:
        """Labels of tracks, by forward-backward; ``handed``: twins that a spell tells apart are labels of their own."""
        y = (self._series(tracks, series) - self.centre_) / self.scale_
        x, known = _past(y, self.order_, tracks.lengths)
        probs, _, _ = self._expect(x, y, known, tracks.lengths, self._states)
        member = self._labels(handed)
        chain, merged = self._states.chain, probs @ member
        ahead = np.maximum(probs[:, :-1] @ chain, 1e-300)
        same = chain * (member @ member.T)
        stay = np.einsum("bti,ij,btj->bt", probs[:, :-1], same, probs[:, 1:] / ahead, optimize=True)
        switches = np.zeros(y.shape[:2])
        switches[:, 1:] = np.clip(1.0 - stay, 0.0, 1.0)
        return Segmentation.of_probs(merged, tracks.times, tracks.lengths, switches=switches)

    def _labels(self, handed: bool) -> Floats:
        """Which label each state (twins after the states) has; (S, labels)."""
        K, S = self.intents_, len(self._states.chain)
        label = list(range(K)) * (S // K)
        spells = 1.0 / np.maximum(1.0 - np.diag(self._states.chain), 1e-6)
        count = K
        for k in range(K if handed and S > K else 0):
            offset = 2.0 * self._states.weights[k, 0] * (self._signs(self._states.cov.shape[1]) < 0)
            told = 0.5 * float(offset @ np.linalg.solve(self._states.cov[k], offset)) * float(spells[k])
            if told > _TOLD:
                label[K + k], count = count, count + 1
        return np.asarray(np.eye(count)[label])

    def _series(self, tracks: Tracks, series: Floats | None) -> Floats:
        return egocentric(tracks, self.window_, self.noise_sd) if series is None else np.asarray(series, dtype=float)

    def _signs(self, size: int) -> Floats:
        signs = np.ones(size)
        signs[list((1,) if self.across is None else self.across)] = -1.0
        return signs

    def _sides(self, size: int) -> list[Floats]:
        return [np.ones(size), self._signs(size)] if self.mirrored else [np.ones(size)]

    def _expect(
        self, x: Floats, y: Floats, known: NDArray[np.bool_], lengths: NDArray[np.int64], states: _States
    ) -> tuple[Floats, Floats, float]:
        D, K = y.shape[2], len(states.cov)
        sides = self._sides(D)
        rows = np.zeros((*y.shape[:2], len(sides) * K))
        inverse, level = np.linalg.inv(states.cov), np.linalg.slogdet(2.0 * np.pi * states.cov)[1]
        for s, signs in enumerate(sides):
            xs, ys = _mirror(x, signs), np.where(known[..., None], y, 0.0) * signs
            for k in range(K):
                e = ys - xs @ states.weights[k]
                square = np.einsum("bti,ij,btj->bt", e, inverse[k], e, optimize=True)
                rows[..., s * K + k] = np.where(known, -0.5 * (square + level[k]), 0.0)
        probs, counts, evidence = np.zeros_like(rows), np.zeros((rows.shape[2],) * 2), np.zeros(len(y))
        steps = np.ones(y.shape[:2])
        smooth_labels(rows, steps, lengths, states.chain, False, states.initial, probs, counts, evidence)
        return probs, counts, float(evidence.sum())

    def _climb(
        self, x: Floats, y: Floats, known: NDArray[np.bool_], lengths: NDArray[np.int64], K: int,
        generator: np.random.Generator,
    ) -> tuple[float, _States]:  # fmt: skip
        D, P = y.shape[2], x.shape[2]
        sides = self._sides(D)
        S = K * len(sides)
        weights = np.zeros((K, P, D))
        blocks = _blocks(y, known, generator, K)  # local means and spreads of stretches: what a state may look like
        weights[:, 0], cov = blocks[0], blocks[1]
        chain = np.full((S, S), 0.05 / max(S - 1, 1)) + (0.95 - 0.05 / max(S - 1, 1)) * np.eye(S)
        states = _States(weights, cov, chain / chain.sum(axis=1, keepdims=True), np.full(S, 1.0 / S))
        before = score = -np.inf
        for _ in range(self.sweeps):
            probs, counts, score = self._expect(x, y, known, lengths, states)
            weights, cov = states.weights.copy(), states.cov.copy()
            for k in range(K):
                gram, cross, square, mass = 1e-2 * np.eye(P), np.zeros((P, D)), 2.0 * 0.05 * np.eye(D), D + 2.0
                for s, signs in enumerate(sides):
                    r = probs[..., s * K + k][known]
                    xs, ys = _mirror(x, signs)[known], y[known] * signs
                    gram += xs.T @ (r[:, None] * xs)
                    cross += xs.T @ (r[:, None] * ys)
                    square += ys.T @ (r[:, None] * ys)
                    mass += float(r.sum())
                weights[k] = np.linalg.solve(gram, cross)
                left = square - weights[k].T @ cross
                cov[k] = 0.5 * (left + left.T) / mass
            counts = counts + 0.5 / S + self.sticky * np.eye(S)
            initial = probs[:, 0].sum(axis=0) + 1.0
            if len(sides) == 2:  # twins share rows of the chain, sides exchanged
                swapped = np.roll(np.arange(S), K)
                counts, initial = counts + counts[np.ix_(swapped, swapped)], initial + initial[swapped]
            states = _States(weights, cov, counts / counts.sum(axis=1, keepdims=True), initial / initial.sum())
            if score - before < 1e-6 * abs(score):
                break
            before = score
        return score, states


def _mirror(x: Floats, signs: Floats) -> Floats:
    order = (x.shape[-1] - 1) // len(signs)
    return x * np.concatenate([[1.0], np.tile(signs, order)])


def _past(y: Floats, order: int, lengths: NDArray[np.int64]) -> tuple[Floats, NDArray[np.bool_]]:
    """Regressors [1, y of the known rows before] (B, T, P), 0 where unknown, and rows where all of them are known."""
    known = np.isfinite(y).all(axis=2) & (np.arange(y.shape[1]) < lengths[:, None])
    D = y.shape[2]
    x, whole = np.zeros((*y.shape[:2], 1 + order * D)), known.copy()
    x[..., 0] = 1.0
    for b in range(len(y)):
        rows = np.flatnonzero(known[b])
        for lag in range(1, order + 1):
            x[b, rows[lag:], 1 + (lag - 1) * D : 1 + lag * D] = y[b, rows[:-lag]]
        whole[b, rows[:order]] = False
    return x, whole


def _blocks(y: Floats, known: NDArray[np.bool_], generator: np.random.Generator, K: int) -> tuple[Floats, Floats]:
    """Means (K, D) and covariances (K, D, D) of short stretches far from each other (k-means++)."""
    size = 15 if known.sum() > 40 * len(y) else 5
    stretches = []
    for b in range(len(y)):
        where = np.flatnonzero(known[b])
        for first in range(0, where.size, size):
            rows = y[b, where[first : first + size]]
            if len(rows) >= 4:
                stretches.append(rows)
    if len(stretches) < K:
        stretches = [y[known]] * K
    D = y.shape[2]
    described = np.array([np.concatenate([r.mean(axis=0), np.log(r.std(axis=0) + 0.05)]) for r in stretches])
    chosen = [int(generator.integers(len(stretches)))]
    while len(chosen) < K:
        distance = np.min([np.sum((described - described[c]) ** 2, axis=1) for c in chosen], axis=0) + 1e-12
        chosen.append(int(generator.choice(len(stretches), p=distance / distance.sum())))
    mean = described[chosen, :D]
    cov = np.array([np.diag((stretches[c].std(axis=0) + 0.05) ** 2) for c in chosen])
    return mean, cov
