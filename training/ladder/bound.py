"""What no estimator can beat: the error of one that is told everything but where the target started and is pushed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes
from jink.envs.plants import LinearPlant
from jink.envs.scenario import Scenario
from jink.estimators.bounds import riccati_bound
from jink.training.ladder.rungs import NoSuchRung

__all__ = ["bound_values"]

Floats = NDArray[np.float64]


def bound_values(scenario: Scenario, episodes: Episodes) -> dict[str, Floats]:
    """Root mean square position and velocity errors of each run, (B,), that no estimator falls below on average.

    Model: a target of constant velocity whose noise covariance is told at every sample. A `LinearPlant` is pushed by
    its own white noise: then this is the posterior Cramer-Rao bound given the noise. Of a target that changes its mind
    the bound is told every acceleration, so that only the start is unknown: valid, and loose.

    Raises:
        NoSuchRung: the sensor is not linear, or the plant's model is off by an unknown amount.
    """
    if scenario.sensor.name != "position":
        raise NoSuchRung("bounds are for measured positions")
    linear = isinstance(scenario.motion, LinearPlant)
    if linear and (scenario.motion.error is not None or scenario.motion.model != "constant-velocity"):  # type: ignore[attr-defined]
        raise NoSuchRung("the truth does not tell by how much the plant was off")
    density = scenario.motion.density if linear else 0.0  # type: ignore[attr-defined]
    A = scenario.axes
    observation = np.eye(A, 2 * A)
    found = np.empty((2, len(episodes.times)))
    for b, times in enumerate(episodes.times):
        dt = np.diff(times)[:, None, None]
        one, none = np.eye(A), np.zeros((A, A))
        F = np.block([[one, none], [none, one]]) + dt * np.block([[none, one], [none, none]])
        Q = density * (
            dt**3 / 3 * np.block([[one, none], [none, none]])
            + dt**2 / 2 * np.block([[none, one], [one, none]])
            + dt * np.block([[none, none], [none, one]])
        )
        seen = np.asarray(episodes.detected[b])
        covs = riccati_bound(F, Q, observation, episodes.noise[b], episodes.prior_cov, len(times), seen)
        variances = np.diagonal(covs, axis1=1, axis2=2)
        found[:, b] = np.sqrt(variances[:, :A].sum(axis=1).mean()), np.sqrt(variances[:, A:].sum(axis=1).mean())
    return {"position_rmse": found[0], "velocity_rmse": found[1]}
