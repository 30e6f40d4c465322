"""Published scenarios that fly a fixed path: straight, at constant acceleration, or at constant turn rate."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from jink.envs.literature.published_truth import (
    Array,
    PublishedValue,
    ScenarioData,
    check_markov,
    check_number,
    check_runs,
    draw_sensor_noise,
)


@dataclass(frozen=True)
class Leg:
    """A piece of a path: constant acceleration, or constant turn rate (counter-clockwise positive).

    Args:
        duration: s, > 0.
        mode: name of the motion, one of the scenario's `mode_names`.
        turn_rate: rad/s; 0 means no turn.
        acceleration: (ax, ay) m/s^2; must be zero in a turn.
    Raises:
        ValueError: a duration that is not positive, or a turn with an acceleration.
    """

    duration: float
    mode: str
    turn_rate: float = 0.0
    acceleration: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_number("Leg", "duration", self.duration)
        if not np.all(np.isfinite((self.turn_rate, *self.acceleration))):
            raise ValueError(
                f"Leg: turn_rate and acceleration must be finite; got {self.turn_rate!r}, "
                f"{self.acceleration!r}. Use 0 for none."
            )
        if self.turn_rate != 0.0 and any(self.acceleration):
            raise ValueError(
                f"Leg: acceleration must be (0, 0) in a turn; got {self.acceleration} with turn_rate="
                f"{self.turn_rate}. Split it into two legs."
            )

    def propagate(self, start: Array, elapsed: Array) -> Array:
        """Exact state after `elapsed` seconds of this leg.

        Model: p' = v; v' = a, or v' = w (-vy, vx).

        Args:
            start: (4,) x, vx, y, vy at the start of the leg.
            elapsed: (K,) s.
        Returns:
            (K, 4) x, vx, y, vy.
        Source: closed form. Differs: none.
        """
        x, vx, y, vy = start
        t, w = elapsed, self.turn_rate
        if w == 0.0:
            ax, ay = self.acceleration
            columns = (x + vx * t + ax * t**2 / 2, vx + ax * t, y + vy * t + ay * t**2 / 2, vy + ay * t)
        else:
            s, c = np.sin(w * t), np.cos(w * t)
            along, across = s / w, 2 * np.sin(w * t / 2) ** 2 / w
            columns = (
                x + along * vx - across * vy,
                c * vx - s * vy,
                y + across * vx + along * vy,
                s * vx + c * vy,
            )
        return np.stack(columns, axis=-1)


@dataclass(frozen=True)
class LegScenario:
    """A fixed path of legs in the plane, seen by a position sensor.

    Args:
        id, title, source: name with version, one line, where it comes from.
        dt: s between samples.
        start: (x, vx, y, vy) at time 0; m, m/s.
        legs: flown in order; the last sample is the last multiple of `dt` within them.
        sigma: standard deviation of the position per axis, m.
        mode_names: motions, in the order of the filter bank that the source used.
        mode_transition, mode_probs0: Markov matrix (row = from) and start of that bank, or None.
        published: numbers to compare with.
    Raises:
        ValueError: a number out of range, no legs, an unknown mode, or rows that do not sum to 1.
    """

    id: str
    title: str
    source: str
    dt: float
    start: tuple[float, float, float, float]
    legs: tuple[Leg, ...]
    sigma: float
    mode_names: tuple[str, ...]
    mode_transition: tuple[tuple[float, ...], ...] | None = None
    mode_probs0: tuple[float, ...] | None = None
    published: Mapping[str, PublishedValue] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_number(self.id, "dt", self.dt)
        check_number(self.id, "sigma", self.sigma)
        object.__setattr__(self, "published", MappingProxyType(dict(self.published)))
        if not self.legs or not np.all(np.isfinite(self.start)) or len(self.start) != 4:
            raise ValueError(
                f"{self.id}: start must be four finite numbers and legs must not be empty; "
                f"got start={self.start}, {len(self.legs)} legs. Give start as (x, vx, y, vy)."
            )
        for leg in self.legs:
            if leg.mode not in self.mode_names:
                raise ValueError(
                    f"{self.id}: a leg's mode must be one of {', '.join(self.mode_names)}; got {leg.mode!r}. "
                    "Add it to mode_names."
                )
        if (self.mode_transition is None) != (self.mode_probs0 is None):
            raise ValueError(
                f"{self.id}: mode_transition and mode_probs0 must be given together; got only one of them. Give both."
            )
        if self.mode_transition is not None and self.mode_probs0 is not None:
            check_markov(self.id, np.array(self.mode_transition), np.array(self.mode_probs0), len(self.mode_names))

    def fly(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """The path without noise.

        Returns:
            times (T,) s; state (T, 4) x, vx, y, vy; mode of the step that ends at each sample (T,).
        """
        ends = np.cumsum([leg.duration for leg in self.legs])
        times = self.dt * np.arange(int(np.floor(ends[-1] / self.dt + 1e-9)) + 1, dtype=np.float64)
        # A sample on a boundary belongs to the leg that ends there: it moved the target during the step.
        owner = np.minimum(np.searchsorted(ends, times - 1e-9 * self.dt), len(self.legs) - 1)
        state = np.empty((times.size, 4))
        at_start = np.array(self.start, dtype=float)
        for index, leg in enumerate(self.legs):
            rows = owner == index
            state[rows] = leg.propagate(at_start, times[rows] - (ends[index] - leg.duration))
            at_start = leg.propagate(at_start, np.array([leg.duration]))[0]
        indices = [self.mode_names.index(leg.mode) for leg in self.legs]
        modes = np.array(indices, dtype=np.int64)[owner]
        return times, state, modes

    def simulate(self, runs: int, seed: int) -> ScenarioData:
        """Draws `runs` noisy looks at the path.

        Args:
            runs: number of runs, >= 1.
            seed: experiment seed, >= 0; run i is the same whatever `runs` is.
        Returns:
            the runs; no prior (start a filter from its first measurements).
        Raises:
            ValueError: runs or seed out of range.
        """
        check_runs(f"{self.id}.simulate", runs, seed)
        times, path, mode = self.fly()
        state = np.repeat(path[None], runs, axis=0)
        position = state[..., [0, 2]]
        unit = draw_sensor_noise(seed, runs, times.size, 2)
        return ScenarioData(
            times=times,
            state=state,
            state_labels=("x", "vx", "y", "vy"),
            position=position,
            velocity=state[..., [1, 3]],
            measurements=position + self.sigma * unit,
            noise=self.sigma**2 * np.eye(2),
            modes=np.repeat(mode[None], runs, axis=0),
            mode_names=self.mode_names,
            mode_transition=None if self.mode_transition is None else np.array(self.mode_transition),
            mode_probs0=None if self.mode_probs0 is None else np.array(self.mode_probs0),
            prior_mean=None,
            prior_cov=None,
            published=self.published,
        )
