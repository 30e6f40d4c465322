"""Estimators that are told what nobody can know: the true noise, the true intent, or both. Bounds for a benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank
from jink.estimators.inputs import Prior, check_inputs

__all__ = ["oracle", "untreated"]


def untreated(bank: Bank) -> Bank:
    """The intents of a bank alone: one mode each, at nominal noise. What `oracle` runs.

    Of a joint bank, the bank that was given to `joint_bank`, without treatments.

    Raises:
        ValueError: several modes per intent in a bank that is no product (then build the bank of intents).
    """
    names = list(dict.fromkeys(mode.purpose for mode in bank.modes))
    changes = {"shared": False, "learns_noise": False}
    if len(names) == 1:
        mode = replace(bank.modes[0], name=names[0], treatment=None)
        return bank.with_(modes=(mode,), chain=None, initial_probs=None, **changes)
    if len(names) == len(bank.modes):
        return bank.with_(modes=tuple(replace(mode, treatment=None) for mode in bank.modes), **changes)
    factors = None if bank.chain is None else bank.chain.factors
    levels = len(bank.modes) // len(names)
    product = [name for name in names for _ in range(levels)]
    if factors is None or factors[0].modes != len(names) or [mode.purpose for mode in bank.modes] != product:
        raise ValueError(
            f"untreated: bank must have one mode per intent, or come from joint_bank; got {len(bank.modes)} modes of "
            f"{len(names)} intents. Pass the bank of intents."
        )
    modes = tuple(replace(mode, name=mode.purpose, treatment=None) for mode in bank.modes[::levels])
    start = bank.initial_probs
    if start is not None:
        start = tuple(float(share) for share in np.reshape(start, (-1, levels)).sum(axis=1))
    return bank.with_(modes=modes, chain=factors[0], initial_probs=start, **changes)


def oracle(
    bank: Bank,
    measurements: ArrayLike,
    times: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    intents: ArrayLike | None = None,
    names: Sequence[str] | None = None,
    sensor_states: ArrayLike | None = None,
    prior: Prior | None = None,
    threads: int | None = None,
) -> Estimates:
    """Run the intents of a bank with the true noise, the true intents, or both.

    Args:
        bank: see `untreated`.
        measurements, times, sensor_states, prior: as in `BankEstimator.run`.
        noise: true R, (D, D), (T, D, D) or (B, T, D, D); None: the sensor's.
        intents: true intent of each row, (T,) or (B, T), as an index into ``names``; negative: not told. Told from
            the second row on.
        names: names of the intents in ``intents``; None: those of the bank, in order.

    Returns:
        `Estimates` with one mode per intent.

    Raises:
        ValueError: an intent the bank has not, a bank that `untreated` refuses, or shapes that do not fit.
    """
    estimator = BankEstimator(untreated(bank), name="oracle", threads=threads)
    transition = None
    if intents is not None:
        known = [mode.purpose for mode in estimator.bank.modes]
        columns = _columns(known, known if names is None else names)
        inputs = check_inputs(estimator.bank, measurements, times, noise, sensor_states, caller="oracle")
        shape = np.shape(measurements)[:-1]
        given = np.asarray(intents)
        if given.shape != shape or not np.issubdtype(given.dtype, np.integer) or given.max(initial=-1) >= len(columns):
            found = f"shape {given.shape}"
            if given.shape == shape:
                found = f"{given.dtype}" if given.dtype.kind not in "iu" else f"{given.max()} among them"
            raise ValueError(
                f"oracle: intents must be integers below {len(columns)} with shape {shape}; got {found}. "
                "One per measurement; negative where it is not told."
            )
        modes = np.where(given < 0, -1, columns[given])
        transition = _told(estimator.bank, modes, inputs.times[0] if len(inputs.times) == 1 else inputs.times)
    return estimator.run(measurements, times, noise, sensor_states, prior=prior, mode_transition=transition)


def _columns(known: list[str], names: Sequence[str]) -> NDArray[np.int64]:
    names = [names] if isinstance(names, str) else list(names)
    missing = [name for name in names if name not in known]
    if missing:
        raise ValueError(f"oracle: names must be intents of the bank, {', '.join(known)}; got {missing}. Rename them.")
    return np.array([known.index(name) for name in names], dtype=np.int64)


def _told(bank: Bank, modes: NDArray[np.int64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Markov matrices (..., T, M, M) that lead to the given modes, and the bank's own where -1."""
    count = len(bank.modes)
    matrices = np.zeros((*modes.shape, count, count))
    for index in np.ndindex(modes.shape):
        if modes[index] >= 0:
            matrices[index][:, modes[index]] = 1.0
        elif bank.chain is None:
            matrices[index] = np.eye(count)
        else:
            row = times if times.ndim == 1 else times[index[0]]
            t = index[-1]
            matrices[index] = bank.chain.at(float(row[t] - row[t - 1]) if t > 0 else 0.0)
    return matrices
