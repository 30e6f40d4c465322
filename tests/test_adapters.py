"""FilterPy and Stone Soup as estimators of ours, and a bank of ours in Stone Soup: against the packages themselves."""

import builtins
import datetime
import importlib

import numpy as np
import pytest

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motions import constant_velocity
from jink.estimators.recipes import Scales, make_estimator
from jink.estimators.sensors import position, range_bearing
from jink.training.checking import check_estimator
from jink.training.loading import make_named

filterpy = pytest.importorskip("filterpy.kalman", reason="needs pip install 'jink[peers]'")
pytest.importorskip("stonesoup", reason="needs pip install 'jink[peers]'")
from jink.training.adapters import filterpy_filters as theirs  # noqa: E402
from jink.training.adapters import stonesoup_bank, stonesoup_filters  # noqa: E402
from jink.training.adapters.stonesoup_sensor import measurement_model, seconds, stamp  # noqa: E402

FILTERPY, SOUP = "jink.training.adapters.filterpy_filters:", "jink.training.adapters.stonesoup_filters:"
SCALES = {"acceleration": 2.0, "speed": 20.0, "turn_rate": 0.1, "sojourn": 10.0}
CLOSE = {"rtol": 1e-8, "atol": 1e-7}
RNG = np.random.default_rng(4)
TIMES = np.cumsum(RNG.choice([0.5, 1.0, 1.5], size=40))
TRUTH = np.stack([500.0 + 15.0 * TIMES, 300.0 + 40.0 * np.sin(TIMES / 6.0)], axis=1)
Z = TRUTH + RNG.normal(scale=5.0, size=TRUTH.shape)
RADAR = np.stack([np.hypot(*TRUTH.T), np.arctan2(TRUTH[:, 1], TRUTH[:, 0])], axis=1)
RADAR = RADAR + RNG.normal(size=RADAR.shape) * (5.0, 0.005)


def gaps(z):
    z = z.copy()
    z[8:11] = np.nan
    z[20, 1] = np.nan
    return z


@pytest.mark.parametrize("name", [FILTERPY + n for n in ("kf_cv", "imm_cv", "ukf_turn")] + [SOUP + "kalman"])
def test_adapters_keep_the_contract(name):
    assert check_estimator(name).ok, check_estimator(name).of("failed")


@pytest.mark.parametrize("name", [FILTERPY + "ukf_turn", SOUP + "unscented"])
def test_adapters_keep_the_contract_behind_a_radar(name):
    assert check_estimator(name, "range-bearing").ok, check_estimator(name, "range-bearing").of("failed")


# --- FilterPy


def test_filterpy_does_the_work():
    """The same numbers, to the last bit, as FilterPy driven by hand."""
    adapted = make_named(FILTERPY + "kf_cv", position(2, 5.0), **SCALES).run(Z, TIMES)
    hand = filterpy.KalmanFilter(4, 2)
    hand.H, hand.R = np.eye(4)[[0, 2]], 25.0 * np.eye(2)
    hand.x = np.array([[Z[0, 0]], [0.0], [Z[0, 1]], [0.0]])
    hand.P = np.diag([25.0, 400.0, 25.0, 400.0])
    for k in range(1, len(Z)):
        dt = TIMES[k] - TIMES[k - 1]
        hand.F = np.kron(np.eye(2), [[1.0, dt], [0.0, 1.0]])
        hand.Q = np.kron(np.eye(2), 4.0 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]))
        hand.predict()
        hand.update(Z[k])
        np.testing.assert_array_equal(adapted.position[0, k], hand.x[[0, 2], 0])
        assert adapted.nis[0, k] == float(hand.mahalanobis) ** 2
        assert adapted.log_likelihood[0, k] == hand.log_likelihood


@pytest.mark.parametrize(
    "name, recipe, sensor, z",
    [
        (FILTERPY + "kf_cv", "kf-cv", position(2, 5.0), Z),
        (FILTERPY + "ukf_turn", "ukf-ct", position(2, 5.0), Z),
        (FILTERPY + "ukf_turn", "ukf-ct", range_bearing((5.0, 0.005)), RADAR),
        (SOUP + "kalman", "kf-cv", position(2, 5.0), Z),
        (SOUP + "unscented", "kf-cv", range_bearing((5.0, 0.005)), RADAR),
    ],
)
def test_equal_to_our_recipe(name, recipe, sensor, z):
    """Two implementations of one filter, from the same start; gaps and half measurements too."""
    z = gaps(z)
    ours = make_estimator(recipe, sensor, **SCALES).run(z, TIMES)
    them = make_named(name, sensor, **SCALES).run(z, TIMES)
    # Ours integrates the noise of a turn along the turn, theirs along a straight line: second order in rate dt.
    close = {"rtol": 2e-2, "atol": 2.0} if recipe == "ukf-ct" else CLOSE
    if sensor.name != "position" and recipe == "kf-cv":
        close = {"rtol": 1e-4, "atol": 0.05}  # Stone Soup's mean of bearings is that of their unit vectors
    np.testing.assert_allclose(them.position, ours.position, **close)
    np.testing.assert_allclose(them.velocity, ours.velocity, **close)
    if recipe == "kf-cv":
        np.testing.assert_allclose(them.covariance, ours.covariance, **close)
        np.testing.assert_allclose(them.nis[0, 1:], ours.nis[0, 1:], **close)
        np.testing.assert_allclose(them.log_likelihood[0, 1:], ours.log_likelihood[0, 1:], **close)
        np.testing.assert_array_equal(them.nis_dof[0, 1:], ours.nis_dof[0, 1:])


def test_imm_equals_a_bank_of_ours():
    """Same modes, same matrix, mixing; without gaps, where FilterPy leaves the mode probabilities as they are."""
    sensor, stay = position(2, 5.0), np.exp(-0.1)
    modes = tuple(
        Mode(name, constant_velocity(2, acceleration_density=q)) for name, q in (("quiet", 0.01), ("loud", 4.0))
    )
    chain = MarkovChain.per_step([[stay, 1.0 - stay], [1.0 - stay, stay]])
    ours = BankEstimator(Bank(modes, sensor, chain=chain, interaction="mix", speed=20.0)).run(Z, TIMES)
    them = make_named(FILTERPY + "imm_cv", sensor, **SCALES).run(Z, TIMES)
    np.testing.assert_allclose(them.mode_probs[0, 1:], ours.mode_probs[0, 1:], **CLOSE)
    np.testing.assert_allclose(them.position, ours.position, **CLOSE)
    np.testing.assert_allclose(them.covariance, ours.covariance, **CLOSE)
    np.testing.assert_allclose(them.log_likelihood[0, 1:], ours.log_likelihood[0, 1:], **CLOSE)


@pytest.mark.parametrize("name", [FILTERPY + "kf_cv", SOUP + "kalman"])
def test_a_prior_is_used_as_by_ours(name):
    sensor, z = position(2, 5.0), gaps(Z)
    z[0] = np.nan
    prior = Prior(np.array([520.0, 310.0, 12.0, 3.0]), np.diag([25.0, 16.0, 9.0, 4.0]))
    ours = make_estimator("kf-cv", sensor, **SCALES).run(z, TIMES, prior=prior)
    them = make_named(name, sensor, **SCALES).run(z, TIMES, prior=prior)
    np.testing.assert_allclose(them.position[:, 1:], ours.position[:, 1:], **CLOSE)
    np.testing.assert_allclose(them.covariance[:, 1:], ours.covariance[:, 1:], **CLOSE)


def test_labels_must_fit():
    with pytest.raises(ValueError, match="labels must name the 4 components"):
        theirs.FilterPyFilter(filterpy.KalmanFilter(4, 2), position(2), "x y vx")
    with pytest.raises(ValueError, match="sensor must be linear"):
        theirs.FilterPyFilter(filterpy.KalmanFilter(4, 2), range_bearing(), "x vx y vy")
    with pytest.raises(ValueError, match="must have 2 axes"):
        theirs.ukf_turn(position(3), Scales())
    with pytest.raises(ValueError, match="labels must name x, y, vx, vy"):
        stonesoup_filters.StoneSoupFilter(None, None, position(2), "x y")


# --- Stone Soup


def test_the_clock_keeps_seconds():
    assert seconds(stamp(12.25)) == 12.25
    assert stamp(1.0) - stamp(0.0) == datetime.timedelta(seconds=1)


def test_a_sensor_is_a_measurement_model():
    from stonesoup.types.state import State

    model = measurement_model(range_bearing((5.0, 0.01)), 4, [0, 2, 1, 3])
    seen = model.function(State([[3.0], [9.0], [-4.0], [9.0]]), noise=False)
    np.testing.assert_allclose(np.asarray(seen, dtype=float)[:, 0], [5.0, np.arctan2(-4.0, 3.0)])
    np.testing.assert_array_equal(model.covar(), np.diag([25.0, 1e-4]))
    part = model.only([1], np.diag([1.0, 0.25]), np.array([3.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(np.asarray(part.function(State([[3.0], [0], [-4.0], [0]])), dtype=float), [[-np.pi / 2]])
    np.testing.assert_array_equal(part.covar(), [[0.25]])


@pytest.mark.parametrize("recipe", ["kf-cv", "imm", "intent-imm"])
def test_a_bank_in_stone_soup_is_the_bank(recipe):
    """Bit for bit, with predictions in between that nothing comes of, and its modes beside the Gaussian."""
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis

    times = np.round(TIMES * 2.0) / 2.0  # Stone Soup's clock has microseconds
    estimator = make_estimator(recipe, position(2, 5.0), **SCALES)
    wanted = estimator.run(Z, times)
    predictor, updater = stonesoup_bank.make_pair(estimator)
    state = stonesoup_bank.start_state(estimator, Z[0], times[0])
    for k in range(1, len(Z)):
        predictor.predict(state, timestamp=stamp(times[k] + 3.0))
        prediction = predictor.predict(state, timestamp=stamp(times[k]))
        state = updater.update(SingleHypothesis(prediction, Detection(Z[k][:, None], timestamp=stamp(times[k]))))
        np.testing.assert_array_equal(np.ravel(state.state_vector)[[0, 2]], wanted.position[0, k])
        np.testing.assert_array_equal(np.ravel(state.state_vector)[[1, 3]], wanted.velocity[0, k])
        np.testing.assert_array_equal(np.asarray(state.covar)[0, 2], wanted.covariance[0, k, 0, 1])
        np.testing.assert_array_equal(state.estimates.mode_probs, wanted.mode_probs[0, k])


def test_the_pair_of_one_mode_is_stone_soups_own():
    """Predictions, measurement predictions and updates of a Kalman filter, from a plain Gaussian state."""
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import KalmanUpdater

    sensor = position(2, 5.0)
    ours = stonesoup_bank.make_pair(make_estimator("kf-cv", sensor, **SCALES))
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(4.0)] * 2)
    own = (KalmanPredictor(motion), KalmanUpdater(measurement_model(sensor, 4, [0, 2, 1, 3])))
    start = GaussianState([[500.0], [0.0], [300.0], [0.0]], np.diag([25.0, 400.0, 25.0, 400.0]), timestamp=stamp(0.0))
    found = []
    for predictor, updater in (ours, own):
        state, rows = start, []
        for k in range(10):
            prediction = predictor.predict(state, timestamp=stamp(k + 1.0))
            seen = updater.predict_measurement(prediction)
            state = updater.update(SingleHypothesis(prediction, Detection(Z[k][:, None], timestamp=stamp(k + 1.0))))
            rows += [prediction.state_vector, prediction.covar, seen.state_vector, seen.covar]
            rows += [state.state_vector, state.covar]
        found.append([np.asarray(row, dtype=float) for row in rows])
    for left, right in zip(*found, strict=True):
        np.testing.assert_allclose(left, right, **CLOSE)


def test_a_tracker_of_stone_soup_runs_a_bank():
    """Nearest-neighbour association over its hypotheser, with a false alarm in each scan."""
    from stonesoup.dataassociator.neighbour import NearestNeighbour
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.measures import Mahalanobis
    from stonesoup.types.detection import Detection
    from stonesoup.types.track import Track

    estimator = make_estimator("imm", position(2, 5.0), **SCALES)
    predictor, updater = stonesoup_bank.make_pair(estimator)
    hypothesiser = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=5)
    associator = NearestNeighbour(hypothesiser)
    track = Track([stonesoup_bank.start_state(estimator, Z[0], TIMES[0])])
    for k in range(1, len(Z)):
        now = stamp(TIMES[k])
        true, false = (Detection(z[:, None], timestamp=now) for z in (Z[k], Z[k] + [400.0, -300.0]))
        hypothesis = associator.associate({track}, {true, false}, now)[track]
        track.append(updater.update(hypothesis) if hypothesis else hypothesis.prediction)
    path = np.array([[float(s.state_vector[0]), float(s.state_vector[2])] for s in track])
    assert np.sqrt(np.mean(np.sum((path - TRUTH) ** 2, axis=1))) < 7.0


def test_a_state_of_other_components_is_refused():
    from stonesoup.types.state import GaussianState

    predictor, _ = stonesoup_bank.make_pair(make_estimator("kf-cv", position(2, 5.0)))
    with pytest.raises(ValueError, match="prior must have components x, vx, y, vy; got 2"):
        predictor.predict(GaussianState([[0.0], [0.0]], np.eye(2), timestamp=stamp(0.0)), timestamp=stamp(1.0))


def test_a_missing_package_is_named_with_its_command(monkeypatch):
    real = importlib.import_module

    def without(name, *rest):
        if name.split(".")[0] in ("filterpy", "stonesoup"):
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
        return real(name, *rest)

    monkeypatch.setattr(importlib, "import_module", without)
    assert builtins.__import__  # the adapters themselves are imported without either package
    with pytest.raises(ValueError, match=r"filterpy must be installed.*pip install 'jink\[peers\]'"):
        theirs.kf_cv(position(2), Scales())
    with pytest.raises(ValueError, match=r"stonesoup must be installed.*pip install 'jink\[peers\]'"):
        stonesoup_filters.kalman(position(2), Scales())
