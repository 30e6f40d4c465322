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
from jink.envs.task import ActionError, Array, Outcome, Picture, Rows
from jink.estimators.agent import looking
from jink.estimators.agent.lookback import kept_size
from jink.estimators.agent.policy import COVARIANCES
from jink.estimators.factors import Factor, make_factor

__all__ = ["FACTORS_OFFERED", "LARGEST_LOG_INFLATION", "TOLD", "AdaptiveFactorTask"]

FACTORS_OFFERED = ("none", "mr", "huber", "rma", "mahalanobis")
"""Actions of `jink/AdaptiveFactor-v0`, in order."""
LARGEST_LOG_INFLATION = looking.LARGEST_LOG_INFLATION
TOLD = kernels.TOLD
"""Columns that ``informed=True`` appends to an observation."""
_LOSSES = {
    "distance": kernels.DISTANCE,
    "squared": kernels.SQUARED,
    "log": kernels.LOG,
    "regret": kernels.REGRET,
    "log-regret": kernels.LOG_REGRET,
}
_LOWEST, _HIGHEST, _LEAST_GAIN = -10.0, 100.0, 0.1


class AdaptiveFactorTask:
    """Choose how far a tracking filter distrusts each measurement, one decision per measurement.

    ## Description
    A Kalman filter tracks a target; the noise of its sensor surges without notice, in bursts, in isolated gross
    outliers, or in heavy tails. An innovation that is too large may be noise, which the filter should ignore, or a
    manoeuvre, which it should follow. The agent sees the innovation of a measurement and then chooses the adaptive
    factor that turns the nominal noise R into the R~ the update uses (or, in the continuous variant, how much to
    inflate R). Two references run beside the agent's filter, equal but for their R: the *nominal* filter always uses
    R, the *oracle* knows the true noise of every measurement.

    ## Observation Space
    A `Box` of float32 with A space dimensions. Squashed means ``x / (1 + |x| / 5)``; D^2 is the innovation
    squared over its covariance with nominal R, d the components measured.

    | part | size | meaning | range |
    |---|---|---|---|
    | innovation | A | whitened by the Cholesky factor of its covariance, squashed; 0 where missing | -5 .. 5 |
    | drift | A | running average of the former, 4 detections: a manoeuvre pushes one way, noise does not | -5 .. 5 |
    | log NIS | 1 | ``ln(D^2 / d + 0.01) / 2``; 0 where nothing was measured | -5 .. 5 |
    | short average | 1 | of the former, 4 detections | -5 .. 5 |
    | long average | 1 | of the former, 20 detections | -5 .. 5 |
    | silence | 1 | samples since the last detection (0: detected now), squashed | 0 .. 5 |
    | uncertainty | 1 | ``tr H P H' / tr S``: about the gain of the nominal filter; 0 where missing | 0 .. 1 |
    | modes | M | probabilities of the filter's modes; none for the single-model filters | 0 .. 1 |
    | last action | choices | one-hot, zeros at first; in the continuous variant the action itself | 0 .. 1 (-1 .. 1) |

    Averages move by a quarter and a twentieth of the difference; they include the measurement shown.

    ``view="levels"`` shows 22 numbers without direction, the same for every sensor and space, with r the innovation in
    nominal sigmas (``v' R^-1 v``), and beliefs about the noise level (`jink.estimators.agent.beliefs`):

    | part | size | meaning | range |
    |---|---|---|---|
    | log NIS | 1 | ``ln(D^2 / d + 0.01) / 2`` | -10 .. 10 |
    | log size | 1 | ``ln(r / d + 0.01) / 2`` | -10 .. 10 |
    | log uncertainty | 1 | ``ln(u + 0.001) / 2``, u the mean of ``(H P H')_ii / R_ii`` | -10 .. 10 |
    | averages | 6 | of the first and of the second, over 3, 10 and 30 detections | -10 .. 10 |
    | along | 1 | cosine of the innovation with the drift, times the drift's length | -1 .. 1 |
    | drift | 1 | length of the average direction of 4 innovations: near 1 in a manoeuvre | 0 .. 1 |
    | silence | 1 | as above | 0 .. 5 |
    | belief | 8 | probability that R is multiplied by 1, 4, 16, ..., 16 384 | 0 .. 1 |
    | advice | 1 | log inflation (over ln 1e6) whose gain is the mean over the belief | 0 .. 1 |
    | last inflation | 1 | log inflation used with the last measurement, over ln 1e6 | 0 .. 1 |

    ``informed=True`` appends five numbers that only a simulator knows, within -30 .. 30, for the critic of an
    actor-critic algorithm; an actor must not see them: ``ln(0.01 + e / sigma)`` of the errors e of the agent and of
    the oracle in the last decision, the logarithm of the true factor on the noise, ``ln c`` (see *Rewards*), and
    ``(e_agent - e_oracle) / (sigma c)``. They are 0 where the truth is not known.

    With ``covariance="mixture"`` the agent's filter becomes as sure of its estimate as that belief allows, instead of
    as sure as the noise chosen says; action -1 is then not exactly the nominal filter.

    With ``lookback=True`` the filter judges the noise of its last measurement again when the next one comes, with both
    innovations, and corrects its prediction before the next is observed (`jink.estimators.agent.lookback`): the
    decision stays one per measurement, and what the filter believed wrongly is taken back once. Unless both
    measurements are ordinary, the gain of a decision is then replaced by the mean gain of what is believed: so a
    decision matters most for the estimate it was made for.

    ## Action Space
    `Discrete`: the number of a factor: 0 none, 1 mr, 2 huber, 3 rma, 4 mahalanobis, or what ``factors`` lists
    (`jink.estimators.factors.FACTORS`). Continuous: `Box(-1, 1, (1,), float32)`; R is multiplied by a factor of 1 at
    -1 to a million at 1, linearly in its logarithm. A sample without a measurement is only predicted, whatever the
    action.

    ## Rewards
    ``(e_nominal - e_agent) / c``: how much closer the agent's estimate is than the nominal filter's, e the distance
    to the truth at the time of the measurement. c is the mean of ``e_nominal - e_oracle`` over the episode, so that
    the mean reward is 0 for the nominal filter (exactly: action *none*, or -1) and 1 for the oracle. c is at least
    a tenth (``least_gain``) of sigma, the root mean nominal variance of a position component: in an episode without
    surges there is nothing to gain, and the reward is the difference in tenths of sigma. ``reward="squared"`` and
    ``"log"`` use ``e^2`` and ``ln(1 + e^2)`` instead, in units of sigma; ``"regret"`` is ``(e_oracle - e_agent) /
    c``, which differs from the first by what no action changes and varies far less: its mean is -1 for the nominal
    filter and 0 for the oracle; ``"log-regret"`` is the same of the logarithms. A reward is cut off at -10 and 100;
    in scenarios where that happens the oracle's mean is not exactly 1 (0.94 to 1.23). Losing the track costs 10 for
    each decision left, so that giving up never pays. A sample whose truth is not known (recorded tracks) gives 0.

    ## Starting State
    A target drawn by the scenario from the environment's generator; the filters start from what the scenario tells
    about it; the first observation is the first innovation.

    ## Episode End
    - Terminated: the track is lost, that is the agent's error exceeded ``lost_after`` times the larger of sigma and
      the nominal filter's error for ``lost_steps`` decisions in a row. The nominal filter is never lost.
    - Truncated: the decision at the last sample but one has been taken; the last observation shows the last sample.

    ## Arguments
    ``scenario``, ``suite`` or ``tracks`` choose what happens, other keywords change the scenario's parameters.
    ``factors``, ``loop_filter`` ("kf", "robust", or a `jink.envs.loop_filter.LoopFilter`), ``reward``, ``least_gain``
    (default 0.1), ``lost_after`` (default 25), ``lost_steps`` (default 10), ``view``, ``covariance``, ``informed``
    and ``lookback``. The filter is linear: measurements of range and angle are converted to positions with their exact
    moments beforehand; sensors that do not locate a target are refused.

    ## Info
    Of the sample observed: ``time`` s, ``noise_scale`` (the true factor on the noise covariance), ``intent`` (its
    index in ``rollout.source.intents``), ``detected``, ``nis`` (D^2). Of the decision just taken, or the prior before
    any: ``error_agent``, ``error_nominal``, ``error_oracle`` m, ``inflation`` (``tr R~ / tr R``), ``position`` and
    ``estimate`` m.

    ## Version History
    * v0: first version.

    Args:
        source: where episodes come from.
        count: number of targets B.
        continuous: choose an inflation instead of a factor.
        factors: names or `Factor` objects, one per action.
        loop_filter: the filter in the loop.
        reward: "distance", "squared", "log", "regret" or "log-regret".
        lost_after: how far off, in sigma or nominal errors, an estimate may be.
        lost_steps: decisions in a row after which the track is lost.
        least_gain: what rewards are divided by at least, sigma.
        view: "plain" or "levels": what is observed.
        covariance: "chosen" or "mixture": how sure an update makes the agent's filter.
        informed: append what only a simulator knows, for a critic.
        lookback: judge the last measurement again with the next.

    Raises:
        ValueError: an unknown name, an option out of range, or a sensor that does not locate.
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
        least_gain: float = _LEAST_GAIN,
        view: str = "plain",
        covariance: str = "chosen",
        informed: bool = False,
        lookback: bool = False,
    ) -> None:
        check_locates("make", source.sensor)
        if reward not in _LOSSES:
            raise ValueError(f"make: reward must be one of {', '.join(_LOSSES)}; got {reward!r}. Pick one.")
        if not (lost_after > 0 and lost_steps >= 1 and lost_steps == int(lost_steps)):
            raise ValueError(
                f"make: lost_after must be > 0 sigma and lost_steps an integer >= 1; got {lost_after}, {lost_steps}. "
                "Use math.inf for a track that is never lost."
            )
        real = isinstance(least_gain, float | int) and not isinstance(least_gain, bool)
        if not (real and 0 < least_gain < math.inf):
            raise ValueError(f"make: least_gain must be > 0 sigma and finite; got {least_gain!r}. Leave it out.")
        if view not in looking.VIEWS:
            raise ValueError(f"make: view must be one of {', '.join(looking.VIEWS)}; got {view!r}. Pick one.")
        if covariance not in COVARIANCES or (covariance == "mixture" and view != "levels"):
            raise ValueError(
                f"make: covariance must be one of {', '.join(COVARIANCES)}, mixture only with view levels; got "
                f"{covariance!r} with view {view!r}. Leave it out if in doubt."
            )
        for name, value in (("informed", informed), ("lookback", lookback)):
            if not isinstance(value, bool):
                raise ValueError(f"make: {name} must be True or False; got {value!r}. Leave it out if in doubt.")
        if lookback and not (covariance == "mixture" and loop_filter == "kf"):
            raise ValueError(
                f"make: lookback must come with covariance mixture and the filter kf; got {covariance!r} and "
                f"{loop_filter!r}. Leave it out if in doubt."
            )
        self.view, self.covariance, self.informed, self.lookback = view, covariance, informed, lookback
        self.source, self.count, self.continuous = source, int(count), bool(continuous)
        self.factors = tuple(make_factor(factor) if isinstance(factor, str) else factor for factor in factors)
        if not continuous and len(self.factors) < 2:
            raise ValueError(f"make: factors must be at least two; got {len(self.factors)}. Name another.")
        self.loop_filter = make_loop_filter(loop_filter, source.axes)
        A, B, T, modes = source.axes, self.count, source.steps, len(self.loop_filter.modes)
        choices = 0 if continuous else len(self.factors)
        self.observation_space = gymnasium.spaces.Box(*_bounds(view, A, modes, choices, informed), dtype=np.float32)
        self.action_space: gymnasium.Space[Any] = (
            gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32) if continuous else gymnasium.spaces.Discrete(choices)
        )
        self._sizes = A, modes, choices
        self._thresholds = np.array([[factor.thresholds(d + 1) for d in range(A)] for factor in self.factors])
        self._params = self.loop_filter.params_for(source.filter_noise)
        self._settings = np.array(
            [
                lost_after, lost_steps, _LOWEST, _HIGHEST, _LOSSES[reward], least_gain, looking.VIEWS[view],
                covariance == "mixture", informed, lookback,
            ],
            dtype=np.float64,
        )  # fmt: skip
        self._states = np.zeros((B, 4 * A + 3, 8))
        self._samples = np.zeros((B, T, kernels.FIRST + 3 * A))
        self._memory = np.zeros((B, kernels.PLACE + 2 * A))
        self._looks = np.zeros((B, looking.memory_size(A)))
        self._bases = np.zeros((B, A + 2, 8))
        self._keeps = np.zeros((B, kept_size(2 * A, A) if lookback else 1))
        self._features = np.zeros((B, self.observation_space.shape[0]), dtype=np.float32)
        self._noises = np.zeros((1, 1, A * A))
        self._ones = np.ones(B)
        self._ends = np.full(B, T - 1)
        self._sensor_places = np.zeros((B, A))
        self._one_noise = True
        self._look_up()

    def _look_up(self) -> None:
        self._filters = self.loop_filter.addresses()
        self._addresses = np.array([factor.function.address for factor in self.factors])

    @property
    def sigma(self) -> Array:
        """Root mean nominal variance of a position component in each target's episode, m; (B,)."""
        return self._memory[:, kernels.SIGMA].copy()

    @property
    def gain(self) -> Array:
        """What rewards are divided by, in sigma: see *Rewards*; (B,)."""
        return self._memory[:, kernels.GAIN].copy()

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
                remedy = "Give -1 to leave the noise as it is, up to 1 to inflate it by a million."
                raise ActionError.shaped(caller, "numbers", array, (self.count, 1), remedy)
            inflations = array.astype(np.float64)  # before abs: the most negative integer has no absolute value
            if not np.abs(inflations).max() <= 1.0:
                row = int(np.argmin(np.abs(inflations[:, 0]) <= 1.0))
                raise ActionError.valued(caller, "be finite and within -1 .. 1", array[row, 0], row, "Clip it.")
            return inflations
        if array.shape != (self.count,) or array.dtype.kind not in "iu":
            remedy = f"Give the number of a factor: {_listed(self.factors)}."
            raise ActionError.shaped(caller, "integers", array, (self.count,), remedy)
        chosen = array.astype(np.int64)
        # Seen as unsigned, a negative number is a huge one; a reduction costs ten times as much as one item.
        largest = chosen.view(np.uint64).item(0) if self.count == 1 else chosen.view(np.uint64).max()
        if largest >= len(self.factors):
            row = int(np.argmax((array < 0) | (array >= len(self.factors))))
            remedy = f"Give the number of a factor: {_listed(self.factors)}."
            raise ActionError.valued(caller, f"be 0 .. {len(self.factors) - 1}", array[row], row, remedy)
        return chosen

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
        self._ends[rows] = T - 1
        self._sensor_places[rows] = episodes.sensor_states[:, 0, :A]
        priors = np.zeros((len(rows), 2 * A + 1, 8))
        priors[:, 0, : 2 * A] = episodes.prior_mean
        priors[:, 1:, : 2 * A] = episodes.prior_cov
        inputs = (
            _own(episodes.times), _own(episodes.scale), _own(episodes.truth.intent), _own(episodes.truth.position),
            _own(places),
        )  # fmt: skip
        in_halves(
            kernels.begin_rows, len(rows), rows, A, modes, choices, self._filters, self._params, self._settings,
            *inputs, priors,
            self._noises, self._one_noise, self._states,
            self._samples, self._memory, self._looks, self._bases, self._keeps, self._features,
        )  # fmt: skip

    def end_early(self, rows: Rows, ends: Rows) -> None:
        """The episodes just begun end at samples ``ends``: no decision after them is lost with a track."""
        self._ends[rows] = ends

    def step(self, actions: NDArray[Any], k: Rows, live: NDArray[np.bool_]) -> Outcome:
        """Update the filters of sample ``k[b]`` with the noise chosen, and look at the next one."""
        A, modes, choices = self._sizes
        if self.continuous:
            chosen = np.full(self.count, -1)
            inflations = np.exp((0.5 * LARGEST_LOG_INFLATION) * (actions[:, 0] + 1.0))
        else:
            chosen, inflations = actions, self._ones
        reward, lost = np.empty(self.count), np.empty(self.count, dtype=np.bool_)
        in_halves(
            kernels.step_rows, self.count, live, k, self._ends, chosen, inflations, A, modes, choices, self._filters,
            self._addresses, self._thresholds, self._params, self._settings, self._noises, self._one_noise,
            self._states, self._samples, self._memory, self._looks, self._bases, self._keeps, self._features,
            reward, lost,
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
        kernels.tell_rows(k, A, self._samples, self._memory, self._looks, *told.values())
        return told

    def info_alone(self, k: int) -> dict[str, Any]:
        """`info` of a single target, as plain numbers: one target is told in a fifth of the time."""
        A, place = self.source.axes, kernels.PLACE
        sample, mine = self._samples[0, k, : kernels.FIRST + 2 * A].tolist(), self._memory[0, :place].tolist()
        return {
            "time": sample[kernels.TIME],
            "noise_scale": sample[kernels.SCALE],
            "intent": int(sample[kernels.INTENT]),
            "detected": not all(map(math.isnan, sample[kernels.FIRST + A :])),
            "nis": self._looks.item((0, looking.NIS)),
            "error_agent": mine[kernels.ERROR_AGENT],
            "error_nominal": mine[kernels.ERROR_NOMINAL],
            "error_oracle": mine[kernels.ERROR_ORACLE],
            "inflation": mine[kernels.INFLATION],
            "position": self._memory[0, place : place + A].copy(),
            "estimate": self._memory[0, place + A : place + 2 * A].copy(),
        }

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


def _own(array: NDArray[Any]) -> NDArray[Any]:
    """The array as kernels were compiled for: C order and not marked read-only."""
    return np.require(array, requirements=["C", "W"])


def _bounds(view: str, A: int, modes: int, choices: int, informed: bool) -> tuple[Array, Array]:
    low, high = looking.view_bounds(looking.VIEWS[view], A)
    last = max(choices, 1) if view == "plain" else 0
    low = np.concatenate([low, np.zeros(modes + last)])
    high = np.concatenate([high, np.ones(modes + last)])
    if last and not choices:
        low[-1] = -1.0
    if informed:
        told = np.full(TOLD, kernels.TOLD_BOUND)
        low, high = np.concatenate([low, -told]), np.concatenate([high, told])
    return low.astype(np.float32), high.astype(np.float32)


def _listed(factors: Sequence[Factor]) -> str:
    return ", ".join(f"{number} {factor.name}" for number, factor in enumerate(factors))
