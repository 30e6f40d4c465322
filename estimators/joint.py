"""The joint bank: every intent at every noise level, so that a manoeuvre and a surge compete for one innovation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jink.estimators.bank import Bank, Mode
from jink.estimators.markov import MarkovChain
from jink.estimators.treatments import Level

__all__ = ["LEVELS", "joint_bank", "level_chain"]

LEVELS = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0, 4096.0)
"""Factors on R. In steps of four a surge between two levels costs a few per cent; with 1, 9, 100, 2500 up to 30."""
CALM, SURGE, BACK = 20.0, 1.5, 0.8
"""Mean durations, s, and the share of surges that end in calm rather than at another level: 9 % of the time surges."""


def _check_levels(caller: str, levels: Sequence[float]) -> tuple[float, ...]:
    try:
        given = tuple(Level(level).scale for level in levels)
    except (TypeError, ValueError):
        given = ()
    if isinstance(levels, str) or len(given) < 2 or len(set(given)) != len(given):
        raise ValueError(
            f"{caller}: levels must be two or more distinct factors on R, > 0; got {levels!r}. Use LEVELS."
        )
    if given[0] != min(given):
        raise ValueError(
            f"{caller}: levels must begin with the lowest, which is calm; got {levels!r}. Sort them; if the sensor may "
            "be better than its R, give the sensor the better one."
        )
    return given


def _check_duration(name: str, value: float) -> None:
    if isinstance(value, bool) or not isinstance(value, float | int | np.number) or not 0.0 < value < math.inf:
        raise ValueError(f"level_chain: {name} must be > 0 s and finite; got {value!r}. Give a mean duration.")


def _shown(level: float) -> str:
    short = f"{level:g}"
    return short if float(short) == level else repr(level)


def level_chain(
    levels: Sequence[float] = LEVELS, calm: float = CALM, surge: float = SURGE, back: float = BACK
) -> MarkovChain:
    """The chain of the noise levels: calm lasts ``calm`` seconds, any other level ``surge``.

    From calm all levels are equally likely; a surge returns to calm with probability ``back``, else it goes evenly to
    the other levels.

    Raises:
        ValueError: fewer than two levels, levels that repeat or do not begin with the lowest, a duration not positive,
            or ``back`` no probability.
    """
    _check_levels("level_chain", levels)
    _check_duration("calm", calm)
    _check_duration("surge", surge)
    if isinstance(back, bool) or not isinstance(back, float | int | np.number) or not 0.0 <= back <= 1.0:
        raise ValueError(
            f"level_chain: back must be in [0, 1]; got {back!r}. Give the share of surges that end in calm."
        )
    count, back = len(levels), float(back)
    targets = np.full((count, count), (1.0 - back) / max(count - 2, 1))
    targets[:, 0] = back if count > 2 else 1.0
    targets[0] = 1.0 / (count - 1)
    np.fill_diagonal(targets, 0.0)
    return MarkovChain.from_sojourns([calm] + [surge] * (count - 1), targets)


def joint_bank(
    bank: Bank,
    levels: Sequence[float] = LEVELS,
    *,
    calm: float = CALM,
    surge: float = SURGE,
    back: float = BACK,
    shared: bool | None = None,
) -> Bank:
    """The product of a bank's modes (the intents) and noise levels.

    Model: intent and level are independent chains, so the generator is the Kronecker sum of theirs. A switch of level
    keeps the whole state; a switch of intent follows the bank's own interaction. Each level starts from its own
    reading of the first measurement, which may be an outlier.

    With ``shared``, the noise levels of an intent share its state: their posteriors are collapsed before each step, so
    there are as many predictions and conversions as intents, and levels cost one small update each. What is lost are
    the separate histories of the levels: up to 10 % in RMS position in long bursts.

    Args:
        bank: intents, with a chain in continuous time if there are several. Their treatments stay, beside the level:
            Student-t intents get the product of tails and levels.
        levels: factors on R, the first and lowest one being calm; distinct.
        calm, surge, back: see `level_chain`; s, s, a share.
        shared: see `Bank`; False: the full product; None: shared if there are several intents.

    Raises:
        ValueError: levels that repeat or do not begin with the lowest, a bank that has levels already, or a chain given
            per step.

    Source: Li & Bar-Shalom (1994) for noise identification by IMM; the product is ours. Differs: levels collapsed.
    """
    if not isinstance(bank, Bank):
        raise ValueError(f"joint_bank: bank must be a Bank; got {type(bank).__name__}. Use recipes.intent_imm.")
    for mode in bank.modes:
        if any(isinstance(item, Level) for item in mode.treatments):
            raise ValueError(
                f"joint_bank: bank must have no noise levels yet; got mode {mode.name} with one. "
                "Pass the bank of intents."
            )
    levels = _check_levels("joint_bank", levels)
    noise = level_chain(levels, calm, surge, back)
    chain = noise
    if bank.chain is not None:
        if bank.chain.generator is None:
            raise ValueError(
                "joint_bank: bank must have a chain in continuous time, as levels last for seconds; got one matrix per "
                "step (that of robust_imm, for instance, whose modes are factors and no intents). "
                "Use MarkovChain.from_sojourns or from_matrix."
            )
        chain = bank.chain.beside(chain)
    modes = tuple(
        Mode(f"{mode.name} {_shown(level)}R", mode.motion, (*mode.treatments, Level(level)), mode.purpose)
        for mode in bank.modes
        for level in levels
    )
    start = None
    if bank.initial_probs is not None:
        shares = np.kron(bank.initial_probs, noise.stationary())
        start = tuple(float(share) for share in shares)
    return replace(
        bank, modes=modes, chain=chain, initial_probs=start, shared=len(bank.modes) > 1 if shared is None else shared
    )
