"""Change points by penalised cost: where a weighted piecewise constant fits best for its number of pieces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.clusters import projected
from jink.intent.features import Features, encode
from jink.intent.window import choose_window

__all__ = ["Piece", "Pieces", "cut_tracks", "optimal_cuts"]

Floats = NDArray[np.float64]
_THIN = 0.25  # of a window
_NEWS = 0.4  # of a window: features this far apart are nearly independent


class Piece(NamedTuple):
    """Rows first..last of a track that share one law: mean (g, |w|) and variances, (2,); side -1 if it turns right."""

    track: int
    first: int
    last: int
    mean: Floats
    var: Floats
    side: int = 1


class Pieces(NamedTuple):
    """Pieces of all tracks, and the features they were cut by."""

    pieces: list[Piece]
    features: Features


def optimal_cuts(x: Floats, weights: Floats, penalty: float) -> list[int]:
    """Beginnings of the pieces of the best piecewise constant: sum of weights (x - mean)^2 + penalty per piece.

    Args:
        x: (T, D).
        weights: of each component, >= 0; (T, D).
        penalty: for every piece.

    Returns:
        rows where a piece begins, the first 0.

    Source: Jackson et al. (2005), optimal partitioning; PELT without the pruning, exact.
    """
    T = len(x)
    zero = np.zeros((1, x.shape[1]))
    w, wx, wxx = (np.cumsum(np.concatenate([zero, part]), axis=0) for part in (weights, weights * x, weights * x * x))
    best, origin = np.zeros(T + 1), np.zeros(T + 1, dtype=np.int64)
    best[0] = -penalty
    for end in range(1, T + 1):
        mass, first, second = w[end] - w[:end], wx[end] - wx[:end], wxx[end] - wxx[:end]
        cost = np.sum(second - first**2 / np.maximum(mass, 1e-300), axis=1)
        total = best[:end] + cost + penalty
        origin[end] = int(np.argmin(total))
        best[end] = total[origin[end]]
    cuts, end = [], T
    while end > 0:
        end = int(origin[end])
        cuts.append(end)
    return cuts[::-1]


def cut_tracks(tracks: Tracks, strength: float, window: float | None, noise_sd: float | None) -> Pieces:
    """Pieces of tracks whose shape parameters are constant as far as their noise lets one say.

    Args:
        tracks: what was measured.
        strength: penalty of a piece over that of the Bayesian criterion, ``E log n`` for n independent windows.
        window: of the encoder, s; None: `choose_window`.
        noise_sd: as for `encode`.
    """
    span = choose_window(tracks, noise_sd) if window is None else window
    features = encode(tracks, span, noise_sd)
    x, C, sure = projected(features)
    pieces = []
    for b, length in enumerate(tracks.lengths):
        clock = tracks.times[b, :length]
        if length == 0:
            continue
        rows = np.unique(np.searchsorted(clock, np.arange(clock[0], clock[-1] + 1e-9, _THIN * span)))
        rows = rows[sure[b, rows]]
        if rows.size < 2:
            pieces.append(Piece(b, 0, int(length) - 1, np.zeros(2), np.full(2, np.inf)))
            continue
        gaps = np.diff(clock[rows], append=clock[rows[-1]] + _THIN * span)
        news = np.clip(gaps / (_NEWS * span), 0.0, 1.0)
        weights = news[:, None] / np.diagonal(C[b, rows], axis1=1, axis2=2)
        spans = max((clock[-1] - clock[0]) / (_NEWS * span), 2.0)
        cuts = optimal_cuts(x[b, rows], weights, strength * x.shape[2] * float(np.log(spans)))
        edges = [0, *(int(rows[c]) for c in cuts[1:]), int(length)]
        for i, cut in enumerate(cuts):
            end = cuts[i + 1] if i + 1 < len(cuts) else len(rows)
            mass = weights[cut:end].sum(axis=0)
            mean = np.sum(weights[cut:end] * x[b, rows[cut:end]], axis=0) / mass
            var = np.array([1.0 / mass[0], 1.0 / mass[1:].mean()])
            folded = np.array([mean[0], float(np.linalg.norm(mean[1:]))])
            side = -1 if x.shape[2] == 2 and mean[1] < 0.0 else 1
            pieces.append(Piece(b, edges[i], edges[i + 1] - 1, folded, var, side))
    return Pieces(pieces, features)
