"""A third party's estimator on a scenario of the benchmark."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from jink.envs.scenario import Scenario
from jink.training.ladder.typical import typical_scales
from jink.training.loading import make_named

__all__ = ["load_estimator"]


def load_estimator(spec: str, scenario: Scenario) -> Any:
    """The estimator of a file for a scenario: told its sensor and the typical scales of its targets, as ours are.

    Whether it looks ahead is examined where it runs (`jink.training.ladder.causality`).

    Args:
        spec: ``path/to/mine.py:make``.
        scenario: what it will follow.

    Returns:
        an object with ``run(z, times, noise, sensor_states, prior=...)`` and ``forecast_run``.

    Raises:
        ValueError: as `jink.training.loading.make_named`.
    """
    return make_named(spec, scenario.sensor, **asdict(typical_scales(scenario)))
