"""`jink train agent`: reinforcement learning of the noise of each measurement, in rounds that can be taken up again."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jink.estimators.agent.looking import LEVELS_SIZE
from jink.estimators.agent.policy import Policy
from jink.estimators.agent.policy_file import POLICY_FILE, load_policy, replace_file, save_policy
from jink.training.agent_config import AgentConfig
from jink.training.agent_scores import interquartile_mean, make_source, play_episodes, score, simulate_seeds
from jink.training.agent_seen import shown_columns

__all__ = ["AgentReport", "Round", "copy_first", "train_agent"]

TRAINING_SEED, VALIDATION_SEED, TEST_SEED = 10_000_000, 1_000_000, 2_000_000
"""First seeds of episodes to learn from, to choose among rounds by, and to report: they never meet."""
_SEEDS_A_RUN, _SEEDS_A_ROUND = 10**9, 10**5
CHECKPOINT, LOG, DONE = "checkpoint", "progress.jsonl", "training.json"
_ADVICE = LEVELS_SIZE - 2


class Round(NamedTuple):
    """What one round brought, on validation episodes: 0 is the nominal filter, 1 the oracle."""

    round: int
    steps: int
    score: float  # interquartile mean over episodes
    mean: float
    reward: float  # mean reward of a decision while learning
    seconds: float


class AgentReport(NamedTuple):
    """What came out: the best policy (none of a recurrent model), every round, and whether it had been there before."""

    policy: Policy | None
    rounds: tuple[Round, ...]
    resumed: bool
    finished_before: bool


def train_agent(
    config: AgentConfig,
    out: Path,
    *,
    fresh: bool = False,
    progress: Callable[[Round], None] = lambda found: None,
    tensorboard: bool = True,
) -> AgentReport:
    """Train an agent and write its best policy; a training that was killed goes on from its last round.

    Args:
        config: what is asked for.
        out: folder of the policy, its log and its checkpoint.
        fresh: begin anew whatever lies there.
        progress: told of every round.
        tensorboard: write events where TensorBoard is installed.

    Returns:
        what came out.

    Raises:
        ValueError: another training in the folder, or stable-baselines3 is not installed.
        OSError: it cannot be written.
    """
    try:
        import torch

        from jink.training import sb3
        from jink.training.agent_checkpoint import load_checkpoint, save_checkpoint
    except ModuleNotFoundError as error:
        raise ValueError(
            f"train agent: stable-baselines3 must be installed to learn; {error}. Run pip install 'jink[rl]'."
        ) from error
    key = hashlib.sha256(json.dumps(config.told(), sort_keys=True).encode()).hexdigest()
    finished = _prepare(out, key, fresh)
    if finished:
        policy = load_policy(out) if (out / POLICY_FILE).is_file() else None
        return AgentReport(policy, _read_log(out), False, True)
    torch.set_num_threads(1)  # on networks this small a second thread costs three to nine times as much
    env = sb3.make_env(config)
    try:
        model = sb3.make_model(config, env)
    except ModuleNotFoundError as error:
        raise ValueError(f"train agent: {error}. Run pip install 'jink[rl]'.") from error
    state = load_checkpoint(out / CHECKPOINT, model)
    resumed = state is not None
    if state is None:
        copy_first(config, model)
        state = {"round": 0, "best": None, "rounds": []}
    rounds = [Round(*found) for found in state["rounds"]]
    source = make_source(config.suite, config.scenario)
    judged = simulate_seeds(source, VALIDATION_SEED, config.episodes)
    board = _board(out / "tensorboard") if tensorboard else None
    best = state["best"]
    critic_steps, ends = config.plan()
    while state["round"] < config.rounds:
        number, began = state["round"], time.monotonic()
        _seed_round(config, model, env, number)
        watch = _Watch.make()
        if number == 0 and critic_steps:
            with sb3.critic_only(model):
                model.learn(critic_steps, reset_num_timesteps=False)
        model.learn(ends[number] - model.num_timesteps, callback=watch, reset_num_timesteps=False)
        found = _judge(config, model, source, judged)
        row = Round(number + 1, int(model.num_timesteps), *found, watch.mean, time.monotonic() - began)
        rounds.append(row)
        # A policy that ties with an earlier one has seen more.
        if best is None or row.score >= best:
            best = row.score
            if config.algorithm != "recurrent-ppo":
                save_policy(sb3.export_policy(model, config, _about(config, rounds)), out)
        state = {"round": number + 1, "best": best, "rounds": [list(found) for found in rounds]}
        save_checkpoint(out / CHECKPOINT, model, state)
        replace_file(out / LOG, "".join(json.dumps(found._asdict()) + "\n" for found in rounds).encode())
        if board is not None:
            for name in ("score", "mean", "reward"):
                board.add_scalar(f"agent/{name}", getattr(row, name), row.steps)
        progress(row)
    if board is not None:
        board.close()
    replace_file(out / DONE, json.dumps({"request": key, "finished": True}).encode())
    shutil.rmtree(out / CHECKPOINT, ignore_errors=True)
    policy = None if config.algorithm == "recurrent-ppo" else load_policy(out)
    return AgentReport(policy, tuple(rounds), resumed, False)


def _prepare(out: Path, key: str, fresh: bool) -> bool:
    """Make the folder; whether an equal training has ended there.

    Raises:
        ValueError: a file, or a folder with another training or with something else.
    """
    if out.exists() and not out.is_dir():
        raise ValueError(f"--out: value must be a folder; got {out}, a file. Choose another name.")
    mark, done = out / "request.json", out / DONE
    if not fresh and out.is_dir():
        for path in (done, mark):
            if path.is_file():
                if _read(path).get("request") == key:
                    return path == done
                raise ValueError(
                    f"--out: folder must not hold an agent of other options; got {out}. "
                    "Add --fresh to replace it, or choose another folder."
                )
        strange = sorted(path.name for path in out.iterdir())
        if strange:
            raise ValueError(
                f"--out: folder must be new, empty or of an earlier training; got {out} with {strange[0]} in it. "
                "Choose another folder."
            )
    if fresh:
        shutil.rmtree(out / CHECKPOINT, ignore_errors=True)
        for name in (DONE, LOG, POLICY_FILE):
            (out / name).unlink(missing_ok=True)
    try:
        out.mkdir(parents=True, exist_ok=True)
        replace_file(mark, json.dumps({"request": key}).encode())
    except OSError as error:
        raise ValueError(
            f"--out: folder must be writable; got {out} ({error.strerror}). Choose another folder."
        ) from error
    return False


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        found = {}
    return found if isinstance(found, dict) else {}


def _read_log(out: Path) -> tuple[Round, ...]:
    if not (out / LOG).is_file():
        return ()
    try:
        return tuple(Round(**json.loads(line)) for line in (out / LOG).read_text(encoding="utf-8").splitlines())
    except (TypeError, ValueError):
        raise ValueError(
            f"train agent: log must hold a round a line; got {out / LOG}, which is damaged. Add --fresh to begin anew."
        ) from None


def _seed_round(config: AgentConfig, model: Any, env: Any, number: int) -> None:
    """Everything random in a round follows from the seed and its number: what makes a resumed training the same."""
    import torch

    first = TRAINING_SEED + config.seed * _SEEDS_A_RUN + number * _SEEDS_A_ROUND
    torch.manual_seed(first)
    np.random.seed(first % 2**32)  # noqa: NPY002  (stable-baselines3 shuffles its minibatches with it)
    model.action_space.seed(first % 2**31)
    env.seed(first)
    model._last_obs = None
    rate = config.learning_rate * (1.0 - 0.9 * number / max(config.rounds - 1, 1))
    model.learning_rate = rate
    model.lr_schedule = lambda _: rate
    if config.algorithm == "dqn":
        left = 1.0 - number / config.rounds
        model.exploration_schedule = lambda _: max(0.02, 1.0 - 3.0 * (1.0 - left)) if number else 0.5


class _Watch:
    """Mean reward of a decision, whatever the number of environments."""

    @staticmethod
    def make() -> Any:
        from stable_baselines3.common.callbacks import BaseCallback

        class Watch(BaseCallback):
            total, count = 0.0, 0

            def _on_step(self) -> bool:
                rewards = self.locals["rewards"]
                self.total += float(rewards.sum())
                self.count += rewards.size
                return True

            @property
            def mean(self) -> float:
                return self.total / max(self.count, 1)

        return Watch()


def copy_first(config: AgentConfig, model: Any) -> None:
    """Scale observations by what a filter sees, and let the network copy an inflation before it learns."""
    from jink.training import sb3
    from jink.training.agent_warm_start import gather_examples, imitate

    examples = gather_examples(config, TRAINING_SEED + config.seed * _SEEDS_A_RUN - _SEEDS_A_ROUND)
    spread = examples.features.std(axis=0)
    gain = np.where(spread > 1e-3, 1.0 / np.maximum(spread, 1e-3), 1.0)
    if config.unseen:
        gain *= shown_columns(config.unseen)
    sb3.set_scales(model, examples.features.mean(axis=0), gain)
    if config.copies == "advice" and "advice" not in config.unseen:
        sb3.follow_advice(model, _ADVICE)
    elif config.copies != "none":
        imitate(model, examples, config.seed)


def _judge(config: AgentConfig, model: Any, source: Any, judged: Any) -> tuple[float, float]:
    """Interquartile mean and mean of the score of validation episodes."""
    from jink.training import sb3

    if config.algorithm == "recurrent-ppo":
        act = sb3.act_with_memory(model)
        played = play_episodes(act, source, judged, continuous=not config.discrete, **config.environment())
    else:
        options = {**config.environment()}
        played = play_episodes(sb3.export_policy(model, config, {}), source, judged, reward=options["reward"])
    found = score(played.agent, played.nominal, played.oracle, played.sigma)
    return float(interquartile_mean(found)), float(np.clip(found, -10.0, 2.0).mean())


def _about(config: AgentConfig, rounds: list[Round]) -> dict[str, Any]:
    """Where a policy comes from."""
    from jink.training.train_intents import command

    row = rounds[-1]
    return {
        "command": command(sys.argv[1:]),
        "config": config.told(),
        "round": row.round,
        "steps": row.steps,
        "validation_score": round(row.score, 6),
    }


def _board(folder: Path) -> Any:
    from jink.training.training_log import make_board

    return make_board(folder)
