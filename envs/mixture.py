"""Several scenarios as one source: every episode is one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jink.envs.episodes import Episodes, Source, join, pick
from jink.envs.streams import Streams
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
        names = self.intents
        made = [
            (self.parts[i], at, _named(names, self.parts[i], self.parts[i].simulate([streams[r] for r in at.tolist()])))
            for i, at in enumerate(rows)
            if len(at)
        ]
        if len(made) == 1:
            return made[0][2]
        first = made[0][2]
        for part, _, episodes in made[1:]:
            if not np.array_equal(episodes.prior_cov, first.prior_cov):
                raise ValueError(
                    f"{self.id}: scenarios must have the same start_sigma; {made[0][0].id} and {part.id} differ. "
                    "Give start_sigma, or choose one with scenario=."
                )
        order = np.argsort(np.concatenate([at for _, at, _ in made]))
        return pick(join([episodes for _, _, episodes in made]), order)


def _named(names: tuple[str, ...], part: Source, episodes: Episodes) -> Episodes:
    """Intents of one part as indices into those of all; -1 stays what it is."""
    places = np.array([*(names.index(name) for name in part.intents), -1], dtype=np.int8)
    truth = late = episodes.truth._replace(intent=places[episodes.truth.intent])
    if episodes.delivered is not episodes.truth:
        late = episodes.delivered._replace(intent=places[episodes.delivered.intent])
    return episodes._replace(truth=truth, delivered=late)


def _sensor(sensor: Sensor) -> str:
    sigmas = ", ".join(
        f"{label} {sigma:g} {unit}" for label, sigma, unit in zip(sensor.labels, sensor.sigma, sensor.units)
    )
    places = f" at {sensor.params}" if sensor.params else ""
    return f"{sensor.name}{places} (sigma {sigmas})"
