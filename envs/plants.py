"""Linear truth, with or without bounded model error: `LinearPlant`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jink.envs.flight.model_error import ModelError
from jink.envs.flight.plant_steps import ACCELERATION, VELOCITY, run_plant
from jink.envs.manoeuvres import check_times
from jink.envs.streams import Draws, Need
from jink.envs.truth import Truth

__all__ = [
    "LinearPlant",
    "uncertain_plant",
]

Array = NDArray[np.float64]
_PLANTS = {"constant-velocity": VELOCITY, "constant-acceleration": ACCELERATION}


@dataclass(frozen=True, kw_only=True)
class LinearPlant:
    """A `Motion`: white acceleration or white jerk, discretised exactly for any steps, with optional model error.

    Model: ``x+ = (F + M Delta E_f) x + (G + M Delta E_g) u``, u unit white, ``G G' = Q(dt)``; per axis the state is
    position, velocity (, acceleration), axis after axis. The noise is drawn per sample: the same draws at other times
    are another trajectory. With two states per axis the acceleration reported is the mean over the last step.

    Args:
        axes: 2 or 3.
        model: "constant-velocity" (white acceleration) or "constant-acceleration" (white jerk).
        density: of the white noise on each axis, m^2/s^3 or m^2/s^5.
        start_mean: state at the start, (n,); None: zeros.
        start_sigma: its standard deviations, (n,); None: 1000 m, 30 m/s, 1 m/s^2.
        error: model error added to every step whatever its length; None: none.
    Raises:
        ValueError: a value outside its range or a shape that does not fit.
    """

    axes: int = 2
    model: str = "constant-velocity"
    density: float = 1.0
    start_mean: tuple[float, ...] | None = None
    start_sigma: tuple[float, ...] | None = None
    error: ModelError | None = None

    def __post_init__(self) -> None:
        if self.axes not in (2, 3):
            raise ValueError(f"LinearPlant: axes must be 2 or 3; got {self.axes!r}. Count the space dimensions.")
        if self.model not in _PLANTS:
            raise ValueError(
                f"LinearPlant: model must be one of {', '.join(_PLANTS)}; got {self.model!r}. Pick a listed one."
            )
        if not 0.0 <= self.density < math.inf:
            raise ValueError(f"LinearPlant: density must be finite and >= 0; got {self.density!r}. Give m^2/s^3.")
        n = self.axes * _PLANTS[self.model]
        defaults = {"start_mean": (0.0,) * n, "start_sigma": (1000.0, 30.0, 1.0)[: n // self.axes] * self.axes}
        for name, default in defaults.items():
            given = getattr(self, name)
            values = default if given is None else tuple(float(x) for x in given)
            low = -math.inf if name == "start_mean" else 0.0
            if len(values) != n or not all(math.isfinite(x) and x >= low for x in values):
                raise ValueError(
                    f"LinearPlant: {name} must be {n} finite numbers{' >= 0' if low == 0.0 else ''}; got {given!r}. "
                    "The order is x vx (ax) y vy (ay) ..."
                )
            object.__setattr__(self, name, values)
        if self.error is not None and len(self.error.gain) != n:
            raise ValueError(
                f"LinearPlant: error must act on {n} states; got a gain of {len(self.error.gain)} rows. "
                f"Build it for {self.axes} axes and {self.model}."
            )

    @property
    def intents(self) -> tuple[str, ...]:
        """One intent throughout."""
        return ("straight",) if self.model == "constant-velocity" else ("accelerate",)

    @property
    def _start(self) -> tuple[Array, Array]:
        """Mean and standard deviations at the start, (n,) each."""
        return np.array(self.start_mean or ()), np.array(self.start_sigma or ())

    def extent(self, duration: float) -> float:
        """Positions stay within this of the origin, m: six standard deviations, model error left aside."""
        per_axis = _PLANTS[self.model]
        growth = [duration**i / math.factorial(i) for i in range(per_axis)]
        start, sigma = (moment.reshape(self.axes, per_axis) for moment in self._start)
        mean = np.abs(start) @ growth
        variance = sigma**2 @ np.square(growth)
        power = 2 * per_axis - 1
        drift = self.density * duration**power / (power * math.factorial(per_axis - 1) ** 2)
        return float((mean + 6.0 * np.sqrt(variance + drift)).max())

    def need(self, steps: int, duration: float) -> Need:
        """Draws of one episode of ``steps`` samples; the duration does not matter."""
        n = self.axes * _PLANTS[self.model]
        error = Need() if self.error is None else self.error.need(max(steps - 1, 0))
        return Need(uniforms=error.uniforms, normals=n * max(steps, 1) + error.normals)

    def simulate(self, times: Array, draws: Draws) -> Truth:
        """Trajectories at ``times`` (B, T), seconds from the start, non-decreasing; row b uses row b of the draws.

        Raises:
            ValueError: bad times, or draws of another size than `need` says.
        """
        times = np.ascontiguousarray(times, dtype=np.float64)
        check_times("LinearPlant.simulate", times)
        B, T = times.shape
        per_axis = _PLANTS[self.model]
        n = self.axes * per_axis
        check_draws("LinearPlant.simulate", draws, self.need(T, 0.0), B)
        normals = draws.normals
        states = np.empty((B, T, n))
        mean, sigma = self._start
        states[:, 0] = mean + sigma * normals[:, :n]
        noise = np.ascontiguousarray(normals[:, n : n * T]).reshape(B, T - 1, n)
        error = self.error
        if error is None:
            error = ModelError(gain=((0.0,),) * n, of_state=((0.0,) * n,), fixed=0.0)
        spare = error.need(T - 1)
        delta = error.deltas(draws.uniforms[:, : spare.uniforms], normals[:, n * T : n * T + spare.normals])
        dt = np.diff(times, axis=1)
        run_error_plant(dt, per_axis, self.density, np.eye(n), np.eye(n), error, delta, noise, states)
        by_axis = states.reshape(B, T, self.axes, per_axis)
        velocity = np.ascontiguousarray(by_axis[..., 1])
        acceleration = np.zeros_like(velocity)
        if per_axis == ACCELERATION:
            acceleration[...] = by_axis[..., 2]
        else:
            gained = np.diff(velocity, axis=1)
            np.divide(gained, dt[:, :, None], out=acceleration[:, 1:], where=dt[:, :, None] > 0)
        return Truth(
            position=np.ascontiguousarray(by_axis[..., 0]),
            velocity=velocity,
            acceleration=acceleration,
            intent=np.zeros((B, T), dtype=np.int8),
            switch_times=np.full((B, 1), np.nan),
        )


def uncertain_plant(axes: int = 2, *, density: float = 1.0, redraw: str = "step", **options: Any) -> LinearPlant:
    """The test plant of the interactive robust estimator: x moves on by up to 0.0198 s of its velocity too much.

    Model: constant velocity with ``M = (0.0198, 0, ...)'``, ``E_f = (0, 1, 0, ...)``, ``E_g = 0``, scalar Delta.

    Args:
        axes: 2 or 3.
        density: of the white acceleration, m^2/s^3.
        redraw: "step" or "episode".
        options: further fields of `LinearPlant`.
    Returns:
        the plant.
    Raises:
        ValueError: axes that are not 2 or 3, or an option outside its range.
    Source: EstimatorFrame, ModelErrorLinearTrajectoryGeneration. Differs: none.
    """
    if axes not in (2, 3):
        raise ValueError(f"uncertain_plant: axes must be 2 or 3; got {axes!r}. Count the space dimensions.")
    n = 2 * axes
    gain = tuple((0.0198 if i == 0 else 0.0,) for i in range(n))
    error = ModelError(gain=gain, of_state=(tuple(float(i == 1) for i in range(n)),), redraw=redraw)
    return LinearPlant(axes=axes, density=density, error=error, **options)


def run_error_plant(
    dt: Array,
    per_axis: int,
    density: float,
    F: Array,
    G: Array,
    error: ModelError,
    delta: Array,
    noise: Array,
    x: Array,
) -> None:
    """States ``x`` (B, T, n) from their first row; ``per_axis`` 0: F and G as given, else filled in for each step."""
    M, Ef = np.array(error.gain), np.array(error.of_state)
    Eg = np.zeros_like(Ef) if error.of_noise is None else np.array(error.of_noise)
    run_plant(dt, per_axis, density, F, G, M, Ef, Eg, delta, noise, x)


def check_draws(caller: str, draws: Draws, need: Need, rows: int) -> None:
    """Refuse draws with another number of rows, or of fewer columns than needed.

    Raises:
        ValueError: as said.
    """
    for name, array, count in (("uniforms", draws.uniforms, need.uniforms), ("normals", draws.normals, need.normals)):
        if array.ndim != 2 or array.shape[0] != rows or array.shape[1] < count:
            raise ValueError(
                f"{caller}: draws.{name} must have {rows} rows of {count} or more; got {array.shape}. "
                "Draw what need(...) says."
            )
