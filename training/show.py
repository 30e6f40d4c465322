"""`jink show`: the intents of a model, printed and drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.columns import Columns
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from jink.intent.model import IntentModel
from jink.training.console import check_writable
from jink.training.intent_pictures import draw_model, sample_rollouts, typical_speed
from jink.training.intent_summary import print_model
from jink.training.models import find_model
from jink.training.sketch import sketch
from jink.training.wording import counted

__all__ = ["show"]

_COLOURS = ("blue", "yellow", "green", "magenta", "red", "cyan", "bright_yellow", "white")
_PATHS = 8


def show(name: str, plot: Path | None, console: Console) -> None:
    """Print a model and draw it, in letters and, if asked to, as a picture.

    Args:
        name: folder, or name of a model that ships with the package.
        plot: picture; None: none.
        console: where to print.

    Raises:
        ValueError: no such model, or a picture that cannot be written.
    """
    check_writable(plot, "--plot", (".png", ".pdf", ".svg"))
    model = find_model(name, option="MODEL")
    console.print(
        f"[bold]{escape(name)}[/bold]: {counted(len(model.intents), 'intent')} in {model.axes} axes, {_origin(model)}"
    )
    print_model(console, model)
    _print_sketches(console, model)
    if plot is not None:
        draw_model(plot, model)
        console.print(f"wrote {plot}", markup=False)


def _print_sketches(console: Console, model: IntentModel) -> None:
    rng = np.random.default_rng(0)
    pieces = []
    for number, intent in enumerate(model.intents):
        lines = sketch(sample_rollouts(model, number, rng, _PATHS))
        text = Text(intent.name[:24] + "\n", style="bold")
        text.append("\n".join(lines) + "\n", style=_COLOURS[number % len(_COLOURS)])
        pieces.append(text)
    console.print(Columns(pieces, padding=(0, 2)))
    console.print(f"paths from the left at {typical_speed(model):.3g} m/s, seen from above", style="dim")


def _origin(model: IntentModel) -> str:
    """Where a model comes from, in a few words."""
    tracks = model.about.get("tracks")
    if not isinstance(tracks, dict):
        return "of unknown origin"
    return escape(f"learned from {counted(tracks.get('tracks', '?'), 'track')} of {tracks.get('source', '?')}")
