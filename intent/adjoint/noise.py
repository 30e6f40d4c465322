"""Process noise of a state from a row of the law tables, and back.

Growth acts along the velocity and a turn across it: each shape parameter has a column (mean velocity of the step for
position, last one for velocity), and its moments (double integral, integral, value, slope) spread along that column.
"""

from __future__ import annotations

from jink.estimators.compiled import kernel
from jink.intent.adjoint.velocities import velocities, velocities_adjoint

__all__ = ["add_noise", "noise_adjoint"]


@kernel
def _column(axes, k, velocity, out):
    """Column ``k`` of ``velocity``: itself (0), or crossed from the left with the k-th turn axis."""
    if k == 0:
        for i in range(axes):
            out[i] = velocity[i]
    elif axes == 2:
        out[0] = -velocity[1]
        out[1] = velocity[0]
    else:
        a = k - 1
        b = k % 3
        c = (k + 1) % 3
        out[a] = 0.0
        out[b] = -velocity[c]
        out[c] = velocity[b]


@kernel
def _column_adjoint(axes, k, out_bar, velocity_bar):
    if k == 0:
        for i in range(axes):
            velocity_bar[i] += out_bar[i]
    elif axes == 2:
        velocity_bar[1] -= out_bar[0]
        velocity_bar[0] += out_bar[1]
    else:
        b = k % 3
        c = (k + 1) % 3
        velocity_bar[c] -= out_bar[b]
        velocity_bar[b] += out_bar[c]


@kernel
def add_noise(axes, second, row, x, work, P):
    """Add the process noise of state ``x`` to both triangles of ``P`` (N, N); ``work`` (6, 3) is scratch."""
    turns = 1 if axes == 2 else 3
    own = 2 * axes
    end, mean, e, m = work[0], work[1], work[2], work[3]
    velocities(axes, second, row, x, end, mean)
    for i in range(0, own, 2):
        P[i, i] += row[29]
        P[i, i + 1] += row[30]
        P[i + 1, i] += row[30]
        P[i + 1, i + 1] += row[31]
    for k in range(turns + 1):
        _column(axes, k, mean, m)
        _column(axes, k, end, e)
        if k == 0:
            pp, pv, pa, vv, va, aa = row[13], row[14], row[15], row[16], row[17], row[18]
        else:
            pp, pv, pa, vv, va, aa = row[19], row[20], row[21], row[23], row[24], row[26]
        at = own + k
        for i in range(axes):
            for j in range(axes):
                P[2 * i, 2 * j] += pp * (m[i] * m[j])
                P[2 * i + 1, 2 * j + 1] += vv * (e[i] * e[j])
                both = pv * (m[i] * e[j])
                P[2 * i, 2 * j + 1] += both
                P[2 * j + 1, 2 * i] += both
            P[2 * i, at] += pa * m[i]
            P[at, 2 * i] += pa * m[i]
            P[2 * i + 1, at] += va * e[i]
            P[at, 2 * i + 1] += va * e[i]
            if second and k > 0:
                after = at + turns
                P[2 * i, after] += row[22] * m[i]
                P[after, 2 * i] += row[22] * m[i]
                P[2 * i + 1, after] += row[25] * e[i]
                P[after, 2 * i + 1] += row[25] * e[i]
        P[at, at] += aa
        if second and k > 0:
            after = at + turns
            P[at, after] += row[27]
            P[after, at] += row[27]
            P[after, after] += row[28]


@kernel
def noise_adjoint(axes, second, row, x, work, P_bar, x_bar, row_bar):
    """Add to ``x_bar`` and ``row_bar`` what the (symmetric) derivative by the noise says; ``work`` (8, 3)."""
    turns = 1 if axes == 2 else 3
    own = 2 * axes
    end, mean, e, m = work[0], work[1], work[2], work[3]
    end_bar, mean_bar, e_bar, m_bar = work[4], work[5], work[6], work[7]
    velocities(axes, second, row, x, end, mean)
    for i in range(axes):
        end_bar[i] = 0.0
        mean_bar[i] = 0.0
        row_bar[29] += P_bar[2 * i, 2 * i]
        row_bar[30] += 2.0 * P_bar[2 * i, 2 * i + 1]
        row_bar[31] += P_bar[2 * i + 1, 2 * i + 1]
    for k in range(turns + 1):
        _column(axes, k, mean, m)
        _column(axes, k, end, e)
        first = 13 if k == 0 else 19
        if k == 0:
            pp, pv, pa, vv, va = row[13], row[14], row[15], row[16], row[17]
        else:
            pp, pv, pa, vv, va = row[19], row[20], row[21], row[23], row[24]
        at = own + k
        after = at + turns
        pp_bar, pv_bar, pa_bar, vv_bar, va_bar = 0.0, 0.0, 0.0, 0.0, 0.0
        pu_bar, vu_bar = 0.0, 0.0
        for i in range(axes):
            through_mm, through_me, through_em, through_ee = 0.0, 0.0, 0.0, 0.0
            for j in range(axes):
                through_mm += P_bar[2 * i, 2 * j] * m[j]
                through_me += P_bar[2 * i, 2 * j + 1] * e[j]
                through_em += P_bar[2 * j, 2 * i + 1] * m[j]
                through_ee += P_bar[2 * i + 1, 2 * j + 1] * e[j]
            pp_bar += m[i] * through_mm
            pv_bar += 2.0 * m[i] * through_me
            vv_bar += e[i] * through_ee
            pa_bar += 2.0 * P_bar[2 * i, at] * m[i]
            va_bar += 2.0 * P_bar[2 * i + 1, at] * e[i]
            m_bar[i] = 2.0 * (pp * through_mm + pv * through_me + pa * P_bar[2 * i, at])
            e_bar[i] = 2.0 * (vv * through_ee + pv * through_em + va * P_bar[2 * i + 1, at])
            if second and k > 0:
                pu_bar += 2.0 * P_bar[2 * i, after] * m[i]
                vu_bar += 2.0 * P_bar[2 * i + 1, after] * e[i]
                m_bar[i] += 2.0 * row[22] * P_bar[2 * i, after]
                e_bar[i] += 2.0 * row[25] * P_bar[2 * i + 1, after]
        row_bar[first] += pp_bar
        row_bar[first + 1] += pv_bar
        row_bar[first + 2] += pa_bar
        if k == 0:
            row_bar[16] += vv_bar
            row_bar[17] += va_bar
            row_bar[18] += P_bar[at, at]
        else:
            row_bar[23] += vv_bar
            row_bar[24] += va_bar
            row_bar[26] += P_bar[at, at]
            if second:
                row_bar[22] += pu_bar
                row_bar[25] += vu_bar
                row_bar[27] += 2.0 * P_bar[at, after]
                row_bar[28] += P_bar[after, after]
        _column_adjoint(axes, k, m_bar, mean_bar)
        _column_adjoint(axes, k, e_bar, end_bar)
    velocities_adjoint(axes, second, row, x, end_bar, mean_bar, x_bar, row_bar)
