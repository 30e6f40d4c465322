"""One piece of a trajectory in closed form: a `leg` turns or swings, speeds up, pitches.

Model: speed ``s(t) = s0 + a t``, heading ``psi(t) = psi0 + omega t`` or, in a leg that swings,
``psi0 + A sin(Omega t)`` at constant speed and climb; climb angle ``gamma(t) = gamma0 + kappa t``;
``v = s (cos gamma cos psi, cos gamma sin psi, sin gamma)`` and position its integral.
Heading is counter-clockwise from +x, climb is up from the horizontal.

Products of sines are sums of arcs of rates ``omega + kappa``, ``omega - kappa`` and ``kappa``; a swing is the series
``exp(i A sin(Omega t)) = sum_n J_n(A) exp(i n Omega t)`` (Jacobi-Anger), so nothing is integrated numerically.
"""

from __future__ import annotations

import math

from jink.envs.compiled import inner_kernel

DURATION, SPEED, ACCELERATION = 0, 1, 2
HEADING, TURN, COS_HEADING, SIN_HEADING = 3, 4, 5, 6
CLIMB, PITCH, COS_CLIMB, SIN_CLIMB = 7, 8, 9, 10
AMPLITUDE, SWING = 11, 12
LEG_SIZE = 13
"""Entries of a leg: s, m/s, m/s^2; rad, rad/s and their cosine, sine at the start; again for the climb; rad, rad/s."""

MAX_AMPLITUDE = 0.5 * math.pi
SERIES = 18
"""Terms of the swing's series: J_n(pi / 2) is below 1e-17 beyond them."""


@inner_kernel
def arc(speed, acceleration, cosine, sine, rate, t):
    """Displacement after ``t`` of a point that leaves along (cosine, sine) and turns at ``rate``, and its direction.

    Model: ``integral of (s0 + a t) exp(i w t) = t exp(i u) ((s0 + a t / 2) sin(u) / u + i (a t / 2) g(u))`` with
    ``u = w t / 2`` and ``g(u) = (sin u - u cos u) / u^2``.
    """
    half = 0.5 * t
    u = rate * half
    c = math.cos(u)
    s = math.sin(u)
    uu = u * u
    if uu < 0.0025:
        sinc = 1.0 - uu / 6.0 * (1.0 - uu / 20.0 * (1.0 - uu / 42.0))
        lean = u / 3.0 * (1.0 - uu / 10.0 * (1.0 - uu / 28.0 * (1.0 - uu / 54.0)))
    else:
        sinc = s / u
        lean = (s - u * c) / uu
    forward = t * (speed + acceleration * half) * sinc
    left = t * acceleration * half * lean
    mid_cos = cosine * c - sine * s
    mid_sin = sine * c + cosine * s
    return (
        forward * mid_cos - left * mid_sin,
        forward * mid_sin + left * mid_cos,
        mid_cos * c - mid_sin * s,
        mid_sin * c + mid_cos * s,
    )


@inner_kernel
def bessel_series(amplitude, rate, series):
    """``series[0] = J_0``, ``series[n] = 2 J_n / (n rate)`` for the swing; (SERIES + 1,)."""
    half = 0.5 * amplitude
    lead = 1.0
    for n in range(SERIES + 1):
        if n > 0:
            lead *= half / n
        term = lead
        total = lead
        for k in range(1, 16):
            term *= -half * half / (k * (n + k))
            total += term
        series[n] = total if n == 0 else 2.0 * total / (n * rate)


@inner_kernel
def begin_leg(leg, series):
    """Fill in what follows from the start of a leg, once for all its samples."""
    leg[COS_HEADING] = math.cos(leg[HEADING])
    leg[SIN_HEADING] = math.sin(leg[HEADING])
    leg[COS_CLIMB] = math.cos(leg[CLIMB])
    leg[SIN_CLIMB] = math.sin(leg[CLIMB])
    if leg[AMPLITUDE] != 0.0:
        bessel_series(leg[AMPLITUDE], leg[SWING], series)


@inner_kernel
def _swing(leg, series, t, out):
    s = leg[SPEED]
    level = s * leg[COS_CLIMB]
    theta = leg[SWING] * t
    c1 = math.cos(theta)
    s1 = math.sin(theta)
    cn = c1
    sn = s1
    along = series[0] * t
    across = 0.0
    floor = 1e-18 * abs(series[0]) / leg[SWING]
    for n in range(1, SERIES + 1, 2):
        across += series[n] * (1.0 - cn)
        cn, sn = cn * c1 - sn * s1, sn * c1 + cn * s1
        along += series[n + 1] * sn
        cn, sn = cn * c1 - sn * s1, sn * c1 + cn * s1
        if abs(series[n]) < floor:
            break
    c0 = leg[COS_HEADING]
    s0 = leg[SIN_HEADING]
    out[0] = level * (c0 * along - s0 * across)
    out[1] = level * (s0 * along + c0 * across)
    out[2] = s * leg[SIN_CLIMB] * t
    heading = leg[HEADING] + leg[AMPLITUDE] * s1
    rate = leg[AMPLITUDE] * leg[SWING] * c1
    vx = level * math.cos(heading)
    vy = level * math.sin(heading)
    out[3] = vx
    out[4] = vy
    out[5] = s * leg[SIN_CLIMB]
    out[6] = -rate * vy
    out[7] = rate * vx
    out[8] = 0.0


@inner_kernel
def _level_arc(leg, t, out):
    s0 = leg[SPEED]
    a = leg[ACCELERATION]
    w = leg[TURN]
    if w == 0.0:
        c = leg[COS_HEADING]
        s = leg[SIN_HEADING]
        path = t * (s0 + 0.5 * a * t)
        dx = path * c
        dy = path * s
    else:
        dx, dy, c, s = arc(s0, a, leg[COS_HEADING], leg[SIN_HEADING], w, t)
    speed = s0 + a * t
    level = leg[COS_CLIMB]
    up = leg[SIN_CLIMB]
    out[0] = level * dx
    out[1] = level * dy
    out[2] = up * t * (s0 + 0.5 * a * t)
    out[3] = level * speed * c
    out[4] = level * speed * s
    out[5] = up * speed
    out[6] = level * (a * c - speed * w * s)
    out[7] = level * (a * s + speed * w * c)
    out[8] = up * a


@inner_kernel
def _pitching_arc(leg, t, out):
    s0 = leg[SPEED]
    a = leg[ACCELERATION]
    w = leg[TURN]
    kappa = leg[PITCH]
    ch = leg[COS_HEADING]
    sh = leg[SIN_HEADING]
    cc = leg[COS_CLIMB]
    sc = leg[SIN_CLIMB]
    px, py, pc, ps = arc(s0, a, ch * cc - sh * sc, sh * cc + ch * sc, w + kappa, t)
    mx, my, mc, ms = arc(s0, a, ch * cc + sh * sc, sh * cc - ch * sc, w - kappa, t)
    _, dz, cosine, sine = arc(s0, a, cc, sc, kappa, t)
    speed = s0 + a * t
    dir_x = 0.5 * (pc + mc)
    dir_y = 0.5 * (ps + ms)
    out[0] = 0.5 * (px + mx)
    out[1] = 0.5 * (py + my)
    out[2] = dz
    out[3] = speed * dir_x
    out[4] = speed * dir_y
    out[5] = speed * sine
    out[6] = a * dir_x - speed * (w * dir_y + kappa * 0.5 * (ps - ms))
    out[7] = a * dir_y + speed * (w * dir_x - kappa * 0.5 * (mc - pc))
    out[8] = a * sine + speed * kappa * cosine


@inner_kernel
def move(leg, series, t, out):
    """Displacement, velocity and acceleration ``t`` seconds into a leg, into ``out`` (9,): m, m/s, m/s^2."""
    if leg[AMPLITUDE] != 0.0:
        _swing(leg, series, t, out)
    elif leg[PITCH] != 0.0:
        _pitching_arc(leg, t, out)
    else:
        _level_arc(leg, t, out)


@inner_kernel
def end_leg(leg):
    """The heading, climb and speed at the end of a leg become the start of the next."""
    t = leg[DURATION]
    heading = leg[HEADING] + leg[TURN] * t
    if leg[AMPLITUDE] != 0.0:
        heading = leg[HEADING] + leg[AMPLITUDE] * math.sin(leg[SWING] * t)
    leg[HEADING] = heading - 2.0 * math.pi * math.floor(heading / (2.0 * math.pi) + 0.5)
    leg[CLIMB] += leg[PITCH] * t
    leg[SPEED] += leg[ACCELERATION] * t
