"""What an agent's network copies before it learns: the inflation of the belief about noise levels, or the oracle's."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from jink.envs.adaptive_factor import LARGEST_LOG_INFLATION, AdaptiveFactorTask
from jink.estimators.agent.looking import LEVELS_SIZE
from jink.training.agent_config import AgentConfig
from jink.training.agent_scores import make_source, simulate_seeds

__all__ = ["Examples", "advised_actions", "gather_examples", "imitate"]

Floats = NDArray[np.float64]
EPISODES = 400
_ADVICE, _JITTER = LEVELS_SIZE - 2, 0.15
_PASSES, _BATCH, _RATE = 6, 1024, 2e-3


class Examples(NamedTuple):
    """Observations (N, F) and the actions to copy (N, 1)."""

    features: Floats
    actions: Floats


def advised_actions(observations: NDArray[Any], first: NDArray[np.bool_] | None = None) -> Floats:
    """The action whose gain is the mean over the belief about the noise level; a policy without any learning."""
    return np.asarray(2.0 * observations[:, _ADVICE : _ADVICE + 1].astype(np.float64) - 1.0)


def gather_examples(config: AgentConfig, seed: int) -> Examples:
    """Play episodes near the advice (or at random where there is none) and note what should be copied."""
    source = make_source(config.suite, config.scenario)
    episodes = simulate_seeds(source, seed, EPISODES)
    task = AdaptiveFactorTask(source, EPISODES, not config.discrete, **config.environment())
    rows, live = np.arange(EPISODES), np.ones(EPISODES, dtype=np.bool_)
    task.begin(rows, episodes)
    k, rng = np.zeros(EPISODES, dtype=np.int64), np.random.default_rng(seed)
    features, actions = [], []
    for step in range(source.steps - 1):
        seen = task.observe(k)
        wanted = 2.0 * np.log(np.clip(episodes.scale[:, step], 1.0, 1e6)) / LARGEST_LOG_INFLATION - 1.0
        copied = advised_actions(seen) if config.copies == "advice" else wanted[:, None]
        features.append(seen.astype(np.float64))
        actions.append(copied)
        if config.discrete:
            played: NDArray[Any] = rng.integers(0, len(config.factors), EPISODES)
        else:
            near = advised_actions(seen) if config.view == "levels" else -np.ones((EPISODES, 1))
            played = np.clip(near + _JITTER * rng.normal(size=(EPISODES, 1)), -1.0, 1.0)
        task.step(task.check_actions(played, "step"), k, live)
        k = k + 1
    return Examples(np.concatenate(features), np.concatenate(actions))


def imitate(model: Any, examples: Examples, seed: int) -> float:
    """Least squares of the mean action, by Adam; the mean square that is left."""
    torch.manual_seed(seed)
    policy = model.policy
    known = torch.zeros(len(examples.features), policy.pi_features_extractor.features_dim)
    known[:, : examples.features.shape[1]] = torch.as_tensor(examples.features, dtype=torch.float32)
    features = policy.pi_features_extractor(known)
    actions = torch.as_tensor(examples.actions, dtype=torch.float32)
    parameters = [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters()]
    steps = _PASSES * (len(features) // _BATCH)
    optimizer = torch.optim.Adam(parameters, _RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 5.0 * _RATE, total_steps=steps + 1)
    left = 0.0
    for _ in range(_PASSES):
        for chosen in torch.randperm(len(features))[: len(features) // _BATCH * _BATCH].reshape(-1, _BATCH):
            hidden = policy.mlp_extractor.policy_net(features[chosen])
            loss = torch.nn.functional.mse_loss(policy.action_net(hidden), actions[chosen])
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
            left = float(loss.detach())
    return left
