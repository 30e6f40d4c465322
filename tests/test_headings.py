"""Recorded directions as tracks, turns that shake about their rate, and which side a spell keeps to."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from jink.intent.bank_torch import make_batch
from jink.intent.climbing import climb
from jink.intent.describing import describe_phase
from jink.intent.first_guess import guess, shaky
from jink.intent.headings import heading_tracks
from jink.intent.joining import alike, merge, settled, tidy
from jink.intent.laws import Birth, Law, Phase
from jink.intent.learner import IntentLearner
from jink.intent.model import Intent, IntentModel
from jink.intent.pruning import pruned
from jink.intent.segmentation_scores import score_segmentation
from jink.intent.selection import freedom, row_scores, shorter_models, smaller_models
from jink.intent.sides import keeps_side, spell_turn
from jink.intent.trainer import Settings

STEP = 0.1


def shaking(rows=150, tracks=6, rate=1.5, sd=0.2, seed=0):
    """Headings that turn at ``rate`` to the left or the right and shake by ``sd`` rad from row to row."""
    rng = np.random.default_rng(seed)
    sides = np.where(np.arange(tracks) % 2, 1.0, -1.0)[:, None]
    return np.cumsum(sides * rate * STEP + rng.normal(scale=sd, size=(tracks, rows)), axis=1)


def test_path_follows_the_heading():
    angle = np.array([0.0, 0.0, np.pi / 2, np.nan, np.pi])
    tracks = heading_tracks(angle, np.array([0.0, 0.5, 1.0, 1.25, 2.0]), error=0.1)
    np.testing.assert_allclose(
        tracks.measurements[0], [[0.5, 0], [1.0, 0], [1.0, 0.5], [np.nan, np.nan], [0.0, 0.5]], atol=1e-12
    )
    sds = np.sqrt(tracks.noise[0, :, 0, 0])
    np.testing.assert_allclose(sds, [0.05, 0.05, 0.05, 0.025, 0.1])  # the last step bridges the gap
    turned = heading_tracks(angle + 0.3, np.array([0.0, 0.5, 1.0, 1.25, 2.0]), error=0.1).measurements[0]
    c, s = np.cos(0.3), np.sin(0.3)
    np.testing.assert_allclose(turned, tracks.measurements[0] @ np.array([[c, s], [-s, c]]), atol=1e-12)


@pytest.mark.parametrize(
    ("headings", "times", "error", "said"),
    [
        (np.zeros(1), np.zeros(1), 0.1, "headings must be"),
        (np.zeros(3), np.zeros(4), 0.1, "times must be"),
        (np.zeros(3), np.array([0.0, 1.0, 1.0]), 0.1, "times must increase"),
        (np.zeros(3), np.arange(3.0), 0.0, "error must be > 0"),
    ],
)
def test_refusals(headings, times, error, said):
    with pytest.raises(ValueError, match=said):
        heading_tracks(headings, times, error=error)


def test_the_mean_of_a_turn_that_shakes_is_learned():
    """Turns to the left and right whose rate is white noise about a mean: the birth alone cannot say so."""
    tracks = heading_tracks(shaking(), np.arange(150) * STEP)
    sizes = guess(tracks).sizes
    model = IntentModel(2, (Intent("a", (shaky(sizes, 0.5),)),), speed=0.7)
    batch = make_batch(tracks.measurements, tracks.times, tracks.noise, speed=0.7)
    law = tidy(climb(model, batch, sizes, steps=40).model).intents[0].phases[0].law
    assert law.turn_mean == pytest.approx(1.5, abs=0.35)
    diffused = law.turn_noise / law.turn_rate**2
    assert diffused == pytest.approx(0.2**2 / STEP, rel=0.35)


def test_a_spell_averages_its_turn_rate():
    law = Law(2, turn_mean=0.8, turn_rate=3.0, turn_noise=2.0)
    birth = Birth(1.0, 0.0, 0.1, -0.5, 0.4)
    lasts, dt = 2.0, 0.002
    rng = np.random.default_rng(1)
    w, total = rng.normal(-0.5, 0.4, 20_000), 0.0
    for _ in range(round(lasts / dt)):
        total = total + w * dt / lasts
        w = w + 3.0 * (0.8 - w) * dt + rng.normal(scale=np.sqrt(2.0 * dt), size=w.size)
    mean, sd = spell_turn(Phase(law, (birth,)), birth, lasts)
    assert mean == pytest.approx(total.mean(), abs=0.02)
    assert sd == pytest.approx(total.std(), rel=0.15)  # the start of the average is taken as settled
    still = Phase(Law(2), (Birth(1.0, 0.0, 0.1, 0.3, 0.1),))
    assert spell_turn(still, still.births[0], 5.0) == (0.3, 0.1)


def test_a_shaky_turn_keeps_its_side_over_a_long_spell_only():
    law = Law(2, turn_mean=1.0, turn_rate=50.0, turn_noise=1e4)
    phase = Phase(law, (Birth(1.0, 0.0, 0.1, 1.0, 10.0),), mirrored=True)
    assert keeps_side(phase, phase.births[0], 20.0)
    assert not keeps_side(phase, phase.births[0], 1.0)
    long, short = (
        IntentModel(2, (Intent("a", (phase,)), Intent("b", (Phase(Law(2)),))), ((-r, r), (r, -r))) for r in (0.05, 5.0)
    )
    assert tidy(long).intents[0].phases[0].mirrored
    assert not tidy(short).intents[0].phases[0].mirrored
    assert tidy(short).intents[0].phases[0].law.turn_mean == 0.0  # or it would turn to one side only


def twins(apart=0.0):
    """Two weaves that differ by their period, and a turn."""
    weave = Phase(Law(2, 0, 0, 1e-4, 0, 0, 1e-3, 0.01, swing=(1.0, 0.1)), (Birth(1.0, 0.0, 0.02, 0.0, 0.3, 0.3),))
    other = dataclasses.replace(weave, law=dataclasses.replace(weave.law, swing=(np.exp(apart), 0.1)))
    turn = Phase(Law(2, 0, 0, 1e-4, 0, 0, 1e-3, 0.01), (Birth(1.0, 0.0, 0.02, 0.3, 0.1),), mirrored=True)
    rates = np.array([[0, 0.2, 0.1], [0.2, 0, 0.1], [0.05, 0.05, 0]])
    np.fill_diagonal(rates, -rates.sum(axis=1))
    intents = tuple(Intent(name, (phase,)) for name, phase in zip("abc", (weave, other, turn), strict=True))
    return IntentModel(2, intents, tuple(map(tuple, rates.tolist())), (0.25, 0.25, 0.5), speed=0.7)


def test_twins_are_one_intent_that_begins_anew():
    """Joining twins loses nothing, with a fifth of the numbers; unlike weaves are not twins."""
    model = settled(twins())
    one = merge(model, 0, 1, renewed=True)
    assert one.intents[0].renewal == pytest.approx(0.4) and freedom(one) < freedom(model)
    tracks = heading_tracks(shaking(rows=40), np.arange(40) * STEP)
    batch = make_batch(tracks.measurements, tracks.times, tracks.noise, speed=0.7)
    whole, fewer, plain = (row_scores(m, batch).sum() for m in (model, one, merge(model, 0, 1)))
    assert fewer == pytest.approx(whole, abs=1e-6)
    assert abs(plain - whole) > 1e-3  # without beginning anew something is lost
    assert any(how == "a is b" for how, _ in smaller_models(model))
    assert merge(twins(0.5), 0, 1, renewed=True) is None
    assert not alike(model.intents[0].phases[0], model.intents[2].phases[0])
    # speeding up and slowing down together spread like a wide straight, and are none
    still = Phase(Law(2), (Birth(1.0, 0.0, 0.02, 0.0, 0.01),))
    changing = Phase(Law(2), tuple(Birth(0.5, side * 0.03, 0.01, 0.0, 0.01) for side in (1.0, -1.0)))
    assert alike(still, still) and alike(changing, changing) and not alike(still, changing)


def test_a_template_may_lose_a_phase_and_lasts_as_long():
    """Stay and leave times survive; each phase may go."""
    base = settled(twins())
    first, second = base.intents[0].phases[0], base.intents[2].phases[0]
    whole = Intent("a", (dataclasses.replace(first, duration=2.0), dataclasses.replace(second, duration=3.0), first))
    model = settled(IntentModel(2, (whole, base.intents[2]), ((-0.25, 0.25), (0.5, -0.5)), speed=0.7))
    found = dict(shorter_models(model))
    assert list(found) == ["a less 0", "a less 1", "a less 2"]
    lasts = [(5.0, 4.0), (2.0, 7.0), (2.0, 7.0)]
    for (how, one), (before, last) in zip(found.items(), lasts, strict=True):
        assert len(one.intents[0].phases) == 2, how
        assert one.intents[0].phases[0].duration == pytest.approx(before)
        assert -1.0 / one.generator[0][0] == pytest.approx(last)
        assert one.intent_probs(one.mode_shares())[0] == pytest.approx(9.0 / 11.0)
        assert freedom(one) < freedom(model)


def waggling(tracks=6, rows=120, seed=4):
    """Spells of 20 to 50 rows: turns that shake, to either side, and swings with a period of 2.4 rows; their labels."""
    rng = np.random.default_rng(seed)
    angle, labels = np.zeros((tracks, rows)), np.empty((tracks, rows), dtype="<U5")
    for b in range(tracks):
        now, left, word = rng.uniform(0.0, 6.0), 0, ""
        for k in range(rows):
            if left == 0:
                word = str(rng.choice([other for other in ("swing", "left", "right") if other != word]))
                left = int(rng.integers(20, 50))
            left -= 1
            labels[b, k] = word
            swings = word == "swing"
            now += rng.normal(scale=0.02) if swings else {"left": 0.13, "right": -0.13}[word] + rng.normal(scale=0.15)
            angle[b, k] = now + swings * (0.3 * np.sin(2.0 * np.pi * k / 2.4) + rng.normal(scale=0.03))
    return angle, labels


def test_swings_that_no_window_resolves_are_found():
    """The learner begins where windows see nothing: turns that shake, and weaves of little more than two rows."""
    angle, labels = waggling()
    tracks = heading_tracks(angle, np.arange(angle.shape[1]) / 30.0)
    learner = IntentLearner(2, 2, seed=0, threads=1, most=4, heat=8, first=25, rounds=0, last=15).fit(tracks)
    swings = [intent.phases[0].law.swing for intent in learner.model_.intents]
    found = score_segmentation(learner.segment(tracks), np.where(labels == "swing", "swing", "turn"), 0.2)
    assert found.accuracy > 0.9, learner.model_.describe()
    assert any(swing and 2.0 * np.pi / swing[0] == pytest.approx(2.4 / 30.0, rel=0.1) for swing in swings)


def test_a_weave_that_nobody_would_see_is_called_straight():
    law = Law(2, swing=(3.0, 0.1), wobble=0.01)
    seen, unseen = (Phase(law, (Birth(1.0, 0.0, 1e-4, 0.0, rate),)) for rate in (0.5, 0.05))
    assert describe_phase(seen).startswith("weave of 2.1 s") and describe_phase(unseen) == "straight"


@pytest.mark.parametrize(("rare", "left"), [(0.0, 2), (0.5, 3)])
def test_pruning_looks_at_what_the_floor_of_outliers_hides(rare, left):
    """An intent of few rows costs nothing under the floor; without the floor it does, and stays."""

    class Trained:
        settings = Settings()

        def climb(self, model, batch, stage, steps):
            return model

        def mean(self, model, batch, *, whole=False):
            return -9.8 - whole * rare * (3 - len(model.intents))

    model = settled(twins())
    assert len(pruned(Trained(), model, SimpleNamespace(rows=5000)).intents) == left
