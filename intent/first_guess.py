"""Where learning begins: more intents than there will be, laid over what windows of the tracks say."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.features import Features, encode
from jink.intent.joining import settled
from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent, IntentModel
from jink.intent.sizes import Sizes
from jink.intent.window import choose_window

__all__ = [
    "STILL",
    "Guess",
    "first_intents",
    "guess",
    "law_like",
    "level",
    "one_intent",
    "restless_intents",
    "shaky",
    "weave_of",
    "weave_periods",
]

Floats = NDArray[np.float64]
_SPELLS = 6.0
_QUIET, _DRIFT = 0.05, 0.4
STILL = 0.1
"""Spread of a shape parameter that an intent leaves at zero, as a share of its typical size."""
_WINDOW = 0.15  # of a piece: a longer window would hold more than one spell
_SLOW = 3.0  # standard deviations of speed
_PERIODS = (2.4, 3.6, 5.4, 8.0, 12.0, 18.0)  # steps
_LONGEST = 0.26  # of a piece: two periods must fit into a spell
_SWAY = 0.25  # rad
_FORGETS = 3.0  # times per step that a shaky turn forgets its rate
_SHAKE = 0.5  # of a typical turn per step


class Guess(NamedTuple):
    """Windows of the tracks, sizes of what is in them, and how strongly each shape parameter shows."""

    features: Features
    sizes: Sizes
    growths: Floats
    turns: Floats


def guess(tracks: Tracks, noise_sd: float | None = None) -> Guess:
    """What the tracks say before any filter has run."""
    steps = np.diff(tracks.times, axis=1)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    last = tracks.times[np.arange(len(tracks)), np.maximum(tracks.lengths - 1, 0)]
    duration = float(np.median(last - tracks.times[:, 0])) or step
    window = min(choose_window(tracks, noise_sd), max(_WINDOW * duration, 5.0 * step))
    features = encode(tracks, window, noise_sd)
    sound = features.valid & (features.speed_ratio > _SLOW)
    speeds = np.linalg.norm(features.velocity[features.valid], axis=-1)
    eta, variance = features.eta[sound], np.diagonal(features.eta_cov, axis1=-2, axis2=-1)[sound]
    if len(eta) < 10:
        eta, variance = np.zeros((10, features.eta.shape[-1])), np.ones((10, features.eta.shape[-1]))
    turn = np.linalg.norm(eta[:, 1:], axis=1) if tracks.axes == 3 else eta[:, 1]
    turn_variance = variance[:, 1:].mean(axis=1)
    growths = eta[:, 0][eta[:, 0] ** 2 > 4.0 * variance[:, 0]]
    turns = np.abs(turn[turn**2 > 4.0 * turn_variance * (1 if tracks.axes == 2 else 3)])
    speed = float(np.sqrt(np.mean(np.square(np.minimum(speeds, 3.0 * np.median(speeds)))))) if speeds.size else 1.0
    least = 0.01 / max(duration, step)
    growth = float(np.quantile(np.abs(growths), 0.75)) if growths.size > 20 else least
    turning = float(np.quantile(turns, 0.75)) if turns.size > 20 else least
    speed = max(speed, 1e-9)
    sizes = Sizes(speed, max(growth, least), max(turning, least), speed * max(growth, turning, least), duration, step)
    return Guess(features, sizes, growths, turns)


def law_like(axes: int, sizes: Sizes, swing: tuple[float, float] | None = None) -> Law:
    """A law to begin with: shape parameters that drift a little, and a weave that is kept going."""
    turn_noise = _DRIFT**2 * sizes.turn**2 / sizes.duration
    if swing is not None:
        turn_noise = 4.0 * swing[1] * swing[0] ** 3 * (0.3 * sizes.turn) ** 2
    return Law(
        axes,
        growth_noise=_DRIFT**2 * sizes.growth**2 / sizes.duration,
        turn_noise=turn_noise,
        wobble=(_QUIET * sizes.acceleration) ** 2 * sizes.step,
        swing=swing,
    )


def level(values: Floats, q: float, size: float) -> float:
    """Quantile of what windows show; where they show little, that share of a typical size."""
    return float(np.quantile(values, q)) if values.size > 20 else q * size


def first_intents(found: Guess, axes: int, most: int = 7) -> IntentModel:
    """Straight, slow and fast turns, weak and strong speeding up and slowing down.

    Left and right are one intent from the start. Up and down are not: they may be laws of their own.

    Args:
        found: from `guess`.
        axes: 2 or 3.
        most: intents, 1 to 7.
    """
    sizes = found.sizes

    up, down = found.growths[found.growths > 0], -found.growths[found.growths < 0]
    still_g, still_w = STILL * sizes.growth, STILL * sizes.turn
    lively = law_like(axes, sizes)
    flat = axes == 2
    births = [(Birth(1.0, 0.0, still_g, 0.0, still_w), False)]
    for q in (0.8, 0.25):
        rate = level(found.turns, q, sizes.turn)
        births.append((Birth(1.0, 0.0, still_g, rate if flat else 0.0, 0.4 * rate if flat else rate), flat))
    for q in (0.35, 0.85):
        for values, sign in ((up, 1.0), (down, -1.0)):
            middle = level(values, q, sizes.growth)
            births.append((Birth(1.0, sign * middle, 0.5 * middle, 0.0, still_w), False))
    births.append(births.pop(2))  # slow turns come last: the first to go where few intents are wanted
    made = [
        Intent(chr(ord("a") + k), (Phase(lively, (birth,), mirrored=sided),))
        for k, (birth, sided) in enumerate(births[:most])
    ]
    return _with_chain(axes, tuple(made), sizes)


def weave_periods(sizes: Sizes) -> tuple[float, ...]:
    """Periods to try, s: from what rows just resolve to what a spell just holds."""
    longest = _LONGEST * sizes.duration
    periods = [count * sizes.step for count in _PERIODS if count * sizes.step < 0.8 * longest]
    return (*periods, longest)


def weave_of(axes: int, sizes: Sizes, period: float) -> Phase:
    """A weave that turns as fast as turns do, and its course by a quarter radian at least.

    Turn rates within a weave of a few steps are larger than any that windows show.
    """
    natural = 2.0 * math.pi / period
    rate = max(sizes.turn, _SWAY * natural)
    birth = Birth(1.0, 0.0, STILL * sizes.growth, 0.0, rate, swing_sd=0.5 * rate * natural)
    law = law_like(axes, sizes, (natural, 0.05))
    return Phase(replace(law, turn_noise=law.turn_noise * (rate / sizes.turn) ** 2), (birth,))


def shaky(sizes: Sizes, rate: float) -> Phase:
    """A turn in the plane whose rate shakes about a mean from step to step: the course diffuses."""
    forgets = _FORGETS / sizes.step
    noise = (_SHAKE * sizes.turn) ** 2 * sizes.step * forgets**2
    law = replace(law_like(2, sizes), turn_mean=rate, turn_rate=forgets, turn_noise=noise)
    spread = math.sqrt(0.5 * noise / forgets)
    return Phase(law, (Birth(1.0, 0.0, STILL * sizes.growth, rate, spread),), mirrored=True)


def restless_intents(found: Guess, axes: int, most: int = 7) -> IntentModel:
    """Straight, weaves of many periods and, in the plane, a turn whose rate shakes.

    What `first_intents` cannot become: a course that shakes from row to row leaves windows nothing to see.

    Args:
        found: from `guess`.
        axes: 2 or 3.
        most: intents, 1 to 7.
    """
    sizes = found.sizes
    phases = [shaky(sizes, level(found.turns, 0.8, sizes.turn))] if axes == 2 else []
    phases.append(Phase(law_like(axes, sizes), (Birth(1.0, 0.0, STILL * sizes.growth, 0.0, STILL * sizes.turn),)))
    phases += [weave_of(axes, sizes, period) for period in weave_periods(sizes)]
    made = tuple(Intent(chr(ord("a") + k), (phase,)) for k, phase in enumerate(phases[:most]))
    return _with_chain(axes, made, sizes)


def one_intent(found: Guess, axes: int) -> IntentModel:
    """A single intent that does everything: shape parameters that forget themselves."""
    sizes = found.sizes
    rate = _SPELLS / sizes.duration
    law = Law(
        axes,
        growth_rate=rate,
        growth_noise=2.0 * rate * sizes.growth**2 * 0.25,
        turn_rate=rate,
        turn_noise=2.0 * rate * sizes.turn**2 * 0.25,
        wobble=(0.1 * sizes.acceleration) ** 2 * sizes.step,
    )
    birth = Birth(1.0, 0.0, 0.5 * sizes.growth, 0.0, 0.5 * sizes.turn)
    return _with_chain(axes, (Intent("a", (Phase(law, (birth,)),)),), sizes)


def _with_chain(axes: int, intents: tuple[Intent, ...], sizes: Sizes) -> IntentModel:
    count = len(intents)
    rate = _SPELLS / sizes.duration
    generator = np.full((count, count), rate / max(count - 1, 1))
    np.fill_diagonal(generator, 0.0)
    np.fill_diagonal(generator, -generator.sum(axis=1))
    model = IntentModel(
        axes, intents, tuple(map(tuple, generator.tolist())), (), None, speed=sizes.speed / math.sqrt(axes)
    )
    return settled(model)
