"""Random small tracking problems for the differential tests: motions and sensors a user would write.

Each returns the parts for this package and the same functions in plain numpy for a peer. Process noise is as
large as the covariances, so that a filter that forgets to redraw its sigma points is far off.
"""

import math

import numpy as np

from jink.estimators.compiled import NOISE, OBSERVE, Callback
from jink.estimators.motion import motion
from jink.estimators.sensor import Sensor

LABELS = "x vx y vy w"
N = 5
KIN = [0, 2, 1, 3]  # x, y, vx, vy among the components


def spd(rng, n, scale=1.0):
    """A well-conditioned random covariance (n, n)."""
    a = rng.normal(size=(n, n))
    return scale * (a @ a.T / n + 0.3 * np.eye(n))


def _given_noise(x, dt, params, out):
    n = x.shape[0]
    for i in range(n):
        for k in range(n):
            out[i, k] = params[i * n + k]


@motion(LABELS, linear=True)
def matrix_motion(x, dt, params, out):
    n = x.shape[0]
    for i in range(n):
        out[i] = 0.0
        for k in range(n):
            out[i] += params[n * n + i * n + k] * x[k]


@motion(LABELS)
def swirl(x, dt, params, out):
    n = x.shape[0]
    bend, pull = params[n * n], params[n * n + 1]
    turn = x[4] * dt
    out[0] = x[0] + dt * x[1] + bend * math.sin(x[2])
    out[1] = x[1] * math.cos(turn) - x[3] * math.sin(turn) - pull * x[0]
    out[2] = x[2] + dt * x[3] + 0.1 * bend * x[0] * x[4]
    out[3] = x[1] * math.sin(turn) + x[3] * math.cos(turn)
    out[4] = 0.9 * x[4] + 0.1 * math.sin(x[1])


def _curved(kin, sensor, params, out):
    dx, dy = kin[0] - sensor[0], kin[1] - sensor[1]
    out[0] = math.sqrt(1.0 + dx * dx + dy * dy) + 0.1 * kin[2]
    out[1] = kin[0] + 0.3 * math.sin(kin[1]) + params[0] * kin[3]


def plain(callback, *fixed):
    """A callback ``f(x, ..., out)`` as a function that returns a new vector of the size of ``x``."""

    def function(x, *_, **__):
        x = np.asarray(x, dtype=float).ravel()
        out = np.zeros(len(x))
        callback.function(x, *fixed, out)
        return out

    return function


def linear_problem(rng):
    """``(motion, F, Q)``: a stable random matrix."""
    F = 0.7 * np.eye(N) + 0.25 * rng.normal(size=(N, N)) / math.sqrt(N)
    Q = spd(rng, N)
    made = matrix_motion.with_(params=(*Q.ravel(), *F.ravel()), noise=Callback(_given_noise, NOISE))
    return made, F, Q


def curved_problem(rng, dt):
    """``(motion, f, Q)``: a nonlinear transition."""
    Q = spd(rng, N, 0.4)
    params = (*Q.ravel(), rng.uniform(0.3, 0.8), rng.uniform(0.05, 0.2))
    made = swirl.with_(params=params, noise=Callback(_given_noise, NOISE))
    return made, plain(made.transition, dt, np.array(params)), Q


def curved_sensor(place=(0.4, -0.7, 0.0, 0.0)):
    """``(sensor, h)`` with ``h`` of a state; a nonlinear measurement of position and velocity."""
    sensor = Sensor("curved", ("r", "q"), ("m", "m"), 2, Callback(_curved, OBSERVE), (0.7, 0.9), params=(0.2,))

    def h(x, *_, **__):
        out = np.zeros(2)
        _curved(np.asarray(x, dtype=float).ravel()[KIN], np.array(place), np.array([0.2]), out)
        return out

    return sensor, h, np.array(place)
