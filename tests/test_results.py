"""Numbers with intervals: the bootstrap, the rows that carry it, and the pages made from committed rows."""

import importlib
import importlib.util
import json
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jink.training import published, weighted
from jink.training.intervals import Score, measure, resample_blocks, resample_runs
from jink.training.recorded_scores import score_report
from jink.training.recorded_suite import UNGATED, list_files, list_flags
from jink.training.rows import COLUMNS, Cell, make_rows, read_rows
from jink.training.track import TrackRequest, track

ROOT = Path(__file__).resolve().parent.parent
ROWS = ROOT / "docs" / "results"


@pytest.fixture(scope="module")
def pages():
    """The script that writes the pages."""
    spec = importlib.util.spec_from_file_location("update_readme", ROOT / "benchmarks" / "update_readme.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def all_weights(draws):
    return np.concatenate(list(draws.batches))


# Statistics of weighted rows.


def check_statistic(statistic, plain):
    """Weights of one give the plain number, whole weights that of the repeated rows."""
    values = np.random.default_rng(2).normal(size=(501, 3)) ** 2
    weights = np.random.default_rng(3).integers(0, 4, size=(2, 501)).astype(float)
    weights[0] = 1.0
    expected = [plain(np.repeat(values, row.astype(int), axis=0)) for row in weights]
    np.testing.assert_allclose(statistic(values)(weights), expected, rtol=1e-12)


def test_weighted_statistics_equal_the_plain_ones():
    first = lambda function: lambda v: function(v[:, 0])  # noqa: E731
    check_statistic(first(weighted.mean), lambda v: v[:, 0].mean())
    check_statistic(first(weighted.root_mean), lambda v: math.sqrt(v[:, 0].mean()))
    check_statistic(first(weighted.median), lambda v: np.median(v[:, 0]))
    check_statistic(first(weighted.largest), lambda v: v[:, 0].max())
    check_statistic(first(weighted.trimmed_mean), lambda v: np.sort(v[:, 0])[len(v) // 100 :].mean())
    check_statistic(weighted.root_mean_peak, lambda v: math.sqrt(v.mean(0).max()))
    check_statistic(lambda v: weighted.ratio(v[:, 0], v[:, 1]), lambda v: v[:, 0].sum() / v[:, 1].sum())


def test_unknown_rows_do_not_count():
    values = np.array([3.0, np.nan, 1.0, 2.0])
    ones = np.ones((1, 4))
    assert weighted.mean(values)(ones) == weighted.median(values)(ones) == 2.0
    assert weighted.trimmed_mean(values)(ones) == 2.0 and weighted.largest(values)(ones) == 3.0
    assert np.isnan(weighted.median(values[1:2])(np.ones((1, 1))))


# The bootstrap.


def half_width(values, draws):
    number = measure({"mean": Score(weighted.mean(values), "m")}, draws)["mean"]
    assert number.value == pytest.approx(values.mean(), rel=1e-12)
    return (number.high - number.low) / 2


def test_runs_give_the_textbook_interval_of_a_mean():
    values = np.random.default_rng(0).normal(5.0, 2.0, size=400)
    # The percentiles of 1000 resamples are known to some 5 %.
    assert half_width(values, resample_runs(400, 1)) == pytest.approx(1.96 * values.std() / 20, rel=0.12)


def test_blocks_see_that_neighbours_are_alike():
    rng, keep, rows = np.random.default_rng(0), 0.9, 6000
    values = np.empty(rows)
    values[0] = rng.normal()
    for k in range(1, rows):
        values[k] = keep * values[k - 1] + math.sqrt(1 - keep**2) * rng.normal()
    exact = 1.96 * math.sqrt((1 + keep) / (1 - keep) / rows)
    times, lengths = np.arange(float(rows))[None], np.array([rows])
    blocks = half_width(values, resample_blocks(times, lengths, 1))
    # 60 rows against a memory of ten: blocks miss about 15 %, a hundred of them know it to 10 %.
    assert blocks == pytest.approx(exact, rel=0.3)
    assert half_width(values, resample_runs(rows, 1)) < 0.3 * exact


def test_every_row_is_drawn_equally_often():
    # Tracks of unlike pace and length; the second is shorter than a block, the third has repeated times.
    times = np.full((4, 400), np.nan)
    lengths = np.array([400, 20, 300, 1])
    times[0], times[1, :20] = 2.0 * np.arange(400), np.arange(20)
    times[2, :300], times[3, 0] = np.repeat(np.arange(100) * 3.0, 3), 7.0
    draws = resample_blocks(times, lengths, 0)
    weights = all_weights(draws)
    assert weights.shape == (1000, 721) and weights.min() == 0
    # Neighbours share their draws; each track's mean is known to about 1 %, of the two short ones to 4 %.
    for b, tolerance in ((0, 0.04), (1, 0.2), (2, 0.06), (3, 0.2)):
        rows = slice(lengths[:b].sum(), lengths[: b + 1].sum())
        assert weights[:, rows].mean() == pytest.approx(1.0, abs=tolerance), b
    # The ends of a track count as much as its middle, and a block never reaches into the next track.
    assert weights[:, :5].mean() == pytest.approx(1.0, abs=0.15)
    assert weights[:, 395:400].mean() == pytest.approx(1.0, abs=0.15)
    np.testing.assert_array_equal(weights[:, 400], weights[:, 419])
    jumps = (np.diff(weights[:, :400], axis=1) != 0).sum(axis=1)
    assert jumps.max() <= 2 * (2 * 400 / (60 / 2))


def test_same_seed_same_interval():
    values = np.random.default_rng(0).normal(size=50)
    score = {"mean": Score(weighted.mean(values), "m")}
    first, again, other = (measure(score, resample_runs(50, seed)) for seed in (1, 1, 2))
    assert first == again
    assert first["mean"].low != other["mean"].low and first["mean"].value == other["mean"].value


def test_no_interval_has_a_reason():
    values = np.arange(4.0)
    scores = {"mean": Score(weighted.mean(values), "m"), "peak": Score(weighted.largest(values), "m", "one record")}
    for draws, words in (
        (resample_runs(4, 0), "fewer than 5 runs"),
        (resample_blocks(60.0 * np.arange(4.0)[None], np.array([4]), 0), "fewer than 8 blocks of 18 s"),
    ):
        found = measure(scores, draws)
        assert math.isnan(found["mean"].low) and found["mean"].interval == words
        assert math.isnan(found["peak"].high) and found["peak"].interval == "one record"
        assert found["peak"].value == 3.0
    broken = measure({"mean": Score(weighted.mean(np.array([1.0] * 9 + [np.inf])), "m")}, resample_runs(10, 0))
    assert math.isnan(broken["mean"].low) and "not finite" in broken["mean"].interval


# Rows.


def test_published_cells_have_intervals_over_runs():
    cells = {(cell.scenario, cell.estimator): cell for cell in published.PUBLISHED_CELLS}
    known = cells["n4-cv-ca-v0", "kf-ca"]
    many, few = (published.run_cell(known, runs, 1).values["position_mse"] for runs in (80, 20))
    assert few.low < few.value < few.high and many.low < many.value < many.high
    assert "20 runs" in few.interval and few.unit == "m^2"
    # Four times the runs, half the width; widths of 20 runs scatter by some 20 %.
    assert 1.3 < (few.high - few.low) / (many.high - many.low) < 3.0
    closed = published.run_cell(cells[published.UNCERTAIN.id, "kf"], 1, 1).values
    assert all(math.isnan(v.low) and v.interval.startswith("closed form") for v in closed.values())


def test_rows_carry_the_interval(tmp_path):
    values = published.run_cell(published.PUBLISHED_CELLS[-1], 5, 1).values
    rows = make_rows(Cell("published", "s", "e", 5, 1, ""), values)
    assert list(rows.columns) == list(COLUMNS)
    assert (rows["low"] <= rows["high"]).all() and rows["interval"].str.contains("bootstrap").all()
    empty = make_rows(Cell("published", "s", "e", 5, 1, ""), {}, status="skipped", reason="no truth")
    assert empty["low"].isna().all() and empty["interval"][0] == "no number"
    rows.drop(columns="low").to_parquet(tmp_path / "old.parquet")
    with pytest.raises(ValueError, match="without low"):
        read_rows(tmp_path / "old.parquet")


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Fifteen minutes of a straight line with sigma 5 m, estimated."""
    times = np.arange(0.0, 900.0)
    z = np.stack([2.0 * times, -times], axis=1) + np.random.default_rng(1).normal(scale=5.0, size=(900, 2))
    frame = {"t": times, "x": z[:, 0], "y": z[:, 1], "true_x": 2.0 * times, "true_y": -times}
    path = tmp_path_factory.mktemp("walk") / "walk.csv"
    pd.DataFrame(frame).to_csv(path, index=False)
    return track(TrackRequest(file=path, estimator="kf-cv", sigma="5", acceleration=0.1, speed=3.0))


@pytest.mark.parametrize("raw", [False, True])
def test_recorded_scores_are_those_of_the_summary(walk, raw):
    found, known = score_report(walk, 0, raw=raw), walk.raw_scores if raw else walk.scores
    for name, key in (("rmse", "rmse_m"), ("median", "median_m"), ("peak", "peak_m")):
        assert found[f"position_{name}"].value == pytest.approx(known[f"position_{key}"], rel=1e-12)
    rmse = found["position_rmse"]
    assert rmse.low < rmse.value < rmse.high and "15 blocks of 60 s" in rmse.interval
    assert math.isnan(found["position_peak"].low) and "largest" in found["position_peak"].interval
    assert ("nis_inside" in found) is not raw
    if not raw:
        for name, key in (
            ("position_nees", "position_nees"),
            ("log_likelihood_per_step", "log_likelihood_per_step"),
            ("nis_per_component", "nis_per_dof"),
            ("nis_inside", "nis_inside"),
        ):
            assert found[name].value == pytest.approx(known[key], rel=1e-12), name
            assert found[name].low < found[name].value < found[name].high, name
        assert found["diverged_share"].value == known["diverged_steps"] / known["steps"]


def test_gated_files_are_read_both_ways(tmp_path):
    folder = tmp_path / "uwb_outdoor"
    folder.mkdir()
    for name in ("a_case1_ranges.csv", "a_case1_truth.csv"):
        (folder / name).write_text("t\n")
    files = {file.name: file.request for file in list_files(tmp_path)}
    name = "uwb_outdoor/a_case1_ranges.csv"
    flags = "--truth a_case1_truth.csv --truth-columns t=time_aligned --axes 2 --height 1.1"
    assert list_flags(files[name]) == f"{flags} --gate"
    assert list_flags(files[name + UNGATED]) == flags
    assert list_flags(TrackRequest(tmp_path / "x.csv", bias=("range=2.8",), where=("a=1", "b=2"))) == (
        "--where a=1 --where b=2 --bias range=2.8"
    )


# Pages made from committed rows.


@pytest.mark.parametrize("suite", ["published", "recorded"])
def test_committed_rows_are_whole(suite):
    rows = read_rows(ROWS / f"{suite}.parquet")
    assert set(rows["suite"]) == {suite} and "error" not in set(rows["status"])
    assert not rows.duplicated(["scenario", "estimator", "metric", "commit"]).any()
    known = rows["low"].notna()
    assert (known == rows["interval"].str.contains("bootstrap")).all() and known.mean() > 0.5
    assert (rows["interval"].str.len() > 0).all() and (rows["low"] <= rows["high"])[known].all()
    plain = known & ~rows["metric"].str.contains("peak")
    assert ((rows["low"] <= rows["value"]) & (rows["value"] <= rows["high"]))[plain].all()
    assert not re.search(r"(?<![\w.])/\w+/|\\\\Users", rows.to_csv()), "a folder of some machine"
    assert rows["command"].str.startswith(f"jink bench --suite {suite}").all()
    assert "--quick" not in set(" ".join(rows["command"]).split())


def test_readme_shows_the_committed_rows(pages):
    rows = pages.ladder_rows()
    block = pages.results_block(rows)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"<!-- results:start -->\n{block}<!-- results:end -->" in text, "run benchmarks/update_readme.py"
    scenes = len(pages.compared(rows))
    assert scenes and block.count("\n|") == 7  # under the heading: the rule and six rows
    assert len(re.findall(r"\d \[[\d.]+, [\d.]+\]", block)) == 6 * scenes


def test_readme_table_is_that_of_the_runs(pages):
    """Against plain numpy, not the script: the error of imm, and on which side of it the others are."""
    rows = pages.ladder_rows()
    block = pages.results_block(rows)
    lines = {line.split("|")[1].strip(): line.split("|")[2:-1] for line in block.splitlines() if line.startswith("|")}
    for column, scene in enumerate(pages.compared(rows)):
        mine = rows[(rows["scenario"] == scene) & (rows["metric"] == "position_rmse") & (rows["kind"] == "number")]
        runs = {row.estimator: np.asarray(row.samples, float) for row in mine.itertuples() if row.samples is not None}
        for name in ("kf-cv", "imm", "joint-imm", "oracle"):
            shown = lines[pages.LINES[name]][column]
            value = math.sqrt(np.mean(runs[name] ** 2))
            assert float(shown.split("[")[0]) == pytest.approx(value, rel=6e-3)
            if " ▼" in shown:
                assert value < math.sqrt(np.mean(runs["imm"] ** 2))
            if " ▼▼" in shown:
                assert value < min(math.sqrt(np.mean(runs[one] ** 2)) for one in pages.CLASSICAL)
            if " ▲" in shown:
                assert value > math.sqrt(np.mean(runs["imm"] ** 2))


def test_readme_figure_was_drawn_from_the_committed_rows(pages, tmp_path):
    from PIL import Image

    numbers = pages.plotted(pages.ladder_rows())
    with Image.open(pages.PICTURE) as picture:
        assert picture.info["Description"] == pages.digest(numbers), "run benchmarks/update_readme.py"
        assert picture.size[0] == 960
    assert "](docs/pictures/ladder.png)" in (ROOT / "README.md").read_text(encoding="utf-8")
    pages.draw(numbers, tmp_path / "again.png")
    with Image.open(tmp_path / "again.png") as again:
        assert again.info["Description"] == pages.digest(numbers)
        assert np.asarray(again.convert("L")).std() > 10, "something is drawn"
    some = next(iter(numbers))
    assert pages.digest(numbers | {some: {}}) != pages.digest(numbers)


def test_recorded_page_shows_the_committed_rows(pages):
    text = (ROOT / "docs" / "recorded.md").read_text(encoding="utf-8")
    for marker, block in pages.recorded_tables(read_rows(ROWS / "recorded.parquet")).items():
        assert f"<!-- {marker}:start -->\n{block}<!-- {marker}:end -->" in text, "run benchmarks/update_readme.py"


def test_a_page_without_its_marker_is_refused(pages):
    assert pages.replace_block("<!-- a:start -->\nold<!-- a:end -->", "a", "new\n") == (
        "<!-- a:start -->\nnew\n<!-- a:end -->"
    )
    with pytest.raises(SystemExit, match="marker 'b' once"):
        pages.replace_block("<!-- a:start -->\n<!-- a:end -->", "b", "")


@pytest.mark.parametrize("world", ["three", "five"])
def test_tables_of_the_learner_are_its_rows(world, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    learn = importlib.import_module("learn_intents")
    learn.show(ROWS / f"learn_{world}.jsonl")
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    block = re.search(rf"<!-- learn-{world}:start -->\n(.*?)<!-- learn-{world}:end -->", page, flags=re.S)
    assert [line for line in block[1].splitlines() if line] == capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("name", ["agent_batches", "agent_ablations"])
def test_tables_of_trainings_are_those_of_the_rows(name, monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    script = importlib.import_module(name)
    kept = json.loads((ROWS / f"{name}.json").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    marker = name.replace("_", "-")
    block = re.search(rf"<!-- {marker}:start -->\n(.*?)<!-- {marker}:end -->", page, flags=re.S)
    assert [line for line in block[1].splitlines() if line] == [line for line in script.table(kept) if line]
    assert kept["command"] in page
    if name == "agent_batches":
        head = (ROOT / "docs" / "pictures" / "agent_batches.png").read_bytes()[:2000]
        assert script.digest(kept).encode() in head
    else:
        for row in kept["rows"]:
            value, low, high = row["score"]
            assert low <= value <= high and low <= np.mean(row["each"]) <= high, row
            assert row["seeds"] == len(row["each"]) >= 2


@pytest.mark.slow
def test_a_training_of_the_ablations_comes_out_about_as_its_row_says(tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    script = importlib.import_module("agent_ablations")
    kept = json.loads((ROWS / "agent_ablations.json").read_text(encoding="utf-8"))
    (variant,) = (one for one in script.VARIANTS if one[:2] == (script.NOTHING, "advice alone"))
    (row,) = (row for row in kept["rows"] if (row["group"], row["variant"]) == variant[:2])
    source = script.make_source("surge")
    episodes = script.simulate_seeds(source, script.TEST_SEED, kept["episodes"])
    done = script.run(script.config_of(variant, {}, 0), tmp_path / "x", source, episodes)
    assert done["steps"] == row["steps"]
    # The rows are of an earlier chain of noise levels (see their "made with"), and seeds differ by 0.01 to 0.02.
    assert script.interquartile_mean(np.array(done["scores"])) == pytest.approx(row["each"][0], abs=0.04)
