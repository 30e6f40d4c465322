"""Errors against time: over a run, around switches of intent and around the beginnings of noise surges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes
from jink.estimators.api import Estimates
from jink.estimators.metrics import chi_square_band, nees
from jink.training.ladder.scores import Readings, surging

__all__ = ["Curve", "Curves", "add_curves", "start_curves", "take_curves"]

Floats = NDArray[np.float64]
BEFORE_S, AFTER_S = 1.0, 5.0
"""What is shown around an event; s."""


class Curve(NamedTuple):
    """Values at times, and the 95 % band that a consistent estimator keeps (NaN: none)."""

    at: Floats
    values: Floats
    unit: str
    low: float = np.nan
    high: float = np.nan


class Curves(NamedTuple):
    """Sums and counts of samples by curve, over as many runs as were added; times of the bins, s."""

    step: float
    times: Floats
    around: Floats
    sums: dict[str, tuple[Floats, Floats]]


def start_curves(step: float, samples: int) -> Curves:
    """Nothing added yet.

    Args:
        step: time between samples, nominally; s.
        samples: of a run.
    """
    around = np.arange(-round(BEFORE_S / step), round(AFTER_S / step) + 1, dtype=np.float64)
    return Curves(step, step * np.arange(samples, dtype=np.float64), step * around, {})


def add_curves(curves: Curves, episodes: Episodes, found: Estimates, said: Readings) -> None:
    """Count B more runs."""
    truth = episodes.truth
    squares = np.sum((found.position - truth.position) ** 2, axis=2)
    _add(curves, "error_over_time", np.nansum(squares, axis=0), np.isfinite(squares).sum(axis=0))
    if np.isfinite(found.covariance).all():
        normalised = nees(found.position, found.velocity, found.covariance, truth.position, truth.velocity)
        _add(curves, "nees_over_time", normalised.sum(axis=0), np.full(squares.shape[1], len(squares)))
    used = np.asarray(found.nis_dof) > 0
    if used.any():
        nis = np.where(used, found.nis, 0.0)
        _add(curves, "nis_over_time", nis.sum(axis=0), np.asarray(found.nis_dof).sum(axis=0))
    switches = [
        (b, time, after[0] if len(after) else np.inf)
        for b, row in enumerate(truth.switch_times)
        for i, time in enumerate(row[np.isfinite(row)])
        for after in [row[i + 1 :][np.isfinite(row[i + 1 :])]]
    ]
    loud = surging(episodes)
    starts = [(int(b), episodes.times[b, k + 1], np.inf) for b, k in np.argwhere(loud[:, 1:] & ~loud[:, :-1])]
    for what, events in (("switch", switches), ("surge", starts)):
        if not events:
            continue
        _add(curves, f"error_after_{what}", *_around(curves, episodes.times, squares, events))
    if said.intents is not None and switches:
        right = np.take_along_axis(said.intents, truth.intent.astype(np.int64)[..., None], axis=2)[..., 0]
        _add(curves, "intent_after_switch", *_around(curves, episodes.times, right, switches))
    if said.surge is not None and starts:
        _add(curves, "surge_probability_after_surge", *_around(curves, episodes.times, said.surge, starts))


def take_curves(curves: Curves, axes: int) -> dict[str, Curve]:
    """The curves of all runs added; bins without a sample are left out."""
    found = {}
    for name, (total, count) in curves.sums.items():
        some = count > 0
        values = total[some] / count[some]
        at = (curves.times if name.endswith("_over_time") else curves.around)[some]
        if name.startswith("error"):
            found[name] = Curve(at, np.sqrt(values), "m")
        elif name == "nees_over_time":
            found[name] = Curve(
                at, values, "", *chi_square_band(2 * axes, max(round(float(np.median(count[some]))), 1))
            )
        elif name == "nis_over_time":
            typical = float(np.median(count[some]))
            found[name] = Curve(at, values, "", *chi_square_band(1, max(round(typical), 1)))
        else:
            found[name] = Curve(at, values, "")
    return found


def _around(
    curves: Curves, times: Floats, values: Floats, events: list[tuple[int, float, float]]
) -> tuple[Floats, Floats]:
    """Sums and counts by time from the event; samples after the next event do not count."""
    total, count = np.zeros(len(curves.around)), np.zeros(len(curves.around))
    first = round(curves.around[0] / curves.step)
    for b, event, stop in events:
        since = times[b] - event
        place = np.rint(since / curves.step).astype(np.int64) - first
        used = (place >= 0) & (place < len(total)) & (times[b] < stop) & np.isfinite(values[b])
        np.add.at(total, place[used], values[b, used])
        np.add.at(count, place[used], 1.0)
    return total, count


def _add(curves: Curves, name: str, total: Floats, count: Floats) -> None:
    old = curves.sums.get(name)
    curves.sums[name] = (total, np.asarray(count, float)) if old is None else (old[0] + total, old[1] + count)
