"""`jink train agent`: the adapter, the export, what is learnt and what is not, trainings that are taken up again."""

import json
import os
import signal
import subprocess
import sys
import time
from typing import ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from jink.envs.adaptive_factor import TOLD  # noqa: E402
from jink.envs.single import TargetEnv  # noqa: E402
from jink.envs.vector import TargetVectorEnv  # noqa: E402
from jink.estimators.agent.policy_file import load_policy  # noqa: E402
from jink.training import sb3  # noqa: E402
from jink.training.agent_config import AgentConfig  # noqa: E402
from jink.training.agent_scores import interquartile_mean, make_source, play_episodes, score, simulate_seeds  # noqa: E402
from jink.training.agent_warm_start import advised_actions  # noqa: E402
from jink.training.cli import main  # noqa: E402
from jink.training.train_agent import CHECKPOINT, TEST_SEED, VALIDATION_SEED, train_agent  # noqa: E402

SHORT = {
    "suite": None, "scenario": "surge-v0", "steps": 4096, "environments": 32, "horizon": 16, "minibatch": 256,
    "rounds": 4, "episodes": 10, "epochs": 2, "hidden": 16,
}  # fmt: skip


def native(count=3, **options):
    return TargetVectorEnv("adaptive-factor", count, autoreset_mode="SameStep", scenario="surge-v0", **options)


@pytest.mark.parametrize("continuous", [True, False])
def test_the_adapter_gives_what_single_environments_give(continuous):
    options = {"steps": 12, "view": "levels", "continuous": continuous, "lost_after": 3.0, "lost_steps": 1}
    adapter = sb3.NativeVecEnv(native(**options))
    singles = [TargetEnv("adaptive-factor", scenario="surge-v0", **options) for _ in range(3)]
    adapter.seed(5)
    seen = adapter.reset()
    np.testing.assert_array_equal(seen, [env.reset(seed=5 + i)[0] for i, env in enumerate(singles)])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(60):
        actions = rng.uniform(-1, 1, (3, 1)).astype(np.float32) if continuous else rng.integers(5, size=3)
        seen, rewards, dones, infos = adapter.step(actions)
        for i, env in enumerate(singles):
            observation, reward, terminated, truncated, _ = env.step(actions[i])
            assert rewards[i] == np.float32(reward) and dones[i] == (terminated or truncated)
            if dones[i]:
                ends += 1
                np.testing.assert_array_equal(infos[i]["terminal_observation"], observation)
                assert infos[i]["TimeLimit.truncated"] == (truncated and not terminated)
                observation, _ = env.reset()
            else:
                assert infos[i] == {}
            np.testing.assert_array_equal(seen[i], observation)
    assert ends > 10


def test_what_a_critic_is_told_is_the_truth_and_the_actor_cannot_see_it():
    config = AgentConfig(**SHORT)
    env = sb3.make_env(config)
    env.seed(1)
    seen = env.reset()
    model = sb3.make_model(config, env)
    sb3.set_scales(model, np.zeros(seen.shape[1] - TOLD), np.ones(seen.shape[1] - TOLD))
    scale = env.env.rollout.task.info(env.env.rollout.k)["noise_scale"]
    np.testing.assert_allclose(seen[:, -3], np.log(scale), rtol=1e-6)
    other = seen.copy()
    other[:, -TOLD:] += 1.0
    with torch.no_grad():
        torch.nn.init.normal_(model.policy.action_net.weight)
        for action, same in (("predict", True), ("value", False)):
            if action == "predict":
                first, second = (model.predict(o, deterministic=True)[0] for o in (seen, other))
            else:
                first, second = (model.policy.predict_values(torch.as_tensor(o)).numpy() for o in (seen, other))
            assert np.array_equal(first, second) == same


def test_another_autoreset_mode_is_refused():
    env = TargetVectorEnv("adaptive-factor", 2)
    assert env.autoreset_mode is AutoresetMode.NEXT_STEP
    with pytest.raises(ValueError, match="NativeVecEnv: env must reset in the same step"):
        sb3.NativeVecEnv(env)


@pytest.mark.parametrize(
    "options", [{}, {"informed": False}, {"discrete": True}, {"discrete": True, "algorithm": "dqn", "minibatch": 64}]
)
def test_the_exported_policy_acts_as_the_model(options):
    config = AgentConfig(**{**SHORT, **options})
    env = sb3.make_env(config)
    model = sb3.make_model(config, env)
    told = TOLD if config.informed else 0
    size = env.observation_space.shape[0] - told
    rng = np.random.default_rng(0)
    sb3.set_scales(model, rng.normal(size=size), rng.uniform(0.5, 2.0, size))
    with torch.no_grad():  # a fresh network says zero
        for layer in sb3.action_layers(model):
            torch.nn.init.normal_(layer.weight, std=0.3)
            torch.nn.init.normal_(layer.bias, std=0.3)
    policy = sb3.export_policy(model, config, {})
    low, high = env.observation_space.low[:size], env.observation_space.high[:size]
    seen = rng.uniform(low, high, (500, size)).astype(np.float32)
    full = np.concatenate([seen, np.zeros((500, told), dtype=np.float32)], axis=1)
    ours, theirs = policy.act(seen), model.predict(full, deterministic=True)[0]
    if config.discrete:
        # Where two values differ by less than float32 can tell, either may win.
        values = np.sort(policy.outputs(seen), axis=1)
        clear = values[:, -1] - values[:, -2] > 1e-4
        assert clear.mean() > 0.98
        np.testing.assert_array_equal(ours[clear], theirs[clear])
        assert len(set(ours.tolist())) > 1
    else:
        model.policy.double()
        with torch.no_grad():
            exact = model.policy._predict(torch.as_tensor(full.astype(np.float64)), deterministic=True).numpy()
        np.testing.assert_allclose(ours, np.clip(exact, -1.0, 1.0), atol=1e-6)
        np.testing.assert_allclose(ours, theirs, atol=1e-4)
        assert np.ptp(ours) > 0.5


def test_a_fresh_agent_follows_the_advice():
    config = AgentConfig(**SHORT)
    model = sb3.make_model(config, sb3.make_env(config))
    size = AgentSizes.levels
    sb3.set_scales(model, np.linspace(-1, 1, size), np.linspace(0.5, 2, size))
    sb3.follow_advice(model, size - 2)
    seen = np.random.default_rng(0).uniform(0, 1, (100, size))
    np.testing.assert_allclose(sb3.export_policy(model, config, {}).act(seen), advised_actions(seen), atol=1e-5)


class AgentSizes:
    """Numbers an agent sees."""

    levels = 22


def bits(folder):
    return [(path.name, path.read_bytes()) for path in sorted(folder.glob("weights-*"))]


def test_same_seed_same_bits_other_seed_other_bits(tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        train_agent(AgentConfig(**SHORT, seed=seed), tmp_path / name, tensorboard=False)
    assert bits(tmp_path / "a") == bits(tmp_path / "b") != bits(tmp_path / "c")
    report = train_agent(AgentConfig(**SHORT, seed=1), tmp_path / "a", tensorboard=False)
    assert report.finished_before and len(report.rounds) == 4
    with pytest.raises(ValueError, match="--out: folder must not hold an agent of other options"):
        train_agent(AgentConfig(**SHORT, seed=2), tmp_path / "a", tensorboard=False)


def test_episodes_of_seeds_and_rounds_and_of_evaluations_never_meet(tmp_path, monkeypatch):
    firsts, seed_env = [], sb3.NativeVecEnv.seed
    monkeypatch.setattr(sb3.NativeVecEnv, "seed", lambda env, seed=None: firsts.append(seed) or seed_env(env, seed))
    for seed in (1, 2):
        train_agent(AgentConfig(**SHORT, seed=seed), tmp_path / str(seed), tensorboard=False)
    assert firsts.count(None) == 0
    firsts = [first for first in firsts if first > 2]  # stable-baselines3 seeds the environment with the model's
    drawn = [set(range(first, first + SHORT["environments"])) for first in firsts]
    drawn += [set(range(first, first + 10_000)) for first in (VALIDATION_SEED, TEST_SEED)]
    assert len(firsts) == 2 * SHORT["rounds"] and len(set.union(*drawn)) == sum(map(len, drawn))


@pytest.mark.parametrize("options", [{}, {"discrete": True, "algorithm": "dqn", "minibatch": 64}])
def test_a_training_taken_up_again_ends_as_one_that_was_not_stopped(tmp_path, options):
    config = AgentConfig(**{**SHORT, **options})
    whole = train_agent(config, tmp_path / "whole", tensorboard=False)

    class StoppedError(Exception):
        pass

    def stop(found):
        if found.round == 2:
            raise StoppedError

    with pytest.raises(StoppedError):
        train_agent(config, tmp_path / "parts", tensorboard=False, progress=stop)
    assert (tmp_path / "parts" / CHECKPOINT).is_dir()
    again = train_agent(config, tmp_path / "parts", tensorboard=False)
    assert again.resumed and bits(tmp_path / "parts") == bits(tmp_path / "whole")
    assert [row[:5] for row in again.rounds] == [row[:5] for row in whole.rounds]


def test_the_warm_start_counts_and_a_network_without_it_is_worse(tmp_path):
    source = make_source(scenario="surge-v0")
    episodes = simulate_seeds(source, 77, 40)
    found = {}
    for name, warm in (("advice", "advice"), ("none", "none")):
        config = AgentConfig(**{**SHORT, "steps": 1024, "rounds": 1, "warm_start": warm, "lookback": False})
        policy = train_agent(config, tmp_path / name, tensorboard=False).policy
        played = play_episodes(policy, source, episodes)
        found[name] = interquartile_mean(score(played.agent, played.nominal, played.oracle, played.sigma))
    assert found["advice"] > 0.9 > found["none"] + 0.1


class Guess(VectorEnv):
    """One step: the action should be the observation. With ``shuffled`` rewards belong to another target."""

    metadata: ClassVar = {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, shuffled=False):
        self.num_envs, self.shuffled = 64, shuffled
        self.single_observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def _draw(self):
        self.now = self.rng.uniform(-1, 1, (self.num_envs, 1)).astype(np.float32)
        return self.now

    def reset(self, *, seed=None, options=None):
        self.rng = np.random.default_rng(seed)
        return self._draw(), {}

    def step(self, actions):
        rewards = -np.square(actions - self.now)[:, 0].astype(np.float64)
        if self.shuffled:
            rewards = np.roll(rewards, 1)  # a permutation would leave one in 64 in place, and that is enough to learn
        last = np.array([*self.now, None], dtype=object)[:-1]
        over = np.ones(self.num_envs, dtype=bool)
        return self._draw(), rewards, over, np.zeros_like(over), {"final_obs": last}


def wrong(shuffled):
    config = AgentConfig(
        environments=64, horizon=16, minibatch=256, hidden=16, learning_rate=3e-3, informed=False, discount=0.5,
        log_std=-0.5, seed=3,
    )  # fmt: skip
    env = sb3.NativeVecEnv(Guess(shuffled))
    env.seed(0)
    model = sb3.make_model(config, env)
    model.learn(40_000)
    seen = np.linspace(-0.9, 0.9, 50, dtype=np.float32)[:, None]
    return float(np.mean((model.predict(seen, deterministic=True)[0] - seen) ** 2))


def test_a_trivial_environment_is_solved_and_shuffled_rewards_teach_nothing():
    assert wrong(shuffled=False) < 0.01  # guessing zero costs 0.27
    assert wrong(shuffled=True) > 0.1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--steps", "0"], "steps must be an integer from 1"),
        (["--minibatch", "100000000"], "minibatch must be an integer"),
        (["--minibatch", "100000"], "minibatch must be at most environments x horizon"),
        (["--learning-rate", "nan"], "learning-rate must be a number"),
        (["--algorithm", "sac"], "algorithm must be one of ppo, dqn, recurrent-ppo"),
        (["--algorithm", "dqn"], "Add --discrete"),
        (["--suite", "nothing"], "suite must be one of"),
        (["--suite", "surge", "--scenario", "surge-v0"], "not both"),
        (["--factors", "none", "--discrete"], "factors must be at least two"),
        (["--view", "plain", "--covariance", "mixture"], "Use --covariance chosen"),
        (["--reward", "gold"], "reward must be one of"),
    ],
)
def test_bad_options_end_in_one_sentence(tmp_path, capsys, options, said):
    assert main(["train", "agent", "--out", str(tmp_path / "x"), *options]) == 2
    words = capsys.readouterr().err
    assert words.startswith("jink: ") and said in words and words.count("\n") == 1
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--factors", "none,huber"], "Add --discrete"),
        (["--discrete", "--warm-start", "oracle"], "copy nothing; got oracle"),
        (["--view", "plain", "--warm-start", "advice"], "copy nothing; got advice"),
        (["--algorithm", "recurrent-ppo", "--warm-start", "advice"], "copy nothing; got advice"),
        (["--discrete", "--algorithm", "dqn", "--horizon", "8"], "horizon must be left out for dqn"),
        (["--covariance", "chosen", "--lookback"], "lookback must be left out with covariance chosen"),
        (["--view", "plain", "--no-lookback"], "lookback must be left out with covariance chosen"),
    ],
)
def test_options_without_effect_are_refused(tmp_path, capsys, options, said):
    assert main(["train", "agent", "--out", str(tmp_path / "x"), *options]) == 2
    assert said in capsys.readouterr().err and not (tmp_path / "x").exists()


@pytest.mark.parametrize("options", [{}, {"discrete": True, "algorithm": "dqn", "minibatch": 64}])
def test_no_more_steps_are_taken_than_asked_for(tmp_path, options):
    least = 3 * 512 if not options else 2 * 128  # a batch for the critic and for each of two rounds
    with pytest.raises(ValueError, match=f"Use --steps {least}, or"):
        AgentConfig(**{**SHORT, "rounds": 2, **options, "steps": least - 1})
    for steps in (least, least + 300):
        config = AgentConfig(**{**SHORT, "rounds": 2, **options, "steps": steps})
        rounds = train_agent(config, tmp_path / str(steps), tensorboard=False).rounds
        assert steps - config.batch < rounds[-1].steps <= steps
        assert tuple(row.steps for row in rounds) == config.plan()[1]


@pytest.mark.parametrize("damage", ["cut state", "other counter", "cut tensors", "no tensors"])
def test_a_damaged_checkpoint_is_named_with_its_remedy(tmp_path, capsys, damage):
    class StoppedError(Exception):
        pass

    def stop(found):
        raise StoppedError

    short = {**SHORT, "steps": 1536, "rounds": 2}
    with pytest.raises(StoppedError):
        train_agent(AgentConfig(**short), tmp_path, tensorboard=False, progress=stop)
    state, (tensors,) = tmp_path / CHECKPOINT / "state.json", (tmp_path / CHECKPOINT).glob("*.safetensors")
    path = state if "tensors" not in damage else tensors
    if damage == "other counter":
        path.write_text(path.read_text().replace('"num_timesteps": 1024', '"num_timesteps": 1025'))
    elif damage == "no tensors":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ValueError, match="checkpoint must be whole") as caught:
        train_agent(AgentConfig(**short), tmp_path, tensorboard=False)
    assert str(path) in str(caught.value) and "Add --fresh" in str(caught.value)
    assert train_agent(AgentConfig(**short), tmp_path, tensorboard=False, fresh=True).policy is not None


def test_help_names_the_defaults(capsys):
    assert main(["train", "agent", "--help"]) == 0
    words, config = " ".join(capsys.readouterr().out.replace("│", " ").split()), AgentConfig()
    for name in ("reward", "view", "covariance", "algorithm", "warm_start"):
        assert f"{getattr(config, name)} (default)" in words
    for name in ("steps", "environments", "horizon", "minibatch", "epochs", "learning_rate", "discount", "hidden"):
        assert f"default {getattr(config, name)}." in words


def test_a_folder_of_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("precious")
    assert main(["train", "agent", "--out", str(tmp_path)]) == 2
    assert "thesis.tex" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.slow
def test_a_training_that_was_killed_goes_on(tmp_path):
    options = [
        "train", "agent", "--scenario", "surge-v0", "--steps", "60000", "--environments", "32", "--horizon", "16",
        "--minibatch", "256", "--rounds", "20", "--hidden", "16",
    ]  # fmt: skip
    command = [sys.executable, "-m", "jink.training.cli", *options, "--out"]
    subprocess.run([*command, str(tmp_path / "whole")], check=True, capture_output=True)
    running = subprocess.Popen(
        [*command, str(tmp_path / "killed")], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    state = tmp_path / "killed" / CHECKPOINT / "state.json"
    while not state.is_file() or json.loads(state.read_text())["progress"]["round"] < 3:
        time.sleep(0.05)
        assert running.poll() is None, "it ended before it could be killed"
    os.kill(running.pid, signal.SIGKILL)
    running.wait()
    subprocess.run([*command, str(tmp_path / "killed")], check=True, capture_output=True)
    a, b = (load_policy(tmp_path / name) for name in ("whole", "killed"))
    for (one, _), (other, _) in zip(a.layers, b.layers, strict=True):
        np.testing.assert_array_equal(one, other)
