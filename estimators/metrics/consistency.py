"""Whether normalised errors and innovations lie in the bands that a matched filter keeps."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from jink.estimators.metrics.steps import as_tracks, check_level, check_shape, step_mask


class Consistency(NamedTuple):
    """An average of chi-square distributed quantities beside the band it should lie in.

    mean: average value (NEES: about the dof; NIS: already divided by the dof, about 1).
    low, high: two-sided band of that average at the requested level, for independent samples.
    share_inside: fraction of the single values (NIS) or of the per-time averages (NEES) in their own bands.
    samples: how many values were averaged.
    """

    mean: float
    low: float
    high: float
    share_inside: float
    samples: int


def chi_square_band(dof: float, runs: int = 1, level: float = 0.95) -> tuple[float, float]:
    """Two-sided band of the average of `runs` independent chi-square variables.

    Args:
        dof: degrees of freedom of one of them.
        runs: how many are averaged (N).
        level: probability inside, split evenly over both tails.
    Returns:
        (low, high), around `dof`.
    Raises:
        ValueError: dof <= 0, runs < 1 or level outside (0, 1).
    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4: chi2_{nN} / N. Differs: none.
    """
    check_level("chi_square_band", level)
    if not dof > 0.0 or runs < 1:
        raise ValueError(
            f"chi_square_band: dof and runs must be positive; got dof={dof}, runs={runs}. "
            "Count at least one run and one component."
        )
    tail = 0.5 * (1.0 - level)
    low, high = stats.chi2.ppf([tail, 1.0 - tail], dof * runs) / runs
    return float(low), float(high)


def average_nees(values: ArrayLike, dof: int, level: float = 0.95) -> Consistency:
    """ANEES of a batch of runs against its band.

    At each time the average over the N_t scored tracks is compared with the band for N_t runs;
    `share_inside` is the fraction of times inside, about `level` for a consistent filter. `low, high` is the
    band of the average over the tracks of one typical time (median N_t): errors of one track are correlated
    in time, so `mean`, which also averages over time, should lie well within it.

    Args:
        values: (B, T) from `nees` or `position_nees`; NaN = not scored.
        dof: 2A or A.
        level: probability of the band.
    Returns:
        Consistency; `mean` is about `dof` (not divided by it); all NaN when nothing is scored.
    Raises:
        ValueError: wrong shape, dof <= 0 or level outside (0, 1).
    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4. Differs: not divided by dof, unlike Li and Zhao's ANEES.
    """
    check_level("average_nees", level)
    table = as_tracks("average_nees", "values", values, 2)
    present = ~np.isnan(table)
    count = present.sum(axis=0)
    used = count > 0
    if not used.any():
        return Consistency(np.nan, np.nan, np.nan, np.nan, 0)
    total = np.where(present, table, 0.0).sum(axis=0)
    bands = {int(n): chi_square_band(dof, int(n), level) for n in np.unique(count[used])}
    low, high = np.array([bands[int(n)] for n in count[used]]).T
    per_time = total[used] / count[used]
    inside = (per_time >= low) & (per_time <= high)
    band = chi_square_band(dof, max(int(np.median(count[used])), 1), level)
    return Consistency(float(total.sum() / count.sum()), *band, float(inside.mean()), int(count.sum()))


def nis_consistency(
    nis: ArrayLike,
    nis_dof: ArrayLike,
    lengths: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    level: float = 0.95,
) -> Consistency:
    """Normalised innovations squared against their bands, each with its own number of components.

    Model: sum NIS / sum dof, which is chi2_{sum dof} / sum dof because the innovations of a matched filter
    are independent. Each value is also judged by the band of its own dof (partial measurements have fewer).

    Args:
        nis: (B, T) or (T,).
        nis_dof: same shape; components really used; 0 = no measurement, ignored.
        lengths: (B,) valid rows per track.
        mask: (B, T) or (T,) steps to count.
        level: probability of the bands.
    Returns:
        Consistency; `mean`, `low`, `high` are per degree of freedom (about 1); all NaN without measurements.
    Raises:
        ValueError: shapes differ or level outside (0, 1).
    Source: Bar-Shalom, Li, Kirubarajan (2001), 5.4. Differs: pooled over different dimensions.
    """
    check_level("nis_consistency", level)
    values = as_tracks("nis_consistency", "nis", nis, 2)
    dof = as_tracks("nis_consistency", "nis_dof", nis_dof, 2)
    check_shape("nis_consistency", "nis_dof", dof, (values.shape[0], values.shape[1]))
    used = step_mask((values.shape[0], values.shape[1]), lengths, mask) & (dof > 0)
    v, d = values[used], dof[used]
    if not v.size:
        return Consistency(np.nan, np.nan, np.nan, np.nan, 0)
    low, high = chi_square_band(float(d.sum()), 1, level)
    tail = 0.5 * (1.0 - level)
    inside = (v >= stats.chi2.ppf(tail, d)) & (v <= stats.chi2.ppf(1.0 - tail, d))
    total = float(d.sum())
    return Consistency(float(v.sum()) / total, low / total, high / total, float(inside.mean()), int(v.size))
