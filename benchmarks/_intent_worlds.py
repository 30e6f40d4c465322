"""Worlds for the study of learnt intents: targets simulated by `jink.envs`, and the best bank one can write for them.

A bank of true laws knows every law, every prior, every sojourn and the speed, and its noise scales are tuned by
likelihood on tracks of their own. It is what a learner is measured against, so it must not be a strawman.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jink.envs.flight.dwells import Dwell
from jink.envs.flight.limits import Limits, Start
from jink.envs.intents import Accelerate, StopAndGo, Straight, Turn, Weave
from jink.envs.manoeuvres import Manoeuvres
from jink.envs.sampling import Regular
from jink.envs.scenario import Scenario
from jink.envs.sensing import Sensing
from jink.envs.simulate import simulate_tracks
from jink.estimators.bank import Bank, Mode
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion, motion
from jink.estimators.motions import constant_velocity, coordinated_turn
from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks

__all__ = ["SIGMA", "WORLDS", "World", "simulate", "true_bank"]

Floats = NDArray[np.float64]
DEGREE = math.pi / 180.0
SIGMA = 20.0  # m
TURNS = (3.0 * DEGREE, 12.0 * DEGREE)  # rad/s
PUSHES = (3.0, 8.0)  # m/s^2
WEAVES = (0.35, 0.6, 10.5, 12.5)  # amplitude (rad), period (s)
STOPS = (14.0, 24.0)  # m/s^2


def _along(x: NDArray[np.float64], dt: float, params: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    speed = math.sqrt(x[1] * x[1] + x[3] * x[3])
    push = x[4] / max(speed, 1.0)
    gain = max(1.0 + push * dt, 0.0)
    reach = dt * (1.0 + 0.5 * push * dt) if gain > 0.0 else -0.5 / push
    out[0] = x[0] + reach * x[1]
    out[1] = gain * x[1]
    out[2] = x[2] + reach * x[3]
    out[3] = gain * x[3]
    out[4] = x[4]


def push(wobble: float, drift: float, mean: float, sd: float) -> Motion:
    """The true law of `Accelerate`: a constant acceleration along the path."""
    return motion(
        "x vx y vy s",
        name="push",
        diffusion={"vx": wobble, "vy": wobble, "s": drift},
        birth={"s": (mean, sd)},
        jet_order=2,
    )(_along)


def _meander(x: NDArray[np.float64], dt: float, params: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    rate, turn, swing = x[6], x[4], x[5]
    c, s = math.cos(rate * dt), math.sin(rate * dt)
    half_c, half_s = math.cos(0.5 * rate * dt), math.sin(0.5 * rate * dt)
    safe = rate if abs(rate) > 1e-3 else 1e-3
    middle = turn * half_s / safe + swing * (1.0 - half_c) / safe / safe
    angle = turn * s / safe + swing * (1.0 - c) / safe / safe
    # Simpson's rule for the path: the heading at the start, half way and at the end of the step
    along = dt * (1.0 + 4.0 * math.cos(middle) + math.cos(angle)) / 6.0
    across = dt * (4.0 * math.sin(middle) + math.sin(angle)) / 6.0
    out[0] = x[0] + along * x[1] - across * x[3]
    out[2] = x[2] + across * x[1] + along * x[3]
    out[1] = math.cos(angle) * x[1] - math.sin(angle) * x[3]
    out[3] = math.sin(angle) * x[1] + math.cos(angle) * x[3]
    out[4] = c * turn + s * swing / safe
    out[5] = c * swing - safe * s * turn
    out[6] = rate


def meander(wobble: float, drift: float) -> Motion:
    """The true law of `Weave`: a turn rate that swings, with its natural rate in the state.

    A weave begins along the course: turn rate ``a W`` at its largest and no swing.
    """
    low, high, short, long = WEAVES
    rates = 2.0 * math.pi / np.array([short, long])
    rate, rate_sd = float(rates.mean()), float(rates[0] - rates[1]) / math.sqrt(12.0)
    turn = float(np.hypot(0.5 * (low + high), (high - low) / math.sqrt(12.0)) * rate)
    return motion(
        "x vx y vy w u r",
        name="meander",
        diffusion={"vx": wobble, "vy": wobble, "u": drift},
        birth={"w": (0.0, turn), "u": (0.0, 0.05 * turn * rate), "r": (rate, rate_sd)},
        jet_order=2,
    )(_meander)


@dataclass(frozen=True)
class World:
    """Targets, how long their intents last, and how their true bank is written.

    Args:
        name: of the world.
        behaviours: of the targets.
        start: noise scales of the true bank where tuning begins; logs.
        size: scale of lengths: positions, speeds and accelerations are so many times those of the reference.
        dt: s.
        steps: rows per track.
        turned: rotation of the whole scene; rad.
    """

    name: str
    behaviours: tuple[str, ...]
    size: float = 1.0
    dt: float = 1.0
    steps: int = 100
    turned: float = 0.0

    @property
    def intents(self) -> int:
        """How many there are."""
        return len(self.behaviours)

    def motion(self) -> Manoeuvres:
        """The target."""
        size = self.size
        known = {
            "straight": Straight(dwell=Dwell(18.0, 6.0)),
            "turn": Turn(dwell=Dwell(14.0, 5.0), rate=TURNS),
            "accelerate": Accelerate(dwell=Dwell(12.0, 5.0), acceleration=(PUSHES[0] * size, PUSHES[1] * size)),
            "weave": Weave(dwell=Dwell(25.0, 12.0), amplitude=WEAVES[:2], period=WEAVES[2:]),
            "stop-and-go": StopAndGo(
                dwell=Dwell(30.0, 18.0), braking=(STOPS[0] * size, STOPS[1] * size),
                starting=(STOPS[0] * size, STOPS[1] * size),
            ),
        }  # fmt: skip
        slowest = 15.0 if "stop-and-go" in self.behaviours else 80.0
        return Manoeuvres(
            behaviours=tuple(known[name] for name in self.behaviours),
            limits=Limits(speed=(slowest * size, 330.0 * size), lateral=15.0 * size),
            start=Start(speed=(150.0 * size, 250.0 * size), x=(-2e4 * size, 2e4 * size), y=(-2e4 * size, 2e4 * size)),
        )

    def scenario(self) -> Scenario:
        """The target before its sensor."""
        return Scenario(
            f"{self.name}-v0", self.name, "learn", self.motion(), Sensing(position(2, SIGMA)),
            Regular(self.steps, self.dt),
        )  # fmt: skip

    def with_(self, **changes: object) -> World:
        """A copy with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


WORLDS: dict[str, World] = {
    "three": World("three", ("straight", "turn", "accelerate")),
    "five": World("five", ("straight", "turn", "accelerate", "weave", "stop-and-go")),
}
"""The two worlds by name."""


def simulate(world: World, count: int, seed: int) -> Tracks:
    """Tracks of a world; the same seed gives the same tracks."""
    tracks = simulate_tracks(world.scenario(), count, seed)
    if world.turned == 0.0:
        return tracks
    c, s = math.cos(world.turned), math.sin(world.turned)
    turn = np.array([[c, s], [-s, c]])
    noise = tracks.measurements - tracks.truth
    return replace(
        tracks,
        measurements=tracks.truth @ turn + noise,
        truth=tracks.truth @ turn,
        truth_velocity=tracks.truth_velocity @ turn,
    )


def true_bank(world: World, logs: Floats) -> Bank:
    """The bank of true laws.

    Args:
        world: whose laws they are.
        logs: logs of its scales, see `start_scales`.

    Returns:
        A bank in which a switch is a birth; left and right, faster and slower are modes of their own.
    """
    size = world.size
    q = np.exp(logs)
    modes: list[Mode] = []
    owner: list[int] = []
    share: list[float] = []

    def add(intent: int, name: str, made: Motion, weight: float) -> None:
        modes.append(Mode(name, made, intent=name))
        owner.append(intent)
        share.append(weight)

    at, rates = 0, np.zeros(world.intents)
    for i, behaviour in enumerate(world.behaviours):
        wobble, drift, rates[i] = q[at] * size**2, q[at + 1], 1.0 / q[at + 2]
        at += 3
        if behaviour == "straight":
            add(i, "straight", constant_velocity(2, acceleration_density=wobble), 1.0)
        elif behaviour == "turn":
            middle, spread = 0.5 * (TURNS[0] + TURNS[1]), (TURNS[1] - TURNS[0]) / math.sqrt(12.0)
            for side in (1, -1):
                made = coordinated_turn(
                    acceleration_density=wobble, rate_density=drift, rate=side * middle, rate_sd=spread
                )
                add(i, f"turn {side}", made, 0.5)
        elif behaviour == "accelerate":
            middle, spread = 0.5 * (PUSHES[0] + PUSHES[1]), (PUSHES[1] - PUSHES[0]) / math.sqrt(12.0)
            for side in (1, -1):
                add(i, f"push {side}", push(wobble, drift * size**2, side * middle * size, spread * size), 0.5)
        elif behaviour == "weave":
            add(i, "weave", meander(wobble, drift), 1.0)
        else:
            middle, spread = 0.5 * (STOPS[0] + STOPS[1]), (STOPS[1] - STOPS[0]) / math.sqrt(12.0)
            parts = (("brake", -1.0), ("wait", 0.0), ("go", 1.0))
            for name, side in parts:
                made = push(wobble, drift * size**2, side * middle * size, spread * size) if side else (
                    constant_velocity(2, acceleration_density=q[at + 2] * size**2)
                )  # fmt: skip
                add(i, name, made, 1.0 if name == "brake" else 0.0)
            braking, waiting = q[at], q[at + 1]
            at += 3
    count = len(modes)
    generator = np.zeros((count, count))
    for a in range(count):
        i = owner[a]
        leaving = rates[i]
        if modes[a].name in ("brake", "wait"):
            generator[a, a + 1] = 1.0 / (braking if modes[a].name == "brake" else waiting)
            continue
        for b in range(count):
            if owner[b] != i:
                generator[a, b] = leaving * share[b] / (world.intents - 1)
    np.fill_diagonal(generator, -generator.sum(axis=1))
    initial = np.array(share) / world.intents
    return Bank(
        tuple(modes),
        position(2, SIGMA),
        chain=MarkovChain(generator=tuple(map(tuple, generator))),
        initial_probs=tuple(initial),
        interaction="birth",
        speed=203.0 * size / math.sqrt(2.0),
    )


def start_scales(world: World) -> Floats:
    """Logs of the true bank's scales where tuning begins.

    Per intent: white acceleration (m^2/s^3 at size 1), drift of its own parameter, sojourn (s); a stop adds how long
    braking and waiting last (s) and the white acceleration while waiting.
    """
    drifts = {"straight": 1.0, "turn": 1e-5, "accelerate": 1e-2, "weave": 1e-5, "stop-and-go": 1e-2}
    sojourns = {"straight": 18.0, "turn": 14.0, "accelerate": 12.0, "weave": 25.0, "stop-and-go": 9.0}
    scales: list[float] = []
    for behaviour in world.behaviours:
        scales += [0.3, drifts[behaviour], sojourns[behaviour]]
        scales += [9.0, 10.0, 1.0] if behaviour == "stop-and-go" else []
    return np.log(scales)
