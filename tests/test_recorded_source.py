"""Recorded tracks as a source of episodes: windows, truth, noise, streams, refusals, and recorded data."""

import dataclasses
import pickle

import numpy as np
import pandas as pd
import pytest

from jink.envs.recorded import read_tracks
from jink.envs.recorded_source import RecordedSource
from jink.envs.sampling import TICK
from jink.envs.sensing import Platform, Sensing
from jink.envs.streams import make_streams
from jink.envs.surges import IsolatedOutliers, MarkovBursts
from jink.estimators.sensors import bearing, range_bearing
from jink.estimators.tracks import Tracks

RATES = (0.4, -0.1)
"""Turn rates of the two tracks, rad/s: known velocity and acceleration at every time."""


def circles(rows=(120, 90), *, noise=0.5, seed=3, epoch=1000.0, truth=True, labels=True):
    """Two tracks around the origin at irregular times, so that windows can be told apart."""
    generator = np.random.default_rng(seed)
    parts = []
    for count, rate in zip(rows, RATES, strict=False):
        times = np.cumsum(generator.uniform(0.05, 0.4, count))
        angle = rate * times
        radius = 40.0 + 10.0 * len(parts)
        position = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        velocity = radius * rate * np.column_stack([-np.sin(angle), np.cos(angle)])
        parts.append((times + epoch, position, velocity, position + noise * generator.standard_normal((count, 2))))
    words = [np.array(["early"] * (len(p[0]) // 3) + ["late"] * (len(p[0]) - len(p[0]) // 3)) for p in parts]
    return Tracks.from_arrays(
        [part[3] for part in parts],
        [part[0] for part in parts],
        truth=[part[1] for part in parts] if truth else None,
        truth_velocity=[part[2] for part in parts] if truth else None,
        intents=words if labels else None,
        source="small file.csv",
    )


def streams(count, seed=0):
    return [make_streams(np.random.default_rng(seed + b)) for b in range(count)]


def rows_of(tracks, episodes):
    """Track and first row of each episode, found again by its true positions."""
    found = []
    for start in episodes.truth.position[:, 0]:
        b, k = np.argwhere((tracks.truth == start).all(axis=-1))[0]
        found.append((int(b), int(k)))
    return found


def test_episodes_are_windows_of_the_recording():
    tracks = circles()
    source = RecordedSource(tracks, steps=50)
    assert (source.axes, source.steps, source.intents) == (2, 50, ("early", "late"))
    assert source.id == "recorded-small-file-v0"
    assert source.windows == 120 - 49 + 90 - 49
    episodes = source.simulate(streams(40))
    for index, (b, k) in enumerate(rows_of(tracks, episodes)):
        window = slice(k, k + 50)
        np.testing.assert_array_equal(episodes.truth.position[index], tracks.truth[b, window])
        np.testing.assert_array_equal(episodes.truth.velocity[index], tracks.truth_velocity[b, window])
        np.testing.assert_array_equal(episodes.measurements[index], tracks.measurements[b, window])
        labels = np.array(source.intents)[episodes.truth.intent[index]]
        np.testing.assert_array_equal(labels, tracks.intents[b, window])
        # Times near 1000 s are known to 1e-13 s; ticks are 1.5e-11 s and do not add up to more than one gap's.
        np.testing.assert_allclose(episodes.times[index], tracks.times[b, window] - tracks.times[b, k], atol=50 * TICK)
        changes = np.flatnonzero(labels[1:] != labels[:-1]) + 1
        switches = episodes.truth.switch_times[index]
        np.testing.assert_array_equal(switches[~np.isnan(switches)], episodes.times[index, changes])
    assert episodes.detected.all()
    assert np.abs(episodes.truth.position).max() <= source.extent
    assert episodes.truth.switch_times.shape == (40, 1)


@pytest.mark.parametrize("epoch", [0.0, 1.7e9])
def test_gaps_add_up_exactly(epoch):
    """A policy that sums the gaps it sees arrives at the same times, bit for bit."""
    for seed in range(20):
        source = RecordedSource(circles(rows=(50,), epoch=epoch, seed=seed), steps=50, sigma=1.0)
        times = source.simulate(streams(1)).times
        np.testing.assert_array_equal(np.cumsum(np.diff(times, axis=1), axis=1), times[:, 1:])
        assert times[0, 0] == 0
        # Whole ticks, as simulated times are; a power of two divides exactly.
        np.testing.assert_array_equal(times / TICK, np.rint(times / TICK))


def test_every_window_is_equally_likely():
    tracks = circles(rows=(20, 15))
    source = RecordedSource(tracks, steps=11)
    assert source.windows == 15
    found = rows_of(tracks, source.simulate(streams(3000)))
    counts = np.unique(found, axis=0, return_counts=True)[1]
    assert len(counts) == 15
    # 200 each; a window twice as likely would be 14 standard deviations away.
    assert np.abs(counts - 200).max() < 5 * np.sqrt(200)


def test_same_streams_same_bits_rows_alone_equal_rows_together():
    source = RecordedSource(circles(), steps=30, noise="simulated", sigma=2.0, surges=(IsolatedOutliers(0.3),))
    together, other = source.simulate(streams(6)), source.simulate(streams(6, seed=100))
    assert not np.array_equal(together.measurements, other.measurements)
    for b in range(6):
        alone = source.simulate(streams(1, seed=b))
        for name in ("times", "measurements", "detected", "scale", "bias", "noise", "prior_mean"):
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(together, name)[b])


def test_generators_advance_alike_whatever_the_window():
    source = RecordedSource(circles(), steps=30)
    first = streams(5)
    source.simulate(first)
    left = [generator.random() for row in first for generator in row]
    again = streams(5)
    source.simulate(again)
    assert left == [generator.random() for row in again for generator in row]
    second = source.simulate(first)
    assert not np.array_equal(second.times, source.simulate(streams(5)).times)


def test_noise_and_surges_leave_the_windows_alone():
    """Not even those of the next episodes."""

    def two_episodes(**options):
        generators = streams(8)
        source = RecordedSource(circles(), steps=30, **options)
        return source.simulate(generators), source.simulate(generators)

    recorded = two_episodes()
    for options in (
        {"sigma": 1.0},
        {"sigma": 9.0, "surges": (IsolatedOutliers(0.5),)},
        {"sensing": Sensing(bearing())},
    ):
        for one, two in zip(two_episodes(noise="simulated", **options), recorded, strict=True):
            np.testing.assert_array_equal(one.times, two.times)
            np.testing.assert_array_equal(one.truth.position, two.truth.position)
            assert not np.array_equal(one.measurements, two.measurements)


def test_surges_by_name():
    options = {"steps": 30, "noise": "simulated", "sigma": 1.0}
    for given in ("bursts", ["bursts"], MarkovBursts()):
        assert RecordedSource(circles(), surges=given, **options).surges == (MarkovBursts(),)
    both = RecordedSource(circles(), surges=["bursts", IsolatedOutliers()], **options)
    assert both.surges == (MarkovBursts(), IsolatedOutliers())
    assert both.simulate(streams(4)).scale.max() > 1.0


def test_simulated_noise_is_the_noise_that_is_said():
    source = RecordedSource(circles(), steps=50, noise="simulated", sigma=(2.0, 3.0), surges=(IsolatedOutliers(0.3),))
    episodes = source.simulate(streams(200))
    np.testing.assert_array_equal(episodes.nominal_noise, np.diag([4.0, 9.0]))
    error = (episodes.measurements - episodes.truth.position) / np.array([2.0, 3.0])
    unit = error / np.sqrt(episodes.scale)[..., None]
    # 20 000 numbers: the standard deviation is known to 0.5 %, 10 % of sigma is 20 of these.
    assert unit.std() == pytest.approx(1.0, abs=0.022)
    assert np.mean(episodes.scale > 1) == pytest.approx(0.3, abs=0.02)
    np.testing.assert_allclose(episodes.noise, episodes.scale[..., None, None] * episodes.nominal_noise)


def test_simulated_sensor_stands_where_its_platform_is():
    sensing = Sensing(range_bearing((0.01, 1e-4)), Platform(((100.0, -20.0),)), detection_probability=0.8)
    source = RecordedSource(circles(), steps=40, noise="simulated", sensing=sensing)
    episodes = source.simulate(streams(50))
    assert source.sensor.name == "range-bearing"
    offset = episodes.truth.position - [100.0, -20.0]
    polar = np.stack([np.hypot(offset[..., 0], offset[..., 1]), np.arctan2(offset[..., 1], offset[..., 0])], axis=-1)
    seen = episodes.detected
    assert seen.mean() == pytest.approx(0.8, abs=0.04)
    error = np.angle(np.exp(1j * (episodes.measurements - polar)[seen][:, 1]))
    assert np.abs(error).max() < 6e-4
    assert np.isnan(episodes.measurements[~seen]).all()


def test_nominal_sigma_comes_from_the_errors_in_the_file():
    tracks = circles(rows=(3000, 3000), noise=0.5)
    source = RecordedSource(tracks, steps=50)
    # 1.4826 MAD of 5000 numbers has a standard deviation of 1.7 %.
    np.testing.assert_allclose(source.sensor.sigma, 0.5, rtol=0.07)
    np.testing.assert_allclose(source.simulate(streams(2)).noise[0, 0], source.sensor.noise)
    rows = np.where(np.arange(3000) % 3 == 0, 16.0, 1.0)[None, :, None, None] * np.eye(2)
    given = RecordedSource(dataclasses.replace(tracks, noise=np.tile(rows, (2, 1, 1, 1))), steps=50)
    assert given.sensor.sigma == (1.0, 1.0)
    episodes = given.simulate(streams(3))
    np.testing.assert_allclose(episodes.noise, episodes.scale[..., None, None] * np.eye(2))
    assert set(np.unique(episodes.scale)) == {1.0, 16.0}
    assert RecordedSource(tracks, steps=50, sigma=7.0).sensor.sigma == (7.0, 7.0)


def test_velocity_and_acceleration_from_positions():
    """Without recorded velocities: second-order differences, so errors go with the square of the gap."""
    tracks = dataclasses.replace(circles(), truth_velocity=None)
    for track, rate in zip((0, 1), RATES, strict=True):
        source = RecordedSource(tracks.subset([track]), steps=30)
        episodes = source.simulate(streams(30))
        position, velocity = episodes.truth.position, episodes.truth.velocity
        wanted = rate * np.stack([-position[..., 1], position[..., 0]], axis=-1)
        speed = np.abs(rate) * (40.0 + 10.0 * track)
        # Third derivative times two gaps of at most 0.4 s, over 6, and over 3 at the ends.
        assert np.abs(velocity - wanted).max() < speed * rate**2 * 0.4**2 / 3
        # Differences of these, over gaps of at least 0.05 s, one of which a single wrong row would exceed.
        assert np.abs(episodes.truth.acceleration + rate**2 * position).max() < 0.25 * speed * abs(rate)


def test_rows_at_equal_times_share_their_velocity():
    tracks = circles(noise=0.0)
    double = [np.repeat(part, 2, axis=0) for part in (tracks.times[0], tracks.truth[0], tracks.measurements[0])]
    source = RecordedSource(Tracks.from_arrays(double[2], double[0], truth=double[1]), steps=60, sigma=1.0)
    episodes = source.simulate(streams(10))
    assert np.isfinite(episodes.truth.velocity).all()
    same = np.diff(episodes.times, axis=1) == 0
    assert same.any()
    np.testing.assert_array_equal(episodes.truth.velocity[:, 1:][same], episodes.truth.velocity[:, :-1][same])


def test_prior_and_filter_noise_are_sensible():
    tracks = circles(rows=(2000, 2000))
    source = RecordedSource(tracks, steps=40)
    episodes = source.simulate(streams(500))
    np.testing.assert_allclose(np.diag(episodes.prior_cov)[[0, 1]], (3 * np.sqrt(2) * 0.5) ** 2, rtol=0.15)
    start = np.concatenate([episodes.truth.position[:, 0], episodes.truth.velocity[:, 0]], axis=1)
    unit = (episodes.prior_mean - start) / np.sqrt(np.diag(episodes.prior_cov))
    assert unit.std() == pytest.approx(1.0, abs=0.1)
    assert RecordedSource(tracks, steps=40, start_sigma=(7.0, 3.0)).simulate(streams(1)).prior_cov[3, 3] == 9.0
    assert RecordedSource(tracks, steps=40, filter_noise=2.5).filter_noise == 2.5


def test_filter_noise_is_that_of_white_acceleration():
    """Integrated white acceleration of known density, exactly sampled."""
    generator, dt, density, rows = np.random.default_rng(0), 0.5, 3.0, 20_000
    factor = np.linalg.cholesky(density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    drawn = generator.standard_normal((rows, 2, 2)) @ factor.T
    velocity = np.cumsum(drawn[..., 1], axis=0)
    position = np.cumsum(dt * np.concatenate([np.zeros((1, 2)), velocity[:-1]]) + drawn[..., 0], axis=0)
    tracks = Tracks.from_arrays(position, dt * np.arange(rows), truth=position)
    source = RecordedSource(tracks, steps=60, sigma=1.0)
    # Spans of 3 rows, 6700 independent ones in two axes: the mean square is known to 1.5 %.
    assert source.filter_noise == pytest.approx(density, rel=0.07)


def test_windows_do_not_cross_holes_and_gaps():
    tracks = circles(rows=(60,))
    truth = tracks.truth.copy()
    truth[0, 25] = np.nan
    source = RecordedSource(dataclasses.replace(tracks, truth=truth), steps=20)
    assert source.windows == (25 - 19) + (34 - 19)
    times = tracks.times.copy()
    times[0, 40:] += 30.0
    gap = RecordedSource(dataclasses.replace(tracks, times=times), steps=20, max_gap=10.0)
    assert gap.windows == (40 - 19) + 1
    assert np.diff(gap.simulate(streams(50)).times, axis=1).max() < 10.0
    assert RecordedSource(dataclasses.replace(tracks, times=times), steps=20).windows == 41


def test_measured_positions_stand_for_the_truth():
    tracks = circles(truth=False, noise=0.0, labels=False)
    measured = tracks.measurements.copy()
    measured[0, 10] = np.nan
    source = RecordedSource(dataclasses.replace(tracks, measurements=measured), steps=30, noise="simulated", sigma=1.0)
    assert "truth: measured" in source.notes
    assert source.intents == ("recorded",)
    # The row without a measurement is not there; its time is a longer gap.
    assert source.windows == 119 - 29 + 90 - 29
    assert np.isfinite(source.simulate(streams(50)).truth.position).all()


def test_smoothed_positions_stand_for_the_truth():
    tracks, known = circles(rows=(400, 400), truth=False), circles(rows=(400, 400))
    source = RecordedSource(tracks, steps=50, sigma=0.5, acceleration=5.0)
    assert "truth: smoothed" in source.notes
    episodes = source.simulate(streams(100))
    np.testing.assert_array_equal(np.isin(episodes.measurements, tracks.measurements), True)
    # Closer to what really happened than the measurements are.
    error = []
    for z, smooth in zip(episodes.measurements, episodes.truth.position, strict=True):
        b, k = np.argwhere((tracks.measurements == z[0]).all(axis=-1))[0]
        error.append(smooth - known.truth[b, k : k + 50])
    assert np.std(error) < 0.4


def test_small_file(tmp_path):
    tracks = circles()
    frames = [
        pd.DataFrame(
            {
                "track": track.id,
                "t": track.times,
                "x": track.measurements[:, 0],
                "y": track.measurements[:, 1],
                "sigma_x": 0.5,
                "sigma_y": 0.25,
                "true_x": track.truth[:, 0],
                "true_y": track.truth[:, 1],
                "intent": track.intents,
            }
        )
        for track in tracks
    ]
    file = tmp_path / "Two Circles.csv"
    pd.concat(frames).to_csv(file, index=False)
    source = RecordedSource(file, steps=50)
    assert source.id == "recorded-two-circles-v0"
    assert source.sensor.sigma == (0.5, 0.25)
    again = RecordedSource(str(file), steps=50)
    np.testing.assert_array_equal(source.simulate(streams(3)).times, again.simulate(streams(3)).times)
    copy = pickle.loads(pickle.dumps(source))
    np.testing.assert_array_equal(copy.simulate(streams(3)).prior_mean, source.simulate(streams(3)).prior_mean)


def test_ranges_to_anchors_are_measured_as_recorded():
    """One anchor at a time: the sensor's place goes with each row."""
    generator = np.random.default_rng(1)
    anchors = np.array([[0.0, 0.0], [50.0, 0.0], [0.0, 60.0]])
    tracks = circles(rows=(300,), noise=0.0)
    places = anchors[np.arange(300) % 3]
    ranges = np.linalg.norm(tracks.truth[0] - places, axis=1, keepdims=True) + 0.2 * generator.standard_normal((300, 1))
    seen = Tracks.from_arrays(
        ranges, tracks.times[0], sensor="range", axes=2, truth=tracks.truth[0],
        sensor_states=np.hstack([places, np.zeros((300, 2))]),
    )  # fmt: skip
    source = RecordedSource(seen, steps=40)
    # 300 errors: the robust deviation is known to 7 %.
    assert source.sensor.sigma[0] == pytest.approx(0.2, rel=0.3)
    episodes = source.simulate(streams(10))
    away = np.linalg.norm(episodes.truth.position - episodes.sensor_states[..., :2], axis=-1)
    assert np.abs(episodes.measurements[..., 0] - away).max() < 1.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"steps": 1}, "steps must be an integer >= 2; got 1"),
        ({"steps": 100}, "got track '2' has 90 rows, of which 90 in a row .* are fewer than 100.*skip_unusable=True"),
        ({"steps": 500}, r"track '1' has 120 rows.*and so for 1 more. Use fewer steps\."),
        ({"noise": "none"}, "noise must be one of recorded, simulated; got 'none'"),
        ({"truth": "guessed"}, "truth must be one of auto, recorded, measured, smoothed; got 'guessed'"),
        ({"truth": "measured"}, "no error at all. Use truth='smoothed'"),
        ({"surges": (IsolatedOutliers(),)}, "surges must come with simulated noise"),
        ({"noise": "simulated", "sigma": 1.0, "surges": "burst"}, "name must be a known surge; got 'burst'"),
        ({"noise": "simulated", "sigma": 1.0, "surges": [3]}, "surges must be surges or their names; got 3"),
        ({"noise": "simulated"}, "sigma or sensing must be given with simulated noise, and not both; got neither"),
        ({"noise": "simulated", "sigma": -1.0}, "sigma must"),
        ({"noise": "simulated", "sensing": Sensing(bearing()), "sigma": 1.0}, "got both"),
        ({"noise": "simulated", "sensing": Sensing(range_bearing(), latency=1.0)}, "no latency"),
        ({"max_gap": 0.0}, "max_gap must be > 0 s"),
        ({"max_gap": 0.01}, "track '1' has 120 rows, of which 1 in a row"),
        ({"start_sigma": (1.0,)}, "start_sigma must be two numbers > 0"),
        ({"filter_noise": -1.0}, "filter_noise must be finite and >= 0"),
    ],
)
def test_bad_options_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        RecordedSource(circles(), **{"steps": 30, **options})


def test_unusable_tracks_are_refused_or_left_out():
    source = RecordedSource(circles(), steps=100, skip_unusable=True)
    assert source.windows == 21
    assert any("left out: track '2' has 90 rows" in note for note in source.notes)
    blind = circles(truth=False)
    with pytest.raises(ValueError, match=r"sigma must be given for small file.csv .* Use sigma=VALUE"):
        RecordedSource(blind, steps=30)
    with pytest.raises(ValueError, match="must not be 'recorded'; got tracks without true positions"):
        RecordedSource(blind, steps=30, truth="recorded")
    still = Tracks.from_arrays(np.zeros((40, 2)), np.zeros(40), truth=np.zeros((40, 2)))
    with pytest.raises(ValueError, match="and these take no time"):
        RecordedSource(still, steps=30, sigma=1.0)
    many = dataclasses.replace(circles(rows=(200,)), intents=np.arange(200).astype(str)[None])
    with pytest.raises(ValueError, match="intents must be at most 127 different labels; got 200"):
        RecordedSource(many, steps=30)


# --- recorded data ---


def test_outdoor_ranging_fixes(data_dir):
    file = data_dir / "uwb_outdoor" / "los_A_case1_lsq_position.csv"
    if not file.exists():
        pytest.skip("uwb_outdoor is not among the recorded tracks")
    columns = {"t": "time_aligned", "x": "x", "y": "y"}
    truth = file.with_name("los_A_case1_truth.csv")
    tracks = read_tracks(file, axes=2, truth=truth, truth_columns=columns)
    source = RecordedSource(tracks, steps=200)
    episodes = source.simulate(streams(64))
    # Walking speed at 10 Hz; the fixes have gross outliers, their core is tens of centimetres.
    speed = np.linalg.norm(episodes.truth.velocity, axis=-1)
    assert 0.5 < np.median(speed) < 2.5
    assert 0.05 < min(source.sensor.sigma) <= max(source.sensor.sigma) < 1.0
    assert np.median(np.diff(episodes.times, axis=1)) == pytest.approx(0.1, abs=0.005)
    error = (episodes.measurements - episodes.truth.position) / np.asarray(source.sensor.sigma)
    assert np.median(np.abs(error)) == pytest.approx(0.6745, rel=0.2)


def test_aircraft_seen_by_a_simulated_sensor(data_dir):
    file = data_dir / "aircraft_adsb" / "munich.csv"
    if not file.exists():
        pytest.skip("aircraft_adsb is not among the recorded tracks")
    source = RecordedSource(file, steps=100, noise="simulated", sigma=50.0)
    assert "truth: measured" in source.notes
    assert {"Sl", "Ll", "Rl"} <= set(source.intents)
    episodes = source.simulate(streams(64))
    assert (np.diff(episodes.times, axis=1) == 5.0).all()
    error = episodes.measurements - episodes.truth.position
    assert error.std() == pytest.approx(50.0, rel=0.04)
    speed = np.linalg.norm(episodes.truth.velocity, axis=-1)
    assert 40.0 < np.median(speed) < 150.0
    # Turns as labelled are turns as flown: signed turn rate of left and right rows.
    v, a = episodes.truth.velocity, episodes.truth.acceleration
    rate = (v[..., 0] * a[..., 1] - v[..., 1] * a[..., 0]) / np.square(speed)
    labels = np.array(source.intents)[episodes.truth.intent]
    left, right = np.char.startswith(labels, "L"), np.char.startswith(labels, "R")
    assert np.median(rate[left]) > 0.005
    assert np.median(rate[right]) < -0.005
