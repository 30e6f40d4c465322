"""A forecast as a picture: where the target came from, where it may be, where it went."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from jink.intent.forecasting import PositionForecast
from jink.training.intent_drawing import colour_of

__all__ = ["plot_forecast"]

Floats = NDArray[np.float64]
_CELLS = 220
_SAMPLES = 12
_CLEAR = LinearSegmentedColormap.from_list("clear", [(0.0, 0.45, 0.7, 0.0), (0.0, 0.45, 0.7, 0.9)])


def plot_forecast(
    path: Path,
    found: PositionForecast,
    past: Floats,
    truth: Floats | None = None,
    *,
    state: int = 0,
    horizons: Sequence[int] | None = None,
    title: str = "",
) -> None:
    """Draw the density of the position at a few horizons, sampled paths and what became of it; the first two axes.

    Args:
        path: .png, .pdf or .svg.
        found: the forecast.
        past: measured positions up to now; (T, A); m.
        truth: where the target went; (H, A); m; None: unknown.
        state: which of the B states.
        horizons: which horizons to draw; None: four, evenly.
        title: above the picture.
    """
    count = found.weights.shape[1]
    shown = horizons if horizons is not None else sorted({*np.linspace(0, count - 1, 5).astype(int)[1:].tolist()})
    paths = found.paths[state, :_SAMPLES]
    corners = np.concatenate([past[:, :2], paths[..., :2].reshape(-1, 2), *([] if truth is None else [truth[:, :2]])])
    low, high = np.nanmin(corners, axis=0), np.nanmax(corners, axis=0)
    half = 0.55 * float((high - low).max())
    middle = 0.5 * (low + high)
    x, y = (np.linspace(m - half, m + half, _CELLS) for m in middle)
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axis = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
        for h in shown:
            image = found.density(state, h, x, y)
            # Each horizon to its own height: the late ones are as real as the early ones, only wider.
            extent = (x[0], x[-1], y[0], y[-1])
            axis.imshow(np.sqrt(image / image.max()), extent=extent, origin="lower", cmap=_CLEAR, zorder=1)
        for number, one in enumerate(paths):
            label = "possible paths" if number == 0 else None
            axis.plot(*one[:, :2].T, color=colour_of(1), lw=0.7, alpha=0.8, zorder=2, label=label)
        axis.plot(*past[:, :2].T, ".", color="#999999", ms=4, label="measured", zorder=3)
        if truth is not None:
            axis.plot(*truth[:, :2].T, color="black", lw=1.6, label="what became of it", zorder=4)
            axis.plot(*truth[list(shown), :2].T, "o", color="black", ms=4, zorder=4)
        axis.plot([], [], "s", color=_CLEAR(0.8), label=f"density after {_said(found, state, shown)} s")
        axis.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), xlabel="x, m", ylabel="y, m")
        axis.set_aspect("equal")
        axis.set_title(title, loc="left", fontsize=9)
        figure.legend(loc="outside right center", frameon=False, fontsize=8)
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            figure.savefig(part, dpi=150, format=path.suffix[1:].lower())
            part.replace(path)
        finally:
            plt.close(figure)
            part.unlink(missing_ok=True)


def _said(found: PositionForecast, state: int, shown: Sequence[int]) -> str:
    return ", ".join(f"{found.horizons[state, h]:.3g}" for h in shown)
