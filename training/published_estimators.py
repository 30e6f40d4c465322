"""The filters behind published results: one function per scenario, each with the start its source used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.literature.published_truth import ScenarioData
from jink.envs.published import JUMP_LINEAR, UNCERTAIN
from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.motions import constant_acceleration, constant_velocity, known_turn, polar_turn
from jink.estimators.recipes import RECIPES, make_estimator
from jink.estimators.sensors import position
from jink.training.published_motions import fixed_step, pushed, weighted_sum, with_diagonal_noise

__all__ = ["FILTERS", "MIXING_RULES", "PublishedFilter", "run_filter", "uncertain_filter"]

Floats = NDArray[np.float64]
DEGREE = np.pi / 180.0
MIXING_RULES = ("none", "reset", "jet", "birth", "mix")


class PublishedFilter(NamedTuple):
    """An estimator and how its source starts it.

    estimator: what to run.
    prior: belief at row `first`; None: start from the first measurement(s).
    first: row the filter begins with.
    mode_transition: Markov matrix of each step (B, T - first, M, M), where the modes are told; else None.
    origin: (B, A), m; subtracted from the measurements and added to the positions, so that one prior about
        the origin serves runs that start at different places; None: no shift.
    """

    estimator: BankEstimator
    prior: Prior | None = None
    first: int = 0
    mode_transition: Floats | None = None
    origin: Floats | None = None


def run_filter(chosen: PublishedFilter, data: ScenarioData) -> Estimates:
    """Estimates of rows `chosen.first` and later, (B, T - first, ...)."""
    shift = 0.0 if chosen.origin is None else chosen.origin[:, None, :]
    estimates = chosen.estimator.run(
        data.measurements[:, chosen.first :] - shift,
        data.times[chosen.first :],
        prior=chosen.prior,
        mode_transition=chosen.mode_transition,
    )
    return estimates._replace(position=estimates.position + shift)


def make_bank(
    data: ScenarioData,
    modes: Sequence[Mode],
    *,
    transition: Floats | None = None,
    probs0: Floats | None = None,
    interaction: str = "mix",
    min_prob: float = 0.0,
    alpha: float = 1.0,
) -> Bank:
    """A bank on the scenario's position sensor; the Markov matrix acts once per step, as in the sources.

    Args:
        data: whose sensor noise is used.
        modes: M modes.
        transition: Markov matrix (M, M), row = from; None: a single mode.
        probs0: mode probabilities at the start (M,); None: a single mode.
        interaction: see `Bank`.
        min_prob: floor under the probabilities; the textbook's filters have none.
        alpha: of the unscented transform.
    """
    return Bank(
        tuple(modes),
        position(data.noise.shape[0], tuple(np.sqrt(np.diag(data.noise)))),
        chain=None if transition is None else MarkovChain.per_step(transition),
        initial_probs=None if probs0 is None else tuple(float(p) for p in probs0),
        interaction=interaction,
        min_prob=min_prob,
        alpha=alpha,
    )


def start_from_two_points(data: ScenarioData) -> Prior:
    """Two-point differencing: the belief at the second row, with both measurements already in it.

    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.5.3. Differs: none.
    """
    dt, z = data.times[1] - data.times[0], data.measurements
    mean = np.concatenate([z[:, 1], (z[:, 1] - z[:, 0]) / dt], axis=1)
    return Prior(mean, np.kron([[1.0, 1 / dt], [1 / dt, 2 / dt**2]], data.noise), includes_first=True)


def atc_turns(data: ScenarioData) -> dict[str, PublishedFilter]:
    """B2: two Kalman filters, IMM-L (two levels of noise), IMM with the true turn rates."""

    def straight(held: float) -> Motion:
        return constant_velocity(2, acceleration_density=0.0, held_acceleration=held)

    def turn(rate: float) -> Motion:
        return known_turn(rate, acceleration_density=0.0, held_acceleration=0.1)

    levels = [Mode("quiet", straight(0.1)), Mode("loud", straight(2.0))]
    turns = [
        Mode("straight", straight(0.1)),
        Mode("left-1", turn(DEGREE)),
        Mode("right-3", turn(-3 * DEGREE)),
    ]
    banks = {
        "kf-1": make_bank(data, [Mode("cv", straight(1.0))]),
        "kf-0.1": make_bank(data, [Mode("cv", straight(0.1))]),
        "imm-cv-cv": make_bank(
            data, levels, transition=np.array([[0.9, 0.1], [0.1, 0.9]]), probs0=np.array([0.5, 0.5])
        ),
        "imm-cv-ct": make_bank(data, turns, transition=data.mode_transition, probs0=data.mode_probs0),
    }
    prior = start_from_two_points(data)
    return {name: PublishedFilter(BankEstimator(bank, name), prior, 1) for name, bank in banks.items()}


def jump_linear(data: ScenarioData) -> dict[str, PublishedFilter]:
    """N1: the IMM with the true Markov matrix, and the oracle that is told the mode of every step."""
    drift, gain = np.asarray(JUMP_LINEAR.drift), np.asarray(JUMP_LINEAR.noise_gain)
    modes = [
        Mode(name, pushed(name, drift[m, 1] / JUMP_LINEAR.dt, gain[m, 1, 0] / JUMP_LINEAR.dt))
        for m, name in enumerate(data.mode_names)
    ]
    bank = make_bank(data, modes, transition=data.mode_transition, probs0=data.mode_probs0)
    prior = Prior(data.prior_mean, data.prior_cov)  # type: ignore[arg-type]
    # Whatever mode a step comes from, it leads to the true one.
    told = np.repeat(np.eye(len(modes))[data.modes][:, :, None, :], len(modes), axis=2)
    return {
        "oracle": PublishedFilter(BankEstimator(bank, "oracle"), prior, mode_transition=told),
        "imm": PublishedFilter(BankEstimator(bank, "imm"), prior),
    }


def cv_ca(data: ScenarioData) -> dict[str, PublishedFilter]:
    """N4: Kalman filters with four and six components, and the IMM of both."""
    modes = {
        "cv": Mode("cv", constant_velocity(2, acceleration_density=0.01)),
        "ca": Mode("ca", constant_acceleration(2, jerk_density=1.0)),
    }
    mean, cov = np.asarray(data.prior_mean), np.asarray(data.prior_cov)

    def make(name: str, *chosen: str) -> PublishedFilter:
        several = len(chosen) > 1
        index = [[data.state_labels.index(label) for label in modes[key].motion.labels] for key in chosen]
        bank = make_bank(
            data,
            [modes[key] for key in chosen],
            transition=data.mode_transition if several else None,
            probs0=data.mode_probs0 if several else None,
        )
        prior = Prior([mean[i] for i in index], [cov[np.ix_(i, i)] for i in index])
        return PublishedFilter(BankEstimator(bank, name), prior)

    return {"kf-cv": make("kf-cv", "cv"), "kf-ca": make("kf-ca", "ca"), "imm": make("imm", "cv", "ca")}


def mixing_study(data: ScenarioData) -> dict[str, PublishedFilter]:
    """The mixing study: straight, accelerating and turning states of unlike size, by every interaction rule.

    Starts at the first measured position and the true velocity, which every mode takes with the same spread.
    """
    modes = (
        Mode("cv", with_diagonal_noise(constant_velocity(2), (1e-4, 1e-2) * 2)),
        Mode("ca", with_diagonal_noise(constant_acceleration(2, acceleration_sd=1.0), (1e-4, 1e-3, 2e-2) * 2)),
        Mode("ct", with_diagonal_noise(polar_turn(rate_sd=0.1), (1e-4, 1e-4, 1e-2, 1e-5, 1e-4))),
    )
    vx, vy = data.velocity[0, 0]
    means = [
        np.array([0.0, vx, 0.0, vy]),
        np.array([0.0, vx, 0.0, 0.0, vy, 0.0]),
        np.array([0.0, 0.0, np.hypot(vx, vy), np.arctan2(vy, vx), 0.0]),
    ]
    spreads = [(1.0, 4.0) * 2, (1.0, 4.0, 1.0) * 2, (1.0, 1.0, 4.0, 0.05, 0.01)]
    prior = Prior(means, [np.diag(spread) for spread in spreads], includes_first=True)
    filters = {}
    for rule in MIXING_RULES:
        bank = make_bank(
            data,
            modes,
            transition=data.mode_transition,
            probs0=data.mode_probs0,
            interaction=rule,
            min_prob=1e-6,
            alpha=0.5,
        )
        filters[rule] = PublishedFilter(BankEstimator(bank, rule), prior, origin=data.measurements[:, 0])
    return filters


def path_recipes(data: ScenarioData) -> dict[str, PublishedFilter]:
    """Paths without published numbers: every recipe, told the path's largest acceleration and mean speed."""
    acceleration = np.linalg.norm(np.gradient(data.velocity[0], data.times, axis=0), axis=1)
    scales: dict[str, Any] = {
        "acceleration": float(acceleration.max()),
        "speed": float(np.linalg.norm(data.velocity[0], axis=1).mean()),
        "sojourn": 30.0,
    }
    sensor = position(data.noise.shape[0], tuple(np.sqrt(np.diag(data.noise))))
    return {name: PublishedFilter(make_estimator(name, sensor, **scales)) for name in RECIPES}


def uncertain_filter(delta: float = 0.0) -> BankEstimator:
    """N5: the Kalman filter designed for one value of the unknown number; its components are `x` and `vx`.

    Args:
        delta: the value it believes in, within the system's bound.
    Raises:
        ValueError: `delta` is out of bounds.
    """
    motion = fixed_step("uncertain", UNCERTAIN.transition_at(delta), np.asarray(UNCERTAIN.noise_gain)[:, 0])
    sensor = weighted_sum(np.asarray(UNCERTAIN.observation)[0])
    return BankEstimator(Bank((Mode("nominal", motion),), sensor), "kf")


FILTERS: dict[str, Callable[[ScenarioData], dict[str, PublishedFilter]]] = {
    "b1-slow-fast-turns-v0": path_recipes,
    "b2-atc-turns-v0": atc_turns,
    **{f"lbb-{case}-v0": path_recipes for case in ("1", "2", "3", "3b", "3c")},
    "n1-jump-linear-v0": jump_linear,
    "n4-cv-ca-v0": cv_ca,
    "mixing-study-v0": mixing_study,
}
"""Scenario id -> its filters, by the names that the published numbers use."""
