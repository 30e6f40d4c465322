"""A bank of Jink inside Stone Soup: its predictor and updater, Stone Soup's hypotheses and association in clutter.

pip install 'jink[peers]'
python examples/stone_soup_tracker.py
"""

import numpy as np
from stonesoup.dataassociator.neighbour import NearestNeighbour
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.measures import Mahalanobis
from stonesoup.types.detection import Detection
from stonesoup.types.track import Track

from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position
from jink.training.adapters.stonesoup_bank import make_pair, start_state
from jink.training.adapters.stonesoup_sensor import stamp

rng = np.random.default_rng(3)
times = np.arange(0.0, 60.0)
heading = np.deg2rad(6.0) * np.clip(times - 30.0, 0.0, None)
truth = np.cumsum(20.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
measured = truth + rng.normal(scale=10.0, size=truth.shape)

estimator = make_estimator("imm", position(axes=2, sigma=10.0), acceleration=2.0, speed=20.0)
predictor, updater = make_pair(estimator)
associator = NearestNeighbour(DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=4))

track = Track([start_state(estimator, measured[0], times[0])])
for z, time in zip(measured[1:], times[1:], strict=True):
    places = [z, *rng.uniform(-200.0, 1000.0, size=(5, 2))]  # the target and five false alarms
    detections = {Detection(place[:, None], timestamp=stamp(time)) for place in places}
    hypothesis = associator.associate({track}, detections, stamp(time))[track]
    track.append(updater.update(hypothesis) if hypothesis else hypothesis.prediction)

path = np.array([np.ravel(state.state_vector)[[0, 2]].astype(float) for state in track])
error = np.linalg.norm(path - truth, axis=1)
print(f"mean error {error.mean():.1f} m, measured {np.linalg.norm(measured - truth, axis=1).mean():.1f} m")
turning = [state.estimates.mode_probs[2] for state in track if getattr(state, "estimates", None) is not None]
print(f"probability of the turn at the end: {turning[-1]:.2f}")
