"""What a learner learns from: positions with covariances, in pieces of like length, some of them kept aside."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.located import locate, noise_sigma
from jink.intent.outliers import absurd_rows

if TYPE_CHECKING:
    from jink.intent.bank_torch import Batch

__all__ = ["Lessons", "first_spoiled", "make_lessons", "positions_of"]

Floats = NDArray[np.float64]
_PIECE = 100  # rows
_SHORTEST, _FEWEST_PIECES, _FEWEST_ROWS = 12, 4, 100
_FIT, _HELD = 48, 96  # pieces that intents are chosen by


class Lessons(NamedTuple):
    """Pieces of tracks, all of them positions; which of them structure is fitted to and which it is judged by.

    noise_sd: standard deviation per axis that is learned from here, (A,), m; None: the covariances are given.
    left_out: rows that no path leads to, missing in the pieces.
    """

    pieces: Tracks
    fit: NDArray[np.int64]
    held: NDArray[np.int64]
    noise_sd: tuple[float, ...] | None
    left_out: int = 0

    def batch(self, chosen: NDArray[np.int64] | None, speed: float, device: str = "cpu") -> Batch:
        """Some pieces, or all, as the twin takes them."""
        from jink.intent.bank_torch import make_batch

        part = self.pieces if chosen is None else self.pieces.subset(chosen)
        noise = part.noise if self.noise_sd is None else np.array(self.noise_sd)
        if noise is None:
            raise AssertionError("positions without covariance")
        return make_batch(part.measurements, part.times, noise, part.lengths, speed=speed, device=device)


def positions_of(tracks: Tracks, noise_sd: float | None = None) -> Tracks:
    """The same tracks as positions with a covariance for every row; a row that misses a component is missing.

    Raises:
        ValueError: one axis, or a sensor that does not locate a target from one row.
    """
    if tracks.axes not in (2, 3):
        raise ValueError(
            f"IntentLearner.fit: tracks must have 2 or 3 axes; got {tracks.axes}. Directions need a plane."
        )
    places, covs = locate(tracks, noise_sd)
    whole = np.isfinite(places).all(axis=2) & tracks.used & np.isfinite(covs).all(axis=(2, 3))
    whole &= (np.abs(places) < 1e12).all(axis=2)
    return replace(
        tracks,
        measurements=np.where(whole[..., None], places, np.nan),
        sensor="position",
        noise=np.where(whole[..., None, None], covs, np.eye(tracks.axes)),
        sensor_states=None,
    )


def make_lessons(tracks: Tracks, seed: int, noise_sd: float | str | None = None) -> Lessons:
    """Cut tracks into pieces and put some aside.

    Tracks longer than 150 rows are cut into pieces of about 100; where that gives fewer than eight, into shorter ones.
    Rows that no path leads to (`absurd_rows`) are missing in them.
    About half of the pieces, at most 48, are fitted while structure is chosen; others, at most 96, judge it.

    Args:
        tracks: what was measured.
        seed: of the division.
        noise_sd: m; "learn": learned with the laws; None: that of the tracks, learned if they carry none.

    Raises:
        ValueError: too little to learn from.
    """
    learn = noise_sd == "learn" or (noise_sd is None and tracks.noise is None)
    if learn and tracks.sensor != "position":
        raise ValueError(
            f"IntentLearner.fit: noise_sd must be given, or be in the tracks, for a {tracks.sensor} sensor; got "
            f"{noise_sd!r}. Noise is learned from positions."
        )
    given = None if noise_sd is None or isinstance(noise_sd, str) else float(noise_sd)
    places = positions_of(tracks, given)
    absurd = absurd_rows(places)
    if absurd.any():
        places = replace(places, measurements=np.where(absurd[..., None], np.nan, places.measurements))
    measured = (np.isfinite(places.measurements[..., 0]) & places.used).sum(axis=1)
    total = int(measured.sum())
    size = _PIECE
    while True:
        cuts = _cuts(places, size)
        if len(cuts) >= 2 * _FEWEST_PIECES or size <= 2 * _SHORTEST:
            break
        size //= 2
    if len(cuts) < _FEWEST_PIECES or total < _FEWEST_ROWS:
        raise ValueError(
            f"IntentLearner.fit: tracks must hold at least {_FEWEST_ROWS} measured rows in {_FEWEST_PIECES} pieces of "
            f"{_SHORTEST} or more; got {total} rows in {len(cuts)} such pieces of {len(tracks)} tracks. "
            "Record more, or longer, tracks."
        )
    pieces = _cut(places, cuts)
    order = np.random.default_rng([seed, 5]).permutation(len(cuts))
    half = min(_FIT, (len(cuts) + 1) // 2)
    sigma = None if not learn else tuple(noise_sigma(places if absurd.any() else tracks).tolist())
    held = np.sort(order[half : half + _HELD])
    return Lessons(pieces, np.sort(order[:half]), held, sigma, int(absurd.sum()))


def _cuts(tracks: Tracks, size: int) -> list[tuple[int, int, int]]:
    """Track, first and last row (exclusive) of every piece with enough measured rows."""
    found = []
    for b, length in enumerate(tracks.lengths.tolist()):
        parts = max(1, round(length / size)) if length > 1.5 * size else 1
        edges = np.linspace(0, length, parts + 1).astype(int)
        for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            if np.isfinite(tracks.measurements[b, low:high, 0]).sum() >= _SHORTEST:
                found.append((b, low, high))
    return found


def _cut(tracks: Tracks, cuts: list[tuple[int, int, int]]) -> Tracks:
    noise = tracks.noise
    assert noise is not None  # `positions_of` gives every row one
    ids: list[str] = []
    used: dict[str, int] = {}
    for b, low, _ in cuts:
        name = tracks.ids[b] if low == 0 else f"{tracks.ids[b]} from row {low}"
        used[name] = used.get(name, 0) + 1
        ids.append(name if used[name] == 1 else f"{name} ({used[name]})")
    return _padded(tracks, noise, cuts, ids)


def _padded(tracks: Tracks, noise: Floats, cuts: list[tuple[int, int, int]], ids: list[str]) -> Tracks:
    longest = max(high - low for _, low, high in cuts)
    count, axes = len(cuts), tracks.axes
    times = np.zeros((count, longest))
    z = np.full((count, longest, axes), np.nan)
    covs = np.broadcast_to(np.eye(axes), (count, longest, axes, axes)).copy()
    for k, (b, low, high) in enumerate(cuts):
        rows = high - low
        times[k, :rows], times[k, rows:] = tracks.times[b, low:high], tracks.times[b, high - 1]
        z[k, :rows], covs[k, :rows] = tracks.measurements[b, low:high], noise[b, low:high]
    return Tracks(
        ids=tuple(ids),
        times=times,
        measurements=z,
        sensor="position",
        lengths=np.array([high - low for _, low, high in cuts]),
        axes=axes,
        noise=covs,
        source=tracks.source,
    )


def first_spoiled(log_likelihood: Floats, measured: NDArray[np.bool_], least: float) -> NDArray[np.bool_]:
    """The first of every run of rows that lie more than ``least`` nats below the median; (B, T)."""
    if not measured.any():
        return measured
    bad = measured & (log_likelihood < float(np.median(log_likelihood[measured])) - least)
    after = np.zeros(len(bad), dtype=np.bool_)
    first = np.zeros_like(bad)
    for t in range(bad.shape[1]):
        first[:, t] = bad[:, t] & ~after
        after = np.where(measured[:, t], bad[:, t], after)
    return first
