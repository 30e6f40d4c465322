"""Jink's side of the comparison: each function prepares the work and returns a callable that does it.

The callable takes nothing, runs the whole problem and returns a `_problem.Result`. Everything that a user
does once (building the estimator, compiling, copying inputs) belongs before it; everything done per run
belongs in it.
"""

from __future__ import annotations

from collections.abc import Callable

from _problem import Problem, Result

# ------------------------------------------------------------------------------------------------------
# To fill. `problem` carries the modes of `_problem.move` and `_problem.process_noise`: same Q, same points.
# ------------------------------------------------------------------------------------------------------


def jink_bank(problem: Problem, linear_shortcut: bool = False) -> Callable[[], Result]:
    """Prepare the three-mode unscented bank on all tracks at once (`run`).

    Args:
        problem: workload "bank".
        linear_shortcut: False does the peers' work (three unscented filters); True may run the linear modes
            as Kalman filters, which gives the same estimates and is shown as a row of its own.
    """
    raise NotImplementedError("jink_bank: not written yet; fill it in benchmarks/_jink.py.")


def jink_ukf(problem: Problem) -> Callable[[], Result]:
    """Prepare one unscented filter (mode `ct`, N = 7) on all tracks at once."""
    raise NotImplementedError("jink_ukf: not written yet; fill it in benchmarks/_jink.py.")


def jink_kf(problem: Problem) -> Callable[[], Result]:
    """Prepare one Kalman filter (constant velocity, N = 4) on all tracks at once."""
    raise NotImplementedError("jink_kf: not written yet; fill it in benchmarks/_jink.py.")


def jink_step(problem: Problem) -> Callable[[], Result]:
    """Prepare a Python loop of single `step` calls on the first track, for any of the three workloads."""
    raise NotImplementedError("jink_step: not written yet; fill it in benchmarks/_jink.py.")


def jink_scaling(kind: str, size: int, tracks: int, steps: int) -> Callable[[], object]:
    """Prepare a run in which one thing grows.

    Args:
        kind: "modes" (size = number of modes of the bank: cv, ca, ct, cv, ...) or "state" (size = number of
            state components N of one unscented filter, a chain of N / 2 derivatives per axis).
        size: the number of modes or of state components.
        tracks: number of tracks.
        steps: steps per track.
    """
    raise NotImplementedError("jink_scaling: not written yet; fill it in benchmarks/_jink.py.")


# ------------------------------------------------------------------------------------------------------
