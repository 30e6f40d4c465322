"""Learn intents from simulated tracks and compare the learnt bank with the bank of true laws, seed by seed.

python benchmarks/learn_intents.py run --world three --seeds 0-9 --out docs/results/learn_three.jsonl
python benchmarks/learn_intents.py show docs/results/learn_three.jsonl
python benchmarks/learn_intents.py tune --world three        # scales of the true bank, from 384 tracks of its own

A seed learns from 128 tracks of 100 rows and is judged on 128 others, the same for every seed: as they are, at half and
twice the time step, with the whole scene 0.4 and 2.5 times as large (the noise stays), and turned. Rows are appended as
they finish; a seed that is in the file is not run again. RMSE over all rows of all tracks; 95 % intervals over seeds.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))

from _intent_worlds import SIGMA, WORLDS, World, simulate, start_scales, true_bank
from _scoring import climb

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank
from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks

Floats = NDArray[np.float64]
TRACKS, STEPS, TESTS = 128, 100, 128
TUNED_ON, TUNING_SEED, TEST_SEED = 384, 5_000_000, 7_000_000
SCALES: dict[str, tuple[float, ...]] = {
    "three": (-7.204, 0.0, 3.2, -7.204, -19.274, 3.504, -7.295, -8.391, 2.621),
}
"""Logs of the true banks' scales, from ``tune``."""


def cases(world: World) -> dict[str, World]:
    """The world as it is learnt, and as it is not."""
    return {
        "as learnt": world,
        "dt x 0.5": world.with_(dt=0.5 * world.dt, steps=2 * world.steps),
        "dt x 2": world.with_(dt=2.0 * world.dt, steps=world.steps // 2),
        "speed x 0.4": world.with_(size=0.4),
        "speed x 2.5": world.with_(size=2.5),
        "turned 57 deg": world.with_(turned=1.0),
    }


def judge(bank: Bank, tracks: Tracks) -> dict[str, float]:
    """Position RMSE, nats per row, NIS over its dimension, NEES of position over its own; NIS without first rows."""
    found = BankEstimator(bank, threads=2).run(tracks.measurements, tracks.times)
    away = found.position - tracks.truth
    cov = found.covariance[..., :2, :2]
    nees = np.einsum("bti,btij,btj->bt", away, np.linalg.inv(cov), away) / 2.0
    per_track = nees.mean(axis=1)
    return {
        "rmse": float(np.sqrt(np.square(away).sum(axis=-1).mean())),
        "nats": float(found.log_likelihood[:, 1:].mean()),
        "nis": float(found.nis[:, 1:].mean() / 2.0),
        "nees": float(per_track.mean()),
        "nees_error": float(per_track.std() / math.sqrt(len(per_track))),
        "modes": float(len(bank.modes)),
    }


def run(name: str, seeds: list[int], out: Path, count: int, steps: int) -> None:
    """Learn and judge, one row per seed."""
    import torch

    from jink.intent.learner import IntentLearner

    torch.set_num_threads(1)
    world = WORLDS[name].with_(steps=steps)
    done = {(row["world"], row["seed"], row["tracks"]) for row in _rows(out)}
    tests = {case: simulate(variant, TESTS, TEST_SEED) for case, variant in cases(world).items()}
    scales = np.array(SCALES[name]) if name in SCALES else start_scales(world)
    truth = {case: judge(true_bank(v, scales), tests[case]) for case, v in cases(world).items()}
    for seed in seeds:
        if (name, seed, count) in done:
            continue
        tracks = simulate(world, count, 1000 * seed)
        wall, cpu = time.perf_counter(), time.process_time()
        learner = IntentLearner(seed=seed).fit(tracks)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        bank = learner.bank(position(2, SIGMA))
        row = {
            "world": name,
            "seed": seed,
            "tracks": count,
            "rows": steps,
            "intents": len(learner.model_.intents),
            "truth": world.intents,
            "wall_s": round(wall, 1),
            "cpu_s": round(cpu, 1),
            "load": round(os.getloadavg()[0], 1),
            "curve": [list(point) for point in learner.curve_],
            "learnt": {case: judge(bank, tests[case]) for case in tests},
            "true": truth,
            "describe": learner.model_.describe(),
            "machine": platform.processor() or platform.machine(),
        }
        with out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(f"seed {seed}: {row['intents']} intents, {cpu:.0f} s of processor time", flush=True)
        print(learner.model_.describe(), flush=True)


def show(out: Path) -> None:
    """Tables of a file of rows."""
    rows = list(_rows(out))
    for name in sorted({row["world"] for row in rows}):
        full = [row for row in rows if row["world"] == name and row["tracks"] == TRACKS]
        if not full:
            continue
        right = sum(row["intents"] == row["truth"] for row in full)
        cpu = [row["cpu_s"] for row in full]
        print(f"{name}: right number of intents in {right} of {len(full)}; found {[row['intents'] for row in full]}")
        print(f"processor time {np.median(cpu):.0f} s (median), {max(cpu):.0f} s at most, of one core")
        print("| case | RMSE learnt | true | ratio [95 %] | nats gap [95 %] | NIS/2 | NEES/2 | its NIS/2, NEES/2 |")
        print("|---|---|---|---|---|---|---|---|")
        for case in full[0]["learnt"]:
            learnt = {key: np.array([row["learnt"][case][key] for row in full]) for key in full[0]["learnt"][case]}
            true = {key: np.array([row["true"][case][key] for row in full]) for key in full[0]["true"][case]}
            ratio, gap = learnt["rmse"] / true["rmse"], true["nats"] - learnt["nats"]
            print(
                f"| {case} | {learnt['rmse'].mean():.2f} | {true['rmse'].mean():.2f} | {_mean(ratio)} "
                f"| {_mean(gap, 4)} | {learnt['nis'].mean():.3f} | {learnt['nees'].mean():.3f} "
                f"| {true['nis'].mean():.3f}, {true['nees'].mean():.3f} |"
            )
    sizes = sorted({(row["tracks"], row["cpu_s"]) for row in rows if row["tracks"] != TRACKS})
    if sizes:
        print("tracks and processor seconds:", sizes)


def _mean(values: Floats, digits: int = 3) -> str:
    """A mean with its bootstrap interval over seeds."""
    rng = np.random.default_rng(1)
    draws = values[rng.integers(0, len(values), (2000, len(values)))].mean(axis=1)
    low, high = np.quantile(draws, (0.025, 0.975))
    return f"{values.mean():.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def tune(name: str, start: Floats | None = None) -> None:
    """Print the scales of a true bank that make tracks of its own likeliest."""
    world = WORLDS[name]
    tracks = simulate(world, TUNED_ON, TUNING_SEED)

    def rows(logs: Floats) -> Floats:
        found = BankEstimator(true_bank(world, logs)).run(tracks.measurements, tracks.times)
        return np.asarray(found.log_likelihood[:, 1:].ravel())

    first = start_scales(world) if start is None else start
    largest = np.full(first.size, 1.0)
    for point in climb(rows, first, centre=first, width=np.full(first.size, 4.0), iterations=12, largest=largest):
        print(f"{point.value:.5f}", np.round(point.at, 3).tolist(), flush=True)


def _rows(path: Path) -> Iterator[dict[str, Any]]:
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            yield json.loads(line)


def main() -> int:
    """Run, show or tune."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="what", required=True)
    runs = parts.add_parser("run")
    runs.add_argument("--world", choices=tuple(WORLDS), default="three")
    runs.add_argument("--seeds", default="0-9")
    runs.add_argument("--out", type=Path, required=True)
    runs.add_argument("--tracks", type=int, default=TRACKS)
    runs.add_argument("--steps", type=int, default=STEPS)
    shows = parts.add_parser("show")
    shows.add_argument("out", type=Path)
    tunes = parts.add_parser("tune")
    tunes.add_argument("--world", choices=tuple(WORLDS), default="three")
    options = parser.parse_args()
    if options.what == "show":
        show(options.out)
    elif options.what == "tune":
        tune(options.world)
    else:
        low, _, high = options.seeds.partition("-")
        seeds = list(range(int(low), int(high or low) + 1))
        run(options.world, seeds, options.out, options.tracks, options.steps)
    return 0


if __name__ == "__main__":
    sys.exit(main())
