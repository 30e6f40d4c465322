"""Groups of what an agent sees: which columns they are, that hidden ones are hidden, that refusals name the way out."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from jink.envs.adaptive_factor import AdaptiveFactorTask
from jink.training.agent_config import AgentConfig
from jink.training.agent_scores import interquartile_mean, make_source, play_episodes, score, simulate_seeds
from jink.training.agent_seen import GROUPS, shown_columns
from jink.training.agent_warm_start import advised_actions
from jink.training.cli import main
from jink.training.train_agent import train_agent

SHORT = {
    "suite": None, "scenario": "surge-v0", "steps": 1024, "environments": 32, "horizon": 16, "minibatch": 256,
    "rounds": 1, "episodes": 10, "epochs": 2, "hidden": 16,
}  # fmt: skip


def column(name):
    return list(GROUPS[name])


def test_groups_are_every_column_once():
    found = sorted(number for group in GROUPS.values() for number in group)
    assert found == list(range(22)) == list(range(len(shown_columns(()))))
    assert shown_columns(()).all()
    hidden = ~shown_columns(("belief", "gap"))
    assert np.flatnonzero(hidden).tolist() == sorted(column("belief") + column("gap"))


def test_groups_are_what_their_names_say():
    source, count = make_source(scenario="surge-dropouts-v0"), 20
    episodes = simulate_seeds(source, 3, count)
    task = AdaptiveFactorTask(source, count, True, view="levels", covariance="mixture")
    task.begin(np.arange(count), episodes)
    k, live, rng = np.zeros(count, dtype=np.int64), np.ones(count, dtype=bool), np.random.default_rng(0)
    missed, used, had = 0, np.zeros(count), np.zeros(count, dtype=bool)
    for step in range(100):
        seen = task.observe(k)
        np.testing.assert_allclose(seen[:, column("belief")].sum(axis=1), 1.0, atol=1e-5)
        np.testing.assert_allclose(2.0 * seen[:, column("advice")] - 1.0, advised_actions(seen))
        assert np.all((seen[:, column("share")] > -4.0) & (seen[:, column("direction")[1:]] >= 0.0))
        gone = np.isnan(episodes.measurements[:, step]).any(axis=1)
        missed += gone.sum()
        np.testing.assert_array_equal(seen[gone][:, column("innovation")], 0.0)
        # The same size, once against the innovation's covariance and once against R: the first is the smaller.
        sizes = seen[~gone][:, column("innovation")]
        assert np.all(sizes[:, 0] <= sizes[:, 1] + 1e-6)
        np.testing.assert_allclose(seen[had, column("used")[0]], used[had], atol=1e-6)
        if step:
            assert np.all((seen[:, column("gap")[0]] > 0.0) == gone)
        actions = rng.uniform(-1.0, 1.0, (count, 1))
        used, had = 0.5 * (actions[:, 0] + 1.0), ~gone
        task.step(task.check_actions(actions, "step"), k, live)
        k = k + 1
    assert missed > 20


@pytest.mark.parametrize("warm", ["advice", "oracle", "none"])
def test_what_is_hidden_changes_nothing_and_what_is_shown_does(tmp_path, warm):
    config = AgentConfig(**SHORT, unseen=("belief", "advice"), warm_start=warm)
    policy = train_agent(config, tmp_path / "x", tensorboard=False).policy
    seen = np.random.default_rng(0).uniform(0.0, 1.0, (50, len(policy.shift)))
    for name in GROUPS:
        other = seen.copy()
        other[:, column(name)] += 0.5
        same = np.array_equal(policy.outputs(other), policy.outputs(seen))
        assert same == (name in config.unseen), name


def test_without_the_advice_its_copy_from_the_rest_is_nearly_as_good(tmp_path):
    source = make_source(scenario="surge-v0")
    episodes = simulate_seeds(source, 77, 40)
    found = {}
    for name, hidden in (("rest", ("advice",)), ("gap", tuple(group for group in GROUPS if group != "gap"))):
        policy = train_agent(AgentConfig(**SHORT, unseen=hidden), tmp_path / name, tensorboard=False).policy
        played = play_episodes(policy, source, episodes)
        found[name] = interquartile_mean(score(played.agent, played.nominal, played.oracle, played.sigma))
    assert found["rest"] > 0.9 > found["gap"] + 0.2


@pytest.mark.parametrize(
    "options", [["--unseen", "belief,nothing"], ["--unseen", ",".join(GROUPS)], ["--view", "plain", "--unseen", "gap"]]
)
def test_groups_that_cannot_be_hidden_are_refused(tmp_path, capsys, options):
    assert main(["train", "agent", "--out", str(tmp_path / "x"), *options]) == 2
    words = capsys.readouterr().err
    assert "unseen must be some, not all, of innovation, share" in words and words.count("\n") == 1
    assert not (tmp_path / "x").exists()
