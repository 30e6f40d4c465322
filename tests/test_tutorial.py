"""Documents as their readers use them: blocks run in order, in an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
ELSEWHERE = {
    "adaptive_factor.md": "test_pages.py",
    "environments.md": "test_pages.py",
    "intents.md": "test_intents_page.py",
    "manoeuvring_target.md": "test_pages.py",
    "multi_target.md": "test_track_many.py",
    "scenarios.md": "test_pages.py",
}
"""Pages whose blocks another file runs."""


def blocks_of(page):
    return re.findall(r"^```(python|bash)\n(.*?)^```$", (DOCS / page).read_text(encoding="utf-8"), re.S | re.M)


EVERY = sorted(page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md"))
PAGES = [page for page in EVERY if blocks_of(page) and page not in ELSEWHERE]


def run_shell(body):
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    command = ["bash", "-euo", "pipefail", "-c", body]
    done = subprocess.run(command, env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{body}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.parametrize("page", PAGES)
def test_blocks_run_in_order(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    names = {"__name__": "__main__"}
    blocks = blocks_of(page)
    assert blocks
    for number, (kind, body) in enumerate(blocks):
        if kind == "python":
            exec(compile(body, f"{page}, block {number}", "exec"), names)
        else:
            run_shell(body)
    if page == "tutorial.md":
        said = capsys.readouterr().out
        begin, end = map(float, re.search(r"surging from ([\d.]+) to ([\d.]+) s", said).groups())
        assert 78.0 <= begin <= 82.0 and 88.0 <= end <= 93.0, "it finds the burst"
        assert {"imm.png", "joint.png", "report.html", "rows.parquet"} <= {p.name for p in tmp_path.iterdir()}
        errors = {name: float(value) for name, value in re.findall(r"^([\w.:-]+): ([\d.]+) m", said, re.M)}
        assert errors["oracle"] < errors["joint-imm"] < errors["imm"] and "mine.py:Fading" in errors


@pytest.mark.parametrize("page", ELSEWHERE)
def test_the_others_are_run_elsewhere(page):
    assert page in (ROOT / "tests" / ELSEWHERE[page]).read_text(encoding="utf-8")


@pytest.mark.parametrize("script", ["my_estimator", "my_scenario", "stone_soup_tracker"])
def test_examples_run(script, tmp_path):
    if script == "stone_soup_tracker":
        pytest.importorskip("stonesoup", reason="needs pip install 'jink[peers]'")
    path = ROOT / "examples" / f"{script}.py"
    done = subprocess.run([sys.executable, path], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
