"""The work every package does in the speed comparison: models, measurements and what to hand back.

State of the bank: (x, vx, ax, y, vy, ay, w) in m, m/s, m/s^2 and rad/s; three modes over that one state:
`cv` (constant velocity, a' = 0, w' = 0), `ca` (constant acceleration, w' = 0) and `ct` (turn at the rate w,
with a' the centripetal acceleration of the turn). Position is measured, z = (x, y) + N(0, sigma^2 I).
`ukf` runs `ct` alone, `kf` a four-state constant-velocity Kalman filter.

The prior is given at `times[0]`, whose measurement is NaN; every later time is one full cycle: mix, predict,
redraw the sigma points after Q, update, combine. The prior is the same in all modes and `mode_probs` is
stationary, so a package that mixes once more at `times[0]` gets the same estimates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

BANK_MODES = ("cv", "ca", "ct")
MODE_TRANSITION = np.array([[0.94, 0.03, 0.03], [0.03, 0.94, 0.03], [0.03, 0.03, 0.94]])
SIGMA_M = 5.0
_SMALL_ANGLE = 1e-4


class Result(NamedTuple):
    """Fused estimates after the last measurement; covariance ordered [x, y, vx, vy]."""

    position: np.ndarray  # (B, 2) m
    velocity: np.ndarray  # (B, 2) m/s
    covariance: np.ndarray  # (B, 4, 4)
    mode_probs: np.ndarray  # (B, M)


class Case(NamedTuple):
    """A prepared run: `prepare` is not timed, `run` is, `finish` turns what `run` gave into a Result."""

    run: Callable[[], Any]
    finish: Callable[[Any], Result] | None = None
    prepare: Callable[[], None] | None = None
    compile_s: float = 0.0


@dataclass(frozen=True)
class Problem:
    """One workload: B tracks, T steps after the prior, N states, M modes."""

    workload: str
    times: np.ndarray  # (T + 1,) s, irregular, 0.1 to 1 s apart
    measurements: np.ndarray  # (B, T + 1, 2) m; row 0 is NaN
    prior_mean: np.ndarray  # (B, N) at times[0]
    prior_cov: np.ndarray  # (N, N)
    modes: tuple[str, ...]
    mode_transition: np.ndarray  # (M, M), row = from, one step
    mode_probs: np.ndarray  # (M,) at times[0]
    sigma: float = SIGMA_M

    @property
    def tracks(self) -> int:
        return len(self.measurements)

    @property
    def steps(self) -> int:
        return len(self.times) - 1

    @property
    def noise(self) -> np.ndarray:
        """Measurement noise R (2, 2) in m^2."""
        return self.sigma**2 * np.eye(2)

    @property
    def position_index(self) -> tuple[int, int]:
        return (0, 2) if self.workload == "kf" else (0, 3)

    @property
    def order(self) -> list[int]:
        """State indices of x, y, vx, vy."""
        px, py = self.position_index
        return [px, py, px + 1, py + 1]

    def process_noises(self) -> np.ndarray:
        """Q of every step and mode, (T, M, N, N); packages get it ready-made, which is to their advantage."""
        return np.array([[process_noise(mode, dt) for mode in self.modes] for dt in np.diff(self.times)])

    def first(self, steps: int) -> Problem:
        """The same tracks, cut after `steps` steps."""
        return replace(self, times=self.times[: steps + 1], measurements=self.measurements[:, : steps + 1])


def move(mode: str, state: Any, dt: Any, trig: Callable[[Any], tuple[Any, Any, Any]]) -> tuple[Any, ...]:
    """Move the seven state components by dt, for floats, NumPy and JAX arrays alike.

    Args:
        mode: "cv", "ca" or "ct".
        state: the components x, vx, ax, y, vy, ay, w along the first axis.
        dt: seconds.
        trig: gives sin(u), cos(u) and sin(u)/u.

    Returns:
        the seven components at t + dt.
    """
    x, vx, ax, y, vy, ay, w = state
    if mode == "cv":
        return x + dt * vx, vx, 0.0 * ax, y + dt * vy, vy, 0.0 * ay, 0.0 * w
    if mode == "ca":
        half = 0.5 * dt * dt
        return x + dt * vx + half * ax, vx + dt * ax, ax, y + dt * vy + half * ay, vy + dt * ay, ay, 0.0 * w
    s, c, sinc = trig(0.5 * dt * w)
    chord, sin_full, cos_full = dt * sinc, 2.0 * s * c, 1.0 - 2.0 * s * s
    new_vx, new_vy = cos_full * vx - sin_full * vy, sin_full * vx + cos_full * vy
    new_x, new_y = x + chord * (c * vx - s * vy), y + chord * (s * vx + c * vy)
    return new_x, new_vx, -w * new_vy, new_y, new_vy, w * new_vx, w


def scalar_trig(u: float) -> tuple[float, float, float]:
    """Give sin(u), cos(u), sin(u)/u of a float."""
    s = math.sin(u)
    return s, math.cos(u), s / u if abs(u) > _SMALL_ANGLE else 1.0 - u * u / 6.0


def array_trig(u: np.ndarray, xp: Any = np) -> tuple[Any, Any, Any]:
    """Give sin(u), cos(u), sin(u)/u of an array of the array module xp."""
    s = xp.sin(u)
    tiny = xp.abs(u) < _SMALL_ANGLE
    return s, xp.cos(u), xp.where(tiny, 1.0 - u * u / 6.0, s / xp.where(tiny, 1.0, u))


def process_noise(mode: str, dt: float) -> np.ndarray:
    """Q of one mode: white acceleration (cv, ct) or white jerk (ca) per axis, small noise on the rest."""
    velocity_block = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    if mode == "kf-cv":
        return np.kron(np.eye(2), 2.0 * velocity_block)
    q = np.zeros((7, 7))
    for i in (0, 3):
        if mode == "ca":
            q[i : i + 3, i : i + 3] = 0.5 * np.array(
                [
                    [dt**5 / 20, dt**4 / 8, dt**3 / 6],
                    [dt**4 / 8, dt**3 / 3, dt**2 / 2],
                    [dt**3 / 6, dt**2 / 2, dt],
                ]
            )
        else:
            q[i : i + 2, i : i + 2] = (1.0 if mode == "cv" else 0.1) * velocity_block
            q[i + 2, i + 2] = 0.01 if mode == "cv" else 0.25
    q[6, 6] = 1e-3 * dt if mode == "ct" else 1e-4
    return q


def constant_velocity_matrix(dt: float) -> np.ndarray:
    """Transition F (4, 4) of the `kf` workload, state (x, vx, y, vy)."""
    return np.kron(np.eye(2), np.array([[1.0, dt], [0.0, 1.0]]))


def make_problem(workload: str, tracks: int, steps: int, seed: int = 1) -> Problem:
    """Simulate manoeuvring targets and their measured positions.

    Args:
        workload: "bank", "ukf" or "kf"; all three see the same measurements.
        tracks: number of tracks B.
        steps: number of steps T after the prior.
        seed: of NumPy's default generator.
    """
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(np.round(rng.uniform(0.1, 1.0, steps), 3))])
    truth = np.zeros((tracks, 7))
    truth[:, [0, 3]] = rng.normal(0.0, 1000.0, (tracks, 2))
    truth[:, [1, 4]] = rng.normal(0.0, 20.0, (tracks, 2))
    prior_mean = truth + rng.normal(size=(tracks, 7)) * [10.0, 5.0, 0.0, 10.0, 5.0, 0.0, 0.0]
    measurements = np.full((tracks, steps + 1, 2), np.nan)
    mode = rng.integers(3, size=tracks)
    for k in range(steps):
        switched = rng.random(tracks) < 0.06
        mode = np.where(switched, rng.integers(3, size=tracks), mode)
        drawn = rng.normal(size=(tracks, 3)) * [2.0, 2.0, 0.2]
        truth[:, [2, 5, 6]] = np.where(switched[:, None], drawn, truth[:, [2, 5, 6]])
        dt = times[k + 1] - times[k]
        moved = [np.stack(move(name, truth.T, dt, array_trig), axis=-1) for name in BANK_MODES]
        truth = np.choose(mode[:, None], moved)
        measurements[:, k + 1] = truth[:, [0, 3]] + rng.normal(0.0, SIGMA_M, (tracks, 2))
    prior_cov = np.diag([100.0, 25.0, 4.0, 100.0, 25.0, 4.0, 0.04])
    if workload == "kf":
        keep = [0, 1, 3, 4]
        return Problem(
            workload, times, measurements, prior_mean[:, keep], prior_cov[np.ix_(keep, keep)],
            ("kf-cv",), np.ones((1, 1)), np.ones(1),
        )  # fmt: skip
    if workload == "ukf":
        return Problem(workload, times, measurements, prior_mean, prior_cov, ("ct",), np.ones((1, 1)), np.ones(1))
    if workload == "bank":
        return Problem(
            workload,
            times,
            measurements,
            prior_mean,
            prior_cov,
            BANK_MODES,
            MODE_TRANSITION,
            np.full(3, 1 / 3),
        )
    raise ValueError(f"make_problem: workload must be bank, ukf or kf; got {workload!r}. Choose one of these.")


def to_result(problem: Problem, mean: np.ndarray, cov: np.ndarray, mode_probs: np.ndarray) -> Result:
    """Take position, velocity and their covariance out of fused states (B, N), (B, N, N), (B, M)."""
    order = problem.order
    mean, cov = np.asarray(mean), np.asarray(cov)
    return Result(mean[:, order[:2]], mean[:, order[2:]], cov[:, order][:, :, order], np.asarray(mode_probs))


def difference(result: Result, truth: Result) -> float:
    """Largest difference of two results: means in standard deviations, covariances as correlations."""
    deviation = np.sqrt(np.einsum("bii->bi", truth.covariance))
    mean = np.concatenate([result.position - truth.position, result.velocity - truth.velocity], axis=1)
    cov = (result.covariance - truth.covariance) / (deviation[:, :, None] * deviation[:, None, :])
    worst = max(
        np.abs(mean / deviation).max(),
        np.abs(cov).max(),
        np.abs(result.mode_probs - truth.mode_probs).max() if truth.mode_probs.shape[1] > 1 else 0.0,
    )
    return float(worst) if np.isfinite(worst) else math.inf
