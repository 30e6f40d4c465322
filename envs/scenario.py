"""A scenario: what moves, when it is looked at, how it is seen, and what goes wrong with the measurements."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jink.envs.episodes import Episodes
from jink.envs.library.overrides import override, parameters
from jink.envs.noise.spans import check_positive
from jink.envs.sampling import Sampling, make_sampling
from jink.envs.sensing import Sensing
from jink.envs.simulate import simulate
from jink.envs.streams import Streams
from jink.envs.surge import Surge
from jink.envs.surges import as_surges
from jink.envs.truth import Motion
from jink.estimators.sensor import Sensor
from jink.estimators.sensor_parts import check_sigmas
from jink.estimators.sensors import make_sensor

__all__ = ["Scenario"]


@dataclass(frozen=True)
class Scenario:
    """A source of simulated episodes.

    Args:
        id: name, ends in ``-v`` and a number.
        title: one line for tables.
        suite: what it belongs to.
        motion: what the target does.
        sensing: how it is seen.
        sampling: when.
        surges: what goes wrong; any number, applied in order.
        start_sigma: standard deviations of the prior's position and velocity, around the truth; m, m/s.
        filter_noise: white acceleration a sensible constant-velocity filter assumes (spectral density); m^2/s^3.
        reach: positions stay within this distance of the origin along every axis, m; None: what the motion says.

    Raises:
        ValueError: a name without a version, a value out of range, or parts that do not fit each other.
    """

    id: str
    title: str
    suite: str
    motion: Motion
    sensing: Sensing
    sampling: Sampling
    surges: tuple[Surge, ...] = ()
    start_sigma: tuple[float, float] = (1.0, 1.0)
    filter_noise: float = 1.0
    reach: float | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9-]+-v\d+", str(self.id)):
            raise ValueError(
                f"Scenario: id must be lower case with hyphens and end in a version; got {self.id!r}. "
                "Write for instance my-scenario-v0."
            )
        object.__setattr__(self, "surges", tuple(self.surges))
        parts = [
            ("motion", self.motion, "simulate"),
            ("sampling", self.sampling, "times"),
            ("sensing", self.sensing, "look"),
        ]
        for name, part, method in (*parts, *((f"surges.{i}", surge, "apply") for i, surge in enumerate(self.surges))):
            if not hasattr(part, method):
                raise ValueError(
                    f"{self.id}: {name} must have a method {method}; got {part!r}. See Scenario for what goes where."
                )
        if np.shape(self.start_sigma) != (2,):
            raise ValueError(
                f"{self.id}: start_sigma must hold two numbers; got {self.start_sigma}. Give position in m, "
                "velocity in m/s."
            )
        for sigma in self.start_sigma:
            check_positive(self.id, "start_sigma", sigma, "m, m/s")
        object.__setattr__(self, "start_sigma", tuple(float(sigma) for sigma in self.start_sigma))
        check_positive(self.id, "filter_noise", self.filter_noise, "m^2/s^3")
        check_positive(self.id, "reach", self.extent, "m")
        if self.motion.axes != self.sensing.sensor.axes:
            raise ValueError(
                f"{self.id}: sensing must have the motion's {self.motion.axes} axes; got a {self.sensing.sensor.name} "
                f"sensor of {self.sensing.sensor.axes}. Use a sensor of the same space."
            )
        for surge in self.surges:
            surge.need(self.steps, self.sampling.duration, self.sensor.size)

    @property
    def axes(self) -> int:
        """Space dimensions, 2 or 3."""
        return self.motion.axes

    @property
    def sensor(self) -> Sensor:
        """What is measured, with its nominal noise."""
        return self.sensing.sensor

    @property
    def intents(self) -> tuple[str, ...]:
        """Names that `Truth.intent` points to."""
        return self.motion.intents

    @property
    def steps(self) -> int:
        """Samples of an episode."""
        return self.sampling.steps

    @property
    def extent(self) -> float:
        """Positions stay within this distance of the origin along every axis, m."""
        if self.reach is not None:
            return self.reach
        extent = getattr(self.motion, "extent", None)
        if extent is None:
            raise ValueError(
                f"{self.id}: reach must be given for a {type(self.motion).__name__}, which has no extent(duration); "
                "got None. Give metres."
            )
        return float(extent(self.sampling.duration + self.sensing.latency))

    @property
    def parameters(self) -> dict[str, Any]:
        """Every parameter by its dotted name."""
        return parameters(self)

    def replace(self, **overrides: Any) -> Scenario:
        """A copy with parameters replaced, by dotted or plain name (see `override`).

        Raises:
            ValueError: an unknown or ambiguous name, or a value out of range.
        """
        return override(self, overrides, self.id, _fitted)

    def simulate(self, streams: Sequence[Streams]) -> Episodes:
        """One episode per entry; the generators advance by the same amount every time."""
        return simulate(self, streams)


def _sensor_constants(sensor: Sensor, value: Any) -> tuple[float, ...]:
    """Constants of a sensor reach compiled code, which trusts their number."""
    try:
        constants = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        constants = np.full(0, np.nan)
    if constants.shape != (len(sensor.params),) or not np.isfinite(constants).all():
        raise ValueError(
            f"{sensor.name}: params must be {len(sensor.params)} finite numbers; got {value!r}. "
            "Give a sensor of your own for another number of them."
        )
    return tuple(constants.tolist())


def _fitted(parent: Any, name: str, value: Any) -> Any:
    """A new value as its field wants it: kinds by name, one sigma for all components, tuples for lists."""
    if isinstance(parent, Sensor) and name == "sigma":
        return check_sigmas(parent.name, value, parent.labels, parent.units)
    if isinstance(parent, Sensor) and name == "params":
        return _sensor_constants(parent, value)
    if isinstance(parent, Sensing) and name == "sensor" and isinstance(value, str):
        any_space = value.replace("_", "-") in ("position", "range", "range-rate", "range-range-rate")
        return make_sensor(value, **({"axes": parent.sensor.axes} if any_space else {}))
    if isinstance(parent, Scenario) and name == "sampling" and isinstance(value, str):
        return make_sampling(value, steps=parent.steps, dt=getattr(parent.sampling, "dt", 0.1))
    if isinstance(parent, Scenario) and name == "surges":
        return as_surges(value)
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return tuple(_fitted(None, "", item) for item in value) if isinstance(value, list) else value
