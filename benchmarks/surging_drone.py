"""A drone that manoeuvres while its sensor surges: separate filters for either, and the bank that has both.

One setting of each estimator for all four scenarios: its scales are chosen on other episodes of all of them, from one
grid. Told R: the intent bank that is given the true noise of every measurement. Intervals are 95 %, paired, over
episodes.

python benchmarks/surging_drone.py --runs 200 --seed 0 --out surging_drone.json
"""

from __future__ import annotations

import numpy as np
from _paired import (
    FULL,
    GRID,
    TOLD,
    TRAINING_SEED,
    choose_scales,
    compare_squares,
    flat,
    follow_row,
    mean_squares,
    parser,
    save,
    short,
    show,
    shown,
    simulate_runs,
)

from jink.envs.scenarios import make_scenario
from jink.estimators.recipes import Scales
from jink.training.console import progress

SCENARIOS = ("joint-v0", "joint-bursts-v0", "joint-outliers-v0", "switch-v0")
NAMES = (
    "kf-cv",
    "imm",
    "intent-imm",
    "student-t-imm",
    "robust-imm",
    "sage-husa",
    "vb-noise",
    "joint-imm",
    FULL,
    TOLD,
)
FIXED = Scales(speed=15.0, turn_rate=0.5)
BASE = "joint-imm"


def main() -> None:
    """Choose scales, run, print, save."""
    options = parser(__doc__, 200)
    options.add_argument("--training", type=int, default=10, help="episodes of each scenario to choose scales on")
    given = options.parse_args()
    scenarios = [make_scenario(name) for name in SCENARIOS]
    training = [(s, simulate_runs(s, given.training, given.seed + TRAINING_SEED)) for s in scenarios]
    held_out = [(s, simulate_runs(s, given.runs, given.seed)) for s in scenarios]
    chosen = {}
    squares = {
        s.id: {"measured": np.mean((e.measurements - e.truth.position) ** 2, axis=1).sum(axis=1)} for s, e in held_out
    }
    with progress("drones", len(NAMES) * (len(GRID) + len(SCENARIOS))) as advance:
        for row in NAMES:
            advance(0, text=row)
            chosen[row] = choose_scales(row, training, FIXED, advance)
            for scenario, episodes in held_out:
                squares[scenario.id][row] = mean_squares(follow_row(row, scenario, episodes, chosen[row]), episodes)
                advance()
    against = {name: compare_squares(found, BASE, given.seed) for name, found in squares.items()}
    bound = {name: compare_squares(found, TOLD, given.seed) for name, found in squares.items()}
    rows = [
        [
            row,
            f"{chosen[row].acceleration:g}, {chosen[row].sojourn:g}",
            *(
                short(against[name][row].value.value)
                + ("" if row == BASE else f", {shown(against[name][row].difference, '+', 2)}")
                for name in SCENARIOS
            ),
        ]
        for row in NAMES
    ]
    header = ["estimator", "acceleration, sojourn", *SCENARIOS]
    show(f"RMS position, m, and more than {BASE} [95 %], {given.runs} episodes each", header, rows, given.markdown)
    middle = [
        [row, *(short(np.median(np.sqrt(squares[name][row]))) for name in SCENARIOS)] for row in squares[SCENARIOS[0]]
    ]
    show("Median over episodes of RMS position, m", ["estimator", *SCENARIOS], middle, given.markdown)
    ratios = [[row, *(shown(bound[name][row].ratio) for name in SCENARIOS)] for row in (BASE, FULL)]
    show(f"Over {TOLD} [95 %]", ["estimator", *SCENARIOS], ratios, given.markdown)
    numbers = {}
    for name in SCENARIOS:
        numbers |= flat(f"{name} against {BASE}", against[name]) | flat(f"{name} against {TOLD}", bound[name])
    scales = {row: vars(value) for row, value in chosen.items()}
    save(given.out, numbers, runs=given.runs, seed=given.seed, training=given.training, scales=scales)


if __name__ == "__main__":
    main()
