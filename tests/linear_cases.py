"""Small linear problems given by their matrices, as a bank sees them."""

from __future__ import annotations

import numpy as np

from jink.estimators.compiled import NOISE, OBSERVE, Callback
from jink.estimators.motion import motion
from jink.estimators.sensor import Sensor


def _given_noise(x, dt, params, out):
    n = x.shape[0]
    for i in range(n):
        for k in range(n):
            out[i, k] = params[i * n + k]


def _matrix(x, dt, params, out):
    n = x.shape[0]
    for i in range(n):
        out[i] = 0.0
        for k in range(n):
            out[i] += params[n * n + i * n + k] * x[k]


def _row(kin, sensor, params, out):
    for a in range(out.shape[0]):
        out[a] = 0.0
        for i in range(kin.shape[0]):
            out[a] += params[a * kin.shape[0] + i] * kin[i]


_MADE = motion("x vx", linear=True)(_matrix)
_OBSERVE = Callback(_row, OBSERVE)


def given_motion(F, Q):
    """One axis (x, vx) with the matrices given, whatever dt."""
    params = (*np.ravel(Q).astype(float), *np.ravel(F).astype(float))
    return _MADE.with_(params=params, noise=Callback(_given_noise, NOISE))


def given_sensor(H, sigma):
    """Rows of H on (x, vx)."""
    rows = len(H)
    labels = tuple(f"z{i}" for i in range(rows))
    params = tuple(np.ravel(H).astype(float))
    return Sensor("rows", labels, ("m",) * rows, 1, _OBSERVE, tuple(sigma), params=params, linear=True)
