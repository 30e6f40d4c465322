"""Pictures of a model of intents: how each moves, and where the rows of tracks lie among them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.describing import describe_phase
from jink.intent.features import encode
from jink.intent.model import IntentModel
from jink.intent.window import choose_window
from jink.training.intent_drawing import STYLE, colour_of, leaving_rates, save_figure
from jink.training.intent_graphs import draw_graph

__all__ = ["draw_model", "plot_clusters", "plot_rollouts", "sample_rollouts", "typical_speed"]

Floats = NDArray[np.float64]
_SAMPLES, _POINTS = 20, 79
_DOTS = 4000
_SURE = 3.0  # speed over its standard deviation, below which a turn rate means nothing
_ROWS = 7.0  # median time steps, below which a window says nothing
_SHORTEST, _LONGEST, _STRETCH = 2.0, 120.0, 1.5  # s, s, mean durations
_MARKS = 13
_FAR = 4.0
_CLEAR, _SEEN = 0.8, (0.01, 0.99)  # shares of rows that are drawn, and that limits of axes hold at least


def plot_rollouts(path: Path, model: IntentModel, seed: int = 0) -> None:
    """How each intent moves: paths without noise from one start, parameters drawn from its births."""
    count = len(model.intents)
    columns = min(count, 4)
    rows = math.ceil(count / columns)
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(2.7 * columns + 0.3, 2.9 * rows), layout="constrained")
        _draw_rollouts(figure, model, rows, columns, seed)
        save_figure(figure, path)


def draw_model(path: Path, model: IntentModel, seed: int = 0) -> None:
    """Rollouts and graph in one picture, for `jink show`."""
    count = len(model.intents)
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    several = count > 1
    width = 2.6 * columns + (5.0 if several else 0.6)
    with plt.rc_context(STYLE):
        figure = plt.figure(figsize=(width, max(2.8 * rows, 4.2)), layout="constrained")
        if several:
            halves: Any = figure.subfigures(1, 2, width_ratios=[2.6 * columns, 5.0])
            left, right = halves
            _draw_rollouts(left, model, rows, columns, seed)
            draw_graph(right.subplots(), model)
        else:
            _draw_rollouts(figure, model, 1, 1, seed)
        save_figure(figure, path)


def plot_clusters(path: Path, model: IntentModel, tracks: Tracks, labels: NDArray[np.int64]) -> None:
    """Shape parameters of the rows of tracks, coloured by intent, with the births of each intent.

    Args:
        path: .png, .pdf or .svg.
        model: the intents.
        tracks: positions.
        labels: intent of each row; (B, T); negative: none.
    """
    sigma = None if model.noise_sd is None else float(np.sqrt(np.mean(np.square(model.noise_sd))))
    features = encode(tracks, _window(model, tracks, sigma), sigma)
    known = features.valid & (features.speed_ratio > _SURE) & (labels >= 0)
    if known.any():  # rows of which little is known hide the others
        doubt = np.trace(features.eta_cov[..., 1:, 1:], axis1=2, axis2=3)
        known &= doubt <= np.quantile(doubt[known], _CLEAR)
    chosen = np.flatnonzero(known)
    chosen = (
        chosen[np.linspace(0, len(chosen) - 1, min(_DOTS, len(chosen))).astype(np.int64)] if len(chosen) else chosen
    )
    eta, of = features.eta.reshape(-1, features.eta.shape[-1])[chosen], labels.ravel()[chosen]
    growth, turn = 100.0 * eta[:, 0], np.degrees(_turn(eta[:, 1:]))
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(6.4, 4.6 + 0.2 * len(model.intents)), layout="constrained")
        for number, intent in enumerate(model.intents):
            mine = of == number
            axis.plot(turn[mine], growth[mine], "o", ms=2.2, mew=0, color=colour_of(number), alpha=0.5, rasterized=True)
            said = f"{intent.name}: {', then '.join(describe_phase(phase) for phase in intent.phases)}"
            axis.plot([], [], "o", ms=5, color=colour_of(number), label=said)
            _draw_births(axis, model, number)
        births = _extent(model)
        for set_limits, values, reach in ((axis.set_xlim, turn, births[0]), (axis.set_ylim, growth, births[1])):
            if len(values):
                low, high = np.quantile(values, _SEEN)
                room = max(high - low, 1e-3)
                low, high = max(min(low, reach[0]), low - 0.5 * room), min(max(high, reach[1]), high + 0.5 * room)
                margin = 0.08 * (high - low)
                set_limits(low - margin, high + margin)
        axis.set(
            xlabel="turn rate, deg/s" if model.axes == 2 else "size of the turn rate, deg/s",
            ylabel="growth of speed, %/s",
        )
        said = f"{len(chosen)} rows in windows of {features.window:.3g} s; ellipses: births, 2 sigma"
        axis.set_title(said, loc="left", fontsize=9)
        figure.legend(loc="outside lower left", frameon=False, fontsize=8)
        save_figure(figure, path)


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
    shares = model.intent_probs(model.mode_shares())
    for number, intent in enumerate(model.intents):
        axis = figure.add_subplot(rows, columns, number + 1, **kind)
        for place in _within_reach(sample_rollouts(model, number, rng)):
            axis.plot(*place.T, "-", color=colour_of(number), lw=0.9, alpha=0.55, marker="o", ms=2, markevery=_MARKS)
        axis.plot(*np.zeros((model.axes, 1)), "o", color="black", ms=3)
        lasts = model.spell_lasting(number)
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
            side.set_major_locator(MaxNLocator(4))
    said = f"m, from the black dot at {speed:.3g} m/s, for 1.5 mean durations, without noise"
    figure.supxlabel(f"{said};\ndots are equally far apart in time", fontsize=8)


def _within_reach(paths: list[Floats]) -> list[Floats]:
    """Paths cut where they go several times as far as most do: a rare birth may grow without end."""
    reach = _FAR * float(np.median([np.linalg.norm(path, axis=1).max() for path in paths]))
    return [np.where(np.linalg.norm(path, axis=1, keepdims=True) <= reach, path, np.nan) for path in paths]


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


def _window(model: IntentModel, tracks: Tracks, sigma: float | None) -> float:
    """The encoder's window, but no longer than intents last on average."""
    chosen = choose_window(tracks, sigma)
    last = [model.lasting(number) for number in range(len(model.intents))]
    steps = np.diff(tracks.times, axis=1)[tracks.used[:, 1:]]
    shortest = _ROWS * float(np.median(steps[steps > 0]))
    return max(min([chosen, *last]), min(chosen, shortest))


def _extent(model: IntentModel) -> tuple[tuple[float, float], tuple[float, float]]:
    """Reach of the births at two standard deviations: turn rate, deg/s, and growth, %/s."""
    births = [birth for intent in model.intents for phase in intent.phases for birth in phase.births]
    turn = max(math.degrees(abs(birth.turn_mean) + 2.0 * birth.turn_sd) for birth in births)
    low = min(100.0 * (birth.growth_mean - 2.0 * birth.growth_sd) for birth in births)
    high = max(100.0 * (birth.growth_mean + 2.0 * birth.growth_sd) for birth in births)
    return (-turn if model.axes == 2 else 0.0, turn), (low, high)


def _turn(rates: Floats) -> Floats:
    """Signed in the plane, the size of the vector in space."""
    return rates[:, 0] if rates.shape[1] == 1 else np.asarray(np.linalg.norm(rates, axis=1))
