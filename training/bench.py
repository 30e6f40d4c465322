"""`jink bench`: cells computed once each, written as they finish, and the table made from the rows."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from rich.console import Console

from jink.training.catalogue import SUITES
from jink.training.console import check_writable, progress, say_when_compiling
from jink.training.recorded_scores import score_report
from jink.training.recorded_suite import ESTIMATORS, list_files, list_flags
from jink.training.rows import Cell, append_rows, commit, finished_cells, hash_files, make_rows, now, read_rows
from jink.training.tables import print_many_suite, print_published, print_recorded
from jink.training.track import choose, estimate, read

__all__ = ["BenchRequest", "bench"]

_SEED = 1
SIMULATED = ("switch", "surge", "joint", "heavy-tail", "model-error")
RUNS, QUICK_RUNS = 100, 20


@dataclass(frozen=True)
class BenchRequest:
    """What the command line asked for; None means the suite's own choice."""

    suite: str
    quick: bool = False
    out: Path | None = None
    data: Path | None = None
    runs: int | None = None
    seed: int | None = None
    scenarios: tuple[str, ...] = ()
    estimators: tuple[str, ...] = ()


class Job(NamedTuple):
    """A cell and the function that computes its rows."""

    cell: Cell
    compute: Callable[[str], pd.DataFrame]


def bench(request: BenchRequest, console: Console) -> int:
    """Run a suite; what `out` already holds is not computed again.

    Args:
        request: what was asked for.
        console: where the table goes.

    Returns:
        0, or 1 where a cell ended in an error.

    Raises:
        ValueError: an unknown suite, a refused option, or a file that holds something else.
        OSError: the rows cannot be written.
    """
    if request.suite not in SUITES:
        raise ValueError(f"--suite: name must be one of {', '.join(SUITES)}; got '{request.suite}'. See jink list.")
    if request.runs is not None and request.runs < 1:
        raise ValueError(f"--runs: value must be >= 1; got {request.runs}. Leave it out for the source's.")
    if request.seed is not None and request.seed < 0:
        raise ValueError(f"--seed: value must be >= 0; got {request.seed}. Use for example --seed 1.")
    if request.suite == "recorded" and request.data is None:
        raise ValueError("--data: folder must be given for the suite recorded; got none. Add --data DIR.")
    _refuse_unused(request)
    check_writable(request.out, "--out", (".parquet",))
    with ExitStack() as stack:
        out = request.out or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "rows.parquet"
        jobs = list(_JOBS[request.suite](request))
        done = finished_cells(read_rows(out))
        todo = [job for job in jobs if job.cell not in done]
        stack.enter_context(say_when_compiling())
        advance = stack.enter_context(progress(request.suite, len(todo)))
        for job in todo:
            advance(0, f"{job.cell.scenario}: {job.cell.estimator}")
            append_rows(out, _rows(job))
            advance(1)
        rows = read_rows(out)
    wanted = {job.cell for job in jobs}
    mine = [Cell(*key) in wanted for key in rows[list(Cell._fields)].itertuples(index=False, name=None)]
    rows = rows[mine]
    if request.suite in _TABLES:
        _TABLES[request.suite](console, rows)
    if len(todo) < len(jobs):
        console.print(f"{len(jobs) - len(todo)} of {len(jobs)} cells were already in {out.name}", markup=False)
    if request.out is not None:
        console.print(f"wrote {request.out}", markup=False)
    return int((rows["status"] == "error").any())


def _refuse_unused(request: BenchRequest) -> None:
    """Options that the suite would not look at: whoever gives them expects something else."""
    given = {"--data": request.data, "--quick": request.quick or None, "--runs": request.runs, "--seed": request.seed}
    unused = ("--quick", "--runs", "--seed") if request.suite == "recorded" else ("--data",)
    for option in unused:
        if given[option] is not None:
            raise ValueError(
                f"{option}: option must be left out of the suite {request.suite}, which does not use it; "
                f"got {given[option]}. Leave it out."
            )


def _rows(job: Job) -> pd.DataFrame:
    """Rows of a cell; what goes wrong in it becomes a row too, so that the others still run."""
    started = now()
    try:
        return job.compute(started)
    except (ValueError, ArithmeticError, OSError) as error:
        return make_rows(job.cell, {}, status="error", reason=" ".join(str(error).split()), started=started)


def _published(request: BenchRequest) -> Iterator[Job]:
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
        if request.quick and not published_values(known):
            continue
        runs = request.runs or known.runs
        seed = _SEED if request.seed is None else request.seed
        cell = Cell("published", known.scenario, known.estimator, runs, seed, commit())
        yield Job(cell, lambda started, known=known, cell=cell: compute(known, cell, started))  # type: ignore[misc]


def _recorded(request: BenchRequest) -> Iterator[Job]:
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
            cell = Cell("recorded", file.name, estimator, 1, 0, commit(), data)
            yield Job(cell, lambda started, file=file, cell=cell: compute(file, cell, started))  # type: ignore[misc]


def _many(request: BenchRequest) -> Iterator[Job]:
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
        if request.quick and known.scene not in QUICK:
            continue
        cell = Cell("multi-target", known.scene, known.estimator, runs, seed, commit())
        yield Job(cell, lambda started, known=known, cell=cell: compute(known, cell, started))  # type: ignore[misc]


def _simulated(request: BenchRequest) -> Iterator[Job]:
    from jink.envs.scenarios import SUITES as SCENARIOS
    from jink.training.ladder.cells import BLOCK, TRUTH, LadderCell, run_ladder_cell
    from jink.training.ladder.rungs import LADDER
    from jink.training.ladder.typical import EVALUATION_SEED

    names = SCENARIOS[request.suite]
    runs = request.runs or (QUICK_RUNS if request.quick else RUNS)
    first = EVALUATION_SEED if request.seed is None else request.seed
    for scenario in [name for name in names if name in request.scenarios or not request.scenarios]:
        for begin in range(0, runs, BLOCK):
            count = min(BLOCK, runs - begin)
            estimators = request.estimators or (TRUTH, *LADDER)
            for estimator in estimators:
                if estimator == TRUTH and begin:
                    continue
                job = LadderCell(request.suite, scenario, estimator, count, first + begin)
                cell = Cell(*job, commit())
                yield Job(cell, lambda started, job=job, cell=cell: run_ladder_cell(job, cell))  # type: ignore[misc]


_JOBS = {"published": _published, "recorded": _recorded, "multi-target": _many} | dict.fromkeys(SIMULATED, _simulated)
_TABLES = {"published": print_published, "recorded": print_recorded, "multi-target": print_many_suite}
