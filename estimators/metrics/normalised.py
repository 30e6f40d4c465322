"""Errors in units of their own covariance: squared distance, NEES of the state and of the position."""

import numpy as np
from numpy.typing import ArrayLike

from jink.estimators.metrics.steps import Bools, Floats, as_tracks, check_shape, scored_steps


def squared_distance(error: ArrayLike, cov: ArrayLike) -> Floats:
    """Squared Mahalanobis distance e' P^-1 e of a stack of errors.

    The matrices are scaled to unit diagonal first, so metres beside mm/s cost no digits.

    Args:
        error: (..., n).
        cov: (..., n, n), same leading shape, unit squared.
    Returns:
        (...); NaN where the error has a NaN, inf where P is not finite or not positive definite.
    Raises:
        ValueError: shapes do not fit.
    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4. Differs: none.
    """
    e = np.asarray(error, dtype=np.float64)
    P = np.asarray(cov, dtype=np.float64)
    if e.ndim < 1 or P.shape != (*e.shape, e.shape[-1]):
        raise ValueError(
            f"squared_distance: cov must have shape (..., n, n) beside an error (..., n); got {P.shape} and "
            f"{e.shape}. Give one covariance per error."
        )
    n = e.shape[-1]
    lead, e, P = e.shape[:-1], e.reshape(-1, n), P.reshape(-1, n, n)
    variances = np.diagonal(P, axis1=1, axis2=2)
    good: Bools = np.asarray(np.isfinite(P).all(axis=(1, 2))) & np.asarray((variances > 0.0).all(axis=1))
    scale = np.sqrt(np.where(good[:, None], variances, 1.0))
    unit = np.where(good[:, None, None], P, np.eye(n)) / scale[:, :, None] / scale[:, None, :]
    # A correlation above one is already not positive definite, and inf would stop the eigenvalue routine.
    good &= np.asarray((np.abs(unit) < 2.0).all(axis=(1, 2)))
    values, vectors = np.linalg.eigh(np.where(good[:, None, None], unit, np.eye(n)))
    good &= values[:, 0] > 0.0
    y = np.einsum("kij,ki->kj", vectors, e / scale)
    out = np.where(good, np.sum(y * y / np.where(good[:, None], values, 1.0), axis=1), np.inf)
    return np.where(np.isnan(e).any(axis=1), np.nan, out).reshape(lead)


def nees(
    position: ArrayLike,
    velocity: ArrayLike,
    covariance: ArrayLike,
    truth: ArrayLike,
    truth_velocity: ArrayLike,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> Floats:
    """Normalised estimation error squared of (position, velocity); expected value 2A.

    Args:
        position: (B, T, A) or (T, A) m.
        velocity: same shape, m/s.
        covariance: (B, T, 2A, 2A) or (T, 2A, 2A), all positions first, then all velocities.
        truth: positions, (B, T, A) m; NaN = unknown.
        truth_velocity: same, m/s.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to score.
    Returns:
        (B, T), no unit, 2A degrees of freedom; NaN where not scored, inf where the estimate is broken.
    Raises:
        ValueError: shapes differ.
    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4. Differs: none; of a bank, the fused covariance.
    """
    estimate = np.concatenate(
        [as_tracks("nees", "position", position, 3), as_tracks("nees", "velocity", velocity, 3)], axis=2
    )
    known = np.concatenate(
        [as_tracks("nees", "truth", truth, 3), as_tracks("nees", "truth_velocity", truth_velocity, 3)], axis=2
    )
    return _nees("nees", estimate, as_tracks("nees", "covariance", covariance, 4), known, lengths, mask)


def position_nees(
    position: ArrayLike,
    covariance: ArrayLike,
    truth: ArrayLike,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> Floats:
    """Normalised squared error of the position alone; expected value A.

    Args:
        position: (B, T, A) or (T, A) m.
        covariance: (B, T, 2A, 2A) in the order (p, v), or already (B, T, A, A); m^2.
        truth: (B, T, A) m; NaN = unknown.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to score.
    Returns:
        (B, T), A degrees of freedom; NaN where not scored, inf where the estimate is broken.
    Raises:
        ValueError: shapes differ.
    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4. Differs: position block only.
    """
    estimate = as_tracks("position_nees", "position", position, 3)
    cov = as_tracks("position_nees", "covariance", covariance, 4)
    axes = estimate.shape[2]
    known = as_tracks("position_nees", "truth", truth, 3)
    if cov.shape[2:] == (2 * axes, 2 * axes):
        cov = cov[:, :, :axes, :axes]
    return _nees("position_nees", estimate, cov, known, lengths, mask)


def _nees(
    caller: str,
    estimate: Floats,
    cov: Floats,
    known: Floats,
    lengths: ArrayLike | None,
    mask: ArrayLike | None,
) -> Floats:
    check_shape(caller, "estimate", estimate, known.shape)
    check_shape(caller, "covariance", cov, (*known.shape, known.shape[2]))
    scored, usable = scored_steps(estimate, known, lengths, mask)
    out = np.full(known.shape[:2], np.nan)
    out[scored] = np.inf
    out[usable] = squared_distance(estimate[usable] - known[usable], cov[usable])
    return out
