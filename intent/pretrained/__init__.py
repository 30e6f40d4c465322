"""Models that ship with the package, trained on the simulated suites; `docs/intents.md` says by which command."""

from __future__ import annotations

from pathlib import Path

from jink.intent.model import IntentModel
from jink.intent.model_file import MODEL_FILE, load_model

__all__ = ["load_pretrained", "pretrained_names"]

_HERE = Path(__file__).resolve().parent


def pretrained_names() -> tuple[str, ...]:
    """Names that `load_pretrained` knows."""
    return tuple(sorted(path.parent.name for path in _HERE.glob(f"*/{MODEL_FILE}")))


def load_pretrained(name: str) -> IntentModel:
    """A model that ships with the package.

    Args:
        name: one of `pretrained_names`.

    Raises:
        ValueError: an unknown name.
    """
    names = pretrained_names()
    if name not in names:
        raise ValueError(f"load_pretrained: name must be one of {', '.join(names)}; got {name!r}. See `jink list`.")
    return load_model(_HERE / name)
