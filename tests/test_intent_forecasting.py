"""Forecasts as mixtures: closed forms of linear modes, switching, scores, trajectories."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motions import constant_velocity, known_turn, polar_turn
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks
from jink.intent.forecast_scores import score_forecasts
from jink.intent.forecasting import PositionForecast, forecast

SENSOR = position(2, 2.0)
HORIZONS = np.array([0.5, 1.0, 2.5])


def flow(dt):
    return np.kron(np.eye(2), [[1.0, dt], [0.0, 1.0]])


def noise(q, dt):
    return q * np.kron(np.eye(2), [[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


def bank(densities, matrix=None, rates=None, interaction="mix", start=None):
    modes = tuple(Mode(f"q{k}", constant_velocity(2, acceleration_density=q)) for k, q in enumerate(densities))
    chain = None
    if matrix is not None:
        chain = MarkovChain.per_step(matrix)
    if rates is not None:
        chain = MarkovChain(generator=rates)
    return BankEstimator(Bank(modes, SENSOR, chain=chain, interaction=interaction, initial_probs=start))


def measured(rows=12, seed=0):
    times = np.arange(float(rows))
    return np.stack([10.0 * times, -3.0 * times], axis=1) + np.random.default_rng(seed).normal(0, 2, (rows, 2)), times


@pytest.fixture(scope="module")
def single():
    estimator = bank([0.5])
    return estimator, estimator.start(*measured())


def test_one_linear_mode_is_kalman_prediction(single):
    estimator, state = single
    found = forecast(estimator, state, HORIZONS)
    truth = np.array([[[125.0, -34.0], [118.0, -36.0], [np.nan, 0.0]]])
    assert found.weights.shape == (1, 3, 1) and found.labels == ("q0",)
    nll = found.nll(truth)
    for h, dt in enumerate(HORIZONS):
        F = flow(dt)
        mean = F @ state.mean[0, 0, :4]
        cov = F @ state.cov[0, 0, :4, :4] @ F.T + noise(0.5, dt)
        # The horizons are steps of one prediction, so rounding only.
        np.testing.assert_allclose(found.means[0, h, 0], mean[[0, 2]], rtol=1e-12)
        np.testing.assert_allclose(found.covariances[0, h, 0], cov[np.ix_([0, 2], [0, 2])], rtol=1e-10)
        if h < 2:
            expected = -multivariate_normal(mean[[0, 2]], cov[np.ix_([0, 2], [0, 2])]).logpdf(truth[0, h])
            assert nll[0, h] == pytest.approx(expected, rel=1e-10)
    assert np.isnan(nll[0, 2])


def test_without_switches_the_modes_stay_apart():
    estimator = bank([0.1, 8.0], rates=((0.0, 0.0), (0.0, 0.0)), start=(0.3, 0.7))
    state = estimator.start(*measured())
    found = forecast(estimator, state, HORIZONS)
    np.testing.assert_allclose(
        found.weights[0], np.tile([state.mode_probs[0, 0], 0, 0, state.mode_probs[0, 1]], (3, 1))
    )
    truth = np.array([118.0, -30.0])
    density = 0.0
    for mode, q in enumerate((0.1, 8.0)):
        F = flow(2.5)
        mean = (F @ state.mean[0, mode, :4])[[0, 2]]
        cov = (F @ state.cov[0, mode, :4, :4] @ F.T + noise(q, 2.5))[np.ix_([0, 2], [0, 2])]
        density += state.mode_probs[0, mode] * multivariate_normal(mean, cov + np.diag([4.0, 1.0])).pdf(truth)
    nll = found.nll(np.tile(truth, (1, 3, 1)), noise=np.diag([4.0, 1.0]))
    assert nll[0, 2] == pytest.approx(-np.log(density), rel=1e-9)


def test_switching_is_that_of_the_chain():
    """Two modes that differ in noise only: every road has the same mean and a covariance one can write down."""
    chain, q = np.array([[0.9, 0.1], [0.4, 0.6]]), (0.1, 5.0)
    estimator = bank(q, matrix=chain)
    state = estimator.start(*measured())
    found = forecast(estimator, state, [1.0, 2.0])
    np.testing.assert_allclose(found.weights[0, 0].reshape(2, 2), state.mode_probs[0][:, None] * chain, rtol=1e-12)
    twice = state.mode_probs[0][:, None] * (chain @ chain)
    np.testing.assert_allclose(found.weights[0, 1].reshape(2, 2), twice, rtol=1e-12)
    np.testing.assert_allclose(found.mode_probs[0, 1], twice.sum(axis=0), rtol=1e-12)
    F, pick = flow(1.0), np.ix_([0, 2], [0, 2])
    for i in range(2):
        for j in range(2):
            road = chain[i] * chain[:, j] / (chain @ chain)[i, j]  # of the mode between
            between = sum(road[m] * noise(q[m], 1.0) for m in range(2))
            cov = F @ (F @ state.cov[0, i, :4, :4] @ F.T + between) @ F.T + noise(q[j], 1.0)
            np.testing.assert_allclose(found.covariances[0, 1, 2 * i + j], cov[pick], rtol=1e-10)
            np.testing.assert_allclose(found.means[0, 1, 2 * i + j], (F @ F @ state.mean[0, i, :4])[[0, 2]], rtol=1e-12)
    assert found.labels == ("q0", "q0 > q1", "q1 > q0", "q1")


def test_all_roads_together_are_the_bank_without_measurements():
    """Moment matching loses nothing of mean and covariance where motions are linear."""
    estimator = bank([0.1, 5.0, 1.0], rates=((-0.2, 0.1, 0.1), (0.5, -0.6, 0.1), (0.0, 0.3, -0.3)))
    state = estimator.start(*measured())
    found = forecast(estimator, state, [1.0, 2.0, 3.0])
    for h in range(3):
        state, expected = estimator.step(state, [np.nan, np.nan], 12.0 + h)
        np.testing.assert_allclose(found.mean[0, h], expected.position, rtol=1e-11)
        np.testing.assert_allclose(found.covariance[0, h], expected.covariance[:2, :2], rtol=1e-9)
        np.testing.assert_allclose(found.mode_probs[0, h], expected.mode_probs, rtol=1e-11)


@pytest.mark.parametrize("name", ["imm", "intent-imm", "ukf-ct"])
def test_states_of_a_run_are_those_of_its_steps(name):
    estimator = make_estimator(name, SENSOR, acceleration=1.0, speed=10.0)
    z, times = measured(20)
    states, estimates = estimator.states(np.stack([z, z + 3.0]), times)
    assert estimates.position.shape == (2, 20, 2) and len(states.time) == 40
    found = forecast(estimator, states, [1.0, 4.0])
    alone = forecast(estimator, estimator.start(z + 3.0, times), [1.0, 4.0])
    np.testing.assert_allclose(found.means[39], alone.means[0], rtol=1e-12)
    np.testing.assert_allclose(found.weights[39], alone.weights[0], rtol=1e-12)
    each = forecast(estimator, states, np.linspace(0.5, 2.0, 40)[:, None])  # its own horizon for every state
    alone = forecast(estimator, estimator.start(z + 3.0, times), [2.0])
    np.testing.assert_allclose(each.means[39], alone.means[0], rtol=1e-12)
    np.testing.assert_allclose(found.weights.sum(axis=2), 1.0, rtol=1e-12)


def test_states_without_cartesian_components():
    estimator = BankEstimator(Bank((Mode("turn", polar_turn()),), SENSOR))
    state = estimator.start(*measured())
    found = forecast(estimator, state, [1.5])
    mean, cov = estimator.forecast(state, 1.5)
    np.testing.assert_allclose(found.means[0, 0, 0], mean, rtol=1e-10)
    np.testing.assert_allclose(found.covariances[0, 0, 0], cov, rtol=1e-9)


# A mixture by hand: three ways to go, far from each other.


@pytest.fixture(scope="module")
def ways():
    horizons = np.array([[1.0, 2.0]])
    weights = np.array([[[0.5, 0.1, 0.0, 0.4], [0.3, 0.3, 0.1, 0.3]]])
    means = np.array([[[[0, 0], [10, 0], [50, 50], [0, 90]], [[0, 0], [20, 0], [60, 60], [0, 99]]]], dtype=float)
    covs = np.broadcast_to([[1.0, 0.5], [0.5, 2.0]], (1, 2, 4, 2, 2)).copy()
    now, then = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
    return PositionForecast(horizons, weights, means, covs, now, then, ("a", "b"), np.zeros((1, 3, 2, 2)))


def test_density_is_a_density(ways):
    x, y = np.linspace(-12, 80, 461), np.linspace(-12, 112, 621)
    image = ways.density(0, 1, x, y)
    assert image.shape == (621, 461)
    assert image.sum() * 0.2 * 0.2 == pytest.approx(1.0, abs=1e-6)  # the grid is fine against a width of 1
    row, column = 100, 120
    there = np.array([[[np.nan, np.nan], [x[column], y[row]]]])
    assert image[row, column] == pytest.approx(np.exp(-ways.nll(there)[0, 1]), rel=1e-9)


def test_paths_that_no_memory_holds_are_refused(single):
    estimator, state = single
    for paths in (10**9, 2**24, 2.5, True, -1):
        with pytest.raises(ValueError, match="forecast: paths must be"):
            forecast(estimator, state, [1.0, 2.0], paths=paths)


def test_paths_are_spread_as_the_mixture_at_every_horizon():
    estimator = bank([0.1, 20.0], rates=((-0.3, 0.3), (0.6, -0.6)))
    state = estimator.start(*measured())
    found = forecast(estimator, state, [1.0, 2.0, 3.0], paths=4096, seed=1)
    apart = found.paths[0] - found.mean[0]
    scale = np.sqrt(np.diagonal(found.covariance[0], axis1=1, axis2=2))
    # Sobol points of 4096: some times closer than the 1/64 of independent ones.
    np.testing.assert_allclose(apart.mean(axis=0) / scale, 0.0, atol=0.01)
    for h in range(3):
        np.testing.assert_allclose(np.cov(apart[:, h].T), found.covariance[0, h], atol=0.02 * scale[h, 0] ** 2)
    np.testing.assert_array_equal(found.paths, forecast(estimator, state, [1.0, 2.0, 3.0], paths=4096, seed=1).paths)
    assert not np.array_equal(found.paths, forecast(estimator, state, [1.0, 2.0, 3.0], paths=4096, seed=2).paths)
    assert forecast(estimator, state, [1.0], paths=0).paths.shape == (1, 0, 1, 2)


def test_a_path_is_that_of_its_modes():
    """Turns that never end: every path is a circle of one of two radii, and none jumps between them."""
    modes = tuple(Mode(name, known_turn(rate, acceleration_density=1e-6)) for name, rate in (("l", 0.3), ("r", -0.3)))
    chain = MarkovChain(generator=((0.0, 0.0), (0.0, 0.0)))
    estimator = BankEstimator(Bank(modes, SENSOR, chain=chain, initial_probs=(0.25, 0.75)))
    prior = Prior(np.array([0.0, 0.0, 10.0, 0.0]), np.diag([1e-6] * 4), time=0.0)
    states, _ = estimator.states(np.full((1, 2), np.nan), [0.0], prior=prior)
    times = np.arange(1.0, 6.0)
    found = forecast(estimator, states, times, paths=64)
    circle = np.stack([np.sin(0.3 * times), 1.0 - np.cos(0.3 * times)], axis=1) * 10.0 / 0.3
    left = found.paths[0, :, -1, 1] > 0
    assert left.sum() == 16
    np.testing.assert_allclose(found.paths[0, left], np.broadcast_to(circle, (16, 5, 2)), atol=0.05)
    np.testing.assert_allclose(found.paths[0, ~left], np.broadcast_to(circle * [1, -1], (48, 5, 2)), atol=0.05)


def test_best_of_several_paths(ways):
    truth = np.array([[[0.0, 90.0], [3.0, 103.0]]])
    weights, paths = ways.roads(2)
    np.testing.assert_allclose(weights, [[0.3, 0.3]])
    np.testing.assert_allclose(paths[0, 1], ways.means[0, :, 1])
    assert ways.min_ade(truth, 4, by="roads")[0] == pytest.approx(2.5)  # 0 and 5 m
    assert ways.min_fde(truth, 4, by="roads")[0] == pytest.approx(5.0)
    assert ways.min_fde(truth, 2, by="roads")[0] > 90.0
    half = truth.copy()
    half[0, 1] = np.nan
    assert ways.min_ade(half, 4, by="roads")[0] == pytest.approx(0.0)
    assert np.isnan(ways.min_fde(half, 4, by="roads")[0])
    drawn = dataclasses.replace(ways, paths=truth[:, None] + np.array([7.0, 2.0, 5.0])[None, :, None, None])
    assert drawn.min_ade(truth, 1)[0] == pytest.approx(7.0 * np.sqrt(2.0))
    assert drawn.min_ade(truth, 3)[0] == pytest.approx(2.0 * np.sqrt(2.0)) == drawn.min_fde(truth, 2)[0]


def test_one_gaussian_says_less_than_the_mixture(ways):
    """Truth drawn from the mixture: its own score is better by the divergence of the two, about 3 nats here."""
    rng = np.random.default_rng(3)
    truth = np.empty((256, 2, 2))
    for row in truth:
        for h in range(2):
            k = rng.choice(4, p=ways.weights[0, h])
            row[h] = rng.multivariate_normal(ways.means[0, h, k], ways.covariances[0, h, k])
    names = ("horizons", "weights", "means", "covariances", "paths")
    many = dataclasses.replace(ways, **{name: np.repeat(getattr(ways, name), 256, axis=0) for name in names})
    one = many.collapsed()
    np.testing.assert_allclose(one.mean, many.mean)
    np.testing.assert_allclose(one.covariance, many.covariance)
    gain = one.nll(truth).mean() - many.nll(truth).mean()
    assert 2.0 < gain < 5.0


def zigzag(seed):
    """A target that turns left or right every 12 s at 0.25 rad/s for 4 s."""
    rng = np.random.default_rng(seed)
    times = np.arange(60.0)
    rate = np.where(times % 12 < 4, np.repeat(rng.choice([-0.25, 0.25], 5), 12), 0.0)
    heading = np.cumsum(rate)
    truth = np.cumsum(15.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    return truth, truth + rng.normal(0, 1.0, truth.shape), times


def test_scores_of_tracks():
    flights = [zigzag(seed) for seed in range(4)]
    truth, z, times = (np.stack(values) for values in zip(*flights, strict=True))
    tracks = Tracks.from_arrays(z, times, truth=truth)
    estimator = make_estimator("intent-imm", position(2, 1.0), acceleration=4.0, speed=15.0, sojourn=6.0)
    scores = score_forecasts(estimator, tracks, 10, every=3, warm_up=10)
    assert scores.forecasts == 4 * len(range(10, 50, 3))
    np.testing.assert_allclose(scores.horizon, np.arange(1.0, 11.0))
    assert np.all(np.diff(scores.rmse) > 0) and scores.rmse[0] < 4.0
    collapsed = score_forecasts(estimator, tracks, 10, every=3, warm_up=10, collapse=True)
    np.testing.assert_allclose(collapsed.rmse, scores.rmse, rtol=1e-9)
    assert scores.nll.mean() < collapsed.nll.mean()
    assert scores.min_ade < collapsed.min_ade
    bare = dataclasses.replace(tracks, truth=None)
    seen = score_forecasts(estimator, bare, 10, every=3, warm_up=10)
    assert seen.rmse[0] == pytest.approx(np.hypot(scores.rmse[0], np.sqrt(2.0)), rel=0.15)
    with pytest.raises(ValueError, match="tracks must be longer than warm_up"):
        score_forecasts(estimator, tracks, 55)


def test_refusals(ways, single):
    estimator, state = single
    for horizons in (-1.0, [2.0, 1.0], [np.inf], [[1.0], [2.0]], []):
        with pytest.raises(ValueError, match="horizons must be seconds"):
            forecast(estimator, state, horizons)
    with pytest.raises(ValueError, match="state must come from"):
        forecast(bank([0.1, 1.0], rates=((-1, 1), (1, -1))), state, [1.0])
    with pytest.raises(ValueError, match=r"truth must have shape .* = \(1, 2, 2\)"):
        ways.nll(np.zeros((1, 3, 2)))
    with pytest.raises(ValueError, match="by must be paths or roads"):
        ways.min_ade(np.zeros((1, 2, 2)), by="luck")
    for count in (0, 4):
        with pytest.raises(ValueError, match=r"count must be in 1 \.\. 3"):
            ways.min_ade(np.zeros((1, 2, 2)), count)
    with pytest.raises(ValueError, match="paths must be an integer >= 0"):
        forecast(estimator, state, [1.0], paths=-1)
    ranges = Tracks.from_arrays(np.ones((20, 1)), np.arange(20.0), sensor="range", axes=2)
    with pytest.raises(ValueError, match="tracks must have truth or positions"):
        score_forecasts(estimator, ranges)


def test_a_given_state_is_left_alone(single):
    estimator, state = single
    before = [value.copy() for value in state]
    forecast(estimator, state, HORIZONS)
    for old, new in zip(before, state, strict=True):
        np.testing.assert_array_equal(old, new)


def test_prior_and_missing_rows_do_not_disturb():
    estimator = bank([0.5])
    prior = Prior(np.zeros(4), np.diag([1.0, 1.0, 4.0, 4.0]), time=0.0)
    states, _ = estimator.states(np.full((3, 2), np.nan), [1.0, 2.0, 3.0], prior=prior)
    found = forecast(estimator, states, [1.0])
    # Variance of a position t seconds after the prior: 1 + 4 t^2 + 0.5 t^3 / 3.
    np.testing.assert_allclose(found.covariances[:, 0, 0, 0, 0], [1 + 4 * t**2 + t**3 / 6 for t in (2.0, 3.0, 4.0)])
