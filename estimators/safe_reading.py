"""Reading files that a stranger may have made: plain files of a bounded size, JSON without surprises, bare tensors."""

from __future__ import annotations

import json
import math
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load

__all__ = ["check_names", "parse_json", "parse_tensors", "read_bytes", "refuse"]

# A string that does not end takes the rest with it, so that no text makes the search slow.
_BRACKETS = re.compile(r'"(?:[^"\\]|\\.)*+"?|[\[\]{}]', re.DOTALL)
_STEP = {"[": 1, "{": 1, "]": -1, "}": -1}
_TEXT = 2000
_LENGTH = 8
_NAMES = 32
_INTEGER = 2**63


def refuse(file: str, rule: str, value: object, remedy: str) -> NoReturn:
    """Raise the one sentence that all refusals of model files share."""
    raise ValueError(f"load_model: {file} must {rule}; got {value}. {remedy}")


def read_bytes(path: Path, limit: int) -> bytes:
    """The content of a regular file, never more than ``limit`` bytes of it in memory.

    Args:
        path: not a link: what it names may change between a look and the next, or lie outside the folder.
        limit: bytes.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a link, a folder, a device, or a file that is too large.
    """
    try:
        # O_NONBLOCK: opening a named pipe would otherwise wait for a writer for ever.
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        if path.is_symlink():
            refuse(path.name, "be a plain file", "a link", "Copy the file itself into the folder.")
        descriptor = os.open(path, flags)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"load_model: {path.name} must lie in the folder of the model; got none in {path.parent}. "
            "Name a folder that `jink train intents` or save_model wrote."
        ) from None
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode):
        os.close(descriptor)
        refuse(path.name, "be a plain file", "something else", "Copy the file itself into the folder.")
    with os.fdopen(descriptor, "rb") as file:
        content = file.read(limit + 1) if found.st_size <= limit else b""
    size = max(found.st_size, len(content))
    if size > limit:
        refuse(path.name, f"be at most {limit} bytes", f"{size}", "Models are small: this is none.")
    return content


def parse_json(content: bytes, name: str, depth: int) -> dict[str, Any]:
    """An object of JSON: UTF-8, every key once, finite numbers, printable text, nesting of at most ``depth``.

    Args:
        content: of the file.
        name: of the file, for messages.
        depth: of nested lists and objects.

    Raises:
        ValueError: anything else.
    """
    remedy = "Save the model again."
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        refuse(name, "be JSON text in UTF-8", str(error), remedy)
    _check_depth(text, name, depth)
    try:
        value = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    except (json.JSONDecodeError, _FoundError) as error:
        refuse(name, "be JSON text in UTF-8", str(error), remedy)
    except ValueError:  # an integer of thousands of digits
        refuse(name, "hold numbers of a sensible length", "an integer of thousands of digits", remedy)
    if not isinstance(value, dict):
        refuse(name, "be one JSON object", f"a {type(value).__name__}", remedy)
    _check_values(value, name)
    return value


def parse_tensors(content: bytes, name: str, wanted: Mapping[str, tuple[int, ...]]) -> dict[str, NDArray[np.float64]]:
    """Tensors of a safetensors file: exactly the wanted names and shapes, float64, finite.

    Args:
        content: of the file.
        name: of the file, for messages.
        wanted: shape by name of tensor.

    Raises:
        ValueError: anything else.
    """
    remedy = "Save the model again."
    if len(content) < _LENGTH:
        refuse(name, f"begin with {_LENGTH} bytes of length", f"{len(content)} bytes in all", remedy)
    length = int.from_bytes(content[:_LENGTH], "little")
    if length > len(content) - _LENGTH:
        refuse(name, f"be safetensors, with a header inside its {len(content)} bytes", f"one of {length} bytes", remedy)
    header = parse_json(content[_LENGTH : _LENGTH + length], name, 4)
    check_names(header, wanted, name, "tensors")
    for key, shape in wanted.items():
        entry = header[key]
        if not isinstance(entry, dict) or set(entry) != {"dtype", "shape", "data_offsets"}:
            refuse(name, f"describe {key} by dtype, shape and data_offsets", _short(entry), remedy)
        if entry["dtype"] != "F64":
            refuse(name, f"hold {key} as float64 (F64)", _short(entry["dtype"]), remedy)
        if entry["shape"] != list(shape):
            refuse(name, f"hold {key} with shape {list(shape)}", _short(entry["shape"]), remedy)
    try:
        tensors = {key: np.array(value) for key, value in load(content).items()}
    except SafetensorError as error:
        refuse(name, "be a complete safetensors file", str(error), remedy)
    for key, value in tensors.items():
        if not np.isfinite(value).all():
            bad = value[~np.isfinite(value)][0]
            refuse(name, f"hold finite numbers in {key}", f"{bad}", "Train again: a model with such weights is none.")
    return tensors


class _FoundError(ValueError):
    """Something in the text that JSON allows and we do not."""


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object; of two equal keys one would win silently."""
    found = dict(pairs)
    if len(found) != len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise _FoundError(f"the key {_short(twice)} twice")
    return found


def _no_constant(name: str) -> NoReturn:
    raise _FoundError(f"the number {name}")


def _check_depth(text: str, name: str, limit: int) -> None:
    """Before the parser sees it, which calls itself for every level."""
    depth = 0
    for found in _BRACKETS.finditer(text):
        depth += _STEP.get(found.group(), 0)
        if depth > limit:
            refuse(name, f"nest lists and objects at most {limit} deep", "more", "Save the model again.")


def _check_values(value: Any, name: str) -> None:
    """Numbers are finite, text is short and printable (it will be shown in terminals)."""
    if isinstance(value, dict):
        for key, item in value.items():
            _check_values(key, name)
            _check_values(item, name)
    elif isinstance(value, list):
        for item in value:
            _check_values(item, name)
    elif isinstance(value, str):
        if len(value) > _TEXT or not value.isprintable():
            refuse(name, f"hold printable text of at most {_TEXT} letters", _short(value), "Rename it.")
    elif isinstance(value, float) and not math.isfinite(value):
        refuse(name, "hold finite numbers", f"{value}", "Save the model again.")
    elif isinstance(value, int) and not abs(value) < _INTEGER:
        refuse(name, "hold integers of at most 63 bits", f"{value:.3g}", "Save the model again.")


def check_names(found: Mapping[str, Any], wanted: Mapping[str, Any], name: str, what: str) -> None:
    """Refuse a mapping that holds more or fewer names than ``wanted``."""
    if set(found) != set(wanted):
        extra, missing = sorted(set(found) - set(wanted)), sorted(set(wanted) - set(found))
        said = " and ".join(
            f"{word} {', '.join(_short(key) for key in keys[:_NAMES])}"
            for word, keys in (("unknown", extra), ("no", missing))
            if keys
        )
        refuse(name, f"hold the {what} {', '.join(wanted)}", said, "Save the model again with this version of Jink.")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
