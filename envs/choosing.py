"""What the keywords of `gymnasium.make` mean: which task, which scenario, suite or recording, which parameters."""

from __future__ import annotations

import dataclasses
import difflib
import importlib
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from jink.envs.episodes import Source
from jink.envs.registration import TASKS
from jink.envs.rollout import TaskFactory

__all__ = ["Chosen", "choose_source", "choose_task"]


class Chosen(NamedTuple):
    """A task with its own options bound, and what is left of the keywords: parameters of the scenario."""

    make: TaskFactory
    scenario: str
    options: tuple[str, ...]
    parameters: dict[str, Any]


def choose_task(task: str | TaskFactory, options: dict[str, Any]) -> Chosen:
    """The task by name, and which of the options are its own.

    Args:
        task: a key of `TASKS`, or a function ``(source, count, **options) -> Task``.
        options: keywords of ``make``: the task's own by the names in its signature, the scenario's otherwise.

    Returns:
        the choice.

    Raises:
        ValueError: an unknown name.
    """
    factory: Callable[..., Any]
    if isinstance(task, str):
        if task not in TASKS:
            raise ValueError(f"make: task must be one of {', '.join(TASKS)}; got {task!r}. Or give a function.")
        place, scenario = TASKS[task]
        module, _, name = place.partition(":")
        factory = getattr(importlib.import_module(module), name)
    else:
        factory, scenario = task, next(iter(TASKS.values()))[1]
    names = list(inspect.signature(factory).parameters.values())[2:]
    own = tuple(name.name for name in names if name.kind in (name.KEYWORD_ONLY, name.POSITIONAL_OR_KEYWORD))
    if "max_episode_steps" in options:
        raise ValueError(
            "make_vec: max_episode_steps must be left out, episodes end with their last sample; got "
            f"{options['max_episode_steps']}. Use steps, which is one more."
        )
    bound = {name: value for name, value in options.items() if name in own}
    rest = {name: value for name, value in options.items() if name not in own}
    return Chosen(partial(factory, **bound), scenario, own, rest)


def choose_source(chosen: Chosen, *, scenario: Any, suite: str | None, tracks: Any) -> Source:
    """Where the episodes come from.

    Args:
        chosen: the task, with the parameters meant for the source.
        scenario: a name, a source itself, or None.
        suite: a name or None: each episode draws one of its scenarios.
        tracks: a file or `Tracks`, or None.

    Returns:
        a scenario, a mixture of them, or recorded tracks.

    Raises:
        ValueError: an unknown name or parameter, or choices that contradict each other.
    """
    if tracks is not None:
        both = "scenario" if scenario is not None else "suite" if suite is not None else ""
        if both:
            raise ValueError(f"make: tracks must come without {both}; got both. Choose recorded or simulated targets.")
        from jink.envs.recorded_source import RecordedSource

        known = [entry.name for entry in dataclasses.fields(RecordedSource) if entry.init and entry.name != "tracks"]
        _check_names(chosen, known)
        return _built("tracks", RecordedSource, tracks, chosen)
    if scenario is not None and not isinstance(scenario, str):
        if suite is not None:
            raise ValueError("make: suite must come without a Scenario object; got both. Choose one of them.")
        if not hasattr(scenario, "simulate"):
            raise ValueError(f"make: scenario must be a name or a Scenario; got {scenario!r}. See `jink list`.")
        if chosen.parameters and not hasattr(scenario, "replace"):
            raise ValueError(
                f"make: options must be those of the task ({', '.join(chosen.options) or 'none'}); "
                f"got {', '.join(sorted(chosen.parameters))}. The source given has no parameters to replace."
            )
        given: Source = scenario.replace(**chosen.parameters) if chosen.parameters else scenario
        return given
    from jink.envs.mixture import Mixture
    from jink.envs.scenarios import SUITES, make_scenario

    if suite is not None:
        if suite not in SUITES:
            raise ValueError(f"make: suite must be one of {', '.join(SUITES)}; got {suite!r}. See `jink list`.")
        if scenario is None:
            parts = [_member(suite, name, chosen) for name in SUITES[suite]]
            return parts[0] if len(parts) == 1 else Mixture(suite, tuple(parts))
        if scenario not in SUITES[suite]:
            raise ValueError(
                f"make: scenario must be one of suite {suite} ({', '.join(SUITES[suite])}); got {scenario!r}. "
                "Leave one of the two out."
            )
    return _built("scenario", make_scenario, chosen.scenario if scenario is None else scenario, chosen)


def _check_names(chosen: Chosen, known: list[str]) -> None:
    """Refuse options that neither recorded tracks nor the task have."""
    names = [*known, *(name for name in chosen.options if name not in known)]
    for name in chosen.parameters:
        if name not in known:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f"Did you mean {near[0]}? " if near else ""
            raise ValueError(
                f"make: option {name} must be a known one with tracks; got no such name. "
                f"{hint}There are {', '.join(names)}."
            )


def _member(suite: str, name: str, chosen: Chosen) -> Source:
    """One scenario of a suite; what it refuses is told with its name."""
    from jink.envs.scenarios import make_scenario

    try:
        source: Source = _built("suite", make_scenario, name, chosen)
    except ValueError as error:
        if str(error).startswith((f"{name}:", "make:")):
            raise
        raise ValueError(
            f"make: options must suit every scenario of suite {suite}; got a refusal from {name}: {error}"
        ) from None
    return source


def _built(what: str, build: Any, name: Any, chosen: Chosen) -> Any:
    """The source with its parameters; a parameter nobody knows is answered with what the task would have taken."""
    for name_given in chosen.parameters:
        near = difflib.get_close_matches(name_given, chosen.options, n=1, cutoff=0.75)
        if near and near[0] != name_given:
            raise ValueError(
                f"make: option {name_given} must be a known one; got no such name. Did you mean {near[0]}?"
            )
    try:
        return build(name, **chosen.parameters)
    except TypeError as error:
        if not chosen.parameters:
            raise
        raise ValueError(
            f"make: options must have values that {what} can use; got "
            f"{', '.join(f'{key}={value!r}' for key, value in sorted(chosen.parameters.items()))} ({error}). "
            "Correct the value of one."
        ) from None
