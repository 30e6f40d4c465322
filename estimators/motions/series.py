"""Entire functions that keep motions exact from dt = 0 to any dt: no 0/0 and no cancellation."""

from __future__ import annotations

import math

from jink.estimators.compiled import kernel

__all__ = ["decay", "half_turn", "stumpff", "swing_moments"]

_SMALL = 2.0


@kernel
def half_turn(angle: float) -> tuple[float, float, float]:
    """``sin(u)/u``, ``cos u`` and ``sin u`` of ``u = angle / 2``: all a turn needs.

    With them ``sin(a)/a = sinc cos``, ``(1 - cos a)/a = sinc sin`` and ``cos a = 1 - 2 sin^2``, exact at a =
    0.
    """
    u = 0.5 * angle
    sine = math.sin(u)
    cosine = math.cos(u)
    sinc = sine / u if u != 0.0 else 1.0
    return sinc, cosine, sine


@kernel
def stumpff(angle: float) -> tuple[float, float, float, float, float, float, float, float]:
    """Stumpff functions ``c_0 .. c_7`` of an angle (rad).

    Model: ``c_k(a) = sum_j (-1)^j a^(2j) / (2j + k)!``, so ``c_0 = cos a``, ``c_1 = sin(a)/a``,
    ``c_k = 1/k! - a^2 c_(k+2)`` and ``d/ds [s^k c_k(w s)] = s^(k-1) c_(k-1)(w s)``.
    """
    square = angle * angle
    if square < _SMALL * _SMALL:
        c7 = 0.0
        c6 = 0.0
        for j in range(12, -1, -1):
            c7 = 1.0 - square / ((2 * j + 8) * (2 * j + 9)) * c7
            c6 = 1.0 - square / ((2 * j + 7) * (2 * j + 8)) * c6
        c7 /= 5040.0
        c6 /= 720.0
        c5 = 1.0 / 120.0 - square * c7
        c4 = 1.0 / 24.0 - square * c6
        c3 = 1.0 / 6.0 - square * c5
        c2 = 0.5 - square * c4
        return 1.0 - square * c2, 1.0 - square * c3, c2, c3, c4, c5, c6, c7
    c0 = math.cos(angle)
    c1 = math.sin(angle) / angle
    c2 = (1.0 - c0) / square
    c3 = (1.0 - c1) / square
    c4 = (0.5 - c2) / square
    c5 = (1.0 / 6.0 - c3) / square
    c6 = (1.0 / 24.0 - c4) / square
    c7 = (1.0 / 120.0 - c5) / square
    return c0, c1, c2, c3, c4, c5, c6, c7


@kernel
def swing_moments(angle: float) -> tuple[float, float]:
    """``int_0^1 (r^2 c_2(a r))^2 dr`` and ``int_0^1 (r^3 c_3(a r))^2 dr``, stable at any angle."""
    if abs(angle) < _SMALL:
        _, _, _, _, _, c5, c6, c7 = stumpff(angle)
        _, _, _, _, _, d5, _, d7 = stumpff(2.0 * angle)
        return 8.0 * d5 - 2.0 * c5, 32.0 * d7 + 2.0 * c7 - 2.0 * c6
    sine = math.sin(angle)
    cosine = math.cos(angle)
    square = angle * angle
    second = 1.5 - (2.0 - 0.5 * cosine) * sine / angle
    third = square / 3.0 + 0.5 + 2.0 * cosine - (2.0 + 0.5 * cosine) * sine / angle
    return second / square / square, third / square / square / square


@kernel
def decay(x: float) -> tuple[float, float, float, float, float, float, float, float]:
    """Repeated integrals ``g_0 .. g_7`` of an exponential decay, for ``x >= 0``.

    Model: ``g_0 = exp(-x)``, ``g_k = (1/(k-1)! - g_(k-1)) / x = int_0^1 (1-r)^(k-1)/(k-1)! exp(-x r) dr``,
    so ``g_k(0) = 1/k!`` and ``d/ds [s^k g_k(c s)] = s^(k-1) g_(k-1)(c s)``.
    """
    if x < 2.0 * _SMALL:
        g7 = 0.0
        for j in range(25, -1, -1):
            g7 = 1.0 - x / (j + 8) * g7
        g7 /= 5040.0
        g6 = 1.0 / 720.0 - x * g7
        g5 = 1.0 / 120.0 - x * g6
        g4 = 1.0 / 24.0 - x * g5
        g3 = 1.0 / 6.0 - x * g4
        g2 = 0.5 - x * g3
        g1 = 1.0 - x * g2
        return 1.0 - x * g1, g1, g2, g3, g4, g5, g6, g7
    g0 = math.exp(-x)
    g1 = (1.0 - g0) / x
    g2 = (1.0 - g1) / x
    g3 = (0.5 - g2) / x
    g4 = (1.0 / 6.0 - g3) / x
    g5 = (1.0 / 24.0 - g4) / x
    g6 = (1.0 / 120.0 - g5) / x
    g7 = (1.0 / 720.0 - g6) / x
    return g0, g1, g2, g3, g4, g5, g6, g7
