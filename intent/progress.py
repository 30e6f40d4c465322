"""What a learner says while it learns."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Progress"]


class Progress(NamedTuple):
    """One report of a running fit, handed to ``IntentLearner(progress=...)``.

    stage: what is going on, in one or two words ("clusters", "fit", "merge", "eliminate", "final").
    step, steps: how far this stage is; steps 0 where that is not known.
    intents: how many there are at the moment.
    log_likelihood: mean per measured row, nats; NaN before there is one.
    held_out: True where it is that of tracks which were not fitted.
    """

    stage: str
    step: int
    steps: int
    intents: int
    log_likelihood: float
    held_out: bool = False
