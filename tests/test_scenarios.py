"""Scenarios: what is measured is what was said, streams do not mix, and the published cases are the published ones."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
from gymnasium.utils import seeding
from scipy import stats

from jink.envs.scenarios import SCENARIOS, SUITES, make_scenario
from jink.envs.sensing import Platform, Sensing
from jink.envs.simulate import simulate_tracks
from jink.envs.streams import make_streams
from jink.envs.surges import BiasDrift, Dropouts, MarkovBursts
from jink.envs.truth import Truth
from jink.estimators.sensors import SENSORS, make_sensor

EVERY = list(SCENARIOS)


def streams(count, seed=0):
    return [make_streams(seeding.np_random(seed + b)[0]) for b in range(count)]


def simulated(name, count=4, seed=0, **overrides):
    return make_scenario(name, **overrides).simulate(streams(count, seed))


def arrays(episodes):
    for field in episodes._fields:
        value = getattr(episodes, field)
        yield from value if isinstance(value, Truth) else (value,)


def same(one, other):
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(arrays(one), arrays(other), strict=True))


def errors(scenario, episodes):
    """Measurement error without its bias over its standard deviation, from the sensor's own formula in Python."""
    kin = np.concatenate([episodes.truth.position, episodes.truth.velocity], axis=2)
    sensor = scenario.sensor
    params, expected = np.array(sensor.params or (0.0,)), np.empty_like(episodes.measurements)
    for b, k in np.ndindex(kin.shape[:2]):
        sensor.observe(kin[b, k], episodes.sensor_states[b, k], params, expected[b, k])
    error = episodes.measurements - expected - episodes.bias
    turns = np.where(sensor.angular, 2 * np.pi, np.inf)
    error -= np.where(sensor.angular, np.round(error / turns) * 2 * np.pi, 0.0)
    return error / np.sqrt(np.diagonal(episodes.noise, axis1=2, axis2=3))


@pytest.mark.parametrize("name", EVERY)
def test_every_scenario_simulates(name):
    scenario = make_scenario(name, steps=120)
    episodes = scenario.simulate(streams(4))
    B, T, D, A = 4, scenario.steps, scenario.sensor.size, scenario.axes
    for truth in (episodes.truth, episodes.delivered):
        assert truth.position.shape == truth.velocity.shape == truth.acceleration.shape == (B, T, A)
        assert np.isfinite(np.stack([truth.position, truth.velocity, truth.acceleration])).all()
        assert np.abs(truth.position).max() <= scenario.extent
        assert set(np.unique(truth.intent)) <= set(range(len(scenario.intents)))
    assert episodes.measurements.shape == episodes.bias.shape == (B, T, D)
    assert episodes.noise.shape == (B, T, D, D)
    assert episodes.sensor_states.shape == (B, T, 2 * A)
    assert episodes.prior_mean.shape == (B, 2 * A)
    np.testing.assert_array_equal(episodes.detected, ~np.isnan(episodes.measurements).all(2))
    np.testing.assert_array_equal(episodes.nominal_noise, scenario.sensor.noise)
    # The factor is the only thing that scales R; rounding of one product apart.
    np.testing.assert_allclose(episodes.noise, episodes.scale[..., None, None] * episodes.nominal_noise, rtol=1e-15)
    angles = episodes.measurements[..., np.array(scenario.sensor.angular)]
    assert np.nanmax(np.abs(angles), initial=0.0) <= np.pi
    for array in arrays(episodes):
        assert array.flags.c_contiguous


@pytest.mark.parametrize("name", EVERY)
def test_errors_whitened_by_what_the_oracle_knows_are_standard_normal(name):
    scenario = make_scenario(name)
    error = errors(scenario, scenario.simulate(streams(3, 50)))
    error = error[np.isfinite(error)]
    # Angles under the largest surges wrap: fewer than one in a thousand.
    assert stats.kstest(error, "norm").pvalue > 1e-4
    assert abs(error.mean()) < 5 / np.sqrt(error.size)
    assert abs(error.var() - 1) < 5 * np.sqrt(2 / error.size)


@pytest.mark.parametrize("name", SENSORS)
def test_every_sensor_of_the_core_can_be_simulated(name):
    sensor = make_sensor(name, **({"anchors": [[0.0, 0.0], [500.0, 0.0], [0.0, 400.0]]} if name == "ranges" else {}))
    A = sensor.axes
    places = (((-3000.0, -2000.0, -100.0)[:A]), ((2500.0, -4000.0, 50.0)[:A]))
    scenario = make_scenario("surge-v0" if A == 2 else "air-joint-v0").replace(
        sensing=Sensing(sensor, Platform(places, (3.0, -4.0, 0.5)[:A], weave=20.0), 0.9, 0.1)
    )
    episodes = scenario.simulate(streams(3))
    error = errors(scenario, episodes)
    error = error[np.isfinite(error)]
    assert abs(error.var() - 1) < 5 * np.sqrt(2 / error.size)
    assert stats.kstest(error, "norm").pvalue > 1e-4


def test_bearings_wrap_where_the_circle_closes():
    episodes = simulated("surge-v0", sensor="range-bearing", sigma=(1.0, 0.02), places=((5000.0, 0.0),), surges=())
    angles = episodes.measurements[..., 1]  # the target is due west
    assert np.abs(angles).max() <= np.pi
    assert 0.1 < (angles > 0).mean() < 0.9
    assert np.abs(angles).min() > 2.5


def test_platforms_take_turns_and_move_as_said():
    times = np.array([[0.0, 10.0, 20.0, 30.0]])
    two = Platform(((0.0, 0.0), (100.0, 50.0)), (3.0, 4.0)).states(times, 2)[0]
    np.testing.assert_allclose(two, [[0, 0, 3, 4], [130, 90, 3, 4], [60, 80, 3, 4], [190, 170, 3, 4]])
    fine = np.arange(0.0, 80.0, 0.01)[None]
    weaving = Platform(((7.0, -5.0),), (3.0, 4.0), weave=10.0, period=40.0).states(fine, 2)[0]
    # A quarter of a period in, the ship is a whole amplitude to the left of its course.
    np.testing.assert_allclose(weaving[1000, :2], [37.0 - 8.0, 35.0 + 6.0])
    slope = np.gradient(weaving[:, :2], 0.01, axis=0)
    np.testing.assert_allclose(slope[1:-1], weaving[1:-1, 2:], atol=1e-5)  # central differences


@pytest.mark.parametrize("name", ["joint-v0", "surge-v0", "switch-irregular-v0", "radar-joint-v0", "heavy-tail-t3-v0"])
def test_same_seed_same_bits_and_batches_are_singles(name):
    batch = simulated(name, 5)
    assert same(batch, simulated(name, 5))
    other = simulated(name, 5, seed=100)
    assert not np.array_equal(batch.truth.position, other.truth.position)
    assert not np.array_equal(batch.measurements, other.measurements, equal_nan=True)
    for b in (0, 3):
        single = simulated(name, 1, seed=b)
        for field, many in zip(batch._fields, batch, strict=True):
            one = getattr(single, field)
            if field in ("truth", "delivered"):
                for of_one, of_many in zip(one, many, strict=True):
                    np.testing.assert_array_equal(of_one[0], of_many[b])
            elif field not in ("nominal_noise", "prior_cov"):
                np.testing.assert_array_equal(one[0], many[b])


def three_in_a_row(scenario):
    rows = streams(3)
    return [scenario.simulate(rows) for _ in range(3)]


@pytest.mark.parametrize("name", ["joint-v0", "surge-v0", "switch-irregular-v0"])
@pytest.mark.parametrize(
    "change",
    [
        {"sigma": 5.0},
        {"sensor": "range-bearing"},
        {"detection_probability": 0.5, "component_loss": 0.2},
        {"surges": ()},
        {"surges": (BiasDrift(), Dropouts(), MarkovBursts(0.1, 0.1))},
        {"start_sigma": (50.0, 9.0)},
        {"places": ((100.0, 100.0),)},
    ],
)
def test_neither_sensor_nor_surge_moves_a_trajectory_now_or_later(name, change):
    before = make_scenario(name)
    for one, other in zip(three_in_a_row(before), three_in_a_row(before.replace(**change)), strict=True):
        np.testing.assert_array_equal(one.times, other.times)
        for field in Truth._fields:
            np.testing.assert_array_equal(getattr(one.truth, field), getattr(other.truth, field))


def test_a_bias_is_so_many_nominal_deviations_and_part_of_the_measurement():
    fine, coarse = (simulated("surge-v0", surges=[BiasDrift()], sigma=sigma) for sigma in (1.0, (3.0, 7.0)))
    np.testing.assert_allclose(coarse.bias, fine.bias * [3.0, 7.0], rtol=1e-12)
    assert np.abs(fine.bias).max() > 1
    errors_of = [(e.measurements - e.truth.position) / np.sqrt(np.diag(e.nominal_noise)) for e in (fine, coarse)]
    np.testing.assert_allclose(*errors_of, atol=1e-9)
    plain = simulated("surge-v0", surges=())
    np.testing.assert_allclose(fine.measurements - plain.measurements, fine.bias, atol=1e-9)


def test_dropouts_leave_nothing_to_measure():
    none = simulated("surge-v0", surges=[Dropouts(1e6, 1e-3)])
    assert not none.detected.any()
    assert np.isnan(none.measurements).all()
    some = simulated("surge-v0", 40, surges=[Dropouts((1.0, 1.0), (1.0, 1.0))], detection_probability=0.8)
    # Half of the time dropped in whole periods, then one look in five missed; 12 000 looks in 1200 dropouts.
    assert abs(some.detected.mean() - 0.4) < 0.02


def test_surges_do_not_move_the_sensors_own_draws():
    loud, quiet = simulated("joint-v0"), simulated("joint-v0", surges=())
    np.testing.assert_array_equal(loud.prior_mean, quiet.prior_mean)
    white = [(e.measurements - e.truth.position) / np.sqrt(e.scale)[..., None] for e in (loud, quiet)]
    np.testing.assert_allclose(*white, atol=1e-9)


def test_missed_detections_do_not_change_the_noise_of_the_others():
    all_seen, some = simulated("surge-v0"), simulated("surge-v0", detection_probability=0.7)
    np.testing.assert_array_equal(some.measurements[some.detected], all_seen.measurements[some.detected])


@pytest.mark.parametrize("latency", [0.3, 0.05, 0.77])
def test_late_measurements_leave_a_manoeuvre_as_it_is_and_are_on_its_path(latency):
    prompt, late = (three_in_a_row(make_scenario("joint-v0", latency=value)) for value in (0.0, latency))
    for one, other in zip(prompt, late, strict=True):
        assert one.delivered is one.truth
        np.testing.assert_array_equal(one.truth.position, other.truth.position)
        np.testing.assert_array_equal(one.measurements, other.measurements)
        switches = [np.nan_to_num(late.switch_times, nan=-1.0) for late in (one.truth, other.truth, other.delivered)]
        np.testing.assert_array_equal(switches[0], switches[1])
        assert (switches[2].max(1) <= one.times[:, -1] + latency).all()
        assert (switches[2] >= switches[1]).all()
        moved = other.delivered.position - other.truth.position - latency * other.truth.velocity
        largest = np.abs(other.truth.acceleration).max() + np.abs(other.delivered.acceleration).max()
        assert np.abs(moved).max() <= latency**2 / 2 * largest
    if latency == 0.3:
        np.testing.assert_allclose(other.delivered.position[:, :-3], other.truth.position[:, 3:], atol=1e-9)
        np.testing.assert_array_equal(other.delivered.intent[:, :-3], other.truth.intent[:, 3:])


def test_deliveries_are_late_by_the_latency():
    late = simulated("switch-irregular-v0")
    np.testing.assert_allclose(late.delivery_times - late.times, 0.25, rtol=0, atol=1e-10)  # a tick is 15 ps
    at_once = simulated("switch-v0")
    np.testing.assert_array_equal(at_once.delivery_times, at_once.times)


def test_a_stochastic_plant_has_one_path_for_samples_and_deliveries():
    late = simulated("surge-v0", 8, latency=0.3)
    np.testing.assert_allclose(late.delivered.position[:, :-3], late.truth.position[:, 3:], atol=1e-9)
    half = simulated("surge-v0", 400, latency=0.05)
    step = half.delivered.velocity - half.truth.velocity
    # White acceleration of 1 m^2/s^3 for 0.05 s; 400 x 300 x 2 values.
    assert abs((step**2).mean() / 0.05 - 1) < 0.02


def test_priors_are_drawn_around_the_truth():
    scenario = make_scenario("surge-v0", steps=100, start_sigma=(3.0, 0.5))
    episodes = scenario.simulate(streams(1500))
    start = np.concatenate([episodes.truth.position[:, 0], episodes.truth.velocity[:, 0]], axis=1)
    white = (episodes.prior_mean - start) / [3.0, 3.0, 0.5, 0.5]
    np.testing.assert_array_equal(np.diag(episodes.prior_cov), [9.0, 9.0, 0.25, 0.25])
    assert abs(white.var() - 1) < 5 * np.sqrt(2 / white.size)
    assert stats.kstest(white.ravel(), "norm").pvalue > 1e-4
    first = episodes.measurements[:, 0] - episodes.truth.position[:, 0]
    for axis in range(2):  # the prior knows nothing of the first measurement
        assert abs(np.corrcoef(white[:, axis], first[:, axis] / np.sqrt(episodes.scale[:, 0]))[0, 1]) < 5 / np.sqrt(
            1500
        )


def test_when_a_target_is_looked_at_does_not_move_it():
    regular = make_scenario("joint-v0")
    for one, other in zip(three_in_a_row(regular), three_in_a_row(regular.replace(sampling="jittered")), strict=True):
        np.testing.assert_array_equal(one.truth.position[:, 0], other.truth.position[:, 0])
        assert (one.times[:, 100] != other.times[:, 100]).all()
        assert np.abs(one.truth.position[:, 100] - other.truth.position[:, 100]).max() < 0.05 * 30.0  # s, m/s
    # Longer episodes draw more legs, so only the first is the same.
    one, other = regular.simulate(streams(3)), regular.replace(sampling="irregular").simulate(streams(3))
    np.testing.assert_array_equal(one.truth.position[:, 0], other.truth.position[:, 0])


def test_tracks_are_the_first_episodes_of_the_environments():
    scenario = make_scenario("joint-v0", detection_probability=0.9)
    tracks = simulate_tracks(scenario, 4, seed=20)
    assert tracks.ids == ("20", "21", "22", "23")
    for i in range(4):
        episode = scenario.simulate([make_streams(seeding.np_random(20 + i)[0])])
        np.testing.assert_array_equal(tracks.measurements[i], episode.measurements[0])
        np.testing.assert_array_equal(tracks.truth[i], episode.truth.position[0])
        np.testing.assert_array_equal(tracks.noise[i, 7], episode.nominal_noise)
        assert tracks.intents[i, 50] == scenario.intents[episode.truth.intent[0, 50]]
    with pytest.raises(ValueError, match="simulate_tracks: count must be an integer >= 1; got 0"):
        simulate_tracks(scenario, 0, seed=0)


# The published values are means over 40 runs, whose standard errors are below (from 2000 runs of our own).
TABLE = {
    "surge-25-bursts-v0": ((1.50, 0.028), (1.10, 0.029)),
    "surge-400-bursts-v0": ((5.46, 0.118), (1.98, 0.098)),
    "surge-100-outliers-v0": ((1.98, 0.039), (0.70, 0.008)),
    "surge-10000-outliers-v0": ((13.1, 0.40), (0.69, 0.008)),
}


def kalman_rms(episodes, noise, q=1.0):
    m, P = episodes.prior_mean.reshape(-1, 2, 2), np.broadcast_to(np.eye(2), (len(noise), 2, 2))
    squared = []
    for k in range(noise.shape[1]):
        if k:
            dt = episodes.times[0, k] - episodes.times[0, k - 1]
            F = np.array([[1.0, dt], [0.0, 1.0]])
            m, P = F @ m, F @ P @ F.T + q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        K = P[:, :, :1] / (P[:, :1, :1] + noise[:, k, None, None])
        m = m + K * (episodes.measurements[:, k] - m[:, 0])[:, None]
        P = P - K * P[:, :1]
        squared.append(((m[:, 0] - episodes.truth.position[:, k]) ** 2).sum(1))
    return np.sqrt(np.mean(squared))


@pytest.mark.parametrize("name", TABLE)
def test_the_published_cases_give_the_published_numbers(name):
    episodes = simulated(name, 500)
    for noise, (published, error) in zip((np.ones_like(episodes.scale), episodes.scale), TABLE[name], strict=True):
        # Three errors of theirs; ours are a third of that with 500 runs.
        assert abs(kalman_rms(episodes, noise) - published) < 3 * error


def test_random_surges_are_the_published_generator():
    surge = make_scenario("surge-v0").surges[0]
    assert (surge.on, surge.off, surge.scale) == ((0.5, 5.0), (0.5, 5.0), (4.0, 1e4))


def test_suites_hold_every_scenario_once():
    assert {"switch", "surge", "joint", "heavy-tail", "model-error"} <= set(SUITES)
    assert sorted(name for names in SUITES.values() for name in names) == sorted(SCENARIOS)
    for suite in ("switch", "surge", "joint", "heavy-tail", "model-error"):
        alike = {
            (s.steps, s.axes, s.sensor.name, s.sensor.sigma, s.start_sigma)
            for s in (SCENARIOS[name] for name in SUITES[suite])
        }
        assert len(alike) == 1  # so that one environment can mix them


def test_parameters_are_replaced_by_plain_and_dotted_names():
    scenario = make_scenario(
        "joint-v0",
        steps=250,
        sigma=2.0,
        detection_probability=0.9,
        latency=0.1,
        **{"surges.0.on": [1.0, 2.0], "motion.limits.speed": (1.0, 25.0), "behaviours.1.rate": (0.1, 0.2)},
    )
    assert scenario.steps == 250
    assert scenario.sensor.sigma == (2.0, 2.0)
    assert (scenario.sensing.detection_probability, scenario.sensing.latency) == (0.9, 0.1)
    assert scenario.surges[0].on == (1.0, 2.0)
    assert scenario.motion.limits.speed == (1.0, 25.0)
    assert scenario.motion.behaviours[1].rate == (0.1, 0.2)
    assert scenario.parameters["surges.0.on"] == (1.0, 2.0)
    assert scenario.parameters["surges.0"] == "MarkovBursts"
    assert make_scenario("joint-v0").steps == 300
    both = make_scenario("joint-v0", sensor="range-bearing", sigma=(5.0, 0.01)).sensor
    assert (both.name, both.sigma) == ("range-bearing", (5.0, 0.01))
    assert make_scenario("air-switch-v0", sensor="position").sensor.axes == 3
    assert make_scenario("surge-glint-v0", width=8.0, **{"surges.0.period": 9.0}).surges[0].width == 8.0
    biased = make_scenario("surge-bias-v0", sigma=3.0)
    assert (biased.sensor.sigma, biased.surges[0].sigma) == ((3.0, 3.0), 1.0)
    named = make_scenario("joint-v0", sampling="irregular", surges=["glint", BiasDrift()], steps=np.int64(80))
    assert (type(named.sampling).__name__, named.sampling.steps, named.sampling.dt) == ("Irregular", 80, 0.1)
    assert [type(surge).__name__ for surge in named.surges] == ["Glint", "BiasDrift"]
    with pytest.raises(dataclasses.FrozenInstanceError):
        scenario.id = "x-v1"


@pytest.mark.parametrize(
    ("name", "overrides", "message"),
    [
        ("joint", {}, "make_scenario: name must be a known scenario; got 'joint'. Did you mean joint-v0?"),
        (
            "joint-v0",
            {"stpes": 3},
            "joint-v0: stpes must be a parameter; got no such name. Did you mean steps? There are",
        ),
        ("joint-v0", {"surges.1.on": 3.0}, "Did you mean surges.0.on?"),
        ("joint-v0", {"dwell": 3.0}, "joint-v0: dwell must name one parameter; got several: motion.behaviours.0.dwell"),
        ("surge-glint-v0", {"period": 3.0}, "got several: sensing.platform.period, surges.0.period. Write the whole"),
        ("joint-v0", {"on": 3.0, "surges.0.on": 2.0}, "surges.0.on must be given once"),
        ("joint-v0", {"on": -3.0}, "MarkovBursts: on must be"),
        ("joint-v0", {"sigma": (1.0, 2.0, 3.0)}, "position: sigma must be"),
        ("joint-v0", {"sensor": "range_bering"}, "make_sensor: name must be a known sensor"),
        ("joint-v0", {"sensor": "range-bearing-elevation"}, "joint-v0: sensing must have the motion's 2 axes"),
        ("joint-v0", {"surges": "bursst"}, "make_surge: name must be a known surge; got 'bursst'. Use one of bursts"),
        ("joint-v0", {"sampling": "often"}, "make_sampling: name must be one of regular"),
        ("joint-v0", {"places": ((0.0, 0.0, 0.0),)}, "Sensing: platform must have the sensor's 2 axes; got 3"),
        ("joint-v0", {"places": "here"}, "Platform: places and velocity must be finite"),
        ("joint-v0", {"velocity": (1.0, np.nan)}, "Platform: places and velocity must be finite"),
        ("joint-v0", {"sensing": None}, "joint-v0: sensing must have a method look; got None"),
        ("joint-v0", {"surges": [3.0]}, "joint-v0: surges.0 must have a method apply; got 3.0"),
        ("joint-v0", {"start_sigma": 2.0}, "joint-v0: start_sigma must hold two numbers"),
        (
            "joint-v0",
            {"detection_probability": "often"},
            "Sensing: detection_probability must be in [0, 1]; got 'often'",
        ),
        ("joint-v0", {"id": "Joint"}, "Scenario: id must be lower case"),
        ("joint-v0", {"start_sigma": (1.0,)}, "joint-v0: start_sigma must hold two numbers"),
        ("joint-v0", {"filter_noise": 0.0}, "joint-v0: filter_noise must be > 0"),
        ("surge-25-bursts-v0", {"steps": 50}, "PlacedBursts: lengths must fit"),
    ],
)
def test_bad_names_and_values_are_refused_in_one_sentence(name, overrides, message):
    with pytest.raises(ValueError) as caught:
        make_scenario(name, **overrides)
    assert message in str(caught.value)


def test_a_scenario_survives_pickling():
    scenario = make_scenario("radar-joint-v0", steps=50)
    copy = pickle.loads(pickle.dumps(scenario))
    assert same(scenario.simulate(streams(2)), copy.simulate(streams(2)))


def test_streams_advance_by_the_same_amount_every_time():
    scenario, rows = make_scenario("switch-irregular-v0"), streams(2)
    scenario.simulate(rows)
    for index, generator in enumerate(rows[0]):
        reference = streams(1)[0]
        scenario.simulate([reference])
        assert generator.random() == reference[index].random()
