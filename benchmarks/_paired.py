"""What the scripts on noise surges share: episodes, scales chosen on other episodes, paired intervals, tables."""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _timing import machine
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from jink.envs.episodes import Episodes
from jink.envs.scenario import Scenario
from jink.envs.simulate import simulate
from jink.envs.streams import make_streams
from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.inputs import Prior
from jink.estimators.joint import joint_bank
from jink.estimators.recipes import Scales, intent_imm, make_estimator
from jink.estimators.sensor import Sensor
from jink.training.intervals import Measured, Score, Statistic, measure, resample_runs
from jink.training.weighted import root_mean

Floats = NDArray[np.float64]

FULL, TOLD = "full product", "intent-imm told R"
GRID = tuple(itertools.product((0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0), (1.0, 3.0, 10.0, 30.0, 100.0)))
"""Accelerations, m/s^2, and sojourns, s, that every recipe chooses from."""
TRAINING_SEED = 1000
"""Added to the seed of the episodes on which scales are chosen."""


class Gap(NamedTuple):
    """A number with its interval, its paired difference to a base, and its paired ratio to it."""

    value: Measured
    difference: Measured
    ratio: Measured


def make_row(name: str, sensor: Sensor, scales: Scales) -> BankEstimator:
    """A recipe by name, the joint bank without shared levels (`FULL`), or the bank that is told R (`TOLD`)."""
    if name == FULL:
        return BankEstimator(joint_bank(intent_imm(sensor, scales), shared=False), name=name)
    return make_estimator("intent-imm" if name == TOLD else name, sensor, **vars(scales))


def simulate_runs(scenario: Scenario, runs: int, seed: int) -> Episodes:
    """Episodes; the one of a run depends on seed and run alone."""
    return simulate(scenario, [make_streams(np.random.default_rng((seed, run))) for run in range(runs)])


def follow(estimator: BankEstimator, episodes: Episodes, noise: Floats | None = None) -> Estimates:
    """Estimates of all episodes, told R or not, from the prior of the scenario."""
    prior = Prior(mean=episodes.prior_mean, cov=episodes.prior_cov)
    return estimator.run(episodes.measurements, episodes.times, noise, episodes.sensor_states, prior=prior)


def mean_squares(found: Estimates, episodes: Episodes) -> Floats:
    """Squared position error averaged over time, of each episode; (runs,); m^2."""
    return np.mean(np.sum((found.position - episodes.truth.position) ** 2, axis=2), axis=1)


def follow_row(name: str, scenario: Scenario, episodes: Episodes, scales: Scales) -> Estimates:
    """Estimates of a row of `make_row`."""
    noise = episodes.noise if name == TOLD else None
    return follow(make_row(name, scenario.sensor, scales), episodes, noise)


def choose_scales(
    name: str,
    training: Sequence[tuple[Scenario, Episodes]],
    fixed: Scales,
    advance: Callable[..., None],
) -> Scales:
    """The point of `GRID` with the smallest product of RMS position errors over the training scenarios."""

    def cost(scales: Scales) -> float:
        squares = (mean_squares(follow_row(name, *pair, scales), pair[1]).mean() for pair in training)
        total = sum(math.log(square) for square in squares)
        advance()
        return total

    points = [Scales(acceleration, fixed.speed, fixed.turn_rate, sojourn) for acceleration, sojourn in GRID]
    return min(points, key=cost)


def minus(statistic: Statistic, base: Statistic) -> Statistic:
    """Difference of two statistics of the same runs: a paired one, as each resample holds the same runs for both."""
    return lambda weights: statistic(weights) - base(weights)


def over(statistic: Statistic, base: Statistic) -> Statistic:
    """Ratio of two statistics of the same runs."""
    return lambda weights: statistic(weights) / base(weights)


def compare(
    statistics: Mapping[str, Statistic], base: str, runs: int, seed: int = 0, unit: str = "m"
) -> dict[str, Gap]:
    """Every statistic with its interval, and the paired ones against the base."""
    scores: dict[str, Score] = {}
    for name, statistic in statistics.items():
        scores[f"{name}/value"] = Score(statistic, unit)
        scores[f"{name}/difference"] = Score(minus(statistic, statistics[base]), unit)
        scores[f"{name}/ratio"] = Score(over(statistic, statistics[base]), "")
    found = measure(scores, resample_runs(runs, seed))
    return {name: Gap(*(found[f"{name}/{kind}"] for kind in Gap._fields)) for name in statistics}


def compare_squares(squares: Mapping[str, Floats], base: str, seed: int = 0) -> dict[str, Gap]:
    """Root mean squares over runs, m, from (runs,) squares, m^2."""
    return compare({name: root_mean(values) for name, values in squares.items()}, base, len(squares[base]), seed)


def short(value: float, sign: str = "", digits: int = 3) -> str:
    """Three significant digits, no exponent below a million."""
    if not math.isfinite(value):
        return "-"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{value:{sign}.{min(decimals, 4)}f}"


def shown(number: Measured, sign: str = "", digits: int = 3) -> str:
    """Value [low, high], all with the decimals of the value's or the interval's leading digits."""
    if math.isnan(number.low):
        return short(number.value, sign, digits)
    scale = max(abs(number.value), (number.high - number.low) / 2)
    decimals = min(4, max(0, digits - 1 - math.floor(math.log10(scale)))) if scale else 0
    value, low, high = (f"{v:{sign}.{decimals}f}" for v in number[:1] + number[2:4])
    return f"{value} [{low}, {high}]"


def parser(doc: str | None, runs: int | None, seed: int = 0) -> argparse.ArgumentParser:
    """The options that all of these scripts have."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if runs is not None:
        made.add_argument("--runs", type=int, default=runs, help=f"episodes or rounds (default {runs})")
    made.add_argument("--seed", type=int, default=seed, help=f"of the episodes and of the intervals (default {seed})")
    made.add_argument("--out", type=Path, help="rows with intervals, command and versions, as JSON")
    made.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    return made


def show(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], markdown: bool) -> None:
    """Print a table."""
    if markdown:
        lines = [header, ["---"] * len(header), *rows]
        print(f"\n{title}\n", *("| " + " | ".join(line) + " |" for line in lines), sep="\n", flush=True)
        return
    table = Table(title=title)
    for number, column in enumerate(header):
        table.add_column(column, justify="right" if number else "left")
    for row in rows:
        table.add_row(*row)
    Console(width=200).print(table)


def save(path: Path | None, numbers: Mapping[str, Measured], **more: object) -> None:
    """Write numbers with their intervals, the command and the versions."""
    if path is None:
        return
    given = [Path(a).name if Path(a).is_absolute() else a for a in sys.argv[1:]]
    command = " ".join(["python", f"benchmarks/{Path(sys.argv[0]).name}", *given])
    rows = {name: number._asdict() for name, number in numbers.items()}
    path.write_text(json.dumps({"command": command, **more, "machine": machine(), "rows": rows}, indent=1) + "\n")


def flat(prefix: str, gaps: Mapping[str, Gap]) -> dict[str, Measured]:
    """Numbers for `save`."""
    return {f"{prefix}/{name}/{kind}": number for name, gap in gaps.items() for kind, number in gap._asdict().items()}
