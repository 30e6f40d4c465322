"""`jink bench`: cells computed once each, written as they finish, and the tables made from the rows."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pandas as pd
from rich.console import Console

from jink.training.bench_jobs import SIMULATED, Job, jobs_of, rows_of_job
from jink.training.bench_request import BenchRequest, check_request
from jink.training.console import name_what_compiles, progress, say_when_compiling, stderr
from jink.training.ladder.backends import compute_all
from jink.training.ladder.table import print_ladder
from jink.training.ladder.typical import EVALUATION_END, EVALUATION_SEED
from jink.training.ladder.warming import Aside, warm_aside
from jink.training.row_writer import RowWriter, remove_leftovers
from jink.training.rows import Cell, finished_cells, make_rows, read_rows
from jink.training.tables import print_many_suite, print_published, print_recorded

__all__ = ["SIMULATED", "BenchRequest", "bench"]


def bench(request: BenchRequest, console: Console) -> int:
    """Run one suite or several; what `out` already holds is not computed again.

    Args:
        request: what was asked for.
        console: where the tables go.

    Returns:
        0, or 1 where a cell ended in an error.

    Raises:
        ValueError: a refused option, or a file that holds something else.
        OSError: the rows cannot be written.
    """
    check_request(request)
    quick = request.suite is None
    if quick and not request.quick:
        request = BenchRequest(**{**vars(request), "quick": True})
    with ExitStack() as stack:
        out = request.out or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "rows.parquet"
        jobs = [job for suite in request.suites for job in jobs_of(suite, request)]
        remove_leftovers(out)
        done = finished_cells(read_rows(out))
        todo = [job for job in jobs if job.cell not in done]
        _warn_of_seeds(todo)
        stack.enter_context(say_when_compiling())
        _compute(todo, request, out, "bench" if request.suite is None else request.suite)
        rows = _mine(read_rows(out), jobs)
    for suite in request.suites:
        mine = rows[rows["suite"] == suite]
        (print_ladder if suite in SIMULATED else _TABLES[suite])(console, mine)
    if len(todo) < len(jobs):
        console.print(f"{len(jobs) - len(todo)} of {len(jobs)} cells were already in {out.name}", markup=False)
    if request.out is not None:
        console.print(f"wrote {request.out}", markup=False)
    if request.report is not None:
        from jink.training.report.page import write_report

        write_report(rows, request.report, source=request.out.name if request.out else "")
        console.print(f"wrote {request.report}", markup=False)
    if quick:
        console.print("a first look: jink bench --suite all --out rows.parquet runs everything", style="dim")
    return int((rows["status"] == "error").any())


def _warn_of_seeds(todo: list[Job]) -> None:
    """Runs outside of the seeds that nothing learns from say little of what was tuned or learned here."""
    seeds = [(job.cell.seed, job.cell.seed + job.cell.runs - 1) for job in todo if job.cell.suite in SIMULATED]
    low, high = min((one for one, _ in seeds), default=EVALUATION_SEED), max((last for _, last in seeds), default=0)
    if low < EVALUATION_SEED or high >= EVALUATION_END:
        stderr().print(
            f"jink: seeds {low} to {high}: settings are chosen and models learned on seeds outside of "
            f"{EVALUATION_SEED} to {EVALUATION_END - 1}, so these runs may favour them. Leave --seed out.",
            markup=False,
        )


def _compute(todo: list[Job], request: BenchRequest, out: Path, text: str) -> None:
    if not todo:
        return
    names = [job.cell.estimator for job in todo if job.cell.suite in SIMULATED]
    with progress(text, len(todo)) as advance, warm_aside(names) as aside, RowWriter(out) as writer:
        shown = f"{text}: {todo[0].cell.scenario}: {todo[0].cell.estimator}"
        advance(0, shown)

        def compute(job: Job) -> pd.DataFrame:
            _wait(aside, job.cell.estimator, advance, text)
            return rows_of_job(job)

        alone = request.place.backend == "local" and request.place.workers == 1
        if not alone and not request.place.address:  # workers of this machine would all compile the same
            for name in names:
                _wait(aside, name, advance, text)
        with name_what_compiles(lambda kernel: advance(0, f"{shown}: compiling {kernel}")):
            for index, rows in compute_all(compute if alone else rows_of_job, todo, request.place, _give_up):
                writer.add(rows)
                after = todo[min(index + 1, len(todo) - 1)].cell if alone else todo[index].cell
                shown = f"{text}: {after.scenario}: {after.estimator}"
                advance(1, shown)


def _wait(aside: Aside, estimator: str, advance: Callable[..., None], text: str) -> None:
    """Until another process has compiled what this rung needs."""
    if aside.busy(estimator):
        advance(0, f"{text}: compiling {estimator} in a second process")
        aside.wait()


def _give_up(job: Job, reason: str) -> pd.DataFrame:
    return make_rows(job.cell, {}, status="error", reason=reason)


def _mine(rows: pd.DataFrame, jobs: list[Job]) -> pd.DataFrame:
    """The rows of these cells in their order, whatever the order in which they were ready."""
    order = {job.cell: place for place, job in enumerate(jobs)}
    place = [order.get(Cell(*key), -1) for key in rows[list(Cell._fields)].itertuples(index=False, name=None)]
    rows = rows.assign(place=place)
    return rows[rows["place"] >= 0].sort_values("place", kind="stable").drop(columns="place")


_TABLES = {"published": print_published, "recorded": print_recorded, "multi-target": print_many_suite}
