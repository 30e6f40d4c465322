"""What sensors see of states, and how that changes with the state: ``h(x)`` and ``H = dh/dx`` per target and scan."""

from __future__ import annotations

from jink.estimators.compiled import call_kinematics, call_noise, call_observe, call_transition, inner_kernel, kernel
from jink.estimators.linalg import wrap_angle

__all__ = ["linearise", "linearise_one", "move_tables", "step_tables"]

_NODES = (0.1127016653792583, 0.5, 0.8872983346207417)
_NODE_WEIGHTS = (0.2777777777777778, 0.4444444444444444, 0.2777777777777778)


@inner_kernel
def _kinematics(moving, x, kin):
    if moving.kinematics[0] != 0:
        call_kinematics(moving.kinematics[0], x, moving.params[0, : moving.counts[0]], kin)
    else:
        for i in range(kin.size):
            kin[i] = x[moving.index[i]]


@kernel
def linearise_one(moving, sensing, s, place, x, kin, above, below, seen, H):
    """``seen = h(x)`` (D,) of sensor ``s`` at ``place`` (2 A,), and ``H`` (D, n), zero beyond its components.

    The matrix itself for linear sensors of Cartesian states, else central differences. ``kin`` (2 A,), ``above`` and
    ``below`` (D,) are scratch; ``x`` is changed and restored.
    """
    d, n = sensing.sizes[s], x.size
    address, params = sensing.observe[s], sensing.params[s, : sensing.counts[s]]
    _kinematics(moving, x, kin)
    for a in range(H.shape[0]):
        for c in range(n):
            H[a, c] = 0.0
    cartesian = moving.kinematics[0] == 0
    if sensing.linear[s] and cartesian:
        for a in range(d):
            seen[a] = 0.0
            for i in range(kin.size):
                H[a, moving.index[i]] = sensing.matrix[s, a, i]
                seen[a] += sensing.matrix[s, a, i] * kin[i]
        return
    call_observe(address, kin, place, params, seen[:d])
    for i in range(kin.size if cartesian else n):
        c = moving.index[i] if cartesian else i
        centre = x[c]
        step = 1e-3 + 1e-6 * abs(centre) if cartesian else 1e-5 * (1.0 + abs(centre))
        x[c] = centre + step
        _kinematics(moving, x, kin)
        call_observe(address, kin, place, params, above[:d])
        x[c] = centre - step
        _kinematics(moving, x, kin)
        call_observe(address, kin, place, params, below[:d])
        x[c] = centre
        for a in range(d):
            difference = above[a] - below[a]
            H[a, c] = (wrap_angle(difference) if sensing.angular[s, a] else difference) / (2.0 * step)


@inner_kernel
def linearise(moving, sensing, sensor, places, means, begin, kin, above, below, seen, H):
    """`linearise_one` for every target from its first scan on.

    Args:
        moving, sensing: tables of motion and sensors.
        sensor, places: sensor of each scan and its state; (K,), (K, 2 A).
        means: where to linearise; (M, K, n).
        begin: first scan of each target; (M,).
        kin, above, below: scratch; (2 A,), (D,), (D,).
        seen, H: ``h(x)`` and its Jacobian; (M, K, D), (M, K, D, n).
    """
    for m in range(means.shape[0]):
        for k in range(begin[m], means.shape[1]):
            linearise_one(
                moving, sensing, sensor[k], places[k], means[m, k], kin, above, below, seen[m, k], H[m, k]
            )  # fmt: skip


@inner_kernel
def _process_noise(moving, j, x, dt, above, below, Q):
    """Q of mode ``j`` over ``dt`` from ``x``; without a closed form by Gauss-Legendre of the flow, as in the bank."""
    n = x.size
    params = moving.params[j, : moving.counts[j]]
    for a in range(n):
        for c in range(n):
            Q[a, c] = 0.0
    if moving.noise[j] != 0:
        call_noise(moving.noise[j], x, dt, params, Q)
        return
    for c in range(n):
        if moving.diffusion[j, c] > 0.0:
            centre = x[c]
            step = 1e-5 * (1.0 + abs(centre))
            for node in range(3):
                x[c] = centre + step
                call_transition(moving.transition[j], x, dt * _NODES[node], params, above)
                x[c] = centre - step
                call_transition(moving.transition[j], x, dt * _NODES[node], params, below)
                scale = dt * _NODE_WEIGHTS[node] * moving.diffusion[j, c] / (4.0 * step * step)
                for a in range(n):
                    for b in range(n):
                        Q[a, b] += scale * (above[a] - below[a]) * (above[b] - below[b])
            x[c] = centre


@inner_kernel
def step_tables(moving, j, x, dt, above, below, moved, F, Q):
    """``moved = f(x)`` (n,), its Jacobian ``F`` (n, n) and the process noise ``Q`` (n, n) of mode ``j`` over ``dt``.

    Exact for linear motions, central differences otherwise. ``above``, ``below`` (n,) are scratch; ``x`` is restored.
    """
    n = x.size
    address, params = moving.transition[j], moving.params[j, : moving.counts[j]]
    if moving.linear[j]:
        for c in range(n):
            below[c] = 0.0
        for c in range(n):
            below[c] = 1.0
            call_transition(address, below, dt, params, above)
            below[c] = 0.0
            for a in range(n):
                F[a, c] = above[a]
        for a in range(n):
            moved[a] = 0.0
            for c in range(n):
                moved[a] += F[a, c] * x[c]
    else:
        call_transition(address, x, dt, params, moved)
        for c in range(n):
            centre = x[c]
            step = 1e-5 * (1.0 + abs(centre))
            x[c] = centre + step
            call_transition(address, x, dt, params, above)
            x[c] = centre - step
            call_transition(address, x, dt, params, below)
            x[c] = centre
            for a in range(n):
                difference = above[a] - below[a]
                F[a, c] = (wrap_angle(difference) if moving.angular[a] else difference) / (2.0 * step)
    _process_noise(moving, j, x, dt, above, below, Q)


@inner_kernel
def move_tables(moving, times, origin, scratch, F, Q):
    """F and Q of every mode for the step that ends at each scan; linear motions only.

    Args:
        moving: tables of the motion.
        times, origin: of the scans, and the time before the first, s; (K,).
        scratch: (4, n).
        F, Q: (J, K, n, n).
    """
    for j in range(F.shape[0]):
        for k in range(times.size):
            dt = times[k] - (origin if k == 0 else times[k - 1])
            for a in range(scratch.shape[1]):
                scratch[3, a] = 0.0
            step_tables(moving, j, scratch[3], dt, scratch[0], scratch[1], scratch[2], F[j, k], Q[j, k])
