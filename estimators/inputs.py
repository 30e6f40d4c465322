"""Checking and shaping what a user hands to an estimator."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.bank import Bank
from jink.estimators.markov import check_transition_matrix
from jink.estimators.records import ABSURD, Inputs

__all__ = ["Prior", "check_inputs", "check_moments"]

Floats = NDArray[np.float64]
_ROUNDING = 1e-9


class Prior(NamedTuple):
    """What is known before the first measurement; wins over a start from measurements.

    Args:
        mean: position then velocity (2A,), m and m/s; or with ``cov`` a list: one state per mode, own components.
        cov: covariance (2A, 2A); or one per mode.
        time: when it holds; s; None: at the first row.
        includes_first: the first row's measurement is already in it (a posterior), so it is not used again.
        mode_probs: (M,); None: the bank's.
    """

    mean: ArrayLike | list[ArrayLike]
    cov: ArrayLike | list[ArrayLike]
    time: float | None = None
    includes_first: bool = False
    mode_probs: ArrayLike | None = None


def check_inputs(
    bank: Bank,
    measurements: ArrayLike,
    times: ArrayLike,
    noise: ArrayLike | None = None,
    sensor_states: ArrayLike | None = None,
    lengths: ArrayLike | None = None,
    mode_transition: ArrayLike | None = None,
    *,
    caller: str,
) -> Inputs:
    """Arrays for the compiled cycle, shared axes kept at length 1.

    Args:
        bank: whose sensor and modes set the sizes.
        measurements: (T, D) or (B, T, D); NaN where a component is missing.
        times: (T,) or (B, T); s; not decreasing.
        noise: measurement covariance (D, D), (T, D, D) or (B, T, D, D); None: the sensor's.
        sensor_states: sensor position, velocity (2A,), (T, 2A) or (B, T, 2A); None: zeros.
        lengths: rows of each track; (B,); None: all.
        mode_transition: Markov matrix of each step (M, M), (T, M, M) or (B, T, M, M); None: the bank's chain.
        caller: named in errors.

    Returns:
        `Inputs` with ``first`` at zero.

    Raises:
        ValueError: a shape, a time that decreases, a noise that is no covariance, a row that is no probability.
    """
    size, kin, modes = bank.sensor.size, 2 * bank.sensor.axes, len(bank.modes)
    z = _numbers(measurements, "measurements", caller)
    if z.ndim == 2:
        z = z[None]
    if z.ndim != 3 or z.shape[2] != size:
        raise ValueError(
            f"{caller}: measurements must have shape (T, {size}) or (B, T, {size}) for sensor {bank.sensor.name}; "
            f"got {np.shape(measurements)}. Columns are {', '.join(bank.sensor.labels)}."
        )
    tracks, rows = z.shape[:2]
    t = _numbers(times, "times", caller)
    if t.ndim == 1:
        t = t[None]
    if t.ndim != 2 or t.shape[1] != rows or t.shape[0] not in (1, tracks):
        raise ValueError(
            f"{caller}: times must have shape ({rows},) or ({tracks}, {rows}), one per row of measurements; got "
            f"{np.shape(times)}. Use np.arange(T) * dt for regular data."
        )
    counts = np.full(tracks, rows, dtype=np.int64)
    if lengths is not None:
        given = _numbers(lengths, "lengths", caller)
        counts = np.where(given == np.floor(given), given, -1).astype(np.int64)
        if counts.shape != (tracks,) or counts.min(initial=0) < 0 or counts.max(initial=0) > rows:
            raise ValueError(
                f"{caller}: lengths must be {tracks} integers in 0..{rows}; got {np.shape(lengths)} with values "
                f"{np.asarray(lengths).tolist()[:5]}. Give rows per track."
            )
    used = np.arange(rows) < counts[:, None]
    if not np.all(np.isfinite(np.where(used, t, 0.0))):
        raise ValueError(f"{caller}: times must be finite; got NaN or inf. Drop rows without a time.")
    backwards = (np.diff(t, axis=1) < 0) & used[:, 1:]
    if backwards.any():
        b, k = np.argwhere(backwards)[0]
        row = min(int(b), t.shape[0] - 1)
        raise ValueError(
            f"{caller}: times must not decrease; got {t[row, k]:.9g} then {t[row, k + 1]:.9g} in track {b} at row "
            f"{k + 1}. Sort the rows by time."
        )
    return Inputs(
        times=t,
        measurements=z,
        noise=_noise(bank, noise, tracks, rows, caller),
        sensors=_shared(sensor_states, (kin,), tracks, rows, np.zeros(kin), "sensor_states", caller),
        chains=(
            np.zeros((0, 0, modes, modes))
            if mode_transition is None
            else check_transition_matrix(
                _shared(mode_transition, (modes, modes), tracks, rows, None, "mode_transition", caller),
                modes,
                caller=caller,
            )
        ),
        first=np.zeros(tracks, dtype=np.int64),
        lengths=counts,
    )


def check_moments(mean: Floats, cov: Floats, caller: str = "Prior") -> None:
    """Refuse a prior that is no Gaussian: mean (..., n), cov (..., n, n); zero variances are allowed.

    Raises:
        ValueError: not finite, not symmetric, or not positive semidefinite.
    """
    if not (np.abs(mean) < ABSURD).all():
        raise ValueError(f"{caller}: mean must be finite (below {ABSURD:g}); got {mean.ravel()[:6]}. Give m and m/s.")
    variances = np.diagonal(cov, axis1=-2, axis2=-1)
    if not (np.abs(cov) < ABSURD).all() or (variances < 0).any():
        raise ValueError(
            f"{caller}: cov must be finite (below {ABSURD:g}) with variances >= 0; got {variances.ravel()[:6]} on its "
            "diagonal. Use a large variance for what is unknown."
        )
    scale = np.sqrt(np.where(variances > 0, variances, 1.0))
    scaled = cov / scale[..., :, None] / scale[..., None, :]
    worst = np.abs(scaled - np.swapaxes(scaled, -1, -2)).max(initial=0.0)
    lowest = np.linalg.eigvalsh(scaled).min(initial=0.0)
    if worst > _ROUNDING or lowest < -_ROUNDING:
        raise ValueError(
            f"{caller}: cov must be symmetric and positive semidefinite; got asymmetry {worst:.3g} and an eigenvalue "
            f"of {lowest:.3g} (of its correlations). Check signs and units."
        )


def _numbers(given: ArrayLike | None, name: str, caller: str) -> Floats:
    try:
        return np.ascontiguousarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{caller}: {name} must be numbers in rows of one length; got {error}. Use NaN for gaps."
        ) from None


def _shared(
    given: ArrayLike | None,
    shape: tuple[int, ...],
    tracks: int,
    rows: int,
    default: Floats | None,
    name: str,
    caller: str,
) -> Floats:
    """``given`` with leading axes (1 or B, 1 or T)."""
    array = _numbers(default if given is None else given, name, caller)
    extra = array.ndim - len(shape)
    if extra not in (0, 1, 2) or array.shape[extra:] != shape:
        raise ValueError(
            f"{caller}: {name} must have shape {shape}, (T, ...) or (B, T, ...) with B = {tracks}, T = {rows}; got "
            f"{array.shape}. Add or drop leading axes."
        )
    lead = (1,) * (2 - extra) + array.shape[:extra]
    if lead[0] not in (1, tracks) or lead[1] not in (1, rows):
        raise ValueError(
            f"{caller}: {name} must have leading axes ({tracks}, {rows}) or 1; got {array.shape}. One per row."
        )
    return array.reshape(lead + shape)


def _noise(bank: Bank, noise: ArrayLike | None, tracks: int, rows: int, caller: str) -> Floats:
    size = bank.sensor.size
    R = _shared(noise, (size, size), tracks, rows, bank.sensor.noise, "noise", caller)
    diagonal = np.diagonal(R, axis1=-2, axis2=-1)
    if noise is not None and np.any(diagonal <= 0):
        raise ValueError(
            f"{caller}: noise must be a covariance with variances > 0; got {float(diagonal.min()):.6g} on its "
            "diagonal. Give squared standard deviations."
        )
    if noise is not None and not np.allclose(R, np.swapaxes(R, -1, -2), rtol=1e-9, atol=0.0, equal_nan=True):
        raise ValueError(f"{caller}: noise must be symmetric; got an asymmetric matrix. Use (R + R.T) / 2.")
    return R
