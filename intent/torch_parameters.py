"""A model of intents as unconstrained numbers that an optimiser may move freely."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from jink.intent.laws import Birth
from jink.intent.model import Intent, IntentModel
from jink.intent.torch_tables import law_tables, markov_matrices

__all__ = ["ModelParameters"]

_NOTHING = -700.0
"""Logarithm that stands for exactly nothing: its gradient vanishes, so what is absent stays absent."""
_TURN_UNIT = 0.1  # rad/s
_GROWTH_UNIT = 0.02  # 1/s
_DAMPING = (1e-3, 0.999)


def _log(values: list[float]) -> nn.Parameter:
    return nn.Parameter(
        torch.tensor([math.log(v) if v > 0 else _NOTHING for v in values], dtype=torch.float64), requires_grad=True
    )


def _plain(values: list[float], unit: float) -> nn.Parameter:
    return nn.Parameter(torch.tensor(values, dtype=torch.float64) / unit)


def _positive(log: Tensor, power: float = 1.0) -> Tensor:
    """``exp(power log)``, and 0 where there is nothing."""
    return torch.where(log <= _NOTHING, torch.zeros_like(log), torch.exp(power * log))


def _exact(log: Tensor) -> np.ndarray:
    values = log.detach().cpu().double()
    return np.asarray(torch.where(values <= _NOTHING, torch.zeros_like(values), torch.exp(values)))


class ModelParameters(nn.Module):
    """Every number of an `IntentModel` as unconstrained parameters; the structure (phases, sides) stays as it is.

    Positive numbers are logarithms, shares are soft-maxed logits, means are in units of 0.1 rad/s and 0.02 1/s so that
    one learning rate fits all. A number that is exactly zero (a rate, a variance) stays zero. To hold something
    still, clear its ``requires_grad``.

    Args:
        model: where to begin.

    Attributes:
        growth_mean, log_growth_rate, log_growth_noise, turn_mean, log_turn_rate, log_turn_noise, log_wobble,
        log_natural, damping_logit, log_duration: of each phase; (F,).
        birth_logit, birth_growth, log_birth_growth_sd, birth_turn, log_birth_turn_sd, log_birth_swing_sd: of each
            birth component; (C,).
        log_rates: between intents, diagonal unused; (P, P).
        log_renewal, initial_logit: of each intent; (P,).
        log_noise: standard deviation of the measurement; (A,); None where the sensor's is used.
    """

    _intent_of: Tensor
    _phase_of: Tensor
    _birth_of: Tensor
    _owner_of: Tensor
    _sign: Tensor
    _share: Tensor
    _first: Tensor
    _swings: Tensor
    _leave: Tensor
    _again: Tensor
    _onward: Tensor

    def __init__(self, model: IntentModel) -> None:
        super().__init__()
        self.model = model
        phases = [phase for intent in model.intents for phase in intent.phases]
        births = [birth for phase in phases for birth in phase.births]
        laws = [phase.law for phase in phases]
        self.growth_mean = _plain([law.growth_mean for law in laws], _GROWTH_UNIT)
        self.log_growth_rate = _log([law.growth_rate for law in laws])
        self.log_growth_noise = _log([law.growth_noise for law in laws])
        self.turn_mean = _plain([law.turn_mean for law in laws], _TURN_UNIT)
        self.log_turn_rate = _log([law.turn_rate for law in laws])
        self.log_turn_noise = _log([law.turn_noise for law in laws])
        self.log_wobble = _log([law.wobble for law in laws])
        swings = [law.swing or (1.0, 0.5) for law in laws]
        self.log_natural = _log([swing[0] for swing in swings])
        low, high = _DAMPING
        shares = torch.tensor([(swing[1] - low) / (high - low) for swing in swings], dtype=torch.float64)
        self.damping_logit = nn.Parameter(torch.logit(shares, eps=1e-12))
        self.log_duration = _log([phase.duration for phase in phases])
        self.birth_logit = _log([birth.weight for birth in births])
        self.birth_growth = _plain([birth.growth_mean for birth in births], _GROWTH_UNIT)
        self.log_birth_growth_sd = _log([birth.growth_sd for birth in births])
        self.birth_turn = _plain([birth.turn_mean for birth in births], _TURN_UNIT)
        self.log_birth_turn_sd = _log([birth.turn_sd for birth in births])
        self.log_birth_swing_sd = _log([birth.swing_sd for birth in births])
        rates = np.array(model.generator)
        count = len(rates)
        self.log_rates = nn.Parameter(_log(rates.clip(0.0).ravel().tolist()).detach().reshape(count, count))
        self.log_renewal = _log([intent.renewal for intent in model.intents])
        self.initial_logit = _log(list(model.initial))
        self.log_noise = None if model.noise_sd is None else _log(list(model.noise_sd))
        if model.axes == 3:  # no direction in space is special
            self.turn_mean.requires_grad_(False)
            self.birth_turn.requires_grad_(False)
        self._index(model)

    def _index(self, model: IntentModel) -> None:
        """Which phase, birth and side each mode is, and how the mode generator is put together."""
        modes = model.modes
        starts, first_births, phases = {}, {}, 0
        births = 0
        owners: list[int] = []
        for p, intent in enumerate(model.intents):
            for k, phase in enumerate(intent.phases):
                starts[p, k], first_births[p, k] = phases, births
                owners += [phases] * len(phase.births)
                phases += 1
                births += len(phase.births)
        count, last = len(modes), [len(intent.phases) - 1 for intent in model.intents]
        leave, again, onward = np.zeros((3, count, count))
        for i, old in enumerate(modes):
            for j, new in enumerate(modes):
                if i == j:
                    continue
                if old.phase == last[old.intent] and new.phase == 0:
                    (again if old.intent == new.intent else leave)[i, j] = 1.0
                if new.intent == old.intent and new.phase == old.phase + 1:
                    kept = model.phase_of(old).mirrored and model.phase_of(new).mirrored
                    onward[i, j] = 2.0 * (old.sign == new.sign) if kept else 1.0
        named = {
            "intent_of": np.array([m.intent for m in modes]),
            "phase_of": np.array([starts[m.intent, m.phase] for m in modes]),
            "birth_of": np.array([first_births[m.intent, m.phase] + m.birth for m in modes]),
            "owner_of": np.array(owners),
            "sign": np.array([float(m.sign) for m in modes]),
            "share": np.array([1.0 / len(model.phase_of(m).signs) for m in modes]),
            "first": np.array([float(m.phase == 0) for m in modes]),
            "swings": np.array([model.law_of(m).second_order for m in modes]),
            "leave": leave,
            "again": again,
            "onward": onward,
        }
        for name, value in named.items():
            self.register_buffer(f"_{name}", torch.as_tensor(value), persistent=False)

    @classmethod
    def from_model(cls, model: IntentModel) -> ModelParameters:
        """Parameters that give ``model`` back."""
        return cls(model)

    @property
    def damping(self) -> Tensor:
        """Damping of each phase's swing; (F,)."""
        low, high = _DAMPING
        return low + (high - low) * torch.sigmoid(self.damping_logit)

    def birth_weights(self) -> Tensor:
        """Share of each component within its phase; (C,)."""
        top = torch.full((len(self.log_wobble),), -torch.inf, dtype=torch.float64, device=self.birth_logit.device)
        top = top.scatter_reduce(0, self._owner_of, self.birth_logit.detach(), "amax")
        raw = torch.exp(self.birth_logit - top[self._owner_of])
        total = torch.zeros_like(top).index_add(0, self._owner_of, raw)
        return raw / total[self._owner_of]

    def generator(self) -> Tensor:
        """Rates between modes; (M, M), 1/s."""
        entry = self.birth_weights()[self._birth_of] * self._share
        i, p = self._intent_of, self._phase_of
        rates = _positive(self.log_rates)[i][:, i] * self._leave
        rates = rates + _positive(self.log_renewal)[i][:, None] * self._again
        rates = rates + torch.exp(-self.log_duration)[p][:, None] * self._onward
        rates = rates * entry
        return rates - torch.diag(rates.sum(1))

    def initial(self) -> Tensor:
        """Mode probabilities at the start of a track; (M,)."""
        intents = torch.softmax(self.initial_logit, 0)
        return intents[self._intent_of] * self.birth_weights()[self._birth_of] * self._share * self._first

    def births(self) -> tuple[Tensor, Tensor]:
        """Mean and variance of the own parameters of each mode; (M, K) twice."""
        b, axes, slope = self._birth_of, self.model.axes, self.model.second_order
        turns = 1 if axes == 2 else 3
        growth = (_GROWTH_UNIT * self.birth_growth)[b]
        turn = (_TURN_UNIT * self.birth_turn)[b] * self._sign
        means = [growth] + [turn] * turns
        turn_var = _positive(self.log_birth_turn_sd, 2.0)[b]
        variances = [_positive(self.log_birth_growth_sd, 2.0)[b]] + [turn_var] * turns
        if slope:
            means += [torch.zeros_like(turn)] * turns
            kick = _positive(self.log_birth_swing_sd, 2.0)[b]
            variances += [torch.where(self._swings, kick, torch.ones_like(kick))] * turns
        return torch.stack(means, 1), torch.stack(variances, 1)

    def tables(self, dt: Tensor) -> tuple[Tensor, Tensor]:
        """What steps of ``dt`` (U,) seconds do: law tables (U, M, 32) and Markov matrices (U, M, M)."""
        p = self._phase_of
        law = {
            "growth_mean": (_GROWTH_UNIT * self.growth_mean)[p],
            "growth_rate": _positive(self.log_growth_rate)[p],
            "growth_noise": _positive(self.log_growth_noise)[p],
            "turn_mean": (_TURN_UNIT * self.turn_mean)[p] * self._sign,
            "turn_rate": _positive(self.log_turn_rate)[p],
            "turn_noise": _positive(self.log_turn_noise)[p],
            "wobble": _positive(self.log_wobble)[p],
            "natural": _positive(self.log_natural)[p],
            "damping": self.damping[p],
        }
        chain = markov_matrices(self.generator(), dt)
        return law_tables(law, dt, self._swings, self.model.second_order), chain

    def to_model(self, **changes: object) -> IntentModel:
        """The model these parameters stand for; ``changes`` replace further fields (``about``, ``speed``).

        Raises:
            ValueError: a parameter has left the range of numbers.
        """
        model = self.model
        value = {
            name: _exact(getattr(self, f"log_{name}"))
            for name in (
                *("growth_rate", "growth_noise", "turn_rate", "turn_noise", "wobble", "natural", "duration", "renewal"),
                *("birth_growth_sd", "birth_turn_sd", "birth_swing_sd", "rates"),
            )
        }
        damping = self.damping.detach().cpu().numpy().clip(*_DAMPING)
        weights = self.birth_weights().detach().cpu().numpy().clip(1e-300)
        growth_mean, turn_mean = (
            unit * mean.detach().cpu().numpy()
            for unit, mean in ((_GROWTH_UNIT, self.growth_mean), (_TURN_UNIT, self.turn_mean))
        )
        birth_growth, birth_turn = (
            unit * mean.detach().cpu().numpy()
            for unit, mean in ((_GROWTH_UNIT, self.birth_growth), (_TURN_UNIT, self.birth_turn))
        )
        intents, f, c = [], 0, 0
        for p, intent in enumerate(model.intents):
            phases = []
            for phase in intent.phases:
                births = []
                for _ in phase.births:
                    births.append(
                        Birth(
                            float(weights[c]),
                            float(birth_growth[c]),
                            float(value["birth_growth_sd"][c]),
                            float(birth_turn[c]),
                            float(value["birth_turn_sd"][c]),
                            float(value["birth_swing_sd"][c]),
                        )
                    )
                    c += 1
                law = replace(
                    phase.law,
                    growth_mean=float(growth_mean[f]),
                    growth_rate=float(value["growth_rate"][f]),
                    growth_noise=float(value["growth_noise"][f]),
                    turn_mean=float(turn_mean[f]),
                    turn_rate=float(value["turn_rate"][f]),
                    turn_noise=float(value["turn_noise"][f]),
                    wobble=float(value["wobble"][f]),
                    swing=None if phase.law.swing is None else (float(value["natural"][f]), float(damping[f])),
                )
                phases.append(replace(phase, law=law, births=tuple(births), duration=float(value["duration"][f])))
                f += 1
            intents.append(Intent(intent.name, tuple(phases), float(value["renewal"][p])))
        rates = value["rates"].copy()
        np.fill_diagonal(rates, 0.0)
        np.fill_diagonal(rates, -rates.sum(1))
        initial = torch.softmax(self.initial_logit, 0).detach().cpu().numpy()
        noise = None if self.log_noise is None else tuple(_exact(self.log_noise).tolist())
        made = replace(
            model,
            intents=tuple(intents),
            generator=tuple(tuple(row) for row in rates.tolist()),
            initial=tuple((initial / initial.sum()).tolist()),
            noise_sd=noise,
        )
        return made.with_(**changes) if changes else made
