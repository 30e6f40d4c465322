"""How tracks of a bank begin: located by their first measurements, or at an explicit prior."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.estimators.bank import Bank
from jink.estimators.cycle import begin_tracks
from jink.estimators.forecasting import forecast_states
from jink.estimators.inputs import Prior, check_moments
from jink.estimators.records import ABSURD, LOCATED, PRIOR, Inputs, State
from jink.estimators.starting import StartBatch, start_batch

__all__ = ["begin_at_measurements", "locate", "take_prior"]


def begin_at_measurements(
    bank: Bank, started: StartBatch, inputs: Inputs, scales: NDArray[np.float64], program: Any, work: Any, state: State
) -> None:
    """Begin every mode where its own measurement noise puts the target: a first measurement may be an outlier.

    Args:
        bank: whose modes they are.
        started: starts of all tracks with the nominal noise.
        inputs: measurements.
        scales: factor on R of each mode; (M,).
        program, work: handles.
        state: written to; its position and velocity are those of the mixture.
    """
    for scale in np.unique(scales):
        own = started
        if scale != 1.0:
            own = locate(bank, inputs._replace(noise=inputs.noise * scale))
            alike = (own.index == started.index) & (own.seen == started.seen) & (own.ok == started.ok)
            own = StartBatch(
                *(np.where(alike.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(own, started, strict=True))
            )
        kin_mean = np.concatenate([own.position, own.velocity], axis=1)
        begin_tracks(program, work, kin_mean, np.ascontiguousarray(own.covariance), scales == scale, state)
    if (scales != 1.0).any():
        forecast_states(program, work, state, 0.0, 0, False, state.kin_mean, state.kin_cov)


def locate(bank: Bank, inputs: Inputs) -> StartBatch:
    """Starts of all tracks from their own measurements; broken numbers are left out."""
    tracks, rows = inputs.measurements.shape[:2]
    usable = (np.arange(rows) < inputs.lengths[:, None])[..., None] & (np.abs(inputs.measurements) < ABSURD)
    sensors = None if not inputs.sensors.any() else inputs.sensors
    if sensors is not None and not bank.sensor.linear:
        placed = (np.abs(sensors) < ABSURD).all(axis=2, keepdims=True)
        usable, sensors = usable & placed, np.where(placed, sensors, 0.0)
    z = np.where(usable, inputs.measurements, np.nan)
    return start_batch(
        bank.sensor,
        z,
        np.broadcast_to(inputs.times, (tracks, rows)),
        inputs.noise,
        sensors if sensors is None else np.broadcast_to(sensors, (tracks, rows, sensors.shape[2])),
        bank.speed,
        bank.area,
    )


def take_prior(bank: Bank, prior: Prior, program: Any, work: Any, state: State, times: NDArray[np.float64]) -> None:
    """Begin every track at an explicit prior, given in position and velocity or once per mode.

    Args:
        bank: whose prior it is.
        prior: what is known.
        program, work: handles.
        state: written to.
        times: (1 or B, T); s.

    Raises:
        ValueError: shapes do not fit, no covariance, or a time after the first row.
    """
    kin = state.kin_mean.shape[1]
    tracks = len(state.time)
    per_mode = isinstance(prior.mean, list) and len(prior.mean) == len(bank.modes) and np.ndim(prior.mean[0]) == 1
    if isinstance(prior.mean, list) and per_mode:
        if not isinstance(prior.cov, list) or len(prior.cov) != len(bank.modes):
            raise ValueError(
                f"Prior: cov must be a list with one matrix per mode, as mean is; got {type(prior.cov).__name__}. "
                "Give both alike."
            )
        for j, mode in enumerate(bank.modes):
            n = mode.motion.size
            mean, cov = np.asarray(prior.mean[j], dtype=np.float64), np.asarray(prior.cov[j], dtype=np.float64)
            if mean.shape != (n,) or cov.shape != (n, n):
                raise ValueError(
                    f"Prior: mode {mode.name} must have mean ({n},) and cov ({n}, {n}); got {mean.shape} and "
                    f"{cov.shape}. Components are {', '.join(mode.motion.labels)}."
                )
            check_moments(mean, cov)
            state.mean[:, j, :n] = mean
            state.cov[:, j, :n, :n] = cov
    else:
        mean = np.asarray(prior.mean, dtype=np.float64)
        cov = np.asarray(prior.cov, dtype=np.float64)
        if mean.shape not in ((kin,), (tracks, kin)) or cov.shape not in ((kin, kin), (tracks, kin, kin)):
            raise ValueError(
                f"Prior: mean must be position and velocity ({kin},) with cov ({kin}, {kin}), or one of each per "
                f"mode; got {mean.shape} and {cov.shape}. Add zero velocities with a large variance."
            )
        check_moments(mean, cov)
        begin_tracks(
            program,
            work,
            np.ascontiguousarray(np.broadcast_to(mean, (tracks, kin))),
            np.ascontiguousarray(np.broadcast_to(cov, (tracks, kin, kin))),
            np.ones(len(bank.modes), dtype=np.bool_),
            state,
        )
    if prior.mode_probs is not None:
        probs = np.asarray(prior.mode_probs, dtype=np.float64)
        if probs.shape != (len(bank.modes),) or not np.all(probs >= 0) or abs(probs.sum() - 1.0) > 1e-9:
            raise ValueError(
                f"Prior: mode_probs must be {len(bank.modes)} probabilities that sum to 1; got {prior.mode_probs}. "
                "Divide by the sum."
            )
        state.mode_probs[:] = probs
    if per_mode:
        forecast_states(program, work, state, 0.0, 0, False, state.kin_mean, state.kin_cov)
    begin = times[:, :1].min(axis=1, initial=np.inf)
    if prior.time is not None and not (np.isfinite(prior.time) and np.all(prior.time <= begin)):
        raise ValueError(
            f"Prior: time must be finite and not after the first row; got {prior.time}. Drop the rows before it."
        )
    state.time[:] = np.where(np.isfinite(begin), begin, 0.0) if prior.time is None else prior.time
    state.phase[:] = LOCATED if prior.includes_first else PRIOR
