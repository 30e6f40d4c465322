"""Targets under track as values: the window of scans, and what is known of each target in it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.motion import Motion
from jink.estimators.multitarget.scans import Scan

__all__ = ["TrackSet", "Window", "empty_tracks", "empty_window", "keep", "state_moments", "with_scan", "without_first"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Window(NamedTuple):
    """The scans that are still being explained: K scans, N detections."""

    times: Array  # (K,)
    origin: float  # time of the scan before the first, s
    sensor: Ints  # (K,)
    places: Array  # (K, 2 A)
    noise: Array  # (K, D, D)
    detections: Array  # (N, D)
    offsets: Ints  # (K + 1,)


class TrackSet(NamedTuple):
    """M targets with J modes of n components over the K scans of a window."""

    ids: Ints  # (M,)
    begin: Ints  # first scan of each in the window, K: the next one; (M,)
    prior_mean: Array  # prediction at that scan by mode; (M, J, n)
    prior_cov: Array  # (M, J, n, n)
    prior_probs: Array  # (M, J)
    means: Array  # smoothed; (M, K, n)
    covs: Array  # (M, K, n, n)
    ahead_mean: Array  # predictions by mode at every scan; (M, K, J, n)
    ahead_cov: Array  # (M, K, J, n, n)
    ahead_probs: Array  # (M, K, J)
    last_mean: Array  # what the newest scan left behind by mode; (M, J, n)
    last_cov: Array  # (M, J, n, n)
    last_probs: Array  # (M, J)
    detected: Array  # P_D, 0: out of view; (M, K)
    hits: Array  # expected number of own detections; (M, K)
    since: Array  # when the track was confirmed, s; (M,)
    doubt: Array  # how far the evidence fell from its best, nat; (M,)
    twin: Ints  # scans in a row spent on top of an older track; (M,)


def empty_window(origin: float, axes: int, size: int) -> Window:
    """No scans yet."""
    none = np.zeros(0)
    return Window(
        none, origin, np.zeros(0, dtype=np.int64), np.zeros((0, 2 * axes)), np.zeros((0, size, size)),
        np.zeros((0, size)), np.zeros(1, dtype=np.int64),
    )  # fmt: skip


def with_scan(window: Window, scan: Scan) -> Window:
    """The window with one more scan; detections sorted by their components."""
    size = window.detections.shape[1]
    n, d = scan.detections.shape
    values, noise = np.zeros((n, size)), np.eye(size)
    values[:, :d] = scan.detections
    noise[:d, :d] = scan.noise
    return Window(
        np.concatenate([window.times, [scan.time]]),
        window.origin,
        np.concatenate([window.sensor, [scan.sensor]]),
        np.concatenate([window.places, scan.sensor_state[None]]),
        np.concatenate([window.noise, noise[None]]),
        np.concatenate([window.detections, values]),
        np.concatenate([window.offsets, window.offsets[-1:] + n]),
    )


def without_first(window: Window) -> Window:
    """The window without its oldest scan."""
    gone = int(window.offsets[1])
    return Window(
        window.times[1:],
        float(window.times[0]),
        window.sensor[1:],
        np.ascontiguousarray(window.places[1:]),
        np.ascontiguousarray(window.noise[1:]),
        np.ascontiguousarray(window.detections[gone:]),
        window.offsets[1:] - gone,
    )


def empty_tracks(scans: int, modes: int, n: int) -> TrackSet:
    """No targets, in a window of K scans."""
    none, M, K, J = np.zeros(0, dtype=np.int64), 0, scans, modes
    moments = np.zeros((M, J, n)), np.zeros((M, J, n, n)), np.zeros((M, J))
    ahead = np.zeros((M, K, J, n)), np.zeros((M, K, J, n, n)), np.zeros((M, K, J))
    path = np.zeros((M, K, n)), np.zeros((M, K, n, n))
    return TrackSet(
        none,
        none,
        *moments,
        *path,
        *ahead,
        *moments,
        np.zeros((M, K)),
        np.zeros((M, K)),
        np.zeros(M),
        np.zeros(M),
        none,
    )


def keep(tracks: TrackSet, which: NDArray[np.bool_]) -> TrackSet:
    """Some of the targets."""
    parts: list[Any] = [np.ascontiguousarray(part[which]) for part in tracks]
    return TrackSet(*parts)


def join(first: TrackSet, second: TrackSet) -> TrackSet:
    """Both sets; of the same window."""
    joined: list[Any] = [np.concatenate(parts) for parts in zip(first, second, strict=True)]
    return TrackSet(*joined)


def fresh_tracks(ids: Ints, scans: int, last: tuple[Array, Array, Array], since: Array) -> TrackSet:
    """Targets that begin at the scan after the K of the window, from what is known of them now by mode."""
    M, J, n = last[0].shape
    empty = empty_tracks(scans, J, n)
    wide: dict[str, Any] = {name: np.zeros((M, *getattr(empty, name).shape[1:])) for name in TrackSet._fields}
    return TrackSet(**wide)._replace(
        ids=ids,
        begin=np.full(M, scans, dtype=np.int64),
        last_mean=np.ascontiguousarray(last[0]),
        last_cov=np.ascontiguousarray(last[1]),
        last_probs=np.ascontiguousarray(last[2]),
        since=since,
        twin=np.zeros(M, dtype=np.int64),
    )


def state_moments(motion: Motion, mean: Array, cov: Array) -> tuple[Array, Array]:
    """State moments from those of position and velocity, own parameters from their birth prior.

    Args:
        motion: whose state.
        mean, cov: position then velocity; (M, 2 A), (M, 2 A, 2 A).

    Returns:
        (M, n), (M, n, n); linearised where positions and velocities are not components.
    """
    M, K = mean.shape
    own = [motion.labels.index(label) for label in motion.own_labels]
    joint = np.zeros((M, K + len(own), K + len(own)))
    joint[:, :K, :K] = cov
    joint[:, range(K, K + len(own)), range(K, K + len(own))] = np.square(motion.birth_sd)
    if motion.cartesian:
        index = [motion.labels.index(label) for label in motion.kinematic_labels] + own
        out_mean, out_cov = np.zeros((M, motion.size)), np.zeros((M, motion.size, motion.size))
        out_mean[:, index] = np.hstack([mean, np.broadcast_to(np.array(motion.birth_mean), (M, len(own)))])
        out_cov[:, np.array(index)[:, None], index] = joint
        return out_mean, out_cov
    if motion.assemble is None:
        raise ValueError(f"Pmht: motion must say how its state is assembled; got {motion.name}. Pass assemble=.")
    params = np.array(motion.params, dtype=np.float64)

    def assemble(kin: Array) -> Array:
        out = np.zeros(motion.size)
        motion.assemble(np.ascontiguousarray(kin[:K]), np.ascontiguousarray(kin[K:]), params, out)  # type: ignore[misc]
        return out

    means, covs = [], []
    for m in range(M):
        centre = np.concatenate([mean[m], motion.birth_mean])
        steps = 1e-4 * (1e-3 + np.abs(centre))
        slopes = [
            (assemble(centre + step * unit) - assemble(centre - step * unit)) / (2 * step)
            for step, unit in zip(steps, np.eye(len(centre)), strict=True)
        ]
        J = np.stack(slopes, axis=1)
        means.append(assemble(centre))
        covs.append(J @ joint[m] @ J.T)
    return np.array(means).reshape(M, motion.size), np.array(covs).reshape(M, motion.size, motion.size)
