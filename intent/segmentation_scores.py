"""How well labels found without supervision agree with labels given: permutation, information, change points, delay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from jink.estimators.metrics.steps import step_mask
from jink.estimators.metrics.switches import switch_delays
from jink.intent.segmentation import Segmentation

__all__ = ["Delay", "SegmentationScore", "contingency", "detection_delay", "score_segmentation"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class SegmentationScore(NamedTuple):
    """Agreement of a segmentation with given labels.

    accuracy: share of rows whose label is the given one, under the best one-to-one naming pooled over all tracks.
    purity: the same, where several found labels may name one given label.
    majority: share of the most frequent given label: what a single label would reach.
    nmi: mutual information over the mean of both entropies. ari: adjusted Rand index.
    precision, recall, f1: of change points within the tolerance. median_delay_s: from the switches that were followed,
    of the filter where there is one, else of the labels; missed: share of switches never followed.
    naming: given label of each found label, "" where none is left. rows: rows that counted.
    """

    accuracy: float
    purity: float
    majority: float
    nmi: float
    ari: float
    precision: float
    recall: float
    f1: float
    median_delay_s: float
    missed: float
    naming: tuple[str, ...]
    rows: int


class Delay(NamedTuple):
    """Delays of detection at a rate of false alarms: median, s; share missed; threshold; false alarms per hour."""

    median_s: float
    missed: float
    threshold: float
    false_alarms_per_hour: float


def contingency(found: Integers, given: Integers, kinds: tuple[int, int]) -> NDArray[np.int64]:
    """How often each found label (row) stood beside each given one (column)."""
    table = np.zeros(kinds, dtype=np.int64)
    np.add.at(table, (found, given), 1)
    return table


def score_segmentation(
    found: Segmentation, given: ArrayLike, tolerance_s: float, *, unknown: tuple[str, ...] = ("",)
) -> SegmentationScore:
    """Compare a segmentation with given labels; the labels are looked at here for the first time.

    Args:
        found: of B tracks.
        given: labels of the rows, text or whole numbers; (B, T); rows that are unknown do not count.
        tolerance_s: how far apart, s, a found and a given change point may lie to be the same.
        unknown: given labels that mean there is none; negative whole numbers too.

    Returns:
        the scores; NaN where nothing can be said.

    Raises:
        ValueError: another shape, a tolerance that is not positive, or no row with a label.
    """
    text = np.asarray(given)
    if text.shape != found.labels.shape:
        raise ValueError(
            f"score_segmentation: given must have shape {found.labels.shape}; got {text.shape}. Give one label per row."
        )
    if not tolerance_s > 0.0:
        raise ValueError(f"score_segmentation: tolerance_s must be > 0 s; got {tolerance_s}. Give a few time steps.")
    known = step_mask(found.labels.shape, found.lengths)
    known &= (text >= 0) if np.issubdtype(text.dtype, np.integer) else ~np.isin(text.astype(str), unknown)
    if not known.any():
        raise ValueError("score_segmentation: given must label at least one row; got none. Check the label column.")
    words, codes = np.unique(text[known].astype(str), return_inverse=True)
    true = np.full(text.shape, -1, dtype=np.int64)
    true[known] = codes.ravel()
    P, L = found.probs.shape[2], len(words)
    table = contingency(found.labels[known], true[known], (P, L))
    rows, columns = linear_sum_assignment(-table)
    naming = np.full(P, -1)
    naming[rows] = columns
    total = int(table.sum())
    mutual, ari = _information(table), _adjusted_rand(table)
    precision, recall, f1 = _change_points(found, true, tolerance_s)
    delays = _delays(found, true, naming, L)
    return SegmentationScore(
        accuracy=float(table[rows, columns].sum() / total),
        purity=float(table.max(axis=1).sum() / total),
        majority=float(table.sum(axis=0).max() / total),
        nmi=mutual,
        ari=ari,
        precision=precision,
        recall=recall,
        f1=f1,
        median_delay_s=float(np.nanmedian(delays)) if np.isfinite(delays).any() else float("nan"),
        missed=float(np.mean(~np.isfinite(delays))) if delays.size else float("nan"),
        naming=tuple(str(words[c]) if c >= 0 else "" for c in naming),
        rows=total,
    )


def _information(table: NDArray[np.int64]) -> float:
    joint = table / table.sum()
    rows, columns = joint.sum(axis=1), joint.sum(axis=0)

    def entropy(p: Floats) -> float:
        return float(-np.sum(p[p > 0] * np.log(p[p > 0])))

    whole = entropy(rows) + entropy(columns)
    return 2.0 * (whole - entropy(joint.ravel())) / whole if whole > 0 else float("nan")


def _adjusted_rand(table: NDArray[np.int64]) -> float:
    """Hubert and Arabie (1985)."""

    def pairs(count: NDArray[np.int64]) -> float:
        size = count.astype(np.float64)
        return float(np.sum(size * (size - 1.0) / 2.0))

    both, rows, columns = pairs(table), pairs(table.sum(axis=1)), pairs(table.sum(axis=0))
    whole = pairs(table.sum(keepdims=True).ravel())
    expected = rows * columns / whole if whole > 0 else 0.0
    most = 0.5 * (rows + columns)
    return (both - expected) / (most - expected) if most > expected else float("nan")


def _change_points(found: Segmentation, true: Integers, tolerance: float) -> tuple[float, float, float]:
    """Precision, recall and F1; each given change meets at most one found change, as many as possible."""
    met = claimed = wanted = 0
    for b in range(len(true)):
        known = np.flatnonzero(true[b] >= 0)
        if known.size < 2:
            continue
        clock, label = found.times[b, known], true[b, known]
        cut = np.flatnonzero(label[1:] != label[:-1])
        given = 0.5 * (clock[cut] + clock[cut + 1])
        mine = np.array([c.time for c in found.change_points(b) if clock[0] <= c.time <= clock[-1]])
        claimed, wanted = claimed + mine.size, wanted + given.size
        i = j = 0
        while i < mine.size and j < given.size:  # both sorted: the earliest possible pair is always safe to take
            if abs(mine[i] - given[j]) <= tolerance * (1.0 + 1e-9):
                met, i, j = met + 1, i + 1, j + 1
            elif mine[i] < given[j]:
                i += 1
            else:
                j += 1
    precision = met / claimed if claimed else float("nan")
    recall = met / wanted if wanted else float("nan")
    return precision, recall, 2.0 * met / (claimed + wanted) if claimed + wanted else float("nan")


def _named(probs: Floats, naming: NDArray[np.int64], kinds: int) -> Floats:
    """Probabilities of the given labels; what has no name goes to a column of its own."""
    out = np.zeros((*probs.shape[:2], kinds + 1))
    for p, name in enumerate(naming):
        out[..., name if name >= 0 else kinds] += probs[..., p]
    return out


def _delays(found: Segmentation, true: Integers, naming: NDArray[np.int64], kinds: int) -> Floats:
    if found.filtered is not None:
        probs = found.filtered
    else:
        probs = np.eye(found.probs.shape[2])[np.maximum(found.labels, 0)]
    return switch_delays(_named(probs, naming, kinds), true, found.times, found.lengths).delay_s


def detection_delay(probs: ArrayLike, given: ArrayLike, times: ArrayLike, false_alarms_per_hour: float) -> Delay:
    """Delay of a detector that declares a new label once its probability reaches a threshold.

    The threshold is the lowest at which declarations of a wrong label come no more often than allowed.

    Args:
        probs: of the given labels, by a filter; (B, T, L).
        given: 0..L-1, -1 = unknown; (B, T).
        times: s; (B, T).
        false_alarms_per_hour: allowed.

    Returns:
        the delay; the strictest threshold tried is 0.999, whether or not it keeps the rate.
    """
    p, true, clock = np.asarray(probs, dtype=np.float64), np.asarray(given), np.asarray(times, dtype=np.float64)
    known = true >= 0
    hours = float(np.sum(np.diff(clock, axis=1)[known[:, 1:] & known[:, :-1]])) / 3600.0
    result = Delay(float("nan"), float("nan"), 1.0, float("nan"))
    for threshold in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.999):
        declared = _declared(p, threshold)
        changed = np.zeros(true.shape, dtype=np.bool_)
        changed[:, 1:] = declared[:, 1:] != declared[:, :-1]
        rate = float(np.count_nonzero(changed & known & (declared != true))) / max(hours, 1e-12)
        delays = switch_delays(np.eye(p.shape[2])[declared], true, clock).delay_s
        median = float(np.nanmedian(delays)) if np.isfinite(delays).any() else float("nan")
        missed = float(np.mean(~np.isfinite(delays))) if delays.size else float("nan")
        result = Delay(median, missed, threshold, rate)
        if rate <= false_alarms_per_hour:
            break
    return result


def _declared(probs: Floats, threshold: float) -> Integers:
    out = np.empty(probs.shape[:2], dtype=np.int64)
    best, size = probs.argmax(axis=2), probs.max(axis=2)
    current = best[:, 0]
    for t in range(probs.shape[1]):
        current = np.where(size[:, t] >= threshold, best[:, t], current)
        out[:, t] = current
    return out
