"""Tables in the track format to `Scans`: rows that share `t` and `sensor` are a scan, one without values is empty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.estimators.checks import check_kind
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scans

__all__ = ["scans_from_frame"]

Array = NDArray[np.float64]
AXES = "xyz"


def scans_from_frame(frame: pd.DataFrame, sensors: ScanSensor | Mapping[str, ScanSensor]) -> Scans:
    """Group rows into scans by time and sensor.

    Column names are those of the track format: `t`, optionally `sensor`; the components of each sensor (`x`, `y`,
    `range`, `bearing`, ...); optionally `sensor_x`, ..., `sensor_vx`, ... and `sigma_*`. Where a scan's sigmas
    differ, it gets their root mean square.

    Args:
        frame: one row per detection.
        sensors: by the name in the column `sensor`, or the only one.

    Returns:
        the scans; sensors are numbered in the order of ``sensors``; ``rows`` counts the rows that hold a detection.

    Raises:
        ValueError: a missing column, a sensor that is not in ``sensors``, or a time that is not finite.
    """
    me = "Scans.from_frame"
    check_kind(me, "frame", frame, pd.DataFrame, "a pandas DataFrame", "Read one, for instance with pd.read_csv.")
    check_kind(me, "sensors", sensors, (ScanSensor, Mapping), "a ScanSensor, or some by name", "Use a dictionary.")
    single = isinstance(sensors, ScanSensor)
    # Names may be numbers, in the table and here.
    named = {"": sensors} if isinstance(sensors, ScanSensor) else {str(key): one for key, one in sensors.items()}
    for label, one in named.items():
        check_kind(me, f"sensors[{label!r}]", one, ScanSensor, "a ScanSensor", "Say how it measures.")
    if "t" not in frame.columns or not (single or "sensor" in frame.columns):
        raise ValueError(
            f"Scans.from_frame: frame must have the columns t and, for several sensors, sensor; got "
            f"{', '.join(map(str, frame.columns))}. Rename them."
        )
    names = pd.Series("", index=frame.index) if single else frame["sensor"].astype(str)
    unknown = sorted(set(names) - set(named))
    if unknown:
        raise ValueError(
            f"Scans.from_frame: sensors must name every sensor of the frame; got no {', '.join(unknown[:10])} among "
            f"{', '.join(named)}. Add it, or leave its rows out."
        )
    keys = pd.DataFrame({"t": frame["t"].to_numpy(dtype=np.float64), "sensor": names.to_numpy()})
    order = list(named)
    groups = keys.groupby(["t", "sensor"], sort=False, dropna=False).indices
    times, owner, found, places, noises = [], [], [], [], []
    axes = next(iter(named.values())).model.axes
    states = _columns(frame, [f"sensor_{v}{axis}" for v in ("", "v") for axis in AXES[:axes]], 0.0)
    for key, rows in groups.items():
        time, name = cast("tuple[float, str]", key)
        sensor = named[name]
        labels = [label.replace(" ", "_") for label in sensor.model.labels]
        missing = [label for label in labels if label not in frame.columns]
        if missing:
            raise ValueError(
                f"Scans.from_frame: frame must have the columns {', '.join(labels)} of sensor {name!r}; got no "
                f"{', '.join(missing)}. Rename or add them."
            )
        values = frame[labels].to_numpy(dtype=np.float64)[rows]
        there = ~np.isnan(values).all(axis=1)
        times.append(float(time))
        owner.append(order.index(name))
        found.append(values[there])
        places.append(np.nan_to_num(states[rows[0]]))
        sigmas = _columns(frame, [f"sigma_{label}" for label in labels], np.nan)[rows][there]
        noises.append(_noise(sensor, sigmas))
    wide = max(sensor.size for sensor in named.values())
    noise = np.stack([np.eye(wide)] * len(times)) if times else np.zeros((0, wide, wide))
    for k, own in enumerate(noises):
        noise[k, : len(own), : len(own)] = own
    return Scans.from_arrays(
        times, found, tuple(named.values()), sensor=owner, sensor_states=np.reshape(places, (-1, 2 * axes)), noise=noise
    )


def _columns(frame: pd.DataFrame, names: list[str], missing: float) -> Array:
    columns = [
        frame[name].to_numpy(dtype=np.float64) if name in frame.columns else np.full(len(frame), missing)
        for name in names
    ]
    return np.stack(columns, axis=1)


def _noise(sensor: ScanSensor, sigmas: Array) -> Array:
    good = sigmas[np.isfinite(sigmas).all(axis=1) & (sigmas > 0).all(axis=1)]
    return np.diag(np.mean(good**2, axis=0)) if len(good) else sensor.noise
