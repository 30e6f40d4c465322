"""Distributed PMHT: the centre as a limit, one target as a Kalman filter, rounds, faults, bytes, scenes."""

from dataclasses import replace

import numpy as np
import pytest

from jink.envs.networks import geometric, line, metropolis_weights
from jink.envs.scene_library import get_scene
from jink.envs.scenery.regions import Box
from jink.envs.scenery.scene_scans import scene_scans
from jink.envs.scenery.scene_sensors import SceneSensor
from jink.envs.scenes import simulate_scene
from jink.estimators.metrics import disagreement, gospa
from jink.estimators.motions.cartesian import constant_velocity
from jink.estimators.multitarget.consensus import Consensus
from jink.estimators.multitarget.distributed import DistributedPmht
from jink.estimators.multitarget.faults import Faults
from jink.estimators.multitarget.network_state import frames_of
from jink.estimators.multitarget.pmht import KnownTracks, Pmht
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scans
from jink.estimators.sensors import position

MOTION = constant_velocity(2, acceleration_density=0.5)
NETWORK = get_scene("sensor-network-v0").network
SENSING = NETWORK.sensing


def run_scene(seed, duration=30.0, **changes):
    """The six radars of the library, shortened: data, scans, known tracks, truth at distinct times."""
    scene = get_scene("sensor-network-v0")
    scene = replace(scene, duration=duration, sensors=tuple(replace(one, **changes) for one in scene.sensors))
    data = simulate_scene(scene, seed)
    rng = np.random.default_rng((seed, 1))
    sigma = np.array([50.0, 50.0, 5.0, 5.0])
    state = np.hstack([data.truth.position[:, 0], data.truth.velocity[:, 0]])
    known = KnownTracks(state + sigma * rng.standard_normal(state.shape), np.diag(sigma**2), float(data.times[0]))
    first = np.unique(data.times, return_index=True)[1]
    return data, scene_scans(data), known, data.truth.position[:, first]


def linear_scans(seed, sensors=4, steps=8, targets=2, clutter=0.0, detection=1.0):
    """Position sensors with different noise and two targets 60 m apart, in a box of 400 m."""
    rng = np.random.default_rng(seed)
    kinds = tuple(
        ScanSensor(position(2, (3.0 + s, 5.0 - s)), detection=detection, clutter=clutter, volume=160_000.0)
        for s in range(sensors)
    )
    start = np.array([[0.0, 0.0, 4.0, 1.0], [0.0, 60.0, 4.0, -1.0]])[:targets]
    times, owner, found = [], [], []
    for k in range(steps):
        places = start[:, :2] + 1.5 * k * start[:, 2:]
        for s, kind in enumerate(kinds):
            seen = places[rng.random(targets) < detection] if detection < 1 else places
            noise = rng.standard_normal(seen.shape) * kind.model.sigma
            false = rng.uniform(-200.0, 200.0, (rng.poisson(clutter), 2))
            times.append(1.5 * k)
            owner.append(s)
            found.append(np.vstack([seen + noise, false]))
    known = KnownTracks(start + np.array([3.0, -2.0, 0.5, 0.5]), np.diag([25.0, 25.0, 4.0, 4.0]), 0.0)
    return Scans.from_arrays(times, found, kinds, sensor=owner), known


def kalman(scans, known, q):
    """Information filter of one target with all detections: means and covariances at each time, x y vx vy."""
    x, P = known.mean[0], known.cov[0]
    H = np.hstack([np.eye(2), np.zeros((2, 2))])
    means, covs, before = [], [], known.time
    for frame in frames_of(list(scans)):
        dt, before = frame[0].time - before, frame[0].time
        F = np.block([[np.eye(2), dt * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
        x, P = F @ x, F @ P @ F.T + q * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2))
        Omega, q_vector = np.linalg.inv(P), np.linalg.solve(P, x)
        for scan in frame:
            for z in scan.detections:
                W = np.linalg.inv(scan.noise)
                Omega, q_vector = Omega + H.T @ W @ H, q_vector + H.T @ W @ z
        P = np.linalg.inv(Omega)
        x = P @ q_vector
        means.append(x)
        covs.append(P)
    return np.array(means), np.array(covs)


# --- limits ---


@pytest.mark.parametrize("order", ["V1", "V2"])
@pytest.mark.parametrize("adaptive", [True, False])
def test_one_sure_target_on_a_complete_network_is_the_centralised_filter(order, adaptive):
    """Complete graph, equal weights, omega = N, one round; however many iterations and times sent anew."""
    scans, known = linear_scans(0, targets=1)
    means, covs = kalman(scans, known, 0.5)
    network = Consensus(np.full((4, 4), 0.25), 1, "N")
    for exchanged, iterations in ((1, 1), (3, 2)):
        tracker = DistributedPmht(
            MOTION, network, range(4), order, exchanged=exchanged, iterations=iterations, gate=None, adaptive=adaptive
        )
        found = tracker.run(scans, known)
        states = np.concatenate([found.position, found.velocity], axis=-1)
        np.testing.assert_allclose(states, np.broadcast_to(means, states.shape), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.covariance, np.broadcast_to(covs, found.covariance.shape), atol=1e-9)


def test_in_clutter_the_fused_iterations_of_a_complete_network_are_those_of_the_centre():
    scans, known = linear_scans(1, clutter=3.0, detection=0.8)
    network = Consensus(np.full((4, 4), 0.25), 1, "safe")
    options = {"order": "V2", "iterations": 4, "exchanged": 3}
    found = DistributedPmht(MOTION, network, range(4), **options).run(scans, known)
    centre = DistributedPmht.centralised(MOTION, 4, **options).run(scans, known)
    for name in ("position", "velocity", "smoothed_position"):
        whole = np.broadcast_to(getattr(centre, name), getattr(found, name).shape)
        np.testing.assert_allclose(getattr(found, name), whole, atol=1e-8)


@pytest.mark.parametrize("adaptive", [True, False])
def test_iterations_of_one_node_are_those_of_plain_em(adaptive):
    """One time, two targets, four sensors in clutter, against loops over detections; a V1 pass ends with an E-step."""
    scans, known = linear_scans(6, steps=1, clutter=3.0, detection=0.8)
    H = np.hstack([np.eye(2), np.zeros((2, 2))])
    x, P = known.mean.copy(), known.cov.copy()
    for _ in range(3):
        Omega = [np.linalg.inv(one) for one in known.cov]
        q = [np.linalg.solve(one, mean) for one, mean in zip(known.cov, known.mean, strict=True)]
        for scan in scans:
            W, density = np.linalg.inv(scan.noise), 3.0 / 160_000.0
            for z in scan.detections:
                like = []
                for mean, cov in zip(x, P, strict=True):
                    S = scan.noise + H @ cov @ H.T if adaptive else scan.noise
                    e = z - H @ mean
                    like.append(0.8 * np.exp(-0.5 * e @ np.linalg.solve(S, e)) / np.sqrt(np.linalg.det(2 * np.pi * S)))
                for m in range(2):
                    w = like[m] / (density + sum(like))
                    Omega[m], q[m] = Omega[m] + w * H.T @ W @ H, q[m] + w * H.T @ W @ z
        P = np.array([np.linalg.inv(one) for one in Omega])
        x = np.array([cov @ one for cov, one in zip(P, q, strict=True)])
    options = {"gate": None, "correction": False, "adaptive": adaptive}
    for order, iterations in (("V1", 2), ("V2", 3)):
        tracker = DistributedPmht.centralised(MOTION, 4, order=order, iterations=iterations, **options)
        found = tracker.run(scans, known)
        np.testing.assert_allclose(found.position[0, :, 0], x[:, :2], rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(found.covariance[0, :, 0], P, rtol=1e-9, atol=1e-12)


def test_smoothing_is_that_of_all_scans_when_the_window_holds_them():
    """One sure target: smoothed path = Rauch-Tung-Striebel, here by least squares over the whole path."""
    scans, known = linear_scans(2, steps=5, targets=1)
    found = DistributedPmht.centralised(MOTION, 4, window=5, gate=None).run(scans, known)
    n, T, dt = 4, 5, 1.5
    F = np.block([[np.eye(2), dt * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
    W = np.linalg.inv(0.5 * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2)))
    A, b = np.zeros((T * n, T * n)), np.zeros(T * n)
    A[:n, :n], b[:n] = np.linalg.inv(known.cov[0]), np.linalg.solve(known.cov[0], known.mean[0])
    H = np.hstack([np.eye(2), np.zeros((2, 2))])
    for k, frame in enumerate(frames_of(list(scans))):
        own = slice(k * n, (k + 1) * n)
        if k:
            step = np.zeros((n, T * n))
            step[:, own], step[:, (k - 1) * n : k * n] = np.eye(n), -F
            A += step.T @ W @ step
        for scan in frame:
            A[own, own] += H.T @ np.linalg.solve(scan.noise, H)
            b[own] += H.T @ np.linalg.solve(scan.noise, scan.detections[0])
    path = np.linalg.solve(A, b).reshape(T, n)
    np.testing.assert_allclose(found.smoothed_position[0, 0], path[:, :2], atol=1e-8)
    np.testing.assert_allclose(found.smoothed_velocity[0, 0], path[:, 2:], atol=1e-8)


def test_nodes_come_to_one_estimate_with_rounds():
    _, scans, known, _ = run_scene(0, 12.0)
    apart = []
    for rounds in (1, 10, 60):
        network = Consensus(metropolis_weights(NETWORK), rounds)
        apart.append(disagreement(DistributedPmht(MOTION, network, SENSING).run(scans, known).position).mean())
    assert apart[0] > 4 * apart[1] > 100 * apart[2]


# --- what must not matter ---


def test_numbers_of_targets_and_order_of_detections_are_no_matter():
    _, scans, known, _ = run_scene(1, 8.0)
    network = Consensus(metropolis_weights(NETWORK), 5)
    tracker = DistributedPmht(MOTION, network, SENSING, order="V2", iterations=2)
    found = tracker.run(scans, known)
    order = [2, 0, 1]
    turned = tracker.run(scans, KnownTracks(known.mean[order], known.cov[order], known.time))
    np.testing.assert_allclose(turned.position, found.position[:, order], rtol=1e-9)
    rng = np.random.default_rng(0)
    mixed = Scans.from_arrays(
        scans.times, [rng.permutation(scan.detections) for scan in scans], scans.sensors, sensor=scans.sensor,
        sensor_states=scans.sensor_states, noise=scans.noise,
    )  # fmt: skip
    np.testing.assert_array_equal(tracker.run(mixed, known).position, found.position)


def test_a_loop_of_steps_is_a_run():
    _, scans, known, _ = run_scene(2, 16.0)
    tracker = DistributedPmht(MOTION, Consensus(metropolis_weights(NETWORK), 5), SENSING, window=3)
    whole = tracker.run(scans, known)
    state = tracker.start(scans.sensors, known)
    for k, frame in enumerate(frames_of(list(scans))):
        state, found = tracker.step(state, frame)
        assert (found.retired is not None) == (k >= 3)
        np.testing.assert_array_equal(found.mean[..., [0, 2]], whole.position[:, :, k])
        assert found.sent_bytes == whole.sent_bytes[k]


@pytest.mark.parametrize("exchanged", [1, 3])
def test_targets_may_come_and_go(exchanged):
    """A target far from the others, admitted after five times and dismissed after ten, is followed as if alone."""
    scans, known = linear_scans(7, steps=12, clutter=1.0)
    network = Consensus(metropolis_weights(line(4)), 3)
    tracker = DistributedPmht(MOTION, network, range(4), exchanged=exchanged)
    frames = frames_of(list(scans))
    first, second = (KnownTracks(known.mean[[m]], known.cov[[m]], 0.0) for m in (0, 1))
    state = tracker.start(scans.sensors, first)
    alone = None
    for k, frame in enumerate(frames):
        if k == 5:
            late = KnownTracks(
                second.mean + np.outer(1.0, [*(state.time * second.mean[0, 2:]), 0.0, 0.0]), second.cov, state.time
            )
            state, alone = tracker.admit(state, late), tracker.start(scans.sensors, late)
            assert state.ids.tolist() == [1, 2]
        if k == 10:
            state = tracker.dismiss(state, [1])
            assert state.ids.tolist() == [2]
        state, found = tracker.step(state, frame)
        if k >= 5:
            alone, lonely = tracker.step(alone, frame)
            # 60 m apart with sigmas of 3 to 6 m: the other target is no candidate.
            np.testing.assert_allclose(found.mean[:, -1], lonely.mean[:, 0], rtol=1e-3, atol=0.2)
    again = tracker.admit(state, KnownTracks(known.mean, known.cov, state.time))
    assert again.ids.tolist() == [2, 3, 4]
    with pytest.raises(ValueError, match="admit: known must be of 16"):
        tracker.admit(state, known)


# --- faults ---


BAD_DAYS = Faults(
    message_loss=0.3, link_failure=0.2, dead=((SENSING[1], 10.0, 20.0),), delays=((SENSING[2], 3),), seed=2
)


@pytest.mark.parametrize("order", ["V1", "V2"])
def test_faults_leave_estimates_finite_and_consistent(order):
    squares = []
    network = Consensus(metropolis_weights(NETWORK), 10, "safe", BAD_DAYS)
    for seed in range(3):
        data, scans, known, truth = run_scene(seed, 40.0)
        found = DistributedPmht(MOTION, network, SENSING, order).run(scans, known)
        assert np.isfinite(found.position).all()
        assert np.isfinite(found.covariance).all()
        assert found.trouble == 0
        off = found.position - truth
        squares.append(np.einsum("nmfi,nmfij,nmfj->nmf", off, np.linalg.inv(found.covariance[..., :2, :2]), off))
        gone = gospa(found.position[0], truth, 300.0).missed_count
        assert gone.max() == 0
    # Two degrees of freedom; targets are straight and the filter allows for accelerations, so it stays below.
    assert np.mean(squares) < 2.0
    assert np.mean(squares, axis=(0, 2)).max() < 6.0


def test_a_node_that_returns_recovers():
    dead = SENSING[1]
    faults = Faults(dead=((dead, 6.0, 20.0),))
    _, scans, known, truth = run_scene(3, 30.0)
    weights = metropolis_weights(NETWORK)
    hurt = DistributedPmht(MOTION, Consensus(weights, 10, faults=faults), SENSING).run(scans, known)
    well = DistributedPmht(MOTION, Consensus(weights, 10), SENSING).run(scans, known)
    spread = np.sqrt(hurt.covariance[dead, :, :, 0, 0] / well.covariance[dead, :, :, 0, 0]).mean(axis=0)
    assert spread[9] > 1.8  # 18 s: predicted for 14 s
    assert spread[12] < 1.25  # 24 s, two exchanges later
    assert np.linalg.norm(hurt.position[dead] - truth, axis=-1)[:, 12:].max() < 120


def test_what_a_dead_node_would_have_seen_never_counts():
    """Not even later, when past times are sent anew: other detections at the dead radar, the same bits everywhere."""
    _, scans, known, _ = run_scene(4, 20.0)
    network = Consensus(metropolis_weights(NETWORK), 4, faults=Faults(dead=((SENSING[0], 4.0, 12.0),)))
    tracker = DistributedPmht(MOTION, network, SENSING, exchanged=3)
    other = Scans.from_arrays(
        scans.times,
        [one.detections + 5.0 * (one.sensor == 0 and 4 <= one.time < 12) for one in scans],
        scans.sensors, sensor=scans.sensor, sensor_states=scans.sensor_states, noise=scans.noise,
    )  # fmt: skip
    np.testing.assert_array_equal(tracker.run(other, known).position, tracker.run(scans, known).position)
    whole = replace(tracker, consensus=replace(network, faults=Faults()))
    assert (whole.run(other, known).position != whole.run(scans, known).position).any()


def test_silence_is_survived():
    """No message arrives, no radar finds anything: finite predictions everywhere."""
    _, scans, known, _ = run_scene(0, 20.0, detection=0.0, clutter=0.0)
    assert scans.counts.sum() == 0
    network = Consensus(metropolis_weights(NETWORK), 3, faults=Faults(message_loss=1.0))
    found = DistributedPmht(MOTION, network, SENSING, order="V2").run(scans, known)
    kept = known.mean[:, None, :2] + known.mean[:, None, 2:] * found.times[None, :, None]
    np.testing.assert_allclose(found.position, np.broadcast_to(kept, found.position.shape), rtol=1e-9)
    assert (np.diff(found.covariance[..., 0, 0], axis=-1) > 0).all()


# --- bytes, clocks, scenes ---


def test_messages_are_counted():
    _, scans, known, _ = run_scene(0, 10.0)
    weights, links = metropolis_weights(NETWORK), int(NETWORK.adjacency.sum())
    one = DistributedPmht(MOTION, Consensus(weights, 7, "b"), SENSING).run(scans, known)
    np.testing.assert_array_equal(one.messages, 7 * links)
    np.testing.assert_array_equal(one.sent_bytes, 7 * links * 29 * 8 * 3)
    many = DistributedPmht(MOTION, Consensus(weights, 7, "b"), SENSING, "V2", exchanged=2, iterations=3).run(
        scans, known
    )
    np.testing.assert_array_equal(many.messages[1:], 6 * one.messages[1:])
    assert many.messages[0] == 3 * one.messages[0]  # nothing older to send anew
    alone = DistributedPmht.centralised(MOTION, 6).run(scans, known)
    assert alone.sent_bytes.sum() == 0


def test_sensors_on_clocks_of_their_own():
    """Two radars that scan in turn, at the ends of a line of three nodes."""
    data = simulate_scene(replace(get_scene("crossing-v0"), duration=30.0), 0)
    state = np.hstack([data.truth.position[:, 0], data.truth.velocity[:, 0]])
    known = KnownTracks(state, np.diag([1e4, 1e4, 25.0, 25.0]), 0.0)
    found = DistributedPmht(MOTION, Consensus(metropolis_weights(line(3)), 4), (0, 2)).run(scene_scans(data), known)
    assert found.times.tolist() == data.times.tolist()
    assert gospa(found.position[1], data.truth.position, 300.0).missed_count.sum() == 0
    assert np.linalg.norm(found.position - data.truth.position, axis=-1)[:, :, 15:].mean() < 60


def test_own_and_position_sensors_may_differ():
    """A radar at one node, a position sensor at the other."""
    scene = replace(get_scene("crossing-v0"), duration=20.0)
    box = SceneSensor("position", (40.0, 40.0), Box((-1e4, 0.0), (1e4, 2e4)), (500.0, 0.0), period=2.0, clutter=2.0)
    data = simulate_scene(replace(scene, sensors=(scene.sensors[0], box)), 0)
    state = np.hstack([data.truth.position[:, 0], data.truth.velocity[:, 0]])
    known = KnownTracks(state, np.diag([1e4, 1e4, 25.0, 25.0]), 0.0)
    found = DistributedPmht(MOTION, Consensus(metropolis_weights(line(2)), 2), (0, 1)).run(scene_scans(data), known)
    first = np.unique(data.times, return_index=True)[1]
    assert np.linalg.norm(found.position - data.truth.position[:, first], axis=-1)[:, :, 5:].mean() < 50


def test_ten_rounds_are_better_than_one_sensor_and_near_the_centre():
    """Three scenes with clutter; the bar is 1.6 times the centralised tracker."""
    network = Consensus(metropolis_weights(NETWORK), 10)
    motion = constant_velocity(2, acceleration_density=0.1)
    shares = []
    for seed in range(3):
        _, scans, known, truth = run_scene(seed, 40.0)
        found = DistributedPmht(motion, network, SENSING).run(scans, known)
        nodes = np.mean([gospa(one, truth, 300.0).distance[5:].mean() for one in found.position])
        single = []
        for sensor in range(6):
            own = DistributedPmht.centralised(motion, 6).run(scans.of_sensors([sensor]), known)
            single.append(gospa(own.position[0], truth, 300.0).distance[5:].mean())
        _, paths = Pmht(motion, initiation=None).run(scans, known).sets()
        centre = gospa(paths[:, 5::6], truth, 300.0).distance[5:].mean()
        assert nodes < 0.8 * min(single)
        shares.append(nodes / centre)
    assert np.mean(shares) < 1.3


def tracker_of(**changes):
    options = {"node_of": SENSING, **changes}
    return DistributedPmht(MOTION, Consensus(metropolis_weights(NETWORK), 2), **options)


def step_back():
    scans, known = linear_scans(0, steps=2)
    tracker = DistributedPmht.centralised(MOTION, 4)
    frames = frames_of(list(scans))
    state, _ = tracker.step(tracker.start(scans.sensors, known), frames[1])
    tracker.step(state, frames[0])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: tracker_of(order="V3"), "order must be one of V1, V2; got 'V3'"),
        (lambda: tracker_of(exchanged=9), "exchanged must be an integer from 1 to 5; got 9"),
        (lambda: tracker_of(window=0), "window must be an integer >= 1"),
        (lambda: tracker_of(iterations=True), "iterations must be an integer >= 1"),
        (lambda: tracker_of(node_of=(18,)), r"node_of must name nodes 0\.\.17"),
        (lambda: tracker_of(gate=0.0), "gate must be a number > 0"),
        (lambda: tracker_of().start(linear_scans(0)[0].sensors, linear_scans(0)[1]), "sensors must be one per entry"),
        (step_back, r"scan must be of 1\.5 s or later"),
    ],
)
def test_refusals(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_larger_network_of_relays_only_adds_nodes():
    """Geometric network with one sensor: every node ends at its estimate once rounds are many."""
    network = geometric(10, 500.0, 1000.0, seed=1, sensing=[4])
    scans, known = linear_scans(5, sensors=1, clutter=2.0, detection=0.9)
    consensus = Consensus(metropolis_weights(network), 300)
    found = DistributedPmht(MOTION, consensus, (4,)).run(scans, known)
    alone = DistributedPmht.centralised(MOTION, 1).run(scans, known)
    np.testing.assert_allclose(found.position, np.broadcast_to(alone.position, found.position.shape), atol=1e-3)
