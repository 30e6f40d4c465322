"""Adaptive factors: how far one innovation makes us distrust one measurement.

A factor turns the nominal measurement noise R into the R~ that the update then uses, from the innovation alone. All
have one signature (`FACTOR`), so a bank or an environment calls them by address; adding one is a function and a row
of `FACTORS`. Statistic: ``D^2 = v' S^-1 v``, ``S = H P H' + R``, chi-square with d degrees of freedom when all is well.

Source: patent CN202211618386 (claim 5 names the four rules and their thresholds); rules and constants from its
inventor's public code. Differs: rejection and every bound are relative to R, so that units do not matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from jink.estimators.compiled import Callback, address_caller, entry_kernel, kernel
from jink.estimators.linalg import padded

__all__ = [
    "FACTOR",
    "FACTORS",
    "LARGEST_INFLATION",
    "Factor",
    "address_caller",
    "call_factor",
    "make_factor",
    "normalised_innovation",
]

LARGEST_INFLATION = 1e9
"""No factor inflates R further: a measurement with this noise is rejected."""

_ITERATIONS = 100
_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "C")

FACTOR = types.void(_VECTOR, _MATRIX, _MATRIX, types.float64, _VECTOR, _MATRIX, _MATRIX)
"""``factor(v, HPH, R, nis, thresholds, work, out)``: noise to use with innovation ``v`` (d,) into ``out`` (d, d).

Matrices may have longer rows, as in `linalg`. ``nis`` is D^2 with whatever S the statistic should have (the nominal
one, if thresholds are chi-square quantiles); ``work`` is scratch (2 d, padded).
"""


call_factor = address_caller(FACTOR)


@kernel
def _inflate(R, inflation, d, out):
    """``out = inflation R``; an inflation that is no number leaves R alone."""
    if not inflation > 1.0:
        inflation = 1.0
    inflation = min(inflation, LARGEST_INFLATION)
    for i in range(d):
        for j in range(d):
            out[i, j] = inflation * R[i, j]


@kernel
def normalised_innovation(v, HPH, R, inflation, d, work):
    """``D^2 = v' S^-1 v`` with ``S = HPH + inflation R``; NaN where S is no covariance.

    ``work`` (2 d, padded) keeps the lower Cholesky factor L of S in its first d rows and ``L^-1 v`` in column 0 of the
    others. Plain loops: for two or three components the eight lanes of `linalg.cholesky` cost four times as much.
    """
    total = 0.0
    for i in range(d):
        seen = v[i]
        for j in range(i):
            entry = HPH[i, j] + inflation * R[i, j]
            for k in range(j):
                entry -= work[i, k] * work[j, k]
            entry /= work[j, j]
            work[i, j] = entry
            seen -= entry * work[d + j, 0]
        pivot = HPH[i, i] + inflation * R[i, i]
        for k in range(i):
            pivot -= work[i, k] * work[i, k]
        if not pivot > 0.0:
            return np.nan
        work[i, i] = math.sqrt(pivot)
        seen /= work[i, i]
        work[d + i, 0] = seen
        total += seen * seen
    return total


@kernel
def _chang_inflation(v, HPH, R, K, d, work):
    """Smallest ``kappa >= 1`` with ``v' (HPH + kappa R)^-1 v <= K``, by Newton on ``1 / D^2``.

    ``1 / D^2(kappa)`` is concave and increasing, so the iteration rises to the root from below; for d = 1 it is a
    straight line and one iteration is exact. Newton on ``D^2`` itself only doubles kappa each time far from the root.
    """
    kappa = 1.0
    for _ in range(_ITERATIONS):
        distance = normalised_innovation(v, HPH, R, kappa, d, work)
        if not distance > K:
            return kappa
        if not distance < np.inf:
            return LARGEST_INFLATION
        for i in range(d - 1, -1, -1):
            for k in range(i + 1, d):
                work[d + i, 0] -= work[k, i] * work[d + k, 0]
            work[d + i, 0] /= work[i, i]
        slope = 0.0
        for i in range(d):
            for j in range(d):
                slope += work[d + i, 0] * R[i, j] * work[d + j, 0]
        if not slope > 0.0:
            return LARGEST_INFLATION
        raised = kappa + (distance - K) / slope * (distance / K)
        if not raised < LARGEST_INFLATION:
            return LARGEST_INFLATION
        if raised <= kappa * (1.0 + 1e-15):
            return kappa
        kappa = raised
    return kappa


def _none(v, HPH, R, nis, thresholds, work, out):
    """``R~ = R``: the nominal filter."""
    _inflate(R, 1.0, v.size, out)


def _mr(v, HPH, R, nis, thresholds, work, out):
    """Two thresholds on D^2: ``R~ = sqrt(D^2 / K1) R`` above K1, rejection above K2."""
    if nis > thresholds[1]:
        _inflate(R, LARGEST_INFLATION, v.size, out)
    else:
        _inflate(R, math.sqrt(max(nis, 0.0) / thresholds[0]), v.size, out)


def _huber(v, HPH, R, nis, thresholds, work, out):
    """``R~ = (D / K) R`` for D > K. Differs: K is the root of a chi-square quantile, as D is the root of D^2."""
    _inflate(R, math.sqrt(max(nis, 0.0)) / thresholds[0], v.size, out)


def _rma(v, HPH, R, nis, thresholds, work, out):
    """Root-Mahalanobis: ``g = sqrt(D^2 + 0.001)``, ``R~ = g R`` for g > K; jumps from R to K R."""
    root = math.sqrt(max(nis, 0.0) + 1e-3)
    _inflate(R, root if root > thresholds[0] else 1.0, v.size, out)


def _mahalanobis(v, HPH, R, nis, thresholds, work, out):
    """For D^2 > K: ``R~ = diag_j max(|v_j^2 / K - (HPH)_jj|, R_jj)``; for d = 1 this makes D^2 equal K."""
    d = v.size
    _inflate(R, 1.0, d, out)
    if not nis > thresholds[0]:
        return
    for j in range(d):
        for i in range(d):
            out[j, i] = 0.0
        noise = abs(v[j] * v[j] / thresholds[0] - HPH[j, j])
        if not noise < LARGEST_INFLATION * R[j, j]:  # also where it is no number
            noise = LARGEST_INFLATION * R[j, j]
        out[j, j] = max(noise, R[j, j])


def _igg3(v, HPH, R, nis, thresholds, work, out):
    """IGG-III weights on D: 1 up to k0, ``(k0 / D) ((k1 - D) / (k1 - k0))^2`` up to k1, 0 beyond; ``R~ = R / weight``.

    Source: Yang, Song, Xu (2002), J. Geodesy.
    """
    root = math.sqrt(max(nis, 0.0))
    k0, k1 = thresholds[0], thresholds[1]
    inflation = 1.0
    if root >= k1:
        inflation = LARGEST_INFLATION
    elif root > k0:
        share = (k1 - k0) / (k1 - root)
        inflation = root / k0 * share * share
    _inflate(R, inflation, v.size, out)


def _chang(v, HPH, R, nis, thresholds, work, out):
    """``R~ = kappa R`` with kappa such that ``v' (HPH + kappa R)^-1 v = K`` exactly.

    Source: Chang (2014), J. Geodesy 88(4). Differs: Newton on 1 / D^2.
    """
    inflation = 1.0
    if nis > thresholds[0]:
        inflation = _chang_inflation(v, HPH, R, thresholds[0], v.size, work)
    _inflate(R, inflation, v.size, out)


def _chang_analytic(v, HPH, R, nis, thresholds, work, out):
    """``S~ = (D^2 / K) S`` for D^2 > K, that is ``R~ = (D^2 / K) S - HPH``; D^2 becomes K without iterating."""
    d = v.size
    share = min(max(nis / thresholds[0], 1.0), LARGEST_INFLATION)
    _inflate(R, 1.0, d, out)
    if share > 1.0:
        for i in range(d):
            for j in range(d):
                out[i, j] = share * R[i, j] + (share - 1.0) * HPH[i, j]


@dataclass(frozen=True)
class Factor:
    """One rule from innovation to measurement noise.

    Args:
        name: in the registry.
        function: of signature `FACTOR`; a plain function of Numba's subset will do.
        probabilities: chi-square probabilities of the thresholds, at most two; in (0, 1).
        root: thresholds apply to D, not to D^2.

    Raises:
        ValueError: a probability outside (0, 1), more than two, or not increasing.
    """

    name: str
    function: Callback
    probabilities: tuple[float, ...] = ()
    root: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.function, Callback):
            object.__setattr__(self, "function", Callback(self.function, FACTOR))
        try:
            values = tuple(float(value) for value in self.probabilities)
        except (TypeError, ValueError):
            values = (math.nan,)
        rising = all(low < high for low, high in zip((0.0, *values), (*values, 1.0)))
        if len(values) > 2 or not rising:
            raise ValueError(
                f"Factor: probabilities must be at most two increasing numbers in (0, 1); got {self.probabilities!r}. "
                "Give the share of good measurements below each threshold."
            )
        object.__setattr__(self, "probabilities", values)

    def thresholds(self, d: int) -> NDArray[np.float64]:
        """Thresholds for a measurement of ``d`` components: chi-square quantiles or their roots; (2,), unused = inf."""
        values = np.full(2, np.inf)
        quantiles = chi2.ppf(self.probabilities, d)
        values[: len(self.probabilities)] = np.sqrt(quantiles) if self.root else quantiles
        return values

    def adapt(self, innovation: ArrayLike, predicted: ArrayLike, noise: ArrayLike) -> NDArray[np.float64]:
        """The noise to use with one measurement.

        Args:
            innovation: v; (d,).
            predicted: covariance of the predicted measurement ``H P H'``; (d, d).
            noise: nominal R; (d, d).

        Returns:
            R~; (d, d).

        Raises:
            ValueError: shapes do not fit.
        """
        v = np.ascontiguousarray(innovation, dtype=np.float64)
        d = v.size
        if v.ndim != 1 or d == 0 or np.shape(predicted) != (d, d) or np.shape(noise) != (d, d):
            raise ValueError(
                "Factor.adapt: innovation, predicted, noise must have shapes (d,), (d, d), (d, d); got "
                f"{np.shape(innovation)}, {np.shape(predicted)}, {np.shape(noise)}. Use the components present."
            )
        HPH, R, out, work = (np.zeros((rows, padded(d))) for rows in (d, d, d, 2 * d))
        HPH[:, :d], R[:, :d] = predicted, noise
        _adapt_one(self.function.address, v, HPH, R, self.thresholds(d), work, out)
        return np.ascontiguousarray(out[:, :d])


@entry_kernel
def _adapt_one(address, v, HPH, R, thresholds, work, out):
    nis = normalised_innovation(v, HPH, R, 1.0, v.size, work)
    call_factor(address, v, HPH, R, nis, thresholds, work, out)


# 2.5 of the inventor's code for d = 2 as a probability, so that it means the same for other d.
_RMA_PROBABILITY = 1.0 - math.exp(-0.5 * 2.5**2)

FACTORS: dict[str, Factor] = {
    factor.name: factor
    for factor in (
        Factor("none", Callback(_none, FACTOR)),
        Factor("mr", Callback(_mr, FACTOR), (0.90, 0.99)),
        Factor("huber", Callback(_huber, FACTOR), (0.95,), root=True),
        Factor("rma", Callback(_rma, FACTOR), (_RMA_PROBABILITY,), root=True),
        Factor("mahalanobis", Callback(_mahalanobis, FACTOR), (0.95,)),
        Factor("igg3", Callback(_igg3, FACTOR), (0.90, 0.9999), root=True),
        Factor("chang", Callback(_chang, FACTOR), (0.95,)),
        Factor("chang-analytic", Callback(_chang_analytic, FACTOR), (0.95,)),
    )
}
"""By name. For d = 2 the thresholds are 4.605 and 9.210, 2.448, 2.5, 5.991, 2.146 and 4.292, 5.991, 5.991."""


def make_factor(name: str, probabilities: tuple[float, ...] | None = None) -> Factor:
    """The factor of that name, with other thresholds if wanted.

    Args:
        name: a key of `FACTORS`.
        probabilities: chi-square probabilities of its thresholds; None: the usual ones.

    Returns:
        The factor.

    Raises:
        ValueError: unknown name, or probabilities that do not fit it.
    """
    factor = FACTORS.get(name) if isinstance(name, str) else None
    if factor is None:
        raise ValueError(
            f"make_factor: name must be one of {', '.join(FACTORS)}; got {name!r}. Pick one, or add it to FACTORS."
        )
    if probabilities is None:
        return factor
    if np.ndim(probabilities) != 1 or len(probabilities) != len(factor.probabilities):
        raise ValueError(
            f"make_factor: probabilities of {name} must have {len(factor.probabilities)} entries; "
            f"got {len(probabilities) if np.ndim(probabilities) == 1 else probabilities!r}. Give one per threshold."
        )
    return replace(factor, probabilities=tuple(probabilities))
