"""One flat row of numbers for the output of an estimator."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.metrics.consistency import average_nees, nis_consistency
from jink.estimators.metrics.modes import brier_score, log_score, mode_accuracy, true_mode_probability
from jink.estimators.metrics.normalised import nees, position_nees
from jink.estimators.metrics.paths import lost_track_rate, smoothness
from jink.estimators.metrics.steps import Bools, Floats, mean_or_nan, root_mean_square, step_mask
from jink.estimators.metrics.switches import switch_delays
from jink.estimators.metrics.tracking_errors import errors, peak_error, rmse
from jink.estimators.status import DIVERGED, MISSING, REPAIRED, STARTING


class EstimatesLike(Protocol):
    """What is read of an estimator's output; B tracks, T times, A axes, M modes, order (p, v)."""

    @property
    def times(self) -> Floats:
        """(B, T) s."""

    @property
    def position(self) -> Floats:
        """(B, T, A) m."""

    @property
    def velocity(self) -> Floats:
        """(B, T, A) m/s."""

    @property
    def covariance(self) -> Floats:
        """(B, T, 2A, 2A)."""

    @property
    def mode_probs(self) -> Floats:
        """(B, T, M)."""

    @property
    def log_likelihood(self) -> Floats:
        """(B, T) nats."""

    @property
    def nis(self) -> Floats:
        """(B, T)."""

    @property
    def nis_dof(self) -> NDArray[Any]:
        """(B, T), 0 = no measurement."""

    @property
    def status(self) -> NDArray[Any]:
        """(B, T) codes."""


def summary(
    estimates: EstimatesLike,
    truth: ArrayLike | None = None,
    truth_velocity: ArrayLike | None = None,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    true_modes: ArrayLike | None = None,
    gate: float | None = None,
    last: int = 10,
    level: float = 0.95,
) -> dict[str, float]:
    """Every measure that the given truth allows, as one flat row; keys carry their units.

    Always present: counts (`tracks`, `steps`, `measured_steps`, `missing_steps`, `repaired_steps`,
    `diverged_steps`, `starting_steps`), `nis_per_dof` with `nis_low`, `nis_high`, `nis_inside`,
    `log_likelihood_per_step` and `roughness_m_s2`. With truth: `scored_steps`, position errors and NEES,
    `lost_track_rate` if a gate is given; with velocity truth: velocity errors and the full NEES; with true
    modes: mode scores and switch delays. Steps still STARTING whose position is not finite are not scored.

    Args:
        estimates: what an estimator returns.
        truth: positions, (B, T, A) or (T, A) m; NaN = unknown.
        truth_velocity: same, m/s.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to use.
        true_modes: (B, T) or (T,) integers in the order of `mode_probs`; negative = unknown.
        gate: m; position error that counts as lost; None = no such row.
        last: scored steps that must all exceed the gate.
        level: probability of the bands.
    Returns:
        name -> number; NaN where nothing could be measured.
    Raises:
        ValueError: shapes differ or an option is out of range.
    Source: the measures of this package.
    """
    e = estimates
    shape = (e.status.shape[0], e.status.shape[1])
    keep = step_mask(shape, lengths, mask)
    measured = keep & (np.asarray(e.nis_dof) > 0)
    row: dict[str, float] = {"tracks": float(np.any(keep, axis=1).sum()), "steps": float(keep.sum())}
    row["measured_steps"] = float(measured.sum())
    codes = {"missing": MISSING, "repaired": REPAIRED, "diverged": DIVERGED, "starting": STARTING}
    for name, code in codes.items():
        row[f"{name}_steps"] = float((keep & (e.status == code)).sum())
    started = keep & ~((e.status == STARTING) & ~np.isfinite(e.position).all(axis=2))
    nis = nis_consistency(e.nis, e.nis_dof, lengths, mask, level)
    row.update(nis_per_dof=nis.mean, nis_low=nis.low, nis_high=nis.high, nis_inside=nis.share_inside)
    row["log_likelihood_per_step"] = mean_or_nan(e.log_likelihood[measured])
    row["roughness_m_s2"] = smoothness(e.position, e.times, lengths, started)
    if truth is not None:
        row.update(_position_row(e, truth, started, gate, last, level))
    if truth_velocity is not None:
        row["velocity_rmse_m_s"] = rmse(e.velocity, truth_velocity, None, started)
        row["velocity_peak_m_s"] = _largest(peak_error(e.velocity, truth_velocity, None, started))
    if truth is not None and truth_velocity is not None:
        values = nees(e.position, e.velocity, e.covariance, truth, truth_velocity, None, started)
        full = average_nees(values, 2 * e.position.shape[2], level)
        row.update(nees=full.mean, nees_low=full.low, nees_high=full.high, nees_inside=full.share_inside)
    if true_modes is not None:
        probs = e.mode_probs
        row["mode_accuracy"] = mode_accuracy(probs, true_modes, lengths, mask)
        row["mode_brier"] = brier_score(probs, true_modes, lengths, mask)
        row["mode_log_score"] = log_score(probs, true_modes, lengths, mask)
        row["true_mode_probability"] = true_mode_probability(probs, true_modes, lengths, mask)
        delays = switch_delays(probs, true_modes, e.times, lengths).delay_s
        row["switches"] = float(delays.size)
        row["switches_missed"] = float(np.isnan(delays).sum())
        row["switch_delay_s"] = mean_or_nan(delays[~np.isnan(delays)])
    return row


def _position_row(
    e: EstimatesLike, truth: ArrayLike, started: Bools, gate: float | None, last: int, level: float
) -> dict[str, float]:
    """Rows of `summary` that need true positions only."""
    scored = errors(e.position, truth, None, started)
    present = scored[~np.isnan(scored)]
    values = position_nees(e.position, e.covariance, truth, None, started)
    band = average_nees(values, e.position.shape[2], level)
    row = {
        "scored_steps": float(present.size),
        "position_rmse_m": float(root_mean_square(scored, None)),
        "position_median_m": float(np.median(present)) if present.size else float("nan"),
        "position_peak_m": _largest(peak_error(e.position, truth, None, started)),
        "position_rmse_peak_m": _largest(root_mean_square(scored, 0)),
        "position_nees": band.mean,
        "position_nees_low": band.low,
        "position_nees_high": band.high,
        "position_nees_inside": band.share_inside,
    }
    if gate is not None:
        row["lost_track_rate"] = lost_track_rate(e.position, truth, gate, last, None, started)
    return row


def _largest(values: Floats) -> float:
    present = values[~np.isnan(values)]
    return float(present.max()) if present.size else float("nan")
