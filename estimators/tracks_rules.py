"""What a container of tracks refuses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jink.estimators.tracks import Tracks


def check_shapes(tracks: Tracks) -> None:
    """Refuse arrays whose shapes do not fit each other."""
    if tracks.axes not in (1, 2, 3):
        raise ValueError(f"Tracks: axes must be 1, 2 or 3; got {tracks.axes}. Use the target's space dimensions.")
    if tracks.times.ndim != 2:
        raise ValueError(
            f"Tracks: times must have shape (B, T); got {tracks.times.shape}. Use Tracks.from_arrays for single tracks."
        )
    B, T = tracks.times.shape
    if tracks.measurements.ndim != 3 or tracks.measurements.shape[:2] != (B, T):
        raise ValueError(
            f"Tracks: measurements must have shape (B, T, D) = ({B}, {T}, D); got "
            f"{tracks.measurements.shape}. "
            "Give one row per time."
        )
    D, A = tracks.measurements.shape[2], tracks.axes
    if tracks.sensor == "position" and D != A:
        raise ValueError(
            f"Tracks: measurements must have D = {A} components for a position in {A} axes; got {D}. "
            "Change axes or the columns."
        )
    expected = {
        "lengths": (B,),
        "noise": (B, T, D, D),
        "sensor_states": (B, T, 2 * A),
        "truth": (B, T, A),
        "truth_velocity": (B, T, A),
        "intents": (B, T),
        "sensor_ids": (B, T),
    }
    for name, shape in expected.items():
        value = getattr(tracks, name)
        if value is not None and value.shape != shape:
            raise ValueError(
                f"Tracks: {name} must have shape {shape}; got {value.shape}. Match times of shape {(B, T)}."
            )
    if len(tracks.ids) != B or len(set(tracks.ids)) != B:
        raise ValueError(
            f"Tracks: ids must be {B} different names; got {len(tracks.ids)}, {len(set(tracks.ids))} of "
            f"them different. "
            "Give one per track."
        )


def check_values(tracks: Tracks) -> None:
    """Refuse lengths out of range, times that are not finite or go backwards, and infinite measurements."""
    T = tracks.times.shape[1]
    if tracks.lengths.size and (tracks.lengths.min() < 0 or tracks.lengths.max() > T):
        raise ValueError(
            f"Tracks: lengths must lie in 0..{T}; got "
            f"{int(tracks.lengths.min())}..{int(tracks.lengths.max())}. "
            "Count the rows of each track."
        )
    used = np.arange(T) < tracks.lengths[:, None]
    bad = np.argwhere(used & ~np.isfinite(tracks.times))
    if bad.size:
        b, t = bad[0]
        raise ValueError(
            f"Tracks: times must be finite; got {tracks.times[b, t]} in track '{tracks.ids[b]}', row {t}. "
            "Remove the row."
        )
    back = np.argwhere(used[:, 1:] & (np.diff(tracks.times, axis=1) < 0))
    if back.size:
        b, t = back[0]
        raise ValueError(
            f"Tracks: times must not go backwards; got {tracks.times[b, t + 1]} after {tracks.times[b, t]} "
            f"in track "
            f"'{tracks.ids[b]}', row {t + 1}. Sort the rows by time."
        )
    if np.isinf(tracks.measurements).any():
        b, t, d = np.argwhere(np.isinf(tracks.measurements))[0]
        raise ValueError(
            f"Tracks: measurements must be finite or NaN (missing); got {tracks.measurements[b, t, d]} "
            f"in track "
            f"'{tracks.ids[b]}', row {t}, component {d}. Use NaN for what is missing."
        )
