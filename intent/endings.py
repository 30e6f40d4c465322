"""How long intents last on tracks: time and endings as the smoother counts them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.model import IntentModel
from jink.intent.segmentation import segment

__all__ = ["count_endings", "with_endings"]

Floats = NDArray[np.float64]
_TOGETHER = 32  # tracks; bounds the memory that pairs of modes take


def count_endings(model: IntentModel, tracks: Tracks, threads: int | None = None) -> tuple[Floats, Floats]:
    """Expected seconds in each intent, and expected number of times that it gave way to another; (P,) twice.

    Model: given whole tracks, an intent has the time between two rows to the mean of its probabilities at both, and
    ends there with the probability of a pair of unlike intents that begins with it. A stretch that a track's first or
    last row cuts counts with the part that was seen, so seconds over endings are true to short tracks as well.

    Args:
        model: whose intents.
        tracks: what was measured, with the noise, unless the model learned it.
        threads: processor cores; None: all.

    Raises:
        ValueError: as `segment`.
    """
    count = len(model.intents)
    seconds, ended = np.zeros(count), np.zeros(count)
    for first in range(0, len(tracks), _TOGETHER):
        part = tracks.subset(np.arange(first, min(first + _TOGETHER, len(tracks))))
        found = segment(model, part, threads=threads)
        steps = np.diff(found.times, axis=1)
        used = np.arange(1, found.times.shape[1]) < found.lengths[:, None]
        mean = 0.5 * (found.probs[:, 1:] + found.probs[:, :-1])
        seconds += np.einsum("bt,btp->p", np.where(used, steps, 0.0), np.where(used[..., None], mean, 0.0))
        if found.endings is None:
            raise AssertionError("segment counts endings")
        ended += found.endings.sum(axis=(0, 1))
    return seconds, ended


def with_endings(model: IntentModel, tracks: Tracks, threads: int | None = None) -> IntentModel:
    """The model with ``endings`` as counted on tracks; an intent that they never show keeps what its chain says."""
    seconds, ended = count_endings(model, tracks, threads)
    chain = np.array([1.0 / model.chain_lasting(number) for number in range(len(seconds))])
    rates = np.divide(ended, seconds, out=chain, where=seconds > 0.0)
    return model.with_(endings=tuple(rates.tolist()))
