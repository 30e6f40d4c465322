"""Graphs about a model of intents: how they follow one another, how well they fit, how their number was chosen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import networkx as nx
import numpy as np
from matplotlib.ticker import MaxNLocator

from jink.intent.model import IntentModel
from jink.intent.progress import Progress
from jink.training.intent_drawing import STYLE, colour_of, save_figure
from jink.training.plotting import MODE_COLOURS

__all__ = ["CurvePoint", "draw_graph", "plot_curve", "plot_graph"]

_RARE = 0.03


class CurvePoint(NamedTuple):
    """How well so many intents predict tracks that were not fitted: nats per row.

    low, high: 95 % interval of the difference to the best number, added to the best.
    """

    intents: int
    nats: float
    low: float
    high: float


def plot_graph(path: Path, model: IntentModel) -> None:
    """How the intents follow one another: share of the time, mean duration, and where each goes next."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(6.0, 4.6), layout="constrained")
        draw_graph(axis, model)
        save_figure(figure, path)


def plot_curve(path: Path, trace: Sequence[Progress], curve: Sequence[CurvePoint], chosen: int) -> None:
    """Likelihood while fitting, and against the number of intents.

    Args:
        path: .png, .pdf or .svg.
        trace: reports that had a likelihood, in order.
        curve: one point per number of intents tried.
        chosen: number of intents of the model.
    """
    panels = [name for name, wanted in (("fit", len(trace) > 1), ("choice", len(curve) > 0)) if wanted]
    with plt.rc_context(STYLE):
        figure, found = plt.subplots(
            1, max(len(panels), 1), figsize=(4.2 * max(len(panels), 1), 3.2), layout="constrained", squeeze=False
        )
        axes = dict(zip(panels, found[0], strict=False))
        if "fit" in axes:
            _draw_trace(axes["fit"], trace)
        if "choice" in axes:
            _draw_choice(axes["choice"], curve, chosen)
        if not panels:
            found[0, 0].text(0.5, 0.5, "no curve was kept", ha="center", transform=found[0, 0].transAxes)
            found[0, 0].set_axis_off()
        save_figure(figure, path)


def draw_graph(axis: Any, model: IntentModel) -> None:
    """Nodes by their share of the time; an arrow is as wide as it is probable."""
    shares = model.intent_probs(model.mode_shares())
    graph = nx.DiGraph()
    for number, intent in enumerate(model.intents):
        lasts = model.spell_lasting(number)
        graph.add_node(number, label=f"{intent.name}\n{100 * shares[number]:.0f} %, {lasts}")
    for i, row in enumerate(model.generator):
        for j, rate in enumerate(row):
            if i != j and rate > -_RARE * row[i]:
                graph.add_edge(i, j, weight=-rate / row[i])
    places = nx.circular_layout(graph) if len(graph) > 1 else {0: np.zeros(2)}
    sizes = [500.0 + 4500.0 * float(shares[number]) for number in graph]
    colours = [colour_of(number) for number in graph]
    nx.draw_networkx_nodes(graph, places, node_size=sizes, node_color=colours, alpha=0.85, ax=axis)
    weights = [graph.edges[edge]["weight"] for edge in graph.edges]
    nx.draw_networkx_edges(
        graph, places, width=[0.6 + 3.0 * w for w in weights], node_size=sizes, connectionstyle="arc3,rad=0.18",
        edge_color="#555555", arrowsize=12, ax=axis,
    )  # fmt: skip
    labels = {edge: f"{100 * graph.edges[edge]['weight']:.0f} %" for edge in graph.edges}
    nx.draw_networkx_edge_labels(
        graph, places, labels, font_size=7, connectionstyle="arc3,rad=0.18", rotate=False, ax=axis,
        bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8},
    )  # fmt: skip
    middle = np.mean(list(places.values()), axis=0)
    for number, place in places.items():
        outward = place - middle
        size = float(np.hypot(*outward))
        shift = outward / size * 0.12 if size > 0 else np.zeros(2)
        axis.annotate(
            graph.nodes[number]["label"], place + shift, ha="center", va="center", fontsize=8, zorder=6,
            bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": colour_of(number), "alpha": 0.9},
        )  # fmt: skip
    axis.set_title("where each intent goes next; share of the time, mean duration", loc="left", fontsize=9)
    axis.margins(0.28)
    axis.set_axis_off()


def _draw_trace(axis: Any, trace: Sequence[Progress]) -> None:
    """One line per climb, which begins at its first step; crosses are of tracks held out."""
    names = list(dict.fromkeys(report.stage for report in trace))
    for k, name in enumerate(names):
        nats = np.array([r.log_likelihood if r.stage == name and not r.held_out else np.nan for r in trace])
        held = np.array([r.log_likelihood if r.stage == name and r.held_out else np.nan for r in trace])
        first = [n for n, r in enumerate(trace) if n and r.stage == name and r.step <= trace[n - 1].step]
        line = np.insert(nats, first, np.nan)
        place = np.insert(np.arange(len(trace), dtype=np.float64), first, np.nan)
        axis.plot(place, line, ".-", ms=3, lw=0.8, color=colour_of(k), label=name)
        axis.plot(np.arange(len(trace)), held, "x", ms=5, color=colour_of(k))
    if any(report.held_out for report in trace):
        axis.plot([], [], "x", color="black", label="held out")
    values = np.array([report.log_likelihood for report in trace])
    low, high = float(np.quantile(values, 0.02)), float(values.max())
    axis.set(xlabel="report", ylabel="log-likelihood, nats per row", ylim=(low - 0.05 * (high - low) - 1e-3, None))
    axis.legend(frameon=False, fontsize=8)
    axis.set_title("fitting", loc="left", fontsize=9)


def _draw_choice(axis: Any, curve: Sequence[CurvePoint], chosen: int) -> None:
    points = sorted(curve)
    numbers, nats = np.array([p.intents for p in points]), np.array([p.nats for p in points])
    errors = np.array([[p.nats - p.low for p in points], [p.high - p.nats for p in points]])
    errors = np.maximum(np.nan_to_num(errors), 0.0)
    axis.errorbar(numbers, nats, yerr=errors, fmt="o-", ms=4, lw=1.0, capsize=3, color=colour_of(0))
    at = [p.nats for p in points if p.intents == chosen]
    if at:
        axis.plot([chosen], at[-1:], "o", ms=11, mfc="none", mec=MODE_COLOURS[4], mew=1.6, label="chosen")
        axis.legend(frameon=False, fontsize=8)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set(xlabel="intents (bars: 95 % of the difference to the best)", ylabel="held out, nats per row")
    axis.set_title("choosing their number", loc="left", fontsize=9)
