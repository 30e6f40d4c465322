"""Velocity at the end of a step and its mean over the step, from a state and a row of the law tables; and back.

``row`` is one row of `jink.intent.torch_tables.FIELDS`; a name ending in ``_bar`` is the derivative of the likelihood
by what the name stands for, added to.
"""

from __future__ import annotations

import math

from jink.estimators.compiled import kernel
from jink.estimators.motions.bilinear import LARGEST_GROWTH
from jink.estimators.motions.series import stumpff

__all__ = ["shapes", "shapes_adjoint", "velocities", "velocities_adjoint"]


_INVERSE = tuple(1.0 / math.factorial(k) for k in range(17))


@kernel
def _plane(growth, angle):
    """Real and imaginary parts of ``e^z``, of ``(e^z - 1)/z = phi`` and of ``phi'``.

    A step turns by less than half a radian as a rule: there series give all three without an exponential.
    """
    size = growth * growth + angle * angle
    if size < 0.25:
        last = 7 if size < 2.5e-3 else 13
        real, imag = _INVERSE[last + 1], 0.0
        slope_real, slope_imag = (last + 1) * _INVERSE[last + 2], 0.0
        for k in range(last, 0, -1):
            real, imag = _INVERSE[k] + real * growth - imag * angle, real * angle + imag * growth
            slope_real, slope_imag = (
                k * _INVERSE[k + 1] + slope_real * growth - slope_imag * angle,
                slope_real * angle + slope_imag * growth,
            )
        return (
            1.0 + growth * real - angle * imag,
            growth * imag + angle * real,
            real,
            imag,
            slope_real,
            slope_imag,
        )
    factor = math.exp(growth)
    half = math.sin(0.5 * angle)
    cosine = 1.0 - 2.0 * half * half
    sine = factor * math.sin(angle)
    x = math.expm1(growth) * cosine - 2.0 * half * half
    end = factor * cosine
    real = (x * growth + sine * angle) / size
    imag = (sine * growth - x * angle) / size
    dr = end - real
    di = sine - imag
    return end, sine, real, imag, (dr * growth + di * angle) / size, (di * growth - dr * angle) / size


@kernel
def _space(growth, square):
    """Coefficients of ``v``, ``a x v``, ``a x (a x v)`` in the end and mean velocity, and their derivatives.

    Order: e0 e1 e2 m0 m1 m2; by growth of m0 m1 m2; by ``square = |a|^2`` of e1 e2 m1 m2. By growth e0 e1 e2 are
    themselves.
    """
    factor = math.exp(growth)
    _, c1, c2, c3, c4, _, _, _ = stumpff(math.sqrt(square))
    e1 = factor * c1
    e2 = factor * c2
    e1_s = 0.5 * factor * (c3 - c2)
    e2_s = 0.5 * factor * (2.0 * c4 - c3)
    size = growth * growth + square
    if size < 0.25:
        power, real, imag, defect = 1.0, 1.0, 0.0, 0.0
        power_g, real_g, imag_g, defect_g = 0.0, 0.0, 0.0, 0.0
        real_s, imag_s, defect_s = 0.0, 0.0, 0.0
        m0, m1, m2, m0_g, m1_g, m2_g, m1_s, m2_s = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        scale = 1.0
        for k in range(1, 18):
            defect_g = defect + growth * defect_g + imag_g
            defect_s = growth * defect_s + imag_s
            defect = growth * defect + imag
            power_g = power + growth * power_g
            power *= growth
            next_g = real + growth * real_g - square * imag_g
            next_s = growth * real_s - imag - square * imag_s
            following = growth * real - square * imag
            imag_g = imag + growth * imag_g + real_g
            imag_s = growth * imag_s + real_s
            imag = growth * imag + real
            real, real_g, real_s = following, next_g, next_s
            scale /= k + 1
            m0 += scale * power
            m1 += scale * imag
            m2 += scale * defect
            m0_g += scale * power_g
            m1_g += scale * imag_g
            m2_g += scale * defect_g
            m1_s += scale * imag_s
            m2_s += scale * defect_s
        return factor, e1, e2, m0, m1, m2, m0_g, m1_g, m2_g, e1_s, e2_s, m1_s, m2_s
    grown = math.expm1(growth)
    if abs(growth) < 1e-2:
        m0 = 1.0 + growth / 2.0 * (1.0 + growth / 3.0 * (1.0 + growth / 4.0 * (1.0 + growth / 5.0)))
        m0_g = 0.5 + growth * (1.0 / 3.0 + growth * (0.125 + growth * (1.0 / 30.0 + growth / 144.0)))
        m0 += growth * growth * growth * growth * growth / 720.0 * (1.0 + growth / 7.0)
        m0_g += growth * growth * growth * growth * growth / 840.0
    else:
        m0 = grown / growth
        m0_g = (factor - m0) / growth
    m1 = (growth * e1 - grown + square * e2) / size
    m2 = (m0 + growth * e2 - e1) / size
    m1_g = (e1 + growth * e1 - factor + square * e2 - 2.0 * growth * m1) / size
    m2_g = (m0_g + e2 + growth * e2 - e1 - 2.0 * growth * m2) / size
    m1_s = (growth * e1_s + e2 + square * e2_s - m1) / size
    m2_s = (growth * e2_s - e1_s - m2) / size
    return factor, e1, e2, m0, m1, m2, m0_g, m1_g, m2_g, e1_s, e2_s, m1_s, m2_s


@kernel
def _angle(row, x, at, after, second):
    value = row[4] + row[5] * x[at]
    return value + row[6] * x[after] if second else value


@kernel
def velocities(axes, second, row, x, end, mean):
    """Velocity at the end of the step into ``end`` (A,), its mean over the step into ``mean`` (A,)."""
    growth = min(row[0] + row[1] * x[2 * axes], LARGEST_GROWTH)
    if axes == 2:
        er, ei, mr, mi, _, _ = _plane(growth, _angle(row, x, 5, 6, second))
        vx = x[1]
        vy = x[3]
        end[0] = er * vx - ei * vy
        end[1] = ei * vx + er * vy
        mean[0] = mr * vx - mi * vy
        mean[1] = mi * vx + mr * vy
        return
    ax = _angle(row, x, 7, 10, second)
    ay = _angle(row, x, 8, 11, second)
    az = _angle(row, x, 9, 12, second)
    e0, e1, e2, m0, m1, m2, _, _, _, _, _, _, _ = _space(growth, ax * ax + ay * ay + az * az)
    vx = x[1]
    vy = x[3]
    vz = x[5]
    tx = ay * vz - az * vy
    ty = az * vx - ax * vz
    tz = ax * vy - ay * vx
    nx = ay * tz - az * ty
    ny = az * tx - ax * tz
    nz = ax * ty - ay * tx
    end[0] = e0 * vx + e1 * tx + e2 * nx
    end[1] = e0 * vy + e1 * ty + e2 * ny
    end[2] = e0 * vz + e1 * tz + e2 * nz
    mean[0] = m0 * vx + m1 * tx + m2 * nx
    mean[1] = m0 * vy + m1 * ty + m2 * ny
    mean[2] = m0 * vz + m1 * tz + m2 * nz


@kernel
def _angle_adjoint(row, x, at, after, second, bar, x_bar, row_bar):
    row_bar[4] += bar
    row_bar[5] += bar * x[at]
    x_bar[at] += bar * row[5]
    if second:
        row_bar[6] += bar * x[after]
        x_bar[after] += bar * row[6]


@kernel
def velocities_adjoint(axes, second, row, x, end_bar, mean_bar, x_bar, row_bar):
    """Add to ``x_bar`` and ``row_bar`` what derivatives by the end and mean velocity say."""
    own = 2 * axes
    raw = row[0] + row[1] * x[own]
    growth = min(raw, LARGEST_GROWTH)
    growth_bar = 0.0
    if axes == 2:
        er, ei, mr, mi, dr, di = _plane(growth, _angle(row, x, 5, 6, second))
        vx = x[1]
        vy = x[3]
        ex = end_bar[0]
        ey = end_bar[1]
        px = mean_bar[0]
        py = mean_bar[1]
        x_bar[1] += er * ex + ei * ey + mr * px + mi * py
        x_bar[3] += er * ey - ei * ex + mr * py - mi * px
        er_bar = ex * vx + ey * vy
        ei_bar = ey * vx - ex * vy
        mr_bar = px * vx + py * vy
        mi_bar = py * vx - px * vy
        growth_bar = er_bar * er + ei_bar * ei + mr_bar * dr + mi_bar * di
        angle_bar = ei_bar * er - er_bar * ei + mi_bar * dr - mr_bar * di
        _angle_adjoint(row, x, 5, 6, second, angle_bar, x_bar, row_bar)
    else:
        ax = _angle(row, x, 7, 10, second)
        ay = _angle(row, x, 8, 11, second)
        az = _angle(row, x, 9, 12, second)
        e0, e1, e2, m0, m1, m2, m0_g, m1_g, m2_g, e1_s, e2_s, m1_s, m2_s = _space(growth, ax * ax + ay * ay + az * az)
        vx = x[1]
        vy = x[3]
        vz = x[5]
        tx = ay * vz - az * vy
        ty = az * vx - ax * vz
        tz = ax * vy - ay * vx
        nx = ay * tz - az * ty
        ny = az * tx - ax * tz
        nz = ax * ty - ay * tx
        ex = end_bar[0]
        ey = end_bar[1]
        ez = end_bar[2]
        px = mean_bar[0]
        py = mean_bar[1]
        pz = mean_bar[2]
        e0_bar = ex * vx + ey * vy + ez * vz
        e1_bar = ex * tx + ey * ty + ez * tz
        e2_bar = ex * nx + ey * ny + ez * nz
        m0_bar = px * vx + py * vy + pz * vz
        m1_bar = px * tx + py * ty + pz * tz
        m2_bar = px * nx + py * ny + pz * nz
        growth_bar = e0_bar * e0 + e1_bar * e1 + e2_bar * e2 + m0_bar * m0_g + m1_bar * m1_g + m2_bar * m2_g
        twice = 2.0 * (e1_bar * e1_s + e2_bar * e2_s + m1_bar * m1_s + m2_bar * m2_s)
        # n = a x t, then t = a x v
        nbx = e2 * ex + m2 * px
        nby = e2 * ey + m2 * py
        nbz = e2 * ez + m2 * pz
        tbx = e1 * ex + m1 * px + nby * az - nbz * ay
        tby = e1 * ey + m1 * py + nbz * ax - nbx * az
        tbz = e1 * ez + m1 * pz + nbx * ay - nby * ax
        x_bar[1] += e0 * ex + m0 * px + tby * az - tbz * ay
        x_bar[3] += e0 * ey + m0 * py + tbz * ax - tbx * az
        x_bar[5] += e0 * ez + m0 * pz + tbx * ay - tby * ax
        abx = twice * ax + ty * nbz - tz * nby + vy * tbz - vz * tby
        aby = twice * ay + tz * nbx - tx * nbz + vz * tbx - vx * tbz
        abz = twice * az + tx * nby - ty * nbx + vx * tby - vy * tbx
        _angle_adjoint(row, x, 7, 10, second, abx, x_bar, row_bar)
        _angle_adjoint(row, x, 8, 11, second, aby, x_bar, row_bar)
        _angle_adjoint(row, x, 9, 12, second, abz, x_bar, row_bar)
    if raw <= LARGEST_GROWTH:
        row_bar[0] += growth_bar
        row_bar[1] += growth_bar * x[own]
        x_bar[own] += growth_bar * row[1]


@kernel
def shapes(axes, second, row, x, out):
    """Shape parameters at the end of the step into their places in ``out`` (N,)."""
    own = 2 * axes
    turns = 1 if axes == 2 else 3
    out[own] = row[2] + row[3] * x[own]
    for k in range(own + 1, own + 1 + turns):
        if second:
            out[k] = row[7] + row[8] * x[k] + row[9] * x[k + turns]
            out[k + turns] = row[10] + row[11] * x[k] + row[12] * x[k + turns]
        else:
            out[k] = row[7] + row[8] * x[k]


@kernel
def shapes_adjoint(axes, second, row, x, out_bar, x_bar, row_bar):
    """Add to ``x_bar`` and ``row_bar`` what derivatives by the shape parameters at the end say."""
    own = 2 * axes
    turns = 1 if axes == 2 else 3
    bar = out_bar[own]
    row_bar[2] += bar
    row_bar[3] += bar * x[own]
    x_bar[own] += bar * row[3]
    for k in range(own + 1, own + 1 + turns):
        bar = out_bar[k]
        row_bar[7] += bar
        row_bar[8] += bar * x[k]
        x_bar[k] += bar * row[8]
        if second:
            row_bar[9] += bar * x[k + turns]
            x_bar[k + turns] += bar * row[9]
            bar = out_bar[k + turns]
            row_bar[10] += bar
            row_bar[11] += bar * x[k]
            row_bar[12] += bar * x[k + turns]
            x_bar[k] += bar * row[11]
            x_bar[k + turns] += bar * row[12]
