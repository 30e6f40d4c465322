"""`jink track` with estimators that judge the noise: what it says about surges."""

import re

import numpy as np
import pandas as pd
import pytest

from jink.training.cli import main
from jink.training.track import TrackRequest, track


@pytest.fixture(scope="module")
def surging(tmp_path_factory):
    """Straight, sigma 1 m, 30 m for ten rows and 1000 m for one."""
    rng = np.random.default_rng(1)
    times = 0.5 * np.arange(120)
    sigma = np.ones(120)
    sigma[60:70], sigma[100] = 30.0, 1000.0
    z = np.stack([20.0 * times, 10.0 * times], axis=1) + sigma[:, None] * rng.normal(size=(120, 2))
    path = tmp_path_factory.mktemp("surging") / "surging.csv"
    pd.DataFrame({"track": "a", "t": times, "x": z[:, 0], "y": z[:, 1]}).to_csv(path, index=False)
    return path


def run(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out + err


def test_surges_are_told_and_written(surging, tmp_path, capsys):
    out = tmp_path / "e.csv"
    given = ("--sigma", 1, "--acceleration", 1, "--speed", 20, "--surge-for", 3, "--surge-every", 50)
    code, text = run(capsys, "track", surging, "-e", "joint-imm", *given, "--out", out)
    assert code == 0
    assert re.search(r"surge_every +given +50 +s", text) and re.search(r"surge_for +given +3 +s", text)
    assert "time in intents: straight" in text and "4096R" not in text
    assert re.search(r"noise: surging \d+ % of the time; R times 1\.\d* in the median row", text)
    assert re.search(r"[1-9]\d* rows are at the highest noise level, 4096 R", text)
    assert "sigma was tuned" not in text
    written = pd.read_csv(out)
    loud = written["surge_probability"].to_numpy()
    assert loud[61:70].mean() > 0.9
    assert loud[20:60].mean() < 0.1
    assert written["noise_scale"][60:70].mean() > 50.0


def test_a_learnt_noise_is_told_and_written(surging, tmp_path, capsys):
    out = tmp_path / "e.csv"
    given = ("--sigma", 1, "--acceleration", 1, "--speed", 20)
    code, text = run(capsys, "track", surging, "-e", "vb-noise", *given, "--out", out)
    assert code == 0
    assert re.search(r"noise learnt, standard deviation in the median row: x [\d.]+ m, y [\d.]+ m", text)
    scale = pd.read_csv(out)["noise_scale"]
    assert scale[66:70].mean() > 20.0 * scale[20:60].mean()


def test_a_sigma_tuned_with_the_surges_is_doubted(surging):
    request = TrackRequest(surging, "joint-imm", acceleration=1.0, speed=20.0)
    report = track(request)
    assert any("give --sigma" in doubt for doubt in report.doubts)
    assert not any("give --sigma" in doubt for doubt in track(TrackRequest(surging, "kf-cv", speed=20.0)).doubts)
    assert not any("give --sigma" in doubt for doubt in track(TrackRequest(surging, "joint-imm", sigma="1")).doubts)


def test_surges_fit_the_interval_unless_told(surging, tmp_path):
    frame = pd.read_csv(surging)
    slow = tmp_path / "slow.csv"
    frame.assign(t=10.0 * np.arange(len(frame))).to_csv(slow, index=False)
    for file, every, origin in ((surging, 20.0, "default"), (slow, 20.0 / 1.5 * 20.0, "interval")):
        found = {item.name: item for item in track(TrackRequest(file, "joint-imm", sigma="1", speed=20.0)).parameters}
        assert found["surge_every"].value == pytest.approx(every)
        assert found["surge_every"].origin == origin


def test_refusals(surging, capsys):
    code, text = run(capsys, "track", surging, "--surge-for", 3)
    assert code == 2
    assert "--surge-for: value must come with --estimator joint-imm" in text
    code, text = run(capsys, "track", surging, "-e", "joint-imm", "--surge-for", -3)
    assert code == 2
    assert "--surge-for: value must be > 0 and finite; got -3" in text


def test_a_plain_estimator_has_no_reading(surging):
    assert track(TrackRequest(surging, "kf-cv", sigma="1", speed=20.0)).noise is None
