"""Models of intents as files: a folder with one JSON of what is named and counted, and one safetensors of numbers."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from jink.estimators.safe_reading import check_names, parse_json, parse_tensors, read_bytes, refuse
from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent, IntentModel

__all__ = ["MODEL_FILE", "load_model", "save_model"]

Floats = NDArray[np.float64]

MODEL_FILE = "intents.json"
"""Names, counts and provenance; the numbers lie beside it in ``weights-<hash>.safetensors``."""
FORMAT, VERSION = "jink intents", 2
LAW = (
    "growth_mean",
    "growth_rate",
    "growth_noise",
    "turn_mean",
    "turn_rate",
    "turn_noise",
    "wobble",
    "swing_rate",
    "swing_damping",
    "duration",
)
"""Columns of the tensor ``laws``, one row per phase; a swing rate of 0 is none."""
BIRTH = ("weight", "growth_mean", "growth_sd", "turn_mean", "turn_sd", "swing_sd")
"""Columns of the tensor ``births``, one row per component, phase after phase."""
_KNOWN = (1, 2)  # version 1 has no endings
_LARGEST = 2**22
_DEPTH = 10
_INTENTS, _PHASES, _BIRTHS, _MODES = 64, 16, 16, 512
_KEYS = ("format", "version", "axes", "weights", "learned_noise", "known_endings", "intents", "about")
_AGAIN = "Save the model again."


def save_model(model: IntentModel, folder: str | Path) -> Path:
    """Write a model into a folder; a reader finds the old model or the new one, whatever happens in between.

    Args:
        model: what was learned; its ``about`` must be JSON (tuples come back as lists).
        folder: made where it does not exist; other files in it are left alone.

    Returns:
        the folder.

    Raises:
        ValueError: ``about`` is no JSON, or the model is larger than a file may be.
        OSError: it cannot be written.
    """
    folder = Path(folder)
    weights = save(_tensors(model))
    digest = hashlib.sha256(weights).hexdigest()
    try:
        text = json.dumps(_document(model, digest), indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(
            f"save_model: about must hold text, finite numbers, lists and dicts; got {error}. Convert it first."
        ) from error
    # What would be refused later is refused now, while the model is still there.
    again = _model(text.encode(), lambda _: weights)
    if again != model or again.about != _listed(model.about):
        raise ValueError("save_model: about must come back as it was; got another. Name things by text, not numbers.")
    folder.mkdir(parents=True, exist_ok=True)
    name = _weights_name(digest)
    _replace(folder / name, weights)
    _replace(folder / MODEL_FILE, text.encode())
    for old in folder.glob("weights-*.safetensors"):
        if old.name != name and re.fullmatch(r"weights-[0-9a-f]{16}\.safetensors", old.name):
            old.unlink(missing_ok=True)
    return folder


def load_model(folder: str | Path) -> IntentModel:
    """Read a model that `save_model` wrote; nothing in the files is ever executed, and anything else is refused.

    Args:
        folder: with ``intents.json`` and the weights that it names by their hash.

    Returns:
        the model, to the last bit.

    Raises:
        FileNotFoundError: no such folder or file.
        ValueError: anything that is not such a model: file, rule, value, remedy in one sentence.
    """
    folder = Path(folder)
    if folder.is_file() and folder.name == MODEL_FILE:
        folder = folder.parent
    if not folder.is_dir():
        raise FileNotFoundError(
            f"load_model: folder must be that of a model; got {folder}. "
            "Name a folder that `jink train intents` or save_model wrote."
        )
    text = read_bytes(folder / MODEL_FILE, _LARGEST)
    return _model(text, lambda name: read_bytes(folder / name, _LARGEST))


def _listed(value: Any) -> Any:
    """The same with lists for tuples, as JSON has it."""
    if isinstance(value, Mapping):
        return {key: _listed(item) for key, item in value.items()}
    return [_listed(item) for item in value] if isinstance(value, list | tuple) else value


def _weights_name(digest: str) -> str:
    return f"weights-{digest[:16]}.safetensors"


def _replace(path: Path, content: bytes) -> None:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _phases(model: IntentModel) -> Iterator[Phase]:
    for intent in model.intents:
        yield from intent.phases


def _document(model: IntentModel, digest: str) -> dict[str, Any]:
    intents = [
        {
            "name": intent.name,
            "phases": [{"births": len(phase.births), "mirrored": phase.mirrored} for phase in intent.phases],
        }
        for intent in model.intents
    ]
    known = (model.noise_sd is not None, bool(model.endings))
    values = (FORMAT, VERSION, model.axes, digest, *known, intents, dict(model.about))
    return dict(zip(_KEYS, values, strict=True))


def _tensors(model: IntentModel) -> dict[str, Floats]:
    laws = [
        [*(getattr(phase.law, name) for name in LAW[:7]), *(phase.law.swing or (0.0, 0.0)), phase.duration]
        for phase in _phases(model)
    ]
    births = [[getattr(birth, name) for name in BIRTH] for phase in _phases(model) for birth in phase.births]
    tensors = {
        "laws": laws,
        "births": births,
        "generator": model.generator,
        "initial": model.initial,
        "renewal": [intent.renewal for intent in model.intents],
        "speed": [model.speed],
    }
    if model.noise_sd is not None:
        tensors["noise_sd"] = model.noise_sd
    if model.endings:
        tensors["endings"] = model.endings
    return {name: np.array(value, dtype=np.float64) for name, value in tensors.items()}


def _model(text: bytes, weights_of: Any) -> IntentModel:
    """The model of a JSON text and a function from the name of the weights to their bytes."""
    document = parse_json(text, MODEL_FILE, _DEPTH)
    found = document.get("format"), document.get("version")
    if found[0] != FORMAT or type(found[1]) is not int or found[1] not in _KNOWN:
        refuse(MODEL_FILE, f"have format '{FORMAT}' and version 1 or {VERSION}", found, "Use the Jink that wrote it.")
    keys = tuple(key for key in _KEYS if found[1] > 1 or key != "known_endings")
    check_names(document, dict.fromkeys(keys), MODEL_FILE, "keys")
    axes, digest, noise = document["axes"], document["weights"], document["learned_noise"]
    if axes not in (2, 3) or type(axes) is not int:
        refuse(MODEL_FILE, "have axes 2 or 3", repr(axes), _AGAIN)
    if not isinstance(digest, str) or not re.fullmatch(r"[0-9a-f]{64}", digest):
        refuse(MODEL_FILE, "have weights, a SHA-256 in 64 hexadecimal digits", repr(digest)[:80], _AGAIN)
    if not isinstance(noise, bool):
        refuse(MODEL_FILE, "have learned_noise true or false", repr(noise)[:60], _AGAIN)
    endings = document.get("known_endings", False)
    if not isinstance(endings, bool):
        refuse(MODEL_FILE, "have known_endings true or false", repr(endings)[:60], _AGAIN)
    if not isinstance(document["about"], dict):
        refuse(MODEL_FILE, "have about, an object", type(document["about"]).__name__, _AGAIN)
    outline = _outline(document["intents"])
    phases = [phase for _, found in outline for phase in found]
    modes = sum(births * (1 + mirrored) for births, mirrored in phases)
    if modes > _MODES:
        refuse(MODEL_FILE, f"stand for at most {_MODES} modes", f"{modes}", "A bank of so many would never finish.")
    P = len(outline)
    wanted: dict[str, tuple[int, ...]] = {
        "laws": (len(phases), len(LAW)),
        "births": (sum(births for births, _ in phases), len(BIRTH)),
        "generator": (P, P),
        "initial": (P,),
        "renewal": (P,),
        "speed": (1,),
    }
    if noise:
        wanted["noise_sd"] = (axes,)
    if endings:
        wanted["endings"] = (P,)
    name = _weights_name(digest)
    content = weights_of(name)
    if hashlib.sha256(content).hexdigest() != digest:
        refuse(name, f"have the SHA-256 that {MODEL_FILE} names", "another", "Copy both files again, from one model.")
    tensors = parse_tensors(content, name, wanted)
    try:
        return _assemble(axes, outline, tensors, document["about"])
    except ValueError as error:
        raise ValueError(f"load_model: {name}: {error}") from error


def _outline(intents: Any) -> list[tuple[str, list[tuple[int, bool]]]]:
    """Names, and births and mirroring of each phase."""
    if not isinstance(intents, list) or not 1 <= len(intents) <= _INTENTS:
        refuse(MODEL_FILE, f"have intents, a list of 1 to {_INTENTS}", _size(intents), _AGAIN)
    outline = []
    for intent in intents:
        _check_object(intent, ("name", "phases"), "an intent")
        name, phases = intent["name"], intent["phases"]
        if not isinstance(name, str) or not 0 < len(name) <= 100:
            refuse(MODEL_FILE, "name each intent by 1 to 100 letters", repr(name)[:60], _AGAIN)
        if not isinstance(phases, list) or not 1 <= len(phases) <= _PHASES:
            refuse(MODEL_FILE, f"give each intent 1 to {_PHASES} phases", _size(phases), _AGAIN)
        found = []
        for phase in phases:
            _check_object(phase, ("births", "mirrored"), "a phase")
            births, mirrored = phase["births"], phase["mirrored"]
            if isinstance(births, bool) or not isinstance(births, int) or not 1 <= births <= _BIRTHS:
                refuse(MODEL_FILE, f"give each phase 1 to {_BIRTHS} births", repr(births)[:60], _AGAIN)
            if not isinstance(mirrored, bool):
                refuse(MODEL_FILE, "have mirrored true or false", repr(mirrored)[:60], _AGAIN)
            found.append((births, mirrored))
        outline.append((name, found))
    return outline


def _check_object(value: Any, keys: tuple[str, ...], what: str) -> None:
    if not isinstance(value, dict):
        refuse(MODEL_FILE, f"describe {what} by an object", type(value).__name__, _AGAIN)
    check_names(value, dict.fromkeys(keys), MODEL_FILE, f"keys of {what}")


def _size(value: Any) -> str:
    return f"{len(value)}" if isinstance(value, list) else type(value).__name__


def _assemble(
    axes: int, outline: list[tuple[str, list[tuple[int, bool]]]], tensors: Mapping[str, Floats], about: dict[str, Any]
) -> IntentModel:
    laws, births = iter(tensors["laws"].tolist()), iter(tensors["births"].tolist())
    intents = []
    for (name, phases), renewal in zip(outline, tensors["renewal"].tolist(), strict=True):
        built = []
        for count, mirrored in phases:
            *numbers, rate, damping, duration = next(laws)
            swing = (rate, damping) if rate != 0.0 or damping != 0.0 else None
            law = Law(axes, **dict(zip(LAW, numbers, strict=False)), swing=swing)
            parts = tuple(Birth(*next(births)) for _ in range(count))
            built.append(Phase(law, parts, mirrored, duration))
        intents.append(Intent(name, tuple(built), renewal))
    noise = tensors.get("noise_sd")
    return IntentModel(
        axes,
        tuple(intents),
        tuple(tuple(row) for row in tensors["generator"].tolist()),
        tuple(tensors["initial"].tolist()),
        None if noise is None else tuple(noise.tolist()),
        float(tensors["speed"][0]),
        about,
        tuple(tensors["endings"].tolist()) if "endings" in tensors else (),
    )
