"""What a step of each recipe costs beside one of `imm`: a batch, and one track fed step by step.

Positions in the plane of drones whose sensor surges (joint-v0, 300 samples). One core, one thread; recipes take turns,
round after round. Processor time: the figure is the median of the rounds; the ratio is that of the same round, with the
95 % bootstrap interval of its median over rounds. Compilation is not counted. Run it on a machine
that has nothing else to do.

python benchmarks/recipe_cost.py --runs 21 --seed 0 --out recipe_cost.json
"""

from __future__ import annotations

import numpy as np
from _paired import FULL, Floats, make_row, parser, save, short, show, shown, simulate_runs
from _problem import Case
from _timing import interleaved, use_one_core

from jink.envs.episodes import Episodes
from jink.envs.scenarios import make_scenario
from jink.estimators.api import BankEstimator
from jink.estimators.inputs import Prior
from jink.estimators.recipes import RECIPES, Scales
from jink.training.console import progress
from jink.training.intervals import Measured, Score, measure, resample_runs
from jink.training.weighted import median

SCENARIO = "joint-v0"
SCALES = Scales(acceleration=10.0, speed=15.0, turn_rate=0.5)
BASE = "imm"
NAMES = (*RECIPES, FULL)


def batch(estimator: BankEstimator, episodes: Episodes) -> Case:
    """All tracks in one call."""
    prior = Prior(mean=episodes.prior_mean, cov=episodes.prior_cov)
    return Case(lambda: estimator.run(episodes.measurements, episodes.times, prior=prior))


def stream(estimator: BankEstimator, episodes: Episodes) -> Case:
    """One track, step by step, from its first fix on."""

    def feed() -> None:
        z, times = episodes.measurements[0], episodes.times[0]
        state = estimator.start(z[0], times[0], prior=Prior(episodes.prior_mean[0], episodes.prior_cov))
        for k in range(1, len(z)):
            state, _ = estimator.step(state, z[k], times[k])

    return Case(feed)


def main() -> None:
    """Time, print, save."""
    options = parser(__doc__, 21)
    options.add_argument("--tracks", type=int, default=50, help="tracks of the batch")
    given = options.parse_args()
    bound = use_one_core()
    scenario = make_scenario(SCENARIO)
    episodes = simulate_runs(scenario, given.tracks, given.seed)
    samples = episodes.times.shape[1]
    estimators = {name: make_row(name, scenario.sensor, SCALES) for name in NAMES}
    cases: dict[str, Case] = {}
    steps: dict[str, int] = {}
    for name, estimator in estimators.items():
        for form, make, count in (("batch", batch, given.tracks * samples), ("stream", stream, samples - 1)):
            case = make(estimator, episodes)
            case.run()
            cases[f"{name}/{form}"], steps[f"{name}/{form}"] = case, count
    seconds: dict[str, list[float]] = {key: [] for key in cases}
    with progress("rounds", given.runs) as advance:
        for _ in range(given.runs):
            for key, found in interleaved(cases, dict.fromkeys(cases, 1)).items():
                seconds[key].append(found[0][0])
            advance()
    taken = {key: 1e6 * np.array(values) / steps[key] for key, values in seconds.items()}
    numbers: dict[str, Measured] = {}
    rows = []
    for name in NAMES:
        cells = [name, f"{len(estimators[name].bank.modes)}"]
        for form in ("batch", "stream"):
            key = f"{name}/{form}"
            found = over_base(taken[key], taken[f"{BASE}/{form}"], given.seed)
            numbers |= {f"{key}/{kind}": number for kind, number in found.items()}
            ratio = "1" if name == BASE else shown(found["ratio"])
            cells += [short(found["cost"].value), ratio]
        rows.append(cells)
    header = ["recipe", "modes", "batch, us/step", "over imm [95 %]", "streaming, us/step", "over imm [95 %]"]
    title = f"{bound}; {given.runs} rounds, {given.tracks} tracks of {samples} samples in the batch"
    show(title, header, rows, given.markdown)
    save(given.out, numbers, runs=given.runs, seed=given.seed)


def over_base(cost: Floats, base: Floats, seed: int) -> dict[str, Measured]:
    """Median cost, us, and median ratio of the rounds."""
    scores = {"cost": Score(median(cost), "us"), "ratio": Score(median(cost / base), "")}
    return measure(scores, resample_runs(len(cost), seed))


if __name__ == "__main__":
    main()
