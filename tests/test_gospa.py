"""Distances of sets, identities and disagreement against closed forms and every possible assignment."""

import itertools

import numpy as np
import pytest

from jink.estimators import metrics

NAN = np.nan


def every_pairing(few, many):
    """All ways to pair some of ``few`` items with distinct ones of ``many``: index into many, or -1."""
    for choice in itertools.product(range(-1, many), repeat=few):
        taken = [c for c in choice if c >= 0]
        if len(taken) == len(set(taken)):
            yield choice


def gospa_by_trial(x, y, c, p):
    best = np.inf
    for choice in every_pairing(len(x), len(y)):
        cost = sum(np.linalg.norm(x[i] - y[j]) ** p for i, j in enumerate(choice) if j >= 0)
        pairs = sum(j >= 0 for j in choice)
        best = min(best, cost + c**p / 2 * (len(x) + len(y) - 2 * pairs))
    return best ** (1 / p)


def ospa_by_trial(x, y, c, p):
    if len(x) > len(y):
        x, y = y, x
    if not len(y):
        return 0.0
    costs = (
        sum(min(np.linalg.norm(x[i] - y[j]), c) ** p for i, j in enumerate(order))
        for order in itertools.permutations(range(len(y)), len(x))
    )
    return ((min(costs) + c**p * (len(y) - len(x))) / len(y)) ** (1 / p)


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0, 3.0])
def test_set_distances_are_the_best_of_all_assignments(order):
    rng = np.random.default_rng(0)
    for _ in range(40):
        x, y = rng.normal(size=(rng.integers(0, 5), 2)), rng.normal(size=(rng.integers(0, 5), 2))
        assert metrics.gospa(x, y, 1.2, order).distance == pytest.approx(gospa_by_trial(x, y, 1.2, order))
        assert metrics.ospa(x, y, 1.2, order) == pytest.approx(ospa_by_trial(x, y, 1.2, order))


def test_the_best_assignment_depends_on_the_order():
    """The coinciding pair wins by distance (2.06 against 2.12), the shifted pairs by squares (2.25 against 4.25)."""
    x, y = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[1.0, 0.0], [2.0, 0.5]])
    assert metrics.ospa(x, y, 10.0, 1) == pytest.approx(np.sqrt(4.25) / 2)
    assert metrics.ospa(x, y, 10.0, 2) == pytest.approx(np.sqrt(2.25 / 2))
    assert metrics.gospa(x, y, 10.0, 2).distance == pytest.approx(1.5)


def test_parts_by_hand():
    """One target met at 3 m, one missed, two false tracks, one of them 100 m from the missed target."""
    truth = np.array([[0.0, 0.0], [50.0, 0.0]])
    estimate = np.array([[0.0, 3.0], [150.0, 0.0], [-80.0, 0.0]])
    found = metrics.gospa(estimate, truth, 10.0)
    assert (found.localisation, found.missed, found.false) == (9.0, 50.0, 100.0)
    assert (found.pairs, found.missed_count, found.false_count) == (1, 1, 2)
    assert found.distance == pytest.approx(np.sqrt(159.0))
    np.testing.assert_array_equal(found.estimate_of, [0, -1])
    # OSPA: 3 m, and two of three unmatched at the cut-off.
    assert metrics.ospa(estimate, truth, 10.0) == pytest.approx(np.sqrt((9 + 100 + 100) / 3))


def test_empty_sets():
    none, two = np.empty((0, 2)), np.zeros((2, 2))
    assert metrics.gospa(none, none, 5.0).distance == 0.0
    assert metrics.ospa(none, none, 5.0) == 0.0
    assert metrics.gospa(none, two, 5.0).missed == 25.0
    assert metrics.gospa(two, none, 5.0).false == 25.0
    assert metrics.ospa(two, none, 5.0) == 5.0
    assert metrics.gospa(np.empty((0, 4, 2)), np.zeros((1, 4, 2)), 2.0).distance == pytest.approx([np.sqrt(2)] * 4)


def test_over_time_a_track_that_is_not_there_does_not_count():
    truth = np.zeros((2, 3, 2))
    truth[1] = 100.0
    truth[1, 0] = NAN  # born at the second time
    estimate = np.full((3, 3, 2), NAN)
    estimate[2] = [[1.0, 0.0], [0.0, 2.0], [100.0, 101.0]]
    estimate[0, 1] = (100.0, NAN)  # half a position is none
    found = metrics.gospa(estimate, truth, 4.0)
    np.testing.assert_array_equal(found.localisation, [1.0, 4.0, 1.0])
    np.testing.assert_array_equal(found.missed, [0.0, 8.0, 8.0])
    np.testing.assert_array_equal(found.false, 0.0)
    np.testing.assert_array_equal(found.estimate_of, [[2, 2, -1], [-1, -1, 2]])


def test_distances_are_metrics():
    """Symmetric, zero for equal sets whatever their order, and the triangle inequality."""
    rng = np.random.default_rng(1)
    for distance in (
        lambda a, b: float(metrics.gospa(a, b, 1.0).distance),
        lambda a, b: float(metrics.ospa(a, b, 1.0)),
    ):
        for _ in range(50):
            a, b, c = (rng.normal(size=(n, 2)) for n in rng.integers(0, 4, 3))
            assert distance(a, b) == pytest.approx(distance(b, a))
            assert distance(a, a[::-1]) == 0.0
            assert distance(a, c) <= distance(a, b) + distance(b, c) + 1e-12


@pytest.mark.parametrize("measure", [metrics.gospa, metrics.ospa])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((2, 2)), np.zeros((2, 2)), 0.0), "cutoff must be a number > 0 and finite"),
        ((np.zeros((2, 2)), np.zeros((2, 2)), 1.0, 0.5), "order must be a number >= 1"),
        ((np.zeros(2), np.zeros((2, 2)), 1.0), r"estimate must have shape \(K, T, A\)"),
        ((np.zeros((2, 3)), np.zeros((2, 2)), 1.0), "must have the same times and axes"),
    ],
)
def test_set_distances_refuse(measure, arguments, message):
    with pytest.raises(ValueError, match=message):
        measure(*arguments)


# --- identities ---


def crossing(steps=21):
    """Two targets on crossing lines, 20 m apart at both ends."""
    t = np.linspace(-10.0, 10.0, steps)
    return np.stack([np.stack([t, t], -1), np.stack([t, -t], -1)])


def test_tracks_that_keep_their_targets():
    truth = crossing()
    found = metrics.identities(truth + 0.5, truth, 2.0)
    assert found.switches.tolist() == found.breaks.tolist() == [0, 0]
    np.testing.assert_array_equal(found.held, 1.0)
    np.testing.assert_array_equal(found.lost, 0.0)
    assert found.false_tracks == 0
    # The order of the tracks is no matter.
    np.testing.assert_array_equal(metrics.identities(truth[::-1], truth, 2.0).switches, 0)


def test_tracks_that_swap_their_targets():
    truth = crossing()
    swapped = truth.copy()
    swapped[:, 11:] = truth[::-1, 11:]
    assert metrics.identities(swapped, truth, 2.0).switches.tolist() == [1, 1]


def test_a_third_track_beside_does_not_take_a_target():
    truth = crossing()[:1]
    beside = np.concatenate([truth + 0.9, truth])  # the second is nearer, but the first came first
    beside[1, :3] = NAN
    found = metrics.identities(beside, truth, 2.0)
    assert found.switches.tolist() == [0]
    assert found.false_tracks == 1


def test_breaks_and_losses():
    truth = np.concatenate([crossing(), np.full((1, 21, 2), NAN)])
    truth[1, 15:] = NAN
    estimate = truth[:2].copy()
    estimate[0, 5:8] = NAN  # broken off
    estimate[0, 18:] = 50.0  # lost
    found = metrics.identities(estimate, truth, 1.0, last=3)
    assert found.breaks.tolist() == [1, 0, 0]
    assert found.switches.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(found.lost, [1.0, 0.0, NAN])
    np.testing.assert_allclose(found.held, [15 / 21, 1.0, NAN])


def test_identities_pair_as_many_as_possible():
    """The nearest pair first would leave the second target without a track."""
    truth = np.array([[[0.0, 0.0]], [[1.5, 0.0]]])
    estimate = np.array([[[0.7, 0.0]], [[-0.9, 0.0]]])
    assert metrics.identities(estimate, truth, 1.0).track_of.tolist() == [[1], [0]]


def test_identities_refuse():
    with pytest.raises(ValueError, match="gate must be a number > 0"):
        metrics.identities(np.zeros((1, 2, 2)), np.zeros((1, 2, 2)), -1.0)
    with pytest.raises(ValueError, match="same times and axes"):
        metrics.identities(np.zeros((1, 3, 2)), np.zeros((1, 2, 2)), 1.0)


# --- nodes ---


def test_disagreement_by_hand():
    estimates = np.array([[[0.0, 0.0], [1.0, 1.0]], [[2.0, 0.0], [1.0, 1.0]], [[1.0, 3.0], [NAN, 1.0]]])
    np.testing.assert_allclose(metrics.disagreement(estimates), [(1 + 1 + 1 + 1 + 0 + 4) / 3, 0.0])
    np.testing.assert_array_equal(metrics.disagreement(np.full((2, 1, 2), NAN)), [NAN])
    with pytest.raises(ValueError, match="nodes first"):
        metrics.disagreement(np.zeros(3))
