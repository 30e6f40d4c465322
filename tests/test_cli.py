"""The command line: what it prints, writes and refuses."""

import json
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from jink.envs.recorded import read_tracks
from jink.estimators.recipes import RECIPES, make_estimator
from jink.estimators.sensors import SENSORS, position, range_bearing
from jink.estimators.tracks import Tracks
from jink.training import bench_jobs, plotting, published, rows
from jink.training.cli import main
from jink.training.doubts import nis_verdict, outlier_hint
from jink.training.options import parse_numbers, parse_sigma
from jink.training.recorded_suite import list_files
from jink.training.running import forecast_ends, gate_tracks


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
    given = ("--sigma", "sigma_range=10,sigma_bearing=0.3", "--acceleration", 0.1, "--degrees")
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
        (("track", "{radar}", "--columns", "t"), "jink: --columns: columns must be pairs"),
        (("track", "{radar}", "--truth", "{radar}", "--truth-columns", "t"), "jink: --truth-columns: columns must be"),
        (("track", "{radar}", "--truth-columns", "t=t"), "--truth-columns: value must come with --truth"),
        (("track", "{radar}", "--columns", "t=clock"), r"jink: radar\.csv must have the column 'clock'"),
        (("track", "{radar}", "--rate-hz", "-1"), "jink: --rate-hz: value must be > 0 and finite"),
        (("track", "{radar}", "--axes", "4"), "--axes: value must be 2 or 3; got 4"),
        (("track", "{radar}", "--height", "5"), "jink: --height: value must be left out unless ranges"),
        (("track", "{radar}", "--out", "{radar}"), "--out: file must not be the input file"),
        (("track", "{radar}", "--out", "e.txt"), r"--out: file must end in \.parquet or \.csv"),
        (("track", "{radar}", "--out", "no/where/e.csv"), "must lie in an existing folder"),
        (("track", "{radar}", "--plot", "e.gif"), r"must end in \.png"),
        (("track", "{radar}", "--show", "b"), "--show: value must name a track; got 'b'"),
        (("bench", "--suite", "speed"), "--suite: name must be one of switch, surge"),
        (("bench", "--suite", "recorded"), "--data: folder must be given"),
        (("bench", "--suite", "recorded", "--data", "nowhere"), "folder must exist"),
        (("bench", "--suite", "published", "--runs", "0"), "--runs: value must be >= 1"),
        (("bench", "--suite", "published", "--data", "."), "--data: option must be left out of the suite published"),
        (("bench", "--suite", "recorded", "--data", ".", "--quick"), "--quick: option must be left out"),
        (("bench", "--suite", "recorded", "--data", ".", "--runs", "5"), "--runs: option must be left out"),
        (("bench", "--suite", "recorded", "--data", ".", "--seed", "1"), "--seed: option must be left out"),
        (("bench", "--suite", "published", "--out", "{radar}"), r"must end in \.parquet"),
    ],
)
def test_refusals_are_one_sentence(radar, capsys, arguments, words):
    filled = [argument.format(radar=radar) for argument in arguments]
    assert re.search(words, refused(capsys, *filled))


def test_inputs_are_not_overwritten(radar, tmp_path, capsys, monkeypatch):
    before = radar.read_bytes()
    link, truth = tmp_path / "link.csv", tmp_path / "truth.csv"
    link.symlink_to(radar)
    truth.write_bytes(before)
    assert "--out: file must not be the input file" in refused(capsys, "track", radar, "--out", link)
    monkeypatch.chdir(tmp_path)
    assert "must not be the file of --truth" in refused(
        capsys, "track", radar, "--truth", truth, "--out", "./truth.csv"
    )
    # Names of inputs seldom end like pictures, but links do.
    (tmp_path / "link.png").symlink_to(radar)
    assert "--plot: file must not be the input file" in refused(capsys, "track", radar, "--plot", "link.png")
    assert radar.read_bytes() == truth.read_bytes() == before


def test_too_few_measurements_name_the_file(tmp_path, capsys):
    path = tmp_path / "two.csv"
    path.write_text("t,x,y\n0,0,0\n1,1,1\n")
    text = refused(capsys, "track", path)
    assert text.startswith("jink: two.csv: tracks must hold three measurements")


@pytest.mark.parametrize(
    ("header", "clock", "size", "arguments", "words"),
    [
        ("t,x,y", 1.0, 1.0, ("--degrees", "--compass"), "--degrees is ignored.*--compass is ignored"),
        ("t,x,y", 1.0, 1.0, ("--show", "plain"), "--show is ignored without --plot"),
        ("t,x,y", 5e6, 1.0, (), r"rows are 5e\+06 s apart, 58 days"),
        ("t,x,y", 1e11, 1.0, (), "look like milliseconds"),
        ("t,lon_deg,lat_deg", 1.0, 1e-3, ("--columns", "x=lon_deg,y=lat_deg"), "look like degrees"),
        ("t,lon_deg,lat_deg", 1.0, 1e3, ("--columns", "x=lon_deg,y=lat_deg"), ""),
        ("t,x,y", 1.0, 1e-3, (), ""),
    ],
)
def test_odd_files_are_questioned(tmp_path, capsys, header, clock, size, arguments, words):
    path = tmp_path / "plain.csv"
    z = np.random.default_rng(0).normal(scale=size, size=(20, 2))
    table = np.column_stack([clock * np.arange(20.0), z + size * np.arange(20.0)[:, None]])
    pd.DataFrame(table, columns=header.split(",")).to_csv(path, index=False)
    given = ("-e", "kf-cv", "--sigma", size, "--acceleration", 1, "--speed", 1)
    assert run("track", path, *given, *arguments) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(words, text) if words else not re.search("look like|ignored|apart", text)


@pytest.mark.parametrize(
    ("interval", "value", "origin"), [(0.5, 10, "default"), (5, 50, "interval"), (0.1, 2, "length")]
)
def test_sojourn_fits_the_file(tmp_path, capsys, interval, value, origin):
    rows_of_file = 81
    path = tmp_path / "plain.csv"
    z = np.random.default_rng(0).normal(size=(rows_of_file, 2))
    pd.DataFrame({"t": interval * np.arange(rows_of_file), "x": z[:, 0], "y": z[:, 1]}).to_csv(path, index=False)
    assert run("track", path, "--sigma", 1, "--acceleration", 1, "--speed", 1) == 0
    assert re.search(rf"sojourn +{origin} +{value} +s", capsys.readouterr().out)


def test_outliers_are_named_above_the_errors(radar, capsys):
    frame = pd.read_csv(radar)
    frame.loc[[20, 27, 34, 41, 48], "x"] += 3000.0
    frame.to_csv(radar, index=False)
    given = ("track", radar, "-e", "kf-cv", "--sigma", 15, "--acceleration", 1, "--speed", 20)
    assert run(*given) == 0
    text = capsys.readouterr().out
    assert 0 < text.index("--gate leaves them out") < text.index("error against truth")
    assert run(*given, "--gate") == 0
    text = capsys.readouterr().out
    assert "5 measurements left out by --gate" in text and "leaves them out" not in text


@pytest.mark.parametrize(("high", "flat"), [(1.0, True), (400.0, False)])
def test_flat_anchors_suggest_two_axes(high, flat):
    places = np.array([[0.0, 0, 0], [100, 0, 0], [100, 100, high], [0, 100, 0]])
    T = 40
    states = np.zeros((1, T, 6))
    states[0, :, :3] = places[np.arange(T) % 4]
    reach = np.linalg.norm(states[..., :3] - [30.0, 60.0, 2.0], axis=2)[..., None]
    times = np.arange(float(T))[None]
    tracks = Tracks(("a",), times, reach, "range", np.array([T]), 3, sensor_states=states)
    outliers = SimpleNamespace(nis=np.where(times % 4 == 1, 60.0, 1.0), nis_dof=np.ones((1, T), dtype=int))
    hint = outlier_hint(tracks, outliers, gated=False)
    assert hint.startswith("10 measurements lie") and "--gate" in hint
    assert ("--axes 2 --height" in hint) == flat
    assert ("--axes 2" in outlier_hint(tracks, outliers, gated=True)) == flat
    outliers.nis[:] = 1.0
    assert outlier_hint(tracks, outliers, gated=False) == ""


@pytest.mark.parametrize(
    ("mean", "inside", "words"),
    [
        (1.0, 0.95, "consistent"),
        (1.2, 0.94, "nearly consistent"),
        (1.2, 0.89, "too sure of itself"),
        (1.3, 0.94, "too sure of itself"),
        (0.9, 0.97, "nearly consistent"),
        (0.7, 0.99, "cautious"),
    ],
)
def test_verdict_on_innovations(mean, inside, words):
    assert nis_verdict(mean, 0.97, 1.03, inside) == words


def test_long_tracks_are_drawn_in_bins():
    clock = np.concatenate([np.arange(3000.0), 6000.0 + np.arange(3000.0)])
    probs = np.where(np.arange(6000)[:, None] < 3000, [0.9, 0.1], [0.2, 0.8])
    probs[::2] = probs[::2, ::-1].copy()  # flickers from row to row
    edges, bins, shares = plotting._bin_modes(clock, probs)
    assert len(edges) == len(shares) <= 252 and edges[0] == 0 and edges[-1] == clock[-1]
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    np.testing.assert_allclose(shares[bins], 0.5, atol=0.06)  # 36 rows to a bin, odd or even
    assert np.all(np.diff(bins) >= 0) and len(bins) == len(clock)
    short = plotting._bin_modes(clock[:500], probs[:500])
    assert short[0] is not None and np.array_equal(short[2], probs[:500]) and np.array_equal(short[1], np.arange(500))


def test_progress_reaches_its_end(radar):
    frame = pd.read_csv(radar)
    lost = frame.assign(track="b", x=np.nan)  # never located: skipped, but done with
    lost["y"] = np.nan
    path = radar.with_name("both.csv")
    pd.concat([frame, lost]).to_csv(path, index=False)
    tracks = read_tracks(path)
    estimator = make_estimator("kf-cv", position(2, 15.0))
    for work in (gate_tracks, lambda *a, advance: forecast_ends(*a, 1.0, advance=advance)):
        done = []
        work(estimator, tracks, advance=done.append)
        assert sum(done) == tracks.lengths.sum()


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
    assert parse_sigma("1,.5", polar, degrees=True) == (1.0, np.deg2rad(0.5))
    assert parse_sigma("15", plane, degrees=True) == (15.0, 15.0)
    with pytest.raises(ValueError, match="sigma_bearing in deg"):
        parse_sigma("1", polar, degrees=True)
    for text in ("1e300,1", "1,1e-300", "1", "range=1", "range=1,bearing=2,x=3", "nan,1", "a,b"):
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
    assert table["command"][0] == (
        "jink bench --suite published --scenario n4-cv-ca-v0 --estimator kf-cv --runs 5 --seed 3"
    )
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


def test_two_processes_lose_no_rows(tmp_path):
    out, count = tmp_path / "rows.parquet", 8
    code = (
        "import sys; from pathlib import Path; from jink.training.rows import *\n"
        "for i in range(int(sys.argv[3])): append_rows(Path(sys.argv[1]), make_rows("
        "Cell('s', str(i), sys.argv[2], 1, 1, ''), {}, status='skipped'))"
    )
    writers = [
        subprocess.Popen([sys.executable, "-c", code, str(out), name, str(count)], env=dict(os.environ))
        for name in ("a", "b", "c")
    ]
    assert [writer.wait(timeout=120) for writer in writers] == [0, 0, 0]
    table = rows.read_rows(out)
    assert sorted(zip(table["estimator"], table["scenario"], strict=True)) == sorted(
        (name, str(i)) for name in "abc" for i in range(count)
    )
    assert [path.name for path in tmp_path.iterdir()] == ["rows.parquet"]


def test_rows_are_of_these_sources_and_these_files(radar, tmp_path, monkeypatch):
    def no_git(*_, **__):
        raise FileNotFoundError

    monkeypatch.setattr("subprocess.run", no_git)
    rows.commit.cache_clear()
    key = rows.commit()
    assert re.fullmatch("sources [0-9a-f]{12}", key)
    hashed = []
    monkeypatch.setattr(rows, "hash_files", lambda *paths: hashed.extend(paths) or "other")
    rows.commit.cache_clear()
    assert rows.commit() == "sources other"
    assert {"rows.py", "kalman.py", "recorded.py"} <= {path.name for path in hashed}
    rows.commit.cache_clear()

    request = bench_jobs.BenchRequest("recorded", data=radar.parent)
    first, same = ([job.cell for job in bench_jobs.jobs_of("recorded", request)] for _ in range(2))
    assert first == same and all(cell.data for cell in first if cell.scenario == "radar.csv")
    radar.write_text(radar.read_text().replace("\na,0", "\na,0.5", 1))
    changed = [job.cell for job in bench_jobs.jobs_of("recorded", request)]
    pairs = [(a, b) for a, b in zip(first, changed, strict=True) if a.scenario == "radar.csv"]
    assert pairs and all(a != b and a._replace(data="") == b._replace(data="") for a, b in pairs)


def test_rows_without_a_hash_are_read(few_cells, tmp_path):
    out = tmp_path / "rows.parquet"
    rows.append_rows(out, rows.make_rows(rows.Cell("s", "a", "b", 1, 1, ""), {}))
    pd.read_parquet(out).drop(columns="data").to_parquet(out)
    assert list(rows.read_rows(out)["data"]) == [""]


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
    monkeypatch.setattr(bench_jobs, "ESTIMATORS", ("raw", "kf-cv"))
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
