"""Noise surges: one factor, four factors, heavy tails and the joint bank against a filter that knows the noise.

The scenarios are the four of the published table of adaptive factors (CN202211618386) and surges of any scale.
Constant velocity, 1 m^2/s^3, R = 1 m^2, 300 samples at 10 Hz. RMS position error in metres.

python benchmarks/surges.py --runs 200 --seed 0 --out surges.json
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from jink.envs.scenarios import make_scenario
from jink.envs.simulate import simulate
from jink.envs.streams import make_streams
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.joint import joint_bank
from jink.estimators.motions import constant_velocity
from jink.estimators.oracles import oracle
from jink.estimators.recipes import Scales, robust_imm
from jink.estimators.sensors import position
from jink.estimators.treatments import Adaptive, BoundedTails, HeavyTails

SCENARIOS = (
    "surge-25-bursts-v0",
    "surge-400-bursts-v0",
    "surge-100-outliers-v0",
    "surge-10000-outliers-v0",
    "surge-v0",
)
SENSOR = position(2, 1.0)
SCALES = Scales(acceleration=1.0)
MOTION = constant_velocity(2, acceleration_density=1.0)


def single(treatment) -> Bank:  # type: ignore[no-untyped-def]
    """One mode of constant velocity."""
    return Bank((Mode("cv", MOTION, treatment),), SENSOR)


PLAIN = single(None)
BANKS: dict[str, Bank] = {
    "kf": PLAIN,
    "mr": single(Adaptive("mr")),
    "huber": single(Adaptive("huber")),
    "rma": single(Adaptive("rma")),
    "mahalanobis": single(Adaptive("mahalanobis")),
    "igg3": single(Adaptive("igg3")),
    "chang": single(Adaptive("chang")),
    "bounded-tails": single(BoundedTails(3.0)),
    "student-t": single(HeavyTails(3.0)),
    "robust-imm nominal": robust_imm(SENSOR, SCALES, likelihood="nominal"),
    "robust-imm adapted": robust_imm(SENSOR, SCALES, likelihood="adapted"),
    "robust-imm adapted, cap 1000": robust_imm(SENSOR, SCALES, likelihood="adapted", cap=1e3),
    "robust-imm": robust_imm(SENSOR, SCALES),
    "joint-imm": joint_bank(PLAIN),
    "joint-imm, levels shared": joint_bank(PLAIN, shared=True),
}


def errors(runs: int, seed: int) -> dict[str, dict[str, np.ndarray]]:
    """Squared position errors (runs,) averaged over time, by scenario and estimator."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for name in SCENARIOS:
        streams = [make_streams(np.random.default_rng((seed, run))) for run in range(runs)]
        episodes = simulate(make_scenario(name), streams)
        prior = Prior(mean=episodes.prior_mean, cov=episodes.prior_cov)
        given = (episodes.measurements, episodes.times)
        results = {key: BankEstimator(bank, threads=1).run(*given, prior=prior).position for key, bank in BANKS.items()}
        results["oracle"] = oracle(PLAIN, *given, noise=episodes.noise, prior=prior).position
        truth = episodes.truth.position
        found[name] = {key: np.mean(np.sum((value - truth) ** 2, axis=2), axis=1) for key, value in results.items()}
    return found


def main() -> None:
    """Run, print, save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    found = errors(options.runs, options.seed)
    table = Table(title=f"RMS position in m, {options.runs} runs; in brackets: over the oracle")
    table.add_column("estimator")
    for name in SCENARIOS:
        table.add_column(name.removesuffix("-v0"), justify="right")
    rows = {}
    for key in [*BANKS, "oracle"]:
        rms = {name: float(np.sqrt(found[name][key].mean())) for name in SCENARIOS}
        best = {name: float(np.sqrt(found[name]["oracle"].mean())) for name in SCENARIOS}
        rows[key] = rms
        table.add_row(key, *(f"{rms[name]:.2f} ({rms[name] / best[name]:.2f})" for name in SCENARIOS))
    Console(width=140).print(table)
    if options.out:
        options.out.write_text(json.dumps({"runs": options.runs, "seed": options.seed, "rms": rows}, indent=1))


if __name__ == "__main__":
    main()
