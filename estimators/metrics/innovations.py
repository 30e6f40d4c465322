"""Innovations: unit covariance, and no correlation in time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from jink.estimators.metrics.steps import Floats, Ints, as_tracks, check_level, step_mask


class Whiteness(NamedTuple):
    """Autocorrelation of innovations: lags (L,), correlation (L,), half width (L,) of its band about 0."""

    lags: Ints
    correlation: Floats
    band: Floats


def normalise_innovations(innovations: ArrayLike, covs: ArrayLike) -> Floats:
    """Innovations with unit covariance, L^-1 v where S = L L' (lower Cholesky factor).

    Args:
        innovations: (..., D); NaN = missing component; measurement units.
        covs: (..., D, D); rows and columns of missing components are not read.
    Returns:
        (..., D), no unit; NaN stays NaN; the squares of the rest add up to the NIS.
    Raises:
        ValueError: shapes do not fit, or a covariance is not positive definite.
    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4. Differs: none.
    """
    v = np.asarray(innovations, dtype=np.float64)
    S = np.asarray(covs, dtype=np.float64)
    if v.ndim < 1 or S.shape != (*v.shape, v.shape[-1]):
        raise ValueError(
            f"normalise_innovations: covs must have shape (..., D, D) beside (..., D); "
            f"got {S.shape} and {v.shape}. Give one covariance per innovation."
        )
    present = np.isfinite(v)
    both = present[..., :, None] & present[..., None, :]
    S = np.where(both, S, np.eye(v.shape[-1]))
    try:
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "normalise_innovations: covs must be positive definite; got one that is not. "
            "Pass innovation covariances that include the measurement noise."
        ) from error
    white = np.linalg.solve(L, np.where(present, v, 0.0)[..., None])[..., 0]
    return np.where(present, white, np.nan)


def whiteness(
    innovations: ArrayLike, lags: Sequence[int] = (1,), lengths: ArrayLike | None = None, level: float = 0.95
) -> Whiteness:
    """Time autocorrelation of normalised innovations; zero within the band for a matched filter.

    Model: rho(l) = sum e_k . e_{k+l} / sqrt(sum |e_k|^2 sum |e_{k+l}|^2), sums over tracks, times and
    components present at both ends; rho ~ N(0, 1/N) with N the number of scalar products.

    Args:
        innovations: (B, T, D) or (T, D), normalised; NaN = missing.
        lags: steps l >= 1 between the two factors.
        lengths: (B,) valid rows per track.
        level: probability of the band.
    Returns:
        Whiteness; NaN for a lag without pairs.
    Raises:
        ValueError: wrong shape, a lag below 1 or level outside (0, 1).
    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4. Differs: N counts components too.
    """
    check_level("whiteness", level)
    if any(lag < 1 for lag in lags):
        raise ValueError(f"whiteness: lags must be >= 1; got {list(lags)}. Lag 0 is always one.")
    e = as_tracks("whiteness", "innovations", innovations, 3)
    e = np.where(step_mask((e.shape[0], e.shape[1]), lengths)[:, :, None], e, np.nan)
    rho, band = np.full(len(lags), np.nan), np.full(len(lags), np.nan)
    half = float(stats.norm.ppf(0.5 * (1.0 + level)))
    for i, lag in enumerate(lags):
        early, late = e[:, :-lag], e[:, lag:]
        pair = np.isfinite(early) & np.isfinite(late)
        if pair.any():
            x, y = early[pair], late[pair]
            rho[i] = np.dot(x, y) / np.sqrt(np.dot(x, x) * np.dot(y, y))
            band[i] = half / np.sqrt(x.size)
    return Whiteness(np.asarray(lags, dtype=np.int64), rho, band)
