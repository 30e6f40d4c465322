"""Where a track starts: position and velocity from its first measurements, for every sensor.

Convention: the Gaussian returned is the *posterior* at row ``index``, with all rows up to that one used.
The filter goes on with row ``index + 1``, so no measurement counts twice. The one exception is a start that
used no row at all (``seen == 0``: the prior area, or nothing): there the filter may update with that row too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.locating import reference_places
from jink.estimators.sensor import Sensor
from jink.estimators.starting_fit import Window, fit, observe_with_slope
from jink.estimators.starting_search import candidates, judge

__all__ = ["MAX_ROWS", "Area", "Start", "StartBatch", "start_batch", "start_prior"]
Area = tuple[ArrayLike, float]
"""Where targets appear: centre (A,) and standard deviation, metres."""
MAX_ROWS = 50
"""A start uses at most this many rows that hold something."""
_FAR = 1e5  # m, sd of a start that knows nothing


class Start(NamedTuple):
    """Gaussian over position and velocity of one track, and what it rests on.

    ``index``: row it holds at; ``position``, ``velocity``: mean, (A,); ``covariance``: (2 A, 2 A), positions
    first; ``seen``: rows used; ``ok``: False where nothing located the target (then broad, but finite).
    """

    index: int  # type: ignore[assignment]  # the name that fits hides tuple.index
    position: Array
    velocity: Array
    covariance: Array
    seen: int
    ok: bool


class StartBatch(NamedTuple):
    """`Start` of many tracks: index, seen, ok (B,), position, velocity (B, A), covariance (B, 2 A, 2 A)."""

    index: NDArray[np.int64]  # type: ignore[assignment]
    position: Array
    velocity: Array
    covariance: Array
    seen: NDArray[np.int64]
    ok: NDArray[np.bool_]


def start_prior(
    sensor: Sensor,
    z: Array,
    times: Array,
    R: Array,
    sensor_states: Array | None,
    speed: float,
    area: Area | None = None,
    complete: bool = True,
) -> Start:
    """Start one track.

    Model: ``v ~ N(0, speed^2 I)``; a row that locates alone gives ``p ~ N(locate(z, R))``, and a range rate
    in it then updates position and velocity. Other rows are gathered (5, 8, 12, ... up to `MAX_ROWS`) and
    ``p(t) = p + v (t - t_index)`` is fitted to them until one place explains them and its standard deviation
    is below 5 % of the distance to the sensors, or 3 sigma for linear sensors. At `MAX_ROWS`, or the end of
    the track, 50 % will do, and of two places that explain the rows alike the likelier one is taken with the
    covariance widened to the second moment about it. Otherwise ``area`` is the answer, using no row.

    Args:
        sensor: the sensor.
        z: measurements; (T, D); NaN = missing; rows entirely missing are skipped.
        times: increasing; (T,); s.
        R: measurement noise; (T, D, D); where it is no covariance, the sensor's default.
        sensor_states: sensor position and velocity; (T, 2 A); None: at rest in the origin.
        speed: standard deviation of the target's velocity along each axis; m/s.
        area: where targets appear, centre (A,) and standard deviation; m. A prior on position for fits too.
        complete: no further row will come. False (streaming): a start is only accepted where it would be with
            any rows following, so that starting on a growing track gives the same row and the same numbers.

    Returns:
        The start. With ``ok`` False it is broad: centred on the sensors, wide as the ranges seen or 100 km.

    Raises:
        ValueError: ``speed`` or ``area`` out of range.

    Source: Bar-Shalom, Li, Kirubarajan (2001), "Estimation with Applications to Tracking and Navigation", on
        starting filters; Levenberg-Marquardt with Huber weights (3 sigma) for the fit. Differs: a position
        starts with the velocity prior (one point), not with the difference of two points.
    """
    centre_sd = _checked_prior(sensor.axes, speed, area)
    present = np.flatnonzero(np.isfinite(z).any(axis=1))[:MAX_ROWS]
    states = np.zeros((len(z), 2 * sensor.axes)) if sensor_states is None else sensor_states
    z = np.where(np.isfinite(z), z, np.nan)
    ends = _window_ends(sensor, z[present], complete)
    solutions: Array | None = None
    previous = 0
    for rank, row in enumerate(present):
        noise = R[row] if _definite(R[row]) else sensor.noise
        located = None if sensor.locate is None else sensor.locate(sensor, z[row], noise, states[row])
        if located is not None:
            return _from_location(sensor, int(row), located, z[row], noise, states[row], speed)
        if rank + 1 not in ends:
            continue
        rows = present[: rank + 1]
        window = Window(sensor, z[rows], times[rows], R[rows], states[rows], speed, centre_sd)
        if solutions is None:
            solutions = candidates(window)
        else:
            axes = sensor.axes
            solutions[:, :axes] += solutions[:, axes:] * (times[row] - times[previous])
        previous = row
        solutions, costs, information = fit(window, solutions)
        last = rank + 1 == MAX_ROWS or (complete and rank + 1 == len(present))
        found = judge(window, solutions, costs, information, last)
        if found is not None:
            mean, cov = found
            return Start(int(row), mean[: sensor.axes], mean[sensor.axes :], cov, rank + 1, True)
    return _unlocated(sensor, z, states, present, speed, centre_sd)


def start_batch(
    sensor: Sensor,
    z: Array,
    times: Array,
    R: Array,
    sensor_states: Array | None,
    speed: float,
    area: Area | None = None,
) -> StartBatch:
    """Start many tracks; sensors of position at array speed, others track by track.

    Args:
        sensor: the sensor.
        z: measurements; (B, T, D); NaN = missing (padding too).
        times: (B, T); s.
        R: measurement noise; (B, T, D, D) or broadcast to it.
        sensor_states: (B, T, 2 A) or None.
        speed: as for `start_prior`.
        area: as for `start_prior`.

    Returns:
        The starts, equal to those of `start_prior`.

    Raises:
        ValueError: ``speed`` or ``area`` out of range.
    """
    tracks, axes = len(z), sensor.axes
    _checked_prior(axes, speed, area)
    batch = StartBatch(
        np.zeros(tracks, dtype=np.int64),
        np.zeros((tracks, axes)),
        np.zeros((tracks, axes)),
        np.zeros((tracks, 2 * axes, 2 * axes)),
        np.zeros(tracks, dtype=np.int64),
        np.zeros(tracks, dtype=np.bool_),
    )
    R = np.broadcast_to(R, (*z.shape, z.shape[-1]))
    slow = np.arange(tracks)
    if sensor.name == "position" and sensor.linear and sensor.size == axes and z.shape[1] > 0:
        finite = np.isfinite(z)
        any_seen = finite.any(axis=2)
        first = np.argmax(any_seen, axis=1)
        each = np.arange(tracks)
        noise = R[each, first]
        fast = finite[each, first].all(axis=1) & _definite(noise)
        chosen = each[fast]
        batch.index[chosen] = first[chosen]
        batch.position[chosen] = z[chosen, first[chosen]]
        symmetric = 0.5 * (noise[chosen] + noise[chosen].swapaxes(1, 2))
        batch.covariance[chosen, :axes, :axes] = symmetric
        batch.covariance[chosen, axes:, axes:] = speed**2 * np.eye(axes)
        batch.seen[chosen] = 1
        batch.ok[chosen] = True
        slow = each[~fast]
    for track in slow:
        states = None if sensor_states is None else sensor_states[track]
        start = start_prior(sensor, z[track], times[track], R[track], states, speed, area)
        batch.index[track], batch.seen[track], batch.ok[track] = start.index, start.seen, start.ok
        batch.position[track], batch.velocity[track] = start.position, start.velocity
        batch.covariance[track] = start.covariance
    return batch


def _definite(noise: Array) -> NDArray[np.bool_]:
    """Which matrices (..., D, D) are finite and positive definite (scaled to unit variances)."""
    variances = np.diagonal(noise, axis1=-2, axis2=-1)
    sound = np.asarray(np.isfinite(noise).all(axis=(-2, -1)) & (variances > 0).all(axis=-1))
    scale = np.sqrt(np.where(sound[..., None], variances, 1.0))
    scaled = np.where(sound[..., None, None], noise, 0.0) / scale[..., :, None] / scale[..., None, :]
    return np.asarray(sound & (np.linalg.eigvalsh(scaled)[..., 0] > 0.0))


def _checked_prior(axes: int, speed: float, area: Area | None) -> tuple[Array, float] | None:
    if not (np.isfinite(speed) and speed > 0):
        raise ValueError(f"start_prior: speed must be > 0 and finite; got {speed!r}. Give a typical speed in m/s.")
    if area is None:
        return None
    centre, sd = np.asarray(area[0], dtype=np.float64), float(area[1])
    if centre.shape != (axes,) or not np.isfinite(centre).all() or not (np.isfinite(sd) and sd > 0):
        raise ValueError(
            f"start_prior: area must be (centre ({axes},), sd > 0), finite; got {area!r}. "
            "Give both in metres, for instance ((0, 0), 5000)."
        )
    return centre, sd


def _window_ends(sensor: Sensor, z: Array, complete: bool) -> set[int]:
    """How many rows the fits use: from 2 A + 1 numbers (one spare) on, half as many again each time."""
    numbers = np.cumsum(np.isfinite(z).sum(axis=1))
    ends: set[int] = set()
    if len(z) == 0:
        return ends
    count = int(np.searchsorted(numbers, 2 * sensor.axes + 1)) + 1
    while count < MAX_ROWS:
        ends.add(count)
        count = max(count + 1, math.ceil(1.5 * count))
    ends.add(MAX_ROWS)
    if complete:
        ends.add(len(z))
    return ends


def _from_location(
    sensor: Sensor, row: int, located: tuple[Array, Array], z: Array, noise: Array, state: Array, speed: float
) -> Start:
    axes = sensor.axes
    mean = np.concatenate([located[0], np.zeros(axes)])
    cov = np.zeros((2 * axes, 2 * axes))
    cov[:axes, :axes] = located[1]
    cov[axes:, axes:] = speed**2 * np.eye(axes)
    rates = [i for i, unit in enumerate(sensor.units) if unit == "m/s" and np.isfinite(z[i])]
    if rates:
        expected, slope = observe_with_slope(sensor, mean[None], np.zeros(1), state[None], speed)
        distance = max(float(np.linalg.norm(mean[:axes] - state[:axes])), 1e-9)
        for i in rates:
            H = slope[0, 0, i]
            # Velocity across the line of sight leaks in through the uncertain direction: second order.
            leak = speed**2 * float(np.trace(located[1])) / distance**2
            gain = cov @ H / (H @ cov @ H + noise[i, i] + leak)
            mean = mean + gain * (z[i] - expected[0, 0, i] - H @ (mean - np.r_[located[0], np.zeros(axes)]))
            cov = cov - np.outer(gain, H @ cov)
        cov = 0.5 * (cov + cov.T)
    return Start(row, mean[:axes], mean[axes:], cov, 1, True)


def _unlocated(
    sensor: Sensor,
    z: Array,
    states: Array,
    present: NDArray[np.int64],
    speed: float,
    area: tuple[Array, float] | None,
) -> Start:
    axes = sensor.axes
    row = int(present[0]) if len(present) else 0
    if area is not None:
        centre, sd = area
    else:
        places = [reference_places(sensor, z[r], states[r]) for r in present] or [np.zeros((1, axes))]
        centre = np.concatenate(places).mean(axis=0)
        lengths = [i for i, unit in enumerate(sensor.units) if unit == "m"]
        seen = np.abs(z[present][:, lengths])
        seen = seen[np.isfinite(seen)]
        sd = float(seen.max()) + float(np.ptp(np.concatenate(places), axis=0).max()) if seen.size else _FAR
        sd = min(max(sd, 1e-3), 1e9)
    cov = np.diag(np.repeat([sd**2, speed**2], axes))
    return Start(row, np.array(centre), np.zeros(axes), cov, 0, area is not None)


Array = NDArray[np.float64]
