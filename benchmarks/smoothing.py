"""How much smoothing a bank gains: forty simulated tracks that go straight, accelerate and turn.

python benchmarks/smoothing.py
"""

from __future__ import annotations

import numpy as np

from jink.estimators.metrics import rmse
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position

TRACKS, ROWS, SIGMA_M = 40, 200, 5.0


def simulate(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Truth and measurements (B, T, 2) at 1 s; an intent lasts 20 s on average."""
    rng = np.random.default_rng(seed)
    truth = np.zeros((TRACKS, ROWS, 2))
    for track in range(TRACKS):
        place, velocity, push = np.zeros(2), np.array([10.0, 0.0]), np.zeros(2)
        mode, rate = 0, 0.0
        for row in range(ROWS):
            truth[track, row] = place
            if rng.random() < 1.0 / 20.0:
                mode = (mode + 1 + rng.integers(2)) % 3
                rate, push = 0.1 * rng.normal(), rng.normal(size=2)
            if mode == 2:
                cos, sin = np.cos(rate), np.sin(rate)
                velocity = np.array([[cos, -sin], [sin, cos]]) @ velocity
            place = place + velocity + (0.5 * push if mode == 1 else 0.0)
            velocity = velocity + (push if mode == 1 else 0.0)
    return truth, truth + rng.normal(scale=SIGMA_M, size=truth.shape)


if __name__ == "__main__":
    truth, measured = simulate(seed=1)
    times = np.arange(float(ROWS))
    for name in ("kf-cv", "kf-ca", "imm", "intent-imm"):
        estimator = make_estimator(name, sensor=position(axes=2, sigma=SIGMA_M), sojourn=20.0)
        filtered = rmse(estimator.run(measured, times).position, truth)
        smoothed = rmse(estimator.smooth(measured, times).position, truth)
        print(f"{name:12s} filtered {filtered:6.2f} m, smoothed {smoothed:6.2f} m")
