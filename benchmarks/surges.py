"""Noise surges: one factor, four factors, heavy tails and the joint bank against a filter that knows the noise.

The scenarios are the four of the published table of adaptive factors (CN202211618386) and surges of any scale.
Constant velocity, 1 m^2/s^3, R = 1 m^2, 300 samples at 10 Hz. RMS position error in metres; 95 % intervals of its ratio
to that of the oracle, paired over episodes.

python benchmarks/surges.py --runs 200 --seed 0 --out surges.json
"""

from __future__ import annotations

from _paired import compare_squares, flat, follow, mean_squares, parser, save, short, show, shown, simulate_runs

from jink.envs.scenarios import make_scenario
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.joint import joint_bank
from jink.estimators.motions import constant_velocity
from jink.estimators.recipes import Scales, robust_imm
from jink.estimators.sensors import position
from jink.estimators.treatments import Adaptive, BoundedTails, HeavyTails
from jink.training.console import progress

SCENARIOS = (
    "surge-25-bursts-v0",
    "surge-400-bursts-v0",
    "surge-100-outliers-v0",
    "surge-10000-outliers-v0",
    "surge-v0",
)
ORACLE = "oracle: told R"
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
    "joint-imm, levels of the scenarios": joint_bank(PLAIN, (1.0, 25.0, 100.0, 400.0, 1e4)),
    ORACLE: PLAIN,
}


def main() -> None:
    """Run, print, save."""
    given = parser(__doc__, 200).parse_args()
    gaps = {}
    with progress("surges", len(SCENARIOS) * len(BANKS)) as advance:
        for name in SCENARIOS:
            episodes = simulate_runs(make_scenario(name), given.runs, given.seed)
            squares = {}
            for key, bank in BANKS.items():
                noise = episodes.noise if key == ORACLE else None
                squares[key] = mean_squares(follow(BankEstimator(bank), episodes, noise), episodes)
                advance()
            gaps[name] = compare_squares(squares, ORACLE, given.seed)
    rows = [
        [
            key,
            *(
                short(gaps[name][key].value.value) + ("" if key == ORACLE else f"; {shown(gaps[name][key].ratio)}")
                for name in SCENARIOS
            ),
        ]
        for key in BANKS
    ]
    header = ["estimator", *(name.removesuffix("-v0") for name in SCENARIOS)]
    show(f"RMS position, m, {given.runs} episodes; over the oracle [95 %]", header, rows, given.markdown)
    numbers = {}
    for name in SCENARIOS:
        numbers |= flat(name, gaps[name])
    save(given.out, numbers, runs=given.runs, seed=given.seed)


if __name__ == "__main__":
    main()
