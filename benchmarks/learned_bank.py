"""A learnt bank against tuned ones: every scenario of the suite `switch`, on episodes that nobody was tuned on.

Learnt: `jink train intents SCENARIO --tracks 64 --steps 150`, read from or written to --models, or the pretrained model
of the target; that of the drone at 10 Hz serves where it is seen every 0.4 s or at random times too. Tuned on the same
64 x 150 rows of each scenario, all scales free: singer, imm, and the library bank of `intent-imm`; each once by
likelihood, as intents are learnt, and once by RMS position error, which no learner knows. Oracle: library motions told
the true intent of every row. Truth is that of the time of sight; 95 % intervals, paired over episodes. What was tuned
is kept in --tuned and not tuned again.

python benchmarks/learned_bank.py --runs 300 --models DIR --tuned tuned.json --out learned_bank.json
python benchmarks/learned_bank.py --table learned_bank.json     # of each bank the better of both tunings
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _paired import Floats, Gap, compare, flat, follow, parser, save, short, show, shown, simulate_runs
from _tuned_banks import FAMILIES, ORACLE, by_likelihood, by_rms, oracle_family, oracle_scales, run_oracle
from gymnasium.utils import seeding
from update_intents_page import TRAININGS

from jink.envs.episodes import Episodes
from jink.envs.scenario import Scenario
from jink.envs.scenarios import SUITES, make_scenario
from jink.envs.streams import make_streams
from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank
from jink.estimators.extrapolation import rows_of
from jink.estimators.inputs import Prior
from jink.estimators.metrics import errors, nees
from jink.estimators.recipes import make_estimator
from jink.estimators.status import DIVERGED
from jink.intent.forecasting import forecast
from jink.intent.model import IntentModel
from jink.intent.model_file import MODEL_FILE, load_model
from jink.intent.pretrained import load_pretrained
from jink.training.cli import main as jink
from jink.training.console import progress
from jink.training.intervals import Measured, Statistic
from jink.training.weighted import mean, ratio, root_mean

LEARNT = "learnt"
SAME_TARGET = {"switch-slow-v0": "drone", "switch-irregular-v0": "drone"}
"""The drone again, at other times: a model is exact in the time step, so the one of `switch-v0` is asked there."""
TRACKS, STEPS = 64, 150
AFTER = 20  # rows after a switch in which the peak is looked for
AHEAD, WARM, EVERY, PATHS = 20, 30, 30, 6


class Run(NamedTuple):
    """What one row of the table did, per episode: squares (m^2, m^2/s^2), peaks (m), mean NEES, NIS, forecasts."""

    position: Floats
    velocity: Floats
    peak: Floats
    switches: Floats
    nees: Floats
    nis: Floats
    nats: Floats
    lost: Floats
    ahead: Floats  # (runs, AHEAD) squared error of the mean forecast, m^2
    nll: Floats  # (runs, AHEAD)
    ade: Floats
    fde: Floats


def training_episodes(scenario: str) -> Episodes:
    """The episodes that `jink train intents` simulates."""
    made = make_scenario(scenario, steps=STEPS)
    return made.simulate([make_streams(seeding.np_random(number)[0]) for number in range(TRACKS)])


def find_or_train(scenario: str, folder: Path, fresh: bool) -> IntentModel:
    """The model in ``folder/scenario``, else a pretrained one of that target, else one that is trained now."""
    place = folder / scenario
    if (place / MODEL_FILE).is_file() and not fresh:
        return load_model(place)
    name = SAME_TARGET.get(scenario, next((n for n, command in TRAININGS.items() if command[0] == scenario), None))
    if name is not None and not fresh:
        with contextlib.suppress(ValueError):
            return load_pretrained(name)
    folder.mkdir(parents=True, exist_ok=True)
    before = sys.argv
    arguments = ["train", "intents", scenario, "--tracks", f"{TRACKS}", "--steps", f"{STEPS}", "--out", str(place)]
    sys.argv = ["jink", *arguments]
    try:
        if jink():
            raise SystemExit(f"{scenario}: no model")
    finally:
        sys.argv = before
    return load_model(place)


def peaks(found: Estimates, episodes: Episodes) -> tuple[Floats, Floats]:
    """Sum over switches of the largest position error in the `AFTER` rows that follow, m, and the switches; (runs,)."""
    away = errors(found.position, episodes.truth.position)
    sums, counts = np.zeros(len(away)), np.zeros(len(away))
    for b, moments in enumerate(episodes.truth.switch_times):
        for moment in moments[np.isfinite(moments)]:
            first = int(np.searchsorted(episodes.times[b], moment))
            part = away[b, first : first + AFTER]
            if first >= WARM // 3 and len(part) == AFTER:
                sums[b] += part.max()
                counts[b] += 1
    return sums, counts


def forecasts(estimator: BankEstimator, episodes: Episodes) -> tuple[Floats, Floats, Floats, Floats]:
    """Mean over starting rows of each episode: squared error and NLL by row ahead, minADE and minFDE of six paths."""
    B, T = episodes.times.shape
    prior = Prior(mean=episodes.prior_mean, cov=episodes.prior_cov)
    states, _ = estimator.states(episodes.measurements, episodes.times, prior=prior)
    rows = np.arange(WARM, T - AHEAD, EVERY)
    following = rows[:, None] + np.arange(1, AHEAD + 1)
    squares, nll = np.empty((B, AHEAD)), np.empty((B, AHEAD))
    ade, fde = np.empty(B), np.empty(B)
    portion = 20
    for low in range(0, B, portion):
        part = np.arange(low, min(low + portion, B))
        index = (part[:, None] * T + rows).ravel()
        horizons = episodes.times[part][:, following] - episodes.times[part][:, rows, None]
        truth = episodes.truth.position[part][:, following]
        n = len(part) * len(rows)
        found = forecast(estimator, rows_of(states, index), horizons.reshape(n, AHEAD), paths=PATHS)
        place = truth.reshape(n, AHEAD, -1)
        shape = (len(part), len(rows), -1)
        squares[part] = np.square(found.mean - place).sum(axis=-1).reshape(shape).mean(axis=1)
        nll[part] = found.nll(place).reshape(shape).mean(axis=1)
        ade[part] = found.min_ade(place, PATHS).reshape(shape)[..., 0].mean(axis=1)
        fde[part] = found.min_fde(place, PATHS).reshape(shape)[..., 0].mean(axis=1)
    return squares, nll, ade, fde


def judge(found: Estimates, episodes: Episodes, estimator: BankEstimator | None, ahead: int) -> Run:
    """Scores of one row; forecasts from the first ``ahead`` episodes if an estimator is given."""
    truth = episodes.truth
    peak, switches = peaks(found, episodes)
    runs = len(episodes.times)
    empty = np.full((runs, AHEAD), np.nan)
    more: tuple[Floats, ...] = (empty, empty, empty[:, 0], empty[:, 0])
    if estimator is not None and ahead:
        first = Episodes(*(value[:ahead] if i not in (2, 3, 9, 12) else value for i, value in enumerate(episodes)))
        first = first._replace(truth=type(truth)(*(value[:ahead] for value in truth)))
        parts = forecasts(estimator, first)
        more = tuple(np.concatenate([part, np.full((runs - ahead, *part.shape[1:]), np.nan)]) for part in parts)
    used = found.nis_dof > 0
    used[:, :1] = False
    return Run(
        np.square(found.position - truth.position).sum(axis=2).mean(axis=1),
        np.square(found.velocity - truth.velocity).sum(axis=2).mean(axis=1),
        peak,
        switches,
        nees(found.position, found.velocity, found.covariance, truth.position, truth.velocity)[:, WARM:].mean(axis=1)
        / 4.0,
        np.where(used, found.nis, 0.0).sum(axis=1) / found.nis_dof.sum(axis=1, where=used),
        np.where(used, found.log_likelihood, 0.0).sum(axis=1) / used.sum(axis=1),
        (found.status == DIVERGED).any(axis=1).astype(float),
        *more,
    )


def statistics(runs: dict[str, Run], name: str) -> dict[str, Statistic]:
    """A statistic of every row by the name of the measure."""
    made: dict[str, Statistic] = {}
    for row, run in runs.items():
        values = getattr(run, name, None)
        if name in ("position", "velocity"):
            made[row] = root_mean(values)
        elif name == "peak":
            made[row] = ratio(run.peak, run.switches)
        elif name.startswith("ahead "):
            made[row] = root_mean(run.ahead[:, int(name.split()[1]) - 1])
        elif name == "nll":
            made[row] = mean(run.nll.mean(axis=1))
        else:
            made[row] = mean(values)
    return made


UNITS = {"position": "m", "velocity": "m/s", "peak": "m", "ade": "m", "fde": "m", "nll": "nats", "nats": "nats"}
MEASURES = ("position", "velocity", "peak", "nees", "nis", "nats", "lost")
FORECASTS = ("ahead 5", f"ahead {AHEAD}", "nll", "ade", "fde")


class Tuned:
    """Logs of scales by scenario and bank, kept in a file if there is one."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.found: dict[str, list[float]] = json.loads(path.read_text()) if path and path.exists() else {}

    def get(self, key: str, tune: Callable[[], Floats]) -> Floats:
        """What is known, or tuned now."""
        if key not in self.found:
            self.found[key] = [float(value) for value in tune()]
            if self.path:
                self.path.write_text(json.dumps(self.found, indent=0) + "\n")
        return np.array(self.found[key])


def tuned_banks(scenario: Scenario, given, advance) -> tuple[dict[str, BankEstimator], Bank]:  # type: ignore[no-untyped-def]
    """Banks of library motions and the oracle's, scales chosen on the training episodes or read."""
    training, tuned, sensor = training_episodes(scenario.id), Tuned(given.tuned), scenario.sensor
    banks: dict[str, BankEstimator] = {}
    for name, family in FAMILIES.items():
        key = f"{scenario.id}, {name}"
        likeliest = tuned.get(f"{key}, likelihood", lambda family=family: by_likelihood(family, sensor, training))
        closest = tuned.get(
            f"{key}, RMS",
            lambda family=family, start=likeliest: by_rms(family, sensor, training, start, given.evaluations),
        )
        for how, logs in (("likelihood", likeliest), ("RMS", closest)):
            banks[f"{name}, {how}"] = BankEstimator(family.make(logs, sensor), name=name)
        advance(text=f"{scenario.id}: {name}")
    family, from_library = oracle_family(scenario.intents)
    first = from_library(tuned.get(f"{scenario.id}, library bank, likelihood", lambda: likeliest))
    logs = tuned.get(f"{scenario.id}, {ORACLE}", lambda: oracle_scales(family, sensor, training, first))
    advance(text=f"{scenario.id}: oracle")
    return banks, family.make(logs, sensor)


def study(scenario: Scenario, given, advance) -> dict[str, Run]:  # type: ignore[no-untyped-def]
    """All rows of one scenario."""
    banks, told = tuned_banks(scenario, given, advance)
    model = find_or_train(scenario.id, given.models, given.fresh)
    banks = {LEARNT: make_estimator("intent-imm", scenario.sensor, model=model), **banks}
    advance(text=f"{scenario.id}: {LEARNT}")
    episodes = simulate_runs(scenario, given.runs, given.seed)
    runs = {
        name: judge(follow(bank, episodes), episodes, bank, min(given.forecasts, given.runs))
        for name, bank in banks.items()
    }
    runs[ORACLE] = judge(run_oracle(told, episodes), episodes, None, 0)
    return runs


def gaps_of(runs: dict[str, Run], names: Sequence[str], seed: int) -> dict[str, dict[str, Gap]]:
    """Measure -> row -> number and paired differences to the learnt bank."""
    out = {}
    for name in names:
        kept = {row: run for row, run in runs.items() if not (name in FORECASTS and row == ORACLE)}
        if name in FORECASTS:
            known = np.isfinite(kept[LEARNT].ade)
            kept = {row: Run(*(value[known] for value in run)) for row, run in kept.items()}
        found = statistics(kept, name)
        with np.errstate(invalid="ignore"):  # nothing lost over nothing lost
            out[name] = compare(found, LEARNT, len(kept[LEARNT].position), seed, UNITS.get(name, ""))
    return out


def _cell(row: str, gap: Gap, digits: int = 3) -> str:
    said = short(gap.value.value, digits=digits)
    return said if row == LEARNT else f"{said}, {shown(gap.difference, '+', 2)}"


def raw(episodes: Episodes) -> float:
    """RMS of the measurements, m."""
    return float(np.sqrt(np.nanmean(np.square(episodes.measurements - episodes.truth.position).sum(axis=2))))


def known_rows(path: Path | None) -> dict[str, Measured]:
    """Numbers of other scenarios that a file holds already."""
    if path is None or not path.exists():
        return {}
    return {name: Measured(**row) for name, row in json.loads(path.read_text())["rows"].items()}


TABLES = {
    "position, m": ("position", (ORACLE, *FAMILIES)),
    "velocity, m/s": ("velocity", (ORACLE, *FAMILIES)),
    "largest error in 20 rows after a switch, m": ("peak", (ORACLE, *FAMILIES)),
    "mean NLL of forecasts of 1 to 20 rows, nats": ("nll", tuple(FAMILIES)),
    "error 5 rows ahead, m": ("ahead 5", tuple(FAMILIES)),
    f"error {AHEAD} rows ahead, m": (f"ahead {AHEAD}", tuple(FAMILIES)),
    "minADE, m": ("ade", tuple(FAMILIES)),
    "minFDE, m": ("fde", tuple(FAMILIES)),
    "NEES over 4": ("nees", (ORACLE, *FAMILIES)),
    "NIS over its dof": ("nis", (ORACLE, *FAMILIES)),
    "nats per row": ("nats", (ORACLE, *FAMILIES)),
}


def print_tables(path: Path) -> None:
    """One table per measure in Markdown: learnt, and how much more the others have, each at its better tuning."""
    numbers = known_rows(path)
    scenarios = list(dict.fromkeys(name.split("/")[0] for name in numbers))
    for title, (measure, columns) in TABLES.items():
        rows = []
        for scenario in scenarios:
            cells = [scenario, shown(numbers[f"{scenario}/{measure}/{LEARNT}/value"])]
            for column in columns:
                ways = [column] if column == ORACLE else [f"{column}, {how}" for how in ("likelihood", "RMS")]
                keys = [f"{scenario}/{measure}/{way}" for way in ways]
                sign = -1.0 if measure == "nats" else 1.0
                best = min(keys, key=lambda key: sign * numbers[f"{key}/value"].value)
                if measure in ("nees", "nis"):
                    best = min(keys, key=lambda key: abs(numbers[f"{key}/value"].value - 1.0))
                    cells.append(short(numbers[f"{best}/value"].value))
                    continue
                cells.append(shown(numbers[f"{best}/difference"], "+", 2))
            rows.append(cells)
        names = ["told the intent" if column == ORACLE else column for column in columns]
        show(title, ["scenario", LEARNT, *names], rows, True)


def main() -> None:
    """Train or load, tune, run, print, save."""
    options = parser(__doc__, 300)
    options.add_argument("--models", type=Path, default=Path("learned_bank_models"), help="models by scenario")
    options.add_argument("--tuned", type=Path, help="JSON of tuned scales, read and written")
    options.add_argument("--tune", action="store_true", help="only tune, into --tuned")
    options.add_argument("--fresh", action="store_true", help="train every model again")
    options.add_argument("--only", nargs="*", choices=SUITES["switch"], default=list(SUITES["switch"]))
    options.add_argument("--forecasts", type=int, default=50, help="episodes to forecast in")
    options.add_argument("--evaluations", type=int, default=120, help="of RMS, per bank and scenario")
    options.add_argument("--table", type=Path, help="print the tables of these numbers and end")
    given = options.parse_args()
    if given.table:
        print_tables(given.table)
        return
    numbers = known_rows(given.out)
    for name in given.only:
        scenario = make_scenario(name)
        with progress(name, len(FAMILIES) + 2) as advance:
            if given.tune:
                tuned_banks(scenario, given, advance)
                continue
            runs = study(scenario, given, advance)
        measured = raw(simulate_runs(scenario, given.runs, given.seed))
        gaps = gaps_of(runs, (*MEASURES, *FORECASTS), given.seed)
        _print(name, gaps, measured, given)
        for measure, found in gaps.items():
            numbers |= flat(f"{name}/{measure}", found)
        save(given.out, numbers, runs=given.runs, seed=given.seed, training=[TRACKS, STEPS])


def _print(name: str, gaps: dict[str, dict[str, Gap]], measured: float, given) -> None:  # type: ignore[no-untyped-def]
    """Two tables of one scenario."""
    header = ["bank", "position, m", "velocity, m/s", "peak after a switch, m", "NEES/4", "NIS/dof", "nats", "lost"]
    rows = []
    for row in gaps["position"]:
        away = [_cell(row, gaps[m][row]) for m in ("position", "velocity", "peak")]
        more = [short(gaps[m][row].value.value) for m in ("nees", "nis")]
        rows.append([row, *away, *more, f"{gaps['nats'][row].value.value:.4f}", f"{gaps['lost'][row].value.value:.3f}"])
    title = f"{name}: {given.runs} episodes, measured {measured:.3f} m; and more than {LEARNT} [95 %]"
    show(title, header, rows, given.markdown)
    if given.forecasts:
        header = ["bank", "5 rows ahead, m", f"{AHEAD} rows ahead, m", f"NLL, rows 1-{AHEAD}", "minADE, m", "minFDE, m"]
        rows = [[row, *(_cell(row, gaps[m][row]) for m in FORECASTS)] for row in gaps["nll"]]
        title = f"{name}: forecasts in {min(given.forecasts, given.runs)} episodes, best of {PATHS} paths"
        show(title, header, rows, given.markdown)


if __name__ == "__main__":
    main()
