"""Tracks as they come: gaps, odd times, outliers."""

from __future__ import annotations

import numpy as np

from jink.estimators.status import DIVERGED, STARTING, STATUS_NAMES
from jink.training.contract.subject import Broken, Subject, columns_of, finite_of, must_be_known

__all__ = ["check_missing", "check_outliers", "check_times"]


def check_missing(subject: Subject) -> str:
    """Gaps, parts of measurements, tracks that begin late or hold nothing."""
    z = subject.case.measurements.copy()
    z[0, 10:14] = np.nan
    z[0, 20, 0] = np.nan
    z[1, :4] = np.nan
    z[2] = np.nan
    e = subject.run(z)
    if text := finite_of(columns_of(e, lambda column: column[:2])):
        raise Broken(
            f"with missing measurements {text}",
            "Where a component is NaN, predict without it: np.isfinite(measurement) says which there are.",
        )
    must_be_known(e)
    if (e.status[:2] == DIVERGED).any():
        raise Broken("a gap makes a row diverge", "Where a measurement is NaN, predict and do not update.")
    if not (e.status[2] == STARTING).all():
        raise Broken(f"a track without measurements is {STATUS_NAMES[e.status[2, -1]]}", "Report it as starting (4).")
    if (np.asarray(e.nis_dof)[~np.isfinite(z).any(axis=2)] != 0).any():
        raise Broken("nis_dof is above 0 where nothing was measured", "Report 0 there.")
    return "gaps of four rows, half a measurement, a late start, an empty track"


def check_times(subject: Subject) -> str:
    """Irregular times, equal times, a long gap, one row, no row."""
    z, t = subject.case.measurements.copy(), subject.case.times.copy()
    t[:, 20:] += 600.0
    t[:, 11] = t[:, 10]
    e = subject.run(z, t)
    if text := finite_of(e):
        raise Broken(
            f"with equal times or a gap of 600 s {text}",
            "The time step can be 0: do not divide by it; over a long one, do not let covariances overflow.",
        )
    must_be_known(e)
    if (e.status[:, :20] == DIVERGED).any():
        raise Broken(
            "a row of the same time as the one before is diverged",
            "The time step can be 0: do not divide by it.",
        )
    for rows in (0, 1):
        e = subject.run(z[:, :rows], t[:, :rows])
        if np.shape(e.position) != (len(t), rows, subject.sensor.axes) or finite_of(e):
            raise Broken(f"tracks of {rows} rows give positions {np.shape(e.position)}", "Take any number of rows.")
    return "equal times, a gap of 600 s, one row, none"


def check_outliers(subject: Subject) -> str:
    """A wild measurement makes no NaN and no exception."""
    z = subject.case.measurements.copy()
    z[:, 15] *= 1e6
    z[1, 16] = -z[1, 16]
    e = subject.run(z)
    if text := finite_of(e):
        raise Broken(f"after an outlier {text}", "Guard against overflow; report DIVERGED (3) instead of NaN.")
    must_be_known(e)
    return "a measurement a million times too large"
