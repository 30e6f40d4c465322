"""The banks that repeat published results, one function per scenario, and the errors as the sources define them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.published import SCENARIOS, UNCERTAIN
from jink.envs.published_truth import PublishedValue, ScenarioData
from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank, Mode
from jink.estimators.bounds import mismatched_errors, steady_kf
from jink.estimators.compiled import NOISE, TRANSITION, Callback
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.motions import constant_acceleration, constant_velocity, known_turn, polar_turn
from jink.estimators.recipes import RECIPES, make_estimator
from jink.estimators.sensors import position

__all__ = ["PUBLISHED_CELLS", "Outcome", "PublishedCell", "published_values", "run_cell"]

Floats = NDArray[np.float64]
_DEGREE = np.pi / 180.0


class Outcome(NamedTuple):
    """What one cell gives: metric to (value, unit), parameters, track-steps, how many of them diverged."""

    values: dict[str, tuple[float, str]]
    parameters: dict[str, Any]
    steps: int
    diverged: int


class PublishedCell(NamedTuple):
    """One estimator on one scenario: its function, and the Monte-Carlo runs of the source."""

    scenario: str
    estimator: str
    runs: int
    run: Callable[[ScenarioData, str], tuple[Estimates, dict[str, Any]]]
    score: Callable[[ScenarioData, Estimates], dict[str, tuple[float, str]]]


def run_cell(cell: PublishedCell, runs: int, seed: int) -> Outcome:
    """Simulate the scenario, run the estimator, score it as the source does.

    Args:
        cell: from `PUBLISHED_CELLS`.
        runs: Monte-Carlo runs.
        seed: of truth and noise; the same for every estimator.

    Returns:
        the outcome.
    """
    if cell.scenario == UNCERTAIN.id:
        return Outcome(_uncertain(), {}, 0, 0)
    data = SCENARIOS[cell.scenario].simulate(runs, seed)
    estimates, parameters = cell.run(data, cell.estimator)
    values = cell.score(data, estimates)
    status = np.asarray(estimates.status)
    return Outcome(values, parameters, int(status.size), int((status == 3).sum()))


def published_values(cell: PublishedCell) -> Mapping[str, PublishedValue]:
    """The numbers to compare with, by metric."""
    source = UNCERTAIN.published if cell.scenario == UNCERTAIN.id else SCENARIOS[cell.scenario].published
    if cell.scenario == UNCERTAIN.id:
        return source
    found = {}
    for key, value in source.items():
        name, _, metric = key.partition("/")
        if name == cell.estimator:
            found[metric or _MAIN_METRIC[cell.scenario]] = value
    return found


# Air traffic turns (B2).


def _run_turns(data: ScenarioData, name: str) -> tuple[Estimates, dict[str, Any]]:
    """Banks of held white acceleration, started from two points at the second sample."""
    dt, sigma = float(np.diff(data.times)[0]), float(np.sqrt(data.noise[0, 0]))

    def straight(held: float) -> Motion:
        return constant_velocity(2, acceleration_density=0.0, held_acceleration=held)

    def turn(rate: float) -> Motion:
        return known_turn(rate, acceleration_density=0.0, held_acceleration=0.1)

    chain, probs = None, None
    if name == "imm-cv-cv":
        modes = (Mode("quiet", straight(0.1)), Mode("manoeuvre", straight(2.0)))
        chain, probs = MarkovChain.per_step([[0.9, 0.1], [0.1, 0.9]]), (0.5, 0.5)
    elif name == "imm-cv-ct":
        modes = (
            Mode("straight", straight(0.1)),
            Mode("left", turn(_DEGREE)),
            Mode("right", turn(-3 * _DEGREE)),
        )
        chain, probs = MarkovChain.per_step(data.mode_transition), tuple(data.mode_probs0)
    else:
        modes = (Mode("cv", straight(float(name.removeprefix("kf-")))),)
    bank = Bank(modes, position(2, sigma), chain=chain, initial_probs=probs, interaction="mix", min_prob=0.0)
    z = data.measurements
    mean = np.concatenate([z[:, 1], (z[:, 1] - z[:, 0]) / dt], axis=1)
    cov = np.kron(sigma**2 * np.array([[1, 1 / dt], [1 / dt, 2 / dt**2]]), np.eye(2))
    run = BankEstimator(bank, name).run(z[:, 1:], data.times[1:], prior=Prior(mean, cov, includes_first=True))
    return run, {"interaction": "mix", "start": "two points"}


def _score_turns(data: ScenarioData, run: Estimates) -> dict[str, tuple[float, str]]:
    times = data.times[1:]
    late, leg1 = times >= 30.0, (times >= 75.0) & (times <= 125.0)
    per_time = ((run.position - data.position[:, 1:]) ** 2).sum(-1).mean(0)
    velocity = ((run.velocity - data.velocity[:, 1:]) ** 2).sum(-1).mean(0)
    return {
        "position_rms": (_root(per_time[late].mean()), "m"),
        "position_peak": (_root(per_time[late].max()), "m"),
        "position_leg1": (_root(per_time[leg1].mean()), "m"),
        "velocity_rms": (_root(velocity[late].mean()), "m/s"),
    }


# Jump linear system (N1).


def _pushed(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    out[0] = x[0] + dt * x[1] + 0.5 * dt * dt * params[0]
    out[1] = x[1] + dt * params[0]


def _held_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    held = params[1] * params[1] * dt * dt
    out[0, 0] = held * dt * dt / 4.0
    out[0, 1] = out[1, 0] = held * dt / 2.0
    out[1, 1] = held


_PUSHED, _PUSHED_NOISE = Callback(_pushed, TRANSITION), Callback(_held_noise, NOISE)


def _run_jump(data: ScenarioData, name: str) -> tuple[Estimates, dict[str, Any]]:
    """One mode per known acceleration; the oracle is told the mode of every step."""
    modes = tuple(
        Mode(label, Motion(label, ("x", "vx"), 1, _PUSHED, (a, 2.0), noise=_PUSHED_NOISE))
        for label, a in zip(data.mode_names, (0.0, 20.0, -20.0), strict=True)
    )
    bank = Bank(
        modes,
        position(1, float(np.sqrt(data.noise[0, 0]))),
        chain=MarkovChain.per_step(data.mode_transition),
        initial_probs=tuple(data.mode_probs0),
        interaction="mix",
        min_prob=0.0,
    )
    told = None
    if name == "oracle":
        # Whatever mode it came from, the step leads to the true one.
        told = np.repeat(np.eye(len(modes))[data.modes][:, :, None, :], len(modes), axis=2)
    prior = Prior(data.prior_mean, data.prior_cov)
    run = BankEstimator(bank, name).run(data.measurements, data.times, prior=prior, mode_transition=told)
    return run, {"interaction": "mix", "accelerations": [0.0, 20.0, -20.0]}


def _score_jump(data: ScenarioData, run: Estimates) -> dict[str, tuple[float, str]]:
    squared = ((run.position - data.position) ** 2 + (run.velocity - data.velocity) ** 2).sum(-1)
    return {"rmse": (float(np.sqrt(squared.mean(1)).mean()), "SI")}


# Constant velocity and constant acceleration (N4).


def _run_cv_ca(data: ScenarioData, name: str) -> tuple[Estimates, dict[str, Any]]:
    """Wiener models of unlike size; the missing acceleration is filled by the receiving mode."""
    cv, ca = constant_velocity(2, acceleration_density=0.01), constant_acceleration(2, jerk_density=1.0)
    order = {label: index for index, label in enumerate(data.state_labels)}
    known = {"cv": Mode("cv", cv), "ca": Mode("ca", ca)}
    modes = tuple(known.values()) if name == "imm" else (known[name.removeprefix("kf-")],)
    index = [[order[label] for label in mode.motion.labels] for mode in modes]
    prior_mean, prior_cov = np.asarray(data.prior_mean), np.asarray(data.prior_cov)
    prior = Prior([prior_mean[i] for i in index], [prior_cov[np.ix_(i, i)] for i in index])
    several = len(modes) > 1
    bank = Bank(
        modes,
        position(2, float(np.sqrt(data.noise[0, 0]))),
        chain=MarkovChain.per_step(data.mode_transition) if several else None,
        initial_probs=tuple(data.mode_probs0) if several and data.mode_probs0 is not None else None,
        interaction="mix",
        min_prob=0.0,
    )
    run = BankEstimator(bank, name).run(data.measurements, data.times, prior=prior)
    return run, {"interaction": "mix"}


def _score_cv_ca(data: ScenarioData, run: Estimates) -> dict[str, tuple[float, str]]:
    return {"position_mse": (float(((run.position - data.position) ** 2).mean()), "m^2")}


# The mixing study (EQUATIONS 1.6).


def _fixed_noise(x: np.ndarray, dt: float, params: np.ndarray, out: np.ndarray) -> None:
    first = params.size - x.size
    for i in range(x.size):
        out[i, i] = params[first + i]


_FIXED_NOISE = Callback(_fixed_noise, NOISE)


def _with_fixed_noise(motion: Motion, variances: Mapping[str, float]) -> Motion:
    """The motion with the same diagonal process noise at every step, as the study states it."""
    return motion.with_(noise=_FIXED_NOISE, params=(*motion.params, *(variances[label] for label in motion.labels)))


def _run_mixing(data: ScenarioData, name: str) -> tuple[Estimates, dict[str, Any]]:
    """Three unlike states; `name` is the interaction rule.

    Differs from the study: alpha is 1, not 0.5, whose negative centre weight loses the turn mode under `none`.
    """
    place = {"x": 1e-4, "y": 1e-4}
    cv = {**place, "vx": 1e-2, "vy": 1e-2}
    ca = {**place, "vx": 1e-3, "vy": 1e-3, "ax": 2e-2, "ay": 2e-2}
    ct = {**place, "s": 1e-2, "psi": 1e-5, "w": 1e-4}
    modes = (
        Mode("cv", _with_fixed_noise(constant_velocity(2), cv)),
        Mode("ca", _with_fixed_noise(constant_acceleration(2), ca)),
        Mode("ct", _with_fixed_noise(polar_turn(), ct)),
    )
    bank = Bank(
        modes,
        position(2, float(np.sqrt(data.noise[0, 0]))),
        chain=MarkovChain.per_step(data.mode_transition),
        initial_probs=tuple(data.mode_probs0) if data.mode_probs0 is not None else None,
        interaction=name,
        speed=30.0,
    )
    return BankEstimator(bank, name).run(data.measurements, data.times), {"interaction": name, "alpha": 1.0}


def _score_mixing(data: ScenarioData, run: Estimates) -> dict[str, tuple[float, str]]:
    later = data.times >= data.times[0] + 1.0
    per_time = ((run.position - data.position) ** 2).sum(-1).mean(0)[later]
    return {"position_rms": (_root(per_time.mean()), "m"), "position_peak": (_root(per_time.max()), "m")}


# Uncertain system (N5), in closed form.


def _uncertain() -> dict[str, tuple[float, str]]:
    gain = np.asarray(UNCERTAIN.noise_gain)
    observation, noise, Q = np.asarray(UNCERTAIN.observation), np.eye(1), gain @ gain.T
    nominal = UNCERTAIN.transition_at(0.0)
    steady = steady_kf(nominal, Q, observation, noise)
    values = {}
    for delta in (-0.3, 0.0, 0.3):
        true = UNCERTAIN.transition_at(delta)
        errors = mismatched_errors(true, Q, observation, noise, steady.gain, nominal)
        values[f"kf/{delta:+g}"] = (float(errors[0][0, 0]), "variance")
    return values


# Paths without published results: the recipes, for comparison with each other.


def _run_recipe(data: ScenarioData, name: str) -> tuple[Estimates, dict[str, Any]]:
    """A recipe whose scales are the true ones: largest acceleration of the path, its mean speed."""
    acceleration = np.linalg.norm(np.gradient(data.velocity[0], data.times, axis=0), axis=1)
    speed = np.linalg.norm(data.velocity[0], axis=1)
    scales = {"acceleration": float(acceleration.max()), "speed": float(speed.mean()), "sojourn": 30.0}
    sensor = position(data.position.shape[-1], float(np.sqrt(data.noise[0, 0])))
    return make_estimator(name, sensor, **scales).run(data.measurements, data.times), scales


def _score_recipe(data: ScenarioData, run: Estimates) -> dict[str, tuple[float, str]]:
    per_time = ((run.position - data.position) ** 2).sum(-1).mean(0)[5:]
    return {"position_rms": (_root(per_time.mean()), "m"), "position_peak": (_root(per_time.max()), "m")}


def _root(value: float) -> float:
    return float(np.sqrt(value))


_MAIN_METRIC = {"n1-jump-linear-v0": "rmse", "n4-cv-ca-v0": "position_mse"}
_WITHOUT = [name for name, scenario in SCENARIOS.items() if not scenario.published]
PUBLISHED_CELLS: tuple[PublishedCell, ...] = (
    *(
        PublishedCell("b2-atc-turns-v0", name, 200, _run_turns, _score_turns)
        for name in ("kf-1", "kf-0.1", "imm-cv-cv", "imm-cv-ct")
    ),
    *(PublishedCell("n1-jump-linear-v0", name, 50, _run_jump, _score_jump) for name in ("oracle", "imm")),
    *(PublishedCell("n4-cv-ca-v0", name, 200, _run_cv_ca, _score_cv_ca) for name in ("kf-cv", "kf-ca", "imm")),
    PublishedCell(UNCERTAIN.id, "kf", 1, _run_recipe, _score_recipe),
    *(
        PublishedCell("mixing-study-v0", name, 30, _run_mixing, _score_mixing)
        for name in ("none", "reset", "jet", "birth")
    ),
    *(PublishedCell(scenario, name, 100, _run_recipe, _score_recipe) for scenario in _WITHOUT for name in RECIPES),
)
"""Every cell of the suite, in the order of the table."""
