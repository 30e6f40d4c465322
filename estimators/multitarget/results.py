"""What a multi-target estimator reports: tracks at each scan, smoothed afterwards, and where every detection went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.estimators.compiled import call_kinematics, entry_kernel
from jink.estimators.multitarget.tracked import TrackSet, Window

if TYPE_CHECKING:
    from jink.estimators.multitarget.scans import Scans
    from jink.estimators.multitarget.tables import Moving

__all__ = ["Fit", "Found", "MultiTracks", "Newest", "Outcome", "gather", "kinematic_moments"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
AXES = "xyz"


class Newest(NamedTuple):
    """Association of the newest scan: P candidate pairs."""

    target: Ints  # row of the track set; (P,)
    detection: Ints  # (P,)
    weight: Array  # probability that the detection is of the target; (P,)


class Fit(NamedTuple):
    """Result of `fit_window`, in its order."""

    objective: Array
    begins: Ints
    pairs: Ints
    weight: Array
    hits: Array
    seen: Array
    ahead_mean: Array
    ahead_cov: Array
    ahead_probs: Array
    filtered_mean: Array
    filtered_cov: Array
    last_mean: Array
    last_cov: Array
    last_probs: Array
    mass: Array
    pull: Array
    H: Array
    counts: Ints

    def apply(self, tracks: TrackSet) -> TrackSet:
        """The tracks after the fit; their paths were smoothed in place."""
        return tracks._replace(
            ahead_mean=self.ahead_mean,
            ahead_cov=self.ahead_cov,
            ahead_probs=self.ahead_probs,
            last_mean=self.last_mean,
            last_cov=self.last_cov,
            last_probs=self.last_probs,
            hits=self.hits,
        )

    def newest(self, window: Window) -> Newest:
        """Association of the last scan of the window."""
        M, K = self.hits.shape
        begins = self.begins[(K - 1) * M :]
        target = np.repeat(np.arange(M), np.diff(begins))
        which = slice(begins[0], begins[-1])
        return Newest(target, self.pairs[which] - window.offsets[-2], self.weight[which])


class Outcome(NamedTuple):
    """M tracks at one scan: position then velocity."""

    ids: Ints  # (M,)
    mean: Array  # (M, 2 A)
    cov: Array  # (M, 2 A, 2 A)
    hits: Array  # (M,)
    mode_probs: Array  # (M, J)

    @classmethod
    def of(cls, moving: Moving, tracks: TrackSet, k: int, modes: object = None) -> Outcome:
        """Tracks that scan ``k`` of the window knows; those confirmed at the last scan count as of it."""
        K = tracks.means.shape[1]
        there = tracks.begin <= k
        mean, cov, hits, probs = tracks.means[:, k], tracks.covs[:, k], tracks.hits[:, k], tracks.ahead_probs[:, k]
        new = tracks.begin == K
        if k == K - 1 and new.any():
            there = there | new
            fresh = (tracks.last_probs[:, :, None] * tracks.last_mean).sum(axis=1)
            off = tracks.last_mean - fresh[:, None]
            spread = tracks.last_cov + off[..., :, None] * off[..., None, :]
            merged = (tracks.last_probs[:, :, None, None] * spread).sum(axis=1)
            mean, cov = np.where(new[:, None], fresh, mean), np.where(new[:, None, None], merged, cov)
            hits, probs = np.where(new, 1.0, hits), tracks.last_probs
        elif k == K - 1:
            probs = tracks.last_probs
        kin_mean, kin_cov = kinematic_moments(moving, mean[there], cov[there])
        return cls(tracks.ids[there], kin_mean, kin_cov, hits[there], probs[there])


class Found(NamedTuple):
    """What one step gives."""

    time: float
    now: Outcome  # tracks at this scan, from the scans so far
    retired: Outcome | None  # the scan that left the window, smoothed
    ended: Ints  # ids of tracks deleted at this scan
    begun: Ints  # ids of tracks confirmed at this scan
    newest: Newest  # association of this scan among the tracks there were before it
    counts: Ints  # EM iterations, unexplained detections of the window, failed updates
    objective: Array  # of each EM iterate


class MultiTracks(NamedTuple):
    """Tracks over all scans: one row per track and scan, R rows, in order of scan; K scans."""

    scan: Ints  # (R,)
    id: Ints  # (R,)
    time: Array  # (R,)
    mean: Array  # position then velocity from the scans so far; (R, 2 A)
    cov: Array  # (R, 2 A, 2 A)
    smoothed_mean: Array  # the same with the scans that followed within the window; (R, 2 A)
    smoothed_cov: Array  # (R, 2 A, 2 A)
    hits: Array  # expected number of detections of the track in the scan; (R,)
    mode_probs: Array  # (R, J)
    times: Array  # of all scans; (K,)
    counts: Ints  # per scan: EM iterations, unexplained detections, failed updates; (K, 3)

    def sets(self, smoothed: bool = False) -> tuple[Ints, Array]:
        """Tracks as sets for GOSPA: ids (M,), positions (M, K, A), NaN where a track is not there."""
        ids, row = np.unique(self.id, return_inverse=True)
        A = self.mean.shape[1] // 2
        out = np.full((len(ids), len(self.times), A), np.nan)
        out[row, self.scan] = (self.smoothed_mean if smoothed else self.mean)[:, :A]
        return ids, out

    def to_frame(self, smoothed: bool = False) -> pd.DataFrame:
        """A table: scan, t, track, x, y[, z], vx, ..., sigma_x, ..., hits."""
        mean, cov = (self.smoothed_mean, self.smoothed_cov) if smoothed else (self.mean, self.cov)
        A = mean.shape[1] // 2
        sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
        table: dict[str, object] = {"scan": self.scan, "t": self.time, "track": self.id}
        table |= {AXES[a]: mean[:, a] for a in range(A)} | {f"v{AXES[a]}": mean[:, A + a] for a in range(A)}
        table |= {f"sigma_{AXES[a]}": sigma[:, a] for a in range(A)}
        return pd.DataFrame(table | {"hits": self.hits})


def gather(found: Sequence[Found], rest: Sequence[Outcome] | None, scans: Scans) -> MultiTracks:
    """Rows of all steps; ``rest`` are the scans still in the window at the end, smoothed."""
    K, A2 = len(found), 2 * scans.axes
    late = [one.retired for one in found if one.retired is not None] + list(rest or [])
    J = found[0].now.mode_probs.shape[1] if found else 1
    if not sum(len(one.now.ids) for one in found):
        none = np.zeros(0, dtype=np.int64)
        moments = np.zeros((0, A2)), np.zeros((0, A2, A2))
        counts = np.array([one.counts for one in found], dtype=np.int64).reshape(-1, 3)
        return MultiTracks(
            none, none, np.zeros(0), *moments, *moments, np.zeros(0), np.zeros((0, J)), scans.times, counts
        )  # fmt: skip
    scan = np.repeat(np.arange(K), [len(one.now.ids) for one in found])
    parts = [np.concatenate([getattr(one.now, name) for one in found]) for name in Outcome._fields]
    ids, mean, cov, hits, probs = parts
    smoothed_mean, smoothed_cov = mean.copy(), cov.copy()
    starts = np.concatenate([[0], np.cumsum([len(one.now.ids) for one in found])])
    for k, one in enumerate(late):
        own = ids[starts[k] : starts[k + 1]]
        place = {int(name): row for row, name in enumerate(own)}
        for row, name in enumerate(one.ids):
            if int(name) in place:
                smoothed_mean[starts[k] + place[int(name)]] = one.mean[row]
                smoothed_cov[starts[k] + place[int(name)]] = one.cov[row]
    counts = np.array([one.counts for one in found], dtype=np.int64)
    return MultiTracks(
        scan, ids, scans.times[scan], mean, cov, smoothed_mean, smoothed_cov, hits, probs, scans.times, counts
    )  # fmt: skip


def kinematic_moments(moving: Moving, means: Array, covs: Array) -> tuple[Array, Array]:
    """Position and velocity of states (M, n), (M, n, n): (M, 2 A), (M, 2 A, 2 A); linearised where not components."""
    if moving.kinematics[0] == 0:
        index = np.asarray(moving.index)
        return means[:, index], covs[:, index[:, None], index]
    found: tuple[Array, Array] = _linearised(moving, np.ascontiguousarray(means), np.ascontiguousarray(covs))
    return found


@entry_kernel
def _linearised(moving, means, covs):  # type: ignore[no-untyped-def]
    M, n = means.shape
    width = moving.index.size
    out, spread, slope = np.zeros((M, width)), np.zeros((M, width, width)), np.zeros((width, n))
    above, below, x = np.zeros(width), np.zeros(width), np.zeros(n)
    address, params = moving.kinematics[0], moving.params[0, : moving.counts[0]]
    for m in range(M):
        x[:] = means[m]
        call_kinematics(address, x, params, out[m])
        for c in range(n):
            step = 1e-5 * (1.0 + abs(means[m, c]))
            x[c] = means[m, c] + step
            call_kinematics(address, x, params, above)
            x[c] = means[m, c] - step
            call_kinematics(address, x, params, below)
            x[c] = means[m, c]
            for a in range(width):
                slope[a, c] = (above[a] - below[a]) / (2.0 * step)
        for a in range(width):
            for b in range(width):
                total = 0.0
                for c in range(n):
                    for e in range(n):
                        total += slope[a, c] * covs[m, c, e] * slope[b, e]
                spread[m, a, b] = total
    return out, spread
