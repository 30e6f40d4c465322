"""What a step of a given length does to shape parameters and their noise, for every mode at once, differentiable.

The torch twin of the parts of `jink.estimators.motions.bilinear` that do not depend on the state. One table row per
(time step, mode) holds `FIELDS`; the recursion over a track reads nothing else of a law.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from jink.estimators.motions.bilinear import _NODES, _WEIGHTS

__all__ = ["FIELDS", "impulse_response", "law_tables"]

FIELDS = (
    *("growth_0", "growth_g"),  # integral of g: constant and factor of g
    *("g_0", "g_g"),  # g at the end
    *("angle_0", "angle_w", "angle_u"),  # integral of w
    *("w_0", "w_w", "w_u"),
    *("u_0", "u_w", "u_u"),
    *("gpp", "gpv", "gpa", "gvv", "gva", "gaa"),  # noise of (double integral, integral, value) of g
    *("wpp", "wpv", "wpa", "wpu", "wvv", "wva", "wvu", "waa", "wau", "wuu"),  # the same of w, and its slope
    *("pp", "pv", "vv"),  # white acceleration
)
"""Columns of a table."""
_SERIES = 4.0
_SHORT = 2.0


def _decay(x: Tensor) -> list[Tensor]:
    """``g_0 .. g_5`` of `series.decay`, for ``x >= 0``, with gradients that hold for any x."""
    near, far = x.clamp(max=_SERIES), x.clamp(min=_SERIES)
    g5 = torch.zeros_like(x)
    for j in range(25, -1, -1):
        g5 = 1.0 - near / (j + 6) * g5
    g5 = g5 / 120.0
    g4 = 1.0 / 24.0 - near * g5
    g3 = 1.0 / 6.0 - near * g4
    g2 = 0.5 - near * g3
    g1 = 1.0 - near * g2
    series = [1.0 - near * g1, g1, g2, g3, g4, g5]
    g = torch.exp(-far)
    closed = [g]
    for factorial in (1.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0):
        g = (factorial - g) / far
        closed.append(g)
    small = x < _SERIES
    return [torch.where(small, a, b) for a, b in zip(series, closed, strict=True)]


def _decayed_noise(x: Tensor) -> list[Tensor]:
    """``int_0^1`` of the products of ``(r^2 g_2, r g_1, g_0)(x r)``: pp, pv, pa, vv, va, aa."""
    near, far = x.clamp(max=_SHORT), x.clamp(min=_SHORT)
    _, _, n2, n3, n4, _ = _decay(near)
    _, _, _, d3, _, d5 = _decay(2.0 * near)
    _, g1, g2, _, _, _ = _decay(x)
    _, d1, *_ = _decay(2.0 * x)
    e = torch.exp(-far)
    half = 0.5 * (1.0 - torch.exp(-2.0 * far))
    small = x < _SHORT
    pp = torch.where(small, 16.0 * d5 - 2.0 * n4, (((far / 3.0 - 1.0) * far + 1.0 - 2.0 * e) * far + half) / far**5)
    pa = torch.where(small, 4.0 * d3 - n2, (half - far * e) / far**3)
    vv = torch.where(small, 4.0 * d3 - 2.0 * n3, (far - 2.0 * (1.0 - e) + half) / far**3)
    return [pp, 0.5 * g2 * g2, pa, vv, 0.5 * g1 * g1, d1]


def impulse_response(x: Tensor, damping: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The entire functions of `bilinear.impulse_response`."""
    near, far = x.clamp(max=1.0), x.clamp(min=1.0)
    double = 2.0 * damping
    before, term = torch.zeros_like(near * damping), torch.ones_like(near * damping)
    h, first, second = torch.zeros_like(term), torch.zeros_like(term), torch.zeros_like(term)
    for j in range(20):
        h = h + term
        first = first + term / (j + 2)
        second = second + term / ((j + 2) * (j + 3))
        before, term = term, -near / (j + 2) * (double * term + near / (j + 1) * before)
    share = torch.sqrt(1.0 - damping * damping)
    fade = torch.exp(-damping * far)
    sine = fade * torch.sin(share * far) / share
    slope = fade * torch.cos(share * far) - damping * sine
    h_far = sine / far
    first_far = (1.0 - slope - double * sine) / (far * far)
    second_far = (1.0 - h_far - double * far * first_far) / (far * far)
    small = x < 1.0
    return (
        torch.where(small, 1.0 - near * (double * h + near * first), slope),
        torch.where(small, h, h_far),
        torch.where(small, first, first_far),
        torch.where(small, second, second_far),
    )


def _swing_noise(x: Tensor, damping: Tensor) -> list[Tensor]:
    """The ten moments of `bilinear.swing_noise`."""
    near, far = x.clamp(max=1.0), x.clamp(min=1.0)
    r = torch.tensor(_NODES, dtype=x.dtype, device=x.device).reshape(-1, *[1] * x.ndim)
    weight = torch.tensor(_WEIGHTS, dtype=x.dtype, device=x.device).reshape(r.shape)
    f0, f1, f2, f3 = impulse_response(near * r, damping)
    parts = [r**3 * f3, r**2 * f2, r * f1, f0]
    short = [(weight * parts[i] * parts[j]).sum(0) for i in range(4) for j in range(i, 4)]
    f0, f1, f2, _ = impulse_response(far, damping)
    f3 = (1.0 - f1 - 2.0 * damping * far * f2) / (far * far)
    double, square = 2.0 * damping, far * far
    kept = f0 + double * far * f1
    s11 = (1.0 - kept * kept - square * f1 * f1) / (2.0 * double * square * far)
    s10 = 0.5 * f1 * f1
    s00 = (1.0 - f0 * f0 - square * f1 * f1) / (2.0 * double * far)
    m0, m1 = f1 - f2, f2 - f3
    s20 = (f1 - s00 - double * far * s10) / square
    s21 = (f2 - s10 - double * far * s11) / square
    s22 = (f3 - s20 - double * far * s21) / square
    m2 = (0.5 - m0 - double * far * m1) / square
    m3 = (1.0 / 3.0 - m1 - double * far * m2) / square
    s30 = (m0 - s10 - double * far * s20) / square
    s31 = (m1 - s11 - double * far * s21) / square
    s32 = (m2 - s21 - double * far * s22) / square
    s33 = (m3 - s31 - double * far * s32) / square
    long = [s33, s32, s31, s30, s22, s21, s20, s11, s10, s00]
    return [torch.where(x < 1.0, a, b) for a, b in zip(short, long, strict=True)]


def law_tables(law: Mapping[str, Tensor], dt: Tensor, swings: Tensor, slope: bool) -> Tensor:
    """Rows of `FIELDS` for every time step and mode.

    Args:
        law: growth_mean, growth_rate, growth_noise, turn_mean, turn_rate, turn_noise, wobble, natural, damping of
            each mode; (M,).
        dt: lengths of steps; (U,); s.
        swings: which modes swing; (M,) bool.
        slope: modes that do not swing carry a dormant slope.

    Returns:
        (U, M, 32).
    """
    t = dt[:, None].expand(-1, len(swings))
    zero = torch.zeros_like(t)
    x = law["growth_rate"] * t
    g0, g1, *_ = _decay(x)
    columns = [law["growth_mean"] * (t - t * g1), t * g1, law["growth_mean"] * (1.0 - g0), g0]
    r0, r1, *_ = _decay(law["turn_rate"] * t)
    mean = law["turn_mean"]
    turn = [
        mean * (t - t * r1),
        t * r1,
        zero,
        mean * (1.0 - r0),
        r0,
        zero,
        zero,
        zero,
        torch.exp(-t) if slope else zero,
    ]
    p = _decayed_noise(x)
    q = law["growth_noise"] * t
    noise = [q * t**4 * p[0], q * t**3 * p[1], q * t**2 * p[2], q * t**2 * p[3], q * t * p[4], q * p[5]]
    p = _decayed_noise(law["turn_rate"] * t)
    q = law["turn_noise"] * t
    dormant = -torch.expm1(-2.0 * t) if slope else zero
    turning = [
        *(q * t**4 * p[0], q * t**3 * p[1], q * t**2 * p[2], zero),
        *(q * t**2 * p[3], q * t * p[4], zero, q * p[5], zero, dormant),
    ]
    if bool(swings.any()):
        natural, damping = law["natural"], law["damping"]
        x = natural * t
        f0, f1, f2, f3 = impulse_response(x, damping.expand_as(x))
        swing = [
            *(mean * x * x * f3 * t, t - x * x * f3 * t, t * t * f2),
            *(mean * x * x * f2, 1.0 - x * x * f2, t * f1),
            *(mean * natural * x * f1, -natural * x * f1, f0),
        ]
        turn = [torch.where(swings, a, b) for a, b in zip(swing, turn, strict=True)]
        s = _swing_noise(x, damping.expand_as(x))
        scales = (t**6, t**5, t**4, t**3, t**4, t**3, t**2, t**2, t, torch.ones_like(t))
        turning = [
            torch.where(swings, q * scale * moment, other)
            for scale, moment, other in zip(scales, s, turning, strict=True)
        ]
    wobble = law["wobble"]
    return torch.stack(
        [*columns, *turn, *noise, *turning, wobble * t**3 / 3.0, 0.5 * wobble * t**2, wobble * t], dim=-1
    )
