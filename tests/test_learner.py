"""Learning intents: it overfits few tracks, beats one intent, repeats itself, survives a kill, bears bad data."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from jink.estimators.api import BankEstimator
from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks
from jink.intent.endings import count_endings
from jink.intent.learner import IntentLearner
from jink.intent.selection import RESOLVABLE, choose, curve_of, gain_over_one

SIGMA = 5.0
QUICK = {"most": 3, "single": 6, "first": 10, "rounds": 0, "fewer": 5, "last": 6}


def turning(count: int, rows: int = 40, seed: int = 1) -> Tracks:
    """Straight legs and turns of 0.15 rad/s either way, 8 to 12 s each, 50 m/s, a fix every second."""
    rng = np.random.default_rng(seed)
    z, truth = np.empty((count, rows, 2)), np.empty((count, rows, 2))
    for b in range(count):
        heading, place, rate, left = rng.uniform(-math.pi, math.pi), rng.normal(0.0, 1000.0, 2), 0.0, 0.0
        for t in range(rows):
            if left <= 0.0:
                rate = 0.0 if rate != 0.0 else 0.15 * rng.choice([-1.0, 1.0])
                left = rng.uniform(8.0, 12.0)
            truth[b, t] = place
            middle = heading + 0.5 * rate
            chord = np.sinc(0.5 * rate / math.pi)
            place = place + 50.0 * chord * np.array([math.cos(middle), math.sin(middle)])
            heading, left = heading + rate, left - 1.0
        z[b] = truth[b] + SIGMA * rng.standard_normal((rows, 2))
    return Tracks.from_arrays(z, np.arange(rows, dtype=float), noise=SIGMA**2 * np.eye(2), truth=truth)


@pytest.fixture(scope="module")
def tracks() -> Tracks:
    """Sixteen tracks to learn from."""
    return turning(16)


@pytest.fixture(scope="module")
def learner(tracks: Tracks) -> IntentLearner:
    """A quick fit of them."""
    return IntentLearner(seed=3, **QUICK).fit(tracks)


def test_finds_straight_and_turn(learner: IntentLearner) -> None:
    model = learner.model_
    assert learner.resolvable_ and len(model.intents) == 2
    turn = next(intent.phases[0] for intent in model.intents if intent.phases[0].mirrored)
    # 0.15 rad/s with births of some 10 rows seen through 5 m at 50 m/s: known to about 5 %
    heaviest = max(turn.births, key=lambda birth: birth.weight)
    assert heaviest.turn_mean == pytest.approx(0.15, rel=0.15)


def test_beats_one_intent_on_fresh_tracks(learner: IntentLearner) -> None:
    fresh = turning(24, seed=9)
    single = IntentLearner(seed=3, intents=1, **QUICK).fit(turning(16))
    assert learner.score(fresh) > single.score(fresh) + RESOLVABLE

    def rmse(learned: IntentLearner) -> float:
        found = BankEstimator(learned.bank(position(2, SIGMA)), threads=1).run(fresh.measurements, fresh.times)
        return float(np.sqrt(np.square(found.position - fresh.truth).sum(axis=-1).mean()))

    assert rmse(learner) < rmse(single)


def test_overfits_eight_tracks() -> None:
    """More work on the same eight tracks must keep raising their likelihood."""
    few = turning(8, seed=4)
    little = IntentLearner(intents=2, **{**QUICK, "first": 2, "fewer": 1, "last": 1}).fit(few)
    much = IntentLearner(intents=2, **{**QUICK, "last": 12}).fit(few)
    assert much.log_likelihood_ > little.log_likelihood_ + 0.01
    assert much.score(few) > much.score(turning(24, seed=9)) - 0.1


def test_shuffled_time_teaches_nothing(tracks: Tracks, learner: IntentLearner) -> None:
    """Rows in random order have no motion: no bank is worth more than one that expects nothing."""
    rng = np.random.default_rng(0)
    mixed = np.stack([z[rng.permutation(len(z))] for z in tracks.measurements])
    shuffled = Tracks.from_arrays(mixed, tracks.times, noise=SIGMA**2 * np.eye(2))
    learned = IntentLearner(seed=3, intents=1, **QUICK).fit(shuffled)
    assert learned.log_likelihood_ < learner.log_likelihood_ - 2.0


def test_same_seed_same_bits(tracks: Tracks, learner: IntentLearner) -> None:
    again = IntentLearner(seed=3, **QUICK).fit(tracks)
    assert again.model_ == learner.model_ and again.curve_ == learner.curve_


def test_labels_and_truth_are_not_looked_at(tracks: Tracks, learner: IntentLearner) -> None:
    blind = Tracks.from_arrays(tracks.measurements, tracks.times, noise=SIGMA**2 * np.eye(2))
    assert IntentLearner(seed=3, **QUICK).fit(blind).model_ == learner.model_


def test_goes_on_after_a_kill(tracks: Tracks, learner: IntentLearner, tmp_path: Path) -> None:
    """Killed within any stage, the next fit takes what is finished and ends at the same bits."""

    class Killed(BaseException):
        pass

    for stage in ("fit", "final"):

        def kill(report: object, stage: str = stage) -> None:
            if getattr(report, "stage", "") == stage and getattr(report, "step", 0) == 2:
                raise Killed

        folder = tmp_path / stage
        with pytest.raises(Killed):
            IntentLearner(seed=3, checkpoint=folder, progress=kill, **QUICK).fit(tracks)
        stages = {path.name for path in folder.iterdir() if path.is_dir() and (path / "stage.json").is_file()}
        assert "one-intent-1" in stages and "final" not in stages
        resumed = IntentLearner(seed=3, checkpoint=folder, **QUICK).fit(tracks)
        assert resumed.model_ == learner.model_ and resumed.curve_ == learner.curve_
        shutil.rmtree(folder)


def test_a_checkpoint_of_other_tracks_is_refused(tracks: Tracks, tmp_path: Path) -> None:
    IntentLearner(intents=1, checkpoint=tmp_path, **QUICK).fit(tracks)
    with pytest.raises(ValueError, match="checkpoint must belong to these tracks"):
        IntentLearner(intents=1, checkpoint=tmp_path, **QUICK).fit(turning(16, seed=5))


def test_bears_bad_data(tracks: Tracks, learner: IntentLearner) -> None:
    """Missing rows, ragged tracks, irregular times and gross outliers change little."""
    rng = np.random.default_rng(2)
    z, t = [], []
    for b in range(len(tracks)):
        rows = int(rng.integers(30, 41))
        values, clock = tracks.measurements[b, :rows].copy(), tracks.times[b, :rows].copy()
        values[rng.integers(3, rows, 3)] = np.nan
        values[rng.integers(3, rows)] += 4000.0
        z.append(values)
        t.append(clock)
    bad = Tracks.from_arrays(z, t, noise=SIGMA**2 * np.eye(2))
    learned = IntentLearner(seed=3, **QUICK).fit(bad)
    assert learned.left_out_ >= 14  # of 16; one that fell on a missing row was none
    assert len(learned.model_.intents) == 2
    fresh = turning(24, seed=9)
    assert learned.score(fresh) > learner.score(fresh) - 0.05


def test_outliers_beyond_all_scales_are_left_out_before_the_fit(tracks: Tracks) -> None:
    """Noise not given: one row in a hundred off by a million scenes changes no finding."""
    rng = np.random.default_rng(5)
    z = tracks.measurements.copy()
    hit = rng.random(z.shape[:2]) < 0.01
    z[hit] += 1e9 * rng.standard_normal((int(hit.sum()), 2))
    learned = IntentLearner(seed=3, **QUICK).fit(Tracks.from_arrays(z, tracks.times))
    assert learned.left_out_ == hit.sum() >= 5
    assert learned.resolvable_ and len(learned.model_.intents) == 2
    assert learned.model_.noise_sd is not None and np.allclose(learned.model_.noise_sd, SIGMA, rtol=0.15)


def test_one_intent_is_not_resolved_into_more() -> None:
    """Straight flight only: the evidence for a second intent is below a hundredth of a nat."""
    rng = np.random.default_rng(3)
    velocity = rng.normal(0.0, 30.0, (16, 1, 2))
    z = velocity * np.arange(40.0)[None, :, None] + SIGMA * rng.standard_normal((16, 40, 2))
    learned = IntentLearner(**QUICK).fit(Tracks.from_arrays(z, np.arange(40.0), noise=SIGMA**2 * np.eye(2)))
    assert not learned.resolvable_ and len(learned.model_.intents) == 1


def test_targets_at_rest() -> None:
    z = np.broadcast_to(np.array([10.0, -5.0]), (6, 30, 2))
    learned = IntentLearner(**QUICK).fit(Tracks.from_arrays(z, np.arange(30.0), noise=np.eye(2)))
    assert len(learned.model_.intents) == 1 and math.isfinite(learned.log_likelihood_)


def test_noise_is_learned(tracks: Tracks) -> None:
    bare = Tracks.from_arrays(tracks.measurements, tracks.times)
    learned = IntentLearner(intents=2, noise_sd="learn", **QUICK).fit(bare)
    assert learned.model_.noise_sd is not None
    # 640 rows of two components: 3 % of sd; the laws take a little
    assert np.allclose(learned.model_.noise_sd, SIGMA, rtol=0.12)


def test_too_little_is_refused_in_a_sentence() -> None:
    with pytest.raises(ValueError, match=r"IntentLearner\.fit: tracks must hold at least 100 measured rows"):
        IntentLearner().fit(turning(2, rows=10))
    with pytest.raises(ValueError, match="axes"):
        IntentLearner(axes=3).fit(turning(2))
    with pytest.raises(ValueError, match="must be fitted first"):
        IntentLearner().score(turning(2))
    for wrong in ({"intents": 0}, {"noise_sd": -1.0}, {"noise_sd": "guess"}, {"seconds": 0.0}, {"epochs": 3}):
        with pytest.raises(ValueError, match="IntentLearner: "):
            IntentLearner(**wrong)  # type: ignore[arg-type]


def test_choice_takes_the_fewest_within_one_standard_error() -> None:
    rng = np.random.default_rng(0)
    rows = np.full(64, 100.0)
    base = rng.normal(-960.0, 20.0, 64)
    noise = {k: rng.normal(0.0, 1.0, 64) for k in (2, 3, 4)}
    scores = {1: base - 30.0, 2: base - 5.0 + noise[2], 3: base + noise[3], 4: base + 0.05 + noise[4]}
    assert choose(scores, rows, 0) == (3, True)
    assert choose({1: base - 0.5, 2: base}, rows, 0) == (1, False)  # 0.005 nats per row are not worth a second intent
    curve = curve_of(scores, rows, 0)
    assert [point.intents for point in curve] == [1, 2, 3, 4]
    assert curve[1].high < max(point.held_out for point in curve) and curve[2].low < curve[2].held_out < curve[2].high


def test_durations_are_those_of_the_tracks(tracks: Tracks, learner: IntentLearner) -> None:
    """Spells of 8 to 12 s; the first and the last of every track are cut."""
    model = learner.model_
    seconds, ended = count_endings(model, tracks)
    assert seconds.sum() == pytest.approx(16 * 39.0)
    np.testing.assert_allclose(model.endings, ended / seconds)
    rates = (
        np.abs(np.diff(np.unwrap(np.arctan2(*np.moveaxis(np.diff(tracks.truth, axis=1), 2, 0)[::-1])), axis=1)) > 0.07
    )
    switches = int((rates[:, 1:] != rates[:, :-1]).sum())
    assert ended.sum() == pytest.approx(switches, rel=0.2)
    assert all(7.5 < model.lasting(number) < 14.0 for number in range(2)) and "by its chain" not in model.describe()


def test_the_noise_given_to_a_learner_is_that_of_its_bank(tracks: Tracks, learner: IntentLearner) -> None:
    bare = Tracks.from_arrays(tracks.measurements, tracks.times)
    given = IntentLearner(seed=3, noise_sd=SIGMA, **QUICK)
    given.model_ = learner.model_
    np.testing.assert_array_equal(given.segment(bare).probs, learner.segment(tracks).probs)
    np.testing.assert_array_equal(given.bank().sensor.noise, position(2, SIGMA).noise)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        *(({"seed": value}, "seed") for value in (-1, "a", 1.5, True)),
        *(({"seconds": value}, "seconds") for value in ("x", True, 0, math.nan)),
        *(({"noise_sd": value}, "noise_sd") for value in (True, [1, 2], 0.0, "x", math.inf)),
        *(({"device": value}, "device") for value in ("xyz", None, "tpu", "cuda:x")),
        *(({"intents": value}, "intents") for value in (True, 0, 8, 2.0)),
        *(({"threads": value}, "threads") for value in (0, -3, True, "2")),
        *(({name: value}, name) for name, value in [("rounds", "3"), ("most", 0), ("first", -5), ("rivals", 0)]),
        ({"axes": True}, "axes"),
        ({"laps": 3}, "work"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, object], word: str) -> None:
    with pytest.raises(ValueError, match=f"IntentLearner: {word} must .*; got ") as caught:
        IntentLearner(**options)
    assert str(caught.value).endswith(".")


def test_what_several_bring_over_one_has_an_interval() -> None:
    """Of paired differences: the same numbers whichever of both is the best."""
    rng = np.random.default_rng(2)
    rows = np.full(40, 50.0)
    one = rng.normal(-400.0, 50.0, 40)
    for shift in (0.3, -0.3):
        two = one + shift + rng.normal(0.0, 2.0, 40)
        gain, low, high = gain_over_one(curve_of({1: one, 2: two, 3: two - 20.0}, rows, 0))
        error = np.std(two - one) / math.sqrt(40) / 50.0
        assert gain == pytest.approx((two - one).mean() / 50.0)
        assert low == pytest.approx(gain - 1.96 * error, abs=0.4 * error)
        assert high == pytest.approx(gain + 1.96 * error, abs=0.4 * error)
    assert gain_over_one(curve_of({1: one}, rows, 0)) is None
