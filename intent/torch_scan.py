"""The cycle of the bank over tracks and modes at once, in torch operations: any device, gradients by torch.

The state of all tracks and modes is (N, B, M), components first: every operation is elementwise over long rows, so a
Cholesky factor of 6 x 6 costs some thirty operations for any number of tracks. `jink.estimators` defines what is
computed (interaction ``birth``, unscented prediction with alpha 1, beta 2, kappa 0, position measurements); this is
its twin.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from jink.intent.torch_motion import MotionStep

__all__ = ["Recursion", "scan"]

_ZERO_PIVOT = 1e-14
_NEGATIVE_PIVOT = 1e-9
_LOG_TWO_PI = math.log(2.0 * math.pi)


class Recursion(NamedTuple):
    """What a pass over all rows gives.

    ``failed`` tracks met numerical trouble; after a backward pass of the compiled recursion also those whose
    derivatives were no numbers.
    """

    log_likelihood: Tensor  # (B, T)
    mode_probs: Tensor  # (B, T, M), empty unless asked for
    mean: Tensor  # (B, T, 2A) position then velocity, empty unless asked for
    cov: Tensor  # (B, T, 2A, 2A)
    failed: Tensor  # (B,)


def _upper_factor(cov: Tensor) -> tuple[Tensor, Tensor]:
    """Upper Cholesky factors (N, N, B, M) with zero rows where a pivot vanishes, and which were no covariances."""
    n = cov.shape[0]
    rest, rows = cov, []
    bad = torch.zeros_like(cov[0, 0], dtype=torch.bool)
    for i in range(n):
        pivot, size = rest[0, 0], cov[i, i]
        sound = pivot > _ZERO_PIVOT * size
        bad = bad | ~(pivot >= -_NEGATIVE_PIVOT * size.abs())
        scale = torch.where(sound, torch.where(sound, pivot, torch.ones_like(pivot)).rsqrt(), torch.zeros_like(pivot))
        row = rest[0] * scale
        rows.append(torch.nn.functional.pad(row, (0, 0, 0, 0, i, 0)) if i else row)
        if i + 1 < n:
            tail = row[1:]
            rest = rest[1:, 1:] - tail[:, None] * tail[None, :]
    return torch.stack(rows), bad


def _interact(
    mean: Tensor, cov: Tensor, probs: Tensor, chain: Tensor, birth_mean: Tensor, birth_var: Tensor, kin: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Prior probabilities (B, M) and every mode's mixture of what carries over and what is born."""
    joint = chain * probs[:, :, None]
    prior = joint.sum(1)
    alive = prior > 0.0
    weights = joint / torch.where(alive, prior, torch.ones_like(prior))[:, None, :]
    stay = torch.diagonal(weights, dim1=1, dim2=2)
    own = torch.diag_embed((~alive).to(weights.dtype))  # a mode that cannot be reached keeps its own state
    weights, stay = weights + own, stay + (~alive).to(stay.dtype)
    # moments about a point of each track: second moments of positions far away would lose the spread
    centre = mean[:kin].detach().mean(2, keepdim=True)
    away = mean[:kin] - centre
    second = cov[:kin, :kin] + away[:, None] * away[None, :]
    stacked = torch.cat([away, second.reshape(kin * kin, *away.shape[1:])])
    mixed = torch.einsum("kbq,bqp->kbp", stacked, weights)
    shift = mixed[:kin]
    spread = mixed[kin:].reshape(kin, kin, *shift.shape[1:]) - shift[:, None] * shift[None, :]
    novel = mean[kin:] - birth_mean
    born = birth_mean + stay * novel
    cross = stay * (cov[:kin, kin:] + (away - shift)[:, None] * novel[None, :])
    fresh = torch.diag_embed(birth_var.movedim(0, -1)).movedim(0, -1)[:, :, None, :]
    inner = stay * cov[kin:, kin:] + (1.0 - stay) * (fresh + stay * novel[:, None] * novel[None, :])
    cov_out = torch.cat([torch.cat([spread, cross], 1), torch.cat([cross.transpose(0, 1), inner], 1)])
    return prior, torch.cat([shift + centre, born]), cov_out


def _predict(step: MotionStep, mean: Tensor, cov: Tensor, dt: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Unscented prediction of all tracks and modes; ``dt`` (B or 1, 1)."""
    n, kin = mean.shape[0], 2 * step.axes
    upper, bad = _upper_factor(cov)
    offsets = math.sqrt(n) * upper.transpose(0, 1)  # component, point
    points = torch.cat([mean[:, None], mean[:, None] + offsets, mean[:, None] - offsets], 1)
    end, average = step.velocities(points)
    place = points[0:kin:2] + dt * average
    kinematics = torch.stack([place, end], 1).reshape(kin, *place.shape[1:])
    moved = torch.cat([kinematics, step.shapes(points)])
    centre = moved[:, :1]
    mean_out = centre[:, 0] + (moved[:, 1:] - centre).sum(1) / (2.0 * n)
    deviation = moved - mean_out[:, None]
    others = deviation[:, 1:]
    flat = others.permute(2, 3, 0, 1)
    spread = (flat @ flat.transpose(2, 3)).permute(2, 3, 0, 1) / (2.0 * n)
    first = deviation[:, 0]
    return mean_out, spread + 2.0 * first[:, None] * first[None, :] + step.noise(mean), bad


def _update(mean: Tensor, cov: Tensor, z: Tensor, R: Tensor, axes: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Posterior, log density, and where the innovation had no covariance; z (A, B), R (A, A, B)."""
    rows = list(range(0, 2 * axes, 2))
    cross = cov[rows]
    innovation = z[:, :, None] - mean[rows]
    S = cross[:, rows] + R[..., None]
    factor, bad = _upper_factor(S)
    whitened: list[Tensor] = []
    gains: list[Tensor] = []
    log_density = torch.full_like(innovation[0], -0.5 * axes * _LOG_TWO_PI)
    for a in range(axes):
        value, gain = innovation[a], cross[a]
        for k in range(a):
            value = value - factor[k, a] * whitened[k]
            gain = gain - factor[k, a] * gains[k]
        pivot = torch.where(factor[a, a] > 0.0, factor[a, a], torch.ones_like(factor[a, a]))
        bad = bad | ~(factor[a, a] > 0.0)
        whitened.append(value / pivot)
        gains.append(gain / pivot)
        log_density = log_density - 0.5 * whitened[a] * whitened[a] - torch.log(pivot)
    gain, white = torch.stack(gains), torch.stack(whitened)
    posterior = mean + (gain * white[:, None]).sum(0)
    cov_out = cov - (gain[:, :, None] * gain[:, None, :]).sum(0)
    return posterior, cov_out, log_density, bad


def _append_moments(out: list[list[Tensor]], probs: Tensor, place: Tensor, spread: Tensor) -> None:
    """Mode probabilities and the moments of their mixture, of one row."""
    fused = (probs * place).sum(2)
    away = place - fused[..., None]
    total = (probs * (spread + away[:, None] * away[None, :])).sum(3)
    out[1].append(probs)
    out[2].append(fused.T)
    out[3].append(total.permute(2, 0, 1))


def scan(
    tables: Tensor,
    chain: Tensor,
    birth_mean: Tensor,
    birth_var: Tensor,
    initial: Tensor,
    z: Tensor,
    dt: Tensor,
    which: Tensor,
    noise: Tensor,
    detected: Tensor,
    start_mean: Tensor,
    start_cov: Tensor,
    temper: float = 1.0,
    min_prob: float = 1e-6,
    moments: bool = False,
) -> Recursion:
    """Filter all tracks with all modes.

    Args:
        tables, chain: of each time step; (U, M, 32), (U, M, M).
        birth_mean, birth_var: of own parameters; (M, K).
        initial: mode probabilities at the start; (M,).
        z: measurements; (B, T, A); anything where not detected.
        dt: lengths of time steps; (U,); s; ``which`` (B, T): the one that leads to each row.
        noise: measurement noise; (B or 1, T or 1, A, A).
        detected: rows to update with; (B, T).
        start_mean, start_cov: position then velocity; (B, 2A), (B, 2A, 2A).
        temper: exponent of the likelihoods of modes, in (0, 1].
        min_prob: floor of mode probabilities.
        moments: return mode probabilities and fused moments too.
    """
    B, T, A = z.shape
    M, K = birth_mean.shape
    kin, n = 2 * A, 2 * A + K
    order = [i // 2 + A * (i % 2) for i in range(kin)]  # state keeps x vx y vy, kinematics position then velocity
    back = [2 * (i % A) + i // A for i in range(kin)]
    means, variances = birth_mean.T[:, None], birth_var.T
    mean = torch.cat([start_mean[:, order].T[..., None].expand(kin, B, M), means.expand(K, B, M)])
    cov = torch.zeros((n, n, B, M), dtype=z.dtype, device=z.device)
    cov = torch.cat(
        [
            torch.cat([start_cov[:, order][:, :, order].permute(1, 2, 0)[..., None].expand(kin, kin, B, M),
                       cov[:kin, kin:]], 1),
            torch.cat([cov[kin:, :kin], torch.diag_embed(variances.T).permute(1, 2, 0)[:, :, None].expand(K, K, B, M)],
                      1),
        ]
    )  # fmt: skip
    probs = initial.expand(B, M)
    bad = torch.zeros(B, dtype=torch.bool, device=z.device)
    fields = tables.permute(2, 0, 1)
    single = len(dt) == 1
    out: list[list[Tensor]] = [[], [], [], []]
    noise = noise.expand(B, T, A, A)
    for t in range(T):
        if t == 0:  # no step leads here: at best the start itself
            out[0].append(torch.zeros_like(z[:, 0, 0]))
            if moments:
                _append_moments(out, probs, mean[:kin][back], cov[:kin, :kin][back][:, back])
            continue
        u = which[:, t]
        rows = fields if single else fields[:, u]
        links = chain.expand(B, M, M) if single else chain[u]
        step = MotionStep(rows, A, n)
        prior, mixed, mixed_cov = _interact(mean, cov, probs, links, means, variances, kin)
        ahead, ahead_cov, failed = _predict(step, mixed, mixed_cov, dt[:, None] if single else dt[u][:, None])
        seen = detected[:, t]
        measured = torch.where(seen[:, None], z[:, t], torch.zeros_like(z[:, t])).T
        posterior, posterior_cov, density, unsound = _update(
            ahead, ahead_cov, measured, noise[:, t].permute(1, 2, 0), A
        )
        lane = seen[:, None]
        mean, cov = torch.where(lane, posterior, ahead), torch.where(lane, posterior_cov, ahead_cov)
        alive = prior > 0.0
        density = torch.where(lane & alive, temper * density, torch.zeros_like(density))
        top = torch.where(alive, density, torch.full_like(density, -torch.inf)).amax(1, keepdim=True).detach()
        joint = torch.where(alive, prior * torch.exp(density - top), torch.zeros_like(prior))
        mass = joint.sum(1, keepdim=True)
        share = joint / mass
        floored = torch.where(alive & (share < min_prob), torch.full_like(share, min_prob), share)
        probs = torch.where(lane, floored / floored.sum(1, keepdim=True), prior)
        value = (top + torch.log(mass))[:, 0] / temper
        out[0].append(torch.where(seen, value, torch.zeros_like(value)))
        bad = (
            bad | failed.any(1) | (unsound & lane).any(1) | ~torch.isfinite(value) | ~torch.isfinite(mean).all(2).all(0)
        )
        if moments:
            _append_moments(out, probs, mean[:kin][back], cov[:kin, :kin][back][:, back])
    empty = torch.zeros((B, 0), dtype=z.dtype, device=z.device)
    stacked = [torch.stack(item, 1) if item else empty for item in out]
    return Recursion(stacked[0], stacked[1], stacked[2], stacked[3], bad)
