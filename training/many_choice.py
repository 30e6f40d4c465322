"""Numbers of a run with many targets: given, from the file, estimated from it, or a default."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jink.envs.reading.graph_file import NetworkPlan
from jink.estimators.multitarget.scans import Scans
from jink.estimators.tracks import Tracks
from jink.training.console import progress
from jink.training.many_estimators import NETWORKED, ManyScales
from jink.training.many_scans import group_rows, guess, patience_of, sensors_of, with_numbers
from jink.training.options import parse_sigma
from jink.training.track import Parameter, TrackRequest
from jink.training.tuning import sensor_of

__all__ = ["choose_many"]


def choose_many(
    request: TrackRequest, tracks: Tracks, plan: NetworkPlan | None
) -> tuple[Scans, ManyScales, tuple[Parameter, ...]]:
    """Sensors, scans and scales.

    Args:
        request: what was asked for.
        tracks: rows of the file, as one track.
        plan: network; None: everything at one place.

    Returns:
        scans with sensors, what a tracker is told, and the same for print.

    Raises:
        ValueError: no standard deviation, or a sensor without a node.
    """
    plain = sensor_of(tracks)
    sigma = None if request.sigma is None else parse_sigma(request.sigma, plain, request.degrees)
    use_noise = sigma is None and tracks.noise is not None
    if sigma is None and tracks.noise is None:
        wanted = ",".join(f"sigma_{label.replace(' ', '_')}" for label in plain.labels)
        raise ValueError(
            f"--sigma: value must be given where the file has no columns {wanted}; got none. Give the standard "
            "deviation of a detection, for example --sigma 15."
        )
    if sigma is None:
        whole = np.isfinite(tracks.measurements[0]).all(axis=1)
        noise = tracks.noise[0][whole] if tracks.noise is not None and whole.any() else np.eye(plain.size)[None]
        sigma = tuple(np.sqrt(np.diagonal(np.mean(noise, axis=0))))
    ids = tracks.sensor_ids
    names = [""] if ids is None else sorted({str(name) for name in ids[0]})
    node_of = None
    if plan is not None:
        missing = [name for name in names if name not in plan.sensors]
        if missing:
            raise ValueError(
                f"--network: sensors must name every sensor of the scans; got no {', '.join(missing) or 'sensor'} "
                f"among {', '.join(plan.sensors)}. Add where it stands."
            )
        node_of = plan, tuple(plan.sensors[name] for name in names)
    scans = group_rows(tracks, sensors_of(tracks, sigma, names), use_noise)
    patience, networked = patience_of(scans), request.estimator in NETWORKED
    scales = ManyScales(
        tracks.axes, 1.0, 1.0, request.turn_rate, request.sojourn or 10.0, request.window or (5 if networked else 10),
        request.gate_size or 5.0, patience, node_of,
    )  # fmt: skip
    if request.turn_rate is not None and tracks.axes != 2:
        raise ValueError(f"--turn-rate: option must come with two axes; got {tracks.axes}. Leave it out, or --axes 2.")
    with progress("choosing clutter and speed from the file"):
        told = guess(scans, request.speed, request.acceleration, scales)
    detection = told.detection if request.detection is None else (request.detection,) * len(names)
    clutter = told.clutter if request.clutter is None else (request.clutter,) * len(names)
    found = [
        Parameter(f"sigma_{label.replace(' ', '_')}", value, unit, "file" if use_noise else "given")
        for label, value, unit in zip(plain.labels, sigma, plain.units, strict=True)
    ]
    for s, name in enumerate(names):
        of = f" of {name or 'the sensor without a name'}" if len(names) > 1 or name else ""
        found.append(Parameter(f"detection{of}", detection[s], "", "tuned" if request.detection is None else "given"))
        found.append(Parameter(f"clutter{of}", clutter[s], "per scan", "tuned" if request.clutter is None else "given"))
    for key, value, unit, origin in (
        ("speed", told.speed, "m/s", "tuned"), ("acceleration", told.acceleration, "m/s^2", "default"),
        ("gate_size", scales.gate, "sd", "default"), ("window", float(scales.window), "scans", "default"),
        ("turn_rate", request.turn_rate, "rad/s", "none"), ("patience", patience, "s", "interval"),
        ("dismissal", scales.dismissal if networked else None, "s", "interval"),
    ):  # fmt: skip
        given = getattr(request, key, None) is not None
        if value is not None and not (key == "window" and request.estimator in ("gnn", "jpda")):
            found.append(Parameter(key, value, unit, "given" if given else origin))
    scales = replace(scales, speed=told.speed, acceleration=told.acceleration)
    return with_numbers(scans, detection, clutter), scales, tuple(found)
