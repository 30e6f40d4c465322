"""Fewer intents: two that share a law become one, one that follows another becomes its next phase, one is left out.

What an intent is shows in the chain alone: two births of one intent never follow each other directly, two intents do.
So joining is a restriction of the model, and the likelihood tells what it costs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent, IntentModel
from jink.intent.sides import keeps_side, spell_length

__all__ = [
    "MOST_BIRTHS",
    "alike",
    "append",
    "closest_joined",
    "join_births",
    "merge",
    "settled",
    "shorter",
    "tidy",
    "without",
]

Floats = NDArray[np.float64]
MOST_BIRTHS = 4
_SAME_PERIOD = 0.2  # log of the ratio of two periods that are one
_SAME_SPREAD = 3.0  # ratio of two spreads that are one
_ONE_SIDED = 0.5  # standard deviations of the turn rate from zero below which left and right are not told apart


def settled(model: IntentModel) -> IntentModel:
    """The same model beginning as it goes on: initial probabilities are those of the long run."""
    if len(model.intents) == 1:
        return model
    shares = model.intent_probs(model.mode_shares())
    return model.with_(initial=tuple((shares / shares.sum()).tolist()))


def _flows(model: IntentModel) -> tuple[Floats, Floats]:
    """Share of time of each intent (P,), and switches per second from each to each (P, P)."""
    shares = model.intent_probs(model.mode_shares())
    lasting = np.array([model.chain_lasting(i) for i in range(len(model.intents))])
    rates = np.array(model.generator)
    off = rates - np.diag(np.diag(rates))
    leaving = off.sum(axis=1)
    ends = np.divide(shares, lasting, out=np.zeros_like(shares), where=lasting > 0)
    targets = np.divide(off, leaving[:, None], out=np.zeros_like(off), where=leaving[:, None] > 0)
    return shares, ends[:, None] * targets


def _rebuilt(
    model: IntentModel, intents: Sequence[Intent], flows: Floats, shares: Floats, lasts: Sequence[float]
) -> IntentModel:
    """A model of the given intents: ``flows`` (P, P) switches per second, ``lasts`` share of time of the last phase."""
    count = len(intents)
    generator = np.zeros((count, count))
    for i in range(count):
        if lasts[i] > 0:
            generator[i] = flows[i] / lasts[i]
        generator[i, i] = 0.0
        generator[i, i] = -generator[i].sum()
    probs = shares / shares.sum()
    made = model.with_(
        intents=tuple(intents), generator=tuple(map(tuple, generator.tolist())), initial=tuple(probs.tolist())
    )
    return settled(made)


def _last_shares(model: IntentModel, shares: Floats) -> list[float]:
    """Share of time in the last phase of each intent."""
    found = []
    for i, intent in enumerate(model.intents):
        whole = model.chain_lasting(i)
        last = whole - math.fsum(phase.duration for phase in intent.phases[:-1])
        found.append(float(shares[i]) * (last / whole if math.isfinite(whole) else 1.0))
    return found


def merge(model: IntentModel, first: int, second: int, *, renewed: bool = False) -> IntentModel | None:
    """Two intents as one with the births of both; None where their laws have unlike parts.

    Noises become averages of their logs, weighted with the time in each; births are weighted with how often each intent
    begins. Direct switches between the two are gone; or, ``renewed``, they are the one intent that begins anew, which
    only twins can be (`alike`): any two intents with births of their own could be called one otherwise.
    """
    one, two = model.intents[first], model.intents[second]
    if len(one.phases) > 1 or len(two.phases) > 1:
        return None
    laws = one.phases[0].law, two.phases[0].law
    if (laws[0].swing is None) != (laws[1].swing is None):
        return None
    shares, flows = _flows(model)
    time = shares[[first, second]] + 1e-12
    begins = np.array([flows[:, k].sum() - flows[other, k] for k, other in ((first, second), (second, first))]) + 1e-12
    law = _average(laws[0], laws[1], time / time.sum())
    births = [
        replace(birth, weight=birth.weight * share)
        for intent, share in zip((one, two), begins / begins.sum(), strict=True)
        for birth in intent.phases[0].births
    ]
    if renewed and not alike(one.phases[0], two.phases[0]):
        return None
    mirrored = one.phases[0].mirrored or two.phases[0].mirrored
    phase = Phase(law, _normalised(births), mirrored)
    again = max(one.renewal, two.renewal)
    if renewed:
        other = 1.0 - math.fsum(
            birth.weight**2 for birth in phase.births
        )  # a mode that begins anew as itself is no switch
        switches = float(flows[first, second] + flows[second, first])
        again += switches / max(float(shares[first] + shares[second]) * other, 1e-12)
    joined = Intent(one.name, (phase,), again)
    keep = [i for i in range(len(model.intents)) if i != second]
    moved = flows.copy()
    moved[first] += moved[second]
    moved[:, first] += moved[:, second]
    moved = moved[np.ix_(keep, keep)]
    np.fill_diagonal(moved, 0.0)
    total, lasts = shares.copy(), _last_shares(model, shares)
    total[first] += total[second]
    lasts[first] += lasts[second]
    intents = [joined if i == first else model.intents[i] for i in keep]
    return tidy(_rebuilt(model, intents, moved, total[keep], [lasts[i] for i in keep]))


def alike(one: Phase, two: Phase) -> bool:
    """Two phases of one law that begin with the same: births and weaves overlap."""
    if one.mirrored != two.mirrored or (one.law.swing is None) != (two.law.swing is None):
        return False
    swings = [phase.law.swing[0] for phase in (one, two) if phase.law.swing is not None]
    if swings and abs(math.log(swings[0] / swings[1])) > _SAME_PERIOD:
        return False
    if len(one.births) != len(two.births):
        return False
    return all(_alike(a, b) for a, b in zip(*(sorted(p.births, key=_place) for p in (one, two)), strict=True))


def _place(birth: Birth) -> tuple[float, float]:
    return birth.growth_mean, birth.turn_mean


def _alike(a: Birth, b: Birth) -> bool:
    pairs = ((a.growth_mean, a.growth_sd, b.growth_mean, b.growth_sd), (a.turn_mean, a.turn_sd, b.turn_mean, b.turn_sd))
    return not any(
        abs(mean - other) > math.hypot(sd, other_sd) or max(sd, other_sd) > _SAME_SPREAD * min(sd, other_sd)
        for mean, sd, other, other_sd in pairs
    )


def append(model: IntentModel, first: int, second: int) -> IntentModel | None:
    """``second`` as the next phase of ``first``: a template; None where that would be no restriction."""
    count = len(model.intents)
    if count < 3:
        return None
    shares, flows = _flows(model)
    one, two = model.intents[first], model.intents[second]
    if flows[first].sum() <= 0 or len(one.phases) + len(two.phases) > 4:
        return None
    before = [replace(phase) for phase in one.phases]
    leaving = -model.generator[first][first]
    before[-1] = replace(before[-1], duration=1.0 / leaving)
    joined = Intent(one.name, (*before, *two.phases))
    keep = [i for i in range(count) if i != second]
    moved = flows.copy()
    moved[first] = flows[second]
    moved[:, second] = 0.0
    moved = moved[np.ix_(keep, keep)]
    np.fill_diagonal(moved, 0.0)
    total, lasts = shares.copy(), _last_shares(model, shares)
    total[first] += total[second]
    lasts[first] = lasts[second]
    intents = [joined if i == first else model.intents[i] for i in keep]
    return _rebuilt(model, intents, moved, total[keep], [lasts[i] for i in keep])


def shorter(model: IntentModel, number: int, phase: int) -> IntentModel:
    """A template without one of its phases: the next phase, or the one before the last, lasts so much longer."""
    phases = list(model.intents[number].phases)
    leaving = -model.generator[number][number]
    lasts = [*(entry.duration for entry in phases[:-1]), 1.0 / leaving]
    del phases[phase]
    spare = lasts.pop(phase)
    lasts[min(phase, len(lasts) - 1)] += spare
    kept = tuple(replace(entry, duration=lasting) for entry, lasting in zip(phases, lasts, strict=True))
    intents, rates = list(model.intents), np.array(model.generator)
    intents[number] = replace(intents[number], phases=kept)
    rates[number] *= 1.0 / (lasts[-1] * leaving)
    return settled(model.with_(intents=tuple(intents), generator=tuple(map(tuple, rates.tolist()))))


def without(model: IntentModel, number: int) -> IntentModel:
    """The model without one intent: what went to it goes on to where it led."""
    shares, flows = _flows(model)
    keep = [i for i in range(len(model.intents)) if i != number]
    out = flows[number].copy()
    moved = flows.copy()
    if out.sum() > 0:
        moved += np.outer(flows[:, number], out / out.sum())
    moved = moved[np.ix_(keep, keep)]
    np.fill_diagonal(moved, 0.0)
    lasts = _last_shares(model, shares)
    intents = [model.intents[i] for i in keep]
    return _rebuilt(model, intents, moved, shares[keep] + 1e-12, [lasts[i] + 1e-12 for i in keep])


def _average(one: Law, two: Law, shares: Floats) -> Law:
    def mean(a: float, b: float) -> float:
        if a <= 0.0 or b <= 0.0:
            return float(shares[0] * a + shares[1] * b)
        return float(math.exp(shares[0] * math.log(a) + shares[1] * math.log(b)))

    names = ("growth_rate", "growth_noise", "turn_rate", "turn_noise", "wobble")
    changed: dict[str, object] = {name: mean(getattr(one, name), getattr(two, name)) for name in names}
    for name in ("growth", "turn"):  # a law that forgets nothing has no mean
        weights = [share * (getattr(law, f"{name}_rate") > 0.0) for share, law in zip(shares, (one, two), strict=True)]
        means = [getattr(law, f"{name}_mean") for law in (one, two)]
        changed[f"{name}_mean"] = float(np.dot(weights, means) / max(sum(weights), 1e-300))
    if one.swing is not None and two.swing is not None:
        changed["swing"] = (mean(one.swing[0], two.swing[0]), mean(one.swing[1], two.swing[1]))
    return replace(one, **changed)  # type: ignore[arg-type]


def _normalised(births: Sequence[Birth]) -> tuple[Birth, ...]:
    total = math.fsum(birth.weight for birth in births)
    return tuple(replace(birth, weight=birth.weight / total) for birth in births)


def tidy(model: IntentModel, most: int = MOST_BIRTHS) -> IntentModel:
    """Few births per phase, sides only where left and right differ; the heaviest birth first."""
    intents = []
    for i, intent in enumerate(model.intents):
        phases = []
        for k, phase in enumerate(intent.phases):
            births = list(phase.births)
            while len(births) > most:
                births = closest_joined(births)
            births.sort(key=lambda birth: -birth.weight)
            lasts = spell_length(model, i, k)
            mirrored = phase.mirrored and any(keeps_side(phase, birth, lasts, _ONE_SIDED) for birth in births)
            law = phase.law if mirrored or not phase.mirrored else replace(phase.law, turn_mean=0.0)
            if phase.mirrored:
                one_side = math.copysign(1.0, law.turn_mean) if law.turn_mean else None
                law = replace(law, turn_mean=abs(law.turn_mean))
                births = [
                    replace(birth, turn_mean=abs(birth.turn_mean) if one_side is None else one_side * birth.turn_mean)
                    if mirrored
                    else replace(birth, turn_mean=0.0, turn_sd=math.hypot(birth.turn_sd, birth.turn_mean))
                    for birth in births
                ]
            phases.append(Phase(law, _normalised(births), mirrored, phase.duration))
        intents.append(replace(intent, phases=tuple(phases)))
    return model.with_(intents=tuple(intents))


def closest_joined(births: list[Birth]) -> list[Birth]:
    """The two nearest births, in standard deviations of what they would become, moment matched into one."""
    best, pair = math.inf, (0, 1)
    for i, one in enumerate(births):
        for j in range(i + 1, len(births)):
            both = join_births(one, births[j])
            cost = (one.weight + births[j].weight) * (
                math.log(max(both.growth_sd, 1e-12) * max(both.turn_sd, 1e-12))
            ) - sum(b.weight * math.log(max(b.growth_sd, 1e-12) * max(b.turn_sd, 1e-12)) for b in (one, births[j]))
            if cost < best:
                best, pair = cost, (i, j)
    rest = [birth for k, birth in enumerate(births) if k not in pair]
    return [*rest, join_births(births[pair[0]], births[pair[1]])]


def join_births(one: Birth, two: Birth) -> Birth:
    """One component with the moments of two."""
    weight = one.weight + two.weight
    a, b = one.weight / weight, two.weight / weight

    def moments(m: float, s: float, n: float, t: float) -> tuple[float, float]:
        mean = a * m + b * n
        return mean, math.sqrt(a * (s * s + (m - mean) ** 2) + b * (t * t + (n - mean) ** 2))

    growth = moments(one.growth_mean, one.growth_sd, two.growth_mean, two.growth_sd)
    turn = moments(abs(one.turn_mean), one.turn_sd, abs(two.turn_mean), two.turn_sd)
    swing = math.sqrt(a * one.swing_sd**2 + b * two.swing_sd**2)
    return Birth(min(weight, 1.0), *growth, *turn, swing)
