"""A third party's estimator on a scenario of the benchmark."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from jink.envs.scenario import Scenario
from jink.estimators.inputs import Prior
from jink.training.ladder.typical import TRAINING_SEED, simulate_runs, typical_scales
from jink.training.loading import make_named
from jink.training.outside import OutsideEstimator

__all__ = ["load_estimator", "looks_ahead"]

_TRACKS, _ROWS = 2, 60
"""What is examined for looking ahead."""
_ROUNDING = 1e-9
"""Relative difference that another order of the same sums may make."""


def load_estimator(spec: str, scenario: Scenario) -> Any:
    """The estimator of a file for a scenario: told its sensor and the typical scales of its targets, as ours are.

    Args:
        spec: ``path/to/mine.py:make``.
        scenario: what it will follow.

    Returns:
        an object with ``run(z, times, noise, sensor_states, prior=...)`` and ``forecast_run``.

    Raises:
        ValueError: as `jink.training.loading.make_named`; or its estimates depend on later measurements.
    """
    estimator = make_named(spec, scenario.sensor, **asdict(typical_scales(scenario)))
    if text := looks_ahead(estimator, scenario):
        raise ValueError(
            f"{estimator.name}: estimates must come from measurements up to their own row; got {text}. "
            f"Leave out smoothing and statistics of the whole track; see jink check {spec}."
        )
    return estimator


def looks_ahead(estimator: Any, scenario: Scenario) -> str:
    """Where later measurements change a third party's earlier estimate; "" where they do not.

    One that takes a row at a time cannot look ahead, our own do not, and one whose second run differs from its first
    cannot be told apart from one that does: all these pass. Draws training episodes, which no table shows.
    """
    if not isinstance(estimator, OutsideEstimator) or (estimator.streams and not estimator.batches):
        return ""
    episodes = simulate_runs(scenario, _TRACKS, TRAINING_SEED)
    z, t = episodes.measurements[:, :_ROWS], episodes.times[:, :_ROWS]
    noise = np.broadcast_to(episodes.nominal_noise, (*t.shape, *episodes.nominal_noise.shape))
    places, prior = episodes.sensor_states[:, :_ROWS], Prior(episodes.prior_mean, episodes.prior_cov)
    cut = t.shape[1] // 2
    later = z.copy()
    later[:, cut:] = later[:, cut:] * 1.1 + 3.0 * np.sqrt(np.diagonal(episodes.nominal_noise))

    def places_of(measurements: Any) -> Any:
        return estimator.run(measurements, t, noise, places, prior=prior).position[:, :cut]

    first, again, changed = places_of(z), places_of(z), places_of(later)
    if not np.array_equal(first, again, equal_nan=True):
        return ""
    far = ~np.isclose(first, changed, rtol=_ROUNDING, atol=_ROUNDING, equal_nan=True)
    if not far.any():
        return ""
    b, row, axis = (int(i) for i in np.argwhere(far)[0])
    before, after = first[b, row, axis], changed[b, row, axis]
    return f"later measurements change a position of row {row}, from {before:.6g} m to {after:.6g} m"
