"""A third party's estimator plays `jink/ManoeuvringTarget-v0`: `OutsidePolicy`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.training.outside import OutsideEstimator

__all__ = ["OutsidePolicy"]


class OutsidePolicy:
    """Reads one target's observations as measurements, one after the other; the position estimated is the action.

    Where the estimator streams, its state is carried on; one that takes whole tracks sees all rows again at each.

    Args:
        estimator: of the environment's sensor.
        layout: of the task, from observation to measurement.
    """

    def __init__(self, estimator: OutsideEstimator, layout: Any) -> None:
        self.estimator, self.layout = estimator, layout
        self.rows: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        self.times: list[float] = []
        self.state: Any = None

    def __call__(self, observation: NDArray[Any]) -> NDArray[np.float64]:
        """The action (A,); the origin until the estimator has started."""
        seen = self.layout.read(np.asarray(observation, dtype=np.float64)[None])
        self.times.append(self.times[-1] + float(seen.step[0]) if self.times else 0.0)
        if self.state is not None:
            self.state, estimate = self.estimator.step(
                self.state, seen.measurement[0], self.times[-1], sensor_state=seen.sensor_state[0]
            )
            return self._action(estimate.position)
        self.rows.append((seen.measurement[0], seen.sensor_state[0]))
        z, places = (np.array(column) for column in zip(*self.rows, strict=True))
        if not self.estimator.streams:
            return self._action(self.estimator.run(z, self.times, sensor_states=places).position[0, -1])
        if not np.isfinite(z).any():
            return np.zeros(self.layout.axes)
        found = self.estimator.begin(z, self.times, sensor_states=places)
        if found is None:
            return np.zeros(self.layout.axes)
        self.state, estimate = found
        return self._action(estimate.position)

    def _action(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.clip(np.nan_to_num(position / self.layout.scale), -1.0, 1.0)
