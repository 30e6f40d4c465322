"""An estimator with an agent in the loop, which chooses how noisy each measurement is taken to be."""

from __future__ import annotations

import zlib
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.adaptive_cycle import AGENT, LEARNT, Settings, advance
from jink.estimators.agent.beliefs import LEVEL_SCALES, LEVELS
from jink.estimators.agent.looking import BELIEF, LARGEST_LOG_INFLATION, USED, memory_size
from jink.estimators.agent.policy import Policy
from jink.estimators.agent.updating import Chooser, agent_memory, make_chooser
from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.bank import Bank
from jink.estimators.inputs import Prior, check_inputs
from jink.estimators.records import History, Inputs, Outputs, State
from jink.estimators.streaming import Desk

__all__ = ["AgentEstimator"]

Floats = NDArray[np.float64]


class AgentEstimator(BankEstimator):
    """A filter of one mode whose measurement noise is chosen by a `Policy`, measurement by measurement.

    Everything is used as in `BankEstimator`. What the agent sees is computed by the kernel that computes the
    observations of `jink/AdaptiveFactor-v0`. ``nis`` and ``log_likelihood`` are those with the noise chosen.

    Args:
        bank: one mode, sensor.
        policy: what it sees and chooses.
        name: shown in tables.
        threads: processor cores for many tracks; None: all.

    Raises:
        ValueError: several modes, a treatment, or a policy for another number of components.
    """

    _learns = True

    def __init__(self, bank: Bank, policy: Policy, name: str = "agent", threads: int | None = None) -> None:
        if len(bank.modes) != 1 or bank.modes[0].treatments:
            raise ValueError(
                f"AgentEstimator: bank must have one mode without treatment; got {len(bank.modes)} modes, the first "
                f"with {bank.modes[0].treatment!r}. The agent is the treatment."
            )
        if not isinstance(policy, Policy):
            raise ValueError(
                f"AgentEstimator: policy must be a Policy; got {policy!r}. Load it first: "
                "jink.estimators.agent.policy_file.find_policy(name)."
            )
        if policy.view == "plain" and policy.components != bank.sensor.size:
            raise ValueError(
                f"AgentEstimator: policy must be for {bank.sensor.size} components of a measurement; got one for "
                f"{policy.components}. Train one with the view levels, which fits any sensor."
            )
        if policy.lookback and not bank.modes[0].motion.linear:
            raise ValueError(
                f"AgentEstimator: bank must have a linear motion for a policy that looks back; got "
                f"{bank.modes[0].motion.name}. Train one with --no-lookback."
            )
        super().__init__(bank, name=name, threads=threads)
        self.policy = policy
        self._trail = np.zeros((0, 0, 0))

    def __getstate__(self) -> dict[str, Any]:
        """Pickled without compiled tables: addresses belong to one process."""
        return {**super().__getstate__(), "policy": self.policy, "_trail": np.zeros((0, 0, 0))}

    def surge_probability(self, estimates: Estimates) -> Floats:
        """Not offered: the agent's belief is not part of the estimates.

        Raises:
            ValueError: always.
        """
        raise ValueError("surge_probability: bank must have noise levels; got an agent. Use noise_run.")

    def noise_scale(self, estimates: Estimates) -> Floats:
        """Not offered: what the agent chose is not part of the estimates.

        Raises:
            ValueError: always.
        """
        raise ValueError("noise_scale: bank must have noise levels; got an agent. Use noise_run.")

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
        """What `run` chooses and believes at every row; arguments and errors as there.

        Returns:
            ``tr R~ / tr R`` of the last measurement (B, T), and the probability that the noise was above nominal
            (B, T; only policies of the view ``levels`` keep one, else NaN). Rows before the first are 1 and 0.1.
        """
        inputs = check_inputs(self.bank, measurements, times, noise, sensor_states, lengths, caller="noise_run")
        tracks, rows = inputs.measurements.shape[:2]
        recorder = AgentEstimator(self.bank, self.policy, self.name, self.threads)
        recorder._trail = np.tile(recorder._unseen(), (tracks, rows, 1))
        recorder._filter(inputs, prior, False, None)
        surge = 1.0 - recorder._trail[..., BELIEF]
        if self.policy.view != "levels":
            surge[:] = np.nan
        return np.exp(recorder._trail[..., USED] * LARGEST_LOG_INFLATION), surge

    def _unseen(self) -> Floats:
        size, n = self.bank.sensor.size, len(self.bank.modes[0].motion.labels)
        columns = np.zeros(agent_memory(size, n, self.policy.lookback))
        columns[1] = columns[memory_size(size)] = -1.0
        columns[BELIEF] = 0.9
        columns[BELIEF + 1 : BELIEF + LEVELS] = 0.1 / (len(LEVEL_SCALES) - 1)
        return columns

    def _blank(self, tracks: int) -> State:
        state = super()._blank(tracks)
        return state._replace(nis_average=np.hstack([state.nis_average, np.tile(self._unseen(), (tracks, 1))]))

    @cached_property
    def _chooser(self) -> Chooser:
        return make_chooser(self.policy, self.bank.sensor.size)

    @cached_property
    def _settings(self) -> Settings:
        return Settings(AGENT, 1.0, 1.0, 1.0, 1.0, 1, True, False, self.bank.restart is not False)

    @cached_property
    def _layout(self) -> int:
        policy = self.policy
        own = (
            policy.view,
            policy.factors,
            policy.covariance,
            policy.lookback,
            [weight.tobytes() for weight, _ in policy.layers],
        )
        motion = self.bank.modes[0].motion
        return zlib.crc32(repr((self.bank.sensor.axes, self.bank.sensor.size, self.modes, motion.labels, own)).encode())

    def _advance(self, state: State, inputs: Inputs, outputs: Outputs, history: History, low: int, high: int) -> None:
        advance(
            self._settings, self._chooser, self._handle.handle, self._work(), state, inputs, outputs, history,
            self._trail, low, high,
        )  # fmt: skip

    def _advance_row(self, desk: Desk, state: State) -> None:
        self._advance(state, desk.inputs.record, desk.outputs.record, self._history(1, 0), 0, 1)


assert LEARNT == 2  # `_blank` appends to the two columns of a bank of one mode
