"""Parameters by name: any value inside nested frozen dataclasses can be replaced by a dotted or a plain name."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from jink.estimators.sensor import Sensor

__all__ = ["override", "parameters"]

T = TypeVar("T")
Fit = Callable[[Any, str, Any], Any]
_MEANT = {"sigma": "sensing.sensor.sigma"}  # biases have a sigma too
_OF_SENSORS = ("sigma", "params")  # the rest of a sensor is its kind


def _children(node: Any) -> dict[str, Any]:
    """What of a value can be replaced: fields of a dataclass, entries of a tuple of dataclasses or of a mapping."""
    if dataclasses.is_dataclass(node) and not isinstance(node, type):
        names = [entry.name for entry in dataclasses.fields(node) if entry.init]
        return {name: getattr(node, name) for name in names if name in _OF_SENSORS or not isinstance(node, Sensor)}
    if isinstance(node, tuple) and any(dataclasses.is_dataclass(item) for item in node):
        return {str(index): item for index, item in enumerate(node)}
    return dict(node) if isinstance(node, Mapping) else {}


def _paths(node: Any, prefix: str = "") -> dict[str, Any]:
    """Every path and its value, inner nodes included."""
    found: dict[str, Any] = {}
    for name, value in _children(node).items():
        found[prefix + name] = value
        found.update(_paths(value, f"{prefix}{name}."))
    return found


def parameters(thing: Any) -> dict[str, Any]:
    """Every single parameter by its dotted name; what a row of results should carry. Parts are named by their kind."""
    named: dict[str, Any] = {}
    for path, value in _paths(thing).items():
        if isinstance(value, Sensor):
            named[path] = value.name
        elif dataclasses.is_dataclass(value):
            named[path] = type(value).__name__
        elif not _children(value):
            named[path] = value
    return named


def override(thing: T, changes: Mapping[str, Any], caller: str, fit: Fit) -> T:
    """A copy with parameters replaced; everything is validated again.

    Args:
        thing: a frozen dataclass.
        changes: new values by dotted name (``surges.0.on``) or by the last part of one (``steps``), where only one
            place has it; ``sigma`` always means the sensor's.
        caller: name for messages.
        fit: ``fit(parent, field, value)`` gives the value as the field wants it.

    Returns:
        the copy.

    Raises:
        ValueError: an unknown or an ambiguous name, one given twice, or a value out of range.
    """
    paths = list(_paths(thing))
    tree: dict[str, Any] = {}
    for name, value in changes.items():
        parts = _resolve(name, paths, caller).split(".")
        branch = tree
        for part in parts[:-1]:
            branch = branch.setdefault(part, {})
        leaf = branch.setdefault(parts[-1], {})
        if "" in leaf:
            raise ValueError(f"{caller}: {'.'.join(parts)} must be given once; got it as {name!r} too. Remove one.")
        leaf[""] = value
    changed: T = _apply(thing, tree, fit)
    return changed


def _resolve(name: str, paths: list[str], caller: str) -> str:
    if name in paths:
        return name
    matches = [path for path in paths if path.endswith(f".{name}")]
    if _MEANT.get(name) in matches:
        return _MEANT[name]
    if len(matches) > 1:
        raise ValueError(
            f"{caller}: {name} must name one parameter; got several: {', '.join(matches)}. Write the whole name."
        )
    if matches:
        return matches[0]
    plain = sorted({path.rpartition(".")[2] for path in paths if not path.rpartition(".")[2].isdigit()})
    near = difflib.get_close_matches(name, [*plain, *paths], n=1)
    hint = f"Did you mean {near[0]}? " if near else ""
    raise ValueError(f"{caller}: {name} must be a parameter; got no such name. {hint}There are {', '.join(plain)}.")


def _apply(node: Any, tree: Mapping[str, Any], fit: Fit) -> Any:
    if "" in tree:
        node = tree[""]
    deeper = {name: sub for name, sub in tree.items() if name}
    if not deeper:
        return node
    children = _children(node)
    values = {
        name: _apply(children.get(name), {**sub, "": fit(node, name, sub[""])} if "" in sub else sub, fit)
        for name, sub in deeper.items()
    }
    if isinstance(node, tuple):
        return tuple(values.get(str(index), item) for index, item in enumerate(node))
    if isinstance(node, Mapping):
        return {**node, **values}
    return dataclasses.replace(node, **values)
