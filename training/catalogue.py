"""`jink list`: what there is, one line each."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape

from jink.training.summary import plain_table

__all__ = ["SUITES", "print_catalogue"]

SUITES = {
    "switch": "targets that change their mind: the ladder from raw measurement to bound",
    "surge": "noise surges: the ladder",
    "joint": "both at once: the ladder",
    "heavy-tail": "heavy-tailed noise: the ladder",
    "model-error": "a plant that its model does not describe: the ladder",
    "published": "scenarios with published results, ours beside them",
    "recorded": "recorded tracks in a folder: errors where there is truth, predictions elsewhere",
    "multi-target": "scenes of many targets in clutter: GOSPA, misses, false tracks, identity switches, time",
    "all": "all of these; recorded where --data is given",
}


def print_catalogue(console: Console) -> None:
    """Print every registry: estimators, learned models, motions, sensors, environments, scenarios, suites."""
    from jink.envs.intents import INTENTS
    from jink.envs.published import SCENARIOS as PUBLISHED
    from jink.envs.registration import ENVIRONMENTS
    from jink.envs.scenarios import SCENARIOS
    from jink.envs.scenarios import SUITES as MIXES
    from jink.envs.scene_library import SCENES
    from jink.envs.surges import SURGES
    from jink.estimators.agent.policy_file import pretrained_policies
    from jink.estimators.factors import FACTORS
    from jink.estimators.motions import MOTIONS
    from jink.estimators.recipes import RECIPES
    from jink.estimators.sensors import SENSORS
    from jink.intent.pretrained import pretrained_names
    from jink.training.many_estimators import MANY

    _print_section(console, "estimators", {name: _first_line(make) for name, make in RECIPES.items()})
    _print_section(console, "learned models", {name: _model(name) for name in pretrained_names()})
    _print_section(console, "learned policies", {name: _policy(name) for name in pretrained_policies()})
    _print_section(console, "estimators of many targets", {name: _first_line(make) for name, make in MANY.items()})
    _print_section(console, "motions", {name: _first_line(make) for name, make in MOTIONS.items()})
    _print_section(console, "sensors", {name: _first_line(make) for name, make in SENSORS.items()})
    _print_section(console, "environments", {name: _environment(options) for name, options in ENVIRONMENTS.items()})
    _print_section(console, "intents", {name: _first_line(kind) for name, kind in INTENTS.items()})
    _print_section(console, "surges", {name: _first_line(kind) for name, kind in SURGES.items()})
    simulated = {name: f"{scenario.title} ({scenario.suite})" for name, scenario in SCENARIOS.items()}
    _print_section(console, "scenarios", simulated)
    _print_section(console, "scenes", {name: scene.title for name, scene in SCENES.items()})
    _print_section(console, "suites of environments", {name: ", ".join(members) for name, members in MIXES.items()})
    factors = {name: _first_line(factor.function.function) for name, factor in FACTORS.items()}
    _print_section(console, "factors", factors)
    _print_section(console, "bench: published", {name: scenario.title for name, scenario in PUBLISHED.items()})
    _print_section(console, "bench: suites", SUITES)


def _print_section(console: Console, title: str, lines: Mapping[str, str]) -> None:
    table = plain_table(title, "what it is", words=2)
    for name, line in lines.items():
        table.add_row(name, escape(line))
    console.print(table)


def _model(name: str) -> str:
    """Its intents and where they were learned."""
    from jink.intent.pretrained import load_pretrained

    model = load_pretrained(name)
    tracks = model.about.get("tracks")
    source = tracks.get("source") if isinstance(tracks, dict) else "unknown tracks"
    return f"{', '.join(intent.name for intent in model.intents)} ({model.axes} axes, from {source})"


def _policy(name: str) -> str:
    """What it chooses and where it was learned."""
    from jink.estimators.agent.policy_file import find_policy

    policy = find_policy(name)
    config = policy.about.get("config")
    config = config if isinstance(config, dict) else {}
    chooses = f"one of {', '.join(policy.factors)}" if policy.factors else "an inflation of R"
    return f"{chooses} (learned on {config.get('scenario') or config.get('suite') or 'unknown scenarios'})"


def _environment(options: Mapping[str, Any]) -> str:
    """What an agent does there: the first line of the task's page."""
    from jink.envs.registration import TASKS

    module, _, name = TASKS[options["task"]][0].partition(":")
    line = _first_line(getattr(importlib.import_module(module), name))
    return f"{line} (the inflation itself is the action)" if options.get("continuous") else line


def _first_line(thing: Any) -> str:
    return (inspect.getdoc(thing) or "").partition("\n")[0]
