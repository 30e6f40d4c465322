"""Following a motion without noise: what an intent looks like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.motion import Motion

__all__ = ["follow"]

Floats = NDArray[np.float64]
_LONGEST = 0.25  # s; a step is exact for constant shape parameters only
_MOST = 1000


def follow(legs: Sequence[tuple[Motion, float]], kin: Floats, own: ArrayLike | None, times: Floats) -> Floats:
    """Positions along a sequence of motions.

    Args:
        legs: motion and duration (s) of each; the last lasts for ever.
        kin: position and velocity at the start; (2A,).
        own: own parameters of the first motion (K,); None: the mean of its birth prior. Later ones begin with theirs.
        times: increasing, >= 0; (T,); s.

    Returns:
        Positions; (T, A).

    Raises:
        ValueError: a shape or an order is wrong.
    """
    first = legs[0][0]
    axes = first.axes
    if kin.shape != (2 * axes,):
        raise ValueError(f"rollout: kin must be position and velocity ({2 * axes},); got {kin.shape}. Positions first.")
    if times.ndim != 1 or (times < 0).any() or (np.diff(times) < 0).any():
        raise ValueError("rollout: times must be increasing and >= 0 s, (T,); got others. Sort them.")
    start = np.asarray(first.birth_mean if own is None else own, dtype=np.float64)
    if start.shape != (len(first.own_labels),):
        raise ValueError(
            f"rollout: own must be {', '.join(first.own_labels)}; got shape {start.shape}. One number each."
        )
    x = np.zeros(first.size)
    x[0 : 2 * axes : 2], x[1 : 2 * axes : 2], x[2 * axes :] = kin[:axes], kin[axes:], start
    ends = np.cumsum([duration for _, duration in legs])
    ends[-1] = np.inf
    out = np.zeros((len(times), axes))
    now, leg = 0.0, 0
    for i, time in enumerate(times):
        while time > ends[leg]:
            x = _move(legs[leg][0], x, ends[leg] - now)
            now = float(ends[leg])
            leg += 1
            x[2 * axes :] = legs[leg][0].birth_mean
        x = _move(legs[leg][0], x, time - now)
        now = float(time)
        out[i] = x[0 : 2 * axes : 2]
    return out


def _move(motion: Motion, x: Floats, duration: float) -> Floats:
    steps = min(int(np.ceil(duration / _LONGEST)), _MOST)
    params = np.array(motion.params)
    for _ in range(steps):
        following = np.zeros_like(x)
        motion.transition(x, duration / steps, params, following)
        x = following
    return x
