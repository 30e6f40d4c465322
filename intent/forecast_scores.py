"""How good forecasts are: from every few rows of tracks to the rows that follow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.api import BankEstimator
from jink.estimators.extrapolation import rows_of
from jink.estimators.status import DIVERGED, STARTING
from jink.estimators.tracks import Tracks
from jink.intent.forecasting import PositionForecast, forecast

__all__ = ["ForecastScores", "score_forecasts"]

Floats = NDArray[np.float64]
_PORTION = 200


class ForecastScores(NamedTuple):
    """How good forecasts were: nll and rmse per horizon (H,), the other three over all forecasts.

    ``horizon`` is the mean time ahead, s; nll in nats; distances in m; ``forecasts`` counts the states scored.
    """

    horizon: Floats
    nll: Floats
    rmse: Floats
    min_ade: float
    min_fde: float
    forecasts: int


def score_forecasts(
    estimator: BankEstimator,
    tracks: Tracks,
    steps: int = 20,
    *,
    every: int = 5,
    count: int = 6,
    collapse: bool = False,
    warm_up: int = 10,
    use_noise: bool = True,
    seed: int = 0,
) -> ForecastScores:
    """Forecast from every few rows of tracks to the rows that follow, and compare.

    Args:
        estimator: of any recipe.
        tracks: with truth, or measured as positions (then the measurements, with their noise, are the truth).
        steps: rows ahead, H.
        every: from every so many rows.
        count: trajectories of min_ade and min_fde.
        collapse: score the single Gaussian instead.
        warm_up: rows left out at the beginning of each track.
        use_noise: the tracks' own covariances; False: the sensor's.
        seed: of the trajectories.

    Returns:
        the scores.

    Raises:
        ValueError: no truth to compare with, or tracks too short.
    """
    if tracks.truth is None and tracks.sensor != "position":
        raise ValueError(
            f"score_forecasts: tracks must have truth or positions; got {tracks.sensor} alone. Add true_x, true_y."
        )
    nll, error, ade, fde, ahead = [], [], [], [], []
    for found, truth, noise in _rolling(estimator, tracks, steps, every, warm_up, use_noise, (count, seed)):
        chosen = found.collapsed(seed) if collapse else found
        nll.append(chosen.nll(truth, noise))
        error.append(np.linalg.norm(chosen.mean - truth, axis=-1))
        ade.append(chosen.min_ade(truth, count))
        fde.append(chosen.min_fde(truth, count))
        ahead.append(chosen.horizons)
    if not nll:
        raise ValueError(
            f"score_forecasts: tracks must be longer than warm_up + steps = {warm_up + steps} rows; got "
            f"{int(tracks.lengths.max(initial=0))}. Shorten one of them."
        )
    square = np.square(np.concatenate(error))
    return ForecastScores(
        np.concatenate(ahead).mean(axis=0),
        np.nanmean(np.concatenate(nll), axis=0),
        np.sqrt(np.nanmean(square, axis=0)),
        float(np.nanmean(np.concatenate(ade))),
        float(np.nanmean(np.concatenate(fde))),
        len(square),
    )


def _rolling(
    estimator: BankEstimator,
    tracks: Tracks,
    steps: int,
    every: int,
    warm_up: int,
    use_noise: bool,
    paths: tuple[int, int],
) -> Iterator[tuple[PositionForecast, Floats, Floats | None]]:
    """Forecasts of one track after another, in portions, with where the target was and how well that is known."""
    for track in tracks:
        T = len(track.times)
        rows = np.arange(warm_up, T - steps, every)
        noise = track.noise if use_noise else None
        if not rows.size:
            continue
        states, estimates = estimator.states(track.measurements, track.times, noise, sensor_states=track.sensor_states)
        status = estimates.status[0, rows]
        rows = rows[(status != STARTING) & (status != DIVERGED)]
        for low in range(0, len(rows), _PORTION):
            part = rows[low : low + _PORTION]
            following = part[:, None] + np.arange(1, steps + 1)
            ahead = track.times[following] - track.times[part, None]
            found = forecast(estimator, rows_of(states, part), ahead, paths=paths[0], seed=paths[1])
            if track.truth is not None:
                yield found, track.truth[following], None
            else:
                R = estimator.bank.sensor.noise if noise is None else noise[following]
                yield found, track.measurements[following], np.asarray(R)
