"""Estimators of other people: loading a file, completing what it reports, and the contract as a command."""

import re
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from jink.estimators.metrics import summary
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import position
from jink.estimators.status import DIVERGED, MISSING, OK, STARTING
from jink.training.checking import check_estimator
from jink.training.cli import main
from jink.training.loading import is_spec, load_maker, make_named, spec_digest, spec_label
from jink.training.outside import OutsideEstimator, without_unreported

ROOT = Path(__file__).resolve().parent.parent
MINE = f"{ROOT / 'examples' / 'my_estimator.py'}:AlphaBeta"
TIMES = np.arange(0.0, 30.0)
Z = np.stack([10.0 * TIMES, 5.0 * TIMES], axis=1) + np.random.default_rng(0).normal(size=(30, 2))

GOOD = """
import numpy as np

class Follower:
    def __init__(self, gain=0.5):
        self.gain = gain

    def start(self, measurements, times):
        place = np.nan_to_num(measurements[-1])
        return (place, 0 * place, times[-1]), self.said(place, 0 * place)

    def step(self, state, measurement, time):
        place, velocity, before = state
        dt = time - before
        place = place + velocity * dt
        error = np.nan_to_num(measurement - place)
        place = place + self.gain * error
        velocity = velocity + (0.2 * error / dt if dt > 0 else 0.0)
        return (place, velocity, time), self.said(place, velocity)

    def said(self, place, velocity):
        return {"position": place, "velocity": velocity}

make = Follower
"""
BROKEN = {
    "shapes and numbers": "def said(self, place, velocity): return {'position': place[:1]}",
    "values": "def said(self, place, velocity): return {'position': place, 'covariance': np.array([[1, 5], [5, 1]])}",
    "follows": "def said(self, place, velocity): return place[::-1]",
    "inputs untouched": """
        def step(self, state, measurement, time):
            following = super().step(state, measurement, time)
            measurement *= 2
            return following
        """,
    "determinism": "def said(self, place, velocity): return place + np.random.normal(size=2)",
    "neighbours": """
        past = 0.0
        def start(self, measurements, times):
            self.past = 1e-3 * (self.past + measurements[-1, 0])
            (place, velocity, time), _ = super().start(measurements, times)
            return (place, velocity + self.past, time), place
        """,
    "batch equals singles": """
        def run(self, measurements, times):
            z = np.nan_to_num(measurements)
            return z - 1e-3 * z.mean(axis=0)
        """,
    "padding": """
        def run(self, measurements, times):
            z = np.nan_to_num(measurements)
            return z + 1e-6 * z[:, -1:]
        """,
    "causality": """
        def run(self, measurements, times):
            z = np.nan_to_num(measurements)
            return (z + np.roll(z, -1, axis=1)) / 2
        """,
    "prior": """
        def start(self, measurements, times, prior):
            (place, velocity, time), said = super().start(measurements, times)
            if prior is not None:
                place = prior[0][2:] / prior[0][2:]
            return (place, velocity, time), self.said(place, velocity)
        """,
    "missing data": """
        def step(self, state, measurement, time):
            if np.isnan(measurement).any():
                raise RuntimeError("no measurement")
            return super().step(state, measurement, time)
        """,
    "times": """
        def step(self, state, measurement, time):
            place, velocity, before = state
            velocity = (np.nan_to_num(measurement) - place) / (time - before)
            return (np.nan_to_num(measurement), velocity, time), {"position": place, "velocity": velocity}
        """,
    "outliers": """
        def step(self, state, measurement, time):
            if np.nanmax(np.abs(np.append(measurement, 0))) > 1e8:
                raise OverflowError
            return super().step(state, measurement, time)
        """,
    "run equals steps": """
        def run(self, measurements, times):
            return np.nan_to_num(measurements)
        """,
    "state is a value": """
        def start(self, measurements, times):
            (place, velocity, time), said = super().start(measurements, times)
            return [place, velocity, time], said
        def step(self, state, measurement, time):
            following, said = super().step(state, measurement, time)
            state[:] = following
            return state, said
        """,
}
"""The check that must fail -> what is done wrong."""


def write(folder, text, name="mine.py"):
    (folder / name).write_text(textwrap.dedent(text), encoding="utf-8")
    return f"{folder / name}:make"


def broken(folder, how):
    body = textwrap.indent(textwrap.dedent(how), "    ")
    return write(folder, GOOD + f"\nclass Broken(Follower):\n{body}\n\nmake = Broken\n")


# --- the contract


@pytest.mark.parametrize("sensor, axes", [("position", 2), ("position", 3)])
def test_a_good_estimator_passes(sensor, axes):
    report = check_estimator(MINE, sensor, axes)
    assert report.ok and not report.of("skipped"), report.of("failed")


@pytest.mark.parametrize("name", ["kf-cv", "imm"])
def test_our_own_pass(name):
    assert check_estimator(name).ok, check_estimator(name).of("failed")


@pytest.mark.parametrize("sensor", ["range-bearing", "range-bearing-elevation", "range-bearing-rate"])
def test_our_own_pass_behind_a_radar(sensor):
    assert check_estimator("kf-cv", sensor).ok, check_estimator("kf-cv", sensor).of("failed")


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_found_and_a_remedy_named(name, tmp_path):
    report = check_estimator(broken(tmp_path, BROKEN[name]))
    failed = {finding.name: finding for finding in report.of("failed")}
    assert name in failed, [(f.name, f.found) for f in report.findings]
    assert len(failed[name].found) > 10 and len(failed[name].remedy) > 10


def test_each_check_is_broken_once():
    from jink.training.contract.checks import CHECKS

    assert set(BROKEN) == set(CHECKS)


def test_what_was_right_still_passes(tmp_path):
    """A check that fails on everything would pass the test above."""
    report = check_estimator(write(tmp_path, GOOD))
    assert report.ok, report.of("failed")


def test_the_command_says_what_failed_and_how_to_mend_it(tmp_path, capsys):
    assert main(["check", write(tmp_path, GOOD)]) == 0
    assert "16 passed, 0 failed, 0 skipped" in capsys.readouterr().out
    assert main(["check", broken(tmp_path, BROKEN["causality"])]) == 1
    out = capsys.readouterr().out
    assert re.search(r"^causality: .*later measurements", out, re.M) and "to mend it: Estimate row t" in out


def test_one_cause_is_told_once_and_with_its_own_remedy(tmp_path, capsys):
    spec = write(tmp_path, "class make:\n def start(self, z): pass\n def step(self, state): pass")
    assert main(["check", spec]) == 1
    out = " ".join(capsys.readouterr().out.split())
    assert out.count("to mend it:") == 1 and "Name them as these are: measurements, times" in out
    assert "Do without the exception" not in out and "np." not in out


def test_numbers_are_told_as_numbers(tmp_path):
    failed = {f.name: f for f in check_estimator(broken(tmp_path, BROKEN["causality"])).of("failed")}
    assert re.search(r"position\[.*\]: -?[0-9.]+ against -?[0-9.]+", failed["causality"].found)


@pytest.mark.parametrize("where", ["def make():\n    raise SystemExit(3)", "def make(measurements):\n    exit(3)"])
def test_who_exits_ends_neither_check_nor_bench(where, tmp_path, capsys):
    spec = write(tmp_path, where)
    assert main(["check", spec]) == 1
    assert "SystemExit: 3" in capsys.readouterr().out
    few = ["--suite", "surge", "--scenario", "surge-25-bursts-v0", "--estimator", "raw", "--runs", "2"]
    assert main(["bench", *few, "--estimator", spec]) == 1
    out = capsys.readouterr().out
    assert "SystemExit: 3" in " ".join(out.split()) and "raw" in out


def test_who_looks_ahead_gets_no_row(tmp_path, capsys):
    spec = broken(tmp_path, BROKEN["causality"])
    few = ["--suite", "surge", "--scenario", "surge-25-bursts-v0", "--runs", "2"]
    assert main(["bench", *few, "--estimator", "raw", "--estimator", spec]) == 1
    assert "later measurements change" in " ".join(capsys.readouterr().out.split())


# --- loading


def test_specs_are_told_from_names():
    assert is_spec("mine.py:make") and is_spec("package.module:make") and not is_spec("imm")
    assert spec_label("a/b/mine.py:make") == "mine.py:make"


def test_parameters_get_the_scales_they_name(tmp_path):
    spec = write(
        tmp_path,
        """
        def make(sensor, acceleration, scales, sojourn, other=7):
            assert sensor.axes == 2 and acceleration == 3.0 and scales.speed == 20.0 and sojourn == 10.0 and other == 7
            return lambda measurements: measurements
        """,
    )
    assert make_named(spec, position(2), acceleration=3.0, speed=20.0).run(Z, TIMES).position.shape == (1, 30, 2)


def test_a_function_of_measurements_is_itself_the_estimator(tmp_path):
    spec = write(tmp_path, "def make(measurements, times): return measurements + times[:, None]")
    np.testing.assert_array_equal(make_named(spec, position(2)).run(Z, TIMES).position[0], Z + TIMES[:, None])


def test_a_bank_is_used_as_it_is(tmp_path):
    spec = write(
        tmp_path,
        """
        from jink.estimators.recipes import RECIPES
        def make(sensor, scales):
            return RECIPES["kf-cv"](sensor, scales)
        """,
    )
    ours = make_estimator("kf-cv", position(2), acceleration=3.0).run(Z, TIMES)
    theirs = make_named(spec, position(2), acceleration=3.0)
    assert theirs.name == "mine.py:make"
    np.testing.assert_array_equal(theirs.run(Z, TIMES).position, ours.position)


def test_neighbours_of_the_file_can_be_imported(tmp_path):
    (tmp_path / "a_helper_of_mine.py").write_text("OFFSET = 2.0\n", encoding="utf-8")
    spec = write(tmp_path, "import a_helper_of_mine as h\ndef make(measurements): return measurements + h.OFFSET")
    np.testing.assert_array_equal(make_named(spec, position(2)).run(Z, TIMES).position[0], Z + 2.0)


def test_a_changed_file_is_another_one(tmp_path):
    spec = write(tmp_path, "def make(measurements): return measurements")
    first = spec_digest(spec)
    assert make_named(spec, position(2)).run(Z, TIMES).position[0, 3, 0] == Z[3, 0]
    write(tmp_path, "def make(measurements): return 2 * measurements")
    assert spec_digest(spec) != first
    assert make_named(spec, position(2)).run(Z, TIMES).position[0, 3, 0] == 2 * Z[3, 0]


WRONG = {
    "no file": ("nowhere.py:make", "file must exist"),
    "no module": ("no_such_package:make", "must be installed"),
    "another file": ("some/mine.txt:make", "must end in .py"),
    "no colon": ("mine.py", "FILE.py:NAME"),
    "no name": ("mine.py:", "FILE.py:NAME"),
}


@pytest.mark.parametrize("given, said", WRONG.values(), ids=WRONG)
def test_wrong_specs(given, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=said):
        load_maker(given)


FILES = {
    "syntax": ("def make(:", r"must be Python; got mine.py, line 1"),
    "import": ("import no_such_package_of_mine", "ModuleNotFoundError.*line 1"),
    "exit": ("raise SystemExit(3)", "SystemExit: 3"),
    "nothing there": ("def other(): pass", "There are other"),
    "not callable": ("make = 3", "must be a class or function"),
    "raises": ("def make():\n    return 1 / 0", r"ZeroDivisionError: division by zero \(mine.py, line 2\)"),
    "unknown parameter": ("def make(gain): pass", "got gain"),
    "positional": ("def make(sensor, /): pass", "positional-only"),
    "nothing returned": ("def make(): pass", "got NoneType"),
}


@pytest.mark.parametrize("text, said", FILES.values(), ids=FILES)
def test_wrong_files(text, said, tmp_path):
    with pytest.raises(ValueError, match=said):
        make_named(write(tmp_path, text), position(2))


RUNS = {
    "shape": ("def make(measurements): return measurements[:5]", "position must have shape"),
    "words": ("def make(measurements): return 'abc'", "must be numbers"),
    "unknown field": ("def make(measurements): return {'position': measurements, 'place': 1}", "got place"),
    "no position": ("def make(measurements): return {'velocity': measurements}", "must hold a position"),
    "status": ("def make(measurements): return {'position': measurements, 'status': [9] * 30}", "status must be"),
    "no pair": ("class make:\n def start(self): return 3\n def step(self, state): return 3", "must return"),
    "foreign name": ("class make:\n def start(self, z): pass\n def step(self): pass", "got z, which cannot be"),
}


@pytest.mark.parametrize("text, said", RUNS.values(), ids=RUNS)
def test_wrong_results(text, said, tmp_path):
    with pytest.raises(ValueError, match=said):
        make_named(write(tmp_path, text), position(2)).run(Z, TIMES)


# --- what is completed


def test_nothing_is_made_of_what_is_not_reported():
    estimator = OutsideEstimator(lambda measurements: measurements, position(2), "raw")
    e = estimator.run(Z, TIMES)
    assert np.isnan(e.velocity).all() and np.isnan(e.covariance).all() and not e.nis_dof.any()
    truth = np.zeros((1, 30, 2))
    scores = without_unreported(summary(e, truth, truth), e)
    assert np.isnan([scores["position_nees"], scores["nees"], scores["velocity_rmse_m_s"], scores["nis_per_dof"]]).all()
    assert scores["position_rmse_m"] > 0


def test_a_position_that_is_lost_is_held_and_marked():
    def track(measurements):
        out = measurements.copy()
        out[10:12] = np.nan
        return out

    e = OutsideEstimator(track, position(2), "lossy").run(Z, TIMES)
    np.testing.assert_array_equal(e.position[0, 10:12], Z[[9, 9]])
    np.testing.assert_array_equal(e.status[0, 9:13], [OK, DIVERGED, DIVERGED, OK])


def test_rows_before_the_start_and_gaps_are_marked():
    z = Z.copy()
    z[:3] = z[7] = np.nan
    e = make_named(MINE, position(2)).run(z, TIMES)
    np.testing.assert_array_equal(e.status[0, :9], [STARTING] * 3 + [OK] * 4 + [MISSING] + [OK])
    np.testing.assert_array_equal(e.position[0, :3], e.position[0, [3, 3, 3]])


def test_a_start_may_ask_for_more_rows(tmp_path):
    spec = write(
        tmp_path,
        """
        class make:
            def start(self, measurements, times):
                if len(times) >= 3:
                    return len(times), measurements[-1]
            def step(self, state, measurement):
                return state + 1, measurement
        """,
    )
    estimator = make_named(spec, position(2))
    e = estimator.run(Z, TIMES)
    np.testing.assert_array_equal(e.status[0, :4], [STARTING, STARTING, OK, OK])
    np.testing.assert_array_equal(e.position[0], np.concatenate([Z[[2, 2]], Z[2:]]))
    assert estimator.start(Z[:3], TIMES[:3]) == 3
    with pytest.raises(ValueError, match="rows must suffice"):
        estimator.start(Z[:2], TIMES[:2])


def test_a_covariance_of_the_position_alone_is_scored():
    def track(measurements):
        return {"position": measurements, "covariance": np.tile(np.eye(2), (len(measurements), 1, 1))}

    truth = np.stack([10.0 * TIMES, 5.0 * TIMES], axis=1)
    e = OutsideEstimator(track, position(2), "raw").run(Z, TIMES)
    scores = without_unreported(summary(e, truth[None]), e)
    assert scores["position_nees"] == pytest.approx(np.mean(np.sum((Z - truth) ** 2, axis=1)))


def test_refusals_are_those_of_our_own(tmp_path):
    estimator = make_named(MINE, position(2))
    with pytest.raises(ValueError, match="measurements must have shape"):
        estimator.run(np.zeros((3, 5)), np.arange(3.0))
    with pytest.raises(ValueError, match="times must not decrease"):
        estimator.run(Z, TIMES[::-1])


def test_the_benchmark_gives_a_prior_and_reads_forecasts(tmp_path):
    from jink.envs.scenarios import make_scenario
    from jink.estimators.inputs import Prior
    from jink.training.third_party import load_estimator

    spec = write(
        tmp_path,
        """
        def make(sensor, acceleration, speed):
            def track(measurements, prior):
                mean, cov = prior
                assert speed != 10.0 and cov.shape == (4, 4)
                return {"position": measurements + mean[:2], "velocity": 0 * measurements + mean[2:]}
            return track
        """,
    )
    estimator = load_estimator(spec, make_scenario("surge-25-bursts-v0"))
    prior = Prior(np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]]), np.eye(4))
    found = estimator.run(np.stack([Z, Z]), TIMES, prior=prior)
    np.testing.assert_array_equal(found.position[1], Z + np.array([5.0, 6.0]))
    ahead, _ = estimator.forecast_run(np.stack([Z, Z]), TIMES, 2.0, prior=prior)
    np.testing.assert_array_equal(ahead[1], Z + np.array([5.0, 6.0]) + 2.0 * np.array([7.0, 8.0]))


# --- on the command line


@pytest.fixture
def radar(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    columns = {"track": "a", "t": TIMES, "x": Z[:, 0], "y": Z[:, 1], "true_x": 10 * TIMES, "true_y": 5 * TIMES}
    pd.DataFrame(columns).to_csv("radar.csv", index=False)
    return "radar.csv"


def test_track_takes_a_file(radar, capsys):
    assert main(["track", radar, "--estimator", MINE, "--out", "out.csv", "--plot", "out.png"]) == 0
    out = capsys.readouterr().out
    assert "my_estimator.py:AlphaBeta: 30 ok" in out and "inf" not in out and "nan" not in out
    written = pd.read_csv("out.csv")
    np.testing.assert_allclose(written["x"], make_named(MINE, position(2)).run(Z, TIMES).position[0, :, 0])


@pytest.mark.parametrize("option", [["--smooth"], ["--forecast", "2"]])
def test_track_names_what_the_estimator_lacks(option, radar, capsys):
    assert main(["track", radar, "--estimator", MINE, *option]) == 2
    assert f"{option[0]}: estimator must have {option[0][2:]}" in capsys.readouterr().err


def test_play_takes_a_file(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pygame", reason="needs pip install 'jink[render]'")
    monkeypatch.chdir(tmp_path)
    arguments = ["play", "ManoeuvringTarget-v0", "--policy", MINE, "--seed", "1", "--steps", "20", "--out", "a.png"]
    assert main(arguments) == 0
    assert "policy " in capsys.readouterr().out
    assert main(["play", "AdaptiveFactor-v0", "--policy", MINE, "--seed", "1", "--out", "a.png"]) == 2
    assert "an estimator" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["check"], "one thing must be named"),
        (["check", MINE, "--env", "CartPole-v1"], "got both"),
        (["check", "nobody"], "must be one of"),
        (["check", MINE, "--sensor", "sonar"], "--sensor: name must be"),
        (["check", MINE, "--axes", "4"], "--axes: value must be 2 or 3"),
        (["check", MINE, "--sensor", "range-bearing", "--axes", "2"], "--axes: option must be left out"),
        (["check", MINE, "--seed", "-1"], "--seed: value must be >= 0"),
    ],
)
def test_check_refuses(arguments, said, capsys):
    assert main(arguments) == 2
    assert said in capsys.readouterr().err
