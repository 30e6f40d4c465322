"""The package as a whole: import direction, installation, versions, README, words that must not appear."""

import ast
import importlib
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LAYERS = ("estimators", "intent", "envs", "training")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SOURCES = sorted(path for layer in LAYERS for path in (ROOT / layer).rglob("*.py"))
# Distributions whose import name is not their own name.
IMPORT_NAMES = {
    "sb3_contrib": "sb3-contrib",
    "stable_baselines3": "stable-baselines3",
    "pygame": "pygame-ce",
    "llvmlite": "numba",
    "PIL": "pillow",
    "imageio_ffmpeg": "imageio-ffmpeg",
}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("jink", *(part for part in parts if part != "__init__")))


def imported(tree: ast.AST, name: str, is_package: bool) -> Iterator[str]:
    """Full names a module imports, wherever in it, relative ones resolved."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = node.level - is_package
                parents = name.split(".")[: len(name.split(".")) - above]
                base = ".".join([*parents, *([base] if base else [])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def upward_imports(source: str, name: str, is_package: bool = False) -> set[str]:
    """Imports of a layer above the module's own, and of a layer by its bare folder name."""
    own = LAYERS.index(name.split(".")[1])
    wrong = set()
    for target in imported(ast.parse(source), name, is_package):
        parts = target.split(".")
        if parts[0] in LAYERS or (
            parts[0] == "jink" and len(parts) > 1 and parts[1] in LAYERS and LAYERS.index(parts[1]) > own
        ):
            wrong.add(target)
    return wrong


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_imports_go_one_way(path):
    wrong = upward_imports(path.read_text(encoding="utf-8"), module_name(path), path.name == "__init__.py")
    assert not wrong, f"{sorted(wrong)} go against estimators <- intent <- envs <- training"


@pytest.mark.parametrize(
    "source",
    [
        "import jink.envs.targets",
        "from jink.intent import laws",
        "from jink import training",
        "from ..envs import targets",
        "def f():\n    import jink.training.cli",
        "import envs",
    ],
)
def test_the_import_rule_sees_every_form(source):
    assert upward_imports(source, "jink.estimators.bank")


def test_the_import_rule_allows_downward_and_sideways():
    source = "from . import laws\nfrom ..estimators import bank\nimport jink.intent.laws, numpy"
    assert not upward_imports(source, "jink.intent.learner")


def declared() -> set[str]:
    """Distributions the package asks for, always or in an extra that a user installs."""
    needs = list(PROJECT["dependencies"])
    for extra, more in PROJECT["optional-dependencies"].items():
        if extra not in ("test", "dev", "all"):
            needs += more
    return {re.match(r"[\w.-]+", need).group().lower() for need in needs} | {"jink"}


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_third_party_imports_are_declared(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names = {name.split(".")[0] for name in imported(tree, module_name(path), path.name == "__init__.py")}
    assert "pickle" not in names, "files are JSON, safetensors or Parquet, never pickle"
    third_party = names - set(sys.stdlib_module_names)
    undeclared = {name for name in third_party if IMPORT_NAMES.get(name, name).lower() not in declared()}
    assert not undeclared, f"pyproject.toml does not ask for {sorted(undeclared)}"


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_every_module_imports(path):
    extras = {"torch", "stable_baselines3", "tensorboard", "pygame", "dask", "distributed", "ray"}
    try:
        importlib.import_module(module_name(path))
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in extras:
            raise
        pytest.skip(f"needs the extra with {error.name}")


@pytest.mark.parametrize("layer", LAYERS)
def test_installed_files_are_those_of_the_tree(layer):
    """A stale installation would test old code; a subpackage missing from pyproject.toml would not ship."""
    here, there = ROOT / layer, Path(importlib.import_module(f"jink.{layer}").__path__[0])
    wanted, found = (
        {path.relative_to(top) for path in top.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
        for top in (here, there)
    )
    assert {Path("__init__.py"), Path("py.typed")} <= wanted
    stale = {name for name in wanted & found if (there / name).read_bytes() != (here / name).read_bytes()}
    wrong = sorted(map(str, stale | (wanted ^ found)))
    assert not wrong, f"remove build/ and install again, or list the subpackage: {wrong}"


def test_jink_is_a_namespace_without_a_folder():
    assert importlib.import_module("jink").__file__ is None
    assert not (ROOT / "jink").exists()


def test_versions_agree():
    citation = re.search(r"^version: *(\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    changelog = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    found = {citation.group(1), changelog.group(1), importlib.metadata.version("jink")}
    assert found == {PROJECT["version"]}


def tracked() -> list[Path]:
    """Files that git has or would add; every file outside hidden and built folders where there is no git."""
    git = shutil.which("git")
    if git and (ROOT / ".git").exists():
        listing = [git, "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        done = subprocess.run(listing, capture_output=True, check=False, text=True)
        if done.returncode == 0:
            return [ROOT / name for name in done.stdout.split("\0") if name and (ROOT / name).is_file()]
    left_out = re.compile(r"^(\.(?!ci$|github$)|build$|dist$|__pycache__$|.*\.egg-info$)")
    files = (path for path in ROOT.rglob("*") if path.is_file())
    return [path for path in files if not any(map(left_out.match, path.relative_to(ROOT).parts[:-1]))]


# Written in pieces, so that this file does not refuse itself.
FORBIDDEN = re.compile(
    "|".join(
        [
            r"(?<![\w.~$}/-])/(?:work|root|home|t" + r"mp|Users)(?=/|\b)",
            "py" + r"pi\.org",
            "python" + r"hosted\.",
            "find" + "-links",
            r"\b(?:clau" + "de|anth" + "ropic|open" + r"ai)\b",
            r"\bissues (?:sh" + "ow|li" + r"st)\b",
        ]
    ),
    re.IGNORECASE,
)


def test_nothing_names_a_machine_or_a_workplace():
    files = tracked()
    assert ROOT / "pyproject.toml" in files
    found = []
    for path in files:
        content = path.read_bytes()
        if b"\0" in content:
            continue
        for number, line in enumerate(content.decode("utf-8").splitlines(), start=1):
            found += [f"{path.relative_to(ROOT)}:{number}: {hit.group()}" for hit in FORBIDDEN.finditer(line)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("line", ["cd /wo" + "rk/main", "open('/t" + "mp/x')", "see py" + "pi.org/x"])
def test_the_forbidden_words_are_seen(line):
    assert FORBIDDEN.search(line)


@pytest.mark.parametrize("line", ["../shared/data", "a root/leaf", "tmp_path / 'x'"])
def test_innocent_lines_pass(line):
    assert not FORBIDDEN.search(line)


def readme() -> str:
    return (ROOT / "README.md").read_text(encoding="utf-8")


def between(text: str, marker: str) -> str:
    found = re.search(rf"<!-- {marker}:start -->\n(.*?)<!-- {marker}:end -->", text, re.S)
    assert found, f"README.md must hold <!-- {marker}:start --> and <!-- {marker}:end -->"
    return found.group(1)


def test_readme_holds_what_ci_runs():
    text = readme()
    between(text, "results")
    for marker in ("bench", "test"):
        block = between(text, marker)
        assert re.fullmatch(r"```bash\n[^\n]+\n```\n", block), f"{marker}: one command in one block"
        assert "-c constraints.txt" in block


def test_links_lead_somewhere():
    broken = []
    for page in [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if "://" not in target and not (page.parent / target).exists():
                broken.append(f"{page.relative_to(ROOT)}: {target}")
    assert not broken, "\n".join(broken)


def test_readme_blocks_run_in_order(tmp_path):
    """All Python blocks are one script; then the shell blocks run in the same folder."""
    text = readme()
    for marker in ("bench", "test"):  # these build environments: .ci/run runs the second as written
        text = text.replace(between(text, marker), "")
    blocks = re.findall(r"^```(python|bash)\n(.*?)^```$", text, re.S | re.M)
    assert {kind for kind, _ in blocks} == {"python", "bash"}
    script = "\n".join(body for kind, body in blocks if kind == "python")
    shell = "\n".join(body for kind, body in blocks if kind == "bash")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = {**os.environ, "PATH": path}
    for command in ([sys.executable, "-c", script], ["bash", "-euo", "pipefail", "-c", shell]):
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"
    assert (tmp_path / "track.png").stat().st_size > 0
