"""How far a number may lie from its repetition: percentile bootstrap over runs, or over blocks of recorded tracks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLOCK_S", "FEWEST_RUNS", "Measured", "Resampling", "Score", "measure", "resample_blocks", "resample_runs"]

Floats = NDArray[np.float64]
Statistic = Callable[[Floats], Floats]
"""Weights (R, n), how often each resample holds each run or row, to one number per resample (R,)."""

RESAMPLES, FEWEST_RUNS, FEWEST_BLOCKS = 1000, 5, 8
BLOCK_S = (10.0, 60.0)
"""Shortest and longest block; s."""
_STREAM, _ELEMENTS = 61, 4_000_000  # a stream of its own, apart from those of the scenarios; 32 MB of weights


class Measured(NamedTuple):
    """A number, its unit, the ends of its 95 % interval (NaN = none), and how these were found or why they are not."""

    value: float
    unit: str
    low: float = math.nan
    high: float = math.nan
    interval: str = "nothing to resample"


class Score(NamedTuple):
    """A statistic of weighted runs or rows; `reason`: why it cannot be resampled, empty where it can."""

    statistic: Statistic
    unit: str
    reason: str = ""


class Resampling(NamedTuple):
    """Batches of weights (R, n), words for the rows, and why there are no batches (empty where there are)."""

    size: int
    batches: Iterator[Floats]
    words: str
    reason: str = ""


def measure(scores: Mapping[str, Score], draws: Resampling) -> dict[str, Measured]:
    """Every score, with the interval between the 2.5 and 97.5 percentiles of its resamples.

    The percentile interval of a maximum (peak) leans upward: noise adds to it in every resample once more.

    Args:
        scores: metric to score, all of the same n runs or rows.
        draws: from `resample_runs` or `resample_blocks`.

    Returns:
        metric to number with interval.
    """
    names = [name for name, score in scores.items() if not (score.reason or draws.reason)]
    found: dict[str, list[Floats]] = {name: [] for name in names}
    with np.errstate(invalid="ignore"):  # an infinite error that no resample holds: zero times infinity
        for weights in draws.batches if names else ():
            for name in names:
                found[name].append(scores[name].statistic(weights))
    values = {}
    for name, score in scores.items():
        value = float(score.statistic(np.ones((1, draws.size)))[0])
        low = high = math.nan
        words = score.reason or draws.reason
        if name in found:
            resampled = np.concatenate(found[name])
            resampled = resampled[np.isfinite(resampled)]
            words = draws.words
            if len(resampled) < RESAMPLES:
                words = f"not finite in {RESAMPLES - len(resampled)} of {RESAMPLES} resamples"
            else:
                low, high = (float(end) for end in np.quantile(resampled, (0.025, 0.975)))
        values[name] = Measured(value, score.unit, low, high, words)
    return values


def resample_runs(runs: int, seed: int) -> Resampling:
    """Runs drawn with replacement; the same ones for every estimator of a seed.

    Args:
        runs: independent Monte-Carlo runs.
        seed: >= 0.
    """

    def batches() -> Iterator[Floats]:
        rng = _stream(seed)
        for count in _batches(runs):
            yield rng.multinomial(runs, np.full(runs, 1 / runs), size=count).astype(np.float64)

    reason = f"fewer than {FEWEST_RUNS} runs" if runs < FEWEST_RUNS else ""
    words = f"95 % percentile bootstrap, {RESAMPLES} resamples of {runs} runs"
    return Resampling(runs, batches(), words, reason)


def resample_blocks(times: Floats, lengths: NDArray[np.int64], seed: int) -> Resampling:
    """Blocks of rows drawn with replacement, because the errors of neighbouring rows are alike.

    A block lasts 60 s; a tenth of all track time where that is less, but not under 10 s. It holds as many rows as
    fit at the mean pace of its track, and continues at the track's first row after its last. A shorter track
    is one block. Every row is drawn equally often on average.

    Args:
        times: (B, T) s.
        lengths: rows of each track, the first of `times`; (B,).
        seed: >= 0.

    Source: Politis, Romano (1992), circular block bootstrap. Differs: several tracks.
    """
    spans = [float(times[b, rows - 1] - times[b, 0]) for b, rows in enumerate(lengths) if rows]
    block = float(np.clip(sum(spans) / 10, *BLOCK_S))
    blocks = np.array([_block_rows(times[b, :rows], block) for b, rows in enumerate(lengths)], dtype=np.int64)
    per_row, rows = np.repeat(blocks, lengths), int(lengths.sum())
    first = np.repeat(np.cumsum(lengths) - lengths, lengths)  # of the track of each row
    last = first + np.repeat(lengths, lengths)
    count = float((1.0 / per_row).sum()) if rows else 0.0

    def batches() -> Iterator[Floats]:
        rng, drawn = _stream(seed), round(count)
        for size in _batches(rows):
            starts = rng.choice(rows, (size, drawn), p=1.0 / per_row / count)
            ends, line = starts + per_row[starts], np.arange(size)[:, None]
            over = np.maximum(ends - last[starts], 0)
            steps = np.zeros((size, rows + 1))
            np.add.at(steps, (line, starts), 1.0)
            np.add.at(steps, (line, ends - over), -1.0)
            np.add.at(steps, (line, first[starts]), (over > 0).astype(np.float64))
            np.add.at(steps, (line, np.where(over > 0, first[starts] + over, rows)), -(over > 0).astype(np.float64))
            yield np.cumsum(steps[:, :-1], axis=1)

    reason = f"fewer than {FEWEST_BLOCKS} blocks of {block:.3g} s" if count < FEWEST_BLOCKS else ""
    words = f"95 % percentile bootstrap, {RESAMPLES} resamples of {round(count)} blocks of {block:.3g} s"
    return Resampling(rows, batches(), words, reason)


def _block_rows(times: Floats, seconds: float) -> int:
    """Rows of a block of one track."""
    span = float(times[-1] - times[0]) if len(times) else 0.0
    # At the mean pace: several rows may share one time or come in bursts, so a median gap says little.
    return int(np.clip(round(seconds * len(times) / span), 1, len(times))) if span > 0 else max(len(times), 1)


def _stream(seed: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(_STREAM,)))


def _batches(columns: int) -> Iterator[int]:
    """Numbers of resamples that add up to `RESAMPLES` and fit into memory."""
    size = int(np.clip(_ELEMENTS // max(columns, 1), 1, RESAMPLES))
    for first in range(0, RESAMPLES, size):
        yield min(size, RESAMPLES - first)
