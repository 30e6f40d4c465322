"""Scenes of several targets and sensors, and networks: statistics, streams, geometry, labels, published numbers."""

import csv
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from jink.envs import scenes
from jink.envs.literature.published_legs import Leg
from jink.envs.networks import (
    CONSENSUS_SENSING,
    Network,
    check_weights,
    complete,
    consensus_network,
    geometric,
    line,
    metropolis_weights,
    ring,
    second_eigenvalue,
)
from jink.envs.recorded import read_tracks
from jink.envs.scene_library import SCENES, get_scene
from jink.envs.scenery.paths import Path
from jink.envs.scenery.regions import Box, Sector
from jink.envs.scenery.scene_data import CLUTTER, PADDING
from jink.envs.scenery.scene_sensors import SceneSensor
from jink.envs.scenes import Scene, SceneTarget, simulate_scene
from jink.envs.streams import draw

SECTOR = Sector(range_max=9000.0, range_min=1000.0, boresight=2.5, width=2.0)
RADAR = SceneSensor("range-bearing", (20.0, 0.01), SECTOR, (100.0, -50.0), detection=0.7, clutter=8.0)
STILL = Path((-4000.0, 3000.0), (0.0, 0.0))
LONG = Scene("long-v0", "one still target", "test", 9999.0, (SceneTarget(STILL),), (RADAR,))


def numbers(data):
    return (data.times, data.measurements, data.count, data.origin, data.truth.position, data.truth.velocity)


def detections(data):
    """Measurements of targets only, in a fixed order: scan, target, values."""
    scan, column = np.nonzero(data.origin >= 0)
    table = np.column_stack([scan, data.origin[scan, column], data.measurements[scan, column]])
    return table[np.lexsort((table[:, 1], table[:, 0]))]


# --- statistics: 10 000 scans, so 10 % of a parameter is 7 sd or more and the tolerance is 4.5 sd ---


def test_false_alarms_are_poisson():
    counts = (simulate_scene(LONG, 3).origin == CLUTTER).sum(axis=1)
    assert len(counts) == 10_000
    assert abs(counts.mean() - 8.0) < 4.5 * np.sqrt(8.0 / 10_000)
    # Dispersion of a Poisson count is 1; the estimate of it has a standard deviation sqrt(2 / K).
    assert abs(counts.var(ddof=1) / counts.mean() - 1.0) < 4.5 * np.sqrt(2 / 10_000)
    # Independent from scan to scan.
    assert abs(np.corrcoef(counts[1:], counts[:-1])[0, 1]) < 4.5 / np.sqrt(10_000)


def test_targets_are_detected_as_often_as_said():
    found = (simulate_scene(LONG, 4).origin == 0).sum(axis=1)
    assert set(np.unique(found)) == {0, 1}
    assert abs(found.mean() - 0.7) < 4.5 * np.sqrt(0.21 / 10_000)
    assert abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < 4.5 / np.sqrt(10_000)


def test_detections_have_the_noise_they_are_said_to_have():
    data = simulate_scene(LONG, 5)
    error = data.measurements[data.origin == 0] - [np.hypot(-4100.0, 3050.0), np.arctan2(3050.0, -4100.0)]
    unit = error / [20.0, 0.01]
    assert abs(unit.mean(axis=0)).max() < 4.5 / np.sqrt(len(unit))
    assert abs(unit.std(axis=0) - 1).max() < 4.5 / np.sqrt(2 * len(unit))
    assert abs(np.corrcoef(unit.T)[0, 1]) < 4.5 / np.sqrt(len(unit))
    np.testing.assert_array_equal(data.noise[0], np.diag([400.0, 1e-4]))


@pytest.mark.parametrize("space", ["measurement", "plane"])
def test_false_alarms_are_uniform_where_they_are_said_to_be(space):
    data = simulate_scene(replace(LONG, sensors=(replace(RADAR, clutter_space=space),)), 6)
    distance, bearing = data.measurements[data.origin == CLUTTER].T
    near, far = SECTOR.range_min, SECTOR.range_max
    along = (distance - near) / (far - near) if space == "measurement" else (distance**2 - near**2) / (far**2 - near**2)
    across = np.mod(bearing - SECTOR.boresight + np.pi, 2 * np.pi) - np.pi
    for part in (along, across / SECTOR.width + 0.5):
        assert stats.kstest(part, "uniform").pvalue > 1e-4
    assert abs(np.corrcoef(along, across)[0, 1]) < 4.5 / np.sqrt(len(along))


@pytest.mark.parametrize("axes", [2, 3])
def test_false_alarms_of_a_position_sensor_fill_its_box(axes):
    low, high = (-3.0, 5.0, 100.0)[:axes], (1.0, 6.0, 500.0)[:axes]
    sensor = SceneSensor("position", (1.0,) * axes, Box(low, high), (7.0,) * axes, clutter=5.0)
    places = sensor.false_alarms(np.random.default_rng(0).random((20_000, axes)))
    for a in range(axes):
        assert stats.kstest((places[:, a] - low[a]) / (high[a] - low[a]), "uniform").pvalue > 1e-4
    density = sensor.clutter_density(places)
    np.testing.assert_allclose(density.plane, 5.0 / np.prod(np.subtract(high, low)))


@pytest.mark.parametrize("space", ["measurement", "plane"])
def test_clutter_density_is_that_of_the_false_alarms(space):
    """Counts in small cells of polar and of Cartesian coordinates against both densities."""
    sensor = replace(RADAR, place=(0.0, 0.0), clutter_space=space)
    draws = 400_000
    places = sensor.false_alarms(np.random.default_rng(1).random((draws, 2)))
    r, b = np.hypot(*places.T), np.arctan2(places[:, 1], places[:, 0])
    for distance in (2000.0, 7000.0):
        middle = distance * np.array([np.cos(2.4), np.sin(2.4)])
        density = sensor.clutter_density(middle)
        polar = np.mean((abs(r - distance) < 400) & (abs(b - 2.4) < 0.15)) * sensor.clutter / (800 * 0.3)
        plane = np.mean((abs(places - middle) < 350).all(axis=1)) * sensor.clutter / 700**2
        # At least 700 points per cell: 4 sd = 15 %; at these two ranges the densities differ by a factor of 3.5.
        assert polar == pytest.approx(float(density.measurement), rel=0.15)
        assert plane == pytest.approx(float(density.plane), rel=0.15)
    outside = sensor.clutter_density(np.array([[5000.0, 0.0], [np.nan, 0.0]]))
    np.testing.assert_array_equal(outside, 0.0)


# --- randomness ---


@pytest.mark.parametrize("name", SCENES)
def test_same_seed_same_bits_other_seed_other_bits(name):
    scene = SCENES[name]
    first, again, other = simulate_scene(scene, 7), simulate_scene(scene, 7), simulate_scene(scene, 8)
    for one, two in zip(numbers(first), numbers(again), strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(detections(first), detections(other))


@pytest.mark.parametrize("name", SCENES)
def test_clutter_moves_neither_target_nor_detection(name):
    scene = SCENES[name]
    quiet = replace(scene, sensors=tuple(replace(s, clutter=0.0) for s in scene.sensors))
    loud = replace(scene, sensors=tuple(replace(s, clutter=30.0) for s in scene.sensors))
    one, two = simulate_scene(quiet, 7), simulate_scene(loud, 7)
    assert (two.count > one.count).mean() > 0.99
    assert (one.origin != CLUTTER).all()
    np.testing.assert_array_equal(one.truth.position, two.truth.position)
    np.testing.assert_array_equal(detections(one), detections(two))


def test_streams_do_not_touch_each_other():
    base = simulate_scene(get_scene("births-v0"), 9)
    scene = base.scene
    clutter = base.measurements[base.origin == CLUTTER]
    worse = simulate_scene(replace(scene, sensors=tuple(replace(s, detection=0.5) for s in scene.sensors)), 9)
    np.testing.assert_array_equal(worse.measurements[worse.origin == CLUTTER], clutter)
    kept = {tuple(row) for row in detections(base)}
    assert {tuple(row) for row in detections(worse)} < kept
    noisy = simulate_scene(replace(scene, sensors=tuple(replace(s, sigma=(100.0, 0.02)) for s in scene.sensors)), 9)
    np.testing.assert_array_equal(detections(noisy)[:, :2], detections(base)[:, :2])
    assert not np.array_equal(detections(noisy), detections(base))
    fewer = simulate_scene(replace(scene, targets=scene.targets[:3]), 9)
    np.testing.assert_array_equal(detections(fewer), detections(base)[detections(base)[:, 1] < 3])
    np.testing.assert_array_equal(fewer.measurements[fewer.origin == CLUTTER], clutter)


def test_every_target_and_sensor_has_its_own_generators(monkeypatch):
    keys, made = [], scenes._generator
    monkeypatch.setattr(scenes, "_generator", lambda seed, *key: keys.append(key) or made(seed, *key))
    simulate_scene(get_scene("births-v0"), 5)
    wanted = [("truth", n) for n in range(5)] + [("clutter", s) for s in range(2)]
    wanted += [(name, s, n) for name in ("detection", "noise") for s in range(2) for n in range(5)]
    assert sorted(map(str, keys)) == sorted(map(str, wanted))
    first = {made(5, *key).random() for key in wanted} | {made(6, *key).random() for key in wanted}
    assert len(first) == 2 * len(wanted)


def test_order_within_a_scan_tells_nothing():
    data = simulate_scene(LONG, 10)
    for k in range(100):
        assert (np.diff(data.scan(k)[:, 0]) >= 0).all()
    position = np.argmax(data.origin == 0, axis=1)[(data.origin == 0).any(axis=1)]
    assert len(np.unique(position)) > 5


# --- geometry, times, labels ---


def test_bearing_is_counter_clockwise_from_x_and_seen_from_the_sensor():
    sensor = replace(RADAR, region=Sector(9000.0), place=(100.0, 200.0))
    north, west = sensor.measure(np.array([[100.0, 700.0], [-400.0, 200.0]]))
    np.testing.assert_allclose(north, [500.0, np.pi / 2])
    np.testing.assert_allclose(west, [500.0, np.pi])
    # The same to noise across the cut: wrapped, and never a negative range.
    turned = sensor.measure(np.array([-400.0, 200.0]), np.array([0.0, 1.0]))
    np.testing.assert_allclose(turned, [500.0, -np.pi + 0.01])
    assert sensor.measure(np.array([100.0, 200.0]), np.array([-2.0, 0.0]))[0] == pytest.approx(40.0)


def test_sector_watches_what_it_should():
    sensor = replace(RADAR, place=(0.0, 0.0), region=Sector(10.0, 1.0, boresight=np.pi, width=np.pi / 2))
    points = np.array([[-5, 0], [-5, 4.9], [-5, 5.1], [-5, -4.9], [5, 0], [-0.5, 0], [-11, 0], [np.nan, 0]])
    assert sensor.watches(points).tolist() == [True, True, False, True, False, False, False, False]
    assert sensor.region.area == pytest.approx(np.pi / 4 * 99)
    assert sensor.volume == pytest.approx(9 * np.pi / 2)


def test_targets_outside_the_region_are_never_seen():
    scene = replace(LONG, duration=100.0, sensors=(replace(RADAR, detection=1.0, region=Sector(6000.0)),))
    far = replace(scene, targets=(SceneTarget(Path((100.0, 0.0), (100.0, 0.0))),))
    data = simulate_scene(far, 1)
    distance = np.hypot(*(data.truth.position[0] - [100.0, -50.0]).T)
    np.testing.assert_array_equal((data.origin == 0).any(axis=1), distance <= 6000.0)


def test_asynchronous_scans_are_in_time_order():
    scene = get_scene("crossing-v0")
    data = simulate_scene(scene, 0)
    np.testing.assert_array_equal(data.times, np.arange(81.0))
    np.testing.assert_array_equal(data.sensor, np.arange(81) % 2)
    np.testing.assert_array_equal(data.places[:, 0], np.where(data.sensor == 0, -2000.0, 2000.0))
    # A tenth is not exact in binary; the last scan is still there, and equal times come in the order of sensors.
    tenths = replace(scene, duration=0.3, sensors=tuple(replace(s, period=0.1, offset=0.0) for s in scene.sensors))
    fine = simulate_scene(tenths, 0)
    assert len(fine) == 8
    np.testing.assert_array_equal(fine.sensor, [0, 1] * 4)


def test_births_and_deaths_happen_when_said():
    data = simulate_scene(get_scene("births-v0"), 2)
    spans = [(0, 80), (0, 50), (20, 80), (40, 70), (55, 80)]
    for target, (birth, death) in enumerate(spans):
        there = (data.times >= birth) & (data.times <= death)
        np.testing.assert_array_equal(data.truth.alive[target], there)
        np.testing.assert_array_equal(np.isfinite(data.truth.position[target, :, 0]), there)
        seen = (data.origin == target).any(axis=1)
        assert seen[there].mean() > 0.7
        assert not seen[~there].any()
        first = np.flatnonzero(there)[0]
        np.testing.assert_allclose(data.truth.position[target, first], data.scene.targets[target].motion.position)


def test_place_and_heading_put_the_motion_into_the_scene():
    moved = SceneTarget(Path((10.0, 0.0), (0.0, 5.0)), birth=2.0, place=(100.0, 200.0), heading=np.pi / 2)
    sensor = SceneSensor("position", (1.0, 1.0), Box((-1e4, -1e4), (1e4, 1e4)), period=2.0)
    data = simulate_scene(Scene("moved-v0", "", "", 4.0, (moved,), (sensor,)), 0)
    np.testing.assert_allclose(data.truth.position[0, 1:], [[100.0, 210.0], [90.0, 210.0]])
    np.testing.assert_allclose(data.truth.velocity[0, 1:], [[-5.0, 0.0]] * 2, atol=1e-12)


def test_labels_name_the_nearest_target():
    """With tiny noise every labelled measurement is its target's, every clutter label is nobody's."""
    scene = get_scene("births-v0")
    exact = replace(scene, sensors=tuple(replace(s, sigma=(1e-6, 1e-9), detection=1.0) for s in scene.sensors))
    data = simulate_scene(exact, 3)
    for k in range(len(data)):
        sensor = scene.sensors[data.sensor[k]]
        for z, origin in zip(data.scan(k), data.origin[k], strict=False):
            away = np.abs(sensor.measure(data.truth.position[:, k]) - z) / [1e-6, 1e-9]
            hit = np.flatnonzero((away < 8).all(axis=1))
            assert hit.tolist() == ([origin] if origin >= 0 else [])
    np.testing.assert_array_equal((data.origin >= 0).sum(axis=1), data.truth.alive.sum(axis=0))
    np.testing.assert_array_equal((data.origin != PADDING).sum(axis=1), data.count)
    assert np.isnan(data.measurements[data.origin == PADDING]).all()


def test_path_agrees_with_its_derivatives_and_labels():
    legs = (Leg(4.0, "straight"), Leg(5.0, "turn", 0.3), Leg(3.0, "brake", acceleration=(-1.0, 2.0)))
    path = Path((1.0, 2.0), (30.0, -5.0), legs)
    times = np.arange(0.0, 15.0, 1e-3)[None]
    truth = path.simulate(times, None)
    smooth = np.abs(times[0, 1:-1, None] - np.array([4.0, 9.0])).min(axis=1) > 2e-3
    slope = (truth.position[0, 2:] - truth.position[0, :-2]) / 2e-3
    np.testing.assert_allclose(slope[smooth], truth.velocity[0, 1:-1][smooth], atol=1e-5)
    slope = (truth.velocity[0, 2:] - truth.velocity[0, :-2]) / 2e-3
    np.testing.assert_allclose(slope[smooth], truth.acceleration[0, 1:-1][smooth], atol=1e-5)
    np.testing.assert_array_equal(truth.switch_times, [[4.0, 9.0]])
    assert [path.intents[truth.intent[0, k]] for k in (3999, 4000, 8999, 9000, 14_999)] == [
        "straight", "turn", "turn", "brake", "brake",
    ]  # fmt: skip
    assert abs(np.diff(truth.position[0], axis=0)).max() < 0.05


# --- files ---


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_scene_files_are_read_back(tmp_path, suffix):
    data = simulate_scene(replace(get_scene("crossing-v0"), sensors=(replace(RADAR, detection=0.5, clutter=0.3),)), 1)
    assert (data.count == 0).any()
    frame = data.to_frame()
    file = tmp_path / f"scene.{suffix}"
    frame.to_csv(file, index=False) if suffix == "csv" else frame.to_parquet(file)
    (track,) = read_tracks(file)
    assert len(track.times) == len(frame) == np.maximum(data.count, 1).sum()
    np.testing.assert_array_equal(track.times, np.repeat(data.times, np.maximum(data.count, 1)))
    full = np.isfinite(track.measurements).all(axis=1)
    np.testing.assert_array_equal(track.measurements[full], data.measurements[data.origin != PADDING])
    assert (~full).sum() == (data.count == 0).sum()
    np.testing.assert_allclose(track.noise[full], np.diag([400.0, 1e-4])[None].repeat(full.sum(), axis=0))
    np.testing.assert_array_equal(track.sensor_states[:, :2], np.tile([100.0, -50.0], (len(frame), 1)))
    origin = frame["origin"].to_numpy(dtype=float, na_value=np.nan)
    np.testing.assert_array_equal(np.isfinite(track.truth[:, 0]), origin >= 0)
    np.testing.assert_array_equal(np.isnan(origin), ~full)


def test_truth_frame_holds_each_target_once_per_time(tmp_path):
    data = simulate_scene(get_scene("births-v0"), 2)
    frame = data.truth_frame()
    file = tmp_path / "truth.csv"
    frame.to_csv(file, index=False)
    tracks = read_tracks(file)
    assert tracks.ids == tuple(f"target-{n}" for n in range(5))
    np.testing.assert_array_equal(tracks.lengths, data.truth.alive.sum(axis=1))
    np.testing.assert_array_equal(tracks.measurements[1, :51], data.truth.position[1, :51])


def test_own_detections_as_tracks():
    data = simulate_scene(get_scene("births-v0"), 2)
    tracks = data.to_tracks()
    np.testing.assert_array_equal(tracks.lengths, data.truth.alive.sum(axis=1))
    assert np.isfinite(tracks.measurements[..., 0]).sum() == (data.origin >= 0).sum()
    sensor = data.scene.sensors[0].model
    for track in tracks:
        offset = track.truth - track.sensor_states[:, :2]
        error = track.measurements - np.column_stack([np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0])])
        unit = error[np.isfinite(error[:, 0])] / np.sqrt(np.diag(sensor.noise))
        assert np.abs(unit).max() < 5


def test_mixed_sensors_are_written_one_kind_at_a_time():
    box = SceneSensor("position", (5.0, 5.0), Box((-9e3, -9e3), (9e3, 9e3)), period=3.0)
    data = simulate_scene(replace(LONG, duration=30.0, sensors=(RADAR, box)), 1)
    with pytest.raises(ValueError, match="kind must be one of range-bearing, position"):
        data.to_frame()
    assert list(data.to_frame("position").columns[:4]) == ["t", "sensor", "x", "y"]
    assert len(data.to_frame("position")) == 11
    assert len(data.to_tracks("position").times[0]) == 11


# --- the library ---


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_of_the_library(name):
    scene = SCENES[name]
    data = simulate_scene(scene, 0)
    assert scene.id == name
    assert scene.title
    assert scene.source
    for k in range(len(data)):
        there = data.truth.alive[:, k]
        assert scene.sensors[data.sensor[k]].watches(data.truth.position[there, k]).all(), "a target leaves the region"
    pd.testing.assert_frame_equal(data.to_frame(), simulate_scene(scene, 0).to_frame())


def test_crossing_targets_meet_and_the_formation_splits():
    data = simulate_scene(get_scene("crossing-v0"), 0)
    apart = np.linalg.norm(data.truth.position[0] - data.truth.position[1], axis=1)
    assert apart[40] < 1e-9
    assert apart[[0, 80]] == pytest.approx(2 * 2000 * np.sin(np.deg2rad(20)))
    data = simulate_scene(get_scene("formation-split-v0"), 0)
    apart = np.linalg.norm(data.truth.position[0] - data.truth.position[2], axis=1)
    np.testing.assert_allclose(apart[:31], 120.0)
    course = np.arctan2(data.truth.velocity[:, -1, 1], data.truth.velocity[:, -1, 0])
    np.testing.assert_allclose(np.rad2deg(course), [-30.0, 0.0, 30.0], atol=1e-9)
    assert [switches.tolist() for switches in data.truth.switch_times] == [[30.0, 40.0], [], [30.0, 40.0]]


def test_published_three_targets():
    scene = get_scene("three-targets-v0")
    data = simulate_scene(scene, 1)
    (radar,) = scene.sensors
    assert (len(data), radar.detection, radar.place, radar.period) == (100, 0.8, (-7000.0, 0.0), 5.0)
    np.testing.assert_allclose(data.noise[0], np.diag([100.0, np.deg2rad(0.2) ** 2]))
    np.testing.assert_allclose(radar.clutter_density(np.array([10e3, 0.0])).measurement, 1e-4)
    assert radar.clutter == pytest.approx(24.504, abs=1e-3)
    # Check points of the air-traffic example; the second target is the first one at x -> 6500 - x.
    first, second, third = data.truth.position
    for k, place in ((25, (10e3, 10e3)), (43, (3124.506, 3124.506)), (68, (3124.506, -11875.494))):
        np.testing.assert_allclose(first[k], place, atol=6e-4)
    np.testing.assert_allclose(second, first * [-1, 1] + [6500, 0], atol=1e-8)
    np.testing.assert_allclose(third[0], [2874.50645843013, 28924.50645843013])
    np.testing.assert_allclose(third[99] - third[0], [0, -120 * 495], atol=1e-8)


def test_published_paths_equal_the_recorded_ones(data_dir):
    data = simulate_scene(get_scene("three-targets-v0"), 1)
    for target in range(3):
        file = data_dir / "published_scenarios" / f"atc_blk_target{target + 1}.csv"
        if not file.exists():
            pytest.skip(f"{file.name} is not among the recorded tracks")
        with file.open(newline="") as stream:
            rows = [[float(row[key]) for key in ("time", "x", "y", "vx", "vy")] for row in csv.DictReader(stream)]
        state = np.column_stack([data.times, data.truth.position[target], data.truth.velocity[target]])
        # The files carry six decimals.
        np.testing.assert_allclose(state, np.array(rows), atol=1e-6)


def start_states(target, rows, times):
    """States (rows, T, 4) x, y, vx, vy of a target of the library in the frame of the scene."""
    clock = np.tile(np.asarray(times, dtype=float), (rows, 1))
    draws = draw([np.random.default_rng(seed) for seed in range(rows)], target.motion.need(len(times), times[-1]))
    flown = target.motion.simulate(clock, draws)
    return np.concatenate([target.put(flown.position, True), target.put(flown.velocity, False)], axis=-1)


def test_consensus_scene_has_the_published_parameters():
    scene = get_scene("consensus-network-v0")
    data = simulate_scene(scene, 0)
    np.testing.assert_array_equal(data.times, np.repeat(2.0 * np.arange(50), 10))
    np.testing.assert_array_equal(data.count, 1)
    np.testing.assert_array_equal(data.noise, np.tile(1e4 * np.eye(2), (500, 1, 1)))
    assert scene.network == consensus_network()
    np.testing.assert_array_equal(data.places[:10], np.array(scene.network.positions)[list(CONSENSUS_SENSING)])
    error = data.measurements[:, 0] - data.truth.position[0]
    assert error.std() == pytest.approx(100.0, rel=0.1)
    # All sensors of one time see one target, and their errors are not the same.
    assert (np.ptp(data.truth.position[0].reshape(50, 10, 2), axis=1) == 0).all()
    assert (np.ptp(error.reshape(50, 10, 2), axis=1) > 10).all()
    states = start_states(scene.targets[0], 8000, [0.0, 2.0])
    first = states[:, 0]
    # 8000 starts: means to 1.1 %, deviations to 0.8 %, correlations to 0.011 (one sd).
    np.testing.assert_allclose(first.mean(axis=0), [2000.0, 4000.0, 15.0, 5.0], atol=4 * 1500 / np.sqrt(8000))
    np.testing.assert_allclose(first[:, 2:].mean(axis=0), [15.0, 5.0], atol=4 * 2 / np.sqrt(8000))
    np.testing.assert_allclose(first.std(axis=0), [1500.0, 1500.0, 2.0, 2.0], rtol=0.035)
    correlation = np.corrcoef(first.T)
    assert correlation[0, 1] == pytest.approx(0.6, abs=0.035)
    assert np.abs(correlation[2:, :2]).max() < 0.05
    assert abs(correlation[2, 3]) < 0.05
    # One step: w = (position less drift, velocity less velocity) has Q = 16 [T^3/3, T^2/2; T^2/2, T] on each axis.
    w = states[:, 1] - np.concatenate([first[:, :2] + 2 * first[:, 2:], first[:, 2:]], axis=1)
    wanted = 16 * np.kron([[8 / 3, 2.0], [2.0, 2.0]], np.eye(2))
    np.testing.assert_allclose(np.cov(w.T), wanted, atol=0.06 * wanted.max())


def test_manoeuvring_targets_meet_and_change_their_minds():
    scene = get_scene("manoeuvring-crossing-v0")
    data = simulate_scene(scene, 4)
    middle = np.linalg.norm(data.truth.position[:, 20:45] - [0.0, 10_000.0], axis=-1).min(axis=1)
    assert (middle < 1000.0).all()
    speed = np.linalg.norm(data.truth.velocity, axis=-1)
    assert (speed >= 40.0 - 1e-9).all()
    assert (speed <= 60.0 + 1e-9).all()
    for target in range(3):
        switches = data.truth.switch_times[target]
        assert len(switches) >= 2
        changed = np.flatnonzero(np.diff(data.truth.intent[target])) + 1
        for k in changed:
            assert ((switches > data.times[k - 1]) & (switches <= data.times[k])).any()
    # A continuous-time motion does not depend on when it is looked at.
    later = replace(scene, sensors=tuple(replace(s, period=4.0) for s in scene.sensors))
    seldom = simulate_scene(later, 4)
    common = np.isin(data.times, seldom.times)
    np.testing.assert_array_equal(data.truth.position[:, common], seldom.truth.position)


# --- networks ---


def test_metropolis_of_the_path_of_three():
    weights = metropolis_weights(line(3))
    np.testing.assert_allclose(weights, [[2 / 3, 1 / 3, 0], [1 / 3, 1 / 3, 1 / 3], [0, 1 / 3, 2 / 3]])
    np.testing.assert_allclose(np.sort(np.linalg.eigvalsh(weights)), [0, 2 / 3, 1], atol=1e-12)
    reached = weights @ [1.0, 0.0, 1.0]
    np.testing.assert_allclose(1 / reached, 1.5)


@pytest.mark.parametrize(("nodes", "value"), [(3, 0.0), (5, 0.539345), (10, 0.872678)])
def test_second_eigenvalue_of_rings(nodes, value):
    assert second_eigenvalue(metropolis_weights(ring(nodes))) == pytest.approx(value, abs=5e-7)


def test_complete_network_agrees_at_once():
    np.testing.assert_allclose(metropolis_weights(complete(4)), 0.25)
    assert second_eigenvalue(metropolis_weights(complete(4))) == pytest.approx(0.0, abs=1e-12)
    assert second_eigenvalue([[1.0]]) == 0.0


@pytest.mark.parametrize("network", [line(7), ring(6), complete(5), geometric(15, 400.0, 1000.0, seed=2)])
def test_metropolis_weights_average(network):
    weights = check_weights(metropolis_weights(network), network)
    np.testing.assert_allclose(weights, weights.T)
    values = np.random.default_rng(0).standard_normal(len(network))
    mixed = np.linalg.matrix_power(weights, 2000) @ values
    np.testing.assert_allclose(mixed, values.mean(), atol=1e-9)


def test_consensus_network_has_the_published_parameters():
    network = consensus_network()
    assert len(network) == 50
    assert [node + 1 for node in network.sensing] == [2, 9, 11, 16, 20, 27, 28, 36, 38, 42]
    assert network.sensing == CONSENSUS_SENSING
    weights = check_weights(metropolis_weights(network), network)
    # Disagreement after L exchanges goes with its L-th power: 1e-4 here is 0.2 % of it after 20.
    assert second_eigenvalue(weights) == pytest.approx(0.98349, abs=1e-4)
    assert network == consensus_network()


def test_geometric_links_are_those_within_reach():
    network = geometric(30, 300.0, 1000.0, seed=3, sensing=[4, 1])
    places = np.array(network.positions)
    near = np.linalg.norm(places[:, None] - places, axis=-1) <= 300.0
    np.testing.assert_array_equal(network.adjacency, near & ~np.eye(30, dtype=bool))
    assert network.sensing == (1, 4)
    assert network == geometric(30, 300.0, 1000.0, seed=3, sensing=[1, 4])
    assert network.positions != geometric(30, 300.0, 1000.0, seed=4).positions
    assert network.graph().nodes[4] == {"pos": network.positions[4], "sensing": True}


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        (np.ones((2, 3)), r"shape \(N, N\)"),
        ([[0.5, 0.4], [0.5, 0.5]], "rows that sum to 1; got row 0 with sum 0.9"),
        ([[1.5, -0.5], [0.5, 0.5]], "smallest entry -0.5"),
        (np.eye(2), "must be primitive"),
        ([[0.0, 1.0], [1.0, 0.0]], "must be primitive"),
        ([[1.0, 0.0], [0.5, 0.5]], "must be primitive"),
        (np.full((3, 3), 1 / 3), "zero between nodes without a link; got a weight from 2 to 0"),
        (np.full((2, 2), 1 / 2), r"shape \(3, 3\)"),
    ],
)
def test_bad_weights_are_refused(weights, words):
    with pytest.raises(ValueError, match=words):
        check_weights(weights, line(3))


def test_wielandt_bound_is_met():
    """The slowest primitive pattern, a ring with one chord, has its last zero at the power before the bound."""
    N = 7
    pattern = np.roll(np.eye(N), 1, axis=1)
    pattern[N - 1, 1] = 1
    check_weights(pattern / pattern.sum(axis=1, keepdims=True))
    assert (np.linalg.matrix_power(pattern, N * N - 2 * N + 1) == 0).any()
    assert (np.linalg.matrix_power(pattern, N * N - 2 * N + 2) > 0).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Network(((0.0, 0.0), (1.0, 0.0)), (), (0,)), "must connect all 2 nodes; got 2 parts"),
        (lambda: Network(((0.0, 0.0), (1.0, 0.0)), ((0, 2),), (0,)), r"links must name nodes 0..1; got \[\[0, 2\]\]"),
        (lambda: Network(((0.0, 0.0), (1.0, 0.0)), ((0, 1), (1, 1)), (0,)), "must join different nodes"),
        (lambda: Network(((0.0, 0.0), (1.0, 0.0)), ((0, 1),), ()), "sensing must name at least one node"),
        (lambda: Network(((0.0,), (1.0,)), ((0, 1),), (0,)), r"got shape \(2, 1\)"),
        (lambda: ring(2), "ring: nodes must be an integer >= 3; got 2"),
        (lambda: geometric(20, 1.0, 1000.0, seed=0), "reach must connect 20 nodes"),
        (lambda: geometric(20, -1.0, 1000.0, seed=0), "reach must be finite and > 0"),
    ],
)
def test_bad_networks_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: replace(RADAR, kind="sonar"), "kind must be one of range-bearing, position; got 'sonar'"),
        (lambda: replace(RADAR, clutter_space="sky"), "clutter_space must be one of measurement, plane"),
        (lambda: replace(RADAR, period=0.0), "period must be finite and > 0"),
        (lambda: replace(RADAR, offset=-1.0), "offset must be finite and >= 0"),
        (lambda: replace(RADAR, detection=1.1), "detection must be a probability; got 1.1"),
        (lambda: replace(RADAR, clutter=np.nan), "clutter must be finite and >= 0"),
        (lambda: replace(RADAR, sigma=(1.0,)), "sigma must have 2 entries"),
        (lambda: replace(RADAR, sigma=(1.0, 0.0)), "sigma must"),
        (lambda: replace(RADAR, place=(0.0, 0.0, 0.0)), "place must be 2 finite coordinates"),
        (lambda: replace(RADAR, region=Box((0.0, 0.0), (1.0, 1.0))), "region must be a Sector"),
        (lambda: Sector(1.0, 2.0), "0 <= range_min < range_max"),
        (lambda: Sector(2.0, width=7.0), "width must lie in"),
        (lambda: Box((0.0, 0.0), (1.0, 0.0)), "low < high"),
        (lambda: SceneTarget(STILL, birth=3.0, death=3.0), "0 <= birth < death"),
        (lambda: SceneTarget(STILL, place=(1.0,)), "place must be 2 finite coordinates"),
        (lambda: Path((0.0, 0.0), (0.0, np.inf)), "two finite numbers"),
        (lambda: replace(LONG, id="long"), "Use name-v0"),
        (lambda: replace(LONG, targets=()), "must not be empty"),
        (lambda: replace(LONG, sensors=(replace(RADAR, offset=1e5),)), "sensors must scan within 9999 s"),
        (lambda: replace(LONG, network=line(3, sensing=[0])), "must stand at the network's sensing nodes"),
        (lambda: simulate_scene(LONG, -1), "seed must be an integer >= 0; got -1"),
        (lambda: get_scene("crossing"), "Did you mean 'crossing-v0'"),
    ],
)
def test_bad_scenes_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
