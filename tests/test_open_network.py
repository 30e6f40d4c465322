"""A network that finds its targets itself: matching, births, ends, faults, bytes."""

from types import SimpleNamespace

import numpy as np
import pytest

from jink.envs.networks import line, metropolis_weights
from jink.estimators.metrics import identities
from jink.estimators.motions.cartesian import constant_velocity
from jink.estimators.multitarget.consensus import Consensus
from jink.estimators.multitarget.distributed import DistributedPmht
from jink.estimators.multitarget.faults import Faults
from jink.estimators.multitarget.gnn import Gnn
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.network_state import frames_of
from jink.estimators.multitarget.network_step import NetworkStep
from jink.estimators.multitarget.open_network import OpenNetwork, match
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scans
from jink.estimators.sensors import position

MOTION = constant_velocity(2, acceleration_density=0.05)
RULES = Initiation(speed=5.0, patience=5.0)
NODES, STEPS = 4, 40
# x, y, vx, vy, first and last step: the second comes at 10, the first goes at 25
TARGETS = ((0.0, 0.0, 5.0, 0.0, 0, 25), (100.0, 80.0, -3.0, 0.0, 10, 40))


def make_scans(seed, sensors=(0, 2), clutter=1.0):
    """Sensors of 3 m, P_D 0.9, at steps of 1 s; truth (2, steps, 2), NaN where a target is not there."""
    rng = np.random.default_rng(seed)
    kind = ScanSensor(position(2, 3.0), 0.9, clutter, 400.0 * 400.0)
    truth = np.full((len(TARGETS), STEPS, 2), np.nan)
    for n, (x, y, vx, vy, first, last) in enumerate(TARGETS):
        k = np.arange(first, last)
        truth[n, k] = np.stack([x + vx * k, y + vy * k], axis=1)
    times, owner, found = [], [], []
    for k in range(STEPS):
        for s in range(len(sensors)):
            there = truth[:, k][np.isfinite(truth[:, k, 0])]
            seen = there[rng.random(len(there)) < 0.9]
            false = rng.uniform(-200, 200, (rng.poisson(clutter), 2))
            times.append(float(k))
            owner.append(s)
            found.append(np.vstack([seen + 3.0 * rng.standard_normal(seen.shape), false]))
    return Scans.from_arrays(times, found, (kind,) * len(sensors), sensor=owner), truth


def make_network(faults=None, **options):
    weights = metropolis_weights(line(NODES))
    consensus = Consensus(weights, 20, faults=faults or Faults())
    return OpenNetwork(DistributedPmht(MOTION, consensus, (0, 2)), RULES, patience=3.0, **options)


def test_targets_begin_and_end_under_one_number_everywhere():
    scans, truth = make_scans(0)
    found = make_network().run(scans)
    assert found.mean.shape[0] == NODES
    for node in range(NODES):
        ids, tracks = found.sets(node)
        kept = identities(tracks, truth, 15.0)
        assert kept.switches.tolist() == [0, 0]
        assert kept.breaks.tolist() == [0, 0]
        # Confirmation takes at least three scans of 25 and 30; two more are allowed for.
        assert (kept.held > 0.8).all()
        assert kept.false_tracks == 0
        assert len(ids) == 2
    # The first is silent from 25 on: its nodes' tracks end within 5 s and the network's 3 s later.
    last = found.times[found.frame[found.id == found.id.min()]].max()
    assert 25.0 <= last <= 34.0


def test_run_is_a_loop_of_steps_and_a_step_leaves_its_state_alone():
    scans, _ = make_scans(1)
    network = make_network()
    whole = network.run(scans)
    state = network.start(scans.sensors, 0.0)
    begun = ended = 0
    for k, frame in enumerate(frames_of(list(scans))):
        before = state
        state, found = network.step(before, frame)
        again, _ = network.step(before, frame)
        np.testing.assert_array_equal(again.network.last, state.network.last)
        np.testing.assert_array_equal(found.mean, whole.mean[:, whole.frame == k])
        begun, ended = begun + len(found.begun), ended + len(found.ended)
    assert begun - ended == len(state.network.ids)
    assert begun == len(np.unique(whole.id))


def test_a_node_that_dies_and_lost_messages_cost_no_number():
    scans, truth = make_scans(2)
    found = make_network(Faults(message_loss=0.3, dead=((2, 15.0, 20.0),))).run(scans)
    kept = identities(found.sets(0)[1], truth, 15.0)
    assert kept.switches.tolist() == [0, 0]
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.cov).all()
    # After its return the dead node agrees with its neighbour again.
    late = found.times[found.frame] > 30.0
    np.testing.assert_allclose(found.mean[2, late, :2], found.mean[1, late, :2], atol=3.0)


def test_announcements_are_counted():
    scans, _ = make_scans(3)
    network = make_network()
    state = network.start(scans.sensors, 0.0)
    for frame in frames_of(list(scans)):
        before = state
        state, found = network.step(state, frame)
        _, plain = network.tracker.step(before.network, frame)
        said = found.messages - plain.messages
        # Each of two sensing nodes at most speaks once, over three links both ways.
        assert said in (0, 6, 12)
        assert (found.sent_bytes - plain.sent_bytes > 0) == (said > 0)


def test_nothing_to_see_is_no_track():
    scans, _ = make_scans(4)
    empty = Scans.from_arrays(scans.times, [np.zeros((0, 2))] * len(scans), scans.sensors, sensor=scans.sensor)
    found = make_network().run(empty)
    assert found.id.size == 0
    assert found.sets()[1].shape == (0, STEPS, 2)
    assert make_network().run(scans.select(np.zeros(len(scans), dtype=bool))).times.size == 0


def test_nodes_may_use_another_tracker():
    scans, truth = make_scans(5)
    found = make_network(local=Gnn(MOTION, initiation=RULES)).run(scans)
    assert identities(found.sets(1)[1], truth, 15.0).held.min() > 0.8


def test_match_is_one_to_one_older_first_then_nearest():
    cov = np.eye(4)[None]
    targets = np.array([[0.0, 0, 0, 0], [3.0, 0, 0, 0], [100.0, 0, 0, 0]])
    covs = np.repeat(cov, 3, axis=0)
    # Alone the track belongs to the older target, though the younger is nearer.
    assert match(np.array([[2.5, 0, 0, 0]]), cov, targets, covs, 25.0).tolist() == [0]
    # Two tracks: both targets, each the nearest.
    two = np.array([[3.1, 0, 0, 0], [0.1, 0, 0, 0]])
    assert match(two, covs[:2], targets, covs, 25.0).tolist() == [1, 0]
    # As many pairs as possible: the second reaches only the younger.
    two = np.array([[1.0, 0, 0, 0], [8.0, 0, 0, 0]])
    assert match(two, covs[:2], targets, covs, 25.0).tolist() == [0, 1]
    # D^2 = 50 / 2 is not below 25.
    assert match(np.array([[50**0.5, 0, 0, 0]]), cov, targets[:1], covs[:1], 25.0).tolist() == [-1]
    assert match(np.zeros((0, 4)), np.zeros((0, 4, 4)), targets, covs, 25.0).size == 0
    assert match(two, covs[:2], targets[:0], covs[:0], 25.0).tolist() == [-1, -1]


@pytest.mark.parametrize("name", ["near", "patience"])
def test_refusals(name):
    with pytest.raises(ValueError, match=f"OpenNetwork: {name} must be a number > 0.*; got 0"):
        OpenNetwork(make_network().tracker, **{name: 0})


def test_a_covariance_that_rounding_spoilt_loses_its_correlations():
    good, spoilt = np.array([[4.0, 1.0], [1.0, 9.0]]), np.array([[1.0, 2.0], [2.0, 1.0]])
    step = SimpleNamespace(trouble=0)
    found = NetworkStep._sound(step, np.stack([good, spoilt, np.full((2, 2), np.nan)])[None])
    np.testing.assert_array_equal(found[0], [good, np.eye(2), 1e30 * np.eye(2)])
    assert step.trouble == 2
