"""All rows of many tracks, forward and back. The only loops over time and tracks of the compiled twin."""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import entry_kernel, inner_kernel
from jink.intent.adjoint.mixing import mix, mix_adjoint
from jink.intent.adjoint.prediction import predict, predict_adjoint
from jink.intent.adjoint.update import posterior, posterior_adjoint, update, update_adjoint

__all__ = ["backward", "forward"]


@inner_kernel
def _forward_track(
    b, tables, chain, birth_mean, birth_var, initial, z, dt, which, noise, detected, start_mean, start_cov,
    temper, floor, values, probs, mean, cov,
    weights, prior, density, mixed, mixed_cov, upper, moved, ahead, ahead_cov, inverse, gain, white, small, x,
):  # fmt: skip
    """Filter track ``b`` into ``values`` (T,), ``probs``, ``mean``, ``cov`` (T, M, ...); returns whether all went well.

    The third line of arguments keeps what the way back needs: a leading T keeps every row, a leading 1 the last.
    """
    rows, axes = z.shape[1], z.shape[2]
    modes, own = birth_mean.shape
    kin = 2 * axes
    n = kin + own
    second = own > (2 if axes == 2 else 4)
    keep = mixed.shape[0] > 1
    for p in range(modes):
        probs[0, p] = initial[p]
        for i in range(n):
            mean[0, p, i] = 0.0
            for j in range(n):
                cov[0, p, i, j] = 0.0
        for i in range(kin):
            mean[0, p, i] = start_mean[b, i // 2 + axes * (i % 2)]
            for j in range(kin):
                cov[0, p, i, j] = start_cov[b, i // 2 + axes * (i % 2), j // 2 + axes * (j % 2)]
        for k in range(own):
            mean[0, p, kin + k] = birth_mean[p, k]
            cov[0, p, kin + k, kin + k] = birth_var[p, k]
    values[0] = 0.0
    good = True
    for t in range(1, rows):
        u = which[b, t]
        s = t if keep else 0
        R = noise[b if noise.shape[0] > 1 else 0, t if noise.shape[1] > 1 else 0]
        mix(
            modes, n, kin, chain[u], probs[t - 1], mean[t - 1], cov[t - 1], birth_mean, birth_var,
            weights[s], prior[s], mixed[s], mixed_cov,
        )  # fmt: skip
        for p in range(modes):
            good = (
                predict(
                    axes, second, tables[u, p], dt[u], mixed[s, p], mixed_cov[p], n, upper[s, p], moved[s, p], small, x,
                    ahead, ahead_cov[s, p],
                )
                and good
            )  # fmt: skip
            if detected[b, t]:
                density[s, p], fine = update(
                    axes, n, ahead, ahead_cov[s, p], z[b, t], R, inverse[s, p], gain[s, p], white[s, p],
                    mean[t, p], cov[t, p],
                )  # fmt: skip
                good = good and fine and math.isfinite(density[s, p])
            else:
                for i in range(n):
                    mean[t, p, i] = ahead[i]
                    for j in range(n):
                        cov[t, p, i, j] = ahead_cov[s, p, i, j]
        values[t] = 0.0
        if detected[b, t]:
            values[t] = posterior(prior[s], density[s], temper, floor, modes, probs[t])
        else:
            for p in range(modes):
                probs[t, p] = prior[s, p]
        if not (good and math.isfinite(values[t])):
            return False
    return True


@inner_kernel
def _backward_track(
    b, tables, chain, birth_mean, birth_var, z, dt, which, noise, detected, temper, floor, value_bar, probs, mean, cov,
    weights, prior, density, mixed, upper, moved, ahead_cov, inverse, gain, white, small, x,
    x_bar, out_bar, upper_bar, through, S_bar, share, prior_bar, density_bar, mixed_bar, mixed_cov_bar,
    probs_bar, mean_bar, cov_bar,
    tables_bar, chain_bar, birth_mean_bar, birth_var_bar, initial_bar, noise_bar, start_cov_bar,
):  # fmt: skip
    """Add the derivatives of ``sum(value_bar * values)`` of track ``b``, whose every row was kept."""
    rows, axes = z.shape[1], z.shape[2]
    modes, own = birth_mean.shape
    kin = 2 * axes
    n = kin + own
    second = own > (2 if axes == 2 else 4)
    for p in range(modes):
        probs_bar[p] = 0.0
        for i in range(n):
            mean_bar[p, i] = 0.0
            for j in range(n):
                cov_bar[p, i, j] = 0.0
    last = rows - 1
    while last > 0 and (value_bar[last] == 0.0 or not detected[b, last]):
        last -= 1
    for t in range(last, 0, -1):
        u = which[b, t]
        seen = detected[b, t]
        if seen:
            posterior_adjoint(
                prior[t], density[t], temper, floor, modes, probs_bar, value_bar[t], share, prior_bar, density_bar
            )
        else:
            for p in range(modes):
                prior_bar[p] = probs_bar[p]
        for p in range(modes):
            if seen:
                update_adjoint(
                    axes, n, ahead_cov[t, p], inverse[t, p], gain[t, p], white[t, p], density_bar[p],
                    mean_bar[p], cov_bar[p], through, S_bar,
                    noise_bar[b if noise.shape[0] > 1 else 0, t if noise.shape[1] > 1 else 0],
                )  # fmt: skip
            for i in range(n):
                mixed_bar[p, i] = 0.0
                for j in range(n):
                    mixed_cov_bar[p, i, j] = 0.0
            predict_adjoint(
                axes, second, tables[u, p], dt[u], mixed[t, p], n, upper[t, p], moved[t, p], small, x, x_bar, out_bar,
                upper_bar, mean_bar[p], cov_bar[p], mixed_bar[p], mixed_cov_bar[p], tables_bar[u, p],
            )  # fmt: skip
        mix_adjoint(
            modes, n, kin, chain[u], probs[t - 1], mean[t - 1], cov[t - 1], birth_mean, birth_var,
            weights[t], prior[t], mixed[t], prior_bar, mixed_bar, mixed_cov_bar,
            chain_bar[u], probs_bar, mean_bar, cov_bar, birth_mean_bar, birth_var_bar, share,
        )  # fmt: skip
    for p in range(modes):
        initial_bar[p] += probs_bar[p]
        for k in range(own):
            birth_mean_bar[p, k] += mean_bar[p, kin + k]
            birth_var_bar[p, k] += cov_bar[p, kin + k, kin + k]
        for i in range(kin):
            for j in range(kin):
                start_cov_bar[b, i // 2 + axes * (i % 2), j // 2 + axes * (j % 2)] += cov_bar[p, i, j]


@entry_kernel
def forward(
    tables, chain, birth_mean, birth_var, initial, z, dt, which, noise, detected, start_mean, start_cov,
    temper, floor, log_likelihood, probs, mean, cov, failed, begin, end,
):  # fmt: skip
    """Filter tracks ``begin`` to ``end``; ``probs``, ``mean``, ``cov`` (B, T, M, ...) are the posterior of each row."""
    axes = z.shape[2]
    modes, own = birth_mean.shape
    n = 2 * axes + own
    weights, prior, density = np.zeros((1, modes, modes)), np.zeros((1, modes)), np.zeros((1, modes))
    mixed, mixed_cov = np.zeros((1, modes, n)), np.zeros((modes, n, n))
    upper, moved = np.zeros((1, modes, n, n)), np.zeros((1, modes, 2 * n + 1, n))
    ahead, ahead_cov = np.zeros(n), np.zeros((1, modes, n, n))
    inverse, gain = np.zeros((1, modes, axes, axes)), np.zeros((1, modes, n, axes))
    white, small, x = np.zeros((1, modes, axes)), np.zeros((8, 3)), np.zeros(n)
    for b in range(begin, end):
        failed[b] = not _forward_track(
            b, tables, chain, birth_mean, birth_var, initial, z, dt, which, noise, detected, start_mean, start_cov,
            temper, floor, log_likelihood[b], probs[b], mean[b], cov[b],
            weights, prior, density, mixed, mixed_cov, upper, moved, ahead, ahead_cov, inverse, gain, white, small, x,
        )  # fmt: skip


@entry_kernel
def backward(
    tables, chain, birth_mean, birth_var, initial, z, dt, which, noise, detected, start_mean, start_cov,
    temper, floor, value_bar, log_likelihood, failed,
    tables_bar, chain_bar, birth_mean_bar, birth_var_bar, initial_bar, noise_bar, start_cov_bar, begin, end,
):  # fmt: skip
    """Filter tracks ``begin`` to ``end`` and add the derivatives of ``sum(value_bar * log_likelihood)``.

    What a track needs on its way back stays in the processor's cache: nothing is computed twice, nothing stored.
    """
    rows, axes = z.shape[1], z.shape[2]
    modes, own = birth_mean.shape
    n = 2 * axes + own
    probs, mean, cov = np.zeros((rows, modes)), np.zeros((rows, modes, n)), np.zeros((rows, modes, n, n))
    weights, prior, density = np.zeros((rows, modes, modes)), np.zeros((rows, modes)), np.zeros((rows, modes))
    mixed, mixed_cov = np.zeros((rows, modes, n)), np.zeros((modes, n, n))
    upper, moved = np.zeros((rows, modes, n, n)), np.zeros((rows, modes, 2 * n + 1, n))
    ahead, ahead_cov = np.zeros(n), np.zeros((rows, modes, n, n))
    inverse, gain = np.zeros((rows, modes, axes, axes)), np.zeros((rows, modes, n, axes))
    white, small, x = np.zeros((rows, modes, axes)), np.zeros((8, 3)), np.zeros(n)
    x_bar, out_bar, upper_bar = np.zeros(n), np.zeros(n), np.zeros((n, n))
    through, S_bar = np.zeros((n, axes)), np.zeros((axes, axes))
    share, prior_bar, density_bar = np.zeros(modes), np.zeros(modes), np.zeros(modes)
    mixed_bar, mixed_cov_bar = np.zeros((modes, n)), np.zeros((modes, n, n))
    probs_bar, mean_bar, cov_bar = np.zeros(modes), np.zeros((modes, n)), np.zeros((modes, n, n))
    for b in range(begin, end):
        failed[b] = failed[b] or not _forward_track(
            b, tables, chain, birth_mean, birth_var, initial, z, dt, which, noise, detected, start_mean, start_cov,
            temper, floor, log_likelihood[b], probs, mean, cov,
            weights, prior, density, mixed, mixed_cov, upper, moved, ahead, ahead_cov, inverse, gain, white, small, x,
        )  # fmt: skip
        if not failed[b]:
            _backward_track(
                b, tables, chain, birth_mean, birth_var, z, dt, which, noise, detected, temper, floor, value_bar[b],
                probs, mean, cov, weights, prior, density, mixed, upper, moved, ahead_cov, inverse, gain, white,
                small, x, x_bar, out_bar, upper_bar, through, S_bar, share, prior_bar, density_bar,
                mixed_bar, mixed_cov_bar, probs_bar, mean_bar, cov_bar,
                tables_bar, chain_bar, birth_mean_bar, birth_var_bar, initial_bar, noise_bar, start_cov_bar,
            )  # fmt: skip
