"""Simulate the track of the README's picture and write it as a track file.

python examples/simulate_a_track.py track.csv
jink track track.csv --estimator intent-imm --sigma 25 --plot track.png
"""

import sys

import numpy as np
import pandas as pd

LEGS = [  # seconds, intent, turn rate (rad/s), acceleration along the path (m/s^2)
    (25, "straight", 0.0, 0.0),
    (22, "turn", 0.14, 0.0),
    (20, "straight", 0.0, 0.0),
    (12, "accelerate", 0.0, 2.0),
    (18, "straight", 0.0, 0.0),
    (16, "turn", -0.16, 0.0),
    (18, "straight", 0.0, 0.0),
]


def simulate(sigma_m=25.0, seed=7):
    """Positions measured once a second; a frame in the track format, with truth and intent."""
    rng = np.random.default_rng(seed)
    place, velocity, rows = np.zeros(2), np.array([30.0, 0.0]), []
    for seconds, intent, rate, acceleration in LEGS:
        for _ in range(seconds):
            rows.append((float(len(rows)), *place, intent))
            push = acceleration * velocity / np.linalg.norm(velocity)
            place = place + velocity + 0.5 * push
            cos, sin = np.cos(rate), np.sin(rate)
            velocity = np.array([[cos, -sin], [sin, cos]]) @ velocity + push
    frame = pd.DataFrame(rows, columns=["t", "true_x", "true_y", "intent"])
    for axis in "xy":
        frame[axis] = frame[f"true_{axis}"] + rng.normal(scale=sigma_m, size=len(frame))
    return frame


if __name__ == "__main__":
    target = sys.argv[1] if len(sys.argv) > 1 else "track.csv"
    simulate().to_csv(target, index=False)
    print(f"wrote {target}")
