"""Intents out of the encoder's features: a hidden Markov mixture that knows how noisy every row is.

A row shows ``x = (g, w)`` with covariance C (its window). Component k holds the law's parameters of an intent,

    eta | k ~ 1/2 N((m_g, m_w), V) + 1/2 N((m_g, -m_w), V)   (plane; left and right are one intent),
    eta | k ~ N((m_g, 0), diag(V_g, V_w I))                  (space; seen perpendicular to the velocity),
    x | eta ~ N(eta, C),

so ``V`` is what remains when the noise of the windows is taken away (extreme deconvolution). Labels follow a Markov
generator. Windows overlap, so the log-likelihood of a row is tempered by the share of it that is news.
Source: Bovy, Hogg, Roweis (2011), EM with a covariance per datum. Differs: diagonal V, mirrored pairs, Markov labels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.intent.features import Features
from jink.intent.hidden_chain import smooth_labels
from jink.intent.mixture_steps import densities, improved

__all__ = ["Clusters", "cluster"]

Floats = NDArray[np.float64]
_SURE = 3.0  # standard deviations of speed below which a row says nothing
_NEWS = 0.4  # of a window: features this far apart are nearly independent
_THIN = 0.12  # of a window: rows closer than this add work and no news
_FLOOR = 0.05  # smallest spread of a component, in standard deviations of a window
_ENOUGH = 1e-4  # nats per row
_PSEUDO = 1.0  # switches assumed before any are seen


class Clusters(NamedTuple):
    """What `cluster` found; K components, the mean and spread of g (1/s) and |w| (rad/s) in two columns.

    mean, sd: (K, 2). generator: row = from; (K, K), 1/s. initial: (K,). probs: of each row's component, (B, T, K).
    score: tempered log-likelihood per row, nats.
    """

    mean: Floats
    sd: Floats
    generator: Floats
    initial: Floats
    probs: Floats
    score: float

    @property
    def shares(self) -> Floats:
        """Share of rows of each component; (K,)."""
        return np.asarray(self.probs.mean(axis=(0, 1)))


def cluster(
    features: Features, lengths: NDArray[np.int64], count: int, *, seed: int = 0, restarts: int = 2, sweeps: int = 60
) -> Clusters:
    """Components of the shape parameters, by EM from several seeds; the best one is returned.

    Args:
        features: from `encode`.
        lengths: rows of each track; (B,).
        count: components K; the first begins at rest (g = 0, w = 0), as straight flight.
        seed: of the starting points; the same seed gives the same result.
        restarts: how many starting points.
        sweeps: most EM steps each.

    Returns:
        the components, by falling share.

    Raises:
        ValueError: fewer informative rows than components.
    """
    x, C, sure = projected(features)
    if np.count_nonzero(sure) < max(2 * count, 5):
        raise ValueError(
            f"cluster: features must have at least {max(2 * count, 5)} rows with a known direction; got "
            f"{np.count_nonzero(sure)}. Use a longer window, more tracks or fewer intents."
        )
    best = None
    generator = np.random.default_rng([int(seed), 0x1E47])
    thin = _Rows.of(x, C, sure, features, lengths, _THIN * features.window)
    for _ in range(max(restarts, 1)):
        start = _seeded(thin.x[thin.sure], thin.C[thin.sure], count, generator)
        found = _climb(thin, start, sweeps)
        if best is None or found.score > best.score:
            best = found
    assert best is not None
    rows = _Rows.of(x, C, sure, features, lengths, 0.0)
    best = _labelled(rows, best)
    order = np.argsort(-best.shares, kind="stable")
    return Clusters(
        best.mean[order], best.sd[order], best.generator[np.ix_(order, order)], best.initial[order],
        best.probs[..., order], best.score,
    )  # fmt: skip


def projected(features: Features) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """What each row shows of eta: values (B, T, E'), covariances, and which rows say anything.

    E' = 2 in the plane, 3 in space: g and the two components of w perpendicular to the velocity.
    """
    eta, cov = features.eta, features.eta_cov
    sure = np.asarray(features.valid & (features.speed_ratio > _SURE))
    if features.axes == 3:
        along = np.where(sure[..., None], features.velocity, [1.0, 0.0, 0.0])
        along = along / np.linalg.norm(along, axis=-1, keepdims=True)
        least = np.eye(3)[np.argmin(np.abs(along), axis=-1)]
        first = np.cross(along, least)
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        U = np.zeros((*along.shape[:-1], 3, 4))
        U[..., 0, 0] = 1.0
        U[..., 1, 1:], U[..., 2, 1:] = first, np.cross(along, first)
        eta, cov = (U @ eta[..., None])[..., 0], U @ cov @ U.swapaxes(-1, -2)
    size = eta.shape[-1]
    sure &= np.isfinite(cov).all(axis=(-1, -2)) & np.isfinite(eta).all(axis=-1)
    eta = np.where(sure[..., None], eta, 0.0)
    # a window across a switch fits badly: it is as uncertain as it fits badly
    excess = np.where(sure, np.maximum(features.misfit, 1.0), 1.0)[..., None, None]
    cov = np.where(sure[..., None, None], cov * excess, np.eye(size))
    return eta, cov, sure


class _Rows(NamedTuple):
    """Rows in use: values, covariances, which say anything, how much of each is news, steps and lengths."""

    x: Floats
    C: Floats
    sure: NDArray[np.bool_]
    news: Floats
    steps: Floats
    lengths: NDArray[np.int64]

    @staticmethod
    def of(
        x: Floats, C: Floats, sure: NDArray[np.bool_], features: Features, lengths: NDArray[np.int64], apart: float
    ) -> _Rows:
        """Every row, or rows at least ``apart`` seconds from the one before."""
        B, T = x.shape[:2]
        kept = [_spaced(features.times[b, : lengths[b]], apart) for b in range(B)]
        few = np.array([rows.size for rows in kept], dtype=np.int64)
        table = np.zeros((B, max(int(few.max(initial=1)), 1)), dtype=np.int64)
        for b, rows in enumerate(kept):
            table[b, : rows.size] = rows
            table[b, rows.size :] = rows[-1] if rows.size else T - 1
        track = np.arange(B)[:, None]
        clock = features.times[track, table]
        steps = np.diff(clock, axis=1, prepend=clock[:, :1])
        inside = np.arange(table.shape[1]) < few[:, None]
        positive = steps[steps > 0]
        typical = float(np.median(positive)) if positive.size else 1.0
        at = sure[track, table] & inside
        news = np.clip(np.maximum(steps, typical) / (_NEWS * features.window), 0.0, 1.0) * at
        return _Rows(x[track, table], C[track, table], at, news, steps, few)


def _spaced(times: Floats, apart: float) -> NDArray[np.int64]:
    if apart <= 0.0 or times.size == 0:
        return np.arange(times.size)
    return np.unique(np.searchsorted(times, np.arange(times[0], times[-1] + 1e-9 * apart, apart)))


def _seeded(x: Floats, C: Floats, count: int, generator: np.random.Generator) -> tuple[Floats, Floats]:
    """Means and variances to begin with: rest, then rows far from all before (k-means++), and the smallest variance."""
    folded = np.stack([x[:, 0], np.linalg.norm(x[:, 1:], axis=1)], axis=1)
    noise = np.stack([C[:, 0, 0], np.trace(C[:, 1:, 1:], axis1=1, axis2=2) / (x.shape[1] - 1)], axis=1)
    scale = np.sqrt(np.maximum(np.median(folded**2, axis=0), np.median(noise, axis=0)))
    clear = np.exp(-0.5 * np.sum(noise / scale**2, axis=1))  # certain rows make better starting points
    points = folded / scale
    chosen = [np.zeros(2)]
    while len(chosen) < count:
        distance = np.min([np.sum((points - point) ** 2, axis=1) for point in chosen], axis=0)
        weights = np.minimum(distance, np.quantile(distance, 0.98)) * clear
        total = weights.sum()
        pick = int(np.searchsorted(np.cumsum(weights), generator.random() * total)) if total > 0 else 0
        chosen.append(points[min(pick, len(points) - 1)])
    mean = np.array(chosen) * scale
    if x.shape[1] == 3:
        mean[:, 1] = 0.0
        spread = np.maximum(np.array(chosen)[:, 1] * scale[1], 0.1 * scale[1])
        var = np.stack([np.full(count, (0.3 * scale[0]) ** 2), spread**2], axis=1)
    else:
        var = np.tile((0.3 * scale) ** 2, (count, 1))
    return mean, var


def _climb(rows: _Rows, start: tuple[Floats, Floats], sweeps: int) -> Clusters:
    mean, var = start
    K = len(mean)
    span = float(sum(step[:length].sum() for step, length in zip(rows.steps, rows.lengths, strict=True)))
    dwell = span / max(4.0 * len(rows.lengths), 8.0) or 1.0
    chain = np.full((K, K), 1.0 / (dwell * max(K - 1, 1)))
    np.fill_diagonal(chain, 0.0)
    np.fill_diagonal(chain, -chain.sum(axis=1))
    found = Clusters(mean, np.sqrt(var), chain, np.full(K, 1.0 / K), np.empty(0), -np.inf)
    noise = rows.C[rows.sure]
    smallest = _FLOOR**2 * np.array([np.median(noise[:, 0, 0]), np.median(noise[:, 1, 1])])
    for _ in range(sweeps):
        fit = _expect(rows, found)
        weights = fit.probs * rows.news[..., None]
        mean, var = improved(rows.x, weights, fit.left, fit.inverse, found.mean, found.sd**2, smallest)
        time = np.einsum("btk,bt->k", fit.probs, rows.steps)
        off = fit.counts + _PSEUDO / K
        np.fill_diagonal(off, 0.0)
        chain = off / np.maximum(time + _PSEUDO * dwell, 1e-12)[:, None]
        np.fill_diagonal(chain, -chain.sum(axis=1))
        initial = fit.probs[:, 0].mean(axis=0) + 1e-3
        before = found.score
        found = Clusters(mean, np.sqrt(var), chain, initial / initial.sum(), fit.probs, fit.score)
        if fit.score - before < _ENOUGH:
            break
    return found


class _Fit(NamedTuple):
    """An E step: labels, switches, side (left), gains and remaining variances per component, score."""

    probs: Floats
    counts: Floats
    left: Floats
    inverse: list[Floats]
    score: float


def _expect(rows: _Rows, at: Clusters) -> _Fit:
    logs, left, inverse = densities(rows.x, rows.C, at.mean, at.sd**2)
    probs, counts = np.zeros(logs.shape), np.zeros((len(at.mean),) * 2)
    evidence = np.zeros(len(rows.x))
    smooth_labels(
        rows.news[..., None] * logs, rows.steps, rows.lengths, at.generator, True, at.initial, probs, counts, evidence
    )
    return _Fit(probs, counts, left, inverse, float(evidence.sum()) / max(float(rows.news.sum()), 1.0))


def _labelled(rows: _Rows, at: Clusters) -> Clusters:
    return at._replace(probs=_expect(rows, at).probs)
