"""Surges of single samples: outliers, contamination, heavy tails."""

from __future__ import annotations

from dataclasses import dataclass

from jink.envs.noise import surge_laws
from jink.envs.noise.spans import Level, check_between, check_level, check_positive, level_of
from jink.envs.streams import Need
from jink.envs.surge import CompiledSurge

__all__ = ["Contaminated", "HeavyTails", "IsolatedOutliers"]


@dataclass(frozen=True)
class IsolatedOutliers(CompiledSurge):
    """Gross outliers: each sample by itself, with a probability, has a much larger covariance.

    Args:
        probability: of one sample, in [0, 1].
        scale: factor on R: fixed, or (low, high) of a log-uniform law.

    Raises:
        ValueError: a probability outside [0, 1] or a factor that is not > 0.
    """

    probability: float = 0.1
    scale: Level = 100.0
    _law = surge_laws.outliers

    def __post_init__(self) -> None:
        caller = type(self).__name__
        check_between(caller, "probability", self.probability, 0.0, 1.0, "parts of one")
        object.__setattr__(self, "scale", check_level(caller, "scale", self.scale))

    def _params(self) -> tuple[float, ...]:
        return (self.probability, *level_of(self.scale))

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: two per sample."""
        return Need(uniforms=2 * steps)


@dataclass(frozen=True)
class Contaminated(IsolatedOutliers):
    """Contaminated Gaussian noise, ``(1 - p) N(0, R) + p N(0, scale R)``: the textbook of robust estimation.

    The law of `IsolatedOutliers` with a moderate factor, so that single samples do not betray themselves.
    """

    probability: float = 0.2
    scale: Level = 9.0


@dataclass(frozen=True)
class HeavyTails(CompiledSurge):
    """Student-t noise: every sample's factor is nu / chi^2_nu, so that the error is multivariate t.

    R is then the scale matrix; the covariance is ``R nu / (nu - 2)``, infinite for nu <= 2.

    Args:
        dof: degrees of freedom nu > 0; small = heavy tails.

    Raises:
        ValueError: ``dof`` is not > 0 and finite.

    Source: Marsaglia, Tsang (2000). Differs: at most five attempts, so exact up to an event of probability 3e-7.
    """

    dof: float = 3.0
    _law = surge_laws.heavy_tails

    def __post_init__(self) -> None:
        check_positive("HeavyTails", "dof", self.dof, "degrees of freedom")

    def _params(self) -> tuple[float, ...]:
        return (self.dof,)

    def need(self, steps: int, duration: float, size: int) -> Need:
        """Draws of one episode: a fixed number of attempts per sample."""
        return Need(uniforms=(surge_laws.ATTEMPTS + 1) * steps, normals=surge_laws.ATTEMPTS * steps)
