"""Many tracks: in threads, in parts that fit memory, and rows outside a track's own."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from jink.estimators.inputs import Prior
from jink.estimators.records import History, Inputs, Outputs
from jink.estimators.status import MISSING, STARTING

__all__ = ["fill_outside", "in_parallel", "part_of_inputs", "part_of_prior"]

Floats = NDArray[np.float64]
_PARALLEL_ROWS = 4000


def in_parallel(
    threads: int,
    work: Callable[[int, int], object],
    tracks: int,
    rows: int,
    progress: Callable[[int], None] | None,
) -> None:
    """``work(begin, end)`` over chunks of tracks; kernels release the GIL, so threads are enough."""
    threads = min(threads, tracks)
    if tracks == 0:
        return
    pieces = threads if progress is None else max(threads, min(tracks, 50))
    bounds = np.linspace(0, tracks, pieces + 1).astype(int)
    ranges = [(int(low), int(high)) for low, high in pairwise(bounds) if high > low]
    if threads <= 1 or tracks * rows < _PARALLEL_ROWS:
        for low, high in ranges:
            work(low, high)
            if progress is not None:
                progress((high - low) * rows)
        return
    work(*ranges[0])  # compiled once, before the threads meet
    if progress is not None:
        progress((ranges[0][1] - ranges[0][0]) * rows)
    with ThreadPoolExecutor(threads) as pool:
        for (low, high), _ in zip(ranges[1:], pool.map(lambda span: work(*span), ranges[1:]), strict=True):
            if progress is not None:
                progress((high - low) * rows)


def part_of_inputs(inputs: Inputs, begin: int, end: int) -> Inputs:
    """The inputs of tracks ``begin`` to ``end``."""

    def cut(array: NDArray[np.float64]) -> NDArray[np.float64]:
        return array if array.shape[0] <= 1 else np.ascontiguousarray(array[begin:end])

    return Inputs(
        cut(inputs.times),
        np.ascontiguousarray(inputs.measurements[begin:end]),
        cut(inputs.noise),
        cut(inputs.sensors),
        cut(inputs.chains),
        inputs.first[begin:end].copy(),
        inputs.lengths[begin:end].copy(),
    )


def part_of_prior(prior: Prior | None, begin: int, end: int) -> Prior | None:
    """The prior of tracks ``begin`` to ``end``: kinematic priors may differ by track."""
    if prior is None or isinstance(prior.mean, list) or np.ndim(prior.mean) < 2:
        return prior
    cov = np.asarray(prior.cov)
    return prior._replace(mean=np.asarray(prior.mean)[begin:end], cov=cov[begin:end] if cov.ndim == 3 else cov)


def fill_outside(inputs: Inputs, outputs: Outputs, history: History, probs: Floats) -> None:
    """Rows before the start hold the start carried back at its velocity; padding repeats the last row."""
    rows = outputs.status.shape[1]
    if rows == 0 or (not inputs.first.any() and (inputs.lengths == rows).all()):
        return
    half = outputs.kin_mean.shape[2] // 2
    for b in range(len(inputs.first)):
        first, length = int(inputs.first[b]), int(inputs.lengths[b])
        times = inputs.times[min(b, inputs.times.shape[0] - 1)]
        if first >= length:
            outputs.status[b, :length] = STARTING
            outputs.status[b, length:] = MISSING
            outputs.mode_probs[b] = probs
            continue
        if first > 0:
            back = np.eye(2 * half)
            for t in range(first):
                back[range(half), range(half, 2 * half)] = times[t] - times[first]
                outputs.kin_mean[b, t] = back @ outputs.kin_mean[b, first]
                outputs.kin_cov[b, t] = back @ outputs.kin_cov[b, first] @ back.T
            outputs.mode_probs[b, :first] = outputs.mode_probs[b, first]
            outputs.status[b, :first] = STARTING
            if history.mean.shape[1]:
                history.mean[b, :first] = history.mean[b, first]
                history.cov[b, :first] = history.cov[b, first]
        if length < rows:
            for array in (outputs.kin_mean, outputs.kin_cov, outputs.mode_probs, *history):
                if array.shape[1]:
                    array[b, length:] = array[b, length - 1]
            outputs.status[b, length:] = MISSING
