"""Noise, acceleration and speed from the tracks themselves, when nobody gave them."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize
from scipy.special import gammaln
from scipy.stats import chi2

from jink.estimators.sensor import Sensor
from jink.estimators.sensors import SENSORS, make_sensor
from jink.estimators.starting import start_batch
from jink.estimators.tracks import Tracks
from jink.training.stretches import cut_stretches, rough_sigma, rough_speed, smallest_steps

__all__ = ["DEFAULT_SPEED", "Tuning", "sensor_of", "tune"]

Floats = NDArray[np.float64]

DEFAULT_SPEED = 10.0
"""m/s, where the sensor shows neither positions nor ranges."""
_DOF = 4.0  # of the Student-t score: one gross outlier costs a few nats, however gross
_RANGE = (1e-4, 1e3)  # of a sigma, against its rough guess
_ACCELERATIONS = (1e-6, 1e6)  # m/s^2
_STARTING = 4


class Tuning(NamedTuple):
    """What a file says about itself.

    sigma: standard deviation per measurement component; (D,); metres, radians, m/s.
    acceleration: typical acceleration of the target; m/s^2.
    speed: typical speed along each axis; m/s.
    log_likelihood: robust score at these values; nats per measured step.
    evaluations: how often a filter was run.
    tuned: which of sigma, acceleration and speed were estimated; the rest was given or a default.
    """

    sigma: tuple[float, ...]
    acceleration: float
    speed: float
    log_likelihood: float
    evaluations: int
    tuned: tuple[str, ...]


def sensor_of(tracks: Tracks, sigma: Sequence[float] | Floats | None = None) -> Sensor:
    """The sensor that the tracks were measured with.

    Args:
        tracks: what was measured; `sensor` names a kind of the registry.
        sigma: standard deviation per component; None: 1 each.

    Raises:
        ValueError: no such sensor, or as many axes as it does not have.
    """
    size = tracks.measurements.shape[2]
    if tracks.sensor not in SENSORS:
        raise ValueError(
            f"sensor_of: tracks must be measured by one of {', '.join(SENSORS)}; got '{tracks.sensor}'. "
            "Map other columns with --columns."
        )
    options: dict[str, Any] = {"sigma": [1.0] * size if sigma is None else list(sigma)}
    if tracks.sensor in {"position", "range", "range-rate"}:
        options["axes"] = tracks.axes
    sensor = make_sensor(tracks.sensor, **options)
    if sensor.axes != tracks.axes:
        raise ValueError(
            f"sensor_of: tracks of a {tracks.sensor} sensor must have {sensor.axes} axes; got {tracks.axes}. "
            f"Use --axes {sensor.axes}."
        )
    return sensor


@functools.cache
def _consistency(dof: int) -> float:
    """Scale k that makes the Student-t score of a correct Gaussian filter stationary at the true covariance.

    Solves E[(nu + d) q / (nu k + q)] = d for q ~ chi2_d.
    """
    q = chi2.ppf((np.arange(20000) + 0.5) / 20000, dof)
    return float(brentq(lambda k: np.mean((_DOF + dof) * q / (_DOF * k + q)) - dof, 1e-3, 10.0))


def robust_score(estimates: Any, used: NDArray[np.bool_]) -> float:
    """Student-t log-likelihood of the innovations; nats per measured step; -inf without any.

    Model: v ~ t_4(0, k S) with S the filter's innovation covariance and k such that Gaussian data are not
    pulled. Steps of the start carry no innovation and do not count.

    Args:
        estimates: of one estimator, with nis, nis_dof, log_likelihood and status; (B, T).
        used: rows that are not padding; (B, T).
    """
    dof = np.asarray(estimates.nis_dof)
    counted = used & (dof > 0) & (np.asarray(estimates.status) != _STARTING)
    if not counted.any():
        return -math.inf
    d, nis = dof[counted].astype(float), np.asarray(estimates.nis)[counted]
    log_det = -2.0 * np.asarray(estimates.log_likelihood)[counted] - nis - d * math.log(2 * math.pi)
    k = np.array([_consistency(int(n)) for n in range(1, int(d.max()) + 1)])[d.astype(int) - 1]
    norm = gammaln((_DOF + d) / 2) - gammaln(_DOF / 2) - 0.5 * d * np.log(math.pi * _DOF * k)
    terms = norm - 0.5 * log_det - 0.5 * (_DOF + d) * np.log1p(nis / (_DOF * k))
    return float(np.mean(terms)) if np.all(np.isfinite(terms)) else -math.inf


def tune(
    tracks: Tracks,
    *,
    sigma: Sequence[float] | None = None,
    acceleration: float | None = None,
    speed: float | None = None,
    steps: int = 2000,
    advance: Callable[[], None] | None = None,
) -> Tuning:
    """Estimate what was not given, from the innovations of `kf-cv` on stretches of the tracks.

    First the balance: a coarse grid over log sigma and log acceleration, then Nelder-Mead, on a Student-t
    likelihood that no outlier can bend. Then the size: sigma and acceleration together (the gains stay) so that
    the NIS, its upper tenth left out, is what it should be. Deterministic. Components that measure the same thing
    (x and y) share a sigma; none is below the quantisation of its component; sigmas in the file are kept.

    Args:
        tracks: what was measured.
        sigma: standard deviation per component where known; (D,).
        acceleration: where known; m/s^2.
        speed: where known; m/s.
        steps: rows to run on, about.
        advance: called after each run of the filter, for a progress bar.

    Returns:
        the values, given or estimated.

    Raises:
        ValueError: an unknown sensor, or too few measurements to estimate from.
    """
    from jink.estimators.recipes import make_estimator

    plain = sensor_of(tracks, sigma)
    free_sigma = sigma is None and tracks.noise is None
    if not free_sigma and acceleration is not None and speed is not None:
        return Tuning(plain.sigma, acceleration, speed, math.nan, 0, ())
    sample = cut_stretches(tracks, steps)
    rough = np.asarray(plain.sigma)
    if free_sigma:
        rough = rough_sigma(sample, plain)
    elif tracks.noise is not None and sigma is None:
        rough = np.sqrt(np.median(np.diagonal(sample.noise[sample.used], axis1=1, axis2=2), axis=0))  # type: ignore[index]
    found_speed = speed if speed is not None else rough_speed(sample, sensor_of(tracks, rough), rough)
    group = _groups(plain)
    quantum = smallest_steps(sample, plain) / math.sqrt(12)
    if free_sigma:
        rough, quantum = (np.array([values[group == g].max() for g in group]) for values in (rough, quantum))
    sample, prior = _started(sample, sensor_of(tracks, rough), found_speed or DEFAULT_SPEED)
    rough = np.maximum(rough, quantum) if free_sigma else rough
    low = np.maximum(quantum, _RANGE[0] * rough)
    names = tuple(n for n, f in (("sigma", free_sigma), ("acceleration", acceleration is None)) if f)
    active = np.array([free_sigma] * (int(group.max()) + 1) + [acceleration is None])
    evaluations, best = 0, -math.inf

    def run(values: tuple[float, ...], density: float) -> Any:
        engine = make_estimator(
            "kf-cv", sensor_of(tracks, values), acceleration=density, speed=found_speed or DEFAULT_SPEED
        )
        noise = sample.noise if sigma is None else None
        return engine.run(sample.measurements, sample.times, noise, sample.sensor_states, sample.lengths, prior=prior)

    def unpack(theta: Floats) -> tuple[tuple[float, ...], float]:
        values = rough
        if free_sigma:
            values = np.clip(rough * np.exp(theta[group]), low, np.maximum(_RANGE[1] * rough, low))
        return tuple(map(float, values)), float(np.exp(theta[-1])) if acceleration is None else acceleration

    def cost(part: Floats) -> float:
        nonlocal evaluations, best
        theta = np.zeros(len(active))
        theta[active] = part
        evaluations += 1
        values, density = unpack(theta)
        if acceleration is None and not _ACCELERATIONS[0] <= density <= _ACCELERATIONS[1]:
            return 1e9
        score = robust_score(run(values, density), sample.used)
        best = max(best, score)
        if advance is not None:
            advance()
        # The faint pull towards the rough guess only decides where the data are silent.
        return min(1e9, -score + 1e-5 * float(np.sum(np.square(theta[:-1]))))

    theta = np.zeros(len(active))
    if names:
        grid = _grid(sample, plain, rough, group, free_sigma, acceleration)
        start = min((point[active] for point in grid), key=cost)
        simplex = np.vstack([start, start + 0.7 * np.eye(len(start))])
        options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-5, "maxfev": 60 * len(start)}
        theta[active] = minimize(cost, start, method="Nelder-Mead", options=options).x
    else:
        cost(theta[active])
    values, density = unpack(theta)
    if len(names) == 2:
        # R and Q times one factor leave the gains alone and make the covariances honest.
        factor = math.sqrt(_trimmed_nis(run(values, density), sample.used))
        values, density = tuple(factor * value for value in values), factor * density
    tuned = names + (("speed",) if speed is None and found_speed is not None else ())
    return Tuning(values, density, found_speed or DEFAULT_SPEED, best, evaluations, tuned)


def _trimmed_nis(estimates: Any, used: NDArray[np.bool_], share: float = 0.9) -> float:
    """Mean NIS over its expectation, of the lower `share` of steps; at least 1/4, at most 100; 1 without steps."""
    dof = np.asarray(estimates.nis_dof)
    counted = used & (dof > 0)
    if not counted.any():
        return 1.0
    d, nis = dof[counted], np.asarray(estimates.nis)[counted]
    bound = np.quantile(nis / d, share)
    # E[q; q < its quantile] of chi2_d is d times the distribution function of chi2_{d+2} there.
    expected = {int(n): n * chi2.cdf(chi2.ppf(share, n), n + 2) / share for n in np.unique(d)}
    kept = nis / d <= bound
    return float(np.clip(nis[kept].sum() / sum(expected[int(n)] for n in d[kept]), 0.25, 100.0))


def _started(sample: Tracks, sensor: Sensor, speed: float) -> tuple[Tracks, Any]:
    """The stretches from where their targets are located on, and the prior there.

    Finding a target in ranges costs more than following it, so it is done once and not per evaluation.
    """
    from jink.estimators.inputs import Prior

    noise = sensor.noise if sample.noise is None else sample.noise
    noise = np.broadcast_to(noise, (*sample.measurements.shape, sensor.size))
    start = start_batch(sensor, sample.measurements, sample.times, noise, sample.sensor_states, speed)
    T = sample.times.shape[1]
    grid = np.minimum(start.index[:, None] + np.arange(T), T - 1)
    rows = np.arange(len(sample))[:, None]
    lengths = np.maximum(sample.lengths - start.index, 1)
    padding = np.arange(T) >= lengths[:, None]
    moved = replace(
        sample,
        times=sample.times[rows, grid],
        measurements=np.where(padding[..., None], np.nan, sample.measurements[rows, grid]),
        lengths=lengths,
        noise=None if sample.noise is None else sample.noise[rows, grid],
        sensor_states=None if sample.sensor_states is None else sample.sensor_states[rows, grid],
    )
    mean = np.concatenate([start.position, start.velocity], axis=1)
    return moved, Prior(mean, start.covariance, includes_first=True)


def _groups(sensor: Sensor) -> NDArray[np.int64]:
    """Which sigma each component uses: x and y one, several ranges one, the rest its own; (D,)."""
    kinds = ["horizontal" if label in {"x", "y"} else label.split(" ")[0] for label in sensor.labels]
    if "range rate" in sensor.labels:
        kinds[sensor.labels.index("range rate")] = "rate"
    order = list(dict.fromkeys(kinds))
    return np.array([order.index(kind) for kind in kinds])


def _grid(
    sample: Tracks,
    sensor: Sensor,
    rough: Floats,
    group: NDArray[np.int64],
    free_sigma: bool,
    acceleration: float | None,
) -> list[Floats]:
    """Starting points (log sigma against rough per group, log acceleration), coarse and few."""
    gaps = np.diff(sample.times, axis=1)[sample.used[:, 1:]]
    dt = float(np.median(gaps[gaps > 0])) if (gaps > 0).any() else 1.0
    metres = [s for s, unit in zip(rough, sensor.units, strict=True) if unit == "m"]
    scale = metres[0] if metres else 1.0
    fractions = (0.1, 0.3, 1.0) if free_sigma else (1.0,)
    # Tracking index a dt^2 / sigma: from a target that hardly turns to one that outruns its noise.
    indices = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
    accelerations = [index * scale / dt**2 for index in indices] + [0.1, 1.0, 10.0]
    if acceleration is not None:
        accelerations = [acceleration]
    return [
        np.append(np.full(int(group.max()) + 1, math.log(fraction)), math.log(a))
        for fraction in fractions
        for a in accelerations
    ]
