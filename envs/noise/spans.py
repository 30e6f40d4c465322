"""Lengths and levels that are fixed or random: what surges share, with their checks."""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = [
    "DwellLaw",
    "Level",
    "check_between",
    "check_dwell",
    "check_level",
    "check_positive",
    "cycles_within",
    "ends_of",
    "level_of",
]

DwellLaw = float | tuple[float, float]
"""Seconds: the mean of an exponential law, or the ends (low, high) of a uniform one."""
Level = float | tuple[float, float]
"""Factor on the noise covariance: fixed, or the ends (low, high) of a log-uniform law."""


def check_dwell(caller: str, name: str, value: DwellLaw) -> DwellLaw:
    """A mean > 0 or a range 0 < low <= high, as floats.

    Raises:
        ValueError: anything else.
    """
    return _check(caller, name, value, "s", "the mean of an exponential law", "a uniform law")


def check_level(caller: str, name: str, value: Level) -> Level:
    """A factor > 0 or a range 0 < low <= high, as floats.

    Raises:
        ValueError: anything else.
    """
    return _check(caller, name, value, "a factor on R", "a fixed factor", "a log-uniform law")


def _check(caller: str, name: str, value: object, unit: str, one: str, two: str) -> float | tuple[float, float]:
    ends = tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else (value, value)
    numbers = [float(end) for end in ends if isinstance(end, int | float) and not isinstance(end, bool)]
    fine = len(numbers) == len(ends) == 2 and all(math.isfinite(n) and n > 0 for n in numbers)
    if not fine or numbers[0] > numbers[1]:
        raise ValueError(
            f"{caller}: {name} must be > 0 or a range (low, high) with 0 < low <= high, {unit}; got {value!r}. "
            f"Give one number for {one}, two for {two}."
        )
    return numbers[0] if ends[0] is value else (numbers[0], numbers[1])


def check_positive(caller: str, name: str, value: float, unit: str) -> None:
    """Refuse a number that is not finite and > 0.

    Raises:
        ValueError: anything else.
    """
    if not _is_number(value) or not math.isfinite(value) or value <= 0:
        raise ValueError(f"{caller}: {name} must be > 0 and finite; got {value!r}. Give it in {unit}.")


def check_between(caller: str, name: str, value: float, low: float, high: float = math.inf, unit: str = "SI") -> None:
    """Refuse a number outside [low, high] or not finite.

    Raises:
        ValueError: anything else.
    """
    if not _is_number(value) or not math.isfinite(value) or not low <= value <= high:
        rule = f">= {low:g} and finite" if high == math.inf else f"in [{low:g}, {high:g}]"
        raise ValueError(f"{caller}: {name} must be {rule}; got {value!r}. Give it in {unit}.")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def cycles_within(duration: float, *dwells: DwellLaw) -> int:
    """Cycles of consecutive dwells that are enough for ``duration`` seconds.

    A uniform law has a shortest dwell. Exponential dwells of mean m end at most N times, N Poisson with mean
    ``duration / m``; ten standard deviations and twenty more leave less than 1e-12.
    """
    shortest = sum(dwell[0] for dwell in dwells if isinstance(dwell, tuple))
    bounds = [math.ceil(duration / shortest)] if shortest else []
    for dwell in dwells:
        if not isinstance(dwell, tuple):
            ends = duration / dwell
            bounds.append(math.ceil(ends + 10.0 * math.sqrt(ends) + 20.0))
    return min(bounds) + 2


def ends_of(dwell: DwellLaw) -> tuple[float, float]:
    """(low, high) of a uniform law; (mean, -1) of an exponential one: how kernels are told."""
    return dwell if isinstance(dwell, tuple) else (dwell, -1.0)


def level_of(level: Level) -> tuple[float, float]:
    """The lowest factor, and the natural logarithm of highest over lowest: how kernels are told."""
    low, high = level if isinstance(level, tuple) else (level, level)
    return low, math.log(high / low)
