"""Filters that learn the noise while they track, over every scenario of surges, heavy tails and model errors.

Constant velocity with the process noise each scenario gives a filter; R = 1 m^2, 300 samples at 10 Hz. The oracle is
told the covariance that every measurement really has (not its bias, and not the error of the model). RMS position error
in metres; 95 % intervals of its ratio to that of the plain Kalman filter, paired over episodes.

python benchmarks/adaptive_noise.py --runs 200 --seed 0 --out adaptive_noise.json
"""

from __future__ import annotations

from _paired import compare_squares, flat, follow, mean_squares, parser, save, short, show, shown, simulate_runs

from jink.envs.scenario import Scenario
from jink.envs.scenarios import SUITES, make_scenario
from jink.estimators.adaptive_estimator import AdaptiveEstimator, NoiseAdaptation
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.joint import joint_bank
from jink.estimators.motions import constant_velocity
from jink.estimators.recipes import ADAPTATIONS
from jink.training.console import progress

SCENARIOS = (*SUITES["surge"], *SUITES["heavy-tail"], *SUITES["model-error"])
BASE, ORACLE = "kf", "oracle: told R"
LEARN_Q = NoiseAdaptation("sage-husa", forgetting=0.95, measurement=False, process=True)


def estimators(scenario: Scenario) -> dict[str, BankEstimator]:
    """One mode of constant velocity, plain, learning, or at seven noise levels."""
    bank = Bank((Mode("cv", constant_velocity(2, acceleration_density=scenario.filter_noise)),), scenario.sensor)
    return {
        BASE: BankEstimator(bank),
        **{name: AdaptiveEstimator(bank, adaptation) for name, adaptation in ADAPTATIONS.items()},
        "sage-husa, Q alone": AdaptiveEstimator(bank, LEARN_Q),
        "joint-imm, one intent": BankEstimator(joint_bank(bank)),
        ORACLE: BankEstimator(bank),
    }


def main() -> None:
    """Run, print, save."""
    given = parser(__doc__, 200).parse_args()
    gaps, rows, numbers = {}, [], {}
    with progress("learnt noise", len(SCENARIOS)) as advance:
        for name in SCENARIOS:
            scenario = make_scenario(name)
            episodes = simulate_runs(scenario, given.runs, given.seed)
            squares = {}
            for key, estimator in estimators(scenario).items():
                found = follow(estimator, episodes, episodes.noise if key == ORACLE else None)
                squares[key] = mean_squares(found, episodes)
            gaps[name] = compare_squares(squares, BASE, given.seed)
            numbers |= flat(name, gaps[name])
            advance(text=name)
    for name, found in gaps.items():
        cells = (
            short(gap.value.value) + ("" if key == BASE else f"; {shown(gap.ratio)}") for key, gap in found.items()
        )
        rows.append([name.removesuffix("-v0"), *cells])
    title = f"RMS position, m, {given.runs} episodes; over the plain Kalman filter [95 %]"
    show(title, ["scenario", *gaps[SCENARIOS[0]]], rows, given.markdown)
    save(given.out, numbers, runs=given.runs, seed=given.seed)


if __name__ == "__main__":
    main()
