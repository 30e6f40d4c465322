"""Measured tracks as arrays: what the readers give, what estimators and benchmarks take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.tracks_padding import as_list, pad
from jink.estimators.tracks_rules import check_shapes, check_values

__all__ = ["Track", "Tracks"]

Floats = NDArray[np.float64]


class Track(NamedTuple):
    """One track without padding: views into the arrays of `Tracks`, T rows."""

    id: str
    times: Floats
    measurements: Floats
    noise: Floats | None
    sensor_states: Floats | None
    truth: Floats | None
    truth_velocity: Floats | None
    intents: NDArray[np.str_] | None


@dataclass(frozen=True)
class Tracks:
    """Measurements of B tracks over T times, padded to the longest; A axes, D measurement components.

    Rows from `lengths[b]` on are padding: the time repeats the last one, measurements and truth are NaN.
    Arrays become contiguous float64, copied only where they are not; nothing changes them in place.

    Args:
        ids: one name per track, each once; (B,).
        times: seconds, never decreasing within a track; (B, T).
        measurements: metres, radians, m/s as the sensor says; NaN = missing component; (B, T, D).
        sensor: kind of sensor, for instance "position", "range-bearing", "range".
        lengths: rows of each track; (B,).
        axes: space dimensions A, 1 to 3.
        noise: measurement covariance of each row, or None for the sensor's own; (B, T, D, D).
        sensor_states: the sensor's position then velocity, m and m/s, or None for the origin; (B, T, 2 A).
        truth: true position, metres, NaN = unknown; (B, T, A).
        truth_velocity: true velocity, m/s, NaN = unknown; (B, T, A).
        intents: label of each row, "" = none; (B, T).
        sensor_ids: name of the sensor of each row, "" = none; (B, T).
        source: where the tracks come from, for messages.
        notes: what a reader decided, one sentence each, for the summary.

    Raises:
        ValueError: shapes do not fit each other, or a time is not finite or goes backwards.
    """

    ids: tuple[str, ...]
    times: Floats
    measurements: Floats
    sensor: str
    lengths: NDArray[np.int64]
    axes: int
    noise: Floats | None = None
    sensor_states: Floats | None = None
    truth: Floats | None = None
    truth_velocity: Floats | None = None
    intents: NDArray[np.str_] | None = None
    sensor_ids: NDArray[np.str_] | None = None
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", tuple(str(name) for name in self.ids))
        object.__setattr__(self, "notes", tuple(self.notes))
        for name in ("times", "measurements", "noise", "sensor_states", "truth", "truth_velocity"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, np.ascontiguousarray(value, dtype=np.float64))
        object.__setattr__(self, "lengths", np.array(self.lengths, dtype=np.int64))
        for name in ("intents", "sensor_ids"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, np.asarray(value, dtype=np.str_))
        check_shapes(self)
        check_values(self)

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[Track]:
        for b, name in enumerate(self.ids):
            rows = slice(0, int(self.lengths[b]))
            optional = (self.noise, self.sensor_states, self.truth, self.truth_velocity, self.intents)
            cut = [None if value is None else value[b, rows] for value in optional]
            yield Track(name, self.times[b, rows], self.measurements[b, rows], *cut)  # type: ignore[arg-type]

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which rows are not padding; (B, T)."""
        return np.asarray(np.arange(self.times.shape[1]) < self.lengths[:, None])

    def subset(self, which: Sequence[int | str] | NDArray[np.int64] | NDArray[np.bool_]) -> Tracks:
        """Some of the tracks, in the order asked for, padded to the longest of them.

        Args:
            which: ids, positions (negative from the end), or one boolean per track.

        Returns:
            a new container.

        Raises:
            ValueError: an id or a position that does not exist, or a wrong number of booleans.
        """
        array = np.asarray(which)
        if array.dtype == bool:
            if array.shape != (len(self),):
                raise ValueError(
                    f"Tracks.subset: which must have shape ({len(self)},) when boolean; got {array.shape}. "
                    "Give one per track."
                )
            positions = np.flatnonzero(array)
        else:
            positions = np.array([self._position(name) for name in which], dtype=np.int64)
        T = int(self.lengths[positions].max(initial=0))
        arrays = (
            "times",
            "measurements",
            "noise",
            "sensor_states",
            "truth",
            "truth_velocity",
            "intents",
            "sensor_ids",
        )
        changed = {name: value[positions, :T] for name in arrays if (value := getattr(self, name)) is not None}
        return replace(self, ids=tuple(self.ids[b] for b in positions), lengths=self.lengths[positions], **changed)

    def _position(self, which: int | str | np.int64) -> int:
        if isinstance(which, str):
            if which not in self.ids:
                shown = ", ".join(self.ids[:10]) + (", ..." if len(self) > 10 else "")
                raise ValueError(f"Tracks.subset: which must name tracks; got '{which}'. There are {shown}.")
            return self.ids.index(which)
        if not -len(self) <= int(which) < len(self):
            raise ValueError(
                f"Tracks.subset: which must lie in 0..{len(self) - 1}; got {which}. There are {len(self)} tracks."
            )
        return int(which) % len(self)

    @classmethod
    def from_arrays(
        cls,
        measurements: ArrayLike | Sequence[ArrayLike],
        times: ArrayLike | Sequence[ArrayLike],
        *,
        sensor: str = "position",
        axes: int | None = None,
        ids: Sequence[str] | None = None,
        lengths: ArrayLike | None = None,
        noise: ArrayLike | Sequence[ArrayLike] | None = None,
        sensor_states: ArrayLike | Sequence[ArrayLike] | None = None,
        truth: ArrayLike | Sequence[ArrayLike] | None = None,
        truth_velocity: ArrayLike | Sequence[ArrayLike] | None = None,
        intents: ArrayLike | Sequence[ArrayLike] | None = None,
        source: str = "",
    ) -> Tracks:
        """Build tracks from one track, a batch, or a list of tracks of different lengths.

        Args:
            measurements: one track (T, D), a batch (B, T, D), or a list of arrays (T_b, D).
            times: seconds; (T,), (B, T), or a list of (T_b,); (T,) serves a whole batch.
            sensor: kind of sensor.
            axes: space dimensions; None: D for positions, 2 otherwise.
            ids: one name per track; None: "1", "2", ...
            lengths: rows of each track in a batch; None: all.
            noise: covariances with the leading shape of `measurements`, or one (D, D) for all.
            sensor_states: position then velocity of the sensor, leading shape of `measurements`.
            truth: true positions, leading shape of `measurements`.
            truth_velocity: true velocities, leading shape of `measurements`.
            intents: labels, leading shape of `measurements`.
            source: where they come from.

        Returns:
            the container.

        Raises:
            ValueError: shapes do not fit each other.
        """
        tracks = as_list(measurements, 2)
        B = len(tracks)
        rows = np.array([len(track) for track in tracks], dtype=np.int64)
        T = int(rows.max(initial=0))
        clock = as_list(times, 1)
        clock = clock * B if len(clock) == 1 else clock
        if B == 0 or rows.min() == 0 or tracks[0].ndim != 2 or [len(t) for t in clock] != rows.tolist():
            raise ValueError(
                f"Tracks.from_arrays: times must have one entry per measurement row, {rows.tolist()[:10]}; "
                f"got "
                f"{[len(t) for t in clock][:10]}. Give measurements (T, D), (B, T, D) or a list of (T_b, D)."
            )
        size = tracks[0].shape[1]
        if noise is not None and np.ndim(noise) == 2:  # type: ignore[arg-type]
            noise = [np.broadcast_to(np.asarray(noise, dtype=float), (int(n), size, size)) for n in rows]

        def padded(value: ArrayLike | Sequence[ArrayLike] | None) -> Floats | None:
            return None if value is None else pad(as_list(value, 2), T, rows, np.nan)

        labels: Any = None
        if intents is not None:
            labels = pad([np.asarray(v, dtype=np.str_) for v in as_list(intents, 1)], T, rows, "")
        state = None
        if sensor_states is not None:
            state = pad(as_list(sensor_states, 2), T, rows, None)
        return cls(
            ids=tuple(ids) if ids is not None else tuple(str(b + 1) for b in range(B)),
            times=pad(clock, T, rows, None),
            measurements=pad(tracks, T, rows, np.nan),
            sensor=sensor,
            lengths=rows if lengths is None else np.asarray(lengths, dtype=np.int64),
            axes=axes if axes is not None else (size if sensor == "position" else 2),
            noise=None if noise is None else pad(as_list(noise, 3), T, rows, None),
            sensor_states=state,
            truth=padded(truth),
            truth_velocity=padded(truth_velocity),
            intents=labels,
            source=source,
        )
