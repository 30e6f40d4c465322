"""The score of estimates against the truth, and the age of an intent: one pass over all targets."""

from __future__ import annotations

import math

from numba import njit

from jink.envs.compiled import entry_kernel
from jink.estimators.compiled import COMPILE_OPTIONS

__all__ = ["elapsed", "judge"]

_uncontracted = njit(nogil=True, _nrt=False, **{**COMPILE_OPTIONS, "fastmath": False})
"""Without fused multiply-add: an error has the very bits that ``sqrt((x * x).sum())`` in NumPy gives a benchmark."""


@_uncontracted
def _length(x):
    total = 0.0
    for i in range(x.size):
        total += x[i] * x[i]
    return math.sqrt(total)


@entry_kernel
def judge(actions, k, live, ends, samples, columns, limits, off, streak, error, reward, lost):
    """Score the estimates of sample ``k[b]`` of every live target.

    actions (B, A) in units of ``limits[0]`` m; samples (B, T, W) with position, estimate, sigma and score in the
    columns given; ends (B,): the sample after the last decision; limits: scale, sigma at which an estimate is far
    off, decisions in a row, cap. Writes the estimate and the score into the sample, and streak, error, reward, lost;
    (B,). Where the truth is NaN the reward is 0.
    """
    position, guess, sigma, score = columns
    scale, lost_after, lost_steps, cap = limits
    for b in range(k.size):
        reward[b] = 0.0
        lost[b] = False
        if live[b]:
            sample = samples[b, k[b]]
            for i in range(actions.shape[1]):
                sample[guess + i] = actions[b, i] * scale
                off[i] = sample[guess + i] - sample[position + i]
            error[b] = _length(off)
            relative = error[b] / sample[sigma]
            if relative > lost_after:
                streak[b] += 1
            elif relative <= lost_after:
                streak[b] = 0
            if streak[b] >= lost_steps:
                lost[b] = True
                reward[b] = -cap * (ends[b] - k[b])
            elif not math.isnan(relative):
                reward[b] = -min(relative, cap)
            sample[score] = reward[b]


@entry_kernel
def elapsed(times, switch_times, since):
    """Time since the last switch, or since time 0; (B, T); switches in order, then NaN."""
    for b in range(times.shape[0]):
        last, j = 0.0, 0
        for t in range(times.shape[1]):
            while j < switch_times.shape[1] and switch_times[b, j] <= times[b, t]:
                last = switch_times[b, j]
                j += 1
            since[b, t] = times[b, t] - last
