"""What a bank of noise levels says about noise and trust, in calm data, after jumps, and across a restart."""

import numpy as np
import pytest

from jink.estimators.adaptive_estimator import AdaptiveEstimator
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.joint import joint_bank, level_chain
from jink.estimators.motions import constant_velocity
from jink.estimators.oracles import oracle
from jink.estimators.recipes import RECIPES, Scales, intent_imm, kf_cv, make_estimator, robust_imm
from jink.estimators.sensors import position
from jink.estimators.status import DIVERGED, MISSING, OK, STARTING
from jink.estimators.treatments import Adaptive, HeavyTails, Level

SENSOR = position(2, 1.0)
SCALES = Scales(acceleration=1.0, speed=20.0)
ROWS, JUMP = 200, 100


def estimator(name, **options):
    return make_estimator(name, SENSOR, acceleration=1.0, speed=20.0, **options)


def straight(seed, dt=1.0, tracks=8, rows=ROWS):
    """Straight at 22 m/s with the told noise: truth, measurements, times."""
    times = dt * np.arange(rows)
    truth = np.tile(np.stack([20.0 * times, 10.0 * times], axis=1), (tracks, 1, 1))
    return truth, truth + np.random.default_rng(seed).normal(size=truth.shape), times


def jumped(seed, size, tracks=8):
    truth, z, times = straight(seed, tracks=tracks)
    jump = np.where(np.arange(ROWS) >= JUMP, size, 0.0)[:, None] * [1.0, 0.0]
    return truth + jump, z + jump, times


def distance(estimates, truth):
    return np.linalg.norm(estimates.position - truth, axis=2)


@pytest.mark.parametrize(("dt", "surging"), [(0.1, 0.02), (1.0, 0.04), (4.0, 0.06), (10.0, 0.08)])
def test_calm_is_called_calm_and_consistent_at_any_interval(dt, surging):
    _, z, times = straight(0, dt)
    joint = estimator("joint-imm")
    run = joint.run(z, times)
    never = estimator("joint-imm", surge_every=1e9).run(z, times)
    # What the intents expect and a straight target does not do lowers both; levels alone may take a tenth or so.
    assert 0.8 < run.nis[:, 20:].sum() / never.nis[:, 20:].sum() < 1.02
    bank = kf_cv(SENSOR, Scales(acceleration=1e-3, speed=20.0))
    one = BankEstimator(joint_bank(bank)).run(z, times)
    # 2880 components: 0.026 in one standard deviation.
    assert 0.85 < one.nis[:, 20:].sum() / one.nis_dof[:, 20:].sum() < 1.12
    assert joint.surge_probability(run)[:, 20:].mean() < surging


def test_the_nis_of_levels_has_mean_one_where_the_bank_is_true():
    """One step from the prior: levels drawn from the chain's shares, then noise."""
    rng = np.random.default_rng(1)
    levels = (1.0, 16.0, 256.0)
    bank = joint_bank(kf_cv(SENSOR, SCALES), levels)
    shares = level_chain(levels).stationary()
    tracks = 20000
    scale = rng.choice(levels, p=shares, size=tracks)
    place = rng.normal(size=(tracks, 2))
    z = place + np.sqrt(scale)[:, None] * rng.normal(size=(tracks, 2))
    prior = Prior(np.zeros(4), np.diag([1.0, 1.0, 25.0, 25.0]))
    run = BankEstimator(bank).run(z[:, None], [0.0], prior=prior)
    # Of a chi-square with two degrees of freedom over 20000 tracks: 0.007 in one standard deviation.
    assert abs(run.nis.mean() / 2.0 - 1.0) < 0.035
    mistaken = BankEstimator(bank.with_(sensor=position(2, 0.8))).run(z[:, None], [0.0], prior=prior)
    assert mistaken.nis.mean() / 2.0 > 1.1


def test_surges_raise_the_noise_and_not_the_nis():
    _, z, times = straight(2, 0.5)
    z[:, 80:120] += 20.0 * np.random.default_rng(3).normal(size=(8, 40, 2))
    joint = estimator("joint-imm", surge_for=5.0)
    run = joint.run(z, times)
    loud = slice(85, 120)
    assert joint.surge_probability(run)[:, loud].mean() > 0.85
    assert 0.6 < run.nis[:, loud].mean() / 2.0 < 1.5


def test_the_chain_of_levels_can_be_set():
    seldom = level_chain(calm=200.0, surge=1.0, back=1.0).stationary()
    assert seldom[0] == pytest.approx(200.0 / 201.0)
    assert level_chain().stationary()[0] > 0.9
    asked = estimator("joint-imm", surge_every=200.0, surge_for=4.0).bank
    expected = joint_bank(intent_imm(SENSOR, SCALES), calm=200.0, surge=4.0)
    np.testing.assert_array_equal(asked.chain.rates, expected.chain.rates)
    with pytest.raises(ValueError, match="Scales: surge_for must be > 0"):
        estimator("joint-imm", surge_for=0.0)


@pytest.mark.parametrize("name", ["imm", "joint-imm"])
@pytest.mark.parametrize("size", [1e4, 1e6])
def test_a_jump_leaves_no_turn_of_many_circles_per_row(name, size):
    """A turn rate thrown to 2 pi k per row explains every position: such a track never came back."""
    truth, z, times = jumped(1, size)
    run = estimator(name).run(z, times)
    assert distance(run, truth)[:, JUMP + 60 :].max() < 8.0  # sigma is 1 m


def test_beyond_the_highest_level_the_target_is_called_lost_at_once():
    truth, z, times = jumped(2, 1e6)
    run = estimator("joint-imm").run(z, times)
    wrong = distance(run, truth)[:, JUMP] > 1000.0
    assert wrong.all()
    assert (run.status[:, JUMP] == DIVERGED).all()
    assert (run.status[:, 5:JUMP] == OK).all()


def test_asking_for_restarts_hides_no_divergence():
    _, z, times = jumped(3, 60.0)
    bank = kf_cv(SENSOR, Scales(acceleration=0.05, speed=20.0))
    plain = BankEstimator(bank).run(z, times).status == DIVERGED
    asked = BankEstimator(bank.with_(restart=True)).run(z, times).status == DIVERGED
    assert plain.sum() > 8
    assert (asked | ~plain)[:, : JUMP + 6].all()  # until it begins again


@pytest.mark.parametrize("name", ["sage-husa", "vb-noise"])
def test_the_smoother_takes_a_restart_for_a_new_start(name):
    truth, z, times = jumped(4, 500.0)
    judge = estimator(name)
    filtered, smoothed = judge.run(z, times), judge.smooth(z, times)
    assert (filtered.status == DIVERGED).any(axis=1).all()
    assert distance(smoothed, truth)[:, :JUMP].max() < 4.0
    before = slice(20, JUMP - 10)
    assert distance(smoothed, truth)[:, before].mean() < 0.9 * distance(filtered, truth)[:, before].mean()


def test_a_track_with_nothing_measured_never_started():
    z = np.full((2, 6, 2), np.nan)
    z[1] = np.arange(12.0).reshape(6, 2)
    run = estimator("kf-cv").run(z, np.arange(6.0), lengths=[4, 6])
    assert (run.status[0, :4] == STARTING).all()
    assert (run.status[0, 4:] == MISSING).all()


def test_who_learns_the_noise_is_run_by_who_learns():
    for name in ("sage-husa", "vb-noise"):
        bank = RECIPES[name](SENSOR, SCALES)
        with pytest.raises(ValueError, match="BankEstimator: bank must not learn its noise"):
            BankEstimator(bank)
        assert isinstance(estimator(name), AdaptiveEstimator)
        AdaptiveEstimator(bank)
    with pytest.raises(ValueError, match="Bank: learns_noise must be True or False; got 1"):
        kf_cv(SENSOR, SCALES).with_(learns_noise=1)


def test_an_oracle_takes_the_joint_bank_apart():
    _, z, times = straight(5, tracks=2, rows=30)
    noise = 4.0 * np.eye(2)
    bank = intent_imm(SENSOR, SCALES).with_(initial_probs=(0.4, 0.3, 0.2, 0.1))
    whole, part = oracle(joint_bank(bank), z, times, noise=noise), oracle(bank, z, times, noise=noise)
    assert whole.mode_probs.shape == part.mode_probs.shape
    np.testing.assert_allclose(whole.position, part.position, atol=1e-9)
    np.testing.assert_allclose(whole.mode_probs, part.mode_probs, atol=1e-9)
    mixed = joint_bank(bank)
    shuffled = mixed.with_(modes=mixed.modes[::-1], shared=False, chain=mixed.chain.__class__(mixed.chain.generator))
    with pytest.raises(ValueError, match="untreated: bank must have one mode per intent, or come from joint_bank"):
        oracle(shuffled, z, times)


@pytest.mark.parametrize("name", ["robust-imm", "student-t-imm", "imm"])
def test_readings_of_levels_need_levels(name):
    one = estimator(name)
    run = one.run(np.zeros((5, 2)), np.arange(5.0))
    for reading in (one.surge_probability, one.noise_scale):
        with pytest.raises(ValueError, match="bank must have several noise levels; got"):
            reading(run)
    with pytest.raises(ValueError, match=r"surge_probability: mode_probs must have shape .* got NoneType"):
        estimator("joint-imm").surge_probability(None)


PLAIN = kf_cv(SENSOR, SCALES)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: joint_bank(PLAIN, (1.0, 0.25, 16.0)), "joint_bank: levels must begin with the lowest, which is calm"),
        (lambda: level_chain((4.0, 1.0)), "level_chain: levels must begin with the lowest"),
        (lambda: joint_bank(joint_bank(PLAIN)), "joint_bank: bank must have no noise levels yet; got mode cv 1R"),
        (lambda: joint_bank(robust_imm(SENSOR, SCALES)), "as levels last for seconds; got one matrix per step"),
        (lambda: level_chain(back=True), "level_chain: back must be in [0, 1]; got True"),
        (lambda: robust_imm(SENSOR, SCALES, factors=()), "robust_imm: factors must be one or more distinct names"),
        (lambda: robust_imm(SENSOR, SCALES, factors="mr"), "robust_imm: factors must be one or more distinct names"),
        (lambda: Mode("a", constant_velocity(2), [Level(2.0)]), "must be one treatment or a tuple; got a list"),
    ],
)
def test_refusals(make, sentence):
    with pytest.raises(ValueError, match="got") as error:
        make()
    assert sentence in str(error.value)


def test_numbers_of_numpy_are_numbers_and_tails_go_with_levels():
    chain = level_chain(back=np.float32(0.5))
    np.testing.assert_allclose(chain.rates, level_chain(back=0.5).rates)
    bank = joint_bank(Bank((Mode("cv", constant_velocity(2), HeavyTails(5.0)),), SENSOR), (1.0, 100.0))
    assert [len(mode.treatments) for mode in bank.modes] == [2, 2]
    assert Mode("a", constant_velocity(2), (Adaptive(), Level(2.0))).noise_scale == 2.0
