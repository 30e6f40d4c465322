"""Tracks to learn from: files, simulated scenarios and suites of them, as positions in one container."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.envs.scenarios import SCENARIOS, SUITES, make_scenario
from jink.envs.simulate import simulate_tracks
from jink.estimators.tracks import Tracks
from jink.intent.located import locate
from jink.training.options import parse_sigma
from jink.training.track import TrackRequest, read
from jink.training.tuning import sensor_of
from jink.training.wording import in_own_words

__all__ = ["as_positions", "digest_of", "gather", "pool"]

_ARRAYS = ("times", "measurements", "noise", "truth", "truth_velocity", "intents")


def gather(
    sources: Sequence[str], reading: TrackRequest, *, count: int = 128, steps: int | None = None, seed: int = 0
) -> Tracks:
    """Read or simulate every source and put the tracks into one container of positions.

    Args:
        sources: files, scenarios or suites; an existing file wins over a name.
        reading: how files are read; its ``file`` is not looked at.
        count: tracks of each scenario.
        steps: samples of each simulated track; None: the scenario's own.
        seed: of the first simulated track.

    Returns:
        the tracks.

    Raises:
        ValueError: neither a file nor a name, or tracks that do not go together.
        OSError: a file that cannot be read.
    """
    found: list[Tracks] = []
    for source in sources:
        path = Path(source)
        if path.is_file():
            found.append(as_positions(read(replace(reading, file=path)), reading.sigma, reading.degrees))
        elif source in SCENARIOS or source in SUITES:
            for name in SUITES.get(source, (source,)):
                with in_own_words("--steps"):
                    scenario = make_scenario(name, **({} if steps is None else {"steps": steps}))
                found.append(as_positions(simulate_tracks(scenario, count, seed), None))
        else:
            raise ValueError(
                f"SOURCES: each must be a file, or a scenario or suite of jink list; got '{source}'. "
                f"Suites are {', '.join(SUITES)}."
            )
    return found[0] if len(found) == 1 else pool(found)


def as_positions(tracks: Tracks, sigma: str | None, degrees: bool = False) -> Tracks:
    """The same tracks measured as positions: what a sensor that locates alone saw, row by row.

    Args:
        tracks: as read.
        sigma: value of ``--sigma``; None: the noise of the tracks, if any.
        degrees: its angles are in degrees.

    Raises:
        ValueError: a sensor that does not locate a target from one row, or no noise for one that does.
    """
    if sigma is not None:
        deviations = np.array(parse_sigma(sigma, sensor_of(tracks), degrees))
        noise = np.broadcast_to(np.diag(deviations**2), (*tracks.measurements.shape, len(deviations)))
        tracks = replace(tracks, noise=noise)
    if tracks.sensor == "position":
        return tracks
    if tracks.noise is None:
        raise ValueError(
            f"--sigma: value must be given for a {tracks.sensor} sensor without sigma columns; got none. "
            "Write for example --sigma sigma_range=10,sigma_bearing=0.003."
        )
    with in_own_words(tracks.source):
        positions, covs = locate(tracks)
    note = f"{tracks.sensor} made positions row by row, each with its covariance"
    return replace(
        tracks,
        measurements=np.where(tracks.used[..., None], positions, np.nan),
        noise=covs,
        sensor="position",
        sensor_states=None,
        notes=(*tracks.notes, note),
    )


def pool(parts: Sequence[Tracks]) -> Tracks:
    """Tracks of several sources as one container; ids get the source in front.

    Args:
        parts: positions in the same axes; all with noise or all without.

    Raises:
        ValueError: they do not go together.
    """
    for name, kinds in (("axes", {part.axes for part in parts}), ("noise", {part.noise is None for part in parts})):
        if len(kinds) > 1:
            given = ", ".join(f"{part.source} {_said(part, name)}" for part in parts)
            raise ValueError(
                f"SOURCES: all must have the same {name}; got {given}. "
                f"{'Use --axes.' if name == 'axes' else 'Give --sigma for all.'}"
            )
    T = max(part.times.shape[1] for part in parts)
    arrays: dict[str, Any] = {}
    for name in _ARRAYS:
        values = [getattr(part, name) for part in parts]
        if all(value is None for value in values):
            continue
        if name == "intents":
            empty = [np.full(part.times.shape, "") if v is None else v for part, v in zip(parts, values, strict=True)]
            arrays[name] = np.concatenate([_widened(value, T, "") for value in empty])
            continue
        if name in ("truth", "truth_velocity"):
            values = [
                np.full_like(p.measurements, np.nan) if v is None else v for p, v in zip(parts, values, strict=True)
            ]
        fill = np.nan if name in ("measurements", "truth", "truth_velocity") else None
        arrays[name] = np.concatenate([_widened(value, T, fill) for value in values])
    names = [part.source.removesuffix(".csv").removesuffix(".parquet") for part in parts]
    distinct = names if len(set(names)) == len(names) else [f"{number}" for number in range(1, len(names) + 1)]
    ids = tuple(f"{name}/{one}" for name, part in zip(distinct, parts, strict=True) for one in part.ids)
    return Tracks(
        ids=ids,
        lengths=np.concatenate([part.lengths for part in parts]),
        sensor="position",
        axes=parts[0].axes,
        source=", ".join(names),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
        **arrays,
    )


def digest_of(tracks: Tracks) -> str:
    """SHA-256 of what is learned from: times, measurements, noise, lengths."""
    total = hashlib.sha256()
    for value in (tracks.times, tracks.measurements, tracks.noise, tracks.lengths):
        if value is not None:
            total.update(repr((value.shape, value.dtype.str)).encode())
            total.update(np.ascontiguousarray(value).tobytes())
    return total.hexdigest()


def _said(part: Tracks, name: str) -> str:
    return str(part.axes) if name == "axes" else "without" if part.noise is None else "with"


def _widened(value: NDArray[Any], T: int, fill: float | str | None) -> NDArray[Any]:
    """Padding to T rows; None repeats the last one."""
    more = T - value.shape[1]
    if not more:
        return value
    tail = value[:, -1:] if fill is None else np.full_like(value[:, -1:], fill)
    return np.concatenate([value, np.repeat(tail, more, axis=1)], axis=1)
