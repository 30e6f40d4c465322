"""Starts: what is used once, where a track begins, and how far its Gaussian can be believed."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from jink.estimators.sensors import (
    bearing,
    bearing_elevation,
    position,
    range_bearing,
    range_bearing_rate,
    range_only,
    range_range_rate,
    range_rate,
    ranges,
)
from jink.estimators.starting import MAX_ROWS, start_batch, start_prior

DATA = Path(os.environ.get("JINK_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def table(name):
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{name} not found; set JINK_DATA to the folder of recorded data")
    return np.genfromtxt(path, delimiter=",", skip_header=1)


def measure(sensor, truths, states, rng):
    """Noisy measurements (T, D) of kinematics (T, 2 A)."""
    out = np.empty((len(truths), sensor.size))
    for row, kin, state in zip(out, truths, states, strict=True):
        sensor.observe(kin, state, np.asarray(sensor.params), row)
    return out + rng.normal(size=out.shape) * sensor.sigma


def straight(place, velocity, times):
    place, velocity = np.asarray(place), np.asarray(velocity)
    return np.concatenate([place + np.outer(times, velocity), np.tile(velocity, (len(times), 1))], axis=1)


def begin(sensor, z, times, states=None, speed=10.0, **options):
    noise = np.tile(sensor.noise, (len(z), 1, 1))
    z, times = np.asarray(z, dtype=float), np.asarray(times, dtype=float)
    return start_prior(sensor, z, times, noise, states, speed, **options)


def nees(start, truth):
    error = np.r_[start.position, start.velocity] - truth[start.index]
    return error @ np.linalg.solve(start.covariance, error)


def test_position_starts_at_the_first_row_that_holds_something():
    z = [[np.nan, np.nan], [3.0, -4.0], [9.0, 9.0]]
    start = begin(position(sigma=(2.0, 5.0)), z, [0.0, 1.0, 2.0], speed=7.0)
    assert (start.index, start.seen, start.ok) == (1, 1, True)
    np.testing.assert_array_equal(start.position, [3.0, -4.0])
    np.testing.assert_array_equal(start.velocity, 0.0)
    np.testing.assert_allclose(start.covariance, np.diag([4.0, 25.0, 49.0, 49.0]))


def test_the_rows_own_noise_counts_and_a_bad_one_is_replaced():
    sensor = position()
    noise = np.array([[[9.0, 1.0], [1.0, 4.0]]])
    start = start_prior(sensor, np.zeros((1, 2)), np.zeros(1), noise, None, 1.0)
    np.testing.assert_allclose(start.covariance[:2, :2], noise[0])
    start = start_prior(sensor, np.zeros((1, 2)), np.zeros(1), noise * np.nan, None, 1.0)
    np.testing.assert_allclose(start.covariance[:2, :2], sensor.noise)


def test_alternating_components_of_a_position_start_together():
    z = np.array([[np.nan, 5.0], [8.0, np.nan], [8.0, np.nan], [np.nan, 5.0]])
    start = begin(position(sigma=1.0), z, [0.0, 0.1, 0.2, 0.3], speed=1.0)
    assert start.ok and start.seen == start.index + 1 > 1
    np.testing.assert_allclose(start.position, [8.0, 5.0], atol=0.1)


def test_batch_equals_singles_and_leaves_inputs():
    rng = np.random.default_rng(1)
    z = rng.normal(size=(30, 6, 2)) * 100
    z[rng.random((30, 6)) < 0.5] = np.nan
    z[3] = np.nan
    z[4, 0] = [1.0, np.nan]
    times = np.tile(np.arange(6.0), (30, 1))
    before = z.copy()
    for sensor in (position(sigma=3.0), range_bearing(sigma=(3.0, 0.1))):
        batch = start_batch(sensor, z, times, sensor.noise, None, 10.0)
        for track in range(30):
            single = begin(sensor, z[track], times[track])
            for column, value in zip(batch, single, strict=True):
                np.testing.assert_array_equal(column[track], value)
    np.testing.assert_array_equal(z, before)
    assert not batch.ok[3]


def test_range_rate_of_the_first_row_sets_the_velocity_along_the_line_of_sight():
    rng = np.random.default_rng(2)
    sensor, state = range_bearing_rate(sigma=(10.0, 0.05, 0.2)), np.array([100.0, 0.0, 4.0, 3.0])
    values = []
    for _ in range(3000):
        truth = np.r_[[-3000.0, 2000.0], rng.normal(0, 20.0, 2)][None]
        start = begin(sensor, measure(sensor, truth, [state], rng), [0.0], state[None], speed=20.0)
        values.append(nees(start, truth))
    along = (start.position - state[:2]) / np.linalg.norm(start.position - state[:2])
    assert math.sqrt(along @ start.covariance[2:, 2:] @ along) < 2.0
    assert np.mean(values) == pytest.approx(4.0, abs=4 * np.std(values) / math.sqrt(3000))


def test_one_anchor_at_a_time_is_consistent():
    rng = np.random.default_rng(3)
    anchors = np.array([[0.0, 0.0], [60.0, 5.0], [20.0, 50.0], [-30.0, 20.0]])
    sensor, times = range_only(sigma=0.3), np.arange(60) * 0.1
    states = np.zeros((60, 4))
    states[:, :2] = anchors[np.arange(60) % 4]
    values = []
    for _ in range(150):
        truth = straight(rng.uniform(0, 30, 2), rng.normal(0, 2.0, 2), times)
        start = begin(sensor, measure(sensor, truth, states, rng), times, states, speed=2.0)
        assert start.ok and start.seen < MAX_ROWS
        values.append(nees(start, truth))
    # 150 draws of chi-square(4): standard error 0.23.
    assert np.mean(values) == pytest.approx(4.0, abs=0.95)


def test_bearings_from_a_turning_ship_across_the_cut():
    rng = np.random.default_rng(4)
    sensor, times = bearing(sigma=0.002), np.arange(60) * 2.0
    angle = times * 0.03
    states = np.stack([800 * np.sin(angle), 800 * np.cos(angle), np.zeros(60), np.zeros(60)], axis=1)
    values = []
    for _ in range(60):
        truth = straight([-4000.0, rng.normal(300, 100)], rng.normal(0, 3.0, 2), times)
        z = measure(sensor, truth, states, rng)
        start = begin(sensor, np.remainder(z + np.pi, 2 * np.pi) - np.pi, times, states, speed=3.0)
        assert start.ok and 3 <= start.seen < MAX_ROWS
        values.append(nees(start, truth))
    # 60 draws of chi-square(4): standard error 0.37.
    assert np.mean(values) == pytest.approx(4.0, abs=1.5)
    assert (z > 3.0).any() and (np.abs(z) > 2.5).all()


def test_camera_on_a_moving_platform_in_space():
    rng = np.random.default_rng(5)
    sensor, times = bearing_elevation(sigma=0.002), np.arange(50) * 1.0
    states = straight([0.0, 0.0, 100.0], [60.0, 0.0, 0.0], times)
    truth = straight([1500.0, 2500.0, 700.0], [2.0, -1.0, 0.5], times)
    start = begin(sensor, measure(sensor, truth, states, rng), times, states, speed=3.0)
    assert start.ok
    assert nees(start, truth) < 22.5  # chi-square(6), 0.999


def test_still_sensors_that_cannot_locate_say_so():
    rng = np.random.default_rng(6)
    times = np.arange(80) * 1.0
    truth, states = straight([500.0, 300.0], [3.0, 1.0], times), np.zeros((80, 4))
    for sensor in (range_only(), bearing(), range_rate()):
        start = begin(sensor, measure(sensor, truth, states, rng), times, states)
        assert (start.ok, start.seen, start.index) == (False, 0, 0)
        assert np.isfinite(start.covariance).all() and (np.linalg.eigvalsh(start.covariance) > 0).all()
        assert np.linalg.norm(truth[0, :2]) < 3 * math.sqrt(start.covariance[0, 0])
        z = measure(sensor, truth, states, rng)
        start = begin(sensor, z, times, states, area=((400.0, 400.0), 200.0))
        assert start.ok


def test_area_stands_in_where_nothing_was_seen():
    start = begin(position(), np.full((3, 2), np.nan), [0.0, 1.0, 2.0], area=((5.0, -6.0), 40.0), speed=2.0)
    assert (start.ok, start.seen, start.index) == (True, 0, 0)
    np.testing.assert_allclose(start.position, [5.0, -6.0])
    np.testing.assert_allclose(start.covariance, np.diag([1600.0, 1600.0, 4.0, 4.0]))
    assert not begin(position(), np.full((3, 2), np.nan), [0.0, 1.0, 2.0]).ok


def test_area_decides_between_mirror_images():
    rng = np.random.default_rng(7)
    times = np.arange(60) * 0.5
    states = np.zeros((60, 4))
    states[:, 0] = 40.0 * (np.arange(60) % 3)
    truth, sensor = straight([30.0, 25.0], [0.2, 0.1], times), range_only(sigma=0.2)
    z = measure(sensor, truth, states, rng)
    alone = begin(sensor, z, times, states, speed=0.5)
    image = alone.position * [1, -1]
    assert alone.ok and alone.seen == MAX_ROWS
    offset = np.r_[image - alone.position, 0, 0]
    assert offset[:2] @ np.linalg.solve(alone.covariance[:2, :2], offset[:2]) < 2.1
    for side in (1, -1):
        start = begin(sensor, z, times, states, speed=0.5, area=((40.0, 30.0 * side), 10.0))
        assert start.seen < MAX_ROWS
        np.testing.assert_allclose(start.position, truth[start.index, :2] * [1, side], atol=2.0)


def test_a_gross_outlier_in_the_first_rows_does_not_decide():
    rng = np.random.default_rng(8)
    anchors = np.array([[0.0, 0.0], [60.0, 5.0], [20.0, 50.0], [-30.0, 20.0]])
    times = np.arange(60) * 0.1
    states = np.zeros((60, 4))
    states[:, :2] = anchors[np.arange(60) % 4]
    sensor, truth = range_only(sigma=0.1), straight([15.0, 12.0], [1.0, -0.5], times)
    z = measure(sensor, truth, states, rng)
    z[5] -= 10.0
    # Until more rows outvote the outlier, the start must at least not claim to be precise and be wrong.
    start = begin(sensor, z, times, states, speed=2.0)
    assert start.ok
    assert np.linalg.norm(start.position - truth[start.index, :2]) < 1.5


def test_noise_that_is_declared_far_too_small_shows_in_the_covariance():
    rng = np.random.default_rng(12)
    anchors = np.array([[0.0, 0.0], [60.0, 5.0], [20.0, 50.0], [-30.0, 20.0]])
    times = np.arange(60) * 0.1
    states = np.zeros((60, 4))
    states[:, :2] = anchors[np.arange(60) % 4]
    truth = straight([15.0, 12.0], [1.0, -0.5], times)
    z = measure(range_only(sigma=0.5), truth, states, rng)
    start = begin(range_only(sigma=0.002), z, times, states, speed=0.5)
    # Declared: 2 mm. The misfit of the first rows says decimetres.
    assert math.sqrt(start.covariance[0, 0]) > 0.01


def test_growing_track_starts_where_the_whole_track_does():
    rng = np.random.default_rng(9)
    sensor, times = range_only(sigma=0.3), np.arange(40) * 0.2
    states = np.zeros((40, 4))
    states[:, :2] = np.array([[0.0, 0.0], [60.0, 5.0], [20.0, 50.0]])[np.arange(40) % 3]
    z = measure(sensor, straight([15.0, 12.0], [1.0, -0.5], times), states, rng)
    whole = begin(sensor, z, times, states)
    for rows in range(1, 41):
        start = begin(sensor, z[:rows], times[:rows], states[:rows], complete=False)
        if start.ok:
            break
    assert rows == whole.seen
    for a, b in zip(start, whole, strict=True):
        np.testing.assert_array_equal(a, b)


def test_range_and_range_rate_from_a_turning_sensor_start_with_position_and_velocity():
    rng = np.random.default_rng(12)
    sensor, times = range_range_rate(sigma=(0.5, 0.05)), np.arange(30) * 0.5
    states = np.zeros((30, 4))
    states[:, 0], states[:, 1] = 60 * np.cos(times / 3), 60 * np.sin(times / 3)
    states[:, 2], states[:, 3] = -20 * np.sin(times / 3), 20 * np.cos(times / 3)
    truth = straight([150.0, 40.0], [3.0, -2.0], times)
    start = begin(sensor, measure(sensor, truth, states, rng), times, states, speed=5.0)
    assert start.ok and start.seen > 1
    assert nees(start, truth) < 18.5  # chi-square of four, one in a thousand


def test_ranges_that_come_two_at_a_time_are_gathered():
    rng = np.random.default_rng(10)
    sensor = ranges([[0.0, 0.0], [50.0, 0.0], [20.0, 40.0], [-10.0, 30.0]], sigma=0.2)
    times = np.arange(20) * 0.1
    truth = straight([12.0, 18.0], [1.0, 2.0], times)
    z = measure(sensor, truth, np.zeros((20, 4)), rng)
    full = begin(sensor, z, times)
    assert full.seen == 1
    z[::2, 2:] = np.nan
    z[1::2, :2] = np.nan
    start = begin(sensor, z, times, speed=3.0)
    assert start.ok and 1 < start.seen < 10
    np.testing.assert_allclose(start.position, truth[start.index, :2], atol=1.0)


@pytest.mark.parametrize("offset", [0, 400, 2000])
def test_recorded_uwb_ranges_locate_within_a_second(offset):
    rows = table("uwb_outdoor/los_A_case1_ranges.csv")[offset : offset + 60]
    truth = table("uwb_outdoor/los_A_case1_truth.csv")
    states = np.zeros((len(rows), 4))
    states[:, :2] = rows[:, 2:4]
    start = begin(range_only(sigma=0.1), rows[:, 5:6], rows[:, 0], states, speed=1.5)
    assert start.ok and rows[start.index, 0] - rows[0, 0] < 1.0
    place = [np.interp(rows[start.index, 0], truth[:, 1], truth[:, axis]) for axis in (2, 3)]
    error = np.linalg.norm(start.position - place)
    sd = math.sqrt(np.linalg.eigvalsh(start.covariance[:2, :2])[-1])
    assert error < max(0.5, 2.5 * sd)  # the anchors lie within 2 m of each other: far off they see no more
    if offset == 0:
        assert error < 0.5


@pytest.mark.parametrize("offset", [0, 500, 2000])
def test_recorded_plaza_ranges_locate(offset):
    rows = table("plaza_range/plaza1_ranges.csv")[offset : offset + 60]
    truth = table("plaza_range/plaza1_truth.csv")
    states = np.zeros((len(rows), 4))
    states[:, :2] = rows[:, 3:5]
    start = begin(range_only(sigma=1.5), rows[:, 2:3], rows[:, 0], states, speed=1.0)
    place = [np.interp(rows[start.index, 0], truth[:, 0], truth[:, axis]) for axis in (1, 2)]
    assert start.ok
    assert np.linalg.norm(start.position - place) < 7.0  # ranges are 2.8 m too long, of up to 70 m


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"speed": 0.0}, ["speed", "> 0"]),
        ({"speed": math.nan}, ["speed"]),
        ({"area": ((0.0, 0.0, 0.0), 5.0)}, ["area", "(2,)"]),
        ({"area": ((0.0, 0.0), -5.0)}, ["area", "sd"]),
    ],
)
def test_errors_name_the_argument(options, words):
    with pytest.raises(ValueError) as caught:
        begin(position(), [[0.0, 0.0]], [0.0], **options)
    assert all(word in str(caught.value) for word in words)


def test_wild_numbers_never_raise():
    rng = np.random.default_rng(11)
    for sensor in (position(), range_bearing(), range_only(), bearing(), range_bearing_rate(), range_rate()):
        for power in (-9, 0, 9, 150):
            z = rng.normal(size=(12, sensor.size)) * 10.0**power
            z[rng.random(z.shape) < 0.4] = np.nan
            z[3] = np.inf
            states = rng.normal(size=(12, 4)) * 10.0
            start = begin(sensor, z, np.repeat(np.arange(6.0), 2), states)
            assert np.isfinite(start.position).all() and np.isfinite(start.covariance).all()
