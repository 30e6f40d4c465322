"""What a careful reader would ask about a file before believing the numbers: units, clock, unused options, outliers."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from jink.estimators.tracks import Tracks

if TYPE_CHECKING:
    from jink.training.track import TrackRequest

__all__ = ["doubts_about", "nis_verdict", "outlier_hint"]

_LONG_INTERVAL_S, _MILLISECONDS = 1e6, 1e11
_LATITUDE, _LONGITUDE = 90.0, 180.0
_EXCESS, _SHARE = 1.25, 0.9
_FAR = 3.0
_FLAT = 0.1


def doubts_about(request: TrackRequest, tracks: Tracks, interval: float) -> tuple[str, ...]:
    """One sentence per thing that is probably not meant.

    Args:
        request: what was asked for.
        tracks: what was read.
        interval: median time between rows; s.

    Returns:
        the sentences; none where nothing is odd.
    """
    found = [
        f"{option} is ignored: {tracks.source} has no {what}"
        for option, given, what in (
            ("--degrees", request.degrees and tracks.sensor == "position", "angles to read in degrees"),
            ("--compass", request.compass and "bearing" not in tracks.sensor, "bearings"),
        )
        if given
    ]
    if request.shown is not None and request.plot is None:
        found.append("--show is ignored without --plot")
    latest = float(np.abs(tracks.times[tracks.used]).max(initial=0.0))
    if latest > _MILLISECONDS:
        found.append(
            f"times near {latest:.3g} look like milliseconds (or less) since 1970, and seconds are assumed: "
            "divide the time column first"
        )
    elif interval > _LONG_INTERVAL_S:
        found.append(f"rows are {interval:.3g} s apart, {interval / 86400:.0f} days: is the time column in seconds?")
    if _degrees_as_metres(tracks):
        found.append(
            "x and y look like degrees, and metres are assumed: map them with --columns lat=LATITUDE,lon=LONGITUDE"
        )
    return tuple(found)


def _degrees_as_metres(tracks: Tracks) -> bool:
    """Whether x and y come from columns named like degrees and stay within the range of degrees."""
    if tracks.sensor != "position":
        return False
    columns = dict(pair.partition("=")[::2] for note in tracks.notes[:1] for pair in re.split(r"[:,] ", note))
    pattern = re.compile(r"(^|_|\b)(lat|lon|lng|long|deg)|latitude|longitude|degree|°", re.IGNORECASE)
    if not all(pattern.search(columns.get(axis, "")) for axis in ("x", "y")):
        return False
    places = np.abs(tracks.measurements[tracks.used][:, :2])
    places = places[np.isfinite(places).all(axis=1)]
    return bool(places.size) and places.max() <= _LONGITUDE and places.max(axis=0).min() <= _LATITUDE


def nis_verdict(mean: float, low: float, high: float, inside: float) -> str:
    """What the normalised innovations say about the covariances.

    A long file resolves a mean that is off by a few percent, which no one need act on: it takes a quarter more than
    one, or a tenth of the steps outside their band, to be called too sure.

    Args:
        mean: NIS per component; expected 1.
        low: lower end of its 95 % band, were the model true.
        high: upper end.
        inside: share of steps within their own 95 % band.

    Returns:
        a few words.
    """
    if low <= mean <= high:
        return "consistent"
    if mean > high:
        return "too sure of itself" if mean > _EXCESS or inside < _SHARE else "nearly consistent"
    return "cautious" if mean < 1.0 / _EXCESS else "nearly consistent"


def outlier_hint(tracks: Tracks, estimates: Any, *, gated: bool) -> str:
    """What to try where measurements lie far from what was predicted.

    Args:
        tracks: what was measured.
        estimates: `Estimates` of them.
        gated: whether --gate was given.

    Returns:
        one sentence; empty where there are few such measurements, or nothing to suggest.
    """
    dof, nis = np.asarray(estimates.nis_dof), np.asarray(estimates.nis)
    counted = tracks.used & (dof > 0)
    if not counted.any():
        return ""
    wild = int((nis[counted] > chi2.isf(1e-5, dof[counted])).sum())
    far = nis[counted].sum() / dof[counted].sum() > _FAR
    if wild <= max(2.0, 1e-3 * counted.sum()) and not far:
        return ""
    tries = [] if gated else ["--gate leaves them out"]
    if _flat_anchors(tracks):
        tries.append("seen from the target the sensors lie nearly in a plane: try --axes 2 --height METRES")
    if not tries:
        return ""
    return f"{wild} measurements lie where 1 in 100 000 should: outliers? {'; '.join(tries)}"


def _flat_anchors(tracks: Tracks) -> bool:
    """Whether ranges in three axes come from places that, seen from the target, hardly leave a plane."""
    if tracks.axes != 3 or tracks.sensor != "range" or tracks.sensor_states is None:
        return False
    places = np.unique(tracks.sensor_states[tracks.used][:, :3], axis=0)
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    typical = float(np.nanmedian(tracks.measurements[tracks.used]))
    return len(spread) < 3 or bool(spread[2] < _FLAT * max(spread[1], np.sqrt(len(places)) * typical))
