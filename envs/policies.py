"""Any estimator is a policy: `EstimatorPolicy`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from jink.envs.manoeuvring_target import ManoeuvringTargetTask
from jink.estimators.api import BankEstimator
from jink.estimators.starting import start_prior

__all__ = ["EstimatorPolicy"]

Array = NDArray[np.float64]


class EstimatorPolicy:
    """A Jink estimator that plays `jink/ManoeuvringTarget-v0`, single or vector.

    It reads observations alone: each is undone to measurement, time step and sensor place, the estimator takes them
    one by one, and its position divided by ``layout.scale`` is the action, cut off at -1 .. 1. Until the measurements
    seen locate the target, the action is 0, the origin. Where the first measurement locates, the positions are those
    of ``estimator.run`` bit for bit; a start that needs several (bearings alone) can rest on fewer rows here.

    Args:
        estimator: from `jink.estimators.recipes.make_estimator`, for the environment's sensor.
        env: the environment, single or vector, wrapped or not; only its spaces' layout is read.

    Raises:
        ValueError: another task, or an estimator for another sensor.
    """

    def __init__(self, estimator: BankEstimator, env: gymnasium.Env[Any, Any] | gymnasium.vector.VectorEnv) -> None:
        task = getattr(getattr(env.unwrapped, "rollout", None), "task", None)
        if not isinstance(task, ManoeuvringTargetTask):
            raise ValueError(
                f"EstimatorPolicy: env must be jink/ManoeuvringTarget; got {env}. Estimates are its actions."
            )
        wanted, found = task.source.sensor, estimator.bank.sensor
        if (found.name, found.axes, found.size) != (wanted.name, wanted.axes, wanted.size):
            raise ValueError(
                f"EstimatorPolicy: estimator must be for {wanted.name} in {wanted.axes} axes; got {found.name} in "
                f"{found.axes}. Make it with sensor=env.unwrapped.rollout.source.sensor."
            )
        self.estimator = estimator
        self.layout = task.layout
        self._memories: list[_Memory] = []

    def act(self, observations: NDArray[Any], first: NDArray[np.bool_]) -> Array:
        """Actions (B, A); ``first`` (B,) marks targets whose observation is the first of an episode."""
        if len(self._memories) != len(observations):
            self._memories = [_Memory(self.estimator) for _ in range(len(observations))]
        seen = self.layout.read(np.asarray(observations, dtype=np.float64))
        positions = np.zeros((len(observations), self.layout.axes))
        for b, memory in enumerate(self._memories):
            if first[b]:
                memory.forget()
            positions[b] = memory.take(seen.measurement[b], float(seen.step[b]), seen.sensor_state[b])
        return np.clip(np.nan_to_num(positions / self.layout.scale), -1.0, 1.0)

    def reset(self) -> None:
        """A new episode of a single environment begins with the next call."""
        self._memories = []

    def __call__(self, observation: NDArray[Any]) -> Array:
        """The action for one target (A,), or for a batch (B, A) in which no episode has ended."""
        batch = np.atleast_2d(observation)
        fresh = np.full(len(batch), len(self._memories) != len(batch))
        actions = self.act(batch, fresh)
        return actions if np.ndim(observation) == 2 else actions[0]


class _Memory:
    """What the estimator knows of one target."""

    def __init__(self, estimator: BankEstimator) -> None:
        self.estimator = estimator
        self.forget()

    def forget(self) -> None:
        self.state: Any = None
        self.rows: list[tuple[Array, Array]] = []
        self.times: list[float] = []
        self.origin = np.zeros(1)

    def take(self, measurement: Array, step: float, sensor_state: Array) -> Array:
        """The position after one more sample; zeros before the target is located."""
        if self.state is not None:
            # The filter uses time differences alone, and the observed step is that difference, to the last bit.
            past = self.state._replace(time=self.origin)
            self.state, _ = self.estimator.step(past, measurement, step, sensor_state=sensor_state)
            return self.state.kin_mean[0, : self.estimator.bank.sensor.axes]
        self.times.append(self.times[-1] + step if self.times else 0.0)
        self.rows.append((measurement, sensor_state))
        bank, times = self.estimator.bank, np.array(self.times)
        z, places = (np.array(column) for column in zip(*self.rows, strict=True))
        noise = np.broadcast_to(bank.sensor.noise, (len(z), bank.sensor.size, bank.sensor.size))
        if not start_prior(bank.sensor, z, times, noise, places, bank.speed, bank.area).ok:
            return np.zeros(bank.sensor.axes)
        self.state = self.estimator.start(z, times, sensor_states=places)
        self.rows, self.times = [], []
        return self.state.kin_mean[0, : bank.sensor.axes]
