"""Recorded tracks as a source of episodes: windows of real targets, seen as recorded or through a simulated sensor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes
from jink.envs.observing import nominal_sigma
from jink.envs.reading.recorded_choice import TRUTHS, choose_sensor, choose_truth, intent_names
from jink.envs.reading.recorded_rows import TruthRows, find_windows, mean_acceleration_density, truth_rows
from jink.envs.recorded import read_tracks
from jink.envs.sensing import Sensing
from jink.envs.streams import STREAMS, Need, Streams, draw
from jink.envs.surges import Surge, as_surges
from jink.envs.truth import Truth
from jink.estimators.sensor import Sensor
from jink.estimators.tracks import Tracks

__all__ = ["NOISES", "RecordedSource"]

Array = NDArray[np.float64]
NOISES = ("recorded", "simulated")
_MOTION, _SURGE, _SENSOR = (STREAMS.index(name) for name in ("motion", "surge", "sensor"))


@dataclass(frozen=True, eq=False)
class RecordedSource:
    """Episodes are windows of ``steps`` consecutive rows of recorded tracks; every window is equally likely.

    Times are the recorded ones from the window's first row on, gaps and all, in whole ticks of 15 ps so that gaps add
    up exactly. The motion stream picks the window; surges and simulated sensor noise have their own streams, so that
    other noise leaves the windows alone. ``notes`` says what was decided.

    Args:
        tracks: the tracks, or a file in the track format.
        steps: samples of an episode, >= 2.
        noise: "recorded": measurements as recorded; "simulated": truth seen by `sensing`.
        sigma: nominal standard deviation, one or one per component; m, rad, m/s. None, recorded noise: the median
            of the file's sigmas, else the robust spread about the recorded truth.
        sensing: the simulated sensor; None: positions with `sigma`.
        surges: what goes wrong with simulated noise; surges or their registry names, one or several.
        truth: "recorded"; "measured": the measured positions stand for the truth; "smoothed": a constant-velocity
            smoother's do; "auto": recorded where the tracks have it, else measured under simulated noise of measured
            positions, else smoothed.
        start_sigma: standard deviations of the prior's position and velocity around the truth, m, m/s; None: three
            times the position error of one measurement, and the root mean square speed.
        filter_noise: white acceleration a constant-velocity filter should assume, m^2/s^3; 0: what moves the mean
            velocities of spans of steps / 20 as much as recorded.
        max_gap: rows further apart than this, s, are never in one window.
        acceleration: typical acceleration, m/s^2, for the smoother.
        skip_unusable: leave out tracks without a window instead of refusing them.

    Raises:
        ValueError: an option out of range or against another, or a track that gives no window, and why.
    """

    tracks: Tracks | str | Path
    steps: int = 200
    noise: str = "recorded"
    sigma: float | tuple[float, ...] | None = None
    sensing: Sensing | None = None
    surges: tuple[Surge, ...] = ()
    truth: str = "auto"
    start_sigma: tuple[float, float] | None = None
    filter_noise: float = 0.0
    max_gap: float = np.inf
    acceleration: float = 1.0
    skip_unusable: bool = False
    notes: tuple[str, ...] = field(init=False, repr=False)
    sensor: Sensor = field(init=False, repr=False)
    intents: tuple[str, ...] = field(init=False, repr=False)
    _tracks: Tracks = field(init=False, repr=False)
    _sensing: Sensing = field(init=False, repr=False)
    _start_sigma: tuple[float, float] = field(init=False, repr=False)
    _rows: TruthRows = field(init=False, repr=False)
    _starts: NDArray[np.int64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check_options()
        tracks = self.tracks if isinstance(self.tracks, Tracks) else read_tracks(self.tracks)
        kind = choose_truth(tracks, self.truth, self.noise)
        intents = intent_names(tracks)
        choice = (tracks, self.noise, self.sigma, self.sensing)
        sensor = choose_sensor(*choice) if kind == "smoothed" or self.noise == "simulated" else None
        rows = truth_rows(tracks, kind, intents, self.max_gap, sensor, self.acceleration)
        windows = find_windows(rows, tracks, self.steps)
        if windows.refused and not (self.skip_unusable and windows.starts.size):
            more = f", and so for {len(windows.refused) - 1} more" if len(windows.refused) > 1 else ""
            raise ValueError(
                f"RecordedSource: tracks must each hold {self.steps} usable rows in a row; got {windows.refused[0]}"
                f"{more}. Use fewer steps" + (", or skip_unusable=True." if windows.starts.size else ".")
            )
        sensor = sensor or choose_sensor(*choice, rows)
        sensing = self.sensing or Sensing(sensor)
        density = self.filter_noise or mean_acceleration_density(rows, max(1, self.steps // 20))
        notes = [f"truth: {kind}", f"{windows.starts.size} windows of {self.steps} rows in {len(tracks)} tracks"]
        notes += [f"left out: {sentence}" for sentence in windows.refused]
        notes.append(f"nominal sigma: {', '.join(f'{value:.4g}' for value in sensor.sigma)}")
        places = rows.sensor_states[:, : tracks.axes]
        if self.noise == "simulated":
            places = sensing.platform.states(rows.clock[None], tracks.axes)[0, :, : tracks.axes]
        error = float(np.sqrt(np.mean(np.square(nominal_sigma(sensor, rows.position - places)))))
        speed = float(np.sqrt(np.mean(np.square(rows.velocity).sum(axis=1))))
        for name, value in (
            ("_tracks", tracks),
            ("_sensing", sensing),
            ("sensor", sensor),
            ("intents", intents),
            ("_start_sigma", self.start_sigma or (3 * error, max(speed, 1e-3))),
            # A target that never accelerates still needs a filter that does not go to sleep.
            ("filter_noise", density or 1e-6),
            ("notes", tuple(notes)),
            ("_rows", rows),
            ("_starts", windows.starts),
        ):
            object.__setattr__(self, name, value)
        for surge in self.surges:
            surge.need(self.steps, self._duration, sensor.size)

    def _check_options(self) -> None:
        for name, value, known in (("noise", self.noise, NOISES), ("truth", self.truth, TRUTHS)):
            if value not in known:
                raise ValueError(
                    f"RecordedSource: {name} must be one of {', '.join(known)}; got {value!r}. Choose one."
                )
        if not isinstance(self.steps, int | np.integer) or isinstance(self.steps, bool) or self.steps < 2:
            raise ValueError(
                f"RecordedSource: steps must be an integer >= 2; got {self.steps!r}. Give the samples of an episode."
            )
        for name, rule, good in (
            ("filter_noise", "be finite and >= 0 m^2/s^3", 0 <= self.filter_noise < np.inf),
            ("max_gap", "be > 0 s", self.max_gap > 0),
            ("acceleration", "be finite and > 0 m/s^2", 0 < self.acceleration < np.inf),
        ):
            if not good:
                raise ValueError(
                    f"RecordedSource: {name} must {rule}; got {getattr(self, name)!r}. Leave it out for the default."
                )
        sigmas = self.start_sigma
        if sigmas is not None and (len(sigmas) != 2 or not all(0 < value < np.inf for value in sigmas)):
            raise ValueError(
                f"RecordedSource: start_sigma must be two numbers > 0, m and m/s; got {sigmas!r}. Leave it out."
            )
        object.__setattr__(self, "surges", as_surges(self.surges))
        for surge in self.surges:
            if not hasattr(surge, "apply"):
                raise ValueError(
                    f"RecordedSource: surges must be surges or their names; got {surge!r}. See jink.envs.surges."
                )
        if self.noise == "recorded" and (self.surges or self.sensing is not None):
            raise ValueError(
                f"RecordedSource: {'surges' if self.surges else 'sensing'} must come with simulated noise; got "
                "noise='recorded'. Use noise='simulated'."
            )
        if self.noise == "simulated" and (self.sigma is None) == (self.sensing is None):
            raise ValueError(
                "RecordedSource: sigma or sensing must be given with simulated noise, and not both; got "
                f"{'neither' if self.sigma is None else 'both'}. Use sigma=METRES for a position sensor."
            )

    @property
    def id(self) -> str:
        """Name with version, from the file's name."""
        name = self._tracks.source.rpartition("/")[2].partition(".")[0]
        return f"recorded-{re.sub(r'[^a-z0-9]+', '-', name.lower()).strip('-') or 'tracks'}-v0"

    @property
    def axes(self) -> int:
        """Space dimensions, 2 or 3."""
        return self._tracks.axes

    @property
    def extent(self) -> float:
        """True positions stay within this distance of the origin along every axis, m."""
        return max(float(np.abs(self._rows.position).max()), 1.0)

    @property
    def windows(self) -> int:
        """How many different episodes there are, before noise."""
        return len(self._starts)

    @property
    def _duration(self) -> float:
        return float((self._rows.clock[self._starts + self.steps - 1] - self._rows.clock[self._starts]).max())

    def simulate(self, streams: Sequence[Streams]) -> Episodes:
        """One episode per entry; the generators advance by the same amount every time."""
        by_stream = list(zip(*streams, strict=True)) or [()] * len(STREAMS)
        picked = draw(by_stream[_MOTION], Need(uniforms=1)).uniforms[:, 0]
        starts = self._starts[(picked * self.windows).astype(np.int64)]
        rows = starts[:, None] + np.arange(self.steps)
        own = self._rows
        clock = own.clock[rows]
        times = clock - clock[:, :1]
        truth = Truth(
            own.position[rows],
            own.velocity[rows],
            own.acceleration[rows],
            own.intent[rows],
            self._switches(rows, times),
        )
        scale, bias = np.ones(times.shape), np.zeros((*times.shape, self.sensor.size))
        detected = np.ones(times.shape, dtype=np.bool_)
        draws = draw(by_stream[_SENSOR], self._sensing.need(self.steps))
        mean, cov = self._sensing.prior(truth, draws, self._start_sigma)
        if self.noise == "simulated":
            for surge in self.surges:
                need = surge.need(self.steps, self._duration, self.sensor.size)
                surge.apply(times, draw(by_stream[_SURGE], need), scale, bias, detected)
            z, noise, states = self._sensing.look(times, truth, draws, scale, bias, detected)
        else:
            z, states = own.measurements[rows], own.sensor_states[rows]
            detected = np.isfinite(z).any(axis=-1)
            noise = np.broadcast_to(self.sensor.noise, (*z.shape, self.sensor.size)).copy()
            if own.noise is not None:
                noise = own.noise[rows]
                ratio = np.diagonal(noise, axis1=-2, axis2=-1) / np.diag(self.sensor.noise)
                known = np.isfinite(z)
                scale = np.where(detected, np.where(known, ratio, 0.0).sum(-1) / np.maximum(known.sum(-1), 1), 1.0)
        nominal = self.sensor.noise
        return Episodes(times, times, truth, truth, z, detected, scale, bias, noise, nominal, states, mean, cov)

    def _switches(self, rows: NDArray[np.int64], times: Array) -> Array:
        """Times of the first rows with a new label; (B, S)."""
        intent = self._rows.intent
        changed = np.concatenate([[False], intent[1:] != intent[:-1]])
        total = np.cumsum(changed)
        most = int((total[self._starts + self.steps - 1] - total[self._starts]).max())
        switches = np.full((len(rows), most), np.nan)
        b, k = np.nonzero(changed[rows[:, 1:]])
        switches[b, (total[rows[b, k + 1]] - total[rows[b, 0]]) - 1] = times[b, k + 1]
        return switches
