"""Where the target may be in a while: a mixture over what it does now and what it will be doing then."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp, ndtri
from scipy.stats import qmc

from jink.estimators.api import BankEstimator
from jink.estimators.extrapolation import follow_modes
from jink.estimators.records import State

__all__ = ["PositionForecast", "forecast"]

Floats = NDArray[np.float64]
_MOST_POINTS = 2**25  # of all paths together; some gigabytes


@dataclass(frozen=True)
class PositionForecast:
    """Positions to come, as a Gaussian mixture for each of B states and H horizons.

    Model: component k is the road from mode ``now[k]`` to mode ``then[k]``; ``p(position) = sum_k weight_k
    N(mean_k, covariance_k)``. Roads between the same two modes differ in when they switch; their moments are matched.

    Args:
        horizons: s ahead; (B, H).
        weights: sum to 1; (B, H, K).
        means: m; (B, H, K, A).
        covariances: m^2, of the position without measurement noise; (B, H, K, A, A).
        now, then: modes of each component; (K,).
        modes: their names.
        paths: trajectories that the target might take, equally likely; (B, S, H, A); m. Each follows one sequence of
            modes drawn from the chain and keeps its place within the noise. Evenly spread (Sobol numbers), so that few
            already show the alternatives.
    """

    horizons: Floats
    weights: Floats
    means: Floats
    covariances: Floats
    now: NDArray[np.int64]
    then: NDArray[np.int64]
    modes: tuple[str, ...]
    paths: Floats

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the components: "turn" stays, "turn > straight" switches."""
        pairs = zip(self.now, self.then, strict=True)
        return tuple(self.modes[i] if i == j else f"{self.modes[i]} > {self.modes[j]}" for i, j in pairs)

    @property
    def mode_probs(self) -> Floats:
        """Probability of each mode at the horizon; (B, H, M)."""
        found = np.zeros((*self.weights.shape[:2], len(self.modes)))
        for k, mode in enumerate(self.then):
            found[..., mode] += self.weights[..., k]
        return found

    @property
    def mean(self) -> Floats:
        """Mean of the mixture; (B, H, A); m."""
        return np.asarray(np.einsum("bhk,bhka->bha", self.weights, self.means))

    @property
    def covariance(self) -> Floats:
        """Covariance of the mixture; (B, H, A, A); m^2."""
        apart = self.means - self.mean[:, :, None]
        spread = self.covariances + apart[..., :, None] * apart[..., None, :]
        return np.asarray(np.einsum("bhk,bhkac->bhac", self.weights, spread))

    def collapsed(self, seed: int = 0) -> PositionForecast:
        """The one Gaussian of equal mean and covariance: what a tracker without alternatives would say."""
        zero = np.zeros(1, dtype=np.int64)
        B, S, H, A = self.paths.shape
        mean, cov = self.mean, self.covariance
        normal = ndtri(_even(S, A, seed))
        paths = mean[:, None] + np.einsum("bhac,sc->bsha", np.linalg.cholesky(cov), normal)
        ones = np.ones((B, H, 1))
        return PositionForecast(self.horizons, ones, mean[:, :, None], cov[:, :, None], zero, zero, ("all",), paths)

    def nll(self, truth: ArrayLike, noise: ArrayLike | None = None) -> Floats:
        """Negative log-likelihood of where the target was; (B, H); nats; NaN where that is unknown.

        Args:
            truth: positions; (B, H, A); m.
            noise: covariance of ``truth`` if it was measured; broadcasts to (B, H, A, A); m^2; None: exact.

        Raises:
            ValueError: another shape.
        """
        place, cov = self._truth(truth, "nll"), self.covariances
        if noise is not None:
            cov = cov + np.asarray(noise, dtype=np.float64)[..., None, :, :]
        known = np.asarray(np.isfinite(place).all(axis=-1))
        cov = np.where((self.weights > 0.0)[..., None, None], cov, np.eye(cov.shape[-1]))
        lower = np.linalg.cholesky(cov)
        apart = np.where(known[..., None], place, 0.0)[:, :, None] - self.means
        white = np.linalg.solve(lower, apart[..., None])[..., 0]
        half_log_det = np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)
        log_density = -0.5 * np.square(white).sum(axis=-1) - half_log_det - 0.5 * cov.shape[-1] * math.log(2 * math.pi)
        total = logsumexp(log_density, b=self.weights, axis=-1)
        return np.where(known, -total, np.nan)

    def roads(self, count: int) -> tuple[Floats, Floats]:
        """The ``count`` likeliest roads at the last horizon: weights (B, count) there, mean paths (B, count, H, A).

        With fewer components than ``count``, all of them.
        """
        best = np.argsort(-self.weights[:, -1], axis=-1, kind="stable")[:, :count]
        paths = np.take_along_axis(self.means, best[:, None, :, None], axis=2)
        return np.take_along_axis(self.weights[:, -1], best, axis=1), np.swapaxes(paths, 1, 2)

    def min_ade(self, truth: ArrayLike, count: int = 6, *, by: str = "paths") -> Floats:
        """Mean distance to the truth of the best of ``count`` trajectories; (B,); m; NaN where nothing is known.

        Args:
            truth: positions; (B, H, A); m; NaN = unknown.
            count: trajectories, at most as many as there are.
            by: "paths", or "roads" for the mean paths of the likeliest components.

        Raises:
            ValueError: another shape, too many trajectories, or an unknown ``by``.
        """
        distance = self._distances(truth, count, by, "min_ade")
        known = np.isfinite(distance)
        share = known.sum(axis=2)
        mean = np.where(known, distance, 0.0).sum(axis=2) / np.maximum(share, 1)
        return np.asarray(np.where(share > 0, mean, np.nan).min(axis=1))

    def min_fde(self, truth: ArrayLike, count: int = 6, *, by: str = "paths") -> Floats:
        """Distance at the last horizon of the best of ``count`` trajectories; (B,); m; as `min_ade`."""
        return np.asarray(self._distances(truth, count, by, "min_fde")[:, :, -1].min(axis=1))

    def density(self, state: int, horizon: int, x: ArrayLike, y: ArrayLike) -> Floats:
        """Probability density of (x, y) on a grid, for pictures; (len(y), len(x)); 1/m^2.

        Args:
            state: which of the B states.
            horizon: which of the H horizons.
            x, y: edges of no cells but points; m.
        """
        grid = np.stack(np.meshgrid(np.asarray(x, float), np.asarray(y, float)), axis=-1)
        found = np.zeros(grid.shape[:2])
        parts = zip(
            self.weights[state, horizon], self.means[state, horizon], self.covariances[state, horizon], strict=True
        )
        for weight, mean, cov in parts:
            if weight > 0.0:
                apart = grid - mean[:2]
                precision = np.linalg.inv(cov[:2, :2])
                distance = np.einsum("yxa,ac,yxc->yx", apart, precision, apart)
                found += weight * np.exp(-0.5 * distance) * math.sqrt(np.linalg.det(precision)) / (2 * math.pi)
        return found

    def _truth(self, truth: ArrayLike, caller: str) -> Floats:
        place, wanted = np.asarray(truth, dtype=np.float64), (*self.weights.shape[:2], self.means.shape[-1])
        if place.shape != wanted:
            raise ValueError(
                f"{caller}: truth must have shape (B, H, A) = {wanted}; got {place.shape}. Give one place per horizon."
            )
        return place

    def _distances(self, truth: ArrayLike, count: int, by: str, caller: str) -> Floats:
        place = self._truth(truth, caller)
        if by not in ("paths", "roads"):
            raise ValueError(f"{caller}: by must be paths or roads; got {by!r}. Use paths.")
        if by == "paths" and not 1 <= count <= self.paths.shape[1]:
            raise ValueError(
                f"{caller}: count must be in 1 .. {self.paths.shape[1]}, the paths of this forecast; got {count}. "
                "Pass paths= to forecast."
            )
        paths = self.paths[:, :count] if by == "paths" else self.roads(count)[1]
        return np.asarray(np.linalg.norm(paths - place[:, None], axis=-1))


def _even(count: int, size: int, seed: int) -> Floats:
    """Evenly spread numbers in (0, 1); (count, size)."""
    if count == 0:
        return np.empty((0, size))
    whole = 1 << (count - 1).bit_length()  # Sobol numbers are balanced in powers of two
    found = qmc.Sobol(size, scramble=True, rng=np.random.default_rng(seed)).random(whole)[:count]
    return np.asarray(np.clip(found, 1e-12, 1.0 - 1e-12))


def _draw_modes(estimator: BankEstimator, state: State, horizons: Floats, uniform: Floats) -> NDArray[np.int64]:
    """Sequences of modes from the chain, by inverting cumulated probabilities; (B, S, H + 1)."""
    B, H = horizons.shape
    chain = estimator.bank.chain
    modes = np.empty((B, len(uniform), H + 1), dtype=np.int64)
    modes[:, :, 0] = _pick(state.mode_probs[:, None, :], uniform[:, 0])
    steps = np.diff(horizons, axis=1, prepend=0.0)
    sizes, which = np.unique(steps, return_inverse=True)
    tables = np.array([np.eye(1) if chain is None else chain.at(float(dt)) for dt in sizes])
    which = which.reshape(steps.shape)
    for h in range(H):
        moves = tables[which[:, h][:, None], modes[:, :, h]]
        modes[:, :, h + 1] = _pick(moves, uniform[:, h + 1])
    return modes


def _pick(probs: Floats, uniform: Floats) -> NDArray[np.int64]:
    """Index by inverting cumulated probabilities (B, S or 1, K) at uniform numbers (S,); (B, S)."""
    edges = np.cumsum(probs, axis=2)
    below = uniform[None, :, None] * edges[..., -1:] >= edges
    return np.minimum(below.sum(axis=2), probs.shape[2] - 1)


def forecast(
    estimator: BankEstimator, state: State, horizons: ArrayLike, *, paths: int = 20, seed: int = 0
) -> PositionForecast:
    """Where the target may be at each horizon.

    Args:
        estimator: whose state it is, of any recipe.
        state: from `start`, `step` or `states`; B tracks.
        horizons: s ahead, >= 0, not decreasing; (H,) or (B, H).
        paths: trajectories to draw, >= 0.
        seed: of the paths; the same for every state.

    Returns:
        a mixture over the mode now and the mode then; one component for an estimator of one mode.

    Raises:
        ValueError: as `BankEstimator.extrapolate`, or paths < 0 or more than fit into memory.
    """
    if isinstance(paths, bool) or not isinstance(paths, (int, np.integer)) or paths < 0:
        raise ValueError(f"forecast: paths must be an integer >= 0; got {paths!r}. Use 20.")
    roads = estimator.extrapolate(state, horizons)
    B, H, M = roads.weights.shape[:3]
    most = _MOST_POINTS // max(B * (H + 1), 1)
    if paths > most:
        raise ValueError(
            f"forecast: paths must be at most {most} for {B} states and {H} horizons; got {paths}. "
            "Draw fewer, or forecast in parts with other seeds."
        )
    ahead = np.array(np.broadcast_to(np.atleast_1d(np.asarray(horizons, dtype=np.float64)), (B, H)))
    axes = roads.mean.shape[-1]
    drawn = np.empty((B, 0, H, axes))
    if paths:
        uniform = _even(paths, 1 + H + axes, seed)
        # The place within the noise comes first: the first dimensions are the most evenly spread together.
        modes = _draw_modes(estimator, state, ahead, uniform[:, axes:])
        mean, cov = follow_modes(estimator, state, ahead, modes)
        drawn = mean + np.einsum("bshac,sc->bsha", np.linalg.cholesky(cov), ndtri(uniform[:, :axes]))
    now, then = (index.ravel() for index in np.divmod(np.arange(M * M), M))
    return PositionForecast(
        ahead,
        roads.weights.reshape(B, H, M * M),
        roads.mean.reshape(B, H, M * M, -1),
        roads.cov.reshape(B, H, M * M, *roads.cov.shape[-2:]),
        now,
        then,
        estimator.modes,
        drawn,
    )
