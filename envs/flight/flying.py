"""The semi-Markov chain of intents, flown leg by leg: one compiled pass for a batch of episodes."""

from __future__ import annotations

import math

import numpy as np

from jink.envs.compiled import entry_kernel, inner_kernel
from jink.envs.flight.dwells import draw_dwell
from jink.envs.flight.intent_rules import (
    ALTITUDE,
    LEFT,
    MAX_CLIMB,
    MAX_LATERAL,
    MAX_SPEED,
    MIN_SPEED,
    NOW_SIZE,
    OUT_SIZE,
    WISH_SIZE,
    between,
    call_plan,
)
from jink.envs.flight.intent_rules import CLIMB as NOW_CLIMB
from jink.envs.flight.intent_rules import HEADING as NOW_HEADING
from jink.envs.flight.intent_rules import SPEED as NOW_SPEED
from jink.envs.flight.legs import (
    ACCELERATION,
    AMPLITUDE,
    CLIMB,
    DURATION,
    HEADING,
    LEG_SIZE,
    PITCH,
    SERIES,
    SPEED,
    SWING,
    TURN,
    begin_leg,
    end_leg,
    move,
)

START_DRAWS = 6
"""Uniforms of the start: speed, heading, place (3), first intent."""
VISIT_DRAWS = 2
"""Uniforms at the head of a round: next intent, dwell; used when the round opens a visit."""
_SLIVER = 1e-9  # s; what rounding leaves of a dwell


@inner_kernel
def _pick(cumulative, row, u):
    last = cumulative.shape[1] - 1
    for j in range(last):
        if u < cumulative[row, j]:
            return j
    return last


@inner_kernel
def _set_leg(leg, wishes, at, left, now, axes):
    """A leg as long as the limits let the wish last unchanged (and at most ``left`` seconds)."""
    duration = left
    speed = leg[SPEED]
    a = wishes[at + 1]
    if a != 0.0:
        room = ((now[MAX_SPEED] if a > 0.0 else now[MIN_SPEED]) - speed) / a
        if room <= _SLIVER:
            a = 0.0
        else:
            duration = min(duration, room)
    pitch = wishes[at + 3] if axes == 3 else 0.0
    if pitch != 0.0:
        room = ((now[MAX_CLIMB] if pitch > 0.0 else -now[MAX_CLIMB]) - leg[CLIMB]) / pitch
        if room <= _SLIVER:
            pitch = 0.0
        else:
            duration = min(duration, room)
    turn = wishes[at + 2]
    amplitude = wishes[at + 4]
    rate = wishes[at + 5]
    fastest = max(speed, speed + a * duration)
    lateral = fastest * math.sqrt(turn * turn + pitch * pitch)
    if lateral > now[MAX_LATERAL]:
        turn *= now[MAX_LATERAL] / lateral
        pitch *= now[MAX_LATERAL] / lateral
    lateral = speed * abs(amplitude) * rate
    if lateral > now[MAX_LATERAL]:
        amplitude *= now[MAX_LATERAL] / lateral
    leg[DURATION] = duration
    leg[ACCELERATION] = a
    leg[TURN] = turn
    leg[PITCH] = pitch
    leg[AMPLITUDE] = amplitude
    leg[SWING] = rate


@entry_kernel
def fly(
    times, uniforms, block, start, limits, addresses, params, counts, dwells, first, chain,
    position, velocity, acceleration, intent, switches,
):  # fmt: skip
    """Trajectories of all rows; -1, or the index of an intent whose plan leaves its time unfilled.

    uniforms: those of the start, then blocks of ``block``, one a round; as many rounds as columns of ``switches``.
    """
    rows, samples = times.shape
    axes = position.shape[2]
    u = np.zeros(block - VISIT_DRAWS)
    rounds = switches.shape[1]
    now = np.zeros(NOW_SIZE)
    for i in range(limits.size):
        now[MIN_SPEED + i] = limits[i]
    leg = np.zeros(LEG_SIZE)
    series = np.zeros(SERIES + 1)
    out = np.zeros(9)
    wishes = np.zeros(OUT_SIZE)
    place = np.zeros(3)
    row_params = np.zeros(params.shape[1])
    for b in range(rows):
        leg[SPEED] = between(start[0, 0], start[0, 1], uniforms[b, 0])
        leg[HEADING] = between(start[1, 0], start[1, 1], uniforms[b, 1])
        leg[CLIMB] = 0.0
        for axis in range(3):
            place[axis] = between(start[2 + axis, 0], start[2 + axis, 1], uniforms[b, 2 + axis])
        current = _pick(first, 0, uniforms[b, 5])
        t = 0.0
        left = 0.0
        k = 0
        switched = 0
        this_round = 0
        while k < samples:
            if this_round == rounds:
                return current
            base = START_DRAWS + this_round * block
            if left <= _SLIVER:
                if this_round > 0:
                    following = _pick(chain, current, uniforms[b, base])
                    if following != current:
                        switches[b, switched] = t
                        switched += 1
                    current = following
                left = draw_dwell(dwells[current], uniforms[b, base + 1])
            this_round += 1
            for i in range(counts[current]):
                u[i] = uniforms[b, base + VISIT_DRAWS + i]
            for i in range(params.shape[1]):
                row_params[i] = params[current, i]
            now[NOW_SPEED] = leg[SPEED]
            now[NOW_HEADING] = leg[HEADING]
            now[NOW_CLIMB] = leg[CLIMB]
            now[ALTITUDE] = place[2]
            now[LEFT] = left
            wishes[0] = 0.0
            call_plan(addresses[current], now, u, row_params, wishes)
            for w in range(int(wishes[0])):
                at = 1 + w * WISH_SIZE
                wished = min(wishes[at], left)
                left -= wished
                while wished > 0.0 and k < samples:
                    _set_leg(leg, wishes, at, wished, now, axes)
                    wished -= leg[DURATION]
                    begin_leg(leg, series)
                    end = t + leg[DURATION]
                    while True:  # the samples of the leg, then its end
                        inside = k < samples and times[b, k] < end
                        move(leg, series, times[b, k] - t if inside else leg[DURATION], out)
                        if not inside:
                            break
                        for axis in range(axes):
                            position[b, k, axis] = place[axis] + out[axis]
                            velocity[b, k, axis] = out[3 + axis]
                            acceleration[b, k, axis] = out[6 + axis]
                        intent[b, k] = current
                        k += 1
                    end_leg(leg)
                    leg[SPEED] = min(max(leg[SPEED], now[MIN_SPEED]), now[MAX_SPEED])
                    for axis in range(axes):
                        place[axis] += out[axis]
                    t = end
    return -1
