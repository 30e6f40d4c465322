"""Hostile scans for every tracker of many targets: what must never happen, whatever the sensors report.

    python benchmarks/fuzz_scans.py --scans 10000 --seed 0

A round draws a tracker (PMHT in its forms, nearest neighbour, JPDA, a network), one to three sensors (positions, range
and bearing), targets and some twenty scans, and spoils them: NaN, infinite and absurd components, detections that
repeat bit for bit or nearly, thousands of false alarms, empty scans, sensors that stop, scans at one time, scans that
come late, jumps of hours, a single scan. Then it checks that

* nothing raises, and every number that comes out is finite, every covariance symmetric and positive;
* every row that went in is in the scans or counted as left out, and late scans are counted;
* ids are unique in a scan, weights of a detection sum to at most one, and so do those of a target that gives one;
* scans fed one by one give the tracks of the whole run bit for bit.

It prints what broke, how often and in which rounds; each round has a seed of its own, so ``--only ROUND`` repeats one
alone. Exit status 1 if anything broke.
"""

from __future__ import annotations

import argparse
import sys
import traceback
import warnings
from collections import defaultdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.envs.networks import line, metropolis_weights
from jink.estimators.motions import constant_velocity, known_turn
from jink.estimators.multitarget.consensus import Consensus
from jink.estimators.multitarget.distributed import DistributedPmht
from jink.estimators.multitarget.faults import Faults
from jink.estimators.multitarget.gnn import Gnn
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.jpda import Jpda
from jink.estimators.multitarget.network_state import frames_of
from jink.estimators.multitarget.open_network import OpenNetwork
from jink.estimators.multitarget.pmht import Pmht
from jink.estimators.multitarget.scans import Scans, ScanSensor
from jink.estimators.sensors import position, range_bearing

Floats = NDArray[np.float64]
SPOILT = (np.nan, np.inf, -np.inf, 1e300, -1e31, 1e29)
TRACKERS = ("pmht", "pmht-bank", "pmht-published", "pmht-annealed", "gnn", "gnn-bank", "jpda", "jpda-bank", "network")
CROWD = 2000


def motions(bank: bool) -> Any:
    if bank:
        return [known_turn(rate, acceleration_density=0.1) for rate in (0.0, 0.1, -0.1)]
    return constant_velocity(2, acceleration_density=1.0)


def make_tracker(name: str, sensors: int, rng: np.random.Generator) -> Any:
    rules = Initiation(
        speed=float(rng.choice([1.0, 30.0])), hits=2, scans=4, confirm=float(rng.choice([1.0, 8.0])),
        patience=float(rng.choice([5.0, np.inf])), separation=float(rng.choice([0.0, 20.0])), most=300,
    )  # fmt: skip
    motion, window = motions(name.endswith("bank")), int(rng.choice([1, 3, 10]))
    if name.startswith("gnn"):
        return Gnn(motion, initiation=rules)
    if name.startswith("jpda"):
        return Jpda(motion, initiation=rules, most=2000)
    if name == "network":
        faults = Faults(message_loss=float(rng.choice([0.0, 0.4])), dead=((0, 5.0, 9.0),), delays=((1, 2),))
        consensus = Consensus(metropolis_weights(line(4)), 5, str(rng.choice(["safe", "b", "N", "1"])), faults)
        order = str(rng.choice(["V1", "V2"]))
        tracker = DistributedPmht(motions(bool(rng.integers(2))), consensus, tuple(range(sensors)), order=order)
        return OpenNetwork(tracker, rules, patience=20.0)
    options: dict[str, Any] = {"window": window, "initiation": rules, "slide": int(rng.choice([1, 3]))}
    if name == "pmht-published":
        options |= {"assignment": "independent", "adaptive": 0, "correction": False, "priors": "updated"}
    if name == "pmht-annealed":
        options |= {"annealing": (8.0, 2.0), "clutter_prior": "missed"}
    return Pmht(motion, **options)


def draw_scans(rng: np.random.Generator) -> tuple[Floats, list[Floats], Floats, tuple[ScanSensor, ...]]:
    """Times, detections, sensor of each scan, sensors; as bad as they come."""
    count, K = int(rng.integers(1, 4)), int(rng.choice([1, 2, 20, 30], p=[0.05, 0.05, 0.6, 0.3]))
    sensors = []
    for _ in range(count):
        polar = rng.random() < 0.4
        model = (
            range_bearing((float(rng.choice([1.0, 30.0])), 0.01))
            if polar
            else position(2, float(rng.choice([0.01, 5])))
        )
        clutter = float(rng.choice([0.0, 1e-6, 3.0, 500.0]))
        detection = float(rng.choice([0.3, 0.9, 1.0]))
        sensors.append(ScanSensor(model, detection, clutter, float(rng.choice([100.0, 4e6]))))
    start = np.hstack([rng.uniform(-500, 500, (4, 2)), rng.normal(0, 10, (4, 2))])
    times = np.cumsum(rng.choice([0.0, 1e-9, 0.5, 1.0, 1e4], K, p=[0.15, 0.05, 0.3, 0.48, 0.02]))
    owner = rng.integers(0, count, K)
    stops = rng.integers(0, 2 * K, count)  # a sensor that stops reports empty scans
    found = []
    for k in range(K):
        there = start[:, :2] + min(times[k], 1e4) * start[:, 2:]
        values = [there[rng.random(4) < 0.8] + rng.normal(size=2)]
        crowd = CROWD if rng.random() < 0.01 else int(rng.poisson(2))
        values.append(rng.uniform(-1000, 1000, (crowd, 2)))
        z = np.vstack(values)
        if sensors[owner[k]].model.angular[-1]:
            z = np.column_stack([np.hypot(*z.T), np.arctan2(z[:, 1], z[:, 0])])
        if len(z) and rng.random() < 0.3:
            z = np.vstack([z, z[rng.integers(0, len(z), 3)]])
        if len(z) and rng.random() < 0.1:
            z = np.vstack([z, z + 1e-12])
        if len(z) and rng.random() < 0.3:
            z[rng.integers(0, len(z), 2), rng.integers(0, 2, 2)] = rng.choice(SPOILT, 2)
        found.append(np.zeros((0, 2)) if k >= stops[owner[k]] or rng.random() < 0.15 else z)
    if K > 3 and rng.random() < 0.3:
        times[int(rng.integers(1, K))] -= 3.0  # time goes backwards
    return times, found, owner.astype(np.float64), tuple(sensors)


def covariances_hold(cov: Floats) -> bool:
    scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))
    if not np.isfinite(cov).all() or (scale <= 0).any() or np.abs(cov - np.swapaxes(cov, -1, -2)).max(initial=0) > 0:
        return False
    return bool((np.linalg.eigvalsh(cov / (scale[..., :, None] * scale[..., None, :])) > -1e-7).all())


def play(number: int, seed: int) -> tuple[int, list[str]]:
    """A round: how many scans, and what broke."""
    rng = np.random.default_rng((seed, number))
    times, found, owner, sensors = draw_scans(rng)
    name = str(rng.choice(TRACKERS))
    scans = Scans.from_arrays(times, found, sensors, sensor=owner.astype(np.int64))
    broken, cleaning = [], scans.cleaning
    if len(scans.detections) + cleaning.not_finite + cleaning.repeated != sum(map(len, found)):
        broken.append("rows lost")
    if cleaning.reordered != int((times < np.maximum.accumulate(times)).sum()):
        broken.append("late scans not counted")
    tracker = make_tracker(name, len(sensors), rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # clusters of JPDA that are too large
        if name == "network":
            got = tracker.run(scans)
            if not (np.isfinite(got.mean).all() and covariances_hold(got.cov)):
                broken.append(f"{name}: numbers")
            return len(scans), broken + _ids(got.frame, got.id, len(frames_of(list(scans))), len(got.times))
        got = tracker.run(scans)
        if not all(np.isfinite(part).all() for part in (got.mean, got.smoothed_mean, got.hits, got.mode_probs)):
            broken.append(f"{name}: numbers")
        if not (covariances_hold(got.cov) and covariances_hold(got.smoothed_cov)):
            broken.append(f"{name}: covariances")
        broken += _ids(got.scan, got.id, len(scans), len(got.times))
        state, rows = tracker.start(scans.sensors, float(scans.times[0])), []
        for scan in scans:
            state, one = tracker.step(state, scan)
            rows.append(one.now.mean)
            each = np.bincount(one.newest.detection, one.newest.weight, minlength=len(scan.detections))
            own = np.bincount(one.newest.target, one.newest.weight)
            if each.max(initial=0) > 1 + 1e-6 or (name != "pmht-published" and own.max(initial=0) > 1 + 1e-6):
                broken.append(f"{name}: weights")
        if not np.array_equal(np.concatenate(rows), got.mean):
            broken.append(f"{name}: steps differ from run")
    return len(scans), sorted(set(broken))


def _ids(scan: NDArray[np.int64], ids: NDArray[np.int64], wanted: int, given: int) -> list[str]:
    rows = np.stack([scan, ids], axis=1)
    return (["ids repeat"] if len(np.unique(rows, axis=0)) < len(rows) else []) + (
        ["scans missing"] if wanted != given else []
    )


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--scans", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int)
    options = parser.parse_args()
    done, number, broken = 0, 0, defaultdict(list)
    rounds = None if options.only is None else [options.only]
    while done < options.scans if rounds is None else rounds:
        which = number if rounds is None else rounds.pop()
        try:
            scans, wrong = play(which, options.seed)
        except Exception as error:
            scans, wrong = 1, [f"raised {type(error).__name__}: {str(error)[:100]}"]
            if options.only is not None:
                traceback.print_exc()
        for what in wrong:
            broken[what].append(which)
        done, number = done + scans, number + 1
    print(f"{done} scans in {number} rounds, seed {options.seed}: {sum(map(len, broken.values()))} broken rules")
    for what, where in broken.items():
        print(f"  {what}: {len(where)} rounds, for instance {where[:8]}")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
