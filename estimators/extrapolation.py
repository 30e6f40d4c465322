"""Where each intent would take the target: the bank runs on without measurements, once for every mode it may be in."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.batches import in_parallel
from jink.estimators.forecasting import forecast_states
from jink.estimators.inputs import check_inputs
from jink.estimators.records import RUNNING, History, Outputs, State, make_outputs

if TYPE_CHECKING:
    from jink.estimators.api import BankEstimator

__all__ = ["Extrapolation", "extrapolate", "follow_modes", "rows_of"]

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
        _extrapolate(estimator, rows_of(state, slice(low, low + size)), ahead[low : low + size])
        for low in range(0, tracks, size)
    ]
    return Extrapolation(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def follow_modes(
    estimator: BankEstimator, state: State, horizons: Floats, modes: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Moments of the position along given sequences of modes: nothing is collapsed, for nothing is uncertain but noise.

    Args:
        estimator: whose bank runs on.
        state: B states of it.
        horizons: seconds ahead, not decreasing; (B, H).
        modes: mode now, then at each horizon; (B, S, H + 1).

    Returns:
        mean (B, S, H, A), m, and covariance (B, S, H, A, A), m^2.
    """
    B, S, H = modes.shape[0], modes.shape[1], modes.shape[2] - 1
    many, count, axes = B * S, state.mode_probs.shape[1], state.kin_mean.shape[1] // 2
    sequences = modes.reshape(many, H + 1)
    begun = _repeated(state, S)
    begun.mode_probs[:] = np.eye(count)[sequences[:, 0]]
    forced = np.repeat(np.eye(count)[sequences[:, 1:], None, :], count, axis=2)
    _, outputs = _run_on(estimator, begun, np.repeat(horizons, S, axis=0), forced)
    mean, cov = outputs.kin_mean[..., :axes], outputs.kin_cov[..., :axes, :axes]
    return mean.reshape(B, S, H, axes), cov.reshape(B, S, H, axes, axes)


def rows_of(state: State, rows: slice | NDArray[np.int64]) -> State:
    """Some of the tracks of a state."""
    return State._make([*(value[rows] for value in state[:-1]), state.layout])


def _repeated(state: State, times: int) -> State:
    return State._make([*(np.repeat(value, times, axis=0) for value in state[:-1]), state.layout])


def _run_on(
    estimator: BankEstimator, begun: State, horizons: Floats, chains: Floats | None = None
) -> tuple[History, Outputs]:
    """The bank's own cycle without measurements; ``begun`` is used up."""
    many, steps = horizons.shape
    begun.phase[:] = RUNNING
    begun.time[:] = 0.0  # so that states of different times share the tables of equal steps
    nothing = np.full((many, steps, estimator.bank.sensor.size), np.nan)
    inputs = check_inputs(estimator.bank, nothing, horizons, mode_transition=chains, caller="extrapolate")
    outputs = make_outputs(many, steps, begun.kin_mean.shape[1], begun.mode_probs.shape[1])
    history = estimator._history(many, steps if chains is None else 0)
    in_parallel(
        estimator.threads,
        lambda low, high: estimator._advance(begun, inputs, outputs, history, low, high),
        many,
        steps,
        None,
    )
    return history, outputs


def _extrapolate(estimator: BankEstimator, state: State, horizons: Floats) -> Extrapolation:
    tracks, modes = state.mode_probs.shape
    steps, kin = horizons.shape[1], state.kin_mean.shape[1]
    begun = _repeated(state, modes)
    begun.mode_probs[:] = np.tile(np.eye(modes), (tracks, 1))
    history, outputs = _run_on(estimator, begun, np.repeat(horizons, modes, axis=0))
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
