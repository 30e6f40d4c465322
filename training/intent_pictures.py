"""Pictures of a model of intents: how each moves, how they follow one another, where they lie, how they were chosen."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import networkx as nx
import numpy as np
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.describing import describe_phase
from jink.intent.features import encode
from jink.intent.model import IntentModel
from jink.intent.progress import Progress
from jink.intent.window import choose_window
from jink.training.plotting import MODE_COLOURS

__all__ = [
    "CurvePoint",
    "colour_of",
    "draw_model",
    "leaving_rates",
    "plot_clusters",
    "plot_curve",
    "plot_graph",
    "plot_rollouts",
    "sample_rollouts",
    "typical_speed",
]

Floats = NDArray[np.float64]
_STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
_SAMPLES, _POINTS = 20, 79
_DOTS = 4000
_SURE = 3.0  # speed over its standard deviation, below which a turn rate means nothing
_SHORTEST, _LONGEST, _STRETCH = 2.0, 120.0, 1.5  # s, s, mean durations
_MARKS = 13
_RARE = 0.03


class CurvePoint(NamedTuple):
    """How well so many intents predict tracks that were not fitted: nats per row.

    low, high: 95 % interval of the difference to the best number, added to the best.
    """

    intents: int
    nats: float
    low: float
    high: float


def colour_of(number: int) -> str:
    """Of an intent, wherever it is drawn."""
    return MODE_COLOURS[number % len(MODE_COLOURS)]


def leaving_rates(model: IntentModel) -> Floats:
    """Rate at which each intent ends, in favour of another or of itself anew; (P,); 1/s."""
    return -np.diag(np.array(model.generator)) + np.array([intent.renewal for intent in model.intents])


def _lasting(model: IntentModel, number: int) -> float:
    """Mean duration of an intent with all its phases; s."""
    return sum(phase.duration for phase in model.intents[number].phases[:-1]) + 1.0 / leaving_rates(model)[number]


def plot_rollouts(path: Path, model: IntentModel, seed: int = 0) -> None:
    """How each intent moves: paths without noise from one start, parameters drawn from its births."""
    count = len(model.intents)
    columns = min(count, 4)
    rows = math.ceil(count / columns)
    with plt.rc_context(_STYLE):
        figure = plt.figure(figsize=(2.7 * columns + 0.3, 2.9 * rows), layout="constrained")
        _draw_rollouts(figure, model, rows, columns, seed)
        _save(figure, path)


def plot_graph(path: Path, model: IntentModel) -> None:
    """How the intents follow one another: share of the time, mean duration, and where each goes next."""
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(6.0, 4.6), layout="constrained")
        _draw_graph(axis, model)
        _save(figure, path)


def draw_model(path: Path, model: IntentModel, seed: int = 0) -> None:
    """Rollouts and graph in one picture, for `jink show`."""
    count = len(model.intents)
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    several = count > 1
    width = 2.6 * columns + (5.0 if several else 0.6)
    with plt.rc_context(_STYLE):
        figure = plt.figure(figsize=(width, max(2.8 * rows, 4.2)), layout="constrained")
        if several:
            left, right = figure.subfigures(1, 2, width_ratios=[2.6 * columns, 5.0])
            _draw_rollouts(left, model, rows, columns, seed)
            _draw_graph(right.subplots(), model)
        else:
            _draw_rollouts(figure, model, 1, 1, seed)
        _save(figure, path)


def plot_clusters(path: Path, model: IntentModel, tracks: Tracks, labels: NDArray[np.int64]) -> None:
    """Shape parameters of the rows of tracks, coloured by intent, with the births of each intent.

    Args:
        path: .png, .pdf or .svg.
        model: the intents.
        tracks: positions.
        labels: intent of each row; (B, T); negative: none.
    """
    sigma = None if model.noise_sd is None else float(np.sqrt(np.mean(np.square(model.noise_sd))))
    features = encode(tracks, choose_window(tracks, sigma), sigma)
    known = features.valid & (features.speed_ratio > _SURE) & (labels >= 0)
    chosen = np.flatnonzero(known)
    chosen = (
        chosen[np.linspace(0, len(chosen) - 1, min(_DOTS, len(chosen))).astype(np.int64)] if len(chosen) else chosen
    )
    eta, of = features.eta.reshape(-1, features.eta.shape[-1])[chosen], labels.ravel()[chosen]
    growth, turn = 100.0 * eta[:, 0], np.degrees(_turn(eta[:, 1:]))
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(6.4, 4.6 + 0.2 * len(model.intents)), layout="constrained")
        for number, intent in enumerate(model.intents):
            mine = of == number
            axis.plot(turn[mine], growth[mine], "o", ms=2.2, mew=0, color=colour_of(number), alpha=0.5, rasterized=True)
            said = f"{intent.name}: {', then '.join(describe_phase(phase) for phase in intent.phases)}"
            axis.plot([], [], "o", ms=5, color=colour_of(number), label=said)
            _draw_births(axis, model, number)
        for set_limits, values in ((axis.set_xlim, turn), (axis.set_ylim, growth)):
            if len(values):
                low, high = np.quantile(values, [0.003, 0.997])
                margin = 0.08 * max(high - low, 1e-3)
                set_limits(low - margin, high + margin)
        axis.set(
            xlabel="turn rate, deg/s" if model.axes == 2 else "size of the turn rate, deg/s",
            ylabel="growth of speed, %/s",
        )
        said = f"{len(chosen)} rows in windows of {features.window:.3g} s; ellipses: births, 2 sigma"
        axis.set_title(said, loc="left", fontsize=9)
        figure.legend(loc="outside lower left", frameon=False, fontsize=8)
        _save(figure, path)


def plot_curve(path: Path, trace: Sequence[Progress], curve: Sequence[CurvePoint], chosen: int) -> None:
    """Likelihood while fitting, and against the number of intents.

    Args:
        path: .png, .pdf or .svg.
        trace: reports that had a likelihood, in order.
        curve: one point per number of intents tried.
        chosen: number of intents of the model.
    """
    panels = [name for name, wanted in (("fit", len(trace) > 1), ("choice", len(curve) > 0)) if wanted]
    with plt.rc_context(_STYLE):
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
        _save(figure, path)


def sample_rollouts(model: IntentModel, number: int, rng: np.random.Generator, count: int = _SAMPLES) -> list[Floats]:
    """Paths (T, A) of an intent without noise, from the origin along x, parameters drawn from its births; m."""
    duration = sum(phase.duration for phase in model.intents[number].phases[:-1])
    duration = float(np.clip(duration + _STRETCH / max(leaving_rates(model)[number], 1e-9), _SHORTEST, _LONGEST))
    times = np.linspace(0.0, duration, _POINTS)
    start = np.zeros(2 * model.axes)
    start[model.axes] = typical_speed(model)
    paths = []
    for _ in range(count):
        sign, own = _draw_own(model, number, rng)
        paths.append(model.rollout(number, start, own, times, sign=sign))
    return paths


def typical_speed(model: IntentModel) -> float:
    """Root mean square of the speed; m/s."""
    return model.speed * math.sqrt(model.axes)


def _draw_rollouts(figure: Any, model: IntentModel, rows: int, columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    speed = typical_speed(model)
    kind = {"projection": "3d"} if model.axes == 3 else {}
    rates, shares = leaving_rates(model), model.intent_probs(model.mode_shares())
    for number, intent in enumerate(model.intents):
        axis = figure.add_subplot(rows, columns, number + 1, **kind)
        for place in sample_rollouts(model, number, rng):
            axis.plot(*place.T, "-", color=colour_of(number), lw=0.9, alpha=0.55, marker="o", ms=2, markevery=_MARKS)
        axis.plot(*np.zeros((model.axes, 1)), "o", color="black", ms=3)
        lasts = f"lasts {_lasting(model, number):.2g} s" if rates[number] > 0 else "never ends"
        axis.set_title(f"{intent.name}\n{100 * shares[number]:.0f} % of the time, {lasts}", fontsize=8)
        if model.axes == 2:
            axis.set_aspect("equal", adjustable="datalim")
            axis.margins(0.08)
        else:
            limits = np.array([axis.get_xlim(), axis.get_ylim(), axis.get_zlim()])
            half = 0.5 * float(np.ptp(limits, axis=1).max())
            for set_limits, (low, high) in zip((axis.set_xlim, axis.set_ylim, axis.set_zlim), limits, strict=True):
                set_limits(0.5 * (low + high) - half, 0.5 * (low + high) + half)
        axis.tick_params(labelsize=7)
        for side in (axis.xaxis, axis.yaxis, *([axis.zaxis] if model.axes == 3 else [])):
            side.set_major_locator(plt.MaxNLocator(4))
    said = f"m, from the black dot at {speed:.3g} m/s, for 1.5 mean durations, without noise"
    figure.supxlabel(f"{said};\ndots are equally far apart in time", fontsize=8)


def _draw_own(model: IntentModel, number: int, rng: np.random.Generator) -> tuple[int, Floats]:
    """A side and shape parameters (g, w[, u]) as an intent may begin with."""
    phase = model.intents[number].phases[0]
    weights = np.array([birth.weight for birth in phase.births])
    birth = phase.births[int(rng.choice(len(weights), p=weights / weights.sum()))]
    sign = int(rng.choice(phase.signs))
    turns = 1 if model.axes == 2 else 3
    normal = rng.normal(size=1 + 2 * turns)
    growth = birth.growth_mean + birth.growth_sd * normal[:1]
    turn = sign * birth.turn_mean + birth.turn_sd * normal[1 : 1 + turns]
    slope = (birth.swing_sd if phase.law.second_order else 0.0) * normal[1 + turns :]
    return sign, np.concatenate([growth, turn, slope if model.second_order else np.empty(0)])


def _draw_births(axis: Any, model: IntentModel, number: int) -> None:
    for phase in model.intents[number].phases:
        for birth in phase.births:
            for sign in phase.signs:
                if model.axes == 3:
                    # The size of a vector of three normal components lies about sqrt(8 / pi) of one of them.
                    centre, width = 1.6 * birth.turn_sd, 0.67 * birth.turn_sd
                else:
                    centre, width = sign * birth.turn_mean, birth.turn_sd
                axis.add_patch(
                    Ellipse(
                        (math.degrees(centre), 100.0 * birth.growth_mean),
                        4.0 * math.degrees(width),
                        400.0 * birth.growth_sd,
                        fill=False,
                        edgecolor=colour_of(number),
                        lw=1.4,
                        zorder=5,
                    )
                )


def _draw_graph(axis: Any, model: IntentModel) -> None:
    """Nodes by their share of the time; an arrow is as wide as it is probable."""
    shares, rates = model.intent_probs(model.mode_shares()), leaving_rates(model)
    graph = nx.DiGraph()
    for number, intent in enumerate(model.intents):
        lasts = f"{_lasting(model, number):.2g} s" if rates[number] > 0 else "for ever"
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
    axis.xaxis.set_major_locator(plt.MaxNLocator(integer=True))
    axis.set(xlabel="intents (bars: 95 % of the difference to the best)", ylabel="held out, nats per row")
    axis.set_title("choosing their number", loc="left", fontsize=9)


def _turn(rates: Floats) -> Floats:
    """Signed in the plane, the size of the vector in space."""
    return rates[:, 0] if rates.shape[1] == 1 else np.asarray(np.linalg.norm(rates, axis=1))


def _save(figure: Any, path: Path) -> None:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        figure.savefig(part, dpi=150, format=path.suffix[1:].lower())
        part.replace(path)
    finally:
        plt.close(figure)
        part.unlink(missing_ok=True)
