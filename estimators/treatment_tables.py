"""Noise treatments as tables, one row per mode, for the compiled cycle."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import poch, roots_jacobi

from jink.estimators.compiled import Callback
from jink.estimators.factors import FACTOR
from jink.estimators.treatment_kernels import ADAPTING, ERRING, SCALED, TAILED, bounded_tails
from jink.estimators.treatments import (
    DENSITIES,
    Adaptive,
    BoundedTails,
    HeavyTails,
    Level,
    Treatment,
    Uncertain,
)

__all__ = ["TreatmentTables", "reset_by_divergence", "reset_by_moments", "treatment_tables"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_BOUNDED = Callback(bounded_tails, FACTOR)
_NODES = 200
_NEARLY_GAUSSIAN = 300.0


class TreatmentTables(NamedTuple):
    """Fields of `Program`; M modes, N padded components, D measured ones, q errors, t excitations."""

    treated: Ints  # (M,) sum of SCALED, ADAPTING, TAILED, ERRING; 0: none
    noise_scale: Floats  # (M,) factor on R
    process_scale: Floats  # (M,) factor on Q
    spread_scale: Floats  # (M,) factor on the spread of means when mixing
    factor: Ints  # (M,) address of signature FACTOR
    thresholds: Floats  # (M, D, 2) by number of components present
    cap: Floats  # (M,) of R~ over R
    density: Ints  # (M,) NOMINAL, ADAPTED, STUDENT
    dof: Floats  # (M,)
    density_constant: Floats  # (M, D) of ln t by number of components present, without the determinant
    reset_scale: Floats  # (M, D) of a dof reset
    error: Floats  # (M, N, q) M
    excitation: Floats  # (M, t, N) E_f
    noise_excitation: Floats  # (M, t, N) E_g
    error_count: Ints  # (M,)
    excitation_count: Ints  # (M,)
    alpha: Floats  # (M,)
    optimise: NDArray[np.bool_]  # (M,) regulation is searched


def reset_by_moments(dof: float, d: int) -> float:
    """Factor on the scale matrix when dof ``dof + d`` becomes ``dof`` at equal covariance."""
    risen = dof + d
    return (dof - 2.0) * risen / (dof * (risen - 2.0))


def reset_by_divergence(dof: float, d: int, n: int) -> float:
    """The same at least Kullback-Leibler divergence from the t with the risen dof, for ``n`` components.

    Solves ``(nu + n) E[u / (c nu + u)] = n``, ``u = n F(n, nu + d)``; with ``u = nu' x / (1 - x)``, x is a beta
    variable and the expectation a Gauss-Jacobi sum.
    Source: Roth, Ardeshiri, Ozkan, Gustafsson (2017). Differs: none.
    """
    risen = dof + d
    if dof > _NEARLY_GAUSSIAN:
        return reset_by_moments(dof, d)
    nodes, weights = roots_jacobi(_NODES, 0.5 * risen - 1.0, 0.5 * n - 1.0)
    x = 0.5 * (nodes + 1.0)
    weights = weights / weights.sum()

    def excess(c: float) -> float:
        return float((dof + n) * np.sum(weights * risen * x / (c * dof * (1.0 - x) + risen * x)) - n)

    return float(brentq(excess, 1e-3, 1e3, xtol=1e-14))


def _log_constant(dof: float, d: int) -> float:
    """``ln Gamma((nu + d) / 2) - ln Gamma(nu / 2) - d / 2 ln(nu pi)``."""
    return float(np.log(poch(0.5 * dof, 0.5 * d))) - 0.5 * d * math.log(dof * math.pi)


def treatment_tables(
    treatments: tuple[tuple[Treatment, ...], ...], sizes: tuple[int, ...], states: int, measured: int
) -> TreatmentTables:
    """Tables of the treatments of M modes.

    Args:
        treatments: of each mode.
        sizes: state components of each mode.
        states: padded components N.
        measured: components of a measurement D.
    """
    modes = len(treatments)
    uncertain = [item for items in treatments for item in items if isinstance(item, Uncertain)]
    errors = max((len(item.error[0]) for item in uncertain), default=1)
    excitations = max((len(item.excitation) for item in uncertain), default=1)
    tables = TreatmentTables(
        treated=np.zeros(modes, dtype=np.int64),
        noise_scale=np.ones(modes),
        process_scale=np.ones(modes),
        spread_scale=np.ones(modes),
        factor=np.zeros(modes, dtype=np.int64),
        thresholds=np.full((modes, measured, 2), np.inf),
        cap=np.full(modes, np.inf),
        density=np.zeros(modes, dtype=np.int64),
        dof=np.full(modes, np.inf),
        density_constant=np.zeros((modes, measured)),
        reset_scale=np.ones((modes, measured)),
        error=np.zeros((modes, states, errors)),
        excitation=np.zeros((modes, excitations, states)),
        noise_excitation=np.zeros((modes, excitations, states)),
        error_count=np.zeros(modes, dtype=np.int64),
        excitation_count=np.zeros(modes, dtype=np.int64),
        alpha=np.zeros(modes),
        optimise=np.zeros(modes, dtype=np.bool_),
    )
    counts = range(1, measured + 1)
    for j, items in enumerate(treatments):
        for item in items:
            if isinstance(item, Level):
                tables.noise_scale[j] *= item.scale
            elif isinstance(item, Adaptive):
                tables.treated[j] |= ADAPTING
                tables.factor[j] = item.rule.function.address
                tables.thresholds[j] = [item.rule.thresholds(d) for d in counts]
                tables.cap[j], tables.density[j], tables.dof[j] = item.cap, DENSITIES[item.likelihood], item.dof
            elif isinstance(item, BoundedTails):
                tables.treated[j] |= ADAPTING
                tables.factor[j] = _BOUNDED.address
                tables.thresholds[j] = [item.dof, item.iterations]
                tables.density[j], tables.dof[j] = DENSITIES["t"], item.dof
            elif isinstance(item, HeavyTails):
                _tails(tables, j, item, sizes[j])
            else:
                n, q, t = sizes[j], len(item.error[0]), len(item.excitation)
                if np.any(item.excitation) or np.any(item.noise_excitation):  # else nothing excites the error
                    tables.treated[j] |= ERRING
                tables.error[j, :n, :q] = item.error
                tables.excitation[j, :t, :n] = item.excitation
                tables.noise_excitation[j, :t, :n] = item.noise_excitation
                tables.error_count[j], tables.excitation_count[j], tables.alpha[j] = q, t, item.alpha
                tables.optimise[j] = item.optimise
        if tables.noise_scale[j] != 1.0:
            tables.treated[j] |= SCALED
        if np.isfinite(tables.dof[j]):
            tables.density_constant[j] = [_log_constant(tables.dof[j], d) for d in counts]
    return tables


def _tails(tables: TreatmentTables, j: int, item: HeavyTails, n: int) -> None:
    if item.matrices == "scale":
        tables.noise_scale[j] *= item.spread("noise_dof")
        tables.process_scale[j] = item.spread("process_dof")
    if item.mix_factor == "plain":
        tables.spread_scale[j] = item.spread("dof")
    if math.isinf(item.dof):
        return
    tables.treated[j] |= TAILED
    tables.dof[j] = item.dof
    for d in range(1, tables.reset_scale.shape[1] + 1):
        tables.reset_scale[j, d - 1] = (
            reset_by_moments(item.dof, d) if item.reset == "moments" else reset_by_divergence(item.dof, d, n)
        )
