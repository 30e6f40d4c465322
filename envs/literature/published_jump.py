"""Jump Markov linear scenarios with published results."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.envs.literature.published_truth import (
    Array,
    PublishedValue,
    ScenarioData,
    check_markov,
    check_number,
    check_runs,
    check_shape,
    draw_sensor_noise,
    freeze,
    make_stream,
)


@dataclass(frozen=True, eq=False)
class JumpScenario:
    """A jump Markov linear system seen through its positions.

    Model: x[k] = F[m] x[k-1] + u[m] + L[m] w, w ~ N(0, I), m the mode of the step; z = H x + sigma v.

    Args:
        id, title, source: name with version, one line, where it comes from.
        dt, steps: s between samples; number of samples, the first at time 0.
        state_labels: names of the n state components.
        position_index, velocity_index: where position and velocity sit in the state, A each.
        mode_names: M names.
        transition, drift, noise_gain: F (M, n, n), u (M, n), L (M, n, q); L L' is the process noise.
        sigma: standard deviation of each position measurement, m.
        mode_transition, mode_probs0: Markov matrix (row = from) and distribution at time 0.
        prior_mean, prior_cov: belief at time 0 before the first measurement; (n,), (n, n).
        schedule: mode of each sample (`steps` of them); None draws it from the Markov matrix.
        draw_start: True draws the true start from the prior, False puts it on the prior mean.
        published: numbers to compare with.
    Raises:
        ValueError: a wrong shape, a number out of range, rows that do not sum to 1, or an unknown mode.
    """

    id: str
    title: str
    source: str
    dt: float
    steps: int
    state_labels: tuple[str, ...]
    position_index: tuple[int, ...]
    velocity_index: tuple[int, ...]
    mode_names: tuple[str, ...]
    transition: ArrayLike
    drift: ArrayLike
    noise_gain: ArrayLike
    sigma: float
    mode_transition: ArrayLike
    mode_probs0: ArrayLike
    prior_mean: ArrayLike
    prior_cov: ArrayLike
    schedule: tuple[int, ...] | None = None
    draw_start: bool = False
    published: Mapping[str, PublishedValue] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_number(self.id, "dt", self.dt)
        check_number(self.id, "sigma", self.sigma)
        check_number(self.id, "steps", self.steps, low=1)
        modes, n = len(self.mode_names), len(self.state_labels)
        gain = np.asarray(self.noise_gain, dtype=np.float64)
        shapes = {
            "transition": (modes, n, n),
            "drift": (modes, n),
            "noise_gain": (modes, n, gain.shape[-1]),
            "mode_transition": (modes, modes),
            "mode_probs0": (modes,),
            "prior_mean": (n,),
            "prior_cov": (n, n),
        }
        for name, shape in shapes.items():
            array = freeze(getattr(self, name))
            check_shape(self.id, name, array, shape)
            object.__setattr__(self, name, array)
        check_markov(self.id, np.asarray(self.mode_transition), np.asarray(self.mode_probs0), modes)
        object.__setattr__(self, "published", MappingProxyType(dict(self.published)))
        schedule = self.schedule
        if schedule is not None and (len(schedule) != self.steps or not set(schedule) <= set(range(modes))):
            raise ValueError(
                f"{self.id}: schedule must be {self.steps} mode indices in 0..{modes - 1}; "
                f"got {len(schedule)} values. Give one per sample."
            )

    @property
    def process_noise(self) -> Array:
        """Covariance of the process noise of each mode, (M, n, n)."""
        gain = np.asarray(self.noise_gain)
        return np.asarray(gain @ np.swapaxes(gain, -1, -2))

    @property
    def observation(self) -> Array:
        """H, (A, n): picks the positions."""
        return np.eye(len(self.state_labels))[list(self.position_index)]

    def draw_modes(self, seed: int, runs: int) -> NDArray[np.int64]:
        """Mode in effect during the step that ends at each sample, (runs, steps)."""
        if self.schedule is not None:
            return np.repeat(np.array(self.schedule, dtype=np.int64)[None], runs, axis=0)
        last = len(self.mode_names) - 1
        start = np.cumsum(np.asarray(self.mode_probs0))
        rows = np.cumsum(np.asarray(self.mode_transition), axis=1)
        uniform = np.stack([make_stream("modes", seed, run).random(self.steps) for run in range(runs)])
        modes = np.empty((runs, self.steps), dtype=np.int64)
        modes[:, 0] = np.minimum((uniform[:, :1] > start).sum(-1), last)
        for k in range(1, self.steps):
            modes[:, k] = np.minimum((uniform[:, k, None] > rows[modes[:, k - 1]]).sum(-1), last)
        return modes

    def simulate(self, runs: int, seed: int) -> ScenarioData:
        """Draws `runs` tracks.

        Args:
            runs: number of runs, >= 1.
            seed: experiment seed, >= 0; run i is the same whatever `runs` is.
        Returns:
            the runs, with the prior that the source gives its filters.
        Raises:
            ValueError: runs or seed out of range.
        """
        check_runs(f"{self.id}.simulate", runs, seed)
        transition, drift = np.asarray(self.transition), np.asarray(self.drift)
        gain = np.asarray(self.noise_gain)
        mean, cov = np.asarray(self.prior_mean), np.asarray(self.prior_cov)
        n, q = gain.shape[-2:]
        modes = self.draw_modes(seed, runs)
        unit = [make_stream("truth", seed, run).standard_normal(n + (self.steps - 1) * q) for run in range(runs)]
        start, shocks = np.split(np.stack(unit), [n], axis=1)
        shocks = shocks.reshape(runs, self.steps - 1, q)
        state = np.empty((runs, self.steps, n))
        state[:, 0] = mean + (start @ np.linalg.cholesky(cov).T if self.draw_start else 0.0)
        for k in range(1, self.steps):
            m = modes[:, k]
            moved = np.einsum("bij,bj->bi", transition[m], state[:, k - 1])
            state[:, k] = moved + drift[m] + np.einsum("bij,bj->bi", gain[m], shocks[:, k - 1])
        position = state[..., list(self.position_index)]
        axes = position.shape[-1]
        return ScenarioData(
            times=self.dt * np.arange(self.steps, dtype=np.float64),
            state=state,
            state_labels=self.state_labels,
            position=position,
            velocity=state[..., list(self.velocity_index)],
            measurements=position + self.sigma * draw_sensor_noise(seed, runs, self.steps, axes),
            noise=self.sigma**2 * np.eye(axes),
            modes=modes,
            mode_names=self.mode_names,
            mode_transition=np.array(self.mode_transition),
            mode_probs0=np.array(self.mode_probs0),
            prior_mean=mean.copy(),
            prior_cov=cov.copy(),
            published=self.published,
        )
