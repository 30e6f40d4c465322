"""Many targets through the command line: scans, networks, pictures, refusals, hostile files, the suite."""

import importlib.util
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jink.envs.reading import graph_file
from jink.envs.reading.graph_file import read_graph
from jink.estimators.multitarget.pmht import Pmht
from jink.training import many_estimators, many_film, many_network, many_plot, many_rows, many_suite
from jink.training import track_many as track_many_module
from jink.training.cli import main
from jink.training.many_estimators import MANY
from jink.training.track import TrackRequest, track
from jink.training.track_many import track_many

ROOT = Path(__file__).resolve().parent.parent
START = np.array([[0.0, 0.0, 10.0, 0.0], [0.0, 300.0, 10.0, -2.0]])
GRAPH = {"nodes": ["a", "relay", "b"], "sensors": {"s0": "a", "s1": "b"}, "links": [["a", "relay"], ["relay", "b"]]}


@pytest.fixture
def scans(tmp_path):
    """Two targets 300 m apart, two sensors every second in turn, sigma 5 m, P_D 0.9, two false alarms per scan."""
    rng, rows = np.random.default_rng(4), []
    for k in range(40):
        seen = [x[:2] + 0.5 * k * x[2:] + 5.0 * rng.standard_normal(2) for x in START if rng.random() < 0.9]
        seen += list(rng.uniform([-100, -200], [400, 500], (rng.poisson(2.0), 2)))
        rows += [{"t": 0.5 * k, "sensor": f"s{k % 2}", "x": z[0], "y": z[1]} for z in seen or [np.full(2, np.nan)]]
    frame = pd.DataFrame(rows)
    frame.to_csv(tmp_path / "scans.csv", index=False)
    truth = [
        {"track": name, "t": t, "x": x[0] + t * x[2], "y": x[1] + t * x[3]}
        for name, x in zip("pq", START, strict=True)
        for t in (0.0, 30.0)
    ]
    pd.DataFrame(truth).to_csv(tmp_path / "truth.csv", index=False)
    (tmp_path / "graph.json").write_text(json.dumps(GRAPH))
    return tmp_path / "scans.csv"


def run(*arguments):
    return main(["track", *(str(argument) for argument in arguments)])


def refused(capsys, *arguments):
    """Exit code 2 and one sentence on stderr, nothing on stdout."""
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    said = [line for line in err.strip().splitlines() if "first run only" not in line]  # with cold caches
    assert len(said) == 1, err
    assert said[0].startswith("jink: ")
    return said[0]


@pytest.mark.parametrize("estimator", ["pmht", "gnn", "jpda"])
def test_two_targets_are_two_tracks(scans, tmp_path, capsys, estimator):
    out = tmp_path / "o.parquet"
    assert run(scans, "-e", estimator, "--sigma", 5, "--truth", tmp_path / "truth.csv", "--out", out) == 0
    text = capsys.readouterr().out
    assert f"{estimator}: 2 tracks" in text
    assert "0 breaks, 0 identity switches" in text
    assert "left out: nothing" in text
    frame = pd.read_parquet(out)
    assert sorted(frame["track"].unique()) == [1, 2]
    assert set(frame["status"]) == {"starting", "ok", "missing"}
    assert list(frame.columns[:8]) == ["track", "scan", "t", "sensor", "x", "y", "vx", "vy"]
    last = frame[frame["scan"] == 39].sort_values("y")
    want = START[:, :2] + 19.5 * START[:, 2:]
    # Four of the tracker's own standard deviations, which must be below the sensor's.
    off = np.abs(last[["x", "y"]].to_numpy() - want[np.argsort(want[:, 1])])
    sd = last[["sd_x", "sd_y"]].to_numpy()
    assert (off < 4 * sd).all()
    assert (sd < 5.0).all()
    cov = np.array([[last["sd_x"] ** 2, last["cov_x_vx"]], [last["cov_x_vx"], last["sd_vx"] ** 2]])
    assert (np.linalg.eigvalsh(cov.transpose(2, 0, 1)) > 0).all()


def test_numbers_nobody_gave_come_from_the_file(scans):
    report = track_many(TrackRequest(scans, "gnn", sigma="5"))
    found = {name: (value, origin) for name, value, _, origin in report.parameters}
    # 20 scans a sensor: P_D 0.9 +- 0.05 and clutter 2 +- 0.3; a factor or a count off would be far outside.
    for sensor in ("s0", "s1"):
        assert found[f"detection of {sensor}"][0] == pytest.approx(0.9, abs=0.12)
        assert found[f"clutter of {sensor}"][0] == pytest.approx(2.0, abs=1.0)
    assert found["speed"][0] == pytest.approx(7.2, rel=0.5)  # per axis
    assert found["speed"][1] == found["clutter of s0"][1] == "tuned"
    given_ = track_many(TrackRequest(scans, "gnn", sigma="5", clutter=7.0, detection=0.6, speed=11.0, gate_size=4.0))
    told = {name: (value, origin) for name, value, _, origin in given_.parameters}
    assert told["clutter of s0"] == (7.0, "given")
    assert told["detection of s1"] == (0.6, "given")
    assert told["speed"] == (11.0, "given")
    assert told["gate_size"] == (4.0, "given")


def test_a_network_is_read_and_every_node_reports(scans, tmp_path, capsys):
    out = tmp_path / "o.csv"
    arguments = (scans, "-e", "distributed-pmht", "--network", tmp_path / "graph.json", "--sigma", 5, "--out", out)
    assert run(*arguments) == 0
    assert "2 tracks at 3 nodes" in capsys.readouterr().out
    frame = pd.read_csv(out)
    assert list(frame["node"].unique()) == ["a", "relay", "b"]
    end = frame[frame["scan"] == 39].pivot(index="track", columns="node", values="x")
    assert len(end) == 2
    # The relay has no sensor; what it knows it has been told.
    np.testing.assert_allclose(end["relay"], end["a"], atol=5.0)


def test_what_is_dropped_is_counted(scans, tmp_path, capsys):
    frame = pd.read_csv(scans)
    extra = pd.DataFrame({"t": [19.5, 19.5, 19.5], "sensor": "s1", "x": [1.0, 7.0, 7.0], "y": [np.nan, 8.0, 8.0]})
    pd.concat([frame, extra]).to_csv(scans, index=False)
    assert run(scans, "-e", "gnn", "--sigma", 5) == 0
    assert "left out: 1 incomplete or absurd, 1 repeated within a scan" in capsys.readouterr().out


def test_pictures_are_written(scans, tmp_path):
    files = [tmp_path / name for name in ("p.png", "f.gif", "f.png")]
    assert run(scans, "-e", "gnn", "--sigma", 5, "--plot", files[0], "--film", files[1]) == 0
    assert run(scans, "-e", "gnn", "--sigma", 5, "--film", files[2]) == 0
    from PIL import Image

    assert Image.open(files[1]).n_frames == 40
    last = np.asarray(Image.open(files[2]).convert("RGB"))
    assert last.shape == (640, 960, 3)
    assert len(np.unique(last.reshape(-1, 3), axis=0)) > 10
    assert Image.open(files[0]).size[0] > 800


def test_a_bank_follows_turns_and_smoothing_changes_the_past(scans, tmp_path):
    outs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    assert run(scans, "-e", "pmht", "--sigma", 5, "--turn-rate", 0.1, "--window", 6, "--out", outs[0]) == 0
    assert run(scans, "-e", "pmht", "--sigma", 5, "--turn-rate", 0.1, "--window", 6, "--smooth", "--out", outs[1]) == 0
    now, late = (pd.read_csv(path) for path in outs)
    assert (now["scan"] == late["scan"]).all()
    middle = now["scan"] == 20
    assert (late["sd_x"][middle] < now["sd_x"][middle]).all()


def test_a_sensor_that_locates_nothing_says_so(tmp_path, capsys):
    path = tmp_path / "bearings.csv"
    pd.DataFrame({"t": np.arange(5.0), "bearing": 0.1}).to_csv(path, index=False)
    assert run(path, "-e", "pmht", "--sigma", 0.01) == 0
    out = capsys.readouterr().out
    assert "no track can begin" in out
    assert "pmht: 0 tracks" in out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("-e", "pmht"), "--sigma: value must be given where the file has no columns sigma_x,sigma_y"),
        (("-e", "pmth"), "--estimator: name must be one of kf-cv, .*, pmht, gnn, jpda, distributed-pmht.*; got 'pmth'"),
        (("-e", "gnn", "--sigma", 5, "--window", 3), "--window: option must be left out of gnn"),
        (("-e", "jpda", "--sigma", 5, "--smooth"), "--smooth: option must be left out of jpda"),
        (("-e", "pmht", "--sigma", 5, "--forecast", 3), "--forecast: option must be left out of pmht"),
        (("-e", "pmht", "--sigma", 5, "--show", "x"), "--show: option must be left out of pmht"),
        (("-e", "pmht", "--sigma", 5, "--sojourn", 3), "--sojourn: option must be left out"),
        (
            ("-e", "pmht", "--sigma", 5, "--detection", 1.5),
            "--detection: value must be above 0 and at most 0.999, or every miss would end a track; got 1.5",
        ),
        (("-e", "pmht", "--sigma", 5, "--clutter", -1), "--clutter: value must be from 0"),
        (("-e", "pmht", "--sigma", 5, "--clutter", "nan"), "--clutter: value must be from 0"),
        (("-e", "pmht", "--sigma", 5, "--window", 0), "--window: value must be from 1 to 1000"),
        (("-e", "pmht", "--sigma", 5, "--gate-size", 0), "--gate-size: value must be above 0"),
        (("-e", "imm", "--sigma", 5, "--clutter", 2), "--clutter: option must be left out of imm"),
        (("-e", "pmht", "--sigma", 5, "--network", "g.json"), "--network: option must be left out of pmht"),
        (("-e", "distributed-pmht", "--sigma", 5), "--network: file must be given"),
        (("-e", "distributed-pmht", "--sigma", 5, "--network", "no.json"), "path must name an existing file"),
        (("-e", "pmht", "--sigma", 5, "--film", "f.avi"), r"--film: file must end in \.mp4 or \.gif or \.png"),
        (("-e", "pmht", "--sigma", 5, "--truth", "no.csv"), "--truth: value must name an existing file; got no.csv"),
        (("-e", "pmht", "--sigma", 5, "--model", "/none"), "--model: option must be left out of pmht"),
        (("-e", "gnn", "--sigma", 5, "--policy", "zzz"), "--policy: option must be left out of gnn"),
        (("-e", "jpda", "--sigma", 5, "--surge-every", -4), "--surge-every: option must be left out of jpda"),
        (("-e", "jpda", "--sigma", 5, "--surge-for", 4), "--surge-for: option must be left out of jpda"),
        (("-e", "pmht", "--sigma", 5, "--detection", 1), "--detection: value must be above 0 and at most 0.999"),
        (
            ("-e", "pmht", "--sigma", "1e300"),
            "--sigma: value must be from 1e-12 to 1e12|--sigma: value must be from 1e-12",
        ),
        (("-e", "pmht", "--sigma", "1e-300"), "--sigma: value must be from 1e-12"),
        (("-e", "pmht", "--sigma", 5, "--cutoff", 9), "--cutoff: value must come with --truth"),
        (("-e", "imm", "--sigma", 5, "--cutoff", 9), "--cutoff: option must be left out of imm"),
    ],
)
def test_refusals(scans, capsys, arguments, sentence):
    assert re.search(sentence, refused(capsys, scans, *arguments))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "have a header and data rows"),
        ("t,sensor\n0,a\n", "have a position"),
        ("t,x,y\n0,1,oops\n", "row 1 .line 2., column 'y' must be a finite number or empty; got 'oops'"),
        ("t,x,y\n0,1,inf\n", "must be a finite number"),
        ("t,x,y\n1,1,1\n0,1,1\n", "must not go backwards"),
        ("t,x,y\n,1,1\n", "must be a time"),
        ("t,x,y,sigma_x,sigma_y\n0,1,1,0,1\n", "must be a standard deviation > 0"),
    ],
)
def test_bad_files(tmp_path, capsys, text, sentence):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    assert re.search(sentence, refused(capsys, path, "-e", "pmht", "--sigma", 5))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("{", "must be JSON text"),
        ("[1]", "must hold one object; got list"),
        ({"nodes": None}, "name 1 to 1000 nodes"),
        ({"nodes": ["a", "a"]}, "name 1 to 1000 nodes, each once"),
        ({"nodes": True}, "name 1 to 1000 nodes"),
        ({"sensors": {"s0": "c"}}, "use the nodes it names; got c. Nodes: a, relay, b"),
        ({"sensors": {}}, "say in sensors at which node"),
        ({"links": [["a", "b", "relay"]]}, "list links as pairs"),
        ({"links": [["a", "a"]]}, "link different nodes"),
        (
            {"links": [["a", "b"]]},
            "must link all nodes, over others if need be; got 1 that the first cannot reach, such as relay",
        ),
        ({"weights": [[1, 2], [3]]}, "have weights as rows of numbers"),
        ({"weights": np.full((3, 3), 0.3).tolist()}, "weights and links that are >= 0 with rows that sum to 1"),
        ({"weights": [[0.5, 0.5, 0], [0.5, 0.5, 0], [0, 0, 1]]}, "weights and links that are primitive"),
        ({"rule": 2}, "one of the rules b, N, 1, safe; got 2"),
        ({"rule": True}, "one of the rules b, N, 1, safe; got True"),
        ({"weights": np.full((3, 3), 1 / 3).tolist()}, "zero between nodes without a link"),
        ({"rounds": -1}, "have whole rounds"),
        ({"rule": "median"}, "one of the rules b, N, 1, safe"),
        ({"rule": ["b"]}, "one of the rules"),
        ({"speed": 3}, "unknown speed"),
    ],
)
def test_bad_graphs(scans, tmp_path, capsys, change, sentence):
    path = tmp_path / "graph.json"
    path.write_text(change if isinstance(change, str) else json.dumps(GRAPH | change))
    err = refused(capsys, scans, "-e", "distributed-pmht", "--sigma", 5, "--network", path)
    assert re.search(sentence, err)
    assert "graph.json" in err


def test_a_graph_without_an_entry_or_a_sensor(scans, tmp_path, capsys):
    path = tmp_path / "graph.json"
    path.write_text(json.dumps({name: value for name, value in GRAPH.items() if name != "links"}))
    with pytest.raises(ValueError, match=r"read_graph: graph\.json must have nodes, sensors, links .* got no links"):
        read_graph(path)
    path.write_text(json.dumps(GRAPH | {"sensors": {"s0": "a"}}))
    err = refused(capsys, scans, "-e", "distributed-pmht", "--sigma", 5, "--network", path)
    assert "--network: sensors must name every sensor of the scans; got no s1 among s0" in err


def test_a_graph_may_number_its_nodes_and_give_weights(tmp_path):
    path = tmp_path / "graph.json"
    weights = [[0.75, 0.25], [0.5, 0.5]]
    path.write_text(
        json.dumps({"nodes": 2, "sensors": {"r": 1}, "links": [[0, 1]], "weights": weights, "rounds": 3, "rule": "b"})
    )
    plan = read_graph(path)
    assert plan.nodes == ("0", "1")
    assert plan.sensors == {"r": 1}
    np.testing.assert_array_equal(plan.weights, weights)
    assert (plan.consensus().rounds, plan.consensus().rule) == (3, "b")


def test_the_rule_may_be_a_number(tmp_path):
    (tmp_path / "graph.json").write_text(json.dumps(GRAPH | {"rule": 1}))
    assert read_graph(tmp_path / "graph.json").rule == "1"


def test_truth_with_a_time_twice_is_refused_before_anything_runs(scans, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(track_many_module, "choose_many", None)  # calling it would raise
    truth = pd.read_csv(tmp_path / "truth.csv").drop(columns="track").sort_values("t")
    truth.to_csv(tmp_path / "truth.csv", index=False)
    err = refused(capsys, scans, "-e", "gnn", "--sigma", 5, "--truth", tmp_path / "truth.csv")
    assert re.search(r"--truth: file must give each time once per target; got 0 s twice .* column track", err)


def test_a_given_cutoff_is_used_and_said(scans, tmp_path, capsys):
    truth = ("--truth", tmp_path / "truth.csv")
    assert run(scans, "-e", "gnn", "--sigma", 5, *truth, "--cutoff", 77) == 0
    assert "against truth, cut-off 77 m (given)" in " ".join(capsys.readouterr().out.split())
    assert run(scans, "-e", "gnn", "--sigma", 5, *truth) == 0
    assert "(ten sd of this run; --cutoff compares runs)" in " ".join(capsys.readouterr().out.split())


def test_a_network_says_what_it_uses_and_what_nobody_saw(scans, tmp_path, capsys):
    """Window and dismissal are the network's own; a target that no node sees is missing at all of them."""
    frame = pd.read_csv(scans)
    # Nothing of the upper target between 12 and 13.5 s; its tracks live on.
    hidden = frame["t"].between(12.0, 13.5) & (frame["y"] > 200.0)
    frame[~hidden].to_csv(scans, index=False)
    path = tmp_path / "graph.json"
    path.write_text(json.dumps(GRAPH | {"sensors": {"s0": "a", "s1": "b", "s9": "relay"}}))
    request = TrackRequest(scans, "distributed-pmht", sigma="5", network=path)
    report = track_many(request)
    told = {name: value for name, value, _, _ in report.parameters}
    assert told["window"] == 5.0
    assert told["dismissal"] == told["patience"] / 4
    assert (
        many_estimators.MANY["distributed-pmht"](
            many_estimators.ManyScales(2, 1.0, 10.0, window=9, patience=8.0, plan=(read_graph(path), (0, 2)))
        ).tracker.window
        == 9
    )
    assert any("sensors that have no scan: s9" in note for note in report.notes)
    table = report.frame
    assert {"node", "hits"} <= set(table.columns)
    upper = table[table["y"] > 150.0]
    gone = upper[upper["t"].between(12.0, 13.5)]
    assert len(gone) >= 9
    assert (gone["status"] == "missing").all()
    assert (upper[upper["t"].between(16.0, 19.0)]["status"] == "ok").mean() > 0.6


def test_angles_of_sigma_are_in_the_unit_of_the_file(tmp_path):
    path = tmp_path / "polar.csv"
    pd.DataFrame({"t": np.arange(4.0), "range": 100.0, "bearing": 20.0}).to_csv(path, index=False)
    request = TrackRequest(path, "gnn", sigma="sigma_range=1,sigma_bearing=0.5", degrees=True, speed=5.0)
    found = {name: value for name, value, _, _ in track_many(request).parameters}
    assert found["sigma_bearing"] == pytest.approx(np.deg2rad(0.5))


def test_degrees_of_positions_are_said_to_be_ignored(scans):
    notes = track_many(TrackRequest(scans, "gnn", sigma="5", speed=5.0, degrees=True)).notes
    assert any(note.startswith("--degrees is ignored") for note in notes)


def test_a_negative_variance_shows():
    cov = np.stack([np.eye(4), np.diag([1.0, -1.0, 1.0, 1.0])])
    ids = np.array([1, 2])
    one = SimpleNamespace(
        mean=np.zeros((2, 4)), cov=cov, id=ids, scan=np.zeros(2, dtype=int), time=np.zeros(2), hits=np.ones(2)
    )
    scans_ = SimpleNamespace(sensors=[SimpleNamespace(name="s")], sensor=np.zeros(1, dtype=int))
    frame = many_rows.track_frame(one, scans_)
    assert list(frame["status"]) == ["starting", "diverged"]
    assert np.isnan(frame["sd_y"][1])


def test_a_network_is_drawn(scans, tmp_path):
    """With sensors at places of their own, one of which moves; the picture names nodes."""
    report = track_many(TrackRequest(scans, "distributed-pmht", sigma="5", network=tmp_path / "graph.json", speed=10.0))
    states = np.zeros((len(report.scans), 4))
    states[:, 0], states[:, 1] = np.where(report.scans.sensor == 1, 5.0 * report.scans.times, 200.0), -100.0
    report = report._replace(scans=replace(report.scans, sensor_states=states))
    places = {place.name: place for place in many_network.sensor_places(report.scans, report.plan)}
    assert set(places) == {"s0 at a", "s1 at b"}
    assert places["s1 at b"].moves
    assert not places["s0 at a"].moves
    assert many_network.links_of(report.plan).tolist() == [[0, 1], [1, 2]]
    many_plot.plot_many(tmp_path / "network.svg", report)
    many_film.film_many(tmp_path / "network.png", report)
    without = report._replace(plan=None)
    with_, plain = (next(iter(many_film.frames_of(one))) for one in (report, without))
    assert (with_ != plain).any()
    text = (tmp_path / "network.svg").read_text()
    assert "s1 at b" in text
    assert "of node a" in text


def test_the_output_may_not_be_an_input(scans, tmp_path, capsys):
    assert "must not be the input file" in refused(capsys, scans, "-e", "gnn", "--sigma", 5, "--out", scans)
    # Its contents are still there.
    assert len(pd.read_csv(scans)) > 50


def test_one_target_per_track_does_not_know_these_names(scans):
    with pytest.raises(ValueError, match="--estimator: name must be one of"):
        track(TrackRequest(scans, "pmht", sigma="5"))


VALUES = st.one_of(st.floats(-1e3, 1e3), st.sampled_from([float("nan"), 0.0, 1e25, 1e35, -1e300, 5e-324]), st.just(3.0))


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.tuples(st.integers(0, 6), st.sampled_from(["s0", "s1"]), VALUES, VALUES), min_size=1, max_size=40),
    estimator=st.sampled_from(list(MANY)),
)
def test_hostile_files_give_an_answer(tmp_path_factory, rows, estimator):
    """Any numbers: exit 0, finite or marked states, every row accounted for."""
    folder = tmp_path_factory.mktemp("fuzz")
    path, out = folder / "scans.csv", folder / "out.csv"
    pd.DataFrame(sorted(rows, key=lambda row: row[0]), columns=["t", "sensor", "x", "y"]).to_csv(path, index=False)
    (folder / "graph.json").write_text(json.dumps(GRAPH))
    extra = ("--network", folder / "graph.json") if estimator == "distributed-pmht" else ()
    assert run(path, "-e", estimator, "--sigma", 5, "--out", out, *extra) == 0
    frame = pd.read_csv(out)
    marked = frame["status"] == "diverged"
    assert np.isfinite(frame.loc[~marked, ["x", "y", "vx", "vy", "sd_x", "sd_vy"]].to_numpy(dtype=float)).all()
    values = pd.read_csv(path)[["x", "y"]].to_numpy()
    report = track_many(TrackRequest(path, "gnn", sigma="5", speed=10.0))
    cleaning = report.scans.cleaning
    given_ = int((~np.isnan(values).all(axis=1)).sum())
    assert len(report.scans.detections) + cleaning.not_finite + cleaning.repeated == given_


def test_the_suite_writes_rows_and_a_table(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(many_suite, "QUICK", ("crossing-v0",))
    out = tmp_path / "rows.parquet"
    assert main(["bench", "--suite", "multi-target", "--quick", "--runs", "1", "--out", str(out)]) == 0
    rows = pd.read_parquet(out)
    assert set(rows["estimator"]) == {"pmht", "gnn", "jpda"}
    assert set(rows["metric"]) == {"gospa", "missed", "false", "switches", "breaks", "time"}
    good = rows[rows["metric"] == "gospa"]["value"]
    # Both targets held nearly all the time: two misses would cost 200 m.
    assert (good < 100.0).all()
    assert (good > 10.0).all()
    text = capsys.readouterr().out
    assert "crossing-v0" in text
    assert main(["bench", "--suite", "multi-target", "--data", str(tmp_path)]) == 2
    assert "--data: option must be left out of the suite multi-target" in capsys.readouterr().err


def test_the_list_names_them(capsys):
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    for name in (*MANY, "multi-target"):
        assert name in text


def test_the_document_runs(tmp_path, monkeypatch):
    """All Python blocks of the page are one script; its network is one that can be read."""
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "multi_target.md"
    text = page.read_text(encoding="utf-8")
    names = {}
    for number, block in enumerate(re.findall(r"^```python\n(.*?)^```$", text, re.S | re.M)):
        exec(compile(block, f"multi_target.md, block {number}", "exec"), names)
    (found,) = re.findall(r"^```json\n(.*?)^```$", text, re.S | re.M)
    Path("graph.json").write_text(found)
    assert read_graph("graph.json").nodes == ("mast", "buoy", "relay")
    for option in set(re.findall(r"`(--[a-z-]+)`", text)):
        assert option.removeprefix("--").replace("-", "_") in TrackRequest.__dataclass_fields__, option


def test_the_example_of_the_format_is_read(tmp_path):
    (found,) = re.findall(r"```json\n(.*?)```", graph_file.__doc__, re.S)
    (tmp_path / "graph.json").write_text(found)
    plan = read_graph(tmp_path / "graph.json")
    assert plan.sensors == {"radar": 0, "lidar": 1}
    assert plan.weights[0, 1] == 0.3


def test_recorded_boats_are_held_through_their_crossing(data_dir):
    """Radar and lidar on a moving ship: each boat keeps one track while they are within 60 m of each other."""
    path = ROOT / "benchmarks" / "autoferry.py"
    spec = importlib.util.spec_from_file_location("autoferry", path)
    autoferry = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(autoferry)
    scans, truth = autoferry.load(data_dir / "autoferry", 2, ("radar", "lidar"))
    tracker = Pmht(autoferry.MOTION, initiation=autoferry.INITIATION)
    for tracks in (tracker.run(scans).sets()[1], autoferry.distributed(scans)[1]):
        found = autoferry.score(tracks, truth)
        assert found.one_track == 1.0
        assert found.held.min() > 0.9
        assert found.neutral > 5
    # A track far from both boats costs nothing, one beside a boat does.
    far, beside = truth[:1] + 500.0, truth[:1] + 5.0
    perfect = autoferry.score(truth, truth)
    assert perfect.gospa == autoferry.score(np.concatenate([truth, far]), truth).gospa < 1e-9
    assert autoferry.score(np.concatenate([truth, beside]), truth).false == 1.0
