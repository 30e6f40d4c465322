"""What a recording says for itself: which truth it has, how good its sensor is, which intents are labelled."""

from __future__ import annotations

import numpy as np

from jink.envs.reading.recorded_rows import TruthRows, residual_sigma
from jink.envs.sensing import Sensing
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import make_sensor, position
from jink.estimators.tracks import Tracks

__all__ = ["TRUTHS", "choose_sensor", "choose_truth", "intent_names"]

TRUTHS = ("auto", "recorded", "measured", "smoothed")
WITH_AXES = ("position", "range", "range-rate", "range-range-rate")
"""Kinds of sensors that exist in the plane and in space."""


def choose_truth(tracks: Tracks, kind: str, noise: str) -> str:
    """The kind of truth, "auto" decided.

    Raises:
        ValueError: a kind that the tracks do not have, or that would leave no error to estimate.
    """
    measured = tracks.sensor == "position"
    if tracks.axes not in (2, 3):
        raise ValueError(f"RecordedSource: tracks must have 2 or 3 axes; got {tracks.axes}. Read them with axes=2.")
    own = tracks.truth is not None and bool(np.isfinite(tracks.truth).any())
    if kind == "auto":
        kind = "recorded" if own else "measured" if measured and noise == "simulated" else "smoothed"
    for name, good, why in (
        ("recorded", own, "tracks without true positions"),
        ("measured", measured, f"{tracks.sensor} measurements, which are no positions"),
        ("measured", noise == "simulated", "noise='recorded', which would then have no error at all"),
    ):
        if kind == name and not good:
            raise ValueError(f"RecordedSource: truth must not be {kind!r}; got {why}. Use truth='smoothed'.")
    return kind


def choose_sensor(
    tracks: Tracks,
    noise: str,
    sigma: float | tuple[float, ...] | None,
    sensing: Sensing | None,
    rows: TruthRows | None = None,
) -> Sensor:
    """The sensor with the noise a filter is told.

    Args:
        tracks: recorded.
        noise: "recorded" or "simulated".
        sigma: given by the user; None: from the file's sigmas, or the errors in ``rows``.
        sensing: simulated; None: positions with ``sigma``.
        rows: with a recorded truth, if there is one.
    Returns:
        the sensor.
    Raises:
        ValueError: nothing says how good the sensor is, or a simulated one does not fit the tracks.
    """
    if noise == "simulated" and sensing is not None:
        if sensing.sensor.axes != tracks.axes or sensing.latency:
            raise ValueError(
                f"RecordedSource: sensing must have {tracks.axes} axes, as the tracks, and no latency; got "
                f"{sensing.sensor.axes} axes and {sensing.latency:g} s. Change the sensing."
            )
        return sensing.sensor
    if noise == "simulated" and sigma is not None:
        return position(tracks.axes, sigma)
    options = {"axes": tracks.axes} if tracks.sensor in WITH_AXES else {}
    if sigma is None and tracks.noise is not None:
        seen = np.isfinite(tracks.measurements).all(axis=-1)
        sigma = tuple(np.sqrt(np.median(np.diagonal(tracks.noise[seen], axis1=-2, axis2=-1), axis=0)).tolist())
    if sigma is None and rows is not None:
        sigma = tuple(residual_sigma(rows, make_sensor(tracks.sensor, **options)).tolist())
    if sigma is None:
        raise ValueError(
            f"RecordedSource: sigma must be given for {tracks.source or 'tracks'} with neither sigmas nor a recorded "
            "truth to compare with; got None. Use sigma=VALUE, or noise='simulated' with it."
        )
    return make_sensor(tracks.sensor, **options, sigma=sigma)


def intent_names(tracks: Tracks) -> tuple[str, ...]:
    """Labels of the recording in alphabetical order, "unlabelled" for empty ones, or one name for all.

    Raises:
        ValueError: more labels than an episode can number.
    """
    if tracks.intents is None:
        return ("recorded",)
    labels = np.unique(np.where(tracks.intents == "", "unlabelled", tracks.intents)[tracks.used])
    if len(labels) > 127:
        raise ValueError(
            f"RecordedSource: intents must be at most 127 different labels; got {len(labels)}. Merge some of them."
        )
    return tuple(str(label) for label in labels)
