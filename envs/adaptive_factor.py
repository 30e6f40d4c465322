"""`jink/AdaptiveFactor-v0`: how far to distrust each measurement, judged by what the filter makes of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from jink.envs import factor_kernels as kernels
from jink.envs.cartesian import check_locates, place_measurements
from jink.envs.episodes import Episodes, Source
from jink.envs.halves import in_halves
from jink.envs.loop_filter import LoopFilter, make_loop_filter
from jink.envs.task import Array, Outcome, Picture, Rows
from jink.estimators.factors import Factor, make_factor

__all__ = ["FACTORS_OFFERED", "LARGEST_LOG_INFLATION", "AdaptiveFactorTask"]

FACTORS_OFFERED = ("none", "mr", "huber", "rma", "mahalanobis")
"""Actions of `jink/AdaptiveFactor-v0`, in order."""
LARGEST_LOG_INFLATION = math.log(1e6)
_LOSSES = {"distance": kernels.DISTANCE, "squared": kernels.SQUARED, "log": kernels.LOG}
_LOWEST, _HIGHEST, _LEAST_GAIN = -10.0, 100.0, 0.1


class AdaptiveFactorTask:
    """Choose how a filter distrusts each measurement, one decision per measurement.

    ## Description
    """

    def __init__(
        self,
        source: Source,
        count: int,
        continuous: bool = False,
        *,
        factors: Sequence[str | Factor] = FACTORS_OFFERED,
        loop_filter: str | LoopFilter = "kf",
        reward: str = "distance",
        lost_after: float = 25.0,
        lost_steps: int = 10,
    ) -> None:
        check_locates("make", source.sensor)
        if reward not in _LOSSES:
            raise ValueError(f"make: reward must be one of {', '.join(_LOSSES)}; got {reward!r}. Pick one.")
        if not (lost_after > 0 and lost_steps >= 1 and lost_steps == int(lost_steps)):
            raise ValueError(
                f"make: lost_after must be > 0 sigma and lost_steps an integer >= 1; got {lost_after}, {lost_steps}. "
                "Use math.inf for a track that is never lost."
            )
        self.source, self.count, self.continuous = source, int(count), bool(continuous)
        self.factors = tuple(make_factor(factor) if isinstance(factor, str) else factor for factor in factors)
        if not continuous and len(self.factors) < 2:
            raise ValueError(f"make: factors must be at least two; got {len(self.factors)}. There is nothing to choose.")
        self.loop_filter = make_loop_filter(loop_filter, source.axes)
        A, B, T, modes = source.axes, self.count, source.steps, len(self.loop_filter.modes)
        choices = 0 if continuous else len(self.factors)
        self.observation_space = gymnasium.spaces.Box(*_bounds(A, modes, choices), dtype=np.float32)
        self.action_space: gymnasium.Space[Any] = (
            gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32) if continuous else gymnasium.spaces.Discrete(choices)
        )
        self._sizes = A, modes, choices
        self._thresholds = np.array([[factor.thresholds(d + 1) for d in range(A)] for factor in self.factors])
        self._params = self.loop_filter.params_for(source.filter_noise)
        self._settings = np.array(
            [lost_after, lost_steps, _LOWEST, _HIGHEST, _LOSSES[reward], _LEAST_GAIN], dtype=np.float64
        )
        self._states = np.zeros((B, 4 * A + 3, 8))
        self._samples = np.zeros((B, T, kernels.FIRST + 3 * A))
        self._memory = np.zeros((B, kernels.PLACE + 3 * A))
        self._features = np.zeros((B, self.observation_space.shape[0]), dtype=np.float32)
        self._noises = np.zeros((1, 1, A * A))
        self._sensor_places = np.zeros((B, A))
        self._one_noise = True
        self._look_up()

    def _look_up(self) -> None:
        self._filters = self.loop_filter.addresses()
        self._addresses = np.array([factor.function.address for factor in self.factors])

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_filters", "_addresses")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._look_up()  # addresses belong to a process

    def check_actions(self, actions: Any, caller: str) -> NDArray[Any]:
        """The choices (B,) as int64, or the log inflations (B, 1) as float64.

        Raises:
            ValueError: wrong shape or type, not finite, or out of range.
        """
        array = np.asarray(actions)
        if self.continuous:
            if array.shape != (self.count, 1) or array.dtype.kind not in "fiu":
                raise ValueError(
                    f"{caller}: action must be numbers of shape {(self.count, 1)}; got {array.dtype} {array.shape}. "
                    "Give one per target: -1 leaves the noise as it is, 1 inflates it by a million."
                )
            if not np.abs(array).max() <= 1.0:
                row = int(np.argmin(np.abs(array[:, 0]) <= 1.0))
                raise ValueError(
                    f"{caller}: action must be finite and within -1 .. 1; got {array[row, 0]} for target {row}. Clip it."
                )
            return array.astype(np.float64)
        if array.shape != (self.count,) or array.dtype.kind not in "iu":
            raise ValueError(
                f"{caller}: action must be integers of shape {(self.count,)}; got {array.dtype} {array.shape}. "
                f"Give the number of a factor: {_listed(self.factors)}."
            )
        if array.min() < 0 or array.max() >= len(self.factors):
            row = int(np.argmax((array < 0) | (array >= len(self.factors))))
            raise ValueError(
                f"{caller}: action must be 0 .. {len(self.factors) - 1}; got {array[row]} for target {row}. "
                f"Give the number of a factor: {_listed(self.factors)}."
            )
        return array.astype(np.int64)

    def begin(self, rows: Rows, episodes: Episodes) -> None:
        """Rows start new episodes; both reference filters run through them."""
        A, modes, choices = self._sizes
        T = self.source.steps
        places, noises = place_measurements(self.source.sensor, episodes)
        if noises.ndim == 2:
            self._noises[0, 0] = noises.ravel()
        else:
            if self._one_noise:
                self._noises, self._one_noise = np.zeros((self.count, T, A * A)), False
            self._noises[rows] = noises.reshape(len(rows), T, A * A)
        self._sensor_places[rows] = episodes.sensor_states[:, 0, :A]
        priors = np.zeros((len(rows), 2 * A + 1, 8))
        priors[:, 0, : 2 * A] = episodes.prior_mean
        priors[:, 1:, : 2 * A] = episodes.prior_cov
        in_halves(
            kernels.begin_rows, len(rows), rows, A, modes, choices, self._filters, self._params, self._settings,
            episodes.times, episodes.scale, episodes.truth.intent, episodes.truth.position, places, priors,
            self._noises, self._one_noise, self._states, self._samples, self._memory, self._features,
        )  # fmt: skip

    def step(self, actions: NDArray[Any], k: Rows, live: NDArray[np.bool_]) -> Outcome:
        """Update the filters of sample ``k[b]`` with the noise chosen, and look at the next one."""
        A, modes, choices = self._sizes
        if self.continuous:
            chosen = np.full(self.count, -1)
            inflations = np.exp((0.5 * LARGEST_LOG_INFLATION) * (actions[:, 0] + 1.0))
        else:
            chosen, inflations = actions, np.ones(self.count)
        reward, lost = np.empty(self.count), np.empty(self.count, dtype=np.bool_)
        in_halves(
            kernels.step_rows, self.count, live, k, chosen, inflations, A, modes, choices, self._filters, self._addresses,
            self._thresholds, self._params, self._settings, self._noises, self._one_noise,
            self._states, self._samples, self._memory, self._features, reward, lost,
        )  # fmt: skip
        return Outcome(reward, lost)

    def observe(self, k: Rows) -> NDArray[Any]:
        """Observations (B, O) of sample ``k[b]``."""
        return self._features.copy()

    def info(self, k: Rows) -> dict[str, NDArray[Any]]:
        """See *Info* in the class's documentation."""
        B, A = self.count, self.source.axes
        told: dict[str, NDArray[Any]] = {
            "time": np.empty(B),
            "noise_scale": np.empty(B),
            "intent": np.empty(B, dtype=np.int64),
            "detected": np.empty(B, dtype=np.bool_),
            "nis": np.empty(B),
            "error_agent": np.empty(B),
            "error_nominal": np.empty(B),
            "error_oracle": np.empty(B),
            "inflation": np.empty(B),
            "position": np.empty((B, A)),
            "estimate": np.empty((B, A)),
        }
        kernels.tell_rows(k, A, self._samples, self._memory, *told.values())
        return told

    def picture(self, row: int, k: int) -> Picture:
        """Everything up to sample ``k`` of one target."""
        A, c = self.source.axes, kernels.FIRST
        past = self._samples[row, : k + 1]
        return Picture(
            title=self.source.id,
            times=past[:, kernels.TIME].copy(),
            truth=past[:, c : c + A].copy(),
            seen=past[:, c + A : c + 2 * A].copy(),
            estimate=past[:, c + 2 * A :].copy(),
            covariance=self._states[row, 1 : 1 + A, :A].copy(),
            sensor=self._sensor_places[row].copy(),
            intents=self.source.intents,
            intent=past[:, kernels.INTENT].astype(np.int8),
            scale=past[:, kernels.SCALE].copy(),
            choices=() if self.continuous else tuple(factor.name for factor in self.factors),
            choice=past[:, kernels.CHOICE].astype(np.int64),
            score=past[:, kernels.SCORE].copy(),
        )


def _bounds(A: int, modes: int, choices: int) -> tuple[Array, Array]:
    high = np.full(2 * A + 5 + modes + max(choices, 1), kernels.BOUND)
    low = -high
    low[2 * A + 3] = 0.0
    low[2 * A + 5 :], high[2 * A + 5 :] = 0.0, 1.0
    if not choices:
        low[-1] = -1.0
    return low.astype(np.float32), high.astype(np.float32)


def _listed(factors: Sequence[Factor]) -> str:
    return ", ".join(f"{number} {factor.name}" for number, factor in enumerate(factors))
