"""`jink/ManoeuvringTarget-v0`: say where the target is. Any filter and any network is a policy."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes, Source
from jink.envs.estimate_scoring import judge
from jink.envs.observing import Layout, nominal_sigma, seen_positions, since_switch
from jink.envs.task import ActionError, Array, Outcome, Picture, Rows

__all__ = ["ManoeuvringTargetTask"]

CAP = 10.0
"""Largest penalty of one decision."""


class _Columns(NamedTuple):
    """Where things are in the record of a sample: one gather fetches them all."""

    observation: slice
    position: slice
    velocity: slice
    estimate: slice
    time: int
    since: int
    intent: int
    scale: int
    sigma: int
    detected: int
    score: int
    width: int

    @classmethod
    def of(cls, layout: Layout) -> _Columns:
        width, A = layout.width, layout.axes
        position, velocity, estimate = (slice(width + i * A, width + (i + 1) * A) for i in range(3))
        return cls(slice(0, width), position, velocity, estimate, *range(width + 3 * A, width + 3 * A + 8))


class ManoeuvringTargetTask:
    """Estimate the position of a manoeuvring target from noisy measurements, one decision per measurement.

    ## Description
    A target flies, drives or sails under a chain of intents: it goes straight, turns, weaves, brakes, and changes its
    mind without notice. A sensor sees it at (possibly irregular) times, misses it now and then, and its noise surges.
    After every measurement the agent says where the target is. Estimators of `jink.estimators` are policies here
    (`jink.envs.policies.EstimatorPolicy`), so that a learned tracker and an IMM are judged by the same numbers.

    ## Observation Space
    A `Box` of float64, with D measurement components and A space dimensions:

    | part | size | meaning | range |
    |---|---|---|---|
    | measurement | D | each component divided by its unit; 0 where missing | +-2^20 |
    | time step | 1 | s since the previous sample, 0 at the first | 0 .. 2^20 |
    | detected | D | 1 where the component was measured, 0 where it is missing | 0 .. 1 |
    | sensor | 2 A | the sensor's own position and velocity, divided by their units | +-2^20 |

    The unit of a distance is ``layout.scale`` m, that of a speed ``layout.speed_scale`` m/s, that of an angle 1 rad.
    The last part is there only for sensors that measure from their own place (range, bearing, ...).
    Both scales are powers of two, so that multiplying by them gives the measurement back exactly.
    A measurement beyond 2^20 scales is cut off there.

    ## Action Space
    `Box(-1, 1, (A,), float32)`: the estimated position divided by ``layout.scale``, which is at least twice the largest
    coordinate of any target. `step` uses float64 arrays as they are, so that an estimate loses nothing.

    ## Rewards
    ``-min(error / sigma, 10)``: the distance between estimate and truth over sigma, the root mean square error that an
    undisturbed measurement of the sensor has at the target's range. -1 is therefore about what repeating the
    measurement earns in quiet noise, and 0 is perfect. The truth is that of the moment the measurement is delivered.
    Losing the track costs 10 for each decision left, so that giving up never pays. A sample whose truth is not known
    (recorded tracks) gives 0.

    ## Starting State
    A target drawn by the scenario from the environment's generator; the first observation is its first measurement.

    ## Episode End
    - Terminated: the track is lost, that is the error exceeded ``lost_after`` sigma for ``lost_steps`` decisions in a
      row.
    - Truncated: the decision at the last sample but one has been taken; the last observation shows the last sample.

    ## Arguments
    ``scenario``, ``suite`` or ``tracks`` choose what happens, other keywords change the scenario's parameters.
    ``lost_after`` (default 100 sigma) and ``lost_steps`` (default 10) say when a track is lost.

    ## Info
    ``time`` s; ``position``, ``velocity`` the truth, m and m/s; ``intent`` its index in ``rollout.source.intents``;
    ``since_switch`` s since the last change of intent (or the start); ``noise_scale`` the factor on the nominal noise
    covariance; ``sigma`` m, the scale of the reward; ``detected``; all of the sample observed. ``error`` m is that of
    the decision just taken, 0 before any.

    ## Version History
    * v0: first version.

    Args:
        source: where episodes come from.
        count: number of targets B.
        lost_after: sigma beyond which an estimate is far off.
        lost_steps: decisions in a row after which the track is lost.

    Raises:
        ValueError: an option out of range.
    """

    def __init__(self, source: Source, count: int, *, lost_after: float = 100.0, lost_steps: int = 10) -> None:
        if not (lost_after > 0 and lost_steps >= 1 and lost_steps == int(lost_steps)):
            raise ValueError(
                f"make: lost_after must be > 0 sigma and lost_steps an integer >= 1; got {lost_after}, {lost_steps}. "
                "Use math.inf for a track that is never lost."
            )
        self.source = source
        self.count = count
        self.layout = Layout.of(source)
        self.observation_space = self.layout.space()
        self.action_space: gymnasium.spaces.Box = gymnasium.spaces.Box(-1.0, 1.0, (source.axes,), np.float32)
        self._columns = _Columns.of(self.layout)
        self._samples = np.zeros((count, source.steps, self._columns.width))
        c = self._columns
        self._judging = (
            (c.position.start, c.estimate.start, c.sigma, c.score),
            (self.layout.scale, float(lost_after), float(lost_steps), CAP),
        )
        self._off = np.zeros(source.axes)
        self._streak = np.zeros(count, dtype=np.int64)
        self._error = np.zeros(count)
        self._every = np.arange(count)
        self._ends = np.full(count, source.steps - 1)
        self._drawn: dict[int, tuple[Array, Array]] = {}

    def check_actions(self, actions: Any, caller: str) -> NDArray[Any]:
        """The estimates (B, A) as float64.

        Raises:
            ValueError: wrong shape or type, not finite, or outside -1 .. 1.
        """
        shape = (self.count, self.source.axes)
        try:
            array = np.asarray(actions)
        except ValueError:
            array = np.empty(0, dtype=object)
        if array.shape != shape or array.dtype.kind not in "fiu":
            remedy = "Divide the estimated position by layout.scale."
            raise ActionError.shaped(caller, "numbers", array if array.size else None, shape, remedy)
        places = array.astype(np.float64)  # before abs: the most negative integer has no absolute value
        if not np.abs(places).max() <= 1.0:
            row = int(np.argmin((np.abs(places) <= 1.0).all(axis=1)))
            remedy = "Clip the estimate divided by layout.scale."
            raise ActionError.valued(caller, "be finite and within -1 .. 1", array[row].tolist(), row, remedy)
        return places

    def begin(self, rows: Rows, episodes: Episodes) -> None:
        """Rows start new episodes."""
        c, A = self._columns, self.source.axes
        samples = np.empty((len(rows), self.source.steps, c.width))
        samples[:, :, c.observation] = self.layout.observe(episodes)
        samples[:, :, c.position] = episodes.delivered.position
        samples[:, :, c.velocity] = episodes.delivered.velocity
        samples[:, :, c.time] = episodes.times
        samples[:, :, c.intent] = episodes.delivered.intent
        samples[:, :, c.since] = since_switch(episodes.delivery_times, episodes.delivered.switch_times)
        samples[:, :, c.scale] = episodes.scale
        samples[:, :, c.detected] = episodes.detected
        separation = episodes.delivered.position - episodes.sensor_states[:, :, :A]
        samples[:, :, c.sigma] = nominal_sigma(self.source.sensor, separation)
        samples[:, :, c.estimate] = np.nan
        samples[:, :, c.score] = 0.0
        self._samples[rows] = samples
        self._streak[rows] = 0
        self._ends[rows] = self.source.steps - 1
        self._error[rows] = 0.0
        if self._drawn:
            for row in rows.tolist():
                self._drawn.pop(row, None)

    def end_early(self, rows: Rows, ends: Rows) -> None:
        """The episodes just begun end at samples ``ends``: no decision after them is lost with a track."""
        self._ends[rows] = ends

    def step(self, actions: NDArray[Any], k: Rows, live: NDArray[np.bool_]) -> Outcome:
        """Judge the estimates of sample ``k[b]``."""
        reward, lost = np.empty(self.count), np.empty(self.count, dtype=np.bool_)
        columns, limits = self._judging
        judge(
            actions, k, live, self._ends, self._samples, columns, limits,
            self._off, self._streak, self._error, reward, lost,
        )  # fmt: skip
        return Outcome(reward, lost)

    def observe(self, k: Rows) -> NDArray[Any]:
        """Observations (B, O) of sample ``k[b]``."""
        return self._samples[self._every, k, self._columns.observation]

    def info(self, k: Rows) -> dict[str, NDArray[Any]]:
        """See *Info* in the class's documentation."""
        c = self._columns
        now = self._samples[self._every, k]
        return {
            "time": now[:, c.time].copy(),
            "position": now[:, c.position].copy(),
            "velocity": now[:, c.velocity].copy(),
            "intent": now[:, c.intent].astype(np.int64),
            "since_switch": now[:, c.since].copy(),
            "noise_scale": now[:, c.scale].copy(),
            "sigma": now[:, c.sigma].copy(),
            "detected": now[:, c.detected] > 0.0,
            "error": self._error.copy(),
        }

    def picture(self, row: int, k: int) -> Picture:
        """Everything up to sample ``k`` of one target."""
        c, A = self._columns, self.source.axes
        if row not in self._drawn:
            seen = self.layout.read(self._samples[row, :, c.observation])
            self._drawn[row] = (
                seen_positions(self.source.sensor, seen.measurement, seen.sensor_state),
                seen.sensor_state,
            )
        seen_at, sensor = self._drawn[row]
        past = self._samples[row, : k + 1]
        return Picture(
            title=self.source.id,
            times=past[:, c.time].copy(),
            truth=past[:, c.position].copy(),
            seen=seen_at[: k + 1].copy(),
            estimate=past[:, c.estimate].copy(),
            covariance=np.full((A, A), np.nan),
            sensor=sensor[k, :A].copy(),
            intents=self.source.intents,
            intent=past[:, c.intent].astype(np.int8),
            scale=past[:, c.scale].copy(),
            choices=(),
            choice=np.full(k + 1, -1, dtype=np.int64),
            score=past[:, c.score].copy(),
        )
