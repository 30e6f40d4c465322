"""Many targets: PMHT against global nearest neighbour, JPDA and Stone Soup.

Scenes of the library from detections alone: the same initiation and the same motion, or bank of turns, for all of ours;
GOSPA (cut-off 200 m, order 2, mean over scans and seeds) of what each tracker knows at the time of the scan and, for
PMHT, after its window; paired differences from nearest neighbour and JPDA with the same motions, 95 %; identity
switches; processor time.
Then 2 to 200 targets on straight courses in a plane whose size grows with their number, starts known to all, one
false alarm per target and scan: time per scan and GOSPA (cut-off 20 m). Stone Soup's PMHT gives smoothed states, to
be held against our smoothed ones; it runs for few targets only.

python benchmarks/multitarget.py [--seeds 50] [--scenes NAME ...] [--targets 2 5 10 20 50 100 200] [--peer-targets 5]
    [--only scenes|scaling]
"""

from __future__ import annotations

import argparse
import datetime
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from jink.envs.scene_library import get_scene
from jink.envs.scenery.scene_scans import scene_scans
from jink.envs.scenes import simulate_scene
from jink.estimators.markov import MarkovChain
from jink.estimators.metrics.target_sets import gospa
from jink.estimators.motions import constant_velocity, known_turn
from jink.estimators.multitarget.gnn import Gnn
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.jpda import Jpda
from jink.estimators.multitarget.pmht import KnownTracks, Pmht
from jink.estimators.multitarget.scans import Scans, ScanSensor
from jink.estimators.sensors import make_sensor

DEGREE = np.pi / 180
# Scene, acceleration density of one motion (m^2/s^3), speed of new targets (m/s), turn rates (degrees/s) and sojourn
# (s) of the bank: every tracker of a row has the same motion or the same bank.
SCENES = (
    ("crossing-v0", 1.0, 50.0, None, 0.0),
    ("crossing-medium-clutter-v0", 1.0, 50.0, None, 0.0),
    ("crossing-high-clutter-v0", 1.0, 50.0, None, 0.0),
    ("parallel-v0", 1.0, 50.0, None, 0.0),
    ("formation-split-v0", 1.0, 50.0, None, 0.0),
    ("births-v0", 1.0, 50.0, None, 0.0),
    ("manoeuvring-crossing-v0", 10.0, 50.0, (0.0, 3.0, -3.0), 10.0),
    ("three-targets-v0", 15.0, 150.0, (0.0, 1.0, -1.0, 3.0, -3.0), 60.0),
    ("sensor-network-v0", 1.0, 50.0, None, 0.0),
)
WOBBLE = 0.05**2  # of a bank's modes, share of the acceleration density
SIDE, STEPS, SIGMA, DETECTION = 200.0, 20, 1.0, 0.9
Tracker = Callable[[Scans, KnownTracks | None], Any]


def published(motion: Any, **options: Any) -> Pmht:
    return Pmht(motion, assignment="independent", adaptive=0, correction=False, **options)


def against(scores: np.ndarray, others: np.ndarray) -> str:
    """Mean of paired differences with 95 % either way."""
    off = scores - others
    return f"{off.mean():+.1f} +- {1.96 * off.std(ddof=1) / np.sqrt(len(off)):.1f}" if len(off) > 1 else ""


def scenes(seeds: int, names: list[str] | None, console: Console) -> None:
    table = Table(
        "scene", "motion", "tracker", "GOSPA [m]", "- gnn [m]", "- jpda [m]", "smoothed [m]", "missed", "false",
        "switches", "ms/scan",
    )  # fmt: skip
    for name, density, speed, rates, sojourn in SCENES:
        if names and name not in names:
            continue
        initiation = Initiation(speed=speed)
        motions: dict[str, tuple[Any, ...]] = {"one": (constant_velocity(2, acceleration_density=density),)}
        if rates is not None:
            bank = [known_turn(rate * DEGREE, acceleration_density=WOBBLE * density) for rate in rates]
            motions["bank"] = (bank, MarkovChain.from_sojourns([sojourn] * len(bank)))
        trackers: dict[tuple[str, str], Any] = {}
        for kind, motion in motions.items():
            trackers[kind, "pmht"] = Pmht(*motion, initiation=initiation)
            if kind == "one":
                trackers[kind, "pmht as published"] = published(*motion, initiation=initiation)
                trackers[kind, "pmht, not turbo"] = Pmht(*motion, initiation=initiation, extrinsic=False)
            trackers[kind, "gnn"] = Gnn(*motion, initiation=initiation)
            trackers[kind, "jpda"] = Jpda(*motion, initiation=initiation)
        rows: dict[tuple[str, str], list[tuple[float, ...]]] = {key: [] for key in trackers}
        for seed in range(seeds):
            data = simulate_scene(get_scene(name), seed)
            scans = scene_scans(data)
            for key, tracker in trackers.items():
                tracker.run(scans) if seed == 0 else None
                begin = time.process_time()
                found = tracker.run(scans)
                spent = 1e3 * (time.process_time() - begin) / len(scans)
                now = gospa(found.sets()[1], data.truth.position, 200.0)
                late = gospa(found.sets(smoothed=True)[1], data.truth.position, 200.0)
                switches = sum(int((np.diff(row[row >= 0]) != 0).sum()) for row in now.estimate_of)
                rows[key].append(
                    (now.distance.mean(), late.distance.mean(), now.missed_count.mean(), now.false_count.mean(),
                     switches, spent)
                )  # fmt: skip
        for (kind, label), values in rows.items():
            every = np.array(values)
            mean, smooth = every.mean(axis=0), f"{every[:, 1].mean():.1f}" if label.startswith("pmht") else ""
            table.add_row(
                name, kind, label, f"{mean[0]:.1f}",
                *(against(every[:, 0], np.array(rows[kind, other])[:, 0]) for other in ("gnn", "jpda")), smooth,
                f"{mean[2]:.2f}", f"{mean[3]:.2f}", f"{mean[4]:.1f}", f"{np.median(every[:, 5]):.2f}",
            )  # fmt: skip
    console.print(table)


def many(targets: int, seed: int) -> tuple[Scans, KnownTracks, np.ndarray]:
    """Straight targets in a plane of 200 m x 200 m per target, as many false alarms as targets per scan."""
    rng = np.random.default_rng(seed)
    side = SIDE * np.sqrt(targets)
    start = np.hstack([rng.uniform(0, side, (targets, 2)), rng.normal(0, 3, (targets, 2))])
    times = np.arange(float(STEPS))
    truth = start[:, None, :2] + times[None, :, None] * start[:, None, 2:]
    scans = []
    for k in range(STEPS):
        seen = truth[:, k][rng.random(targets) < DETECTION]
        noise = SIGMA * rng.normal(size=seen.shape)
        scans.append(np.vstack([seen + noise, rng.uniform(0, side, (rng.poisson(targets), 2))]))
    sensor = ScanSensor(make_sensor("position", sigma=SIGMA), DETECTION, targets, side**2)
    first = start + rng.normal(size=start.shape) * [SIGMA, SIGMA, 1.0, 1.0]
    return Scans.from_arrays(times, scans, sensor), KnownTracks(first, np.diag([1.0, 1, 1, 1]), 0.0), truth


def scaling(counts: list[int], peer_targets: int, seeds: int, console: Console) -> None:
    motion = constant_velocity(2, acceleration_density=0.01)
    ours: dict[str, Any] = {
        "pmht": Pmht(motion, initiation=None),
        "pmht as published": published(motion, initiation=None),
        "gnn": Gnn(motion, initiation=None),
        "jpda": Jpda(motion, initiation=None),
    }
    table = Table("targets", "tracker", "ms/scan", "us per scan and target", "GOSPA [m]", "smoothed [m]", "scans done")
    for count in counts:
        trackers: dict[str, Tracker] = {name: tracker.run for name, tracker in ours.items()}
        if count <= peer_targets:
            trackers |= {"Stone Soup PMHT": stonesoup_pmht, "Stone Soup JPDA": stonesoup_jpda}
        for name, run in trackers.items():
            spent, scores, late, done = [], [], [], 0
            for seed in range(1 if name.startswith("Stone") else seeds):
                scans, known, truth = many(count, seed)
                if seed == 0 and not name.startswith("Stone"):
                    run(scans, known)
                begin = time.process_time()
                found = run(scans, known)
                spent.append(1e3 * (time.process_time() - begin) / STEPS)
                positions = found if isinstance(found, np.ndarray) else found.sets()[1]
                smooth = found if isinstance(found, np.ndarray) else found.sets(smoothed=True)[1]
                late.append(gospa(smooth, truth, 20.0).distance.mean())
                done = int(np.isfinite(positions[0, :, 0]).sum())
                scores.append(gospa(positions, truth, 20.0).distance.mean())
            ms = float(np.median(spent))
            now = "" if name == "Stone Soup PMHT" else f"{np.mean(scores):.3f}"
            smoothed = f"{np.mean(late):.3f}" if "pmht" in name.lower() else ""
            table.add_row(str(count), name, f"{ms:.3f}", f"{1e3 * ms / count:.1f}", now, smoothed, str(done))
    console.print(table)


EPOCH = datetime.datetime(2020, 1, 1)


def _parts(known: KnownTracks) -> tuple[Any, Any, list[Any]]:
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.types.state import GaussianState

    model = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.01)] * 2)
    sensor = LinearGaussian(4, (0, 2), SIGMA**2 * np.eye(2))
    order = [0, 2, 1, 3]
    states = [
        GaussianState(mean[order], cov[np.ix_(order, order)], timestamp=EPOCH)
        for mean, cov in zip(known.mean, known.cov, strict=True)
    ]
    return model, sensor, states


def _frames(scans: Scans, sensor: Any) -> list[tuple[datetime.datetime, Any]]:
    from stonesoup.types.detection import Detection

    frames = []
    for scan in scans:
        stamp = EPOCH + datetime.timedelta(seconds=scan.time)
        found = [Detection(z[:, None], timestamp=stamp, measurement_model=sensor) for z in scan.detections]
        frames.append((stamp, found))
    return frames


def stonesoup_pmht(scans: Scans, known: KnownTracks | None) -> np.ndarray:
    """Its PMHT in batches of ten that overlap by nine, on scans one second after the start and later."""
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.smoother.kalman import KalmanSmoother
    from stonesoup.tracker.pmht import PMHTTracker
    from stonesoup.updater.kalman import KalmanUpdater

    assert known is not None
    model, sensor, states = _parts(known)
    side = float(np.sqrt(scans.sensors[0].volume))
    tracker = PMHTTracker(
        detector=iter(_frames(scans, sensor)[1:]),
        predictor=KalmanPredictor(model), smoother=KalmanSmoother(model), updater=KalmanUpdater(sensor),
        meas_range=np.array([[0, side], [0, side]]), clutter_rate=scans.sensors[0].clutter,
        batch_len=10, overlap_len=9, update_log_pi=False, detection_probability=DETECTION, init_priors=states,
    )  # fmt: skip
    out = np.full((len(states), len(scans), 2), np.nan)
    starts = {id(track): track for track in tracker.tracks}
    try:
        for _ in tracker:
            pass
    except RuntimeError:  # the detector ended inside a batch
        pass
    for m, track in enumerate(starts.values()):
        for state in track:
            k = round((state.timestamp - EPOCH).total_seconds())
            out[m, k] = np.asarray(state.mean, dtype=float).ravel()[[0, 2]]
    return out


def stonesoup_jpda(scans: Scans, known: KnownTracks | None) -> np.ndarray:
    """Its JPDA with a gate of five standard deviations."""
    from stonesoup.dataassociator.probability import JPDA
    from stonesoup.functions import gm_reduce_single
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.array import StateVectors
    from stonesoup.types.track import Track
    from stonesoup.types.update import GaussianStateUpdate
    from stonesoup.updater.kalman import KalmanUpdater

    assert known is not None
    model, sensor, states = _parts(known)
    updater = KalmanUpdater(sensor)
    guess = PDAHypothesiser(
        predictor=KalmanPredictor(model), updater=updater, prob_detect=DETECTION, prob_gate=1 - 3.7e-6,
        clutter_spatial_density=scans.sensors[0].density,
    )  # fmt: skip
    associator, tracks = JPDA(hypothesiser=guess), [Track([state]) for state in states]
    out = np.full((len(states), len(scans), 2), np.nan)
    for k, (stamp, found) in enumerate(_frames(scans, sensor)):
        joint = associator.associate(set(tracks), set(found), stamp)
        for m, track in enumerate(tracks):
            means, covs, weights = [], [], []
            for one in joint[track]:
                posterior = updater.update(one) if one else one.prediction
                means.append(posterior.state_vector)
                covs.append(posterior.covar)
                weights.append(float(one.probability))
            mean, cov = gm_reduce_single(StateVectors(means), np.stack(covs, axis=2), np.array(weights))
            track.append(GaussianStateUpdate(mean, cov, joint[track], stamp))
            out[m, k] = np.asarray(mean, dtype=float).ravel()[[0, 2]]
    return out


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--scenes", nargs="+")
    parser.add_argument("--targets", type=int, nargs="+", default=[2, 5, 10, 20, 50, 100, 200])
    parser.add_argument("--peer-targets", type=int, default=5)
    parser.add_argument("--only", choices=("scenes", "scaling"))
    options = parser.parse_args()
    console = Console(width=140)
    if options.only != "scaling":
        scenes(options.seeds, options.scenes, console)
    if options.only != "scenes":
        scaling(options.targets, options.peer_targets, min(options.seeds, 3), console)


if __name__ == "__main__":
    main()
