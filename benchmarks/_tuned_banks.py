"""Banks of library motions with all of their scales free, and how these are chosen on training episodes.

Two ways to choose: by likelihood (scoring, `_scoring.climb`), as intents are learnt, and by RMS position error, which a
learner that knows no truth cannot do (Nelder-Mead from the better of the likelihood's optimum and a grid).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from _paired import Floats, follow, mean_squares
from _scoring import climb
from scipy.optimize import minimize

from jink.envs.episodes import Episodes
from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.motions import constant_acceleration, constant_velocity, coordinated_turn, singer, swing
from jink.estimators.oracles import oracle
from jink.estimators.sensor import Sensor

__all__ = [
    "FAMILIES",
    "ORACLE",
    "Family",
    "by_likelihood",
    "by_rms",
    "oracle_family",
    "oracle_scales",
    "run_oracle",
]

ORACLE = "oracle: told the intent"
_WIDTH = 4.0  # of the faint prior on logs of scales: it decides where the data are silent
_LOW, _HIGH = math.log(1e-9), math.log(1e9)


@dataclass(frozen=True)
class Family:
    """Banks of one kind.

    Args:
        make: bank of logs of scales (K,) and a sensor.
        start: logs of the scales of a recipe with an acceleration, m/s^2, a turn rate, rad/s, and a sojourn, s; (K,).
    """

    make: Callable[[Floats, Sensor], Bank]
    start: Callable[[float, float, float], Floats]


def _straight(q: float) -> Motion:
    return constant_velocity(2, acceleration_density=q)


def _accelerate(jerk: float, sd: float) -> Motion:
    return constant_acceleration(2, jerk_density=jerk, acceleration_sd=sd)


def _turn(wobble: float, drift: float, sd: float) -> Motion:
    return coordinated_turn(acceleration_density=wobble, rate_density=drift, rate_sd=sd)


def _weave(rate: float, snap: float, acceleration: float, jerk: float) -> Motion:
    return swing(2, rate=rate, snap_density=snap, acceleration_sd=acceleration, jerk_sd=jerk)


def _single(logs: Floats, sensor: Sensor) -> Bank:
    time, sd = np.exp(logs)
    return Bank((Mode("singer", singer(2, time_constant=time, acceleration_sd=sd)),), sensor)


def _many(
    kinds: Sequence[tuple[str, Callable[..., Motion], int]], interaction: str
) -> Callable[[Floats, Sensor], Bank]:
    """A bank of named motions: the scales of each in turn, then the sojourn in each."""

    def make(logs: Floats, sensor: Sensor) -> Bank:
        scales, at, modes = np.exp(np.clip(logs, _LOW, _HIGH)), 0, []
        for name, motion, count in kinds:
            modes.append(Mode(name, motion(*scales[at : at + count].tolist())))
            at += count
        chain = MarkovChain.from_sojourns(scales[at:].tolist())
        return Bank(tuple(modes), sensor, chain=chain, interaction=interaction)

    return make


def _imm_start(acceleration: float, turn_rate: float, sojourn: float) -> Floats:
    """As the recipe `imm`."""
    quiet = (0.05 * acceleration) ** 2
    cv, ca = (quiet,), (2.0 * acceleration**2 / sojourn, acceleration)
    ct = (quiet, (0.1 * turn_rate) ** 2 / sojourn, turn_rate)
    return np.log([*cv, *ca, *ct, sojourn, sojourn, sojourn])


def _library_start(acceleration: float, turn_rate: float, sojourn: float) -> Floats:
    """As the recipe `intent-imm`."""
    quiet, rate = (0.05 * acceleration) ** 2, 2.0 * math.pi / sojourn
    cv, ct = (quiet,), (quiet, (0.1 * turn_rate) ** 2 / sojourn, turn_rate)
    ca = (2.0 * (0.1 * acceleration) ** 2 / sojourn, acceleration)
    weave = (rate, 0.1 * acceleration**2 * rate**2 / sojourn, acceleration, acceleration * rate)
    return np.log([*cv, *ct, *ca, *weave, *[sojourn] * 4])


FAMILIES: dict[str, Family] = {
    "singer": Family(_single, lambda acceleration, turn_rate, sojourn: np.log([sojourn, acceleration])),
    "imm": Family(
        _many((("cv", _straight, 1), ("ca", _accelerate, 2), ("ct", _turn, 3)), "mix"), _imm_start
    ),
    "library bank": Family(
        _many(
            (("straight", _straight, 1), ("turn", _turn, 3), ("accelerate", _accelerate, 2), ("weave", _weave, 4)),
            "birth",
        ),
        _library_start,
    ),
}  # fmt: skip
"""Name -> banks: those of the recipes `singer`, `imm` and `intent-imm`, with every scale of its own."""

_GRID = tuple((a, w, s) for a in (1.0, 5.0, 25.0) for w in (0.2, 0.6) for s in (3.0, 12.0))


def _rows(bank: Bank, episodes: Episodes) -> Floats:
    return np.asarray(follow(BankEstimator(bank), episodes).log_likelihood[:, 1:].ravel())


def _climbed(objective: Callable[[Floats], Floats], start: Floats, iterations: int) -> Floats:
    """Logs of scales that make the rows likeliest; (K,)."""

    def bounded(logs: Floats) -> Floats:
        found = objective(logs)
        return np.where(np.isfinite(found), found, -1e3)

    width = np.full(start.size, _WIDTH)
    *_, last = climb(bounded, start, centre=start, width=width, iterations=iterations, tolerance=2e-5)
    return last.at


def by_likelihood(family: Family, sensor: Sensor, episodes: Episodes, iterations: int = 15) -> Floats:
    """Logs of scales that make training episodes likeliest, from the likeliest of a grid of recipes' scales; (K,)."""
    starts = [family.start(*point) for point in _GRID]
    start = max(starts, key=lambda logs: float(_rows(family.make(logs, sensor), episodes).mean()))
    return _climbed(lambda logs: _rows(family.make(logs, sensor), episodes), start, iterations)


def by_rms(family: Family, sensor: Sensor, episodes: Episodes, likeliest: Floats, evaluations: int = 120) -> Floats:
    """Logs of scales with the smallest RMS position error on training episodes; (K,)."""

    def cost(logs: Floats) -> float:
        error = float(mean_squares(follow(BankEstimator(family.make(logs, sensor)), episodes), episodes).mean())
        return math.log(error) if math.isfinite(error) else 1e3

    start = min([likeliest, *(family.start(*point) for point in _GRID)], key=cost)
    simplex = np.vstack([start, start + 0.5 * np.eye(len(start))])
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 0.01, "fatol": 1e-5, "adaptive": True}
    return np.asarray(minimize(cost, start, method="Nelder-Mead", options=options).x)


def _oracle_motion(intent: str) -> tuple[Callable[..., Motion], int]:
    """The library motion that says most of a true intent, and how many scales it has."""
    if intent in ("turn", "orbit", "jink"):
        return _turn, 3
    if intent == "weave":
        return _weave, 4
    return (_straight, 1) if intent == "straight" else (_accelerate, 2)


def oracle_family(intents: Sequence[str]) -> tuple[Family, Callable[[Floats], Floats]]:
    """One library motion per true intent, and its scales where they are those of a library bank."""
    kinds = [(name, *_oracle_motion(name)) for name in intents]
    library = {_straight: slice(0, 1), _turn: slice(1, 4), _accelerate: slice(4, 6), _weave: slice(6, 10)}

    def start(acceleration: float, turn_rate: float, sojourn: float) -> Floats:
        logs = _library_start(acceleration, turn_rate, sojourn)
        return np.concatenate([*(logs[library[motion]] for _, motion, _ in kinds), [math.log(sojourn)] * len(kinds)])

    def from_library(logs: Floats) -> Floats:
        sojourns = {_straight: 10, _turn: 11, _accelerate: 12, _weave: 13}
        scales = [logs[library[motion]] for _, motion, _ in kinds]
        return np.concatenate([*scales, [logs[sojourns[motion]] for _, motion, _ in kinds]])

    return Family(_many(kinds, "birth"), start), from_library


def run_oracle(bank: Bank, episodes: Episodes) -> Estimates:
    """Estimates of a bank with one mode per true intent that is told the intent of every row."""
    prior = Prior(mean=episodes.prior_mean, cov=episodes.prior_cov)
    told = episodes.truth.intent.astype(np.int64)
    return oracle(bank, episodes.measurements, episodes.times, intents=told, prior=prior)


def oracle_scales(family: Family, sensor: Sensor, episodes: Episodes, first: Floats, iterations: int = 10) -> Floats:
    """Logs of the oracle's scales by likelihood on training episodes with the intents told; (K,).

    Args:
        family: of the oracle.
        sensor: of the scenario.
        episodes: to choose on.
        first: one more point to begin from, beside the grid.
        iterations: of the climb.
    """

    def rows(logs: Floats) -> Floats:
        return np.asarray(run_oracle(family.make(logs, sensor), episodes).log_likelihood[:, 1:].ravel())

    starts = [first, *(family.start(*point) for point in _GRID)]
    start = max(starts, key=lambda logs: float(np.nan_to_num(rows(logs), nan=-1e3).mean()))
    return _climbed(rows, start, iterations)
