"""Whether a bank that judges its own noise has gone astray, and beginning it again.

Who adapts R to each innovation finds every innovation probable, so the NIS with that R says nothing. A measurement is
*refused* here if the whole bank's innovation lies beyond the chi-square bound of 99.9 % with the nominal R. Surges
are refused too, for as long as they last; but their innovations point anywhere, while those of a bank that has lost
its target point to one side for many rows. So what counts is whether refusals in a row agree in direction.
"""

from __future__ import annotations

import math

from jink.estimators.compiled import inner_kernel
from jink.estimators.factors import normalised_innovation
from jink.estimators.interaction import birth
from jink.estimators.linalg import copy_vector
from jink.estimators.records import ABSURD

__all__ = ["AGREED", "BEGUN", "REFUSED", "begin_again", "refusals_agree", "widening"]

REFUSED, AGREED = 1, 2
"""Sum of what `refusals_agree` found."""
BEGUN = 2
"""In ``Outputs.refused``: the bank began again after this row."""

_BOUND = 3.0902323061678132
"""Normal quantile of 99.9 %."""
_GAIN, _FADING, _AGREED = 0.1, 0.05, 0.65
_PATIENCE = 5
_NARROW, _MARGIN, _WIDEST, _WIDEST_ANGLE = 0.01, 2.0, 1e6, 0.3


@inner_kernel
def refusals_agree(refusals, whitened, present, nis, d):
    """Whether this measurement is refused, and whether refused ones keep lying on the same side.

    That takes about a dozen in a row, or more with gaps.

    Model: ``u = L^-1 v / D``; where D^2 exceeds its bound ``c <- c + 0.1 (u' u_before - c)``, else ``c <- 0.95 c``;
    agreed where ``c > 0.65``. In a surge ``u' u_before`` has mean 0 and c a standard deviation of 0.23, 0.16, 0.13 for
    one, two, three components.

    Args:
        refusals: rows agreed so far, in a row; c; last u; (2 + D,); updated.
        whitened: ``L^-1 v`` with the nominal S; (d, any), first column.
        present, nis, d: components present, nominal D^2, number of components.

    Returns:
        Sum of `REFUSED` and `AGREED`, or 0.

    Source: bound by Wilson & Hilferty (1931).
    """
    spread = 2.0 / (9.0 * d)
    root = 1.0 - spread + _BOUND * math.sqrt(spread)
    refused = nis > d * root * root * root
    if refused:
        cosine = 0.0
        for a in range(d):
            u = whitened[a, 0] / math.sqrt(nis)
            cosine += u * refusals[2 + present[a]]
            refusals[2 + present[a]] = u
        refusals[1] += _GAIN * (cosine - refusals[1])
    else:
        refusals[1] *= 1.0 - _FADING
    agreed = refusals[1] > _AGREED
    refusals[0] = refusals[0] + 1.0 if agreed else 0.0
    return (REFUSED if refused else 0) + (AGREED if agreed else 0)


@inner_kernel
def widening(program, v, S, R, calm, d, work):
    """Factor on a covariance that makes an innovation ``v`` ordinary: its NIS without (most of) the noise.

    No angle gets wider than 0.3 rad: beyond, a nonlinear sensor's sigma points would throw the track farther off. And
    nothing wider than a million standard deviations of the noise: the update would lose the digits it needs.

    Args:
        program: whose sensor it is.
        v, S: innovation and its covariance with noise ``calm R``.
        R, calm, d: noise, its nominal factor, number of components.
        work: bank's scratch.
    """
    HPH = work.HPH
    for a in range(d):
        for b in range(d):
            HPH[a, b] = S[a, b] - calm * R[a, b]
    nis = normalised_innovation(v, HPH, R, _NARROW * calm, d, work.statistic)
    factor = _MARGIN * nis / d if nis < ABSURD else 1.0
    for a in range(d):
        most = _WIDEST * _WIDEST * calm * R[a, a]
        if program.sensor_angular[work.present[a]]:
            most = min(most, _WIDEST_ANGLE * _WIDEST_ANGLE)
        if factor * HPH[a, a] > most:
            factor = most / HPH[a, a]
    return max(factor, 1.0)


@inner_kernel
def begin_again(program, work, state, b, widen_by):
    """Births of all modes where the bank believes its target, ``widen_by`` times less sure; at the start's odds.

    Only after refusals have agreed for some rows more; returns whether it did. What is measured next then decides.
    """
    if not state.refusals[b, 0] > _PATIENCE:
        return False
    kin_cov = state.kin_cov[b]
    size = 0.0
    for a in range(kin_cov.shape[0]):
        size = max(size, kin_cov[a, a])
    if not size * widen_by < ABSURD:
        return False
    for a in range(kin_cov.shape[0]):
        for c in range(kin_cov.shape[0]):
            kin_cov[a, c] *= widen_by
    for j in range(program.sizes.size):
        birth(program, work, j, state.kin_mean[b], kin_cov, state.mean[b, j], state.cov[b, j])
        state.nis_average[b, j] = 1.0
    state.nis_average[b, program.sizes.size] = 1.0
    copy_vector(program.start_probs, state.mode_probs[b])
    for i in range(state.refusals.shape[1]):
        state.refusals[b, i] = 0.0
    return True
