"""Where each intent would take the target: the bank runs on without measurements, once for every mode it may be in."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.batches import in_parallel
from jink.estimators.forecasting import forecast_states
from jink.estimators.inputs import check_inputs
from jink.estimators.records import RUNNING, State, make_outputs

if TYPE_CHECKING:
    from jink.estimators.api import BankEstimator

__all__ = ["Extrapolation", "extrapolate"]

Floats = NDArray[np.float64]
_BYTES = 2e8


class Extrapolation(NamedTuple):
    """Positions to come, by mode now (axis -2 of ``weights``) and mode then (axis -1).

    B states, H times, M modes, A axes. ``weights[b, h]`` sums to one; ``mean`` in m and ``cov`` in m^2 are those of the
    position given both modes (finite, but without meaning where the weight is zero).
    """

    weights: Floats  # (B, H, M, M)
    mean: Floats  # (B, H, M, M, A)
    cov: Floats  # (B, H, M, M, A, A)


def extrapolate(estimator: BankEstimator, state: State, horizons: Floats) -> Extrapolation:
    """Moments of the position at each horizon, given the mode now and the mode then.

    Model: from each mode i alone, with probability one, the bank's own cycle runs on without measurements: chain,
    interaction, prediction. What has come from i to j by different roads is matched in its first two moments, and so
    are the roads back to i; roads from unlike modes stay apart. Weight = mode probability of i times
    ``Pr(j at the horizon | i now)``.

    Args:
        estimator: whose bank runs on.
        state: B states of it.
        horizons: seconds ahead, not decreasing; (H,), or (B, H) for each state its own.

    Returns:
        the moments.

    Source: the cycle of Blom & Bar-Shalom (1988) without update. Differs: begun from each mode apart, because what
    matters to a forecast is that the roads part.
    """
    tracks, modes = state.mode_probs.shape
    kin, states = state.kin_mean.shape[1], state.mean.shape[2]
    ahead = np.broadcast_to(horizons, (tracks, horizons.shape[-1]))
    size = max(1, int(_BYTES / (8.0 * ahead.shape[1] * modes**2 * (states + kin + 1) ** 2)))
    parts = [
        _extrapolate(estimator, _rows(state, slice(low, low + size)), ahead[low : low + size])
        for low in range(0, tracks, size)
    ]
    return Extrapolation(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _rows(state: State, rows: slice) -> State:
    return State(*(value[rows] for value in state[:-1]), state.layout)


def _extrapolate(estimator: BankEstimator, state: State, horizons: Floats) -> Extrapolation:
    tracks, modes = state.mode_probs.shape
    steps, kin, size = horizons.shape[1], state.kin_mean.shape[1], estimator.bank.sensor.size
    begun = State(*(np.repeat(value, modes, axis=0) for value in state[:-1]), state.layout)
    many = tracks * modes
    begun.mode_probs[:] = np.tile(np.eye(modes), (tracks, 1))
    begun.phase[:] = RUNNING
    begun.time[:] = 0.0  # so that states of different times share the tables of equal steps
    inputs = check_inputs(
        estimator.bank,
        np.full((many, steps, size), np.nan),
        np.repeat(horizons, modes, axis=0),
        caller="extrapolate",
    )
    outputs, history = make_outputs(many, steps, kin, modes), estimator._history(many, steps)
    in_parallel(
        estimator.threads,
        lambda low, high: estimator._advance(begun, inputs, outputs, history, low, high),
        many,
        steps,
        None,
    )
    mean, cov = _positions(estimator, history.mean, history.cov, kin)
    shape = (tracks, modes, steps, modes)
    reached = np.swapaxes(outputs.mode_probs.reshape(shape), 1, 2)
    return Extrapolation(
        state.mode_probs[:, None, :, None] * reached,
        np.swapaxes(mean.reshape(*shape, -1), 1, 2),
        np.swapaxes(cov.reshape(*shape, kin // 2, kin // 2), 1, 2),
    )


def _positions(estimator: BankEstimator, mean: Floats, cov: Floats, kin: int) -> tuple[Floats, Floats]:
    """Position moments (..., M, A) of every mode's state, through the core's own fusion of one mode at a time."""
    modes, states = mean.shape[-2:]
    many = mean[..., 0, 0].size
    flat = estimator._blank(many)._replace(
        mean=np.ascontiguousarray(mean.reshape(many, modes, states)),
        cov=np.ascontiguousarray(cov.reshape(many, modes, states, states)),
    )
    places = np.zeros((many, modes, kin // 2))
    spreads = np.zeros((many, modes, kin // 2, kin // 2))
    kin_mean, kin_cov = np.zeros((many, kin)), np.zeros((many, kin, kin))
    for mode in range(modes):
        flat.mode_probs[:] = np.eye(modes)[mode]
        forecast_states(estimator._handle.handle, estimator._work(), flat, 0.0, 0, False, kin_mean, kin_cov)
        places[:, mode] = kin_mean[:, : kin // 2]
        spreads[:, mode] = kin_cov[:, : kin // 2, : kin // 2]
    return places, spreads
