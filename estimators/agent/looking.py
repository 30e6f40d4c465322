"""What an agent sees of a measurement: one kernel for environments and for the estimator.

Two views. ``plain`` shows the whitened innovation axis by axis, so it fits one number of components. ``levels`` shows
only what has no direction: any sensor in any space has the same observation, and one network serves them all.

`remember` returns what an agent remembers of a target between two measurements, one row each; its columns are named
below. The drift is the average of whitened innovations (``plain``) or of their directions (``levels``).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jink.estimators.agent.beliefs import LEVELS, advised_inflation, believe, forget_levels, principal
from jink.estimators.compiled import inner_kernel
from jink.estimators.factors import normalised_innovation

__all__ = [
    "BELIEF",
    "DRIFT",
    "LEVELS_SIZE",
    "LEVELS_VIEW",
    "MISSED",
    "NIS",
    "PLAIN_VIEW",
    "USED",
    "VIEWS",
    "begin_memory",
    "look",
    "look_away",
    "memory_size",
    "note_used",
    "view_bounds",
]

PLAIN_VIEW, LEVELS_VIEW = range(2)
VIEWS = {"plain": PLAIN_VIEW, "levels": LEVELS_VIEW}
NIS, MISSED, USED, SHORT, LONG, LONGEST, SIZE_SHORT, SIZE_LONG, SIZE_LONGEST, ADVICE, BELIEF = range(11)
"""Columns of the memory: D^2, samples since the last detection, last log inflation over ln 1e6, averages, belief."""
DRIFT = BELIEF + LEVELS
"""From here on one column per component of the sensor."""
BOUND, WIDE_BOUND = 5.0, 10.0
LEVELS_SIZE = 14 + LEVELS
LARGEST_LOG_INFLATION = math.log(1e6)
_PLAIN_SHORT, _PLAIN_LONG, _DRIFT = 4.0, 20.0, 4.0
_SHORT, _LONG, _LONGEST = 3.0, 10.0, 30.0


def memory_size(components: int) -> int:
    """Columns of the memory for a sensor of D components."""
    return DRIFT + components


def view_bounds(view: int, components: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest value of what `look` shows; (F,) each."""
    if view == PLAIN_VIEW:
        high = np.full(2 * components + 5, BOUND)
        low = -high
        low[2 * components + 3], low[2 * components + 4], high[2 * components + 4] = 0.0, 0.0, 1.0
        return low, high
    high = np.full(LEVELS_SIZE, WIDE_BOUND)
    low = -high
    low[9], high[9], low[10:], high[10:] = -1.0, 1.0, 0.0, 1.0
    high[11] = BOUND
    return low, high


@inner_kernel
def squash(value):
    """``x / (1 + |x| / 5)``: within the bound, and x itself near zero; a logarithm would cost twenty times as much."""
    return value / (1.0 + abs(value) / BOUND) if abs(value) < math.inf else math.copysign(BOUND, value)


@inner_kernel
def _clip(value, bound):
    return min(value, bound) if value > -bound else -bound


@inner_kernel
def begin_memory(memory):
    """Nothing has been seen."""
    for column in range(memory.size):
        memory[column] = 0.0
    memory[MISSED] = -1.0
    forget_levels(memory[BELIEF:DRIFT])


@inner_kernel
def note_used(memory, inflation):
    """Remember the inflation that was used with a measurement."""
    memory[USED] = _clip(math.log(max(inflation, 1.0)) / LARGEST_LOG_INFLATION, 1.0)


@inner_kernel
def look_away(view, memory, components, features):
    """Nothing was measured: averages stay, and a sample more has passed."""
    memory[MISSED] += 1.0
    memory[NIS] = 0.0
    if view == PLAIN_VIEW:
        _show_plain(memory, components, 0.0, 0.0, features)
        for a in range(components):
            features[a] = 0.0
    else:
        _show_levels(memory, 0.0, 0.0, 0.0, 0.0, 0.0, features)


@inner_kernel
def look(view, v, HPH, R, d, present, components, memory, scratch, basis, features):
    """What the agent sees of a measurement before it decides; the averages move on.

    Args:
        view: `PLAIN_VIEW` or `LEVELS_VIEW`.
        v, HPH, R: innovation, covariance of the predicted measurement, nominal noise of the components present.
        d, present, components: number present, which they are (d,), number of components of the sensor.
        memory: of this target; updated.
        scratch: (5 D + 1, at least 8).
        basis: result, (d + 2, padded): `beliefs.principal` of this innovation, with the view ``levels``.
        features: what is seen; the first columns are filled.
    """
    memory[MISSED] += 1.0
    nis = normalised_innovation(v, HPH, R, 1.0, d, scratch)
    memory[NIS] = nis if nis < math.inf else math.inf
    if view == PLAIN_VIEW:
        _look_plain(nis, HPH, R, d, present, components, memory, scratch, features)
    else:
        _look_levels(nis, v, HPH, R, d, present, memory, scratch, basis, features)


@inner_kernel
def _look_plain(nis, HPH, R, d, present, components, memory, scratch, features):
    log_nis, share = 0.0, 0.0
    for a in range(components):
        features[a] = 0.0
    if nis < math.inf:
        memory[MISSED] = 0.0
        log_nis = _clip(0.5 * math.log(nis / d + 0.01), BOUND)
        memory[SHORT] += (log_nis - memory[SHORT]) / _PLAIN_SHORT
        memory[LONG] += (log_nis - memory[LONG]) / _PLAIN_LONG
        above, below = 0.0, 0.0
        for i in range(d):
            a = int(present[i])
            above += HPH[i, i]
            below += R[i, i]
            value = squash(scratch[d + i, 0])
            features[a] = value
            memory[DRIFT + a] += (value - memory[DRIFT + a]) / _DRIFT
        share = above / (above + below)
    _show_plain(memory, components, log_nis, share, features)


@inner_kernel
def _show_plain(memory, components, log_nis, share, features):
    for a in range(components):
        features[components + a] = memory[DRIFT + a]
    at = 2 * components
    features[at] = log_nis
    features[at + 1] = memory[SHORT]
    features[at + 2] = memory[LONG]
    features[at + 3] = squash(memory[MISSED])
    features[at + 4] = share


@inner_kernel
def _look_levels(nis, v, HPH, R, d, present, memory, scratch, basis, features):
    log_nis, log_size, log_share, along, drift = 0.0, 0.0, 0.0, 0.0, 0.0
    basis[d, 0] = math.nan
    if nis < math.inf:
        memory[MISSED] = 0.0
        log_nis = _clip(0.5 * math.log(nis / d + 0.01), WIDE_BOUND)
        if nis > 0.0:
            root = math.sqrt(nis)
            for i in range(d):
                column, u = DRIFT + int(present[i]), scratch[d + i, 0] / root
                along += u * memory[column]
                memory[column] += (u - memory[column]) / _DRIFT
        for i in range(d):
            column = DRIFT + int(present[i])
            drift += memory[column] * memory[column]
        size = principal(v, HPH, R, d, scratch, basis)
        log_size = _clip(0.5 * math.log(size / d + 0.01), WIDE_BOUND) if size < math.inf else WIDE_BOUND
        share = 0.0
        for i in range(d):
            share += HPH[i, i] / R[i, i]
        log_share = _clip(0.5 * math.log(share / d + 1e-3), WIDE_BOUND)
        for column, seen in ((SHORT, log_nis), (SIZE_SHORT, log_size)):
            memory[column] += (seen - memory[column]) / _SHORT
            memory[column + 1] += (seen - memory[column + 1]) / _LONG
            memory[column + 2] += (seen - memory[column + 2]) / _LONGEST
        if size < math.inf:
            believe(basis, d, memory[BELIEF:DRIFT], scratch)
        advice = advised_inflation(HPH, R, d, memory[BELIEF:DRIFT])
        memory[ADVICE] = _clip(math.log(advice) / LARGEST_LOG_INFLATION, 1.0)
    _show_levels(memory, log_nis, log_size, log_share, along, math.sqrt(drift), features)


@inner_kernel
def _show_levels(memory, log_nis, log_size, log_share, along, drift, features):
    features[0] = log_nis
    features[1] = log_size
    features[2] = log_share
    for i in range(6):
        features[3 + i] = memory[SHORT + i]
    features[9] = _clip(along, 1.0)
    features[10] = min(drift, 1.0)
    features[11] = squash(memory[MISSED])
    for level in range(LEVELS):
        features[12 + level] = memory[BELIEF + level]
    features[12 + LEVELS] = memory[ADVICE]
    features[13 + LEVELS] = memory[USED]
