"""The cells of each suite of `jink bench`, and what computes them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import pandas as pd

from jink.envs.scenarios import SUITES as SCENARIOS
from jink.training.bench_request import BenchRequest
from jink.training.ladder.cells import BLOCK, TRUTH, LadderCell, run_ladder_cell
from jink.training.ladder.rungs import LADDER
from jink.training.ladder.typical import EVALUATION_SEED
from jink.training.loading import is_spec, spec_digest, spec_label
from jink.training.recorded_scores import score_report
from jink.training.recorded_suite import ESTIMATORS, list_files, list_flags
from jink.training.rows import Cell, commit, hash_files, make_rows, now
from jink.training.track import choose, estimate, read

__all__ = ["RUNS", "SIMULATED", "Job", "jobs_of", "rows_of_job"]

SIMULATED = ("switch", "surge", "joint", "heavy-tail", "model-error")
RUNS, QUICK_RUNS = 200, 20
"""Runs of a simulated cell."""
_SEED = 1


class Job(NamedTuple):
    """A cell and the pure function that computes its rows from the time it started."""

    cell: Cell
    compute: Callable[[str], pd.DataFrame]


def rows_of_job(job: Job) -> pd.DataFrame:
    """Rows of a cell; what goes wrong in it becomes a row too, so that the others still run. Ctrl-C still stops."""
    started = now()
    try:
        return job.compute(started)
    except (Exception, SystemExit) as error:
        text = " ".join(str(error).split())
        expected = isinstance(error, ValueError | ArithmeticError | OSError)
        reason = text if expected and text else f"{type(error).__name__}: {text}"
        if isinstance(error, SystemExit):
            reason = f"it ended the program (SystemExit {text}); let it raise an error instead"
        return make_rows(job.cell, {}, status="error", reason=reason, started=started)


def jobs_of(suite: str, request: BenchRequest) -> list[Job]:
    """All cells of a suite that a request asks for, in the order of the table.

    Raises:
        ValueError: a scenario or an estimator that the suite does not have.
    """
    jobs = list(_JOBS[suite](suite, request))
    if suite in SIMULATED:
        return jobs
    for option, given, names in (
        ("--scenario", request.scenarios, [job.cell.scenario for job in jobs]),
        ("--estimator", request.estimators, [job.cell.estimator for job in jobs]),
    ):
        _must_know(option, given, tuple(dict.fromkeys(names)), suite)
    return [
        job
        for job in jobs
        if job.cell.scenario in (request.scenarios or (job.cell.scenario,))
        and job.cell.estimator in (request.estimators or (job.cell.estimator,))
    ]


def _must_know(option: str, given: tuple[str, ...], names: tuple[str, ...], suite: str) -> None:
    for name in given:
        if name not in names:
            raise ValueError(
                f"{option}: name must be one of the suite {suite}: {', '.join(names)}; got '{name}'. Pick one."
            )


def _simulated(suite: str, request: BenchRequest) -> Iterator[Job]:
    names = SCENARIOS[suite]
    _must_know("--scenario", request.scenarios, names, suite)
    scenarios = [name for name in names if name in request.scenarios] or names[: 1 if request.quick else None]
    runs = request.runs or (QUICK_RUNS if request.quick else RUNS)
    first = EVALUATION_SEED if request.seed is None else request.seed
    rungs = [(one, "", "") for one in (TRUTH, *LADDER)]
    if request.estimators:
        rungs = [_rung(one, suite) for one in request.estimators]
    for scenario in scenarios:
        for begin in range(0, runs, BLOCK):
            for estimator, spec, data in rungs:
                if estimator == TRUTH and begin:
                    continue  # it is the first run
                known = LadderCell(suite, scenario, estimator, min(BLOCK, runs - begin), first + begin, spec)
                cell = Cell(suite, scenario, estimator, known.runs, known.seed, commit(), data)
                yield Job(cell, lambda started, known=known, cell=cell: run_ladder_cell(known, cell))  # type: ignore[misc]


def _rung(name: str, suite: str) -> tuple[str, str, str]:
    """What tables call an estimator, where it lies if it is a third party's, and the hash of its file."""
    from jink.estimators.recipes import RECIPES
    from jink.intent.pretrained import pretrained_names

    if is_spec(name):
        return spec_label(name), name, spec_digest(name)
    learned = tuple(f"intent-imm@{one}" for one in pretrained_names())
    _must_know("--estimator", (name,), tuple(dict.fromkeys((TRUTH, *LADDER, *RECIPES, *learned))), suite)
    return name, "", ""


def _published(suite: str, request: BenchRequest) -> Iterator[Job]:
    from jink.training.published import PUBLISHED_CELLS, PublishedCell, published_values, run_cell

    def compute(known: PublishedCell, cell: Cell, started: str) -> pd.DataFrame:
        began = time.perf_counter()
        outcome = run_cell(known, cell.runs, cell.seed)
        compared = {
            metric: (value.value, *(value.interval or (math.nan, math.nan)))
            for metric, value in published_values(known).items()
        }
        lost = outcome.diverged / max(outcome.steps, 1)
        return make_rows(
            cell,
            outcome.values,
            status="diverged" if lost > 0.5 else "ok",
            reason=f"{100 * lost:.0f} % of steps diverged" if lost > 0.5 else "",
            published=compared,
            parameters={"scenario": known.scenario, "estimator": known.estimator},
            steps=outcome.steps,
            seconds=time.perf_counter() - began,
            started=started,
        )

    for known in PUBLISHED_CELLS:
        # Compiling costs more than the source's own number of runs, so quick means fewer models, not fewer runs.
        if request.quick and not published_values(known) and not request.scenarios:
            continue
        runs = request.runs or known.runs
        seed = _SEED if request.seed is None else request.seed
        cell = Cell(suite, known.scenario, known.estimator, runs, seed, commit())
        yield Job(cell, lambda started, known=known, cell=cell: compute(known, cell, started))  # type: ignore[misc]


def _recorded(suite: str, request: BenchRequest) -> Iterator[Job]:
    assert request.data is not None  # checked by `bench`
    prepared: dict[str, Any] = {}

    def compute(file: Any, cell: Cell, started: str) -> pd.DataFrame:
        if file.request is None:
            return make_rows(cell, {}, status="skipped", reason=file.reason, started=started)
        if file.name not in prepared:
            prepared.clear()  # one file in memory at a time
            tracks = read(file.request)
            prepared[file.name] = (tracks, choose(file.request, tracks))
        tracks, choice = prepared[file.name]
        name = "kf-cv" if cell.estimator == "raw" else cell.estimator
        report = estimate(replace(file.request, estimator=name), tracks, choice)
        values = score_report(report, cell.seed, raw=cell.estimator == "raw")
        if not values:
            reason = "rows do not locate the target" if tracks.truth is not None else "no truth to compare with"
            return make_rows(cell, {}, status="skipped", reason=reason, started=started)
        lost = report.scores["diverged_steps"] / max(report.scores["steps"], 1.0)
        bad = lost > 0.5 and cell.estimator != "raw"
        parameters = {p.name: p.value for p in choice.parameters} | {"flags": list_flags(file.request)}
        return make_rows(
            cell,
            values,
            status="diverged" if bad else "ok",
            reason=f"{100 * lost:.0f} % of steps diverged" if bad else "",
            parameters=parameters,
            steps=int(tracks.lengths.sum()),
            seconds=report.seconds,
            started=started,
        )

    for file in list_files(request.data):
        files = () if file.request is None else (file.request.file, file.request.truth)
        data = hash_files(*(path for path in files if path is not None))
        for estimator in ESTIMATORS if file.request is not None else ("raw",):
            cell = Cell(suite, file.name, estimator, 1, 0, commit(), data)
            yield Job(cell, lambda started, file=file, cell=cell: compute(file, cell, started))  # type: ignore[misc]


def _many(suite: str, request: BenchRequest) -> Iterator[Job]:
    from jink.training.many_suite import CUTOFF, MANY_CELLS, QUICK, RUNS, ManyCell, run_many

    def compute(known: ManyCell, cell: Cell, started: str) -> pd.DataFrame:
        began = time.perf_counter()
        values, scans = run_many(known, cell.runs, cell.seed)
        told = {"acceleration": known.scales.acceleration, "speed": known.scales.speed, "cutoff": CUTOFF}
        return make_rows(
            cell, values, parameters=told, steps=scans, seconds=time.perf_counter() - began, started=started
        )  # fmt: skip

    runs = request.runs or (3 if request.quick else RUNS)
    seed = _SEED if request.seed is None else request.seed
    for known in MANY_CELLS:
        if request.quick and known.scene not in QUICK and not request.scenarios:
            continue
        cell = Cell(suite, known.scene, known.estimator, runs, seed, commit())
        yield Job(cell, lambda started, known=known, cell=cell: compute(known, cell, started))  # type: ignore[misc]


_JOBS: dict[str, Callable[[str, BenchRequest], Iterator[Job]]] = {
    "published": _published, "recorded": _recorded, "multi-target": _many, **dict.fromkeys(SIMULATED, _simulated)
}  # fmt: skip
