"""FilterPy's filters as estimators of Jink, to compare with: `FilterPyFilter`, and three made from our scales.

jink check jink.training.adapters.filterpy_filters:imm_cv
jink track radar.csv --estimator jink.training.adapters.filterpy_filters:ukf_turn
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.recipes import Scales
from jink.estimators.sensor import Sensor
from jink.estimators.starting import start_prior
from jink.estimators.status import DIVERGED
from jink.training.adapters.need import need

__all__ = ["FilterPyFilter", "imm_cv", "kf_cv", "ukf_turn"]

Floats = NDArray[np.float64]


class FilterPyState(NamedTuple):
    """Mean and covariance of each filter, mode probabilities (empty without modes), and the time; s."""

    means: tuple[Floats, ...]
    covs: tuple[Floats, ...]
    mode_probs: Floats
    time: float


class FilterPyFilter:
    """A `KalmanFilter`, `UnscentedKalmanFilter` or `IMMEstimator` of FilterPy behind a sensor of ours.

    FilterPy does the predictions, updates and mixing; the sensor's measurement and R replace the filter's own. Where
    nothing was measured it only predicts; its IMM then leaves the mode probabilities as they are, and so do we.

    Args:
        filter: with its state's components in the order of ``labels``, which all filters of a bank share; what is
            neither position nor velocity starts at its ``x`` and ``P``.
        sensor: what is measured.
        labels: of the components, for instance ``"x vx y vy"``.
        prepare: called as ``prepare(filter, dt)`` before each prediction to set F and Q; None: they stay as they are.
        speed: standard deviation of the velocity at the start, along an axis; m/s.

    Raises:
        ValueError: labels without a position or velocity, or a `KalmanFilter` behind a sensor that is not linear.
    """

    def __init__(
        self,
        filter: Any,  # noqa: A002 - FilterPy's word
        sensor: Sensor,
        labels: str | Sequence[str],
        prepare: Callable[[Any, float], None] | None = None,
        speed: float = 10.0,
    ) -> None:
        self.filter, self.sensor, self.prepare, self.speed = filter, sensor, prepare, speed
        self.parts = list(getattr(filter, "filters", [filter]))
        self.bank = hasattr(filter, "filters")
        names = labels.split() if isinstance(labels, str) else list(labels)
        wanted = [f"{v}{axis}" for v in ("", "v") for axis in "xyz"[: sensor.axes]]
        if any(name not in names for name in wanted) or len(names) != len(np.ravel(self.parts[0].x)):
            raise ValueError(
                f"FilterPyFilter: labels must name the {len(np.ravel(self.parts[0].x))} components of the filter, "
                f"{', '.join(wanted)} among them; got {', '.join(names)}. Give them in the order of its x."
            )
        self.kin = [names.index(name) for name in wanted]
        self.modes = tuple(f"filter {i}" for i in range(len(self.parts))) if self.bank else ("filter",)
        self.first = FilterPyState(
            tuple(np.array(part.x, dtype=np.float64) for part in self.parts),
            tuple(np.array(part.P, dtype=np.float64) for part in self.parts),
            np.array(filter.mu, dtype=np.float64) if self.bank else np.ones(1),
            0.0,
        )
        if not sensor.linear and any(hasattr(part, "H") for part in self.parts):
            raise ValueError(
                f"FilterPyFilter: sensor must be linear for KalmanFilter; got {sensor.name}. Use UnscentedKalmanFilter."
            )

    def start(
        self, measurements: Floats, times: Floats, noise: Floats, sensor_states: Floats, prior: Any = None
    ) -> Any:
        """From a prior, or as `start_prior`: position from the measurements; None while they do not locate."""
        if prior is not None:
            state, said = self._begun(prior[0], prior[1], float(times[0])), None
            for row in zip(measurements, times, noise, sensor_states, strict=True):
                state, said = self.step(state, *row)
            return state, said
        found = start_prior(self.sensor, measurements, times, noise, sensor_states, self.speed, complete=False)
        if not found.ok:
            return None
        kin = np.concatenate([found.position, found.velocity])
        state = self._begun(kin, found.covariance, float(times[-1]))
        self._load(state)
        return state, self._said()

    def _begun(self, kin: Floats, kin_cov: Floats, time: float) -> FilterPyState:
        """Every filter at the same place; the rest of each as it was given."""
        means, covs = [], []
        for template, spread in zip(self.first.means, self.first.covs, strict=True):
            mean, cov = template.copy(), spread.copy()
            mean.ravel()[self.kin] = kin
            cov[self.kin, :] = cov[:, self.kin] = 0.0
            cov[np.ix_(self.kin, self.kin)] = kin_cov
            means.append(mean)
            covs.append(cov)
        return FilterPyState(tuple(means), tuple(covs), self.first.mode_probs.copy(), time)

    def step(self, state: FilterPyState, measurement: Floats, time: float, noise: Floats, sensor_state: Floats) -> Any:
        """Predict to the time, then update with what was measured; where FilterPy raises, the row is DIVERGED."""
        self._load(state)
        try:
            return self._advance(state, measurement, time, noise, sensor_state)
        except np.linalg.LinAlgError:  # of a covariance that is none any more, which its unscented filter can reach
            self._load(state)
            return state._replace(time=time), self._said() | {"status": DIVERGED}

    def _advance(self, state: FilterPyState, measurement: Floats, time: float, noise: Floats, place: Floats) -> Any:
        dt = time - state.time
        if self.prepare is not None:
            self.prepare(self.filter, dt)
        scented = not hasattr(self.parts[0], "H")
        self.filter.predict(*((dt,) if scented else ()))
        said: dict[str, Any] = {}
        seen = np.isfinite(measurement)
        if seen.any():
            said = self._update(measurement, seen, noise, place)
        means = tuple(np.array(part.x) for part in self.parts)
        covs = tuple(np.array(part.P) for part in self.parts)
        probs = np.array(self.filter.mu) if self.bank else np.ones(1)
        return FilterPyState(means, covs, probs, time), self._said() | said

    def _update(self, z: Floats, seen: Any, noise: Floats, place: Floats) -> dict[str, Any]:
        """Update with the components that were measured."""
        observe = self._observe(place, seen)
        for part in self.parts:
            part.R = noise[np.ix_(seen, seen)]
            if hasattr(part, "H"):
                part.H = np.stack([observe(column) for column in np.eye(len(np.ravel(part.x)))], axis=1)
                part.dim_z = int(seen.sum())
            else:
                part.hx, part.residual_z, part.z_mean = observe, self._difference(seen), self._mean(seen)
        if not self.bank:
            self.filter.update(z[seen])
            return {
                "nis": float(self.filter.mahalanobis) ** 2,
                "nis_dof": int(seen.sum()),
                "log_likelihood": float(self.filter.log_likelihood),
            }
        predicted = np.array(self.filter.cbar)
        self.filter.update(z[seen])
        with np.errstate(divide="ignore"):
            return {"log_likelihood": float(np.log(predicted @ self.filter.likelihood))}

    def _observe(self, place: Floats, seen: Any) -> Callable[[Floats], Floats]:
        def observe(x: Floats) -> Floats:
            out = np.zeros(self.sensor.size)
            params = np.asarray(self.sensor.params, dtype=np.float64)
            self.sensor.observe.function(np.ravel(x)[self.kin], place, params, out)
            return out[seen]

        return observe

    def _difference(self, seen: Any) -> Callable[[Floats, Floats], Floats]:
        """Angles wrapped; rows of sigma points at once."""
        angular = np.asarray(self.sensor.angular)[seen]

        def difference(a: Floats, b: Floats) -> Floats:
            gap = np.asarray(a) - np.asarray(b)
            return np.where(angular, (gap + math.pi) % (2.0 * math.pi) - math.pi, gap)

        return difference

    def _mean(self, seen: Any) -> Callable[[Floats, Floats], Floats]:
        """Angles about the first point, which is the one in the middle."""
        difference = self._difference(seen)
        return lambda points, weights: np.asarray(points[0] + weights @ difference(points, points[0]))

    def _load(self, state: FilterPyState) -> None:
        for part, mean, cov in zip(self.parts, state.means, state.covs, strict=True):
            part.x, part.P = mean.copy(), cov.copy()
        if self.bank:
            self.filter.mu = state.mode_probs.copy()
            self.filter._compute_mixing_probabilities()
            self.filter._compute_state_estimate()

    def _said(self) -> dict[str, Any]:
        mean, half = np.ravel(self.filter.x)[self.kin], self.sensor.axes
        said = {
            "position": mean[:half],
            "velocity": mean[half:],
            "covariance": np.array(self.filter.P)[np.ix_(self.kin, self.kin)],
        }
        return said | ({"mode_probs": np.array(self.filter.mu)} if self.bank else {})


def kf_cv(sensor: Sensor, scales: Scales) -> FilterPyFilter:
    """FilterPy's Kalman filter, constant velocity: the recipe kf-cv."""
    one = _straight(sensor)
    return FilterPyFilter(one, sensor, _labels(sensor), _drive([scales.acceleration**2]), scales.speed)


def imm_cv(sensor: Sensor, scales: Scales) -> FilterPyFilter:
    """FilterPy's IMM of a quiet and a manoeuvring constant velocity."""
    kalman = need("filterpy.kalman", "peers")
    stay = math.exp(-1.0 / scales.sojourn)  # a fixed matrix per step, as FilterPy has it: steps of about a second
    matrix = np.array([[stay, 1.0 - stay], [1.0 - stay, stay]])
    densities = [(0.05 * scales.acceleration) ** 2, scales.acceleration**2]
    bank = kalman.IMMEstimator([_straight(sensor), _straight(sensor)], [0.5, 0.5], matrix)
    return FilterPyFilter(bank, sensor, _labels(sensor), _drive(densities), scales.speed)


def ukf_turn(sensor: Sensor, scales: Scales) -> FilterPyFilter:
    """FilterPy's unscented filter, coordinated turn in the plane with estimated rate: the recipe ukf-ct.

    Raises:
        ValueError: a sensor that is not in the plane.
    """
    if sensor.axes != 2:
        raise ValueError(f"ukf_turn: sensor must have 2 axes; got {sensor.axes}. Use kf_cv or imm_cv.")
    kalman = need("filterpy.kalman", "peers")
    points = kalman.MerweScaledSigmaPoints(5, alpha=1.0, beta=2.0, kappa=0.0)
    one = kalman.UnscentedKalmanFilter(5, sensor.size, 1.0, hx=None, fx=_turn, points=points)
    one.P = np.diag([1.0, 1.0, 1.0, 1.0, scales.turn**2])
    rate = (0.1 * scales.turn) ** 2 / scales.sojourn

    def prepare(filter: Any, dt: float) -> None:  # noqa: A002 - FilterPy's word
        filter.Q = np.zeros((5, 5))
        filter.Q[:4, :4] = np.kron(np.eye(2), _white(dt, scales.acceleration**2))
        filter.Q[4, 4] = rate * dt

    return FilterPyFilter(one, sensor, "x vx y vy rate", prepare, scales.speed)


def _labels(sensor: Sensor) -> str:
    return " ".join(f"{axis} v{axis}" for axis in "xyz"[: sensor.axes])


def _straight(sensor: Sensor) -> Any:
    if not sensor.linear:
        raise ValueError(
            f"FilterPy's KalmanFilter: sensor must be linear; got {sensor.name}. Use ukf_turn, or a position."
        )
    return need("filterpy.kalman", "peers").KalmanFilter(2 * sensor.axes, sensor.size)


def _drive(densities: Sequence[float]) -> Callable[[Any, float], None]:
    """Sets F and Q of constant velocity, one acceleration density (m^2/s^3) for each filter."""

    def prepare(filter: Any, dt: float) -> None:  # noqa: A002 - FilterPy's word
        for part, density in zip(getattr(filter, "filters", [filter]), densities, strict=True):
            axes = len(np.ravel(part.x)) // 2
            part.F = np.kron(np.eye(axes), [[1.0, dt], [0.0, 1.0]])
            part.Q = np.kron(np.eye(axes), _white(dt, density))

    return prepare


def _white(dt: float, density: float) -> Floats:
    return density * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])


def _turn(x: Floats, dt: float) -> Floats:
    """State x vx y vy rate, exactly; the limit of a straight line below 1e-9 rad."""
    angle = x[4] * dt
    s, c = (math.sin(angle) / x[4], (1.0 - math.cos(angle)) / x[4]) if abs(angle) > 1e-9 else (dt, 0.5 * dt * angle)
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array(
        [x[0] + s * x[1] - c * x[3], cos * x[1] - sin * x[3], x[2] + c * x[1] + s * x[3], sin * x[1] + cos * x[3], x[4]]
    )
