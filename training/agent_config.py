"""What `jink train agent` was asked for: `AgentConfig`, checked when it is made."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import asdict, dataclass
from typing import Any

from jink.envs.adaptive_factor import FACTORS_OFFERED
from jink.envs.scenarios import SCENARIOS, SUITES
from jink.estimators.agent.looking import VIEWS
from jink.estimators.agent.policy import COVARIANCES
from jink.estimators.factors import FACTORS
from jink.training.agent_seen import GROUPS

__all__ = ["ALGORITHMS", "REWARDS", "TRAIN_EVERY", "WARM_STARTS", "AgentConfig", "refuse_idle"]

ALGORITHMS = ("ppo", "dqn", "recurrent-ppo")
REWARDS = ("distance", "regret", "squared", "log", "log-regret")
WARM_STARTS = ("advice", "oracle", "none")
_WHOLE = {
    "seed": (0, 2**31),
    "steps": (1, 10**10),
    "environments": (1, 65536),
    "horizon": (1, 4096),
    "minibatch": (2, 2**22),
    "epochs": (1, 100),
    "hidden": (1, 1024),
    "rounds": (1, 10_000),
    "episodes": (10, 10_000),
}
TRAIN_EVERY = 4
"""Steps of each environment between two updates of dqn."""
_REAL = {
    "learning_rate": (0.0, 1.0),
    "discount": (0.0, 1.0),
    "trace": (0.0, 1.0),
    "clip": (0.0, 10.0),
    "entropy": (0.0, 10.0),
    "critic_first": (0.0, 0.9),
    "least_gain": (1e-3, 100.0),
    "log_std": (-10.0, 2.0),
}


@dataclass(frozen=True)
class AgentConfig:
    """A training of an agent.

    Args:
        discrete: choose factors instead of an inflation.
        algorithm: one of `ALGORITHMS`; dqn is discrete.
        suite: whose scenarios are mixed.
        scenario: one scenario instead.
        seed: of everything drawn.
        steps: environment steps in all, at most: whole batches are made of them.
        environments: targets side by side.
        horizon: steps of each between two updates.
        minibatch: samples of a gradient step.
        epochs: passes over a batch.
        learning_rate: at the start; falls linearly to a tenth.
        discount: of rewards one decision later, in (0, 1).
        trace: lambda of generalised advantage estimates.
        clip: of the ratio of probabilities.
        entropy: weight of the entropy.
        hidden: units of each of the two layers.
        view, covariance, factors, reward, least_gain: of the environment, see `AdaptiveFactorTask`.
        unseen: groups of the view ``levels`` that are hidden from the network, see `GROUPS`.
        warm_start: before learning the network copies ``advice`` (the inflation whose gain is the posterior mean),
            the ``oracle``'s inflation, or nothing; continuous only.
        lookback: the filter judges its last measurement again with the next; covariance ``mixture`` only.
        informed: while learning, the critic sees the truth (errors, true noise); the agent never does; ppo only.
        critic_first: share of the steps in which only the critic learns, before all; ppo only.
        log_std: logarithm of the standard deviation of the first actions, continuous only; None: -3.5 with a warm
            start, whose good filter larger noise would spoil, else -1.
        rounds: pieces of the training; each starts new episodes, and ends with an evaluation and a checkpoint.
        episodes: of an evaluation.

    Raises:
        ValueError: a value out of range or options that exclude each other.
    """

    discrete: bool = False
    algorithm: str = "ppo"
    suite: str | None = "surge"
    scenario: str | None = None
    seed: int = 0
    steps: int = 1_015_808
    environments: int = 1024
    horizon: int = 32
    minibatch: int = 8192
    epochs: int = 4
    learning_rate: float = 3e-4
    discount: float = 0.98
    trace: float = 0.95
    clip: float = 0.2
    entropy: float = 0.0
    hidden: int = 64
    view: str = "levels"
    unseen: tuple[str, ...] = ()
    covariance: str = "mixture"
    factors: tuple[str, ...] = FACTORS_OFFERED
    reward: str = "log-regret"
    least_gain: float = 1.0
    warm_start: str = "advice"
    lookback: bool = True
    informed: bool = True
    critic_first: float = 0.08
    log_std: float | None = None
    rounds: int = 5
    episodes: int = 200

    def __post_init__(self) -> None:
        for name, (low, high) in _WHOLE.items():
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
                _refuse(name, f"be an integer from {low} to {high}", value, "Leave it out if in doubt.")
        for name, (lower, upper) in _REAL.items():
            value = getattr(self, name)
            if name == "log_std" and value is None:
                continue
            real = isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)
            if not real or not (lower <= value <= upper):
                _refuse(name, f"be a number from {lower:g} to {upper:g}", value, "Leave it out if in doubt.")
        if not self.learning_rate > 0.0:
            _refuse("learning_rate", "be > 0", self.learning_rate, "Leave it out if in doubt.")
        choices = (
            ("algorithm", ALGORITHMS), ("reward", REWARDS), ("warm_start", WARM_STARTS), ("view", tuple(VIEWS)),
            ("covariance", COVARIANCES),
        )  # fmt: skip
        for name, known in choices:
            if getattr(self, name) not in known:
                _refuse(name, f"be one of {', '.join(known)}", repr(getattr(self, name)), "Pick one.")
        if self.algorithm == "dqn" and not self.discrete:
            _refuse("algorithm", "be ppo or recurrent-ppo for an inflation", "'dqn'", "Add --discrete.")
        if self.unseen and (self.view != "levels" or not set(self.unseen) < set(GROUPS)):
            rule = f"be some, not all, of {', '.join(GROUPS)}, of the view levels"
            _refuse("unseen", rule, self.unseen, "Leave it out if in doubt.")
        for name in ("informed", "lookback"):
            if not isinstance(getattr(self, name), bool):
                _refuse(name, "be True or False", repr(getattr(self, name)), "Leave it out if in doubt.")
        object.__setattr__(self, "lookback", self.lookback and self.covariance == "mixture")
        object.__setattr__(self, "informed", self.informed and self.algorithm == "ppo")
        if self.covariance == "mixture" and self.view != "levels":
            _refuse("covariance", "be chosen with the view plain", "'mixture'", "Use --covariance chosen.")
        if self.algorithm != "dqn" and self.minibatch > self.environments * self.horizon:
            most = self.environments * self.horizon
            _refuse("minibatch", f"be at most environments x horizon = {most}", self.minibatch, "Make it smaller.")
        for name, known_names in (("suite", SUITES), ("scenario", SCENARIOS)):
            value = getattr(self, name)
            if value is not None and value not in known_names:
                _refuse(name, f"be one of {', '.join(known_names)}", repr(value), "See jink list.")
        if (self.suite is None) == (self.scenario is None):
            _refuse("suite", "be given, or a scenario, not both", (self.suite, self.scenario), "Drop one.")
        if self.discrete and (len(self.factors) < 2 or not set(self.factors) <= set(FACTORS)):
            _refuse("factors", f"be at least two of {', '.join(FACTORS)}", self.factors, "See jink list.")

        least = self.batch * (self.rounds + self.has_critic_first)
        if self.steps < least:
            _refuse(
                "steps", f"be at least {least}, a batch of {self.batch} for each of {self.rounds} rounds"
                + (" and one for the critic" if self.has_critic_first else ""), self.steps,
                f"Use --steps {least}, or fewer --rounds, --environments or --horizon.",
            )  # fmt: skip

    @property
    def batch(self) -> int:
        """Environment steps between two updates."""
        return self.environments * (TRAIN_EVERY if self.algorithm == "dqn" else self.horizon)

    @property
    def has_critic_first(self) -> bool:
        """Whether the critic learns alone at first."""
        return self.algorithm == "ppo" and self.critic_first > 0.0

    def plan(self) -> tuple[int, tuple[int, ...]]:
        """Environment steps of the critic alone, and those after which each round ends: whole batches."""
        total = self.steps // self.batch
        critic = 0
        if self.has_critic_first:
            critic = min(math.ceil(self.critic_first * self.steps / self.batch), total - self.rounds)
        ends = []
        for number in range(1, self.rounds + 1):
            wanted = -(-(self.steps * number // self.rounds) // self.batch)
            ends.append(self.batch * min(max(wanted, critic + number), total - self.rounds + number))
        return critic * self.batch, tuple(ends)

    @property
    def first_log_std(self) -> float:
        """Logarithm of the standard deviation of the first actions."""
        if self.log_std is not None:
            return self.log_std
        return -1.0 if self.copies == "none" else -3.5

    @property
    def copies(self) -> str:
        """What the network copies first."""
        follows = self.algorithm == "ppo" and not self.discrete and self.view == "levels"
        return self.warm_start if follows else "none"

    def environment(self) -> dict[str, Any]:
        """Options of the task."""
        told: dict[str, Any] = {"view": self.view, "covariance": self.covariance}
        told |= {"lookback": self.lookback, "reward": self.reward, "least_gain": self.least_gain}
        return {**told, "factors": self.factors} if self.discrete else told

    def source(self) -> dict[str, Any]:
        """Where episodes come from."""
        return {"scenario": self.scenario} if self.scenario is not None else {"suite": self.suite}

    def told(self) -> dict[str, Any]:
        """Every value, as JSON has it."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def refuse_idle(config: AgentConfig, given: Collection[str]) -> None:
    """Refuse options that were given and would change nothing.

    Args:
        config: what came of them.
        given: their names.

    Raises:
        ValueError: the first of them.
    """
    if "factors" in given and not config.discrete:
        _refuse("factors", "be left out for an inflation", ",".join(config.factors), "Add --discrete.")
    if "warm_start" in given and config.copies != config.warm_start:
        rule = "be none for factors, the view plain and recurrent-ppo, which copy nothing"
        _refuse("warm_start", rule, config.warm_start, "Leave it out.")
    if "lookback" in given and config.covariance != "mixture":
        _refuse("lookback", f"be left out with covariance {config.covariance}", config.lookback, "Drop the option.")
    if "horizon" in given and config.algorithm == "dqn":
        _refuse("horizon", f"be left out for dqn, which learns every {TRAIN_EVERY} steps", config.horizon, "Drop it.")


def _refuse(name: str, rule: str, value: Any, remedy: str) -> None:
    raise ValueError(f"train agent: {name.replace('_', '-')} must {rule}; got {value}. {remedy}")
