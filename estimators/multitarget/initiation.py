"""How tracks begin and end: tentative tracks from detections nobody owns, confirmed or dropped by their evidence.

Evidence is the log-likelihood ratio of each scan with and without the track (`score_tracks`). A tentative track is
confirmed when it has enough evidence and M of its last N scans saw it; a track ends when its evidence has fallen too
far below its best (a CUSUM test), when nothing has been seen of it for too long, or when it stays on top of an older
track and both together own no more than one target's detections.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from jink.estimators.checks import check_count, check_number
from jink.estimators.multitarget.absorbing import absorb
from jink.estimators.multitarget.em import foresee, score_newest
from jink.estimators.multitarget.placing import place_detections
from jink.estimators.multitarget.results import Newest, kinematic_moments
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scan
from jink.estimators.multitarget.scoring import assign_in_order
from jink.estimators.multitarget.tracked import TrackSet, fresh_tracks, join, keep, state_moments

if TYPE_CHECKING:
    from jink.estimators.multitarget.pmht import Pmht, PmhtState

__all__ = ["Initiation", "Tentative", "initiate", "no_tentatives"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Initiation:
    """When tracks begin and end.

    Args:
        speed: standard deviation of a new target's velocity on each axis, m/s.
        hits, scans: M of the last N scans that watched it must have seen a new track; N also is the age at which
            one without enough evidence is dropped, times two.
        confirm: evidence that confirms it, nat.
        drop: evidence below zero that drops it, nat.
        delete: evidence a confirmed track may fall below its best, nat.
        patience: a confirmed track ends after this long without a detection, s.
        merge_scans: scans in a row on top of an older track that end a track.
        separation: targets never keep closer than this at like velocities, m: a younger track that does is a second one
            of an extended target, whatever detections it has; 0: nothing is known.
        most: tentative tracks kept at a time, those with the most evidence.

    Raises:
        ValueError: a number out of range.
    """

    speed: float = 20.0
    hits: int = 3
    scans: int = 5
    confirm: float = 10.0
    drop: float = 3.0
    delete: float = 10.0
    patience: float = np.inf
    merge_scans: int = 5
    separation: float = 0.0
    most: int = 2000

    def __post_init__(self) -> None:
        me = "Initiation"
        check_number(me, "speed", self.speed, 0.0, remedy="Give m/s.")
        for name in ("confirm", "drop", "delete", "patience"):
            remedy = "Give seconds." if name == "patience" else "Give nat."
            check_number(me, name, getattr(self, name), 0.0, infinite=True, remedy=remedy)
        check_number(me, "separation", self.separation, 0.0, least=True, remedy="Give metres, or 0.")
        check_count(me, "scans", self.scans, 1, 59, remedy="Use for instance 5.")
        check_count(me, "hits", self.hits, 1, self.scans, remedy="Use for instance 3 of 5 scans.")
        for name in ("merge_scans", "most"):
            check_count(me, name, getattr(self, name), 1, remedy="Give a count.")


class Tentative(NamedTuple):
    """U tentative tracks with J modes; moments after the newest scan."""

    mean: Array  # (U, J, n)
    cov: Array  # (U, J, n, n)
    probs: Array  # (U, J)
    evidence: Array  # nat; (U,)
    history: Ints  # last scans as bits, newest lowest, 1: seen; (U,)
    age: Ints  # scans that watched it; (U,)


def no_tentatives(modes: int, n: int) -> Tentative:
    """None yet."""
    none = np.zeros(0, dtype=np.int64)
    return Tentative(np.zeros((0, modes, n)), np.zeros((0, modes, n, n)), np.zeros((0, modes)), np.zeros(0), none, none)


def _some(tentative: Tentative, which: NDArray[Any]) -> Tentative:
    parts: list[Any] = [part[which] for part in tentative]
    return Tentative(*parts)


def initiate(
    estimator: Pmht, state: PmhtState, scan: Scan, ahead: tuple[Array, ...], newest: Newest
) -> tuple[PmhtState, Ints, Ints]:
    """End tracks, extend, confirm and begin tentative ones after a scan.

    Args:
        estimator: whose motions and options.
        state: after the fit.
        scan: just taken in.
        ahead: predictions of the tracks to it, of `foresee`.
        newest: its association.

    Returns:
        the state, ids of tracks ended and begun.
    """
    rules = estimator.initiation
    if rules is None:
        return state, newest.target[:0], newest.target[:0]
    sensor = state.sensors[scan.sensor]
    values = np.ascontiguousarray(state.window.detections[state.window.offsets[-2] :])
    spare = _spare(newest, state.tracks.hits[:, -1], len(values), estimator.assignment == "exclusive")
    state, ended = _end(estimator, state, scan, values, ahead)
    tentative, free = _extend(estimator, state, scan, values, spare)
    recent = tentative.history & ((1 << rules.scans) - 1)
    seen = np.array([int(bits).bit_count() for bits in recent], dtype=np.int64)
    ripe = (tentative.evidence >= rules.confirm) & (seen >= rules.hits)
    stale = (tentative.evidence < -rules.drop) | (tentative.age > 2 * rules.scans)
    begun = np.arange(state.next_id, state.next_id + int(ripe.sum()))
    if begun.size:
        K = len(state.window.times)
        fresh = fresh_tracks(
            begun, K, (tentative.mean[ripe], tentative.cov[ripe], tentative.probs[ripe]),
            np.full(begun.size, scan.time),
        )  # fmt: skip
        state = state._replace(tracks=join(state.tracks, fresh), next_id=state.next_id + begun.size)
    kept = _some(tentative, ~ripe & ~stale)
    kept = _begin(estimator, kept, sensor, scan, free)
    if len(kept.age) > rules.most:
        best = np.sort(np.argsort(-kept.evidence, kind="stable")[: rules.most])
        kept = _some(kept, best)
    return state._replace(tentative=kept), ended, begun


def _spare(newest: Newest, hits: Array, detections: int, exclusive: bool) -> Ints:
    """Detections that no track needs.

    Where a target gives one at most, each track that was seen takes one, the surest first: of three detections that two
    close tracks share one is spare, though each is probably somebody's.
    """
    if not exclusive:
        return np.flatnonzero(np.bincount(newest.detection, newest.weight, minlength=detections) < 0.5)
    order = np.argsort(-newest.weight, kind="stable")
    order = order[(newest.weight[order] > 0.05) & (hits[newest.target[order]] > 0.5)]
    return np.flatnonzero(~assign_in_order(order, newest.target, newest.detection, len(hits), detections)[1])


def _end(
    estimator: Pmht, state: PmhtState, scan: Scan, values: Array, ahead: tuple[Array, ...]
) -> tuple[PmhtState, Ints]:
    """Tracks whose evidence fell too far, that were silent too long, or that follow an older one."""
    rules, tracks = estimator.initiation, state.tracks
    if rules is None or not len(tracks.ids):
        return state, tracks.ids[:0]
    sensor = state.sensors[scan.sensor]
    noise = state.window.noise[-1]
    score, *_ = score_newest(
        estimator.moving, state.sensing, scan.sensor, scan.sensor_state, noise, values, ahead[3], ahead[4],
        np.ascontiguousarray(tracks.detected[:, -1]), sensor.density, estimator.gate_of(sensor),
    )  # fmt: skip
    doubt = np.maximum(tracks.doubt - score, 0.0)
    since = np.where(tracks.hits[:, -1] > 0.5, scan.time, tracks.since)
    twin = np.where(_on_top(estimator, tracks), tracks.twin + 1, 0)
    tracks = tracks._replace(doubt=doubt, since=since, twin=twin)
    gone = (doubt > rules.delete) | (scan.time - since > rules.patience) | (twin >= rules.merge_scans)
    ended = tracks.ids[gone]
    return state._replace(tracks=keep(tracks, ~gone)), ended


def _on_top(estimator: Pmht, tracks: TrackSet) -> NDArray[np.bool_]:
    """Which tracks sit on an older one, position and velocity alike, and share one target's detections with it."""
    M = len(tracks.ids)
    twin = np.zeros(M, dtype=bool)
    if M < 2:
        return twin
    mean, cov = kinematic_moments(
        estimator.moving, np.ascontiguousarray(tracks.means[:, -1]), np.ascontiguousarray(tracks.covs[:, -1])
    )
    A, separation = mean.shape[1] // 2, estimator.initiation.separation if estimator.initiation else 0.0
    reach = max(3.0 * np.sqrt(np.max(np.trace(cov[:, :A, :A], axis1=1, axis2=2))), separation)
    if not np.isfinite(mean).all() or not np.isfinite(reach):
        return twin
    for i, j in cKDTree(mean[:, :A]).query_pairs(float(reach)):
        off = mean[i] - mean[j]
        distance = off @ np.linalg.pinv(cov[i] + cov[j]) @ off
        expected = np.maximum(tracks.detected[i], tracks.detected[j]).sum()
        together = tracks.hits[i].sum() + tracks.hits[j].sum()
        alike = off[A:] @ np.linalg.pinv((cov[i] + cov[j])[A:, A:]) @ off[A:] < 2 * A
        beside = alike and np.linalg.norm(off[:A]) < separation
        if beside or (distance < 2 * A and together < 1.4 * max(expected, 1e-9)):
            twin[i if tracks.ids[i] > tracks.ids[j] else j] = True
    return twin


def _extend(estimator: Pmht, state: PmhtState, scan: Scan, values: Array, free: Ints) -> tuple[Tentative, Ints]:
    """Tentative tracks after the scan, each with at most one of the free detections; and what remains free."""
    tentative = state.tentative
    U = len(tentative.age)
    if not U:
        return tentative, free
    dt = scan.time - state_time(state)
    chain = estimator._chain_at(dt)
    ahead = foresee(estimator.moving, chain, dt, tentative.mean, tentative.cov, tentative.probs)
    jm, jP, probs, mean, cov = ahead
    sensor = state.sensors[scan.sensor]
    detected = estimator._in_view(sensor, scan, mean)
    noise = state.window.noise[-1]
    gate = min(estimator.gate_of(sensor), 25.0)
    _, begins, pairs, likelihood = score_newest(
        estimator.moving, state.sensing, scan.sensor, scan.sensor_state, noise,
        np.ascontiguousarray(values[free]), mean, cov, detected, sensor.density, gate,
    )  # fmt: skip
    target = np.repeat(np.arange(U), np.diff(begins))
    evidence = np.log(np.maximum(1.0 - detected, 1e-12))
    # The more evidence a tentative track has, the earlier it chooses: a new one may not starve it.
    order = np.lexsort((-likelihood, -tentative.evidence[target]))
    taken, used = assign_in_order(order[likelihood[order] > 0.0], target, pairs, U, len(free))
    some = taken >= 0
    choice = np.where(some, pairs[taken] if len(pairs) else -1, -1)
    best = likelihood[taken[some]]
    ratio = best / np.maximum(np.maximum(sensor.density, 1e-6 * best), 1e-300)
    evidence[some] = np.log(1.0 - detected[some] + ratio)
    watched = detected > 0
    last = absorb(
        estimator.moving, state.sensing, scan.sensor, scan.sensor_state, noise, np.ascontiguousarray(values[free]),
        choice, jm, jP, probs,
    )  # fmt: skip
    extended = Tentative(
        last[0],
        last[1],
        last[2],
        tentative.evidence + np.where(watched, evidence, 0.0),
        np.where(watched, ((tentative.history << 1) | (choice >= 0)) & ((1 << 60) - 1), tentative.history),
        tentative.age + watched,
    )
    return extended, free[~used]


def _begin(estimator: Pmht, tentative: Tentative, sensor: ScanSensor, scan: Scan, free: Ints) -> Tentative:
    """New tentative tracks at the free detections that locate a target."""
    rules = estimator.initiation
    if rules is None or not free.size:
        return tentative
    mean, cov = place_detections(sensor, scan, scan.detections[free], rules.speed)
    first = estimator.modes[0]
    state_mean, state_cov = state_moments(first, mean, cov)
    J, count = len(estimator.modes), len(mean)
    if not count:
        return tentative
    new = Tentative(
        np.repeat(state_mean[:, None], J, axis=1),
        np.repeat(state_cov[:, None], J, axis=1),
        np.tile(estimator._long_run, (count, 1)),
        np.zeros(count),
        np.ones(count, dtype=np.int64),
        np.ones(count, dtype=np.int64),
    )
    joined: list[Any] = [np.concatenate(parts) for parts in zip(tentative, new, strict=True)]
    return Tentative(*joined)


def state_time(state: PmhtState) -> float:
    """Time of the scan before the newest."""
    times = state.window.times
    return float(times[-2]) if len(times) > 1 else state.window.origin
