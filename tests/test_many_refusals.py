"""What trackers of many targets refuse: one sentence with caller, argument, rule, value and remedy."""

import re

import numpy as np
import pandas as pd
import pytest

from jink.estimators.metrics import gospa, identities
from jink.estimators.motions import constant_velocity
from jink.estimators.multitarget.consensus import Consensus
from jink.estimators.multitarget.distributed import DistributedPmht
from jink.estimators.multitarget.exclusive import exclude
from jink.estimators.multitarget.faults import Faults
from jink.estimators.multitarget.gnn import Gnn
from jink.estimators.multitarget.initiation import Initiation
from jink.estimators.multitarget.jpda import Jpda
from jink.estimators.multitarget.open_network import OpenNetwork
from jink.estimators.multitarget.open_tracks import gather_open
from jink.estimators.multitarget.pmht import KnownTracks, Pmht
from jink.estimators.multitarget.scans import Scans, ScanSensor
from jink.estimators.multitarget.weights import metropolis_weights
from jink.estimators.sensors import position

MOTION = constant_velocity(2, acceleration_density=1.0)
SENSOR = ScanSensor(position(2, 5.0), 0.9, 1.0, 1e4)
CENTRE = Consensus(np.ones((1, 1)), 0)
SCANS = Scans.from_arrays([0.0, 1.0], [np.zeros((1, 2)), np.zeros((1, 2))], SENSOR)
SCAN = SCANS.scan(0)
TRACKER = Pmht(MOTION)
KNOWN = KnownTracks(np.zeros((1, 4)), np.eye(4), 0.0)
INDEFINITE = np.eye(4) + 5.0 * np.diag([1.0, 0, 0], 1) + 5.0 * np.diag([1.0, 0, 0], -1)
FRAME = pd.DataFrame({"t": [0.0], "sensor": [1], "x": [0.0], "y": [1.0]})


def network(**options):
    return DistributedPmht(MOTION, CENTRE, (0,), **options)


def step(**parts):
    return TRACKER.step(TRACKER.start(SENSOR, 0.0), SCAN._replace(**parts))


def network_step(**parts):
    tracker = network()
    return tracker.step(tracker.start(SENSOR, KNOWN), [SCAN._replace(**parts)])


REFUSED = [
    (lambda: KnownTracks(np.zeros(4), -np.eye(4), 0.0), "KnownTracks: cov must be finite .* variances >= 0"),
    (lambda: KnownTracks(np.zeros(4), INDEFINITE, 0.0), "KnownTracks: cov must be symmetric and positive semidefinite"),
    (lambda: KnownTracks(np.zeros(4), np.triu(np.ones((4, 4))), 0.0), "KnownTracks: cov must be symmetric"),
    (lambda: KnownTracks([[0.0, 0.0], [1.0]], np.eye(4), 0.0), "KnownTracks: mean must be numbers in rows"),
    (lambda: KnownTracks(np.zeros((2, 4)), np.zeros((3, 4, 4)), 0.0), "KnownTracks: mean must have shape"),
    (lambda: KnownTracks(np.zeros(4), np.eye(4), "x"), "KnownTracks: time must be a number"),
    (lambda: Pmht(5), "Pmht: motion must be one Motion, or several; got 5"),
    (lambda: Pmht("cv"), "Pmht: motion must be one Motion"),
    (lambda: Pmht(None), "Pmht: motion must be one Motion"),
    (lambda: Pmht(MOTION, chain=5), "Pmht: chain must be a MarkovChain, or None; got 5"),
    (lambda: Pmht(MOTION, homothetic=5), "Pmht: homothetic must give as many shares"),
    (lambda: Pmht(MOTION, priors=[]), "Pmht: priors must be one of fixed, updated; got "),
    (lambda: Pmht(MOTION, initiation=5), "Pmht: initiation must be an Initiation, or None; got 5"),
    (lambda: Pmht(MOTION, adaptive=1.5), "Pmht: adaptive must be an integer"),
    (lambda: Gnn(MOTION, initiation="x"), "Gnn: initiation must be an Initiation, or None; got 'x'"),
    (lambda: Gnn("cv"), "Gnn: motion must be one Motion"),
    (lambda: Jpda(MOTION, gate="x"), "Jpda: gate must be a number > 0; got 'x'"),
    (lambda: Initiation(most=1.5), "Initiation: most must be an integer >= 1; got 1.5"),
    (lambda: Initiation(hits=2.5), "Initiation: hits must be an integer from 1 to 5; got 2.5"),
    (lambda: Initiation(hits=6), "Initiation: hits must be an integer from 1 to 5; got 6"),
    (lambda: Initiation(speed="fast"), "Initiation: speed must be a number > 0 and finite; got 'fast'"),
    (lambda: ScanSensor(position(2, 5.0), watches=3), "ScanSensor: watches must be a function"),
    (lambda: ScanSensor(5), "ScanSensor: model must be a Sensor; got 5"),
    (lambda: TRACKER.start([], 0.0), "Pmht.start: sensors must be a ScanSensor, or at least one"),
    (lambda: TRACKER.start(SENSOR, np.nan), "Pmht.start: time must be a number and finite; got nan"),
    (lambda: TRACKER.start(SENSOR, 0.0, 5), "Pmht.start: known must be KnownTracks, or None; got 5"),
    (lambda: TRACKER.run("x"), "Pmht.run: scans must be Scans; got 'x'"),
    (lambda: Gnn(MOTION).run("x"), "Gnn.run: scans must be Scans; got 'x'"),
    (lambda: TRACKER.run(SCANS, KNOWN.__class__(np.zeros(4), np.eye(4), 0.5)), "Pmht.run: known must be of 0 s"),
    (lambda: step(detections=np.zeros((1, 3))), r"Pmht.step: detections of the scan must have shape \(n, 2\)"),
    (lambda: step(detections=np.full((1, 2), np.nan)), "Pmht.step: scan must have detections .* that are finite"),
    (lambda: step(noise=-25.0 * np.eye(2)), "Pmht.step: noise of the scan must be a covariance"),
    (lambda: step(sensor=3), "Pmht.step: scan must be of 0 s or later, sensor 0..0; got 0.0 s, sensor 3"),
    (lambda: network_step(sensor=3), "DistributedPmht.step: scan must be .* sensor 0..0"),
    (lambda: network_step(detections=np.zeros((1, 3))), "DistributedPmht.step: detections of the scan must have shape"),
    (lambda: network().run("x", KNOWN), "DistributedPmht.run: scans must be Scans"),
    (lambda: network().start(SENSOR, 5), "DistributedPmht.start: known must be KnownTracks; got 5"),
    (lambda: DistributedPmht(MOTION, CENTRE, (0.5,)), "DistributedPmht: node_of must name nodes 0..0"),
    (lambda: DistributedPmht(MOTION, 5, (0,)), "DistributedPmht: consensus must be a Consensus; got 5"),
    (lambda: network(annealing=(2.0,)), "DistributedPmht: annealing must be left out with adaptive densities"),
    (lambda: network(homothetic=((0.5, 0.5), (1, 4))), "homothetic must be left out with adaptive densities"),
    (lambda: network(adaptive=False, annealing=(2.0,)), "annealing must come with iterations > 1"),
    (lambda: network(adaptive=False, annealing=(-1,)), "annealing must hold factors >= 1"),
    (lambda: network(annealing="ab"), "DistributedPmht: annealing must be numbers"),
    (lambda: network(adaptive=False, homothetic=((0.5, 0.9), (1, -4))), "DistributedPmht: homothetic must give"),
    (lambda: OpenNetwork(5), "OpenNetwork: tracker must be a DistributedPmht; got 5"),
    (lambda: OpenNetwork(network(), "x"), "OpenNetwork: initiation must be an Initiation; got 'x'"),
    (lambda: OpenNetwork(network(), near="x"), "OpenNetwork: near must be a number > 0; got 'x'"),
    (lambda: OpenNetwork(network()).run("x"), "OpenNetwork.run: scans must be Scans"),
    (lambda: gather_open([], 3, 2).sets(node=9), "OpenTracks.sets: node must be an integer from 0 to 2; got 9"),
    (lambda: Scans.from_arrays([0.0], [np.zeros((1, 2))], SENSOR, sensor=[0.7]), "sensor must hold whole numbers"),
    (lambda: Scans.from_arrays([0.0], [np.zeros((1, 2))], SENSOR, sensor_states=5.0), "sensor_states must have shape"),
    (lambda: Scans.from_arrays([0.0], [np.zeros((1, 2))], SENSOR, noise=np.eye(3)), "noise must have shape"),
    (lambda: Scans.from_arrays([0.0], [np.zeros((1, 2))], []), "from_arrays: sensors must be a ScanSensor"),
    (lambda: Scans.from_arrays(["a"], [np.zeros((1, 2))], SENSOR), "from_arrays: times must be numbers"),
    (lambda: Scans.from_arrays([0.0], 5, SENSOR), "from_arrays: detections must be one array per scan; got 5"),
    (lambda: Scans.from_frame(FRAME, {2: SENSOR}), "from_frame: sensors must name every sensor of the frame; got no 1"),
    (lambda: Scans.from_frame(FRAME, 5), "Scans.from_frame: sensors must be a ScanSensor, or some by name; got 5"),
    (lambda: Scans.from_frame(5, SENSOR), "Scans.from_frame: frame must be a pandas DataFrame; got 5"),
    (lambda: Consensus(np.zeros((0, 0))), "check_weights: weights must be finite with shape .* N >= 1"),
    (lambda: Consensus(np.ones((1, 1)), faults=None), "Consensus: faults must be Faults; got None"),
    (lambda: Consensus(np.ones((1, 1)), rule=[]), "Consensus: rule must be one of"),
    (lambda: Consensus(np.ones((1, 1)), rounds=1.5), "Consensus: rounds must be an integer >= 0; got 1.5"),
    (lambda: Faults(dead=(1, 0, 1)), "Faults: dead must have 3 numbers per row"),
    (lambda: Faults(dead=((0.5, 0, 1),)), "Faults: dead must have whole numbers for nodes"),
    (lambda: Faults(message_loss="x"), "Faults: message_loss must be a number >= 0 and at most 1; got 'x'"),
    (lambda: Faults(seed=1.5), "Faults: seed must be an integer >= 0; got 1.5"),
    (lambda: metropolis_weights([[0, 1], [0, 0]]), "metropolis_weights: adjacency must be symmetric"),
    (lambda: metropolis_weights([[0, 1], [0]]), "metropolis_weights: adjacency must be numbers in rows"),
    (lambda: gospa(np.zeros((1, 2)), np.zeros((1, 2)), 1e200), "gospa: cutoff must have a power"),
    (lambda: gospa(np.zeros((1, 2)), np.zeros((1, 2)), 10.0, 400), "gospa: cutoff must have a power"),
    (lambda: gospa(np.zeros((1, 2)), np.zeros((1, 2)), "5"), "gospa: cutoff must be a number > 0 and finite; got '5'"),
    (
        lambda: identities(np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), 5.0, last=2.5),
        "identities: last must be an integer",
    ),
]


@pytest.mark.parametrize(("call", "sentence"), REFUSED, ids=range(len(REFUSED)))
def test_one_sentence(call, sentence):
    with pytest.raises(ValueError, match=sentence) as caught:
        call()
    # Caller, argument, rule; the value; the remedy.
    assert re.fullmatch(r"[\w.]+: .* must .*; got .*\. [A-Z].*\.", str(caught.value), re.S), caught.value


def test_watches_must_answer_for_each_target():
    sensor = ScanSensor(position(2, 5.0), watches=lambda positions, state: positions > 0)
    with pytest.raises(ValueError, match=r"ScanSensor: watches must return .* shape \(3,\); got shape \(3, 2\)"):
        sensor.detected(np.zeros((3, 2)), np.zeros(4))
    right = ScanSensor(position(2, 5.0), 0.8, watches=lambda positions, state: positions[:, 0] > 0)
    np.testing.assert_array_equal(right.detected(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.zeros(4)), [0.8, 0.0])


def test_numbers_may_name_sensors():
    assert len(Scans.from_frame(FRAME, {1: SENSOR})) == 1


@pytest.mark.parametrize("rounds", [1, 2, 20])
@pytest.mark.parametrize("seed", range(3))
def test_no_detection_is_given_to_more_than_one(seed, rounds):
    """Eight targets that may each have any of eight detections: messages have not settled after a few rounds."""
    count = 8
    log_odds, weight = np.random.default_rng(seed).normal(0, 6, count * count), np.zeros(count * count)
    pairs, begins = np.tile(np.arange(count), count), np.arange(0, count * count + 1, count)
    largest = exclude(
        np.array([0, count]), begins, pairs, log_odds, np.zeros((1, count)), np.array([1e-6]), rounds, 1, weight
    )
    table = weight.reshape(count, count)
    assert largest == count
    assert table.sum(axis=0).max() <= 1 + 1e-12
    assert table.sum(axis=1).max() <= 1 + 1e-12
    assert table.sum() > 0.8 * count
