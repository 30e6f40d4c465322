"""Which intent a target had when: labels, probabilities and change points, from the whole of each track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.markov import MarkovChain
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import make_sensor, position
from jink.estimators.tracks import Tracks
from jink.intent.model import IntentModel
from jink.intent.sides import keeps_side, spell_length

__all__ = ["ChangePoint", "Run", "Segmentation", "segment", "tracks_sensor"]

Floats = NDArray[np.float64]
_WINDOW_STEPS = 4.0
_FITTINGS, _FITTED = 200, 1e-6  # sweeps at most, and what they may leave of a probability


class ChangePoint(NamedTuple):
    """A change of label: time (midway between two rows), s; first row after it; labels; probability of a switch near.

    The probability is the expected number of switches within the segmentation's window around the time, at most 1.
    """

    time: float
    row: int
    before: int
    after: int
    probability: float


class Run(NamedTuple):
    """A stretch of one label: label, first row, last row, and from change to change its duration, s."""

    label: int
    first: int
    last: int
    duration: float


@dataclass(frozen=True)
class Segmentation:
    """Labels of tracks; B tracks, T rows, P labels.

    Args:
        labels: most probable label of each row, -1 outside its track; (B, T).
        probs: probability of each label given the whole track; (B, T, P).
        times: s; (B, T).
        lengths: rows of each track; (B,).
        names: of the labels, for tables.
        switches: probability that the label changed between the row before and this one; (B, T); None: 1 where the
            label does and 0 elsewhere.
        filtered: probability of each label given the track so far; (B, T, P); None: unknown.
        window: width around a change point in which a switch counts for its probability, s.
        endings: probability that each label ended between the row before and this one; (B, T, P); None: unknown.

    Raises:
        ValueError: shapes do not fit each other.
    """

    labels: NDArray[np.int64]
    probs: Floats
    times: Floats
    lengths: NDArray[np.int64]
    names: tuple[str, ...] = ()
    switches: Floats | None = None
    filtered: Floats | None = None
    window: float = 0.0
    endings: Floats | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        B, T = self.labels.shape
        P = self.probs.shape[-1]
        put(self, "names", tuple(self.names) or tuple(str(p + 1) for p in range(P)))
        expected = {"probs": (B, T, P), "times": (B, T), "lengths": (B,), "switches": (B, T), "filtered": (B, T, P)}
        expected["endings"] = (B, T, P)
        for name, shape in expected.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise ValueError(
                    f"Segmentation: {name} must have shape {shape}; got {value.shape}. "
                    "Give one row per time, one column per label."
                )
        if len(self.names) != P:
            raise ValueError(f"Segmentation: names must hold {P} labels; got {len(self.names)}. Name each column.")

    @classmethod
    def of_probs(
        cls,
        probs: Floats,
        times: Floats,
        lengths: NDArray[np.int64],
        *,
        names: tuple[str, ...] = (),
        switches: Floats | None = None,
        filtered: Floats | None = None,
        window: float | None = None,
        endings: Floats | None = None,
    ) -> Segmentation:
        """From probabilities (B, T, P): the most probable label of each row; window None: four median time steps."""
        labels = np.where(np.arange(times.shape[1]) < lengths[:, None], probs.argmax(axis=2), -1)
        if window is None:
            steps = np.diff(times, axis=1)
            window = _WINDOW_STEPS * float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
        return cls(labels.astype(np.int64), probs, times, lengths, names, switches, filtered, window, endings)

    def change_points(self, track: int) -> tuple[ChangePoint, ...]:
        """Where the label of a track (by position) changes, in order."""
        label, clock = self.labels[track], self.times[track]
        found = []
        for row in range(1, int(self.lengths[track])):
            if label[row] != label[row - 1]:
                time = 0.5 * (float(clock[row]) + float(clock[row - 1]))
                found.append(ChangePoint(time, row, int(label[row - 1]), int(label[row]), self._near(track, time, row)))
        return tuple(found)

    def _near(self, track: int, time: float, row: int) -> float:
        if self.switches is None:
            return 1.0
        n = int(self.lengths[track])
        middle = 0.5 * (self.times[track, 1:n] + self.times[track, : n - 1])
        near = np.abs(middle - time) <= 0.5 * self.window * (1.0 + 1e-9)
        near[row - 1] = True
        return float(min(self.switches[track, 1:n][near].sum(), 1.0))

    def runs(self, track: int) -> tuple[Run, ...]:
        """The stretches of one label of a track (by position), in order."""
        n = int(self.lengths[track])
        if n == 0:
            return ()
        cuts = self.change_points(track)
        rows = [0, *(cut.row for cut in cuts), n]
        edges = [float(self.times[track, 0]), *(cut.time for cut in cuts), float(self.times[track, n - 1])]
        return tuple(
            Run(int(self.labels[track, rows[i]]), rows[i], rows[i + 1] - 1, edges[i + 1] - edges[i])
            for i in range(len(rows) - 1)
        )


def tracks_sensor(tracks: Tracks, noise_sd: tuple[float, ...] | float | None = None) -> Sensor:
    """The sensor of tracks that carry their noise, or of positions with standard deviation ``noise_sd``, m.

    Raises:
        ValueError: neither the tracks nor ``noise_sd`` say how noisy positions are.
    """
    if tracks.sensor == "position":
        if noise_sd is None and tracks.noise is None:
            raise ValueError("segment: tracks must carry noise where the model learned none; got none. Pass a sensor.")
        return position(tracks.axes, 1.0 if noise_sd is None else noise_sd)
    options = {"axes": tracks.axes} if tracks.sensor in {"range", "range-rate", "range-range-rate"} else {}
    return make_sensor(tracks.sensor, **options)


def segment(
    model: IntentModel,
    tracks: Tracks,
    sensor: Sensor | None = None,
    *,
    handed: bool = False,
    window: float | None = None,
    threads: int | None = None,
) -> Segmentation:
    """Label tracks with the intents of a model, by the smoother.

    Model: with filtered mode probabilities mu, smoothed s, the chain Pi of a step and ``c = Pi' mu``, pairs of modes
    (i before, j after) are those nearest to ``mu_i Pi_ij s_j / c_j`` (Kim) with the marginals s before and after; a
    switch is a pair of unlike labels.

    Args:
        model: what was learned.
        tracks: what was measured; any sensor of the bank.
        sensor: None: that of the tracks, with their noise or the one the model learned.
        handed: left and right of a mirrored intent are labels of their own, where a spell keeps to its side (mean turn
            rate larger than its spread).
        window: around a change point, s; None: four median time steps.
        threads: processor cores; None: all.

    Returns:
        one label per intent (or side of one), in the order of the model.

    Raises:
        ValueError: no noise is known, or the tracks do not fit the model.
    """
    if sensor is None:
        sensor = tracks_sensor(tracks, model.noise_sd)
    estimator = model.estimator(sensor, threads=threads)
    learned = model.noise_sd is not None and tracks.sensor == "position"
    given = (tracks.measurements, tracks.times, None if learned else tracks.noise, tracks.sensor_states, tracks.lengths)
    filtered, smoothed = estimator.run(*given).mode_probs, estimator.smooth(*given).mode_probs
    group, names = _groups(model, handed)
    member = np.eye(len(names))[group]
    bank = estimator.bank
    chain = bank.chain if bank.chain is not None else MarkovChain(matrix=((1.0,),))
    endings = _ending_probs(filtered, smoothed, tracks.times, chain, group)
    endings[np.arange(tracks.times.shape[1]) >= tracks.lengths[:, None]] = 0.0
    return Segmentation.of_probs(
        smoothed @ member,
        tracks.times,
        tracks.lengths,
        names=names,
        switches=np.clip(endings.sum(axis=2), 0.0, 1.0),
        filtered=filtered @ member,
        window=window,
        endings=endings,
    )


def _groups(model: IntentModel, handed: bool) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Label of each mode, and the labels' names."""
    names: list[str] = []
    group = []
    for mode in model.modes:
        name = model.intents[mode.intent].name
        phase = model.phase_of(mode)
        lasts = spell_length(model, mode.intent, mode.phase)
        if handed and phase.mirrored and all(keeps_side(phase, birth, lasts) for birth in phase.births):
            name += " left" if mode.sign > 0 else " right"
        if name not in names:
            names.append(name)
        group.append(names.index(name))
    return np.array(group, dtype=np.int64), tuple(names)


def _ending_probs(
    filtered: Floats, smoothed: Floats, times: Floats, chain: MarkovChain, group: NDArray[np.int64]
) -> Floats:
    """Probability of a pair of unlike labels at each row, by the first of both; (B, T, P); 0 at the first row."""
    member = np.eye(int(group.max()) + 1)[group]
    out = np.zeros((*times.shape, member.shape[1]))
    steps = np.diff(times, axis=1)
    unlike = group[:, None] != group[None, :]
    for dt in np.unique(steps):
        b, t = np.nonzero(steps == dt)
        Pi = np.asarray(chain.at(float(dt)))
        pairs = _pairs(filtered[b, t], Pi, smoothed[b, t], smoothed[b, t + 1])
        out[b, t + 1] = np.einsum("kij,ij->ki", pairs, unlike, optimize=True) @ member
    return np.clip(out, 0.0, 1.0)


def _pairs(filtered: Floats, Pi: Floats, before: Floats, after: Floats) -> Floats:
    """Joint probability of modes at two rows, (K, M, M), whose marginals are the smoother's at both.

    Of all such joints the nearest (Kullback-Leibler) to Kim's ``mu_i Pi_ij s_j / c_j``, whose second marginal is right
    and whose first is not that of a smoother which weighs pairs by the likelihood of the future.

    Args:
        filtered: mu at the first row; (K, M).
        Pi: of the step between; (M, M).
        before, after: smoothed at the two rows; (K, M).

    Source: Deming & Stephan (1940), iterative proportional fitting.
    """
    pairs = filtered[:, :, None] * Pi
    pairs = pairs * (after / np.maximum(pairs.sum(axis=1), 1e-300))[:, None, :]
    for _ in range(_FITTINGS):
        rows = pairs.sum(axis=2)
        if float(np.abs(rows - before).max(initial=0.0)) < _FITTED:
            break
        pairs *= (before / np.maximum(rows, 1e-300))[:, :, None]
        pairs *= (after / np.maximum(pairs.sum(axis=1), 1e-300))[:, None, :]
    return np.asarray(pairs)
