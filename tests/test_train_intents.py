"""`jink train intents` and what uses its folder: the command line, kill and resume, pictures, models by name."""

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from stand_in_learner import StandInLearner, stand_in_model

from jink.envs.scenarios import make_scenario
from jink.envs.simulate import simulate_tracks
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks
from jink.intent.model_file import MODEL_FILE, load_model, save_model
from jink.intent.pretrained import load_pretrained, pretrained_names
from jink.intent.progress import Progress
from jink.training import intent_drawing
from jink.training import train_intents as training
from jink.training.cli import main
from jink.training.intent_graphs import CurvePoint, plot_curve, plot_graph
from jink.training.intent_pictures import draw_model
from jink.training.pooling import as_positions, digest_of, gather, pool
from jink.training.sketch import sketch
from jink.training.track import TrackRequest
from jink.training.training_log import TrainingLog, describe_progress

TESTS = Path(__file__).resolve().parent


def run(*arguments):
    return main([str(argument) for argument in arguments])


def refused(capsys, *arguments):
    """Exit code 2 and one sentence on stderr."""
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    said = err.replace("compiling (first run only)\n", "")
    assert out == "" and len(said.strip().splitlines()) == 1 and said.startswith("jink: "), err
    return said


@pytest.fixture(autouse=True)
def coarse_pictures(monkeypatch):
    """What is drawn does not depend on the resolution, which costs most of the time."""
    monkeypatch.setattr(intent_drawing, "DPI", 50)


@pytest.fixture
def stand_in(monkeypatch):
    """The command with the learner replaced; returns what each learner was asked for."""
    asked = []

    def make(request, tracks, checkpoint, log):
        asked.append((request, tracks))
        return StandInLearner(tracks.axes, log, checkpoint, request.seed)

    monkeypatch.setattr(training, "_make_learner", make)
    return asked


@pytest.fixture
def files(tmp_path):
    """Two files of six tracks each."""
    tracks = simulate_tracks(make_scenario("switch-loiter-v0", steps=40), 12, 5)
    names = []
    for number, part in enumerate((range(6), range(6, 12))):
        frames = [
            pd.DataFrame({"track": tracks.ids[b], "t": tracks.times[b], "x": z[:, 0], "y": z[:, 1]})
            for b in part
            for z in [tracks.measurements[b]]
        ]
        names.append(tmp_path / f"part{number}.csv")
        pd.concat(frames).to_csv(names[-1], index=False)
    return names


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_files_become_a_folder_with_model_pictures_and_summary(stand_in, files, tmp_path, capsys):
    out = tmp_path / "model"
    assert run("train", "intents", *files, "--sigma", 1.5, "--out", out, "--seed", 4) == 0
    text, err = capsys.readouterr()
    assert "12 tracks, 480 rows in 2 axes" in text
    assert re.search(r"intent 2 \(turn\): turn, .* deg/s either way", text)
    assert re.search(r"1 +-7\.5000 +-0\.3000 to -0\.1000", text) and re.search(r"2 +-7\.3000 +best +chosen", text)
    assert "fit 1 of 8: 3 intents, -8.000 nats per row" in err
    names = {MODEL_FILE, "README.md", "training.json", *training.PICTURES}
    assert {name for name in contents(out) if not name.startswith("weights-")} == names
    assert not (out / "checkpoint").exists()
    for name in training.PICTURES:
        assert plt.imread(out / name).std() > 0.02, name  # something is drawn
    model = load_model(out)
    assert model.about["seed"] == 4 and model.about["held_out"] == -7.3
    assert model.about["tracks"]["tracks"] == 12 and model.about["curve"][0] == [1.0, -7.5, -7.6, -7.4]
    assert str(tmp_path) not in (out / MODEL_FILE).read_text() + (out / "README.md").read_text()
    readme = (out / "README.md").read_text()
    assert model.describe().splitlines()[1] in readme and "| 2 (chosen) | -7.3000 |" in readme
    ((request, tracks),) = stand_in
    np.testing.assert_allclose(tracks.noise[0, 0], np.diag([1.5**2] * 2))
    assert request.intents is None and tracks.ids[0].startswith("part0/")


def test_scenarios_and_suites_are_sources(stand_in, tmp_path, capsys):
    assert run("train", "intents", "switch-loiter-v0", "--tracks", 8, "--steps", 30, "--out", tmp_path / "m") == 0
    ((_, tracks),) = stand_in
    assert tracks.times.shape == (8, 30) and tracks.noise is not None
    expected = simulate_tracks(make_scenario("switch-loiter-v0", steps=30), 8, 0)
    np.testing.assert_array_equal(tracks.measurements, expected.measurements)
    both = gather(["switch"], TrackRequest(Path()), count=2, steps=30)
    assert len(both) == 12 and both.sensor == "position" and len(set(both.ids)) == 12


def test_the_same_command_again_only_shows(stand_in, files, tmp_path, capsys):
    out = tmp_path / "m"
    assert run("train", "intents", *files, "--out", out) == 0
    before = contents(out)
    capsys.readouterr()
    assert run("train", "intents", *files, "--out", out) == 0
    text = capsys.readouterr().out
    assert "already trained" in text and "-7.3000" in text and contents(out) == before and len(stand_in) == 1
    assert "must not hold a model of other tracks" in refused(
        capsys, "train", "intents", *files, "--out", out, "--seed", 1
    )
    assert contents(out) == before
    assert run("train", "intents", *files, "--out", out, "--seed", 1, "--fresh") == 0
    assert load_model(out) != stand_in_model() and len(stand_in) == 2 and contents(out).keys() - before.keys()


def test_a_kill_and_the_same_command_give_the_same_files(stand_in, files, tmp_path, capsys):
    code = (
        "import sys; from pathlib import Path\n"
        "from stand_in_learner import StandInLearner\n"
        "from jink.training import train_intents as t\n"
        "from jink.training.cli import main\n"
        "t._make_learner = lambda request, tracks, checkpoint, log: StandInLearner(\n"
        "    tracks.axes, log, checkpoint, request.seed, kill_at=3)\n"
        "sys.exit(main())\n"
    )
    whole, killed = tmp_path / "a" / "model", tmp_path / "b" / "model"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])}
    arguments = ["train", "intents", *map(str, files), "--out", str(killed)]
    done = subprocess.run([sys.executable, "-c", code, *arguments], env=environment, capture_output=True, check=False)
    assert done.returncode == -9, done.stderr
    assert not (killed / MODEL_FILE).exists() and (killed / "checkpoint").is_dir()
    with (killed / "checkpoint" / "progress.jsonl").open("a") as file:
        file.write('["fit", 4, 3, -7')  # a line that the kill cut short
    assert run("train", "intents", *files, "--out", killed) == 0
    text, err = capsys.readouterr()
    assert "went on from its checkpoint" in text and "fit 4 of 8" in err and "fit 1 of 8" not in err
    assert run("train", "intents", *files, "--out", whole) == 0
    assert contents(killed) == contents(whole)


def test_an_unfinished_training_is_not_mixed_with_another(stand_in, files, tmp_path, capsys, monkeypatch):
    out = tmp_path / "m"
    fit = StandInLearner.fit

    def stop(self, tracks):
        raise KeyboardInterrupt

    monkeypatch.setattr(StandInLearner, "fit", stop)
    assert run("train", "intents", *files, "--out", out) == 130
    monkeypatch.setattr(StandInLearner, "fit", fit)
    capsys.readouterr()
    assert "must not hold an unfinished training of other" in refused(
        capsys, "train", "intents", files[0], "--out", out
    )
    assert run("train", "intents", files[0], "--out", out, "--fresh", "--sigma", 1) == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nothing.csv",), "SOURCES: each must be a file, or a scenario or suite"),
        (("{file}", "--intents", "0"), "--intents: value must be >= 1"),
        (("{file}", "--tracks", "1"), "--tracks: value must be >= 2"),
        (("{file}", "--steps", "3"), "--steps: value must be >= 10"),
        (("{file}", "--noise", "loud"), "--noise: value must be metres > 0 or learn; got 'loud'"),
        (("{file}", "--noise", "-1"), "--noise: value must be metres"),
        (("{file}", "--seconds", "0"), "--seconds: value must be > 0"),
        (("{file}", "--out", "{file}"), "--out: value must be a folder"),
        (("{file}", "--out", "{folder}"), "--out: folder must be new, empty or of an earlier training"),
        (("{file}", "switch", "--steps", "20"), "SOURCES: all must have the same noise"),
        (("{file}", "air-switch-v0", "--steps", "20", "--sigma", "1"), "SOURCES: all must have the same axes"),
        (("passive-ship-v0", "--steps", "20", "--tracks", "2"), "must carry positions|must be given"),
    ],
)
def test_refusals_are_one_sentence(stand_in, files, tmp_path, capsys, arguments, words):
    folder = tmp_path / "full"
    folder.mkdir()
    (folder / "thesis.tex").write_text("mine")
    filled = [argument.format(file=files[0], folder=folder) for argument in arguments]
    if "--out" not in filled:
        filled += ["--out", str(tmp_path / "m")]
    assert re.search(words, refused(capsys, "train", "intents", *filled))
    assert (folder / "thesis.tex").read_text() == "mine"


def test_positions_that_never_change_teach_nothing(stand_in, files, tmp_path, capsys):
    frame = pd.read_csv(files[0])
    still = tmp_path / "still.csv"
    frame.assign(x=4.0, y=frame["track"].astype(float)).to_csv(still, index=False)  # another place for every track
    said = refused(capsys, "train", "intents", still, "--sigma", 1, "--out", tmp_path / "m")
    assert "SOURCES: positions must change within a track; got the same one in every row of still.csv" in said
    assert not (tmp_path / "m").exists() and not stand_in
    frame.loc[len(frame) - 1, "x"] += 1.0
    frame.assign(y=4.0).to_csv(still, index=False)
    assert run("train", "intents", still, "--sigma", 1, "--out", tmp_path / "m") == 0


def test_too_little_is_refused_in_the_words_of_the_command(files, tmp_path, capsys):
    pytest.importorskip("torch")
    few = tmp_path / "few.csv"
    pd.read_csv(files[0]).head(3).to_csv(few, index=False)
    said = refused(capsys, "train", "intents", few, "--sigma", 1, "--out", tmp_path / "m")
    assert said.startswith("jink: SOURCES: tracks must hold at least 100 measured rows")


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("tpu", "--device: value must be cpu or cuda; got 'tpu'"),
        ("cuda:x", "--device: value must be cpu or cuda; got 'cuda:x'"),
        ("cuda", "--device: value must be cpu where there is no GPU or no torch built for it; got 'cuda'"),
        ("cuda:7", "--device: value must be cpu where there is no GPU"),
    ],
)
def test_a_device_that_is_not_there_is_refused(files, tmp_path, capsys, monkeypatch, device, words):
    torch = pytest.importorskip("torch")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    given = ("train", "intents", files[0], "--sigma", 1, "--out", tmp_path / "m", "--device", device)
    assert words in refused(capsys, *given)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    if device == "cuda:7":
        assert "--device: value must have a number below 2" in refused(capsys, *given)


@pytest.mark.parametrize("command", [("train",), ("train", "intents"), ("show",), ("segment",)])
def test_help_has_examples(command, capsys):
    assert run(*command, "--help") == 0
    text = capsys.readouterr().out
    assert f"Usage: jink {' '.join(command)}" in text
    assert command == ("train",) or f"jink {' '.join(command)} " in text.replace("Usage: jink", "")


# Sources.


def test_ranges_and_bearings_become_positions():
    tracks = simulate_tracks(make_scenario("radar-switch-v0", steps=20), 2, 0)
    found = as_positions(tracks, None)
    assert found.sensor == "position" and found.measurements.shape == (2, 20, 2)
    seen = np.isfinite(found.measurements).all(axis=2)
    error = (found.measurements - tracks.truth)[seen]
    white = np.linalg.solve(np.linalg.cholesky(found.noise[seen]), error[..., None])[..., 0]
    assert 0.6 < np.mean(white**2) < 1.5  # 76 squares of unit variance: 4 sd are 0.65
    bare = Tracks.from_arrays(tracks.measurements, tracks.times, sensor="range-bearing")
    with pytest.raises(ValueError, match="--sigma: value must be given for a range-bearing sensor"):
        as_positions(bare, None)
    assert as_positions(bare, "15,0.003").noise is not None


def test_pooled_tracks_are_padded():
    long, short = (
        Tracks.from_arrays(np.full((1, T, 2), float(T)), np.arange(float(T)), source=f"{T}.csv", truth=truth)
        for T, truth in ((5, np.ones((1, 5, 2))), (3, None))
    )
    both = pool([long, short])
    assert both.ids == ("5/1", "3/1") and both.lengths.tolist() == [5, 3]
    assert np.isnan(both.measurements[1, 3:]).all() and both.times[1, 4] == 2.0 and np.isnan(both.truth[1]).all()
    assert digest_of(both) == digest_of(pool([long, short])) != digest_of(pool([short, long]))
    same = pool([long, long])
    assert same.ids == ("1/1", "2/1")


# Reports of a fit.


def test_the_log_keeps_what_a_killed_run_said(tmp_path):
    path = tmp_path / "progress.jsonl"
    reports = [Progress("fit", k, 4, 3, -8.0 + k) for k in range(4)]
    with TrainingLog(path, tmp_path / "board") as log:
        log(Progress("clusters", 0, 0, 6, float("nan")))
        for report in reports[:3]:
            log(report)
    with TrainingLog(path, tmp_path / "board") as log:
        for report in reports[1:]:
            log(report)
        trace = log.trace()
    assert [report.log_likelihood for report in trace] == [-8, -7, -6, -5]
    assert [report.step for report in trace] == [0, 1, 2, 3] and len(path.read_text().splitlines()) == 4
    assert describe_progress(reports[0]) == "3 intents, -8.000 nats per row"
    assert describe_progress(Progress("a", 0, 0, 1, float("nan"))) == "1 intent"
    assert "held out" in describe_progress(Progress("a", 0, 0, 2, -1.0, True))


def test_tensorboard_is_used_where_it_is_installed(tmp_path, monkeypatch):
    from jink.training import training_log

    written = []

    class Board:
        def add_scalar(self, *arguments):
            written.append(arguments)

        def close(self):
            written.append("closed")

    monkeypatch.setattr(training_log, "make_board", lambda folder: Board())
    with TrainingLog(tmp_path / "p.jsonl", tmp_path / "board") as log:
        log(Progress("fit", 1, 4, 3, -8.0))
    assert written == [("fit/nats per row", -8.0, 1), ("fit/intents", 3, 1), "closed"]


# Showing.


def test_show_prints_and_draws(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_model(stand_in_model().with_(about={"tracks": {"tracks": 7, "source": "[red]a.csv"}}), "m")
    assert run("show", "m", "--plot", "m.png") == 0
    text = capsys.readouterr().out
    assert "m: 2 intents in 2 axes, learned from 7 tracks of [red]a.csv" in text and "intent 2 (turn)" in text
    assert re.search(r"straight +- +100 % +10 s", text)
    assert any(0x2801 <= ord(letter) < 0x2900 for letter in text)
    assert plt.imread(tmp_path / "m.png").std() > 0.02
    assert "MODEL: value must be a folder that jink train intents wrote" in refused(capsys, "show", tmp_path / "none")
    (tmp_path / "m" / MODEL_FILE).write_text("{}")
    assert "MODEL: intents.json must have format" in refused(capsys, "show", tmp_path / "m")


def test_a_template_lasts_as_long_as_its_phases(tmp_path, capsys):
    made = stand_in_model()
    straight, turn = made.intents
    (phase,) = straight.phases
    two = replace(straight, phases=(replace(phase, duration=7.0), phase))
    save_model(made.with_(intents=(two, turn)), tmp_path / "m")
    alone = 1.0 / -made.generator[0][0]
    assert run("show", tmp_path / "m") == 0
    text = capsys.readouterr().out
    assert re.search(rf"straight +- +100 % +{7 + alone:.2g} s by its", text) and f"lasts {7 + alone:.2g} s" in text


@pytest.mark.parametrize("axes", [2, 3])
def test_pictures_of_one_and_of_several_intents(tmp_path, axes):
    model = stand_in_model(axes)
    one = model.with_(intents=model.intents[:1], generator=(), initial=())
    for name, drawn in (("several", model), ("one", one)):
        draw_model(tmp_path / f"{name}.png", drawn)
        plot_graph(tmp_path / f"graph-{name}.svg", drawn)
        assert plt.imread(tmp_path / f"{name}.png").std() > 0.02
    plot_curve(tmp_path / "none.png", [], (), 1)
    plot_curve(tmp_path / "unknown.png", [], (CurvePoint(1, -2.0, np.nan, np.nan),), 1)
    assert len(list(tmp_path.iterdir())) == 6


def test_a_sketch_has_equal_scales():
    line = np.stack([np.linspace(0, 10, 5), np.zeros(5)], axis=1)
    rows = sketch([line], 10, 4)
    assert len(rows) == 4 and all(len(row) == 10 for row in rows)
    inked = [i for i, row in enumerate(rows) if set(row) != {chr(0x2800)}]
    assert len(inked) == 1
    upright = sketch([line[:, ::-1]], 10, 4)
    assert all(sum(letter != chr(0x2800) for letter in row) == 1 for row in upright)
    rising = sketch([np.stack([line[:, 0], line[:, 0]], axis=1)], 10, 5)
    assert rising[0].rstrip(chr(0x2800)) and rising[0].index(rising[0].strip(chr(0x2800))) > 5  # up is up


# Tracking with a model.


def test_make_estimator_takes_a_model(tmp_path):
    model, sensor = stand_in_model(), position(2, 3.0)
    estimator = make_estimator("intent-imm", sensor, model=model)
    assert estimator.modes == ("straight", "turn left", "turn right") and estimator.name == "intent-imm"
    joint = make_estimator("joint-imm", sensor, model=model)
    assert len(joint.modes) == 3 * 7 and joint.intents == estimator.modes
    with pytest.raises(ValueError, match=r"model must be left out for imm.*intent-imm, joint-imm"):
        make_estimator("imm", sensor, model=model)
    with pytest.raises(ValueError, match=r"model must have a method bank\(sensor\); got 'm'. Load it first"):
        make_estimator("intent-imm", sensor, model="m")


def test_track_with_a_model(files, tmp_path, capsys):
    model = stand_in_model()
    save_model(model, tmp_path / "m")
    out, plot = tmp_path / "e.csv", tmp_path / "e.png"
    given = ("track", files[0], "-e", "intent-imm", "--model", tmp_path / "m")
    assert run(*given, "--sigma", 1, "--out", out, "--plot", plot) == 0
    text = capsys.readouterr().out
    assert re.search(r"intents +model +2", text) and re.search(r"speed +model +10", text)
    assert "acceleration" not in text and plot.stat().st_size > 10_000
    written = pd.read_csv(out)
    assert {"mode_straight", "mode_turn left", "mode_turn right"} <= set(written)
    tracks = gather([str(files[0])], TrackRequest(Path()))
    expected = make_estimator("intent-imm", position(2, 1.0), model=model).run(tracks.measurements, tracks.times)
    np.testing.assert_allclose(written[["x", "y"]].to_numpy()[:40], expected.position[0], rtol=1e-12)
    save_model(model.with_(noise_sd=(2.0, 2.5)), tmp_path / "m")
    assert run(*given) == 0
    assert re.search(r"sigma_y +model +2\.5", capsys.readouterr().out)
    assert "--model: value must come with --estimator intent-imm or joint-imm" in refused(
        capsys, "track", files[0], "--model", tmp_path / "m"
    )
    assert "--speed: option must be left out with --model" in refused(capsys, *given, "--speed", 3)
    save_model(stand_in_model(3), tmp_path / "m")
    assert "--model: model must have the 2 axes of the tracks; got one of 3" in refused(capsys, *given)


@pytest.fixture
def hooked(tmp_path):
    """A target that goes straight for 20 s, turns at 0.15 rad/s for 20 s and goes on straight."""
    times = np.arange(60.0)
    heading = 0.15 * np.clip(times - 20.0, 0.0, 20.0)
    truth = np.cumsum(10.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    z = truth + np.random.default_rng(3).normal(0, 0.5, truth.shape)
    path = tmp_path / "hook.csv"
    pd.DataFrame({"track": "a", "t": times, "x": z[:, 0], "y": z[:, 1]}).to_csv(path, index=False)
    slow = ((-0.03, 0.03), (0.03, -0.03))
    save_model(stand_in_model().with_(generator=slow), tmp_path / "m")
    return path


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_segment_labels_rows_and_finds_changes(hooked, tmp_path, capsys, suffix):
    out, plot = tmp_path / f"labels.{suffix}", tmp_path / "labels.png"
    given = ("segment", hooked, "--model", tmp_path / "m", "--sigma", 0.5)
    assert run(*given, "--out", out, "--plot", plot) == 0
    text = capsys.readouterr().out
    found = pd.read_csv(out) if suffix == "csv" else pd.read_parquet(out)
    assert list(found) == ["track", "t", "intent", "prob_straight", "prob_turn", "change"]
    truth = np.where((found["t"] > 20) & (found["t"] <= 40), "turn", "straight")
    assert (found["intent"] == truth).mean() > 0.93
    np.testing.assert_allclose(found["prob_straight"] + found["prob_turn"], 1.0, atol=1e-9)
    near = found["t"].between(17, 24)
    assert found["change"][near].sum() > 0.4 and found["change"][0] == 0.0
    times = [float(t) for t in re.findall(r"a +(?:straight > turn|turn > straight) +([\d.]+) +[01]\.", text)]
    np.testing.assert_allclose(times, [20.5, 40.5], atol=2.5)
    assert re.search(r"turn +3\d % +1", text) and plt.imread(plot).std() > 0.02
    assert run(*given, "--handed") == 0
    assert re.search(r"turn left +3\d % +1", capsys.readouterr().out)


def test_segment_refuses(hooked, tmp_path, capsys):
    given = ("segment", hooked, "--model", tmp_path / "m")
    assert "--out: file must not be the input file" in refused(capsys, *given, "--out", hooked)
    assert "--show: value must name a track; got 'z'" in refused(capsys, *given, "--show", "z")
    assert "--plot: file must end in .png" in refused(capsys, *given, "--plot", "a.gif")
    assert "--model: value must be a folder" in refused(capsys, "segment", hooked, "--model", "nothing")
    assert "Missing option '--model'" in refused(capsys, "segment", hooked)


def test_segment_estimates_noise_that_nobody_gave(hooked, tmp_path, capsys):
    assert run("segment", hooked, "--model", tmp_path / "m") == 0
    assert re.search(r"turn +[234]\d %", capsys.readouterr().out)


def test_pretrained_models_load():
    for name in pretrained_names():
        model = load_pretrained(name)
        assert model.modes and model.about["command"].startswith("jink train intents")
    with pytest.raises(ValueError, match="load_pretrained: name must be one of"):
        load_pretrained("../model")
