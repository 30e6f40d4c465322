"""The estimator every recipe makes: whole tracks at once, one measurement at a time, forecasts, smoothing."""

from __future__ import annotations

import os
import threading
import zlib
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.bank import Bank
from jink.estimators.batches import fill_outside, in_parallel, part_of_inputs, part_of_prior
from jink.estimators.beginning import begin_at_measurements, locate, take_prior
from jink.estimators.cycle import advance, advance_one
from jink.estimators.extrapolation import Extrapolation, extrapolate
from jink.estimators.forecasting import forecast_states
from jink.estimators.inputs import Prior, check_inputs
from jink.estimators.program import Program, make_work
from jink.estimators.readings import intent_names, intent_probs, noise_scale, surge_probability
from jink.estimators.records import LOCATED, PRIOR, History, Inputs, Outputs, State, make_outputs, make_state
from jink.estimators.reference import Pinned, pin
from jink.estimators.smoothers import make_smoother, smooth_tracks
from jink.estimators.starting import StartBatch
from jink.estimators.status import STARTING
from jink.estimators.streaming import Desk, make_desk

__all__ = ["BankEstimator", "Estimates"]

Floats = NDArray[np.float64]
_SMOOTHER_BYTES = 2e8


class Estimates(NamedTuple):
    """What every estimator reports.

    Leading axes are (B, T); from a single `BankEstimator.step` there are none. ``covariance`` is that of position
    then velocity (2A, 2A); ``nis`` is 0 with ``nis_dof`` 0 where nothing was measured; ``status`` counts trouble:
    OK 0, REPAIRED 1, MISSING 2, DIVERGED 3, STARTING 4.
    """

    times: Floats
    position: Floats
    velocity: Floats
    covariance: Floats
    mode_probs: Floats
    log_likelihood: Floats
    nis: Floats
    nis_dof: NDArray[np.int64]
    status: NDArray[np.int8]


class BankEstimator:
    """An estimator made of a `Bank`.

    Args:
        bank: modes, sensor, chain, interaction.
        name: shown in tables.
        threads: processor cores for many tracks; None: all.

    Raises:
        ValueError: from `Bank` and from the inputs of each method, one sentence each.
    """

    _learns = False

    def __init__(self, bank: Bank, name: str = "bank", threads: int | None = None) -> None:
        if bank.learns_noise and not self._learns:
            raise ValueError(
                "BankEstimator: bank must not learn its noise; got one that does. Use AdaptiveEstimator, or "
                "make_estimator by name."
            )
        self.bank = bank
        self.name = name
        if threads is not None and not threads >= 1:
            raise ValueError(f"make_estimator: threads must be >= 1; got {threads}. Leave it out to use all cores.")
        self.threads = threads or os.cpu_count() or 1

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of the modes, in the order of ``mode_probs``."""
        return tuple(mode.name for mode in self.bank.modes)

    @cached_property
    def _program(self) -> Program:
        return self.bank.program()

    @cached_property
    def _handle(self) -> Pinned:
        return pin(self._program)

    @cached_property
    def _scratch(self) -> threading.local:
        return threading.local()

    def _work(self) -> Any:
        """Handle of this thread's scratch."""
        scratch = self._scratch
        if not hasattr(scratch, "work"):
            program, sensor = self._program, self.bank.sensor
            scratch.work = pin(
                make_work(
                    len(self.modes),
                    program.angular.shape[1],
                    program.birth_mean.shape[1],
                    sensor.size,
                    2 * sensor.axes,
                    program.error.shape[2],
                    program.excitation.shape[1],
                    max(len(program.outer_chain), len(program.inner_chain)),
                )
            )
        return scratch.work.handle

    def _desk(self) -> Desk:
        """This thread's arrays for streaming."""
        scratch = self._scratch
        if not hasattr(scratch, "desk"):
            scratch.desk = make_desk(self.bank.sensor.size, 2 * self.bank.sensor.axes, len(self.modes))
        return scratch.desk

    def _smoother(self) -> Any:
        scratch = self._scratch
        if not hasattr(scratch, "smoother"):
            scratch.smoother = pin(make_smoother(len(self.modes), self._program.angular.shape[1]))
        return scratch.smoother.handle

    def __getstate__(self) -> dict[str, Any]:
        """Pickled without compiled tables: addresses belong to one process."""
        return {"bank": self.bank, "name": self.name, "threads": self.threads}

    def run(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
        lengths: ArrayLike | None = None,
        *,
        prior: Prior | None = None,
        mode_transition: ArrayLike | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> Estimates:
        """Track everything: filtered estimates of B tracks.

        Args:
            measurements: (T, D) or (B, T, D); NaN where a component is missing.
            times: (T,) or (B, T); s; may be irregular, must not decrease.
            noise: R, (D, D), (T, D, D) or (B, T, D, D); None: the sensor's.
            sensor_states: sensor position and velocity, (2A,), (T, 2A) or (B, T, 2A); None: at the origin.
            lengths: rows per track (B,); later rows are padding.
            prior: explicit prior; None: start from the first measurement(s).
            mode_transition: Markov matrix per step, (M, M), (T, M, M) or (B, T, M, M); row t leads to row t.
            progress: called with the number of rows just finished.

        Returns:
            `Estimates` with leading (B, T). Rows before the start are STARTING, padding is MISSING.

        Raises:
            ValueError: a shape or a value does not fit.
        """
        inputs = check_inputs(
            self.bank, measurements, times, noise, sensor_states, lengths, mode_transition, caller="run"
        )
        _, outputs, _ = self._filter(inputs, prior, False, progress)
        return self._estimates(inputs, outputs)

    def smooth(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
        lengths: ArrayLike | None = None,
        *,
        prior: Prior | None = None,
        mode_transition: ArrayLike | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> Estimates:
        """Smoothed estimates: every row uses the whole track. Arguments, shapes and errors as `run`."""
        inputs = check_inputs(
            self.bank, measurements, times, noise, sensor_states, lengths, mode_transition, caller="smooth"
        )
        tracks, rows = inputs.measurements.shape[:2]
        states = self._program.angular.shape[1]
        chunk = max(1, int(_SMOOTHER_BYTES / (8.0 * max(rows, 1) * len(self.modes) * states * (states + 1))))
        parts = []
        for begin in range(0, max(tracks, 1), chunk):
            part = part_of_inputs(inputs, begin, min(begin + chunk, tracks))
            _, outputs, history = self._filter(
                part, part_of_prior(prior, begin, begin + part.measurements.shape[0]), True, progress
            )
            in_parallel(
                self.threads,
                lambda low, high, part=part, outputs=outputs, history=history: smooth_tracks(  # type: ignore[misc]
                    self._handle.handle, self._work(), self._smoother(), history, outputs, part, low, high
                ),
                part.measurements.shape[0],
                rows,
                None,
            )
            fill_outside(part, outputs, history, self.bank.start_probs)
            parts.append(self._estimates(part, outputs))
        return Estimates(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def start(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
        *,
        prior: Prior | None = None,
    ) -> State:
        """Begin one track from its first measurement(s), or from an explicit prior alone.

        Args:
            measurements: (D,) or (T, D): as many first rows as the sensor needs to locate the target.
            times: scalar or (T,); s.
            noise, sensor_states, prior: as in `run`.

        Returns:
            A `State` to hand to `step`. All rows given are used.

        Raises:
            ValueError: the rows do not locate the target (then give more rows, a prior, or an area).
        """
        z = np.atleast_2d(np.asarray(measurements, dtype=np.float64))
        inputs = check_inputs(
            self.bank, z, np.atleast_1d(np.asarray(times, dtype=np.float64)), noise, sensor_states, caller="start"
        )
        state, _, _ = self._filter(inputs, prior, False, None, must_start=True)
        return state

    def step(
        self,
        state: State,
        measurement: ArrayLike,
        time: float,
        noise: ArrayLike | None = None,
        sensor_state: ArrayLike | None = None,
    ) -> tuple[State, Estimates]:
        """One more measurement; the same numbers, bit for bit, as `run` over the same rows.

        Args:
            state: from `start` or the last `step`; left unchanged.
            measurement: (D,); NaN where a component is missing.
            time: s; a time before the state's own is treated as equal to it and reported as REPAIRED.
            noise: R (D, D); None: the sensor's.
            sensor_state: sensor position and velocity (2A,); None: at the origin.

        Returns:
            The next state, and `Estimates` without leading axes.

        Raises:
            ValueError: a shape does not fit.
        """
        self._check_state(state, "step")
        desk = self._desk()
        z = np.asarray(measurement, dtype=np.float64)
        R = self._noise if noise is None else np.asarray(noise, dtype=np.float64)
        sensor = self._still if sensor_state is None else np.asarray(sensor_state, dtype=np.float64)
        if z.shape != desk.measurement.shape or R.shape != desk.noise.shape or sensor.shape != desk.sensor.shape:
            raise ValueError(
                f"step: measurement must have shape {desk.measurement.shape}, noise {desk.noise.shape}, sensor_state "
                f"{desk.sensor.shape}; got {z.shape}, {R.shape}, {sensor.shape}. One row at a time."
            )
        desk.time[0] = time
        desk.measurement[:] = z
        desk.noise[:] = R
        desk.sensor[:] = sensor
        following = State(
            state.mean.copy(),
            state.cov.copy(),
            state.mode_probs.copy(),
            state.kin_mean.copy(),
            state.kin_cov.copy(),
            state.nis_average.copy(),
            state.refusals.copy(),
            state.time.copy(),
            state.phase.copy(),
            state.layout,
        )
        self._advance_row(desk, following)
        _, _, _, log_likelihood, nis, nis_dof, status, _ = desk.outputs.record
        axes = self.bank.sensor.axes
        mean = following.kin_mean[0].copy()
        return following, Estimates(
            following.time[0],
            mean[:axes],
            mean[axes:],
            following.kin_cov[0].copy(),
            following.mode_probs[0].copy(),
            log_likelihood[0, 0],
            nis[0, 0],
            nis_dof[0, 0],
            status[0, 0],
        )

    @property
    def intents(self) -> tuple[str, ...]:
        """Names of the intents, in the order of `intent_probs`."""
        return intent_names(self.bank)

    def intent_probs(self, estimates: Estimates) -> Floats:
        """Probability of each intent, whatever the noise; (B, T, I)."""
        return intent_probs(self.bank, getattr(estimates, "mode_probs", None))

    def surge_probability(self, estimates: Estimates) -> Floats:
        """Probability that the measurement noise is above its lowest level; (B, T).

        Raises:
            ValueError: a bank without several noise levels, or no estimates of it.
        """
        return surge_probability(self.bank, getattr(estimates, "mode_probs", None))

    def noise_scale(self, estimates: Estimates) -> Floats:
        """Expected factor on the measurement noise R; (B, T).

        Raises:
            ValueError: as `surge_probability`.
        """
        return noise_scale(self.bank, getattr(estimates, "mode_probs", None))

    def forecast(self, state: State, horizon: float, *, weights: str = "W1", steps: int = 1) -> tuple[Floats, Floats]:
        """Position ``horizon`` seconds ahead.

        Args:
            state: from `start`, `step` (or many tracks at once).
            horizon: s; >= 0.
            weights: ``"W1"``: the intent persists; ``"W2"``: mode probabilities of the chain at the horizon.
            steps: number of equal predictions the horizon is cut into (the unscented points are redrawn at each).

        Returns:
            Mean (A,) in m and covariance (A, A) in m^2; with a leading B for a state of B > 1 tracks.

        Raises:
            ValueError: a negative or infinite horizon, an unknown weighting, fewer than one step.
        """
        self._check_state(state, "forecast")
        if not (horizon >= 0 and np.isfinite(horizon)):
            raise ValueError(f"forecast: horizon must be >= 0 s and finite; got {horizon}. Give seconds ahead.")
        if weights not in ("W1", "W2"):
            raise ValueError(f"forecast: weights must be W1 (persist) or W2 (chain); got {weights!r}. Use W1.")
        if steps < 1 or steps != int(steps):
            raise ValueError(f"forecast: steps must be an integer >= 1; got {steps}. Use 1.")
        tracks, kin = state.kin_mean.shape
        mean, cov = np.zeros((tracks, kin)), np.zeros((tracks, kin, kin))
        forecast_states(
            self._handle.handle, self._work(), state, horizon / steps, int(steps), weights == "W2", mean, cov
        )
        axes = kin // 2
        if tracks == 1:
            return mean[0, :axes], cov[0, :axes, :axes]
        return mean[:, :axes], cov[:, :axes, :axes]

    def forecast_run(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        horizon: float,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
        lengths: ArrayLike | None = None,
        *,
        prior: Prior | None = None,
        weights: str = "W1",
        steps: int = 1,
    ) -> tuple[Floats, Floats]:
        """At every row, position ``horizon`` seconds ahead: mean (B, T, A), covariance (B, T, A, A).

        Arguments and errors as `run` and `forecast`.
        """
        states, estimates = self._states(
            check_inputs(self.bank, measurements, times, noise, sensor_states, lengths, caller="forecast_run"), prior
        )
        tracks, rows = estimates.status.shape
        mean, cov = self.forecast(states, horizon, weights=weights, steps=steps)
        axes = self.bank.sensor.axes
        return mean.reshape(tracks, rows, axes), cov.reshape(tracks, rows, axes, axes)

    def states(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
        lengths: ArrayLike | None = None,
        *,
        prior: Prior | None = None,
    ) -> tuple[State, Estimates]:
        """What the estimator knows after every row, to forecast from: arguments and errors as `run`.

        Returns:
            One `State` of B T tracks, row t of track b at index ``b T + t``, and the `Estimates` of `run`. Where the
            status is STARTING, or beyond a track's length, the state says nothing.
        """
        inputs = check_inputs(self.bank, measurements, times, noise, sensor_states, lengths, caller="states")
        return self._states(inputs, prior)

    def extrapolate(self, state: State, horizons: ArrayLike) -> Extrapolation:
        """Positions to come, apart by the mode now and the mode then: see `jink.estimators.extrapolation`.

        Args:
            state: from `start`, `step` or `states`; B tracks.
            horizons: seconds ahead, (H,) or (B, H); >= 0, not decreasing.

        Returns:
            weights (B, H, M, M), means (B, H, M, M, A) in m, covariances (B, H, M, M, A, A) in m^2.

        Raises:
            ValueError: a state of another bank, or horizons that are negative, infinite or decrease.
        """
        self._check_state(state, "extrapolate")
        ahead = np.atleast_1d(np.asarray(horizons, dtype=np.float64))
        fits = ahead.ndim == 1 or (ahead.ndim == 2 and len(ahead) == len(state.time))
        if not (fits and ahead.size and np.isfinite(ahead).all() and (np.diff(ahead, prepend=0.0) >= 0).all()):
            raise ValueError(
                "extrapolate: horizons must be seconds >= 0, finite, not decreasing, with shape (H,) or "
                f"({len(state.time)}, H); got {horizons!r}. Use np.arange(1, 21) * dt."
            )
        return extrapolate(self, state, ahead)

    def _states(self, inputs: Inputs, prior: Prior | None) -> tuple[State, Estimates]:
        state, outputs, history = self._filter(inputs, prior, True, None)
        many = outputs.status.size

        def flat(array: Floats) -> Floats:
            return np.ascontiguousarray(array.reshape(many, *array.shape[2:]))

        states = self._blank(many)._replace(
            mean=flat(history.mean),
            cov=flat(history.cov),
            mode_probs=flat(outputs.mode_probs),
            kin_mean=flat(outputs.kin_mean),
            kin_cov=flat(outputs.kin_cov),
            time=flat(np.broadcast_to(inputs.times, outputs.status.shape)),
            layout=state.layout,
        )
        return states, self._estimates(inputs, outputs)

    @cached_property
    def _noise(self) -> Floats:
        return self.bank.sensor.noise

    @cached_property
    def _still(self) -> Floats:
        return np.zeros(2 * self.bank.sensor.axes)

    def _history(self, tracks: int, rows: int) -> History:
        modes, states = len(self.modes), self._program.angular.shape[1]
        return History(np.zeros((tracks, rows, modes, states)), np.zeros((tracks, rows, modes, states, states)))

    def _filter(
        self,
        inputs: Inputs,
        prior: Prior | None,
        keep: bool,
        progress: Callable[[int], None] | None,
        must_start: bool = False,
    ) -> tuple[State, Outputs, History]:
        tracks, rows = inputs.measurements.shape[:2]
        kin, modes = 2 * self.bank.sensor.axes, len(self.modes)
        state = self._blank(tracks)
        started: StartBatch | None = None
        if prior is None:
            started = locate(self.bank, inputs)
            if must_start and not started.ok.all():
                raise ValueError(
                    f"start: measurements must locate the target; {rows} row(s) of {self.bank.sensor.name} do not. "
                    "Give more rows, a prior, or an area in the bank."
                )
            inputs.first[:] = started.index
            used = started.seen > 0
            if rows:
                state.time[:] = np.take_along_axis(
                    np.broadcast_to(inputs.times, (tracks, rows)), np.minimum(inputs.first, rows - 1)[:, None], axis=1
                )[:, 0]
            state.phase[:] = np.where(used, LOCATED, PRIOR)
            begin_at_measurements(
                self.bank, started, inputs, self._program.noise_scale, self._handle.handle, self._work(), state
            )
        else:
            take_prior(self.bank, prior, self._handle.handle, self._work(), state, inputs.times)
        outputs = make_outputs(tracks, rows, kin, modes)
        history = self._history(tracks, rows if keep else 0)
        in_parallel(
            self.threads,
            lambda low, high: self._advance(state, inputs, outputs, history, low, high),
            tracks,
            rows,
            progress,
        )
        if started is not None:
            nothing = (started.seen == 0) & ~outputs.nis_dof.any(axis=1)
            outputs.status[nothing] = STARTING
        fill_outside(inputs, outputs, history, self.bank.start_probs)
        return state, outputs, history

    def _advance(self, state: State, inputs: Inputs, outputs: Outputs, history: History, low: int, high: int) -> None:
        """All rows of tracks ``low`` to ``high``."""
        advance(self._handle.handle, self._work(), state, inputs, outputs, history, low, high)

    def _advance_row(self, desk: Desk, state: State) -> None:
        """The row on the desk."""
        advance_one(self._handle.handle, self._work(), desk.inputs.handle, desk.outputs.handle, state)

    def _blank(self, tracks: int) -> State:
        sensor = self.bank.sensor
        state = make_state(tracks, len(self.modes), self._program.angular.shape[1], 2 * sensor.axes, sensor.size)
        state.mode_probs[:] = self.bank.start_probs
        state.layout[:] = self._layout
        return state

    @cached_property
    def _layout(self) -> int:
        """Number that tells this bank's states from those of another."""
        modes = [(mode.name, mode.motion.labels, mode.treatments) for mode in self.bank.modes]
        return zlib.crc32(repr((self.bank.sensor.axes, self.bank.sensor.size, modes)).encode())

    def _check_state(self, state: State, caller: str) -> None:
        """A state of another bank would be read with the wrong sizes."""
        if not isinstance(state, State) or state.layout.shape != (1,) or state.layout[0] != self._layout:
            found = "that of another bank" if isinstance(state, State) else type(state).__name__
            raise ValueError(
                f"{caller}: state must come from start or step of an estimator with modes {', '.join(self.modes)} in "
                f"{self.bank.sensor.axes} axes; got {found}. "
                "Call start again."
            )

    def _estimates(self, inputs: Inputs, outputs: Outputs) -> Estimates:
        axes = self.bank.sensor.axes
        return Estimates(
            np.array(np.broadcast_to(inputs.times, outputs.status.shape)),
            outputs.kin_mean[..., :axes],
            outputs.kin_mean[..., axes:],
            outputs.kin_cov,
            outputs.mode_probs,
            outputs.log_likelihood,
            outputs.nis,
            outputs.nis_dof,
            outputs.status,
        )
