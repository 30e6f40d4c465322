"""Write the tables and pictures of the pages on environments and scenarios.

    python benchmarks/update_environment_pages.py [--pictures]

Tables stand between markers in docs/*.md and come from the registries and docstrings; a test compares them.
"""

import importlib
import inspect
import re
import sys
from dataclasses import MISSING, fields
from pathlib import Path

from jink.envs.intents import INTENTS
from jink.envs.registration import ENVIRONMENTS, TASKS
from jink.envs.sampling import SAMPLINGS
from jink.envs.scenarios import SCENARIOS, SUITES
from jink.envs.scene_library import SCENES
from jink.envs.surges import SURGES

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PICTURES = (
    ("manoeuvring_target.png", "ManoeuvringTarget-v0", "joint-glint-v0", "imm", 5, None),
    ("manoeuvring_target_3d.png", "ManoeuvringTarget-v0", "air-radar-v0", "imm", 3, None),
    ("adaptive_factor.png", "AdaptiveFactor-v0", "joint-bursts-v0", "random", 12, None),
)
"""File, environment, scenario, policy, seed, decisions."""


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows]) + "\n"


def first_line(thing):
    return inspect.getdoc(thing).partition("\n")[0].rstrip(".").replace("|", r"\|")


def shown(value):
    """A default as it would be written."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return "(" + ", ".join(map(shown, value)) + ")"
    if hasattr(value, "mean"):
        return f"{value.mean:g} s mean"
    return str(value)


def parameters(kind, left_out=()):
    """Fields of a dataclass with their defaults."""
    found = []
    for entry in fields(kind):
        if entry.name in left_out or not entry.init:
            continue
        default = entry.default if entry.default is not MISSING else None
        if default is None and entry.default_factory is not MISSING:
            default = entry.default_factory()
        unit = entry.metadata.get("unit", "")
        unit = f" {unit}" if unit and not unit.startswith("(") else ""
        found.append(f"`{entry.name}`" + ("" if default is None else f" {shown(default)}{unit}"))
    return ", ".join(found)


def scenario_rows():
    for suite, names in SUITES.items():
        for number, name in enumerate(names):
            scenario = SCENARIOS[name]
            space = f"{scenario.axes}-D, {scenario.sensor.name}"
            sampling = f"{scenario.steps}, {scenario.sampling.dt:g} s"
            yield suite if number == 0 else "", f"`{name}`", scenario.title, space, sampling


def task_class(environment):
    place, _ = TASKS[ENVIRONMENTS[environment]["task"]]
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def task_page(environment):
    """What the task's docstring says under Gymnasium's headings."""
    text = inspect.getdoc(task_class(environment))
    return text.partition("\nArgs:")[0].strip() + "\n"


def environment_rows():
    for name, options in ENVIRONMENTS.items():
        page = options["task"].replace("-", "_")
        kind = "continuous: the log inflation" if options.get("continuous") else first_line(task_class(name))
        yield f"[`{name}`]({page}.md)", kind, f"`{TASKS[options['task']][1]}`"


def blocks():
    """Page and marker -> text between the markers."""
    return {
        ("environments.md", "environments"): table(("id", "task", "default scenario"), environment_rows()),
        ("environments.md", "scenarios"): table(
            ("suite", "scenario", "what happens", "space, sensor", "samples, every"), scenario_rows()
        ),
        ("manoeuvring_target.md", "task"): task_page("jink/ManoeuvringTarget-v0"),
        ("adaptive_factor.md", "task"): task_page("jink/AdaptiveFactor-v0"),
        ("scenarios.md", "intents"): table(
            ("intent", "what it does", "parameters and defaults"),
            ((f"`{name}`", first_line(kind), parameters(kind, ("name",))) for name, kind in INTENTS.items()),
        ),
        ("scenarios.md", "surges"): table(
            ("kind", "class", "what it does", "parameters and defaults"),
            ((f"`{name}`", f"`{kind.__name__}`", first_line(kind), parameters(kind)) for name, kind in SURGES.items()),
        ),
        ("scenarios.md", "samplings"): table(
            ("kind", "class", "what it does", "parameters and defaults"),
            (
                (f"`{name}`", f"`{kind.__name__}`", first_line(kind), parameters(kind))
                for name, kind in SAMPLINGS.items()
            ),
        ),
        ("scenarios.md", "scenes"): table(
            ("scene", "what happens", "targets", "sensors", "duration"),
            (
                (f"`{name}`", scene.title, str(len(scene.targets)), str(len(scene.sensors)), f"{scene.duration:g} s")
                for name, scene in SCENES.items()
            ),
        ),
    }


def put(text, marker, block):
    """The page with a block between its markers."""
    pattern = rf"(<!-- {marker}:start -->\n).*?(<!-- {marker}:end -->)"
    if not re.search(pattern, text, re.S):
        raise ValueError(f"put: page must hold <!-- {marker}:start --> and its end; got none. Add them.")
    return re.sub(pattern, lambda found: found[1] + block + found[2], text, flags=re.S)


def draw():
    from jink.training.play import PlayRequest, play

    for file, *options in PICTURES:
        env, scenario, policy, seed, steps = options
        played = play(PlayRequest(env, scenario, policy, seed, DOCS / "pictures" / file, steps))
        print(f"wrote {played.out.relative_to(ROOT)}")


if __name__ == "__main__":
    for (page, marker), block in blocks().items():
        path = DOCS / page
        path.write_text(put(path.read_text(encoding="utf-8"), marker, block), encoding="utf-8")
    print(f"wrote tables of {', '.join(sorted({page for page, _ in blocks()}))}")
    if "--pictures" in sys.argv[1:]:
        draw()
