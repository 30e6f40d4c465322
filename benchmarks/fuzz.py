"""Hostile tracks for every estimator: what must never happen, whatever is measured.

    python benchmarks/fuzz.py --steps 1000000 --seed 0

A round draws a bank, a sensor, a start and a few short tracks, spoils them (NaN, inf, 1e300, missing components and
rows, times that repeat or jump by hours, noise from 1e-9 to 1e9, teleports, broken noise matrices and sensor places),
runs them and checks every number that comes out. It prints what broke, how often and in which rounds; each round
has its own seed, so ``--only ROUND`` repeats one alone. Exit status 1 if anything broke.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections import Counter, defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motions import (
    circle,
    constant_acceleration,
    constant_velocity,
    coordinated_turn,
    drag_coast,
    helix,
    jerk,
    known_turn,
    polar_turn,
    singer,
    spatial_turn,
    weave,
)
from jink.estimators.program import INTERACTIONS
from jink.estimators.recipes import RECIPES, Scales
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import (
    bearing,
    bearing_elevation,
    position,
    range_bearing,
    range_bearing_elevation,
    range_bearing_rate,
    ranges,
)
from jink.estimators.status import MISSING, OK, STARTING

Floats = NDArray[np.float64]

SENSORS_2D = ("position", "range-bearing", "range-bearing-rate", "bearing", "bearing-ray", "ranges")
SENSORS_3D = ("position", "range-bearing-elevation", "bearing-elevation", "ranges")
BANKS_2D = (*RECIPES, "all-2d", "curved-2d", "sixteen")
BANKS_3D = (*RECIPES, "all-3d")
_INDEFINITE = -1e-6  # of a correlation matrix: a thousandth of a standard deviation; rounding stays far below


@dataclass
class Round:
    """One drawn problem: what to run, on what, and how it was named."""

    title: str
    bank: Bank
    z: Floats
    times: Floats
    noise: Floats | None
    sensors: Floats | None
    lengths: NDArray[np.int64]
    prior: Prior | None


def draw_round(number: int, seed: int, tracks: int, rows: int) -> Round:
    """Round ``number``: banks, sensors and interactions in turn, everything else at random."""
    rng = np.random.default_rng([seed, number])
    axes = 2 + number % 2
    kinds, banks = (SENSORS_2D, BANKS_2D) if axes == 2 else (SENSORS_3D, BANKS_3D)
    turn = number // 2
    kind = kinds[turn % len(kinds)]
    name = banks[(turn // len(kinds)) % len(banks)]
    interaction = list(INTERACTIONS)[rng.integers(len(INTERACTIONS))]
    scale = _log_uniform(rng, 1.0, 1e7)
    sensor = _sensor(kind, axes, scale, rng)
    bank = _bank(name, sensor, interaction, rng)
    times = _times(rng, tracks, rows)
    sensors = _sensor_states(rng, tracks, rows, axes, scale)
    z = _measure(rng, sensor, _paths(rng, times, axes, scale), sensors)
    noise = _noise(rng, sensor, tracks, rows)
    _spoil(rng, z, noise, sensors)
    lengths = rng.choice([0, 1, 2, rows // 2, rows], size=tracks, p=[0.05, 0.05, 0.05, 0.15, 0.7])
    title = f"{name} {interaction if len(bank.modes) > 1 else '-'} {kind} {axes}-D"
    return Round(title, bank, z, times, noise, sensors, lengths, _prior(rng, bank, scale))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sensor(kind: str, axes: int, scale: float, rng: np.random.Generator) -> Sensor:
    metres, angle, rate = (_log_uniform(rng, 1e-9, 1e9) for _ in range(3))
    match kind:
        case "position":
            return position(axes, metres)
        case "range-bearing":
            return range_bearing((metres, angle))
        case "range-bearing-rate":
            return range_bearing_rate((metres, angle, rate))
        case "range-bearing-elevation":
            return range_bearing_elevation((metres, angle, angle))
        case "bearing":
            return bearing(angle)
        case "bearing-ray":
            return bearing(angle, range_prior=(scale, scale / 3))
        case "bearing-elevation":
            return bearing_elevation(angle, range_prior=(scale, scale / 3))
        case "ranges":
            return ranges(rng.normal(size=(axes + 2, axes)) * scale, metres)
    raise ValueError(f"fuzz: kind must be a known sensor; got {kind!r}. Use one of {SENSORS_2D + SENSORS_3D}.")


def _bank(name: str, sensor: Sensor, interaction: str, rng: np.random.Generator) -> Bank:
    axes = sensor.axes
    if name in RECIPES:
        scales = Scales(_log_uniform(rng, 1e-3, 1e3), _log_uniform(rng, 0.1, 1e4), None, _log_uniform(rng, 0.1, 1e4))
        bank = RECIPES[name](sensor, scales).with_(learns_noise=False)  # problems are run by a BankEstimator
        return bank.with_(interaction=interaction) if len(bank.modes) > 1 else bank
    strong = _log_uniform(rng, 1e-6, 1e6)
    straight = [
        constant_velocity(axes, acceleration_density=strong),
        constant_acceleration(axes, jerk_density=strong),
        singer(axes, acceleration_sd=strong),
        jerk(axes),
        drag_coast(axes, acceleration_density=strong),
    ]
    turning = (
        [
            coordinated_turn(acceleration_density=strong),
            known_turn(0.3),
            polar_turn(speed_density=strong),
            circle(centre_density=strong),
            weave(acceleration_density=strong),
        ]
        if axes == 2
        else [spatial_turn(acceleration_density=strong), helix(centre_density=strong)]
    )
    motions = {"curved-2d": turning[2:], "sixteen": (straight + turning) * 2}.get(name, straight + turning)[:16]
    chain = MarkovChain.from_sojourns([_log_uniform(rng, 0.1, 1e4)] * len(motions))
    modes = tuple(Mode(f"{i}", motion) for i, motion in enumerate(motions))
    return Bank(modes, sensor, chain, interaction=interaction, speed=_log_uniform(rng, 0.1, 1e4))


def _times(rng: np.random.Generator, tracks: int, rows: int) -> Floats:
    steps = np.exp(rng.uniform(np.log(1e-6), np.log(1e4), (tracks, rows)))
    steps[rng.random((tracks, rows)) < 0.15] = 0.0
    regular = rng.random(tracks) < 0.4
    steps[regular] = _log_uniform(rng, 1e-2, 1e2)
    return np.cumsum(steps, axis=1) + rng.choice([0.0, -1e6, 1.7e9])


def _paths(rng: np.random.Generator, times: Floats, axes: int, scale: float) -> Floats:
    tracks, rows = times.shape
    place = np.cumsum(rng.normal(size=(tracks, rows, axes)) * scale * _log_uniform(rng, 1e-6, 1e-1), axis=1)
    jumps = rng.normal(size=(tracks, rows, axes)) * scale * (rng.random((tracks, rows, 1)) < 0.03)
    velocity = np.gradient(place, axis=1) if rows > 1 else np.zeros_like(place)
    still = rng.random((tracks, 1, 1)) < 0.1  # at the very place of the sensor
    place = np.where(still, 0.0, place + np.cumsum(jumps, axis=1) + rng.normal(size=(tracks, 1, axes)) * scale)
    return np.concatenate([place, velocity], axis=2)


def _sensor_states(rng: np.random.Generator, tracks: int, rows: int, axes: int, scale: float) -> Floats | None:
    if rng.random() < 0.5:
        return None
    return rng.normal(size=(tracks, rows, 2 * axes)) * scale * 0.1


def _measure(rng: np.random.Generator, sensor: Sensor, kin: Floats, sensors: Floats | None) -> Floats:
    tracks, rows, size = kin.shape
    z, params = np.zeros((tracks, rows, sensor.size)), np.array(sensor.params)
    for b in range(tracks):
        for t in range(rows):
            sensor.observe(kin[b, t], np.zeros(size) if sensors is None else sensors[b, t], params, z[b, t])
    noisy = np.minimum(np.array(sensor.sigma), np.where(sensor.angular, 1.0, 1e9)) * rng.normal(size=z.shape)
    return z + (noisy if rng.random() < 0.7 else 0.0)


def _noise(rng: np.random.Generator, sensor: Sensor, tracks: int, rows: int) -> Floats | None:
    if rng.random() < 0.4:
        return None
    size = sensor.size
    sigma = np.exp(rng.uniform(np.log(1e-9), np.log(1e9), (tracks, rows, size)))
    mixing = np.eye(size) if rng.random() < 0.5 else np.linalg.qr(rng.normal(size=(size, size)))[0]
    factor = sigma[..., None] * mixing
    R = factor @ factor.swapaxes(-1, -2)
    return 0.5 * (R + R.swapaxes(-1, -2))


def _spoil(rng: np.random.Generator, z: Floats, noise: Floats | None, sensors: Floats | None) -> None:
    """Put in what instruments and files put in; some rounds stay clean."""
    level = rng.choice([0.0, 0.02, 0.2])
    for value in (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e29, 0.0):
        z[rng.random(z.shape) < level * 0.3] = value
    z[rng.random(z.shape[:2]) < level] = np.nan
    if rng.random() < 0.05:
        z[rng.integers(len(z))] = np.nan
    if noise is not None:
        for value in (np.nan, np.inf):
            noise[rng.random(noise.shape) < level * 0.05] = value
        upper = np.triu_indices(noise.shape[-1], 1)
        noise[..., upper[1], upper[0]] = noise[..., upper[0], upper[1]]
        bad = rng.random(noise.shape[:2]) < level * 0.1
        if noise.shape[-1] > 1:  # correlation beyond one: indefinite
            noise[bad, 0, 1] = noise[bad, 1, 0] = 2.0 * np.sqrt(noise[bad, 0, 0]) * np.sqrt(noise[bad, 1, 1])
    if sensors is not None:
        for value in (np.nan, np.inf, 1e300):
            sensors[rng.random(sensors.shape) < level * 0.05] = value


def _prior(rng: np.random.Generator, bank: Bank, scale: float) -> Prior | None:
    if rng.random() < 0.6:
        return None
    kin = 2 * bank.sensor.axes
    draw = rng.random(kin) * (rng.random(kin) < 0.7)  # some components, or all, known exactly
    spread = np.diag(draw * _log_uniform(rng, 1e-18, 1e18)) * (rng.random() < 0.8)
    return Prior(rng.normal(size=kin) * scale, spread, includes_first=bool(rng.random() < 0.3))


def broken(estimates: Estimates) -> list[str]:
    """What no estimate may be, whatever came in: names of broken rules."""
    found = []
    for name, values in zip(estimates._fields, estimates, strict=True):
        if not np.isfinite(values).all():
            found.append(f"{name} not finite")
    if found:
        return found
    if not np.isin(estimates.status, range(5)).all():
        found.append("status unknown")
    if (estimates.nis < 0).any() or (estimates.nis[estimates.nis_dof == 0] != 0).any():
        found.append("nis negative, or given for nothing")
    probs = estimates.mode_probs
    if (probs < 0).any() or (np.abs(probs.sum(axis=-1) - 1.0) > 1e-9).any():
        found.append("mode_probs no distribution")
    return found + covariance_broken(estimates.covariance)


def covariance_broken(cov: Floats) -> list[str]:
    """Rules a stack of covariances breaks."""
    cov = cov.reshape(-1, *cov.shape[-2:])
    variances = np.diagonal(cov, axis1=1, axis2=2)
    if (variances < 0).any():
        return ["negative variance"]
    scale = np.sqrt(variances)
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    correlation = cov * inverse[:, :, None] * inverse[:, None, :]
    found = []
    if (np.abs(correlation - correlation.swapaxes(1, 2)) > 1e-9).any():
        found.append("covariance asymmetric")
    if ((variances[:, :, None] == 0) & (cov != 0)).any():
        found.append("covariance with a certain component")
    if len(cov) and (np.linalg.eigvalsh(correlation)[:, 0] < _INDEFINITE).any():
        found.append("covariance indefinite")
    return found


def silent(problem: Round, estimates: Estimates) -> list[str]:
    """Trouble in the input that the status hides."""
    status = estimates.status
    inside = (np.arange(status.shape[1]) < problem.lengths[:, None]) & (status != STARTING)
    wrong = np.isinf(problem.z) | (np.abs(problem.z) >= 1e30)
    present = np.isfinite(problem.z) & ~wrong
    found = []
    if ((status == OK) & inside & wrong.any(axis=2)).any():
        found.append("inf measured, status OK")
    if ((status == OK) & inside & np.isnan(problem.z).all(axis=2)).any():
        found.append("nothing measured, status OK")
    if problem.noise is not None:
        usable = present[..., :, None] & present[..., None, :]
        spoilt = (usable & ~np.isfinite(problem.noise)).any(axis=(2, 3))
        if (np.isin(status, (OK, MISSING)) & inside & spoilt).any():
            found.append("noise not finite, status OK or MISSING")
    if problem.sensors is not None and problem.bank.sensor.name.startswith(("range-bearing", "bearing")):
        axes = problem.bank.sensor.axes
        lost = ~np.isfinite(problem.sensors[..., :axes]).all(axis=2) & present.any(axis=2)
        if ((status == OK) & inside & lost).any():
            found.append("sensor place not finite, status OK")
    return found


def check_round(problem: Round, rng: np.random.Generator) -> tuple[int, list[str]]:
    """Run one round through every door of the estimator.

    Returns:
        Steps made, and the rules broken.
    """
    estimator = BankEstimator(problem.bank, threads=1)
    given = (problem.z, problem.times, problem.noise, problem.sensors, problem.lengths)
    estimates = estimator.run(*given, prior=problem.prior)
    steps = int(problem.lengths.sum())
    found = broken(estimates) + silent(problem, estimates)
    if rng.random() < 0.25:
        found += [f"smooth: {text}" for text in broken(estimator.smooth(*given, prior=problem.prior))]
        steps += steps
    if rng.random() < 0.25:
        horizon = float(rng.choice([0.0, 1.0, 1e4]))
        mean, cov = estimator.forecast_run(
            problem.z, problem.times, horizon, problem.noise, problem.sensors, problem.lengths, prior=problem.prior
        )
        if not (np.isfinite(mean).all() and np.isfinite(cov).all()):
            found.append("forecast: not finite")
        else:
            found += [f"forecast: {text}" for text in covariance_broken(cov)]
        steps += steps
    made, more = _stream(problem, estimator, estimates, rng)
    return steps + made, found + more


def _stream(
    problem: Round, estimator: BankEstimator, estimates: Estimates, rng: np.random.Generator
) -> tuple[int, list[str]]:
    """One track again by `step`: equal to `run`; then steps that `run` would refuse."""
    b = int(rng.integers(len(problem.z)))
    length = int(problem.lengths[b])
    first = int((estimates.status[b, :length] == STARTING).sum())
    if length == 0 or (problem.prior is None and (first == 0 or problem.bank.sensor.locate is None)):
        return 0, []  # a start that looks at later rows, or none at all, has no equal by single steps
    rows = max(first, 1)
    noise = list(problem.noise[b]) if problem.noise is not None else [None] * length
    sensors = list(problem.sensors[b]) if problem.sensors is not None else [None] * length
    try:
        state = estimator.start(
            problem.z[b, :rows],
            problem.times[b, :rows],
            None if problem.noise is None else problem.noise[b, :rows],
            None if problem.sensors is None else problem.sensors[b, :rows],
            prior=problem.prior,
        )
    except ValueError as error:
        if "must locate" in str(error):  # `run` then begins broad and without these rows; `start` refuses
            return 0, []
        raise
    found = []
    for t in range(rows, length):
        state, one = estimator.step(state, problem.z[b, t], problem.times[b, t], noise[t], sensors[t])
        for name in Estimates._fields:
            if not np.array_equal(getattr(one, name), getattr(estimates, name)[b, t], equal_nan=True):
                found.append(f"step differs from run in {name}")
        if found:
            break
    made = length - rows
    size, now = problem.bank.sensor.size, float(state.time[0])
    for k in range(16):
        z = rng.normal(size=size) * _log_uniform(rng, 1e-3, 1e7)
        R = np.diag(np.exp(rng.uniform(-20, 20, size)))
        when = now + k
        fault = int(rng.integers(8))
        match fault:
            case 0:
                when = float(rng.choice([np.nan, np.inf, -np.inf, -1e300, now - 1e6]))
            case 1:
                R[0, 0] = rng.choice([-1.0, 0.0, np.nan, np.inf, 1e300])
            case 2:
                R = rng.normal(size=(size, size))
            case 3:
                R = -R
            case 4:
                z[0] = rng.choice([np.nan, np.inf, -np.inf, 1e300])
            case 5:
                R *= rng.choice([1e-300, 1e-30, 1e30, 1e300])
        state, one = estimator.step(state, z, when, R)
        found += [f"step with fault {fault}: {text}" for text in broken(one)]
        if fault in (0, 3) and one.status == OK:
            found.append(f"step with fault {fault}: status OK")
        if not all(np.isfinite(part).all() for part in state):
            found.append(f"step with fault {fault}: state not finite")
    return made + 16, found


def main() -> int:
    """Command line: rounds until the steps are made; prints what broke."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1_000_000, help="steps to make in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tracks", type=int, default=4, help="tracks per round")
    parser.add_argument("--rows", type=int, default=80, help="rows per track")
    parser.add_argument("--only", type=int, default=None, help="this round alone")
    parser.add_argument("--seconds", type=float, default=np.inf, help="stop after this time")
    options = parser.parse_args()
    begun, made, number = time.perf_counter(), 0, options.only or 0
    counts: Counter[str] = Counter()
    rounds: dict[str, list[str]] = defaultdict(list)
    while made < options.steps and time.perf_counter() - begun < options.seconds:
        problem = draw_round(number, options.seed, options.tracks, options.rows)
        try:
            with np.errstate(all="ignore"):
                steps, found = check_round(problem, np.random.default_rng([options.seed, number, 1]))
        except Exception as error:  # any exception is a finding here; it is counted and shown
            steps, found = 0, [f"{type(error).__name__}: {str(error)[:90]}"]
            if options.only is not None:
                traceback.print_exc()
        made += max(steps, 1)
        for text in set(found):
            counts[text] += 1
            rounds[text].append(f"{number} ({problem.title})")
        number += 1
        if options.only is not None:
            break
    for text, count in counts.most_common():
        print(f"{count:6d}  {text}\n        rounds {'; '.join(rounds[text][:5])}")
    print(f"{made} steps, {number} rounds, {time.perf_counter() - begun:.0f} s, {sum(counts.values())} broken rules")
    return 1 if counts else 0


if __name__ == "__main__":
    sys.exit(main())
