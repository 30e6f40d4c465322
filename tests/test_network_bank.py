"""Banks of modes in a network: one mode as a limit, an IMM as second opinion, the centre, turns, faults, bytes."""

import numpy as np
import pytest

from jink.envs.networks import line, metropolis_weights
from jink.estimators.markov import MarkovChain
from jink.estimators.motions import constant_velocity, known_turn
from jink.estimators.multitarget.consensus import Consensus, message_bytes
from jink.estimators.multitarget.distributed import DistributedPmht
from jink.estimators.multitarget.faults import Faults
from jink.estimators.multitarget.gnn import Gnn
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.network_bank import ModeStates, foreseen, informed, merged
from jink.estimators.multitarget.open_network import OpenNetwork
from jink.estimators.multitarget.pmht import KnownTracks
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scans
from jink.estimators.multitarget.tables import make_moving
from jink.estimators.sensors import position

ONE = constant_velocity(2, acceleration_density=0.5)
BANK = tuple(known_turn(rate, acceleration_density=0.02) for rate in (0.0, 0.15, -0.15))
CHAIN = MarkovChain.from_sojourns([20.0, 10.0, 10.0])
KNOWN = KnownTracks([[0.0, 0.0, 15.0, 0.0]], np.diag([4.0, 4.0, 1.0, 1.0]), 0.0)


def turning_scans(seed, sensors=1, steps=60, clutter=0.0):
    """Straight for 20 s, 20 s of a turn, straight; one detection per sensor and scan; and the truth (steps, 2)."""
    rng = np.random.default_rng(seed)
    times = np.arange(float(steps))
    course = np.cumsum(np.where((times > 20) & (times < 40), 0.15, 0.0))
    truth = np.cumsum(15.0 * np.stack([np.cos(course), np.sin(course)], 1), axis=0) - [15.0, 0.0]
    kinds = tuple(ScanSensor(position(2, 2.0 + s), clutter=clutter, volume=4e6) for s in range(sensors))
    found, when, owner = [], [], []
    for k in range(steps):
        for s in range(sensors):
            seen = truth[k] + (2.0 + s) * rng.standard_normal((1, 2))
            false = rng.uniform(-1000, 1000, (rng.poisson(clutter), 2))
            found.append(np.vstack([seen, false]))
            when.append(times[k])
            owner.append(s)
    return Scans.from_arrays(when, found, kinds, sensor=owner), truth


def two_sensing(rounds=10, **options):
    return Consensus(metropolis_weights(line(4)), rounds, **options)


@pytest.mark.parametrize("order", ["V1", "V2"])
def test_identical_modes_are_one_motion(order):
    scans, _ = turning_scans(1, sensors=2, steps=15, clutter=3.0)
    plain = DistributedPmht(ONE, two_sensing(), (0, 3), order=order, iterations=2).run(scans, KNOWN)
    chain = MarkovChain.per_step([[0.9, 0.1], [0.3, 0.7]])
    same = DistributedPmht((ONE, ONE), two_sensing(), (0, 3), order=order, iterations=2, chain=chain).run(scans, KNOWN)
    np.testing.assert_allclose(same.position, plain.position, atol=1e-6)
    np.testing.assert_allclose(same.covariance, plain.covariance, atol=1e-6)
    np.testing.assert_allclose(same.smoothed_position, plain.smoothed_position, atol=1e-6)
    assert (same.sent_bytes > plain.sent_bytes).all()


def test_one_node_and_one_sure_target_are_an_interacting_multiple_model():
    scans, _ = turning_scans(2)
    fused = DistributedPmht.centralised(BANK, 1, chain=CHAIN, correction=False).run(scans, KNOWN)
    wanted = Gnn(BANK, CHAIN, initiation=None).run(scans, KNOWN)
    np.testing.assert_allclose(fused.position[0, 0], wanted.mean[:, :2], atol=1e-6)
    np.testing.assert_allclose(fused.covariance[0, 0], wanted.cov, atol=1e-6)


def test_evidence_of_a_mode_is_its_likelihood():
    rng = np.random.default_rng(3)
    mean, A = rng.normal(size=(2, 2)) * 3, rng.normal(size=(2, 2, 2))
    cov, H, R, z = A @ np.swapaxes(A, 1, 2) + np.eye(2), np.array([[1.0, 0.5]]), 0.7, 1.3
    got, bad = informed(
        ModeStates(mean + 1e4, cov, np.array([0.4, 0.6])), (H.T * (z + H @ [1e4, 1e4]) / R)[:, 0], H.T @ H / R
    )
    likelihood = []
    for j in range(2):
        S = (H @ cov[j] @ H.T)[0, 0] + R
        likelihood.append(np.exp(-0.5 * (z - (H @ mean[j])[0]) ** 2 / S) / np.sqrt(S))
    want = np.array([0.4, 0.6]) * likelihood
    np.testing.assert_allclose(got.probs, want / want.sum(), rtol=1e-6)
    assert not bad


def test_prediction_and_its_covariance_with_the_past_are_those_of_a_mixture():
    rng = np.random.default_rng(4)
    chain = np.array([[0.8, 0.1, 0.1], [0.2, 0.7, 0.1], [0.3, 0.1, 0.6]])
    A = rng.normal(size=(3, 4, 4))
    start = ModeStates(rng.normal(size=(3, 4)) * 5, A @ np.swapaxes(A, 1, 2), np.array([0.2, 0.5, 0.3]))
    ahead, cross = foreseen(make_moving(BANK), chain, 2.0, start)
    mode = rng.choice(3, 400_000, p=start.probs)
    factor = np.linalg.cholesky(start.cov)
    x = start.mean[mode] + np.einsum("kab,kb->ka", factor[mode], rng.normal(size=(len(mode), 4)))
    after = (np.cumsum(chain[mode], axis=1) < rng.random((len(mode), 1))).sum(axis=1)
    np.testing.assert_allclose(ahead.probs, np.bincount(after) / len(mode), atol=4e-3)
    F = np.zeros((3, 4, 4))
    for j, one in enumerate(BANK):
        for c in range(4):
            out = np.zeros(4)
            one.transition(np.eye(4)[c], 2.0, np.array(one.params), out)
            F[j, :, c] = out
    moved = np.einsum("kab,kb->ka", F[after], x)
    mean, _ = merged(ahead)
    np.testing.assert_allclose(mean, moved.mean(axis=0), atol=0.05)
    sampled = (x - x.mean(axis=0)).T @ (moved - moved.mean(axis=0)) / len(x)
    np.testing.assert_allclose(cross, sampled, atol=0.02 * np.abs(sampled).max())


@pytest.mark.parametrize("order", ["V1", "V2"])
def test_a_complete_network_is_the_centre(order):
    scans, _ = turning_scans(5, sensors=2, steps=40)
    centre = DistributedPmht.centralised(BANK, 2, chain=CHAIN, order=order).run(scans, KNOWN)
    whole = Consensus(np.full((3, 3), 1 / 3), 1, rule="N")
    spread = DistributedPmht(BANK, whole, (0, 2), chain=CHAIN, order=order).run(scans, KNOWN)
    for node in range(3):
        np.testing.assert_allclose(spread.position[node], centre.position[0], atol=1e-6)
        np.testing.assert_allclose(spread.smoothed_position[node], centre.smoothed_position[0], atol=1e-6)


def test_a_bank_follows_turns_that_one_motion_loses_at_every_node():
    off = {"bank": [], "one": [], "smoothed": []}
    for seed in range(4):
        scans, truth = turning_scans(10 + seed, sensors=2, clutter=5.0)
        for name, motion, chain in (("bank", BANK, CHAIN), ("one", ONE, None)):
            got = DistributedPmht(motion, two_sensing(), (0, 3), chain=chain).run(scans, KNOWN)
            off[name].append(np.linalg.norm(got.position[:, 0] - truth, axis=-1).mean(axis=1))
            if name == "bank":
                off["smoothed"].append(np.linalg.norm(got.smoothed_position[:, 0] - truth, axis=-1).mean(axis=1))
    bank, one, smoothed = (np.mean(off[name], axis=0) for name in ("bank", "one", "smoothed"))
    assert (bank < 0.85 * one).all() and (smoothed < 0.95 * bank).all()


def test_faults_leave_a_bank_finite_and_a_node_that_returns_recovers():
    scans, truth = turning_scans(20, sensors=2, clutter=5.0)
    faults = Faults(message_loss=0.3, dead=((3, 15.0, 35.0),), delays=((1, 3),))
    got = DistributedPmht(BANK, two_sensing(faults=faults), (0, 3), chain=CHAIN).run(scans, KNOWN)
    assert np.isfinite(got.position).all() and (np.linalg.eigvalsh(got.covariance) > 0).all()
    off = np.linalg.norm(got.position[:, 0] - truth, axis=-1)
    assert off[3, 34] > 20 and off[3, 40:].mean() < 4 and off[0].mean() < 4


def test_messages_are_as_long_as_what_they_hold():
    # Two modes: two priors and one novelty of 14 reals, two probabilities; the patent's rule adds one.
    assert message_bytes(4, 3, "b", 0, modes=2) == 8 * 3 * (3 * 14 + 2 + 1)
    assert message_bytes(4, 3, "b") == 8 * 3 * 29


def test_targets_that_turn_are_found_and_dismissed():
    scans, truth = turning_scans(30, sensors=2, clutter=2.0)
    tracker = DistributedPmht(BANK, two_sensing(), (0, 3), chain=CHAIN)
    got = OpenNetwork(tracker, Initiation(speed=15.0), patience=5.0).run(scans)
    ids, places = got.sets(2)
    assert len(ids) == 1
    assert np.nanmean(np.linalg.norm(places[0, 10:] - truth[10:], axis=-1)) < 4


def test_refusals():
    with pytest.raises(ValueError, match="chain must have one state per motion, 3; got 2"):
        DistributedPmht(BANK, two_sensing(), (0, 3), chain=MarkovChain.from_sojourns([1.0, 1.0]))
    with pytest.raises(ValueError, match="exchanged must be 1 with a bank"):
        DistributedPmht(BANK, two_sensing(), (0, 3), exchanged=2)
