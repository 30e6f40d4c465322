"""Smoothers: one mode against peers, many modes against their limits and against the truth."""

import datetime

import numpy as np
import pytest
import reference_unscented as textbook
from random_problems import KIN, N, curved_problem, curved_sensor, linear_problem, spd

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.metrics import brier_score, mode_accuracy
from jink.estimators.motions import constant_acceleration, constant_velocity, coordinated_turn, polar_turn
from jink.estimators.recipes import RECIPES, make_estimator
from jink.estimators.sensors import position, range_bearing

DT, ROWS = 0.4, 25
TIMES = DT * np.arange(ROWS)
PEER = {"rtol": 1e-10, "atol": 1e-10}
TUNINGS = [(1.0, 2.0, 0.0), (0.6, 1.5, 1.0)]


def filtered(est, z, prior, **rest):
    """Full means (T, n) and covariances of the only mode, row 0 being the prior."""
    states = [est.start(z[0], 0.0, prior=prior)]
    for row, time in zip(z[1:], TIMES[1:], strict=True):
        states.append(est.step(states[-1], row, time, **rest)[0])
    return np.array([s.mean[0, 0, :N] for s in states]), np.array([s.cov[0, 0, :N, :N] for s in states])


def curved_case(seed, tuning):
    rng = np.random.default_rng(seed)
    made, f, Q = curved_problem(rng, DT)
    sensor, h, place = curved_sensor()
    R, z = spd(rng, 2), rng.normal(size=(ROWS, 2)) * 1.5 + [1.0, 0.0]
    mean, cov = rng.normal(size=N), spd(rng, N)
    alpha, beta, kappa = tuning
    est = BankEstimator(Bank((Mode("only", made),), sensor, alpha=alpha, beta=beta, kappa=kappa))
    prior = Prior([mean], [cov], includes_first=True)
    out = est.smooth(z, TIMES, R, place, prior=prior)
    return f, Q, h, R, z, out, filtered(est, z, prior, noise=R, sensor_state=place)


def assert_kinematics(out, means, covs, first=0):
    got = np.hstack([out.position[0], out.velocity[0]])
    np.testing.assert_allclose(got[first:], means[first:, KIN], **PEER)
    np.testing.assert_allclose(out.covariance[0, first:], covs[first:, KIN][:, :, KIN], **PEER)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_one_linear_mode_is_the_smoother_of_filterpy(seed):
    filterpy = pytest.importorskip("filterpy.kalman")
    rng = np.random.default_rng(seed)
    made, F, Q = linear_problem(rng)
    R, z = spd(rng, 2), rng.normal(size=(ROWS, 2)) * 2
    prior = Prior([rng.normal(size=N)], [spd(rng, N)], includes_first=True)
    est = BankEstimator(Bank((Mode("only", made),), position(2, 1.0)))
    means, covs = filtered(est, z, prior, noise=R)
    peer = filterpy.KalmanFilter(N, 2)
    peer.F, peer.Q = F, Q
    smooth_means, smooth_covs, _, _ = peer.rts_smoother(means[..., None], covs)
    assert_kinematics(est.smooth(z, TIMES, R, prior=prior), smooth_means[..., 0], smooth_covs)


@pytest.mark.parametrize("tuning", TUNINGS)
@pytest.mark.parametrize("seed", [0, 1])
def test_one_curved_mode_is_the_textbook_smoother(seed, tuning):
    f, Q, _, _, _, out, (means, covs) = curved_case(seed, tuning)
    assert_kinematics(out, *textbook.run_smoother(f, Q, means, covs, tuning))


@pytest.mark.parametrize("tuning", TUNINGS)
def test_one_curved_mode_is_the_smoother_of_filterpy(tuning):
    filterpy = pytest.importorskip("filterpy.kalman")
    f, Q, h, _, _, out, (means, covs) = curved_case(2, tuning)
    peer = filterpy.UnscentedKalmanFilter(N, 2, DT, h, f, filterpy.MerweScaledSigmaPoints(N, *tuning))
    peer.Q = Q
    smooth_means, smooth_covs, _ = peer.rts_smoother(means, covs)
    assert_kinematics(out, smooth_means, smooth_covs)


@pytest.mark.parametrize("tuning", TUNINGS)
def test_one_curved_mode_is_the_smoother_of_stone_soup(tuning):
    pytest.importorskip("stonesoup")
    from stone_soup_models import measurement_model, start_state, transition_model
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.smoother.kalman import UnscentedKalmanSmoother
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.track import Track
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    f, Q, h, R, z, out, (means, covs) = curved_case(3, tuning)
    rule = dict(zip(("alpha", "beta", "kappa"), tuning, strict=True))
    model, t0 = transition_model(f, Q), datetime.datetime(2020, 1, 1)
    predictor, updater = (
        UnscentedKalmanPredictor(model, **rule),
        UnscentedKalmanUpdater(measurement_model(h, R, N), **rule),
    )
    track = Track([start_state(means[0], covs[0], t0)])
    for k in range(1, ROWS):
        now = t0 + datetime.timedelta(seconds=k)
        prediction = predictor.predict(track[-1], timestamp=now)
        track.append(updater.update(SingleHypothesis(prediction, Detection(z[k][:, None], timestamp=now))))
    smooth = UnscentedKalmanSmoother(transition_model=model, **rule).smooth(track)
    # Row 0 is a prior there, which its smoother leaves alone.
    smooth_means = np.array([np.ravel(s.state_vector) for s in smooth])
    assert_kinematics(out, smooth_means, np.array([s.covar for s in smooth]), first=1)


def quiet_and_loud(chain, sensor=None, **options):
    return BankEstimator(
        Bank(
            (
                Mode("quiet", constant_velocity(2, acceleration_density=0.01)),
                Mode("loud", constant_velocity(2, acceleration_density=4.0)),
            ),
            sensor or position(2, 1.0),
            chain=chain,
            min_prob=0.0,
            initial_probs=(0.4, 0.6),
            **options,
        )
    )


PRIOR = Prior(np.zeros(4), np.diag([9.0, 9, 4, 4]))


def test_modes_that_never_switch_are_smoothed_apart():
    rng = np.random.default_rng(4)
    z, times = np.cumsum(rng.normal(size=(15, 2)), axis=0), np.cumsum(rng.uniform(0.2, 2, 15))
    bank = quiet_and_loud(MarkovChain.per_step(np.eye(2)))
    out = bank.smooth(z, times, prior=PRIOR)
    final = bank.run(z, times, prior=PRIOR).mode_probs[0, -1]
    assert 0.02 < final[0] < 0.98
    np.testing.assert_allclose(out.mode_probs[0], np.tile(final, (15, 1)), rtol=1e-9)
    singles = [BankEstimator(Bank((mode,), position(2, 1.0))).smooth(z, times, prior=PRIOR) for mode in bank.bank.modes]
    for k in range(15):
        mean, cov = textbook.moments(
            final,
            np.array([np.r_[s.position[0, k], s.velocity[0, k]] for s in singles]),
            np.array([s.covariance[0, k] for s in singles]),
        )
        np.testing.assert_allclose(np.r_[out.position[0, k], out.velocity[0, k]], mean, **PEER)
        np.testing.assert_allclose(out.covariance[0, k], cov, **PEER)


def test_modes_that_are_alike_are_smoothed_as_one():
    rng = np.random.default_rng(5)
    z, times = np.cumsum(rng.normal(size=(30, 2)), axis=0), np.arange(30.0)
    motion = constant_velocity(2)
    chain = MarkovChain.per_step([[0.9, 0.1], [0.3, 0.7]])
    twins = Bank((Mode("a", motion), Mode("b", motion)), position(2, 1.0), chain=chain, min_prob=0.0)
    single = BankEstimator(Bank((Mode("a", motion),), position(2, 1.0))).smooth(z, times, prior=PRIOR)
    both = BankEstimator(twins).smooth(z, times, prior=PRIOR)
    np.testing.assert_allclose(both.position, single.position, **PEER)
    np.testing.assert_allclose(both.covariance, single.covariance, **PEER)
    np.testing.assert_allclose(both.mode_probs, np.tile([0.75, 0.25], (1, 30, 1)), rtol=1e-10)


def exact_by_enumeration(est, chain, z, times):
    """Smoothed position mean, covariance and mode probabilities over every sequence of modes."""
    modes, rows = len(est.modes), len(z)
    logs, tracks = [], []
    initial = est.bank.start_probs
    for number in range(modes**rows):
        sequence = [(number // modes**k) % modes for k in range(rows)]
        hot = np.zeros((rows, modes, modes))
        hot[range(rows), :, sequence] = 1.0
        probs = np.eye(modes)[sequence[0]]
        prior = PRIOR._replace(mode_probs=probs)
        likelihood = est.run(z, times, prior=prior, mode_transition=hot).log_likelihood.sum()
        with np.errstate(divide="ignore"):
            weight = np.log(initial[sequence[0]]) + np.log(chain[sequence[:-1], sequence[1:]]).sum()
        logs.append(likelihood + weight)
        tracks.append((sequence, est.smooth(z, times, prior=prior, mode_transition=hot)))
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    mean = sum(w * s.position[0] for w, (_, s) in zip(weights, tracks, strict=True))
    probs = sum(w * np.eye(modes)[q] for w, (q, _) in zip(weights, tracks, strict=True))
    return mean, probs


def test_a_bank_is_close_to_the_sum_over_every_sequence_of_modes():
    chain = np.array([[0.9, 0.1], [0.2, 0.8]])
    est = quiet_and_loud(MarkovChain.per_step(chain))
    z = np.cumsum([[0, 0], [1, 0], [2, 1], [3.5, 2.0], [3.6, 2], [3.5, 2.0]], axis=0)
    mean, probs = exact_by_enumeration(est, chain, z, np.arange(6.0))
    smooth, run = (method(z, np.arange(6.0), prior=PRIOR) for method in (est.smooth, est.run))
    # Late rows inherit the filter's own approximation (0.07 at the last row); early ones have a future.
    np.testing.assert_allclose(smooth.mode_probs[0, :2], probs[:2], atol=2e-3)
    assert np.abs(run.mode_probs[0, :2] - probs[:2]).max() > 0.1
    worst, filtered_worst = (np.abs(out.position[0] - mean).mean() for out in (smooth, run))
    assert worst < 0.35 * filtered_worst


def switching(rng, tracks, rows):
    """Truth that is quiet, then loud, then quiet: positions, modes, measurements."""
    modes = np.zeros((tracks, rows), dtype=int)
    modes[:, rows // 3 : 2 * rows // 3] = 1
    step = np.linalg.cholesky(np.array([[1 / 3, 1 / 2], [1 / 2, 1]]))
    state = rng.normal(size=(tracks, 2, 2)) * [3.0, 2.0]
    truth = []
    for k in range(rows):
        if k:
            q = np.array([0.01, 4.0])[modes[0, k]]
            state = state @ np.array([[1.0, 0], [1, 1]]) + np.sqrt(q) * rng.normal(size=(tracks, 2, 2)) @ step.T
        truth.append(state)
    truth = np.stack(truth, 1)
    return truth[..., 0], modes, truth[..., 0] + rng.normal(size=truth.shape[:3])


def rms(a):
    return np.sqrt(np.mean(np.sum(a**2, axis=-1)))


def test_the_bank_smoother_beats_its_filter_and_every_single_smoother():
    truth, modes, z = switching(np.random.default_rng(6), 60, 45)
    est = quiet_and_loud(MarkovChain.per_step([[0.95, 0.05], [0.05, 0.95]]))
    times = np.arange(45.0)
    smooth, run = est.smooth(z, times, prior=PRIOR), est.run(z, times, prior=PRIOR)
    singles = [BankEstimator(Bank((mode,), position(2, 1.0))).smooth(z, times, prior=PRIOR) for mode in est.bank.modes]
    best = min(rms(s.position - truth) for s in singles)
    assert rms(smooth.position - truth) < 0.97 * best
    assert rms(smooth.position - truth) < 0.8 * rms(run.position - truth)
    assert mode_accuracy(smooth.mode_probs, modes) > mode_accuracy(run.mode_probs, modes) + 0.03
    assert brier_score(smooth.mode_probs, modes) < 0.8 * brier_score(run.mode_probs, modes)
    # The truth is inside what it claims: mean squared distance of a matched smoother is 2.
    error = smooth.position - truth
    cov = smooth.covariance[..., :2, :2]
    assert 1.6 < np.mean(np.einsum("bti,bti->bt", error, np.linalg.solve(cov, error[..., None])[..., 0])) < 2.4


def turning_tracks(rng, tracks=4, rows=30):
    heading = np.cumsum(np.where(np.arange(rows) % 20 < 10, 0.0, 0.25))[None] + rng.uniform(0, 6, (tracks, 1))
    velocity = 5 * np.stack([np.cos(heading), np.sin(heading)], -1)
    truth = 40 + np.cumsum(velocity, axis=1)
    return truth, truth + rng.normal(size=truth.shape)


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_smooths_and_the_last_row_is_the_filter(name):
    truth, z = turning_tracks(np.random.default_rng(7))
    z[0, 5:7] = np.nan
    z[1, 12, 1] = np.nan
    times = np.cumsum(np.random.default_rng(8).uniform(0.5, 1.5, 30))
    est = make_estimator(name, position(2, 1.0), acceleration=1.5, speed=5.0)
    lengths = np.array([30, 30, 22, 0])
    smooth, run = est.smooth(z, times, lengths=lengths), est.run(z, times, lengths=lengths)
    for field in ("position", "velocity", "covariance", "mode_probs"):
        a, b = getattr(smooth, field), getattr(run, field)
        np.testing.assert_array_equal(a[:2, -1], b[:2, -1])
        np.testing.assert_array_equal(a[2, 21:], b[2, 21:])
        np.testing.assert_array_equal(a[3], b[3])
        assert np.isfinite(a).all()
    for field in ("log_likelihood", "nis", "nis_dof", "status", "times"):
        np.testing.assert_array_equal(getattr(smooth, field), getattr(run, field))
    np.testing.assert_allclose(smooth.mode_probs[:3].sum(axis=-1), 1.0, rtol=1e-12)
    eigenvalues = np.linalg.eigvalsh(smooth.covariance[:3])
    assert (eigenvalues > -1e-9 * eigenvalues[..., -1:]).all()
    if name in ("kf-cv", "kf-ca", "singer", "imm"):
        trace = np.trace(smooth.covariance[:2], axis1=2, axis2=3) - np.trace(run.covariance[:2], axis1=2, axis2=3)
        assert trace.mean() < 0
    for b in range(4):
        alone = est.smooth(z[b], times, lengths=lengths[b : b + 1])
        for left, right in zip(alone, smooth, strict=True):
            np.testing.assert_array_equal(left[0], right[b])


@pytest.mark.parametrize("interaction", ["mix", "birth", "jet", "none", "reset"])
def test_unlike_states_smooth_better_than_they_filter(interaction):
    truth, z = turning_tracks(np.random.default_rng(9), tracks=30)
    bank = Bank(
        (
            Mode("cv", constant_velocity(2, acceleration_density=0.01)),
            Mode("ct", coordinated_turn(acceleration_density=0.01, rate_density=1e-4)),
            Mode("ca", constant_acceleration(2, jerk_density=0.05)),
        ),
        position(2, 1.0),
        chain=MarkovChain.from_sojourns([10.0] * 3),
        interaction=interaction,
        speed=6.0,
    )
    est = BankEstimator(bank)
    smooth, run = est.smooth(z, np.arange(30.0)), est.run(z, np.arange(30.0))
    assert np.isfinite(smooth.position).all()
    # Separate filters (none, reset) gain from the future too, but keep the errors of the lost ones.
    assert rms(smooth.position - truth) < (0.85 if interaction in ("mix", "birth", "jet") else 1.0) * rms(
        run.position - truth
    )


@pytest.mark.parametrize("interaction", ["mix", "birth"])
def test_headings_smooth_the_same_on_both_sides_of_the_seam(interaction):
    # Half a turn of the scene puts headings about 0 onto the seam at pi; points only change sign.
    rng = np.random.default_rng(12)
    z = np.column_stack([6.0 * np.arange(25), 0.4 * np.cumsum(rng.normal(size=25))]) + 0.5 * rng.normal(size=(25, 2))
    bank = Bank(
        (
            Mode("cv", constant_velocity(2, acceleration_density=0.05)),
            Mode("polar", polar_turn(speed_density=0.1)),
            Mode("loud", polar_turn(speed_density=3.0, rate_density=0.05)),
        ),
        position(2, 0.5),
        chain=MarkovChain.from_sojourns([5.0] * 3),
        interaction=interaction,
    )
    est, prior = BankEstimator(bank), Prior([0.0, 0, 6, 0], np.diag([1.0, 1, 0.5, 0.5]))
    here = est.smooth(z, np.arange(25.0), prior=prior)
    there = est.smooth(-z, np.arange(25.0), prior=prior._replace(mean=[0.0, 0, -6, 0]))
    np.testing.assert_allclose(there.position, -here.position, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(there.covariance, here.covariance, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(there.mode_probs, here.mode_probs, rtol=1e-6, atol=1e-8)


def test_a_turn_that_was_born_forgets_what_its_mode_held_before():
    z = turning_tracks(np.random.default_rng(13), tracks=1)[1][0, :12]
    turn = coordinated_turn(acceleration_density=0.0, rate_density=0.0, rate=0.1, rate_sd=0.2)
    modes = (Mode("cv", constant_velocity(2, acceleration_density=0.1)), Mode("ct", turn))
    chain = MarkovChain.from_sojourns([5.0] * 2)
    est = BankEstimator(Bank(modes, position(2, 1.0), chain=chain, interaction="birth", min_prob=0.0))
    hot = np.zeros((12, 2, 2))
    hot[:6, :, 0] = hot[6:, :, 1] = 1.0
    start, out = np.r_[z[0, 0], 1.0, z[0, 1], 1.0], []
    for rate in (-2.0, 2.0):  # of the turn while it has no probability
        prior = Prior([start, np.r_[start, rate]], [9 * np.eye(4), 9 * np.eye(5)], mode_probs=[1.0, 0.0])
        out.append(est.smooth(z, np.arange(12.0), prior=prior, mode_transition=hot))
    np.testing.assert_allclose(out[0].position, out[1].position, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(out[0].covariance, out[1].covariance, rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(out[0].mode_probs[0, :, 1], np.arange(12) >= 6)


def test_many_tracks_with_a_prior_each_are_smoothed_in_parts(monkeypatch):
    from jink.estimators import api

    rng = np.random.default_rng(10)
    z = np.cumsum(rng.normal(size=(7, 12, 2)), axis=1)
    prior = Prior(rng.normal(size=(7, 4)), np.stack([np.diag([4.0, 4, 1, 1])] * 7))
    est = quiet_and_loud(MarkovChain.per_step([[0.9, 0.1], [0.1, 0.9]]))
    whole = est.smooth(z, np.arange(12.0), prior=prior)
    monkeypatch.setattr(api, "_SMOOTHER_BYTES", 1.0)  # one track at a time
    for left, right in zip(est.smooth(z, np.arange(12.0), prior=prior), whole, strict=True):
        np.testing.assert_array_equal(left, right)


def test_a_radar_that_moves_and_a_chain_per_row_reach_the_smoother():
    rng = np.random.default_rng(11)
    truth, _ = turning_tracks(rng, tracks=1)
    own = np.column_stack([np.linspace(0, 30, 30), np.zeros(30), np.full(30, 1.0), np.zeros(30)])
    d = truth[0] - own[:, :2]
    z = np.column_stack([np.hypot(*d.T), np.arctan2(d[:, 1], d[:, 0])]) + rng.normal(size=(30, 2)) * [
        0.5,
        0.01,
    ]
    est = quiet_and_loud(MarkovChain.per_step([[0.9, 0.1], [0.1, 0.9]]), range_bearing((0.5, 0.01)))
    chains = np.tile(np.array([[0.9, 0.1], [0.1, 0.9]]), (30, 1, 1))
    prior = Prior(np.r_[truth[0, 0], 0, 0], np.diag([4.0, 4, 25, 25]))
    fixed = est.smooth(z, np.arange(30.0), sensor_states=own, prior=prior)
    given = est.smooth(z, np.arange(30.0), sensor_states=own, prior=prior, mode_transition=chains)
    np.testing.assert_array_equal(given.position, fixed.position)
    chains[15] = [[0.5, 0.5], [0.5, 0.5]]
    other = est.smooth(z, np.arange(30.0), sensor_states=own, prior=prior, mode_transition=chains)
    assert np.abs(other.mode_probs - fixed.mode_probs)[0, 14:16].max() > 1e-3
    assert rms(fixed.position - truth) < rms(
        est.run(z, np.arange(30.0), sensor_states=own, prior=prior).position - truth
    )
