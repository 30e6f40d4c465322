"""A bank of Jink as a predictor and updater of Stone Soup: `make_pair`.

A bank predicts and updates in one step, for its modes predict differently; the state it travels in therefore keeps
what the bank knew before the prediction, and the update starts from there. What comes out equals `estimator.step`
bit for bit, and Stone Soup's trackers, associations and plots see Gaussian states of position and velocity.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from jink.estimators.api import BankEstimator
from jink.training.adapters.need import need
from jink.training.adapters.stonesoup_sensor import measurement_model, seconds, stamp

__all__ = ["Pair", "make_pair", "start_state"]


class Pair(NamedTuple):
    """What Stone Soup's trackers take: states are x, vx, y, vy[, z, vz]."""

    predictor: Any
    updater: Any


def make_pair(estimator: BankEstimator) -> Pair:
    """A predictor and an updater that run a bank.

    Args:
        estimator: from `jink.estimators.recipes.make_estimator`, or any `BankEstimator`.

    Returns:
        the pair; use it with states from `start_state`, or with Gaussian states of x, vx, y, vy[, z, vz], from which
        the bank starts as from a prior.

    Raises:
        ValueError: Stone Soup is not installed.
    """
    predictor, updater = _kinds()
    kin = _order(estimator)
    model = measurement_model(estimator.bank.sensor, len(kin), kin)
    points = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0}
    return Pair(predictor(transition_model=None, estimator=estimator), updater(model, **points, estimator=estimator))


def start_state(estimator: BankEstimator, measurement: Any, time: float) -> Any:
    """A state to begin a track with, from its first measurement; the arguments are those of `estimator.start`.

    Args:
        estimator: the bank.
        measurement: (D,), or (T, D) where one row does not locate the target.
        time: s; (T,) with several rows.

    Raises:
        ValueError: the rows do not locate the target.
    """
    known = estimator.start(measurement, time)
    _kinds()
    return _gaussian(estimator, known, "state")


def _order(estimator: BankEstimator) -> list[int]:
    """Where positions, then velocities, are among x, vx, y, vy, ...; (2A,)."""
    axes = estimator.bank.sensor.axes
    return [2 * a for a in range(axes)] + [2 * a + 1 for a in range(axes)]


def _gaussian(estimator: BankEstimator, known: Any, kind: str, **more: Any) -> Any:
    """Stone Soup's state of what the bank knows; it carries the bank's own state as ``known``."""
    index = np.argsort(_order(estimator))
    mean, cov = known.kin_mean[0][index], known.kin_cov[0][np.ix_(index, index)]
    return _states()[kind](mean[:, None], cov, timestamp=stamp(known.time[0]), known=known, **more)


@cache
def _states() -> dict[str, Any]:
    base, states = need("stonesoup.base", "peers"), need("stonesoup.types.state", "peers")
    predictions, updates = need("stonesoup.types.prediction", "peers"), need("stonesoup.types.update", "peers")

    # Stone Soup wants exactly these two bases, of which the second is the state's own kind.
    class BankState(states.GaussianState):  # type: ignore[name-defined]
        """What a bank knows."""

        known: Any = base.Property(default=None, doc="the bank's own state; of a prediction, the one before it")
        estimates: Any = base.Property(default=None, doc="Estimates of this step: mode_probs, nis, status")

    class BankPrediction(predictions.Prediction, BankState):  # type: ignore[name-defined]
        """What a bank expects."""

    class BankUpdate(updates.Update, BankState):  # type: ignore[name-defined]
        """What a bank knows after an update, with the hypothesis it was made from."""

    return {"state": BankState, "prediction": BankPrediction, "update": BankUpdate}


@cache
def _kinds() -> tuple[Any, Any]:
    base, predictors = need("stonesoup.base", "peers"), need("stonesoup.predictor.base", "peers")
    updaters = need("stonesoup.updater.kalman", "peers")

    class BankPredictor(predictors.Predictor):  # type: ignore[name-defined]
        """Predicts with a bank of Jink."""

        estimator: Any = base.Property(doc="the bank")

        def predict(self, prior: Any, timestamp: Any = None, **kwargs: Any) -> Any:
            known = _known(self.estimator, prior)
            time = known.time[0] if timestamp is None else seconds(timestamp)
            nothing = np.full(self.estimator.bank.sensor.size, np.nan)
            ahead, _ = self.estimator.step(known, nothing, time)
            expected = _gaussian(self.estimator, ahead, "prediction", prior=prior)
            expected.known = known
            return expected

    class BankUpdater(updaters.UnscentedKalmanUpdater):  # type: ignore[name-defined]
        """Updates with a bank of Jink; predicts measurements from its Gaussian with sigma points."""

        estimator: Any = base.Property(default=None, doc="the bank")

        def update(self, hypothesis: Any, **kwargs: Any) -> Any:
            known = _known(self.estimator, hypothesis.prediction)
            detection = hypothesis.measurement
            z = np.ravel(np.asarray(detection.state_vector, dtype=np.float64))
            model = detection.measurement_model
            R = None if model is None else np.asarray(model.noise_covar, dtype=np.float64)
            following, estimates = self.estimator.step(known, z, seconds(detection.timestamp), R)
            if hypothesis.measurement_prediction is None:
                hypothesis.measurement_prediction = self.predict_measurement(
                    hypothesis.prediction, self.measurement_model if model is None else model
                )
            return _gaussian(self.estimator, following, "update", hypothesis=hypothesis, estimates=estimates)

    return BankPredictor, BankUpdater


def _known(estimator: BankEstimator, state: Any) -> Any:
    """The bank's own state behind one of Stone Soup's; a plain Gaussian becomes a prior."""
    from jink.estimators.inputs import Prior

    known = getattr(state, "known", None)
    if known is not None:
        return known
    order = _order(estimator)
    mean = np.ravel(np.asarray(state.state_vector, dtype=np.float64))
    if mean.size != len(order):
        labels = ", ".join(f"{axis}, v{axis}" for axis in "xyz"[: len(order) // 2])
        raise ValueError(
            f"BankPredictor: prior must have components {labels}; got {mean.size}. Use start_state(estimator, z, time)."
        )
    cov = np.asarray(state.covar, dtype=np.float64)[np.ix_(order, order)]
    time = 0.0 if state.timestamp is None else seconds(state.timestamp)
    nothing = np.full(estimator.bank.sensor.size, np.nan)
    return estimator.start(nothing, time, prior=Prior(mean[order], cov, time=time, includes_first=True))
