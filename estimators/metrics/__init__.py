"""Measures of a tracker against the truth: errors, consistency, modes, switches, losses, sets of targets.

Arrays are `(B, T, A)` (tracks, time, axes); a `(T, A)` array is read as one track. A step is *scored* when
its truth is finite on every axis, it lies before `lengths[b]` and `mask` (if given) is true there. Truth
that is NaN is therefore ignored; an *estimate* that is not finite where truth is known counts as an infinite
error, so a filter cannot gain by failing. A measure with nothing to score is NaN, never zero.
"""

from jink.estimators.metrics.consistency import Consistency, average_nees, chi_square_band, nis_consistency
from jink.estimators.metrics.disagreement import disagreement
from jink.estimators.metrics.identities import Identities, identities
from jink.estimators.metrics.innovations import Whiteness, normalise_innovations, whiteness
from jink.estimators.metrics.modes import (
    brier_score,
    encode_modes,
    log_score,
    mode_accuracy,
    true_mode_probability,
)
from jink.estimators.metrics.normalised import nees, position_nees, squared_distance
from jink.estimators.metrics.paths import lost_track_rate, lost_tracks, smoothness
from jink.estimators.metrics.steps import step_mask
from jink.estimators.metrics.summaries import EstimatesLike, summary
from jink.estimators.metrics.switches import Switches, switch_delays
from jink.estimators.metrics.target_sets import Gospa, gospa, ospa
from jink.estimators.metrics.tracking_errors import (
    errors,
    forecast_errors,
    forecast_rmse,
    peak_error,
    phase_rmse,
    rmse,
    rmse_per_time,
    rmse_per_track,
)

__all__ = [
    "Consistency",
    "EstimatesLike",
    "Gospa",
    "Identities",
    "Switches",
    "Whiteness",
    "average_nees",
    "brier_score",
    "chi_square_band",
    "disagreement",
    "encode_modes",
    "errors",
    "forecast_errors",
    "forecast_rmse",
    "gospa",
    "identities",
    "log_score",
    "lost_track_rate",
    "lost_tracks",
    "mode_accuracy",
    "nees",
    "nis_consistency",
    "normalise_innovations",
    "ospa",
    "peak_error",
    "phase_rmse",
    "position_nees",
    "rmse",
    "rmse_per_time",
    "rmse_per_track",
    "smoothness",
    "squared_distance",
    "step_mask",
    "summary",
    "switch_delays",
    "true_mode_probability",
    "whiteness",
]
