"""What a sensor is: a noise-free measurement of kinematics, its noise, and how a first measurement locates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jink.estimators.compiled import Callback

__all__ = ["Location", "Sensor"]

Location = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Position mean (A,) and covariance (A, A) in metres."""


@dataclass(frozen=True)
class Sensor:
    """A measurement of position and velocity.

    Model: ``z = h(kin, sensor) + v``, ``v ~ N(0, R)``; ``kin`` = target position, velocity (2 A,) and ``sensor`` =
    the sensor's own position, velocity (2 A,), which may differ for every measurement (own ship; zero by default).

    Args:
        name: name in the registry, for instance ``"range-bearing"``.
        labels: one per measurement component; (D,).
        units: one per component.
        axes: space dimensions A.
        observe: ``observe(kin, sensor, params, out)``.
        sigma: standard deviation per component, used where a measurement brings no R; (D,).
        params: constants handed to ``observe`` (for instance anchor positions).
        linear: ``h`` is a matrix times ``kin`` and ignores the sensor's place.
        angular: which components are angles, wrapped to (-pi, pi]; (D,).
        locate: ``locate(sensor, z, R, sensor_state)`` gives position mean (A,) and covariance (A, A) from one
            measurement (NaN = missing component), or None where it cannot; None: this sensor never locates alone.

    Raises:
        ValueError: sizes do not fit or a sigma is not positive.
    """

    name: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    axes: int
    observe: Callback
    sigma: tuple[float, ...]
    params: tuple[float, ...] = ()
    linear: bool = False
    angular: tuple[bool, ...] = ()
    locate: (
        Callable[[Sensor, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], Location | None] | None
    ) = None

    def __post_init__(self) -> None:
        size = len(self.labels)
        if not self.angular:
            object.__setattr__(self, "angular", (False,) * size)
        for name in ("units", "sigma", "angular"):
            value = getattr(self, name)
            if len(value) != size:
                raise ValueError(
                    f"Sensor: {name} must have {size} entries, one per {', '.join(self.labels)}; got {len(value)}. "
                    "Give one per component."
                )
        if self.axes not in (1, 2, 3):
            raise ValueError(f"Sensor: axes must be 1, 2 or 3; got {self.axes}. Use the target's space dimensions.")
        if any(not (value > 0 and np.isfinite(value)) for value in self.sigma):
            raise ValueError(
                f"Sensor: sigma must be > 0 and finite; got {self.sigma}. Give a standard deviation in "
                f"{', '.join(self.units)}."
            )

    @property
    def size(self) -> int:
        """Number of measurement components D."""
        return len(self.labels)

    @property
    def noise(self) -> NDArray[np.float64]:
        """Default measurement noise covariance; (D, D)."""
        return np.diag(np.square(np.asarray(self.sigma, dtype=np.float64)))
