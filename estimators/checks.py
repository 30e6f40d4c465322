"""One way to refuse what a user hands over: a sentence with caller, argument, rule, value and remedy.

Each function is for one kind of argument and returns it as what the code works with.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["check_array", "check_choice", "check_count", "check_kind", "check_number"]


def check_number(
    caller: str,
    name: str,
    value: Any,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    least: bool = False,
    infinite: bool = False,
    remedy: str,
) -> float:
    """A real number above ``low``, or from it on with ``least``, up to ``high``; finite unless ``infinite``.

    Raises:
        ValueError: text, a truth value, an array, NaN, or a number out of range.
    """
    number = float(value) if _is_number(value) else math.nan
    inside = (low <= number if least else low < number) and number <= high
    if not inside or not (infinite or math.isfinite(number)):
        ends = "" if math.isinf(low) else f" {'>=' if least else '>'} {low:g}"
        ends += f" and at most {high:g}" if math.isfinite(high) else "" if infinite else " and finite"
        raise ValueError(f"{caller}: {name} must be a number{ends}; got {_shown(value)}. {remedy}")
    return number


def check_count(caller: str, name: str, value: Any, low: int, high: float = math.inf, *, remedy: str) -> int:
    """A whole number from ``low`` to ``high``.

    Raises:
        ValueError: anything else; 2.0 is no count.
    """
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or not low <= value <= high:
        ends = f">= {low}" if math.isinf(high) else f"from {low} to {high:g}"
        raise ValueError(f"{caller}: {name} must be an integer {ends}; got {_shown(value)}. {remedy}")
    return int(value)


def check_choice(caller: str, name: str, value: Any, known: Collection[str]) -> None:
    """One of some names.

    Raises:
        ValueError: anything else.
    """
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{caller}: {name} must be one of {', '.join(known)}; got {_shown(value)}. Choose one.")


def check_kind(caller: str, name: str, value: Any, kind: type | tuple[type, ...], what: str, remedy: str) -> None:
    """A value of some class; ``what`` names it.

    Raises:
        ValueError: a value of another.
    """
    if not isinstance(value, kind):
        raise ValueError(f"{caller}: {name} must be {what}; got {_shown(value)}. {remedy}")


def check_array(caller: str, name: str, value: Any, remedy: str) -> NDArray[np.float64]:
    """Numbers in rows of one length, as an array of its own.

    Raises:
        ValueError: text, None, or rows of several lengths.
    """
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"{caller}: {name} must be numbers in rows of one length; got {_shown(value)}. {remedy}"
        ) from None


def _is_number(value: Any) -> bool:
    kinds = int | float | np.integer | np.floating
    return (isinstance(value, kinds) and not isinstance(value, bool)) or (
        isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"
    )


def _shown(value: Any) -> str:
    """A value in one short line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."
