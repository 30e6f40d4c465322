"""What a mode does about measurement noise that is not the nominal one, and about errors of its own model.

A `Mode` is a motion plus any of these. All work in covariances: a Student-t mode keeps the covariance ``nu / (nu - 2)
P`` of its scale matrix P, so mixing, prediction, births, fusion and forecasts are those of a Gaussian mode, exactly;
only its update differs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.factors import LARGEST_INFLATION, Factor, make_factor

__all__ = ["DENSITIES", "TREATMENTS", "Adaptive", "BoundedTails", "HeavyTails", "Level", "Treatment", "Uncertain"]

NOMINAL, ADAPTED, STUDENT = range(3)
DENSITIES = {"nominal": NOMINAL, "adapted": ADAPTED, "t": STUDENT}
"""By which density of its innovation an adaptive mode is weighed."""


def _number(
    caller: str, name: str, value: float, low: float, remedy: str, *, high: float = math.inf, infinite: bool = False
) -> float:
    try:
        number = math.nan if isinstance(value, str | bytes | bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not (low < number <= high and (infinite or math.isfinite(number))):
        ends = "" if infinite else " and finite" if math.isinf(high) else f" and at most {high:g}"
        raise ValueError(f"{caller}: {name} must be a number > {low:g}{ends}; got {value!r}. {remedy}")
    return number


def _whole(value: object, low: int, high: int) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(low <= value <= high)


def _choice(caller: str, name: str, value: str, choices: tuple[str, ...]) -> None:
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{caller}: {name} must be one of {', '.join(choices)}; got {value!r}. Pick one.")


@dataclass(frozen=True)
class Level:
    """This mode's measurement noise is ``scale`` times R, in update and density: one hypothesis about the noise.

    Args:
        scale: factor on the covariance R; > 0.
    """

    scale: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale", _number("Level", "scale", self.scale, 0.0, "Give a factor on R."))


@dataclass(frozen=True)
class Adaptive:
    """The innovation decides the noise: ``R~ = factor(v, H P H', R)`` before the update.

    Args:
        factor: a key of `FACTORS`, or a `Factor`.
        likelihood: the mode is weighed by ``nominal``: ``N(v; 0, S)`` with the nominal R; ``adapted``: with R~;
            ``t``: Student's t with ``dof`` and the nominal S as scale.
        dof: of that t; > 0.
        cap: R~ is at most this times R; > 1, at most `LARGEST_INFLATION`. About 1000 keeps rejection from losing
            ``adapted`` banks.
        probabilities: chi-square probabilities of the thresholds; None: the factor's usual ones.

    Raises:
        ValueError: an unknown name, or a number out of range.

    Source: CN202211618386 (one mode per factor). Differs: usable around any Gaussian mode; adapts before the gain.
    """

    factor: str | Factor = "huber"
    likelihood: str = "t"
    dof: float = 3.0
    cap: float = LARGEST_INFLATION
    probabilities: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        _choice("Adaptive", "likelihood", self.likelihood, tuple(DENSITIES))
        object.__setattr__(self, "dof", _number("Adaptive", "dof", self.dof, 0.0, "Use 3."))
        object.__setattr__(
            self, "cap", _number("Adaptive", "cap", self.cap, 1.0, "Use 1e3, or leave it out.", high=LARGEST_INFLATION)
        )
        if isinstance(self.factor, str):
            make_factor(self.factor, self.probabilities)
        elif not isinstance(self.factor, Factor):
            raise ValueError(f"Adaptive: factor must be a name or a Factor; got {self.factor!r}. See `jink list`.")
        elif self.probabilities is not None:
            raise ValueError(
                f"Adaptive: probabilities must come with the name of a factor; got {self.probabilities!r} beside a "
                "Factor. Give them to make_factor."
            )

    @property
    def rule(self) -> Factor:
        """The factor itself."""
        return make_factor(self.factor, self.probabilities) if isinstance(self.factor, str) else self.factor


@dataclass(frozen=True)
class BoundedTails:
    """Student-t measurement noise alone: an outlier's pull on the estimate is bounded.

    Model: ``R~ = R / l``, ``l = (nu + d) / (nu + tr{(e e' + H P+ H') R^-1})`` with posterior residual e and
    covariance P+, iterated from ``l = 1``; the mode is weighed by the t density of its innovation.

    Args:
        dof: nu; > 0. 3 to 5 for outliers.
        iterations: of the fixed point; 1 to 50.

    Source: Agamennoni, Nieto, Nebot (2012); Piche, Sarkka, Hartikainen (2012). Differs: a fixed number of iterations.
    """

    dof: float = 3.0
    iterations: int = 4

    def __post_init__(self) -> None:
        object.__setattr__(self, "dof", _number("BoundedTails", "dof", self.dof, 0.0, "Use 3."))
        if not _whole(self.iterations, 1, 50):
            raise ValueError(
                f"BoundedTails: iterations must be an integer from 1 to 50; got {self.iterations!r}. Use 4."
            )


@dataclass(frozen=True)
class HeavyTails:
    """State, process noise and measurement noise jointly Student-t; infinite dof: Gaussian.

    Model: gain as in a Kalman filter; scale update ``(nu + D^2) / (nu + d) (P - K S K')`` with ``D^2 = v' S^-1 v`` in
    scale matrices; the mode's density is the marginal t; then the dof, risen to ``nu + d``, is put back to nu.

    Args:
        dof: nu of the state; > 2.
        process_dof, noise_dof: of process and measurement noise; > 2; None: ``dof``.
        matrices: Q and R are ``scale`` matrices (the patent's), or ``covariance`` matrices.
        reset: how the dof is put back: ``moments`` keeps the covariance (the patent's), ``divergence`` minimises the
            Kullback-Leibler divergence.
        mix_factor: ``exact`` second moments when modes mix; ``plain``: the spread of the means enters the scale
            matrix undivided by ``nu / (nu - 2)``.

    Raises:
        ValueError: a dof of 2 or less, or an unknown option.

    Source: CN109491241B; Roth, Ozkan, Gustafsson (2013). Differs: unlike dofs mix into the receiving mode's.
    """

    dof: float = 5.0
    process_dof: float | None = None
    noise_dof: float | None = None
    matrices: str = "scale"
    reset: str = "moments"
    mix_factor: str = "exact"

    def __post_init__(self) -> None:
        for name in ("dof", "process_dof", "noise_dof"):
            value = getattr(self, name)
            value = self.dof if value is None else value
            object.__setattr__(self, name, _number("HeavyTails", name, value, 2.0, "Use 3 to 5.", infinite=True))
        _choice("HeavyTails", "matrices", self.matrices, ("scale", "covariance"))
        _choice("HeavyTails", "reset", self.reset, ("moments", "divergence"))
        _choice("HeavyTails", "mix_factor", self.mix_factor, ("exact", "plain"))

    def spread(self, name: str) -> float:
        """Covariance over scale matrix, ``nu / (nu - 2)``, for one of the three dofs."""
        dof = float(getattr(self, name))
        return 1.0 if math.isinf(dof) else dof / (dof - 2.0)


@dataclass(frozen=True)
class Uncertain:
    """The model itself is off by a bounded amount (Sayed's filter).

    Model: ``x+ = (F + dF) x + w + dw``, ``[dF dG] = M Delta [E_f E_g]``, ``||Delta|| <= 1``, ``dw = M Delta E_g w``;
    regulation ``lambda = (1 + alpha) ||M' H' R^-1 H M||``, or the best one above that bound. Written as a statement
    ``0 = E_f x + E_g w + N(0, I / lambda)`` about the prediction, and ``R^ = R - H M M' H' / lambda``. P weighs the
    regularisation: it is no error covariance. Nonlinear motions by statistical linearisation. Not applied where nothing
    is measured.

    Args:
        error: M; (n, q).
        excitation: E_f; (t, n).
        noise_excitation: E_g; (t, n), on the process noise w of the motion; None: zero.
        alpha: > 0.
        optimise: search the lambda that minimises ``G(lambda)``, as `RobustFilter` does; ``alpha`` is then unused.
            Costs about as much as ten filters.

    Raises:
        ValueError: shapes do not fit each other, or numbers are not finite.

    Source: Sayed (2001), IEEE TAC 46(7); CN202211618386. Differs: written as updates, as in `robust`.
    """

    error: tuple[tuple[float, ...], ...]
    excitation: tuple[tuple[float, ...], ...]
    noise_excitation: tuple[tuple[float, ...], ...] | None = None
    alpha: float = 0.5
    optimise: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.optimise, bool):
            raise ValueError(f"Uncertain: optimise must be True or False; got {self.optimise!r}. Leave it out.")
        object.__setattr__(self, "alpha", _number("Uncertain", "alpha", self.alpha, 0.0, "Use 0.5."))
        M, E_f = self._rows("error", self.error), self._rows("excitation", self.excitation)
        given = self.noise_excitation
        E_g = np.zeros_like(E_f) if given is None else self._rows("noise_excitation", given)
        if M.shape[0] != E_f.shape[1] or E_g.shape != E_f.shape:
            raise ValueError(
                "Uncertain: error, excitation, noise_excitation must have shapes (n, q), (t, n), (t, n); got "
                f"{M.shape}, {E_f.shape}, {E_g.shape}. n is the size of the motion's state."
            )
        for name, value in (("error", M), ("excitation", E_f), ("noise_excitation", E_g)):
            object.__setattr__(self, name, tuple(tuple(float(entry) for entry in row) for row in value))

    @staticmethod
    def _rows(name: str, given: ArrayLike) -> NDArray[np.float64]:
        try:
            rows = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            rows = np.zeros(0)
        if rows.ndim != 2 or rows.size == 0 or not np.isfinite(rows).all():
            raise ValueError(f"Uncertain: {name} must be a finite matrix; got {given!r}. Give a list of rows.")
        return rows

    @property
    def size(self) -> int:
        """Number of state components n."""
        return len(self.error)


Treatment = Level | Adaptive | BoundedTails | HeavyTails | Uncertain

TREATMENTS: dict[str, type[Treatment]] = {
    "level": Level,
    "adaptive": Adaptive,
    "bounded-tails": BoundedTails,
    "heavy-tails": HeavyTails,
    "uncertain": Uncertain,
}
"""By name; a mode may have one of each kind (but only one of adaptive, bounded-tails, heavy-tails)."""
