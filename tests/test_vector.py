"""Native vector environments: what SyncVectorEnv of singles gives, bit for bit, in every autoreset mode."""

import copy
import io
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Discrete
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers
from rich.console import Console
from straight_source import Straight

from jink.envs.checking import Check, Report, check_vector_env, print_check
from jink.envs.conformance.comparing import difference, rows_of
from jink.envs.evaluating import evaluate
from jink.envs.policies import EstimatorPolicy
from jink.envs.single import TargetEnv
from jink.envs.task import Outcome
from jink.envs.vector import TargetVectorEnv
from jink.estimators.recipes import make_estimator

TARGET = "jink/ManoeuvringTarget-v0"
MODES = [mode.value for mode in AutoresetMode]
ENDINGS = {
    "truncated": {},
    "lost in the middle": {"lost_after": 4.0, "lost_steps": 2},
    "staggered": {"stagger": True},
    "bearings": {"scenario": Straight(kind="range-bearing", missed=0.4)},
    "suite": {"scenario": None, "suite": "switch", "steps": 9},
}


def native(num_envs=4, mode="NextStep", **options):
    options = {"scenario": Straight(), "autoreset_mode": mode} | options
    return gymnasium.make_vec(TARGET, num_envs, **options)


def sync(num_envs=4, mode="NextStep", **options):
    options = {"scenario": Straight()} | options
    return gymnasium.make_vec(
        TARGET, num_envs, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **options
    )


def near(env, seed):
    """Random actions, most of them within a few sigma of the targets."""
    random = np.random.default_rng(seed)
    while True:
        yield random.normal(0.0, 0.02, env.action_space.shape).clip(-1.0, 1.0)


def steps(env, seed, count, actions):
    """All results of a run; with autoreset disabled, those of masked resets too."""
    yield env.reset(seed=seed)
    ended = np.zeros(env.num_envs, dtype=bool)
    for _ in range(count):
        if env.metadata["autoreset_mode"] is AutoresetMode.DISABLED and ended.any():
            yield env.reset(options={"reset_mask": ended})
        result = env.step(next(actions))
        ended = result[2] | result[3]
        yield result


@pytest.mark.parametrize("ending", list(ENDINGS))
@pytest.mark.parametrize("mode", MODES)
def test_native_is_sync_is_single(mode, ending):
    a, b = native(mode=mode, **ENDINGS[ending]), sync(mode=mode, **ENDINGS[ending])
    lost = over = 0
    for x, y in zip(steps(a, 3, 40, near(a, 1)), steps(b, 3, 40, near(b, 1)), strict=True):
        assert difference(x, y) == ""
        if len(x) == 5:
            lost, over = lost + x[2].sum(), over + x[3].sum()
    assert over > 0 if ending != "lost in the middle" else lost > 10


@pytest.mark.parametrize("mode", MODES)
def test_rows_are_single_environments_until_their_end(mode):
    env = native(5, mode=mode)
    singles = [gymnasium.make(TARGET, scenario=Straight()) for _ in range(5)]
    seen = env.reset(seed=[7, 3, None, 11, 3])
    starts = [single.reset(seed=seed) for single, seed in zip(singles, [7, 3, 0, 11, 3], strict=True)]
    for row in (0, 1, 3, 4):
        np.testing.assert_array_equal(seen[0][row], starts[row][0])
    np.testing.assert_array_equal(seen[0][1], seen[0][4])
    for _ in range(10):
        actions = np.random.default_rng(1).uniform(-0.1, 0.1, (5, 2))
        observations, rewards, terminated, truncated, infos = env.step(actions)
        for row in (0, 1, 3, 4):
            observation, reward, over, up, info = singles[row].step(actions[row])
            np.testing.assert_array_equal(observations[row], observation)
            assert (rewards[row], terminated[row], truncated[row]) == (reward, over, up)
            assert {key: infos[key][row] for key in ("time", "error", "intent")} == {
                key: info[key] for key in ("time", "error", "intent")
            }


def test_lost_at_the_last_decision_is_terminated_not_truncated():
    env = native(2, scenario=Straight(steps=4), lost_after=5.0, lost_steps=3)
    env.reset(seed=0)
    ends = [env.step(np.ones((2, 2)))[2:4] for _ in range(3)]
    assert ends[2][0].all() and not ends[2][1].any()


def test_the_next_step_resets_with_reward_zero():
    env = native(2, scenario=Straight(steps=3))
    env.reset(seed=1)
    env.step(np.zeros((2, 2)))
    assert env.step(np.zeros((2, 2)))[3].all()
    observations, rewards, terminated, truncated, infos = env.step(np.full((2, 2), np.nan))  # nobody takes it
    assert not rewards.any() and not terminated.any() and not truncated.any()
    assert (infos["time"] == 0.0).all() and (observations[:, 2] == 0.0).all()


def test_the_same_step_gives_both_observations():
    env = native(3, mode="SameStep", scenario=Straight(steps=3))
    env.reset(seed=1)
    first = env.step(np.zeros((3, 2)))[4]
    assert "final_obs" not in first
    observations, _, _, truncated, infos = env.step(np.zeros((3, 2)))
    assert truncated.all()
    assert (observations[:, 2] == 0.0).all()
    assert all(last[2] > 0.0 for last in infos["final_obs"])
    assert (infos["final_info"]["time"] > infos["time"]).all()
    assert infos["final_info"]["_error"].all() and infos["_final_info"].all()


def test_disabled_names_the_rows_that_are_over():
    env = native(14, mode="Disabled", lost_after=3.0, lost_steps=1)
    env.reset(seed=0)
    actions = env.unwrapped.rollout.task.info(env.unwrapped.rollout.k)["position"] / 2048.0
    actions[[1, 12]] = 1.0
    terminated = env.step(actions)[2]
    assert np.flatnonzero(terminated).tolist() == [1, 12]
    with pytest.raises(ResetNeeded, match=r"^step: every episode must be under way; over: target 1, 12\. Call reset"):
        env.step(actions)
    observations, infos = env.reset(options={"reset_mask": terminated})
    assert infos["_time"].tolist() == terminated.tolist()
    assert not infos["position"][~terminated].any()
    assert (observations[~terminated, 2] > 0.0).all() and not observations[terminated, 2].any()
    env.step(actions)


def test_reset_mask_works_in_every_mode_and_is_left_alone():
    for mode in MODES:
        env, twin = native(mode=mode), native(mode=mode)
        for one in (env, twin):
            one.reset(seed=1)
            one.step(np.zeros((4, 2)))
        options = {"reset_mask": np.array([True, False, False, True])}
        env.reset(options=options)
        assert list(options) == ["reset_mask"]
        assert options["reset_mask"].tolist() == [True, False, False, True]
        x, y = env.step(np.zeros((4, 2))), twin.step(np.zeros((4, 2)))
        for row, same in enumerate((False, True, True, False)):
            assert (difference(rows_of(x, row, 4), rows_of(y, row, 4)) == "") is same


@pytest.mark.parametrize(
    "options",
    [
        {"reset_mask": [True] * 4},
        {"reset_mask": np.ones(3, dtype=bool)},
        {"reset_mask": np.ones(4)},
        {"reset_mask": np.zeros(4, dtype=bool)},
        {"rest_mask": np.ones(4, dtype=bool)},
    ],
)
def test_bad_reset_options_change_nothing(options):
    env, twin = native(), native()
    env.reset(seed=1), twin.reset(seed=1)
    with pytest.raises(ValueError, match=r"^reset: (reset_mask|options) must be"):
        env.reset(options=options)
    assert difference(env.step(np.zeros((4, 2))), twin.step(np.zeros((4, 2)))) == ""


@pytest.mark.parametrize("seed", [-1, [1, 2], [1, 2, -3, 4], "a", 0.5])
def test_bad_seeds_change_nothing(seed):
    env, twin = native(), native()
    env.reset(seed=1), twin.reset(seed=1)
    with pytest.raises(ValueError, match=r"^reset: seed must .*; got "):
        env.reset(seed=seed)
    assert difference(env.step(np.zeros((4, 2))), twin.step(np.zeros((4, 2)))) == ""


@pytest.mark.parametrize(
    ("actions", "said"),
    [
        (np.full((4, 2), np.nan), "finite and within"),
        (np.zeros((3, 2)), r"shape \(4, 2\)"),
        (np.zeros(8), r"shape \(4, 2\)"),
        (np.zeros((4, 2), dtype=bool), "bool"),
        (np.array([[0, 0], [0, 0], [0, 2.0], [0, 0]]), r"got \[0.0, 2.0\] for target 2"),
        ([[0, 0], [0]], "different lengths"),
    ],
)
def test_bad_actions_change_nothing(actions, said):
    env, twin = native(), native()
    env.reset(seed=1), twin.reset(seed=1)
    with pytest.raises(ValueError, match=said):
        env.step(actions)
    assert difference(env.step(np.zeros((4, 2))), twin.step(np.zeros((4, 2)))) == ""


def test_order_of_calls():
    env = native()
    with pytest.raises(ResetNeeded, match="Call reset first"):
        env.step(np.zeros((4, 2)))
    with pytest.raises(ResetNeeded, match="Call reset without a mask"):
        env.reset(options={"reset_mask": np.array([True, False, False, False])})
    env.reset(options={"reset_mask": np.ones(4, dtype=bool)})
    env.step(np.zeros((4, 2)))
    env.close()
    env.close()


@pytest.mark.parametrize("count", [0, -1, 1.5, True])
def test_a_bad_number_of_environments(count):
    with pytest.raises(ValueError, match="num_envs must be an integer >= 1"):
        native(count)


def test_the_length_of_an_episode_is_the_scenarios():
    with pytest.raises(ValueError, match="max_episode_steps must be left out"):
        native(max_episode_steps=5)


def test_an_unknown_mode():
    with pytest.raises(ValueError, match="autoreset_mode must be one of NextStep, SameStep, Disabled; got 'Never'"):
        native(mode="Never")
    assert native(mode="SAME_STEP").metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert native(mode=AutoresetMode.DISABLED).metadata["autoreset_mode"] is AutoresetMode.DISABLED
    assert TargetEnv.metadata.get("autoreset_mode") is None


def test_make_vec_takes_the_native_one():
    env = gymnasium.make_vec(f"jink.envs:{TARGET}", 3, scenario=Straight())
    assert type(env) is TargetVectorEnv
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert env.spec.id == TARGET
    assert pickle.loads(pickle.dumps(env.spec)).id == TARGET
    assert isinstance(sync(), SyncVectorEnv)


def test_seeds_and_generators_by_row():
    env, twin = native(), sync()
    env.reset(seed=5), twin.reset(seed=5)
    assert env.np_random_seed == twin.np_random_seed == (5, 6, 7, 8)
    assert [generator.random() for generator in env.np_random] == [generator.random() for generator in twin.np_random]


@pytest.mark.parametrize("mode", MODES)
def test_a_pickled_copy_goes_on(mode):
    env = native(mode=mode, lost_after=4.0, lost_steps=2)
    run = steps(env, 2, 45, near(env, 2))
    for _ in range(20):
        last = next(run)
    twins = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    ended = last[2] | last[3] if len(last) == 5 else np.zeros(4, dtype=bool)
    actions = near(env, 3)
    for _ in range(20):
        if mode == "Disabled" and ended.any():
            for one in (env, *twins):
                one.reset(options={"reset_mask": ended})
        action = next(actions)
        want = env.step(action)
        ended = want[2] | want[3]
        for twin in twins:
            assert difference(want, twin.step(action)) == ""


def test_interleaved_environments_are_those_alone():
    alone = [copy.deepcopy(result) for result in steps(native(), 1, 30, near(native(), 1))]
    a, b, single = native(), native(3), gymnasium.make(TARGET, scenario=Straight(), lost_after=1e9)
    single.reset(seed=4)
    others = steps(b, 9, 30, near(b, 9))
    for want, got in zip(alone, steps(a, 1, 30, near(a, 1)), strict=True):
        assert difference(want, got) == ""
        next(others)
        if single.step(np.zeros(2))[3]:
            single.reset()


@pytest.mark.parametrize("mode", MODES)
def test_gymnasiums_wrappers(mode):
    env = wrappers.RecordEpisodeStatistics(native(mode=mode))
    lengths = []
    for result in steps(env, 1, 40, near(env, 1)):
        if "episode" in result[-1]:
            lengths += result[-1]["episode"]["l"][result[-1]["_episode"]].tolist()
    assert lengths and set(lengths) == {11}
    listed = wrappers.DictInfoToList(wrappers.ClipReward(native(mode=mode), -1.0, 0.0))
    for result in steps(listed, 1, 30, near(listed, 1)):
        assert len(result[-1]) == 4
        if len(result) == 5:
            assert (result[1] >= -1.0).all()
    if mode != "SameStep":
        rescaled = wrappers.RescaleObservation(native(mode=mode), -1.0, 1.0)
        assert sum(1 for _ in steps(rescaled, 1, 30, near(rescaled, 1))) > 30
    if mode == "NextStep":
        normal = wrappers.NormalizeReward(wrappers.NormalizeObservation(native(mode=mode)))
        assert all(np.isfinite(result[0]).all() for result in steps(normal, 1, 30, near(normal, 1)))


@pytest.mark.parametrize("mode", MODES)
def test_an_estimator_plays_many_targets(mode):
    source = Straight(steps=14)
    env, single = native(3, mode=mode, scenario=source), gymnasium.make(TARGET, scenario=source)
    estimator = make_estimator("imm", sensor=source.sensor)
    batch = evaluate(env, EstimatorPolicy(estimator, env), episodes=7, seed=5)
    alone = evaluate(single, EstimatorPolicy(estimator, single), episodes=7, seed=5)
    assert difference(batch, alone) == ""
    assert batch.lengths.tolist() == [13] * 7


@pytest.mark.parametrize("mode", MODES)
def test_a_policy_is_told_which_targets_have_just_started(mode):
    class Watching:
        started = 0

        def act(self, observations, first):
            np.testing.assert_array_equal(first, observations[:, 2] == 0.0)  # the time step, 0 at the first sample
            self.started += first.sum()
            return np.where(np.arange(5)[:, None] < 2, 1.0, 0.0) * np.ones((5, 2))

    policy = Watching()
    evaluate(native(5, mode=mode, lost_after=60.0, lost_steps=2), policy, episodes=5)
    assert policy.started > 8


def test_the_conformance_test_passes_ours():
    report = check_vector_env(TARGET, 3, 0, 40, scenario=Straight(steps=12), lost_after=8.0, lost_steps=2)
    assert report.ok, report.of("failed")
    assert [(check.name, check.mode) for check in report.of("skipped")] == [
        ("reset mask", "NextStep"),
        ("reset mask", "SameStep"),
    ]
    assert {check.mode for check in report.checks if check.name == "singles"} == set(MODES)


def test_the_conformance_test_finds_gymnasiums_own_cartpole():
    report = check_vector_env("CartPole-v1", 3, 0, 60)
    assert {check.name for check in report.of("failed")} == {"rows", "singles"}
    assert "against" in report.of("failed")[1].sentence
    out = io.StringIO()
    print_check(report, Console(file=out, width=200))
    assert "CartPole-v1: 9 passed, 2 failed, 4 skipped" in out.getvalue()


class Broken(TargetVectorEnv):
    """A vector environment with one fault."""

    def __init__(self, num_envs, fault, **options):
        self.fault, self.calls = fault, 0
        super().__init__("manoeuvring-target", num_envs, scenario=Straight(steps=4), **options)
        if fault == "space":
            self.observation_space = Box(-1.0, 1.0, (num_envs, 5))
        if fault == "metadata":
            self.metadata = {}
        if fault == "pickle":
            self.key = lambda: 0

    def reset(self, *, seed=None, options=None):
        if self.fault == "unseeded":
            seed = None
        if self.fault == "repeats" and seed is None and not options:
            seed = 0
        if self.fault == "deaf":
            options = None
        observations, infos = super().reset(seed=seed, options=options)
        return self.spoil(observations), infos

    def spoil(self, observations):
        if self.fault == "buffer":
            self.buffer = getattr(self, "buffer", observations)
            self.buffer[:] = observations
            return self.buffer
        if self.fault == "neighbours":
            observations[1:, 0] += observations[0, 0]
        return observations

    def step(self, actions):
        observations, rewards, terminated, truncated, infos = super().step(actions)
        self.calls += 1
        if self.fault == "outside":
            observations[0, 3] = 2.0
        if self.fault == "types":
            rewards = rewards.tolist()
        if self.fault == "mask":
            del infos["_time"]
        if self.fault == "late" and self.calls > 6:
            rewards[0] += 1.0
        if self.fault == "final":
            infos.pop("final_obs", None)
        return self.spoil(observations), rewards, terminated, truncated, infos

    def close_extras(self, **kwargs):
        if self.fault == "closing":
            raise RuntimeError("no")


FAULTS = {
    "space": "spaces",
    "metadata": "spaces",
    "unseeded": "seeding",
    "repeats": "seeding",
    "neighbours": "rows",
    "pickle": "pickling",
    "closing": "closing",
    "outside": "results",
    "types": "results",
    "buffer": "fresh arrays",
    "mask": "info masks",
    "final": "autoreset",
    "deaf": "reset mask",
    "late": "singles",
}


@pytest.mark.filterwarnings("ignore:.*autoreset_mode")
@pytest.mark.parametrize("fault", list(FAULTS))
def test_the_conformance_test_finds_every_fault(fault):
    def factory(num_envs, **options):
        return Broken(num_envs, fault, **options)

    def single():
        return gymnasium.make(TARGET, scenario=Straight(steps=4))

    report = check_vector_env(factory, 2, 0, 12, single=single)
    assert FAULTS[fault] in {check.name for check in report.of("failed")}


def test_without_singles_the_comparison_is_skipped():
    report = check_vector_env(lambda n, **o: Broken(n, "", **o), 2, 0, 12)
    assert report.ok
    assert {check.name for check in report.of("skipped")} == {"singles", "reset mask"}
    assert Report("x", (Check("a", "", "failed", "No."),)).ok is False
    with pytest.raises(ValueError, match="random_steps must be an integer >= 1"):
        check_vector_env(TARGET, random_steps=0)


class Counting:
    """A task that records which calls it gets; two choices."""

    def __init__(self, source, count, *, gain=1.0):
        self.observation_space, self.action_space = Box(0.0, 1e3, (1,), np.float64), Discrete(2)
        self.count, self.gain = count, gain
        self.begun = []

    def check_actions(self, actions, caller):
        return np.asarray(actions)

    def begin(self, rows, episodes):
        self.begun.append(rows.tolist())
        assert len(episodes.times) == len(rows)

    def step(self, actions, k, live):
        return Outcome(np.where(live, self.gain * actions, 0.0), live & (actions == 1) & (k == 2))

    def observe(self, k):
        return k[:, None].astype(np.float64)

    def info(self, k):
        return {"twice": 2 * k}


def test_a_task_of_ones_own_and_one_simulation_for_all_that_start():
    env = TargetVectorEnv(Counting, 4, scenario=Straight(steps=6), gain=3.0)
    env.reset(seed=0)
    for _ in range(3):
        observations, rewards, terminated, truncated, _ = env.step(np.array([0, 1, 0, 1]))
    assert terminated.tolist() == [False, True, False, True]
    assert rewards.tolist() == [0.0, 3.0, 0.0, 3.0]
    observations, rewards, *_, infos = env.step(np.array([0, 1, 0, 1]))
    assert observations[:, 0].tolist() == [4.0, 0.0, 4.0, 0.0]
    assert rewards.tolist() == [0.0] * 4
    assert infos["twice"].tolist() == [8, 0, 8, 0]
    task = env.rollout.task
    assert task.begun == [[0, 1, 2, 3], [1, 3]]
    assert TargetEnv(Counting, scenario=Straight(), gain=2.0).reset(seed=1)[1] == {"twice": 0}


def test_frames_of_every_target(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env, twin = native(2, render_mode="rgb_array"), sync(2, render_mode="rgb_array")
    env.reset(seed=1), twin.reset(seed=1)
    for frame, other in zip(env.render(), twin.render(), strict=True):
        np.testing.assert_array_equal(frame, other)
    env.close()


def test_episodes_simulated_ahead_are_those_that_would_have_come():
    """Few targets simulate nothing ahead, many do: the same rows must have the same episodes."""
    many = TargetVectorEnv(
        "adaptive-factor", 300, autoreset_mode="SameStep", stagger=True, scenario="surge-v0", steps=40
    )
    rows = [0, 1, 150, 299]
    alone = [
        TargetVectorEnv("adaptive-factor", 1, autoreset_mode="SameStep", stagger=True, scenario="surge-v0", steps=40)
        for _ in rows
    ]
    seen, _ = many.reset(seed=3)
    rng, waited = np.random.default_rng(0), 0
    for row, env in zip(rows, alone, strict=True):
        np.testing.assert_array_equal(env.reset(seed=3 + row)[0][0], seen[row])
    for step in range(150):
        if step == 90:  # new seeds for some, the others' generators go on
            seeds = [None if row % 2 else 1000 + row for row in range(300)]
            seen, _ = many.reset(seed=seeds)
            for row, env in zip(rows, alone, strict=True):
                np.testing.assert_array_equal(env.reset(seed=seeds[row])[0][0], seen[row])
        actions = rng.integers(0, 3, 300)
        seen, rewards, *_ = many.step(actions)
        waited = max(waited, int(many.rollout._ahead.ready(np.arange(300)).sum()))
        for row, env in zip(rows, alone, strict=True):
            ours, reward, *_ = env.step(actions[row : row + 1])
            np.testing.assert_array_equal(ours[0], seen[row])
            assert reward[0] == rewards[row]
    assert waited > 10


def test_infos_that_nobody_reads_are_not_made():
    quiet, told = (
        TargetVectorEnv("adaptive-factor", 8, autoreset_mode="SameStep", stagger=True, steps=20, infos=infos)
        for infos in (False, True)
    )
    first, nothing = quiet.reset(seed=1)
    np.testing.assert_array_equal(first, told.reset(seed=1)[0])
    assert nothing == {}
    ends = 0
    for _ in range(60):
        ours, theirs = quiet.step(np.zeros(8, dtype=int)), told.step(np.zeros(8, dtype=int))
        for a, b in zip(ours[:4], theirs[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        assert set(ours[4]) == ({"final_obs", "_final_obs"} if "final_obs" in theirs[4] else set())
        for row in np.flatnonzero(ours[4].get("_final_obs", [])):
            np.testing.assert_array_equal(ours[4]["final_obs"][row], theirs[4]["final_obs"][row])
            ends += 1
    assert ends > 10
