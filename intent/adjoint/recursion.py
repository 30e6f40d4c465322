"""All rows of many tracks, forward and back. The only loops over time and tracks of the compiled twin."""

from __future__ import annotations

import math

import numpy as np

from jink.estimators.compiled import entry_kernel
from jink.intent.adjoint.mixing import mix, mix_adjoint
from jink.intent.adjoint.prediction import predict, predict_adjoint
from jink.intent.adjoint.update import posterior, posterior_adjoint, update, update_adjoint

__all__ = ["backward", "forward"]


@entry_kernel
def forward(
    tables, chain, birth_mean, birth_var, initial, z, dt, which, noise, detected, start_mean, start_cov,
    temper, floor, log_likelihood, probs, mean, cov, failed, begin, end,
):  # fmt: skip
    """Filter tracks ``begin`` to ``end``; ``probs``, ``mean``, ``cov`` (B, T, M, ...) keep the posterior of each row."""
    rows, axes = z.shape[1], z.shape[2]
    modes, own = birth_mean.shape
    kin = 2 * axes
    n = kin + own
    second = own > (2 if axes == 2 else 4)
    weights, prior, density = np.zeros((modes, modes)), np.zeros(modes), np.zeros(modes)
    mixed, mixed_cov = np.zeros((modes, n)), np.zeros((modes, n, n))
    upper, moved, small, x = np.zeros((n, n)), np.zeros((2 * n + 1, n)), np.zeros((8, 3)), np.zeros(n)
    ahead, ahead_cov = np.zeros(n), np.zeros((n, n))
    inverse, gain, white = np.zeros((axes, axes)), np.zeros((n, axes)), np.zeros(axes)
    for b in range(begin, end):
        for p in range(modes):
            probs[b, 0, p] = initial[p]
            for i in range(kin):
                mean[b, 0, p, i] = start_mean[b, i // 2 + axes * (i % 2)]
                for j in range(kin):
                    cov[b, 0, p, i, j] = start_cov[b, i // 2 + axes * (i % 2), j // 2 + axes * (j % 2)]
            for k in range(own):
                mean[b, 0, p, kin + k] = birth_mean[p, k]
                cov[b, 0, p, kin + k, kin + k] = birth_var[p, k]
        good = True
        for t in range(1, rows):
            u = which[b, t]
            R = noise[b if noise.shape[0] > 1 else 0, t if noise.shape[1] > 1 else 0]
            mix(
                modes, n, kin, chain[u], probs[b, t - 1], mean[b, t - 1], cov[b, t - 1], birth_mean, birth_var,
                weights, prior, mixed, mixed_cov,
            )  # fmt: skip
            for p in range(modes):
                good = (
                    predict(
                        axes, second, tables[u, p], dt[u], mixed[p], mixed_cov[p], n, upper, moved, small, x,
                        ahead, ahead_cov,
                    )
                    and good
                )  # fmt: skip
                if detected[b, t]:
                    density[p], fine = update(
                        axes, n, ahead, ahead_cov, z[b, t], R, inverse, gain, white, mean[b, t, p], cov[b, t, p]
                    )
                    good = good and fine and math.isfinite(density[p])
                else:
                    for i in range(n):
                        mean[b, t, p, i] = ahead[i]
                        for j in range(n):
                            cov[b, t, p, i, j] = ahead_cov[i, j]
            if detected[b, t]:
                log_likelihood[b, t] = posterior(prior, density, temper, floor, modes, probs[b, t])
                good = good and math.isfinite(log_likelihood[b, t])
            else:
                for p in range(modes):
                    probs[b, t, p] = prior[p]
            if not good:
                failed[b] = True
                break


@entry_kernel
def backward(
    tables, chain, birth_mean, birth_var, z, dt, which, noise, detected, temper, floor, probs, mean, cov, failed,
    value_bar, tables_bar, chain_bar, birth_mean_bar, birth_var_bar, initial_bar, noise_bar, start_cov_bar, begin, end,
):  # fmt: skip
    """Add the derivatives of ``sum(value_bar * log_likelihood)`` over tracks ``begin`` to ``end``.

    Every row is computed again from the posterior of the row before, then taken back.
    """
    rows, axes = z.shape[1], z.shape[2]
    modes, own = birth_mean.shape
    kin = 2 * axes
    n = kin + own
    second = own > (2 if axes == 2 else 4)
    weights, prior, density = np.zeros((modes, modes)), np.zeros(modes), np.zeros(modes)
    mixed, mixed_cov = np.zeros((modes, n)), np.zeros((modes, n, n))
    upper, moved = np.zeros((modes, n, n)), np.zeros((modes, 2 * n + 1, n))
    small, x, x_bar, out_bar = np.zeros((8, 3)), np.zeros(n), np.zeros(n), np.zeros(n)
    ahead, ahead_cov = np.zeros((modes, n)), np.zeros((modes, n, n))
    inverse, gain, white = np.zeros((modes, axes, axes)), np.zeros((modes, n, axes)), np.zeros((modes, axes))
    spare_mean, spare_cov = np.zeros(n), np.zeros((n, n))
    upper_bar, through, S_bar = np.zeros((n, n)), np.zeros((n, axes)), np.zeros((axes, axes))
    share, prior_bar, density_bar = np.zeros(modes), np.zeros(modes), np.zeros(modes)
    mixed_bar, mixed_cov_bar = np.zeros((modes, n)), np.zeros((modes, n, n))
    probs_bar, mean_bar, cov_bar = np.zeros(modes), np.zeros((modes, n)), np.zeros((modes, n, n))
    for b in range(begin, end):
        if failed[b]:
            continue
        probs_bar[:] = 0.0
        mean_bar[:] = 0.0
        cov_bar[:] = 0.0
        last = rows - 1
        while last > 0 and value_bar[b, last] == 0.0:
            last -= 1
        for t in range(last, 0, -1):
            u = which[b, t]
            r0 = b if noise.shape[0] > 1 else 0
            r1 = t if noise.shape[1] > 1 else 0
            mix(
                modes, n, kin, chain[u], probs[b, t - 1], mean[b, t - 1], cov[b, t - 1], birth_mean, birth_var,
                weights, prior, mixed, mixed_cov,
            )  # fmt: skip
            seen = detected[b, t]
            for p in range(modes):
                predict(
                    axes, second, tables[u, p], dt[u], mixed[p], mixed_cov[p], n, upper[p], moved[p], small, x,
                    ahead[p], ahead_cov[p],
                )  # fmt: skip
                if seen:
                    density[p], _ = update(
                        axes, n, ahead[p], ahead_cov[p], z[b, t], noise[r0, r1], inverse[p], gain[p], white[p],
                        spare_mean, spare_cov,
                    )  # fmt: skip
            if seen:
                posterior_adjoint(
                    prior, density, temper, floor, modes, probs_bar, value_bar[b, t], share, prior_bar, density_bar
                )
            else:
                for p in range(modes):
                    prior_bar[p] = probs_bar[p]
            for p in range(modes):
                if seen:
                    update_adjoint(
                        axes, n, ahead_cov[p], inverse[p], gain[p], white[p], density_bar[p], mean_bar[p], cov_bar[p],
                        through, S_bar, noise_bar[r0, r1],
                    )  # fmt: skip
                for i in range(n):
                    mixed_bar[p, i] = 0.0
                    for j in range(n):
                        mixed_cov_bar[p, i, j] = 0.0
                predict_adjoint(
                    axes, second, tables[u, p], dt[u], mixed[p], n, upper[p], moved[p], small, x, x_bar, out_bar,
                    upper_bar, mean_bar[p], cov_bar[p], mixed_bar[p], mixed_cov_bar[p], tables_bar[u, p],
                )  # fmt: skip
            mix_adjoint(
                modes, n, kin, chain[u], probs[b, t - 1], mean[b, t - 1], cov[b, t - 1], birth_mean, birth_var,
                weights, prior, mixed, prior_bar, mixed_bar, mixed_cov_bar,
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
