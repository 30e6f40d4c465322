"""What an estimator does with what is known beforehand: `jink bench` gives everybody a prior."""

from __future__ import annotations

import numpy as np

from jink.estimators.inputs import Prior
from jink.estimators.status import DIVERGED
from jink.training.contract.subject import SPEED, Broken, Subject, finite_of, must_be_known, same

__all__ = ["check_prior"]

_PLACE_M = 50.0
"""Standard deviation of each coordinate of the prior; m."""


def check_prior(subject: Subject) -> str:
    """A prior, as the benchmark gives one to every estimator: taken or ignored, left as it was, each track its own."""
    case, axes = subject.case, subject.sensor.axes
    mean = np.concatenate([case.truth[:, 0], np.zeros((len(case.times), axes))], axis=1)
    cov = np.diag(np.repeat([_PLACE_M**2, SPEED**2], axes))
    kept = mean.copy(), cov.copy()
    e = subject.run(prior=Prior(mean, cov))
    if not (np.array_equal(mean, kept[0]) and np.array_equal(cov, kept[1])):
        raise Broken("the prior was changed", "Work on copies of its mean and covariance.")
    if text := finite_of(e):
        raise Broken(
            f"with a prior {text}",
            "A prior is (mean, covariance) of position, then velocity, at the first row; without one it is None.",
        )
    must_be_known(e)
    if (e.status == DIVERGED).any():
        raise Broken("with a prior rows diverge on an easy track", "Look at the order: all positions, then velocities.")
    other = mean.copy()
    other[0, :axes] += _PLACE_M
    if text := same(e, subject.run(prior=Prior(other, cov)), rows=slice(1, None)):
        raise Broken(f"another track's prior changes {text}", "Begin each track from its own row of the prior.")
    unused = not same(e, subject.run())
    return "not asked for" if unused else "taken; each track has its own"
