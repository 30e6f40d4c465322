"""Choose the settings of every estimator of `jink bench`, all by the same objective, search and budget.

    python benchmarks/tune_bench.py --out training/ladder/settings.json
    python benchmarks/tune_bench.py --starts 6 --estimator imm --out training/ladder/settings.json

Objective: the sum over the scenarios of a suite of the log of the mean squared position error, on training episodes
(seeds 50 000 and up; tables use 100 000 and up). Search: one parameter after the other, a factor of four up and down,
then smaller ones, from the recipe's own choice, until the budget is spent; with ``--starts`` also from points drawn
around it, each with a budget of its own, and the best of all is kept. One setting for a whole suite: factors on the
scales that each scenario's targets have.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from jink.envs.scenarios import SUITES, make_scenario
from jink.training.bench import SIMULATED
from jink.training.ladder.rungs import LADDER, NoSuchRung, make_follower
from jink.training.ladder.settings import Settings
from jink.training.ladder.typical import TRAINING_SEED, simulate_runs

SEARCHED: dict[str, tuple[str, ...]] = {
    "kf-cv": ("acceleration", "noise"),
    "kf-ca": ("acceleration", "noise", "sojourn"),
    "singer": ("acceleration", "noise", "sojourn"),
    "ukf-ct": ("acceleration", "noise", "sojourn"),
    "mr": ("acceleration", "noise", "tail"),
    "huber": ("acceleration", "noise", "tail"),
    "rma": ("acceleration", "noise", "tail"),
    "mahalanobis": ("acceleration", "noise", "tail"),
    "imm": ("acceleration", "noise", "sojourn"),
    "student-t-imm": ("acceleration", "noise", "sojourn", "dof"),
    "robust-imm": ("acceleration", "noise", "tail"),
    "sage-husa": ("acceleration", "noise", "forgetting"),
    "vb-noise": ("acceleration", "noise", "forgetting"),
    "intent-imm": ("acceleration", "noise", "sojourn"),
    "intent-imm@learned": ("acceleration", "noise", "sojourn"),
    "joint-imm": ("acceleration", "noise", "sojourn", "surge_every", "surge_for"),
    "agent": ("acceleration", "noise"),
    "oracle": ("acceleration", "sojourn"),
}
FIRST_STEP, LAST_STEP, REACH = 2.0, 0.125, 12.0
SPREAD = 6.0
"""Further starts are drawn within this many powers of two of the recipe's own choice."""


def settings_at(point: dict[str, float]) -> Settings:
    """From powers of two to settings: dof from 2 up, forgetting by its memory, everything else a factor."""
    values = {name: 2.0**power for name, power in point.items()}
    if "dof" in values:
        values["dof"] = 2.0 + 3.0 * values["dof"]
    if "forgetting" in values:
        values["forgetting"] = 1.0 - 0.1 / values["forgetting"]
    return Settings(**{name: float(f"{value:.4g}") for name, value in values.items()})


def search(
    cost: Callable[[dict[str, float]], float], start: dict[str, float], budget: int
) -> tuple[dict[str, float], float, int]:
    """Best point found from a start, its cost, evaluations."""
    known: dict[tuple[float, ...], float] = {}

    def at(point: dict[str, float]) -> float:
        key = tuple(point.values())
        if key not in known:
            known[key] = cost(point)
        return known[key]

    best = start
    least, step = at(best), FIRST_STEP
    while step >= LAST_STEP:
        better = False
        for name in start:
            for direction in (step, -step):
                moved = best | {name: best[name] + direction}
                while abs(moved[name]) <= REACH and len(known) < budget and at(moved) < least:
                    best, least, better = moved, at(moved), True
                    moved = best | {name: best[name] + direction}
        if len(known) >= budget:
            break
        if not better:
            step /= 2.0
    return best, least, len(known)


def starts_of(names: tuple[str, ...], count: int) -> list[dict[str, float]]:
    """The recipe's own choice, and points around it on whole powers of two."""
    draws = np.random.default_rng(TRAINING_SEED).integers(-SPREAD, SPREAD, (count - 1, len(names)), endpoint=True)
    points = [np.zeros(len(names)), *draws.astype(np.float64)]
    return [dict(zip(names, map(float, point), strict=True)) for point in points]


def tune(suite: str, name: str, runs: int, budget: int, starts: int) -> dict[str, object] | None:
    """Settings of one estimator for one suite; None where the suite has no such rung."""
    scenarios = []
    for known in map(make_scenario, SUITES[suite]):
        try:
            make_follower(name, known, Settings())
        except NoSuchRung:
            continue
        scenarios.append((known, simulate_runs(known, runs, TRAINING_SEED)))
    if not scenarios:
        return None

    def cost(point: dict[str, float]) -> float:
        total = 0.0
        for scenario, episodes in scenarios:
            try:
                found = make_follower(name, scenario, settings_at(point)).estimate(episodes)
            except ValueError:
                return math.inf  # no such threshold, for instance
            square = float(np.mean(np.sum((found.position - episodes.truth.position) ** 2, axis=2)))
            total += math.log(square) if math.isfinite(square) else math.inf
        return total

    untuned = cost(dict.fromkeys(SEARCHED[name], 0.0))
    usual = Settings()._asdict()
    results = []
    for start in starts_of(SEARCHED[name], starts):
        point, least, count = search(cost, start, budget)
        results.append((least, point))
        gain = math.exp((least - untuned) / (2 * len(scenarios))) if math.isfinite(untuned) else math.nan
        found = {key: value for key, value in settings_at(point)._asdict().items() if value != usual[key]}
        print(f"{suite} {name}: {gain:.3f} of the untuned error after {count} evaluations, {found}", flush=True)
    chosen = settings_at(min(results, key=lambda result: result[0])[1])._asdict()
    return {key: value for key, value in chosen.items() if value != usual[key]}


def main() -> None:
    """Search, and write after each estimator."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=24, help="training episodes of each scenario")
    parser.add_argument("--budget", type=int, default=48, help="evaluations of each estimator from each start")
    parser.add_argument(
        "--starts", type=int, default=1, help="points to search from: the recipe's own, then drawn ones"
    )
    parser.add_argument("--suite", action="append", choices=SIMULATED, help="only this one; may be repeated")
    parser.add_argument("--estimator", action="append", choices=sorted(SEARCHED), help="only this; may be repeated")
    parser.add_argument("--out", type=Path, required=True, help="JSON file; what it holds of others stays")
    given = parser.parse_args()
    table = json.loads(given.out.read_text(encoding="utf-8")) if given.out.exists() else {}
    found: dict[str, dict[str, object]] = table.get("settings", {})
    for suite in given.suite or SIMULATED:
        for name in [one for one in LADDER if one in SEARCHED and one in (given.estimator or SEARCHED)]:
            settings = tune(suite, name, given.runs, given.budget, given.starts)
            if settings is None:
                continue
            found.setdefault(suite, {})[name] = settings
            command = f"python benchmarks/tune_bench.py --runs {given.runs} --budget {given.budget} --out settings.json"
            text = json.dumps({"command": command, "seed": TRAINING_SEED, "settings": found}, indent=1)
            given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
