"""A predictor and updater of Stone Soup as an estimator of Jink: `StoneSoupFilter`, and two made from our scales.

jink check jink.training.adapters.stonesoup_filters:kalman
jink track radar.csv --estimator jink.training.adapters.stonesoup_filters:unscented
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.estimators.recipes import Scales
from jink.estimators.sensor import Sensor
from jink.estimators.starting import start_prior
from jink.training.adapters.need import need
from jink.training.adapters.stonesoup_sensor import measurement_model, stamp

__all__ = ["StoneSoupFilter", "kalman", "unscented"]

Floats = NDArray[np.float64]


class StoneSoupFilter:
    """A predictor and an updater with Gaussian states, behind a sensor of ours.

    Args:
        predictor: with its transition model.
        updater: its measurement model must accept a covariance in ``noise_covar``; None in it: that of the sensor.
        sensor: what is measured.
        labels: of the state's components, for instance ``"x vx y vy"``.
        speed: standard deviation of the velocity at the start, along an axis; m/s.
        rest: standard deviation at the start of components that are neither position nor velocity.

    Raises:
        ValueError: labels without a position or velocity.
    """

    def __init__(
        self,
        predictor: Any,
        updater: Any,
        sensor: Sensor,
        labels: str | Sequence[str],
        speed: float = 10.0,
        rest: float = 1.0,
    ) -> None:
        self.predictor, self.updater, self.sensor, self.speed, self.rest = predictor, updater, sensor, speed, rest
        names = labels.split() if isinstance(labels, str) else list(labels)
        wanted = [f"{v}{axis}" for v in ("", "v") for axis in "xyz"[: sensor.axes]]
        if any(name not in names for name in wanted):
            raise ValueError(
                f"StoneSoupFilter: labels must name {', '.join(wanted)}; got {', '.join(names)}. "
                "Give them in the order of the state vector."
            )
        self.size, self.kin = len(names), [names.index(name) for name in wanted]
        if updater.measurement_model is None:
            updater.measurement_model = measurement_model(sensor, self.size, self.kin)

    def start(
        self, measurements: Floats, times: Floats, noise: Floats, sensor_states: Floats, prior: Any = None
    ) -> Any:
        """From a prior, or as `start_prior`: position from the measurements; None while they do not locate."""
        if prior is not None:
            state, said = self._begun(prior[0], prior[1], times[0]), None
            for row in zip(measurements, times, noise, sensor_states, strict=True):
                state, said = self.step(state, *row)
            return state, said
        found = start_prior(self.sensor, measurements, times, noise, sensor_states, self.speed, complete=False)
        if not found.ok:
            return None
        state = self._begun(np.concatenate([found.position, found.velocity]), found.covariance, times[-1])
        return state, self._said(state)

    def _begun(self, kin: Floats, kin_cov: Floats, time: float) -> Any:
        mean, cov = np.zeros(self.size), self.rest**2 * np.eye(self.size)
        mean[self.kin] = kin
        cov[np.ix_(self.kin, self.kin)] = kin_cov
        return need("stonesoup.types.state", "peers").GaussianState(mean[:, None], cov, timestamp=stamp(time))

    def step(self, state: Any, measurement: Floats, time: float, noise: Floats, sensor_state: Floats) -> Any:
        """Predict to the time, then update with the components that were measured."""
        prediction = self.predictor.predict(state, timestamp=stamp(time))
        seen = np.flatnonzero(np.isfinite(measurement))
        if not seen.size:
            return _plain(prediction), self._said(prediction)
        model = self.updater.measurement_model
        if hasattr(model, "only"):
            model = model.only(seen, noise, sensor_state)
        elif len(seen) == len(measurement):
            model = copy.copy(model)
            model.noise_covar = noise
        else:
            raise ValueError("StoneSoupFilter: measurement must be whole for a model of one's own; got gaps.")
        detection = need("stonesoup.types.detection", "peers").Detection(
            measurement[seen][:, None], timestamp=stamp(time), measurement_model=model
        )
        hypothesis = need("stonesoup.types.hypothesis", "peers").SingleHypothesis(prediction, detection)
        after = self.updater.update(hypothesis)
        predicted = hypothesis.measurement_prediction
        gap = np.ravel(np.asarray(detection.state_vector - predicted.state_vector, dtype=np.float64))
        S = np.asarray(predicted.covar, dtype=np.float64)
        nis = float(gap @ np.linalg.solve(S, gap))
        log_likelihood = -0.5 * (nis + np.linalg.slogdet(2.0 * np.pi * S)[1])
        said = {"nis": nis, "nis_dof": len(seen), "log_likelihood": log_likelihood}
        return _plain(after), self._said(after) | said

    def _said(self, state: Any) -> dict[str, Any]:
        mean = np.ravel(np.asarray(state.state_vector, dtype=np.float64))[self.kin]
        half = self.sensor.axes
        cov = np.asarray(state.covar, dtype=np.float64)[np.ix_(self.kin, self.kin)]
        return {"position": mean[:half], "velocity": mean[half:], "covariance": cov}


def kalman(sensor: Sensor, scales: Scales) -> StoneSoupFilter:
    """Stone Soup's Kalman predictor and updater, constant velocity: the recipe kf-cv.

    Raises:
        ValueError: a sensor that is not linear.
    """
    if not sensor.linear:
        raise ValueError(f"kalman: sensor must be linear; got {sensor.name}. Use unscented.")
    predictors, updaters = need("stonesoup.predictor.kalman", "peers"), need("stonesoup.updater.kalman", "peers")
    return _make(predictors.KalmanPredictor, updaters.KalmanUpdater, sensor, scales)


def unscented(sensor: Sensor, scales: Scales) -> StoneSoupFilter:
    """Stone Soup's unscented predictor and updater, constant velocity, any sensor."""
    predictors, updaters = need("stonesoup.predictor.kalman", "peers"), need("stonesoup.updater.kalman", "peers")
    points = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0}
    return _make(predictors.UnscentedKalmanPredictor, updaters.UnscentedKalmanUpdater, sensor, scales, **points)


def _make(predict: Any, update: Any, sensor: Sensor, scales: Scales, **points: float) -> StoneSoupFilter:
    models = need("stonesoup.models.transition.linear", "peers")
    axis = models.ConstantVelocity(scales.acceleration**2)
    motion = models.CombinedLinearGaussianTransitionModel([axis] * sensor.axes)
    labels = " ".join(f"{name} v{name}" for name in "xyz"[: sensor.axes])
    return StoneSoupFilter(predict(motion, **points), update(None, **points), sensor, labels, scales.speed)


def _plain(state: Any) -> Any:
    """The Gaussian alone: Stone Soup's own result holds on to all that came before it."""
    types = need("stonesoup.types.state", "peers")
    return types.GaussianState(state.state_vector, state.covar, timestamp=state.timestamp)
