"""A bank of modes: motions, a Markov chain between them, and an interaction rule. Every recipe is one of these."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.program import INTERACTIONS, Program, make_program
from jink.estimators.sensor import Sensor
from jink.estimators.treatments import TREATMENTS, Adaptive, BoundedTails, HeavyTails, Level, Treatment, Uncertain

__all__ = ["Bank", "Mode"]

_RESET_QUANTILE = 0.999
_ADAPTING = (Adaptive, BoundedTails, HeavyTails)


@dataclass(frozen=True)
class Mode:
    """One hypothesis about how the target moves.

    Args:
        name: shown in tables and plots.
        motion: how it moves.
        treatment: what it does about noise and model error: one of `TREATMENTS`, or several kinds; None: nothing.
        intent: modes of one intent differ in their treatment only, and a switch among them is no birth; None: the
            mode's name.

    Raises:
        ValueError: treatments that exclude each other, or do not fit the motion.
    """

    name: str
    motion: Motion
    treatment: Treatment | tuple[Treatment, ...] | None = None
    intent: str | None = None

    def __post_init__(self) -> None:
        if isinstance(self.treatment, list):
            raise ValueError(
                f"Mode: treatment of {self.name} must be one treatment or a tuple; got a list. Use "
                f"tuple({self.treatment!r})."
            )
        kinds = ["adaptive" if isinstance(item, _ADAPTING) else type(item).__name__ for item in self.treatments]
        known = tuple(TREATMENTS.values())
        if not all(isinstance(item, known) for item in self.treatments) or len(set(kinds)) != len(kinds):
            raise ValueError(
                f"Mode: treatment of {self.name} must be one of {', '.join(kind.__name__ for kind in known)} or one "
                f"of each (only one of Adaptive, BoundedTails, HeavyTails); got {self.treatment!r}. Drop one."
            )
        for item in self.treatments:
            if isinstance(item, Uncertain) and item.size != self.motion.size:
                raise ValueError(
                    f"Mode: treatment of {self.name} must have error with {self.motion.size} rows, one per component "
                    f"of its motion; got {item.size}. Components are {', '.join(self.motion.labels)}."
                )

    @property
    def treatments(self) -> tuple[Treatment, ...]:
        """Its treatments, none or more."""
        if self.treatment is None:
            return ()
        return self.treatment if isinstance(self.treatment, tuple) else (self.treatment,)

    @property
    def purpose(self) -> str:
        """Its intent, whatever its treatment."""
        return self.name if self.intent is None else self.intent

    @property
    def noise_scale(self) -> float:
        """Factor on R that this mode stands for: that of its `Level`, else 1."""
        return next((item.scale for item in self.treatments if isinstance(item, Level)), 1.0)


@dataclass(frozen=True)
class Bank:
    """Everything an interacting-multiple-model estimator needs to know.

    Args:
        modes: one or more; all with the sensor's number of axes.
        sensor: what is measured.
        chain: how the mode changes; None for a single mode.
        initial_probs: mode probabilities at the start; (M,); None: the chain's long-run ones.
        interaction: ``mix`` (equal labels mix, missing ones are filled from the receiving mode), ``birth``
            (position and velocity carry over, own parameters are drawn from their birth prior), ``jet`` (as far as
            position, velocity, acceleration determine them), ``none`` (separate filters), ``reset`` (separate, a
            lost one begins again from the best).
        speed: standard deviation of velocity components before anything is known; m/s.
        area: where targets appear, centre (A,) and standard deviation in m; only for sensors that do not locate.
        alpha, beta, kappa: unscented transform.
        min_prob: floor of mode probabilities, so that no mode dies for ever.
        reset_prob: ``reset`` begins a mode again below this probability.
        reset_nis: or when its running mean of NIS per component exceeds this; None: the 99.9 % chi-square bound.
        every_sigma_point: use sigma points also where a matrix gives the same numbers (for comparisons).
        shared: modes of one intent differ in their `Level` only and share one prediction: before each step they are
            collapsed to their common mean and covariance. A product of I intents and L noise levels then costs I
            modes and L cheap updates of each.
        restart: begin again, with births of all modes at much widened position and velocity, where the target is
            lost: about seventeen measurements in a row lay beyond the 99.9 % chi-square bound at nominal noise, and on
            one side; None: where a treatment judges the noise (`Adaptive`, `BoundedTails`, several `Level`s; not
            `HeavyTails`, whose mean follows a jump by itself).
        learns_noise: its one mode is to learn the noise, as `sage_husa` and `vb_noise`: only an `AdaptiveEstimator`
            runs such a bank.

    Raises:
        ValueError: parts that do not fit; the sentence names them.

    Source: Blom & Bar-Shalom (1988); CN202211553542 claims 1-6 (own state per mode). Differs: the patent's
    filters are separate; births are ours.
    """

    modes: tuple[Mode, ...]
    sensor: Sensor
    chain: MarkovChain | None = None
    initial_probs: tuple[float, ...] | None = None
    interaction: str = "mix"
    speed: float = 10.0
    area: tuple[tuple[float, ...], float] | None = None
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0
    min_prob: float = 1e-6
    reset_prob: float = 1e-3
    reset_nis: float | None = None
    every_sigma_point: bool = False
    shared: bool = False
    restart: bool | None = None
    learns_noise: bool = False

    def __post_init__(self) -> None:
        if not self.modes:
            raise ValueError("Bank: modes must hold at least one Mode; got none. Pass modes=(Mode(name, motion), ...).")
        names = [mode.name for mode in self.modes]
        if len(set(names)) != len(names):
            raise ValueError(f"Bank: modes must have distinct names; got {names}. Rename one.")
        for mode in self.modes:
            if mode.motion.axes != self.sensor.axes:
                raise ValueError(
                    f"Bank: modes must have the sensor's {self.sensor.axes} axes; {mode.name} has "
                    f"{mode.motion.axes}. Make the motion with axes={self.sensor.axes}."
                )
        if self.chain is None and len(self.modes) > 1:
            raise ValueError(
                "Bank: chain must be given for several modes; got None. Use MarkovChain.from_sojourns([...])."
            )
        if self.chain is not None and self.chain.modes != len(self.modes):
            raise ValueError(
                f"Bank: chain must have one row per mode, {len(self.modes)}; got {self.chain.modes}. "
                "Add or remove rows."
            )
        if self.interaction not in INTERACTIONS:
            raise ValueError(
                f"Bank: interaction must be one of {', '.join(INTERACTIONS)}; got {self.interaction!r}. Pick one."
            )
        members: dict[str, Mode] = {}
        for mode in self.modes:
            if members.setdefault(mode.purpose, mode).motion != mode.motion:
                raise ValueError(
                    f"Bank: modes of intent {mode.purpose} must have the same motion; got different ones in "
                    f"{members[mode.purpose].name} and {mode.name}. Give them different intents."
                )
        for mode in self.modes if self.shared else ():
            rest = [
                tuple(i for i in one.treatments if not isinstance(i, Level)) for one in (mode, members[mode.purpose])
            ]
            if rest[0] != rest[1] or any(isinstance(item, Uncertain) for item in rest[0]):
                raise ValueError(
                    f"Bank: shared must be off unless modes of one intent differ in their Level only and none is "
                    f"Uncertain; got {mode.name} with {rest[0]}. Use shared=False."
                )
        if self.initial_probs is not None:
            probs = np.asarray(self.initial_probs, dtype=np.float64)
            if probs.shape != (len(self.modes),) or not np.all(probs >= 0) or abs(probs.sum() - 1) > 1e-9:
                raise ValueError(
                    f"Bank: initial_probs must be {len(self.modes)} probabilities that sum to 1; got "
                    f"{self.initial_probs}. Divide by the sum."
                )
        lowest = {"speed": 0.0, "alpha": 0.0, "beta": -np.inf, "kappa": -np.inf, "reset_nis": 0.0}
        for name, low in lowest.items():
            value = getattr(self, name)
            if value is not None and not (value > low and np.isfinite(value)):
                raise ValueError(f"Bank: {name} must be > {low:g} and finite; got {value}. Leave it out if in doubt.")
        if not (self.restart is None or isinstance(self.restart, bool)):
            raise ValueError(f"Bank: restart must be True, False or None; got {self.restart!r}. Leave it out.")
        if not isinstance(self.learns_noise, bool):
            raise ValueError(f"Bank: learns_noise must be True or False; got {self.learns_noise!r}. Leave it out.")
        if not 0 <= self.reset_prob < 1:
            raise ValueError(f"Bank: reset_prob must be in [0, 1); got {self.reset_prob}. Use 1e-3.")
        if self.area is not None:
            centre, spread = np.asarray(self.area[0], dtype=np.float64), self.area[1]
            if centre.shape != (self.sensor.axes,) or not np.isfinite(centre).all() or not 0 < spread < np.inf:
                raise ValueError(
                    f"Bank: area must be (centre ({self.sensor.axes},), sd > 0), finite; got {self.area}. "
                    "Give both in metres."
                )
        largest = max(mode.motion.size for mode in self.modes)
        if not largest + self.kappa > 0:
            raise ValueError(f"Bank: kappa must be > -n = {-largest}; got {self.kappa}. Use 0.")
        if not 0 <= self.min_prob < 1.0 / len(self.modes):
            raise ValueError(
                f"Bank: min_prob must be in [0, 1/M = {1 / len(self.modes):.3g}); got {self.min_prob}. Use 1e-6."
            )

    @cached_property
    def start_probs(self) -> NDArray[np.float64]:
        """Mode probabilities at the start; (M,)."""
        if self.initial_probs is not None:
            return np.array(self.initial_probs, dtype=np.float64)
        return np.ones(1) if self.chain is None else self.chain.stationary()

    def program(self) -> Program:
        """The bank as tables for the compiled cycle (compiles what it needs)."""
        chain = self.chain or MarkovChain(matrix=((1.0,),))
        size = self.sensor.size
        bound = self.reset_nis if self.reset_nis is not None else float(chi2.ppf(_RESET_QUANTILE, size)) / size
        return make_program(
            tuple(mode.motion for mode in self.modes),
            self.sensor,
            rule=INTERACTIONS[self.interaction],
            per_step=chain.matrix is not None,
            chain=np.array(chain.matrix if chain.matrix is not None else chain.generator, dtype=np.float64),
            tuning=(self.alpha, self.beta, self.kappa),
            min_prob=self.min_prob,
            reset_prob=self.reset_prob,
            reset_nis=bound,
            every_sigma_point=self.every_sigma_point,
            treatments=tuple(mode.treatments for mode in self.modes),
            intents=tuple(mode.purpose for mode in self.modes),
            shared=self.shared,
            restart=self.restart,
            start_probs=self.start_probs,
            chain_factors=None if chain.factors is None else (chain.factors[0].rates, chain.factors[1].rates),
        )

    def with_(self, **changes: object) -> Bank:
        """A copy with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]
