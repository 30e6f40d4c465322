"""Policies as files: a folder with one JSON of names and sizes and one safetensors of numbers; nothing is executed."""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from jink.estimators.agent.policy import Policy
from jink.estimators.safe_reading import check_names, parse_json, parse_tensors, read_bytes, refuse

__all__ = ["POLICY_FILE", "find_policy", "load_policy", "pretrained_policies", "replace_file", "save_policy"]

POLICY_FILE = "policy.json"
FORMAT, VERSION = "jink policy", 2
_KEYS = (
    "format", "version", "weights", "view", "factors", "covariance", "activation", "components", "lookback", "sizes",
    "about",
)  # fmt: skip
_FIRST_KEYS = tuple(name for name in _KEYS if name != "lookback")
"""Of version 1."""
_NAMED = ("view", "covariance", "activation")
_LARGEST = 2**24
_DEPTH, _LAYERS, _UNITS, _FACTORS = 8, 8, 1024, 32
_AGAIN = "Save the policy again."
_HERE = Path(__file__).resolve().parent / "pretrained"


def save_policy(policy: Policy, folder: str | Path) -> Path:
    """Write a policy; a reader finds the old one or the new one, whatever happens in between.

    Args:
        policy: its ``about`` must be JSON.
        folder: made where it does not exist; other files in it are left alone.

    Returns:
        the folder.

    Raises:
        ValueError: ``about`` is no JSON.
        OSError: it cannot be written.
    """
    folder = Path(folder)
    tensors = {"skip": np.array(policy.skip), "shift": np.array(policy.shift), "gain": np.array(policy.gain)}
    for number, (weight, bias) in enumerate(policy.layers):
        tensors[f"weight_{number}"], tensors[f"bias_{number}"] = np.array(weight), np.array(bias)
    content = save(tensors)
    digest = hashlib.sha256(content).hexdigest()
    sizes = [policy.layers[0][0].shape[1], *(len(bias) for _, bias in policy.layers)]
    values = (
        FORMAT, VERSION, digest, policy.view, list(policy.factors), policy.covariance, policy.activation,
        policy.components, policy.lookback, sizes, dict(policy.about),
    )  # fmt: skip
    try:
        text = json.dumps(dict(zip(_KEYS, values, strict=True)), indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"save_policy: about must hold text, finite numbers, lists and dicts; got {error}.") from error
    _policy(text.encode(), lambda _: content)  # what would be refused later is refused now
    folder.mkdir(parents=True, exist_ok=True)
    name = _weights_name(digest)
    replace_file(folder / name, content)
    replace_file(folder / POLICY_FILE, text.encode())
    for old in folder.glob("weights-*.safetensors"):
        if old.name != name and re.fullmatch(r"weights-[0-9a-f]{16}\.safetensors", old.name):
            old.unlink(missing_ok=True)
    return folder


def load_policy(folder: str | Path) -> Policy:
    """Read a policy that `save_policy` wrote; anything else is refused.

    Args:
        folder: with ``policy.json`` and the weights that it names by their hash.

    Raises:
        FileNotFoundError: no such folder or file.
        ValueError: anything that is not such a policy: file, rule, value, remedy in one sentence.
    """
    folder = Path(folder)
    if folder.name == POLICY_FILE:
        folder = folder.parent
    if not (folder / POLICY_FILE).exists():
        raise FileNotFoundError(
            f"load_policy: {POLICY_FILE} must lie in the folder of the policy; got none in {folder}. "
            "Name a folder that `jink train agent` or save_policy wrote."
        )
    try:
        return _policy(read_bytes(folder / POLICY_FILE, _LARGEST), lambda name: read_bytes(folder / name, _LARGEST))
    except ValueError as error:
        raise ValueError("load_policy: " + str(error).removeprefix("load_model: ")) from error


def pretrained_policies() -> tuple[str, ...]:
    """Names of the policies that ship with the package."""
    return tuple(sorted(path.parent.name for path in _HERE.glob(f"*/{POLICY_FILE}")))


def find_policy(policy: Policy | str | Path, caller: str = "make_estimator") -> Policy:
    """A policy itself, one that ships with the package by name, or the one in a folder; a name wins.

    Raises:
        ValueError: neither, or a file that is refused.
    """
    if isinstance(policy, Policy):
        return policy
    names = pretrained_policies()
    if isinstance(policy, str) and policy in names:
        return load_policy(_HERE / policy)
    if isinstance(policy, str | Path):
        try:
            return load_policy(policy)
        except FileNotFoundError:
            pass
    raise ValueError(
        f"{caller}: policy must be one of {', '.join(names)}, or a folder that jink train agent wrote; got "
        f"{str(policy)!r}. See jink list."
    )


def replace_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _weights_name(digest: str) -> str:
    return f"weights-{digest[:16]}.safetensors"


def _policy(text: bytes, weights_of: Any) -> Policy:
    document = parse_json(text, POLICY_FILE, _DEPTH)
    found = document.get("format"), document.get("version")
    if found not in ((FORMAT, 1), (FORMAT, VERSION)) or type(found[1]) is not int:
        refuse(POLICY_FILE, f"have format '{FORMAT}' and version 1 or {VERSION}", found, "Use the Jink that wrote it.")
    check_names(document, dict.fromkeys(_FIRST_KEYS if found[1] == 1 else _KEYS), POLICY_FILE, "keys")
    digest, sizes, factors, about = (document[name] for name in ("weights", "sizes", "factors", "about"))
    if not isinstance(digest, str) or not re.fullmatch(r"[0-9a-f]{64}", digest):
        refuse(POLICY_FILE, "name its weights by a SHA-256", repr(digest)[:80], _AGAIN)
    whole = isinstance(sizes, list) and 2 <= len(sizes) <= _LAYERS + 1
    if not whole or not all(type(size) is int and 1 <= size <= _UNITS for size in sizes):
        refuse(POLICY_FILE, f"have sizes, 2 to {_LAYERS + 1} integers up to {_UNITS}", repr(sizes)[:80], _AGAIN)
    if not (isinstance(factors, list) and len(factors) <= _FACTORS and all(isinstance(name, str) for name in factors)):
        refuse(POLICY_FILE, f"have factors, at most {_FACTORS} names", repr(factors)[:80], _AGAIN)
    if not isinstance(about, dict):
        refuse(POLICY_FILE, "have about, an object", type(about).__name__, _AGAIN)
    wanted: dict[str, tuple[int, ...]] = {"skip": (sizes[-1], sizes[0]), "shift": (sizes[0],), "gain": (sizes[0],)}
    for number in range(len(sizes) - 1):
        wanted[f"weight_{number}"] = (sizes[number + 1], sizes[number])
        wanted[f"bias_{number}"] = (sizes[number + 1],)
    name = _weights_name(digest)
    content = weights_of(name)
    if hashlib.sha256(content).hexdigest() != digest:
        refuse(name, f"have the SHA-256 that {POLICY_FILE} names", "another", "Copy both files again.")
    tensors: dict[str, NDArray[np.float64]] = parse_tensors(content, name, wanted)
    layers = tuple((tensors[f"weight_{n}"], tensors[f"bias_{n}"]) for n in range(len(sizes) - 1))
    named = {key: document[key] for key in _NAMED}
    try:
        return Policy(
            layers, tensors["skip"], tensors["shift"], tensors["gain"], factors=tuple(factors),
            components=document["components"], lookback=document.get("lookback", False), about=about, **named,
        )  # fmt: skip
    except ValueError as error:
        raise ValueError(f"{POLICY_FILE}: {error}") from error
