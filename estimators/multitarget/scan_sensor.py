"""`ScanSensor`: a sensor that reports unlabelled detections, with what a tracker must know of misses and clutter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jink.estimators.checks import check_array, check_kind, check_number
from jink.estimators.sensor import Sensor

__all__ = ["ScanSensor"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ScanSensor:
    """How a sensor measures, misses and errs when it scans.

    Model: a target in view is detected with probability P_D, ``z = h(x) + v``, ``v ~ N(0, R)``; false alarms are
    Poisson, ``clutter`` expected per scan, uniform over a measurement volume V: density ``lambda = clutter / V``.

    Args:
        model: what it measures.
        detection: P_D; above 0, up to 1.
        clutter: expected false alarms per scan, >= 0.
        volume: V, product of the extents of the components, for instance m rad for range and bearing.
        noise: R; (D, D); None: the sensor's own.
        gate: D^2 beyond which a detection is no candidate for a target; None: what the estimator uses.
        watches: ``watches(positions (M, A), sensor_state (2 A,)) -> (M,)`` bool, targets in view; None: all are.
        name: shown in tables and messages; default: the kind of the sensor.

    Raises:
        ValueError: a number out of range, or R is no covariance.
    """

    model: Sensor
    detection: float = 0.9
    clutter: float = 0.0
    volume: float = 1.0
    noise: Array = None  # type: ignore[assignment]
    gate: float | None = None
    watches: Callable[[Array, Array], NDArray[np.bool_]] | None = None
    name: str = ""

    def __post_init__(self) -> None:
        me = "ScanSensor"
        check_kind(me, "model", self.model, Sensor, "a Sensor", "Use for instance position(2, 5.0).")
        check_number(me, "detection", self.detection, 0.0, 1.0, remedy="Give a probability.")
        check_number(me, "clutter", self.clutter, 0.0, least=True, remedy="Give false alarms per scan.")
        check_number(me, "volume", self.volume, 0.0, remedy="Give the product of the extents, in SI units.")
        if self.gate is not None:
            remedy = "Give a squared distance in standard deviations, or None."
            check_number(me, "gate", self.gate, 0.0, infinite=True, remedy=remedy)
        if self.watches is not None and not callable(self.watches):
            raise ValueError(
                f"{me}: watches must be a function of positions and sensor state; got {self.watches!r}. Leave it out "
                "where all targets are in view."
            )
        size = self.model.size
        noise = self.model.noise if self.noise is None else check_array(me, "noise", self.noise, "Give R.")
        if noise.shape != (size, size) or not is_covariance(noise):
            raise ValueError(
                f"ScanSensor: noise must be a covariance of shape ({size}, {size}); got {noise.tolist()}. "
                "Put variances on its diagonal."
            )
        object.__setattr__(self, "noise", noise)
        object.__setattr__(self, "name", self.name or self.model.name)

    @classmethod
    def with_density(cls, model: Sensor, density: float, volume: float, detection: float = 0.9) -> ScanSensor:
        """From clutter per unit of measurement volume (1/m^2, 1/(m rad), ...) and the volume watched."""
        return cls(model, detection, density * volume, volume)

    @property
    def density(self) -> float:
        """Expected false alarms per scan and unit of measurement volume, lambda."""
        return self.clutter / self.volume

    @property
    def size(self) -> int:
        """Number of measurement components D."""
        return self.model.size

    def detected(self, positions: Array, sensor_state: Array) -> Array:
        """P_D of each target, 0 out of view.

        Args:
            positions: of M targets, m; (M, A).
            sensor_state: position then velocity of the sensor; (2 A,).

        Returns:
            (M,).

        Raises:
            ValueError: ``watches`` does not say yes or no to each target.
        """
        M = len(positions)
        if self.watches is None or not M:
            return np.full(M, float(self.detection))
        watched = np.asarray(self.watches(positions, sensor_state))
        if watched.shape != (M,):
            raise ValueError(
                f"ScanSensor: watches must return one truth value per target, shape ({M},); got shape {watched.shape}. "
                "Compare along the last axis of the positions (M, A)."
            )
        return np.where(watched, float(self.detection), 0.0)


def is_covariance(matrices: Array) -> bool:
    """Whether all matrices (..., D, D) are finite, symmetric and positive definite."""
    if not np.isfinite(matrices).all() or not np.allclose(matrices, np.swapaxes(matrices, -1, -2), rtol=1e-9, atol=0):
        return False
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return False
    return True
