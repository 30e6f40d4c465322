"""What a long training has finished so far, on disk, so that a killed one goes on to the same result.

A training is a fixed sequence of stages that each turn models into a model. A finished stage leaves its model and a few
numbers behind; run again, the training takes these instead of computing them. Random draws come from named seeds.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jink.estimators.safe_reading import parse_json, read_bytes
from jink.intent.model import IntentModel
from jink.intent.model_file import load_model, save_model

__all__ = ["Diary"]

_LARGEST = 2**20


class Diary:
    """Finished stages of one training.

    Args:
        folder: where they lie; None: nowhere.
        key: digest of tracks and options; stages of another training are not taken for this one's.

    Raises:
        ValueError: the folder holds another training.
    """

    def __init__(self, folder: str | Path | None, key: str) -> None:
        self.folder = None if folder is None else Path(folder)
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        mark = self.folder / "key.json"
        if not mark.is_file():
            _write(mark, {"key": key})
        elif _read(mark).get("key") != key:
            raise ValueError(
                f"IntentLearner.fit: checkpoint must belong to these tracks and options; got {self.folder} of another "
                "training. Choose another folder, or delete it."
            )

    def stage(self, name: str, compute: Callable[[], tuple[IntentModel, dict[str, Any]]]) -> tuple[IntentModel, Any]:
        """The model and the numbers of a stage, computed unless they lie there already."""
        if self.folder is None:
            return compute()
        place = self.folder / name
        if (place / "stage.json").is_file():
            return load_model(place), _read(place / "stage.json")
        shutil.rmtree(place, ignore_errors=True)
        model, numbers = compute()
        save_model(model, place)
        _write(place / "stage.json", numbers)
        return model, numbers


def _read(path: Path) -> dict[str, Any]:
    return parse_json(read_bytes(path, _LARGEST), path.name, 8)


def _write(path: Path, value: dict[str, Any]) -> None:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.write_text(json.dumps(value, allow_nan=False) + "\n", encoding="utf-8")
    part.replace(path)
