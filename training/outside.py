"""An estimator that somebody else wrote, with the interface of ours: `OutsideEstimator`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.api import Estimates
from jink.estimators.inputs import Prior, check_inputs
from jink.estimators.records import Inputs
from jink.estimators.sensor import Sensor
from jink.estimators.status import DIVERGED, MISSING, OK, STARTING
from jink.training.reported import Reported, read_reported, track_arrays

__all__ = ["OutsideEstimator", "WholeTrack", "without_unreported"]

Floats = NDArray[np.float64]
_START = ("measurements", "times", "noise", "sensor_states", "prior")
_STEP = ("state", "measurement", "time", "noise", "sensor_state")


class _WrongParametersError(TypeError):
    """A signature asks for what nobody has; says what there is."""


class WholeTrack(NamedTuple):
    """A function of one whole track: ``track(measurements, times, noise, sensor_states)``, any of them, by name."""

    track: Callable[..., Any]


class _Sizes(NamedTuple):
    """What `check_inputs` reads of a bank."""

    sensor: Sensor
    modes: tuple[str, ...]


class _One(NamedTuple):
    """One track without padding: measurements (T, D), times (T,), noise (T, D, D), sensor_states (T, 2A), prior."""

    measurements: Floats
    times: Floats
    noise: Floats
    sensor_states: Floats
    prior: tuple[Floats, Floats] | None

    def head(self, rows: int) -> tuple[Any, ...]:
        """The first rows."""
        return (*(column[:rows] for column in self[:4]), self.prior)


class OutsideEstimator:
    """What a third-party class or function made, completed to what every estimator reports.

    One of three forms is enough:

    * ``start(measurements, times, noise, sensor_states)`` -> ``(state, estimate)``, or None while the rows so far do
      not suffice; then ``step(state, measurement, time, noise, sensor_state)`` -> ``(state, estimate)``. The state is
      a value: `step` must not change it.
    * ``run(measurements, times, noise, sensor_states, lengths)`` of B tracks at once -> estimates (B, T, ...).
    * a function ``(measurements, times, noise, sensor_states)`` of one track -> estimates (T, ...).

    Parameters are passed by name, and those that a signature leaves out are not passed. All forms can also ask for
    ``prior``: mean (2A,) and covariance (2A, 2A) of position and velocity at the first row, before its measurement; the
    benchmark gives one to every estimator, elsewhere it is None. An estimate is a position
    alone, or a mapping or object with ``position`` and any of velocity, covariance, mode_probs, log_likelihood, nis,
    nis_dof, status. What is left out is NaN (velocity, covariance) or absent (nis_dof 0), so that no score is made
    from it; a position that is not finite is replaced by the one before it and marked DIVERGED.

    Args:
        made: what the third party's function returned.
        sensor: what is measured.
        name: shown in tables.

    Raises:
        ValueError: none of the forms; later, whatever it does that an estimator must not, in one sentence.
    """

    def __init__(self, made: Any, sensor: Sensor, name: str) -> None:
        self.made, self.sensor, self.name = made, sensor, name
        self.streams = callable(getattr(made, "start", None)) and callable(getattr(made, "step", None))
        self.batches = callable(getattr(made, "run", None))
        self._track = made.track if isinstance(made, WholeTrack) else made
        if not (self.streams or self.batches or callable(self._track)):
            raise ValueError(
                f"{name}: result must be a function of a track, or have run, or start and step; got "
                f"{type(made).__name__}. See docs/extending.md."
            )
        self._copies = True
        modes = getattr(made, "modes", None)
        self.modes: tuple[str, ...] = tuple(map(str, modes)) if modes else ("estimator",)

    def without_copies(self) -> OutsideEstimator:
        """The same, handing on arrays themselves instead of copies: shows who writes into them."""
        plain = OutsideEstimator(self.made, self.sensor, self.name)
        plain._copies = False
        return plain

    def _own(self, array: Any) -> Any:
        return array.copy() if self._copies and isinstance(array, np.ndarray) else array

    def run(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
        lengths: ArrayLike | None = None,
        *,
        prior: Prior | None = None,
    ) -> Estimates:
        """Filtered estimates of B tracks: arguments and shapes as `jink.estimators.api.BankEstimator.run`."""
        sizes: Any = _Sizes(self.sensor, self.modes)
        inputs = check_inputs(sizes, measurements, times, noise, sensor_states, lengths, caller=self.name)
        priors = _priors(prior, len(inputs.measurements))
        raw = self._batch(inputs, priors) if self.batches else [self._one(t) for t in _tracks(inputs, priors)]
        return self._complete(inputs, raw)

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
    ) -> tuple[Floats, Floats]:
        """At every row, position ``horizon`` s ahead: straight on at the velocity reported; NaN without one.

        Returns:
            Mean (B, T, A) in m; a covariance (B, T, A, A) of NaN, for nothing is known of it.
        """
        found = self.run(measurements, times, noise, sensor_states, lengths, prior=prior)
        axes = self.sensor.axes
        return found.position + horizon * found.velocity, np.full((*found.status.shape, axes, axes), np.nan)

    def start(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
    ) -> Any:
        """Begin one track from its first rows; all rows given are used.

        Raises:
            ValueError: it does not stream, or the rows do not suffice.
        """
        found = self.begin(measurements, times, noise, sensor_states)
        if found is None:
            raise ValueError(
                f"{self.name}: rows must suffice to start; got {len(np.atleast_1d(times))}. Give more of them."
            )
        return found[0]

    def begin(
        self,
        measurements: ArrayLike,
        times: ArrayLike,
        noise: ArrayLike | None = None,
        sensor_states: ArrayLike | None = None,
    ) -> tuple[Any, Estimates] | None:
        """State and estimate after a track's first rows; None where they do not suffice to start."""
        self._must_stream("start")
        z = np.atleast_2d(np.asarray(measurements, dtype=np.float64))
        at = np.atleast_1d(np.asarray(times, dtype=np.float64))
        sizes: Any = _Sizes(self.sensor, self.modes)
        (track,) = _tracks(check_inputs(sizes, z, at, noise, sensor_states, caller="start"), None)
        state = said = None
        for state, said in self.follow(track):  # noqa: B007 - the last pair is what is wanted
            pass
        if said is None:
            return None
        return state, self._single(said, z[-1], float(at[-1]))

    def step(
        self,
        state: Any,
        measurement: ArrayLike,
        time: float,
        noise: ArrayLike | None = None,
        sensor_state: ArrayLike | None = None,
    ) -> tuple[Any, Estimates]:
        """One more measurement: the next state, and `Estimates` without leading axes.

        Raises:
            ValueError: it does not stream, or fails.
        """
        self._must_stream("step")
        z = np.array(measurement, dtype=np.float64)
        R = self.sensor.noise if noise is None else np.asarray(noise, dtype=np.float64)
        place = np.zeros(2 * self.sensor.axes) if sensor_state is None else np.asarray(sensor_state, dtype=np.float64)
        following, said = self._step(state, z, float(time), R, place)
        return following, self._single(said, z, float(time))

    def _single(self, said: Any, z: Floats, time: float) -> Estimates:
        """`Estimates` without leading axes."""
        one = read_reported(said, (), self.sensor.axes, self.modes, self.name).lifted()
        done = self._sound(one, np.array([np.isfinite(z).sum()]), np.array([True]))
        return Estimates(np.float64(time), *(column[0] for column in done))  # type: ignore[arg-type]

    def follow(self, track: _One) -> Iterator[tuple[Any, Any]]:
        """State and estimate after each row of a track; (None, None) until it has started."""
        state: Any = None
        begun = False
        for row in range(len(track.times)):
            if begun:
                state, estimate = self._step(
                    state, track.measurements[row], float(track.times[row]), track.noise[row], track.sensor_states[row]
                )
                yield state, estimate
                continue
            if np.isfinite(track.measurements[: row + 1]).any():
                given = dict(zip(_START, map(self._own, track.head(row + 1)), strict=True))
                first = self._call("start", self.made.start, given)
                if first is not None:
                    begun = True
                    state, estimate = self._pair("start", first)
                    yield state, estimate
                    continue
            yield None, None

    def _step(self, state: Any, z: Floats, time: float, R: Floats, place: Floats) -> tuple[Any, Any]:
        given = dict(zip(_STEP, (state, self._own(z), time, self._own(R), self._own(place)), strict=True))
        return self._pair("step", self._call("step", self.made.step, given))

    def _pair(self, method: str, found: Any) -> tuple[Any, Any]:
        if not (isinstance(found, tuple) and len(found) == 2):
            raise ValueError(
                f"{self.name}: {method} must return (state, estimate); got {type(found).__name__}. Return both."
            )
        return found

    def _must_stream(self, method: str) -> None:
        if not self.streams:
            raise ValueError(
                f"{self.name}: estimator must have start and step for {method}; got one that takes whole tracks. "
                "Add both, or leave out what needs them."
            )

    def _call(self, method: str, function: Callable[..., Any], given: dict[str, Any]) -> Any:
        """Call with the arguments that it names; whatever it raises becomes one sentence."""
        from jink.training.loading import said

        try:
            with np.errstate(all="ignore"):
                return function(**_accepted(function, given))
        except _WrongParametersError as error:
            raise ValueError(f"{self.name}: {method} must name its parameters as they are; {error}") from error
        except (Exception, SystemExit) as error:  # who calls exit() must not end the benchmark
            raise ValueError(f"{self.name}: {method} must not raise; got {said(error)}. Mend it.") from error

    def _batch(self, inputs: Inputs, priors: tuple[Floats, Floats] | None) -> list[tuple[Reported, int]]:
        tracks, rows = inputs.measurements.shape[:2]
        D, kin = self.sensor.size, 2 * self.sensor.axes
        given = {
            "measurements": self._own(inputs.measurements),
            "times": np.array(np.broadcast_to(inputs.times, (tracks, rows))),
            "noise": np.array(np.broadcast_to(inputs.noise, (tracks, rows, D, D))),
            "sensor_states": np.array(np.broadcast_to(inputs.sensors, (tracks, rows, kin))),
            "lengths": inputs.lengths.copy(),
            "prior": priors,
        }
        found = self._call("run", self.made.run, given)
        many = read_reported(found, (tracks, rows), self.sensor.axes, self.modes, self.name)
        return [(many.cut(b, int(n)), _first_seen(inputs, b)) for b, n in enumerate(inputs.lengths)]

    def _one(self, track: _One) -> tuple[Reported, int]:
        """What is reported of one track, and the row it starts at."""
        rows = len(track.times)
        if not self.streams:
            if rows == 0:
                return track_arrays([], self.sensor.axes, self.modes), 0
            given = dict(zip(_START, map(self._own, track), strict=True))
            found = self._call("track", self._track, given)
            seen = np.isfinite(track.measurements).any(axis=1)
            return (
                read_reported(found, (rows,), self.sensor.axes, self.modes, self.name),
                int(np.argmax(seen)) if seen.any() else rows,
            )
        found = [estimate for _, estimate in self.follow(track)]
        first = next((row for row, estimate in enumerate(found) if estimate is not None), rows)
        read = [read_reported(e, (), self.sensor.axes, self.modes, self.name) for e in found[first:]]
        return track_arrays(read, self.sensor.axes, self.modes, before=first), first

    def _complete(self, inputs: Inputs, raw: list[tuple[Reported, int]]) -> Estimates:
        tracks, rows = inputs.measurements.shape[:2]
        whole = track_arrays([], self.sensor.axes, self.modes, before=rows)
        columns: list[Any] = [np.repeat(np.asarray(column)[None], tracks, axis=0) for column in whole]
        statuses = np.full((tracks, rows), MISSING, dtype=np.int8)
        dofs = np.zeros((tracks, rows), dtype=np.int64)
        for b, (reported, first) in enumerate(raw):
            n = int(inputs.lengths[b])
            seen = np.isfinite(inputs.measurements[b, :n]).sum(axis=1)
            sound = self._sound(reported, seen, np.arange(n) >= first)
            for column, value in zip(columns, sound[:6], strict=False):
                column[b, :n] = value
                if 0 < n < rows:
                    column[b, n:] = value[-1]
            dofs[b, :n], statuses[b, :n] = sound[6], sound[7]
        times = np.array(np.broadcast_to(inputs.times, (tracks, rows)))
        position, velocity, covariance, probs, log_likelihood, nis = columns[:6]
        return Estimates(times, position, velocity, covariance, probs, log_likelihood, nis, dofs, statuses)

    def _sound(self, reported: Reported, seen: NDArray[np.int64], begun: NDArray[np.bool_]) -> tuple[Any, ...]:
        """The columns of `Estimates` after the times; rows before the start repeat the first estimate."""
        position, velocity, covariance, probs, log_likelihood, nis, dof, status = (np.array(c) for c in reported)
        wild = begun & ~np.isfinite(position).all(axis=1)
        told = begun & np.isfinite(velocity).all(axis=1)
        if told.any():  # a start need not know the velocity; who loses it later is lost
            wild |= begun & ~told & (np.arange(len(begun)) > int(np.argmax(told)))
            velocity = np.where(told[:, None], velocity, _held(np.where(told[:, None], velocity, 0.0), begun))
        position = _held(position, begun & ~wild)
        velocity[~begun] = np.nan if not begun.any() else velocity[begun][0]
        covariance[~begun] = np.nan if not begun.any() else covariance[begun][0]
        judged = begun & (seen > 0) & np.isfinite(nis)
        dof = np.where(judged, np.where(dof > 0, dof, seen), 0)
        codes = np.where(status >= 0, status, np.where(seen > 0, OK, MISSING))
        codes = np.where(wild, DIVERGED, np.where(begun, codes, STARTING)).astype(np.int8)
        nis = np.where(judged, nis, 0.0)
        log_likelihood = np.where(begun & (seen > 0) & np.isfinite(log_likelihood), log_likelihood, 0.0)
        return position, velocity, covariance, probs, log_likelihood, nis, dof, codes


def without_unreported(scores: dict[str, float], estimates: Any) -> dict[str, float]:
    """Scores of what an estimator does not report at all become NaN, "not measured"; they would read as infinite."""
    lost = []
    if np.size(estimates.covariance) and not np.isfinite(estimates.covariance).any():
        lost += [name for name in scores if "nees" in name]
    if np.size(estimates.velocity) and not np.isfinite(estimates.velocity).any():
        lost += [name for name in scores if name.startswith(("velocity", "nees"))]
    return scores | dict.fromkeys(lost, float("nan"))


def _held(values: Any, good: Any) -> Floats:
    """Rows that are not good repeat the last good one; those before the first, the first; zeros without any."""
    if not good.any():
        return np.zeros_like(values)
    index = np.where(good, np.arange(len(good)), -1)
    index = np.maximum.accumulate(index)
    return np.asarray(values[np.where(index < 0, int(np.argmax(good)), index)])


def _first_seen(inputs: Inputs, b: int) -> int:
    seen: Any = np.isfinite(inputs.measurements[b, : inputs.lengths[b]]).any(axis=1)
    return int(np.argmax(seen)) if seen.any() else len(seen)


def _priors(prior: Prior | None, tracks: int) -> tuple[Floats, Floats] | None:
    """Means (B, 2A) and covariances (B, 2A, 2A)."""
    if prior is None:
        return None
    mean, cov = np.asarray(prior.mean, dtype=np.float64), np.asarray(prior.cov, dtype=np.float64)
    kin = mean.shape[-1]
    return np.array(np.broadcast_to(mean, (tracks, kin))), np.array(np.broadcast_to(cov, (tracks, kin, kin)))


def _tracks(inputs: Inputs, priors: tuple[Floats, Floats] | None) -> Iterator[_One]:
    tracks, rows, D = inputs.measurements.shape
    times = np.broadcast_to(inputs.times, (tracks, rows))
    noise = np.broadcast_to(inputs.noise, (tracks, rows, D, D))
    places = np.broadcast_to(inputs.sensors, (tracks, rows, inputs.sensors.shape[-1]))
    for b, length in enumerate(inputs.lengths):
        prior = None if priors is None else (priors[0][b], priors[1][b])
        yield _One(inputs.measurements[b, :length], times[b, :length], noise[b, :length], places[b, :length], prior)


def _accepted(function: Callable[..., Any], given: dict[str, Any]) -> dict[str, Any]:
    """Those arguments that the function's parameters name; all of them where it takes any."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return given
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters):
        return given
    names = {p.name for p in parameters}
    missing = [p.name for p in parameters if p.default is p.empty and p.kind is not p.VAR_POSITIONAL]
    wrong = [name for name in missing if name not in given]
    if wrong:
        raise _WrongParametersError(
            f"got {', '.join(wrong)}, which cannot be filled in. Name them as these are: {', '.join(given)}; "
            "give others a default, leave out what is not needed."
        )
    return {name: value for name, value in given.items() if name in names}
