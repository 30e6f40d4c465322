"""What the pictures of intents share: style, colours, durations, files that appear whole."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from jink.intent.model import IntentModel
from jink.training.plotting import MODE_COLOURS

__all__ = ["STYLE", "colour_of", "leaving_rates", "save_figure", "spell"]

Floats = NDArray[np.float64]
DPI = 150
STYLE: dict[Any, Any] = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}


def colour_of(number: int) -> str:
    """Of an intent, wherever it is drawn."""
    return MODE_COLOURS[number % len(MODE_COLOURS)]


def leaving_rates(model: IntentModel) -> Floats:
    """Rate at which each intent ends, in favour of another or of itself anew; (P,); 1/s."""
    return -np.diag(np.array(model.generator)) + np.array([intent.renewal for intent in model.intents])


def spell(seconds: float) -> str:
    """A duration in two digits, or in whole seconds; no exponent."""
    return f"{seconds:.2g} s" if seconds < 100.0 else f"{seconds:.0f} s"


def save_figure(figure: Any, path: Path) -> None:
    """Write and close a figure; the file is replaced whole or not at all."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        figure.savefig(part, dpi=DPI, format=path.suffix[1:].lower())
        part.replace(path)
    finally:
        plt.close(figure)
        part.unlink(missing_ok=True)
