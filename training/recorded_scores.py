"""Numbers of one estimator on one recorded file, each with an interval over blocks of its tracks."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from jink.estimators.metrics import errors, position_nees
from jink.estimators.status import DIVERGED, STARTING
from jink.training.intervals import Floats, Measured, Score, measure, resample_blocks
from jink.training.running import raw_positions
from jink.training.track import TrackReport
from jink.training.weighted import largest, mean, median, ratio, root_mean, trimmed_mean

__all__ = ["score_report"]


def score_report(report: TrackReport, seed: int, *, raw: bool = False) -> dict[str, Measured]:
    """Metrics of one cell.

    Args:
        report: of an estimator.
        seed: of the resamples.
        raw: score the measurements on the same rows instead of the estimates.

    Returns:
        position errors where there is truth, prediction measures everywhere but for raw; empty if neither.
    """
    tracks = report.tracks
    scores = _error_scores(report, raw) | ({} if raw else _prediction_scores(report))
    if not scores:
        return {}
    found = measure(scores, resample_blocks(tracks.times, tracks.lengths, seed))
    if not raw:
        time = 1e6 * report.seconds / max(report.scores["steps"], 1.0)
        found["microseconds_per_step"] = Measured(time, "us", interval="timed once")
    return found


def _error_scores(report: TrackReport, raw: bool) -> dict[str, Score]:
    """Position errors of the rows that are scored; none without truth or where no row locates the target."""
    tracks, e = report.tracks, report.estimates
    if tracks.truth is None:
        return {}
    place = raw_positions(tracks) if raw else np.asarray(e.position)
    if place is None:
        return {}
    known, located = np.isfinite(e.position).all(axis=2), np.isfinite(place).all(axis=2)
    # As `summary` and `score_raw` do: an estimate may be missing while it starts, a measurement always.
    scored = tracks.used & (known & located if raw else known | (np.asarray(e.status) != STARTING))
    error = errors(place, tracks.truth, None, scored)[tracks.used]
    if np.isnan(error).all():
        return {}
    scores = {
        "position_rmse": Score(root_mean(error**2), "m"),
        "position_median": Score(median(error), "m"),
        "position_peak": Score(largest(error), "m", "the largest error of one recording: no resample exceeds it"),
    }
    if not raw:
        nees = position_nees(e.position, e.covariance, tracks.truth, None, scored)[tracks.used]
        scores["position_nees"] = Score(mean(nees), "")
    return scores


def _prediction_scores(report: TrackReport) -> dict[str, Score]:
    """One-step predictions against the measurements that follow; needs no truth."""
    used, e = report.tracks.used, report.estimates
    dof = np.asarray(e.nis_dof)[used].astype(np.float64)
    nis = np.where(dof > 0, np.asarray(e.nis)[used], 0.0)
    log_likelihood: Floats = np.where(dof > 0, np.asarray(e.log_likelihood)[used], np.nan)
    low, high = (chi2.ppf(tail, np.maximum(dof, 1.0)) for tail in (0.025, 0.975))
    inside = np.where(dof > 0, (nis >= low) & (nis <= high), np.nan)
    diverged = (np.asarray(e.status)[used] == DIVERGED).astype(np.float64)
    return {
        "log_likelihood_trimmed": Score(trimmed_mean(log_likelihood), "nat"),
        "log_likelihood_per_step": Score(mean(log_likelihood), "nat"),
        "nis_per_component": Score(ratio(nis, dof), ""),
        "nis_inside": Score(mean(inside), ""),
        "diverged_share": Score(mean(diverged), ""),
    }
