"""How long the encoder's window should be: noise against what changes inside it.

A window of length T averages the shape parameters with the weights ``15/16 (1 - x^2)^2`` (x from -1 to 1) that least
squares of a parabola gives to the second derivative. Its noise falls as ``T^-5``; a switch inside it is a bias. If eta
jumps at a constant rate, the mean square bias is 0.061 times the mean square difference between two windows that touch,
whatever the size and the rate of the jumps. So with ``D(T)`` that difference, less its own noise,

    risk(T) = trace of the mean covariance of eta + 0.061 D(T)

is measured on the tracks themselves, and the window of least risk is taken.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.features import Features, encode

__all__ = ["WindowChoice", "choose_window", "window_risks"]

Floats = NDArray[np.float64]
_BIAS = 0.0613  # int (switch bias)^2 / int (difference of touching windows)^2 for the weights above
_STEPS = (5, 7, 10, 14, 20, 28, 40, 57, 80, 113, 160)
_ROWS = 1500
_CERTAIN = 3.0  # standard deviations of speed below which eta is no measure of anything
_FEWEST = 20  # pairs of windows that make a mean
_TAIL = 0.95


class WindowChoice(NamedTuple):
    """Windows tried and what they cost: window (K,) s; noise (K,) and bias (K,) of eta, 1/s^2; best window, s."""

    window: Floats
    noise: Floats
    bias: Floats
    best: float


def choose_window(tracks: Tracks, noise_sd: float | None = None) -> float:
    """The window of least risk, s; arguments and errors as `window_risks`."""
    return window_risks(tracks, noise_sd).best


def window_risks(tracks: Tracks, noise_sd: float | None = None) -> WindowChoice:
    """Noise and bias of the shape parameters in windows of 5 to 160 median time steps.

    Means are over at most 1500 rows spread evenly, whose speed is known to better than a third; the largest twentieth
    is pulled in, so that a slow target's turn rate does not decide.

    Args:
        tracks: what was measured; as for `encode`.
        noise_sd: as for `encode`.

    Returns:
        the risks; windows longer than half of most tracks, or with fewer than 20 pairs, are left out. Where none
        remains, the best is the longest tried.

    Raises:
        ValueError: from `encode`, or no track has two rows at different times.
    """
    steps = np.diff(tracks.times, axis=1)[tracks.used[:, 1:]]
    steps = steps[steps > 0]
    if not steps.size:
        raise ValueError("choose_window: tracks must have two rows at different times; got none. Give longer tracks.")
    step = float(np.median(steps))
    last = np.maximum(tracks.lengths - 1, 0)
    spans = tracks.times[np.arange(len(tracks)), last] - tracks.times[:, 0]
    candidates = [count * step for count in _STEPS if count * step <= 0.5 * float(np.quantile(spans, 0.75))]
    candidates = candidates or [_STEPS[0] * step]
    window, noise, bias = [], [], []
    for length in candidates:
        found = _risk(tracks, length, noise_sd)
        if found is not None:
            window.append(length)
            noise.append(found[0])
            bias.append(found[1])
    if not window:
        return WindowChoice(np.empty(0), np.empty(0), np.empty(0), candidates[-1])
    risks = np.array(noise) + np.array(bias)
    return WindowChoice(np.array(window), np.array(noise), np.array(bias), window[int(np.argmin(risks))])


def _risk(tracks: Tracks, window: float, noise_sd: float | None) -> tuple[float, float] | None:
    left, right = _pairs(tracks, window)
    if len(left) < _FEWEST:
        return None
    rows = np.zeros(tracks.times.shape, dtype=np.bool_)
    rows[tuple(left.T)] = rows[tuple(right.T)] = True
    features = encode(tracks, window, noise_sd, rows)
    sure = features.valid & (features.speed_ratio > _CERTAIN)
    kept = sure[tuple(left.T)] & sure[tuple(right.T)]
    if np.count_nonzero(kept) < _FEWEST:
        return None
    first, second = (_at(features, pair[kept]) for pair in (left, right))
    noise = 0.5 * (first[1] + second[1])
    change = np.sum((first[0] - second[0]) ** 2, axis=1)
    level = float(np.mean(np.minimum(noise, np.quantile(noise, _TAIL))))
    moved = float(np.mean(np.minimum(change, np.quantile(change, _TAIL))))
    return level, _BIAS * max(moved - 2.0 * level, 0.0)


def _at(features: Features, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
    b, t = rows.T
    return features.eta[b, t], np.trace(features.eta_cov[b, t], axis1=1, axis2=2)


def _pairs(tracks: Tracks, window: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows (b, t) one window apart, their windows inside the track, at most 1500 of them; (K, 2) each."""
    left, right = [np.empty((0, 2), dtype=np.int64)], [np.empty((0, 2), dtype=np.int64)]
    for b, length in enumerate(tracks.lengths):
        clock = tracks.times[b, :length]
        if length < 2 or clock[-1] - clock[0] < 2.0 * window:
            continue
        first = np.flatnonzero((clock >= clock[0] + 0.5 * window) & (clock <= clock[-1] - 1.5 * window))
        second = np.minimum(np.searchsorted(clock, clock[first] + window), length - 1)
        left.append(np.stack([np.full(first.size, b), first], axis=1))
        right.append(np.stack([np.full(first.size, b), second], axis=1))
    both = np.concatenate(left), np.concatenate(right)
    few = np.linspace(0, len(both[0]) - 1, min(_ROWS, len(both[0]))).astype(np.int64)
    return both[0][few], both[1][few]
