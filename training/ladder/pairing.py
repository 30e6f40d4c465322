"""From rows to what is compared: runs pooled over blocks, paired by their seeds, each number with its interval."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.training.intervals import Measured, Score, Statistic, measure, resample_runs
from jink.training.ladder.scores import METRICS
from jink.training.weighted import interquartile_mean, mean, root_mean

__all__ = ["BASE", "Comparison", "Overall", "Runs", "compare", "compare_suites", "in_order", "pool_runs"]

Floats = NDArray[np.float64]
Key = tuple[str, str, str]
BASE = "imm"
"""What every estimator is compared with."""


class Runs(NamedTuple):
    """Values of the runs of one estimator on one scenario, in the order of their seeds; NaN where a run has none."""

    seeds: NDArray[np.int64]
    values: Floats


class Comparison(NamedTuple):
    """One estimator on one scenario.

    value: root mean square or mean over runs, as `METRICS` says.
    iqm: mean of the middle half of the runs.
    difference, ratio: of `value` to that of the base over the runs that both have; None without such a base.
    runs: how many were pooled.
    """

    suite: str
    scenario: str
    estimator: str
    value: Measured
    iqm: Measured
    difference: Measured | None
    ratio: Measured | None
    runs: int


def in_order(found: Iterable[Any], ladder: Sequence[str]) -> list[Any]:
    """Comparisons with their estimators in the order of the ladder, others behind; scenarios stay as they come."""
    places = {name: place for place, name in enumerate(ladder)}
    return sorted(found, key=lambda each: places.get(each.estimator, len(places)))


def pool_runs(rows: pd.DataFrame, metric: str) -> dict[Key, Runs]:
    """Runs by suite, scenario and estimator; of a block computed twice the later one.

    Args:
        rows: of `jink bench`.
        metric: one of `METRICS`.
    """
    found: dict[Key, Runs] = {}
    mine = rows[(rows["kind"] == "number") & (rows["metric"] == metric) & (rows["statistic"] != "")]
    mine = mine.sort_values("started", kind="stable")
    for key, blocks in mine.groupby(["suite", "scenario", "estimator"], sort=False):
        by_seed: dict[int, float] = {}
        for seed, samples in zip(blocks["seed"], blocks["samples"], strict=True):
            if samples is not None:
                by_seed.update(zip(range(int(seed), int(seed) + len(samples)), map(float, samples), strict=True))
        seeds = np.array(sorted(by_seed), dtype=np.int64)
        found[key] = Runs(seeds, np.array([by_seed[seed] for seed in seeds.tolist()]))  # type: ignore[index]
    return found


def compare(rows: pd.DataFrame, metric: str = "position_rmse", base: str = BASE, seed: int = 0) -> list[Comparison]:
    """Every estimator of every scenario against the base, from rows alone.

    Args:
        rows: of `jink bench`; any suites.
        metric: one of `METRICS`.
        base: estimator that the differences and ratios are to.
        seed: of the resamples.

    Returns:
        in the order of the rows; intervals are 95 % percentile bootstraps over runs, paired by seed.
    """
    pooled = pool_runs(rows, metric)
    found = []
    for (suite, scenario, estimator), runs in pooled.items():
        other = pooled.get((suite, scenario, base))
        scores = {
            "value": Score(_statistic(metric, runs.values), METRICS[metric].unit),
            "iqm": Score(interquartile_mean(runs.values), METRICS[metric].unit),
        }
        numbers = measure(scores, resample_runs(len(runs.seeds), seed))
        paired: dict[str, Measured] = {}
        both = np.zeros(0, dtype=np.int64) if other is None else np.intersect1d(runs.seeds, other.seeds)
        if other is not None and len(both) and estimator != base:
            mine, theirs = _at(metric, runs, both), _at(metric, other, both)
            scores = {
                "difference": Score(_minus(mine, theirs), METRICS[metric].unit),
                "ratio": Score(_over(mine, theirs), ""),
            }
            paired = measure(scores, resample_runs(len(both), seed))
        found.append(
            Comparison(
                suite,
                scenario,
                estimator,
                numbers["value"],
                numbers["iqm"],
                paired.get("difference"),
                paired.get("ratio"),
                len(runs.seeds),
            )
        )
    return found


def _statistic(metric: str, values: Floats) -> Statistic:
    return root_mean(values**2) if METRICS[metric].statistic == "rms" else mean(values)


def _at(metric: str, runs: Runs, seeds: NDArray[np.int64]) -> Statistic:
    """The statistic of the runs of these seeds."""
    return _statistic(metric, runs.values[np.searchsorted(runs.seeds, seeds)])


def _minus(one: Statistic, other: Statistic) -> Statistic:
    return lambda weights: one(weights) - other(weights)


def _over(one: Statistic, other: Statistic) -> Statistic:
    return lambda weights: one(weights) / other(weights)


class Overall(NamedTuple):
    """One estimator on a whole suite: geometric mean over its scenarios of the ratio to the base, and where it failed.

    scenarios: how many are in the ratio; missing: those that the base has and the estimator has not.
    """

    suite: str
    estimator: str
    ratio: Measured
    scenarios: int
    missing: tuple[str, ...]


def compare_suites(rows: pd.DataFrame, metric: str = "position_rmse", base: str = BASE, seed: int = 0) -> list[Overall]:
    """Every estimator of every suite against the base; arguments as `compare`, intervals as there."""
    pooled = pool_runs(rows, metric)
    members: dict[tuple[str, str], dict[str, Runs]] = {}
    for (suite, scenario, estimator), runs in pooled.items():
        members.setdefault((suite, estimator), {})[scenario] = runs
    found = []
    for (suite, estimator), mine in members.items():
        theirs = members.get((suite, base), {})
        shared = [name for name in theirs if name in mine]
        common = None
        for name in shared:
            both = np.intersect1d(mine[name].seeds, theirs[name].seeds)
            common = both if common is None else np.intersect1d(common, both)
        if common is None or not len(common):
            continue
        ratios = [_over(_at(metric, mine[name], common), _at(metric, theirs[name], common)) for name in shared]
        number = measure({"ratio": Score(_geometric(ratios), "")}, resample_runs(len(common), seed))["ratio"]
        missing = tuple(name for name in theirs if name not in mine)
        found.append(Overall(suite, estimator, number, len(shared), missing))
    return found


def _geometric(ratios: list[Statistic]) -> Statistic:
    return lambda weights: np.exp(np.mean([np.log(ratio(weights)) for ratio in ratios], axis=0))
