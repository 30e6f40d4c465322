"""Time the same filter bank in jink, FilterPy, Stone Soup, JAX, dynamax and NumPy, and check that they agree.

python benchmarks/peers.py                         # the full comparison
python benchmarks/peers.py --quick                 # a first answer
python benchmarks/peers.py --only filterpy,jax     # some packages, beside jink
python benchmarks/peers.py --json rows.json        # rows for later
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import _timing

BOUND = _timing.use_one_core() if __name__ == "__main__" else ""

import _problem  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn  # noqa: E402
from rich.table import Table  # noqa: E402

PEERS = ("jink", "jink-linear", "filterpy", "stonesoup", "jax", "jax-unrolled", "dynamax", "numpy")
NEEDS = {
    "filterpy": ("filterpy", "pip install 'filterpy>=2.0'"),
    "stonesoup": ("stonesoup", "pip install stonesoup"),
    "jax": ("jax", "pip install jax"),
    "jax-unrolled": ("jax", "pip install jax"),
    "dynamax": ("dynamax", "pip install dynamax"),
}
LOOPING = ("filterpy", "stonesoup")
# dynamax adds 1e-9 to the diagonal of S before it solves, so it cannot agree to rounding.
AGREEMENT = {"dynamax": 1e-6}
TWIN = 1e-9
LINEAR_ONLY_ONCE = ("jax-unrolled", "dynamax", "jink-linear")


def steps_for(peer: str, workload: str, tracks: int, quick: bool) -> int:
    """Steps measured; 0 leaves the peer out. Packages that loop in Python get fewer, never extrapolated."""
    if peer in LOOPING:
        if tracks >= 10_000:
            return 0 if quick else 1
        return {1: 50, 200: 2}[tracks] if quick else {1: 100, 200: 5}[tracks]
    if peer == "numpy":
        return {1: 20, 200: 5, 10_000: 2}[tracks] if quick else {1: 100, 200: 20, 10_000: 5}[tracks]
    return {1: 100, 200: 50, 10_000: 5}[tracks] if quick else {1: 100, 200: 100, 10_000: 20}[tracks]


def make_case(peer: str, problem: _problem.Problem, stepwise: bool) -> _problem.Case:
    """Prepare one package on one problem."""
    if peer.startswith("jink"):
        import _jink

        if stepwise:
            return _problem.Case(run=_jink.jink_step(problem))
        if peer == "jink-linear":
            return _problem.Case(run=_jink.jink_bank(problem, linear_shortcut=True))
        return _problem.Case(run=getattr(_jink, f"jink_{problem.workload}")(problem))
    if peer in ("jax", "jax-unrolled", "dynamax"):
        import _jax

        return _jax.make_form(problem, peer, stepwise)
    return importlib.import_module(f"_{peer}").make(problem, stepwise)  # type: ignore[no-any-return]


def missing(peer: str) -> str:
    """Say how to install the peer, or nothing where it is there."""
    module, command = NEEDS.get(peer, ("numpy", ""))
    return "" if importlib.util.find_spec(module) else f"not installed: {command}"


def compare(workload: str, tracks: int, stepwise: bool, peers: list[str], quick: bool, say: Any) -> list[dict]:
    """Time one workload in all packages, interleaved, and compare the estimates with the NumPy textbook."""
    import _numpy

    whole = _problem.make_problem(workload, tracks, 100 if tracks < 10_000 else 20)
    rows: list[dict[str, Any]] = []
    cases: dict[str, _problem.Case] = {}
    for peer in peers:
        if (peer in LINEAR_ONLY_ONCE and workload == "kf") or (peer == "jink-linear" and workload != "bank"):
            continue
        if stepwise and peer in ("jink-linear", "jax-unrolled"):
            continue
        steps = steps_for(peer, workload, tracks, quick)
        row: dict[str, Any] = {"workload": workload, "tracks": tracks, "stepwise": stepwise, "peer": peer}
        row |= {"steps": steps, "status": "ok", "note": missing(peer)}
        rows.append(row)
        if row["note"] or not steps:
            row["status"] = "skipped"
            row["note"] = row["note"] or "left out by --quick"
            continue
        say(f"{workload}, {tracks} tracks: preparing {peer}")
        try:
            cases[peer] = make_case(peer, whole.first(steps), stepwise)
        except NotImplementedError as error:
            row |= {"status": "skipped", "note": str(error)}
    truths: dict[int, _problem.Result] = {}
    for row in rows:
        if row["peer"] not in cases:
            continue
        case, steps = cases[row["peer"]], row["steps"]
        say(f"{workload}, {tracks} tracks: checking {row['peer']}")
        if steps not in truths:
            truths[steps] = _numpy.run(whole.first(steps))
        if case.prepare:
            case.prepare()
        raw = case.run()
        row["difference"] = _problem.difference(case.finish(raw) if case.finish else raw, truths[steps])
        row["compile_s"] = case.compile_s
        if not row["difference"] <= AGREEMENT.get(row["peer"], TWIN):
            row |= {"status": "error", "note": "estimates differ from the textbook's"}
    say(f"{workload}, {tracks} tracks{', single steps' if stepwise else ''}: timing")
    rounds = 3 if quick else 5
    repeats = {peer: 1 if peer in LOOPING and tracks >= 10_000 else rounds for peer in cases}
    seconds = _timing.interleaved(cases, repeats)
    for row in rows:
        if seconds.get(row["peer"]):
            scale = 1e6 / (tracks * row["steps"])
            busy, wall = zip(*seconds[row["peer"]], strict=True)
            row["us"], row["us_low"], row["us_high"] = (scale * s for s in _timing.spread(list(busy)))
            row["us_wall"] = scale * _timing.spread(list(wall))[0]
            row["repeats"] = len(seconds[row["peer"]])
    base = next((row.get("us") for row in rows if row["peer"] == "jink"), None)
    for row in rows:
        row["ratio"] = row["us"] / base if base and "us" in row else None
    return rows


def memory_of(peer: str, tracks: int, quick: bool) -> dict[str, Any]:
    """Give the growth of the resident set of this fresh process as it runs the bank."""
    steps = steps_for(peer, "bank", tracks, quick)
    problem = _problem.make_problem("bank", tracks, steps)
    warm_up = make_case(peer, _problem.make_problem("bank", 2, 2), False)
    if warm_up.prepare:
        warm_up.prepare()
    warm_up.run()
    _timing.reset_peak()
    before = _timing.resident_bytes()
    case = make_case(peer, problem, False)
    if case.prepare:
        case.prepare()
    case.run()
    return {"peer": peer, "tracks": tracks, "steps": steps, "mb": (_timing.peak_bytes() - before) / 1e6}


def memory(peers: list[str], quick: bool, say: Any) -> list[dict[str, Any]]:
    """Resident-set growth of every package, each in a fresh process."""
    rows = []
    for peer in peers:
        tracks = 200 if peer in LOOPING else 10_000
        if missing(peer):
            continue
        say(f"memory: {peer}")
        command = [sys.executable, __file__, "--memory-of", peer, "--tracks", str(tracks)]
        done = subprocess.run(command + ["--quick"] * quick, capture_output=True, text=True, check=False)
        last = (done.stdout.strip().splitlines() or [""])[-1]
        if done.returncode == 0 and last.startswith("{"):
            rows.append(json.loads(last))
        else:
            why = (done.stderr.strip().splitlines() or ["no output"])[-1]
            rows.append({"peer": peer, "tracks": tracks, "steps": 0, "mb": None, "note": why})
    return rows


def scaling(quick: bool, say: Any) -> list[dict[str, Any]]:
    """How jink's cost grows with tracks, modes and state size."""
    import _jink

    plans: list[tuple[str, int, int, int, Callable[[], Any]]] = []
    for tracks in (1, 10, 100, 1000) if quick else (1, 10, 100, 1000, 10_000):
        problem = _problem.make_problem("bank", tracks, 20)
        plans.append(("tracks", tracks, tracks, 20, lambda p=problem: _jink.jink_bank(p)))
    for kind, sizes in (("modes", (1, 2, 3, 6, 9)), ("state", (4, 6, 8, 10))):
        plans += [(kind, n, 200, 50, lambda k=kind, n=n: _jink.jink_scaling(k, n, 200, 50)) for n in sizes]
    rows = []
    for kind, size, tracks, steps, prepare in plans:
        say(f"scaling with {kind}: {size}")
        row: dict[str, Any] = {"kind": kind, "size": size, "tracks": tracks, "steps": steps}
        rows.append(row)
        try:
            case = _problem.Case(run=prepare())
        except NotImplementedError as error:
            row["note"] = str(error)
            continue
        case.run()
        seconds = _timing.interleaved({"jink": case}, {"jink": 3 if quick else 5})["jink"]
        row["us"] = 1e6 * _timing.spread([busy for busy, _ in seconds])[0] / (tracks * steps)
    return rows


def _number(value: float | None, form: str = "{:.3g}") -> str:
    if value is None:
        return "-"
    return f"{value:.0f}" if abs(value) >= 100 else form.format(value)


def show(console: Console, rows: list[dict[str, Any]]) -> None:
    """Print one table per workload."""
    for key in dict.fromkeys((r["workload"], r["tracks"], r["stepwise"]) for r in rows):
        workload, tracks, stepwise = key
        names = {
            "bank": "three-mode UKF bank, n = 7",
            "ukf": "one UKF, n = 7",
            "kf": "one Kalman filter, n = 4",
        }
        how = "one step per call from Python" if stepwise else f"{tracks} track{'s' * (tracks > 1)}"
        table = Table(title=f"{names[workload]} - {how}", title_justify="left")
        table.add_column("package")
        for head in ("us / track-step", "low - high", "wall", "x jink", "steps", "difference", "compile s"):
            table.add_column(head, justify="right")
        table.add_column("note")
        for row in (r for r in rows if (r["workload"], r["tracks"], r["stepwise"]) == key):
            bounds = f"{_number(row['us_low'])} - {_number(row['us_high'])}" if "us" in row else "-"
            compiled = f"{row['compile_s']:.1f}" if row.get("compile_s") else "-"
            figures = [_number(row.get("us")), bounds, _number(row.get("us_wall")), _number(row["ratio"])]
            figures += [str(row["steps"]), _number(row.get("difference"), "{:.1e}"), compiled]
            style = "red" if row["status"] == "error" else None
            table.add_row(row["peer"], *figures, row["note"], style=style)
        console.print(table)


def show_rest(console: Console, grown: list[dict[str, Any]], costs: list[dict[str, Any]]) -> None:
    """Print memory and scaling."""
    table = Table(title="memory: growth of the resident set, bank", title_justify="left")
    for head in ("package", "tracks", "steps", "MB", "note"):
        table.add_column(head, justify="left" if head in ("package", "note") else "right")
    for row in grown:
        table.add_row(row["peer"], str(row["tracks"]), str(row["steps"]), _number(row["mb"]), row.get("note", ""))
    console.print(table)
    table = Table(title="jink: cost as one thing grows", title_justify="left")
    for head in ("what", "size", "us / track-step", "note"):
        table.add_column(head, justify="left" if head in ("what", "note") else "right")
    for row in costs:
        table.add_row(row["kind"], str(row["size"]), _number(row.get("us")), row.get("note", ""))
    console.print(table)


def main() -> int:
    """Run the comparison; returns 1 where a package's estimates disagree."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument(
        "--quick", action="store_true", help="fewer steps, repeats and batches, no slow peer at 10 000 tracks"
    )
    parser.add_argument("--only", default="", help=f"comma-separated packages of: {', '.join(PEERS)}")
    parser.add_argument("--json", type=Path, default=None, help="write the rows here")
    parser.add_argument("--memory-of", choices=PEERS, default=None, help=argparse.SUPPRESS)
    parser.add_argument("--tracks", type=int, default=10_000, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.memory_of:
        print(json.dumps(memory_of(options.memory_of, options.tracks, options.quick)))
        return 0
    only = [name for name in options.only.split(",") if name]
    unknown = [name for name in only if name not in PEERS]
    if unknown:
        parser.error(f"--only must name packages of {', '.join(PEERS)}; got {unknown[0]!r}. Choose some of these.")
    peers = [peer for peer in PEERS if not only or peer == "jink" or peer in only]
    console, rows = Console(), []
    about = _timing.machine() | {"bound": BOUND, "command": " ".join(["python", *sys.argv])}
    console.print(", ".join(f"{name} {value}" for name, value in about.items()), highlight=False)
    progress = Progress(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console)
    with progress:
        task = progress.add_task("starting", total=None)

        def say(text: str) -> None:
            progress.update(task, description=text)

        for workload in ("bank", "ukf", "kf"):
            batches = (200,) if options.quick and workload != "bank" else (1, 200, 10_000)
            for tracks, stepwise in [*((tracks, False) for tracks in batches), (1, True)]:
                new = compare(workload, tracks, stepwise, peers, options.quick, say)
                show(console, new)
                rows += new
        grown, costs = memory(peers, options.quick, say), scaling(options.quick, say)
        progress.remove_task(task)
    show_rest(console, grown, costs)
    if options.json:
        options.json.write_text(
            json.dumps({"about": about, "rows": rows, "memory": grown, "scaling": costs}, indent=1),
            encoding="utf-8",
        )
    return 1 if any(row["status"] == "error" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
