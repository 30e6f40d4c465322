"""Scenarios whose results are published, by name.

`get_scenario("b2-atc-turns-v0").simulate(runs=200, seed=1)` gives truth and measurements. Anything that can
move a number bumps the version in the id. The Li, Bar-Shalom and Blair parameters follow sampleTraj.m of the
Tracker Component Library, U.S. Naval Research Laboratory: a work of the United States Government, in the
public domain (17 U.S.C. 105). All other parameters are re-typed from the sources named.
"""

import difflib
import math

import numpy as np

from jink.envs.literature.published_jump import JumpScenario
from jink.envs.literature.published_legs import Leg, LegScenario
from jink.envs.literature.published_truth import PublishedValue, Scenario
from jink.envs.literature.published_uncertain import UncertainSystem

DEGREE = math.pi / 180.0


def list_legs(*ends_and_rates: tuple[float, float]) -> tuple[Leg, ...]:
    """Legs from (end time s, turn rate deg/s) pairs, straight where the rate is 0."""
    starts = [0.0, *(end for end, _ in ends_and_rates)]
    return tuple(
        Leg(end - start, "turn" if rate else "straight", rate * DEGREE)
        for start, (end, rate) in zip(starts[:-1], ends_and_rates, strict=True)
    )


def make_lbb(name: str, title: str, start: tuple[float, ...], *legs: tuple[float, float]) -> LegScenario:
    """One scenario of Li, Bar-Shalom and Blair; start is x, y, vx, vy as in the source."""
    x, y, vx, vy = start
    return LegScenario(
        id=f"lbb-{name}-v0",
        title=title,
        source="Li, Bar-Shalom, Blair (2000), section 10.8.3, as coded in sampleTraj.m (public domain). "
        "Differs: the 100 m position sensor is ours, the source gives the path only",
        dt=1.0,
        start=(x, vx, y, vy),
        legs=list_legs(*legs),
        sigma=100.0,
        mode_names=("straight", "turn"),
    )


SLOW_FAST = LegScenario(
    id="b1-slow-fast-turns-v0",
    title="One slow and one fast 90 degree turn by constant acceleration",
    source="Bar-Shalom, Birmiwal (1982); Bar-Shalom, Fortmann (1988). Differs: the end, 1000 s, is ours",
    dt=10.0,
    start=(2000.0, 0.0, 10000.0, -15.0),
    legs=(
        Leg(400.0, "straight"),
        Leg(200.0, "slow-turn", acceleration=(0.075, 0.075)),
        Leg(10.0, "straight"),
        Leg(50.0, "fast-turn", acceleration=(-0.3, -0.3)),
        Leg(340.0, "straight"),
    ),
    sigma=100.0,
    mode_names=("straight", "slow-turn", "fast-turn"),
)

ATC_CONVENTION = (
    "200 runs, two-point start at the second sample, squared position error pooled over runs and samples "
    "k >= 6 (from 30 s), root at the end"
)
ATC_SOURCE = "Bar-Shalom, Li, Kirubarajan (2001), section 11.7; numbers recomputed in plain numpy"


def list_atc_values() -> dict[str, PublishedValue]:
    """The twelve position and four velocity numbers of B2, keyed `<filter>/<metric>`."""
    rows = {
        "kf-1": (142.3, 402.7, 91.5, 21.1),
        "kf-0.1": (988.6, 2163.8, 60.0, 53.5),
        "imm-cv-cv": (109.6, 220.9, 86.5, 16.5),
        "imm-cv-ct": (88.0, 126.9, 82.3, 10.9),
    }
    metrics = {
        "position_rms": f"m; {ATC_CONVENTION}",
        "position_peak": f"m; {ATC_CONVENTION}, largest over samples of the root mean square over runs",
        "position_leg1": f"m; {ATC_CONVENTION}, samples from 75 to 125 s only",
        "velocity_rms": f"m/s; {ATC_CONVENTION}, velocity",
    }
    return {
        f"{name}/{metric}": PublishedValue(value, None, words, ATC_SOURCE)
        for name, values in rows.items()
        for (metric, words), value in zip(metrics.items(), values, strict=True)
    }


ATC_TURNS = LegScenario(
    id="b2-atc-turns-v0",
    title="Air traffic: 1 degree/s left turn, then 3 degree/s back",
    source=ATC_SOURCE,
    dt=5.0,
    start=(25000.0, -120.0, 10000.0, 0.0),
    legs=(
        Leg(125.0, "straight"),
        Leg(90.0, "left-1", DEGREE),
        Leg(125.0, "straight"),
        Leg(30.0, "right-3", -3.0 * DEGREE),
        Leg(125.0, "straight"),
    ),
    sigma=100.0,
    mode_names=("straight", "left-1", "right-3"),
    mode_transition=((0.9, 0.05, 0.05), (0.05, 0.9, 0.05), (0.05, 0.05, 0.9)),
    mode_probs0=(0.5, 0.25, 0.25),
    published=list_atc_values(),
)

MIXING = LegScenario(
    id="mixing-study-v0",
    title="Straight, 0.4 rad/s turn, acceleration, straight",
    source="Own study of interaction rules, after patent CN202211553542. Speed, acceleration and leg times "
    "are chosen so that a plain numpy bank reproduces its numbers",
    dt=0.1,
    start=(0.0, 30.0, 0.0, 0.0),
    legs=(
        Leg(10.0, "cv"),
        Leg(15.0, "ct", 0.4),
        Leg(10.0, "ca", acceleration=(4.0, 0.0)),
        Leg(10.0, "cv"),
    ),
    sigma=1.0,
    mode_names=("cv", "ca", "ct"),
    mode_transition=((0.98, 0.01, 0.01), (0.01, 0.98, 0.01), (0.01, 0.01, 0.98)),
    mode_probs0=(1 / 3, 1 / 3, 1 / 3),
    published={
        f"{interaction}/{metric}": PublishedValue(
            value, None, f"m; 30 runs, first second left out, {words}", "own study, plain numpy"
        )
        for metric, words, values in (
            ("position_rms", "root mean square position error", (0.913, 0.903, 0.763)),
            ("position_peak", "largest over samples of the root mean square over runs", (3.10, 3.02, 2.15)),
        )
        for interaction, value in zip(("none", "reset", "jet"), values, strict=True)
    },
)

WANG_SOURCE = "Wang (2023), IEEE TSP, Table VI; half-widths: one standard error of 50 runs of our own"
WANG_METRIC = "mean over runs of the root of the time mean of |position error|^2 + |speed error|^2, SI units"
WANG_RMSE = {"oracle": (43.62, 0.38), "imm": (81.60, 0.36), "imm-bayes": (81.61, 0.36)}

JUMP_LINEAR = JumpScenario(
    id="n1-jump-linear-v0",
    title="Position and speed on a line, acceleration jumps among 0, 20 and -20 m/s^2",
    source=WANG_SOURCE,
    dt=1.0,
    steps=1000,
    state_labels=("x", "vx"),
    position_index=(0,),
    velocity_index=(1,),
    mode_names=("coast", "forward", "backward"),
    transition=3 * [[[1.0, 1.0], [0.0, 1.0]]],
    drift=[[0.5 * a, a] for a in (0.0, 20.0, -20.0)],
    noise_gain=3 * [[[1.0], [2.0]]],
    sigma=100.0,
    mode_transition=[[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]],
    mode_probs0=[0.8, 0.1, 0.1],
    prior_mean=[80000.0, 400.0],
    prior_cov=np.diag([1e4, 1e4]),
    published={
        name: PublishedValue(value, (value - width, value + width), WANG_METRIC, WANG_SOURCE)
        for name, (value, width) in WANG_RMSE.items()
    },
)


def make_cv_ca(dt: float = 0.1) -> JumpScenario:
    """The CV/CA demonstration N4.

    Both modes live over (x, y, vx, vy, ax, ay); a CV step sets the acceleration to 0.
    """
    cv, ca = np.zeros((3, 3)), np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
    cv[:2, :2] = ca[:2, :2]
    q_cv = 0.01 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    q_ca = np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
    gain = np.zeros((2, 3, 3))
    gain[0, :2, :2], gain[1] = np.linalg.cholesky(q_cv), np.linalg.cholesky(q_ca)
    source = "EKF/UKF toolbox, imm_demo (parameters re-typed); numbers recomputed in plain numpy"
    metric = "m^2; squared error averaged over 200 runs, samples and both axes; interval: one standard error"
    values = {"kf-cv": (0.172, 0.009), "kf-ca": (0.0318, 0.0003), "imm": (0.0233, 0.0003)}
    return JumpScenario(
        id="n4-cv-ca-v0",
        title="Plane target that alternates between constant velocity and constant acceleration",
        source=source,
        dt=dt,
        steps=200,
        state_labels=("x", "y", "vx", "vy", "ax", "ay"),
        position_index=(0, 1),
        velocity_index=(2, 3),
        mode_names=("cv", "ca"),
        transition=[np.kron(f, np.eye(2)) for f in (cv, ca)],
        drift=np.zeros((2, 6)),
        noise_gain=[np.kron(g, np.eye(2)) for g in gain],
        sigma=math.sqrt(0.1),
        mode_transition=[[0.98, 0.02], [0.02, 0.98]],
        mode_probs0=[0.9, 0.1],
        prior_mean=[0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
        prior_cov=np.diag([0.1, 0.1, 0.1, 0.1, 0.5, 0.5]),
        schedule=(0,) * 50 + (1,) * 20 + (0,) * 50 + (1,) * 30 + (0,) * 50,
        published={
            name: PublishedValue(value, (value - width, value + width), metric, source)
            for name, (value, width) in values.items()
        },
    )


UNCERTAIN = UncertainSystem(
    id="n5-uncertain-v0",
    title="Two states with one unknown number in the transition",
    source="Xie, Soh, de Souza (1994), IEEE TAC 39(6)",
    transition=[[0.0, -0.5], [1.0, 1.0]],
    perturbation=[[0.0, 0.0], [0.0, 1.0]],
    noise_gain=[[-6.0], [1.0]],
    observation=[[-100.0, 10.0]],
    bound=0.3,
    published={
        f"kf/{delta:+g}": PublishedValue(
            value,
            (value - 1e-4, value + 1e-4),
            "predicted error variance of the first component, steady Kalman filter designed at delta = 0",
            "analytic, on the example of Xie, Soh, de Souza (1994)",
        )
        for delta, value in ((-0.3, 551.2255), (0.0, 36.0205), (0.3, 8352.7649))
    },
)

NORTH_EAST = 212.13203435596424  # 300 m/s along a diagonal
SCENARIOS: dict[str, Scenario] = {
    scenario.id: scenario
    for scenario in (
        SLOW_FAST,
        ATC_TURNS,
        make_lbb("1", "2 g turn", (30e3, 30e3, -172.0, -246.0), (61, 0), (106, 3.74), (150, 0)),
        make_lbb("2", "2.5 g turn", (20e3, 50e3, -172.0, -246.0), (61, 0), (96, 4.68), (150, 0)),
        make_lbb(
            "3",
            "Four 180 degree turns of 1, 1.5, 3 and 2.5 g",
            (60e3, 40e3, -NORTH_EAST, NORTH_EAST),
            *((50, 0), (146, 1.87), (176, 0), (240, -2.8), (270, 0)),
            *((302, 5.6), (332, 0), (370, -4.68), (400, 0)),
        ),
        make_lbb(
            "3b",
            "2.5 g full loop, then 1.5 g",
            (60e3, 40e3, -NORTH_EAST, NORTH_EAST),
            *((50, 0), (146, 4.68), (176, 0), (240, -2.8), (270, 0)),
        ),
        make_lbb(
            "3c",
            "Opposite turns with no straight between them",
            (10e3, 50e3, NORTH_EAST, -NORTH_EAST),
            *((50, 0), (78, 4.68), (160, -2.8), (210, 0)),
        ),
        JUMP_LINEAR,
        make_cv_ca(),
        MIXING,
    )
}


def get_scenario(name: str) -> Scenario:
    """The published scenario of this id.

    Args:
        name: an id such as "b2-atc-turns-v0"; see `SCENARIOS`.
    Returns:
        the scenario; call its `simulate(runs, seed)`.
    Raises:
        ValueError: no scenario has this id; the message lists those that exist.
    """
    if name in SCENARIOS:
        return SCENARIOS[name]
    near = difflib.get_close_matches(str(name), SCENARIOS, n=1, cutoff=0.3)
    hint = f"Did you mean {near[0]!r}?" if near else "Choose one of them."
    raise ValueError(f"get_scenario: name must be one of {', '.join(SCENARIOS)}; got {name!r}. {hint}")
