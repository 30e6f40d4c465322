"""JAX: one track's cycle, vmapped over blocks of tracks, scanned over time, jitted, float64, one CPU thread.

Three forms: `jax` is written by hand with `jnp.linalg`; `jax-unrolled` is the same with the Cholesky factor
written out column by column, which XLA fuses over the tracks; `dynamax` uses dynamax's unscented filter
functions with the IMM cycle around them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from _problem import Case, Problem, array_trig, constant_velocity_matrix, move, to_result
from jax import lax

# Tracks vmapped at a time: larger blocks leave the cache and run slower.
BLOCK = 200

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platforms", "cpu")


def _unrolled_cholesky(cov: Any) -> Any:
    """Lower Cholesky factor by scalar formulas, so that batches fuse instead of calling LAPACK per matrix."""
    n = cov.shape[-1]
    factor: list[list[Any]] = [[jnp.zeros_like(cov[..., 0, 0])] * n for _ in range(n)]
    for j in range(n):
        factor[j][j] = jnp.sqrt(cov[..., j, j] - sum(factor[j][k] ** 2 for k in range(j)))
        for i in range(j + 1, n):
            rest = cov[..., i, j] - sum(factor[i][k] * factor[j][k] for k in range(j))
            factor[i][j] = rest / factor[j][j]
    return jnp.stack([jnp.stack(row, axis=-1) for row in factor], axis=-2)


def _condition(mean: Any, cov: Any, z: Any, z_mean: Any, s: Any, cross: Any) -> tuple[Any, Any, Any]:
    """Update with a two-dimensional measurement, the inverse of S written out."""
    det = s[..., 0, 0] * s[..., 1, 1] - s[..., 0, 1] ** 2
    flipped = jnp.stack([s[..., 1, 1], -s[..., 0, 1], -s[..., 0, 1], s[..., 0, 0]], axis=-1)
    inverse = flipped.reshape(s.shape) / det[..., None, None]
    gain, innovation = cross @ inverse, z - z_mean
    nis = jnp.einsum("...i,...ij,...j->...", innovation, inverse, innovation)
    mean = mean + jnp.einsum("...nd,...d->...n", gain, innovation)
    cov = cov - gain @ jnp.swapaxes(cross, -1, -2)
    return mean, cov, -0.5 * (nis + jnp.log(det)) - jnp.log(2 * jnp.pi)


def _by_hand(problem: Problem, cholesky: Callable[[Any], Any]) -> Callable[..., Any]:
    """All modes at once: (M, N), (M, N, N), z, dt, (M, N, N) to means, covariances, log-likelihoods."""
    n, position = problem.prior_mean.shape[1], jnp.array(problem.position_index)
    weight = 0.5 / n

    def points(mean: Any, cov: Any) -> Any:
        spread = jnp.sqrt(1.0 * n) * jnp.swapaxes(cholesky(cov), -1, -2)
        centre = mean[:, None]
        return jnp.concatenate([centre, centre + spread, centre - spread], axis=1)

    def outer(a: Any, b: Any) -> Any:
        wc = jnp.full(2 * n + 1, weight).at[0].set(2.0)
        return jnp.einsum("s,msi,msj->mij", wc, a, b)

    def filters(means: Any, covs: Any, z: Any, dt: Any, q: Any) -> tuple[Any, Any, Any]:
        drawn = points(means, covs)
        moved = jnp.stack(
            [
                jnp.stack(move(mode, jnp.moveaxis(drawn[j], -1, 0), dt, lambda u: array_trig(u, jnp)), -1)
                for j, mode in enumerate(problem.modes)
            ]
        )
        means = weight * moved[:, 1:].sum(1)
        deviation = moved - means[:, None]
        covs = outer(deviation, deviation) + q
        redrawn = points(means, covs)
        seen = redrawn[..., position]
        z_mean = weight * seen[:, 1:].sum(1)
        z_deviation = seen - z_mean[:, None]
        s = outer(z_deviation, z_deviation) + problem.noise
        return _condition(means, covs, z, z_mean, s, outer(redrawn - means[:, None], z_deviation))

    return filters


def _by_dynamax(problem: Problem) -> Callable[..., Any]:
    """The same from dynamax's (private) predict and condition functions, one call per mode."""
    from dynamax.nonlinear_gaussian_ssm import inference_ukf as dynamax_ukf

    n, position = problem.prior_mean.shape[1], jnp.array(problem.position_index)
    wm, wc = dynamax_ukf._compute_weights(n, 1.0, 2.0, 0.0)

    def filters(means: Any, covs: Any, z: Any, dt: Any, q: Any) -> tuple[Any, Any, Any]:
        parts = []
        for j, mode in enumerate(problem.modes):
            mean, cov, _ = dynamax_ukf._predict(
                means[j],
                covs[j],
                lambda x, u, mode=mode: jnp.stack(move(mode, x, dt, lambda v: array_trig(v, jnp))),
                q[j], 0.0, wm, wc, jnp.zeros(1),
            )  # fmt: skip
            log_likelihood, mean, cov = dynamax_ukf._condition_on(
                mean, cov, lambda x, u: x[position], problem.noise, 0.0, wm, wc, jnp.zeros(1), z
            )
            parts.append((mean, cov, log_likelihood))
        means, covs, scores = (jnp.stack(part) for part in zip(*parts, strict=True))
        return means, covs, scores

    return filters


def _linear(problem: Problem) -> Callable[..., Any]:
    """The Kalman filter of the `kf` workload in the same form."""
    h = jnp.eye(4)[jnp.array(problem.position_index)]
    at_zero = constant_velocity_matrix(0.0)
    slope = constant_velocity_matrix(1.0) - at_zero

    def filters(means: Any, covs: Any, z: Any, dt: Any, q: Any) -> tuple[Any, Any, Any]:
        f = at_zero + dt * slope
        means, covs = means @ f.T, f @ covs @ f.T + q
        return _condition(means, covs, z, means @ h.T, h @ covs @ h.T + problem.noise, covs @ h.T)

    return filters


def _cycle(problem: Problem, filters: Callable[..., Any]) -> Callable[..., Any]:
    """One step of one track: carry (means, covs, mode_probs) to the next and to the fused outputs."""
    transition, order = jnp.asarray(problem.mode_transition), jnp.array(problem.order)

    def cycle(carry: Any, data: Any) -> tuple[Any, Any]:
        (means, covs, mode_probs), (z, dt, q) = carry, data
        if problem.workload == "bank":
            predicted = mode_probs @ transition
            share = transition * mode_probs[:, None] / predicted
            mixed = share.T @ means
            deviation = means[:, None] - mixed
            covs = jnp.einsum("ij,inm->jnm", share, covs) + jnp.einsum("ij,ijn,ijm->jnm", share, deviation, deviation)
            means, covs, score = filters(mixed, covs, z, dt, q)
            mode_probs = jax.nn.softmax(score + jnp.log(predicted))
            mean = mode_probs @ means
            apart = means - mean
            cov = jnp.einsum("j,jnm->nm", mode_probs, covs) + jnp.einsum("j,jn,jm->nm", mode_probs, apart, apart)
        else:
            means, covs, _ = filters(means, covs, z, dt, q)
            mean, cov = means[0], covs[0]
        return (means, covs, mode_probs), (mean[order], cov[order][:, order], mode_probs)

    return cycle


def make_form(problem: Problem, form: str, stepwise: bool = False) -> Case:
    """Compile one form for the problem's shapes; compile time is kept apart."""
    if problem.workload == "kf":
        filters = _linear(problem)
    elif form == "dynamax":
        filters = _by_dynamax(problem)
    else:
        filters = _by_hand(problem, jnp.linalg.cholesky if form == "jax" else _unrolled_cholesky)
    cycle = _cycle(problem, filters)
    m, n = len(problem.modes), problem.prior_mean.shape[1]
    start = (
        jnp.repeat(jnp.asarray(problem.prior_mean)[:, None], m, axis=1),
        jnp.broadcast_to(jnp.asarray(problem.prior_cov), (problem.tracks, m, n, n)) + 0.0,
        jnp.broadcast_to(jnp.asarray(problem.mode_probs), (problem.tracks, m)) + 0.0,
    )
    zs, dts = jnp.asarray(problem.measurements[:, 1:]), jnp.asarray(np.diff(problem.times))
    noises = jnp.asarray(problem.process_noises())

    if stepwise:
        one = jax.jit(cycle)
        each = [(problem.measurements[0, k + 1], dts[k], noises[k]) for k in range(problem.steps)]

        def run() -> Any:
            carry, out = tuple(s[0] for s in start), None
            for data in each:
                carry, out = one(carry, data)
                jax.block_until_ready(out)
            return jax.tree.map(lambda o: o[None, None], out)

        def first_call() -> Any:
            return one(tuple(s[0] for s in start), each[0])

    else:

        @jax.jit
        def every_track(start: Any, zs: Any) -> Any:
            def one_track(data: Any) -> Any:
                carry, z = data
                return lax.scan(cycle, carry, (z, dts, noises))[1]

            return lax.map(one_track, (start, zs), batch_size=min(BLOCK, problem.tracks))

        def run() -> Any:
            return jax.block_until_ready(every_track(start, zs))

        first_call = run

    # The first call compiles: its time is reported beside the row, not in it.
    began = time.perf_counter()
    jax.block_until_ready(first_call())
    compile_s = time.perf_counter() - began

    def finish(raw: Any) -> Any:
        mean, cov, mode_probs = (np.asarray(part[:, -1]) for part in raw)
        return to_result(problem, *_unordered(problem, mean, cov), mode_probs)

    return Case(run=run, finish=finish, compile_s=compile_s)


def _unordered(problem: Problem, mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Put [x, y, vx, vy] back at their state indices, for to_result."""
    order, n = problem.order, problem.prior_mean.shape[1]
    full_mean, full_cov = np.zeros((len(mean), n)), np.zeros((len(mean), n, n))
    full_mean[:, order] = mean
    full_cov[np.ix_(range(len(mean)), order, order)] = cov
    return full_mean, full_cov
