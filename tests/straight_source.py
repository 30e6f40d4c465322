"""A source of episodes small enough to check by hand: straight flight, white noise, now and then nothing seen."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from jink.envs.episodes import Episodes
from jink.envs.streams import Need, draw
from jink.envs.truth import Truth
from jink.estimators.sensors import make_sensor


@dataclass(frozen=True)
class Straight:
    """Targets that start within 100 m, fly at some 10 m/s and change their intent once, half way."""

    id: str = "straight-v0"
    axes: int = 2
    kind: str = "position"
    sigma: float = 5.0
    steps: int = 12
    missed: float = 0.2
    shift: float = 0.0
    options: tuple[tuple[str, Any], ...] = ()

    intents = ("straight", "turn")
    extent = 1000.0
    filter_noise = 1.0

    @cached_property
    def sensor(self):
        options = {"sigma": (self.sigma, 0.02) if self.kind == "range-bearing" else self.sigma}
        if self.kind == "position":
            options["axes"] = self.axes
        return make_sensor(self.kind, **options | dict(self.options))

    def simulate(self, streams):
        B, T, A, D = len(streams), self.steps, self.axes, self.sensor.size
        start = draw([row[0] for row in streams], Need(normals=2 * A)).normals.reshape(B, 2, A)
        gaps = 0.5 + draw([row[1] for row in streams], Need(uniforms=T)).uniforms
        lost = draw([row[2] for row in streams], Need(uniforms=T)).uniforms < self.missed
        errors = draw([row[3] for row in streams], Need(normals=T * D)).normals.reshape(B, T, D)
        times = np.cumsum(gaps, axis=1)
        times -= times[:, :1].copy()
        lost[:, 0] = False
        velocity = np.broadcast_to(10.0 * start[:, 1, None] + 0.0, (B, T, A)).copy()
        position = 100.0 * start[:, 0, None] + self.shift + velocity * times[:, :, None]
        switch = times[:, self.steps // 2, None].copy()
        truth = Truth(position, velocity, np.zeros((B, T, A)), (times >= switch).astype(np.int8), switch)
        sensors = np.zeros((B, T, 2 * A))
        if self.kind == "range-bearing":
            clean = np.stack(
                [np.hypot(*position.transpose(2, 0, 1)), np.arctan2(position[..., 1], position[..., 0])], -1
            )
        else:
            clean = position
        z = clean + errors * np.asarray(self.sensor.sigma)
        z[lost] = np.nan
        noise = np.broadcast_to(self.sensor.noise, (B, T, D, D)).copy()
        return Episodes(
            times=times,
            delivery_times=times,
            truth=truth,
            delivered=truth,
            measurements=z,
            detected=~lost,
            scale=np.ones((B, T)),
            bias=np.zeros((B, T, D)),
            noise=noise,
            nominal_noise=self.sensor.noise,
            sensor_states=sensors,
            prior_mean=np.zeros((B, 2 * A)),
            prior_cov=np.eye(2 * A) * 1e4,
        )
