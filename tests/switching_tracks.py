"""Tracks that switch between straight flight, turns and speed changes, at exact times; shared by tests of learning."""

import numpy as np

from jink.estimators.tracks import Tracks

LAWS = ("straight", "turn", "accelerate")


def switching_tracks(tracks=24, rows=100, dt=1.0, speed=150.0, sigma=5.0, dwell=25.0, seed=0, laws=LAWS):
    """Spells of exponential length; turns of 3 to 12 deg/s either way, growth of 2 to 4 %/s up or down.

    Returns tracks with truth and labels, the true shape parameters (B, T, 2) and the law of each row (B, T).
    """
    generator = np.random.default_rng(seed)
    z, eta = np.zeros((tracks, rows, 2)), np.zeros((tracks, rows, 2))
    labels = np.zeros((tracks, rows), dtype=int)
    for b in range(tracks):
        p, v = 0j, speed * np.exp(1j * generator.uniform(0, 2 * np.pi))
        law = int(generator.integers(len(laws)))
        rate, left = _draw(laws[law], v, speed, generator), generator.exponential(dwell)
        for t in range(rows):
            z[b, t], eta[b, t], labels[b, t] = (p.real, p.imag), (rate.real, rate.imag), law
            rest = dt
            while rest > 0:
                step = min(rest, left)
                grown = np.exp(rate * step)
                p, v = p + (v * (grown - 1) / rate if rate else v * step), v * grown
                rest, left = rest - step, left - step
                if left <= 0:
                    law = int((law + generator.integers(1, max(len(laws), 2))) % len(laws))
                    rate, left = _draw(laws[law], v, speed, generator), generator.exponential(dwell)
    noisy = z + sigma * generator.standard_normal(z.shape)
    words = np.array(laws)[labels]
    held = Tracks.from_arrays(noisy, np.arange(rows) * dt, noise=np.eye(2) * sigma**2, truth=z, intents=words)
    return held, eta, labels


def _draw(law, v, speed, generator):
    if law == "turn":
        return 1j * np.radians(generator.uniform(3, 12)) * generator.choice([-1, 1])
    if law == "accelerate":
        return complex(generator.uniform(0.02, 0.04) * (-1 if abs(v) > speed else 1))
    return 0j
