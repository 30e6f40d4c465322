"""Scenarios by name, and suites of them."""

from __future__ import annotations

import difflib
from typing import Any

from jink.envs.library.linear_scenarios import LINEAR
from jink.envs.library.manoeuvring_scenarios import MANOEUVRING
from jink.envs.scenario import Scenario

__all__ = ["SCENARIOS", "SUITES", "Scenario", "make_scenario"]

SCENARIOS: dict[str, Scenario] = {scenario.id: scenario for scenario in (*MANOEUVRING, *LINEAR)}
"""Every named scenario."""

SUITES: dict[str, tuple[str, ...]] = {
    suite: tuple(name for name, scenario in SCENARIOS.items() if scenario.suite == suite)
    for suite in dict.fromkeys(scenario.suite for scenario in SCENARIOS.values())
}
"""Names of the scenarios of each suite. Within switch, joint, surge, heavy-tail and model-error all have 300 samples
of a position in the plane."""


def make_scenario(name: str, **overrides: Any) -> Scenario:
    """A named scenario, with parameters replaced.

    Args:
        name: a key of `SCENARIOS`, for instance "surge-v0".
        overrides: parameters by plain or dotted name: ``steps=200, sigma=2.0``, ``**{"surges.0.on": (1.0, 2.0)}``.

    Returns:
        the scenario.

    Raises:
        ValueError: an unknown name, or an override that `Scenario.replace` refuses.
    """
    if name not in SCENARIOS:
        near = difflib.get_close_matches(str(name), SCENARIOS, n=1, cutoff=0.5)
        hint = f"Did you mean {near[0]}?" if near else f"There are {', '.join(SCENARIOS)}."
        raise ValueError(f"make_scenario: name must be a known scenario; got {name!r}. {hint}")
    scenario = SCENARIOS[name]
    return scenario.replace(**overrides) if overrides else scenario
