"""What a user reads from the mode probabilities of a bank: which intent, which noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.bank import Bank

__all__ = ["intent_names", "intent_probs", "noise_scale", "surge_probability"]

Floats = NDArray[np.float64]


def _by_mode(bank: Bank, mode_probs: ArrayLike | None, caller: str) -> Floats:
    try:
        probs = np.zeros(()) if mode_probs is None else np.asarray(mode_probs, dtype=np.float64)
    except (TypeError, ValueError):
        probs = np.zeros(())
    if probs.ndim == 0 or probs.shape[-1] != len(bank.modes):
        raise ValueError(
            f"{caller}: mode_probs must have shape (..., {len(bank.modes)}), one per mode; got "
            f"{probs.shape if probs.ndim else type(mode_probs).__name__}. "
            "Pass estimates.mode_probs of the same estimator."
        )
    return probs


def _scales(bank: Bank, caller: str) -> Floats:
    scales = np.array([mode.noise_scale for mode in bank.modes])
    if not np.ptp(scales) > 0.0:
        raise ValueError(
            f"{caller}: bank must have several noise levels; got {', '.join(mode.name for mode in bank.modes[:4])}. "
            "Use joint-imm, or joint_bank around this one."
        )
    return scales


def intent_names(bank: Bank) -> tuple[str, ...]:
    """Names of the intents, in the order of their first modes."""
    return tuple(dict.fromkeys(mode.purpose for mode in bank.modes))


def intent_probs(bank: Bank, mode_probs: ArrayLike | None) -> Floats:
    """Probability of each intent whatever the noise; (..., I), in the order of `intent_names`."""
    probs = _by_mode(bank, mode_probs, "intent_probs")
    purposes = [mode.purpose for mode in bank.modes]
    members = np.array([[purpose == name for name in intent_names(bank)] for purpose in purposes], dtype=np.float64)
    return np.asarray(probs @ members)


def surge_probability(bank: Bank, mode_probs: ArrayLike | None) -> Floats:
    """Probability that the noise is above the bank's lowest `Level`; (...).

    Raises:
        ValueError: a bank without several levels, or probabilities of another bank.
    """
    scales = _scales(bank, "surge_probability")
    probs = _by_mode(bank, mode_probs, "surge_probability")
    return np.asarray(probs @ (scales > scales.min()).astype(np.float64))


def noise_scale(bank: Bank, mode_probs: ArrayLike | None) -> Floats:
    """Expected factor on R of a bank of levels, ``sum_j mu_j scale_j``; (...).

    Times R it is the estimated measurement noise; no more than the highest level. A mean over levels that grow by
    fours: one per cent of the highest outweighs the rest. What an adaptive factor did to R is not in it.

    Raises:
        ValueError: as `surge_probability`.
    """
    scales = _scales(bank, "noise_scale")
    probs = _by_mode(bank, mode_probs, "noise_scale")
    return np.asarray(probs @ scales)
