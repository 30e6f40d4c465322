"""One core, one thread, interleaved repeats: how the comparison is timed, and how memory is read."""

from __future__ import annotations

import contextlib
import os
import platform
import resource
import statistics
import sys
import time
from importlib import metadata
from pathlib import Path

from _problem import Case

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS",
)  # fmt: skip
_SHORTEST_S = 0.01


def use_one_core() -> str:
    """Bind this process to one core and its libraries to one thread; re-executes Python if set too late.

    Returns:
        what was bound, in words.
    """
    wanted = dict.fromkeys(_THREAD_VARIABLES, "1")
    wanted["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    if any(os.environ.get(name) != value for name, value in wanted.items()):
        os.environ.update(wanted)
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    if not hasattr(os, "sched_setaffinity"):
        return "one thread (this system cannot bind a process to a core)"
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    return f"one thread on core {core}"


def interleaved(cases: dict[str, Case], repeats: dict[str, int]) -> dict[str, list[tuple[float, float]]]:
    """Time every case in turn, round after round, so that a busy moment hits all of them alike.

    Processor time of the process is the figure to compare: on a machine that others use too, wall time
    charges long runs with their neighbours' turns and short runs not, which would favour the fast packages.

    Args:
        cases: by name.
        repeats: rounds in which a case takes part.

    Returns:
        (processor, wall) seconds per run of every round, by name; runs shorter than 10 ms are repeated
        within a round.
    """
    inner: dict[str, int] = {}
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
    for turn in range(max(repeats.values(), default=0)):
        for name, case in cases.items():
            if turn >= repeats[name]:
                continue
            if name not in inner:
                once = _once(case, 1)
                inner[name] = 1 if case.prepare else max(1, round(_SHORTEST_S / max(once[1], 1e-9)))
                if repeats[name] == 1:
                    seconds[name].append(once)
                    continue
            seconds[name].append(_once(case, inner[name]))
    return seconds


def _once(case: Case, count: int) -> tuple[float, float]:
    if case.prepare:
        case.prepare()
    wall, busy = time.perf_counter(), time.process_time()
    for _ in range(count):
        case.run()
    return (time.process_time() - busy) / count, (time.perf_counter() - wall) / count


def spread(values: list[float]) -> tuple[float, float, float]:
    """Give median, smallest and largest."""
    return statistics.median(values), min(values), max(values)


def resident_bytes() -> int:
    """Resident set of this process now (its peak where the system does not tell)."""
    try:
        with Path("/proc/self/statm").open(encoding="ascii") as file:
            return int(file.read().split()[1]) * resource.getpagesize()
    except OSError:
        return peak_bytes()


def reset_peak() -> None:
    """Start the peak anew where Linux allows it."""
    # Elsewhere the peak counts from the start of the process.
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_bytes() -> int:
    """Largest resident set of this process; on Linux not ru_maxrss, which children inherit."""
    try:
        with Path("/proc/self/status").open(encoding="ascii") as file:
            return 1024 * next(int(line.split()[1]) for line in file if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024


def machine() -> dict[str, str]:
    """Processor, Python and the versions of everything compared."""
    name = platform.processor() or platform.machine()
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as file:
            name = next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        pass  # the generic name above stands
    found = {"processor": name, "python": platform.python_version()}
    for package in ("jink", "numpy", "scipy", "numba", "filterpy", "stonesoup", "jax", "dynamax"):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found
