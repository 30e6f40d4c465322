"""Stone Soup: its Kalman and unscented predictors and updaters, with the IMM cycle written around them.

Stone Soup has no IMM estimator, so mixing, mode probabilities and combination are ours, in NumPy.
"""

from __future__ import annotations

import datetime
import math
from typing import Any

import numpy as np
from _numpy import combine, mix
from _problem import Case, Problem, array_trig, constant_velocity_matrix, move, to_result
from stonesoup.base import Property
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.base import TransitionModel
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor, UnscentedKalmanPredictor
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import KalmanUpdater, UnscentedKalmanUpdater

_START = datetime.datetime(2020, 1, 1)
_POINTS: dict[str, Any] = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0}


class _Motion(TransitionModel):
    """One mode as a Stone Soup transition model; Q is set before each step."""

    mode: str = Property(doc="cv, ca or ct")
    noise: np.ndarray = Property(default=None, doc="Q of the coming step")

    @property
    def ndim_state(self) -> int:
        return 7

    def function(self, state: Any, noise: Any = None, **kwargs: Any) -> StateVectors:
        dt = kwargs["time_interval"].total_seconds()
        return np.stack(move(self.mode, np.asarray(state.state_vector), dt, array_trig)).view(StateVectors)

    def covar(self, **kwargs: Any) -> np.ndarray:
        return self.noise

    def rvs(self, num_samples: int = 1, **kwargs: Any) -> Any:
        raise NotImplementedError("_Motion.rvs: this model only predicts; draw noise elsewhere.")

    def pdf(self, state1: Any, state2: Any, **kwargs: Any) -> Any:
        raise NotImplementedError("_Motion.pdf: this model only predicts; evaluate densities elsewhere.")


def _log_likelihood(hypothesis: SingleHypothesis) -> float:
    """Two-dimensional Gaussian log-density of the innovation, written out: cheaper than SciPy's."""
    seen = hypothesis.measurement_prediction
    (a, b), (_, d) = np.asarray(seen.covar).tolist()
    dx, dy = (np.asarray(hypothesis.measurement.state_vector) - np.asarray(seen.state_vector))[:, 0].tolist()
    det = a * d - b * b
    return -0.5 * ((d * dx * dx - 2 * b * dx * dy + a * dy * dy) / det + math.log(det)) - math.log(2 * math.pi)


def make(problem: Problem, stepwise: bool = False) -> Case:
    """Prepare models, times and detections; `run` is the loop over tracks and steps."""
    n = problem.prior_mean.shape[1]
    noises = problem.process_noises()
    stamps = [_START + datetime.timedelta(seconds=float(t)) for t in problem.times]
    sensor = LinearGaussian(ndim_state=n, mapping=list(problem.position_index), noise_covar=problem.noise)
    detections = [
        [Detection(z[:, None], timestamp=t) for z, t in zip(track[1:], stamps[1:], strict=True)]
        for track in problem.measurements
    ]
    if problem.workload == "kf":
        updater: Any = KalmanUpdater(sensor)
        predictors: list[Any] = [
            KalmanPredictor(
                LinearGaussianTimeInvariantTransitionModel(
                    transition_matrix=constant_velocity_matrix(dt), covariance_matrix=q[0]
                )
            )
            for dt, q in zip(np.diff(problem.times), noises, strict=True)
        ]
    else:
        updater = UnscentedKalmanUpdater(sensor, **_POINTS)
        predictors = [UnscentedKalmanPredictor(_Motion(mode), **_POINTS) for mode in problem.modes]

    def one_filter(b: int) -> tuple[Any, Any, Any]:
        state: Any = GaussianState(problem.prior_mean[b][:, None], problem.prior_cov, timestamp=stamps[0])
        for k, detection in enumerate(detections[b]):
            predictor = predictors[k if problem.workload == "kf" else 0]
            if problem.workload == "ukf":
                predictor.transition_model.noise = noises[k, 0]
            prediction = predictor.predict(state, timestamp=detection.timestamp)
            state = updater.update(SingleHypothesis(prediction, detection))
        return np.asarray(state.state_vector)[:, 0], np.asarray(state.covar), np.ones(1)

    def one_bank(b: int) -> tuple[Any, Any, Any]:
        m = len(problem.modes)
        means = np.repeat(problem.prior_mean[None, b, None], m, axis=1)
        covs, mode_probs = np.repeat(problem.prior_cov[None, None], m, axis=1), problem.mode_probs[None]
        mean, cov = means[:, 0], covs[:, 0]
        for k, detection in enumerate(detections[b]):
            mixed, mixed_covs, predicted = mix(means, covs, mode_probs, problem.mode_transition)
            score = np.log(predicted)
            means, covs = np.empty_like(means), np.empty_like(covs)
            for j, predictor in enumerate(predictors):
                predictor.transition_model.noise = noises[k, j]
                start = GaussianState(mixed[0, j][:, None], mixed_covs[0, j], timestamp=stamps[k])
                hypothesis = SingleHypothesis(predictor.predict(start, timestamp=detection.timestamp), detection)
                after = updater.update(hypothesis)
                means[0, j], covs[0, j] = np.asarray(after.state_vector)[:, 0], after.covar
                score[0, j] += _log_likelihood(hypothesis)
            mode_probs = np.exp(score - score.max())
            mode_probs = mode_probs / mode_probs.sum()
            mean, cov = combine(means, covs, mode_probs)
        return mean[0], cov[0], mode_probs[0]

    one = one_bank if problem.workload == "bank" else one_filter

    def finish(done: list[tuple[Any, Any, Any]]) -> Any:
        mean, cov, mode_probs = (np.array(part) for part in zip(*done, strict=True))
        return to_result(problem, mean, cov, mode_probs)

    return Case(run=lambda: [one(b) for b in range(problem.tracks)], finish=finish)
