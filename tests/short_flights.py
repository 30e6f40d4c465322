"""Short flights to look at: what the tests of the truth share."""

import numpy as np

from jink.envs.flight.dwells import Dwell
from jink.envs.flight.limits import Limits, Start
from jink.envs.intents import INTENTS
from jink.envs.manoeuvres import Manoeuvres
from jink.envs.streams import Draws

SPEED, HEADING = 100.0, 0.7
START = Start(speed=(SPEED, SPEED), heading=(HEADING, HEADING), x=(10.0, 10.0), y=(-20.0, -20.0), z=(1500.0, 1500.0))
LASTS = Dwell(10.0, kind="fixed")


def draws(motion, rows, duration, seed=1):
    return Draws(np.random.default_rng(seed).random((rows, motion.need(1, duration).uniforms)), np.empty((rows, 0)))


def fly(motion, times, rows=1, seed=1, longest=None):
    times = np.broadcast_to(times, (rows, np.shape(times)[-1]))
    return motion.simulate(times, draws(motion, rows, longest or float(times.max()), seed))


def one(intent, *, axes=3, **limits):
    """A target that does one thing over and over."""
    return Manoeuvres(behaviours=(intent,), axes=axes, start=START, limits=Limits(**limits))


def in_all_ways(axes, **options):
    """A target with every intent there is, hard pressed by its limits."""
    behaviours = tuple(kind(dwell=Dwell(4.0, 1.0)) for kind in INTENTS.values() if axes == 3 or not kind.in_space)
    limits = Limits(speed=(20.0, 130.0), lateral=2.0, climb=0.3, altitude=(1350.0, 1650.0))
    return Manoeuvres(behaviours=behaviours, axes=axes, limits=limits, start=START, **options)
