"""Pages on environments and scenarios: tables are those of the registries, code runs, pictures are there."""

import importlib.util
import re
import struct
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = ("environments.md", "manoeuvring_target.md", "adaptive_factor.md", "scenarios.md")


def load_script():
    path = ROOT / "benchmarks" / "update_environment_pages.py"
    spec = importlib.util.spec_from_file_location("update_environment_pages", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tables_are_those_of_the_registries():
    found = load_script().blocks()
    assert {page for page, _ in found} == set(PAGES)
    for (page, marker), block in found.items():
        text = (DOCS / page).read_text(encoding="utf-8")
        wanted = f"<!-- {marker}:start -->\n{block}<!-- {marker}:end -->"
        assert wanted in text, f"{page}, {marker}: run python benchmarks/update_environment_pages.py"


@pytest.mark.parametrize("environment", ["jink/ManoeuvringTarget-v0", "jink/AdaptiveFactor-v0"])
def test_environment_pages_have_the_headings_of_gymnasium(environment):
    text = load_script().task_page(environment)
    headings = re.findall(r"^## (.*)$", text, re.M)
    wanted = [
        "Description",
        "Action Space",
        "Observation Space",
        "Rewards",
        "Starting State",
        "Episode End",
        "Arguments",
        "Version History",
    ]
    assert set(wanted) <= {heading.replace("Episode Termination", "Episode End") for heading in headings}
    assert "Args:" not in text
    assert re.search(r"^\|---", text, re.M), "the observation is a table"


@pytest.mark.parametrize("page", PAGES)
def test_code_runs(page, tmp_path, monkeypatch):
    """All blocks of a page are one script."""
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```python\n(.*?)^```$", (DOCS / page).read_text(encoding="utf-8"), re.S | re.M)
    assert blocks
    names = {}
    for number, block in enumerate(blocks):
        exec(compile(block, f"{page}, block {number}", "exec"), names)


def test_pictures_are_those_of_the_script():
    script = load_script()
    shown = {name for page in PAGES for name in re.findall(r"\(pictures/([^)]+)\)", (DOCS / page).read_text())}
    assert shown == {file for file, *_ in script.PICTURES}
    for name in shown:
        head = (DOCS / "pictures" / name).read_bytes()[:24]
        assert head[:8] == b"\x89PNG\r\n\x1a\n"
        assert struct.unpack(">II", head[16:24]) == (960, 640)


def test_put_replaces_what_is_between_the_markers():
    put = load_script().put
    page = "a\n<!-- x:start -->\nold \\1\n<!-- x:end -->\nb\n"
    assert put(page, "x", "new \\g<0>\n") == "a\n<!-- x:start -->\nnew \\g<0>\n<!-- x:end -->\nb\n"
    with pytest.raises(ValueError, match="put: page must hold"):
        put(page, "y", "")
