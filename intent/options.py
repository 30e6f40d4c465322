"""What a learner is told to do, checked before anything begins."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from jink.intent.trainer import Settings

__all__ = ["check_options"]

_LEAST = {"most": 1, "rivals": 1, "threads": 1}
_ELSEWHERE = {"intents", "seconds", "seed", "device"}


def check_options(
    axes: object,
    intents: object,
    seconds: object,
    seed: object,
    noise_sd: object,
    device: object,
    work: Mapping[str, object],
) -> None:
    """Refuse options of `IntentLearner` that nothing can be learned with.

    Raises:
        ValueError: which one, what it must be, what it is.
    """
    if axes not in (2, 3) or isinstance(axes, bool):
        _refuse("axes", "2 or 3", axes, "Use 2 for the plane, 3 for space.")
    if intents is not None and not (_whole(intents) and 1 <= intents <= 7):  # type: ignore[operator]
        _refuse("intents", "an integer 1 to 7 or None", intents, "Try None.")
    if seconds is not None and not _positive(seconds):
        _refuse("seconds", "> 0 and finite", seconds, "Leave it out.")
    if not (_whole(seed) and 0 <= seed < 2**63):  # type: ignore[operator]
        _refuse("seed", "an integer >= 0 and below 2^63", seed, "Use 0.")
    if isinstance(noise_sd, str) and noise_sd != "learn":
        _refuse("noise_sd", "metres, 'learn' or None", noise_sd, "Use 'learn'.")
    if noise_sd is not None and not isinstance(noise_sd, str) and not _positive(noise_sd):
        _refuse("noise_sd", "one number > 0 m and finite", noise_sd, "Use 'learn'.")
    if not isinstance(device, str):  # which there are: `check_device`
        _refuse("device", "cpu or cuda", device, "Leave it out.")
    known = {field.name for field in dataclasses.fields(Settings)} - _ELSEWHERE
    if set(work) - known:
        unknown = ", ".join(sorted(set(work) - known))
        raise ValueError(f"IntentLearner: work must name {', '.join(sorted(known))}; got {unknown}. See Settings.")
    for name, value in work.items():
        least = _LEAST.get(name, 0)
        if not (_whole(value) and value >= least):  # type: ignore[operator]
            _refuse(name, f"an integer >= {least}", value, "See Settings.")


def _refuse(name: str, wanted: str, found: object, remedy: str) -> None:
    raise ValueError(f"IntentLearner: {name} must be {wanted}; got {found!r}. {remedy}")


def _whole(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _positive(value: object) -> bool:
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return real and 0.0 < float(value) < math.inf  # type: ignore[arg-type]
