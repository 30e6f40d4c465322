"""A short track through banks, compiled or (NUMBA_DISABLE_JIT=1) in plain Python; prints numbers as JSON."""

import json

import numpy as np

from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position, range_bearing


def numbers():
    """Every estimate of two recipes and two sensors over seven rows, one of them missing: name -> lists."""
    z = np.cumsum(np.random.default_rng(14).normal(size=(7, 2)) + np.array([2.0, 1.0]), axis=0) + 30.0
    z[4] = np.nan
    polar = np.column_stack([np.hypot(*z.T), np.arctan2(z[:, 1], z[:, 0])])
    out = {}
    for name, sensor, seen in (
        ("imm", position(2, 1.0), z),
        ("intent-imm", range_bearing((1.0, 0.03)), polar),
    ):
        est = make_estimator(name, sensor, speed=3.0)
        for method in (est.run, est.smooth):
            fields = method(seen, np.arange(7.0))
            out[f"{name} {method.__name__}"] = [np.asarray(field, float).ravel().tolist() for field in fields]
        ahead = est.forecast(est.start(seen[0], 0.0), 2.0, weights="W2")
        out[f"{name} forecast"] = [part.ravel().tolist() for part in ahead]
    return out


if __name__ == "__main__":
    print(json.dumps(numbers()))
