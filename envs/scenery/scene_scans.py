"""A simulated scene as an estimator sees it: `Scans`, without truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.envs.scenery.scene_data import SceneData
from jink.envs.scenery.scene_sensors import SceneSensor
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scans

__all__ = ["scene_scans", "tracker_sensor"]


def tracker_sensor(sensor: SceneSensor, name: str = "") -> ScanSensor:
    """What a tracker that knows the sensor well is told: P_D, clutter, volume and field of view."""

    def watches(positions: NDArray[np.float64], state: NDArray[np.float64]) -> NDArray[np.bool_]:
        return sensor.watches(positions)

    return ScanSensor(
        sensor.model,
        detection=max(sensor.detection, 1e-6),
        clutter=sensor.clutter,
        volume=sensor.volume,
        watches=watches,
        name=name,
    )


def scene_scans(data: SceneData) -> Scans:
    """The scans of a run, sensors named `s0`, `s1`, ... as in its table."""
    still = np.zeros((len(data), data.scene.axes))
    return Scans.from_arrays(
        data.times,
        [data.scan(k) for k in range(len(data))],
        [tracker_sensor(sensor, f"s{index}") for index, sensor in enumerate(data.scene.sensors)],
        sensor=data.sensor,
        sensor_states=np.hstack([data.places, still]),
        noise=data.noise,
    )
