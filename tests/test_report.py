"""The HTML report: made from rows alone, complete without a network, looked at in a real browser."""

import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import find_browser, open_page

from jink.training.cli import main
from jink.training.ladder.pairing import compare
from jink.training.report.page import make_page
from jink.training.report.scenes import collect
from jink.training.report.tables import digits, interval
from jink.training.rows import COLUMNS, read_rows

RESULTS = Path(__file__).resolve().parent.parent / "docs" / "results"
NASTY = "</script><img src=x onerror=alert(1)>&\"'"
READY = "document.documentElement.dataset.ready === 'true'"


def one_row(**changes):
    """A row of a cell that a third party's estimator might leave."""
    blank = {name: "" if kind == "string" else 0 for name, kind in COLUMNS.items()}
    numbers = dict.fromkeys(("value", "low", "high", "published", "published_low", "published_high"), float("nan"))
    made = {
        "suite": "surge",
        "scenario": "mine-v0",
        "estimator": "mine.py:make",
        "kind": "number",
        "runs": 3,
        "seed": 5,
    }
    told = {"parameters": "{}", "versions": "{}", "machine": "{}", "started": "2026-01-01T00:00:00Z", "status": "ok"}
    return blank | numbers | {"at": None, "samples": None} | made | told | changes


def frame(*rows):
    return pd.DataFrame(rows)[list(COLUMNS)].astype(COLUMNS)


@pytest.fixture(scope="module")
def rows():
    shown = ("surge-v0", "joint-v0", "b2-atc-turns-v0")
    parts = [read_rows(RESULTS / f"{name}.parquet") for name in ("surge", "joint", "published")]
    ladders = [part[part["scenario"].isin(shown)] for part in parts]
    strange = frame(
        one_row(metric="position_rmse", value=3.0, unit="m", statistic="rms", samples=np.array([3.0, 3.0, 3.0]),
                estimator=NASTY, command=f"jink bench --estimator '{NASTY}'"),
        one_row(status="error", reason=NASTY, estimator="broken.py:make"),
    )  # fmt: skip
    return pd.concat([*ladders, strange], ignore_index=True)


@pytest.fixture(scope="module")
def page(rows):
    return make_page(rows, source="rows.parquet")


@pytest.fixture(scope="module")
def path(page, tmp_path_factory):
    file = tmp_path_factory.mktemp("report") / "report.html"
    file.write_text(page, encoding="utf-8")
    return file


# --- from rows


def test_numbers_are_those_of_the_rows(rows):
    scenes, _ = collect(rows)
    found = {(s.suite, s.scenario, r.estimator): r for s in scenes for r in s.rungs}
    for one in compare(rows, "position_rmse"):
        rung = found[one.suite, one.scenario, one.estimator]
        assert rung.values["position_rmse"] == (one.value.value, one.value.low, one.value.high)
        if one.difference is not None:
            low, high = one.difference.low, one.difference.high
            wanted = "better" if high < 0 else "worse" if low > 0 else "level"
            assert rung.verdict == (wanted if np.isfinite([low, high]).all() else "")
    assert {rung.verdict for rung in found.values()} >= {"better", "worse", "level"}, "losses are shown too"


def test_every_number_has_its_command(rows, page):
    commands = {unescape(text) for text in re.findall(r'data-copy="([^"]*)"', page)}
    single = {line for text in commands for line in text.split("\n")}
    numbers = rows[(rows["kind"] == "number") & (rows["metric"] != "")]
    assert set(numbers["command"]) <= single


def test_the_later_of_two_versions_of_a_cell_counts(rows):
    old = one_row(metric="position_rmse", statistic="rms", unit="m", value=1.0, samples=np.full(3, 1.0))
    new = old | {"value": 2.0, "samples": np.full(3, 2.0), "started": "2026-02-01T00:00:00Z", "commit": "b"}
    (scene,), _ = collect(frame(new, old))
    assert scene.rungs[0].values["position_rmse"][0] == 2.0
    assert [number.value for number in scene.rungs[0].numbers] == [2.0]
    assert "2 versions of the sources" in make_page(frame(new, old))
    assert "versions of the sources" not in make_page(frame(new))


def test_failures_are_listed(rows, page):
    _, failures = collect(rows)
    wanted = rows[rows["status"] != "ok"].drop_duplicates(["suite", "scenario", "estimator", "runs", "seed"])
    assert len(failures) == len(wanted) > 0
    assert {f.status for f in failures} >= {"error", "diverged"}
    assert "None: no cell" in make_page(frame(one_row(metric="m", value=1.0)))


def test_curves_and_playback_are_those_of_the_rows(rows):
    scenes, _ = collect(rows)
    scene = next(s for s in scenes if s.suite == "joint")
    mine = rows[(rows["suite"] == "joint") & (rows["scenario"] == scene.scenario) & (rows["estimator"] == "imm")]
    curve = mine[mine["metric"] == "error_over_time"].iloc[0]
    np.testing.assert_allclose(scene.curves["error_over_time"]["lines"]["imm"][1], curve["samples"], rtol=1e-3)
    series = {name: mine[mine["metric"] == name].iloc[0]["samples"] for name in ("x", "y", "cov_x_y")}
    played = scene.play["estimators"]["imm"]
    np.testing.assert_allclose(played["place"], [series["x"], series["y"]], rtol=1e-5)
    np.testing.assert_allclose(played["cov"][1], series["cov_x_y"], rtol=1e-3, atol=1e-9)
    true = np.array(scene.play["true"], dtype=float)
    error = np.linalg.norm(np.array([series["x"], series["y"]]) - true, axis=0)
    np.testing.assert_allclose(played["error"], error, rtol=1e-2, atol=1e-3)


def test_rows_without_runs_still_make_a_page():
    page = make_page(frame(one_row(metric="gospa", value=2.5, low=2.0, high=3.0, unit="m")))
    assert "2.5" in page and "gospa" in page


def test_numbers_are_written_as_one_reads_them():
    assert [digits(v) for v in (3.14159, -0.5, 123456.7, float("inf"))] == ["3.142", "−0.5", "123,457", "∞"]
    assert interval(None).shown == interval((float("nan"),) * 3).shown == "–"
    assert re.sub("<.*?>", "", interval((1.0, 0.5, 2.0), signed=True).shown) == "+1 [+0.5, +2]"
    assert interval((0.25, 0.2, 0.3), band=False, share=True).shown == "25 %"


# --- the page by itself


class Reader(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.open = [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))


def read(page):
    reader = Reader()
    reader.feed(page)
    return reader.tags


def test_nothing_is_fetched_from_anywhere(page):
    for tag, attributes in read(page):
        for name in ("src", "href", "srcset", "data", "action"):
            value = attributes.get(name)
            assert value is None or value.startswith(("#", "data:")), f"{tag} {name}={value}"
    assert "default-src 'none'" in page
    assert page.count("plotly.js v") <= 2, "plotly is in it once"


def test_strange_names_stay_text(page):
    assert "<img" not in page.partition("plotly.js v")[0]
    tags = {tag for tag, _ in read(page)}
    assert "img" not in tags


def test_it_can_be_read_without_sight(page):
    tags = read(page)
    assert ("html", {"lang": "en"}) in tags
    assert sum(tag == "caption" for tag, _ in tags) == sum(tag == "table" for tag, _ in tags) > 3
    assert all("scope" in attributes for tag, attributes in tags if tag == "th")
    assert all(a.get("aria-label") for tag, a in tags if tag == "div" and a.get("role") == "img")
    labelled = {a["for"] for tag, a in tags if tag == "label"}
    assert {a["id"] for tag, a in tags if tag in ("select", "input")} <= labelled


def luminance(colour):
    parts = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


def contrast(a, b):
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", [0, 1])
def test_contrast_is_enough_in_both_themes(theme):
    from jink.training.report.page import _own

    blocks = re.findall(r"{([^{}]*--bg:[^{}]*)}", _own("report.css"))
    assert len(blocks) == 3 and blocks[1].split() == blocks[2].split(), "chosen and preferred dark are the same"
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", blocks[theme]))
    for name in ("text", "quiet", "link", "better", "worse"):
        for ground in ("bg", "panel"):
            assert contrast(colours[name], colours[ground]) >= 4.5, (name, ground)
    # Lines and markers of the plots: 3 is what graphics need.
    pairs = re.findall(r'\["(#[0-9a-fA-F]{6})", "(#[0-9a-fA-F]{6})"', _own("report.js"))
    assert len(pairs) >= 15
    for pair in pairs:
        assert contrast(pair[theme], colours["bg"]) >= 3.0, pair


# --- the command


def test_the_command_makes_the_page(tmp_path, capsys):
    out = tmp_path / "r.html"
    assert main(["report", str(RESULTS / "joint.parquet"), "--out", str(out), "--title", "Mine & yours"]) == 0
    assert "Mine &amp; yours" in out.read_text(encoding="utf-8")
    assert "wrote" in capsys.readouterr().out


def test_bench_makes_the_page_of_its_rows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    few = ["--suite", "surge", "--scenario", "surge-25-bursts-v0", "--estimator", "kf-cv", "--estimator", "raw"]
    assert main(["bench", *few, "--runs", "3", "--out", "rows.parquet", "--report", "r.html"]) == 0
    assert "wrote r.html" in capsys.readouterr().out
    page = Path("r.html").read_text(encoding="utf-8")
    value = read_rows(Path("rows.parquet")).query("estimator == 'kf-cv' and metric == 'position_rmse'")["value"].iloc[0]
    assert digits(value) in page and "surge-25-bursts-v0" in page
    assert main(["bench", *few, "--report", "r.pdf"]) == 2
    assert "--report: file must end in .html" in capsys.readouterr().err


def test_suites_are_summed_up(rows):
    from jink.training.ladder.pairing import compare_suites
    from jink.training.report.overview import overview

    again = rows[rows["suite"] == "joint"].assign(scenario="another-v0")
    both = pd.concat([rows[rows["suite"] == "joint"], again], ignore_index=True)
    text = re.sub("<[^>]*>", " ", overview(both, collect(both)[0]))
    for one in compare_suites(both):
        if one.estimator != "imm":
            low, high = digits(one.ratio.low), digits(one.ratio.high)
            assert re.search(rf"{re.escape(one.estimator)} +{digits(one.ratio.value)} +\[{low}, {high}\]", text)
    assert overview(rows, collect(rows)[0]) == "" or "Suite joint" not in overview(rows, collect(rows)[0])


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["nowhere.parquet"], "file must exist"),
        (["rows.parquet", "--out", "r.pdf"], "must end in .html"),
        (["notes.parquet"], "must be Parquet rows"),
        (["empty.parquet"], "rows must not be empty"),
        (["."], "got the folder ."),
        (["parameters.parquet"], "parameters that are not JSON: '{'"),
        (["samples.parquet"], "2 samples of 3 runs"),
        (["text.parquet"], "must hold numbers where they belong"),
        (["rows.parquet", "--out", "no/where/r.html"], "existing folder"),
    ],
)
def test_the_command_refuses(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    frame(one_row(metric="m", value=1.0)).to_parquet("rows.parquet")
    frame(one_row()).iloc[:0].to_parquet("empty.parquet")
    Path("notes.parquet").write_text("notes", encoding="utf-8")
    frame(one_row(metric="m", value=1.0, parameters="{")).to_parquet("parameters.parquet")
    frame(one_row(metric="m", value=1.0, samples=np.full(2, 1.0))).to_parquet("samples.parquet")
    frame(one_row(metric="m", value=1.0)).astype({"value": str}).assign(value="a").to_parquet("text.parquet")
    assert main(["report", *arguments]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("*.part"))


# --- in a browser

needs_browser = pytest.mark.skipif(find_browser() is None, reason="no Chromium here: install chromium")
SIZES = {"desktop": (1280, 900, False), "phone": (390, 844, True)}


@needs_browser
@pytest.mark.parametrize("size", SIZES)
def test_it_works_in_a_browser(size, path, tmp_path):
    with open_page(tmp_path / "profile") as page:
        width, height, mobile = SIZES[size]
        page.resize(width, height, mobile)
        page.open(path, READY)
        assert page.run("document.documentElement.scrollWidth") <= width, "nothing sticks out sideways"
        heads = page.run("[...document.querySelectorAll('section:not([hidden]) tbody th')].map((h) => h.offsetHeight)")
        assert max(heads) < 90, "names of estimators are not broken letter by letter"
        links = page.run("[...document.querySelectorAll('nav a')].map((a) => [a.offsetHeight, a.getAttribute('href')])")
        assert len(links) == 6 and min(height for height, _ in links) > 20, "sections can be reached"
        reached = "(a) => document.querySelector(a.hash).getClientRects().length"
        targets = page.run(f"[...document.querySelectorAll('nav a')].map({reached})")
        assert all(targets), "no link leads to a scenario that is not shown"
        frames = "[...document.querySelectorAll('section:not([hidden]) .scroll')]"
        tall = page.run(f"{frames}.map((f) => f.scrollHeight - f.clientHeight)")
        assert not mobile or max(tall) <= 1, "nothing scrolls up and down inside the page"
        page.wait("document.querySelectorAll('.plot svg.main-svg').length > 8")
        assert page.run("document.getElementById('scene').selectedOptions[0].text").startswith("joint")
        look(page)
        sort(page)
        play(page)
        for scheme in ("dark", "light"):
            page.prefer(scheme)
            page.run("document.getElementById('theme').click()")
        for index in range(page.run("document.getElementById('scene').options.length")):
            page.run(f"choose = document.getElementById('scene'), choose.value = {index}")
            page.run("choose.dispatchEvent(new Event('change'))")
            shown = page.run("[...document.querySelectorAll('[data-scene]')].filter((s) => !s.hidden).length")
            assert shown == 1
            assert page.run("document.documentElement.scrollWidth") <= width
        assert page.errors == []
        outside = [r for r in page.requests if not r.startswith(("file:", "data:", "blob:", "about:"))]
        assert outside == []


def look(page):
    """What is drawn is what the rows say."""
    drawn = page.run(
        "Object.fromEntries(document.getElementById('ladder').data.flatMap((t) => t.y.map((n, i) => [n, t.x[i]])))"
    )
    told = page.run(
        "JSON.parse(document.getElementById('scene-' + document.getElementById('scene').value).textContent)"
    )
    wanted = {r["name"]: r["values"]["position_rmse"][0] for r in told["rungs"] if "position_rmse" in r["values"]}
    assert drawn == wanted and len(drawn) > 10
    page.run("m = document.getElementById('metric'), m.selectedIndex = 1, m.dispatchEvent(new Event('change'))")
    page.wait("document.getElementById('ladder').layout.xaxis.title.text.startsWith(m.selectedOptions[0].text)")


def sort(page):
    table = "[...document.querySelectorAll('section:not([hidden]) table')][0]"
    page.run(f"{table}.querySelectorAll('button.sort')[1].click()")
    for sign in (1, -1):
        found = page.run(f"[...{table}.tBodies[0].rows].map((r) => r.children[1].dataset.v)")
        values = [float(v) for v in found if v]
        assert values == sorted(values, reverse=sign < 0) and len(values) > 10
        assert "" not in found[: len(values)], "what was not measured comes last"
        page.run(f"{table}.querySelectorAll('button.sort')[1].click()")


def play(page):
    before = page.run("document.getElementById('now').textContent")
    page.run("t = document.getElementById('time'), t.value = 100, t.dispatchEvent(new Event('input'))")
    assert page.run("document.getElementById('now').textContent") != before
    at = "document.getElementById('map').data.at(-1).x[0]"
    assert page.run(at) == page.run(f"{played()}.true[0][100]")
    page.run("document.getElementById('play').click()")
    page.wait("Number(document.getElementById('time').value) > 103")
    page.run("document.getElementById('play').click()")
    assert page.run("document.getElementById('play').textContent") == "Play"
    page.run("document.querySelector('section:not([hidden]) .copy').click()")
    page.wait("document.getElementById('said').textContent === 'Command copied'")


def played():
    return "JSON.parse(document.getElementById('scene-' + document.getElementById('scene').value).textContent).play"


@needs_browser
def test_the_browser_test_sees_errors_and_requests(tmp_path):
    """What the test above rests on: a script that fails, a picture from outside."""
    bad = tmp_path / "bad.html"
    bad.write_text("<img src='http://example.invalid/a.png'><script>nobody.is.there()</script>", encoding="utf-8")
    with open_page(tmp_path / "profile") as page:
        page.open(bad)
        assert any("nobody" in text for text in page.errors)
        assert "http://example.invalid/a.png" in page.requests


@needs_browser
def test_it_is_readable_without_script(path, tmp_path):
    with open_page(tmp_path / "profile") as page:
        page.call("Emulation.setScriptExecutionDisabled", value=True)
        page.open(path)
        assert not page.run("document.documentElement.classList.contains('js')")
        sections = "[...document.querySelectorAll('section[data-scene]')]"
        assert page.run(f"{sections}.every((s) => s.offsetHeight > 50 && s.querySelector('table'))")
        assert "joint-imm" in page.run("document.body.innerText")


def test_metrics_whose_runs_were_not_kept_are_shown_all_the_same():
    kept = one_row(metric="position_rmse", statistic="rms", unit="m", value=2.0, samples=np.full(3, 2.0))
    bare = one_row(metric="nees", statistic="mean", value=4.5, low=4.0, high=5.0)
    (scene,), _ = collect(frame(kept, bare))
    assert scene.rungs[0].values["nees"] == (4.5, 4.0, 5.0)
