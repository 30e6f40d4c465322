"""Training throughput: the agent's environment against stable-baselines3's own ceiling.

The ceiling is the same training (network, batch, passes) on a native vector environment with the same spaces that does
nothing: fixed observations, no reward, an episode's end now and then. Rounds alternate; processor time, so that other
work on the machine counts for neither, and wall time, where our second thread counts for us. Whether large batches
learn as well as small ones: `agent_batches.py`.

python benchmarks/training_speed.py
python benchmarks/training_speed.py --no-lookback --from-nothing
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv

from jink.training import sb3
from jink.training.agent_config import AgentConfig
from jink.training.train_agent import copy_first


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


def rate(model: Any, steps: int) -> np.ndarray:
    """Environment steps per second while learning, of processor time and of wall time; (2,)."""
    before, spent, began = model.num_timesteps, time.process_time(), time.perf_counter()
    model.learn(steps, reset_num_timesteps=False)
    return (model.num_timesteps - before) / np.array([time.process_time() - spent, time.perf_counter() - began])


def main() -> None:
    """Measure and print."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--rounds", type=int, default=5)
    made.add_argument("--steps", type=int, default=131_072, help="of a round")
    made.add_argument("--no-lookback", action="store_true", help="the filter does not judge its last measurement again")
    made.add_argument("--from-nothing", action="store_true", help="begin without the advice: many tracks are lost")
    given = made.parse_args()
    torch.set_num_threads(1)
    config = AgentConfig(lookback=not given.no_lookback)
    env = sb3.make_env(config)
    ours, ceiling = sb3.make_model(config, env), sb3.make_model(config, sb3.NativeVecEnv(Idle(env, env.num_envs)))
    if not given.from_nothing:
        copy_first(config, ours)
    env.seed(1)
    for model in (ours, ceiling):
        model.learn(config.environments * config.horizon)
    rates = [(rate(ours, given.steps), rate(ceiling, given.steps)) for _ in range(given.rounds)]
    for number, clock in enumerate(("processor time", "wall time")):
        mine, best = (statistics.median(rate[number] for rate in column) for column in zip(*rates, strict=True))
        ratios = sorted(a[number] / b[number] for a, b in rates)
        print(f"{clock}: ours {mine:,.0f} steps/s, ceiling {best:,.0f}; ratio {statistics.median(ratios):.2f}", end=" ")
        print(f"({ratios[0]:.2f} to {ratios[-1]:.2f} over {given.rounds} rounds)")


if __name__ == "__main__":
    main()
