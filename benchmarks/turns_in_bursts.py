"""Turns of 3 to 6 g and bursts of 100 x noise that overlap: who tells a manoeuvre from a surge?

A fighter at 150 m/s, straight for some seconds, then a hard turn; position every 0.2 s with sigma 10 m, bursts of one
to four seconds. Scales of every estimator are chosen on training episodes from one grid; the table is of others.

Time to recover: after a burst in which the target turned, until the error is within 3 sigma and stays there for a
second or until the next burst; at most until the next burst. Intervals are 95 %, paired, over episodes.

python benchmarks/turns_in_bursts.py --runs 200 --seed 1 --out turns_in_bursts.json
"""

from __future__ import annotations

import numpy as np
from _paired import (
    FULL,
    GRID,
    TOLD,
    TRAINING_SEED,
    Floats,
    choose_scales,
    compare,
    compare_squares,
    flat,
    follow_row,
    parser,
    save,
    short,
    show,
    shown,
    simulate_runs,
)

from jink.envs.episodes import Episodes
from jink.envs.flight.dwells import Dwell
from jink.envs.flight.limits import Limits, Start
from jink.envs.intents import Straight, Turn
from jink.envs.manoeuvres import Manoeuvres
from jink.envs.sampling import Regular
from jink.envs.scenario import Scenario
from jink.envs.sensing import Sensing
from jink.envs.surges import MarkovBursts
from jink.estimators.recipes import Scales
from jink.estimators.sensors import position
from jink.training.console import progress
from jink.training.weighted import mean, ratio

SIGMA, SPEED, GRAVITY, INTERVAL = 10.0, 150.0, 9.80665, 0.2
SETTLED = 5  # samples: one second
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
BASE, MEASURED = "joint-imm", "measured"
FIXED = Scales(speed=SPEED, turn_rate=0.3)
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
    Regular(300, INTERVAL),
    (MarkovBursts(on=(1.0, 4.0), off=(2.0, 6.0), scale=100.0),),
    start_sigma=(SIGMA, 10.0),
    filter_noise=1000.0,
)


def bursts_in_turns(episodes: Episodes) -> list[list[tuple[int, int]]]:
    """For each episode, bursts that overlap a turn: the first quiet sample after each, and the next surging one."""
    turning = episodes.truth.intent == SCENARIO.intents.index("turn")
    found = []
    for loud, turns in zip(episodes.scale > 1.0, turning, strict=True):
        change = np.diff(loud.astype(int), prepend=0)
        begins, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
        stops = [*begins[1:], len(loud)]
        found.append(
            [(end, stop) for begin, end, stop in zip(begins, ends, stops, strict=False) if turns[begin:end].any()]
        )
    return found


def recovery(error: Floats, bursts: list[list[tuple[int, int]]]) -> Floats:
    """Seconds to recover, summed over the bursts of each episode; (runs,)."""
    total = np.zeros(len(error))
    for run, within in enumerate(error <= 3.0 * SIGMA):
        for end, stop in bursts[run]:
            settled = (k for k in range(end, stop) if within[k : min(k + SETTLED, stop)].all())
            total[run] += INTERVAL * (next(settled, stop) - end)
    return total


def main() -> None:
    """Choose scales, run, print, save."""
    options = parser(__doc__, 200, seed=1)
    options.add_argument("--training", type=int, default=20, help="episodes to choose scales on")
    given = options.parse_args()
    training = [(SCENARIO, simulate_runs(SCENARIO, given.training, given.seed + TRAINING_SEED))]
    held_out = simulate_runs(SCENARIO, given.runs, given.seed)
    bursts = bursts_in_turns(held_out)
    counts = np.array([float(len(some)) for some in bursts])
    chosen = {}
    found = {MEASURED: np.linalg.norm(held_out.measurements - held_out.truth.position, axis=2)}
    with progress("turns", len(NAMES) * (len(GRID) + 1)) as advance:
        for row in NAMES:
            advance(0, text=row)
            chosen[row] = choose_scales(row, training, FIXED, advance)
            place = follow_row(row, SCENARIO, held_out, chosen[row]).position
            found[row] = np.linalg.norm(place - held_out.truth.position, axis=2)
            advance()
    rms = compare_squares({row: np.mean(error**2, axis=1) for row, error in found.items()}, BASE, given.seed)
    away = compare(
        {row: mean(INTERVAL * np.sum(error > 3.0 * SIGMA, axis=1)) for row, error in found.items()},
        BASE,
        given.runs,
        given.seed,
        "s",
    )
    late = compare(
        {row: ratio(recovery(error, bursts), counts) for row, error in found.items()}, BASE, given.runs, given.seed, "s"
    )
    middle = {row: np.median(np.sqrt(np.mean(error**2, axis=1))) for row, error in found.items()}
    header = ["estimator", "acceleration, sojourn", "median episode m"]
    for what in ("RMS m", "s beyond 3 sigma", "s to recover"):
        header += [what, "more [95 %]"]
    rows = []
    for row in found:
        picked = f"{chosen[row].acceleration:g}, {chosen[row].sojourn:g}" if row in chosen else ""
        cells = [row, picked, short(middle[row])]
        for gaps in (rms, away, late):
            difference = "" if row == BASE else shown(gaps[row].difference, "+")
            cells += [short(gaps[row].value.value), difference]
        rows.append(cells)
    what = f"{counts.sum():.0f} bursts in turns; 3 sigma = {3 * SIGMA:g} m; more than {BASE} [95 %]"
    show(f"{given.runs} episodes of 60 s, {what}", header, rows, given.markdown)
    numbers = flat("rms", rms) | flat("beyond 3 sigma", away) | flat("to recover", late)
    scales = {row: vars(value) for row, value in chosen.items()}
    save(given.out, numbers, runs=given.runs, seed=given.seed, training=given.training, scales=scales)


if __name__ == "__main__":
    main()
