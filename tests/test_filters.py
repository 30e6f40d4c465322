"""One mode: Kalman and unscented filters against peers and a textbook, and the laws every filter obeys."""

import datetime

import numpy as np
import pytest
import reference_unscented as textbook
from random_problems import KIN, N, curved_problem, curved_sensor, linear_problem, spd

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.compiled import OBSERVE, Callback
from jink.estimators.inputs import Prior
from jink.estimators.metrics import average_nees, nees, nis_consistency
from jink.estimators.motions import constant_acceleration, constant_velocity, coordinated_turn
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import position, range_bearing, ranges
from jink.estimators.status import MISSING, OK, REPAIRED

DT, ROWS = 0.4, 25
PEER = {"rtol": 1e-10, "atol": 1e-10}
TUNINGS = [(1.0, 2.0, 0.0), (0.6, 1.5, 1.0)]


def one(motion, sensor, **options):
    return BankEstimator(Bank((Mode("only", motion),), sensor, **options))


def track(est, z, prior, times=None, **rest):
    """Every state and estimate of a loop of `step` after a prior that already contains row 0."""
    times = DT * np.arange(len(z)) if times is None else times
    states, estimates = [est.start(z[0], times[0], prior=prior)], []
    for row, time in zip(z[1:], times[1:], strict=True):
        state, estimate = est.step(states[-1], row, time, **rest)
        states.append(state)
        estimates.append(estimate)
    return states, estimates


def full(states, mode=0, n=N):
    """Means (T, n) and covariances of one mode."""
    return np.array([s.mean[0, mode, :n] for s in states]), np.array([s.cov[0, mode, :n, :n] for s in states])


def begin(rng):
    mean, cov = rng.normal(size=N), spd(rng, N)
    return mean, cov, Prior([mean], [cov], includes_first=True)


def linear_case(seed):
    rng = np.random.default_rng(seed)
    made, F, Q = linear_problem(rng)
    H = np.zeros((2, N))
    H[0, 0] = H[1, 2] = 1.0
    R = spd(rng, 2)
    mean, cov, prior = begin(rng)
    z = rng.normal(size=(ROWS, 2)) * 2
    states, estimates = track(one(made, position(2, 1.0)), z, prior, noise=R)
    return F, Q, H, R, mean, cov, z, states, estimates


def curved_case(seed, tuning):
    rng = np.random.default_rng(seed)
    made, f, Q = curved_problem(rng, DT)
    sensor, h, place = curved_sensor()
    R = spd(rng, 2)
    mean, cov, prior = begin(rng)
    z = rng.normal(size=(ROWS, 2)) * 1.5 + [1.0, 0.0]
    alpha, beta, kappa = tuning
    est = one(made, sensor, alpha=alpha, beta=beta, kappa=kappa)
    states, estimates = track(est, z, prior, noise=R, sensor_state=place)
    return f, h, Q, R, mean, cov, z, states, estimates


# --- peers


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_kalman_filter_equals_filterpy(seed):
    filterpy = pytest.importorskip("filterpy.kalman")
    F, Q, H, R, mean, cov, z, states, estimates = linear_case(seed)
    peer = filterpy.KalmanFilter(N, 2)
    peer.x, peer.P, peer.F, peer.Q, peer.H, peer.R = mean[:, None], cov, F, Q, H, R
    means, covs = full(states)
    for k, row in enumerate(z[1:], 1):
        peer.predict()
        peer.update(row[:, None])
        np.testing.assert_allclose(means[k], peer.x[:, 0], **PEER)
        np.testing.assert_allclose(covs[k], peer.P, **PEER)
        assert estimates[k - 1].log_likelihood == pytest.approx(peer.log_likelihood, rel=1e-10)
        assert estimates[k - 1].nis == pytest.approx(float(peer.mahalanobis) ** 2, rel=1e-9)
        np.testing.assert_allclose(estimates[k - 1].covariance, peer.P[np.ix_(KIN, KIN)], **PEER)


@pytest.mark.parametrize("tuning", TUNINGS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_unscented_filter_equals_the_textbook(seed, tuning):
    f, h, Q, R, mean, cov, z, states, estimates = curved_case(seed, tuning)
    means, covs, logs = textbook.run_filter(f, Q, h, R, mean, cov, z, tuning)
    np.testing.assert_allclose(full(states)[0], means, **PEER)
    np.testing.assert_allclose(full(states)[1], covs, **PEER)
    np.testing.assert_allclose([e.log_likelihood for e in estimates], logs, **PEER)


@pytest.mark.parametrize("tuning", TUNINGS)
@pytest.mark.parametrize("seed", [0, 1])
def test_unscented_filter_equals_filterpy(seed, tuning):
    filterpy = pytest.importorskip("filterpy.kalman")
    f, h, Q, R, mean, cov, z, states, _ = curved_case(seed, tuning)
    points = filterpy.MerweScaledSigmaPoints(N, *tuning)
    peer = filterpy.UnscentedKalmanFilter(N, 2, DT, h, f, points)
    peer.x, peer.P, peer.Q, peer.R = mean.copy(), cov.copy(), Q, R
    means, covs = full(states)
    for k, row in enumerate(z[1:], 1):
        peer.predict()
        peer.update(row)
        np.testing.assert_allclose(means[k], peer.x, **PEER)
        np.testing.assert_allclose(covs[k], peer.P, **PEER)


@pytest.mark.parametrize("tuning", TUNINGS)
def test_unscented_filter_equals_stone_soup(tuning):
    pytest.importorskip("stonesoup")
    from stone_soup_models import measurement_model, start_state, transition_model
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    f, h, Q, R, mean, cov, z, states, _ = curved_case(7, tuning)
    alpha, beta, kappa = tuning
    rule = {"alpha": alpha, "beta": beta, "kappa": kappa}
    predictor = UnscentedKalmanPredictor(transition_model(f, Q), **rule)
    updater = UnscentedKalmanUpdater(measurement_model(h, R, N), **rule)
    t0 = datetime.datetime(2020, 1, 1)
    peer = start_state(mean, cov, t0)
    means, covs = full(states)
    for k, row in enumerate(z[1:], 1):
        now = t0 + datetime.timedelta(seconds=k)
        prediction = predictor.predict(peer, timestamp=now)
        peer = updater.update(SingleHypothesis(prediction, Detection(row[:, None], timestamp=now)))
        np.testing.assert_allclose(means[k], np.ravel(peer.state_vector), **PEER)
        np.testing.assert_allclose(covs[k], peer.covar, **PEER)


@pytest.mark.parametrize("interval", [0.05, 1.0, 7.0])
@pytest.mark.parametrize("make", [constant_velocity, constant_acceleration])
def test_sigma_points_of_a_linear_mode_change_nothing(make, interval):
    rng = np.random.default_rng(3)
    z, times = rng.normal(size=(30, 2)) * 5, interval * np.arange(30)
    runs = [one(make(2), position(2, 2.0), every_sigma_point=flag).run(z, times) for flag in (False, True)]
    for left, right in zip(*runs, strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-10, atol=1e-10)


# --- noise of a motion that states only its diffusion


def test_noise_from_diffusion_is_the_integral_over_the_flow():
    from scipy.integrate import quad_vec

    from jink.estimators.motion import motion

    @motion("x vx y vy", linear=True, diffusion={"vx": 2.0, "vy": 0.5}, params=(0.3,))
    def damped(x, dt, params, out):
        decay = np.exp(-params[0] * dt)
        out[0] = x[0] + x[1] * (1.0 - decay) / params[0]
        out[1] = x[1] * decay
        out[2] = x[2] + x[3] * (1.0 - decay) / params[0]
        out[3] = x[3] * decay

    def phi(s):
        e = np.exp(-0.3 * s)
        return np.kron(np.eye(2), np.array([[1, (1 - e) / 0.3], [0, e]]))

    spread = np.diag([0, 2.0, 0, 0.5])
    Q = quad_vec(lambda s: phi(s) @ spread @ phi(s).T, 0, 0.8)[0]
    est = one(damped, position(2, 1.0))
    state = est.start([1.0, 2.0], 0.0, prior=Prior([np.ones(4)], [1e-6 * np.eye(4)], includes_first=True))
    after, _ = est.step(state, [np.nan, np.nan], 0.8)
    # Three Gauss points over an exponential flow: relative error of order (0.3 * 0.8)^6 / 1e6.
    np.testing.assert_allclose(after.cov[0, 0, :4, :4], Q + 1e-6 * phi(0.8) @ phi(0.8).T, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(after.mean[0, 0, :4], phi(0.8) @ np.ones(4), rtol=1e-12)


# --- laws


PRIOR = Prior([1.0, -2.0, 0.5, 0.7], np.diag([4.0, 9.0, 1.0, 2.0]))


def noisy_walk(rng, rows=40):
    return np.cumsum(rng.normal(size=(rows, 2)), axis=0)


FILTERS = {
    "cv": lambda sensor: one(constant_velocity(2), sensor),
    "ca": lambda sensor: one(constant_acceleration(2), sensor),
    "ct": lambda sensor: one(coordinated_turn(), sensor),
}


@pytest.mark.parametrize("name", FILTERS)
def test_a_missing_measurement_is_one_without_information(name):
    z = noisy_walk(np.random.default_rng(5))
    est, times = FILTERS[name](position(2, 1.0)), np.arange(40.0)
    R = np.tile(np.eye(2), (40, 1, 1))
    vague, gone = R.copy(), z.copy()
    vague[7:10] = 1e14 * np.eye(2)
    gone[7:10] = np.nan
    left, right = est.run(gone, times, R, prior=PRIOR), est.run(z, times, vague, prior=PRIOR)
    # 1e14 against covariances below 1e3: what is left of the information is below 1e-10 of it.
    np.testing.assert_allclose(left.position, right.position, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(left.covariance, right.covariance, rtol=1e-8, atol=1e-8)
    np.testing.assert_array_equal(left.status[0, 7:10], MISSING)
    np.testing.assert_array_equal(left.nis_dof[0, 6:11], [2, 0, 0, 0, 2])
    assert (left.log_likelihood[0, 7:10] == 0).all() and (left.nis[0, 7:10] == 0).all()


def test_a_partial_measurement_is_a_sensor_with_fewer_rows():
    def see_x(kin, sensor, params, out):
        out[0] = kin[0]

    less = Sensor("x", ("x",), ("m",), 2, Callback(see_x, OBSERVE), (2.0,), linear=True)
    z = noisy_walk(np.random.default_rng(6))
    part = z.copy()
    part[:, 1] = np.nan
    R = np.array([[4.0, 1.3], [1.3, 3.0]])
    for name, make in FILTERS.items():
        left = make(position(2, 1.0)).run(part, np.arange(40.0), R, prior=PRIOR)
        right = make(less).run(z[:, :1], np.arange(40.0), R[:1, :1], prior=PRIOR)
        for a, b in zip(left, right, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12, err_msg=name)
        assert (left.nis_dof == 1).all() and (left.status == OK).all()


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_lost_anchor_is_a_sensor_without_it(lost):
    anchors = np.array([[0.0, 0.0], [30.0, 5.0], [-3.0, 20.0]])
    rng = np.random.default_rng(7)
    truth = noisy_walk(rng) + np.array([8.0, 9.0])
    z = np.linalg.norm(truth[:, None] - anchors, axis=2) + 0.1 * rng.normal(size=(40, 3))
    R, keep = spd(rng, 3), [k for k in range(3) if k != lost]
    part = z.copy()
    part[:, lost] = np.nan
    left = FILTERS["ct"](ranges(anchors)).run(part, np.arange(40.0), R, prior=PRIOR)
    right = FILTERS["ct"](ranges(anchors[keep])).run(z[:, keep], np.arange(40.0), R[np.ix_(keep, keep)], prior=PRIOR)
    for a, b in zip(left, right, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("name", ["cv", "ca"])
def test_splitting_a_step_changes_nothing(name):
    z, est = noisy_walk(np.random.default_rng(8)), FILTERS[name](position(2, 1.0))
    times = np.cumsum(np.random.default_rng(9).uniform(0.1, 3.0, 40))
    more = np.full((79, 2), np.nan)
    more[::2] = z
    between = np.empty(79)
    between[::2] = times
    between[1::2] = 0.7 * times[:-1] + 0.3 * times[1:]
    whole, split = est.run(z, times, prior=PRIOR), est.run(more, between, prior=PRIOR)
    np.testing.assert_allclose(split.position[:, ::2], whole.position, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(split.covariance[:, ::2], whole.covariance, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(split.log_likelihood[:, ::2], whole.log_likelihood, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("angle", [0.3, 2.0, -2.9])
@pytest.mark.parametrize("name", ["cv", "ca"])
def test_turn_and_shift_the_scene_and_the_estimates_follow(name, angle):
    z, est = noisy_walk(np.random.default_rng(10)), FILTERS[name](position(2, 1.5))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = np.array([300.0, -70.0])
    here, there = est.run(z, np.arange(40.0)), est.run(z @ turn.T + shift, np.arange(40.0))
    both = np.kron(np.eye(2), turn)
    np.testing.assert_allclose(there.position, here.position @ turn.T + shift, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(there.velocity, here.velocity @ turn.T, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(there.covariance, both @ here.covariance @ both.T, rtol=1e-9, atol=1e-9)


def test_a_radar_that_sails_with_its_scene_sees_the_same():
    rng = np.random.default_rng(11)
    path, times = 50 + noisy_walk(rng), np.arange(40.0)
    own = np.column_stack([10 * times, 4 * times, np.full(40, 10.0), np.full(40, 4.0)])
    z = np.column_stack([np.hypot(*path.T), np.arctan2(path[:, 1], path[:, 0])])
    est = one(constant_velocity(2), range_bearing((1.0, 0.02)))
    prior = [Prior(np.r_[path[0], v], np.diag([9.0, 9, 4, 4])) for v in ([0.0, 0.0], [10.0, 4.0])]
    still, moving = est.run(z, times, prior=prior[0]), est.run(z, times, sensor_states=own, prior=prior[1])
    np.testing.assert_allclose(moving.position, still.position + own[:, :2], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(moving.velocity, still.velocity + own[:, 2:], rtol=1e-8, atol=1e-8)


def test_bearings_wrap_where_the_circle_closes():
    rng = np.random.default_rng(12)
    path = np.column_stack([np.full(40, -60.0), np.linspace(-15, 15, 40)])
    z = np.column_stack([np.hypot(*path.T), np.arctan2(path[:, 1], path[:, 0])])
    z += rng.normal(size=z.shape) * [0.5, 0.02]
    est = one(constant_velocity(2, acceleration_density=0.01), range_bearing((0.5, 0.02)))
    out = est.run(z, np.arange(40.0))
    shifted = est.run(z + np.array([0.0, 4 * np.pi]), np.arange(40.0))
    np.testing.assert_allclose(shifted.position, out.position, atol=1e-9)
    assert np.abs(out.position[0, 10:] - path[10:]).max() < 2.0  # an unwrapped bearing throws it tens of metres
    # Half a turn of the scene only flips signs, so even an unscented filter follows to rounding.
    opposite = est.run(z + np.array([0.0, np.pi]), np.arange(40.0))
    np.testing.assert_allclose(opposite.position, -out.position, atol=1e-8)


def test_time_running_backwards_is_taken_as_no_time_and_reported():
    est = FILTERS["cv"](position(2, 1.0))
    state = est.start([0.0, 0.0], 5.0)
    back, estimate = est.step(state, [1.0, 1.0], 4.0)
    same, _ = est.step(state, [1.0, 1.0], 5.0)
    assert estimate.status == REPAIRED
    np.testing.assert_array_equal(back.mean, same.mean)


# --- forecast


def test_forecast_of_constant_velocity_is_analytic():
    q, h = 0.7, 3.0
    est = one(constant_velocity(2, acceleration_density=q), position(2, 1.0))
    state = est.start(noisy_walk(np.random.default_rng(13)), np.arange(40.0))
    m, P = state.kin_mean[0], state.kin_cov[0]
    F = np.hstack([np.eye(2), h * np.eye(2)])
    mean, cov = est.forecast(state, h)
    np.testing.assert_allclose(mean, F @ m, rtol=1e-12)
    np.testing.assert_allclose(cov, F @ P @ F.T + q * h**3 / 3 * np.eye(2), rtol=1e-11, atol=1e-12)
    now, cov_now = est.forecast(state, 0.0)
    np.testing.assert_allclose(now, m[:2], rtol=1e-14)
    np.testing.assert_allclose(cov_now, P[:2, :2], rtol=1e-13, atol=1e-15)
    for a, b in zip(est.forecast(state, h, steps=10), (mean, cov), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-12)


def test_forecast_of_a_curved_motion_repeats_the_textbook_prediction():
    rng = np.random.default_rng(14)
    made, f, Q = curved_problem(rng, DT)
    sensor, _, _ = curved_sensor()
    mean, cov, prior = begin(rng)
    est = one(made, sensor)
    for _ in range(3):
        mean, cov = textbook.predict(f, Q, mean, cov)
    there, spread = est.forecast(est.start([0.0, 0.0], 0.0, prior=prior), 3 * DT, steps=3)
    np.testing.assert_allclose(there, mean[[0, 2]], **PEER)
    np.testing.assert_allclose(spread, cov[np.ix_([0, 2], [0, 2])], **PEER)


def test_forecasts_along_a_run_are_those_of_its_states():
    z, est = noisy_walk(np.random.default_rng(15)), FILTERS["ct"](position(2, 1.0))
    mean, cov = est.forecast_run(z, np.arange(40.0), 2.5, steps=2)
    state = est.start(z[0], 0.0)
    for k in range(40):
        if k:
            state, _ = est.step(state, z[k], float(k))
        one_mean, one_cov = est.forecast(state, 2.5, steps=2)
        np.testing.assert_array_equal(mean[0, k], one_mean)
        np.testing.assert_array_equal(cov[0, k], one_cov)


# --- consistency


def matched_batch(q, sigma, rows=30, tracks=300):
    """Truth from the model of `constant_velocity` with its own prior, and measurements of it."""
    rng = np.random.default_rng(16)
    step = np.linalg.cholesky(q * np.array([[1 / 3, 1 / 2], [1 / 2, 1]]))
    state = rng.normal(size=(tracks, 2, 2)) * [5.0, 2.0]  # track, axis, (position, velocity)
    truth = [state]
    for _ in range(rows - 1):
        state = state @ np.array([[1.0, 0.0], [1.0, 1.0]]) + rng.normal(size=(tracks, 2, 2)) @ step.T
        truth.append(state)
    truth = np.stack(truth, 1)
    z = truth[..., 0] + sigma * rng.normal(size=truth.shape[:3])
    return truth, z, Prior(np.zeros(4), np.diag([25.0, 25.0, 4.0, 4.0]))


@pytest.mark.parametrize("factor", [1.0, 0.3, 3.0])
def test_errors_and_innovations_match_their_covariances_only_when_the_model_does(factor):
    truth, z, prior = matched_batch(0.5, 2.0)
    est = one(constant_velocity(2, acceleration_density=0.5 * factor**2), position(2, 2.0 * factor))
    out = est.run(z, np.arange(30.0), prior=prior)
    errors = average_nees(nees(out.position, out.velocity, out.covariance, truth[..., 0], truth[..., 1]), 4)
    innovations = nis_consistency(out.nis, out.nis_dof)
    inside = [c.low < c.mean < c.high for c in (errors, innovations)]
    if factor == 1.0:
        assert all(inside) and errors.share_inside > 0.8 and innovations.share_inside > 0.93
    else:
        assert not any(inside)
        assert (errors.mean > errors.high) == (factor < 1.0)
