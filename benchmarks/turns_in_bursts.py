"""Turns of 3 to 6 g and bursts of 100 x noise that overlap: who tells a manoeuvre from a surge?

A fighter at 150 m/s, straight for some seconds, then a hard turn; position every 0.2 s with sigma 10 m, bursts of one
to four seconds. Scales of every estimator are chosen on training episodes by the same grid; the table is of others.

python benchmarks/turns_in_bursts.py --runs 100
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np
from rich.console import Console
from rich.table import Table

from jink.envs.episodes import Episodes
from jink.envs.flight.dwells import Dwell
from jink.envs.flight.limits import Limits, Start
from jink.envs.intents import Straight, Turn
from jink.envs.manoeuvres import Manoeuvres
from jink.envs.sampling import Regular
from jink.envs.scenario import Scenario
from jink.envs.sensing import Sensing
from jink.envs.simulate import simulate
from jink.envs.streams import make_streams
from jink.envs.surges import MarkovBursts
from jink.estimators.inputs import Prior
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position

SIGMA, SPEED, GRAVITY = 10.0, 150.0, 9.80665
NAMES = ("kf-cv", "imm", "student-t-imm", "robust-imm", "sage-husa", "intent-imm", "joint-imm", "told R")
GRID = tuple(itertools.product((0.3, 1.0, 3.0, 10.0, 30.0, 60.0), (1.0, 3.0, 8.0)))
SCENARIO = Scenario(
    "turns-in-bursts-v0",
    "Fighter: straight and turns of 3 to 6 g, bursts of 100 x",
    "joint",
    Manoeuvres(
        behaviours=(
            Straight(dwell=Dwell(6.0, 2.0)),
            Turn(dwell=Dwell(5.0, 2.0), rate=(3.0 * GRAVITY / SPEED, 6.0 * GRAVITY / SPEED)),
        ),
        limits=Limits(speed=(SPEED, SPEED), lateral=6.01),
        start=Start(speed=(SPEED, SPEED)),
    ),
    Sensing(position(2, SIGMA)),
    Regular(300, 0.2),
    (MarkovBursts(on=(1.0, 4.0), off=(2.0, 6.0), scale=100.0),),
    start_sigma=(SIGMA, 10.0),
    filter_noise=1000.0,
)


def episodes(runs: int, seed: int) -> Episodes:
    """Simulated episodes."""
    return simulate(SCENARIO, [make_streams(np.random.default_rng((seed, run))) for run in range(runs)])


def errors(name: str, given: Episodes, acceleration: float, sojourn: float) -> np.ndarray:
    """Position errors (runs, samples), m."""
    recipe = "intent-imm" if name == "told R" else name
    estimator = make_estimator(
        recipe, SCENARIO.sensor, acceleration=acceleration, speed=SPEED, turn_rate=0.3, sojourn=sojourn
    )
    noise = given.noise if name == "told R" else None
    prior = Prior(mean=given.prior_mean, cov=given.prior_cov)
    found = estimator.run(given.measurements, given.times, noise, prior=prior)
    return np.linalg.norm(found.position - given.truth.position, axis=2)


def interval(differences: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """95 % bootstrap interval of a mean of paired differences."""
    rng = np.random.default_rng(seed)
    means = rng.choice(differences, size=(4000, len(differences))).mean(axis=1)
    return float(np.quantile(means, 0.025)), float(np.quantile(means, 0.975))


def main() -> None:
    """Tune, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--training", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    training, held_out = episodes(options.training, options.seed + 1000), episodes(options.runs, options.seed)
    found, chosen = {}, {}
    for name in NAMES:
        chosen[name] = min(GRID, key=lambda scales, name=name: np.mean(errors(name, training, *scales) ** 2))  # type: ignore[misc]
        found[name] = errors(name, held_out, *chosen[name])
    rms = {name: np.sqrt(np.mean(error**2, axis=1)) for name, error in found.items()}
    away = {name: 0.2 * np.sum(error > 3.0 * SIGMA, axis=1) for name, error in found.items()}
    table = Table(
        title=f"{options.runs} episodes of 60 s; 3 sigma = {3 * SIGMA:g} m; intervals are paired, against joint-imm"
    )
    for column in (
        "estimator",
        "acceleration, sojourn",
        "RMS m",
        "more than joint-imm [95 %]",
        "s beyond 3 sigma",
        "more [95 %]",
    ):
        table.add_column(column, justify="left" if column == "estimator" else "right")
    for name in NAMES:
        low, high = interval(rms[name] - rms["joint-imm"])
        early, late = interval(away[name] - away["joint-imm"])
        table.add_row(
            name,
            "{:g}, {:g}".format(*chosen[name]),
            f"{rms[name].mean():.2f}",
            f"{(rms[name] - rms['joint-imm']).mean():.2f} [{low:.2f}, {high:.2f}]",
            f"{away[name].mean():.2f}",
            f"{(away[name] - away['joint-imm']).mean():.2f} [{early:.2f}, {late:.2f}]",
        )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
