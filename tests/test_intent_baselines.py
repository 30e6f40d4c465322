"""Baselines of segmentation: they find what they are made for, repeat, and say what they cannot use."""

import numpy as np
import pytest
from switching_tracks import switching_tracks

from jink.estimators.tracks import Tracks
from jink.intent.baselines.autoregressive import StickyRegression, egocentric
from jink.intent.baselines.change_points import optimal_cuts
from jink.intent.baselines.choosing import best_of
from jink.intent.baselines.regressions import RegressionMixture
from jink.intent.baselines.segment_cluster import SegmentCluster
from jink.intent.segmentation_scores import score_segmentation

TRACKS, _, LABELS = switching_tracks(tracks=14, seed=1)
MAKERS = {
    "segment-cluster": lambda **options: SegmentCluster(window=10.0, **options),
    "ar-hmm": lambda **options: StickyRegression(window=10.0, mirrored=True, restarts=2, **options),
    "regressions": lambda **options: RegressionMixture(window=10.0, **options),
}


def test_cuts_are_the_best_of_all():
    generator = np.random.default_rng(0)
    x, weights = generator.normal(size=(9, 2)), generator.uniform(0.2, 3.0, (9, 2))
    x[4:] += 1.5

    def cost(cuts):
        total = 0.0
        for first, last in zip(cuts, [*cuts[1:], 9], strict=True):
            w, part = weights[first:last], x[first:last]
            mean = np.sum(w * part, axis=0) / w.sum(axis=0)
            total += np.sum(w * (part - mean) ** 2) + 1.7
        return total

    every = [[0, *(t + 1 for t in range(8) if code >> t & 1)] for code in range(256)]
    best = min(every, key=cost)
    assert optimal_cuts(x, weights, 1.7) == best and len(best) > 1
    assert optimal_cuts(x, weights, 1e9) == [0] and len(optimal_cuts(x, weights, 0.0)) == 9


@pytest.mark.parametrize("name", MAKERS)
def test_fit_and_segment(name):
    made = MAKERS[name](intents=4).fit(TRACKS)
    found = made.segment(TRACKS)
    score = score_segmentation(found, LABELS, 4.0)
    # one label reaches 0.40; the weakest of the three stands at 0.72 here
    assert score.purity > 0.6 and score.nmi > 0.25 and score.f1 > 0.4
    np.testing.assert_allclose(found.probs.sum(axis=2), 1.0, atol=1e-9)
    again = MAKERS[name](intents=4).fit(TRACKS).segment(TRACKS)
    np.testing.assert_array_equal(again.probs, found.probs)
    few = made.segment(TRACKS.subset([3, 5]))  # what was learned, on other tracks
    np.testing.assert_allclose(few.probs, found.probs[[3, 5]], atol=1e-9)


@pytest.mark.parametrize("name", MAKERS)
def test_number_is_chosen_by_the_criterion(name):
    made = MAKERS[name](most=4).fit(TRACKS)
    sizes, values = zip(*made.curve_, strict=True)
    assert sizes == (1, 2, 3, 4) and made.intents_ == sizes[int(np.argmin(values))] > 1


@pytest.mark.parametrize("name", MAKERS)
def test_left_and_right_are_one(name):
    flipped = Tracks.from_arrays(TRACKS.measurements * [1.0, -1.0], TRACKS.times, noise=TRACKS.noise)
    made = MAKERS[name](intents=3).fit(TRACKS)
    np.testing.assert_allclose(made.segment(flipped).probs, made.segment(TRACKS).probs, atol=1e-6)


@pytest.mark.parametrize("name", MAKERS)
def test_tracks_without_direction_are_refused(name):
    still = Tracks.from_arrays(np.zeros((12, 2)), np.arange(12.0), noise=np.eye(2))
    with pytest.raises(ValueError, match=r"tracks must (show a direction|give 20 increments)"):
        MAKERS[name](intents=2).fit(still)


def test_pieces_know_their_side():
    tracks, eta, _ = switching_tracks(tracks=10, seed=6, laws=("straight", "turn"))
    made = SegmentCluster(2, window=10.0).fit(tracks)
    found = made.segment(tracks, handed=True)
    side = np.sign(np.round(eta[..., 1], 6)).astype(int) + 1
    assert found.probs.shape[2] == 3
    assert score_segmentation(found, side, 4.0).accuracy > 0.85  # one label: 0.6
    tied = made.segment(tracks)
    assert score_segmentation(tied, abs(side - 1), 4.0).accuracy > 0.85


def waggling(seed=0, rows=900):
    """A heading that turns left, turns right, or waggles: its change per frame, and which of these it does."""
    generator = np.random.default_rng(seed)
    labels = np.repeat(generator.permutation(np.arange(18) % 3), rows // 18)
    steps = np.array([0.15, -0.15, 0.0])[labels] + np.array([0.1, 0.1, 0.7])[labels] * generator.standard_normal(rows)
    return steps, labels


@pytest.mark.parametrize(("order", "most"), [(0, 4), (1, 4)])
def test_states_of_a_given_series(order, most):
    steps, labels = waggling()
    tracks = Tracks.from_arrays(np.zeros((900, 2)), np.arange(900) / 30)
    series = steps[None, :, None].copy()
    series[0, 300:303] = np.nan
    made = StickyRegression(order=order, most=most).fit(tracks, series)
    assert made.intents_ == 3
    score = score_segmentation(made.segment(tracks, series), labels[None], 0.2)
    assert score.accuracy > 0.95


def test_twins_tie_sides_and_may_be_told_apart():
    steps, labels = waggling(seed=2)
    tracks = Tracks.from_arrays(np.zeros((900, 2)), np.arange(900) / 30)
    made = StickyRegression(2, mirrored=True, across=(0,)).fit(tracks, steps[None, :, None])
    tied = made.segment(tracks, steps[None, :, None])
    sided = made.segment(tracks, steps[None, :, None], handed=True)
    assert score_segmentation(tied, (labels == 2).astype(int)[None], 0.2).accuracy > 0.95
    assert sided.probs.shape[2] == 3  # the waggle is its own mirror image
    assert score_segmentation(sided, labels[None], 0.2).accuracy > 0.95


def test_autoregression_is_what_tells_states_apart():
    generator = np.random.default_rng(4)
    labels = np.repeat(np.arange(8) % 2, 100)
    y = np.zeros(800)
    for t in range(1, 800):
        y[t] = (0.85, -0.85)[labels[t]] * y[t - 1] + generator.standard_normal()
    tracks = Tracks.from_arrays(np.zeros((800, 2)), np.arange(800.0))
    accuracy = [
        score_segmentation(
            StickyRegression(2, order=order).fit(tracks, y[None, :, None]).segment(tracks, y[None, :, None]),
            labels[None], 3.0,
        ).accuracy
        for order in (0, 1)
    ]  # fmt: skip
    assert accuracy[1] > 0.95 and accuracy[0] < 0.75
    assert StickyRegression(2, order=None).fit(tracks, y[None, :, None]).order_ == 1


def test_increments_are_those_of_the_body():
    series = egocentric(TRACKS, 10.0)
    turned = Tracks.from_arrays(TRACKS.measurements[..., ::-1] * [1.0, -1.0], TRACKS.times, noise=TRACKS.noise)
    np.testing.assert_allclose(egocentric(turned, 10.0), series, atol=1e-9)
    assert np.isfinite(series[0, ::4]).any() and np.isnan(series[0, 1::4]).all()  # every fourth second is news


def test_criterion_takes_the_smallest():
    found, size, curve = best_of(lambda k: (-(10.0 / k), 3 * k, f"k={k}"), [1, 2, 3], 100.0)
    wanted = [20.0 / k + 3 * k * np.log(100.0) for k in (1, 2, 3)]
    assert [value for _, value in curve] == pytest.approx(wanted) and size == 1 and found == "k=1"
    with pytest.raises(ValueError, match="sizes must hold at least one number"):
        best_of(lambda k: (0.0, 1, None), [], 10.0)
