"""What a step of a given length does to shape parameters and their noise, for every mode at once, differentiable.

The torch twin of the parts of `jink.estimators.motions.bilinear` that do not depend on the state. One table row per
(time step, mode) holds `FIELDS`; the recursion over a track reads nothing else of a law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from jink.estimators.motions.bilinear import _NODES, _WEIGHTS

__all__ = ["FIELDS", "impulse_response", "law_tables", "markov_matrices"]

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


class _Decay(torch.autograd.Function):
    """``g_0 .. g_7`` of `series.decay`, for ``x >= 0``, stacked; ``d g_k / dx = k g_(k+1) - g_k``."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        near, far = x.clamp(max=_SERIES), x.clamp(min=_SERIES)
        g = torch.zeros_like(x)
        for j in range(25, -1, -1):
            g = torch.addcmul(torch.ones_like(x), near, g, value=-1.0 / (j + 9))
        series = [g / 40320.0]
        for k in range(7, -1, -1):
            series.append(1.0 / math.factorial(k) - near * series[-1])
        closed = [torch.exp(-far)]
        for k in range(8):
            closed.append((1.0 / math.factorial(k) - closed[-1]) / far)
        out = torch.where(x < _SERIES, torch.stack(series[::-1]), torch.stack(closed))
        ctx.save_for_backward(out)
        return out

    @staticmethod
    def backward(ctx: Any, bar: Tensor) -> Tensor:
        (g,) = ctx.saved_tensors
        order = torch.arange(8, dtype=g.dtype, device=g.device).reshape(-1, *[1] * (g.ndim - 1))
        return (bar[:8] * (order * g[1:] - g[:8])).sum(0)


def _decay(x: Tensor) -> Tensor:
    """``g_0 .. g_8`` of a decay; the last has no derivative."""
    return _Decay.apply(x)  # type: ignore[no-untyped-call]


def _decayed_noise(x: Tensor, g: Tensor) -> list[Tensor]:
    """``int_0^1`` of the products of ``(r^2 g_2, r g_1, g_0)(x r)``: pp, pv, pa, vv, va, aa; ``g`` at x."""
    far = x.clamp(min=_SHORT)
    d = _decay(2.0 * x)
    e = torch.exp(-far)
    half = 0.5 * (1.0 - torch.exp(-2.0 * far))
    small = x < _SHORT
    pp = torch.where(small, 16.0 * d[5] - 2.0 * g[4], (((far / 3.0 - 1.0) * far + 1.0 - 2.0 * e) * far + half) / far**5)
    pa = torch.where(small, 4.0 * d[3] - g[2], (half - far * e) / far**3)
    vv = torch.where(small, 4.0 * d[3] - 2.0 * g[3], (far - 2.0 * (1.0 - e) + half) / far**3)
    return [pp, 0.5 * g[2] * g[2], pa, vv, 0.5 * g[1] * g[1], d[1]]


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


def markov_matrices(generator: Tensor, dt: Tensor) -> Tensor:
    """``expm(generator dt)`` of many steps; (M, M), (U,) to (U, M, M).

    By uniformisation as `jink.estimators.markov.transition_matrix`: only non-negative numbers are added. A series of
    twelfth order for all steps at once, squared; its gradient costs a tenth of that of a general exponential.
    """
    M = len(generator)
    unit = torch.eye(M, dtype=generator.dtype, device=generator.device)
    rate = -generator.detach().diagonal().min()
    longest = float(rate * dt.max())
    squarings = max(0, math.ceil(math.log2(longest / 0.25))) if longest > 0.25 else 0
    part = (dt / 2.0**squarings)[:, None, None]
    first = (generator + rate * unit) * part
    second = first @ first
    third = second @ first
    out = third / math.factorial(12)
    for k in (9, 6, 3, 0):
        out = out + second / math.factorial(k + 2) + first / math.factorial(k + 1) + unit / math.factorial(k)
        out = out @ third if k else out
    out = out * torch.exp(-rate * part)
    for _ in range(squarings):
        out = out @ out
    return out


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
    x = torch.stack([law["growth_rate"] * t, law["turn_rate"] * t])
    decays = _decay(x)
    moments = _decayed_noise(x, decays)
    (g0, g1), (r0, r1) = decays[:2, 0], decays[:2, 1]
    columns = [law["growth_mean"] * (t - t * g1), t * g1, law["growth_mean"] * (1.0 - g0), g0]
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
    p = [moment[0] for moment in moments]
    q = law["growth_noise"] * t
    noise = [q * t**4 * p[0], q * t**3 * p[1], q * t**2 * p[2], q * t**2 * p[3], q * t * p[4], q * p[5]]
    p = [moment[1] for moment in moments]
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
