"""`ScanSensor`: a sensor that reports unlabelled detections, with what a tracker must know of misses and clutter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        gate = 1.0 if self.gate is None else self.gate
        for name, rule, good in (
            ("detection", "be a probability > 0", 0 < self.detection <= 1),
            ("clutter", "be finite and >= 0, false alarms per scan", 0 <= self.clutter < np.inf),
            ("volume", "be finite and > 0, in units of the measurement", 0 < self.volume < np.inf),
            ("gate", "be > 0, a squared distance in standard deviations", gate > 0),
        ):
            if not good:
                raise ValueError(f"ScanSensor: {name} must {rule}; got {getattr(self, name)!r}. Use SI units.")
        size = self.model.size
        noise = self.model.noise if self.noise is None else np.array(self.noise, dtype=np.float64)
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


def is_covariance(matrices: Array) -> bool:
    """Whether all matrices (..., D, D) are finite, symmetric and positive definite."""
    if not np.isfinite(matrices).all() or not np.allclose(matrices, np.swapaxes(matrices, -1, -2), rtol=1e-9, atol=0):
        return False
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return False
    return True
