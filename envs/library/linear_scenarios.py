"""Scenarios of targets with a linear model: all that is hard about them is the noise, or an error in the model."""

from __future__ import annotations

from dataclasses import replace

from jink.envs.plants import LinearPlant, uncertain_plant
from jink.envs.sampling import Regular
from jink.envs.scenario import Scenario
from jink.envs.sensing import Sensing
from jink.envs.surges import (
    BiasDrift,
    Contaminated,
    Dropouts,
    Glint,
    HeavyTails,
    IsolatedOutliers,
    MarkovBursts,
    PlacedBursts,
    Ramp,
    Surge,
)
from jink.envs.truth import Motion
from jink.estimators.sensors import position

__all__ = ["LINEAR"]

TARGET = LinearPlant(density=1.0, start_sigma=(100.0, 10.0, 100.0, 10.0))
"""Nearly constant velocity, 1 m^2/s^3."""
UNCERTAIN = uncertain_plant(density=1.0, start_sigma=(100.0, 40.0, 100.0, 40.0))
"""The same but faster, and its x moves on by up to 0.0198 s of its velocity too much or too little, anew every step."""
CONSTANT_ERROR = replace(UNCERTAIN, error=replace(UNCERTAIN.error, redraw="episode"))  # type: ignore[type-var]
"""The same error throughout an episode."""


def _linear(name: str, title: str, suite: str, *surges: Surge, motion: Motion = TARGET) -> Scenario:
    """300 samples at 10 Hz, R = 1 m^2 on each axis."""
    return Scenario(f"{name}-v0", title, suite, motion, Sensing(position(2, 1.0)), Regular(300, 0.1), surges)


LINEAR: tuple[Scenario, ...] = (
    _linear("surge", "Random surges: dwell 0.5 to 5 s, 4 to 10 000 x", "surge", MarkovBursts()),
    _linear("surge-25-bursts", "A burst of 5 s and one of 1 s at 25 x", "surge", PlacedBursts((5.0, 1.0), 25.0)),
    _linear("surge-400-bursts", "A burst of 5 s and one of 1 s at 400 x", "surge", PlacedBursts((5.0, 1.0), 400.0)),
    _linear("surge-100-outliers", "10 % of samples at 100 x", "surge", IsolatedOutliers(0.1, 100.0)),
    _linear("surge-10000-outliers", "5 % of samples at 10 000 x", "surge", IsolatedOutliers(0.05, 1e4)),
    _linear("surge-markov", "Markov bursts, 1 s in 6 s, 9 to 900 x", "surge", MarkovBursts(1.0, 5.0, (9.0, 900.0))),
    _linear("surge-ramp", "Noise that swells and fades", "surge", Ramp()),
    _linear("surge-glint", "Periodic glint", "surge", Glint(4.0, 0.6, (25.0, 400.0))),
    _linear(
        "surge-dropouts", "Surges that end in dropouts", "surge", MarkovBursts(1.0, 5.0, 100.0), Dropouts(1.0, 8.0)
    ),
    _linear("surge-bias", "Random surges over a wandering bias", "surge", BiasDrift(1.0, 10.0), MarkovBursts()),
    _linear("heavy-tail-t3", "Student-t noise, 3 degrees of freedom", "heavy-tail", HeavyTails(3.0)),
    _linear("heavy-tail-t5", "Student-t noise, 5 degrees of freedom", "heavy-tail", HeavyTails(5.0)),
    _linear("heavy-tail-contaminated", "20 % of samples at 9 x", "heavy-tail", Contaminated(0.2, 9.0)),
    _linear("model-error", "Position gain off by 0.02 s, anew every step", "model-error", motion=UNCERTAIN),
    _linear("model-error-constant", "The same all episode", "model-error", motion=CONSTANT_ERROR),
    _linear("model-error-surge", "The first with random surges", "model-error", MarkovBursts(), motion=UNCERTAIN),
)
"""Suites surge, heavy-tail and model-error. The four cases of 25, 400, 100 and 10 000 x are those of the published
table of adaptive factors; its "bursts of 5 s and 1 s" are one of each per episode, which reproduces its numbers."""
