"""Rows that no path leads to are left out before anything is fitted; everything a target can do is kept."""

from __future__ import annotations

import numpy as np
import pytest

from jink.estimators.tracks import Tracks
from jink.intent.devices import check_device
from jink.intent.lessons import make_lessons
from jink.intent.outliers import absurd_rows

SIGMA = 5.0


def straight(count: int = 12, rows: int = 60) -> np.ndarray:
    """Straight flights at 50 m/s, 5 m of noise, all over the place."""
    rng = np.random.default_rng(4)
    heading = rng.uniform(-np.pi, np.pi, count)
    velocity = 50.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    z = rng.normal(0.0, 1e4, (count, 1, 2)) + velocity[:, None] * np.arange(float(rows))[None, :, None]
    return z + SIGMA * rng.standard_normal(z.shape)


@pytest.mark.parametrize("size", [1e7, 1e9, 1e11])
def test_rows_off_by_thousands_of_scenes_are_found(size: float) -> None:
    rng = np.random.default_rng(1)
    z = straight()
    wrong = rng.random(z.shape[:2]) < 0.01
    wrong[0, 0] = wrong[1, -1] = wrong[2, 20] = wrong[2, 21] = True  # at either end, and two together
    z[wrong] = size * np.sign(rng.standard_normal((wrong.sum(), 2)))  # the same few places: also a run of one value
    z[3, 7] = np.nan
    tracks = Tracks.from_arrays(z, np.arange(60.0))
    assert (absurd_rows(tracks) == (wrong & np.isfinite(z[..., 0]))).all()
    lessons = make_lessons(tracks, 0)
    assert lessons.left_out == absurd_rows(tracks).sum() >= 5
    # the noise is a median, 2 % off for 700 rows; it must not know the wrong ones
    assert lessons.noise_sd == pytest.approx((SIGMA, SIGMA), rel=0.15)
    assert np.nanmax(np.abs(lessons.pieces.measurements)) < 1e5


def test_what_targets_do_is_kept() -> None:
    rng = np.random.default_rng(2)
    z, clock = straight(), np.arange(60.0)
    assert not absurd_rows(Tracks.from_arrays(z, clock)).any()
    # 55 of 60 rows at rest to a centimetre, then off at 5 m per row: hundreds of thousands of centimetres in the end
    rest = np.cumsum(np.where(np.arange(600) < 550, 0.0, 5.0))[None, :, None] * np.ones((6, 1, 2))
    rest = rest + 0.01 * rng.standard_normal(rest.shape)
    assert not absurd_rows(Tracks.from_arrays(rest, np.arange(600.0))).any()
    # out of sight for ten days, and seen again far away
    late = np.where(clock < 57, clock, clock + 864000.0)
    z[:, 57:] += 50.0 * 864000.0
    assert not absurd_rows(Tracks.from_arrays(z, late)).any()
    # nothing moves: there is no scale
    assert not absurd_rows(Tracks.from_arrays(np.ones((4, 30, 2)), np.arange(30.0))).any()
    assert not absurd_rows(Tracks.from_arrays(np.full((4, 30, 2), np.nan), np.arange(30.0))).any()


def test_a_device_that_is_not_there_is_refused_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    check_device("cpu")
    with pytest.raises(ValueError, match="IntentLearner: device must be cpu or cuda; got 'tpu'"):
        check_device("tpu")
    torch = pytest.importorskip("torch")
    from jink.intent.learner import IntentLearner

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for device in ("cuda", "cuda:1"):
        with pytest.raises(ValueError, match=f"IntentLearner: device must be cpu where there is no GPU.*'{device}'"):
            IntentLearner(device=device)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    assert IntentLearner(device="cuda").settings.device == "cuda"
    with pytest.raises(ValueError, match="number below 1"):
        IntentLearner(device="cuda:1")
