"""Dwells, chains and parameters of the truth: distributions that were asked for are those one gets."""

import math

import numpy as np
import pytest
from scipy import stats
from short_flights import HEADING, LASTS, SPEED, fly, one

from jink.envs.flight.dwells import Dwell
from jink.envs.flight.intent_rules import GRAVITY
from jink.envs.flight.limits import Start
from jink.envs.intents import Accelerate, Climb, Helix, Jink, Orbit, StopAndGo, Straight, Turn, Weave, make_intent
from jink.envs.manoeuvres import Manoeuvres


# Each test allows 4.5 standard errors and checks that ten of them are less than a tenth of the value: a parameter
# that is off by 10 % is 5.5 standard errors outside.
def agrees(sample, expected):
    sample = np.asarray(sample, dtype=float)
    error = sample.std() / math.sqrt(sample.size) + 1e-12
    assert 10 * error < 0.1 * abs(expected), "too few samples to see 10 %"
    return abs(sample.mean() - expected) < 4.5 * error + 1e-9 * abs(expected)


DWELLS = {
    "fixed": (Dwell(3.0, kind="fixed"), None),
    "uniform": (Dwell(3.0, 1.0, "uniform"), stats.uniform(1.0, 4.0)),
    "exponential": (Dwell(3.0, 1.0, "exponential"), stats.expon(1.0, 2.0)),
    "weibull": (Dwell(3.0, 0.5, "weibull", 3.0), stats.weibull_min(3.0, 0.5, 2.5 / math.gamma(1 + 1 / 3))),
}


@pytest.mark.parametrize("kind", DWELLS)
def test_dwells_follow_their_distribution(kind):
    dwell, law = DWELLS[kind]
    motion = Manoeuvres(behaviours=(Straight(dwell=dwell), Turn(dwell=LASTS)), initial=(1.0, 0.0))
    # The first switch ends the first dwell; nobody dwells so long that the episode ends before.
    lasted = fly(motion, np.array([0.0, 60.0]), rows=6000).switch_times[:, 0]
    assert np.isfinite(lasted).all()
    assert agrees(lasted, 3.0)
    assert lasted.min() >= dwell.shortest
    if law is None:
        assert np.all(lasted == 3.0)
    else:
        assert stats.kstest(lasted, law.cdf).pvalue > 1e-4
        assert stats.kstest(lasted, lambda t: law.cdf(1.1 * t)).pvalue < 1e-8


def test_later_dwells_follow_theirs_too():
    motion = Manoeuvres(behaviours=(Straight(dwell=Dwell(3.0, 1.0)), Turn(dwell=Dwell(2.0, 0.5, "uniform"))))
    truth = fly(motion, np.array([0.0, 200.0]), rows=600)
    lasted = np.diff(truth.switch_times[:, :20], axis=1)
    first = truth.intent[:, 0]
    for label, mean in ((0, 3.0), (1, 2.0)):
        mine = np.concatenate([lasted[first == label, 1::2].ravel(), lasted[first != label, 0::2].ravel()])
        assert agrees(mine, mean)


def test_intents_follow_one_another_as_the_chain_says():
    transition = ((0.0, 0.7, 0.3), (0.5, 0.25, 0.25), (0.8, 0.2, 0.0))
    short = Dwell(1.0, kind="fixed")
    behaviours = tuple(make_intent(name, dwell=short) for name in ("straight", "turn", "weave"))
    motion = Manoeuvres(behaviours=behaviours, transition=transition, initial=(0.2, 0.5, 0.3))
    truth = fly(motion, np.arange(0.5, 60.0), rows=4000)
    label = truth.intent
    # An intent that follows itself is no switch.
    assert np.array_equal(np.isfinite(truth.switch_times).sum(1), (np.diff(label, axis=1) != 0).sum(1))
    for i, row in enumerate(transition):
        assert i == 1 or not np.any((label[:, 1:] == i) & (label[:, :-1] == i))
        following = label[:, 1:][label[:, :-1] == i]
        for j, probability in enumerate(row):
            if probability:
                assert agrees(following == j, probability)
    many = fly(motion, np.zeros(1), rows=50_000).intent[:, 0]
    for i, probability in enumerate(motion.initial):
        assert agrees(many == i, probability)


def moving(truth):
    """Speed, turn rate (signed) and climb angle at every sample."""
    v, a = truth.velocity, truth.acceleration
    level = v[..., 0] ** 2 + v[..., 1] ** 2
    turn = (v[..., 0] * a[..., 1] - v[..., 1] * a[..., 0]) / level
    return np.linalg.norm(v, axis=2), turn, np.arctan2(v[..., 2], np.sqrt(level))


FREE = {"speed": (0.0, 1e6), "lateral": 1e6, "climb": 1.5}
LONG = Dwell(50.0, kind="fixed")
QUANTITIES = {
    "accelerate": (
        Accelerate(dwell=LONG, acceleration=(2.0, 6.0), brakes=0.0),
        lambda truth: np.linalg.norm(truth.acceleration[:, 0], axis=1),
        (2.0, 6.0),
    ),
    "turn": (Turn(dwell=LONG, rate=(0.1, 0.4)), lambda truth: np.abs(moving(truth)[1][:, 0]), (0.1, 0.4)),
    "weave: amplitude": (
        Weave(dwell=LONG, amplitude=(0.3, 0.9), period=(8.0, 8.0)),
        lambda truth: np.abs(np.arctan2(truth.velocity[:, 20, 1], truth.velocity[:, 20, 0]) - HEADING),
        (0.3, 0.9),
    ),
    "weave: period": (
        Weave(dwell=LONG, amplitude=(0.5, 0.5), period=(4.0, 10.0)),
        lambda truth: 2 * math.pi * 0.5 / np.abs(moving(truth)[1][:, 0]),
        (4.0, 10.0),
    ),
    "orbit": (
        Orbit(dwell=LONG, radius=(300.0, 900.0)),
        lambda truth: SPEED / np.abs(moving(truth)[1][:, 0]),
        (300.0, 900.0),
    ),
    "climb: angle": (
        Climb(dwell=LONG, angle=(0.1, 0.4), pitch_rate=0.5),
        lambda truth: np.abs(moving(truth)[2][:, 20]),
        (0.1, 0.4),
    ),
    "helix: angle": (
        Helix(dwell=LONG, angle=(0.1, 0.4), pitch_rate=0.5),
        lambda truth: np.abs(moving(truth)[2][:, 20]),
        (0.1, 0.4),
    ),
    "helix: rate": (Helix(dwell=LONG, rate=(0.1, 0.4)), lambda truth: np.abs(moving(truth)[1][:, 0]), (0.1, 0.4)),
    "jink: lateral": (
        Jink(dwell=LONG, lateral=(2.0, 5.0)),
        lambda truth: SPEED * np.abs(moving(truth)[1][:, 0]) / GRAVITY,
        (2.0, 5.0),
    ),
    "jink: turn time": (
        Jink(dwell=LONG, lateral=(2.0, 5.0), turn_time=(0.5, 1.5)),
        lambda truth: 0.1 * np.argmax(np.abs(np.diff(moving(truth)[1], axis=1)) > 1e-9, axis=1) + 0.05,
        (0.5, 1.5),
    ),
    "stop-and-go: braking": (
        StopAndGo(dwell=LONG, braking=(5.0, 15.0), starting=(50.0, 50.0)),
        lambda truth: np.linalg.norm(truth.acceleration[:, 0], axis=1),
        (5.0, 15.0),
    ),
    "stop-and-go: starting": (
        StopAndGo(dwell=Dwell(10.0, kind="fixed"), braking=(50.0, 50.0), starting=(20.0, 40.0)),
        lambda truth: np.linalg.norm(truth.acceleration[:, 99], axis=1),
        (20.0, 40.0),
    ),
}


@pytest.mark.parametrize("case", QUANTITIES)
def test_parameters_are_uniform_within_their_span(case):
    intent, measure, (low, high) = QUANTITIES[case]
    times = np.arange(100) * 0.1
    value = measure(fly(one(intent, **FREE), times, rows=3000, longest=10.0))
    assert agrees(value, 0.5 * (low + high))
    # The ends themselves, to the resolution of what is measured: 3000 draws come within 1 % of the width.
    slack = 0.01 * (high - low) + (0.051 if case == "jink: turn time" else 1e-9)
    assert low - slack < value.min() < low + slack
    assert high - slack < value.max() < high + slack


@pytest.mark.parametrize(
    ("intent", "measure", "probability"),
    [
        (Turn(dwell=LONG, left=0.3), lambda truth: moving(truth)[1][:, 0] > 0, 0.3),
        (Orbit(dwell=LONG, left=0.7), lambda truth: moving(truth)[1][:, 0] > 0, 0.7),
        (Weave(dwell=LONG), lambda truth: moving(truth)[1][:, 0] > 0, 0.5),
        (Jink(dwell=LONG), lambda truth: moving(truth)[1][:, 0] > 0, 0.5),
        (Climb(dwell=LONG, up=0.3), lambda truth: moving(truth)[2][:, 9] > 0, 0.3),
        (Helix(dwell=LONG, up=0.7), lambda truth: moving(truth)[2][:, 9] > 0, 0.7),
        (Accelerate(dwell=LONG, brakes=0.3), lambda truth: moving(truth)[0][:, 1] < SPEED, 0.3),
    ],
)
def test_sides_are_as_likely_as_they_should_be(intent, measure, probability):
    sides = measure(fly(one(intent, **FREE), np.arange(10) * 0.1, rows=25_000, longest=1.0))
    assert agrees(sides, probability)
    assert agrees(~sides, 1 - probability)


def test_starts_are_uniform():
    start = Start(speed=(20.0, 80.0), heading=(0.5, 2.0), x=(100.0, 300.0), y=(-500.0, -100.0), z=(900.0, 1500.0))
    truth = fly(Manoeuvres(behaviours=(Straight(),), axes=3, start=start), np.zeros(1), rows=3000)
    v = truth.velocity[:, 0]
    values = (np.linalg.norm(v, axis=1), np.arctan2(v[:, 1], v[:, 0]), *truth.position[:, 0].T)
    for value, (low, high) in zip(values, (start.speed, start.heading, start.x, start.y, start.z), strict=True):
        assert agrees(value, 0.5 * (low + high))
        assert stats.kstest(value, stats.uniform(low, high - low).cdf).pvalue > 1e-4
