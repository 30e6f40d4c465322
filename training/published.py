"""The suite of published results: which estimators on which scenarios, scored as each source scores."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from jink.envs.literature.published_truth import PublishedValue, ScenarioData
from jink.envs.published import SCENARIOS, UNCERTAIN
from jink.estimators.api import Estimates
from jink.estimators.bounds import mismatched_errors, steady_kf
from jink.estimators.recipes import RECIPES
from jink.training.intervals import Measured, Score, measure, resample_runs
from jink.training.published_estimators import FILTERS, MIXING_RULES, run_filter
from jink.training.weighted import mean, root_mean, root_mean_peak

__all__ = ["PUBLISHED_CELLS", "Outcome", "PublishedCell", "published_values", "run_cell"]

Values = dict[str, Measured]
Scores = dict[str, Score]
_DIVERGED = 3


class Outcome(NamedTuple):
    """What one cell gives: metric to number with interval over runs, track-steps, how many of them diverged."""

    values: Values
    steps: int
    diverged: int


class PublishedCell(NamedTuple):
    """One estimator on one scenario, with the Monte-Carlo runs of the source and its score."""

    scenario: str
    estimator: str
    runs: int
    score: Callable[[ScenarioData, Estimates], Scores]


def run_cell(cell: PublishedCell, runs: int, seed: int) -> Outcome:
    """Simulate the scenario, run the estimator, score it as the source does.

    Args:
        cell: from `PUBLISHED_CELLS`.
        runs: Monte-Carlo runs.
        seed: of truth, noise and resamples; the same for every estimator.

    Returns:
        the outcome.
    """
    if cell.scenario == UNCERTAIN.id:
        return Outcome(_uncertain(), 0, 0)
    data = SCENARIOS[cell.scenario].simulate(runs, seed)
    estimates = run_filter(FILTERS[cell.scenario](data)[cell.estimator], data)
    status = np.asarray(estimates.status)
    values = measure(cell.score(data, estimates), resample_runs(runs, seed))
    return Outcome(values, int(status.size), int((status == _DIVERGED).sum()))


def published_values(cell: PublishedCell) -> Mapping[str, PublishedValue]:
    """The numbers to compare with, by metric; empty where the source has none."""
    if cell.scenario == UNCERTAIN.id:
        return UNCERTAIN.published
    found = {}
    for key, value in SCENARIOS[cell.scenario].published.items():
        name, _, metric = key.partition("/")
        if name == cell.estimator:
            found[metric or _ONLY_METRIC[cell.scenario]] = value
    return found


def _errors(data: ScenarioData, run: Estimates) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (T,), squared position and velocity errors (B, T) of the rows that were estimated."""
    first = len(data.times) - run.status.shape[1]
    place = ((run.position - data.position[:, first:]) ** 2).sum(-1)
    return data.times[first:], place, ((run.velocity - data.velocity[:, first:]) ** 2).sum(-1)


def _score_turns(data: ScenarioData, run: Estimates) -> Scores:
    times, place, velocity = _errors(data, run)
    late, leg1 = times >= 30.0, (times >= 75.0) & (times <= 125.0)
    return {
        "position_rms": Score(root_mean(place[:, late].mean(1)), "m"),
        "position_peak": Score(root_mean_peak(place[:, late]), "m"),
        "position_leg1": Score(root_mean(place[:, leg1].mean(1)), "m"),
        "velocity_rms": Score(root_mean(velocity[:, late].mean(1)), "m/s"),
    }


def _score_jump(data: ScenarioData, run: Estimates) -> Scores:
    _, place, velocity = _errors(data, run)
    return {"rmse": Score(mean(np.sqrt((place + velocity).mean(1))), "SI")}


def _score_cv_ca(data: ScenarioData, run: Estimates) -> Scores:
    return {"position_mse": Score(mean(_errors(data, run)[1].mean(1) / data.position.shape[-1]), "m^2")}


def _score_after(settling: float) -> Callable[[ScenarioData, Estimates], Scores]:
    """Root mean square and peak over samples, the first `settling` seconds left out."""

    def score(data: ScenarioData, run: Estimates) -> Scores:
        times, place, _ = _errors(data, run)
        late = times >= data.times[0] + settling
        return {
            "position_rms": Score(root_mean(place[:, late].mean(1)), "m"),
            "position_peak": Score(root_mean_peak(place[:, late]), "m"),
        }

    return score


def _uncertain() -> Values:
    """Closed form: a steady filter designed at delta = 0, judged at other deltas."""
    gain, observation = np.asarray(UNCERTAIN.noise_gain), np.asarray(UNCERTAIN.observation)
    nominal, noise = UNCERTAIN.transition_at(0.0), np.eye(1)
    steady = steady_kf(nominal, gain @ gain.T, observation, noise)
    values = {}
    for delta in (-0.3, 0.0, 0.3):
        true = UNCERTAIN.transition_at(delta)
        errors = mismatched_errors(true, gain @ gain.T, observation, noise, steady.gain, nominal)
        values[f"kf/{delta:+g}"] = Measured(
            float(errors[0][0, 0]), "variance", interval="closed form: nothing is drawn"
        )
    return values


_ONLY_METRIC = {"n1-jump-linear-v0": "rmse", "n4-cv-ca-v0": "position_mse"}
_SUITE: tuple[tuple[str, tuple[str, ...], int, Callable[[ScenarioData, Estimates], Scores]], ...] = (
    ("b2-atc-turns-v0", ("kf-1", "kf-0.1", "imm-cv-cv", "imm-cv-ct"), 200, _score_turns),
    ("n1-jump-linear-v0", ("oracle", "imm"), 50, _score_jump),
    ("n4-cv-ca-v0", ("kf-cv", "kf-ca", "imm"), 200, _score_cv_ca),
    (UNCERTAIN.id, ("kf",), 1, _score_cv_ca),
    ("mixing-study-v0", MIXING_RULES, 30, _score_after(1.0)),
    *(
        (name, tuple(RECIPES), 100, _score_after(5 * scenario.simulate(1, 0).times[1]))
        for name, scenario in SCENARIOS.items()
        if not scenario.published
    ),
)
PUBLISHED_CELLS = tuple(
    PublishedCell(scenario, estimator, runs, score)
    for scenario, estimators, runs, score in _SUITE
    for estimator in estimators
)
"""Every cell of the suite, in the order of the table."""
