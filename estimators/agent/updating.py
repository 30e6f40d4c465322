"""The update of a filter whose agent chooses the noise of each measurement."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.agent.beliefs import overconfidence
from jink.estimators.agent.lookback import carry, forget_update, kept_size, reconsider, remember_update
from jink.estimators.agent.looking import (
    BELIEF,
    DRIFT,
    LARGEST_LOG_INFLATION,
    NIS,
    PLAIN_VIEW,
    VIEWS,
    begin_memory,
    look,
    look_away,
    memory_size,
    note_used,
)
from jink.estimators.agent.network import Network, evaluate_network, make_network
from jink.estimators.agent.policy import Policy
from jink.estimators.compiled import inner_kernel
from jink.estimators.factors import FACTORS, call_factor, normalised_innovation
from jink.estimators.kalman import gaussian_update
from jink.estimators.linalg import clear_rows, copy_rows
from jink.estimators.modes import careful_covariance, measure_mode
from jink.estimators.restarting import refusals_agree, widening

__all__ = [
    "IDLE",
    "Chooser",
    "agent_loses",
    "agent_memory",
    "agent_moves",
    "agent_skip",
    "agent_update",
    "forget",
    "make_chooser",
]


class Chooser(NamedTuple):
    """What the kernels read of a `Policy`."""

    network: Network
    sees: int
    honest: bool
    looks_back: bool
    addresses: NDArray[np.int64]  # (F,) factors; none: an inflation
    thresholds: NDArray[np.float64]  # (D, F, 2)


def make_chooser(policy: Policy, components: int) -> Chooser:
    """The policy for a sensor of D components; factors are compiled on first use."""
    factors = [FACTORS[name] for name in policy.factors]
    thresholds = np.full((components, len(factors), 2), np.inf)
    for d in range(components):
        for number, factor in enumerate(factors):
            thresholds[d, number] = factor.thresholds(d + 1)
    return Chooser(
        policy.network,
        VIEWS[policy.view],
        policy.covariance == "mixture",
        policy.lookback,
        np.array([factor.function.address for factor in factors], dtype=np.int64),
        thresholds,
    )


_ONE = np.ones((1, 1)), np.zeros(1)
IDLE = Chooser(
    make_network((_ONE,), np.zeros((1, 1)), np.zeros(1), np.ones(1), "tanh"), PLAIN_VIEW, False, False,
    np.zeros(0, dtype=np.int64), np.zeros((0, 0, 2)),
)  # fmt: skip
"""Of an estimator without an agent."""


def agent_memory(components: int, n: int, looks_back: bool) -> int:
    """Columns an agent remembers: those of `looking`, its last action, then what the last update of n states did."""
    return memory_size(components) + 1 + (kept_size(n, components) if looks_back else 0)


@inner_kernel
def forget(memory, components):
    """Nothing has been seen, no action taken, no update made."""
    last = DRIFT + components
    begin_memory(memory[:last])
    memory[last] = -1.0
    if memory.size > last + 1:
        forget_update(memory)


@inner_kernel
def agent_moves(chooser, components, n, F_transposed, memory, moved):
    """The state was predicted."""
    if chooser.looks_back:
        carry(memory[DRIFT + components + 1 :], n, components, F_transposed, moved)


@inner_kernel
def agent_loses(chooser, memory):
    """The state was begun anew."""
    if chooser.looks_back:
        forget_update(memory)


@inner_kernel
def _slope(program, work, linear, kept, n, D, d, g):
    """``H D`` of `lookback`, for a nonlinear sensor with the H of its sigma points; (d, components then)."""
    for c in range(int(kept[kept.size - 1])):
        if not linear:  # by the root of P that `measure_mode` used
            for i in range(n):
                total = kept[i * D + c]
                for k in range(i):
                    total -= work.upper[k, i] * work.vector[k]
                work.vector[i] = total / work.upper[i, i] if work.upper[i, i] > 0.0 else 0.0
        for a in range(d):
            total = 0.0
            for i in range(n):
                total += work.H[a, i] * kept[i * D + c] if linear else work.gain[a, i] * work.vector[i]
            g[a, c] = total


@inner_kernel
def _decide(chooser, components, memory, features, hidden):
    """The action: the number of a factor, or a number in -1 .. 1; remembered."""
    choices, last = chooser.addresses.size, DRIFT + components
    if chooser.sees == PLAIN_VIEW:
        at = 2 * components + 5
        if choices == 0:
            features[at] = memory[last]
        for j in range(choices):
            features[at + j] = 1.0 if j == memory[last] else 0.0
    row = evaluate_network(chooser.network, features, hidden)
    if choices == 0:
        action = min(max(hidden[row, 0], -1.0), 1.0)
    else:
        best = 0
        for j in range(choices):
            if hidden[row, j] > hidden[row, best]:
                best = j
        action = float(best)
    memory[last] = action
    return action


@inner_kernel
def agent_skip(chooser, components, memory, features, hidden):
    """A row without a measurement: the agent sees that, and its decision changes nothing but what it sees next."""
    look_away(chooser.sees, memory[: DRIFT + components], components, features)
    if chooser.sees == PLAIN_VIEW:
        _decide(chooser, components, memory, features, hidden)


@inner_kernel
def agent_update(
    chooser, program, work, memory, refusals, room, scratch, features, hidden, m, P, sensor, z, d, m_out, P_out
):
    """Look at the ``d`` components present, choose their noise R~, update with it.

    Log density and NIS are those with R~, as for adaptive factors: they say little of whether the target is lost.
    That is judged by `refusals_agree`, with the nominal R.

    Returns:
        (log density, NIS, whether all went well, what `refusals_agree` found, and how much to widen then).
    """
    n, size = program.sizes[0], z.size
    given, excess, HPH, chosen, basis, believed = room[0], room[1], room[2], room[3], room[4], room[5]
    v, seen, kept = work.innovation[0], memory[: DRIFT + size], memory[DRIFT + size + 1 :]
    copy_rows(work.R, given, d)
    clear_rows(work.R, d)
    linear, good = measure_mode(program, work, 0, m, P, sensor, z, d)
    copy_rows(work.S, HPH, d)
    if chooser.looks_back:
        _slope(program, work, linear, kept, n, size, d, room[6])
        again = reconsider(
            kept, n, size, v, HPH, given, d, room[6], seen[BELIEF:DRIFT], scratch, room[7], basis, room[8], m, P
        )
        if again:
            linear, good = measure_mode(program, work, 0, m, P, sensor, z, d)
            copy_rows(work.S, HPH, d)
    look(chooser.sees, v, HPH, given, d, work.present, size, seen, scratch, basis, features)
    action = _decide(chooser, size, memory, features, hidden)
    if chooser.addresses.size == 0:
        inflation = math.exp(0.5 * LARGEST_LOG_INFLATION * (action + 1.0))
        for a in range(d):
            for c in range(d):
                chosen[a, c] = inflation * given[a, c]
    else:
        best = int(action)
        call_factor(
            chooser.addresses[best], v[:d], HPH, given, seen[NIS], chooser.thresholds[d - 1, best], scratch, chosen
        )
    before, after = 0.0, 0.0
    for a in range(d):
        before += given[a, a]
        after += chosen[a, a]
        for c in range(d):
            work.S[a, c] = HPH[a, c] + given[a, c]
    note_used(seen, after / before)
    found, widen_by = 0, 1.0
    nominal = normalised_innovation(v, HPH, given, 1.0, d, work.statistic)
    if np.isfinite(nominal):
        found = refusals_agree(refusals, work.statistic[d:], work.present, nominal, d)
        widen_by = widening(program, v, work.S, given, 1.0, d, work)
    for a in range(d):
        for c in range(d):
            work.R[a, c] = chosen[a, c]
            work.S[a, c] = HPH[a, c] + chosen[a, c]
    log_density, nis, fine, lost = gaussian_update(
        m, P, work.R, work.cross, work.S, v, d, n, work.factor, work.gain, work.whitened, m_out, P_out
    )
    if lost:
        careful_covariance(program, work, 0, linear, P, d, P_out)
    elif chooser.honest and fine:
        sure = overconfidence(basis, d, chosen, seen[BELIEF:DRIFT], scratch, believed, excess)
        if chooser.looks_back and sure:
            remember_update(kept, n, size, work.cross, basis, d, believed)
        for r in range(n):
            for c in range(r + 1):
                total = P_out[r, c]
                for i in range(d):
                    for k in range(d):
                        total += work.cross[i, r] * excess[i, k] * work.cross[k, c]
                P_out[r, c] = total
                P_out[c, r] = total
    return log_density, nis, good and fine, found, widen_by
