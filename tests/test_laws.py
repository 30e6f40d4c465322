"""Laws, births, phases, intents and the bank a model stands for."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.sensors import position
from jink.intent.describing import describe_phase
from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent, IntentModel
from jink.intent.naming import named

STRAIGHT = Intent("straight", (Phase(Law(2, wobble=0.1), (Birth(),)),))
TURN = Intent(
    "turn",
    (
        Phase(
            Law(2, turn_mean=0.1, turn_rate=0.05, turn_noise=1e-5),
            (Birth(0.6, 0.0, 0.01, 0.1, 0.03), Birth(0.4, 0.0, 0.01, 0.2, 0.05)),
            mirrored=True,
        ),
    ),
    renewal=0.02,
)
JINK = Intent(
    "jink",
    (
        Phase(Law(2), (Birth(turn_mean=0.3),), mirrored=True, duration=4.0),
        Phase(Law(2), (Birth(turn_mean=-0.3),), mirrored=True, duration=99.0),
    ),
)
RATES = ((-0.05, 0.03, 0.02), (0.1, -0.1, 0.0), (0.2, 0.0, -0.2))
MODEL = IntentModel(2, (STRAIGHT, TURN, JINK), RATES, (0.5, 0.3, 0.2), speed=100.0)


def test_modes_are_ordered_by_intent_phase_birth_and_side():
    assert [mode[1:] for mode in MODEL.modes] == [
        (0, 0, 0, 1),
        *((1, 0, 0, 1), (1, 0, 0, -1), (1, 0, 1, 1), (1, 0, 1, -1)),
        *((2, 0, 0, 1), (2, 0, 0, -1), (2, 1, 0, 1), (2, 1, 0, -1)),
    ]
    assert len({mode.name for mode in MODEL.modes}) == 9
    assert MODEL.modes[2].name == "turn birth 1 right" and MODEL.modes[7].name == "jink phase 2 left"


def test_generator_of_modes_by_hand():
    rates = MODEL.mode_generator()
    np.testing.assert_allclose(rates.sum(axis=1), 0.0, atol=1e-15)
    np.testing.assert_allclose(rates[0, 1:], [0.009, 0.009, 0.006, 0.006, 0.01, 0.01, 0.0, 0.0])
    # from a left turn: straight, renewals to the three other turns, never into the middle of a template
    np.testing.assert_allclose(rates[1, [0, 2, 3, 4, 5, 6, 7, 8]], [0.1, 0.006, 0.004, 0.004, 0, 0, 0, 0])
    # a template keeps its side, is left from its last phase only, and the last duration plays no part
    np.testing.assert_allclose(rates[5], [0, 0, 0, 0, 0, -0.25, 0, 0.25, 0])
    np.testing.assert_allclose(rates[8], [0.2, 0, 0, 0, 0, 0, 0, 0, -0.2])
    np.testing.assert_allclose(MODEL.mode_initial(), [0.5, 0.09, 0.09, 0.06, 0.06, 0.1, 0.1, 0.0, 0.0])


def test_a_phase_without_sides_draws_them_anew():
    level = Phase(Law(2), (Birth(),), duration=2.0)
    template = Intent("s-turn", (JINK.phases[0], level, JINK.phases[1]))
    rates = IntentModel(2, (template,)).mode_generator()
    np.testing.assert_allclose(rates[:2, 2], 0.25)
    np.testing.assert_allclose(rates[2, 3:], 0.25)  # 1 / 2 s, half to each side


def test_intents_are_what_the_modes_sum_to():
    flow = expm(MODEL.mode_generator() * 3.0)
    small = IntentModel(2, (STRAIGHT, TURN), ((-0.05, 0.05), (0.1, -0.1)))
    probs = small.mode_initial() @ expm(small.mode_generator() * 3.0)
    wanted = np.array([0.5, 0.5]) @ expm(np.array(small.generator) * 3.0)
    np.testing.assert_allclose(small.intent_probs(probs), wanted, rtol=1e-12)
    assert MODEL.intent_probs(flow).shape == (9, 3)
    with pytest.raises(ValueError, match="mode_probs must end in 9 modes; got shape"):
        MODEL.intent_probs(np.ones(3))


def test_long_run_shares_are_stationary():
    shares = MODEL.mode_shares()
    np.testing.assert_allclose(shares @ MODEL.mode_generator(), 0.0, atol=1e-9)
    np.testing.assert_allclose(shares.sum(), 1.0)
    stuck = IntentModel(2, (STRAIGHT, TURN), initial=(0.3, 0.7))
    np.testing.assert_allclose(stuck.intent_probs(stuck.mode_shares()), [0.3, 0.7])


def test_bank_is_that_of_the_modes():
    bank = MODEL.bank(position(2, 5.0), min_prob=1e-4)
    assert bank.interaction == "birth" and bank.speed == 100.0 and bank.min_prob == 1e-4
    assert [mode.name for mode in bank.modes] == [mode.name for mode in MODEL.modes]
    np.testing.assert_array_equal(bank.chain.rates, MODEL.mode_generator())
    right = bank.modes[2].motion
    assert right.labels == ("x", "vx", "y", "vy", "g", "w")
    assert right.birth_mean == (0.0, -0.1) and right.birth_sd == (0.01, 0.03) and right.params[3] == -0.1
    assert MODEL.motion("turn birth 1 right") == right


def test_one_swing_gives_every_mode_a_slope():
    weave = Intent("weave", (Phase(Law(2, turn_noise=1e-3, swing=(0.6, 0.1)), (Birth(swing_sd=0.3),)),))
    model = IntentModel(2, (STRAIGHT, weave), ((-0.1, 0.1), (0.1, -0.1)))
    motions = [mode.motion for mode in model.bank(position(2, 1.0)).modes]
    assert all(motion.labels[-1] == "u" for motion in motions)
    assert motions[0].birth_sd[-1] == 1.0 and motions[1].birth_sd[-1] == 0.3
    assert motions[0].params[7] == 0.0 and motions[1].params[7:9] == (0.6, 0.1)


def test_dormant_slope_changes_nothing_of_a_kalman_filter():
    """Straight flight without any uncertainty of shape is linear, so one more component is no matter."""
    z = np.cumsum(np.random.default_rng(0).normal(10.0, 1.0, (2, 20, 2)), axis=1)
    law, birth = Law(2, wobble=0.5), Birth()
    plain = IntentModel(2, Intent("straight", (Phase(law, (birth,)),)))
    estimates = plain.estimator(position(2, 1.0)).run(z, np.arange(20.0))
    widened = BankEstimator(Bank((Mode("straight", law.motion(birth, slope=True)),), position(2, 1.0)))
    found = widened.run(z, np.arange(20.0))
    np.testing.assert_allclose(found.log_likelihood, estimates.log_likelihood, rtol=1e-9)


def test_learned_noise_is_the_sensor_unless_another_is_given():
    model = MODEL.with_(noise_sd=(3.0, 4.0))
    np.testing.assert_allclose(model.bank().sensor.noise, np.diag([9.0, 16.0]))
    np.testing.assert_allclose(model.bank(position(2, 1.0)).sensor.noise, np.eye(2))
    with pytest.raises(ValueError, match="sensor must be given as no measurement noise was learned"):
        MODEL.bank()


def test_rollout_is_the_motion_function():
    path = MODEL.rollout("turn", [0, 0, 10, 0], [0.0, 0.1], [0.0, math.pi / 0.1])
    np.testing.assert_allclose(path, [[0, 0], [0, 200.0]], atol=1e-9)  # half a circle to the left, radius 100 m
    mirrored = MODEL.rollout("turn", [0, 0, 10, 0], times=[3.0], sign=-1)
    np.testing.assert_allclose(mirrored * [1, -1], MODEL.rollout("turn", [0, 0, 10, 0], times=[3.0]))
    # a template turns left for 4 s at 0.3 rad/s, then back: after 8 s the course is the first one again
    ends = MODEL.rollout("jink", [0, 0, 10, 0], times=[8.0, 8.0 + 1e-3])
    np.testing.assert_allclose((ends[1] - ends[0]) / 1e-3, [10, 0], atol=2e-3)
    with pytest.raises(ValueError, match=r"own must be g, w; got shape \(3,\)"):
        MODEL.rollout("turn", [0, 0, 1, 0], [0, 0, 0])


def test_description_can_be_read():
    lines = MODEL.describe().splitlines()
    assert lines[0] == "intent 1 (straight): straight, lasts 20 s by its chain, 68 % of the time"
    assert "turn, 4.2-13 deg/s either way" in lines[1] and "lasts 10 s by its chain" in lines[1]
    assert lines[2].count("turn, 17 deg/s either way") == 2 and "lasts 9 s" in lines[2]
    left = Phase(Law(2), (Birth(turn_mean=0.1, turn_sd=0.01, growth_mean=0.0),))
    faster = Phase(Law(2), (Birth(growth_mean=0.05, growth_sd=0.01),))
    words = IntentModel(2, (Intent("a", left), Intent("b", faster)), ((-1, 1), (1, -1))).describe()
    assert "deg/s to the left, lasts 1 s by its chain" in words and "speed up, 4-6 %/s" in words
    assert "never ends" in IntentModel(2, (Intent("a", left),)).describe()


def test_about_is_no_part_of_equality():
    assert MODEL.with_(about={"seed": 3}) == MODEL
    assert MODEL.with_(speed=99.0) != MODEL


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Law(4), "Law: axes must be 2 or 3; got 4"),
        (lambda: Law(2, wobble=-1), "Law: wobble must be a finite number >= 0; got -1"),
        (lambda: Law(2, turn_mean=math.nan), "Law: turn_mean must be a finite number; got nan"),
        (lambda: Law(3, turn_mean=0.1), "Law: turn_mean must be 0 in space; got 0.1"),
        (lambda: Law(2, swing=(1.0, 1.5)), r"Law: damping must be in \[0.001, 0.999\]; got 1.5"),
        (lambda: Law(2, swing=(0.5,)), "Law: swing must be"),
        (lambda: Law(2, turn_rate=1.0, swing=(0.5, 0.1)), "Law: turn_rate must be 0 with a swing; got 1.0"),
        (lambda: Birth(0.0), "Birth: weight must be a finite number > 0; got 0.0"),
        (lambda: Birth(turn_sd="wide"), "Birth: turn_sd must be a finite number >= 0; got 'wide'"),
        (lambda: Phase(Law(2), (Birth(0.5),)), "weights that sum to 1; got 0.5"),
        (lambda: Phase(Law(2), ()), "births must hold one or more"),
        (lambda: Phase(Law(3), (Birth(),), True), "mirrored must be False in space"),
        (lambda: Phase(Law(3), (Birth(turn_mean=0.1),)), "turn_mean 0 in space"),
        (lambda: Intent("", STRAIGHT.phases), "name must be a non-empty string"),
        (lambda: Intent("a", ()), "phases of a must hold one or more"),
        (lambda: Intent("a", (Phase(Law(2)), Phase(Law(3)))), r"equal axes; got \[2, 3\]"),
        (lambda: Intent("a", Phase(Law(2)), renewal=-1.0), "renewal must be >= 0"),
        (lambda: IntentModel(3, (STRAIGHT,)), "intents must have 3 axes; straight has 2"),
        (lambda: IntentModel(2, ()), "at least one Intent"),
        (lambda: IntentModel(2, (STRAIGHT, STRAIGHT)), "distinct names"),
        (lambda: IntentModel(2, (STRAIGHT, TURN), ((0.0, 0.1), (0.1, -0.1))), "rows that sum to 0"),
        (lambda: IntentModel(2, (STRAIGHT,), ((-1.0, 1.0),)), r"generator must be finite with shape \(1, 1\)"),
        (lambda: IntentModel(2, (STRAIGHT,), initial=(0.5,)), "probabilities that sum to 1"),
        (lambda: IntentModel(2, (STRAIGHT,), noise_sd=(1.0, 0.0)), "noise_sd must be > 0"),
        (lambda: IntentModel(2, (STRAIGHT,), speed=0.0), "speed must be > 0"),
        (lambda: MODEL.motion("hover"), "mode must be one of straight, .*; got 'hover'"),
        (lambda: MODEL.motion(9), r"mode must be in 0 \.\. 8; got 9"),
    ],
)
def test_one_clear_sentence(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_durations_are_those_that_were_seen():
    """A renewal does not end an intent; what was counted on tracks comes before what the chain says."""
    assert MODEL.intents[1].renewal > 0 and MODEL.lasting(1) == pytest.approx(-1 / MODEL.generator[1][1])
    seen = MODEL.with_(endings=(1 / 21, 0.0, 1 / 35))
    assert seen.lasting(0) == pytest.approx(21) and seen.lasting(1) == math.inf and seen.lasting(2) == pytest.approx(35)
    lines = seen.describe().splitlines()
    assert "lasts 21 s, " in lines[0] and "never ends" in lines[1] and "lasts 35 s, " in lines[2]
    np.testing.assert_array_equal(seen.mode_generator(), MODEL.mode_generator())
    assert seen.with_(noise_sd=(1.0, 1.0)).endings == seen.endings
    assert seen.with_(generator=MODEL.generator).endings == ()  # of another chain nothing was seen
    with pytest.raises(ValueError, match="endings must be finite with shape"):
        MODEL.with_(endings=(1.0,))


def test_names_and_descriptions_agree_on_straight():
    def called(birth, **law):
        model = named(IntentModel(2, (Intent("x", (Phase(Law(2, **law), (birth,)),)),)))
        return model.intents[0].name, describe_phase(model.intents[0].phases[0])

    for growth in (0.0, 0.003, 0.0055, 0.0069, 0.0071, 0.02):
        for turn in (0.0, 0.4, 0.6, 0.9, 1.1, 3.0):
            name, words = called(Birth(growth_sd=growth, turn_sd=math.radians(turn)))
            assert (name == "straight") == (words == "straight") == (growth < 0.007 and turn < 1), (growth, turn)


def test_numbers_beyond_physics_are_refused():
    with pytest.raises(ValueError, match="Law: turn_rate must be at most 1e"):
        Law(2, turn_rate=1e300)
    with pytest.raises(ValueError, match="Birth: turn_mean must be at most 1e"):
        Birth(turn_mean=-1e200)
    largest = Phase(Law(2, turn_rate=1e30, turn_noise=1e30), (Birth(turn_mean=1e30, turn_sd=1e30),))
    assert "straight" in IntentModel(2, (Intent("a", largest),)).describe()  # forgets its turn at once


def test_rollout_refuses_what_is_not_finite():
    for kin, own, times in (
        ([0, 0, math.nan, 1], None, [1.0]),
        ([0, 0, 1, 1], [0.0, math.inf], [1.0]),
        ([0, 0, 1, 1], None, [0.0, math.nan]),
    ):
        with pytest.raises(ValueError, match="must be finite"):
            MODEL.rollout(0, kin, own, times)
