"""The ladder of `jink bench`: scores, pairing, cells that anybody reproduces, files that survive, any backend."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from jink.envs.scenarios import SUITES, make_scenario
from jink.estimators.api import Estimates
from jink.training import cli
from jink.training.bench_jobs import SIMULATED, jobs_of, rows_of_job
from jink.training.bench_request import BenchRequest
from jink.training.ladder.backends import Place, compute_all
from jink.training.ladder.pairing import compare, compare_suites, pool_runs
from jink.training.ladder.rungs import LADDER, NoSuchRung, make_follower
from jink.training.ladder.scores import METRICS, Readings, score_runs
from jink.training.ladder.settings import SETTINGS_FILE, Settings, settings_of
from jink.training.ladder.table import print_ladder
from jink.training.ladder.typical import EVALUATION_SEED, TRAINING_SEED, simulate_runs
from jink.training.row_writer import RowWriter, remove_leftovers
from jink.training.rows import COLUMNS, Cell, make_rows, read_rows

ROOT = Path(__file__).resolve().parent.parent
QUICK = ("kf-cv", "huber", "oracle", "bound")
"""Rungs that share what is compiled for everybody."""
TIMED = ["seconds", "started", "machine"]


def run(*arguments):
    return cli.main([str(argument) for argument in arguments])


def refused(capsys, *arguments):
    assert run("bench", *arguments) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and text.startswith("jink: "), text
    return text


def words(*, suite="surge", scenario="surge-v0", runs=3, estimators=QUICK, **more):
    given = ["--suite", suite, "--scenario", scenario, "--runs", runs]
    for name in estimators:
        given += ["--estimator", name]
    for option, value in more.items():
        given += [f"--{option}", value]
    return given


def without_times(rows):
    """What does not depend on the clock, in an order of its own."""
    rows = rows[rows["metric"] != "microseconds_per_step"].drop(columns=TIMED)
    return rows.sort_values(["scenario", "estimator", "seed", "kind", "metric"]).reset_index(drop=True)


def assert_same(one, other):
    one, other = without_times(one), without_times(other)
    pd.testing.assert_frame_equal(one.drop(columns=["at", "samples"]), other.drop(columns=["at", "samples"]))
    for name in ("at", "samples"):
        for mine, theirs in zip(one[name], other[name], strict=True):
            assert (mine is None) == (theirs is None)
            if mine is not None:
                np.testing.assert_array_equal(mine, theirs)


def rows_of(request):
    return pd.concat([rows_of_job(job) for job in jobs_of(request.suite, request)], ignore_index=True)


# Scores.


def made_up(scenario="switch-v0", runs=4, **changes):
    """Episodes, and estimates that are the truth, sure of it, with changes."""
    episodes = simulate_runs(make_scenario(scenario), runs, EVALUATION_SEED)
    B, T = episodes.times.shape
    found = Estimates(
        episodes.times, episodes.truth.position.copy(), episodes.truth.velocity.copy(),
        np.tile(np.eye(4), (B, T, 1, 1)), np.ones((B, T, 1)), np.zeros((B, T)), np.full((B, T), 2.0),
        np.full((B, T), 2), np.zeros((B, T), dtype=np.int8),
    )  # fmt: skip
    return episodes, found._replace(**changes)


def test_errors_are_those_that_were_put_in():
    episodes, found = made_up()
    found.position[:, :, 0] += 3.0
    found.velocity[:, ::2, 1] += 2.0
    scores = score_runs(episodes, found, Readings())
    np.testing.assert_allclose(scores["position_rmse"], 3.0)
    np.testing.assert_allclose(scores["velocity_rmse"], np.sqrt(2.0))
    np.testing.assert_allclose(scores["peak_after_switch"], 3.0)
    np.testing.assert_allclose(scores["jitter"], 0.0, atol=1e-9)
    np.testing.assert_allclose(scores["nees"], 9.0 + 2.0)
    np.testing.assert_allclose(scores["nis"], 1.0)
    assert set(scores) == set(METRICS) and not scores["lost"].any()
    for name in ("peak_in_surge", "prediction_rmse", "intent_accuracy", "surge_accuracy"):
        assert np.isnan(scores[name]).all(), name


def test_a_track_is_lost_after_ten_samples_far_off():
    episodes, found = made_up()
    found.position[0, 50:59] += 100.0
    found.position[1, 50:60] += 100.0
    found.position[2, 50:60] += 70.0  # 99 sigma
    found.position[3, 100] = np.nan
    scores = score_runs(episodes, found, Readings())
    assert list(scores["lost"]) == [0.0, 1.0, 0.0, 0.0]
    assert scores["position_rmse"][3] == np.inf


def test_predictions_are_judged_where_the_target_will_be():
    episodes, found = made_up("switch-irregular-v0")
    truth = episodes.truth
    # A target that flew straight for a second, seen at random moments.
    straight = truth._replace(
        position=episodes.times[..., None] * np.array([3.0, -2.0]), velocity=np.full_like(truth.velocity, [3.0, -2.0])
    )
    episodes = episodes._replace(truth=straight)
    found = found._replace(position=straight.position, velocity=straight.velocity)
    right = straight.position + np.array([3.0, -2.0])
    np.testing.assert_allclose(score_runs(episodes, found, Readings(right))["prediction_rmse"], 0.0, atol=1e-9)
    np.testing.assert_allclose(score_runs(episodes, found, Readings(right + 0.6))["prediction_rmse"], 0.6 * 2**0.5)


def test_peaks_are_those_of_surges():
    episodes, found = made_up("surge-25-bursts-v0", 2)
    loud = np.flatnonzero(episodes.scale[0] > 1.5)
    second = loud[np.flatnonzero(np.diff(loud) > 1)[0] + 1]
    found.position[0, loud[2], 0] += 8.0
    found.position[0, second, 0] += 4.0
    found.position[0, np.flatnonzero(episodes.scale[0] == 1.0)[0], 0] += 100.0
    assert score_runs(episodes, found, Readings())["peak_in_surge"][0] == pytest.approx(6.0)


def test_intents_are_judged_where_they_are_known():
    episodes, found = made_up()
    names = make_scenario("switch-v0").intents
    true = episodes.truth.intent
    sure = np.eye(len(names))[true]
    scores = score_runs(episodes, found, Readings(intents=sure))
    np.testing.assert_array_equal(scores["intent_accuracy"], 1.0)
    np.testing.assert_array_equal(scores["intent_delay"], 0.0)
    late = np.eye(len(names))[np.concatenate([true[:, :1].repeat(3, axis=1), true[:, :-3]], axis=1)]
    delays = score_runs(episodes, found, Readings(intents=late))["intent_delay"]
    assert np.all((delays > 0.2) & (delays < 0.31))
    # What it has no word for, it does not recognise: an easier subset is no merit.
    deaf = sure.copy()
    deaf[..., names.index("jink")] = np.nan
    scores = score_runs(episodes, found, Readings(intents=deaf))
    np.testing.assert_allclose(scores["intent_accuracy"], (true != names.index("jink")).mean(axis=1))
    some = (np.diff(true, axis=1) != 0).any(axis=1) & (true[:, 1:] == names.index("jink")).any(axis=1)
    assert some.any() and np.all(scores["intent_delay"][some] > 0.0)
    nothing = score_runs(episodes, found, Readings(intents=np.full_like(sure, np.nan)))
    assert np.isnan(nothing["intent_accuracy"]).all() and np.isnan(nothing["intent_delay"]).all()


def test_ties_between_intents_are_no_recognition():
    episodes, found = made_up()
    names = make_scenario("switch-v0").intents
    true = episodes.truth.intent
    uniform = np.full((*true.shape, len(names)), 1.0 / len(names))
    scores = score_runs(episodes, found, Readings(intents=uniform))
    np.testing.assert_array_equal(scores["intent_accuracy"], 0.0)
    never = scores["intent_delay"]
    late = score_runs(episodes, found, Readings(intents=np.eye(len(names))[(true + 1) % len(names)]))
    np.testing.assert_array_equal(never, late["intent_delay"])
    assert np.all(never > 0.5)
    # One word for two intents: naming it is right for both, and a tie with a third is still wrong.
    one, other, third = range(3)
    turns = np.isin(true, (one, other))
    said = np.eye(len(names))[true]
    said[turns] = 0.0
    said[turns, one] = said[turns, other] = 1.0
    alike = tuple(one if k == other else k for k in range(len(names)))
    np.testing.assert_array_equal(score_runs(episodes, found, Readings(None, said, alike))["intent_accuracy"], 1.0)
    foreign = np.where(turns, 2.0, 0.5)  # an intent of its own that the target does not have
    accuracy = score_runs(episodes, found, Readings(None, said, alike, foreign=foreign))["intent_accuracy"]
    np.testing.assert_allclose(accuracy, 1.0 - turns.mean(axis=1))
    said[turns, third] = 1.0
    accuracy = score_runs(episodes, found, Readings(None, said, alike))["intent_accuracy"]
    np.testing.assert_allclose(accuracy, 1.0 - turns.mean(axis=1))


def test_surges_are_judged_sample_by_sample():
    episodes, found = made_up("surge-25-bursts-v0", 2)
    said = np.where(episodes.scale > 1.5, 0.9, 0.1)
    said[1, :30] = 1.0 - said[1, :30]
    accuracy = score_runs(episodes, found, Readings(surge=said))["surge_accuracy"]
    np.testing.assert_allclose(accuracy, [1.0, 0.9])


# The ladder.


@pytest.mark.parametrize("suite", SIMULATED)
def test_every_rung_follows_every_suite(suite):
    scenario = make_scenario(SUITES[suite][0])
    episodes = simulate_runs(scenario, 2, EVALUATION_SEED)
    missing = set()
    for name in LADDER:
        if name == "bound":
            continue
        try:
            follower = make_follower(name, scenario, settings_of(suite, name))
        except NoSuchRung:
            missing.add(name)
            continue
        found = follower.estimate(episodes)
        said = follower.read(episodes, found)
        scores = score_runs(episodes, found, said)
        assert np.isfinite(scores["position_rmse"]).all(), name
        assert json.dumps(follower.parameters, default=str)
        assert said.surge is None or ((said.surge >= 0) & (said.surge <= 1 + 1e-9)).all()
        if name not in ("raw", "oracle"):
            assert np.isfinite(scores["prediction_rmse"]).all(), name
    assert missing <= {"intent-imm@learned", "agent"}


def test_raw_repeats_the_last_measurement():
    scenario = make_scenario("switch-irregular-v0")
    episodes = simulate_runs(scenario, 2, EVALUATION_SEED)
    found = make_follower("raw", scenario, Settings()).estimate(episodes)
    seen = np.isfinite(episodes.measurements).all(axis=2)
    np.testing.assert_array_equal(found.position[seen], episodes.measurements[seen])
    late = np.argwhere(~seen[:, 1:])
    assert len(late) > 20
    for b, k in late:
        np.testing.assert_array_equal(found.position[b, k + 1], found.position[b, k])


def test_ladder_has_its_order_on_surges():
    rows = rows_of(
        BenchRequest("surge", scenarios=("surge-v0",), estimators=("raw", "kf-cv", "oracle", "bound"), runs=40)
    )
    values = {each.estimator: each.value for each in compare(rows, base="kf-cv")}
    assert values["raw"].value > values["kf-cv"].value > values["oracle"].value
    # The mean over runs of squared errors scatters around the bound by a few per cent.
    assert values["oracle"].value == pytest.approx(values["bound"].value, rel=0.15)


def test_everybody_sees_the_same_and_is_told_the_same():
    one, other = (simulate_runs(make_scenario("joint-v0"), runs, seed) for runs, seed in ((3, 7), (1, 9)))
    np.testing.assert_array_equal(one.measurements[2], other.measurements[0])
    np.testing.assert_array_equal(one.truth.position[2], other.truth.position[0])


def test_settings_are_used_and_were_chosen_on_other_seeds():
    table = json.loads(SETTINGS_FILE.read_text(encoding="utf-8"))
    assert table["seed"] == TRAINING_SEED < EVALUATION_SEED and "tune_bench.py" in table["command"]
    assert set(table["settings"]) == set(SIMULATED)
    for suite, chosen in table["settings"].items():
        assert set(LADDER) - set(chosen) <= {"raw", "bound", "agent", "intent-imm@learned"}, suite
        assert all(set(values) <= set(Settings._fields) for values in chosen.values())
    usual, told = (
        make_follower("imm", make_scenario("surge-v0"), settings).parameters["scales"]["acceleration"]
        for settings in (Settings(), Settings(acceleration=4.0))
    )
    assert told == 4.0 * usual


# Pairing.


def number_rows(samples, *, estimator, seed=0, scenario="s", metric="position_rmse", started="1"):
    cell = Cell("surge", scenario, estimator, len(samples), seed, "c")
    row = {"metric": metric, "value": 0.0, "samples": np.array(samples, np.float32), "statistic": "rms"}
    return make_rows(cell, {}, more=[row], started=started)


def test_differences_are_paired_by_seed():
    rng = np.random.default_rng(0)
    base = np.exp(rng.normal(size=200)).astype(np.float32)
    rows = pd.concat(
        [
            number_rows(base, estimator="imm"),
            number_rows(base[100:] + 0.1, estimator="other", seed=100),
            number_rows(base[:100] + 0.1, estimator="other"),
            number_rows(base, estimator="twin"),
        ]
    )
    found = {each.estimator: each for each in compare(rows)}
    imm, other, twin = found["imm"], found["other"], found["twin"]
    assert imm.difference is None and imm.value.value == pytest.approx(np.sqrt(np.mean(np.float64(base) ** 2)))
    middle = np.sort(np.float64(base))[50:150]
    assert imm.iqm.value == pytest.approx(middle.mean(), rel=1e-6)
    assert other.runs == 200 and 0.0 < other.difference.low < other.difference.value < other.difference.high
    # The runs scatter by more than the mean; a constant difference in pairs does not.
    assert other.difference.high - other.difference.low < 0.1 * (other.value.high - other.value.low)
    assert twin.difference[:1] + twin.difference[2:4] == (0.0, 0.0, 0.0)
    assert twin.ratio[:1] + twin.ratio[2:4] == (1.0, 1.0, 1.0)
    shuffled = pd.concat([number_rows(base, estimator="imm"), number_rows(base[::-1], estimator="twin")])
    assert {each.estimator: each for each in compare(shuffled)}["twin"].difference.high > 0.05


def test_later_blocks_replace_earlier_ones_and_missing_runs_do_not_count():
    rows = pd.concat(
        [
            number_rows([1.0, 2.0], estimator="imm", started="1"),
            number_rows([3.0, np.nan], estimator="imm", started="2"),
            number_rows([5.0], estimator="imm", seed=7, started="0"),
        ]
    )
    runs = pool_runs(rows, "position_rmse")["surge", "s", "imm"]
    assert list(runs.seeds) == [0, 1, 7]
    np.testing.assert_array_equal(runs.values, [3.0, np.nan, 5.0])
    assert compare(rows)[0].value.value == pytest.approx(np.sqrt((9 + 25) / 2))


def test_only_runs_that_both_have_are_paired():
    # Half a metre worse in every run that it has; the base was much worse in those that it has not.
    base = np.linspace(1.0, 2.0, 60) + np.where(np.arange(60) < 30, 0.0, 8.0)
    mine = np.where(np.arange(60) < 30, base + 0.5, np.nan)
    rows = pd.concat([number_rows(base, estimator="imm"), number_rows(mine, estimator="mine")])
    for some in (rows, pd.concat([number_rows(mine, estimator="imm"), number_rows(base, estimator="mine")])):
        each = {one.estimator: one for one in compare(some)}["mine"]
        sign = 1.0 if some is rows else -1.0
        assert each.runs == 60 and each.pairs == 30
        assert 0.3 < sign * each.difference.value < 0.6 and sign * each.difference.low > 0 < sign * each.difference.high
        assert (each.ratio.low > 1.0) if some is rows else (each.ratio.high < 1.0)
    each = {one.estimator: one for one in compare_suites(rows)}["mine"]
    assert 1.2 < each.ratio.value < 1.5 and each.ratio.low > 1.0
    apart = pd.concat([number_rows([1.0] * 6 + [np.nan] * 6, estimator="imm"),
                       number_rows([np.nan] * 6 + [1.0] * 6, estimator="mine")])  # fmt: skip
    each = {one.estimator: one for one in compare(apart)}["mine"]
    assert each.difference is None and each.ratio is None and each.pairs == 0


def test_a_number_has_one_interval(pages):
    """In its row, and in every table made from rows: also in those that are committed."""
    request = BenchRequest("surge", scenarios=("surge-v0",), estimators=("kf-cv", "bound"), runs=8, seed=100_010)
    for rows in (rows_of(request), pages.committed()):
        shown = {(one.suite, one.scenario, one.estimator): one.value for one in compare(rows)}
        mine = rows[rows["metric"] == "position_rmse"]
        assert len(shown) == len(mine) >= 2
        for row in mine.itertuples():
            value, _, low, high, words = shown[row.suite, row.scenario, row.estimator]
            assert (value, low, high) == pytest.approx((row.value, row.low, row.high), rel=1e-9, nan_ok=True)
            assert words == row.interval


def test_an_infinite_run_spoils_the_mean_but_not_the_middle():
    rows = number_rows([*np.linspace(1, 2, 11), np.inf], estimator="imm")
    found = compare(rows)[0]
    assert found.value.value == np.inf and 1.4 < found.iqm.value < 1.8


def test_suites_are_compared_by_the_geometric_mean():
    parts = []
    for scenario, factor in (("a", 0.5), ("b", 2.0), ("c", 0.25)):
        base = np.exp(np.random.default_rng(1).normal(size=50))
        parts.append(number_rows(base, estimator="imm", scenario=scenario))
        parts.append(number_rows(factor * base, estimator="other", scenario=scenario))
    parts.append(number_rows([1.0] * 50, estimator="part", scenario="a"))
    found = {each.estimator: each for each in compare_suites(pd.concat(parts))}
    assert found["other"].ratio.value == pytest.approx(0.25 ** (1 / 3), rel=1e-6) and found["other"].scenarios == 3
    assert found["part"].missing == ("b", "c")


# Cells and their commands.


def test_blocks_are_the_runs_of_one_long_cell(monkeypatch):
    request = BenchRequest("surge", scenarios=("surge-v0",), estimators=("kf-cv",), runs=6)
    whole = rows_of(request)
    monkeypatch.setattr("jink.training.bench_jobs.BLOCK", 4)
    blocks = rows_of(request)
    assert len(jobs_of("surge", request)) == 2
    for metric in ("position_rmse", "nees"):
        one, other = (pool_runs(rows, metric)["surge", "surge-v0", "kf-cv"] for rows in (whole, blocks))
        np.testing.assert_array_equal(one.seeds, other.seeds)
        np.testing.assert_array_equal(one.values, other.values)


def test_any_cell_is_made_again_by_its_command(tmp_path, capsys):
    out = tmp_path / "rows.parquet"
    assert run("bench", *words(suite="joint", scenario="joint-v0", estimators=("truth", *QUICK)), "--out", out) == 0
    rows = read_rows(out)
    assert set(rows["kind"]) == {"number", "curve", "track"} and list(rows.columns) == list(COLUMNS)
    for index, command in enumerate(dict.fromkeys(rows["command"])):
        again = tmp_path / f"{index}.parquet"
        first, *rest = command.split()
        assert first == "jink" and run(*rest, "--out", again) == 0
        assert_same(rows[rows["command"] == command], read_rows(again))
    capsys.readouterr()
    # Other seeds are other numbers.
    assert run("bench", *words(estimators=("kf-cv",), seed=5), "--out", tmp_path / "other.parquet") == 0
    samples = read_rows(tmp_path / "other.parquet").set_index("metric").loc["position_rmse", "samples"]
    assert not np.isin(samples, np.concatenate([x for x in rows["samples"] if x is not None])).any()


def test_numbers_follow_from_their_samples():
    rows = rows_of(BenchRequest("surge", scenarios=("surge-v0",), estimators=("kf-cv",), runs=8))
    numbers = rows[(rows["kind"] == "number") & (rows["statistic"] != "once")]
    assert len(numbers) > 8
    for row in numbers.itertuples():
        samples = np.float64(row.samples)
        assert len(samples) == 8
        expected = np.sqrt(np.nanmean(samples**2)) if row.statistic == "rms" else np.nanmean(samples)
        assert row.value == pytest.approx(expected, rel=1e-12), row.metric
        assert row.low <= row.value <= row.high and "8 runs" in row.interval
    parameters = json.loads(rows["parameters"][0])
    assert parameters["scenario"]["surges.0"] == "MarkovBursts" and parameters["estimator"]["scales"]["speed"] > 0


def test_skipped_rungs_say_why_and_are_tried_again(tmp_path, capsys):
    out = tmp_path / "rows.parquet"
    given = ("bench", *words(suite="model-error", scenario="model-error-v0", estimators=("bound",)), "--out", out)
    assert run(*given) == 0
    rows = read_rows(out)
    assert list(rows["status"]) == ["skipped"] and "by how much" in rows["reason"][0]
    assert "skipped, the truth does not tell" in capsys.readouterr().out
    assert run(*given) == 0 and len(read_rows(out)) == 1


def test_a_third_party_takes_part(tmp_path, capsys):
    out = tmp_path / "rows.parquet"
    spec = ROOT / "examples" / "my_estimator.py"
    assert run("bench", *words(estimators=("kf-cv", f"{spec}:AlphaBeta")), "--out", out) == 0
    assert "my_estimator.py:AlphaBeta" in capsys.readouterr().out
    rows = read_rows(out)
    mine = rows[rows["estimator"] == "my_estimator.py:AlphaBeta"]
    assert re.fullmatch("[0-9a-f]{12}", mine["data"].iloc[0]) and str(ROOT) not in rows.to_csv()
    assert "--estimator my_estimator.py:AlphaBeta" in mine["command"].iloc[0]
    value = mine.set_index("metric").loc["position_rmse", "value"]
    assert 0.3 < value < 100.0


OUTSIDE = """
import sys
import numpy as np

class Last:
    def __init__(self, sensor):
        pass

    def run(self, measurements, times):
        return np.where(np.isfinite(measurements), measurements, 0.0)

class Smooths(Last):
    def run(self, measurements, times):
        z = super().run(measurements, times)
        return z + 0.5 * (np.roll(z, -1, axis=-2) - z)

class Guesses(Last):
    def run(self, measurements, times):
        return super().run(measurements, times) + np.random.default_rng().normal(size=measurements.shape)

class Leaves(Last):
    def run(self, measurements, times):
        sys.exit(3)

class Stops(Last):
    def run(self, measurements, times):
        raise KeyboardInterrupt
"""


def outside(folder, name):
    path = folder / "others.py"
    path.write_text(OUTSIDE)
    return f"{path}:{name}"


def test_who_ends_the_program_gets_an_error_row(tmp_path, capsys):
    out = tmp_path / "rows.parquet"
    given = words(estimators=(outside(tmp_path, "Leaves"), "kf-cv", outside(tmp_path, "Last")))
    assert run("bench", *given, "--out", out) == 1
    rows = read_rows(out)
    left = rows[rows["estimator"] == "others.py:Leaves"]
    assert list(left["status"]) == ["error"] and "SystemExit" in left["reason"].iloc[0]
    assert set(rows.loc[rows["status"] == "ok", "estimator"]) == {"kf-cv", "others.py:Last"}
    assert "SystemExit" in capsys.readouterr().out


def test_ctrl_c_stops_whoever_is_computing(tmp_path, capsys):
    given = words(estimators=("kf-cv", outside(tmp_path, "Stops"), "huber"))
    assert run("bench", *given, "--out", tmp_path / "rows.parquet") == 130
    assert set(read_rows(tmp_path / "rows.parquet")["estimator"]) == {"kf-cv"}


@pytest.mark.parametrize(("name", "reason"), [("Smooths", "later measurements change"), ("Guesses", "a second run")])
def test_who_looks_ahead_has_no_place_among_filters(tmp_path, name, reason):
    rows = rows_of(
        BenchRequest("surge", scenarios=("surge-v0",), estimators=("kf-cv", outside(tmp_path, name)), runs=2)
    )
    mine = rows[rows["estimator"] == f"others.py:{name}"]
    assert list(mine["status"]) == ["error"] and reason in mine["reason"].iloc[0] and mine["value"].isna().all()


def test_seeds_that_were_learned_from_are_named(capsys):
    for more in ({}, {"seed": EVALUATION_SEED}, {"seed": 999_997}):
        assert run("bench", *words(estimators=("kf-cv",), **more)) == 0
        assert capsys.readouterr().err.count("seeds") == 0
    for seed in (TRAINING_SEED, EVALUATION_SEED - 1, 999_998, 10_000_000):
        assert run("bench", *words(estimators=("kf-cv",), seed=seed)) == 0
        assert f"seeds {seed} to {seed + 2}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--suite", "surges"), "--suite: name must be one of switch, surge"),
        (("--suite", "surge", "--scenario", "surge"), "--scenario: name must be one of the suite surge: surge-v0"),
        (("--suite", "surge", "--estimator", "ekf"), "--estimator: name must be one of the suite surge: truth, raw"),
        (("--suite", "surge", "--estimator", "intent-imm@nobody"), "--estimator: name must be one"),
        (("--suite", "surge", "--estimator", "nowhere.py:make"), "--estimator: file must exist"),
        (("--suite", "published", "--estimator", "ekf"), "--estimator: name must be one of the suite published"),
        (("--suite", "published", "--scenario", "x"), "--scenario: name must be one of the suite published"),
        (("--suite", "surge", "--runs", "0"), "--runs: value must be >= 1"),
        (("--suite", "surge", "--runs", "x"), "Invalid value for '--runs'"),
        (("--suite", "surge", "--seed", "-1"), "--seed: value must be >= 0"),
        (("--suite", "surge", "--workers", "0"), "--workers: value must be >= 1"),
        (("--suite", "surge", "--backend", "slurm"), "--backend: name must be one of local, dask, ray"),
        (("--suite", "surge", "--address", "tcp://x:1"), "--address: option must come with --backend dask or ray"),
        (
            ("--suite", "surge", "--backend", "dask", "--address", "tcp://127.0.0.1:1"),
            "a dask cluster must answer|dask must be installed",
        ),
        (
            ("--suite", "surge", "--backend", "ray", "--address", "127.0.0.1:1"),
            "a ray cluster must answer|ray must be installed",
        ),
        (("--suite", "surge", "--data", "."), "--data: option must be left out of the suite surge"),
        (("--suite", "all", "--scenario", "surge-v0"), "--scenario: option must be left out of the suite all"),
        (("--scenario", "surge-v0"), "--scenario: option must be left out of the suite ladder"),
        (("--suite", "surge", "--out", "rows.csv"), r"--out: file must end in \.parquet"),
        (("--suite", "surge", "--out", "/no/where/rows.parquet"), "--out: file must lie in an existing folder"),
        (("--suite", "surge", "--out", "/proc/rows.parquet"), "--out: folder must be writable"),
    ],
)
def test_refusals_are_one_sentence(capsys, arguments, sentence):
    assert re.search(sentence, refused(capsys, *arguments))


# Pages made from committed rows.


@pytest.fixture(scope="module")
def pages():
    """The script that writes the tables."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        import update_bench_pages
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))
    return update_bench_pages


def test_pages_show_the_committed_rows(pages):
    for (page, marker), block in pages.blocks(pages.committed()).items():
        text = (ROOT / page).read_text(encoding="utf-8")
        wanted = f"<!-- {marker}:start -->\n{block}<!-- {marker}:end -->"
        assert wanted in text, f"{page}, {marker}: run python benchmarks/update_bench_pages.py"
        assert block.count("\n|") >= 5 and "nan" not in block


@pytest.mark.parametrize("suite", SIMULATED)
def test_committed_rows_are_whole(suite, pages):
    path = pages.ROWS / f"{suite.replace('-', '_')}.parquet"
    assert path.stat().st_size < 700_000
    rows = read_rows(path)
    assert set(rows["suite"]) == {suite} and "error" not in set(rows["status"])
    numbers = rows[rows["kind"] == "number"]
    assert not numbers.duplicated(["scenario", "estimator", "metric", "seed"]).any()
    assert set(numbers["scenario"]) == set(SUITES[suite]) and set(LADDER) == set(numbers["estimator"])
    assert rows["command"].str.startswith(f"jink bench --suite {suite} --scenario ").all()
    assert (rows["seed"] >= EVALUATION_SEED).all()
    assert not re.search(r"(?<![\w.])/\w+/|\\\\Users", rows.drop(columns=["at", "samples"]).to_csv())


def test_committed_rows_were_made_with_the_committed_settings(pages):
    """As many runs as both pages say, and every estimator as it is tuned."""
    rows = pages.committed()
    made = rows[rows["kind"] == "number"].drop_duplicates(["suite", "scenario", "estimator"])
    counted = 0
    for row in made[(made["status"] != "skipped") & ~made["estimator"].isin(["truth", "raw", "bound"])].itertuples():
        told = json.loads(row.parameters)["estimator"]["settings"]
        assert told == settings_of(row.suite, row.estimator)._asdict(), f"{row.scenario}, {row.estimator}: make it anew"
        counted += told != Settings()._asdict()
    assert counted > 300
    runs = set(made.loc[made["estimator"] != "truth", "runs"])
    assert len(runs) == 1
    for page, section in (("README.md", "results:start"), ("docs/results.md", "## The benchmark")):
        text = (ROOT / page).read_text(encoding="utf-8").partition(section)[2][:3000]
        assert re.search(r"jink bench --suite \w+ --runs (\d+)", text)[1] == str(*runs), page


def test_the_table_says_who_diverged_and_when_there_are_no_intervals():
    lost = number_rows([9.0, 8.0, 7.0, 9.0], estimator="imm").assign(status="diverged", reason="51 %")
    rows = pd.concat([lost, number_rows([1.0, 2.0, 3.0, 2.0], estimator="kf-cv")])
    out = io.StringIO()
    print_ladder(Console(file=out, width=110), rows)
    assert "imm †" in out.getvalue() and "kf-cv †" not in out.getvalue() and "† diverged" in out.getvalue()
    assert "fewer than 5 runs" in out.getvalue()
    out = io.StringIO()
    print_ladder(Console(file=out, width=110), pd.concat([number_rows([1.0, 2.0] * 5, estimator="imm")]))
    assert "fewer than" not in out.getvalue() and "†" not in out.getvalue()


def test_the_grid_breaks_into_tables_that_fit():
    rows = pd.concat(
        number_rows([12.5] * 6, estimator=name, scenario=f"a-long-scenario-{k}-v0")
        for name in ("imm", "my_estimator.py:AlphaBeta")
        for k in range(9)
    )
    out = io.StringIO()
    print_ladder(Console(file=out, width=100), rows)
    text = out.getvalue()
    assert all(f"a-long-scenario-{k}" in text for k in range(9)) and text.count("my_estimator.py:AlphaBeta") >= 3
    assert text.count("12.5 ±0") == 18 and max(map(len, text.splitlines())) <= 100


# Files.


SLOWED = """
import time
from jink.training.row_writer import RowWriter
add = RowWriter.add
RowWriter.add = lambda writer, rows: (add(writer, rows), time.sleep(1.0))
"""


def bench_process(out, *more, slowed=False, **options):
    """The command in a process of its own; slowed: it rests a second after each cell, so that it can be stopped."""
    code = f"{SLOWED if slowed else ''}import sys; from jink.training.cli import main; sys.exit(main(sys.argv[1:]))"
    given = [str(word) for word in ("bench", *words(runs=60, estimators=("truth", *QUICK)), "--out", out, *more)]
    return subprocess.Popen(
        [sys.executable, "-c", code, *given], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


def wait_for_rows(out, process):
    for _ in range(1200):
        if out.exists() or process.poll() is not None:
            return
        time.sleep(0.05)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The rows of a run that nobody disturbed."""
    out = tmp_path_factory.mktemp("whole") / "rows.parquet"
    process = bench_process(out)
    process.communicate(timeout=300)
    assert process.returncode == 0
    return read_rows(out)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_stopped_run_goes_on_without_losing_or_doubling_rows(tmp_path, whole, number):
    out = tmp_path / "rows.parquet"
    process = bench_process(out, slowed=True)
    wait_for_rows(out, process)
    process.send_signal(number)
    _, errors = process.communicate(timeout=120)
    some = read_rows(out)
    cells = some[list(Cell._fields)].drop_duplicates()
    assert 1 <= len(cells) < 5, "it was stopped too early or too late to test anything"
    if number == signal.SIGINT:
        assert process.returncode == 130 and "stopped" in errors
    for _, cell in cells.iterrows():  # whole cells only
        same = (whole[list(Cell._fields)] == cell).all(axis=1)
        assert same.sum() == (some[list(Cell._fields)] == cell).all(axis=1).sum()
    process = bench_process(out)
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0 and f"{len(cells)} of 5 cells were already in rows.parquet" in output
    assert_same(whole, read_rows(out))
    assert [path.name for path in tmp_path.iterdir()] == ["rows.parquet"]


@pytest.mark.skipif(sys.platform == "win32", reason="no such limit")
def test_a_full_disk_is_one_sentence(tmp_path):
    import resource

    out = tmp_path / "rows.parquet"

    def little_room():
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    process = bench_process(out, preexec_fn=little_room)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 2
    last = errors.strip().splitlines()[-1]
    assert last.startswith("jink: --out: rows must fit on the disk") and "make room" in last, errors
    assert "Traceback" not in errors
    if out.exists():
        assert len(read_rows(out))
    assert not list(tmp_path.glob("*.part"))


def test_rows_wait_no_longer_than_the_block(tmp_path):
    out = tmp_path / "rows.parquet"
    with pytest.raises(KeyboardInterrupt), RowWriter(out) as writer:
        for name in "abc":
            writer.add(make_rows(Cell("s", name, "e", 1, 1, ""), {}, status="skipped"))
        raise KeyboardInterrupt
    assert list(read_rows(out)["scenario"]) == ["a", "b", "c"]


def test_leftovers_of_dead_processes_go(tmp_path):
    out = tmp_path / "rows.parquet"
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    mine, theirs, other = (tmp_path / f"rows.parquet.{n}.part" for n in (os.getpid(), dead.pid, "x"))
    for path in (mine, theirs, other):
        path.touch()
    remove_leftovers(out)
    assert mine.exists() and other.exists() and not theirs.exists()


# Backends.


def backend_rows(place):
    request = BenchRequest("surge", scenarios=("surge-v0",), estimators=("truth", *QUICK), runs=3)
    jobs = jobs_of("surge", request)
    found = dict(compute_all(rows_of_job, jobs, place, lambda job, reason: reason))
    assert sorted(found) == list(range(len(jobs)))
    return pd.concat([found[index] for index in range(len(jobs))], ignore_index=True)


def test_two_workers_give_the_same_rows():
    assert_same(backend_rows(Place()), backend_rows(Place("local", 2)))


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["dask", "ray"])
def test_clusters_give_the_same_rows(backend):
    pytest.importorskip({"dask": "distributed", "ray": "ray"}[backend])
    assert_same(backend_rows(Place()), backend_rows(Place(backend, 2)))


def kill_once(job):
    """Kills its worker the first time, or every time."""
    marker, number = job
    if number == 2 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 3 and marker.name == "always":
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * number


def gone(job, reason):
    return reason


@pytest.mark.skipif(sys.platform == "win32", reason="no such signal")
def test_a_killed_worker_costs_only_its_cells(tmp_path):
    jobs = [(tmp_path / "once", number) for number in range(6)]
    assert dict(compute_all(kill_once, jobs, Place("local", 2), gone)) == {k: 10 * k for k in range(6)}


@pytest.mark.skipif(sys.platform == "win32", reason="no such signal")
def test_a_cell_that_always_kills_its_worker_is_given_up(tmp_path):
    jobs = [(tmp_path / "always", number) for number in (0, 1, 3, 4)]
    found = dict(compute_all(kill_once, jobs, Place("local", 2), gone))
    assert found[0] == 0 and found[1] == 10 and found[3] == 40
    assert found[2].startswith("its worker died 3 times")


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["dask", "ray"])
def test_a_killed_worker_of_a_cluster_costs_only_its_cells(backend, tmp_path):
    pytest.importorskip({"dask": "distributed", "ray": "ray"}[backend])
    jobs = [(tmp_path / "once", number) for number in range(12)]
    found = list(compute_all(kill_once, jobs, Place(backend, 2), gone))
    assert sorted(found) == [(k, 10 * k) for k in range(12)]
    assert (tmp_path / "once").exists()


def hold(job):
    """Cells that are at work when one of them ends its worker, and how often each was begun."""
    folder, number = job
    begun = folder / f"begun-{number}-{time.monotonic_ns()}"
    begun.touch()
    if number == 0:
        while not list(folder.glob("begun-1-*")):  # another worker is in the middle of its cell
            time.sleep(0.01)
        if not (folder / "once").exists():
            (folder / "once").touch()
            os.kill(os.getpid(), signal.SIGKILL)
    while number == 1 and not (folder / "once").exists():
        time.sleep(0.01)
    if number == 1 and len(list(folder.glob("begun-1-*"))) == 1:
        time.sleep(60.0)  # ended together with the pool
    return 10 * number


@pytest.mark.skipif(sys.platform == "win32", reason="no such signal")
def test_cells_that_go_down_with_the_pool_are_computed_again_once(tmp_path):
    """Two cells in work: the one that ends its worker, and one that loses its worker with it."""
    found = list(compute_all(hold, [(tmp_path, number) for number in range(6)], Place("local", 2), gone))
    assert sorted(found) == [(k, 10 * k) for k in range(6)]  # none lost, none twice
    assert [len(list(tmp_path.glob(f"begun-{number}-*"))) for number in (0, 1)] == [2, 2]


FATAL = """
import os, signal
from pathlib import Path
from jink.estimators.recipes import make_estimator

def make(sensor, acceleration, speed, sojourn):
    once = Path(__file__).with_suffix(".once")
    if not once.exists():
        once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return make_estimator("kf-cv", sensor, acceleration=acceleration, speed=speed, sojourn=sojourn)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no such signal")
@pytest.mark.parametrize("backend", ["local", *(pytest.param(one, marks=pytest.mark.slow) for one in ("dask", "ray"))])
def test_a_file_is_whole_whatever_worker_was_killed(backend, tmp_path):
    """The command itself: a worker is killed in the middle of a cell; the file is as if nothing had happened."""
    if backend != "local":
        pytest.importorskip({"dask": "distributed", "ray": "ray"}[backend])
    (tmp_path / "mine.py").write_text(FATAL)
    names = ("truth", "kf-cv", f"{tmp_path / 'mine.py'}:make", "huber", "bound")
    for name, place in (("killed", ("--backend", backend, "--workers", 2)), ("calm", ())):
        assert run("bench", *words(estimators=names), "--out", tmp_path / f"{name}.parquet", *place) == 0
        assert (tmp_path / "mine.once").exists()
    killed, calm = (read_rows(tmp_path / f"{name}.parquet") for name in ("killed", "calm"))
    assert set(killed["status"]) == {"ok"} and set(killed["estimator"]) == {
        "truth",
        "kf-cv",
        "mine.py:make",
        "huber",
        "bound",
    }
    assert_same(killed, calm)
