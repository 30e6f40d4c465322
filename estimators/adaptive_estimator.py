"""An estimator that learns the measurement noise (and, if wanted, the process noise) while it tracks."""

from __future__ import annotations

import math
import zlib
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.adaptive_cycle import (
    LEARNT,
    PROCESS,
    RATIO,
    SAGE_HUSA,
    VARIATIONAL,
    WEIGHT,
    Settings,
    advance,
)
from jink.estimators.agent.updating import IDLE
from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank
from jink.estimators.inputs import Prior, check_inputs
from jink.estimators.records import History, Inputs, Outputs, State
from jink.estimators.streaming import Desk

__all__ = ["METHODS", "AdaptiveEstimator", "NoiseAdaptation"]

Floats = NDArray[np.float64]
METHODS = {"sage-husa": SAGE_HUSA, "variational": VARIATIONAL}


@dataclass(frozen=True)
class NoiseAdaptation:
    """How an `AdaptiveEstimator` learns the noise.

    The noise learnt is a ratio to the R that comes with each measurement, so that R is where learning starts and
    keeps giving units, and may differ from row to row. A missing row teaches nothing and forgets nothing.

    Args:
        method: one of `METHODS`: ``sage-husa`` (innovations against their prediction) or ``variational``
            (inverse-Wishart noise, fixed point with the state).
        forgetting: what the past is worth after one more measurement, in (0, 1]; the memory is
            ``1 / (1 - forgetting)`` measurements; 1 never forgets.
        start_weight: how many measurements the given R is worth at the start, >= 0; None: a full memory.
        floor, ceiling: the noise used stays between these multiples of R, in every direction.
        iterations: of the variational fixed point, 1 to 100.
        measurement: learn R.
        process: learn a factor on Q, within the same floor and ceiling (``sage-husa`` only). With both, each may take
            the other's share of the innovations and the track with it: learn Q alone where R is known.

    Raises:
        ValueError: a value out of range.
    """

    method: str = "variational"
    forgetting: float = 0.9
    start_weight: float | None = None
    floor: float = 0.1
    ceiling: float = 1e6
    iterations: int = 5
    measurement: bool = True
    process: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.method, str) or self.method not in METHODS:
            raise ValueError(
                f"NoiseAdaptation: method must be one of {', '.join(METHODS)}; got {self.method!r}. Pick one."
            )
        for name in ("forgetting", "start_weight", "floor", "ceiling"):
            value = getattr(self, name)
            number = isinstance(value, float | int | np.number) and not isinstance(value, bool)
            if not number and not (name == "start_weight" and value is None):
                raise ValueError(f"NoiseAdaptation: {name} must be a number; got {value!r}. Leave it out.")
        if not 0.0 < self.forgetting <= 1.0:
            raise ValueError(f"NoiseAdaptation: forgetting must be in (0, 1]; got {self.forgetting}. Use 0.9.")
        if self.start_weight is not None and not self.start_weight >= 0.0:
            raise ValueError(
                f"NoiseAdaptation: start_weight must be >= 0 measurements; got {self.start_weight}. Leave it out."
            )
        for name, low, high, usual in (("floor", 0.0, 1.0, "0.1"), ("ceiling", 1.0, 1e12, "1e6")):
            value = getattr(self, name)
            if not (low <= value <= high and value > 0.0):
                raise ValueError(
                    f"NoiseAdaptation: {name} must be > 0 and in [{low:g}, {high:g}]; got {value}. Use {usual}."
                )
        whole = isinstance(self.iterations, int | np.integer) and not isinstance(self.iterations, bool)
        if not whole or not 1 <= self.iterations <= 100:
            raise ValueError(
                f"NoiseAdaptation: iterations must be an integer in 1..100; got {self.iterations!r}. Use 5."
            )
        for name in ("measurement", "process"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(
                    f"NoiseAdaptation: {name} must be True or False; got {getattr(self, name)!r}. Leave it out."
                )
        if self.method != "sage-husa" and (self.process or not self.measurement):
            raise ValueError(
                f"NoiseAdaptation: measurement, process must be True, False for {self.method}; got "
                f"{self.measurement}, {self.process}. Use sage-husa to learn Q."
            )

    @property
    def settings(self) -> Settings:
        """The same for the compiled kernels."""
        memory = 1.0 / (1.0 - self.forgetting) if self.forgetting < 1.0 else math.inf
        return Settings(
            METHODS[self.method],
            float(self.forgetting),
            float(self.floor),
            float(self.ceiling),
            float(memory if self.start_weight is None else self.start_weight),
            int(self.iterations),
            bool(self.measurement),
            bool(self.process),
            True,
        )


class AdaptiveEstimator(BankEstimator):
    """A filter of one mode that learns how noisy its sensor is.

    Everything is used as in `BankEstimator`. The smoother takes the filter's states as they are, so it inherits the
    noise learnt; with ``process`` there is none.

    Args:
        bank: one mode, sensor.
        adaptation: how to learn; None: `NoiseAdaptation`'s defaults.
        name: shown in tables.
        threads: processor cores for many tracks; None: all.

    Raises:
        ValueError: several modes, or from the inputs of each method, one sentence each.
    """

    _learns = True

    def __init__(
        self,
        bank: Bank,
        adaptation: NoiseAdaptation | None = None,
        name: str = "adaptive",
        threads: int | None = None,
    ) -> None:
        if len(bank.modes) != 1:
            raise ValueError(
                f"AdaptiveEstimator: bank must have one mode; got {len(bank.modes)}. Learn the noise of each mode's "
                "own filter, or use a bank of noise levels."
            )
        if bank.modes[0].treatments:
            raise ValueError(
                f"AdaptiveEstimator: bank must have a mode without treatment; got {bank.modes[0].treatment!r}. Leave "
                "it out: the noise is learnt, or use a BankEstimator."
            )
        super().__init__(bank, name=name, threads=threads)
        self.adaptation = adaptation or NoiseAdaptation()
        self._trail = np.zeros((0, 0, 0))

    def __getstate__(self) -> dict[str, Any]:
        """Pickled without compiled tables: addresses belong to one process."""
        return {**super().__getstate__(), "adaptation": self.adaptation, "_trail": np.zeros((0, 0, 0))}

    def surge_probability(self, estimates: Estimates) -> Floats:
        """Not offered: there are no noise levels to choose from.

        Raises:
            ValueError: always.
        """
        raise ValueError("surge_probability: bank must have noise levels; got a learnt noise. Use noise_run.")

    def noise_scale(self, estimates: Estimates) -> Floats:
        """Not offered: the learnt noise is a matrix.

        Raises:
            ValueError: always.
        """
        raise ValueError("noise_scale: bank must have noise levels; got a learnt noise. Use noise_run.")

    def measurement_noise(self, state: State, noise: ArrayLike | None = None) -> Floats:
        """The R in use after ``state``.

        Args:
            state: from `start` or `step`.
            noise: the R that comes with the next measurement (D, D); None: the sensor's.

        Returns:
            R; (D, D); with a leading B for a state of B > 1 tracks.

        Raises:
            ValueError: a state of another estimator, or a noise that is no covariance.
        """
        self._check_state(state, "measurement_noise")
        size = self.bank.sensor.size
        R = check_inputs(self.bank, np.zeros((1, size)), [0.0], noise, caller="measurement_noise").noise[0, 0]
        used = _scaled(R, state.nis_average[:, LEARNT + RATIO :].reshape(-1, size, size))
        return used[0] if len(used) == 1 else used

    def noise_run(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
        lengths: ArrayLike | None = None,
        *,
        prior: Prior | None = None,
    ) -> tuple[Floats, Floats]:
        """What `run` learns about the noise at every row; arguments and errors as there.

        Returns:
            R after each row (B, T, D, D), in the units of that row's own, and the factor on Q (B, T). Rows before the
            start and padding hold the given R and 1; where the given R is no covariance, NaN.
        """
        inputs = check_inputs(self.bank, measurements, times, noise, sensor_states, lengths, caller="noise_run")
        tracks, rows, size = inputs.measurements.shape
        recorder = AdaptiveEstimator(self.bank, self.adaptation, self.name, self.threads)
        recorder._trail = np.tile(recorder._unlearnt(), (tracks, rows, 1))
        recorder._filter(inputs, prior, False, None)
        ratio = recorder._trail[..., RATIO:].reshape(tracks, rows, size, size)
        return _scaled(inputs.noise, ratio), recorder._trail[..., PROCESS].copy()

    def forecast(self, state: State, horizon: float, *, weights: str = "W1", steps: int = 1) -> tuple[Floats, Floats]:
        """Position ``horizon`` seconds ahead; with ``process``, Q keeps the factor learnt. As `BankEstimator`."""
        mean, cov = super().forecast(state, horizon, weights=weights, steps=steps)
        if not self.adaptation.process:
            return mean, cov
        certain = state._replace(cov=np.zeros_like(state.cov))
        _, noise = super().forecast(certain, horizon, weights=weights, steps=steps)
        factor = state.nis_average[:, LEARNT + PROCESS] - 1.0
        return mean, cov + (factor[:, None, None] if cov.ndim == 3 else factor[0]) * noise

    def forecast_run(self, *arguments: Any, **options: Any) -> tuple[Floats, Floats]:
        """At every row, position ``horizon`` seconds ahead; as `BankEstimator.forecast_run`.

        Raises:
            ValueError: with ``process`` it is not offered.
        """
        if self.adaptation.process:
            raise ValueError(
                "forecast_run: process must be False; got True. Forecast the state of each step, which knows its Q."
            )
        return super().forecast_run(*arguments, **options)

    def states(self, *arguments: Any, **options: Any) -> tuple[State, Estimates]:
        """What the estimator knows after every row, the noise learnt left out; as `BankEstimator.states`.

        Raises:
            ValueError: with ``process`` it is not offered.
        """
        if self.adaptation.process:
            raise ValueError("states: process must be False; got True. Take the state of each step, which knows its Q.")
        return super().states(*arguments, **options)

    def smooth(self, *arguments: Any, **options: Any) -> Estimates:
        """Smoothed estimates: every row uses the whole track; as `BankEstimator.smooth`.

        Raises:
            ValueError: with ``process`` it is not offered.
        """
        if self.adaptation.process:
            raise ValueError("smooth: process must be False; got True. Use run, or learn only the measurement noise.")
        return super().smooth(*arguments, **options)

    def _unlearnt(self) -> Floats:
        size = self.bank.sensor.size
        columns = np.zeros(RATIO + size * size)
        columns[WEIGHT], columns[PROCESS] = self.adaptation.settings.start_weight, 1.0
        columns[RATIO:] = np.eye(size).ravel()
        return columns

    def _blank(self, tracks: int) -> State:
        state = super()._blank(tracks)
        learnt = np.tile(self._unlearnt(), (tracks, 1))
        return state._replace(nis_average=np.hstack([state.nis_average, learnt]))

    @cached_property
    def _layout(self) -> int:
        own = (zlib.crc32(repr(astuple(self.adaptation)).encode()), self.bank.sensor.size)
        motion = self.bank.modes[0].motion
        return zlib.crc32(repr((self.bank.sensor.axes, self.modes, motion.labels, own)).encode())

    def _advance(self, state: State, inputs: Inputs, outputs: Outputs, history: History, low: int, high: int) -> None:
        settings = self.adaptation.settings._replace(restart=self.bank.restart is not False)
        trail = self._trail
        advance(settings, IDLE, self._handle.handle, self._work(), state, inputs, outputs, history, trail, low, high)

    def _advance_row(self, desk: Desk, state: State) -> None:
        self._advance(state, desk.inputs.record, desk.outputs.record, self._history(1, 0), 0, 1)


def _scaled(R: Floats, ratio: Floats) -> Floats:
    """``L ratio L'`` with ``R = L L'``, over leading axes; NaN where R is no covariance."""
    lower = np.full(R.shape, np.nan)
    for index in np.ndindex(R.shape[:-2]):
        try:
            lower[index] = np.linalg.cholesky(R[index]) if np.isfinite(R[index]).all() else np.nan
        except np.linalg.LinAlgError:
            continue
    return np.asarray(lower @ ratio @ np.swapaxes(lower, -1, -2))
