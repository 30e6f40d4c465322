"""One cell of the ladder: an estimator on a block of runs of a scenario, as rows. A pure function of the cell."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from jink.envs.episodes import Episodes
from jink.envs.scenario import Scenario
from jink.envs.scenarios import make_scenario
from jink.estimators.api import Estimates
from jink.estimators.status import DIVERGED
from jink.training.intervals import Score, measure, resample_runs
from jink.training.ladder.bound import bound_values
from jink.training.ladder.causality import foresight
from jink.training.ladder.curves import Curves, add_curves, start_curves, take_curves
from jink.training.ladder.rungs import Follower, NoSuchRung, make_follower
from jink.training.ladder.scores import HORIZON_S, METRICS, Readings, score_runs
from jink.training.ladder.settings import settings_of
from jink.training.ladder.typical import simulate_runs
from jink.training.rows import Cell, make_rows, now
from jink.training.weighted import mean, root_mean

__all__ = ["BLOCK", "TRUTH", "LadderCell", "run_ladder_cell", "statistic_of"]

Floats = NDArray[np.float64]
TRUTH = "truth"
"""Name of the cell that holds what was played and measured, beside the estimators."""
BLOCK = 500
"""Most runs of one cell; more runs are more cells, each a block of seeds."""
_PORTION = 20  # runs at a time: what a forecast keeps of a joint bank is some 4 MB a run


class LadderCell(NamedTuple):
    """What a worker is sent."""

    suite: str
    scenario: str
    estimator: str
    runs: int
    seed: int
    spec: str = ""
    """Where a third party's estimator lies, ``path/to/mine.py:make``; empty: one of ours."""


def statistic_of(name: str, samples: ArrayLike) -> Score:
    """How the runs of a metric become its number."""
    metric = METRICS[name]
    values = np.asarray(samples, dtype=np.float64)
    return Score(root_mean(values**2) if metric.statistic == "rms" else mean(values), metric.unit)


def run_ladder_cell(job: LadderCell, cell: Cell) -> pd.DataFrame:
    """Simulate, follow, score.

    Args:
        job: what to compute.
        cell: the same for its rows, with the commit of whoever asked.

    Returns:
        rows of the kinds number, curve and (of the first run) track.
    """
    started, began = now(), time.perf_counter()
    scenario = make_scenario(job.scenario)
    told: dict[str, Any] = {"scenario": scenario.parameters, "horizon_s": HORIZON_S}

    def rows(more: Sequence[Mapping[str, Any]], status: str = "ok", reason: str = "") -> pd.DataFrame:
        return make_rows(
            cell,
            {},
            status=status,
            reason=reason,
            parameters=told,
            steps=job.runs * scenario.steps,
            seconds=time.perf_counter() - began,
            started=started,
            more=more,
        )

    try:
        if job.estimator == TRUTH:
            return rows(_truth_rows(scenario, job.seed))
        if job.estimator == "bound":
            return rows(_number_rows(bound_values(scenario, simulate_runs(scenario, job.runs, job.seed)), job))
        name = job.spec or job.estimator
        follower = make_follower(name, scenario, settings_of(job.suite, job.estimator))
    except NoSuchRung as skipped:
        return rows((), "skipped", str(skipped))
    told["estimator"] = follower.parameters
    first = simulate_runs(scenario, 1, job.seed)
    seen = follower.estimate(first)  # compiles
    if job.spec and (text := foresight(follower, first, seen)):
        return rows((), "error", text)
    step = float(getattr(scenario.sampling, "dt", 1.0))
    curves = start_curves(step, scenario.steps)
    parts: list[dict[str, Floats]] = []
    tracks: list[dict[str, Any]] = []
    paces: list[float] = []
    diverged = 0
    for episodes in _portions(scenario, job):
        if not paces:  # a single portion would be timed cold
            _timed(follower, episodes, paces)
        found = _timed(follower, episodes, paces)
        said = follower.read(episodes, found)
        parts.append(score_runs(episodes, found, said))
        add_curves(curves, episodes, found, said)
        diverged += int((np.asarray(found.status) == DIVERGED).sum())
        if not tracks:
            tracks = _track_rows(scenario, episodes, found, said)
    numbers = _number_rows({name: np.concatenate([part[name] for part in parts]) for name in METRICS}, job)
    numbers.append(
        {"metric": "microseconds_per_step", "value": 1e6 * min(paces), "unit": "us", "statistic": "once",
         "interval": f"best of {len(paces)}, one thread"}
    )  # fmt: skip
    share = diverged / (job.runs * scenario.steps)
    status, reason = ("diverged", f"{100 * share:.0f} % of steps diverged") if share > 0.5 else ("ok", "")
    return rows([*numbers, *_curve_rows(curves, scenario.axes), *tracks], status, reason)


def _timed(follower: Follower, episodes: Episodes, paces: list[float]) -> Estimates:
    """Estimates; their processor time a step, s, is added to the paces."""
    clock = time.process_time()
    found = follower.estimate(episodes)
    paces.append((time.process_time() - clock) / episodes.times.size)
    return found


def _portions(scenario: Scenario, job: LadderCell) -> Iterator[Episodes]:
    for first in range(0, job.runs, _PORTION):
        yield simulate_runs(scenario, min(_PORTION, job.runs - first), job.seed + first)


def _number_rows(per_run: Mapping[str, Floats], job: LadderCell) -> list[dict[str, Any]]:
    """Numbers with intervals, from runs in single precision, which is what the rows keep."""
    kept = {name: values.astype(np.float32) for name, values in per_run.items() if not np.isnan(values).all()}
    scores = {name: statistic_of(name, values) for name, values in kept.items()}
    found = measure(scores, resample_runs(job.runs, job.seed))
    return [
        {"metric": name, "samples": kept[name], "statistic": METRICS[name].statistic, **number._asdict()}
        for name, number in found.items()
    ]


def _curve_rows(curves: Curves, axes: int) -> list[dict[str, Any]]:
    return [
        {"kind": "curve", "metric": name, "unit": curve.unit, "at": curve.at.astype(np.float32),
         "samples": curve.values.astype(np.float32), "low": curve.low, "high": curve.high}
        for name, curve in take_curves(curves, axes).items()
    ]  # fmt: skip


def _series(times: Floats, columns: Mapping[str, tuple[str, Any]]) -> list[dict[str, Any]]:
    return [
        {"kind": "track", "metric": name, "unit": unit, "at": times.astype(np.float32),
         "samples": np.asarray(values).astype(np.float32)}
        for name, (unit, values) in columns.items()
    ]  # fmt: skip


def _truth_rows(scenario: Scenario, seed: int) -> list[dict[str, Any]]:
    """What was played in the first run: path, measurements, intent, noise."""
    episodes = simulate_runs(scenario, 1, seed)
    truth = episodes.truth
    columns: dict[str, tuple[str, Any]] = {}
    for axis, letter in enumerate("xyz"[: scenario.axes]):
        columns[f"true_{letter}"] = ("m", truth.position[0, :, axis])
        columns[f"true_v{letter}"] = ("m/s", truth.velocity[0, :, axis])
    for component, label in enumerate(scenario.sensor.labels):
        columns[f"measured_{label}"] = (scenario.sensor.units[component], episodes.measurements[0, :, component])
    columns["noise_scale"] = ("", episodes.scale[0])
    for index, name in enumerate(scenario.intents):
        columns[f"intent:{name}"] = ("", truth.intent[0] == index)
    rows = _series(episodes.times[0], columns)
    switches = truth.switch_times[0][np.isfinite(truth.switch_times[0])]
    rows.append({"kind": "track", "metric": "switches", "unit": "s", "at": switches.astype(np.float32),
                 "samples": np.ones(len(switches), dtype=np.float32)})  # fmt: skip
    return rows


def _track_rows(scenario: Scenario, episodes: Episodes, found: Estimates, said: Readings) -> list[dict[str, Any]]:
    """The first run as the estimator saw it."""
    columns: dict[str, tuple[str, Any]] = {}
    letters = "xyz"[: scenario.axes]
    for axis, letter in enumerate(letters):
        columns[letter] = ("m", found.position[0, :, axis])
        columns[f"v{letter}"] = ("m/s", found.velocity[0, :, axis])
    if np.isfinite(found.covariance[0]).all():
        for i, one in enumerate(letters):
            for j, other in enumerate(letters[i:], start=i):
                columns[f"cov_{one}_{other}"] = ("m^2", found.covariance[0, :, i, j])
    if np.asarray(found.nis_dof)[0].any():
        columns["nis"] = ("", np.where(found.nis_dof[0] > 0, found.nis[0] / np.maximum(found.nis_dof[0], 1), np.nan))
    if said.intents is not None:
        for index, name in enumerate(scenario.intents):
            if np.isfinite(said.intents[0, :, index]).any():
                columns[f"intent:{name}"] = ("", said.intents[0, :, index])
    if said.surge is not None:
        columns["surge_probability"] = ("", said.surge[0])
    return _series(episodes.times[0], columns)
