"""From rows to what is compared: runs pooled over blocks, paired by their seeds, each number with its interval."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.training.intervals import Measured, Resampling, Score, Statistic, measure, resample_runs
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
    difference, ratio: of `value` to that of the base over the runs of which both have a value; None without any.
    runs: how many were pooled.
    pairs: over how many of them the difference is; 0 without one.
    """

    suite: str
    scenario: str
    estimator: str
    value: Measured
    iqm: Measured
    difference: Measured | None
    ratio: Measured | None
    runs: int
    pairs: int = 0


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


def compare(rows: pd.DataFrame, metric: str = "position_rmse", base: str = BASE) -> list[Comparison]:
    """Every estimator of every scenario against the base, from rows alone.

    A run without a value (NaN) on either side is left out on both; a lost one (infinite) counts. Resamples have the
    seed of the first run that they draw from, as those of the rows: a number has one interval wherever it is shown.

    Args:
        rows: of `jink bench`; any suites.
        metric: one of `METRICS`.
        base: estimator that the differences and ratios are to.

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
        numbers = measure(scores, _resamples(runs.seeds))
        paired: dict[str, Measured] = {}
        both = np.zeros(0, dtype=np.int64) if other is None else _shared(runs, other)
        if other is not None and len(both) and estimator != base:
            mine, theirs = _at(metric, runs, both), _at(metric, other, both)
            scores = {
                "difference": Score(_minus(mine, theirs), METRICS[metric].unit),
                "ratio": Score(_over(mine, theirs), ""),
            }
            paired = measure(scores, _resamples(both))
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
                len(both) if paired else 0,
            )
        )
    return found


def _resamples(seeds: NDArray[np.int64]) -> Resampling:
    return resample_runs(len(seeds), int(seeds[0]) if len(seeds) else 0)


def _shared(one: Runs, other: Runs) -> NDArray[np.int64]:
    """Seeds of which both have a value."""
    return np.intersect1d(one.seeds[~np.isnan(one.values)], other.seeds[~np.isnan(other.values)])


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


def compare_suites(rows: pd.DataFrame, metric: str = "position_rmse", base: str = BASE) -> list[Overall]:
    """Every estimator of every suite against the base; arguments as `compare`, intervals as there."""
    pooled = pool_runs(rows, metric)
    members: dict[tuple[str, str], dict[str, Runs]] = {}
    for (suite, scenario, estimator), runs in pooled.items():
        members.setdefault((suite, estimator), {})[scenario] = runs
    found = []
    for (suite, estimator), mine in members.items():
        theirs = members.get((suite, base), {})
        pairs = {name: _shared(mine[name], theirs[name]) for name in theirs if name in mine}
        shared = [name for name, both in pairs.items() if len(both)]
        common = None
        for name in shared:
            common = pairs[name] if common is None else np.intersect1d(common, pairs[name])
        if common is None or not len(common):
            continue
        ratios = [_over(_at(metric, mine[name], common), _at(metric, theirs[name], common)) for name in shared]
        number = measure({"ratio": Score(_geometric(ratios), "")}, _resamples(common))["ratio"]
        missing = tuple(name for name in theirs if name not in shared)
        found.append(Overall(suite, estimator, number, len(shared), missing))
    return found


def _geometric(ratios: list[Statistic]) -> Statistic:
    return lambda weights: np.exp(np.mean([np.log(ratio(weights)) for ratio in ratios], axis=0))
