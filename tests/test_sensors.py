"""Sensors: signs and conventions, first locations that are consistent, errors that name the remedy."""

import math
import pickle

import numpy as np
import pytest

from jink.estimators.compiled import call_observe, kernel
from jink.estimators.sensors import (
    SENSORS,
    bearing,
    bearing_elevation,
    make_sensor,
    position,
    range_bearing,
    range_bearing_elevation,
    range_bearing_elevation_rate,
    range_bearing_rate,
    range_only,
    range_range_rate,
    range_rate,
    ranges,
)

ANCHORS_2D = [[0.0, 0.0], [40.0, 0.0], [35.0, 30.0], [-5.0, 25.0]]
EVERY = [
    (name, axes, make_sensor(name, **options))
    for name, axes, options in [
        ("position", 2, {}),
        ("position", 3, {"axes": 3}),
        ("range-bearing", 2, {}),
        ("range-bearing-elevation", 3, {}),
        ("range-bearing-rate", 2, {}),
        ("range-bearing-elevation-rate", 3, {}),
        ("bearing", 2, {"range_prior": (5000.0, 1000.0)}),
        ("bearing-elevation", 3, {}),
        ("ranges", 2, {"anchors": ANCHORS_2D}),
        ("range", 3, {"axes": 3}),
        ("range-rate", 2, {}),
        ("range-range-rate", 3, {"axes": 3}),
    ]
]


@kernel
def _compiled(address, kin, state, params, out):
    call_observe(address, kin, state, params, out)


def see(sensor, kin, state=None):
    out = np.full(sensor.size, np.nan)
    state = np.zeros(2 * sensor.axes) if state is None else np.asarray(state, dtype=float)
    sensor.observe(np.asarray(kin, dtype=float), state, np.asarray(sensor.params, dtype=float), out)
    return out


def mean_nees(errors, covs):
    """Mean and its standard error."""
    nees = np.einsum("bi,bij,bj->b", errors, np.linalg.inv(covs), errors)
    return nees.mean(), nees.std() / math.sqrt(len(nees))


def locate_many(sensor, truth, noise, draws, rng, state=None, missing=None):
    state = np.zeros(2 * sensor.axes) if state is None else state
    exact = see(sensor, np.r_[truth, np.zeros(sensor.axes)], state)
    located = []
    for disturbance in rng.multivariate_normal(np.zeros(sensor.size), noise, draws):
        z = exact + disturbance
        if missing is not None:
            z[missing] = np.nan
        located.append(sensor.locate(sensor, z, noise, state))
    return np.stack([truth - mean for mean, _ in located]), np.stack([cov for _, cov in located])


def test_registry_lists_every_sensor_tested_here():
    assert {name for name, _, _ in EVERY} == set(SENSORS)
    assert all(SENSORS[name] is not None and sensor.name == name for name, _, sensor in EVERY)


@pytest.mark.parametrize(("name", "axes", "sensor"), EVERY)
def test_compiled_function_equals_python_and_leaves_inputs(name, axes, sensor):
    rng = np.random.default_rng(3)
    params = np.asarray(sensor.params, dtype=float)
    for _ in range(20):
        kin, state = rng.normal(size=2 * axes) * 50, rng.normal(size=2 * axes) * 20
        before = kin.copy(), state.copy()
        out = np.empty(sensor.size)
        _compiled(sensor.observe.address, kin, state, params, out)
        # Only the order of a fused multiply-add may differ.
        np.testing.assert_allclose(out, see(sensor, kin, state), rtol=1e-13, atol=1e-13)
        assert (kin == before[0]).all() and (state == before[1]).all()


@pytest.mark.parametrize(("name", "axes", "sensor"), EVERY)
def test_target_on_the_sensor_gives_finite_numbers(name, axes, sensor):
    out = np.empty(sensor.size)
    place = np.full(2 * axes, 2.0)
    _compiled(sensor.observe.address, place, place.copy(), np.asarray(sensor.params, dtype=float), out)
    assert np.isfinite(out).all()
    assert np.isfinite(see(sensor, place, place)).all()


@pytest.mark.parametrize(("name", "axes", "sensor"), EVERY)
def test_sensor_survives_pickling(name, axes, sensor):
    copy = pickle.loads(pickle.dumps(sensor))  # workers of a process pool get sensors this way
    kin = np.arange(1.0, 2 * axes + 1)
    assert (see(copy, kin) == see(sensor, kin)).all()


def test_bearing_is_counter_clockwise_from_x_and_relative_to_the_sensor():
    kin, state = [13.0, 24.0, 0.0, 0.0], [10.0, 20.0, 5.0, -7.0]
    np.testing.assert_allclose(see(range_bearing(), kin, state), [5.0, math.atan2(4.0, 3.0)])
    np.testing.assert_allclose(see(bearing(), kin, state), [math.atan2(4.0, 3.0)])
    assert see(bearing(), [0.0, 1.0, 0, 0])[0] == pytest.approx(math.pi / 2)
    assert see(bearing(), [-1.0, -1e-9, 0, 0])[0] == pytest.approx(-math.pi)


def test_elevation_is_up_from_the_horizontal_plane():
    kin, state = [4.0, 6.0, 15.0, 0, 0, 0], [1.0, 2.0, 3.0, 0, 0, 0]
    expected = [13.0, math.atan2(4.0, 3.0), math.atan2(12.0, 5.0)]
    np.testing.assert_allclose(see(range_bearing_elevation(), kin, state), expected)
    np.testing.assert_allclose(see(bearing_elevation(), kin, state), expected[1:])
    assert see(bearing_elevation(), [1.0, 0, -1.0, 0, 0, 0])[1] == pytest.approx(-math.pi / 4)


def test_range_rate_is_positive_receding_and_counts_the_sensor():
    # Line of sight (0.6, 0.8); relative velocity (2, 1) gives 1.2 + 0.8.
    kin, state = [13.0, 24.0, 5.0, 3.0], [10.0, 20.0, 3.0, 2.0]
    assert see(range_rate(), kin, state)[0] == pytest.approx(2.0)
    np.testing.assert_allclose(see(range_bearing_rate(), kin, state), [5.0, math.atan2(4, 3), 2.0])
    assert see(range_rate(), [10.0, 0, -3.0, 9.0])[0] == pytest.approx(-3.0)
    np.testing.assert_allclose(see(range_range_rate(), kin, state), [5.0, 2.0])
    # In space: line of sight (3, 4, 12) / 13, relative velocity (1, 2, -1).
    kin3, state3 = [4.0, 6.0, 15.0, 1.0, 3.0, 0.0], [1.0, 2.0, 3.0, 0.0, 1.0, 1.0]
    np.testing.assert_allclose(see(range_range_rate(axes=3), kin3, state3), [13.0, -1.0 / 13.0])
    radar = see(range_bearing_elevation_rate(), kin3, state3)
    np.testing.assert_allclose(radar, [*see(range_bearing_elevation(), kin3, state3), -1.0 / 13.0])
    # It is the time derivative of the range.
    later = np.array(kin) + 1e-6 * np.array([5.0, 3.0, 0, 0])
    state_later = np.array(state) + 1e-6 * np.array([3.0, 2.0, 0, 0])
    slope = (see(range_only(), later, state_later)[0] - see(range_only(), kin, state)[0]) / 1e-6
    assert slope == pytest.approx(2.0, rel=1e-5)  # the step leaves 1e-6


def test_ranges_are_in_the_order_of_the_anchors_and_ignore_the_sensors_place():
    sensor = ranges([[0.0, 0.0], [3.0, 0.0]], sigma=(0.1, 0.3))
    np.testing.assert_allclose(see(sensor, [3.0, 4.0, 0, 0], [9.0, 9.0, 0, 0]), [5.0, 4.0])
    np.testing.assert_allclose(np.diag(sensor.noise), [0.01, 0.09])
    assert see(range_only(axes=3), [2.0, 3.0, 6.0, 0, 0, 0])[0] == pytest.approx(7.0)


def test_location_has_the_exact_moments_of_a_correlated_range_and_bearing():
    sensor, z = range_bearing(), np.array([100.0, 0.7])
    R = np.array([[25.0, 1.2], [1.2, 0.09]])
    mean, cov = sensor.locate(sensor, z, R, np.array([5.0, -3.0, 0, 0]))
    # E[r e^(i b)] and E[r^2 e^(2 i b)] of a Gaussian, from its characteristic function.
    first = (z[0] + 1j * R[0, 1]) * np.exp(1j * z[1] - R[1, 1] / 2)
    second = ((z[0] + 2j * R[0, 1]) ** 2 + R[0, 0]) * np.exp(2j * z[1] - 2 * R[1, 1])
    power = z[0] ** 2 + R[0, 0]
    exact = np.array([[power + second.real, second.imag], [second.imag, power - second.real]]) / 2
    exact -= np.outer([first.real, first.imag], [first.real, first.imag])
    # Nine quadrature points per angle: error far below the sixth digit at 0.3 rad.
    np.testing.assert_allclose(mean, [5.0 + first.real, -3.0 + first.imag], rtol=1e-8)
    np.testing.assert_allclose(cov, exact, rtol=1e-7)


@pytest.mark.parametrize("sigma_bearing", [0.001, 0.05, 0.3])
def test_range_bearing_location_is_consistent_up_to_large_angle_noise(sigma_bearing):
    rng = np.random.default_rng(7)
    sensor, noise = range_bearing(), np.diag([50.0**2, sigma_bearing**2])
    errors, covs = locate_many(sensor, np.array([-6000.0, 8000.0]), noise, 4000, rng)
    mean, error = mean_nees(errors, covs)
    assert abs(mean - 2.0) < 4 * error < 0.5
    if sigma_bearing == 0.3:  # the plain conversion with its Jacobian is off by far more than that
        bent = -errors + np.array([-6000.0, 8000.0])
        z = np.arctan2(bent[:, 1], bent[:, 0])
        plain = 1e4 * np.stack([np.cos(z), np.sin(z)], axis=1) - [-6000.0, 8000.0]
        along = np.stack([np.cos(z), np.sin(z)], axis=1)
        across = np.stack([-np.sin(z), np.cos(z)], axis=1)
        wrong = (plain * along).sum(1) ** 2 / 2500.0
        wrong += (plain * across).sum(1) ** 2 / (1e4 * sigma_bearing) ** 2
        assert wrong.mean() > 10.0


def test_range_bearing_elevation_location_is_consistent():
    rng = np.random.default_rng(8)
    sensor = range_bearing_elevation()
    noise = np.diag([30.0**2, 0.1**2, 0.08**2])
    state = np.array([100.0, -50.0, 20.0, 0, 0, 0])
    errors, covs = locate_many(sensor, np.array([3000.0, -4000.0, 1500.0]), noise, 3000, rng, state)
    mean, error = mean_nees(errors, covs)
    assert abs(mean - 3.0) < 4 * error < 0.6


def test_precise_sensor_far_away_keeps_a_positive_covariance():
    sensor = range_bearing()
    _, cov = sensor.locate(sensor, np.array([1e7, 3.0]), np.diag([1e-2, 1e-14]), np.zeros(4))
    # Moments by subtraction would lose everything here; along 0.1^2, across (1e7 1e-7)^2.
    np.testing.assert_allclose(np.linalg.eigvalsh(cov), [1e-2, 1.0], rtol=1e-4)


def test_bearing_with_a_range_prior_lies_along_the_ray():
    rng = np.random.default_rng(9)
    sensor, state = bearing(sigma=0.05, range_prior=(5000.0, 1000.0)), np.array([200.0, 300.0, 0, 0])
    truths = rng.normal(5000.0, 1000.0, 4000)
    errors, covs = [], []
    for distance in truths:
        mean, cov = sensor.locate(sensor, np.array([2.5 + rng.normal(0, 0.05)]), sensor.noise, state)
        errors.append(state[:2] + distance * np.array([math.cos(2.5), math.sin(2.5)]) - mean)
        covs.append(cov)
    mean, error = mean_nees(np.array(errors), np.array(covs))
    assert abs(mean - 2.0) < 4 * error < 0.4
    assert bearing().locate is None


@pytest.mark.parametrize("missing", [None, 1])
def test_ranges_locate_consistently_with_three_or_four_anchors(missing):
    rng = np.random.default_rng(10)
    sensor = ranges(ANCHORS_2D, sigma=0.3)
    errors, covs = locate_many(sensor, np.array([12.0, 9.0]), sensor.noise, 1500, rng, missing=missing)
    mean, error = mean_nees(errors, covs)
    assert abs(mean - 2.0) < 4 * error < 0.4


def test_ranges_in_space_and_with_too_few_anchors():
    anchors = [[0.0, 0, 0], [10.0, 0, 1], [0, 10.0, 2], [10.0, 10, 6], [5.0, 5, -4]]
    sensor = ranges(anchors, sigma=0.05)
    truth = np.array([3.0, 4.0, 5.5])
    z = see(sensor, np.r_[truth, 0, 0, 0])
    np.testing.assert_allclose(sensor.locate(sensor, z, sensor.noise, np.zeros(6))[0], truth, atol=1e-6)
    z[[0, 2]] = np.nan
    assert sensor.locate(sensor, z, sensor.noise, np.zeros(6)) is None


def test_anchors_on_a_line_widen_over_both_mirror_images():
    sensor = ranges([[0.0, 0.0], [10.0, 5.0], [20.0, 10.0]], sigma=0.1)
    truth, mirror = np.array([4.0, 12.0]), np.array([12.0, -4.0])
    mean, cov = sensor.locate(sensor, see(sensor, np.r_[truth, 0, 0]), sensor.noise, np.zeros(4))
    assert min(np.linalg.norm(mean - truth), np.linalg.norm(mean - mirror)) < 1e-3
    for place in (truth, mirror):
        offset = place - mean
        assert offset @ np.linalg.solve(cov, offset) < 2.1  # half the weight each: at sqrt(2) sd
    across = np.array([1.0, 2.0]) / math.sqrt(5)
    assert across @ cov @ across > 30.0  # not only where the other image happens to be


def test_target_in_the_plane_of_its_anchors_has_a_finite_covariance():
    sensor = ranges([[0.0, 0, 0], [10.0, 0, 0], [0, 10.0, 0], [10.0, 10, 0]], sigma=0.1)
    z = see(sensor, [4.0, 3.0, 0, 0, 0, 0])
    mean, cov = sensor.locate(sensor, z, sensor.noise, np.zeros(6))
    assert np.linalg.norm(mean[:2] - [4.0, 3.0]) < 0.1
    assert 0.5 < math.sqrt(cov[2, 2]) < 5.0


@pytest.mark.parametrize(("name", "axes", "sensor"), EVERY)
def test_nothing_is_located_from_nothing(name, axes, sensor):
    if sensor.locate is not None:
        z = np.full(sensor.size, np.nan)
        assert sensor.locate(sensor, z, sensor.noise, np.zeros(2 * axes)) is None


def test_location_across_the_cut_of_the_bearing():
    sensor = range_bearing()
    here = sensor.locate(sensor, np.array([100.0, math.pi - 1e-9]), sensor.noise, np.zeros(4))
    there = sensor.locate(sensor, np.array([100.0, -math.pi + 1e-9]), sensor.noise, np.zeros(4))
    np.testing.assert_allclose(here[0], there[0], atol=1e-5)
    np.testing.assert_allclose(here[1], there[1], atol=1e-5)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: make_sensor("sonar"), ["sonar", "range-bearing", "ranges"]),
        (lambda: make_sensor("position", sigm=1.0), ["sigm", "sigma", "axes"]),
        (lambda: make_sensor("ranges"), ["anchors"]),
        (lambda: position(axes=4), ["axes", "4"]),
        (lambda: position(sigma=-1.0), ["sigma", "> 0", "-1.0"]),
        (lambda: position(sigma="wide"), ["sigma", "wide"]),
        (lambda: range_bearing(sigma=3.0), ["sigma", "range in m", "bearing in rad"]),
        (lambda: range_bearing(sigma=(1.0, math.nan)), ["sigma", "finite"]),
        (lambda: bearing(range_prior=(100.0, 0.0)), ["range_prior", "mean, sd"]),
        (lambda: ranges([1.0, 2.0]), ["anchors", "(D, 2)", "(2,)"]),
        (lambda: ranges(ANCHORS_2D, sigma=(1.0, 2.0)), ["sigma", "4"]),
        (lambda: range_only(axes=1), ["axes", "2, 3"]),
    ],
)
def test_errors_name_the_argument_and_the_remedy(call, words):
    with pytest.raises(ValueError) as caught:
        call()
    assert all(word in str(caught.value) for word in words)
