"""What an estimator that judges the noise found out about it: for the summary of `jink track` and its output file."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.adaptive_estimator import AdaptiveEstimator
from jink.estimators.agent_estimator import AgentEstimator
from jink.estimators.status import STATUS_NAMES
from jink.estimators.tracks import Tracks

__all__ = ["NoiseReading", "judges_noise", "read_noise"]

Floats = NDArray[np.float64]
_SATURATED = 0.5


class NoiseReading(NamedTuple):
    """Columns (B, T) for the output file, mean probability of each intent, and sentences."""

    columns: dict[str, Floats]
    intents: dict[str, float]
    sentences: tuple[str, ...]


def judges_noise(estimator: Any) -> bool:
    """Whether the estimator takes a large innovation for noise as well as for a manoeuvre."""
    bank = getattr(estimator, "bank", None)  # a third party's has none
    return bank is not None and bool(bank.learns_noise or any(mode.treatments for mode in bank.modes))


def read_noise(estimator: Any, tracks: Tracks, estimates: Any, *, use_noise: bool = True) -> NoiseReading | None:
    """Surges of a bank of noise levels, or the noise learnt.

    Args:
        estimator: from `make_estimator`.
        tracks: what it was run on.
        estimates: what came out.
        use_noise: as for `run_tracks`.

    Returns:
        the reading; None for an estimator that has neither levels nor a learnt noise.
    """
    known = tracks.used & (np.asarray(estimates.status) != STATUS_NAMES.index("starting"))
    if not known.any() or not hasattr(estimator, "bank"):
        return None
    if isinstance(estimator, AgentEstimator):
        return _chosen(estimator, tracks, known, use_noise)
    if isinstance(estimator, AdaptiveEstimator):
        return _learnt(estimator, tracks, known, use_noise)
    levels = np.array([mode.noise_scale for mode in estimator.bank.modes])
    if not np.ptp(levels) > 0.0:
        return None
    surge, scale = estimator.surge_probability(estimates), estimator.noise_scale(estimates)
    shares = estimator.intent_probs(estimates)[known].mean(axis=0)
    top = np.asarray(estimates.mode_probs)[known] @ (levels == levels.max())
    sentences = [
        f"noise: surging {100 * surge[known].mean():.0f} % of the time; R times {np.median(scale[known]):.3g} in the "
        f"median row, {scale[known].max():.3g} at most"
    ]
    saturated = int((top > _SATURATED).sum())
    if saturated:
        sentences.append(
            f"{saturated} rows are at the highest noise level, {levels.max():g} R: the noise may be larger still"
        )
    return NoiseReading(
        {"surge_probability": surge, "noise_scale": scale},
        dict(zip(estimator.intents, shares.tolist(), strict=True)),
        tuple(sentences),
    )


def _chosen(estimator: AgentEstimator, tracks: Tracks, known: NDArray[np.bool_], use_noise: bool) -> NoiseReading:
    noise = tracks.noise if use_noise else None
    scale, surge = estimator.noise_run(tracks.measurements, tracks.times, noise, tracks.sensor_states, tracks.lengths)
    columns = {"noise_scale": scale}
    if np.isfinite(surge).all():
        columns["surge_probability"] = surge
    said = (
        f"noise: the agent multiplied R by {np.median(scale[known]):.3g} in the median row, "
        f"{scale[known].max():.3g} at most"
    )
    return NoiseReading(columns, {}, (said,))


def _learnt(estimator: AdaptiveEstimator, tracks: Tracks, known: NDArray[np.bool_], use_noise: bool) -> NoiseReading:
    noise = tracks.noise if use_noise else None
    R, _ = estimator.noise_run(tracks.measurements, tracks.times, noise, tracks.sensor_states, tracks.lengths)
    given = estimator.bank.sensor.noise if noise is None else noise
    learnt, told = np.diagonal(R, axis1=-2, axis2=-1), np.diagonal(given, axis1=-2, axis2=-1)
    sigmas = np.sqrt(np.nanmedian(learnt[known], axis=0))
    sensor = estimator.bank.sensor
    listed = ", ".join(
        f"{label} {sigma:.3g} {unit}" for label, sigma, unit in zip(sensor.labels, sigmas, sensor.units, strict=True)
    )
    return NoiseReading(
        {"noise_scale": (learnt / told).mean(axis=-1)},
        {},
        (f"noise learnt, standard deviation in the median row: {listed}",),
    )
