"""A learned set of intents, and the bank of modes it stands for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import position
from jink.intent.describing import describe_intent, say_lasting
from jink.intent.laws import Birth, Law, Phase
from jink.intent.rollouts import follow
from jink.intent.sides import spell_length

__all__ = ["Intent", "IntentModel", "ModeRecord"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Intent:
    """What a target may be trying to do.

    Args:
        name: shown in tables; distinct within a model.
        phases: one for an ordinary intent; several, run through in order, for the template of a finite manoeuvre.
        renewal: rate at which it begins anew with other parameters (a left turn after a right one); 1/s.

    Raises:
        ValueError: no phase, phases of unlike axes, or a negative rate.
    """

    name: str
    phases: tuple[Phase, ...]
    renewal: float = 0.0

    def __post_init__(self) -> None:
        phases = (self.phases,) if isinstance(self.phases, Phase) else tuple(self.phases)
        object.__setattr__(self, "phases", phases)
        if not self.name or not isinstance(self.name, str):
            raise ValueError(f"Intent: name must be a non-empty string; got {self.name!r}. Write for instance 'turn'.")
        if not phases or not all(isinstance(phase, Phase) for phase in phases):
            raise ValueError(f"Intent: phases of {self.name} must hold one or more Phase; got {phases!r}. Add one.")
        axes = {phase.law.axes for phase in phases}
        if len(axes) > 1:
            raise ValueError(f"Intent: phases of {self.name} must have equal axes; got {sorted(axes)}. Use one space.")
        if not (isinstance(self.renewal, (int, float)) and 0 <= self.renewal < math.inf):
            raise ValueError(f"Intent: renewal must be >= 0 1/s and finite; got {self.renewal!r}. Use 0 for never.")

    @property
    def axes(self) -> int:
        """2 or 3."""
        return self.phases[0].law.axes


class ModeRecord(NamedTuple):
    """One mode of the bank: which component of which phase of which intent, and whether mirrored (sign -1)."""

    name: str
    intent: int
    phase: int
    birth: int
    sign: int


@dataclass(frozen=True)
class IntentModel:
    """Everything learned about a kind of target: its intents and how they follow each other.

    A switch enters the first phase of an intent, at a birth component with the probability of its weight (half of it
    for each side if mirrored), with shape parameters drawn anew; a template keeps its side from phase to phase where
    both phases are mirrored. An intent is left from its last phase.

    Args:
        axes: 2 or 3.
        intents: one or more, all with these axes.
        generator: rates between intents, row = from, rows sum to 0; (P, P), 1/s.
        initial: intent probabilities at the start of a track; (P,).
        noise_sd: standard deviation of the measurement noise that was learned, (A,), m; None: the sensor's own.
        speed: standard deviation of each velocity component before anything is known; m/s.
        about: where the model comes from (seed, command, versions, tracks, likelihood curve).
        endings: how often an intent gave way to another on the tracks that were learned from, as the smoother sees it
            (`jink.intent.endings`), per second spent in it; (P,); 1/s; empty: unknown. Filters do not use it: the chain
            that predicts best is not how long intents last.

    Raises:
        ValueError: the parts do not fit; the sentence names them.

    Source: patent CN202211553542, claims 2, 4-6. Differs: births, mirrored components and templates are ours.
    """

    axes: int
    intents: tuple[Intent, ...]
    generator: tuple[tuple[float, ...], ...] = ()
    initial: tuple[float, ...] = ()
    noise_sd: tuple[float, ...] | None = None
    speed: float = 10.0
    about: Mapping[str, object] = field(default_factory=dict, compare=False)
    endings: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "intents", (self.intents,) if isinstance(self.intents, Intent) else tuple(self.intents))
        put(self, "about", dict(self.about))
        count = len(self.intents)
        if self.axes not in (2, 3):
            raise ValueError(f"IntentModel: axes must be 2 or 3; got {self.axes!r}. Use 2 for the plane, 3 for space.")
        if not count:
            raise ValueError("IntentModel: intents must hold at least one Intent; got none. Add one.")
        names = [intent.name for intent in self.intents]
        if len(set(names)) != count:
            raise ValueError(f"IntentModel: intents must have distinct names; got {names}. Rename one.")
        for intent in self.intents:
            if intent.axes != self.axes:
                raise ValueError(
                    f"IntentModel: intents must have {self.axes} axes; {intent.name} has {intent.axes}. "
                    f"Write Law(axes={self.axes}, ...)."
                )
        rates = _matrix("generator", self.generator, (count, count), np.zeros((count, count)))
        off = rates - np.diag(np.diag(rates))
        if (off < 0).any() or np.any(np.abs(rates.sum(axis=1)) > 1e-9 * (1 + off.max(initial=0.0))):
            raise ValueError(
                "IntentModel: generator must have off-diagonal rates >= 0 and rows that sum to 0; got "
                f"{rates.tolist()}. Put minus the sum of the other rates on the diagonal."
            )
        probs = _matrix("initial", self.initial, (count,), np.full(count, 1.0 / count))
        if (probs < 0).any() or abs(probs.sum() - 1.0) > 1e-9:
            raise ValueError(
                f"IntentModel: initial must be {count} probabilities that sum to 1; got {probs.tolist()}. "
                "Divide by the sum."
            )
        put(self, "generator", tuple(tuple(row) for row in rates.tolist()))
        put(self, "initial", tuple(probs.tolist()))
        if self.noise_sd is not None:
            noise = _matrix("noise_sd", self.noise_sd, (self.axes,), np.zeros(0))
            if not (noise > 0).all():
                raise ValueError(f"IntentModel: noise_sd must be > 0 m; got {noise.tolist()}. Leave it out if unknown.")
            put(self, "noise_sd", tuple(noise.tolist()))
        if not (isinstance(self.speed, (int, float)) and 0 < self.speed < math.inf):
            raise ValueError(
                f"IntentModel: speed must be > 0 m/s and finite; got {self.speed!r}. Give a typical speed."
            )
        put(self, "speed", float(self.speed))
        if len(self.endings):
            endings = _matrix("endings", self.endings, (count,), np.zeros(0))
            if (endings < 0).any():
                raise ValueError(
                    f"IntentModel: endings must be >= 0 1/s; got {endings.tolist()}. Leave them out if unknown."
                )
            put(self, "endings", tuple(endings.tolist()))
        else:
            put(self, "endings", ())

    @property
    def second_order(self) -> bool:
        """A law swings; then every mode carries the slope of its turn rate."""
        return any(phase.law.second_order for intent in self.intents for phase in intent.phases)

    @cached_property
    def modes(self) -> tuple[ModeRecord, ...]:
        """The modes of the bank: by intent, phase, birth component, side."""
        records = []
        for p, intent in enumerate(self.intents):
            for k, phase in enumerate(intent.phases):
                for b in range(len(phase.births)):
                    for sign in phase.signs:
                        name = intent.name
                        name += f" phase {k + 1}" if len(intent.phases) > 1 else ""
                        name += f" birth {b + 1}" if len(phase.births) > 1 else ""
                        name += (" left" if sign > 0 else " right") if phase.mirrored else ""
                        records.append(ModeRecord(name, p, k, b, sign))
        return tuple(records)

    def phase_of(self, mode: ModeRecord) -> Phase:
        """The phase a mode belongs to."""
        return self.intents[mode.intent].phases[mode.phase]

    def law_of(self, mode: ModeRecord) -> Law:
        """The law of a mode, on its side."""
        law = self.phase_of(mode).law
        return law if mode.sign > 0 else law.mirrored()

    def birth_of(self, mode: ModeRecord) -> Birth:
        """What a mode begins with, on its side."""
        birth = self.phase_of(mode).births[mode.birth]
        return birth if mode.sign > 0 else birth.mirrored()

    @cached_property
    def entry(self) -> Floats:
        """Share of each mode when its phase is entered from elsewhere; (M,)."""
        return np.array([self.phase_of(m).births[m.birth].weight / len(self.phase_of(m).signs) for m in self.modes])

    def mode_generator(self) -> Floats:
        """Rates between modes, row = from; (M, M), 1/s."""
        modes, entry = self.modes, self.entry
        intents = np.array(self.generator)
        rates = np.zeros((len(modes), len(modes)))
        for i, old in enumerate(modes):
            last = len(self.intents[old.intent].phases) - 1
            for j, new in enumerate(modes):
                if i == j:
                    continue
                if old.phase == last and new.phase == 0:
                    same = old.intent == new.intent
                    rate = self.intents[old.intent].renewal if same else intents[old.intent, new.intent]
                    rates[i, j] += rate * entry[j]
                if new.intent == old.intent and new.phase == old.phase + 1:
                    share = entry[j]
                    if self.phase_of(old).mirrored and self.phase_of(new).mirrored:
                        share *= 2.0 * (old.sign == new.sign)
                    rates[i, j] += share / self.phase_of(old).duration
        np.fill_diagonal(rates, -rates.sum(axis=1))
        return rates

    def mode_initial(self) -> Floats:
        """Mode probabilities at the start of a track: intents at their first phase; (M,)."""
        return np.array(
            [self.initial[m.intent] * e if m.phase == 0 else 0.0 for m, e in zip(self.modes, self.entry, strict=True)]
        )

    def motion(self, mode: int | str) -> Motion:
        """The motion function f_p of a mode, by number or name."""
        names = [record.name for record in self.modes]
        if isinstance(mode, str):
            if mode not in names:
                raise ValueError(f"IntentModel: mode must be one of {', '.join(names)}; got {mode!r}. See .modes.")
            mode = names.index(mode)
        if not 0 <= mode < len(names):
            raise ValueError(f"IntentModel: mode must be in 0 .. {len(names) - 1}; got {mode}. See .modes.")
        record = self.modes[mode]
        return self.law_of(record).motion(self.birth_of(record), slope=self.second_order)

    def bank(self, sensor: Sensor | None = None, **options: object) -> Bank:
        """The bank of these intents for the compiled core; no torch is needed to run it.

        Args:
            sensor: what is measured; None: position with the noise that was learned.
            **options: of `Bank`.

        Raises:
            ValueError: no sensor and no learned noise, or a sensor of other axes.
        """
        if sensor is None:
            if self.noise_sd is None:
                raise ValueError(
                    "IntentModel: sensor must be given as no measurement noise was learned; got None. "
                    f"Pass position({self.axes}, sigma)."
                )
            sensor = position(self.axes, self.noise_sd)
        records = self.modes
        modes = tuple(Mode(record.name, self.motion(i)) for i, record in enumerate(records))
        chain = None
        if len(modes) > 1:
            chain = MarkovChain(generator=tuple(tuple(row) for row in self.mode_generator().tolist()))
        initial = self.mode_initial()
        bank = Bank(
            modes,
            sensor,
            chain=chain,
            initial_probs=tuple((initial / initial.sum()).tolist()),
            interaction="birth",
            speed=self.speed,
        )
        return bank.with_(**options) if options else bank

    def estimator(
        self, sensor: Sensor | None = None, *, threads: int | None = None, **options: object
    ) -> BankEstimator:
        """An estimator that tracks with this bank; arguments as `bank`."""
        return BankEstimator(self.bank(sensor, **options), name="intent-imm", threads=threads)

    def intent_probs(self, mode_probs: ArrayLike) -> Floats:
        """Probability of each intent; (..., M) to (..., P)."""
        probs = np.asarray(mode_probs, dtype=np.float64)
        if probs.shape[-1:] != (len(self.modes),):
            raise ValueError(
                f"IntentModel: mode_probs must end in {len(self.modes)} modes; got shape {probs.shape}. See .modes."
            )
        out = np.zeros((*probs.shape[:-1], len(self.intents)))
        for i, record in enumerate(self.modes):
            out[..., record.intent] += probs[..., i]
        return out

    def mode_shares(self) -> Floats:
        """Share of time spent in each mode in the long run (of the start, where nothing is ever left); (M,)."""
        rates = self.mode_generator()
        start = self.mode_initial()
        # the resolvent at a rate far below any switch: also defined for chains that fall apart
        slow = 1e-9 * max(float(-rates.diagonal().min()), 1e-12)
        shares = np.linalg.solve((slow * np.eye(len(start)) - rates).T, slow * start)
        shares = np.clip(shares, 0.0, None)
        return np.asarray(shares / shares.sum())

    def describe(self) -> str:
        """One line per intent that a person can read."""
        shares = self.intent_probs(self.mode_shares())
        return "\n".join(
            describe_intent(
                number + 1,
                intent.name,
                intent.phases,
                [spell_length(self, number, k) for k in range(len(intent.phases))],
                self.spell_lasting(number),
                float(share),
            )
            for number, (intent, share) in enumerate(zip(self.intents, shares, strict=True))
        )

    def chain_lasting(self, number: int) -> float:
        """Mean time in an intent with all its phases if the chain were the truth, s; inf where it never ends."""
        leaving = -self.generator[number][number]
        before = math.fsum(phase.duration for phase in self.intents[number].phases[:-1])
        return before + (1.0 / leaving if leaving > 0 else math.inf)

    def lasting(self, number: int) -> float:
        """Mean time in an intent, s; inf where it never ends.

        From its beginning until another one follows: a renewal (a left turn after a right one) does not end it. As seen
        on the tracks that were learned from (``endings``); where that is unknown, by the chain.
        """
        if not self.endings:
            return self.chain_lasting(number)
        return 1.0 / self.endings[number] if self.endings[number] > 1e-300 else math.inf

    def spell_lasting(self, number: int) -> str:
        """`lasting` in words: "lasts 21 s", "never ends"; it says "by its chain" where nothing better is known."""
        return say_lasting(self.lasting(number), bool(self.endings))

    def rollout(
        self,
        intent: int | str,
        kin: ArrayLike,
        own: ArrayLike | None = None,
        times: ArrayLike = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
        *,
        sign: int = 1,
    ) -> Floats:
        """The motion function M_p(c; tau): where a target with that intent is after ``times`` seconds, without noise.

        Args:
            intent: number or name.
            kin: position and velocity at time 0; (2A,); m, m/s.
            own: shape parameters at time 0, as the motion orders them (g, w[, u]); (K,); None: those of its heaviest
                birth component. A template begins every later phase with those of that phase.
            times: increasing, >= 0; (T,); s.
            sign: -1: left and right exchanged (where mirrored, and only where ``own`` is None).

        Returns:
            Positions (T, A); m.

        Raises:
            ValueError: an unknown intent, a wrong shape, or numbers that are not finite.
        """
        names = [item.name for item in self.intents]
        number = names.index(intent) if isinstance(intent, str) and intent in names else intent
        if not isinstance(number, (int, np.integer)) or not 0 <= number < len(names):
            raise ValueError(f"rollout: intent must be a number below {len(names)} or one of {names}; got {intent!r}.")
        for name, value, unit in (("kin", kin, "m and m/s"), ("own", own, "1/s and rad/s"), ("times", times, "s")):
            if value is not None and not np.isfinite(np.asarray(value, dtype=np.float64)).all():
                raise ValueError(f"rollout: {name} must be finite; got {value!r}. Give numbers in {unit}.")
        legs = []
        phases = self.intents[int(number)].phases
        for phase in phases:
            heaviest = max(phase.births, key=lambda birth: birth.weight)
            law = phase.law
            if sign < 0 and phase.mirrored:
                law, heaviest = law.mirrored(), heaviest.mirrored()
            legs.append((law.motion(heaviest, slope=self.second_order), phase.duration))
        return follow(legs, np.asarray(kin, dtype=np.float64), own, np.asarray(times, dtype=np.float64))

    def with_(self, **changes: object) -> IntentModel:
        """A copy with some fields changed; ``endings`` are forgotten where intents or their chain become others."""
        if not {"intents", "generator"}.isdisjoint(changes):
            changes = {"endings": (), **changes}
        return replace(self, **changes)  # type: ignore[arg-type]


def _matrix(name: str, value: Sequence[object], shape: tuple[int, ...], default: Floats) -> Floats:
    array = np.asarray(value, dtype=np.float64) if len(value) else default
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(
            f"IntentModel: {name} must be finite with shape {shape}; got {array.tolist()}. One per intent."
        )
    return array
