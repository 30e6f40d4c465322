"""Packages that only some need."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["need"]


def need(module: str, extra: str) -> Any:
    """Import a module of an extra.

    Args:
        module: its full name.
        extra: of ours that installs it.

    Raises:
        ValueError: it is not installed; the sentence has the command.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        raise ValueError(
            f"{package} must be installed for this; got {error}. Run pip install 'jink[{extra}]'."
        ) from error
