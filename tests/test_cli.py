"""The command line: what it prints, writes and refuses."""

import json
import re
import sys

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from jink.envs.recorded import read_tracks
from jink.estimators.recipes import RECIPES, make_estimator
from jink.estimators.sensors import SENSORS, position, range_bearing
from jink.training import bench as bench_module
from jink.training import published, rows
from jink.training.cli import main
from jink.training.options import parse_numbers, parse_sigma
from jink.training.recorded_suite import list_files


@pytest.fixture
def radar(tmp_path):
    """A straight leg and a turn, sigma 15 m, with truth."""
    times = np.arange(0.0, 60.0)
    heading = np.deg2rad(6.0) * np.clip(times - 30.0, 0.0, None)
    truth = np.cumsum(20.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    z = truth + np.random.default_rng(1).normal(scale=15.0, size=truth.shape)
    frame = {"track": "a", "t": times, "x": z[:, 0], "y": z[:, 1], "true_x": truth[:, 0], "true_y": truth[:, 1]}
    path = tmp_path / "radar.csv"
    pd.DataFrame(frame).to_csv(path, index=False)
    return path


def run(*arguments):
    return main([str(argument) for argument in arguments])


def refused(capsys, *arguments):
    """Exit code 2 and one sentence on stderr, nothing on stdout."""
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.strip().splitlines()) == 1, err
    assert err.startswith("jink: ")
    return err


@pytest.mark.parametrize("estimator", ["kf-cv", "imm"])
def test_track_prints_errors_and_writes_estimates(radar, tmp_path, capsys, estimator):
    out, plot = tmp_path / "e.parquet", tmp_path / "e.png"
    assert run("track", radar, "-e", estimator, "--sigma", 15, "--out", out, "--plot", plot) == 0
    text = capsys.readouterr().out
    assert re.search(r"sigma_x +given +15", text)
    assert re.search(r"acceleration +tuned", text)
    assert re.search(r"turn_rate +default", text)
    assert "59 ok, 1 starting" in text
    measured, estimated = map(float, re.search(r"root mean square +([\d.]+) +([\d.]+)", text).groups())
    assert estimated < 0.8 * measured
    written = pd.read_parquet(out)
    tracks = read_tracks(radar)
    error = np.linalg.norm(written[["x", "y"]].to_numpy() - tracks.truth[0], axis=1)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(estimated, rel=1e-3)
    assert plot.stat().st_size > 10_000
    assert plt.imread(plot).std() > 0.02  # something is drawn
    assert sorted(path.name for path in tmp_path.iterdir()) == ["e.parquet", "e.png", "radar.csv"]


def test_track_equals_the_library(radar, tmp_path):
    out = tmp_path / "e.csv"
    given = ("--sigma", 15, "--acceleration", 2, "--speed", 20, "--turn-rate", 0.1, "--sojourn", 20)
    assert run("track", radar, "-e", "imm", *given, "--out", out) == 0
    tracks = read_tracks(radar)
    scales = {"acceleration": 2.0, "speed": 20.0, "turn_rate": 0.1, "sojourn": 20.0}
    expected = make_estimator("imm", position(2, 15.0), **scales).run(tracks.measurements, tracks.times)
    np.testing.assert_allclose(pd.read_csv(out)[["x", "y"]], expected.position[0], rtol=1e-12)


def test_smoothing_and_forecast(radar, capsys):
    given = ("--sigma", 15, "--acceleration", 1, "--speed", 20)

    def error(*more):
        assert run("track", radar, "-e", "kf-cv", *given, *more) == 0
        text = capsys.readouterr().out
        return float(re.search(r"root mean square +[\d.]+ +([\d.]+)", text).group(1)), text

    filtered, _ = error()
    smoothed, text = error("--smooth", "--forecast", 5)
    assert smoothed < 0.9 * filtered
    assert re.search(r"forecast of a at 64 s: \([\d.-]+, [\d.-]+\) m, sd", text)


def test_sigmas_of_the_file_are_used(radar, capsys):
    frame = pd.read_csv(radar)
    frame["sigma_x"] = frame["sigma_y"] = 15.0
    frame.to_csv(radar, index=False)
    assert run("track", radar, "-e", "kf-cv") == 0
    assert re.search(r"sigma_x +file +by row", capsys.readouterr().out)


def test_polar_measurements_in_degrees(tmp_path, capsys):
    times = np.arange(0.0, 40.0)
    truth = np.stack([1000.0 + 30.0 * times, 2000.0 - 10.0 * times], axis=1)
    rng = np.random.default_rng(0)
    reach = np.hypot(*truth.T) + rng.normal(scale=10.0, size=40)
    bearing = np.degrees(np.arctan2(truth[:, 1], truth[:, 0])) + rng.normal(scale=0.3, size=40)
    path = tmp_path / "polar.csv"
    frame = {"t": times, "range": reach, "bearing": bearing, "true_x": truth[:, 0], "true_y": truth[:, 1]}
    pd.DataFrame(frame).to_csv(path, index=False)
    given = ("--sigma", "sigma_range=10,sigma_bearing=0.005", "--acceleration", 0.1, "--degrees")
    assert run("track", path, "-e", "kf-cv", *given) == 0
    measured, estimated = map(
        float, re.search(r"root mean square +([\d.]+) +([\d.]+)", capsys.readouterr().out).groups()
    )
    assert estimated < 0.9 * measured


def test_list_names_everything(capsys):
    assert run("list") == 0
    text = capsys.readouterr().out
    for name in (*RECIPES, *SENSORS, "coordinated-turn", "b2-atc-turns-v0", "published", "recorded"):
        assert re.search(rf"^ {re.escape(name)} ", text, re.M), name


@pytest.mark.parametrize("command", [(), ("track",), ("list",), ("bench",)])
def test_help_has_examples(command, capsys):
    assert run(*command, "--help") == 0
    text = capsys.readouterr().out
    assert "Usage: jink" in text
    assert not command or f"jink {command[0]}" in text.replace("Usage: jink", "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("track",), "Missing argument"),
        (("track", "{radar}", "--bogus"), "No such option"),
        (("fly",), "No such command"),
        (("track", "nothing.csv"), "must name an existing file; got nothing.csv"),
        (("track", "{radar}", "-e", "imn"), "--estimator: name must be one of kf-cv.*; got 'imn'"),
        (("track", "{radar}", "--sigma", "-1"), "--sigma: value must be > 0"),
        (("track", "{radar}", "--sigma", "1,2,3"), "must have 2 numbers"),
        (("track", "{radar}", "--speed", "0"), "--speed: value must be > 0"),
        (("track", "{radar}", "--where", "x"), "--where: value must be NAME=VALUE"),
        (("track", "{radar}", "--columns", "t"), "columns must be pairs"),
        (("track", "{radar}", "--out", "e.txt"), r"--out: file must end in \.parquet or \.csv"),
        (("track", "{radar}", "--out", "no/where/e.csv"), "must lie in an existing folder"),
        (("track", "{radar}", "--plot", "e.gif"), r"must end in \.png"),
        (("track", "{radar}", "--show", "b"), "must name tracks; got 'b'"),
        (("bench", "--suite", "speed"), "--suite: name must be one of published, recorded"),
        (("bench", "--suite", "recorded"), "--data: folder must be given"),
        (("bench", "--suite", "recorded", "--data", "nowhere"), "folder must exist"),
        (("bench", "--suite", "published", "--runs", "0"), "--runs: value must be >= 1"),
        (("bench", "--suite", "published", "--out", "{radar}"), r"must end in \.parquet"),
    ],
)
def test_refusals_are_one_sentence(radar, capsys, arguments, words):
    filled = [argument.format(radar=radar) for argument in arguments]
    assert re.search(words, refused(capsys, *filled))


def test_an_unwritable_folder_is_one_sentence(radar, capsys, monkeypatch):
    def denied(self, *_, **__):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr("pathlib.Path.touch", denied)
    assert "folder must be writable" in refused(capsys, "track", radar, "--out", radar.with_name("e.csv"))


def test_sigma_forms():
    plane, polar = position(2), range_bearing()
    assert parse_sigma("15", plane) == (15.0, 15.0)
    assert parse_sigma("15,3", plane) == (15.0, 3.0)
    for text in ("1,.01", "sigma_range=1,sigma_bearing=.01", "bearing=0.01, range=1"):
        assert parse_sigma(text, polar) == (1.0, 0.01)
    for text in ("1", "range=1", "range=1,bearing=2,x=3", "nan,1", "a,b"):
        with pytest.raises(ValueError, match=r"^--sigma: value must"):
            parse_sigma(text, polar)
    with pytest.raises(ValueError, match="twice"):
        parse_numbers("--bias", ["range=1", "range=2"])


# Benchmark.


@pytest.fixture
def few_cells(monkeypatch):
    cells = tuple(cell for cell in published.PUBLISHED_CELLS if cell.scenario == "n4-cv-ca-v0")
    monkeypatch.setattr(published, "PUBLISHED_CELLS", cells)
    return cells


def test_published_rows_carry_their_provenance(few_cells, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["jink", "bench", "--out", str(tmp_path / "rows.parquet")])
    rows.provenance.cache_clear()
    out = tmp_path / "rows.parquet"
    assert run("bench", "--suite", "published", "--runs", 5, "--seed", 3, "--out", out) == 0
    assert re.search(r"kf-ca +position_mse +0\.0\d+ +0\.0318 ±0\.0003", capsys.readouterr().out)
    table = rows.read_rows(out)
    assert list(table["estimator"]) == [cell.estimator for cell in few_cells]
    assert set(table["status"]) == {"ok"}
    assert set(table["runs"]) == {5} and set(table["seed"]) == {3}
    assert np.all(table["published_low"] < table["published"]) and np.all(table["steps"] == 5 * 200)
    assert json.loads(table["versions"][0])["numba"] and json.loads(table["machine"][0])["cores"] > 0
    assert table["command"][0] == "jink bench --out rows.parquet"
    assert str(tmp_path) not in table.to_csv()
    rows.provenance.cache_clear()


def test_a_benchmark_goes_on_where_it_stopped(few_cells, tmp_path, capsys, monkeypatch):
    out = tmp_path / "rows.parquet"
    compute, calls = published.run_cell, []

    def stop_at_second(cell, runs, seed):
        calls.append(cell.estimator)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return compute(cell, runs, seed)

    monkeypatch.setattr(published, "run_cell", stop_at_second)
    arguments = ("bench", "--suite", "published", "--runs", 3, "--out", out)
    assert run(*arguments) == 130
    assert "stopped" in capsys.readouterr().err
    first = rows.read_rows(out)
    assert list(first["estimator"]) == ["kf-cv"]
    assert run(*arguments) == 0
    assert calls == ["kf-cv", "kf-ca", "kf-ca", "imm"]
    assert "1 of 3 cells were already in rows.parquet" in capsys.readouterr().out
    second = rows.read_rows(out)
    assert list(second["estimator"]) == ["kf-cv", "kf-ca", "imm"]
    pd.testing.assert_frame_equal(second.iloc[:1], first)
    # Another seed is another cell.
    assert run(*arguments, "--seed", 2) == 0
    assert len(rows.read_rows(out)) == 6


def test_a_failing_cell_is_a_row_and_is_tried_again(few_cells, tmp_path, capsys, monkeypatch):
    out = tmp_path / "rows.parquet"
    compute = published.run_cell

    def fail(cell, runs, seed):
        if cell.estimator == "kf-ca":
            raise ValueError("no such thing")
        return compute(cell, runs, seed)

    monkeypatch.setattr(published, "run_cell", fail)
    arguments = ("bench", "--suite", "published", "--runs", 3, "--out", out)
    assert run(*arguments) == 1
    assert "error: n4-cv-ca-v0 (kf-ca): no such thing" in capsys.readouterr().out
    assert list(rows.read_rows(out)["status"]) == ["ok", "error", "ok"]
    monkeypatch.setattr(published, "run_cell", compute)
    assert run(*arguments) == 0
    assert set(rows.read_rows(out)["status"]) == {"ok"}


def test_a_foreign_file_is_not_overwritten(few_cells, tmp_path, capsys):
    out = tmp_path / "rows.parquet"
    pd.DataFrame({"a": [1]}).to_parquet(out)
    assert "must have the columns of jink bench" in refused(capsys, "bench", "--suite", "published", "--out", out)
    assert list(pd.read_parquet(out)) == ["a"]


def test_common_truth_and_other_seeds(few_cells):
    cell = few_cells[0]
    assert published.run_cell(cell, 3, 1) == published.run_cell(cell, 3, 1)
    assert published.run_cell(cell, 3, 1).values != published.run_cell(cell, 3, 2).values


def test_every_published_number_has_a_cell():
    compared = {
        (cell.scenario, cell.estimator): set(published.published_values(cell)) for cell in published.PUBLISHED_CELLS
    }
    wanted = sum(len(s.published) for s in [*published.SCENARIOS.values(), published.UNCERTAIN])
    # Not repeated: the source's "imm-bayes", which differs from its "imm" by 0.01.
    assert sum(len(metrics) for metrics in compared.values()) == wanted - 1


def test_the_recorded_suite_reads_a_folder(radar, tmp_path, capsys, monkeypatch):
    folder = tmp_path / "data"
    folder.mkdir()
    radar.rename(folder / "radar.csv")
    frame = pd.read_csv(folder / "radar.csv")
    frame[["t", "x", "y"]].to_csv(folder / "plain.csv", index=False)
    (folder / "broken.csv").write_text("t,x,y\n0,1,2\n1,two,3\n")
    monkeypatch.setattr(bench_module, "ESTIMATORS", ("raw", "kf-cv"))
    out = tmp_path / "rows.parquet"
    assert run("bench", "--suite", "recorded", "--data", folder, "--out", out) == 1
    text = capsys.readouterr().out
    assert re.search(r"radar\.csv +1\d\.\d+ \(\d+\.\d+\) +\d+\.?\d* \(", text)
    assert re.search(r"plain\.csv +-\d+", text)
    assert re.search(r"error: broken\.csv \(raw, kf-cv\): .*line 3.*column 'x'", text.replace("\n", " "))
    table = rows.read_rows(out)
    skipped = table[(table["scenario"] == "plain.csv") & (table["estimator"] == "raw")]
    assert list(skipped["reason"]) == ["no truth to compare with"]
    assert "no such file in the folder" in set(table["reason"])


def test_recorded_files_know_their_flags(data_dir):
    files = {file.name: file for file in list_files(data_dir)}
    ranges = files["uwb_outdoor/los_A_case1_ranges.csv"].request
    assert (ranges.height, ranges.truth.name, ranges.gate) == (1.1, "los_A_case1_truth.csv", True)
    assert files["uwb_outdoor/los_A_case1_lsq_position.csv"].request.truth == ranges.truth
    assert files["plaza_range/plaza1_ranges.csv"].request.bias == ("range=2.8",)
    assert files["autoferry/scenario02_detections.csv"].request is None


@pytest.mark.parametrize(
    ("file", "flags"),
    [
        ("uwb_outdoor/los_B_case3_ranges.csv", ("--axes", 2, "--height", 1.1, "--gate")),
        ("rockets/prometheus_telemega.csv", ("--columns", "alt=gps_altitude", "--where", "gps_new=1")),
        ("stonesoup_demos/OpenSky_Plane_States.csv", ()),
        ("aircraft_adsb/noisy_landing.csv", ("--columns", "z=alt_m", "--where", "fresh=1")),
        ("bus_gnss/bus304_limerick.csv", ()),
        ("dancing_bees/seq4_labelled.csv", ("--rate-hz", 30)),
    ],
)
def test_recorded_tracks_run_unattended(data_dir, capsys, file, flags):
    assert run("track", data_dir / file, "-e", "intent-imm", *flags) == 0
    text = capsys.readouterr().out
    assert "NIS per component" in text and "nan" not in text
