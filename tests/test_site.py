"""The documentation's site: builds without a warning, holds every page, and its pages are sound in a real browser."""

import functools
import http.server
import importlib
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from browser import find_browser, open_page

from jink.envs.registration import ENVIRONMENTS
from jink.estimators.recipes import RECIPES

pytest.importorskip("mkdocs", reason="needs pip install 'jink[docs]'")
pytest.importorskip("mkdocstrings", reason="needs pip install 'jink[docs]'")
ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
CONFIG = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
SHOWN = ["index.html", "tutorial.html", "families/joint.html", "bench.html", "api/estimators.html"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site; a link that leads nowhere or a page without a place ends the build."""
    out = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--config-file",
        ROOT / "mkdocs.yml",
        "--site-dir",
        out,
    ]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out


def test_every_page_is_in_the_site(site):
    pages = {p.relative_to(DOCS).with_suffix(".html").as_posix() for p in DOCS.rglob("*.md")}
    assert pages <= {p.relative_to(site).as_posix() for p in site.rglob("*.html")}
    assert not list(site.rglob("*.parquet"))


def test_every_family_and_environment_has_a_page():
    pages = [*(DOCS / "families").glob("*.md"), DOCS / "agent.md"]
    families = "\n".join(p.read_text(encoding="utf-8") for p in pages)
    assert not [name for name in RECIPES if f"`{name}`" not in families]
    rest = "\n".join(p.read_text(encoding="utf-8") for p in DOCS.glob("*.md"))
    assert not [name for name in ENVIRONMENTS if f"`{name}`" not in rest]


@pytest.mark.parametrize("page", sorted(p.name for p in (DOCS / "api").glob("*.md")))
def test_the_reference_holds_what_modules_offer(page, site):
    """Every public name of every module on the page, with the first line of its docstring."""
    text = (DOCS / "api" / page).read_text(encoding="utf-8")
    built = (site / "api" / page).with_suffix(".html").read_text(encoding="utf-8")
    modules = re.findall(r"^::: (\S+)$", text, re.M)
    assert modules
    for name in modules:
        module = importlib.import_module(name)
        for public in getattr(module, "__all__", ()):
            thing = getattr(module, public)
            if getattr(thing, "__module__", None) == name and callable(thing):
                assert f'id="{name}.{public}"' in built, f"{name}.{public}"


@functools.cache
def quiet_handler(folder):
    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args):
            pass

    return functools.partial(Handler, directory=str(folder))


@pytest.fixture(scope="module")
def address(site):
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), quiet_handler(site))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.mark.skipif(find_browser() is None, reason="no Chromium here: install chromium")
@pytest.mark.parametrize("width, mobile", [(1280, False), (390, True)])
def test_pages_are_sound_in_a_browser(width, mobile, address, tmp_path):
    with open_page(tmp_path / "profile") as page:
        page.resize(width, 844, mobile)
        for name in SHOWN:
            page.open(f"{address}/{name}", f"location.href.endsWith('{name}') && document.readyState === 'complete'")
            assert page.run("document.documentElement.scrollWidth") <= width, name
            broken = page.run("[...document.images].filter((i) => !i.naturalWidth).map((i) => i.src)")
            assert broken == [], name
        assert page.errors == []
        assert [r for r in page.requests if not r.startswith((address, "data:", "blob:", "about:"))] == []
