"""Estimators by name. A recipe turns a sensor and a few physical scales into a bank.

Scales: ``acceleration`` (typical size of a target's acceleration, m/s^2), ``speed`` (typical speed, m/s),
``turn_rate`` (typical turn rate, rad/s), ``sojourn`` (how long an intent lasts, s), and for noise levels
``surge_every`` and ``surge_for`` (how often the noise surges and for how long, s). Everything else follows.
To add a recipe: write a function here (or in your own file) and give it one line in ``RECIPES``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from jink.estimators.adaptive_estimator import AdaptiveEstimator, NoiseAdaptation
from jink.estimators.agent.policy import Policy
from jink.estimators.agent.policy_file import find_policy
from jink.estimators.agent_estimator import AgentEstimator
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.factors import LARGEST_INFLATION
from jink.estimators.joint import CALM, SURGE, joint_bank
from jink.estimators.markov import MarkovChain
from jink.estimators.motions import (
    constant_acceleration,
    constant_velocity,
    coordinated_turn,
    singer,
    spatial_turn,
    swing,
)
from jink.estimators.sensor import Sensor
from jink.estimators.treatments import Adaptive, HeavyTails, Uncertain

__all__ = ["AGENT_POLICY", "LEARNED", "RECIPES", "LearnedModel", "Scales", "make_estimator"]

ROBUST_FACTORS = ("mr", "huber", "rma", "mahalanobis")
_STAY = 0.9
_QUIET = 0.05
"""A straight leg wobbles with this share of the target's acceleration."""


@dataclass(frozen=True)
class Scales:
    """Physical scales of a target.

    Args:
        acceleration: typical acceleration; m/s^2.
        speed: typical speed; m/s; also the standard deviation of velocity at the start.
        turn_rate: typical turn rate; rad/s; None: ``acceleration / speed``, at most 1.
        sojourn: mean time between changes of intent; s.
        surge_every: mean time from the end of one noise surge to the next; s; of banks with noise levels.
        surge_for: mean time that a surge stays at one noise level; s; a few rows at least, unless surges are
            outliers that come alone.

    Raises:
        ValueError: a scale is not positive and finite.
    """

    acceleration: float = 1.0
    speed: float = 10.0
    turn_rate: float | None = None
    sojourn: float = 10.0
    surge_every: float = CALM
    surge_for: float = SURGE

    def __post_init__(self) -> None:
        for name in ("acceleration", "speed", "turn_rate", "sojourn", "surge_every", "surge_for"):
            value = getattr(self, name)
            if value is not None and not (value > 0 and math.isfinite(value)):
                raise ValueError(f"Scales: {name} must be > 0 and finite; got {value}. Give a typical value.")

    @property
    def turn(self) -> float:
        """Turn rate used; rad/s."""
        return self.turn_rate if self.turn_rate is not None else min(self.acceleration / self.speed, 1.0)


def _single(name: str, mode: Mode, sensor: Sensor, scales: Scales) -> Bank:
    return Bank((mode,), sensor, speed=scales.speed)


def kf_cv(sensor: Sensor, scales: Scales) -> Bank:
    """Kalman filter, constant velocity: white acceleration strong enough for the manoeuvres."""
    density = scales.acceleration**2
    return _single("kf-cv", Mode("cv", constant_velocity(sensor.axes, acceleration_density=density)), sensor, scales)


def kf_ca(sensor: Sensor, scales: Scales) -> Bank:
    """Kalman filter, constant acceleration: white jerk that turns the acceleration over within a sojourn."""
    motion = constant_acceleration(
        sensor.axes,
        jerk_density=2.0 * scales.acceleration**2 / scales.sojourn,
        acceleration_sd=scales.acceleration,
    )
    return _single("kf-ca", Mode("ca", motion), sensor, scales)


def singer_filter(sensor: Sensor, scales: Scales) -> Bank:
    """Kalman filter, Singer's exponentially correlated acceleration."""
    motion = singer(sensor.axes, time_constant=scales.sojourn, acceleration_sd=scales.acceleration)
    return _single("singer", Mode("singer", motion), sensor, scales)


def ukf_ct(sensor: Sensor, scales: Scales) -> Bank:
    """Unscented Kalman filter, coordinated turn with estimated rate (2-D) or rate vector (3-D)."""
    return _single("ukf-ct", Mode("turn", _turn(sensor.axes, scales, scales.acceleration)), sensor, scales)


def imm(sensor: Sensor, scales: Scales) -> Bank:
    """Interacting multiple models, the textbook's three: constant velocity, constant acceleration, turn; mixing."""
    axes = sensor.axes
    modes = [
        Mode("cv", constant_velocity(axes, acceleration_density=(_QUIET * scales.acceleration) ** 2)),
        Mode(
            "ca",
            constant_acceleration(
                axes,
                jerk_density=2.0 * scales.acceleration**2 / scales.sojourn,
                acceleration_sd=scales.acceleration,
            ),
        ),
    ]
    if axes > 1:
        modes.append(Mode("ct", _turn(axes, scales, _QUIET * scales.acceleration)))
    return _many(modes, sensor, scales, "mix")


def intent_imm(sensor: Sensor, scales: Scales) -> Bank:
    """Intent bank (CN202211553542): straight, turn, accelerate, weave; each its own state; a switch is a birth."""
    axes = sensor.axes
    quiet = (_QUIET * scales.acceleration) ** 2
    modes = [
        Mode("straight", constant_velocity(axes, acceleration_density=quiet)),
        Mode(
            "accelerate",
            constant_acceleration(
                axes,
                jerk_density=2.0 * (2.0 * _QUIET * scales.acceleration) ** 2 / scales.sojourn,
                acceleration_sd=scales.acceleration,
            ),
        ),
        Mode(
            "weave",
            swing(
                axes,
                rate=2.0 * math.pi / scales.sojourn,
                snap_density=0.1 * scales.acceleration**2 * (2.0 * math.pi / scales.sojourn) ** 2 / scales.sojourn,
                acceleration_sd=scales.acceleration,
                jerk_sd=scales.acceleration * 2.0 * math.pi / scales.sojourn,
            ),
        ),
    ]
    if axes > 1:
        modes.insert(1, Mode("turn", _turn(axes, scales, _QUIET * scales.acceleration)))
    return _many(modes, sensor, scales, "birth")


def student_t_imm(sensor: Sensor, scales: Scales, dof: float = 5.0, matrices: str = "scale") -> Bank:
    """Student-t interacting models (CN109491241B): those of imm, with heavy tails in state, motion and measurement."""
    bank = imm(sensor, scales)
    tails = HeavyTails(dof, matrices=matrices)
    return bank.with_(modes=tuple(replace(mode, treatment=tails) for mode in bank.modes))


def robust_imm(
    sensor: Sensor,
    scales: Scales,
    uncertain: Uncertain | None = None,
    likelihood: str = "t",
    factors: tuple[str, ...] = ROBUST_FACTORS,
    cap: float = LARGEST_INFLATION,
) -> Bank:
    """Robust interacting estimators (CN202211618386): one adaptive factor per mode over one constant velocity.

    Raises:
        ValueError: no factor, one that repeats, or an unknown one.
    """
    if isinstance(factors, str) or not len(factors) or len(set(factors)) != len(factors):
        raise ValueError(
            f"robust_imm: factors must be one or more distinct names in a tuple; got {factors!r}. Use {ROBUST_FACTORS}."
        )
    motion = constant_velocity(sensor.axes, acceleration_density=scales.acceleration**2)
    common = () if uncertain is None else (uncertain,)
    modes = tuple(Mode(name, motion, (*common, Adaptive(name, likelihood, cap=cap)), intent="cv") for name in factors)
    count = len(factors)
    if count == 1:
        return Bank(modes, sensor, speed=scales.speed)
    matrix = [[_STAY if i == j else (1.0 - _STAY) / (count - 1) for j in range(count)] for i in range(count)]
    return Bank(modes, sensor, chain=MarkovChain.per_step(matrix), speed=scales.speed)


def joint_imm(sensor: Sensor, scales: Scales) -> Bank:
    """Joint bank (ours): the intents of intent-imm times noise levels: manoeuvre and surge compete."""
    return joint_bank(intent_imm(sensor, scales), calm=scales.surge_every, surge=scales.surge_for)


def _turn(axes: int, scales: Scales, wobble: float):  # type: ignore[no-untyped-def]
    if axes == 1:
        raise ValueError("make_estimator: sensor must have 2 or 3 axes for a turn; got 1. Use kf-cv, kf-ca or singer.")
    make = coordinated_turn if axes == 2 else spatial_turn
    return make(
        acceleration_density=wobble**2,
        rate_density=(0.1 * scales.turn) ** 2 / scales.sojourn,
        rate_sd=scales.turn,
    )


def _many(modes: list[Mode], sensor: Sensor, scales: Scales, interaction: str) -> Bank:
    chain = MarkovChain.from_sojourns([scales.sojourn] * len(modes))
    return Bank(tuple(modes), sensor, chain=chain, interaction=interaction, speed=scales.speed)


def sage_husa(sensor: Sensor, scales: Scales) -> Bank:
    """As kf-cv, learning how noisy the sensor is from the size of its innovations (Sage-Husa)."""
    return kf_cv(sensor, scales).with_(learns_noise=True)


def vb_noise(sensor: Sensor, scales: Scales) -> Bank:
    """As kf-cv, learning how noisy the sensor is by variational Bayes (inverse Wishart)."""
    return kf_cv(sensor, scales).with_(learns_noise=True)


def agent(sensor: Sensor, scales: Scales) -> Bank:
    """As kf-cv, with an agent that chooses how noisy each measurement is taken to be (ours; `jink train agent`)."""
    return kf_cv(sensor, scales).with_(learns_noise=True)


RECIPES: dict[str, Callable[..., Bank]] = {
    "kf-cv": kf_cv,
    "kf-ca": kf_ca,
    "singer": singer_filter,
    "ukf-ct": ukf_ct,
    "imm": imm,
    "intent-imm": intent_imm,
    "student-t-imm": student_t_imm,
    "robust-imm": robust_imm,
    "joint-imm": joint_imm,
    "sage-husa": sage_husa,
    "vb-noise": vb_noise,
    "agent": agent,
}
"""Name -> recipe; the first line of each docstring is shown by ``jink list``."""

ADAPTATIONS: dict[str, NoiseAdaptation] = {
    "sage-husa": NoiseAdaptation(method="sage-husa"),
    "vb-noise": NoiseAdaptation(method="variational"),
}
"""Recipes whose one mode learns its noise -> how."""

AGENT_POLICY = "continuous"
"""The policy of the recipe ``agent`` where none is given."""


class LearnedModel(Protocol):
    """What was learned from tracks and knows its own scales, for instance `jink.intent.IntentModel`."""

    def bank(self, sensor: Sensor) -> Bank:
        """Its modes before a sensor."""
        ...


def _as_learned(bank: Bank, calm: float = CALM, surge: float = SURGE) -> Bank:
    return bank


LEARNED: dict[str, Callable[..., Bank]] = {"intent-imm": _as_learned, "joint-imm": joint_bank}
"""Recipes that take a learned model -> what they make of its bank; ``calm``, ``surge`` as in `joint_bank`."""


def make_estimator(
    name: str,
    sensor: Sensor,
    *,
    acceleration: float = 1.0,
    speed: float = 10.0,
    turn_rate: float | None = None,
    sojourn: float = 10.0,
    surge_every: float = CALM,
    surge_for: float = SURGE,
    threads: int | None = None,
    model: LearnedModel | None = None,
    policy: Policy | str | Path | None = None,
) -> BankEstimator:
    """An estimator by name.

    Args:
        name: one of `RECIPES`.
        sensor: what is measured; its axes are the estimator's.
        acceleration, speed, turn_rate, sojourn: see `Scales`; not used with a ``model``, which has its own.
        surge_every, surge_for: see `Scales`; used by ``joint-imm``.
        threads: processor cores for many tracks; None: all.
        model: learned intents instead of those of the recipe; only for recipes in `LEARNED`.
        policy: of ``agent``: itself, the name of one that ships with the package, or a folder of `jink train agent`;
            None: `AGENT_POLICY`.

    Returns:
        A `BankEstimator` (an `AdaptiveEstimator` where the recipe learns its noise, an `AgentEstimator` for ``agent``).

    Raises:
        ValueError: an unknown name, a scale that is not positive, or a model or policy where none can be used.
    """
    if name not in RECIPES:
        raise ValueError(f"make_estimator: name must be one of {', '.join(RECIPES)}; got {name!r}. See `jink list`.")
    scales = Scales(acceleration, speed, turn_rate, sojourn, surge_every, surge_for)
    if policy is not None and name != "agent":
        raise ValueError(f"make_estimator: policy must be left out for {name}; got one. Only agent takes one.")
    if model is not None:
        return BankEstimator(_learned_bank(name, sensor, model, scales), name=name, threads=threads)
    bank = RECIPES[name](sensor, scales)
    if name == "agent":
        return AgentEstimator(bank, find_policy(AGENT_POLICY if policy is None else policy), name=name, threads=threads)
    if name in ADAPTATIONS:
        return AdaptiveEstimator(bank, ADAPTATIONS[name], name=name, threads=threads)
    return BankEstimator(bank, name=name, threads=threads)


def _learned_bank(name: str, sensor: Sensor, model: LearnedModel, scales: Scales) -> Bank:
    if name not in LEARNED:
        raise ValueError(
            f"make_estimator: model must be left out for {name}; got one. Recipes that take one: {', '.join(LEARNED)}."
        )
    if not hasattr(model, "bank"):
        raise ValueError(
            f"make_estimator: model must have a method bank(sensor); got {model!r}. "
            "Load it first: jink.intent.model_file.load_model(folder)."
        )
    return LEARNED[name](model.bank(sensor), calm=scales.surge_every, surge=scales.surge_for)
