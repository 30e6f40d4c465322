"""Many modes: peers, laws of the cycle, every interaction by hand, and the contract of every recipe."""

import datetime
import json
import os
import subprocess
import sys

import numpy as np
import pytest
import reference_imm
import reference_unscented as textbook
import short_track
from random_problems import KIN, N, curved_problem, curved_sensor, linear_problem, spd

from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motions import (
    circle,
    constant_acceleration,
    constant_velocity,
    coordinated_turn,
    helix,
    known_turn,
    polar_turn,
    spatial_turn,
    weave,
)
from jink.estimators.program import INTERACTIONS
from jink.estimators.recipes import RECIPES, make_estimator
from jink.estimators.sensors import bearing, position, range_bearing, range_bearing_elevation
from jink.estimators.status import DIVERGED, MISSING, OK, STARTING

DT, ROWS = 0.4, 25
TIMES = DT * np.arange(ROWS)
PEER = {"rtol": 1e-10, "atol": 1e-10}
CHAIN = np.array([[0.85, 0.1, 0.05], [0.2, 0.7, 0.1], [0.05, 0.15, 0.8]])
MU = np.array([0.5, 0.2, 0.3])


def bank_of(motions, sensor, matrix=CHAIN, **options):
    modes = tuple(Mode(f"m{k}", made) for k, made in enumerate(motions))
    chain = matrix if isinstance(matrix, MarkovChain) else MarkovChain.per_step(matrix)
    return BankEstimator(Bank(modes, sensor, chain=chain, **{"min_prob": 0.0, **options}))


# --- peers


def same_layout_case(seed, curved):
    """Three modes over one layout, with a start, measurements, and the same functions for a peer."""
    rng = np.random.default_rng(seed)
    if curved:
        made, functions, noises = zip(*(curved_problem(rng, DT) for _ in range(3)), strict=True)
        sensor, h, place = curved_sensor()
    else:
        made, matrices, noises = zip(*(linear_problem(rng) for _ in range(3)), strict=True)
        functions = [lambda x, *_, F=F: F @ np.ravel(x) for F in matrices]
        sensor, place, h = position(2, 1.0), None, lambda x, *_: np.ravel(x)[[0, 2]]
    R, z = spd(rng, 2), rng.normal(size=(ROWS, 2)) * 1.5 + [1.0, 0.0]
    means, covs = list(rng.normal(size=(3, N))), [spd(rng, N) for _ in range(3)]
    prior = Prior(means, covs, includes_first=True, mode_probs=MU)
    est = bank_of(made, sensor)
    out = est.run(z, TIMES, R, place, prior=prior)
    return list(zip(functions, noises, strict=True)), h, R, z, means, covs, out


def assert_fused(out, means, covs, probs):
    np.testing.assert_allclose(np.hstack([out.position[0], out.velocity[0]]), means[:, KIN], **PEER)
    np.testing.assert_allclose(out.covariance[0], covs[:, KIN][:, :, KIN], **PEER)
    np.testing.assert_allclose(out.mode_probs[0], probs, **PEER)


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_mixing_over_one_layout_is_the_textbook_cycle(seed, curved):
    modes, h, R, z, means, covs, out = same_layout_case(seed, curved)
    mean, cov, probs, logs, nis = textbook.run_imm(modes, h, R, CHAIN, MU, means, covs, z)
    assert_fused(out, mean, cov, probs)
    np.testing.assert_allclose(out.log_likelihood[0], logs, **PEER)
    np.testing.assert_allclose(out.nis[0], nis, **PEER)
    assert probs.min(axis=0).max() > 1e-3  # every mode has something to say


@pytest.mark.parametrize("curved", [False, True])
def test_mixing_over_one_layout_equals_filterpy(curved):
    filterpy = pytest.importorskip("filterpy.kalman")
    modes, h, R, z, means, covs, out = same_layout_case(3, curved)
    filters = []
    for (f, Q), mean, cov in zip(modes, means, covs, strict=True):
        points = filterpy.MerweScaledSigmaPoints(N, 1.0, 2.0, 0.0)
        one = filterpy.UnscentedKalmanFilter(N, 2, DT, h, lambda x, dt, f=f: f(x), points)
        one.x, one.P, one.Q, one.R = mean.copy(), cov.copy(), Q, R
        one.predict = lambda u=None, one=one: filterpy.UnscentedKalmanFilter.predict(one)
        filters.append(one)
    peer = filterpy.IMMEstimator(filters, MU.copy(), CHAIN)
    got = [(peer.x.copy(), peer.P.copy(), peer.mu.copy())]
    for row in z[1:]:
        peer.predict()
        peer.update(row)
        got.append((peer.x.copy(), peer.P.copy(), peer.mu.copy()))
    assert_fused(out, *(np.array(column) for column in zip(*got, strict=True)))


def test_mixing_over_one_layout_equals_stone_soup():
    pytest.importorskip("stonesoup")
    from stone_soup_models import measurement_model, start_state, transition_model
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    modes, h, R, z, means, covs, out = same_layout_case(4, True)
    rule = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0}
    t0, mu = datetime.datetime(2020, 1, 1), MU
    got = [(*textbook.moments(mu, means, covs), mu)]
    predictors = [UnscentedKalmanPredictor(transition_model(f, Q), **rule) for f, Q in modes]
    updater = UnscentedKalmanUpdater(measurement_model(h, R, N), **rule)
    for k, row in enumerate(z[1:], 1):
        before, now = (t0 + datetime.timedelta(seconds=n) for n in (k - 1, k))
        prior = mu @ CHAIN
        posts, logs = [], []
        for j, predictor in enumerate(predictors):
            mixed = textbook.moments(CHAIN[:, j] * mu / prior[j], means, covs)
            prediction = predictor.predict(start_state(*mixed, before), timestamp=now)
            hypothesis = SingleHypothesis(prediction, Detection(row[:, None], timestamp=now))
            posts.append(updater.update(hypothesis))
            seen = posts[-1].hypothesis.measurement_prediction
            v, S = row - np.ravel(seen.state_vector), np.asarray(seen.covar)
            logs.append(-0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * np.pi * S)[1]))
        means = [np.ravel(p.state_vector).astype(float) for p in posts]
        covs = [np.asarray(p.covar, float) for p in posts]
        mu = prior * np.exp(logs)
        mu = mu / mu.sum()
        got.append((*textbook.moments(mu, means, covs), mu))
    assert_fused(out, *(np.array(column) for column in zip(*got, strict=True)))


# --- laws


def walk(rng, rows=40, tracks=None):
    steps = rng.normal(size=(rows, 2) if tracks is None else (tracks, rows, 2))
    return np.cumsum(steps, axis=-2)


PRIOR = Prior([1.0, -2.0, 0.5, 0.7], np.diag([4.0, 9.0, 1.0, 2.0]))
QUIET, LOUD = constant_velocity(2, acceleration_density=0.02), constant_velocity(2, acceleration_density=3.0)
TWO = np.array([[0.9, 0.1], [0.3, 0.7]])
ALIKE = Estimates._fields[1:4]


@pytest.mark.parametrize("interaction", ["mix", "none", "jet"])
@pytest.mark.parametrize("motion", [constant_velocity(2), coordinated_turn(), polar_turn()], ids=["cv", "ct", "polar"])
def test_identical_modes_are_one_filter(motion, interaction):
    if interaction == "jet" and motion.own_labels:
        pytest.skip("a jet carries acceleration, not the estimate of the turn rate")
    z, times = walk(np.random.default_rng(0)) * 3, np.arange(40.0)
    single = BankEstimator(Bank((Mode("a", motion),), position(2, 1.0))).run(z, times, prior=PRIOR)
    bank = bank_of([motion] * 3, position(2, 1.0), interaction=interaction, initial_probs=tuple(MU))
    out = bank.run(z, times, prior=PRIOR)
    for field in ALIKE:
        np.testing.assert_allclose(getattr(out, field), getattr(single, field), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(out.log_likelihood, single.log_likelihood, rtol=1e-8)
    mu = MU
    for k in range(40):  # the first row is an update without a step of the chain
        mu = mu @ CHAIN if k else mu
        np.testing.assert_allclose(out.mode_probs[0, k], mu, rtol=1e-9)


@pytest.mark.parametrize("interaction", ["mix", "none", "jet", "birth"])
def test_a_chain_that_never_switches_is_a_static_bank(interaction):
    z, times = walk(np.random.default_rng(1), rows=12), np.arange(12.0)
    motions = [QUIET, coordinated_turn(), constant_acceleration(2)]
    bank = bank_of(motions, position(2, 1.0), np.eye(3), interaction=interaction, initial_probs=tuple(MU))
    out = bank.run(z, times, prior=PRIOR)
    singles = [BankEstimator(Bank((m,), position(2, 1.0))).run(z, times, prior=PRIOR) for m in bank.bank.modes]
    logs = np.log(MU) + np.cumsum([s.log_likelihood[0] for s in singles], axis=1).T
    probs = np.exp(logs - logs.max(axis=1, keepdims=True))
    probs /= probs.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(out.mode_probs[0], probs, rtol=1e-8, atol=1e-12)
    for k in range(12):
        means = np.array([np.r_[s.position[0, k], s.velocity[0, k]] for s in singles])
        mean, cov = textbook.moments(probs[k], means, np.array([s.covariance[0, k] for s in singles]))
        np.testing.assert_allclose(np.r_[out.position[0, k], out.velocity[0, k]], mean, **PEER)
        np.testing.assert_allclose(out.covariance[0, k], cov, **PEER)


@pytest.mark.parametrize("interaction", [name for name in INTERACTIONS if name != "reset"])
def test_a_missing_measurement_is_one_without_information(interaction):
    z, times = walk(np.random.default_rng(2)), np.arange(40.0)
    motions = [QUIET, coordinated_turn(), constant_acceleration(2)]
    bank = bank_of(motions, position(2, 1.0), interaction=interaction)
    R = np.tile(np.eye(2), (40, 1, 1))
    gone, vague = z.copy(), R.copy()
    gone[10:13], vague[10:13] = np.nan, 1e15 * np.eye(2)
    left, right = bank.run(gone, times, R, prior=PRIOR), bank.run(z, times, vague, prior=PRIOR)
    for field in (*ALIKE, "mode_probs"):
        # 1e15 against covariances below 1e4; the difference of log densities is below 1e-10.
        np.testing.assert_allclose(getattr(left, field), getattr(right, field), rtol=1e-7, atol=1e-7)
    for k in (10, 11, 12):
        np.testing.assert_allclose(left.mode_probs[0, k], left.mode_probs[0, k - 1] @ CHAIN, rtol=1e-12)
        assert left.status[0, k] == MISSING and left.log_likelihood[0, k] == 0.0


def test_probabilities_over_a_gap_follow_the_generator_and_a_split_gap_changes_nothing():
    rng = np.random.default_rng(3)
    z, times = walk(rng), np.cumsum(rng.uniform(0.2, 3.0, 40))
    chain = MarkovChain(generator=((-0.3, 0.2, 0.1), (0.5, -0.5, 0.0), (0.1, 0.4, -0.5)))
    motions = [QUIET, LOUD, constant_acceleration(2)]
    more, between = np.full((79, 2), np.nan), np.empty(79)
    more[::2], between[::2], between[1::2] = z, times, 0.3 * times[:-1] + 0.7 * times[1:]
    none = bank_of(motions, position(2, 1.0), chain, interaction="none")
    whole, split = none.run(z, times, prior=PRIOR), none.run(more, between, prior=PRIOR)
    for field in (*ALIKE, "mode_probs", "log_likelihood"):
        np.testing.assert_allclose(getattr(split, field)[:, ::2], getattr(whole, field), rtol=1e-9, atol=1e-9)
    mixing = bank_of(motions, position(2, 1.0), chain).run(more, between, prior=PRIOR)
    for k in range(1, 79, 2):
        wanted = mixing.mode_probs[0, k - 1] @ chain.at(between[k] - between[k - 1])
        np.testing.assert_allclose(mixing.mode_probs[0, k], wanted, rtol=1e-12)


@pytest.mark.parametrize("angle", [0.4, -2.2])
def test_turn_and_shift_the_scene_and_a_linear_bank_follows(angle):
    z = walk(np.random.default_rng(4))
    motions = [QUIET, known_turn(0.3, acceleration_density=0.1), constant_acceleration(2)]
    est = bank_of(motions, position(2, 1.5))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    here, there = est.run(z, np.arange(40.0)), est.run(z @ turn.T + [90.0, -40.0], np.arange(40.0))
    both = np.kron(np.eye(2), turn)
    np.testing.assert_allclose(there.position, here.position @ turn.T + [90.0, -40.0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(there.covariance, both @ here.covariance @ both.T, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(there.mode_probs, here.mode_probs, rtol=1e-8)
    mirror = est.run(z * [1.0, -1.0], np.arange(40.0))  # a known turn has a side: the mirror must show it
    assert np.abs(mirror.mode_probs - here.mode_probs).max() > 1e-3


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("name", RECIPES)
def test_half_a_turn_of_the_scene_flips_every_recipe(name, axes):
    # Half a turn maps sigma points onto sigma points, so even unscented modes follow to rounding.
    z = np.cumsum(np.random.default_rng(5).normal(size=(40, axes)), axis=0)
    flip, shift = np.array([-1.0, -1.0, 1.0])[:axes], np.array([64.0, -32.0, 16.0])[:axes]
    est = make_estimator(name, position(axes, 1.0), speed=2.0)
    here, there = est.run(z, np.arange(40.0)), est.run(flip * z + shift, np.arange(40.0))
    np.testing.assert_allclose(there.position, flip * here.position + shift, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(there.velocity, flip * here.velocity, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(there.mode_probs, here.mode_probs, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["kf-cv", "kf-ca", "singer", "imm"])
def test_sigma_points_where_a_matrix_would_do_change_nothing(name):
    est = make_estimator(name, position(2, 1.0), speed=3.0)
    z, times = walk(np.random.default_rng(6)), np.cumsum(np.random.default_rng(7).uniform(0.1, 2.0, 40))
    points = BankEstimator(est.bank.with_(every_sigma_point=True))
    # `imm` mixes, which amplifies the last digits a little.
    for left, right in zip(est.run(z, times), points.run(z, times), strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-9 if name == "imm" else 1e-10, atol=1e-10)


def test_a_bank_told_the_true_modes_is_the_filter_that_switches():
    rng = np.random.default_rng(8)
    z, modes = walk(rng, tracks=3), rng.integers(0, 3, size=(3, 40))
    motions = [QUIET, LOUD, known_turn(0.4, acceleration_density=0.5)]
    est = bank_of(motions, position(2, 1.0))
    hot = np.zeros((3, 40, 3, 3))
    for b in range(3):
        hot[b, range(40), :, modes[b]] = 1.0
    F, Q = np.zeros((3, 4, 4)), np.zeros((3, 4, 4))
    for j, made in enumerate(motions):
        for c in range(4):
            made.transition.function(np.eye(4)[c], 1.0, np.array(made.params), F[j, :, c])
        made.noise.function(np.zeros(4), 1.0, np.array(made.params), Q[j])
    H = np.zeros((2, 4))
    H[0, 0] = H[1, 2] = 1.0
    oracle = reference_imm.Modes(F, np.zeros((3, 4)), Q, H, np.eye(2))
    order = [0, 2, 1, 3]
    for b in range(3):
        prior = PRIOR._replace(mode_probs=np.eye(3)[modes[b, 0]])
        out = est.run(z[b], np.arange(40.0), prior=prior, mode_transition=hot[b])
        mean0, cov0 = np.array(PRIOR.mean)[order], np.asarray(PRIOR.cov)[np.ix_(order, order)]
        mean, cov = reference_imm.run_kalman(oracle, z[b : b + 1], mean0[None], cov0[None], modes[b : b + 1])
        np.testing.assert_allclose(np.hstack([out.position[0], out.velocity[0]]), mean[0][:, order], **PEER)
        np.testing.assert_allclose(out.covariance[0], cov[0][:, order][:, :, order], **PEER)
        np.testing.assert_array_equal(out.mode_probs[0], np.eye(3)[modes[b]])


def test_a_floor_keeps_every_mode_alive_and_a_sum_of_one():
    z = np.cumsum(np.full((60, 2), 3.0), axis=0)  # a straight line: the loud mode loses every time
    est = bank_of([QUIET, constant_velocity(2, acceleration_density=1e4)], position(2, 1.0), np.eye(2), min_prob=1e-4)
    probs = est.run(z, np.arange(60.0)).mode_probs[0]
    assert probs[-1, 1] == pytest.approx(1e-4, rel=1e-3)
    np.testing.assert_allclose(probs.sum(axis=1), 1.0, rtol=1e-14)


def test_extreme_likelihoods_neither_under_nor_overflow():
    est = bank_of([QUIET, LOUD], position(2, 1e-6), TWO, initial_probs=(0.5, 0.5))
    prior = Prior(np.zeros(4), 1e-12 * np.eye(4))
    out = est.run([[0.0, 0.0], [5.0, 5.0], [10.0, 10.0]], np.arange(3.0), prior=prior)
    assert np.isfinite(out.log_likelihood).all() and out.mode_probs[0, 1, 1] > 0.99
    near = bank_of([QUIET, LOUD], position(2, 1e-9), TWO).run(np.zeros((3, 2)), np.arange(3.0))
    assert np.isfinite(near.log_likelihood).all() and np.isfinite(near.mode_probs).all()


# --- forecast


def test_forecast_weighs_modes_as_they_are_or_as_the_chain_will_have_them():
    chain = MarkovChain(generator=((-0.3, 0.3), (0.2, -0.2)))
    est = bank_of([QUIET, constant_acceleration(2)], position(2, 1.0), chain)
    singles = [BankEstimator(Bank((mode,), position(2, 1.0))) for mode in est.bank.modes]
    state = est.start(walk(np.random.default_rng(9)), np.arange(40.0))
    horizon, parts = 2.0, []
    for j, single in enumerate(singles):
        n = single.bank.modes[0].motion.size
        prior = Prior([state.mean[0, j, :n]], [state.cov[0, j, :n, :n]], includes_first=True)
        parts.append(single.forecast(single.start([0.0, 0.0], 0.0, prior=prior), horizon))
    means, covs = (np.array(column) for column in zip(*parts, strict=True))
    mu = state.mode_probs[0]
    for weights, wanted in (("W1", mu), ("W2", mu @ chain.at(horizon))):
        for got, expected in zip(
            est.forecast(state, horizon, weights=weights), textbook.moments(wanted, means, covs), strict=True
        ):
            np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-12)
    split = est.forecast(state, horizon, weights="W2", steps=8)
    np.testing.assert_allclose(split[0], textbook.moments(mu @ chain.at(horizon), means, covs)[0], rtol=1e-10)
    per_step = BankEstimator(est.bank.with_(chain=MarkovChain.per_step(TWO)))
    stepped = per_step.forecast(state, horizon, weights="W2", steps=3)[0]
    np.testing.assert_allclose(
        stepped, textbook.moments(mu @ np.linalg.matrix_power(TWO, 3), means, covs)[0], rtol=1e-10
    )
    np.testing.assert_allclose(est.forecast(state, 0.0)[0], state.kin_mean[0, :2], rtol=1e-13)
    np.testing.assert_allclose(est.forecast(state, 0.0)[1], state.kin_cov[0, :2, :2], rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"horizon": -1.0}, "horizon"),
        ({"horizon": np.inf}, "horizon"),
        ({"horizon": 1.0, "weights": "W3"}, "W1"),
        ({"horizon": 1.0, "steps": 0}, "steps"),
    ],
)
def test_forecasts_that_make_no_sense_are_refused(options, words):
    est = make_estimator("kf-cv", position(2, 1.0))
    with pytest.raises(ValueError, match=f"^forecast: .*{words}"):
        est.forecast(est.start([0.0, 0.0], 0.0), **options)


# --- interactions by hand: a step of no time without a measurement leaves the mixed states


CV, CA = constant_velocity(2), constant_acceleration(2, acceleration_sd=0.8)
CT = coordinated_turn(rate=0.1, rate_sd=0.2, speed_floor=1.0)
UNLIKE = [CV, CA, CT]


def states_of(motions, rng):
    means = [rng.normal(size=m.size) * 2 + 1 for m in motions]
    for mean, made in zip(means, motions, strict=True):
        if made is CT:
            mean[4] = 0.3
    return means, [spd(rng, m.size, 0.3) for m in motions]


def mixed(motions, interaction, means, covs, probs=MU, matrix=CHAIN, **options):
    """``(prior probabilities, [(mean, cov)] per mode)`` after the interaction alone."""
    est = bank_of(motions, position(2, 1.0), matrix, interaction=interaction, **options)
    state = est.start([0.0, 0.0], 0.0, prior=Prior(means, covs, includes_first=True, mode_probs=probs))
    after, _ = est.step(state, [np.nan, np.nan], 0.0)
    parts = [(after.mean[0, j, : m.size], after.cov[0, j, : m.size, : m.size]) for j, m in enumerate(motions)]
    return after.mode_probs[0], parts


def gathered(p, q, means, covs, motions, carry, own=None):
    """State of mode q in components of p: `carry` from q, others from `own` (or p), no cross terms."""
    labels, old = motions[p].labels, motions[q].labels
    mean, cov = (np.array(a) for a in own or (means[p], covs[p]))
    known = [i for i, label in enumerate(labels) if label in carry and label in old]
    other = [i for i in range(len(labels)) if i not in known]
    source = [old.index(labels[i]) for i in known]
    mean[known] = means[q][source]
    cov[np.ix_(known, other)] = cov[np.ix_(other, known)] = 0.0
    cov[np.ix_(known, known)] = covs[q][np.ix_(source, source)]
    return mean, cov


def assert_mixture(parts, converted, probs=MU, matrix=CHAIN, **tolerance):
    prior = probs @ matrix
    for p, (mean, cov) in enumerate(parts):
        weights = matrix[:, p] * probs / prior[p]
        sources = [converted(p, q) for q in range(len(parts))]
        wanted = textbook.moments(weights, [m for m, _ in sources], [c for _, c in sources])
        np.testing.assert_allclose(mean, wanted[0], **tolerance or PEER)
        np.testing.assert_allclose(cov, wanted[1], **tolerance or PEER)


@pytest.mark.parametrize("seed", [0, 1])
def test_mix_fills_what_a_mode_does_not_know_from_the_receiver(seed):
    means, covs = states_of(UNLIKE, np.random.default_rng(seed))
    probs, parts = mixed(UNLIKE, "mix", means, covs)
    np.testing.assert_allclose(probs, MU @ CHAIN, rtol=1e-13)
    assert_mixture(parts, lambda p, q: gathered(p, q, means, covs, UNLIKE, UNLIKE[p].labels))


@pytest.mark.parametrize("seed", [0, 1])
def test_birth_carries_kinematics_and_draws_the_rest_afresh(seed):
    means, covs = states_of(UNLIKE, np.random.default_rng(seed))
    _, parts = mixed(UNLIKE, "birth", means, covs)

    def born(p, q):
        made = UNLIKE[p]
        if p == q:
            return means[p], covs[p]
        mean, cov = np.zeros(made.size), np.zeros((made.size, made.size))
        own = [made.labels.index(label) for label in made.own_labels]
        mean[own] = made.birth_mean
        cov[own, own] = np.square(made.birth_sd)
        return gathered(p, q, means, covs, UNLIKE, made.kinematic_labels, (mean, cov))

    assert_mixture(parts, born)


def jet_of(made, x):
    """Position, velocity, acceleration of a state of CA or CT."""
    if made is CA:
        return np.r_[x[[0, 3]], x[[1, 4]], x[[2, 5]]]
    v, w = x[[1, 3]], x[4]
    return np.r_[x[[0, 2]], v, -w * v[1], w * v[0]]


def state_of(made, jet):
    p, v, a = jet[:2], jet[2:4], jet[4:]
    if made is CA:
        return np.array([p[0], v[0], a[0], p[1], v[1], a[1]])
    return np.array([p[0], v[0], p[1], v[1], (v[0] * a[1] - v[1] * a[0]) / max(v @ v, 1.0)])


@pytest.mark.parametrize("others", [(), (circle(),)], ids=["", "beside-a-motion-of-more-constants"])
@pytest.mark.parametrize("seed", [0, 1])
def test_jet_carries_acceleration_where_both_states_have_one(seed, others):
    rng = np.random.default_rng(seed)
    means, covs = states_of(UNLIKE, rng)
    means[1][[1, 4]] *= 0.05  # slow: below the floor of the speed that a turn rate is divided by
    matrix, probs = np.eye(3 + len(others)), np.r_[MU, np.zeros(len(others))]
    matrix[:3, :3] = CHAIN
    motions = [*UNLIKE, *others]
    for made in others:
        means.append(np.array([0.0, 0.0, 5.0, 0.1, 0.2]))
        covs.append(0.01 * np.eye(made.size))
    _, parts = mixed(motions, "jet", means, covs, probs, matrix)

    def converted(p, q):
        if p == q:
            return means[p], covs[p]
        if CV in (UNLIKE[p], UNLIKE[q]):  # no acceleration to carry
            return gathered(p, q, means, covs, UNLIKE, UNLIKE[p].kinematic_labels)
        # The unscented transform also draws the receiver's own parameters, which the jet then replaces.
        own = [UNLIKE[p].labels.index(label) for label in UNLIKE[p].own_labels]
        n, joint = len(means[q]), np.r_[means[q], means[p][own]]
        cov = np.zeros((joint.size, joint.size))
        cov[:n, :n], cov[n:, n:] = covs[q], covs[p][np.ix_(own, own)]
        return textbook.transform(lambda x: state_of(UNLIKE[p], jet_of(UNLIKE[q], x[:n])), joint, cov)[:2]

    # The package differentiates velocity numerically over 1 ms: 1e-6 relative, and 1e-13 / 1e-3 of rounding.
    assert_mixture(parts[:3], converted, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("interaction", ["none", "reset"])
def test_separate_filters_keep_their_own_state(interaction):
    means, covs = states_of(UNLIKE, np.random.default_rng(2))
    probs, parts = mixed(UNLIKE, interaction, means, covs)
    np.testing.assert_allclose(probs, MU @ CHAIN, rtol=1e-13)
    for j, (mean, cov) in enumerate(parts):
        np.testing.assert_allclose(mean, means[j], rtol=1e-13)
        np.testing.assert_allclose(cov, covs[j], rtol=1e-12, atol=1e-13)


def test_reset_begins_a_lost_mode_again_from_the_best():
    lost = Prior(
        [np.array([0.0, 0, 0, 0]), np.array([500.0, 0, 0, 500.0, 0, 0])],
        [np.eye(4), np.eye(6)],
        includes_first=True,
        mode_probs=[0.5, 0.5],
    )
    after = {}
    for interaction in ("none", "reset"):
        est = bank_of([CV, CA], position(2, 1.0), TWO, interaction=interaction, min_prob=1e-6, reset_prob=1e-3)
        state = est.start([0.0, 0.0], 0.0, prior=lost)
        after[interaction], _ = est.step(state, [0.3, -0.2], 1.0)
    none, reset = after["none"], after["reset"]
    np.testing.assert_array_equal(reset.mean[0, 0], none.mean[0, 0])
    np.testing.assert_allclose(reset.mean[0, 1, [0, 3, 1, 4]], reset.mean[0, 0, [0, 2, 1, 3]], atol=1e-9)
    np.testing.assert_allclose(reset.mean[0, 1, [2, 5]], CA.birth_mean, atol=1e-9)
    np.testing.assert_allclose(np.diag(reset.cov[0, 1])[[2, 5]], np.square(CA.birth_sd), rtol=1e-9)
    assert abs(none.mean[0, 1, 0] - 0.3) > 50.0


def test_a_start_of_an_unlike_state_is_its_unscented_assembly():
    made = polar_turn(rate=0.1, rate_sd=0.2)
    est = BankEstimator(Bank((Mode("polar", made),), position(2, 1.0)))
    kin, P = np.array([3.0, -2.0, -8.0, 0.5]), spd(np.random.default_rng(3), 4, 0.5)
    state = est.start([0.0, 0.0], 0.0, prior=Prior(kin, P, includes_first=True))

    def assemble(x):
        heading = np.arctan2(x[3], x[2])
        return np.array([x[0], x[1], np.hypot(x[2], x[3]), heading % (2 * np.pi), x[4]])  # no seam near pi

    cov = np.zeros((5, 5))
    cov[:4, :4], cov[4, 4] = P, 0.04
    mean, spread, _ = textbook.transform(assemble, np.r_[kin, 0.1], cov)
    np.testing.assert_allclose(
        np.r_[state.mean[0, 0, :3], state.mean[0, 0, 3] % (2 * np.pi), state.mean[0, 0, 4]], mean, **PEER
    )
    np.testing.assert_allclose(state.cov[0, 0, :5, :5], spread, **PEER)

    # What is reported is the start itself, not what a detour through heading and speed makes of it.
    np.testing.assert_array_equal(state.kin_mean[0], kin)
    np.testing.assert_array_equal(state.kin_cov[0], P)


def test_a_state_of_another_bank_is_refused():
    sensor = position(axes=2, sigma=1.0)
    state = make_estimator("imm", sensor=sensor).start([0.0, 0.0], 0.0)
    other = make_estimator("intent-imm", sensor=sensor)
    with pytest.raises(ValueError, match="state must come from"):
        other.step(state, [1.0, 0.0], 1.0)
    with pytest.raises(ValueError, match="state must come from"):
        other.forecast(state, 1.0)


def test_one_wild_measurement_is_forgotten_by_the_status():
    z = np.random.default_rng(0).normal(size=(120, 2))
    z[50] = 1e6
    status = make_estimator("kf-cv", sensor=position(axes=2, sigma=1.0)).run(z, np.arange(120.0)).status[0]
    assert status[50] == DIVERGED
    assert (status[80:] == OK).all()


def test_birth_into_a_state_without_cartesian_components_draws_its_own_afresh():
    rng = np.random.default_rng(4)
    made = [CV, polar_turn(rate=0.1, rate_sd=0.2)]
    means = [np.array([1.0, 6.0, 2.0, 3.0]), np.array([0.5, 1.0, 7.0, 0.4, -0.9])]
    covs = [spd(rng, 4, 0.2), spd(rng, 5, 0.05)]
    _, parts = mixed(made, "birth", means, covs, np.array([0.6, 0.4]), TWO)

    def assemble(x):
        return np.array([x[0], x[2], np.hypot(x[1], x[3]), np.arctan2(x[3], x[1]), x[4]])

    cov = np.zeros((5, 5))
    cov[:4, :4], cov[4, 4] = covs[0], 0.04
    born = textbook.transform(assemble, np.r_[means[0], 0.1], cov)[:2]
    weights = TWO[:, 1] * [0.6, 0.4] / (np.array([0.6, 0.4]) @ TWO)[1]
    wanted = textbook.moments(weights, [born[0], means[1]], [born[1], covs[1]])
    np.testing.assert_allclose(parts[1][0], wanted[0], **PEER)
    np.testing.assert_allclose(parts[1][1], wanted[1], **PEER)


def test_angles_mix_the_short_way_round():
    made = [polar_turn(), polar_turn(speed_density=5.0)]
    means = [np.array([0.0, 0, 5, np.pi - 0.1, 0]), np.array([0.0, 0, 5, -np.pi + 0.1, 0])]
    _, parts = mixed(made, "mix", means, [0.01 * np.eye(5)] * 2, [0.5, 0.5], np.full((2, 2), 0.5))
    for mean, cov in parts:
        assert np.cos(mean[3]) == pytest.approx(-1.0, abs=1e-12)
        assert cov[3, 3] == pytest.approx(0.01 + 0.1**2, rel=1e-9)


def flight(axes=2, rows=60):
    """Straight, turning, straight; one metre of noise, 1 s apart."""
    rate = np.where((np.arange(rows) > 20) & (np.arange(rows) < 40), 0.15, 0.0)
    heading = np.cumsum(rate)
    v = 12 * np.column_stack([np.cos(heading), np.sin(heading), np.full(rows, 0.1)])[:, :axes]
    truth = np.cumsum(v, axis=0)
    return truth, truth + np.random.default_rng(10).normal(size=truth.shape)


@pytest.mark.parametrize("interaction", INTERACTIONS)
@pytest.mark.parametrize("axes", [2, 3])
def test_motions_without_cartesian_components_share_a_bank(axes, interaction):
    truth, z = flight(axes)
    quiet = constant_velocity(axes, acceleration_density=0.05)
    motions = [quiet, polar_turn(), circle(), weave()] if axes == 2 else [quiet, helix(), spatial_turn()]
    rates = MarkovChain.from_sojourns([20.0] * len(motions))
    est = bank_of(motions, position(axes, 1.0), rates, interaction=interaction, speed=12.0, min_prob=1e-6)
    out = est.run(z, np.arange(60.0))
    for field in out:
        assert np.isfinite(field).all()
    np.testing.assert_allclose(out.mode_probs.sum(axis=-1), 1.0, rtol=1e-12)
    # The circle through a position of unknown heading is no Gaussian: its start says little, and says so.
    error = np.linalg.norm(out.position[0] - truth, axis=1)[1:]
    alone = BankEstimator(Bank((Mode("cv", quiet),), position(axes, 1.0), speed=12.0)).run(z, np.arange(60.0))
    worst_alone = np.linalg.norm(alone.position[0] - truth, axis=1)[1:].max()
    assert not (out.status == DIVERGED).any()
    assert error.max() < max(6.0, worst_alone)
    if interaction in ("birth", "jet"):
        assert error[21:41].mean() < 0.6 * np.linalg.norm(alone.position[0] - truth, axis=1)[22:42].mean()
        assert out.mode_probs[0, 28:38, 0].mean() < 0.2 < out.mode_probs[0, 8:20, 0].mean()


def test_small_alpha_beside_states_of_other_sizes_stays_sound():
    # Scratch rows are shared between modes and weights are 1e6 here: what a larger state leaves in padding of
    # a smaller one must not grow.
    truth, z = flight()
    motions = [polar_turn(), CT, CA, CV]
    est = bank_of(motions, position(2, 1.0), MarkovChain.from_sojourns([9.0] * 4), alpha=1e-3, speed=10.0)
    out = est.run(z, np.arange(60.0))
    assert not (out.status == DIVERGED).any()
    assert np.linalg.norm(out.position[0] - truth, axis=1).max() < 4.0


# --- contract of every recipe and every interaction


def scenes():
    """Name -> (sensor, measurements (B, T, D), times, noise, sensor_states), with gaps, irregular."""
    rng = np.random.default_rng(11)
    rows, tracks = 30, 3
    drift, origin = np.array([4.0, 1.0, 0.3]), np.array([60.0, 20.0, 30.0])
    path = np.cumsum(rng.normal(size=(tracks, rows, 3)) + drift, axis=1) + origin
    times = np.cumsum(rng.choice([0.0, 0.3, 1.0, 2.0], size=(tracks, rows)), axis=1)
    own = np.concatenate([0.1 * times[..., None] * [1.0, 2.0, 0.5], np.tile([0.1, 0.2, 0.05], (tracks, rows, 1))], -1)
    flat, d = path[..., :2], path - own[..., :3]
    ground = np.hypot(d[..., 0], d[..., 1])
    polar = np.stack([ground, np.arctan2(d[..., 1], d[..., 0])], -1)
    sphere = np.stack([np.linalg.norm(d, axis=-1), polar[..., 1], np.arctan2(d[..., 2], ground)], -1)
    out = {}
    for name, sensor, z, states in (
        ("flat", position(2, 1.0), flat, None),
        ("space", position(3, 1.0), path, None),
        ("radar", range_bearing((0.8, 0.02)), polar, np.ascontiguousarray(own[..., [0, 1, 3, 4]])),
        ("radar-3d", range_bearing_elevation((0.8, 0.02, 0.02)), sphere, own),
    ):
        z = z + rng.normal(size=z.shape) * sensor.sigma
        z[0, 5:8] = np.nan
        z[1, 9, 0] = np.nan
        z[2, 20, -1] = np.nan
        scale = rng.uniform(0.5, 2.0, (tracks, rows, 1, 1))
        out[name] = (sensor, z, times, sensor.noise * scale, states)
    return out


SCENES = scenes()
ESTIMATORS = {
    **{name: (lambda sensor, name=name: make_estimator(name, sensor, speed=5.0)) for name in RECIPES},
    **{
        f"imm-{rule}": (
            lambda sensor, rule=rule: BankEstimator(
                make_estimator("imm", sensor, speed=5.0).bank.with_(interaction=rule)
            )
        )
        for rule in INTERACTIONS
        if rule != "mix"
    },
}
both = pytest.mark.parametrize("scene", SCENES), pytest.mark.parametrize("name", ESTIMATORS)


def every(function):
    for mark in both:
        function = mark(function)
    return function


@every
def test_what_comes_out_has_its_shape_and_what_goes_in_stays(name, scene):
    sensor, z, times, noise, states = SCENES[scene]
    est, given = ESTIMATORS[name](sensor), [a if a is None else a.copy() for a in (z, times, noise, states)]
    out = est.run(*given)
    for before, after in zip((z, times, noise, states), given, strict=True):
        np.testing.assert_array_equal(before, after)
    B, T, A, M = 3, 30, sensor.axes, len(est.modes)
    shapes = [(B, T), (B, T, A), (B, T, A), (B, T, 2 * A, 2 * A), (B, T, M), (B, T), (B, T), (B, T), (B, T)]
    for field, value, shape in zip(out._fields, out, shapes, strict=True):
        assert value.shape == shape, field
        assert value.dtype == {"nis_dof": np.int64, "status": np.int8}.get(field, np.float64)
        assert np.isfinite(value).all(), field
    np.testing.assert_allclose(out.mode_probs.sum(axis=-1), 1.0, rtol=1e-12)
    # Fused covariances are sums of outer products; entry by entry they agree to the last digits.
    np.testing.assert_allclose(out.covariance, np.swapaxes(out.covariance, -1, -2), rtol=1e-9, atol=1e-9)
    assert (np.linalg.eigvalsh(out.covariance) > 0).all()
    gone = np.isnan(z).all(axis=-1)
    np.testing.assert_array_equal(out.status == MISSING, gone & (out.status != STARTING))
    used = out.status == OK
    np.testing.assert_array_equal(out.nis_dof[used], np.isfinite(z).sum(axis=-1)[used])
    assert (out.nis[used] > 0).all() and used.mean() > 0.8
    for left, right in zip(est.run(*given), out, strict=True):
        np.testing.assert_array_equal(left, right)


@every
def test_run_is_a_loop_of_step_and_a_batch_is_its_tracks(name, scene):
    sensor, z, times, noise, states = SCENES[scene]
    est = ESTIMATORS[name](sensor)
    out = est.run(z, times, noise, states)
    strange = z.copy()
    strange[1] = np.nan
    strange[2] *= 1e6  # the neighbours of track 0 change beyond recognition
    for left, right in zip(est.run(strange, times, noise, states), out, strict=True):
        np.testing.assert_array_equal(left[0], right[0])
    for b in range(3):
        own = None if states is None else states[b]
        single = est.run(z[b], times[b], noise[b], own)
        for left, right in zip(single, out, strict=True):
            np.testing.assert_array_equal(left[0], right[b])
        first = int(np.argmax(out.status[b] != STARTING))
        begun = int(np.flatnonzero(out.status[b] == STARTING).max(initial=0)) if first else 0
        head = slice(0, begun + 1)
        state = est.start(z[b, head], times[b, head], noise[b, head], None if own is None else own[head])
        for k in range(begun + 1, 30):
            frozen = [field.copy() for field in state]
            following, estimate = est.step(state, z[b, k], times[b, k], noise[b, k], None if own is None else own[k])
            for left, right in zip(state, frozen, strict=True):
                np.testing.assert_array_equal(left, right)
            for left, right in zip(estimate, out, strict=True):
                np.testing.assert_array_equal(left, right[b, k])
            state = following


@pytest.mark.parametrize("name", ESTIMATORS)
def test_threads_change_nothing(name):
    rng = np.random.default_rng(12)
    z, times = walk(rng, rows=60, tracks=80) * 2, np.arange(60.0)
    one, two = ESTIMATORS[name](position(2, 1.0)), ESTIMATORS[name](position(2, 1.0))
    one.threads, two.threads = 1, 2
    for left, right in zip(one.run(z, times), two.run(z, times), strict=True):
        np.testing.assert_array_equal(left, right)
    seen = []
    for left, right in zip(two.run(z, times, progress=seen.append), one.run(z, times), strict=True):
        np.testing.assert_array_equal(left, right)
    assert sum(seen) == 80 * 60


def test_padding_rows_do_nothing_and_lengths_end_a_track():
    sensor, z, times, noise, _ = SCENES["flat"]
    est = ESTIMATORS["imm"](sensor)
    lengths = np.array([30, 17, 0])
    junk = z.copy()
    junk[1, 17:], junk[2] = 1e9, -1e9
    late = times.copy()
    late[1, 17:] = late[1, 16]
    out = est.run(junk, late, noise, lengths=lengths)
    whole = est.run(z, times, noise)
    short = est.run(z[1, :17], times[1, :17], noise[1, :17])
    for field in Estimates._fields[1:]:
        np.testing.assert_array_equal(getattr(out, field)[0], getattr(whole, field)[0])
        np.testing.assert_array_equal(getattr(out, field)[1, :17], getattr(short, field)[0])
    assert (out.status[1, 17:] == MISSING).all() and (out.status[2] == MISSING).all()
    assert (out.nis_dof[1, 17:] == 0).all()


def test_bearings_alone_start_late_and_then_step_like_they_run():
    rows = np.arange(40.0)
    own = np.column_stack([4 * rows, 60 * np.sin(rows / 6), np.full(40, 4.0), 10 * np.cos(rows / 6)])
    target = np.column_stack([100 - rows, 80 + 0.5 * rows])
    d = target - own[:, :2]
    z = np.arctan2(d[:, 1], d[:, 0])[:, None] + 0.005 * np.random.default_rng(13).normal(size=(40, 1))
    est = make_estimator("imm", bearing(0.005), acceleration=0.05, speed=2.0, sojourn=20.0)
    out = est.run(z, rows, sensor_states=own)
    begun = int(np.flatnonzero(out.status[0] == STARTING).max())
    assert 0 < begun < 25
    state = est.start(z[: begun + 1], rows[: begun + 1], sensor_states=own[: begun + 1])
    for k in range(begun + 1, 40):
        state, estimate = est.step(state, z[k], rows[k], sensor_state=own[k])
        for left, right in zip(estimate, out, strict=True):
            np.testing.assert_array_equal(left, right[0, k])
    assert np.linalg.norm(out.position[0, -1] - target[-1]) < 15.0


# --- without compilation


def test_plain_python_gives_the_same_numbers():
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, short_track.__file__], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    plain, compiled = json.loads(done.stdout), short_track.numbers()
    assert plain.keys() == compiled.keys()
    for key, fields in plain.items():
        for left, right in zip(fields, compiled[key], strict=True):
            np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-9, err_msg=key)
