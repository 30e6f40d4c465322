"""`jink list`: what there is, one line each."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape

from jink.training.summary import plain_table

__all__ = ["SUITES", "print_catalogue"]

SUITES = {
    "published": "scenarios with published results, ours beside them",
    "recorded": "recorded tracks in a folder: errors where there is truth, predictions elsewhere",
}


def print_catalogue(console: Console) -> None:
    """Print estimators, motions, sensors, scenarios and suites."""
    from jink.envs.published import SCENARIOS
    from jink.estimators.motions import MOTIONS
    from jink.estimators.recipes import RECIPES
    from jink.estimators.sensors import SENSORS

    _print_section(console, "estimators", {name: _first_line(make) for name, make in RECIPES.items()})
    _print_section(console, "motions", {name: _first_line(make) for name, make in MOTIONS.items()})
    _print_section(console, "sensors", {name: _first_line(make) for name, make in SENSORS.items()})
    _print_section(console, "scenarios", {name: scenario.title for name, scenario in SCENARIOS.items()})
    _print_section(console, "suites", SUITES)


def _print_section(console: Console, title: str, lines: Mapping[str, str]) -> None:
    table = plain_table(title, "what it is", words=2)
    for name, line in lines.items():
        table.add_row(name, escape(line))
    console.print(table)


def _first_line(thing: Any) -> str:
    return (inspect.getdoc(thing) or "").partition("\n")[0]
