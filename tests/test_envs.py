"""Single environments: Gymnasium's and stable-baselines3's checkers, seeds, ends, scores, options, bad input."""

import copy
import importlib.util
import math
import pickle
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.utils.env_checker import check_env
from straight_source import Straight

import jink.envs
from jink.envs.conformance.comparing import difference
from jink.envs.evaluating import evaluate
from jink.envs.manoeuvring_target import CAP
from jink.envs.mixture import Mixture
from jink.envs.observing import BOUND, nominal_sigma, seen_positions, since_switch
from jink.envs.policies import EstimatorPolicy
from jink.envs.registration import ENVIRONMENTS, TASKS
from jink.envs.scenarios import SUITES, make_scenario
from jink.envs.streams import make_streams
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import make_sensor

resource = pytest.importorskip("resource") if sys.platform != "win32" else None
TARGET = "jink/ManoeuvringTarget-v0"


def made(**options):
    """A short environment of the target task, without Gymnasium's wrappers."""
    return gymnasium.make(TARGET, **{"scenario": Straight()} | options).unwrapped


def played(env, seed, steps, scale=0.05):
    """Everything that ``steps`` random actions bring."""
    env.action_space.seed(seed)
    out = [env.reset(seed=seed)]
    for _ in range(steps):
        out.append(env.step(scale * env.action_space.sample()))
        if out[-1][2] or out[-1][3]:
            out.append(env.reset())
    return copy.deepcopy(out)


def truth_action(env):
    """The true position at the sample observed, as an action."""
    rollout = env.rollout
    return rollout.task.info(rollout.k)["position"][0] / rollout.task.layout.scale


def task_is_there(name):
    module = TASKS[ENVIRONMENTS[name]["task"]][0].partition(":")[0]
    return importlib.util.find_spec(module) is not None


@pytest.mark.parametrize("name", list(ENVIRONMENTS))
def test_checkers_have_nothing_to_say(name, monkeypatch):
    if not task_is_there(name):
        pytest.skip("its task is not there")
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(name).unwrapped)
        sb3.check_env(gymnasium.make(name).unwrapped)
        env = gymnasium.make(name)
        env.reset(seed=1)
        env.step(env.action_space.sample())


def test_registration_is_light_and_by_name():
    code = (
        "import sys, gymnasium, jink.envs; gymnasium.register_envs(jink.envs); "
        "assert {'jink/ManoeuvringTarget-v0', 'jink/AdaptiveFactor-v0', 'jink/AdaptiveFactorContinuous-v0'} "
        "<= set(gymnasium.registry); "
        "assert not {'numba', 'pygame', 'scipy'} & set(sys.modules), 'heavy'"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    for name in ENVIRONMENTS:
        spec = gymnasium.spec(name)
        assert spec.max_episode_steps is None
        assert spec.additional_wrappers == ()
        assert isinstance(spec.entry_point, str)
        assert isinstance(spec.vector_entry_point, str)
    jink.envs.register()  # once more changes nothing
    assert gymnasium.make(f"jink.envs:{TARGET}", scenario=Straight()).spec.id == TARGET


def test_an_episode_has_one_decision_less_than_samples():
    env = made(scenario=Straight(steps=7))
    env.reset(seed=4)
    ends = [env.step(truth_action(env))[2:4] for _ in range(6)]
    assert ends == [(False, False)] * 5 + [(False, True)]


def test_observations_are_the_samples_of_the_source():
    source = Straight(steps=9, kind="range-bearing")
    env = made(scenario=source)
    episodes = source.simulate([make_streams(seeding.np_random(11)[0])])
    observation, info = env.reset(seed=11)
    for k in range(9):
        seen = env.rollout.task.layout.read(observation)
        np.testing.assert_array_equal(seen.measurement, episodes.measurements[0, k])
        assert seen.step == (episodes.times[0, k] - episodes.times[0, k - 1] if k else 0.0)
        np.testing.assert_array_equal(seen.sensor_state, episodes.sensor_states[0, k])
        assert info["time"] == episodes.times[0, k]
        np.testing.assert_array_equal(info["position"], episodes.delivered.position[0, k])
        np.testing.assert_array_equal(info["velocity"], episodes.delivered.velocity[0, k])
        assert info["intent"] == episodes.truth.intent[0, k]
        assert info["detected"] is bool(episodes.detected[0, k])
        if k < 8:
            observation, _, _, truncated, info = env.step(truth_action(env))
    assert truncated


def test_scales_are_powers_of_two_and_wide_enough():
    layout = made(scenario=Straight()).rollout.task.layout
    assert math.frexp(layout.scale)[0] == 0.5
    assert 2 * Straight.extent <= layout.scale < 4 * Straight.extent
    assert math.frexp(layout.speed_scale)[0] == 0.5


def test_reward_is_the_error_over_the_error_of_a_measurement():
    env = made(scenario=Straight(sigma=5.0))
    env.reset(seed=2)
    away = np.array([30.0, 40.0]) / env.rollout.task.layout.scale
    _, reward, _, _, info = env.step(truth_action(env) + away)
    assert info["error"] == pytest.approx(50.0, rel=1e-12)  # two roundings of the position
    assert reward == pytest.approx(-50.0 / (5.0 * math.sqrt(2.0)), rel=1e-12)
    assert env.step(truth_action(env) + 20 * away)[1] == -CAP
    assert env.step(truth_action(env))[1] == 0.0


def test_nominal_sigma_of_each_kind_of_sensor():
    far = np.array([[300.0, 400.0]])
    assert nominal_sigma(make_sensor("position", axes=2, sigma=[3.0, 4.0]), far) == pytest.approx(5.0)
    assert nominal_sigma(make_sensor("range-bearing", sigma=[3.0, 0.01]), far) == pytest.approx(math.hypot(3.0, 5.0))
    assert nominal_sigma(make_sensor("bearing", sigma=0.01), far) == pytest.approx(5.0 * math.sqrt(2.0))
    assert nominal_sigma(make_sensor("range", sigma=3.0), far) == pytest.approx(3.0 * math.sqrt(2.0))
    doppler = make_sensor("range-bearing-rate", sigma=[3.0, 0.01, 99.0])
    assert nominal_sigma(doppler, far) == pytest.approx(math.hypot(3.0, 5.0))


def test_time_since_a_switch_counts_from_the_last_one():
    times = np.array([[0.0, 1.0, 2.0, 3.0, 4.0]])
    switches = np.array([[0.5, 0.75, 3.0, np.nan]])
    np.testing.assert_array_equal(since_switch(times, switches), [[0.0, 0.25, 1.25, 0.0, 1.0]])


def test_intent_and_the_time_since_its_start_are_of_one_moment():
    """Also where measurements arrive late: a new intent is never older than the step it appeared in."""
    env, changes = gymnasium.make(TARGET, scenario="switch-irregular-v0", lost_after=math.inf).unwrapped, 0
    for seed in range(3):
        _, info = env.reset(seed=seed)
        assert info["since_switch"] <= 0.25 + 1e-9  # the latency; to a tick of 15 ps
        over = False
        while not over:
            before = info
            *_, over, info = env.step(np.zeros(2))
            if info["intent"] != before["intent"]:
                changes += 1
                assert info["since_switch"] < info["time"] - before["time"] + 1e-9
    assert changes > 10


def test_a_bearing_alone_gives_no_place():
    sensor = make_sensor("bearing")
    assert np.isnan(seen_positions(sensor, np.array([[0.5]]), np.zeros((1, 4)))).all()
    assert np.isfinite(seen_positions(make_sensor("range-bearing"), np.array([[9.0, 0.5]]), np.zeros((1, 4)))).all()
    env = gymnasium.make(TARGET, scenario="passive-ship-v0").unwrapped
    env.reset(seed=0)
    assert np.isnan(env.rollout.task.picture(0, 0).seen).all()


def test_a_lost_track_terminates_and_giving_up_never_pays():
    env = made(scenario=Straight(steps=12), lost_after=5.0, lost_steps=3)
    env.reset(seed=0)
    far = np.array([1.0, 1.0])
    assert [env.step(far)[1:4] for _ in range(2)] == [(-CAP, False, False)] * 2
    env.step(truth_action(env))  # found again: the count starts anew
    assert [env.step(far)[2] for _ in range(2)] == [False, False]
    _, reward, terminated, truncated, _ = env.step(far)
    assert (terminated, truncated) == (True, False)
    assert reward == -CAP * (11 - 5)


def test_lost_at_the_last_decision_is_terminated_not_truncated():
    env = made(scenario=Straight(steps=4), lost_after=5.0, lost_steps=3)
    env.reset(seed=0)
    assert [env.step(np.ones(2))[2:4] for _ in range(3)] == [(False, False), (False, False), (True, False)]


def test_equal_seeds_equal_everything_other_seeds_other_things():
    left, right, other = played(made(), 5, 30), played(made(), 5, 30), played(made(), 6, 30)
    assert difference(left, right) == ""
    assert difference(left[0], other[0])
    env = made()
    again = [played(env, 5, 30), played(env, 5, 30)]
    assert difference(again[0], left) == "" == difference(again[1], left)


def test_reset_without_a_seed_goes_on():
    env = made()
    first = env.reset(seed=1)[0]
    second, third = env.reset()[0], env.reset()[0]
    assert not np.array_equal(first, second)
    assert not np.array_equal(second, third)
    env.reset(seed=1)
    np.testing.assert_array_equal(env.reset()[0], second)


def test_without_any_seed_episodes_differ():
    assert not np.array_equal(made().reset()[0], made().reset()[0])


def test_a_generator_of_ones_own():
    env = made()
    expected = env.reset(seed=9)[0]
    env.np_random = np.random.default_rng(9)
    assert env.np_random_seed == -1
    np.testing.assert_array_equal(env.reset()[0], expected)


def test_stagger_shortens_the_first_episode_only():
    source = Straight(steps=40)
    lengths = []
    for seed in range(8):
        env = made(scenario=source, stagger=True, lost_after=math.inf)
        env.reset(seed=seed)
        for _ in range(2):
            count = 1
            while not env.step(np.zeros(2))[3]:
                count += 1
            lengths.append(count)
            env.reset()
    assert set(lengths[1::2]) == {39}
    assert len(set(lengths[::2])) > 4
    assert all(1 <= length <= 39 for length in lengths)


def test_a_track_lost_in_a_staggered_episode_costs_the_decisions_it_has():
    options = {"scenario": Straight(steps=40), "stagger": True}
    for seed in range(6):
        env = made(lost_after=math.inf, **options)
        env.reset(seed=seed)
        length = 1
        while not env.step(np.ones(2))[3]:
            length += 1
        env = made(lost_after=5.0, lost_steps=1, **options)
        for decisions in (length, 39):  # the second episode is a whole one
            env.reset(seed=seed if decisions == length else None)
            _, reward, terminated, _, _ = env.step(np.ones(2))
            assert terminated and reward == -CAP * decisions


@pytest.mark.parametrize("way", ["pickle", "deepcopy"])
def test_a_copy_goes_on_as_the_original(way):
    env = made()
    played(env, 3, 5)
    twin = copy.deepcopy(env) if way == "deepcopy" else pickle.loads(pickle.dumps(env))
    for _ in range(4):
        assert difference(env.step(np.full(2, 0.01)), twin.step(np.full(2, 0.01))) == ""
    assert difference(env.reset(), twin.reset()) == ""


def test_spec_survives_pickling():
    env = gymnasium.make(TARGET, scenario="switch-v0", steps=30)
    twin = gymnasium.make(pickle.loads(pickle.dumps(env.spec)))
    assert difference(env.reset(seed=1), twin.reset(seed=1)) == ""


def peak_memory_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0**2 if sys.platform == "darwin" else 1024.0)


@pytest.mark.skipif(sys.platform == "win32", reason="needs the resource module")
def test_thousands_of_resets_without_growth():
    env = made(scenario=Straight(steps=100))
    for _ in range(200):
        env.reset()
    before = peak_memory_mb()
    for _ in range(3000):
        env.reset()
        env.step(np.zeros(2))
    assert peak_memory_mb() - before < 15.0  # an episode is 20 kB: keeping them would take 60 MB


BAD_ACTIONS = [
    np.array([np.nan, 0.0]),
    np.array([0.0, 1.0001]),
    np.array([-np.inf, 0.0]),
    np.zeros(3),
    np.zeros((1, 2)),
    np.array([True, False]),
    np.array(["a", "b"]),
    np.array([1j, 0j]),
    0.0,
    None,
    [[0.0], [0.0, 1.0]],
]


@pytest.mark.parametrize("action", BAD_ACTIONS, ids=repr)
def test_an_impossible_action_changes_nothing(action):
    env, twin = made(), made()
    env.reset(seed=1)
    twin.reset(seed=1)
    with pytest.raises(ValueError, match=r"^step: action must .*; got .*\. .*\.$"):
        env.step(action)
    assert difference(env.step(np.zeros(2)), twin.step(np.zeros(2))) == ""


@pytest.mark.parametrize(
    ("name", "action", "said"),
    [
        (TARGET, np.zeros((1, 2)), r"numbers of shape \(2,\); got float64 \(1, 2\)\. Divide"),
        (TARGET, np.array([2.0, 0.0]), r"within -1 \.\. 1; got \[2\.0, 0\.0\]\. Clip"),
        ("jink/AdaptiveFactor-v0", np.array([1]), r"integers of shape \(\); got int64 \(1,\)\. Give"),
        ("jink/AdaptiveFactor-v0", 5, r"0 \.\. 4; got 5\. Give"),
        ("jink/AdaptiveFactorContinuous-v0", 0.5, r"numbers of shape \(1,\); got float64 \(\)\. Give"),
        ("jink/AdaptiveFactorContinuous-v0", np.array([1.5]), r"within -1 \.\. 1; got 1\.5\. Clip"),
    ],
)
def test_a_single_action_is_not_answered_as_a_batch(name, action, said):
    env = gymnasium.make(name, steps=20, scenario="switch-v0").unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match=said):
        env.step(action)


@pytest.mark.parametrize(
    "action", [[0.1, 0.2], (0.1, 0.2), np.array([0.1, 0.2]), np.array([0, 1]), np.float32([0.5, 1])]
)
def test_any_kind_of_number_is_an_action(action):
    env = made()
    env.reset(seed=1)
    env.step(action)


def test_float64_actions_keep_every_digit():
    env = made()
    env.reset(seed=1)
    exact = truth_action(env)
    env.step(exact)
    assert env.rollout.task.info(env.rollout.k)["error"][0] == 0.0
    env.reset(seed=1)
    assert env.step(exact.astype(np.float32))[4]["error"] > 0.0


def test_the_action_is_left_alone():
    env, action = made(), np.array([0.1, 0.2])
    env.reset(seed=1)
    env.step(action)
    np.testing.assert_array_equal(action, [0.1, 0.2])


def test_order_of_calls():
    env = made(scenario=Straight(steps=3))
    for call in (lambda: env.step(np.zeros(2)), made(render_mode="rgb_array").render):
        with pytest.raises(ResetNeeded, match=r"Call reset"):
            call()
    env.reset(seed=1)
    env.step(np.zeros(2))
    assert env.step(np.zeros(2))[3]
    with pytest.raises(ResetNeeded, match=r"^step: the episode must be under way; it is over\. Call reset"):
        env.step(np.zeros(2))
    env.reset()
    env.step(np.zeros(2))
    env.close()
    env.close()


@pytest.mark.parametrize("seed", [-1, 1.5, "a", True])
def test_a_bad_seed_changes_nothing(seed):
    env = made()
    env.reset(seed=1)
    with pytest.raises(ValueError, match=r"^reset: seed must be an integer >= 0; got "):
        env.reset(seed=seed)
    twin = made()
    twin.reset(seed=1)
    assert difference(env.step(np.zeros(2)), twin.step(np.zeros(2))) == ""
    env.reset(seed=np.int64(3))


def test_unknown_reset_options_are_refused():
    with pytest.raises(ValueError, match=r"^reset: options must be empty; got \['scenario'\]"):
        made().reset(options={"scenario": "switch-v0"})
    made().reset(options={})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"scenario": "swich-v0"}, "Did you mean switch-v0"),
        ({"scenario": None, "suite": "swtch"}, "must be one of switch"),
        ({"scenario": "surge-v0", "suite": "switch"}, "must be one of suite switch"),
        ({"scenario": Straight(), "suite": "switch"}, "got both"),
        ({"scenario": "switch-v0", "tracks": "x.csv"}, "must come without scenario"),
        ({"scenario": None, "suite": "switch", "tracks": "x.csv"}, "must come without suite"),
        ({"scenario": None, "suite": "radar"}, "must have the same sensor"),
        ({"scenario": "switch-v0", "lost_aftr": 3.0}, "Did you mean lost_after"),
        ({"scenario": "switch-v0", "stepz": 3}, "Did you mean steps"),
        ({"scenario": Straight(), "stepz": 3}, "must be those of the task"),
        ({"scenario": "switch-v0", "lost_after": 0.0}, "lost_after must be > 0"),
        ({"scenario": "switch-v0", "lost_steps": 1.5}, "lost_steps an integer"),
        ({"scenario": 3}, "must be a name or a Scenario"),
        ({"scenario": None, "suite": "surge", "steps": 20}, r"suite surge; got a refusal from surge-\S+-v0: Placed"),
        ({"scenario": None, "tracks": "x.csv", "stepz": 3}, r"stepz must be .*Did you mean steps\? There are steps, "),
        ({"scenario": None, "tracks": "x.csv", "wings": 2}, r"with tracks; .*There are steps, .*, lost_after, lost_st"),
        ({"task": "fly"}, "must be one of manoeuvring-target"),
        ({"scenario": Straight(steps=1)}, "must have >= 2 samples"),
    ],
)
def test_options_that_make_no_sense(options, said):
    with pytest.raises(ValueError, match=said) as caught:
        made(**options)
    assert str(caught.value).endswith((".", "?"))
    assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("ignore:.*render_mode")
def test_an_unknown_render_mode_is_refused():
    with pytest.raises(ValueError, match="render_mode must be human or rgb_array"):
        made(render_mode="ansi")


def test_parameters_of_the_scenario_by_keyword():
    env = gymnasium.make(TARGET, steps=25, sigma=3.0, lost_after=7.0).unwrapped
    source = env.rollout.source
    assert (source.id, source.steps, source.sensor.sigma) == ("switch-v0", 25, (3.0, 3.0))
    given = gymnasium.make(TARGET, scenario=make_scenario("switch-v0"), steps=25).unwrapped.rollout.source
    assert given.steps == 25


def test_a_suite_draws_one_of_its_scenarios_per_episode():
    env = gymnasium.make(TARGET, suite="switch", steps=20).unwrapped
    source = env.rollout.source
    assert [part.id for part in source.parts] == list(SUITES["switch"])
    env.reset(seed=0)
    intents = {source.intents[env.reset()[1]["intent"]] for _ in range(60)}
    assert {"straight", "orbit"} <= intents  # no single scenario of the suite starts with both


def test_a_mixture_gives_each_row_an_episode_of_one_part():
    parts = Straight(id="a-v0"), Straight(id="b-v0", shift=500.0)
    mixed = Mixture("both", parts)
    rows = [seeding.np_random(seed)[0] for seed in range(12)]
    episodes = mixed.simulate([make_streams(row) for row in rows])
    which = []
    for b in range(12):
        streams = make_streams(seeding.np_random(b)[0])
        which.append(int(streams[0].integers(2)))
        alone = parts[which[b]].simulate([streams])
        for name in ("times", "measurements", "noise"):
            np.testing.assert_array_equal(getattr(episodes, name)[b], getattr(alone, name)[0])
        np.testing.assert_array_equal(episodes.truth.position[b], alone.truth.position[0])
        np.testing.assert_array_equal(episodes.truth.switch_times[b], alone.truth.switch_times[0])
    assert 2 < sum(which) < 10
    with pytest.raises(ValueError, match="must have the same samples"):
        Mixture("both", (Straight(), Straight(id="c-v0", steps=5)))


def test_recorded_tracks_are_a_source():
    from jink.envs.simulate import simulate_tracks

    tracks = simulate_tracks(make_scenario("switch-v0", steps=60), 3, 0)
    env = gymnasium.make(TARGET, tracks=tracks, steps=20).unwrapped
    env.reset(seed=0)
    assert env.rollout.source.steps == 20
    for _ in range(19):
        _, reward, _, truncated, _ = env.step(truth_action(env))
        assert reward == pytest.approx(0.0, abs=1e-9)
    assert truncated


def test_observations_lie_in_finite_bounds_whatever_happens():
    wild = Straight(sigma=1e12, steps=5)
    env = made(scenario=wild, lost_after=math.inf)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert np.abs(observation).max() == BOUND


@pytest.mark.parametrize(
    "source", [Straight(steps=30), Straight(steps=30, kind="range-bearing"), Straight(steps=30, axes=3)]
)
def test_an_estimator_plays_exactly_as_it_filters(source):
    estimator = make_estimator("imm", sensor=source.sensor)
    episodes = source.simulate([make_streams(seeding.np_random(7 + row)[0]) for row in range(5)])
    run = estimator.run(episodes.measurements, episodes.times, sensor_states=episodes.sensor_states)
    errors = np.sqrt(np.square(run.position - episodes.delivered.position).sum(axis=-1))[:, :-1]
    env = made(scenario=source)
    result = evaluate(env, EstimatorPolicy(estimator, env), episodes=5, seed=7)
    np.testing.assert_array_equal(result.errors, errors)
    assert result.lengths.tolist() == [29] * 5
    assert not result.terminated.any()
    np.testing.assert_array_equal(result.returns, result.rewards.sum(axis=1))


def test_the_batch_run_of_a_real_scenario():
    from jink.envs.simulate import simulate_tracks

    scenario = make_scenario("joint-v0", steps=80)
    tracks = simulate_tracks(scenario, 6, 3)
    estimator = make_estimator("imm", sensor=scenario.sensor, acceleration=3.0, speed=15.0)
    run = estimator.run(tracks.measurements, tracks.times, noise=tracks.noise)
    errors = np.linalg.norm(run.position - tracks.truth, axis=-1)[:, :-1]
    env = gymnasium.make(TARGET, scenario="joint-v0", steps=80, lost_after=math.inf)
    result = evaluate(env, EstimatorPolicy(estimator, env), episodes=6, seed=3)
    np.testing.assert_array_equal(result.errors, errors)


def test_a_policy_as_a_function_and_its_own_reset():
    source = Straight(steps=15)
    env = made(scenario=source)
    policy = EstimatorPolicy(make_estimator("kf-cv", sensor=source.sensor), env)

    def play():
        policy.reset()
        observation, _ = env.reset(seed=2)
        errors = []
        for _ in range(14):
            observation, *_, info = env.step(policy(observation))
            errors.append(info["error"])
        return errors

    first = play()
    assert play() == first
    assert evaluate(env, policy, 1, seed=2).errors[0].tolist() == first


def test_an_estimator_for_another_sensor_is_refused():
    env = made()
    with pytest.raises(ValueError, match="must be for position in 2 axes; got range-bearing"):
        EstimatorPolicy(make_estimator("imm", sensor=make_sensor("range-bearing")), env)
    with pytest.raises(ValueError, match=r"env must be jink/ManoeuvringTarget"):
        EstimatorPolicy(make_estimator("imm", sensor=env.rollout.source.sensor), gymnasium.make("CartPole-v1"))
    with pytest.raises(ValueError, match="episodes must be an integer >= 1"):
        evaluate(env, lambda observation: np.zeros(2), episodes=0)


def test_evaluating_keeps_the_agents_error_or_the_one_asked_for():
    options = {"scenario": "switch-v0", "steps": 20}
    single = gymnasium.make("jink/AdaptiveFactor-v0", **options)
    batch = gymnasium.make_vec("jink/AdaptiveFactor-v0", num_envs=2, **options)
    for env, act in ((single, lambda seen: 0), (batch, lambda seen: np.zeros(2, dtype=np.int64))):
        found = evaluate(env, act, episodes=2).errors
        assert np.isfinite(found).all()
        np.testing.assert_array_equal(found, evaluate(env, act, episodes=2, error="error_nominal").errors)
        assert (found != evaluate(env, act, episodes=2, error="inflation").errors).all()
        with pytest.raises(ValueError, match=r"'eror'\. The environment tells detected, error_agent, .*, time\.$"):
            evaluate(env, act, episodes=2, error="eror")
    assert np.isnan(evaluate(gymnasium.make("CartPole-v1"), lambda seen: 0, episodes=1).errors).all()


def test_frames_and_pictures(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = made(render_mode="rgb_array", scenario=Straight(kind="range-bearing"))
    env.reset(seed=1)
    first = env.render()
    env.step(truth_action(env))
    assert first.dtype == np.uint8
    assert first.ndim == 3
    assert not np.array_equal(first, env.render())
    task = env.rollout.task
    picture = task.picture(0, 1)
    assert picture.times.shape == (2,)
    np.testing.assert_array_equal(picture.estimate[0], picture.truth[0])
    assert np.isnan(picture.estimate[1]).all()
    # One measurement errs by some sigma: 5 m along, 0.02 rad across.
    assert np.abs(picture.seen[0] - picture.truth[0]).max() < 60.0
    env.close()
    with pytest.warns(UserWarning, match="render_mode must be chosen"):
        assert made().render() is None
