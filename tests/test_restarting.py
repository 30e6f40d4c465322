"""Banks that judge their own noise: whether they notice that the target is lost, and how they come back."""

import subprocess
import sys

import numpy as np
import pytest

from jink.estimators.adaptive_estimator import METHODS, AdaptiveEstimator, NoiseAdaptation
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.joint import joint_bank
from jink.estimators.motions import constant_velocity
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position, range_bearing
from jink.estimators.status import DIVERGED
from jink.estimators.treatments import Adaptive, BoundedTails, HeavyTails

CV = constant_velocity(2, acceleration_density=1.0)
JUMP, ROWS, DT = 40, 120, 0.1
TIMES = DT * np.arange(ROWS)


def single(treatment=None, sensor=None, **options):
    return Bank((Mode("cv", CV, treatment),), sensor or position(2, 1.0), **options)


def judges(**options):
    """Every way to judge the noise from innovations, over one constant velocity."""
    return {
        "mr": BankEstimator(single(Adaptive("mr"), **options)),
        "chang": BankEstimator(single(Adaptive("chang"), **options)),
        "bounded-tails": BankEstimator(single(BoundedTails(), **options)),
        "joint": BankEstimator(joint_bank(single(**options), (1.0, 16.0, 1e4))),
        **{name: AdaptiveEstimator(single(**options), NoiseAdaptation(name)) for name in METHODS},
    }


every = pytest.mark.parametrize("name", judges())


def jumped(seed=0, tracks=4, jump=500.0):
    """A target that goes straight, and jumps once: truth, measurements."""
    rng = np.random.default_rng(seed)
    truth = np.tile(TIMES[:, None] * [3.0, -2.0], (tracks, 1, 1))
    truth[:, JUMP:] += jump * np.array([0.6, 0.8])
    return truth, truth + rng.normal(size=truth.shape)


def distance(estimates, truth):
    return np.linalg.norm(estimates.position - truth, axis=2)


@every
def test_a_lost_target_is_reported_though_the_noise_explains_it(name):
    truth, z = jumped()
    run = judges(restart=False)[name].run(z, TIMES)
    error = distance(run, truth)
    claimed = np.sqrt(np.trace(run.covariance[..., :2, :2], axis1=2, axis2=3) + 2.0)
    late = np.arange(ROWS) >= JUMP + 15  # a dozen agreeing refusals, some of them after an accepted one
    lost = (error > 6.0 * claimed) & late
    assert lost.sum() > 10
    assert (run.status[lost] == DIVERGED).all()
    assert (run.status[:, 5:JUMP] != DIVERGED).all()


@every
def test_a_lost_bank_begins_again(name):
    truth, z = jumped()
    again = distance(judges()[name].run(z, TIMES), truth)
    never = distance(judges(restart=False)[name].run(z, TIMES), truth)
    assert again[:, JUMP + 30 :].max() < 6.0
    np.testing.assert_array_equal(again[:, : JUMP + 10], never[:, : JUMP + 10])
    if name not in ("chang", "joint"):  # those come back by themselves, later
        assert never[:, JUMP + 30].min() > 50.0
    assert again[:, JUMP + 15 : JUMP + 40].mean() < 0.7 * never[:, JUMP + 15 : JUMP + 40].mean()


@pytest.mark.parametrize("name", ["chang", "joint", *METHODS])
def test_surges_are_not_taken_for_a_lost_target(name):
    """Bursts of 3 s at 4 to 10 000 times R, and single outliers: their innovations agree in no direction."""
    rng = np.random.default_rng(3)
    truth = np.tile(TIMES[:, None] * [3.0, -2.0], (60, 1, 1))
    scale = np.ones((60, ROWS))
    for b in range(40):
        scale[b, 30:60] = 10.0 ** rng.uniform(0.6, 4.0)
    scale[40:][rng.random((20, ROWS)) < 0.05] = 100.0
    z = truth + np.sqrt(scale)[..., None] * rng.normal(size=truth.shape)
    estimator = judges()[name]
    run = estimator.run(z, TIMES)
    assert (run.status[:, 5:] == DIVERGED).mean() < 0.03
    still = judges(restart=False)[name].run(z, TIMES)
    rms = [np.sqrt(np.mean(distance(one, truth) ** 2)) for one in (run, still)]
    assert rms[0] < 1.02 * rms[1]


def test_alternating_refusals_never_agree():
    estimator = BankEstimator(single(Adaptive("mr")))
    z = np.zeros((ROWS, 2))
    z[20:, 0] = np.where(np.arange(ROWS - 20) % 2, 300.0, -300.0)
    run = estimator.run(z, TIMES)
    assert not (run.status == DIVERGED).any()
    z[20:, 0] = 300.0
    assert (estimator.run(z, TIMES).status[0, 20:] == DIVERGED).any()


@every
@pytest.mark.parametrize("polar", [False, True])
def test_one_row_at_a_time_is_the_run_bit_for_bit_through_a_restart(name, polar):
    sensor = range_bearing((1.0, 0.002)) if polar else position(2, 1.0)
    truth, z = jumped(1, tracks=1)
    offset = np.array([600.0, 300.0])
    truth, z = truth + offset, z + offset
    if polar:
        z = np.stack([np.hypot(z[..., 0], z[..., 1]), np.arctan2(z[..., 1], z[..., 0])], axis=-1)
    z[0, JUMP + 20, 1] = np.nan
    z[0, JUMP + 5] = np.nan
    estimator = judges(sensor=sensor)[name]
    run = estimator.run(z, TIMES)
    assert distance(run, truth)[0, -1] < 10.0
    state = estimator.start(z[0, 0], TIMES[0])
    restarted = False
    for t in range(1, ROWS):
        before = state.refusals[0, 0]
        state, now = estimator.step(state, z[0, t], TIMES[t])
        restarted = restarted or (before == 5.0 and state.refusals[0, 0] == 0.0 and now.status == DIVERGED)
        for field, value in now._asdict().items():
            np.testing.assert_array_equal(value, getattr(run, field)[0, t], err_msg=field)
    assert restarted


def test_a_restart_is_widened_enough_and_says_so():
    truth, z = jumped()
    run = BankEstimator(single(Adaptive("mr"))).run(z, TIMES)
    error = distance(run, truth)[:, JUMP + 10 : JUMP + 30]
    sd = np.sqrt(run.covariance[:, JUMP + 10 : JUMP + 30, 0, 0])
    row = sd.argmax(axis=1)
    here = np.arange(len(row)), row
    assert (error[here] < 3.0 * sd[here]).all()
    assert (error[here] > 0.2 * sd[here]).all()
    after = row + 1
    assert (error[np.arange(len(row)), after] < 5.0).all()


def test_who_begins_again():
    def restarts(bank):
        return bank.program().restart

    assert restarts(single(Adaptive("huber")))
    assert restarts(single(BoundedTails()))
    assert restarts(joint_bank(single()))
    assert not restarts(single())
    assert not restarts(single(HeavyTails(4.0)))
    assert not restarts(single(Adaptive("huber"), restart=False))
    truth, z = jumped()
    asked = distance(BankEstimator(single(restart=True)).run(z, TIMES), truth)
    plain = distance(BankEstimator(single()).run(z, TIMES), truth)
    assert asked[:, JUMP + 25].max() < 6.0 < plain[:, JUMP + 25].min()
    with pytest.raises(ValueError, match="Bank: restart must be True, False or None; got 3"):
        single(restart=3)


def test_the_smoother_bears_a_restart():
    _, z = jumped()
    smooth = BankEstimator(single(Adaptive("mr"))).smooth(z, TIMES)
    assert np.isfinite(smooth.position).all()
    assert np.linalg.eigvalsh(smooth.covariance).min() > 0.0


@pytest.mark.parametrize("turn", [0.5, 0.8, 1.0])
def test_no_angle_is_widened_beyond_what_sigma_points_bear(turn):
    """Before a radar 1 km away, a target that jumps aside: without the bound a track ends 70 km away."""
    sensor = range_bearing((1.0, 0.002))
    z = np.tile([1000.0, 0.0], (ROWS, 1)) + np.random.default_rng(2).normal(size=(ROWS, 2)) * [1.0, 0.002]
    z[JUMP:, 1] += turn
    place = 1000.0 * np.array([np.cos(turn), np.sin(turn)])
    for estimator in judges(sensor=sensor).values():
        run = estimator.run(z, TIMES)
        assert np.linalg.norm(run.position[0], axis=1).max() < 5000.0
        assert np.linalg.norm(run.position[0, -1] - place) < 200.0


def test_a_turn_rate_does_not_run_away_under_student_t():
    """Gross outliers inflate a whole covariance; that of a turn rate stays that of its birth."""
    rng = np.random.default_rng(0)
    truth = np.tile(TIMES[:, None] * [12.0, 3.0], (20, 1, 1))
    scale = np.where(rng.random((20, ROWS)) < 0.3, 1e4, 1.0)
    z = truth + np.sqrt(scale)[..., None] * rng.normal(size=truth.shape)
    estimator = make_estimator("student-t-imm", position(2, 1.0), acceleration=3.0, speed=100.0, sojourn=3.0)
    turn = estimator.bank.modes[2].motion
    rate, birth = turn.labels.index(turn.own_labels[0]), turn.birth_sd[0]
    state = estimator.start(z[0, 0], TIMES[0])
    largest = 0.0
    for t in range(1, ROWS):
        state, _ = estimator.step(state, z[0, t], TIMES[t])
        largest = max(largest, state.cov[0, 2, rate, rate])
    assert largest <= 1.5 * birth**2  # the rate's own diffusion comes on top
    assert distance(estimator.run(z, TIMES), truth).max() < 1000.0  # one outlier: 100 to 300


@pytest.mark.parametrize("name", ["imm", "intent-imm", "joint-imm", "ukf-ct", "robust-imm"])
def test_covariances_are_symmetric_to_the_last_bit(name):
    sensor = range_bearing((1.0, 0.02))
    estimator = make_estimator(name, sensor)
    rng = np.random.default_rng(4)
    z = np.stack([100.0 + rng.normal(size=30), 0.3 + 0.02 * rng.normal(size=30)], axis=1)
    times = np.cumsum(rng.uniform(0.1, 0.9, 30))
    run = estimator.run(z, times)
    np.testing.assert_array_equal(run.covariance, np.swapaxes(run.covariance, -1, -2))
    state = estimator.start(z[:1], times[:1])
    for t in range(1, 30):
        state, _ = estimator.step(state, z[t], times[t])
        for weights in ("W1", "W2"):
            _, cov = estimator.forecast(state, 0.7, weights=weights, steps=2)
            np.testing.assert_array_equal(cov, cov.T)


def test_a_state_belongs_to_the_treatments_it_was_made_with():
    sensor = position(2, 1.0)
    state = make_estimator("imm", sensor).start(np.zeros(2), 0.0)
    with pytest.raises(ValueError, match="step: state must come from"):
        make_estimator("student-t-imm", sensor).step(state, np.zeros(2), 1.0)
    two = [BankEstimator(single(Adaptive(factor))) for factor in ("mr", "huber")]
    with pytest.raises(ValueError, match="forecast: state must come from"):
        two[0].forecast(two[1].start(np.zeros(2), 0.0, prior=Prior(np.zeros(4), np.eye(4))), 1.0)
    two[0].step(BankEstimator(single(Adaptive("mr"))).start(np.zeros(2), 0.0), np.zeros(2), 1.0)


NUMBERS = """
import jink.estimators.{first}
import jink.estimators.cycle
from jink.estimators.pieces import _registered
print([(number, _registered[number][0].__name__) for number in sorted(_registered)])
"""


def test_machine_code_does_not_depend_on_what_is_imported_first():
    """Numbers of pieces are compiled into their callers, and the cache outlives the process."""
    lists = []
    for first in ("recipes", "api", "smoothers", "treatments"):
        done = subprocess.run(
            [sys.executable, "-c", NUMBERS.format(first=first)], capture_output=True, text=True, check=True
        )
        lists.append(done.stdout)
    assert len(set(lists)) == 1
    assert "step" in lists[0]
