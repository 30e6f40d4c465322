"""Add a motion of your own: a vehicle that brakes, and whose braking is estimated.

Model: ``p' = v, v' = -k v, k' = white noise`` with k in 1/s, so the vehicle stops after ``|v| / k`` metres.
The function below is all that is needed: labels say what is position and velocity, the rest is an own
parameter with a prior, and the process noise follows from ``diffusion`` along the flow.
"""

import math

import numpy as np

from jink.estimators.motion import motion


@motion("x vx y vy k", diffusion={"vx": 0.1, "vy": 0.1, "k": 1e-4}, birth={"k": (0.2, 0.1)})
def braking(x, dt, params, out):
    keep = math.exp(-x[4] * dt)
    reach = dt * (1.0 - 0.5 * x[4] * dt) if abs(x[4] * dt) < 1e-8 else (1.0 - keep) / x[4]
    out[0] = x[0] + reach * x[1]
    out[1] = keep * x[1]
    out[2] = x[2] + reach * x[3]
    out[3] = keep * x[3]
    out[4] = x[4]


if __name__ == "__main__":
    print(f"{braking.name}: state {' '.join(braking.labels)}, own parameters {braking.own_labels}")
    state, after = np.array([0.0, 20.0, 0.0, 5.0, 0.25]), np.empty(5)
    for seconds in (0.0, 1.0, 4.0, 60.0):
        braking.transition(state, seconds, np.array(braking.params), after)
        speed = np.hypot(after[1], after[3])
        print(f"after {seconds:4.0f} s: position ({after[0]:6.2f}, {after[2]:6.2f}) m, speed {speed:5.2f} m/s")
