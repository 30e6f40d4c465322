"""Training throughput: the agent's environment against stable-baselines3's own ceiling, and small minibatches.

The ceiling is the same training (network, batch, passes) on a native vector environment with the same spaces that does
nothing: fixed observations, no reward, an episode's end now and then. Rounds alternate; processor time, so that other
work on the machine counts for neither. ``--default-minibatches`` trains from nothing instead, with the batches that
stable-baselines3 has by default (8 environments, 2048 steps, minibatches of 64, ten passes) and with large ones (1024
environments, 32 steps, minibatches of 4096, 8192 and 16 384, four passes) for the same number of steps, and with ours
for ``--longer`` times as many; it prints the validation score against steps and processor time (evaluations included).

python benchmarks/training_speed.py
python benchmarks/training_speed.py --default-minibatches 327680 --seeds 3
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv

from jink.training import sb3
from jink.training.agent_config import AgentConfig
from jink.training.train_agent import train_agent


class Idle(VectorEnv):
    """The spaces of another environment and nothing behind them."""

    metadata: ClassVar = {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, like: sb3.NativeVecEnv, count: int) -> None:
        self.num_envs = count
        self.single_observation_space, self.single_action_space = like.observation_space, like.action_space
        low, high = np.maximum(like.observation_space.low, -5.0), np.minimum(like.observation_space.high, 5.0)
        self._seen = np.random.default_rng(0).uniform(low, high, (count, len(low))).astype(np.float32)
        self._rewards, self._never = np.zeros(count), np.zeros(count, dtype=np.bool_)
        self._step = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """The same observations every time."""
        return self._seen, {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict]:
        """Nothing happens; as many episodes end as in the real one, 299 decisions long."""
        self._step += 1
        over = self._never
        told: dict[str, Any] = {}
        if self._step % 4 == 0:
            over = self._never.copy()
            over[np.arange(self._step // 4 % 22, self.num_envs, 75)] = True
            told["final_obs"] = self._seen
        return self._seen, self._rewards, self._never, over, told


def rate(model: Any, steps: int) -> float:
    """Environment steps per second of processor time while learning."""
    before, began = model.num_timesteps, time.process_time()
    model.learn(steps, reset_num_timesteps=False)
    return float((model.num_timesteps - before) / (time.process_time() - began))


def compare_batches(steps: int, seeds: int, longer: int) -> None:
    """Train from nothing with batches of both kinds; print scores against steps and processor time, seeds together."""
    ours = replace(AgentConfig(), steps=steps, rounds=5, warm_start="none")
    ways = {
        "8192 of 1024 x 32, 4 passes": ours,
        "4096 of 1024 x 32, 4 passes": replace(ours, minibatch=4096),
        "16384 of 1024 x 32, 4 passes": replace(ours, minibatch=16384),
        "64 of 8 x 2048, 10 passes": replace(ours, environments=8, horizon=2048, minibatch=64, epochs=10),
        "8192 of 1024 x 32, longer": replace(ours, steps=steps * longer),
    }
    with tempfile.TemporaryDirectory() as folder:  # kernels are loaded before anything is measured
        train_agent(replace(ours, steps=32_768, rounds=1, critic_first=0.0), Path(folder) / "x", tensorboard=False)
    for name, way in ways.items():
        found: list[list[tuple[int, float, float]]] = []
        for seed in range(seeds):
            rows: list[tuple[int, float, float]] = []
            began = time.process_time()
            with tempfile.TemporaryDirectory() as folder:
                train_agent(
                    replace(way, seed=seed), Path(folder) / "x", tensorboard=False,
                    progress=lambda row, rows=rows, began=began: rows.append(
                        (row.steps, row.score, time.process_time() - began)
                    ),
                )  # fmt: skip
            found.append(rows)
        print(name)
        for rows_of_round in zip(*found, strict=True):
            scores = ", ".join(f"{score:.3f}" for _, score, _ in rows_of_round)
            spent = statistics.median(seconds for _, _, seconds in rows_of_round)
            print(f"  {rows_of_round[0][0]} steps, {spent:.0f} s: scores {scores}", flush=True)


def main() -> None:
    """Measure and print."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--rounds", type=int, default=5)
    made.add_argument("--steps", type=int, default=131_072, help="of a round")
    made.add_argument("--default-minibatches", type=int, metavar="STEPS", help="train so many steps from nothing")
    made.add_argument("--seeds", type=int, default=3, help="of these trainings")
    made.add_argument("--longer", type=int, default=8, help="times the steps, of ours once more")
    given = made.parse_args()
    torch.set_num_threads(1)
    if given.default_minibatches:
        compare_batches(given.default_minibatches, given.seeds, given.longer)
        return
    config = AgentConfig()
    env = sb3.make_env(config)
    ours, ceiling = sb3.make_model(config, env), sb3.make_model(config, sb3.NativeVecEnv(Idle(env, env.num_envs)))
    env.seed(1)
    for model in (ours, ceiling):
        model.learn(config.environments * config.horizon)
    rates = [(rate(ours, given.steps), rate(ceiling, given.steps)) for _ in range(given.rounds)]
    mine, best = (statistics.median(column) for column in zip(*rates, strict=True))
    ratios = sorted(a / b for a, b in rates)
    print(f"ours {mine:,.0f} steps/s, ceiling {best:,.0f}; ratio {statistics.median(ratios):.2f}", end=" ")
    print(f"({ratios[0]:.2f} to {ratios[-1]:.2f} over {given.rounds} rounds)")


if __name__ == "__main__":
    main()
