"""The motion of every mode at once, in torch operations: velocities, shape parameters and process noise of a step."""

from __future__ import annotations

import torch
from torch import Tensor

from jink.estimators.motions.bilinear import LARGEST_GROWTH
from jink.intent.torch_tables import FIELDS

__all__ = ["MotionStep"]

_COLUMN = {name: i for i, name in enumerate(FIELDS)}


def _plane_factors(growth: Tensor, angle: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Real and imaginary part of ``e^z`` and of ``(e^z - 1)/z``."""
    factor = torch.exp(growth)
    cosine, sine, half = torch.cos(angle), factor * torch.sin(angle), torch.sin(0.5 * angle)
    x = torch.expm1(growth) * cosine - 2.0 * half * half
    size = growth * growth + angle * angle
    near = size < 1e-6
    safe = torch.where(near, torch.ones_like(size), size)
    # to fourth order next to zero, where the gradient of the quotient has no digits left
    real2, imag2 = growth * growth - angle * angle, 2.0 * growth * angle
    real3, imag3 = real2 * growth - imag2 * angle, real2 * angle + imag2 * growth
    real = torch.where(near, 1.0 + 0.5 * growth + real2 / 6.0 + real3 / 24.0, (x * growth + sine * angle) / safe)
    imag = torch.where(near, 0.5 * angle + imag2 / 6.0 + imag3 / 24.0, (sine * growth - x * angle) / safe)
    return factor * cosine, sine, real, imag


def _space_factors(growth: Tensor, square: Tensor) -> tuple[Tensor, ...]:
    """Coefficients of ``v``, ``a x v``, ``a x (a x v)`` in the last and the mean velocity; ``square`` is ``|a|^2``."""
    factor = torch.exp(growth)
    still = square < 1e-2
    angle = torch.sqrt(torch.where(still, torch.ones_like(square), square))
    half = torch.sin(0.5 * angle) / angle
    series = 1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))
    sinc = torch.where(still, 1.0 - square / 6.0 * series, torch.sin(angle) / angle)
    series = 1.0 - square / 30.0 * (1.0 - square / 56.0 * (1.0 - square / 90.0))
    c2 = torch.where(still, 0.5 - square / 24.0 * series, 2.0 * half * half)
    size = growth * growth + square
    near = size < 2.5e-2
    g, s = torch.where(near, growth, torch.zeros_like(growth)), torch.where(near, square, torch.zeros_like(square))
    power, real, imaginary, defect = torch.ones_like(g), torch.ones_like(g), torch.zeros_like(g), torch.zeros_like(g)
    along, across, twice = torch.ones_like(g), torch.zeros_like(g), torch.zeros_like(g)
    scale = 1.0
    for k in range(1, 11):
        defect = g * defect + imaginary
        real, imaginary = g * real - s * imaginary, g * imaginary + real
        power = power * g
        scale /= k + 1
        along = along + scale * power
        across = across + scale * imaginary
        twice = twice + scale * defect
    # growth alone may vanish where the turn does not
    tiny = growth.abs() < 1e-3
    safe_growth = torch.where(tiny, torch.ones_like(growth), growth)
    taylor = 1.0 + growth / 2.0 * (1.0 + growth / 3.0 * (1.0 + growth / 4.0 * (1.0 + growth / 5.0)))
    far_along = torch.where(tiny, taylor, torch.expm1(safe_growth) / safe_growth)
    safe = torch.where(near, torch.ones_like(size), size)
    far_across = (growth * factor * sinc - torch.expm1(growth) + factor * square * c2) / safe
    far_twice = (far_along + growth * factor * c2 - factor * sinc) / safe
    return (
        *(factor, factor * sinc, factor * c2),
        *(torch.where(near, along, far_along), torch.where(near, across, far_across)),
        torch.where(near, twice, far_twice),
    )


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return torch.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


class MotionStep:
    """One step's tables, gathered for each track; ``row[name]`` is (B or 1, M)."""

    def __init__(self, rows: Tensor, axes: int, size: int) -> None:
        self.rows, self.axes, self.size = rows, axes, size

    def __getitem__(self, name: str) -> Tensor:
        return self.rows[_COLUMN[name]]

    def integrals(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Integral of g, clamped, and of w, of states (N, ..., B, M); w keeps its components first."""
        axes, turns = self.axes, 1 if self.axes == 2 else 3
        own = 2 * axes
        growth = (self["growth_0"] + self["growth_g"] * x[own]).clamp(max=LARGEST_GROWTH)
        angle = self["angle_0"] + self["angle_w"] * x[own + 1 : own + 1 + turns]
        if self.size > own + 1 + turns:
            angle = angle + self["angle_u"] * x[own + 1 + turns :]
        return growth, angle

    def velocities(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Velocity at the end of the step and its mean over the step; (A, ..., B, M)."""
        growth, angle = self.integrals(x)
        v = x[1 : 2 * self.axes : 2]
        if self.axes == 2:
            er, ei, mr, mi = _plane_factors(growth, angle[0])
            end = torch.stack([er * v[0] - ei * v[1], ei * v[0] + er * v[1]])
            return end, torch.stack([mr * v[0] - mi * v[1], mi * v[0] + mr * v[1]])
        factors = _space_factors(growth, (angle * angle).sum(0))
        once = _cross(angle, v)
        twice = _cross(angle, once)
        e0, e1, e2, m0, m1, m2 = factors
        return e0 * v + e1 * once + e2 * twice, m0 * v + m1 * once + m2 * twice

    def shapes(self, x: Tensor) -> Tensor:
        """Shape parameters at the end of the step; (K, ..., B, M)."""
        axes, turns = self.axes, 1 if self.axes == 2 else 3
        own = 2 * axes
        parts = [(self["g_0"] + self["g_g"] * x[own])[None]]
        w = x[own + 1 : own + 1 + turns]
        if self.size > own + 1 + turns:
            u = x[own + 1 + turns :]
            parts += [self["w_0"] + self["w_w"] * w + self["w_u"] * u, self["u_0"] + self["u_w"] * w + self["u_u"] * u]
        else:
            parts.append(self["w_0"] + self["w_w"] * w)
        return torch.cat(parts)

    def noise(self, x: Tensor) -> Tensor:
        """Process noise from state ``x`` (N, B, M); (N, N, B, M)."""
        axes, n = self.axes, self.size
        end, mean = self.velocities(x)
        nothing = torch.zeros_like(x[0])
        q: list[list[Tensor | None]] = [[None] * n for _ in range(n)]

        def put(i: int, j: int, value: Tensor) -> None:
            i, j = min(i, j), max(i, j)
            old = q[i][j]
            q[i][j] = value if old is None else old + value

        def entry(i: int, j: int) -> Tensor:
            value = q[min(i, j)][max(i, j)]
            return nothing if value is None else value + nothing

        own = 2 * axes
        for i in range(axes):
            put(2 * i, 2 * i, self["pp"])
            put(2 * i, 2 * i + 1, self["pv"])
            put(2 * i + 1, 2 * i + 1, self["vv"])
        columns = [(own, "g", (mean, end))]
        if axes == 2:
            columns.append((own + 1, "w", (torch.stack([-mean[1], mean[0]]), torch.stack([-end[1], end[0]]))))
        else:
            zero = torch.zeros_like(mean[0])
            for k in range(3):
                unit = [zero, zero, zero]
                unit[k] = torch.ones_like(zero)
                axis = torch.stack(unit)
                columns.append((own + 1 + k, "w", (_cross(axis, mean), _cross(axis, end))))
        turns = len(columns) - 1
        for row, kind, (m, e) in columns:
            for i in range(axes):
                for j in range(axes):
                    if i <= j:
                        put(2 * i, 2 * j, self[kind + "pp"] * m[i] * m[j])
                        put(2 * i + 1, 2 * j + 1, self[kind + "vv"] * e[i] * e[j])
                    put(2 * i, 2 * j + 1, self[kind + "pv"] * m[i] * e[j])
                put(2 * i, row, self[kind + "pa"] * m[i])
                put(2 * i + 1, row, self[kind + "va"] * e[i])
                if kind == "w" and n > own + 1 + turns:
                    put(2 * i, row + turns, self["wpu"] * m[i])
                    put(2 * i + 1, row + turns, self["wvu"] * e[i])
            put(row, row, self[kind + "aa"])
            if kind == "w" and n > own + 1 + turns:
                put(row, row + turns, self["wau"])
                put(row + turns, row + turns, self["wuu"])
        return torch.stack([torch.stack([entry(i, j) for j in range(n)]) for i in range(n)])
