"""Estimators that take one row at a time: against their own `run`, and whether their state is a value."""

from __future__ import annotations

import copy

import numpy as np

from jink.training.contract.subject import Broken, NotAsked, Subject, same

__all__ = ["check_state", "check_steps"]


def check_steps(subject: Subject) -> str:
    """`run` equals `start` and a loop of `step`, bit for bit."""
    if not subject.streams:
        raise NotAsked("it takes whole tracks")
    made, (z, t, _) = subject.make(), subject.case
    whole = made.run(z, t)
    for b in range(len(t)):
        state, first = None, 0
        while state is None:
            first += 1
            if first > len(t[b]):
                raise Broken(f"track {b} never starts", "Let start return a state once the rows suffice.")
            try:
                state = made.start(z[b, :first], t[b, :first])
            except ValueError:
                state = None
        for row in range(first, t.shape[1]):
            state, one = made.step(state, z[b, row], t[b, row])
            for name in ("position", "velocity", "covariance", "mode_probs", "nis", "log_likelihood"):
                x, y = np.asarray(getattr(one, name)), np.asarray(getattr(whole, name))[b, row]
                if not np.array_equal(x, y, equal_nan=True):
                    one_by_one, at_once = x.ravel()[0].item(), y.ravel()[0].item()
                    raise Broken(
                        f"{name} of row {row}, track {b}: {one_by_one!r} by step, {at_once!r} by run",
                        "Let run be the loop of step, or leave run out: it then is.",
                    )
    return "run is the loop of step"


def check_state(subject: Subject) -> str:
    """The state is a value: a step leaves it as it was, and the estimator keeps nothing besides."""
    if not subject.streams:
        raise NotAsked("it takes whole tracks")
    made, (z, t, _) = subject.make(), subject.case
    state = made.start(z[0, :6], t[0, :6])
    # Bank states hold no references to others; a third party's may hold anything that can be copied.
    kept = copy.deepcopy(state)
    _, first = made.step(state, z[0, 6], t[0, 6])
    _, second = made.step(state, z[0, 6], t[0, 6])
    _, third = made.step(kept, z[0, 6], t[0, 6])
    if same(first, second) or same(first, third):
        raise Broken(
            "two steps from one state give different estimates",
            "Return a new state; change neither the given one nor self (x = x + dx, not x += dx).",
        )
    other = made.start(z[1, :6], t[1, :6])
    made.step(other, z[1, 6], t[1, 6])
    _, fourth = made.step(state, z[0, 6], t[0, 6])
    if text := same(first, fourth):
        raise Broken(f"a step of another track changes {text}", "Keep all that is known of a track in its state.")
    return "steps leave it as it was; tracks may take turns"
