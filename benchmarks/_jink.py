"""Jink's side of the comparison: each function prepares the work and returns a callable that does it.

The callable takes nothing, runs the whole problem and returns a `_problem.Result`. Everything that a user
does once (building the estimator, compiling) belongs before it; everything done per run belongs in it. Only
what a user would write is used: motions are small functions, the rest is the package's public interface.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from _problem import MODE_TRANSITION, SIGMA_M, Problem, Result, make_problem

from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank, Mode
from jink.estimators.compiled import NOISE, Callback
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion, motion
from jink.estimators.motions import constant_velocity
from jink.estimators.sensors import position

LABELS = "x vx ax y vy ay w"
# The prior of acceleration and turn rate in `_problem.make_problem`: mean, standard deviation.
BIRTH = {"ax": (0.0, 2.0), "ay": (0.0, 2.0), "w": (0.0, 0.2)}


@motion(LABELS, birth=BIRTH, linear=True)
def cv(x, dt, params, out):  # type: ignore[no-untyped-def]
    """Constant velocity: acceleration and turn rate return to zero."""
    out[0] = x[0] + dt * x[1]
    out[1] = x[1]
    out[2] = 0.0
    out[3] = x[3] + dt * x[4]
    out[4] = x[4]
    out[5] = 0.0
    out[6] = 0.0


@motion(LABELS, birth=BIRTH, linear=True, jet_order=2)
def ca(x, dt, params, out):  # type: ignore[no-untyped-def]
    """Constant acceleration: the turn rate returns to zero."""
    half = 0.5 * dt * dt
    out[0] = x[0] + dt * x[1] + half * x[2]
    out[1] = x[1] + dt * x[2]
    out[2] = x[2]
    out[3] = x[3] + dt * x[4] + half * x[5]
    out[4] = x[4] + dt * x[5]
    out[5] = x[5]
    out[6] = 0.0


@motion(LABELS, birth=BIRTH, jet_order=2)
def ct(x, dt, params, out):  # type: ignore[no-untyped-def]
    """Turn at the rate w, exactly; acceleration is the centripetal one."""
    vx, vy, w = x[1], x[4], x[6]
    half = 0.5 * dt * w
    s = math.sin(half)
    c = math.cos(half)
    sinc = s / half if abs(half) > 1e-4 else 1.0 - half * half / 6.0
    chord = dt * sinc
    turned = 2.0 * s * c
    kept = 1.0 - 2.0 * s * s
    new_vx = kept * vx - turned * vy
    new_vy = turned * vx + kept * vy
    out[0] = x[0] + chord * (c * vx - s * vy)
    out[1] = new_vx
    out[2] = -w * new_vy
    out[3] = x[3] + chord * (s * vx + c * vy)
    out[4] = new_vy
    out[5] = w * new_vx
    out[6] = w


def _cv_noise(x, dt, params, out):  # type: ignore[no-untyped-def]
    for i in range(0, 6, 3):
        out[i, i] = dt * dt * dt / 3.0
        out[i, i + 1] = out[i + 1, i] = 0.5 * dt * dt
        out[i + 1, i + 1] = dt
        out[i + 2, i + 2] = 0.01
    out[6, 6] = 1e-4


def _ca_noise(x, dt, params, out):  # type: ignore[no-untyped-def]
    q = 0.5 * dt
    for i in range(0, 6, 3):
        out[i, i] = q * dt * dt * dt * dt / 20.0
        out[i, i + 1] = out[i + 1, i] = q * dt * dt * dt / 8.0
        out[i, i + 2] = out[i + 2, i] = q * dt * dt / 6.0
        out[i + 1, i + 1] = q * dt * dt / 3.0
        out[i + 1, i + 2] = out[i + 2, i + 1] = 0.5 * q * dt
        out[i + 2, i + 2] = q
    out[6, 6] = 1e-4


def _ct_noise(x, dt, params, out):  # type: ignore[no-untyped-def]
    q = 0.1 * dt
    for i in range(0, 6, 3):
        out[i, i] = q * dt * dt / 3.0
        out[i, i + 1] = out[i + 1, i] = 0.5 * q * dt
        out[i + 1, i + 1] = q
        out[i + 2, i + 2] = 0.25
    out[6, 6] = 1e-3 * dt


MOTIONS: dict[str, Motion] = {
    "cv": cv.with_(noise=Callback(_cv_noise, NOISE)),
    "ca": ca.with_(noise=Callback(_ca_noise, NOISE)),
    "ct": ct.with_(noise=Callback(_ct_noise, NOISE)),
    "kf-cv": constant_velocity(2, acceleration_density=2.0),
}


def _estimator(modes: list[Mode], chain: np.ndarray | None, every_sigma_point: bool) -> BankEstimator:
    bank = Bank(
        tuple(modes),
        position(2, sigma=SIGMA_M),
        chain=None if chain is None else MarkovChain.per_step(chain),
        min_prob=0.0,  # the peers have no floor
        every_sigma_point=every_sigma_point,
    )
    return BankEstimator(bank, threads=1)


def _of(problem: Problem, linear_shortcut: bool) -> BankEstimator:
    modes = [Mode(name, MOTIONS[name]) for name in problem.modes]
    chain = problem.mode_transition if len(modes) > 1 else None
    return _estimator(modes, chain, not linear_shortcut)


def _prior(problem: Problem) -> Prior:
    """The problem's prior as position and velocity per track; acceleration and turn rate are in `BIRTH`."""
    order = problem.order
    rest = [i for i in range(problem.prior_mean.shape[1]) if i not in order]
    wanted = [BIRTH["ax"], BIRTH["ay"], BIRTH["w"]] if rest else []
    given = [(mean, math.sqrt(problem.prior_cov[i, i])) for i, (mean, _) in zip(rest, wanted, strict=True)]
    if given != wanted or problem.prior_mean[:, rest].any():
        raise ValueError(
            f"_prior: problem must have acceleration and turn rate as in BIRTH, {wanted}; got {given}. Change both."
        )
    return Prior(
        problem.prior_mean[:, order],
        problem.prior_cov[np.ix_(order, order)],
        includes_first=True,
        mode_probs=problem.mode_probs,
    )


def _last(estimates: Estimates) -> Result:
    return Result(
        estimates.position[:, -1],
        estimates.velocity[:, -1],
        estimates.covariance[:, -1],
        estimates.mode_probs[:, -1],
    )


def _whole(problem: Problem, linear_shortcut: bool) -> Callable[[], Result]:
    estimator, prior = _of(problem, linear_shortcut), _prior(problem)
    return lambda: _last(estimator.run(problem.measurements, problem.times, prior=prior))


def jink_bank(problem: Problem, linear_shortcut: bool = False) -> Callable[[], Result]:
    """Prepare the three-mode unscented bank on all tracks at once (`run`).

    Args:
        problem: workload "bank".
        linear_shortcut: False does the peers' work (three unscented filters); True runs the linear modes as
            Kalman filters, which gives the same estimates and is shown as a row of its own.
    """
    return _whole(problem, linear_shortcut)


def jink_ukf(problem: Problem) -> Callable[[], Result]:
    """Prepare one unscented filter (mode `ct`, N = 7) on all tracks at once."""
    return _whole(problem, False)


def jink_kf(problem: Problem) -> Callable[[], Result]:
    """Prepare one Kalman filter (constant velocity, N = 4) on all tracks at once."""
    return _whole(problem, True)


def jink_step(problem: Problem) -> Callable[[], Result]:
    """Prepare a Python loop of single `step` calls on the first track, for any of the three workloads."""
    estimator, prior = _of(problem, problem.workload == "kf"), _prior(problem)
    first = estimator.start(problem.measurements[0, :1], problem.times[:1], prior=prior)
    rows = list(zip(problem.measurements[0, 1:], problem.times[1:].tolist(), strict=True))

    def run() -> Result:
        state = first
        estimate: Any = None
        for measured, now in rows:
            state, estimate = estimator.step(state, measured, now)
        return Result(*(np.asarray(field)[None] for field in estimate[1:5]))

    return run


def _chain_move(x, dt, params, out):  # type: ignore[no-untyped-def]
    count = x.size // 2
    for start in range(0, x.size, count):
        for i in range(count):
            factor, total = 1.0, 0.0
            for k in range(i, count):
                total += factor * x[start + k]
                factor *= dt / (k - i + 1)
            out[start + i] = total


def _chain_noise(x, dt, params, out):  # type: ignore[no-untyped-def]
    """White noise drives the highest derivative: Q_ik = q dt^(a+b+1) / (a! b! (a+b+1)), a, b integrations below it."""
    count = x.size // 2
    left = 1.0
    for a in range(count):
        right = 1.0
        for b in range(count):
            for start in range(0, x.size, count):
                out[start + count - 1 - a, start + count - 1 - b] = 0.1 * left * right * dt / (a + b + 1)
            right *= dt / (b + 1)
        left *= dt / (a + 1)


def _derivatives(size: int) -> Motion:
    labels = [prefix + axis for axis in "xy" for prefix in ("", "v", "a", "j", "s")[: size // 2]]
    return motion(labels, name="chain", jet_order=min(size // 2 - 1, 2))(_chain_move).with_(
        noise=Callback(_chain_noise, NOISE)
    )


def jink_scaling(kind: str, size: int, tracks: int, steps: int) -> Callable[[], object]:
    """Prepare a run in which one thing grows.

    Args:
        kind: "modes" (size = number of modes of the bank: cv, ca, ct, cv, ...) or "state" (size = number of
            state components N of one unscented filter, a chain of N / 2 derivatives per axis).
        size: the number of modes or of state components.
        tracks: number of tracks.
        steps: steps per track.

    Raises:
        ValueError: an unknown kind.
    """
    if kind == "state":
        modes = [Mode("chain", _derivatives(size))]
    elif kind == "modes":
        names = [("cv", "ca", "ct")[i % 3] for i in range(size)]
        modes = [Mode(f"{name}{i}", MOTIONS[name]) for i, name in enumerate(names)]
    else:
        raise ValueError(f"jink_scaling: kind must be modes or state; got {kind!r}. Choose one of these.")
    stay = MODE_TRANSITION[0, 0]
    chain = None
    if len(modes) > 1:
        chain = np.full((size, size), (1.0 - stay) / (size - 1))
        np.fill_diagonal(chain, stay)
    estimator = _estimator(modes, chain, True)
    problem = make_problem("kf", tracks, steps)
    prior = Prior(
        problem.prior_mean[:, problem.order],
        problem.prior_cov[np.ix_(problem.order, problem.order)],
        includes_first=True,
    )
    return lambda: estimator.run(problem.measurements, problem.times, prior=prior)
