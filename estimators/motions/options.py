"""Checks and units shared by the factories of motions."""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = ["check_axes", "check_option", "labels_of", "units_of"]

_UNITS = {
    **dict.fromkeys(("x", "y", "z", "xl", "yl", "xc", "yc", "rho", "A"), "m"),
    **dict.fromkeys(("vx", "vy", "vz", "vxl", "vyl", "s"), "m/s"),
    **dict.fromkeys(("ax", "ay", "az"), "m/s^2"),
    **dict.fromkeys(("jx", "jy", "jz"), "m/s^3"),
    **dict.fromkeys(("theta", "phi", "psi"), "rad"),
    **dict.fromkeys(("w", "wx", "wy", "wz", "Omega"), "rad/s"),
}


def check_axes(caller: str, axes: int, allowed: Sequence[int] = (1, 2, 3)) -> int:
    """``axes`` as an int, or one sentence.

    Raises:
        ValueError: ``axes`` is not among ``allowed``.
    """
    if axes not in allowed:
        wanted = " or ".join(str(value) for value in allowed)
        raise ValueError(f"{caller}: axes must be {wanted}; got {axes!r}. Use 2 for the plane, 3 for space.")
    return int(axes)


def check_option(caller: str, name: str, value: float, rule: str = ">= 0") -> float:
    """A physical option as a float, or one sentence.

    Args:
        caller: the factory.
        name: the option.
        value: what the user gave.
        rule: ``">= 0"``, ``"> 0"`` or ``"finite"``; the first two also ask for a finite number.

    Raises:
        ValueError: the rule does not hold.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    holds = math.isfinite(number)
    if rule == ">= 0":
        holds = holds and number >= 0
    elif rule == "> 0":
        holds = holds and number > 0
    if not holds:
        wanted = "a finite number" if rule == "finite" else f"a finite number {rule}"
        raise ValueError(f"{caller}: {name} must be {wanted}; got {value!r}. Use SI units and radians.")
    return number


def labels_of(axes: int, per_axis: str) -> tuple[str, ...]:
    """Block-ordered labels: ``labels_of(2, " v a")`` is ``x vx ax y vy ay``."""
    return tuple(f"{prefix}{axis}" for axis in "xyz"[:axes] for prefix in per_axis.split(" "))


def units_of(labels: Sequence[str]) -> tuple[str, ...]:
    """The unit of each label of this package."""
    return tuple(_UNITS[label] for label in labels)
