"""The suite of many targets: scenes of the library, from detections alone, the same initiation for every tracker."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.scene_library import SCENES
from jink.envs.scenery.scene_scans import scene_scans
from jink.envs.scenes import simulate_scene
from jink.estimators.metrics import gospa, identities
from jink.training.intervals import Measured, Score, measure, resample_runs
from jink.training.many_estimators import MANY, NETWORKED, ManyScales
from jink.training.weighted import mean

__all__ = ["CUTOFF", "MANY_CELLS", "QUICK", "RUNS", "ManyCell", "run_many"]

CUTOFF, RUNS = 200.0, 50
QUICK = ("crossing-v0", "parallel-v0", "births-v0")
_USUAL = (1.0, 50.0)
_SCALES = {
    "manoeuvring-crossing-v0": (10.0**0.5, 50.0), "three-targets-v0": (15.0**0.5, 150.0),
    "consensus-network-v0": (4.0, 20.0),
}  # fmt: skip
"""Acceleration, m/s^2, and speed, m/s, that trackers are told of scenes whose targets do not all fly straight."""
_DEGREE = np.pi / 180
_TURNS = {
    "manoeuvring-crossing-v0": ((3.0 * _DEGREE,), 10.0),
    "three-targets-v0": ((1.0 * _DEGREE, 3.0 * _DEGREE), 60.0),
}
"""Rates, rad/s, and sojourn, s, of the bank of turns that every tracker gets where targets manoeuvre."""


class ManyCell(NamedTuple):
    """One tracker on one scene."""

    scene: str
    estimator: str

    @property
    def scales(self) -> ManyScales:
        """What the tracker is told; clutter and detection probability it knows."""
        acceleration, speed = _SCALES.get(self.scene, _USUAL)
        rates, sojourn = _TURNS.get(self.scene, (None, 10.0))
        return ManyScales(SCENES[self.scene].axes, acceleration, speed, rates, sojourn, patience=np.inf)


MANY_CELLS = tuple(ManyCell(scene, name) for scene in SCENES for name in MANY if name not in NETWORKED)
"""Every cell of the suite, in the order of the table."""


def run_many(cell: ManyCell, runs: int, seed: int) -> tuple[Mapping[str, Measured], int]:
    """Simulate, track and score.

    Args:
        cell: of `MANY_CELLS`.
        runs: seeds.
        seed: the first; the same for every tracker.

    Returns:
        metric to number with its interval over runs, and how many scans there were. GOSPA: cut-off `CUTOFF`, order 2,
        mean over the scans of what is known at the time of the scan.
    """
    tracker = MANY[cell.estimator](cell.scales)
    scene = SCENES[cell.scene]
    tracker.run(scene_scans(simulate_scene(replace(scene, duration=min(scene.duration, 20.0)), seed)))  # compiles
    rows, count = [], 0
    for run in range(runs):
        data = simulate_scene(scene, seed + run)
        scans = scene_scans(data)
        began = time.perf_counter()
        found = tracker.run(scans)
        seconds = time.perf_counter() - began
        positions = found.sets()[1]
        distance = gospa(positions, data.truth.position, CUTOFF)
        kept = identities(positions, data.truth.position, CUTOFF)
        rows.append(
            (distance.distance.mean(), distance.missed_count.mean(), distance.false_count.mean(), kept.switches.sum(),
             kept.breaks.sum(), 1e3 * seconds / len(scans))
        )  # fmt: skip
        count += len(scans)
    names = (("gospa", "m"), ("missed", ""), ("false", ""), ("switches", ""), ("breaks", ""), ("time", "ms/scan"))
    values: NDArray[np.float64] = np.array(rows, dtype=np.float64)
    scores = {name: Score(mean(values[:, k]), unit) for k, (name, unit) in enumerate(names)}
    return measure(scores, resample_runs(runs, seed)), count
