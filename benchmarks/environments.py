"""Time the environments beside Gymnasium's CartPole: one target, a loop over singles, one native vector.

python benchmarks/environments.py                        # the full comparison and the scaling curve, some minutes
python benchmarks/environments.py --quick                # a first answer within a minute or so
python benchmarks/environments.py --out rows.parquet     # rows for later (.parquet or .json)
python benchmarks/environments.py --only AdaptiveFactor  # environments whose name contains this

An env-step is one decision of one target, whole episodes with their resets included; actions are drawn beforehand,
compilation happens in a round that is not counted. Cases take turns, so that a busy moment hits all of them alike; the
figure is the median of the rounds, wall time, with processor time beside it (two threads count twice).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import jink.envs  # noqa: F401  (registers the environments)

OURS = ("jink/AdaptiveFactor-v0", "jink/AdaptiveFactorContinuous-v0", "jink/ManoeuvringTarget-v0")
CARTPOLE = "CartPole-v1"
TARGETS = {"native": 1024, "sync": 64}
CURVE = (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536)
AIMS = {("jink/AdaptiveFactor-v0", "native", 1024): 1e6, ("jink/AdaptiveFactor-v0", "single", 1): 4e4}
SEED = 0
# Random estimates lose every track at once, and the resets would be all that is timed.
OPTIONS: dict[str, dict[str, Any]] = {"jink/ManoeuvringTarget-v0": {"lost_after": math.inf}}


@dataclass
class Case:
    """One environment in one form, with what its rounds took."""

    env_id: str
    form: str
    targets: int
    steps: int
    walls: list[float]
    processor: list[float]

    @property
    def speed(self) -> float:
        """Env-steps per second, median of the rounds."""
        return self.steps * self.targets / statistics.median(self.walls)


def episode_steps(env_id: str) -> int:
    """Decisions of one whole episode; CartPole under random actions lasts some 20 steps, any number will do."""
    if env_id == CARTPOLE:
        return 300
    env = gymnasium.make(env_id)
    steps = env.unwrapped.rollout.source.steps - 1  # type: ignore[attr-defined]
    env.close()
    return int(steps)


def make_run(case: Case) -> tuple[Callable[[], None], Callable[[], None]]:
    """What one round does, and how it is closed: ``case.steps`` decisions of every target."""
    random, options = np.random.default_rng(SEED), OPTIONS.get(case.env_id, {})
    if case.form == "single":
        env = gymnasium.make(case.env_id, **options)
        env.action_space.seed(SEED)
        actions = [env.action_space.sample() for _ in range(min(case.steps, 4096))]
        env.reset(seed=SEED)

        def run_single() -> None:
            for i in range(case.steps):
                _, _, terminated, truncated, _ = env.step(actions[i % len(actions)])
                if terminated or truncated:
                    env.reset()

        return run_single, env.close
    if case.form == "sync":
        vector = gymnasium.make_vec(case.env_id, case.targets, vectorization_mode="sync", **options)
    else:
        vector = gymnasium.make_vec(case.env_id, case.targets, vectorization_mode="vector_entry_point", **options)
    vector.action_space.seed(SEED)
    batches = [vector.action_space.sample() for _ in range(8)]
    order = random.integers(len(batches), size=case.steps)
    vector.reset(seed=SEED)

    def run_vector() -> None:
        for i in order:
            vector.step(batches[i])

    return run_vector, vector.close


def plan(quick: bool, only: str, most: int) -> list[Case]:
    """The cases: every environment single, sync and native, then the curve of the native ones."""
    found: dict[tuple[str, str, int], Case] = {}
    ids = [env_id for env_id in (*OURS, CARTPOLE) if only.lower() in env_id.lower() or env_id == CARTPOLE]
    for env_id in ids:
        whole = episode_steps(env_id) + 1  # the autoreset takes a step
        curve = () if env_id not in OURS[::2] else CURVE[::4] if quick else CURVE
        for form, targets in (
            ("single", 1), ("sync", TARGETS["sync"]), ("native", TARGETS["native"]),
            *(("native", size) for size in curve),
        ):  # fmt: skip
            if targets > most:
                continue
            episodes = {"single": 20, "sync": 1}.get(form, max(1, min(64, 16384 // targets)))
            steps = whole * max(1, episodes // (4 if quick else 1))
            found.setdefault((env_id, form, targets), Case(env_id, form, targets, steps, [], []))
    return list(found.values())


def measure(cases: list[Case], rounds: int, console: Console) -> None:
    """All cases in turn, ``rounds`` times, after a round that compiles."""
    with Progress(
        TextColumn("{task.description:45}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
    ) as progress:
        bar = progress.add_task("", total=len(cases) * (rounds + 1))
        # Big ones are made, timed and closed one at a time: together they would not fit into memory.
        for group in ([case for case in cases if case.targets <= 4096], *[[c] for c in cases if c.targets > 4096]):
            runs = {}
            for case in group:
                progress.update(bar, description=f"compiling {case.env_id} {case.form} {case.targets}")
                runs[id(case)] = make_run(case)
                runs[id(case)][0]()
                progress.advance(bar)
            for _ in range(rounds):
                for case in group:
                    progress.update(bar, description=f"{case.env_id} {case.form} {case.targets}")
                    wall, busy = time.perf_counter(), time.process_time()
                    runs[id(case)][0]()
                    case.walls.append(time.perf_counter() - wall)
                    case.processor.append(time.process_time() - busy)
                    progress.advance(bar)
            for _, close in runs.values():
                close()


def rows_of(cases: list[Case]) -> list[dict[str, Any]]:
    """One row per case, with all that made it."""
    from _timing import machine

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    shared = {
        **machine(), "gymnasium": metadata.version("gymnasium"), "cores": cores,
        "command": " ".join(sys.argv), "seed": SEED,
    }  # fmt: skip
    return [
        {
            "environment": case.env_id, "form": case.form, "targets": case.targets, "steps": case.steps,
            "rounds": len(case.walls), "steps_per_s": case.speed,
            "slowest_per_s": case.steps * case.targets / max(case.walls),
            "fastest_per_s": case.steps * case.targets / min(case.walls),
            "processor_us_per_step": 1e6 * statistics.median(case.processor) / (case.steps * case.targets),
            "aim_per_s": AIMS.get((case.env_id, case.form, case.targets)), **shared,
        }
        for case in cases
    ]  # fmt: skip


def show(rows: list[dict[str, Any]], console: Console) -> None:
    """Print the table, CartPole's speed in the same form beside each row."""
    cartpole = {(row["form"], row["targets"]): row["steps_per_s"] for row in rows if row["environment"] == CARTPOLE}
    table = Table(title=f"Env-steps per second, {rows[0]['processor']}, {rows[0]['cores']} cores")
    for name in ("environment", "form", "targets", "steps/s", "slowest .. fastest", "CPU us/step", "x CartPole", "aim"):
        table.add_column(name, justify="left" if name in ("environment", "form") else "right")
    for row in rows:
        peer, aim = cartpole.get((row["form"], row["targets"])), row["aim_per_s"]
        met = "" if aim is None else f"{aim:,.0f} {'met' if row['steps_per_s'] >= aim else 'MISSED'}"
        table.add_row(
            row["environment"], row["form"], f"{row['targets']:,}", f"{row['steps_per_s']:,.0f}",
            f"{row['slowest_per_s']:,.0f} .. {row['fastest_per_s']:,.0f}", f"{row['processor_us_per_step']:.2f}",
            "" if peer is None else f"{row['steps_per_s'] / peer:.2f}", met,
        )  # fmt: skip
    console.print(table)


def save(rows: list[dict[str, Any]], path: Path) -> None:
    """Write the rows as Parquet or JSON, by the ending of the name."""
    if path.suffix == ".parquet":
        pd.DataFrame(rows).to_parquet(path)
    else:
        path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--quick", action="store_true", help="fewer rounds and sizes")
    parser.add_argument("--only", default="", help="part of an environment's name; CartPole is always there")
    parser.add_argument("--rounds", type=int, default=0, help="rounds per case (default 5, quick 3)")
    parser.add_argument("--most", type=int, default=CURVE[-1], help="largest number of targets")
    parser.add_argument("--out", type=Path, help="rows, .parquet or .json")
    options = parser.parse_args()
    console = Console()
    if options.out is not None and options.out.suffix not in (".parquet", ".json"):
        console.print(f"--out: file must end in .parquet or .json; got {options.out.name}. Rename it.")
        return 2
    cases = plan(options.quick, options.only, options.most)
    measure(cases, options.rounds or (3 if options.quick else 5), console)
    rows = rows_of(cases)
    show(rows, console)
    if options.out is not None:
        save(rows, options.out)
        console.print(f"rows: {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
