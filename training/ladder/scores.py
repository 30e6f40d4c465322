"""What one run of one estimator is worth: numbers per run, from truth, estimates and forecasts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.stats import chi2

from jink.envs.episodes import Episodes
from jink.estimators.api import Estimates
from jink.estimators.metrics import nees
from jink.estimators.status import DIVERGED, REPAIRED

__all__ = ["HORIZON_S", "LOST_AFTER", "LOST_STEPS", "METRICS", "Metric", "Readings", "score_runs", "surging"]

Floats = NDArray[np.float64]
HORIZON_S = 1.0
"""How far ahead predictions are judged; s."""
LOST_AFTER, LOST_STEPS = 100.0, 10
"""A track is lost when its error exceeds so many sigma of the nominal noise at so many samples in a row, as in
`jink/ManoeuvringTarget-v0`."""
_PEAK_S = 3.0
_LOUD = 1.5  # a sample surges where its noise covariance is above this multiple of the nominal one


class Metric(NamedTuple):
    """Unit, how runs become one number (``rms`` or ``mean``), and what it is."""

    unit: str
    statistic: str
    line: str


METRICS: dict[str, Metric] = {
    "position_rmse": Metric("m", "rms", "root mean square position error over the samples of a run"),
    "velocity_rmse": Metric("m/s", "rms", "the same of velocity"),
    "prediction_rmse": Metric("m", "rms", f"position error of predictions {HORIZON_S:g} s ahead"),
    "peak_after_switch": Metric("m", "mean", f"largest error within {_PEAK_S:g} s of a switch, mean over switches"),
    "peak_in_surge": Metric("m", "mean", "largest error while the noise surges, mean over surges"),
    "jitter": Metric("m", "rms", "change of the position error from one sample to the next"),
    "nees": Metric("", "mean", "squared error of position and velocity over their covariance; 2 x axes if consistent"),
    "nees_inside": Metric("", "mean", "share of samples whose NEES lies in its 95 % band"),
    "nis": Metric("", "mean", "squared innovation over its covariance, per component; 1 if consistent"),
    "nis_inside": Metric("", "mean", "share of samples whose NIS lies in its 95 % band"),
    "intent_accuracy": Metric(
        "", "mean", "share of samples at which the true intent is more probable than any other; ties are wrong"
    ),
    "intent_delay": Metric(
        "s", "mean", "time from a switch until the new intent is more probable than any other; at most its stay"
    ),
    "surge_accuracy": Metric("", "mean", "share of samples judged rightly as surging or not"),
    "lost": Metric("", "mean", f"runs with an error above {LOST_AFTER:g} sigma at {LOST_STEPS} samples in a row"),
    "diverged": Metric("", "mean", "share of steps that the estimator itself calls diverged"),
    "repaired": Metric("", "mean", "share of steps at which it had to repair a covariance"),
}
"""Numbers of a run, in the order of the table."""


class Readings(NamedTuple):
    """What an estimator says besides its estimates; None where it says nothing of the kind."""

    forecast: Floats | None = None  # (B, T, A) position `HORIZON_S` ahead
    intents: Floats | None = None  # (B, T, I) probability of each true intent; NaN column: an intent it does not know
    alike: tuple[int, ...] = ()  # (I,) equal where it has one word for several true intents; empty: one for each
    surge: Floats | None = None  # (B, T) probability that the noise surges
    foreign: Floats | None = None  # (B, T) largest probability of an intent of its own that the target does not have


def surging(episodes: Episodes) -> NDArray[np.bool_]:
    """Samples whose noise is above nominal; (B, T)."""
    return episodes.scale > _LOUD


def score_runs(episodes: Episodes, found: Estimates, said: Readings) -> dict[str, Floats]:
    """Numbers of `METRICS` for each run; (B,), NaN where a run has none (no switch, no surge, nothing said).

    Args:
        episodes: B runs.
        found: estimates of them; a covariance of NaN says nothing about consistency.
        said: see `Readings`.
    """
    truth = episodes.truth
    error = _distance(found.position, truth.position)
    dof = np.asarray(found.nis_dof)
    values = {
        "position_rmse": _root(error**2),
        "velocity_rmse": _root(_distance(found.velocity, truth.velocity) ** 2),
        "peak_after_switch": _peaks(error, _after_switches(episodes)),
        "peak_in_surge": _peaks(error, [_spans(row) for row in surging(episodes)]),
        "jitter": _root(np.sum(np.diff(found.position - truth.position, axis=1) ** 2, axis=2)),
        "lost": _lost(error, float(np.sqrt(np.linalg.eigvalsh(episodes.nominal_noise)[-1]))),
        "diverged": np.mean(np.asarray(found.status) == DIVERGED, axis=1),
        "repaired": np.mean(np.asarray(found.status) == REPAIRED, axis=1),
    }
    values["prediction_rmse"] = _prediction(episodes, said.forecast)
    known = np.isfinite(found.covariance).all(axis=(1, 2, 3))
    values["nees"], values["nees_inside"] = np.full((2, len(error)), np.nan)
    if known.any():
        place, velocity, cov = (np.asarray(part)[known] for part in (found.position, found.velocity, found.covariance))
        normalised = nees(place, velocity, cov, truth.position[known], truth.velocity[known])
        low, high = chi2.ppf((0.025, 0.975), 2 * truth.position.shape[2])
        values["nees"][known] = normalised.mean(axis=1)
        values["nees_inside"][known] = ((normalised >= low) & (normalised <= high)).mean(axis=1)
    used = dof > 0
    low, high = (chi2.ppf(tail, np.maximum(dof, 1)) for tail in (0.025, 0.975))
    inside = used & (found.nis >= low) & (found.nis <= high)
    values["nis"] = _over(np.where(used, found.nis, 0.0).sum(axis=1), dof.sum(axis=1))
    values["nis_inside"] = _over(inside.sum(axis=1), used.sum(axis=1))
    values["intent_accuracy"], values["intent_delay"] = _intents(episodes, said)
    right = None if said.surge is None else (said.surge > 0.5) == surging(episodes)
    values["surge_accuracy"] = np.full(len(error), np.nan) if right is None else right.mean(axis=1)
    return {name: np.asarray(values[name], dtype=np.float64) for name in METRICS}


def _distance(estimate: Floats, truth: Floats) -> Floats:
    error = np.sqrt(np.sum((np.asarray(estimate) - truth) ** 2, axis=2))
    return np.where(np.isfinite(error), error, np.inf)


def _root(squares: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean(squares, axis=1)))


def _over(top: Floats, bottom: Floats) -> Floats:
    return np.divide(top, bottom, out=np.full(len(top), np.nan), where=np.asarray(bottom) > 0)


def _spans(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one after last index of each stretch of True."""
    change = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(change[::2].tolist(), change[1::2].tolist(), strict=True))


def _after_switches(episodes: Episodes) -> list[list[tuple[int, int]]]:
    """For each run, the samples within `_PEAK_S` of each switch and before the next one."""
    found = []
    for times, switches in zip(episodes.times, episodes.truth.switch_times, strict=True):
        starts = switches[np.isfinite(switches)]
        ends = np.minimum(starts + _PEAK_S, np.append(starts[1:], np.inf))
        found.append(
            list(zip(np.searchsorted(times, starts).tolist(), np.searchsorted(times, ends).tolist(), strict=True))
        )
    return found


def _peaks(error: Floats, spans: list[list[tuple[int, int]]]) -> Floats:
    """Mean over the spans of each run of the largest error in them."""
    peaks = [[row[low:high].max() for low, high in some if high > low] for row, some in zip(error, spans, strict=True)]
    return np.array([np.mean(some) if some else np.nan for some in peaks])


def _lost(error: Floats, sigma: float) -> Floats:
    far = error > LOST_AFTER * sigma
    return np.array([any(high - low >= LOST_STEPS for low, high in _spans(row)) for row in far], dtype=np.float64)


def _prediction(episodes: Episodes, forecast: Floats | None) -> Floats:
    """Truth between samples is the cubic through positions and velocities."""
    count = len(episodes.times)
    if forecast is None:
        return np.full(count, np.nan)
    found = np.full(count, np.nan)
    for b, times in enumerate(episodes.times):
        ahead = times + HORIZON_S
        rows = ahead <= times[-1]
        distinct = np.concatenate([[True], np.diff(times) > 0])
        curve = CubicHermiteSpline(
            times[distinct], episodes.truth.position[b, distinct], episodes.truth.velocity[b, distinct]
        )
        if rows.any():
            found[b] = np.sqrt(np.mean(np.sum((forecast[b, rows] - curve(ahead[rows])) ** 2, axis=1)))
    return found


def _intents(episodes: Episodes, said: Readings) -> tuple[Floats, Floats]:
    """Accuracy and delay over all samples and switches; what an estimator has no word for, it does not recognise.

    Who says the same of several intents is right with none of them, unless it has one word for them (`alike`).
    An estimator without a word for any true intent says nothing that could be judged.
    """
    count, probs = len(episodes.times), said.intents
    accuracy, delay = np.full(count, np.nan), np.full(count, np.nan)
    if probs is None or not np.isfinite(probs).any():
        return accuracy, delay
    shares = np.where(np.isfinite(probs), probs, -1.0)
    alike = np.array(said.alike or range(shares.shape[2]))
    others: NDArray[np.bool_] = alike[:, None] != alike[None, :]
    foreign = np.full(shares.shape[:2], -1.0) if said.foreign is None else said.foreign
    for b, (times, true) in enumerate(zip(episodes.times, episodes.truth.intent.astype(np.int64), strict=True)):
        rivals = np.maximum(np.where(others[true], shares[b], -1.0).max(axis=1), foreign[b])
        right: NDArray[np.bool_] = np.take_along_axis(shares[b], true[:, None], axis=1)[:, 0] > rivals
        accuracy[b] = right.mean()
        late = []
        begins = np.flatnonzero(np.diff(true)) + 1
        for begin, end in zip(begins, [*begins[1:], len(true)], strict=True):
            seen = np.flatnonzero(right[begin:end])
            late.append(times[begin + seen[0]] - times[begin] if len(seen) else times[end - 1] - times[begin])
        if late:
            delay[b] = np.mean(late)
    return accuracy, delay
