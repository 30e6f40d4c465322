"""Motions: the ways a target can move, by name.

Each is a factory with physical options in SI units that returns a `Motion`. Adding one is a file, an entry
here and a row in the documentation; the tests over `MOTIONS` do the rest.
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable
from typing import Any

from jink.estimators.motion import Motion
from jink.estimators.motions.bilinear import bilinear
from jink.estimators.motions.cartesian import constant_acceleration, constant_velocity
from jink.estimators.motions.correlated import jerk, singer
from jink.estimators.motions.drag import drag_coast
from jink.estimators.motions.helix import helix
from jink.estimators.motions.polar import circle, polar_turn
from jink.estimators.motions.spatial import spatial_turn
from jink.estimators.motions.turns import coordinated_turn, known_turn
from jink.estimators.motions.weave import swing, weave

__all__ = [
    "MOTIONS",
    "bilinear",
    "circle",
    "constant_acceleration",
    "constant_velocity",
    "coordinated_turn",
    "drag_coast",
    "helix",
    "jerk",
    "known_turn",
    "make_motion",
    "polar_turn",
    "singer",
    "spatial_turn",
    "swing",
    "weave",
]

MOTIONS: dict[str, Callable[..., Motion]] = {
    "constant-velocity": constant_velocity,
    "constant-acceleration": constant_acceleration,
    "singer": singer,
    "jerk": jerk,
    "known-turn": known_turn,
    "coordinated-turn": coordinated_turn,
    "polar-turn": polar_turn,
    "circle": circle,
    "weave": weave,
    "swing": swing,
    "drag-coast": drag_coast,
    "spatial-turn": spatial_turn,
    "helix": helix,
    "bilinear": bilinear,
}


def make_motion(name: str, **options: Any) -> Motion:
    """The motion of that name.

    Args:
        name: a key of `MOTIONS`.
        **options: of its factory.
    Returns:
        The motion.
    Raises:
        ValueError: the name or an option is unknown, or an option is out of range.
    """
    factory = MOTIONS.get(name)
    if factory is None:
        close = difflib.get_close_matches(str(name), MOTIONS, n=1, cutoff=0.5)
        remedy = f"Did you mean {close[0]!r}?" if close else "Pick one of these."
        raise ValueError(f"make_motion: name must be one of {', '.join(MOTIONS)}; got {name!r}. {remedy}")
    known = inspect.signature(factory).parameters
    unknown = [option for option in options if option not in known]
    if unknown:
        raise ValueError(
            f"make_motion: options of {name} must be among {', '.join(known)}; got {', '.join(unknown)}. "
            "Remove or rename them."
        )
    return factory(**options)
