"""PMHT: frozen values, limits that are known exactly, EM's guarantee, symmetries, hostile input, tracks found."""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jink.envs.scene_library import get_scene
from jink.envs.scenery.scene_scans import scene_scans
from jink.envs.scenes import simulate_scene
from jink.estimators.markov import MarkovChain
from jink.estimators.metrics.target_sets import gospa
from jink.estimators.motions import make_motion
from jink.estimators.multitarget.exclusive import exclude
from jink.estimators.multitarget.extrinsic import extrinsic_densities
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.jpda import Jpda
from jink.estimators.multitarget.placing import place_detections
from jink.estimators.multitarget.pmht import KnownTracks, Pmht
from jink.estimators.multitarget.pmht_kernels import centroids, densities, information_pairs, noise_tables, weigh
from jink.estimators.multitarget.scans import Scans, ScanSensor
from jink.estimators.multitarget.seeing import linearise_one
from jink.estimators.multitarget.tables import make_moving, make_sensing
from jink.estimators.sensors import make_sensor

LINE = make_motion("constant-velocity", axes=1, acceleration_density=0.1)
PLANE = make_motion("constant-velocity", axes=2, acceleration_density=0.5)
PUBLISHED = {"assignment": "independent", "adaptive": 0, "correction": False, "gate": None, "initiation": None}


def line_sensor(**options):
    return ScanSensor(make_sensor("position", axes=1, sigma=1.0), **options)


def plane_sensor(**options):
    return ScanSensor(make_sensor("position", axes=2, sigma=1.0), **{"clutter": 2.0, "volume": 1e4, **options})


def rts(z, times, prior, cov, q, R):
    """Textbook Kalman filter and RTS smoother for one axis; filtered and smoothed means and covariances."""
    filtered, predicted, m, P = [], [], np.array(prior, float), np.array(cov, float)
    for k, value in enumerate(z):
        if k:
            dt = times[k] - times[k - 1]
            F = np.array([[1, dt], [0, 1]])
            m, P = F @ m, F @ P @ F.T + q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        predicted.append((m, P))
        if np.isfinite(value):
            gain = P[:, 0] / (P[0, 0] + R)
            m, P = m + gain * (value - m[0]), P - np.outer(gain, P[0])
        filtered.append((m, P))
    smoothed = [filtered[-1]]
    for k in range(len(z) - 2, -1, -1):
        dt = times[k + 1] - times[k]
        C = filtered[k][1] @ np.array([[1, dt], [0, 1]]).T @ np.linalg.inv(predicted[k + 1][1])
        m = filtered[k][0] + C @ (smoothed[0][0] - predicted[k + 1][0])
        P = filtered[k][1] + C @ (smoothed[0][1] - predicted[k + 1][1]) @ C.T
        smoothed.insert(0, (m, P))
    return [tuple(np.array(part) for part in zip(*pairs, strict=True)) for pairs in (filtered, smoothed)]


def line_data(seed, steps=15):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.3, 2.0, steps))
    return times, 0.7 * times + rng.normal(size=steps)


def scene_in_plane(seed, targets=3, steps=8, clutter=4, sensor=None):
    """Straight targets, one detection each with probability 0.9, and clutter around them."""
    rng = np.random.default_rng(seed)
    start = np.hstack([rng.uniform(-15, 15, (targets, 2)), rng.normal(0, 1, (targets, 2))])
    scans = []
    for k in range(steps):
        there = start[:, :2] + k * start[:, 2:] + rng.normal(size=(targets, 2))
        scans.append(np.vstack([there[rng.random(targets) < 0.9], rng.uniform(-30, 30, (rng.poisson(clutter), 2))]))
    found = Scans.from_arrays(np.arange(float(steps)), scans, sensor or plane_sensor())
    return found, KnownTracks(start, np.diag([4.0, 4.0, 1.0, 1.0]), 0.0)


# ---------------------------------------------------------------------------------------------- frozen values


def test_frozen_weights_and_centroids():
    z = np.array([[0.2], [1.1], [4.0]])
    sizes, sensor, offsets = np.array([1]), np.array([0]), np.array([0, 3])
    whiten, log_norm = np.zeros((1, 1, 1)), np.zeros(1)
    noise_tables(sizes, sensor, np.full((1, 1, 1), 0.25), whiten, log_norm)
    seen = np.array([[[0.0]], [[1.5]]])
    begins, pairs = np.array([0, 3, 6]), np.array([0, 1, 2, 0, 1, 2])
    residual, log_density, ratio, weight = np.zeros((6, 1)), np.zeros(6), np.zeros(6), np.zeros(6)
    densities(
        z, sensor, sizes, np.zeros((1, 1), bool), whiten, log_norm, seen, begins, pairs, 1.0,
        np.zeros(1), np.ones(1), residual, log_density, ratio,
    )  # fmt: skip
    log_pi = np.log(np.array([[0.4, 0.4]]))
    _, unexplained = weigh(
        offsets, begins, pairs, log_density, log_pi, np.log([0.2 / 10]), np.zeros(3), np.zeros(3), weight
    )
    w = weight.reshape(2, 3)
    # Six digits are what the note gives.
    np.testing.assert_allclose(w[0], [0.905167, 0.101308, 0.0], atol=6e-7)
    np.testing.assert_allclose(w[1], [0.033385, 0.827297, 0.000059], atol=6e-7)
    np.testing.assert_allclose(1 - w.sum(0), [0.061447, 0.071395, 0.999941], atol=6e-7)
    assert unexplained == 0
    mass, hits, pull, spread = np.zeros((2, 1)), np.zeros((2, 1)), np.zeros((2, 1, 1)), np.zeros((2, 1, 1, 1))
    centroids(begins, pairs, sizes, sensor, residual, weight, ratio, mass, pull, spread, hits)
    np.testing.assert_allclose(seen[:, 0, 0] + pull[:, 0, 0] / mass[:, 0], [0.290591, 1.065292], atol=1e-6)
    np.testing.assert_allclose(0.25 / mass[:, 0], [0.248392, 0.290447], atol=1e-6)
    # The information pair of a position sensor: dOmega = mass / R, dq = sum_r w_r z_r / R.
    H, dq, domega = np.array([[[[1.0, 0.0]]], [[[1.0, 0.0]]]]), np.zeros((2, 1, 2)), np.zeros((2, 1, 2, 2))
    means = np.array([[[0.0, 7.0]], [[1.5, 7.0]]])
    information_pairs(mass, pull, H, whiten, means, np.zeros(2, np.int64), np.zeros((1, 2)), dq, domega)
    np.testing.assert_allclose(dq[:, 0, 0], (w @ z[:, 0]) / 0.25)
    np.testing.assert_allclose(domega[:, 0, 0, 0], w.sum(1) / 0.25)
    assert not domega[:, 0, 1].any() and not dq[:, 0, 1].any()


def test_homothetic_density_and_its_information():
    z, shares, scales, R, tau = np.array([[0.0], [1.0], [7.0]]), [0.6, 0.3, 0.1], [1.0, 4.0, 16.0], 0.5, 2.0
    whiten, log_norm = np.full((1, 1, 1), R**-0.5), np.array([-0.5 * np.log(2 * np.pi * R)])
    residual, log_density, ratio = np.zeros((3, 1)), np.zeros(3), np.zeros(3)
    densities(
        z, np.array([0]), np.array([1]), np.zeros((1, 1), bool), whiten, log_norm, np.zeros((1, 1, 1)),
        np.array([0, 3]), np.arange(3), tau, np.log(shares), np.array(scales), residual, log_density, ratio,
    )  # fmt: skip
    parts = np.array([
        share * np.exp(-0.5 * z[:, 0] ** 2 / (scale * tau * R)) / np.sqrt(2 * np.pi * scale * tau * R)
        for share, scale in zip(shares, scales, strict=True)
    ])  # fmt: skip
    np.testing.assert_allclose(log_density, np.log(parts.sum(0)))
    np.testing.assert_allclose(ratio, (parts / (np.array(scales)[:, None] * tau)).sum(0) / parts.sum(0))
    assert ratio[2] < 0.2 * ratio[0]  # far off, only the wide components are left


def test_no_clutter_and_no_candidate_is_counted():
    weight = np.zeros(0)
    value, unexplained = weigh(
        np.array([0, 2]), np.array([0, 0]), np.zeros(0, np.int64), np.zeros(0), np.zeros((1, 1)), np.array([-np.inf]),
        np.zeros(2), np.zeros(2), weight,
    )  # fmt: skip
    assert (value, unexplained) == (0.0, 2)


# ------------------------------------------------------------------------------------ one target, no clutter


@pytest.mark.parametrize("iterations", [1, 4])
@pytest.mark.parametrize("window", [1, 2, 5, 15])
@pytest.mark.parametrize("assignment", ["independent", "exclusive"])
def test_one_target_without_clutter_is_the_rts_smoother(iterations, window, assignment):
    times, z = line_data(1)
    scans = Scans.from_arrays(times, [[[v]] for v in z], line_sensor(detection=1.0))
    tracker = Pmht(
        LINE, window=window, iterations=iterations, gate=None, initiation=None, assignment=assignment, correction=True
    )
    prior, cov = [0.3, 0.2], np.diag([4.0, 2.0])
    got = tracker.run(scans, KnownTracks([prior], cov, times[0]))
    filtered, _ = rts(z, times, prior, cov, 0.1, 1.0)
    np.testing.assert_allclose(got.mean, filtered[0], atol=1e-9)
    np.testing.assert_allclose(got.cov, filtered[1], atol=1e-9)
    # A scan that has left the window knows the window - 1 scans that followed it.
    for k in range(len(times)):
        _, smoothed = rts(z[: k + window], times[: k + window], prior, cov, 0.1, 1.0)
        np.testing.assert_allclose(got.smoothed_mean[k], smoothed[0][k], atol=1e-9)
        np.testing.assert_allclose(got.smoothed_cov[k], smoothed[1][k], atol=1e-9)


def test_empty_scans_are_missed_detections():
    times, z = line_data(2)
    z[[0, 4, 5, 14]] = np.nan
    scans = Scans.from_arrays(times, [[] if np.isnan(v) else [[v]] for v in z], line_sensor(detection=1.0))
    got = Pmht(LINE, window=6, gate=None, initiation=None).run(scans, KnownTracks([[0, 0.5]], np.eye(2), times[0]))
    np.testing.assert_allclose(got.mean, rts(z, times, [0, 0.5], np.eye(2), 0.1, 1.0)[0][0], atol=1e-9)


def test_identical_modes_are_one_mode():
    scans, known = scene_in_plane(3)
    chain = MarkovChain.per_step([[0.9, 0.1], [0.3, 0.7]])
    two = Pmht([PLANE, PLANE], chain, window=5, initiation=None, tolerance=0.0, iterations=3).run(scans, known)
    one = Pmht(PLANE, window=5, initiation=None, tolerance=0.0, iterations=3).run(scans, known)
    # The bank smooths with an inverse of P-, the single mode without: they agree to its condition number.
    np.testing.assert_allclose(two.mean, one.mean, atol=1e-8)
    np.testing.assert_allclose(two.smoothed_mean, one.smoothed_mean, atol=1e-8)
    np.testing.assert_allclose(two.smoothed_cov, one.smoothed_cov, atol=1e-8)


def test_two_sensors_at_one_time_are_one_better_sensor():
    times, z = line_data(4)
    both = np.stack([z, z + np.random.default_rng(0).normal(size=z.size)], 1)
    twice = Scans.from_arrays(
        np.repeat(times, 2), [[[v]] for v in both.ravel()], [line_sensor(detection=1.0)] * 2,
        sensor=np.tile([0, 1], times.size),
    )  # fmt: skip
    once = Scans.from_arrays(times, [[[v]] for v in both.mean(1)], line_sensor(detection=1.0), noise=[[0.5]])
    tracker, known = Pmht(LINE, window=60, gate=None, initiation=None), KnownTracks([[0, 0.5]], np.eye(2), times[0])
    np.testing.assert_allclose(tracker.run(twice, known).mean[1::2], tracker.run(once, known).mean, atol=1e-9)


# --------------------------------------------------------------------------------------------------- EM


def naive_objective(path, known, scans, density, share):
    """ln p(path) + ln p(detections | path) in plain numpy; path (M, K, 4) in the layout x vx y vy."""
    total, q = 0.0, 0.5
    Q1, F1 = q * np.array([[1 / 3, 0.5], [0.5, 1.0]]), np.array([[1.0, 1.0], [0.0, 1.0]])
    for m, track in enumerate(path):
        first = track[0][[0, 2, 1, 3]] - known.mean[m]
        total -= 0.5 * first @ np.linalg.solve(known.cov[m], first)
        for before, after in pairwise(track):
            for axis in (slice(0, 2), slice(2, 4)):
                off = after[axis] - F1 @ before[axis]
                total -= 0.5 * off @ np.linalg.solve(Q1, off)
    for k, scan in enumerate(scans):
        for z in scan.detections:
            squared = ((z - path[:, k][:, [0, 2]]) ** 2).sum(1)
            total += np.log(density + share * (np.exp(-0.5 * squared) / (2 * np.pi)).sum())
    return total


def test_objective_is_the_observed_data_log_posterior():
    scans, known = scene_in_plane(5, targets=2, steps=5)
    tracker = Pmht(PLANE, window=9, tolerance=0.0, **PUBLISHED)
    before = tracker.start(scans.sensors, 0.0, known)
    for k in range(4):
        before, _ = tracker.step(before, scans.scan(k))
    paths = []
    for iterations in (1, 2, 4):
        after, _ = replace(tracker, iterations=iterations).step(before, scans.scan(4))
        paths.append(after.tracks.means)
    objective = replace(tracker, iterations=6).step(before, scans.scan(4))[1].objective
    norm = 2.0 + 2 * 0.9
    want = [naive_objective(path, known, scans, 2.0 / 1e4 / norm, 0.9 / norm) for path in paths]
    assert np.isnan(objective[-1]) and abs(want[2] - want[0]) > 1e-4  # the iterates differ, so the test can fail
    np.testing.assert_allclose(np.diff(objective[[0, 1, 3]]), np.diff(want), atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000), targets=st.integers(1, 5), clutter=st.integers(0, 12),
    gate=st.sampled_from([None, 9.0]),
    priors=st.sampled_from(["fixed", "updated"]), rule=st.sampled_from(["share", "missed"]), mixed=st.booleans(),
)  # fmt: skip
def test_em_never_lowers_the_objective(seed, targets, clutter, gate, priors, rule, mixed):
    scans, known = scene_in_plane(seed, targets, 6, clutter)
    mixture = ((0.6, 0.3, 0.1), (1.0, 4.0, 16.0)) if mixed else None
    tracker = Pmht(
        PLANE, window=4, iterations=12, tolerance=0.0, priors=priors, clutter_prior=rule, homothetic=mixture,
        **{**PUBLISHED, "gate": gate},
    )  # fmt: skip
    state = tracker.start(scans.sensors, 0.0, known)
    for scan in scans:
        state, found = tracker.step(state, scan)
        values = found.objective[np.isfinite(found.objective)]
        # Exact arithmetic never goes down; sums of a few hundred terms round at 1e-13 of their size.
        assert (np.diff(values) >= -1e-10 * np.abs(values).max()).all()


def test_homothetic_of_equal_components_is_plain():
    scans, known = scene_in_plane(6)
    plain = Pmht(PLANE, initiation=None, extrinsic=False).run(scans, known)
    same = Pmht(PLANE, initiation=None, homothetic=((0.3, 0.7), (1.0, 1.0))).run(scans, known)
    wide = Pmht(PLANE, initiation=None, homothetic=((0.3, 0.7), (1.0, 9.0))).run(scans, known)
    np.testing.assert_allclose(same.mean, plain.mean, atol=1e-9)
    assert np.abs(wide.mean - plain.mean).max() > 1e-3


def test_annealing_finds_a_target_that_plain_em_misses():
    """A sure but wrong start, 8 sigma off: with R alone the detections weigh nothing beside clutter."""
    rng = np.random.default_rng(7)
    scans = Scans.from_arrays(np.arange(8.0), [rng.normal(size=(1, 2)) for _ in range(8)], plane_sensor(clutter=5.0))
    known = KnownTracks([[8.0, 0, 0, 0]], np.diag([9.0, 9.0, 0.1, 0.1]), 0.0)
    off = {}
    for steps in ((), (64.0, 16.0, 4.0)):
        off[steps] = abs(Pmht(PLANE, annealing=steps, **PUBLISHED).run(scans, known).mean[-1, 0])
    assert off[()] > 5 and off[(64.0, 16.0, 4.0)] < 2


def test_weights_by_the_prediction_find_it_too():
    rng = np.random.default_rng(7)
    scans = Scans.from_arrays(np.arange(8.0), [rng.normal(size=(1, 2)) for _ in range(8)], plane_sensor(clutter=5.0))
    known = KnownTracks([[8.0, 0, 0, 0]], np.diag([9.0, 9.0, 0.1, 0.1]), 0.0)
    assert abs(Pmht(PLANE, **{**PUBLISHED, "adaptive": 1}).run(scans, known).mean[-1, 0]) < 2


# -------------------------------------------------------------------------------- one detection per target


def exclusive_weights(g, missed, clutter, rounds=60, most=1):
    """With one event at most all clusters of several targets are weighed by messages."""
    M, n = g.shape
    weight = np.zeros(M * n)
    exclude(
        np.array([0, n]), np.arange(0, M * n + 1, n), np.tile(np.arange(n), M), np.log(g).ravel(),
        np.array([missed]), np.array([clutter]), rounds, most, weight,
    )  # fmt: skip
    return weight.reshape(M, n)


def enumerated(g, missed, clutter):
    M, n = g.shape
    out, total = np.zeros((M, n)), 0.0
    for choice in product(range(-1, n), repeat=M):
        used = [r for r in choice if r >= 0]
        if len(set(used)) == len(used):
            p = clutter ** (n - len(used))
            for m, r in enumerate(choice):
                p *= missed[m] if r < 0 else g[m, r]
            total += p
            for m, r in enumerate(choice):
                if r >= 0:
                    out[m, r] += p
    return out / total


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (2, 1), (4, 1)])
def test_exclusive_weights_are_exact_without_loops(shape):
    rng = np.random.default_rng(8)
    g, missed = rng.gamma(1.0, 1.0, shape), rng.uniform(0.05, 0.5, shape[0])
    np.testing.assert_allclose(exclusive_weights(g, missed, 0.1), enumerated(g, missed, 0.1), atol=1e-9)


def test_exclusive_weights_are_near_with_loops():
    rng = np.random.default_rng(9)
    errors = {"exclusive": [], "independent": []}
    for _ in range(30):
        g, missed = rng.gamma(0.5, 1.0, (3, 3)), rng.uniform(0.05, 0.5, 3)
        got, want = exclusive_weights(g, missed, 0.1), enumerated(g, missed, 0.1)
        assert got.sum(1).max() <= 1 + 1e-9
        errors["exclusive"].append(np.abs(got - want).mean())
        errors["independent"].append(np.abs(g / (0.1 + g.sum(0)) - want).mean())
    # Loopy belief propagation is approximate; the weights of PMHT as published are the measure.
    assert np.mean(errors["exclusive"]) < 0.03 < 4 * np.mean(errors["exclusive"]) < np.mean(errors["independent"])


def test_events_of_small_clusters_are_counted_scan_by_scan():
    """Two scans; in the first, targets 0 and 2 share detections and target 1 is apart, in the second all share one."""
    rng = np.random.default_rng(10)
    offsets, begins = np.array([0, 4, 5]), np.array([0, 3, 4, 6, 7, 8, 9])
    pairs = np.array([0, 1, 2, 3, 1, 2, 4, 4, 4])
    g, missed, clutter = rng.gamma(0.5, 1.0, 9), rng.uniform(0.05, 0.5, (2, 3)), np.array([0.1, 0.3])
    weight = np.zeros(9)
    assert exclude(offsets, begins, pairs, np.log(g), missed, clutter, 5, 100, weight) == 0
    for k in range(2):
        dense = np.zeros((3, 5))
        for m in range(3):
            which = slice(begins[3 * k + m], begins[3 * k + m + 1])
            dense[m, pairs[which]] = g[which]
        want = enumerated(dense, missed[k], clutter[k])
        for m in range(3):
            which = slice(begins[3 * k + m], begins[3 * k + m + 1])
            np.testing.assert_allclose(weight[which], want[m, pairs[which]], atol=1e-12)


def test_three_sure_targets_take_all_that_is_there_without_clutter():
    """Lambda zero: nothing but a miss can leave a detection over."""
    weight = exclusive_weights(
        np.exp(-np.array([[0.0, 2, 50], [1, 0, 40], [60, 50, 5]])), np.full(3, 1e-9), 0.0, most=99
    )
    np.testing.assert_allclose(weight.sum(axis=0), 1, atol=1e-6)


# ------------------------------------------------------------------------------- what the other scans say


def test_extrinsic_density_is_that_of_the_smoother_without_the_scan():
    times, z = line_data(3, steps=6)
    q, R, prior, P0 = 0.4, 1.3, [0.0, 0.5], np.diag([4.0, 1.0])
    (fm, fP), (sm, sP) = rts(z, times, prior, P0, q, R)
    F = [np.array([[1.0, dt], [0, 1]]) for dt in np.diff(times, prepend=times[0])]
    Q = [q * np.array([[f[0, 1] ** 3 / 3, f[0, 1] ** 2 / 2], [f[0, 1] ** 2 / 2, f[0, 1]]]) for f in F]
    pm = np.array([prior, *(F[k] @ fm[k - 1] for k in range(1, 6))])
    pP = np.array([P0, *(F[k] @ fP[k - 1] @ F[k].T + Q[k] for k in range(1, 6))])
    mass, residual, log_density, ratio = np.ones((1, 6)), np.zeros((6, 1)), np.zeros(6), np.zeros(6)
    extrinsic_densities(
        z[:, None], np.zeros(6, dtype=int), np.array([1]), np.zeros((1, 1), dtype=bool), np.full((6, 1, 1), R**-0.5),
        np.full(6, -0.5 * np.log(2 * np.pi * R)), sm[None, :, :1], np.tile([[1.0, 0.0]], (1, 6, 1, 1)),
        np.zeros(1, dtype=int), np.arange(7), np.arange(6), sm[None], sP[None], pm[None], pP[None], fm[None], fP[None],
        mass, 1.0, np.zeros((1, 2)), np.zeros((6, 2)), np.zeros((5, 1, 1)), residual, log_density, ratio,
    )  # fmt: skip
    for k in range(6):
        without = z.copy()
        without[k] = np.nan
        x, P = (part[k] for part in rts(without, times, prior, P0, q, R)[1])
        S = P[0, 0] + R
        want = -0.5 * np.log(2 * np.pi * S) - 0.5 * (z[k] - x[0]) ** 2 / S
        assert log_density[k] == pytest.approx(want, abs=1e-9)
    np.testing.assert_allclose(residual[:, 0], z - sm[:, 0])


@pytest.mark.parametrize("seed", [11, 12])
def test_a_window_of_one_scan_is_joint_probabilistic_data_association(seed):
    scans, known = scene_in_plane(seed, targets=3)
    one = Pmht(PLANE, window=1, initiation=None).run(scans, known)
    other = Jpda(PLANE, initiation=None).run(scans, known)
    np.testing.assert_allclose(one.mean, other.mean, atol=1e-7)
    np.testing.assert_allclose(one.cov, other.cov, atol=1e-7)


def test_other_scans_keep_the_right_choice_where_targets_cross():
    """Five runs of the published three; weights by the path itself, which its own choice has bent, confirm mistakes."""
    motion, rules = make_motion("constant-velocity", acceleration_density=15.0), Initiation(speed=150.0)
    scores = {True: [], False: []}
    for seed in range(5):
        data = simulate_scene(get_scene("three-targets-v0"), seed)
        for extrinsic, runs in scores.items():
            found = Pmht(motion, initiation=rules, extrinsic=extrinsic).run(scene_scans(data))
            runs.append(gospa(found.sets()[1], data.truth.position, 200.0).distance.mean())
    assert np.mean(scores[True]) < np.mean(scores[False]) - 2


# ------------------------------------------------------------------------------------------- symmetries


def test_order_of_detections_and_targets_does_not_matter():
    scans, known = scene_in_plane(10, targets=4)
    rng = np.random.default_rng(0)
    orders = [rng.permutation(len(scan.detections)) for scan in scans]
    shuffled = Scans.from_arrays(
        scans.times, [scan.detections[order] for scan, order in zip(scans, orders, strict=True)], scans.sensors
    )
    tracker = Pmht(PLANE, window=5, initiation=None)
    base = tracker.run(scans, known)
    np.testing.assert_array_equal(tracker.run(shuffled, known).mean, base.mean)
    for k, order in enumerate(orders):
        np.testing.assert_array_equal(scans.offsets[k] + order[shuffled.scan(k).rows - shuffled.offsets[k]],
                                      np.arange(scans.offsets[k], scans.offsets[k + 1]))  # fmt: skip
    turn = [2, 0, 3, 1]
    other = tracker.run(scans, KnownTracks(known.mean[turn], known.cov[turn], 0.0)).mean
    # Sums over targets run in another order.
    np.testing.assert_allclose(other.reshape(-1, 4, 4), base.mean.reshape(-1, 4, 4)[:, turn], atol=1e-9)


def test_run_is_a_loop_of_steps_and_a_step_leaves_its_state_alone():
    scans, known = scene_in_plane(11)
    tracker = Pmht(PLANE, window=4, initiation=Initiation(speed=2.0))
    whole = tracker.run(scans, known)
    state = tracker.start(scans.sensors, 0.0, known)
    rows = []
    for scan in scans:
        again, _ = tracker.step(state, scan)
        state, found = tracker.step(state, scan)
        np.testing.assert_array_equal(again.tracks.means, state.tracks.means)
        rows.append(found.now.mean)
    np.testing.assert_array_equal(np.concatenate(rows), whole.mean)


def test_a_moving_own_ship_changes_nothing_but_the_place():
    """Range and bearing from a ship under way, everything shifted and turned by a quarter: so is the result."""
    rng = np.random.default_rng(12)
    sensor = ScanSensor(make_sensor("range-bearing", sigma=(2.0, 0.01)), clutter=1.0, volume=1000 * 2 * np.pi)
    times = np.arange(10.0)
    ship = np.stack([3 * times, -20 + 0 * times, 3 + 0 * times, 0 * times], 1)
    target = np.stack([-100 + 5 * times, 80 - 2 * times], 1)

    def polar(points, ships):
        off = points - ships[:, :2]
        return np.stack([np.hypot(*off.T), np.arctan2(off[:, 1], off[:, 0])], 1)

    noise = rng.normal(size=(10, 2)) * [2.0, 0.01]
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    means = []
    for spin in (np.eye(2), turn):
        both = np.kron(np.eye(2), spin)
        shift = np.array([0.0, 0, 0, 0]) if spin is not turn else np.array([500.0, -300, 0, 0])
        moved = ship @ both.T + shift
        z = polar(target @ spin.T + shift[:2], moved) + noise
        scans = Scans.from_arrays(times, z[:, None], sensor, sensor_states=moved)
        known = KnownTracks([both @ [-100, 80, 5, -2] + shift], np.diag([25.0, 25, 1, 1]), 0.0)
        got = Pmht(PLANE, window=5, initiation=None).run(scans, known)
        means.append((got.smoothed_mean - shift) @ both)
    # Jacobians are central differences.
    np.testing.assert_allclose(means[1], means[0], atol=1e-5)
    assert np.hypot(*(means[0][:, :2] - target).T).mean() < 2.0


def test_jacobian_of_range_and_bearing():
    sensing = make_sensing([ScanSensor(make_sensor("range-bearing", sigma=(1.0, 0.01)))])
    place, x = np.array([100.0, -50.0, 0, 0]), np.array([400.0, 9.0, 350.0, -3.0])
    seen, H, scratch = np.zeros(2), np.full((2, 4), 7.0), [np.zeros(4), np.zeros(2), np.zeros(2)]
    linearise_one(make_moving([PLANE]), sensing, 0, place, x, *scratch, seen, H)
    np.testing.assert_allclose(seen, [500.0, np.arctan2(400, 300)])
    np.testing.assert_allclose(H, [[0.6, 0, 0.8, 0], [-400 / 500**2, 0, 300 / 500**2, 0]], rtol=1e-7, atol=1e-12)


def test_a_gate_only_saves_work():
    scans, known = scene_in_plane(13, clutter=20)
    free = Pmht(PLANE, gate=None, initiation=None).run(scans, known)
    gated = Pmht(PLANE, gate=100.0, initiation=None).run(scans, known)
    # Beyond 100, e^-50 of a density is left; but a path may move while the scans are weighed anew.
    np.testing.assert_allclose(gated.mean, free.mean, atol=1e-3)


def test_nonlinear_motion_follows_a_turn():
    rng = np.random.default_rng(14)
    times, rate, speed = np.arange(40.0), 0.1, 10.0
    course = rate * times
    truth = speed / rate * np.stack([np.sin(course), 1 - np.cos(course)], 1)
    scans = Scans.from_arrays(times, (truth + rng.normal(size=truth.shape))[:, None], plane_sensor(detection=0.95))
    known = KnownTracks([[0, 0, 10.0, 0]], np.eye(4), 0.0)
    turning = make_motion("coordinated-turn", acceleration_density=0.01)
    got = Pmht(turning, initiation=None).run(scans, known)
    assert np.hypot(*(got.mean[10:, :2] - truth[10:]).T).mean() < 1.0  # raw detections: 1.25


def test_bank_follows_a_turn_that_one_mode_loses():
    rng = np.random.default_rng(15)
    times = np.arange(60.0)
    course = np.cumsum(np.where((times > 20) & (times < 40), 0.15, 0.0))
    truth = np.cumsum(10.0 * np.stack([np.cos(course), np.sin(course)], 1), axis=0)
    scans = Scans.from_arrays(times, (truth + rng.normal(size=truth.shape))[:, None], plane_sensor())
    known = KnownTracks([[*truth[0], 10.0, 0]], np.eye(4), 0.0)
    turns = [make_motion("known-turn", rate=rate, acceleration_density=0.05) for rate in (0.0, 0.15, -0.15)]
    error = {}
    for name, motion in (("one", turns[0]), ("bank", turns)):
        got = Pmht(motion, window=5, gate=None, initiation=None).run(scans, known)
        error[name] = np.sqrt(((got.mean[:, :2] - truth) ** 2).sum(1).mean())
    assert error["bank"] < 1.3 < 3 * error["bank"] < error["one"]


# ------------------------------------------------------------------------------------- scans and hostile input


def test_scans_are_cleaned_and_counted():
    scans = Scans.from_arrays(
        [2.0, 1.0, 3.0], [[[1.0, 2.0], [np.nan, 1.0], [1.0, 2.0]], [[0.0, 0.0]], [[np.inf, 0.0], [1e31, 0.0]]],
        plane_sensor(),
    )  # fmt: skip
    assert scans.cleaning == (3, 1, 1)
    np.testing.assert_array_equal(scans.times, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(scans.counts, [1, 1, 0])
    np.testing.assert_array_equal(scans.rows, [3, 0])
    assert len(scans.scan(2).detections) == 0


def test_scans_of_a_table_are_those_of_the_scene():
    data = simulate_scene(get_scene("crossing-v0"), 1)
    want = scene_scans(data)
    got = Scans.from_frame(data.to_frame(), {sensor.name: sensor for sensor in want.sensors})
    for name in ("times", "sensor", "detections", "offsets", "sensor_states"):
        np.testing.assert_array_equal(getattr(got, name), getattr(want, name))
    np.testing.assert_allclose(got.noise, want.noise)
    part = want.of_sensors([1])
    assert set(part.sensor) == {1} and len(part) == (want.sensor == 1).sum()


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: Scans.from_arrays([0.0, np.nan], [[], []], plane_sensor()), "times must be finite"),
        (lambda: Scans.from_arrays([0.0], [[], []], plane_sensor()), "one entry per time"),
        (lambda: Scans.from_arrays([0.0], [[[1.0]]], plane_sensor()), "shape"),
        (lambda: Scans.from_frame(pd.DataFrame({"x": [1.0]}), plane_sensor()), "column"),
        (lambda: ScanSensor(make_sensor("position"), detection=0.0), "detection must be"),
        (lambda: ScanSensor(make_sensor("position"), noise=-np.eye(2)), "noise must be a covariance"),
        (lambda: Pmht(PLANE, window=0), "window must be"),
        (lambda: Pmht(PLANE, priors="learned"), "priors must be one of fixed, updated"),
        (lambda: Pmht(PLANE, homothetic=((0.5,), (1.0,))), "homothetic"),
        (lambda: Pmht(PLANE, annealing=(2.0, 4.0)), "annealing"),
        (lambda: Pmht([PLANE, make_motion("constant-acceleration")]), "same state"),
        (lambda: KnownTracks([[0.0, 1, 2]], np.eye(3), 0.0), "shape"),
        (lambda: Initiation(hits=6, scans=5), "hits must be an integer from 1 to 5; got 6"),
    ],
)
def test_refusals(build, sentence):
    with pytest.raises(ValueError, match=sentence):
        build()


def test_a_scan_of_the_past_is_refused():
    scans, known = scene_in_plane(16)
    tracker = Pmht(PLANE)
    state, _ = tracker.step(tracker.start(scans.sensors, 0.0, known), scans.scan(3))
    with pytest.raises(ValueError, match=r"3 s or later"):
        tracker.step(state, scans.scan(2))


hostile = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e29, -1e-300, 5.0, 5.0, 6.0])


@settings(max_examples=60, deadline=None)
@given(
    scans=st.lists(st.lists(st.tuples(hostile, hostile), max_size=6), min_size=1, max_size=8),
    steps=st.lists(st.sampled_from([0.0, 0.0, 1e-9, 1.0, 1e4]), min_size=8, max_size=8),
    polar=st.booleans(), assignment=st.sampled_from(["independent", "exclusive"]), bank=st.booleans(),
    clutter=st.sampled_from([0.0, 1e-9, 5.0, 1e6]),
)  # fmt: skip
def test_hostile_scans_raise_nothing_and_lose_nothing(scans, steps, polar, assignment, bank, clutter):
    model = make_sensor("range-bearing", sigma=(1.0, 0.01)) if polar else make_sensor("position", sigma=1e-3)
    found = Scans.from_arrays(
        np.cumsum(steps[: len(scans)]), [np.reshape(scan, (-1, 2)) for scan in scans],
        ScanSensor(model, clutter=clutter, volume=100.0),
    )  # fmt: skip
    given_rows = sum(len(scan) for scan in scans)
    assert len(found.detections) + found.cleaning.not_finite + found.cleaning.repeated == given_rows
    motion = [PLANE, make_motion("known-turn", rate=0.1)] if bank else PLANE
    tracker = Pmht(motion, window=3, assignment=assignment, initiation=Initiation(hits=2, scans=3, confirm=1.0))
    got = tracker.run(found, KnownTracks([[0.0, 0, 1, 1], [5.0, 5, 0, 0]], np.eye(4), 0.0))
    assert np.isfinite(got.mean).all() and np.isfinite(got.smoothed_mean).all() and np.isfinite(got.cov).all()
    assert len(got.counts) == len(scans)


def test_thousands_of_detections():
    rng = np.random.default_rng(17)
    scans = Scans.from_arrays(
        np.arange(4.0), rng.uniform(-500, 500, (4, 3000, 2)), plane_sensor(clutter=3000.0, volume=1e6)
    )
    got = Pmht(PLANE, initiation=Initiation(speed=2.0)).run(scans, KnownTracks(np.zeros((5, 4)), np.eye(4), 0.0))
    assert np.isfinite(got.mean).all() and len(scans.detections) == 12_000


def test_no_scans_and_no_targets():
    assert len(Pmht(PLANE).run(Scans.from_arrays([], [], plane_sensor())).id) == 0
    empty = Scans.from_arrays(np.arange(5.0), [np.zeros((0, 2))] * 5, plane_sensor())
    got = Pmht(PLANE).run(empty)
    assert len(got.id) == 0 and len(got.counts) == 5 and got.sets()[1].shape == (0, 5, 2)


def test_a_sensor_that_stops_leaves_a_wider_track():
    scans, known = scene_in_plane(18, targets=1, steps=10, clutter=0)
    silent = scans.select(scans.times < 5)
    late = Scans.from_arrays(
        np.append(silent.times, [20.0]), [*(scan.detections for scan in silent), np.zeros((0, 2))], scans.sensors
    )
    got = Pmht(PLANE, initiation=None).run(late, known)
    assert got.cov[-1, 0, 0] > 100 * got.cov[-2, 0, 0]


# ------------------------------------------------------------------------------------- tracks from detections


def test_tracks_are_found_and_end():
    data = simulate_scene(get_scene("births-v0"), 2)
    tracker = Pmht(make_motion("constant-velocity", acceleration_density=1.0), initiation=Initiation(speed=50.0))
    got = tracker.run(scene_scans(data))
    ids, positions = got.sets()
    assert len(ids) == 5
    late = [np.flatnonzero(np.isfinite(row[:, 0])) for row in positions]
    assert sum(data.times[rows[-1]] < 79 for rows in late) == 2  # the two that die
    assert gospa(positions, data.truth.position, 200.0).distance.mean() < 160  # every target missed: 245


def test_a_twin_ends_and_the_older_track_stays():
    rng = np.random.default_rng(19)
    scans = Scans.from_arrays(np.arange(20.0), [rng.normal(size=(1, 2)) for _ in range(20)], plane_sensor())
    known = KnownTracks(np.zeros((2, 4)), np.eye(4), 0.0)
    for assignment in ("independent", "exclusive"):
        got = Pmht(PLANE, assignment=assignment).run(scans, known)
        assert list(got.id[got.scan == 19]) == [1]
    assert len(Pmht(PLANE, initiation=None).run(scans, known).id) == 40


def test_a_third_target_is_found_beside_two_that_share_its_detections():
    """Each of three detections is probably somebody's, yet two tracks cannot own three."""
    ids = []
    for tracker in (Pmht, Jpda):
        found = 0
        for seed in range(8):
            rng = np.random.default_rng(seed)
            truth = np.array([[0.0, 0.0], [0.0, 1.2], [0.0, -1.2]])
            scans = Scans.from_arrays(
                np.arange(25.0), [truth + rng.normal(size=(3, 2)) for _ in range(25)], plane_sensor(clutter=0.01)
            )
            known = KnownTracks(np.zeros((2, 4)), np.diag([1.0, 1.0, 0.01, 0.01]), 0.0)
            got = tracker(PLANE, initiation=Initiation(speed=0.1)).run(scans, known)
            found += (got.scan == 24).sum()
        ids.append(found / 8)
    assert min(ids) > 2.8 and max(ids) < 3.2


def test_placing_many_is_locating_each():
    sensor = ScanSensor(make_sensor("range-bearing", sigma=(5.0, 0.2)))
    scan = Scans.from_arrays([0.0], [[[100.0, 1.0], [70.0, -2.5]]], sensor, sensor_states=[3.0, 4, 0, 0]).scan(0)
    mean, cov = place_detections(sensor, scan, scan.detections, 7.0)
    for z, m, P in zip(scan.detections, mean, cov, strict=True):
        where, spread = sensor.model.locate(sensor.model, z, sensor.noise, scan.sensor_state)
        np.testing.assert_allclose(m[:2], where, rtol=1e-9)
        np.testing.assert_allclose(P[:2, :2], spread, rtol=1e-6)
        np.testing.assert_array_equal(P[2:, 2:], 49 * np.eye(2))
