"""The run that is played back: truth, measurements, and what each estimator believed, sample by sample."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from jink.training.report.plain import rounded

__all__ = ["playback_of"]


def playback_of(mine: pd.DataFrame, place: Callable[[str], Any]) -> dict[str, Any] | None:
    """What the player shows of a scenario.

    Args:
        mine: rows of one scenario.
        place: of an estimator in the ladder.

    Returns:
        times, truth, measured places, noise scale, intents, switches and one entry for each estimator; None where the
        rows hold no track.
    """
    tracks = mine[mine["kind"] == "track"]
    series: dict[str, dict[str, Mapping[Any, Any]]] = {}
    for row in tracks.to_dict("records"):
        series.setdefault(str(row["estimator"]), {})[str(row["metric"])] = row
    truth = series.pop("truth", None)
    if truth is None or "true_x" not in truth or "true_y" not in truth or not series:
        return None
    times = np.asarray(truth["true_x"]["at"], dtype=np.float64)
    axes = [axis for axis in "xyz" if f"true_{axis}" in truth]
    intents = [name.partition(":")[2] for name in truth if name.startswith("intent:")]
    played: dict[str, Any] = {
        "times": rounded(times, 6),
        "axes": len(axes),
        "true": [rounded(truth[f"true_{axis}"]["samples"], 6) for axis in axes],
        "measured": _measured(truth, mine),
        "scale": rounded(truth["noise_scale"]["samples"]) if "noise_scale" in truth else None,
        "intents": intents,
        "intent": _most(truth, intents),
        "switches": rounded(truth["switches"]["at"], 6) if "switches" in truth else [],
        "estimators": {},
    }
    path = np.stack([np.asarray(truth[f"true_{axis}"]["samples"], dtype=np.float64) for axis in axes])
    for name in sorted(series, key=place):
        known = series[name]
        if not all(axis in known and len(known[axis]["samples"]) == len(times) for axis in axes):
            continue
        found = np.stack([np.asarray(known[axis]["samples"], dtype=np.float64) for axis in axes])
        cov = [known[key]["samples"] for key in ("cov_x_x", "cov_x_y", "cov_y_y") if key in known]
        played["estimators"][name] = {
            "place": [rounded(row, 6) for row in found[:2]],
            "error": rounded(np.sqrt(np.sum((found - path) ** 2, axis=0))),
            "cov": [rounded(row) for row in cov] if len(cov) == 3 else None,
            "surge": rounded(known["surge_probability"]["samples"], 3) if "surge_probability" in known else None,
            "intent": _most(known, intents),
        }
    return played if played["estimators"] else None


def _most(series: Mapping[str, Mapping[Any, Any]], intents: list[str]) -> list[int | None] | None:
    """Index of the most probable intent at each sample; None where nothing is said of intents."""
    known = [index for index, name in enumerate(intents) if f"intent:{name}" in series]
    if not known:
        return None
    probs = np.stack([np.asarray(series[f"intent:{intents[i]}"]["samples"], dtype=np.float64) for i in known])
    best = np.nanargmax(np.where(np.isfinite(probs), probs, -1.0), axis=0)
    return [known[i] if np.isfinite(probs[:, k]).any() else None for k, i in enumerate(best.tolist())]


def _measured(truth: Mapping[str, Mapping[Any, Any]], mine: pd.DataFrame) -> list[list[float | None]] | None:
    """Places measured, in the plane; None where a sample alone does not locate, or the sensor is not in the origin."""
    parts = {name.removeprefix("measured_"): row["samples"] for name, row in truth.items() if "measured_" in name}
    if "x" in parts and "y" in parts:
        return [rounded(parts["x"], 6), rounded(parts["y"], 6)]
    if "range" not in parts or "bearing" not in parts or _moves(mine):
        return None
    reach, bearing = (np.asarray(parts[name], dtype=np.float64) for name in ("range", "bearing"))
    if "elevation" in parts:
        reach = reach * np.cos(np.asarray(parts["elevation"], dtype=np.float64))
    return [rounded(reach * np.cos(bearing), 6), rounded(reach * np.sin(bearing), 6)]


def _moves(mine: pd.DataFrame) -> bool:
    told = json.loads(str(mine["parameters"].iloc[0])).get("scenario")
    return not isinstance(told, dict) or bool(told.get("sensing.platform.places"))
