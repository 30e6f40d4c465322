"""An estimator of one's own: an alpha-beta filter, in one file.

jink check examples/my_estimator.py:AlphaBeta
jink track radar.csv --estimator examples/my_estimator.py:AlphaBeta
"""

import numpy as np


class AlphaBeta:
    """A fixed share of each innovation corrects position and velocity."""

    def start(self, measurements, times):
        place = np.nan_to_num(measurements[-1])
        return (place, 0.0 * place, times[-1]), place

    def step(self, state, measurement, time):
        place, velocity, before = state
        dt = time - before
        place = place + velocity * dt
        error = np.nan_to_num(measurement - place)  # a missing component corrects nothing
        place = place + 0.5 * error
        velocity = velocity + (0.2 * error / dt if dt > 0.0 else 0.0)
        return (place, velocity, time), {"position": place, "velocity": velocity}
