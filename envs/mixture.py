"""Several scenarios as one source: every episode is one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.envs.episodes import Episodes, Source
from jink.envs.streams import Streams
from jink.envs.truth import Truth
from jink.estimators.sensor import Sensor

__all__ = ["Mixture"]


@dataclass(frozen=True)
class Mixture:
    """Every episode draws one of several sources, all alike, from its motion stream; a source itself.

    Its `intents` are those of all parts; `extent` and `filter_noise` the largest.

    Args:
        id: name.
        parts: the sources.

    Raises:
        ValueError: no parts, or parts that differ in what a space or a filter is made of: axes, sensor, samples.
    """

    id: str
    parts: tuple[Source, ...]

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError(f"{self.id}: parts must be one source or more; got none. Name scenarios.")
        first = self.parts[0]
        for part in self.parts[1:]:
            for name, ours, theirs in (
                ("axes", first.axes, part.axes),
                ("samples", first.steps, part.steps),
                ("sensor", _sensor(first.sensor), _sensor(part.sensor)),
            ):
                if ours != theirs:
                    raise ValueError(
                        f"{self.id}: scenarios must have the same {name}; got {ours} in {first.id} and {theirs} in "
                        f"{part.id}. Choose one with scenario=."
                    )

    @property
    def axes(self) -> int:
        """Space dimensions, 2 or 3."""
        return self.parts[0].axes

    @property
    def sensor(self) -> Sensor:
        """What is measured, with its nominal noise."""
        return self.parts[0].sensor

    @property
    def intents(self) -> tuple[str, ...]:
        """Names that `Truth.intent` points to: those of all parts, each once."""
        return tuple(dict.fromkeys(name for part in self.parts for name in part.intents))

    @property
    def steps(self) -> int:
        """Samples of an episode."""
        return self.parts[0].steps

    @property
    def extent(self) -> float:
        """Positions stay within this distance of the origin along every axis, m."""
        return max(part.extent for part in self.parts)

    @property
    def filter_noise(self) -> float:
        """White acceleration a sensible filter of the wildest part assumes, m^2/s^3."""
        return max(part.filter_noise for part in self.parts)

    def simulate(self, streams: Sequence[Streams]) -> Episodes:
        """One episode per entry.

        Raises:
            ValueError: the parts give different prior covariances.
        """
        which = np.array([int(row[0].integers(len(self.parts))) for row in streams], dtype=np.int64)
        rows = [np.flatnonzero(which == number) for number in range(len(self.parts))]
        made = [
            (self.parts[i], at, self.parts[i].simulate([streams[r] for r in at.tolist()]))
            for i, at in enumerate(rows)
            if len(at)
        ]
        if len(made) == 1:
            part, _, episodes = made[0]
            return episodes._replace(
                truth=self._named(part, episodes.truth), delivered=self._named(part, episodes.delivered)
            )
        order = np.argsort(np.concatenate([at for _, at, _ in made]))
        first = made[0][2]
        for part, _, episodes in made[1:]:
            if not np.array_equal(episodes.prior_cov, first.prior_cov):
                raise ValueError(
                    f"{self.id}: scenarios must have the same start_sigma; {made[0][0].id} and {part.id} differ. "
                    "Give start_sigma, or choose one with scenario=."
                )
        fields: dict[str, Any] = {}
        for name in Episodes._fields:
            values = [getattr(episodes, name) for _, _, episodes in made]
            if name in ("truth", "delivered"):
                fields[name] = _stack(
                    [self._named(part, truth) for (part, _, _), truth in zip(made, values, strict=True)], order
                )
            elif name in ("nominal_noise", "prior_cov"):
                fields[name] = values[0]
            else:
                fields[name] = np.concatenate(values)[order]
        return Episodes(**fields)

    def _named(self, part: Source, truth: Truth) -> Truth:
        """Intents of one part as indices into those of all; -1 stays what it is."""
        names = self.intents
        places = np.array([*(names.index(name) for name in part.intents), -1], dtype=np.int8)
        return truth._replace(intent=places[truth.intent])


def _sensor(sensor: Sensor) -> str:
    sigmas = ", ".join(
        f"{label} {sigma:g} {unit}" for label, sigma, unit in zip(sensor.labels, sensor.sigma, sensor.units)
    )
    places = f" at {sensor.params}" if sensor.params else ""
    return f"{sensor.name}{places} (sigma {sigmas})"


def _stack(truths: list[Truth], order: NDArray[np.int64]) -> Truth:
    width = max(truth.switch_times.shape[1] for truth in truths)
    switches = [
        np.pad(truth.switch_times, ((0, 0), (0, width - truth.switch_times.shape[1])), constant_values=np.nan)
        for truth in truths
    ]
    fields = {
        name: np.concatenate([getattr(truth, name) for truth in truths])[order]
        for name in Truth._fields
        if name != "switch_times"
    }
    return Truth(**fields, switch_times=np.concatenate(switches)[order])
