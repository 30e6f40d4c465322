"""Segmentations: runs, change points and their probabilities, scores against values worked out by hand."""

import numpy as np
import pytest
from switching_tracks import switching_tracks

from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks
from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent, IntentModel
from jink.intent.segmentation import Segmentation, _pairs, segment
from jink.intent.segmentation_scores import detection_delay, score_segmentation


def labelled(rows, names=("a", "b", "c"), times=None, **options):
    """A segmentation with certain labels."""
    labels = np.atleast_2d(rows)
    clock = np.broadcast_to(np.arange(labels.shape[1], dtype=float) if times is None else times, labels.shape)
    lengths = np.full(len(labels), labels.shape[1])
    return Segmentation.of_probs(np.eye(len(names))[labels], clock, lengths, names=names, **options)


def truth_model(turn=(4.0, 12.0)):
    """The laws of `switching_tracks`."""
    middle, spread = np.radians(np.mean(turn)), np.radians((turn[1] - turn[0]) / np.sqrt(12))
    quiet = {"wobble": 0.5, "growth_noise": 1e-9, "turn_noise": 1e-9}
    straight = Intent("straight", Phase(Law(2, **quiet), Birth(growth_sd=1e-4, turn_sd=1e-4)))
    turning = Birth(1.0, 0.0, 1e-4, middle, spread)
    turns = Intent("turn", Phase(Law(2, **quiet), turning, mirrored=True))
    births = tuple(Birth(0.5, sign * 0.03, 0.006, 0.0, 1e-4) for sign in (1, -1))
    changes = Intent("accelerate", Phase(Law(2, **quiet), births))
    rates = 1 / 50 * np.ones((3, 3)) - 3 / 50 * np.eye(3)
    return IntentModel(2, (straight, turns, changes), tuple(map(tuple, rates)), speed=150.0)


def test_runs_and_change_points():
    times = np.array([0.0, 1.0, 3.0, 4.0, 6.0, 7.0])
    switches = np.array([[0.0, 0.1, 0.6, 0.2, 0.9, 0.4]])
    found = labelled([0, 0, 1, 1, 2, 2], times=times, switches=switches, window=3.0)
    first, second = found.change_points(0)
    assert first == (2.0, 2, 0, 1, pytest.approx(0.1 + 0.6 + 0.2))  # midpoints 0.5, 2, 3.5 lie within 1.5 s
    assert second == (5.0, 4, 1, 2, 1.0)  # 0.2 + 0.9 + 0.4, at most 1
    assert [tuple(run) for run in found.runs(0)] == [(0, 0, 1, 2.0), (1, 2, 3, 3.0), (2, 4, 5, 2.0)]
    assert labelled([0, 1], window=1.0).change_points(0)[0].probability == 1.0
    padded = Segmentation.of_probs(np.ones((2, 3, 1)), np.zeros((2, 3)), np.array([2, 0]))
    assert padded.labels.tolist() == [[0, 0, -1], [-1, -1, -1]] and padded.runs(1) == ()


def test_scores_by_hand():
    found = labelled([2, 2, 2, 2, 0, 0, 0, 0, 1, 1])
    score = score_segmentation(found, [["x"] * 5 + ["y"] * 3 + [""] * 2], tolerance_s=1.0)
    # rows: 2 with x 4, 0 with x 1 and y 3
    assert score.rows == 8 and score.accuracy == pytest.approx(7 / 8) and score.majority == pytest.approx(5 / 8)
    assert score.naming == ("y", "", "x")
    # pairs together in both 6 + 3 = 9, in found 6 + 6, in given 10 + 3, of 28
    expected = 12 * 13 / 28
    assert score.ari == pytest.approx((9 - expected) / (12.5 - expected))
    h = lambda *p: -sum(q * np.log(q) for q in p)  # noqa: E731
    mutual = h(0.5, 0.5) + h(5 / 8, 3 / 8) - h(0.5, 1 / 8, 3 / 8)
    assert score.nmi == pytest.approx(2 * mutual / (h(0.5, 0.5) + h(5 / 8, 3 / 8)))
    assert score.f1 == 1.0  # 3.5 against 4.5; the change at 7.5 lies outside what is labelled
    assert score.median_delay_s == 0.0 and score.missed == 0.0
    assert score_segmentation(found, [["x"] * 5 + ["y"] * 3 + [""] * 2], tolerance_s=0.9).f1 == 0.0


def test_one_naming_for_all_tracks():
    found = labelled([[0, 0, 1, 1], [0, 0, 1, 1]])
    swapped = np.array([["x", "x", "y", "y"], ["y", "y", "x", "x"]])
    assert score_segmentation(found, swapped, 1.0).accuracy == 0.5
    over = labelled([0, 0, 1, 1, 2, 2])
    score = score_segmentation(over, [list("xxxxyy")], 1.0)
    assert score.accuracy == pytest.approx(4 / 6) and score.purity == 1.0
    assert (score.precision, score.recall) == (0.5, 1.0)


def test_each_given_change_is_met_once():
    found = labelled([0, 1, 0, 1, 1, 1, 1, 1, 1, 1])
    score = score_segmentation(found, [list("xxxyyyyyyy")], 2.5)
    assert score.precision == pytest.approx(1 / 3) and score.recall == 1.0 and score.f1 == pytest.approx(0.5)


def test_delay_at_a_rate_of_false_alarms():
    times = np.arange(7200.0)[None]
    given = np.zeros((1, 7200), dtype=int)
    given[0, 3600:] = 1
    p = np.full((1, 7200), 0.02)
    p[0, 100:2000:100] = 0.75  # 19 short alarms in two hours
    p[0, 3603:], p[0, 3610:] = 0.8, 0.99
    both = np.stack([1 - p, p], axis=2)
    loose, strict = detection_delay(both, given, times, 10.0), detection_delay(both, given, times, 1.0)
    assert (loose.threshold, loose.median_s) == (0.5, 3.0) and loose.false_alarms_per_hour == pytest.approx(
        9.5, rel=1e-3
    )
    assert strict.threshold == 0.8 and strict.median_s == 3.0 and strict.false_alarms_per_hour == 0.0
    assert detection_delay(np.where(both == 0.8, 0.7, both), given, times, 1.0).median_s == 10.0


def test_true_laws_label_tracks_and_probabilities_are_calibrated():
    tracks, _, labels = switching_tracks(tracks=40, seed=11)
    found = segment(truth_model(), tracks, threads=1)
    score = score_segmentation(found, labels, tolerance_s=4.0)
    assert score.accuracy > 0.93 and score.f1 > 0.75
    assert score.naming == ("0", "1", "2")
    top = found.probs.max(axis=2)
    right = found.labels == labels
    assert abs(right.mean() - top.mean()) < 0.03
    # expected number of switches against those that happened: 40 tracks x 99 s / 25 s = 158, sd 13
    assert found.switches.sum() == pytest.approx(np.count_nonzero(labels[:, 1:] != labels[:, :-1]), rel=0.2)
    cuts = [cut for b in range(40) for cut in found.change_points(b)]
    near = [np.any(np.abs(np.flatnonzero(np.diff(labels[b])) + 0.5 - cut.time) <= 0.5 * found.window + 1e-9)
            for b in range(40) for cut in found.change_points(b)]  # fmt: skip
    assert np.mean([cut.probability for cut in cuts]) == pytest.approx(np.mean(near), abs=0.15)


def test_pairs_of_modes_have_the_marginals_of_the_smoother():
    rng = np.random.default_rng(5)
    Pi = rng.dirichlet(np.array([8.0, 1.0, 1.0]), 3)
    filtered, before, after = (rng.dirichlet(np.ones(3), 50) for _ in range(3))
    pairs = _pairs(filtered, Pi, before, after)
    np.testing.assert_allclose(pairs.sum(axis=2), before, atol=2e-6)
    np.testing.assert_allclose(pairs.sum(axis=1), after, atol=1e-12)
    # where the marginals are already right nothing moves: an exact chain with an exact likelihood of the future
    future = rng.uniform(0.1, 1.0, (50, 3))
    joint = filtered[:, :, None] * Pi * future[:, None, :]
    joint /= joint.sum(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(_pairs(filtered, Pi, joint.sum(axis=2), joint.sum(axis=1)), joint, atol=1e-12)


def test_a_label_cannot_change_more_than_it_switches():
    tracks = switching_tracks(4, 60, seed=3)[0]
    found = segment(truth_model(), tracks)
    moved = 0.5 * np.abs(np.diff(found.probs, axis=1)).sum(axis=2)
    assert moved.max() > 0.2  # something happens
    assert (found.switches[:, 1:] >= moved - 1e-4).all()


def test_left_and_right_may_be_labels():
    tracks, eta, _ = switching_tracks(tracks=8, seed=3, laws=("straight", "turn"))
    found = segment(truth_model(), tracks, handed=True, threads=1)
    assert found.names == ("straight", "turn left", "turn right", "accelerate")
    side = np.sign(np.round(eta[..., 1], 6)).astype(int)
    turning = side != 0
    agree = np.where(side > 0, found.labels == 1, found.labels == 2)[turning]
    assert agree.mean() > 0.9
    np.testing.assert_allclose(found.probs.sum(axis=2), 1.0, atol=1e-9)
    tied = segment(truth_model(), tracks, threads=1)
    np.testing.assert_allclose(tied.probs[..., 1], found.probs[..., 1:3].sum(axis=2), atol=1e-12)


def test_rows_beyond_a_track_and_missing_rows():
    tracks, _, _ = switching_tracks(tracks=2, rows=40)
    z = tracks.measurements.copy()
    z[0, 10:14] = np.nan
    short = Tracks.from_arrays([z[0], z[1, :25]], [tracks.times[0], tracks.times[1, :25]], noise=np.eye(2) * 25.0)
    found = segment(truth_model(), short, threads=1)
    assert (found.labels[1, 25:] == -1).all() and (found.switches[1, 25:] == 0).all()
    assert (found.labels[0] >= 0).all()
    alone = segment(truth_model(), short.subset([1]), threads=1)
    np.testing.assert_array_equal(alone.labels[0], found.labels[1, :25])


def test_noise_comes_from_tracks_model_or_sensor():
    tracks, _, _ = switching_tracks(tracks=2, rows=40)
    bare = Tracks.from_arrays(tracks.measurements, tracks.times)
    with pytest.raises(ValueError, match="must carry noise where the model learned none"):
        segment(truth_model(), bare)
    by_sensor = segment(truth_model(), bare, position(2, 5.0), threads=1)
    by_model = segment(truth_model().with_(noise_sd=(5.0, 5.0)), bare, threads=1)
    by_tracks = segment(truth_model(), tracks, threads=1)
    np.testing.assert_allclose(by_sensor.probs, by_model.probs, atol=1e-12)
    np.testing.assert_allclose(by_sensor.probs, by_tracks.probs, atol=1e-12)


def test_refusals():
    found = labelled([0, 1, 1])
    with pytest.raises(ValueError, match=r"given must have shape \(1, 3\); got \(1, 2\)"):
        score_segmentation(found, [[0, 1]], 1.0)
    with pytest.raises(ValueError, match="tolerance_s must be > 0 s; got 0"):
        score_segmentation(found, [[0, 1, 1]], 0)
    with pytest.raises(ValueError, match="must label at least one row"):
        score_segmentation(found, [[-1, -1, -1]], 1.0)
    with pytest.raises(ValueError, match=r"probs must have shape"):
        Segmentation(np.zeros((1, 2), dtype=int), np.zeros((1, 3, 2)), np.zeros((1, 2)), np.array([2]))
    with pytest.raises(ValueError, match="names must hold 3 labels; got 2"):
        Segmentation.of_probs(np.zeros((1, 2, 3)), np.zeros((1, 2)), np.array([2]), names=("a", "b"))
