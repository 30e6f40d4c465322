"""The native vector environment under stable-baselines3, its models, and their way out of torch."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv

from jink.envs.adaptive_factor import TOLD
from jink.envs.vector import TargetVectorEnv
from jink.estimators.agent.policy import Policy
from jink.training.agent_config import TRAIN_EVERY, AgentConfig

__all__ = [
    "NativeVecEnv",
    "Standardised",
    "act_with_memory",
    "critic_only",
    "export_policy",
    "follow_advice",
    "make_env",
    "make_model",
    "set_scales",
]


class NativeVecEnv(VecEnv):
    """A native vector environment as stable-baselines3 wants it: no loop over environments, no info where none ended.

    Same-step autoreset: of an episode that ends, ``terminal_observation`` and ``TimeLimit.truncated`` are in its info,
    so that values are bootstrapped after a truncation and not after a loss.

    Args:
        env: with same-step autoreset.

    Raises:
        ValueError: another autoreset mode.
    """

    def __init__(self, env: Any) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"NativeVecEnv: env must reset in the same step; got {mode}. Make it with autoreset_mode='SameStep'."
            )
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.env = env
        self._nothing: dict[str, Any] = {}
        self._infos: list[dict[str, Any]] = [self._nothing] * self.num_envs
        self._actions: NDArray[Any] = np.zeros(0)
        self.seed_next: int | None = None
        """Seed of the first target at the next reset; None: generators go on."""

    def reset(self) -> NDArray[Any]:
        """First observations."""
        observations, _ = self.env.reset(seed=self.seed_next)
        self.seed_next = None
        return np.asarray(observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[Any], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Take them."""
        observations, rewards, terminated, truncated, told = self.env.step(self._actions)
        done = terminated | truncated
        infos = self._infos
        if done.any():
            infos = list(infos)
            last = told["final_obs"]
            for row in np.flatnonzero(done).tolist():
                infos[row] = {
                    "terminal_observation": last[row],
                    "TimeLimit.truncated": bool(truncated[row] and not terminated[row]),
                }
        return observations, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """The seed of the next reset; target i gets ``seed + i``."""
        self.seed_next = seed
        return [None if seed is None else seed + row for row in range(self.num_envs)]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The environment's attribute, once per target; none renders."""
        value = None if attr_name == "render_mode" else getattr(self.env, attr_name)
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set the environment's attribute."""
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call the environment's method once."""
        return [getattr(self.env, method_name)(*args, **kwargs)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False] * len(list(self._get_indices(indices)))


class Standardised(BaseFeaturesExtractor):
    """Observations minus a fixed mean over a fixed spread, part of the model's state; a gain of 0 hides a column."""

    shift: torch.Tensor
    gain: torch.Tensor

    def __init__(self, observation_space: spaces.Box) -> None:
        super().__init__(observation_space, int(observation_space.shape[0]))
        self.register_buffer("shift", torch.zeros(self.features_dim))
        self.register_buffer("gain", torch.ones(self.features_dim))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """The scaled observations."""
        return (observations - self.shift) * self.gain


def make_env(config: AgentConfig) -> NativeVecEnv:
    """The training environments of a configuration; episodes of different targets end at different times."""
    env = TargetVectorEnv(
        "adaptive-factor",
        config.environments,
        autoreset_mode=AutoresetMode.SAME_STEP,
        stagger=True,
        infos=False,
        continuous=not config.discrete,
        informed=config.informed,
        **config.source(),
        **config.environment(),
    )
    return NativeVecEnv(env)


def make_model(config: AgentConfig, env: VecEnv) -> Any:
    """An untrained model.

    Raises:
        ModuleNotFoundError: sb3-contrib is needed for recurrent-ppo.
    """
    kwargs: dict[str, Any] = {
        "net_arch": [config.hidden] * 2,
        "features_extractor_class": Standardised,
        "activation_fn": torch.nn.Tanh,
    }
    common: dict[str, Any] = {
        "seed": config.seed,
        "device": "cpu",
        "learning_rate": config.learning_rate,
        "gamma": config.discount,
        "verbose": 0,
    }
    if config.algorithm == "dqn":
        return DQN(
            "MlpPolicy", env, policy_kwargs=kwargs, batch_size=config.minibatch, train_freq=TRAIN_EVERY,
            gradient_steps=max(1, TRAIN_EVERY * config.epochs * config.environments // config.minibatch),
            buffer_size=300_000, learning_starts=0, target_update_interval=8, exploration_fraction=0.3,
            exploration_final_eps=0.02, max_grad_norm=10.0, **common,
        )  # fmt: skip
    kwargs |= {"log_std_init": config.first_log_std, "share_features_extractor": not config.informed}
    common |= {
        "n_steps": config.horizon, "batch_size": config.minibatch, "n_epochs": config.epochs,
        "gae_lambda": config.trace, "clip_range": config.clip, "ent_coef": config.entropy,
    }  # fmt: skip
    if config.algorithm == "recurrent-ppo":
        from sb3_contrib import RecurrentPPO

        kwargs |= {"lstm_hidden_size": config.hidden, "net_arch": [config.hidden]}
        return RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=kwargs, **common)
    model = PPO("MlpPolicy", env, policy_kwargs=kwargs, **common)
    _add_skip(model)
    return model


class WithInputs(torch.nn.Module):
    """Hidden units, and the inputs once more: what follows is linear in both."""

    def __init__(self, inner: torch.nn.Module) -> None:
        super().__init__()
        self.inner = inner

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Both, side by side."""
        return torch.cat([self.inner(inputs), inputs], dim=1)


def _add_skip(model: Any) -> None:
    """The action is linear in the inputs too; a fresh network says nothing: zero."""
    policy = model.policy
    inner = policy.mlp_extractor.policy_net
    policy.mlp_extractor.policy_net = WithInputs(inner)
    policy.action_net = torch.nn.Linear(
        policy.mlp_extractor.latent_dim_pi + policy.features_dim, policy.action_net.out_features
    )
    torch.nn.init.zeros_(policy.action_net.weight)
    torch.nn.init.zeros_(policy.action_net.bias)
    policy.optimizer = policy.optimizer_class(policy.parameters(), lr=model.learning_rate, **policy.optimizer_kwargs)


@contextlib.contextmanager
def critic_only(model: Any) -> Iterator[None]:
    """Within, only the critic learns: an actor that already knows something is not led astray by an ignorant critic."""
    policy = model.policy
    actor = [
        *policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters(),
        *([policy.log_std] if hasattr(policy, "log_std") else []),
    ]  # fmt: skip
    for parameter in actor:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in actor:
            parameter.requires_grad_(True)


def follow_advice(model: Any, column: int) -> None:
    """Let the action of a fresh model be ``2 x - 1`` of an observation ``x``."""
    scales, action = model.policy.pi_features_extractor, model.policy.action_net
    first = action.in_features - scales.features_dim
    with torch.no_grad():
        action.weight[:, first + column] = 2.0 / scales.gain[column]
        action.bias[:] = 2.0 * scales.shift[column] - 1.0


def extractors(model: Any) -> list[Standardised]:
    """Every place where a model scales observations."""
    return [module for module in model.policy.modules() if isinstance(module, Standardised)]


def set_scales(model: Any, shift: NDArray[np.float64], gain: NDArray[np.float64]) -> None:
    """Scale observations so in every part of a model; what is for the critic is hidden from the actor."""
    seen = len(shift)
    for extractor in extractors(model):
        extractor.shift[:seen] = torch.as_tensor(shift, dtype=torch.float32)
        extractor.gain[:seen] = torch.as_tensor(gain, dtype=torch.float32)
        extractor.gain[seen:] = 0.0
    if len(extractors(model)[0].gain) > seen:
        critic = model.policy.vf_features_extractor
        critic.gain[seen:] = torch.tensor([0.7, 0.7, 0.4, 0.7, 0.3])


def action_layers(model: Any) -> list[torch.nn.Linear]:
    """The dense layers between scaled observations and the action (or the values of actions)."""
    policy = model.policy
    if isinstance(model, DQN):
        parts = [policy.q_net.q_net]
    else:
        parts = [policy.mlp_extractor.policy_net, policy.action_net]
    return [layer for part in parts for layer in part.modules() if isinstance(layer, torch.nn.Linear)]


def act_with_memory(model: Any) -> Callable[[NDArray[Any], NDArray[np.bool_]], NDArray[Any]]:
    """Deterministic actions of a recurrent model for observations (B, F) and whether they are first (B,)."""
    memory: Any = None

    def act(observations: NDArray[Any], first: NDArray[np.bool_]) -> NDArray[Any]:
        nonlocal memory
        actions, memory = model.predict(observations, state=memory, episode_start=first, deterministic=True)
        return np.asarray(actions)

    return act


def export_policy(model: Any, config: AgentConfig, about: dict[str, Any]) -> Policy:
    """What a trained model does, without torch.

    Raises:
        ValueError: a recurrent model: its memory has no place in a `Policy`.
    """
    if config.algorithm == "recurrent-ppo":
        raise ValueError("train agent: algorithm must be ppo or dqn to be exported; got recurrent-ppo. It is a study.")
    scales = model.policy.q_net.features_extractor if isinstance(model, DQN) else model.policy.pi_features_extractor
    seen = scales.features_dim - (TOLD if config.informed else 0)
    layers = [
        (layer.weight.detach().numpy().astype(np.float64), layer.bias.detach().numpy().astype(np.float64))
        for layer in action_layers(model)
    ]
    layers[0] = layers[0][0][:, :seen], layers[0][1]
    weight, bias = layers[-1]
    skip = np.zeros((len(bias), seen))
    shift, gain = scales.shift, scales.gain
    if not isinstance(model, DQN):
        skip, layers[-1] = weight[:, config.hidden :][:, :seen], (weight[:, : config.hidden], bias)
    return Policy(
        tuple(layers),
        skip,
        np.asarray(shift, dtype=np.float64)[:seen],
        np.asarray(gain, dtype=np.float64)[:seen],
        view=config.view,
        factors=config.factors if config.discrete else (),
        covariance=config.covariance,
        lookback=config.lookback,
        activation="tanh",
        about=about,
    )
