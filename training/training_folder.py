"""The folder of a training: whose it is, whether it has ended, and what may be replaced in it."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jink.intent.model import IntentModel
from jink.intent.model_file import MODEL_FILE, load_model

__all__ = ["WORK", "abandon", "finish", "finished_model", "prepare"]

WORK, DONE = "checkpoint", "training.json"


def finished_model(out: Path, key: str, fresh: bool) -> IntentModel | None:
    """The model of an equal training that has ended."""
    if fresh or not (out / DONE).is_file() or not (out / MODEL_FILE).is_file():
        return None
    return load_model(out) if _read(out / DONE) == {"request": key, "finished": True} else None


def prepare(out: Path, key: str, made: Sequence[str], fresh: bool) -> bool:
    """Make the folders of a training.

    Args:
        out: of the model.
        key: of the request.
        made: names of the other files that a training writes.
        fresh: begin anew whatever lies there.

    Returns:
        whether a checkpoint of the same request lies there.

    Raises:
        ValueError: a file, a folder of something else, a training of another request, or no permission.
    """
    work = out / WORK
    if out.exists() and not out.is_dir():
        raise ValueError(f"--out: value must be a folder; got {out}, a file. Choose another name.")
    own = {MODEL_FILE, DONE, WORK, "README.md", "tensorboard", *made}
    there = {path.name for path in out.iterdir()} if out.is_dir() else set()
    strange = {name for name in there - own if not name.startswith("weights-")}
    if strange and not (there & {MODEL_FILE, DONE, WORK}):
        raise ValueError(
            f"--out: folder must be new, empty or of an earlier training; got {out} with {sorted(strange)[0]} in it. "
            "Choose another folder."
        )
    mark = work / "request.json"
    if fresh:
        shutil.rmtree(work, ignore_errors=True)
    elif mark.is_file():
        if _read(mark).get("request") == key:
            return True
        raise ValueError(
            f"--out: folder must not hold an unfinished training of other tracks or options; got {out}. "
            "Give the same options to go on, add --fresh, or choose another folder."
        )
    elif (out / DONE).is_file():
        raise ValueError(
            f"--out: folder must not hold a model of other tracks or options; got {out}. "
            "Add --fresh to replace it, or choose another folder."
        )
    try:
        work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"--out: folder must be writable; got {out} ({error.strerror}). Choose another folder."
        ) from error
    (out / DONE).unlink(missing_ok=True)
    _write(mark, {"request": key})
    return False


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        found = {}
    return found if isinstance(found, dict) else {}


def abandon(out: Path) -> None:
    """Forget a training that was refused before it could begin, and its folder where nothing else is in it."""
    shutil.rmtree(out / WORK, ignore_errors=True)
    if out.is_dir() and not any(out.iterdir()):
        out.rmdir()


def finish(out: Path, key: str) -> None:
    """Mark a training as ended and forget its checkpoints."""
    _write(out / DONE, {"request": key, "finished": True})
    shutil.rmtree(out / WORK, ignore_errors=True)


def _write(path: Path, value: dict[str, Any]) -> None:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.write_text(json.dumps(value) + "\n", encoding="utf-8")
    part.replace(path)
