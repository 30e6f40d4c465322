"""The rungs of the ladder: what follows the target, by name, from the measurement itself to a bound."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes
from jink.envs.observing import seen_positions
from jink.envs.scenario import Scenario
from jink.estimators.adaptive_estimator import AdaptiveEstimator
from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.motions import constant_velocity
from jink.estimators.oracles import oracle
from jink.estimators.recipes import (
    ADAPTATIONS,
    RECIPES,
    Scales,
    intent_imm,
    kf_cv,
    make_estimator,
    robust_imm,
    student_t_imm,
)
from jink.estimators.sensor import Sensor
from jink.estimators.status import STARTING
from jink.estimators.treatments import Adaptive, Uncertain
from jink.intent.laws import Phase
from jink.intent.model import IntentModel
from jink.training.ladder.scores import HORIZON_S, Readings
from jink.training.ladder.settings import Settings
from jink.training.ladder.typical import typical_scales
from jink.training.loading import is_spec
from jink.training.third_party import load_estimator

__all__ = ["FACTORS", "LADDER", "Follower", "NoSuchRung", "make_follower"]

Floats = NDArray[np.float64]
FACTORS = ("mr", "huber", "rma", "mahalanobis")
LADDER = (
    "raw",
    "kf-cv",
    "kf-ca",
    "singer",
    "ukf-ct",
    *FACTORS,
    "imm",
    "student-t-imm",
    "robust-imm",
    "sage-husa",
    "vb-noise",
    "intent-imm",
    "intent-imm@learned",
    "joint-imm",
    "agent",
    "oracle",
    "bound",
)
"""From the measurement itself to what no estimator can beat."""
_SAME = {
    "straight": ("cv", "straight"),
    "accelerate": ("ca", "accelerate"),
    "turn": ("ct", "turn", "orbit"),
    "orbit": ("ct", "turn", "orbit"),
    "weave": ("weave",),
}
"""True intent -> what banks call it; a jink is none of them."""
_DESCRIBED = ("straight", "accelerate", "turn", "orbit")


class NoSuchRung(Exception):  # noqa: N818 - it ends no computation
    """A rung that a scenario does not have; the sentence says why."""


class Follower(NamedTuple):
    """What follows the targets of one scenario.

    estimate: episodes to estimates, one thread.
    read: what it says besides, from episodes and its estimates.
    parameters: everything that was chosen, for the rows.
    """

    estimate: Callable[[Episodes], Estimates]
    read: Callable[[Episodes, Estimates], Readings]
    parameters: Mapping[str, Any]


def make_follower(name: str, scenario: Scenario, settings: Settings) -> Follower:
    """The rung of that name for a scenario.

    Args:
        name: one of `LADDER` (not ``bound``, which estimates nothing), or a recipe.
        scenario: what it will follow.
        settings: factors on the typical scales, and options.

    Raises:
        NoSuchRung: this scenario has no such rung.
        ValueError: an unknown name.
    """
    if name == "raw":
        return Follower(functools.partial(_raw, scenario.sensor), _says_nothing, {})
    scales = _scaled(typical_scales(scenario), settings)
    told: dict[str, Any] = {"scales": vars(scales), "settings": settings._asdict()}
    if name == "oracle":
        return _oracle(scenario, scales, told)
    if name == "agent" and name not in RECIPES:
        raise NoSuchRung("this version has no agent")
    if name.startswith("intent-imm@"):
        bank, told["model"] = _learned(name.partition("@")[2], scenario, settings)
        del told["scales"]  # a model has its own
        return _following(BankEstimator(bank, name=name, threads=1), scenario, settings, told)
    if name in FACTORS:
        motion = constant_velocity(scenario.axes, acceleration_density=scales.acceleration**2)
        bank = Bank((Mode("cv", motion, _distrust(name, settings)),), scenario.sensor, speed=scales.speed)
        return _following(BankEstimator(bank, name=name, threads=1), scenario, settings, told)
    if is_spec(name):
        return _outside(name, scenario, told)
    if name not in RECIPES:
        raise ValueError(f"--estimator: name must be one of {', '.join(LADDER)}; got '{name}'. See jink list.")
    if name == "agent":
        return _agent(scenario, scales, settings, told)
    if name == "student-t-imm":
        bank = student_t_imm(scenario.sensor, scales, dof=settings.dof)
    elif name == "robust-imm":
        bank = robust_imm(scenario.sensor, scales)
        known = _known_error(scenario)
        bank = bank.with_(modes=tuple(replace(m, treatment=(*known, _distrust(m.name, settings))) for m in bank.modes))
    else:
        bank = RECIPES[name](scenario.sensor, scales)
    if name in ADAPTATIONS:
        adaptation = replace(ADAPTATIONS[name], forgetting=settings.forgetting)
        return _following(AdaptiveEstimator(bank, adaptation, name=name, threads=1), scenario, settings, told)
    return _following(BankEstimator(bank, name=name, threads=1), scenario, settings, told)


def _scaled(scales: Scales, settings: Settings) -> Scales:
    return replace(
        scales,
        acceleration=scales.acceleration * settings.acceleration,
        sojourn=scales.sojourn * settings.sojourn,
        surge_every=scales.surge_every * settings.surge_every,
        surge_for=scales.surge_for * settings.surge_for,
    )


def _distrust(factor: str, settings: Settings) -> Adaptive:
    """A factor whose thresholds let another share of good measurements pass."""
    usual = Adaptive(factor)
    tails = tuple(1.0 - (1.0 - p) * settings.tail for p in usual.rule.probabilities)
    return usual if settings.tail == 1.0 else replace(usual, probabilities=tails)


def _known_error(scenario: Scenario) -> tuple[Uncertain, ...]:
    """The bound of a plant's error, which is what the robust estimator is made for; its size at a step is not told."""
    error = getattr(scenario.motion, "error", None)
    return () if error is None else (Uncertain(error.gain, error.of_state),)


def _learned(name: str, scenario: Scenario, settings: Settings) -> tuple[Bank, str]:
    """The bank of the pretrained model that learned from this scenario's target, or of the one named.

    The factor on acceleration scales the roots of its three noise densities, that on the time between switches the
    times that its chain stays.
    """
    from jink.envs.scenarios import SCENARIOS
    from jink.intent.pretrained import load_pretrained, pretrained_names

    for known in pretrained_names() if name == "learned" else (name,):
        model = load_pretrained(known)
        tracks = model.about.get("tracks")
        source = SCENARIOS.get(str(tracks.get("source"))) if isinstance(tracks, dict) else None
        if model.axes == scenario.axes and (name != "learned" or (source and source.motion == scenario.motion)):
            return _scaled_model(model, settings).bank(scenario.sensor), known
    raise NoSuchRung("no pretrained model has learned from this target")


def _scaled_model(model: IntentModel, settings: Settings) -> IntentModel:
    """The same model where both factors are one."""
    square, stay = settings.acceleration**2, settings.sojourn

    def scaled(phase: Phase) -> Phase:
        law = replace(
            phase.law,
            growth_noise=phase.law.growth_noise * square,
            turn_noise=phase.law.turn_noise * square,
            wobble=phase.law.wobble * square,
        )
        return replace(phase, law=law, duration=phase.duration * stay)

    intents = tuple(
        replace(intent, phases=tuple(map(scaled, intent.phases)), renewal=intent.renewal / stay)
        for intent in model.intents
    )
    generator = tuple(tuple(rate / stay for rate in row) for row in model.generator)
    return replace(model, intents=intents, generator=generator)


def _prior(episodes: Episodes) -> Prior:
    return Prior(mean=episodes.prior_mean, cov=episodes.prior_cov)


def _following(estimator: Any, scenario: Scenario, settings: Settings, told: Mapping[str, Any]) -> Follower:
    def inputs(episodes: Episodes) -> tuple[Any, ...]:
        noise = None if settings.noise == 1.0 else settings.noise * episodes.nominal_noise
        return episodes.measurements, episodes.times, noise, episodes.sensor_states

    def estimate(episodes: Episodes) -> Estimates:
        return estimator.run(*inputs(episodes), prior=_prior(episodes))

    def read(episodes: Episodes, found: Estimates) -> Readings:
        z, times, noise, places = inputs(episodes)
        forecast = estimator.forecast_run(z, times, HORIZON_S, noise, places, prior=_prior(episodes))[0]
        said = _true_intents(estimator, scenario, found)
        return said._replace(forecast=forecast, surge=_surge(estimator, found))

    return Follower(estimate, read, told)


def _true_intents(estimator: Any, scenario: Scenario, found: Estimates) -> Readings:
    """What a bank says of the true intents and of those that the target does not have.

    Nothing where the bank has one intent or the target has.
    """
    names = list(getattr(estimator, "intents", ()))
    if len(names) < 2 or len(scenario.intents) < 2:
        return Readings()
    probs = np.asarray(estimator.intent_probs(found))
    shares = np.full((*probs.shape[:2], len(scenario.intents)), np.nan)
    words = [tuple(i for i, name in enumerate(names) if name in _SAME.get(true, (true,))) for true in scenario.intents]
    for column, mine in enumerate(words):
        if mine:
            shares[..., column] = probs[..., list(mine)].sum(axis=2)
    foreign = [i for i in range(len(names)) if not any(i in mine for mine in words)]
    return Readings(
        intents=shares,
        alike=tuple(words.index(mine) for mine in words),
        foreign=probs[..., foreign].max(axis=2) if foreign else None,
    )


def _surge(estimator: Any, found: Estimates) -> Floats | None:
    try:
        return np.asarray(estimator.surge_probability(found))
    except (AttributeError, ValueError):  # it has no noise levels
        return None


def _agent(scenario: Scenario, scales: Scales, settings: Settings, told: dict[str, Any]) -> Follower:
    """The pretrained policy in the loop of a Kalman filter; it also says how probable a surge is."""
    estimator: Any = make_estimator("agent", scenario.sensor, **vars(scales), threads=1)
    follower = _following(estimator, scenario, settings, told)

    def read(episodes: Episodes, found: Estimates) -> Readings:
        noise = None if settings.noise == 1.0 else settings.noise * episodes.nominal_noise
        places = episodes.sensor_states
        surge = estimator.noise_run(episodes.measurements, episodes.times, noise, places, prior=_prior(episodes))[1]
        return follower.read(episodes, found)._replace(surge=None if np.isnan(surge).all() else surge)

    return follower._replace(read=read)


def _outside(spec: str, scenario: Scenario, told: dict[str, Any]) -> Follower:
    """A third party's: told the typical scales and, where it asks for it, the prior."""
    estimator = load_estimator(spec, scenario)
    if isinstance(estimator, BankEstimator):
        estimator.threads = 1
        return _following(estimator, scenario, Settings(), told)
    follower = _following(estimator, scenario, Settings(), told)

    def estimate(episodes: Episodes) -> Estimates:
        found = follower.estimate(episodes)
        A = scenario.axes
        # Before its first estimate it knows what everybody is told at the start.
        late = (np.asarray(found.status) == STARTING)[..., None] & ~np.isfinite(found.position)
        return found._replace(position=np.where(late, episodes.prior_mean[:, None, :A], found.position))

    return follower._replace(estimate=estimate)


def _oracle(scenario: Scenario, scales: Scales, told: Mapping[str, Any]) -> Follower:
    """Told the noise of every sample, and the intent where a motion of the bank describes it.

    A weave or a jink is not told: the bank's own swing fits them worse than what it mixes when it is not told.
    """
    several = len(scenario.intents) > 1
    bank = (intent_imm if several else kf_cv)(scenario.sensor, scales)
    known = [mode.purpose for mode in bank.modes]
    told_as = {name: next((k for k, mine in enumerate(known) if mine in _SAME[name]), -1) for name in _DESCRIBED}
    column = np.array([told_as.get(name, -1) for name in scenario.intents])

    def estimate(episodes: Episodes) -> Estimates:
        intents = column[episodes.truth.intent] if several else None
        return oracle(
            bank, episodes.measurements, episodes.times, noise=episodes.noise, intents=intents,
            sensor_states=episodes.sensor_states, prior=_prior(episodes), threads=1,
        )  # fmt: skip

    def read(episodes: Episodes, found: Estimates) -> Readings:
        if several:  # a forecast that is told the intents to come would be told too much
            return Readings()
        places = episodes.sensor_states
        estimator = BankEstimator(bank, threads=1)
        args = (episodes.measurements, episodes.times, HORIZON_S, episodes.noise, places)
        return Readings(estimator.forecast_run(*args, prior=_prior(episodes))[0])

    return Follower(estimate, read, told)


def _says_nothing(episodes: Episodes, found: Estimates) -> Readings:
    return Readings(found.position + HORIZON_S * found.velocity)


def _raw(sensor: Sensor, episodes: Episodes) -> Estimates:
    """The last measured position, and the difference of the last two as velocity; the prior before the first."""
    B, T = episodes.times.shape
    A = episodes.truth.position.shape[2]
    position, velocity = np.empty((B, T, A)), np.empty((B, T, A))
    for b, times in enumerate(episodes.times):
        seen = seen_positions(sensor, episodes.measurements[b], episodes.sensor_states[b])
        place, speed, since = episodes.prior_mean[b, :A], episodes.prior_mean[b, A:], times[0]
        for k in range(T):
            if np.isfinite(seen[k]).all():
                if times[k] > since:
                    speed = (seen[k] - place) / (times[k] - since)
                place, since = seen[k], times[k]
            position[b, k], velocity[b, k] = place, speed
    nothing = np.full((B, T), np.nan)
    return Estimates(
        episodes.times, position, velocity, np.full((B, T, 2 * A, 2 * A), np.nan), np.ones((B, T, 1)),
        nothing, np.zeros((B, T)), np.zeros((B, T), dtype=np.int64), np.zeros((B, T), dtype=np.int8),
    )  # fmt: skip
