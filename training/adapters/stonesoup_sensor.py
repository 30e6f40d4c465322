"""A sensor of Jink as a measurement model of Stone Soup, and its clock."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.estimators.sensor import Sensor
from jink.training.adapters.need import need

__all__ = ["EPOCH", "measurement_model", "seconds", "stamp"]

EPOCH = datetime.datetime(2000, 1, 1)
"""Second 0. Stone Soup's clock ticks in microseconds: times between are rounded to them."""


def stamp(time: float) -> datetime.datetime:
    """Seconds as Stone Soup's time."""
    return EPOCH + datetime.timedelta(seconds=float(time))


def seconds(time: datetime.datetime) -> float:
    """Stone Soup's time in seconds."""
    return (time - EPOCH) / datetime.timedelta(seconds=1)


def measurement_model(sensor: Sensor, size: int, kin: Sequence[int]) -> Any:
    """The sensor as a measurement model.

    Args:
        sensor: what is measured; angles become Stone Soup's `Bearing`.
        size: components of the state.
        kin: where positions, then velocities, are among them; (2A,).

    Returns:
        a model with ``only(seen, noise, sensor_state)``: the same for some of its components, another noise, another
        place of the sensor.

    Raises:
        ValueError: Stone Soup is not installed.
    """
    return _kind()(
        ndim_state=size,
        mapping=tuple(kin),
        noise_covar=sensor.noise,
        sensor=sensor,
        place=np.zeros(2 * sensor.axes),
        seen=tuple(range(sensor.size)),
    )


@cache
def _kind() -> Any:
    """The class; made on first use, since its base is Stone Soup's."""
    base = need("stonesoup.base", "peers")
    models = need("stonesoup.models.measurement.nonlinear", "peers")
    arrays, angles = need("stonesoup.types.array", "peers"), need("stonesoup.types.angle", "peers")

    class SensorModel(models.NonLinearGaussianMeasurement):  # type: ignore[name-defined]
        """A sensor of Jink."""

        sensor: Any = base.Property(doc="the sensor")
        place: Any = base.Property(doc="its position and velocity")
        seen: Any = base.Property(doc="which of its components")

        @property
        def ndim_meas(self) -> int:
            return len(self.seen)

        def function(self, state: Any, noise: Any = False, **kwargs: Any) -> Any:
            columns = np.asarray(state.state_vector, dtype=np.float64)
            added = self.rvs(columns.shape[1]) if noise is True else 0 if noise is False or noise is None else noise
            images = [arrays.StateVector(self._see(column)) for column in columns.T]
            many = arrays.StateVectors(images) if len(images) > 1 else images[0]
            return many + added

        def matrix(self, **kwargs: Any) -> NDArray[np.float64]:
            """Of a linear sensor."""
            return np.stack([np.asarray(self._see(column), dtype=np.float64) for column in np.eye(self.ndim_state)], 1)

        def _see(self, state: NDArray[np.float64]) -> list[Any]:
            out = np.zeros(self.sensor.size)
            params = np.asarray(self.sensor.params, dtype=np.float64)
            self.sensor.observe.function(state[list(self.mapping)], self.place, params, out)
            return [angles.Bearing(out[i]) if self.sensor.angular[i] else out[i] for i in self.seen]

        def only(self, seen: Any, noise: Any, place: Any) -> Any:
            return type(self)(
                ndim_state=self.ndim_state,
                mapping=self.mapping,
                noise_covar=np.asarray(noise)[np.ix_(seen, seen)],
                sensor=self.sensor,
                place=np.asarray(place),
                seen=tuple(int(i) for i in seen),
            )

    return SensorModel
