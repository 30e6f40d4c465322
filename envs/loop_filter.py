"""The filter inside `jink/AdaptiveFactor-v0`, and the seam through which any other recipe can take its place.

A `LoopFilter` is four compiled functions for one target, called by address:

* ``start(prior, params, state)``: `prior` holds the mean (row 0) and covariance (rows 1 to 2 A) of position, velocity.
* ``innovate(state, z, params, work)``: compare the measurement `z` (A,), NaN where a component is missing and of
  nominal noise ``work[0]``, with its prediction.
* ``update(state, params, work)``: take it in, with the noise ``work[1]`` that was chosen for it.
* ``predict(state, dt, params, work)``: go on by `dt` seconds.

The state has 4 A + 3 rows of eight columns. Whatever the filter, these rows hold, when a function returns:

| row | |
|---|---|
| 0, 1 to 2 A | mean and covariance of position, velocity: what errors and pictures are taken from |
| 2 A + 1 | memory of the filter; one with M modes keeps their probabilities in the first M columns |
| 2 A + 2 | innovation v, NaN where missing (after `innovate`) |
| 2 A + 3 to 3 A + 2 | covariance of the predicted measurement, H P H' (after `innovate`) |
| 3 A + 3 to 4 A + 2 | the noise that the factor is to adapt: R, or the robust filter's R^ (after `innovate`) |

A missing measurement skips `innovate` and `update`. `work` is (11, 16, 8): ``work[0]`` stays as it is, what comes after
``work[1]`` is scratch. A filter that needs more (a bank, a network) can keep it in arrays of its own and its number in
the memory row.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray

from jink.envs.loop_kernels import (
    innovate_plain,
    innovate_robust,
    predict_plain,
    predict_robust,
    start_plain,
    update_plain,
)
from jink.estimators.compiled import Callback
from jink.estimators.factors import address_caller

__all__ = ["LOOP_FILTERS", "LoopFilter", "kalman", "make_loop_filter", "robust", "uncertain"]

Array = NDArray[np.float64]
_VECTOR, _MATRIX, _STACK = (types.Array(types.float64, dimensions, "C") for dimensions in (1, 2, 3))
START = types.void(_MATRIX, _MATRIX, _MATRIX)
INNOVATE = types.void(_MATRIX, _VECTOR, _MATRIX, _STACK)
UPDATE = types.void(_MATRIX, _MATRIX, _STACK)
PREDICT = types.void(_MATRIX, types.float64, _MATRIX, _STACK)
call_start, call_innovate, call_update, call_predict = map(address_caller, (START, INNOVATE, UPDATE, PREDICT))


@dataclass(frozen=True)
class LoopFilter:
    """A filter for the loop: four functions and their parameters.

    Args:
        name: in the registry.
        start, innovate, update, predict: functions of the signatures above.
        params: constants they are handed; (rows, 8). Entry (0, 0) is set to the white acceleration of the source.
        modes: names of its modes; empty for a single model.
        axes: space dimensions it is for; None: any.

    Raises:
        ValueError: ``params`` is not a finite (rows, 8) matrix, or there are more than 8 modes.
    """

    name: str
    start: Callback
    innovate: Callback
    update: Callback
    predict: Callback
    params: Array = field(default_factory=lambda: np.zeros((1, 8)))
    modes: tuple[str, ...] = ()
    axes: int | None = None

    def __post_init__(self) -> None:
        params = np.array(self.params, dtype=np.float64)
        if params.ndim != 2 or params.shape[1] != 8 or len(params) == 0 or not np.isfinite(params).all():
            raise ValueError(
                f"LoopFilter: params must be finite with shape (rows, 8); got shape {params.shape}. Pad with zeros."
            )
        if len(self.modes) > 8:
            raise ValueError(f"LoopFilter: modes must be at most 8; got {len(self.modes)}. Merge some.")
        params.setflags(write=False)
        object.__setattr__(self, "params", params)

    def addresses(self) -> NDArray[np.int64]:
        """Of start, innovate, update, predict; compiled on first use."""
        return np.array([part.address for part in (self.start, self.innovate, self.update, self.predict)])

    def params_for(self, density: float) -> Array:
        """The parameters with the source's white acceleration, m^2/s^3."""
        params = self.params.copy()
        params[0, 0] = density
        return params


_START, _UPDATE = Callback(start_plain, START), Callback(update_plain, UPDATE)
_KALMAN = LoopFilter("kf", _START, Callback(innovate_plain, INNOVATE), _UPDATE, Callback(predict_plain, PREDICT))
_ROBUST = Callback(innovate_robust, INNOVATE), _UPDATE, Callback(predict_robust, PREDICT)


def kalman(axes: int = 2) -> LoopFilter:
    """Kalman filter: constant velocity with white acceleration."""
    return _KALMAN


def robust(error: ArrayLike, excitation: ArrayLike, alpha: float = 0.5) -> LoopFilter:
    """Sayed's filter around the same model: its transition is off by ``M Delta E_f``, ``||Delta|| <= 1``.

    The regulation follows the nominal R of each measurement; the factors adapt R^.

    Args:
        error: M; (2 A, q), position rows first.
        excitation: E_f; (t, 2 A).
        alpha: regulation is ``(1 + alpha)`` times its bound; > 0.

    Returns:
        the filter.

    Raises:
        ValueError: shapes do not fit, a number is not finite, or ``alpha`` is not positive.
    """
    M, E = np.array(error, dtype=np.float64), np.array(excitation, dtype=np.float64)
    fits = M.ndim == 2 and E.ndim == 2 and M.shape[0] == E.shape[1] and M.shape[0] in (4, 6)
    if not fits or not (1 <= M.shape[1] <= 8 and 1 <= E.shape[0] <= 8) or not np.isfinite(M.sum() + E.sum()):
        raise ValueError(
            f"robust: error and excitation must be finite with shapes (2 A, q), (t, 2 A), q and t at most 8; "
            f"got {M.shape}, {E.shape}. The state is position, then velocity."
        )
    if not (alpha > 0 and np.isfinite(alpha)):
        raise ValueError(f"robust: alpha must be > 0 and finite; got {alpha!r}. 0.5 is the usual choice.")
    A, t = M.shape[0] // 2, E.shape[0]
    params = np.zeros((1 + t + A, 8))
    params[0, 1:4] = alpha, t, M.shape[1]
    params[1 : 1 + t, : 2 * A] = E
    params[1 + t :, : M.shape[1]] = M[:A]
    return LoopFilter("robust", _START, *_ROBUST, params, axes=A)


def uncertain(axes: int = 2) -> LoopFilter:
    """Sayed's filter for the inventor's test plant: x moves on by up to 0.0198 s of its velocity too much or little."""
    M, E = np.zeros((2 * axes, 1)), np.zeros((1, 2 * axes))
    M[0, 0], E[0, axes] = 0.0198, 1.0
    return robust(M, E)


LOOP_FILTERS: dict[str, Callable[[int], LoopFilter]] = {"kf": kalman, "robust": uncertain}
"""Name -> filter for a number of axes. Others: `robust` with your M and E_f, or a `LoopFilter` of your own."""


def make_loop_filter(loop_filter: str | LoopFilter, axes: int) -> LoopFilter:
    """A filter by name, or the filter itself.

    Raises:
        ValueError: unknown name, or a filter for another number of axes.
    """
    found: Any = loop_filter
    if isinstance(loop_filter, str) and loop_filter in LOOP_FILTERS:
        found = LOOP_FILTERS[loop_filter](axes)
    if not isinstance(found, LoopFilter):
        raise ValueError(
            f"make: loop_filter must be one of {', '.join(LOOP_FILTERS)} or a LoopFilter; got {loop_filter!r}. "
            "Pick one, or build one with jink.envs.loop_filter.robust."
        )
    if found.axes not in (None, axes):
        raise ValueError(
            f"make: loop_filter must be for {axes} axes; got one for {found.axes}. Give M with {2 * axes} rows."
        )
    return found
