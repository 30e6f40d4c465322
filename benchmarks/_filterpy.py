"""FilterPy (>= 2.0): UnscentedKalmanFilter and IMMEstimator, one object per track, looped in Python."""

from __future__ import annotations

from typing import Any

import numpy as np
from _problem import Case, Problem, constant_velocity_matrix, move, scalar_trig, to_result
from filterpy.kalman import IMMEstimator, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter


class _RedrawingFilter(UnscentedKalmanFilter):
    """For FilterPy < 2.0, whose update reuses the points of the prediction, without Q."""

    def predict(self, *args: Any, **kwargs: Any) -> None:
        super().predict(*args, **kwargs)
        self.sigmas_f = self.points_fn.sigma_points(self.x, self.P)


def _redraws_itself() -> bool:
    """True where the points of the update already include Q (2.0 does, 1.4.5 does not)."""
    points = MerweScaledSigmaPoints(1, 1.0, 2.0, 0.0)
    one = UnscentedKalmanFilter(1, 1, 1.0, hx=lambda x: x, fx=lambda x, dt: x, points=points)
    one.predict()
    return bool(abs(one.sigmas_f[1, 0]) > 1.2)


def _unscented(problem: Problem, mode: str) -> UnscentedKalmanFilter:
    kind = UnscentedKalmanFilter if _redraws_itself() else _RedrawingFilter
    px, py = problem.position_index
    one = kind(
        dim_x=7,
        dim_z=2,
        dt=1.0,
        hx=lambda x: np.array([x[px], x[py]]),
        fx=lambda x, dt: np.array(move(mode, x.tolist(), dt, scalar_trig)),
        points=MerweScaledSigmaPoints(7, alpha=1.0, beta=2.0, kappa=0.0),
    )
    one.R = problem.noise
    return one


def _start(problem: Problem, one: Any, b: int) -> None:
    one.x, one.P = problem.prior_mean[b].copy(), problem.prior_cov.copy()


def make(problem: Problem, stepwise: bool = False) -> Case:
    """Prepare one filter object per track; `run` is the loop over tracks and steps."""
    noises, dts = problem.process_noises(), [float(dt) for dt in np.diff(problem.times)]
    tracks: list[Any] = []

    def prepare() -> None:
        tracks.clear()
        for b in range(problem.tracks):
            if problem.workload == "kf":
                one: Any = KalmanFilter(dim_x=4, dim_z=2)
                one.H, one.R = np.eye(4)[list(problem.position_index)], problem.noise
                _start(problem, one, b)
            else:
                filters = [_unscented(problem, mode) for mode in problem.modes]
                for part in filters:
                    _start(problem, part, b)
                one = filters[0]
                if problem.workload == "bank":
                    one = IMMEstimator(filters, problem.mode_probs, problem.mode_transition)
            tracks.append(one)

    matrices = [constant_velocity_matrix(dt) for dt in dts]

    def run() -> list[Any]:
        for one, measured in zip(tracks, problem.measurements, strict=True):
            for k, dt in enumerate(dts):
                if problem.workload == "kf":
                    one.predict(F=matrices[k], Q=noises[k, 0])
                elif problem.workload == "ukf":
                    one.Q = noises[k, 0]
                    one.predict(dt)
                else:
                    for part, q in zip(one.filters, noises[k], strict=True):
                        part.Q = q
                    # IMMEstimator hands its control input on as the filters' first argument, here dt
                    one.predict(dt)
                one.update(measured[k + 1])
        return tracks

    def finish(done: list[Any]) -> Any:
        mode_probs = [getattr(one, "mu", [1.0]) for one in done]
        return to_result(
            problem,
            np.array([one.x for one in done]),
            np.array([one.P for one in done]),
            np.array(mode_probs),
        )

    return Case(run=run, finish=finish, prepare=prepare)
