"""Distance between estimate and truth: every step, over tracks, over time, by phase, and h steps ahead."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from jink.estimators.metrics.steps import (
    Floats,
    as_tracks,
    check_shape,
    root_mean_square,
    scored_steps,
    step_mask,
)


def errors(
    estimate: ArrayLike, truth: ArrayLike, lengths: ArrayLike | None = None, mask: ArrayLike | None = None
) -> Floats:
    """Euclidean error of every scored step; use it for position or for velocity.

    Args:
        estimate: (B, T, A) or (T, A); m (or m/s).
        truth: same shape and unit; NaN = unknown.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to score.
    Returns:
        (B, T), unit of the input; NaN where not scored, inf where a scored estimate is not finite.
    Raises:
        ValueError: shapes differ.
    Source: definition.
    """
    known = as_tracks("errors", "truth", truth, 3)
    given = as_tracks("errors", "estimate", estimate, 3)
    check_shape("errors", "estimate", given, known.shape)
    scored, usable = scored_steps(given, known, lengths, mask)
    out = np.full(known.shape[:2], np.nan)
    out[scored] = np.inf
    out[usable] = np.hypot.reduce(given[usable] - known[usable], axis=1)
    return out


def rmse(
    estimate: ArrayLike, truth: ArrayLike, lengths: ArrayLike | None = None, mask: ArrayLike | None = None
) -> float:
    """Root mean square error over every scored step of every track.

    Model: sqrt(mean_{b,t} |estimate - truth|^2), the norm taken over all axes (not per axis).

    Args:
        estimate: (B, T, A) or (T, A); m or m/s.
        truth: same; NaN = unknown.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to score.
    Returns:
        unit of the input; NaN if nothing is scored.
    Raises:
        ValueError: shapes differ.
    Source: Bar-Shalom, Li, Kirubarajan (2001), 11.7. Differs: none. Long tracks weigh more;
    `rmse_per_track` gives the other average.
    """
    return float(root_mean_square(errors(estimate, truth, lengths, mask), None))


def rmse_per_time(
    estimate: ArrayLike, truth: ArrayLike, lengths: ArrayLike | None = None, mask: ArrayLike | None = None
) -> Floats:
    """Root mean square error over tracks at each time index; arguments as `rmse`.

    Returns:
        (T,), unit of the input; NaN where no track is scored. Its maximum is the peak of Monte-Carlo tables.
    Source: Bar-Shalom, Li, Kirubarajan (2001), section 11.7. Differs: none.
    """
    return root_mean_square(errors(estimate, truth, lengths, mask), 0)


def rmse_per_track(
    estimate: ArrayLike, truth: ArrayLike, lengths: ArrayLike | None = None, mask: ArrayLike | None = None
) -> Floats:
    """Root mean square error over time of each track; arguments as `rmse`.

    Returns:
        (B,), unit of the input; NaN where a track has nothing to score.
    Source: Wang (2023), Table VI, averages these over episodes. Differs: none.
    """
    return root_mean_square(errors(estimate, truth, lengths, mask), 1)


def peak_error(
    estimate: ArrayLike, truth: ArrayLike, lengths: ArrayLike | None = None, mask: ArrayLike | None = None
) -> Floats:
    """Largest error of each track; arguments as `rmse`.

    Returns:
        (B,), unit of the input; NaN where a track has nothing to score.
    Source: Bar-Shalom, Li, Kirubarajan (2001), 11.7. Differs: the peak of one run, not of the run average
    (`rmse_per_time(...).max()`).
    """
    values = errors(estimate, truth, lengths, mask)
    top = np.where(np.isnan(values), -np.inf, values).max(axis=1, initial=-np.inf)
    return np.where(np.isnan(values).all(axis=1), np.nan, top)


def phase_rmse(
    estimate: ArrayLike,
    truth: ArrayLike,
    phases: Mapping[str, ArrayLike],
    lengths: ArrayLike | None = None,
) -> dict[str, float]:
    """Root mean square error over named parts of the tracks.

    Args:
        estimate: (B, T, A) or (T, A); m or m/s.
        truth: same; NaN = unknown.
        phases: name -> (B, T) or (T,) booleans.
        lengths: (B,) valid rows per track.
    Returns:
        name -> error, unit of the input; NaN for a phase without scored steps.
    Raises:
        ValueError: shapes differ.
    Source: Bar-Shalom, Li, Kirubarajan (2001), 11.7 (errors by leg). Differs: none.
    """
    return {name: rmse(estimate, truth, lengths, mask) for name, mask in phases.items()}


def forecast_errors(
    forecasts: ArrayLike,
    truth: ArrayLike,
    steps: int,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> Floats:
    """Errors of h-step predictions, filed under the time at which each was made.

    Model: |forecasts[b, t] - truth[b, t + h]|; the last h steps of every track cannot be scored.

    Args:
        forecasts: (B, T, A) or (T, A); entry t was made at t for t + steps; m.
        truth: same shape; NaN = unknown; m.
        steps: h >= 0, in samples (not seconds).
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) times of *making* a forecast to score.
    Returns:
        (B, T) m; NaN where not scored, inf where the forecast is not finite.
    Raises:
        ValueError: shapes differ or steps is negative.
    Source: definition.
    """
    if steps < 0:
        raise ValueError(f"forecast_errors: steps must be >= 0; got {steps}. Give the look-ahead in samples.")
    known = as_tracks("forecast_errors", "truth", truth, 3)
    given = as_tracks("forecast_errors", "forecasts", forecasts, 3)
    check_shape("forecast_errors", "forecasts", given, known.shape)
    shape = known.shape[:2]
    target = np.where(step_mask(shape, lengths)[:, :, None], known, np.nan)
    ahead = np.full(known.shape, np.nan)
    ahead[:, : max(shape[1] - steps, 0)] = target[:, steps:]
    return errors(given, ahead, lengths, mask)


def forecast_rmse(
    forecasts: ArrayLike,
    truth: ArrayLike,
    steps: int,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
) -> float:
    """Root mean square of `forecast_errors` (same arguments); m, NaN if nothing is scored."""
    return float(root_mean_square(forecast_errors(forecasts, truth, steps, lengths, mask), None))
