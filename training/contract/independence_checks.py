"""What an estimate may depend on: its own track's rows up to it, and nothing else."""

from __future__ import annotations

import copy
from operator import itemgetter

import numpy as np

from jink.training.contract.subject import Broken, Subject, columns_of, same
from jink.training.outside import OutsideEstimator

__all__ = [
    "check_causal",
    "check_deterministic",
    "check_inputs_untouched",
    "check_neighbours",
    "check_padding",
    "check_singles",
]


def check_inputs_untouched(subject: Subject) -> str:
    """The arrays it was given are as before."""
    z, t = subject.case.measurements.copy(), subject.case.times.copy()
    z[0, 5] = np.nan
    R = np.array(np.broadcast_to(subject.sensor.noise, (*t.shape, *subject.sensor.noise.shape)))
    places = np.zeros((*t.shape, 2 * subject.sensor.axes))
    given, names = (z, t, R, places), ("measurements", "times", "noise", "sensor_states")
    made = subject.make()
    if isinstance(made, OutsideEstimator):
        made = made.without_copies()
    kept = copy.deepcopy(given)
    made.run(z, t, R, places)
    for name, now, before in zip(names, given, kept, strict=True):
        if not np.array_equal(now, before, equal_nan=True):
            raise Broken(f"{name} were changed", f"Work on a copy: {name} = {name}.copy().")
    return "measurements, times, noise and sensor places are as before"


def check_deterministic(subject: Subject) -> str:
    """The same input gives the same bits: again, and from one made anew."""
    made = subject.make()
    z, t = subject.case.measurements, subject.case.times
    first = made.run(z, t)
    if text := same(first, made.run(z, t)):
        raise Broken(
            f"a second run of the same estimator gives {text}",
            "Keep nothing from one run to the next; begin each track from its own rows, and seed what is random.",
        )
    if text := same(first, subject.run()):
        raise Broken(f"one made anew gives {text}", "Seed its random numbers when it is made.")
    return "same bits in three runs"


def check_singles(subject: Subject) -> str:
    """A batch equals its tracks one by one."""
    batch = subject.run()
    for b in range(len(subject.case.times)):
        alone = subject.run(subject.case.measurements[b : b + 1], subject.case.times[b : b + 1])
        if text := same(alone, columns_of(batch, itemgetter(slice(b, b + 1)))):
            raise Broken(
                f"track {b} alone gives {text}",
                "Let nothing depend on the other tracks: no sums over the batch, no attribute kept between tracks.",
            )
    return f"{len(subject.case.times)} tracks alone give the same bits"


def check_neighbours(subject: Subject) -> str:
    """Other tracks, and their order, do not matter."""
    z, t = subject.case.measurements.copy(), subject.case.times
    before = subject.run()
    z[0] = z[0] * 1.5 + 7.0
    after = subject.run(z)
    if text := same(before, after, rows=slice(1, None)):
        raise Broken(f"another track's measurements change {text}", "Begin each track from its own rows alone.")
    turned = subject.run(subject.case.measurements[::-1], t[::-1])
    back = columns_of(turned, lambda column: column[::-1])
    if text := same(before, back):
        raise Broken(f"in another order the tracks give {text}", "Begin each track from its own rows alone.")
    return "neither values nor order of the neighbours matter"


def check_padding(subject: Subject) -> str:
    """Rows beyond a track's length do not matter."""
    z, t = subject.case.measurements.copy(), subject.case.times
    lengths = np.array([t.shape[1], t.shape[1] // 2, *[3] * (len(t) - 2)])
    first = subject.run(z, lengths=lengths)
    for b, n in enumerate(lengths):
        z[b, n:] = 1e6
    second = subject.run(z, lengths=lengths)
    for b, n in enumerate(lengths):
        if text := same(first, second, rows=(b, slice(0, n))):
            raise Broken(f"padding changes {text}", "Use only the first lengths[b] rows of track b.")
        short = subject.run(subject.case.measurements[b : b + 1, :n], t[b : b + 1, :n])
        if text := same(first, columns_of(short, lambda c: np.repeat(c, len(t), 0)), (b, slice(0, n))):
            raise Broken(f"a track without its padding gives {text}", "Use only the first lengths[b] rows of track b.")
    return "lengths " + ", ".join(map(str, lengths)) + " of one batch"


def check_causal(subject: Subject) -> str:
    """What comes later changes nothing before it: a filter, not a smoother."""
    cut = subject.case.times.shape[1] // 2
    z = subject.case.measurements.copy()
    z[:, cut:] = z[:, cut:] * 1.1 + 3.0
    if text := same(subject.run(), subject.run(z), rows=(slice(None), slice(0, cut))):
        raise Broken(
            f"later measurements change an earlier {text}",
            "Estimate row t from rows up to t: no smoothing, no statistics of the whole track.",
        )
    return f"rows after {cut} do not change those before"
