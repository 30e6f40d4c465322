"""Straight flight fitted to a track's first rows: robust, damped least squares from many starts at once."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jink.estimators.compiled import call_observe, entry_kernel
from jink.estimators.locating import reference_places
from jink.estimators.sensor import Sensor

Array = NDArray[np.float64]
_HUBER = 3.0


class Window:
    """The rows of one fit, whitened: residual = whiten (z - h)."""

    def __init__(
        self,
        sensor: Sensor,
        z: Array,
        times: Array,
        R: Array,
        states: Array,
        speed: float,
        area: tuple[Array, float] | None,
    ) -> None:
        self.sensor, self.z, self.states, self.speed, self.area = sensor, z, states, speed, area
        self.lags = times - times[-1]
        self.whiten = np.stack([_whitener(sensor, row, noise) for row, noise in zip(z, R, strict=True)])
        places = [reference_places(sensor, row, state) for row, state in zip(z, states, strict=True)]
        self.references = np.concatenate(places)
        self.numbers = int(np.isfinite(z).sum())
        axes = sensor.axes
        place = np.zeros(axes) if area is None else area[0]
        weight = 0.0 if area is None else 1.0 / area[1] ** 2
        self.prior_mean = np.concatenate([place, np.zeros(axes)])
        self.prior_information = np.diag(np.repeat([weight, 1.0 / speed**2], axes))

    def evaluate(self, solutions: Array) -> tuple[Array, Array, Array]:
        """Cost (S,), gradient (S, 2 A), information (S, 2 A, 2 A) of each solution, with Huber weights."""
        sensor = self.sensor
        expected, slope = observe_with_slope(sensor, solutions, self.lags, self.states, self.speed)
        residual = expected - self.z
        angular = np.asarray(sensor.angular)
        residual[..., angular] = np.remainder(residual[..., angular] + np.pi, 2 * np.pi) - np.pi
        missing = np.isnan(self.z)
        residual[:, missing] = 0.0
        slope[:, missing] = 0.0
        residual = np.einsum("tij,stj->sti", self.whiten, residual)
        slope = np.einsum("tij,stjn->stin", self.whiten, slope)
        length = np.linalg.norm(residual, axis=2)
        weight = np.minimum(1.0, _HUBER / np.maximum(length, 1e-300))
        cost = np.sum(np.where(length <= _HUBER, length**2, 2 * _HUBER * length - _HUBER**2), axis=1)
        offset = solutions - self.prior_mean
        cost = cost + np.einsum("si,ij,sj->s", offset, self.prior_information, offset)
        gradient = np.einsum("st,stin,sti->sn", weight, slope, residual) + offset @ self.prior_information
        information = np.einsum("st,stin,stim->snm", weight, slope, slope) + self.prior_information
        return np.where(np.isfinite(cost), cost, np.inf), gradient, information


def _whitener(sensor: Sensor, z: Array, noise: Array) -> Array:
    """Inverse Cholesky factor of the noise of the present components, zero rows for the others; (D, D)."""
    there = np.flatnonzero(np.isfinite(z))
    out = np.zeros((sensor.size, sensor.size))
    for candidate in (noise, sensor.noise):
        try:
            out[np.ix_(there, there)] = np.linalg.inv(np.linalg.cholesky(candidate[np.ix_(there, there)]))
        except np.linalg.LinAlgError:
            continue
        if np.isfinite(out).all():
            return out
    return np.diag(np.isfinite(z) / np.asarray(sensor.sigma))


@entry_kernel
def _sweep(address, params, angular, solutions, lags, states, steps, out, slope):  # type: ignore[no-untyped-def]
    """Measurements (S, T, D) of solutions p, v (S, 2 A) at each lag, and their slopes (S, T, D, 2 A)."""
    axes = solutions.shape[1] // 2
    size = out.shape[2]
    kin = np.empty(2 * axes)
    high = np.empty(size)
    low = np.empty(size)
    sensor = np.empty(2 * axes)
    for s in range(solutions.shape[0]):
        for t in range(lags.shape[0]):
            for i in range(axes):
                kin[i] = solutions[s, i] + solutions[s, axes + i] * lags[t]
                kin[axes + i] = solutions[s, axes + i]
                sensor[i] = states[t, i]
                sensor[axes + i] = states[t, axes + i]
            call_observe(address, kin, sensor, params, high)
            for d in range(size):
                out[s, t, d] = high[d]
            for i in range(2 * axes):
                centre = kin[i]
                kin[i] = centre + steps[i]
                call_observe(address, kin, sensor, params, high)
                kin[i] = centre - steps[i]
                call_observe(address, kin, sensor, params, low)
                kin[i] = centre
                for d in range(size):
                    change = high[d] - low[d]
                    if angular[d]:  # a bearing may cross its cut between the two points
                        change -= 2 * math.pi * math.floor(change / (2 * math.pi) + 0.5)
                    slope[s, t, d, i] = change / (2 * steps[i])
            for d in range(size):
                for i in range(axes):
                    slope[s, t, d, axes + i] += slope[s, t, d, i] * lags[t]


def observe_with_slope(
    sensor: Sensor, solutions: Array, lags: Array, states: Array, speed: float
) -> tuple[Array, Array]:
    """Measurements (S, T, D) of straight flights and their slopes (S, T, D, 2 A), by central differences."""
    axes = sensor.axes
    scale = float(np.abs(solutions[:, :axes]).max() + np.abs(states[:, :axes]).max()) + 1e-3
    steps = np.repeat([min(1e-6 * scale, 0.5), min(1e-3 * speed, 0.5)], axes)
    shape = (len(solutions), len(lags), sensor.size)
    out, slope = np.empty(shape), np.empty((*shape, 2 * axes))
    params = np.asarray(sensor.params, dtype=np.float64)
    _sweep(
        sensor.observe.address,
        params,
        np.asarray(sensor.angular, dtype=np.bool_),
        np.ascontiguousarray(solutions),
        np.ascontiguousarray(lags),
        np.ascontiguousarray(states, dtype=np.float64),
        steps,
        out,
        slope,
    )
    return out, slope


def fit(window: Window, solutions: Array, rounds: int = 40) -> tuple[Array, Array, Array]:
    """Levenberg-Marquardt from all starts at once: solutions (S, 2 A), costs (S,), information."""
    damping = np.full(len(solutions), 1e-3)
    cost, gradient, information = window.evaluate(solutions)
    for _ in range(rounds):
        ridge = damping[:, None] * np.einsum("sii->si", information) + 1e-300
        step = _solve(information + ridge[:, :, None] * np.eye(solutions.shape[1]), -gradient)
        trial_cost, trial_gradient, trial_information = window.evaluate(solutions + step)
        better = trial_cost <= cost
        gain = np.where(better & np.isfinite(cost), cost - trial_cost, np.inf)
        solutions = np.where(better[:, None], solutions + step, solutions)
        gradient = np.where(better[:, None], trial_gradient, gradient)
        information = np.where(better[:, None, None], trial_information, information)
        settled = (gain < 1e-6) | (damping > 1e9)
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, damping * 0.2, damping * 5.0)
        if settled.all():
            break
    return solutions, cost, information


def _solve(matrices: Array, vectors: Array) -> Array:
    try:
        found = np.linalg.solve(matrices, vectors[..., None])[..., 0]
    except np.linalg.LinAlgError:
        found = np.einsum("sij,sj->si", np.linalg.pinv(np.nan_to_num(matrices)), np.nan_to_num(vectors))
    return np.where(np.isfinite(found), found, 0.0)
