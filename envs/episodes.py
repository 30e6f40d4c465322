"""What the simulator hands to everybody: `Episodes`, and `Source`, whatever makes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from jink.envs.streams import Streams
from jink.envs.truth import Truth
from jink.estimators.sensor import Sensor

__all__ = ["Episodes", "Source", "join", "pick"]

Array = NDArray[np.float64]


class Episodes(NamedTuple):
    """Simulated or recorded episodes: B episodes, T samples, A axes, D measurement components; SI.

    Row b depends on its own draws alone. A missing component of a measurement is NaN. ``noise`` is the covariance the
    measurement error really had, given everything that scales it; a filter is told ``nominal_noise``.
    """

    times: Array  # (B, T) s, when the target was seen; times[:, 0] = 0
    delivery_times: Array  # (B, T) s, when each measurement reaches the tracker: `times + latency`
    truth: Truth  # at `times`
    delivered: Truth  # at `delivery_times`; `truth` itself without a latency
    measurements: Array  # (B, T, D)
    detected: NDArray[np.bool_]  # (B, T) whether any component is there
    scale: Array  # (B, T) factor on the nominal noise covariance, >= 0
    bias: Array  # (B, T, D) systematic part of the measurement error, in units of the measurement
    noise: Array  # (B, T, D, D)
    nominal_noise: Array  # (D, D)
    sensor_states: Array  # (B, T, 2 A) the sensor's own position, velocity
    prior_mean: Array  # (B, 2 A) what is known of position, velocity at times[:, 0] before any measurement
    prior_cov: Array  # (2 A, 2 A)


_SHARED = ("nominal_noise", "prior_cov")
"""What all episodes of a source have in common."""


def pick(episodes: Episodes, rows: NDArray[np.int64]) -> Episodes:
    """Some of the episodes, copied, in the order of ``rows`` (k,)."""
    truth = Truth._make(value[rows] for value in episodes.truth)
    late = truth
    if episodes.delivered is not episodes.truth:
        late = Truth._make(value[rows] for value in episodes.delivered)
    fields = {
        name: value if name in _SHARED else value[rows]
        for name, value in episodes._asdict().items()
        if name not in ("truth", "delivered")
    }
    return Episodes(truth=truth, delivered=late, **fields)


def join(parts: Sequence[Episodes]) -> Episodes:
    """Episodes of several batches of one source, one after the other.

    Raises:
        ValueError: they differ in what all episodes of a source share.
    """
    fields: dict[str, Any] = {}
    for name in Episodes._fields:
        values = [getattr(part, name) for part in parts]
        if name in ("truth", "delivered"):
            continue
        if name in _SHARED:
            if not all(np.array_equal(value, values[0]) for value in values[1:]):
                raise ValueError(
                    f"join: {name} must be the same in all parts; got others. Join episodes of one source."
                )
            fields[name] = values[0]
        else:
            fields[name] = np.concatenate(values)
    fields["truth"] = fields["delivered"] = _join_truths([part.truth for part in parts])
    if any(part.delivered is not part.truth for part in parts):
        fields["delivered"] = _join_truths([part.delivered for part in parts])
    return Episodes(**fields)


def _join_truths(truths: Sequence[Truth]) -> Truth:
    width = max(truth.switch_times.shape[1] for truth in truths)
    switches = np.full((sum(len(truth.switch_times) for truth in truths), width), np.nan)
    begin = 0
    for truth in truths:
        rows, columns = truth.switch_times.shape
        switches[begin : begin + rows, :columns] = truth.switch_times
        begin += rows
    fields = {
        name: np.concatenate([getattr(truth, name) for truth in truths])
        for name in Truth._fields
        if name != "switch_times"
    }
    return Truth(**fields, switch_times=switches)


class Source(Protocol):
    """Whatever gives episodes to an environment: a `Scenario`, or recorded tracks."""

    @property
    def id(self) -> str:
        """Name with version."""
        ...

    @property
    def axes(self) -> int:
        """Space dimensions, 2 or 3."""
        ...

    @property
    def sensor(self) -> Sensor:
        """What is measured, with its nominal noise."""
        ...

    @property
    def intents(self) -> tuple[str, ...]:
        """Names that `Truth.intent` points to."""
        ...

    @property
    def steps(self) -> int:
        """Samples of an episode; an environment makes ``steps - 1`` decisions with it."""
        ...

    @property
    def extent(self) -> float:
        """Positions stay within this distance of the origin along every axis, m."""
        ...

    @property
    def filter_noise(self) -> float:
        """White acceleration a sensible constant-velocity filter assumes here (spectral density), m^2/s^3."""
        ...

    def simulate(self, streams: Sequence[Streams]) -> Episodes:
        """One episode per entry; the generators advance by the same amount every time."""
        ...
