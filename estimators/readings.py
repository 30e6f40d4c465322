"""What a user reads from the mode probabilities of a bank: which intent, which noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.bank import Bank

__all__ = ["intent_names", "intent_probs", "noise_scale", "surge_probability"]

Floats = NDArray[np.float64]


def _by_mode(bank: Bank, mode_probs: ArrayLike, caller: str) -> Floats:
    probs = np.asarray(mode_probs, dtype=np.float64)
    if probs.ndim == 0 or probs.shape[-1] != len(bank.modes):
        raise ValueError(
            f"{caller}: mode_probs must have shape (..., {len(bank.modes)}), one per mode; got {probs.shape}. "
            "Pass estimates.mode_probs of the same estimator."
        )
    return probs


def intent_names(bank: Bank) -> tuple[str, ...]:
    """Names of the intents, in the order of their first modes."""
    return tuple(dict.fromkeys(mode.purpose for mode in bank.modes))


def intent_probs(bank: Bank, mode_probs: ArrayLike) -> Floats:
    """Probability of each intent whatever the noise; (..., I), in the order of `intent_names`."""
    probs = _by_mode(bank, mode_probs, "intent_probs")
    purposes = [mode.purpose for mode in bank.modes]
    members = np.array([[purpose == name for name in intent_names(bank)] for purpose in purposes], dtype=np.float64)
    return np.asarray(probs @ members)


def surge_probability(bank: Bank, mode_probs: ArrayLike) -> Floats:
    """Probability that the noise is above the bank's lowest `Level`; (...); 0 for a bank without levels."""
    probs = _by_mode(bank, mode_probs, "surge_probability")
    scales = np.array([mode.noise_scale for mode in bank.modes])
    return np.asarray(probs @ (scales > scales.min()).astype(np.float64))


def noise_scale(bank: Bank, mode_probs: ArrayLike) -> Floats:
    """Expected factor on R of a bank of levels, ``sum_j mu_j scale_j``; (...); 1 without a `Level`.

    Times R it is the estimated measurement noise. What an adaptive factor did to R is not in it.
    """
    probs = _by_mode(bank, mode_probs, "noise_scale")
    return np.asarray(probs @ np.array([mode.noise_scale for mode in bank.modes]))
