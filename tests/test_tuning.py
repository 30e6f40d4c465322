"""Noise, acceleration and speed found in the tracks themselves."""

import numpy as np
import pytest

from jink.estimators.recipes import make_estimator
from jink.estimators.tracks import Tracks
from jink.training.running import gate_tracks, raw_positions, run_tracks
from jink.training.stretches import cut_stretches, rough_speed
from jink.training.tuning import sensor_of, tune


def wander(sigma, density, steps=1200, dt=0.5, seed=0, axes=2, speed=12.0):
    """A constant-velocity target with white acceleration, measured in position; times, truth, measurements."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    state = np.zeros((steps, axes, 2))
    state[0, :, 1] = speed
    for k in range(1, steps):
        state[k] = state[k - 1] @ np.array([[1.0, 0.0], [dt, 1.0]]) + rng.standard_normal((axes, 2)) @ root.T
    noise = np.broadcast_to(sigma, (axes,)) * rng.standard_normal((steps, axes))
    return dt * np.arange(steps), state[..., 0], state[..., 0] + noise


@pytest.mark.parametrize("sigma, acceleration", [(0.2, 1.0), (15.0, 0.5)])
def test_matched_tracks_give_their_parameters(sigma, acceleration):
    times, _, z = wander(sigma, acceleration**2)
    found = tune(Tracks.from_arrays(z, times))
    assert found.tuned == ("sigma", "acceleration", "speed")
    # One track of 1200 steps: sigma is known to a few percent, acceleration to some ten.
    np.testing.assert_allclose(found.sigma, sigma, rtol=0.15)
    assert found.acceleration == pytest.approx(acceleration, rel=0.5)


def test_gross_outliers_do_not_bend_it():
    times, _, z = wander(0.2, 1.0)
    wild = z.copy()
    rows = np.random.default_rng(1).choice(len(z), 12, replace=False)
    wild[rows] += 50.0
    clean, found = (tune(Tracks.from_arrays(values, times)) for values in (z, wild))
    # 1 % of outliers of 250 sigma would raise a plain likelihood's sigma more than tenfold.
    np.testing.assert_allclose(found.sigma, clean.sigma, rtol=0.6)


def test_height_has_its_own_sigma():
    times, _, z = wander((2.0, 2.0, 20.0), 1.0, axes=3)
    found = tune(Tracks.from_arrays(z, times))
    assert found.sigma[0] == found.sigma[1]
    assert 5.0 < found.sigma[2] / found.sigma[0] < 20.0


def test_it_is_deterministic_and_keeps_what_is_given():
    times, _, z = wander(1.0, 1.0, steps=300)
    tracks = Tracks.from_arrays(z, times)
    assert tune(tracks) == tune(tracks)
    given = tune(tracks, sigma=(3.0, 3.0), speed=7.0)
    assert (given.sigma, given.speed, given.tuned) == ((3.0, 3.0), 7.0, ("acceleration",))
    whole = tune(tracks, sigma=(3.0, 3.0), speed=7.0, acceleration=2.0)
    assert (whole.acceleration, whole.evaluations, whole.tuned) == (2.0, 0, ())


def test_repeated_and_quantised_rows_keep_a_floor():
    times, truth, _ = wander(1.0, 0.01, steps=400)
    z = np.repeat(np.round(truth[::4] / 5.0) * 5.0, 4, axis=0)
    # The noise of rounding to 5 m is 5 / sqrt(12) m.
    assert min(tune(Tracks.from_arrays(z, times)).sigma) >= 5.0 / np.sqrt(12) - 1e-9


@pytest.mark.parametrize("length", [3, 5, 12])
def test_short_tracks_are_tuned_too(length):
    times, _, z = wander(1.0, 1.0, steps=length)
    found = tune(Tracks.from_arrays(z, times))
    assert np.all(np.isfinite([*found.sigma, found.acceleration, found.speed]))


def test_too_little_to_tune_is_refused():
    tracks = Tracks.from_arrays(np.full((8, 2), np.nan), np.arange(8.0))
    with pytest.raises(ValueError, match="must hold three measurements"):
        tune(tracks)


def test_a_target_at_rest_is_tuned():
    found = tune(Tracks.from_arrays(np.zeros((50, 2)), np.arange(50.0)))
    assert np.all(np.isfinite([*found.sigma, found.acceleration, found.speed]))
    assert found.speed > 0


def test_speed_of_positions_and_of_ranges():
    times = np.arange(0.0, 60.0, 0.2)
    truth = np.stack([20.0 * times, 0.0 * times], axis=1)
    z = truth + np.random.default_rng(0).normal(scale=5.0, size=truth.shape)
    positions = Tracks.from_arrays(z, times)
    # 20 m/s over two axes.
    found = rough_speed(positions, sensor_of(positions), np.array([5.0, 5.0]))
    assert found == pytest.approx(20.0 / np.sqrt(2), rel=0.1)
    reach = np.linalg.norm(truth - [-100.0, 0.0], axis=1)[:, None]
    places = np.tile([-100.0, 0.0, 0.0, 0.0], (len(times), 1))
    ranges = Tracks.from_arrays(reach, times, sensor="range", axes=2, sensor_states=places)
    assert rough_speed(ranges, sensor_of(ranges), np.array([0.1])) == pytest.approx(20.0, rel=0.05)


def test_ranges_to_anchors_are_tuned():
    times, truth, _ = wander(1.0, 0.05, steps=600, dt=0.2, speed=1.0)
    anchors = np.array([[0.0, 0.0], [80.0, 0.0], [0.0, 80.0], [80.0, 80.0]])
    which = np.arange(len(times)) % 4
    rng = np.random.default_rng(2)
    reach = np.linalg.norm(truth - anchors[which], axis=1) + rng.normal(scale=0.3, size=len(times))
    states = np.concatenate([anchors[which], np.zeros((len(times), 2))], axis=1)
    found = tune(Tracks.from_arrays(reach[:, None], times, sensor="range", axes=2, sensor_states=states))
    # Every anchor is heard every fourth row only: sigma and acceleration trade against each other.
    assert 0.15 < found.sigma[0] < 0.6


def test_stretches_spread_over_the_tracks():
    tracks = Tracks.from_arrays(
        [np.full((n, 2), float(n)) for n in (900, 30, 2)], [np.arange(float(n)) for n in (900, 30, 2)]
    )
    cut = cut_stretches(tracks, 5000)
    assert [name.split(":")[0] for name in cut.ids] == ["1", "1", "1", "1", "2"]
    assert int(cut.lengths.sum()) == 930
    few = cut_stretches(tracks, 300)
    assert int(few.lengths.sum()) <= 500
    np.testing.assert_array_equal(few.measurements[0, :3, 0], 900.0)


def test_the_gate_takes_outliers_and_nothing_else():
    times, truth, z = wander(1.0, 1.0, steps=400)
    rows = np.array([50, 51, 200])
    z[rows] += 100.0
    tracks = Tracks.from_arrays(z, times, truth=truth)
    estimator = make_estimator("kf-cv", sensor_of(tracks, (1.0, 1.0)), acceleration=1.0, speed=12.0)
    cleaned, rejected = gate_tracks(estimator, tracks)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(cleaned.measurements[0]).any(axis=1)), rows)
    assert rejected == 3
    before, after = (
        np.linalg.norm(run_tracks(estimator, t).position[0] - truth, axis=1).max() for t in (tracks, cleaned)
    )
    assert after < 0.2 * before


def test_the_gate_believes_a_target_that_stays_away():
    times, _, z = wander(1.0, 1.0, steps=200)
    z[100:] += 1000.0
    tracks = Tracks.from_arrays(z, times)
    estimator = make_estimator("kf-cv", sensor_of(tracks, (1.0, 1.0)), acceleration=1.0, speed=12.0)
    cleaned, _ = gate_tracks(estimator, tracks)
    estimates = run_tracks(estimator, cleaned)
    assert np.linalg.norm(estimates.position[0, -1] - z[-1]) < 10.0


def test_raw_positions_of_polar_measurements():
    place = np.array([[3.0, 4.0, 0.0, 0.0]] * 2)
    z = np.array([[10.0, np.pi / 2], [2.0, np.pi]])
    tracks = Tracks.from_arrays(z, [0.0, 1.0], sensor="range-bearing", sensor_states=place)
    np.testing.assert_allclose(raw_positions(tracks)[0], [[3.0, 14.0], [1.0, 4.0]], atol=1e-12)
    assert raw_positions(Tracks.from_arrays(z[:, :1], [0.0, 1.0], sensor="range", axes=2)) is None
