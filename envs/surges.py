"""The kinds of noise surges by name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from jink.envs.noise.biases import BiasDrift, BiasWalk
from jink.envs.noise.bursts import Dropouts, Glint, MarkovBursts, PlacedBursts, Ramp
from jink.envs.noise.heavy_tails import Contaminated, HeavyTails, IsolatedOutliers
from jink.envs.surge import Surge

__all__ = [
    "SURGES",
    "BiasDrift",
    "BiasWalk",
    "Contaminated",
    "Dropouts",
    "Glint",
    "HeavyTails",
    "IsolatedOutliers",
    "MarkovBursts",
    "PlacedBursts",
    "Ramp",
    "Surge",
    "as_surges",
    "make_surge",
]

SURGES: dict[str, type[Surge]] = {
    "bursts": MarkovBursts,
    "placed-bursts": PlacedBursts,
    "outliers": IsolatedOutliers,
    "contaminated": Contaminated,
    "ramp": Ramp,
    "student-t": HeavyTails,
    "glint": Glint,
    "bias-drift": BiasDrift,
    "bias-walk": BiasWalk,
    "dropouts": Dropouts,
}
"""Kinds by registry name."""


def make_surge(name: str, **options: Any) -> Surge:
    """A surge by its registry name, its parameters by keyword.

    Raises:
        ValueError: an unknown name, or a parameter out of range.
        TypeError: a parameter the surge does not have.
    """
    if name not in SURGES:
        raise ValueError(f"make_surge: name must be a known surge; got {name!r}. Use one of {', '.join(SURGES)}.")
    return SURGES[name](**options)


def as_surges(value: Any) -> tuple[Any, ...]:
    """One or several surges, each as it is or by its registry name.

    Raises:
        ValueError: an unknown name.
    """
    kinds = [value] if isinstance(value, str) or not isinstance(value, Iterable) else value
    return tuple(make_surge(kind) if isinstance(kind, str) else kind for kind in kinds)
