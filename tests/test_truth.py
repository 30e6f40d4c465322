"""What targets do: truth against differential equations, within its limits, whoever looks and whenever."""

import math
import pickle
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from short_flights import HEADING, LASTS, SPEED, draws, fly, in_all_ways, one

from jink.envs.flight.dwells import Dwell
from jink.envs.flight.intent_rules import GRAVITY, PLAN, Intent, swing, wish, within
from jink.envs.flight.limits import Limits, Start
from jink.envs.intents import (
    INTENTS,
    Accelerate,
    Climb,
    Helix,
    Jink,
    Orbit,
    StopAndGo,
    Straight,
    Turn,
    Weave,
    make_intent,
)
from jink.envs.manoeuvres import Manoeuvres
from jink.envs.streams import Draws
from jink.estimators.compiled import Callback


# Controls by hand, (duration, s', psi'(t), gamma') of each leg of one dwell of 10 s: what the docstrings promise.
def constant(rate):
    return lambda t: rate


RAMP = 0.2 / 0.1
FLOWN = {
    "straight": (Straight(dwell=LASTS), [(10.0, 0.0, constant(0.0), 0.0)]),
    "accelerate": (
        Accelerate(dwell=LASTS, acceleration=(5.0, 5.0), brakes=0.0),
        [(6.0, 5.0, constant(0.0), 0.0), (4.0, 0.0, constant(0.0), 0.0)],  # 130 m/s is the limit
    ),
    "turn": (Turn(dwell=LASTS, rate=(0.3, 0.3), left=0.0), [(10.0, 0.0, constant(-0.3), 0.0)]),
    "weave": (
        Weave(dwell=LASTS, amplitude=(0.8, 0.8), period=(10.0, 10.0)),
        [(10.0, 0.0, lambda t: 0.8 * (math.pi / 5) * math.cos(math.pi / 5 * t), 0.0)],
    ),
    "orbit": (Orbit(dwell=LASTS, radius=(250.0, 250.0), left=1.0), [(10.0, 0.0, constant(0.4), 0.0)]),
    "climb": (
        Climb(dwell=LASTS, angle=(0.2, 0.2), pitch_rate=0.1, up=1.0),
        [(RAMP, 0.0, constant(0.0), 0.1), (10.0 - 2 * RAMP, 0.0, constant(0.0), 0.0), (RAMP, 0.0, constant(0.0), -0.1)],
    ),
    "helix": (
        Helix(dwell=LASTS, rate=(0.25, 0.25), angle=(0.2, 0.2), pitch_rate=0.1, up=0.0),
        [
            (RAMP, 0.0, constant(0.25), -0.1),
            (10.0 - 2 * RAMP, 0.0, constant(0.25), 0.0),
            (RAMP, 0.0, constant(0.25), 0.1),
        ],
    ),
    "jink": (
        Jink(dwell=LASTS, lateral=(3.0, 3.0), turn_time=(2.0, 2.0)),
        [(2.0, 0.0, constant(3.0 * GRAVITY / SPEED), 0.0)] * 5,
    ),
    "stop-and-go": (
        StopAndGo(dwell=LASTS, braking=(25.0, 25.0), starting=(20.0, 20.0)),
        [(4.0, -25.0, constant(0.0), 0.0), (1.0, 0.0, constant(0.0), 0.0), (5.0, 20.0, constant(0.0), 0.0)],
    ),
}


def _corkscrew(now, u, params, out):
    wish(out, now[4], params[0], params[1], params[2])


@dataclass(frozen=True, kw_only=True)
class Corkscrew(Intent):
    """An intent of one's own: everything at once."""

    name: str = "corkscrew"
    gain: float = field(default=1.0, metadata=within("m/s^2"))
    turn: float = field(default=0.0, metadata=within("rad/s"))
    pitch: float = field(default=0.0, metadata=within("rad/s"))
    plan = Callback(_corkscrew, PLAN)


FLOWN["wide weave"] = (
    Weave(dwell=LASTS, amplitude=(1.5, 1.5), period=(20.0, 20.0)),
    [(10.0, 0.0, lambda t: 0.15 * math.pi * math.cos(math.pi / 10 * t), 0.0)],
)
for turn, pitch in ((0.3, 0.05), (0.04, 0.03), (1e-4, 0.0), (0.02, 0.02)):  # above and below where series take over
    FLOWN[f"corkscrew {turn}, {pitch}"] = (
        Corkscrew(dwell=LASTS, gain=2.0, turn=turn, pitch=pitch),
        [(10.0, 2.0, constant(turn), pitch)],
    )


def test_every_intent_is_flown():
    assert set(INTENTS) < set(FLOWN)
    assert all(FLOWN[name][0].name == name == INTENTS[name]().name for name in INTENTS)


def jet(x, gain, turn, pitch):
    """Velocity and acceleration of a state under its controls."""
    s, psi, gamma = x[3:]
    along = np.array([math.cos(gamma) * math.cos(psi), math.cos(gamma) * math.sin(psi), math.sin(gamma)])
    left = np.array([-math.sin(psi), math.cos(psi), 0.0]) * math.cos(gamma)
    up = np.array([-math.sin(gamma) * math.cos(psi), -math.sin(gamma) * math.sin(psi), math.cos(gamma)])
    return s * along, gain * along + s * turn * left + s * pitch * up


@pytest.mark.parametrize("name", FLOWN)
def test_agrees_with_ode_integration(name):
    intent, legs = FLOWN[name]
    times = np.arange(80) / 8.0
    truth = fly(one(intent, speed=(0.0, 130.0)), times, longest=10.0)
    p, v, a = (x[0] for x in truth[:3])
    bent = np.sign(v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0])  # sides that are drawn by chance are read off the truth
    x = np.array([10.0, -20.0, 1500.0, SPEED, HEADING, 0.0])
    start = 0.0
    for duration, gain, turn, pitch in legs:
        inside = np.flatnonzero((times > start - 1e-9) & (times < start + duration - 1e-9))
        local = times[inside] - start
        side = bent[inside[0]] * np.sign(turn(local[0])) if turn(0.0) else 1.0
        solved = solve_ivp(
            lambda t, x, leg=(gain, turn, pitch, side): [
                *jet(x, 0.0, 0.0, 0.0)[0], leg[0], leg[3] * leg[1](t), leg[2]
            ],
            (0.0, duration), x, "DOP853", np.append(local, duration), rtol=2.5e-14, atol=1e-10, max_step=0.25,
        )  # fmt: skip
        for k, t, state in zip(inside, local, solved.y.T, strict=False):
            velocity, pull = jet(state, gain, side * turn(t), pitch)
            # 1e-11 of the path so far (the series end far below), beside the rounding of coordinates of kilometres.
            assert p[k] == pytest.approx(state[:3], rel=0, abs=1e-11 * SPEED * times[k] + 1e-11)
            assert v[k] == pytest.approx(velocity, rel=0, abs=1e-11 * SPEED)
            assert a[k] == pytest.approx(pull, rel=0, abs=1e-10 * SPEED)
        x = solved.y[:, -1]
        start += duration
    assert start == 10.0


@pytest.mark.parametrize("name", ["straight", "turn", "weave", "orbit", "climb", "helix", "jink"])
def test_kinetic_energy_is_kept_where_nothing_speeds_up(name):
    truth = fly(one(FLOWN[name][0]), np.linspace(0.0, 60.0, 601))
    # A rounding error per sample, not one that grows along the way.
    assert np.linalg.norm(truth.velocity, axis=2) == pytest.approx(SPEED, rel=1e-12)
    assert np.einsum("bta,bta->bt", truth.velocity, truth.acceleration) == pytest.approx(0.0, abs=1e-9 * SPEED * 30)


def test_an_orbit_closes():
    orbit = one(Orbit(dwell=Dwell(1000.0, kind="fixed"), radius=(300.0, 300.0), left=1.0))
    around = 2 * math.pi * 300.0 / SPEED
    place = fly(orbit, np.arange(5) * around).position[0]
    assert place - place[0] == pytest.approx(0.0, abs=1e-9)
    centre = place[0, :2] + 300.0 * np.array([-math.sin(HEADING), math.cos(HEADING)])
    path = fly(orbit, np.linspace(0, around, 50)).position[0, :, :2]
    assert np.linalg.norm(path - centre, axis=1) == pytest.approx(300.0, rel=1e-12)


def excess(truth, axes):
    """Largest speed, least speed, lateral acceleration in g and climb angle along trajectories."""
    v, a = truth.velocity, truth.acceleration
    speed = np.linalg.norm(v, axis=2)
    along = np.einsum("bta,bta->bt", a, v) / speed
    lateral = np.sqrt(np.maximum(np.einsum("bta,bta->bt", a, a) - along**2, 0.0)) / GRAVITY
    climb = np.abs(np.arcsin(v[..., 2] / speed)) if axes == 3 else np.zeros(1)
    return speed.max(), speed.min(), lateral.max(), climb.max()


@pytest.mark.parametrize("axes", [2, 3])
def test_limits_hold_everywhere_and_are_reached(axes):
    truth = fly(in_all_ways(axes), np.arange(0.0, 100.0, 0.05), rows=60)
    high, low, lateral, climb = excess(truth, axes)
    assert high <= 130.0 * (1 + 1e-12)
    assert low >= 20.0 * (1 - 1e-12)
    assert lateral <= 2.0 * (1 + 1e-9)
    assert (high, low, lateral) == pytest.approx((130.0, 20.0, 2.0), rel=1e-6)
    if axes == 3:
        assert 0.2999 <= climb <= 0.3 * (1 + 1e-9)
        altitude = truth.position[..., 2]
        assert 1350.0 - 1e-6 <= altitude.min() < 1370.0
        assert 1630.0 < altitude.max() <= 1650.0 + 1e-6


def _reckless(now, u, params, out):
    wish(out, 0.5 * now[4], 100.0, 9.0, 9.0)
    swing(out, 0.2 * now[4], 1.5, 9.0)
    wish(out, now[4], -500.0, -9.0, -9.0)


class Reckless(Intent):
    plan = Callback(_reckless, PLAN)


def test_an_intent_of_ones_own_cannot_break_the_limits():
    motion = replace(in_all_ways(3), behaviours=(Reckless(name="reckless"),))
    high, low, lateral, climb = excess(fly(motion, np.arange(0.0, 30.0, 0.01), rows=20), 3)
    assert 20.0 * (1 - 1e-12) <= low < high <= 130.0 * (1 + 1e-12)
    assert lateral <= 2.0 * (1 + 1e-9)
    assert climb <= 0.3 * (1 + 1e-9)


def test_a_helix_climbs_even_where_the_turn_is_limited():
    steep = Helix(dwell=LASTS, rate=(9.0, 9.0), angle=(0.2, 0.2), pitch_rate=9.0)
    truth = fly(one(steep, lateral=2.0), np.arange(0.0, 9.9, 0.01))
    _, _, lateral, climb = excess(truth, 3)
    assert climb == pytest.approx(0.2, rel=1e-9)
    assert 1.9 < lateral <= 2.0 * (1 + 1e-9)


def test_no_turn_of_a_jink_is_shorter_than_the_shortest():
    hard = one(Jink(dwell=Dwell(3.0, 0.5), turn_time=(0.5, 1.2)))
    truth = fly(hard, np.arange(0.0, 50.0, 0.01), rows=50)
    v, a = truth.velocity, truth.acceleration
    rate = (v[..., 0] * a[..., 1] - v[..., 1] * a[..., 0]) / SPEED**2
    for row in rate:
        changes = np.flatnonzero(np.abs(np.diff(row)) > 1e-9)
        assert changes.size > 20
        assert np.diff(changes).min() >= 50 - 1


def _idle(now, u, params, out):
    out[0] = 0.0


class Idle(Intent):
    plan = Callback(_idle, PLAN)


def test_a_plan_that_does_nothing_is_named():
    with pytest.raises(RuntimeError, match="plan of idler must fill its time"):
        fly(one(Idle(name="idler")), np.arange(5.0))


@pytest.mark.parametrize("axes", [2, 3])
def test_position_and_velocity_are_continuous(axes):
    motion = in_all_ways(axes)
    # One sample every 0.5 ms: legs begin and end between them, so a jump would stand out of v dt and a dt.
    dt = 5e-4
    truth = fly(motion, np.arange(0.0, 30.0, dt), rows=4)
    p, v, a = (np.diff(x, axis=1) for x in truth[:3])
    mid = 0.5 * (truth.velocity[:, 1:] + truth.velocity[:, :-1])
    assert np.isfinite(truth.switch_times).sum() > 15
    assert np.linalg.norm(p - mid * dt, axis=2).max() < 1.01 * 2 * 20.0 * dt**2
    assert np.linalg.norm(v, axis=2).max() < 1.01 * math.hypot(2.0 * GRAVITY, 8.0) * dt
    assert np.linalg.norm(a, axis=2).max() > 1.0  # while the acceleration does jump


def test_labels_and_switch_times_tell_the_same():
    motion = in_all_ways(2)
    times = np.arange(0.0, 60.0, 0.01)
    truth = fly(motion, times, rows=30)
    for label, switches in zip(truth.intent, truth.switch_times, strict=True):
        found = switches[np.isfinite(switches)]
        assert np.isnan(switches[found.size :]).all()
        assert np.all(np.diff(found) >= 1.0 - 1e-9)  # the shortest dwell
        changed = times[1:][label[1:] != label[:-1]]
        assert changed.size == found.size > 0
        assert np.all((changed - found >= 0) & (changed - found < 0.01 + 1e-9))
        # Seen at the very moment, the new intent holds.
    row = truth.switch_times[0]
    k = int(np.isfinite(row).sum())
    at = replace_times(motion, np.concatenate([np.nextafter(row[:k], 0), row[:k]]), 60.0)
    after = truth.intent[0, np.searchsorted(times, row[:k])]
    assert np.array_equal(at.intent[0, 1::2], after)
    assert np.all(at.intent[0, 0::2] != after)


def replace_times(motion, times, longest, seed=1):
    """The first of the trajectories above, looked at other times."""
    block = draws(motion, 30, longest, seed)
    return motion.simulate(np.sort(times)[None], Draws(block.uniforms[:1], block.normals[:1]))


def test_no_switch_is_lost_between_samples():
    motion = in_all_ways(3)
    fine = fly(motion, np.arange(0.0, 60.0, 0.5), rows=20, longest=60.0)
    coarse = fly(motion, np.array([0.0, 59.5]), rows=20, longest=60.0)
    assert np.array_equal(fine.switch_times, coarse.switch_times, equal_nan=True)
    assert np.isfinite(fine.switch_times).sum() > 100


def same(one_truth, other):
    return all(np.array_equal(x, y, equal_nan=x.dtype.kind == "f") for x, y in zip(one_truth, other, strict=True))


@pytest.mark.parametrize("axes", [2, 3])
def test_rows_are_bit_for_bit_alone(axes):
    motion = in_all_ways(axes)
    rng = np.random.default_rng(3)
    times = np.sort(rng.random((6, 90)) * 30.0, axis=1)
    block = draws(motion, 6, 30.0)
    together = motion.simulate(times, block)
    for b in range(6):
        alone = motion.simulate(times[b : b + 1], Draws(block.uniforms[b : b + 1], block.normals[b : b + 1]))
        assert same([x[b : b + 1] for x in together], alone)
    assert same(together, motion.simulate(times, block))
    assert not np.array_equal(together.position, fly(motion, times, rows=6, seed=2, longest=30.0).position)


@pytest.mark.parametrize("axes", [2, 3])
def test_a_trajectory_does_not_depend_on_when_it_is_looked_at(axes):
    motion = in_all_ways(axes)
    times = np.linspace(0.0, 40.0, 1601)
    often, seldom = (fly(motion, t, rows=5, longest=40.0) for t in (times, times[::37]))
    for x, y in zip(often[:4], seldom[:4], strict=True):
        assert np.array_equal(x[:, ::37], y)


def test_more_draws_change_nothing():
    motion = in_all_ways(2)
    times = np.arange(0.0, 20.0, 0.1)[None]
    many = draws(motion, 1, 100.0).uniforms
    few = many[:, : motion.need(200, 20.0).uniforms]
    for x, y in zip(*(motion.simulate(times, Draws(u, np.empty((1, 0))))[:4] for u in (many, few)), strict=True):
        assert np.array_equal(x, y)


def test_pickles_without_its_machine_code():
    motion = in_all_ways(3)
    motion = replace(motion, start=replace(motion.start, x=[0, 5]))  # a list becomes a tuple of floats
    truth = fly(motion, np.arange(20.0))
    copy = pickle.loads(pickle.dumps(motion))
    assert copy == motion
    assert hash(copy) == hash(motion)
    assert "_tables" not in vars(copy)  # an address of this process would crash another
    assert same(truth, fly(copy, np.arange(20.0)))


def test_positions_stay_within_the_extent():
    for axes in (2, 3):
        motion = in_all_ways(axes)
        truth = fly(motion, np.linspace(0.0, 60.0, 100), rows=50)
        assert np.abs(truth.position).max() <= motion.extent(60.0)
    straight = Manoeuvres(
        behaviours=(Straight(),), limits=Limits(speed=(0.0, 90.0)),
        start=Start(speed=(90.0, 90.0), heading=(0.0, 0.0), x=(700.0, 700.0), y=(0.0, 0.0)),
    )  # fmt: skip
    # Nothing tighter would do: this one reaches it.
    assert fly(straight, np.array([50.0])).position.max() == pytest.approx(straight.extent(50.0), rel=1e-12)


def test_need_is_enough_for_the_shortest_dwells_and_no_less():
    motion = Manoeuvres(behaviours=(Turn(dwell=Dwell(0.5, kind="fixed")), Straight(dwell=Dwell(0.5, kind="fixed"))))
    needs = [motion.need(10, duration).uniforms for duration in (0.0, 10.0, 20.0)]
    assert needs[2] - needs[1] == needs[1] - needs[0]
    block = draws(motion, 1, 10.0)
    assert np.isfinite(motion.simulate(np.array([[0.0, 10.0]]), block).switch_times).sum() == 20
    with pytest.raises(ValueError, match=r"rows of \d+ uniforms or more"):
        motion.simulate(np.array([[0.0, 20.0]]), block)


GOOD = (Straight(), Turn())
MISTAKES = {
    "Turn: rate must be two increasing numbers": lambda: Turn(rate=(0.3, 0.1)),
    "Turn: rate must be two increasing numbers of 0 or more rad/s": lambda: Turn(rate=(-0.3, 0.1)),
    "Turn: rate must be two": lambda: Turn(rate=0.3),
    "Turn: left must be a number within 0 and 1": lambda: Turn(left=1.5),
    "Climb: pitch_rate must": lambda: Climb(pitch_rate=0.0),
    "Weave: amplitude must": lambda: Weave(amplitude=(0.5, 2.0)),
    "Weave: period must": lambda: Weave(period=(math.nan, 2.0)),
    "Jink: dwell must be a Dwell": lambda: Jink(dwell=3.0),
    "Orbit: name must be": lambda: Orbit(name=""),
    "make_intent: kind must be one of straight, accelerate": lambda: make_intent("loop"),
    "Dwell: kind must be one of fixed": lambda: Dwell(kind="gamma"),
    "Dwell: mean must be": lambda: Dwell(math.inf),
    "Dwell: minimum must be": lambda: Dwell(3.0, 4.0),
    "Dwell: minimum must be within 0.001": lambda: Dwell(3.0, 0.0),
    "Dwell: shape must be": lambda: Dwell(shape=0.0),
    "Limits: speed must be": lambda: Limits(speed=(10.0, 5.0)),
    "Limits: lateral must be": lambda: Limits(lateral=0.0),
    "Limits: climb must be": lambda: Limits(climb=2.0),
    "Limits: altitude must be": lambda: Limits(altitude=(5.0, 5.0)),
    "Start: heading must be": lambda: Start(heading=(1.0, 0.0)),
    "Start: x must be two increasing finite numbers; got 5": lambda: Start(x=5.0),
    "Manoeuvres: axes must be 2 or 3; got 4": lambda: Manoeuvres(behaviours=GOOD, axes=4),
    "Manoeuvres: axes must be 3 for climb": lambda: Manoeuvres(behaviours=(Climb(),)),
    "Manoeuvres: behaviours must be one": lambda: Manoeuvres(behaviours=()),
    "Manoeuvres: behaviours must have different names": lambda: Manoeuvres(behaviours=(Turn(), Turn())),
    "Manoeuvres: transition must have shape": lambda: Manoeuvres(behaviours=GOOD, transition=((0.5, 0.4), (1.0, 0.0))),
    "Manoeuvres: initial must have shape": lambda: Manoeuvres(behaviours=GOOD, initial=(1.0,)),
    "Manoeuvres: start.speed must be within": lambda: Manoeuvres(behaviours=GOOD, limits=Limits(speed=(90.0, 99.0))),
    "Manoeuvres: start.z must be within": lambda: Manoeuvres(
        behaviours=GOOD, axes=3, limits=Limits(altitude=(0.0, 99.0))
    ),
    "Manoeuvres.need: duration must": lambda: Manoeuvres(behaviours=GOOD).need(10, 1e9),
    "Manoeuvres.simulate: times must": lambda: fly(Manoeuvres(behaviours=GOOD), np.array([1.0, 0.0])),
}


@pytest.mark.parametrize("sentence", MISTAKES)
def test_mistakes_are_named(sentence):
    with pytest.raises(ValueError) as caught:
        MISTAKES[sentence]()
    said = str(caught.value)
    assert said.startswith(sentence)
    assert "; got " in said
    assert said.endswith(".")


def test_two_intents_of_a_kind_have_names_of_their_own():
    motion = Manoeuvres(behaviours=(Turn(), Turn(name="hard-turn", rate=(0.5, 0.6))))
    assert motion.intents == ("turn", "hard-turn")
    truth = fly(motion, np.arange(0.0, 50.0, 0.1), rows=20)
    rate = np.abs(truth.acceleration).max(2) / np.linalg.norm(truth.velocity, axis=2)
    assert rate[truth.intent == 1].max() > 0.4
    assert rate[truth.intent == 0].max() < 0.31
    assert all(0.0 <= low < high for low, high in pairwise(truth.switch_times[0, :3]))
