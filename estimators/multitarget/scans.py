"""`Scans`: what one or several sensors reported, scan by scan, in time order; empty scans are scans."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from jink.estimators.checks import check_array, check_kind
from jink.estimators.multitarget.scan_sensor import ScanSensor, is_covariance

__all__ = ["Cleaning", "Scan", "ScanSensor", "Scans", "check_scan", "check_sensors"]

Array = NDArray[np.float64]
ABSURD = 1e30
"""Detections of this size or larger count as not finite: they are broken."""


class Cleaning(NamedTuple):
    """What building the scans did to hostile input; nothing else is ever left out."""

    not_finite: int = 0
    """Detections left out because a component is NaN, infinite or absurd."""
    repeated: int = 0
    """Detections left out because they repeat another of the same scan bit for bit."""
    reordered: int = 0
    """Scans that came later than a younger one and were sorted in."""


class Scan(NamedTuple):
    """One scan: n detections of one sensor."""

    time: float  # s
    sensor: int
    detections: Array  # (n, D)
    sensor_state: Array  # position, velocity; (2 A,)
    noise: Array  # R; (D, D)
    rows: NDArray[np.int64]  # where each detection stood in the input; (n,)


@dataclass(frozen=True, eq=False)
class Scans:
    """K scans of S sensors with N detections in all; D = components of the largest sensor, A space dimensions.

    Within a scan detections stand in the order of their components (first, then second, ...), so that the order in
    which they arrived tells nothing; ``rows`` says where each stood. Scans at one time keep the order given.
    Use `from_arrays` or `from_frame`, which clean and count; the constructor refuses what is not clean.

    Args:
        times: s, never decreasing; (K,).
        sensor: index into ``sensors``; (K,).
        detections: components beyond those of the scan's sensor are 0; (N, D).
        offsets: detections of scan k are ``detections[offsets[k]:offsets[k + 1]]``; (K + 1,).
        sensors: at least one, all of the same space dimensions.
        sensor_states: position then velocity of the sensor at each scan, m and m/s; (K, 2 A); None: at the origin.
        noise: R of each scan, identity beyond the components of its sensor; (K, D, D); None: the sensors' own.
        rows: where each detection stood in the input; (N,); None: as it stands.
        cleaning: what was left out.

    Raises:
        ValueError: shapes that do not fit, times that go backwards, numbers that are not finite.
    """

    times: Array
    sensor: NDArray[np.int64]
    detections: Array
    offsets: NDArray[np.int64]
    sensors: tuple[ScanSensor, ...]
    sensor_states: Array = None  # type: ignore[assignment]
    noise: Array = None  # type: ignore[assignment]
    rows: NDArray[np.int64] = None  # type: ignore[assignment]
    cleaning: Cleaning = field(default_factory=Cleaning)

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "sensors", tuple(self.sensors))
        if not self.sensors or len({one.model.axes for one in self.sensors}) > 1:
            raise ValueError(
                "Scans: sensors must be at least one, all of the same space dimensions; got "
                f"{[one.model.axes for one in self.sensors]}. Use 2 or 3 for all."
            )
        put(self, "times", np.ascontiguousarray(self.times, dtype=np.float64))
        put(self, "detections", np.ascontiguousarray(self.detections, dtype=np.float64))
        for name in ("sensor", "offsets"):
            put(self, name, np.ascontiguousarray(getattr(self, name), dtype=np.int64))
        K, N = len(self.times), len(self.detections)
        if self.sensor_states is None:
            put(self, "sensor_states", np.zeros((K, 2 * self.axes)))
        if self.noise is None:
            own = np.stack([_padded(one, self.size) for one in self.sensors])
            put(self, "noise", own[np.clip(self.sensor, 0, len(self.sensors) - 1)])
        put(self, "rows", np.arange(N) if self.rows is None else np.asarray(self.rows, dtype=np.int64))
        for name in ("sensor_states", "noise"):
            put(self, name, np.ascontiguousarray(getattr(self, name), dtype=np.float64))
        for name, shape in (
            ("times", (K,)), ("sensor", (K,)), ("detections", (N, self.size)), ("offsets", (K + 1,)), ("rows", (N,)),
            ("sensor_states", (K, 2 * self.axes)), ("noise", (K, self.size, self.size)),
        ):  # fmt: skip
            if getattr(self, name).shape != shape:
                raise ValueError(f"Scans: {name} must have shape {shape}; got {getattr(self, name).shape}. Fit it.")
        self._check_values()

    def _check_values(self) -> None:
        K, N, S = len(self.times), len(self.detections), len(self.sensors)
        ordered = np.isfinite(self.times).all() and (np.diff(self.times) >= 0).all()
        ends = self.offsets[0] == 0 and self.offsets[-1] == N and (np.diff(self.offsets) >= 0).all()
        for name, rule, good in (
            ("times", "be finite and never decrease", ordered),
            ("sensor", f"name sensors 0..{S - 1}", ((self.sensor >= 0) & (self.sensor < S)).all()),
            ("offsets", f"never decrease from 0 to {N}", ends),
            ("detections", f"be finite and below {ABSURD:g}", (np.abs(self.detections) < ABSURD).all()),
            ("sensor_states", "be finite", np.isfinite(self.sensor_states).all()),
            ("noise", "be covariances", K == 0 or is_covariance(self.noise)),
        ):  # fmt: skip
            if not good:
                raise ValueError(f"Scans: {name} must {rule}; got {K} scans that do not. Use Scans.from_arrays.")

    @property
    def axes(self) -> int:
        """Space dimensions A."""
        return self.sensors[0].model.axes

    @property
    def size(self) -> int:
        """Components D of the largest sensor."""
        return max(one.size for one in self.sensors)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Detections of each scan; (K,)."""
        return np.diff(self.offsets)

    @property
    def scan_of(self) -> NDArray[np.int64]:
        """Scan of each detection; (N,)."""
        return np.repeat(np.arange(len(self)), self.counts)

    def __len__(self) -> int:
        return len(self.times)

    def scan(self, k: int) -> Scan:
        """One scan, with the components its sensor has."""
        index, which = int(self.sensor[k]), slice(self.offsets[k], self.offsets[k + 1])
        d = self.sensors[index].size
        return Scan(
            float(self.times[k]), index, self.detections[which, :d], self.sensor_states[k], self.noise[k, :d, :d],
            self.rows[which],
        )  # fmt: skip

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(k) for k in range(len(self)))

    def select(self, scans: ArrayLike) -> Scans:
        """Some of the scans: a mask (K,), or indices in increasing order; sensors keep their numbers."""
        which = np.arange(len(self))[np.asarray(scans)]
        kept = np.concatenate([np.arange(self.offsets[k], self.offsets[k + 1]) for k in which] or [np.arange(0)])
        return replace(
            self,
            times=self.times[which],
            sensor=self.sensor[which],
            detections=self.detections[kept],
            offsets=np.concatenate([[0], np.cumsum(self.counts[which])]),
            sensor_states=self.sensor_states[which],
            noise=self.noise[which],
            rows=self.rows[kept],
        )

    def of_sensors(self, sensors: ArrayLike) -> Scans:
        """The scans of some of the sensors, by index; sensors keep their numbers."""
        return self.select(np.isin(self.sensor, np.asarray(sensors)))

    @classmethod
    def from_arrays(
        cls,
        times: ArrayLike,
        detections: Sequence[ArrayLike] | Array,
        sensors: ScanSensor | Sequence[ScanSensor],
        *,
        sensor: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
        noise: ArrayLike | None = None,
    ) -> Scans:
        """Clean and sort scans, and count what was left out.

        Args:
            times: s; (K,); scans that come late are sorted in.
            detections: one array (n_k, D_k) per scan, or one padded with NaN (K, n, D); one scan's components are
                its sensor's. Detections that are not finite, and repeats within a scan, are left out and counted.
            sensors: the sensors, or the only one.
            sensor: index of each scan's sensor; (K,); None: the first.
            sensor_states: position then velocity; (2 A,) or (K, 2 A); None: at the origin.
            noise: R; (D, D) or (K, D, D); None: the sensors' own.

        Returns:
            the scans; ``rows`` counts the given detections, in order, those of a padded array that are all NaN
            left out.

        Raises:
            ValueError: shapes that do not fit, or a time that is not finite.
        """
        me = "Scans.from_arrays"
        all_sensors = check_sensors(me, sensors)
        clock = np.atleast_1d(check_array(me, "times", times, "Give seconds."))
        K, D = len(clock), max(one.size for one in all_sensors)
        owner = _indices(me, np.zeros(K) if sensor is None else sensor)
        check_kind(
            me, "detections", detections, (Sequence, np.ndarray), "one array per scan", "Put arrays (n, D) into a list."
        )
        if clock.ndim != 1 or len(detections) != K or owner.shape != (K,):
            raise ValueError(
                f"Scans.from_arrays: detections and sensor must have one entry per time, {K}; got {len(detections)} "
                f"and {owner.shape}. Give an empty array for an empty scan."
            )
        if K and not (np.isfinite(clock).all() and owner.min() >= 0 and owner.max() < len(all_sensors)):
            raise ValueError(
                f"Scans.from_arrays: times must be finite and sensor lie in 0..{len(all_sensors) - 1}; got times from "
                f"{clock.min()} to {clock.max()}, sensors {np.unique(owner).tolist()[:10]}. Leave such scans out."
            )
        padded = isinstance(detections, np.ndarray) and detections.ndim == 3
        found = [_measured(part, all_sensors[owner[k]].size, D, k, padded) for k, part in enumerate(detections)]
        starts = np.concatenate([[0], np.cumsum([len(part) for part in found])])
        order = np.argsort(clock, kind="stable")
        reordered = int((clock < np.maximum.accumulate(clock)).sum()) if K else 0
        values, rows, lost = [np.zeros((0, D))], [np.zeros(0, dtype=np.int64)], np.zeros(2, dtype=np.int64)
        counts = []
        for k in order:
            kept, where, gone = _clean(found[k])
            values.append(kept)
            rows.append(starts[k] + where)
            counts.append(len(kept))
            lost += gone
        wide: Any = None
        if sensor_states is not None:
            wide = _per_scan("sensor_states", sensor_states, K, (2 * all_sensors[0].model.axes,))[order]
        own: Any = None if noise is None else _per_scan("noise", noise, K, (D, D))[order]
        return cls(
            times=clock[order],
            sensor=owner[order],
            detections=np.concatenate(values),
            offsets=np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]),
            sensors=all_sensors,
            sensor_states=wide,
            noise=own,
            rows=np.concatenate(rows),
            cleaning=Cleaning(int(lost[0]), int(lost[1]), reordered),
        )

    @classmethod
    def from_frame(cls, frame: pd.DataFrame, sensors: ScanSensor | dict[str, ScanSensor]) -> Scans:
        """From a table in the track format; see `jink.estimators.multitarget.scan_frames.scans_from_frame`."""
        from jink.estimators.multitarget.scan_frames import scans_from_frame

        return scans_from_frame(frame, sensors)


def check_sensors(caller: str, sensors: Any) -> tuple[ScanSensor, ...]:
    """One sensor or several, as a tuple of at least one.

    Raises:
        ValueError: none, or something else.
    """
    every = (sensors,) if isinstance(sensors, ScanSensor) else tuple(sensors) if isinstance(sensors, Sequence) else ()
    if not every or not all(isinstance(one, ScanSensor) for one in every):
        raise ValueError(
            f"{caller}: sensors must be a ScanSensor, or at least one in a sequence; got {str(sensors)[:80]}. Use for "
            "instance ScanSensor(position(2, 5.0))."
        )
    return every


def check_scan(caller: str, scan: Any, sensors: Sequence[ScanSensor], time: float) -> None:
    """Refuse a scan that `Scans` would not have given.

    Args:
        caller: named in the sentence.
        scan: of one of the sensors.
        sensors: that scan.
        time: of the last scan, s.

    Raises:
        ValueError: another class, an older time, an unknown sensor, shapes that are not the sensor's, numbers that
            are not finite, or a noise that is no covariance.
    """
    check_kind(caller, "scan", scan, Scan, "a Scan", "Take it from Scans.from_arrays.")
    remedy = "Take it from Scans.from_arrays."
    known = isinstance(scan.sensor, int | np.integer) and 0 <= scan.sensor < len(sensors)
    if not (scan.time >= time and known):
        raise ValueError(
            f"{caller}: scan must be of {time:g} s or later, sensor 0..{len(sensors) - 1}; got {scan.time} s, sensor "
            f"{scan.sensor}. Sort scans by time, for instance with Scans.from_arrays."
        )
    d, width = sensors[scan.sensor].size, 2 * sensors[scan.sensor].model.axes
    for name, shape in (("detections", (-1, d)), ("sensor_state", (width,)), ("noise", (d, d))):
        value = np.asarray(getattr(scan, name))
        wrong = value.ndim != len(shape) or any(w not in (-1, h) for w, h in zip(shape, value.shape, strict=True))
        if wrong:
            wanted = str(shape).replace("-1", "n")
            raise ValueError(f"{caller}: {name} of the scan must have shape {wanted}; got {value.shape}. {remedy}")
    if not ((np.abs(scan.detections) < ABSURD).all() and np.isfinite(scan.sensor_state).all()):
        raise ValueError(
            f"{caller}: scan must have detections and a sensor state that are finite and below {ABSURD:g}; got others. "
            f"{remedy}"
        )
    if not is_covariance(scan.noise):
        raise ValueError(
            f"{caller}: noise of the scan must be a covariance; got {np.asarray(scan.noise).tolist()}. Put variances "
            "on its diagonal."
        )


def _indices(caller: str, given: ArrayLike) -> NDArray[np.int64]:
    values = check_array(caller, "sensor", given, "Give the index of each scan's sensor.")
    if (values != np.floor(values)).any():
        raise ValueError(f"{caller}: sensor must hold whole numbers; got {values.tolist()[:10]}. Count sensors from 0.")
    return values.astype(np.int64)


def _per_scan(name: str, given: ArrayLike, K: int, shape: tuple[int, ...]) -> Array:
    """One for all scans or one for each, as one for each."""
    values = check_array("Scans.from_arrays", name, given, "Give numbers.")
    if values.shape not in (shape, (K, *shape), (1, *shape)):
        raise ValueError(
            f"Scans.from_arrays: {name} must have shape {shape} or {(K, *shape)}; got {values.shape}. One for all "
            "scans, or one per scan."
        )
    return np.array(np.broadcast_to(values, (K, *shape)))


def _padded(sensor: ScanSensor, size: int) -> Array:
    noise = np.eye(size)
    noise[: sensor.size, : sensor.size] = sensor.noise
    return noise


def _measured(part: ArrayLike, own: int, wide: int, k: int, padded: bool) -> Array:
    """Detections (n, wide) of one scan, zeros beyond the sensor's own components."""
    values = check_array("Scans.from_arrays", f"detections of scan {k}", part, "Give rows of components.")
    values = values.reshape(-1, own) if values.size == 0 else np.atleast_2d(values)
    if values.ndim != 2 or values.shape[1] < own or (values.shape[1] > own and not padded):
        raise ValueError(
            f"Scans.from_arrays: detections must have shape (n, {own}) in scan {k}, as its sensor measures; got "
            f"{values.shape}. Give one row per detection."
        )
    values = values[:, :own]
    if padded:
        values = values[~np.isnan(values).all(axis=1)]
    return np.hstack([values, np.zeros((len(values), wide - own))])


def _clean(values: Array) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Sorted detections, where each stood, and how many were not finite and how many repeated."""
    good = np.flatnonzero((np.abs(values) < ABSURD).all(axis=1))
    if good.size < 2:
        return values[good], good, np.array([len(values) - good.size, 0])
    order = good[np.lexsort(values[good].T[::-1])]
    fresh = np.concatenate([[True], (np.diff(values[order], axis=0) != 0).any(axis=1)])
    return values[order[fresh]], order[fresh], np.array([len(values) - good.size, int((~fresh).sum())])
