"""Exact truth and measurements for scenarios whose results are published.

What the kinds of scenario share: `published_legs` flies a fixed path, `published_jump` draws a jump Markov
linear system. All of it is plain numpy on purpose: it shares no code with the filters, so that agreement with
published numbers tests both.

Conventions: `modes[b, k]` is the mode of the step that ends at sample k (k = 0: the initial mode). A prior,
where the source gives one, is the belief at `times[0]` before `measurements[:, 0]` is used.
"""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
STREAMS = {"truth": 0, "sensor": 1, "modes": 2}


class PublishedValue(NamedTuple):
    """One number to compare with: value, interval (None where the source has none), metric, source."""

    value: float
    interval: tuple[float, float] | None
    metric: str
    source: str


class ScenarioData(NamedTuple):
    """Simulated runs of one scenario: B runs, T samples, n state, A axes, D measurement, M modes; SI."""

    times: Array  # (T,) s
    state: Array  # (B, T, n) truth
    state_labels: tuple[str, ...]
    position: Array  # (B, T, A) m
    velocity: Array  # (B, T, A) m/s
    measurements: Array  # (B, T, D) m
    noise: Array  # (D, D) m^2
    modes: NDArray[np.int64]  # (B, T)
    mode_names: tuple[str, ...]
    mode_transition: Array | None  # (M, M), row = from, column = to
    mode_probs0: Array | None  # (M,) at times[0]
    prior_mean: Array | None  # (n,)
    prior_cov: Array | None  # (n, n)
    published: Mapping[str, PublishedValue]


class Scenario(Protocol):
    """What every published scenario offers."""

    @property
    def id(self) -> str:
        """Name, ends in a version."""
        ...

    @property
    def title(self) -> str:
        """One line for tables."""
        ...

    @property
    def source(self) -> str:
        """Where the parameters come from, and where we differ."""
        ...

    @property
    def published(self) -> Mapping[str, PublishedValue]:
        """Numbers to compare with, by name."""
        ...

    def simulate(self, runs: int, seed: int) -> ScenarioData:
        """Truth and measurements of `runs` runs."""
        ...


def make_stream(name: str, seed: int, run: int) -> np.random.Generator:
    """Random numbers of one named stream of one run; independent of every other stream and run.

    Args:
        name: a key of `STREAMS`.
        seed: the experiment's seed, >= 0.
        run: index of the run; its numbers do not depend on how many runs are asked for.
    Returns:
        a generator; the same three arguments give the same bits.
    """
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(STREAMS[name], run)))


def check_runs(caller: str, runs: int, seed: int) -> None:
    """Refuses a run count below one or a negative seed.

    Raises:
        ValueError: runs < 1 or seed < 0, or either is not an integer.
    """
    for name, value, least in (("runs", runs, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
            raise ValueError(
                f"{caller}: {name} must be an integer >= {least}; got {value!r}. "
                f"Pass for example {name}={max(least, 1)}."
            )


def check_number(caller: str, name: str, value: float, low: float = 0.0) -> None:
    """Refuses a number that is not finite or not above `low`.

    Raises:
        ValueError: value is NaN, infinite or <= low.
    """
    if not (np.isfinite(value) and value > low):
        raise ValueError(f"{caller}: {name} must be finite and > {low:g}; got {value!r}. Give it in SI units.")


def freeze(value: ArrayLike) -> Array:
    """A read-only float64 copy."""
    array = np.array(value, dtype=np.float64)
    array.setflags(write=False)
    return array


def check_shape(caller: str, name: str, value: Array, shape: tuple[int, ...]) -> None:
    """Refuses an array of another shape, or one that is not finite.

    Raises:
        ValueError: wrong shape, NaN or infinity.
    """
    if value.shape != shape or not np.all(np.isfinite(value)):
        raise ValueError(
            f"{caller}: {name} must be finite with shape {shape}; got shape {value.shape}. "
            "Check the mode count and state_labels."
        )


def check_markov(caller: str, transition: Array, probs0: Array, modes: int) -> None:
    """Refuses mode probabilities that are not a Markov matrix (rows sum to 1) and a distribution.

    Raises:
        ValueError: wrong shape, a negative entry, or a sum that differs from 1 by more than 1e-9.
    """
    for name, value, shape in (
        ("mode_transition", transition, (modes, modes)),
        ("mode_probs0", probs0, (modes,)),
    ):
        if value.shape != shape or np.any(value < 0) or np.any(np.abs(value.sum(-1) - 1) > 1e-9):
            raise ValueError(
                f"{caller}: {name} must have shape {shape}, entries >= 0 and rows that sum to 1; "
                f"got {value.tolist()}. Row = from, column = to."
            )


def draw_sensor_noise(seed: int, runs: int, steps: int, axes: int) -> Array:
    """Unit sensor noise, (runs, steps, axes); the caller scales it, so sigma never moves the truth."""
    return np.stack([make_stream("sensor", seed, run).standard_normal((steps, axes)) for run in range(runs)])
