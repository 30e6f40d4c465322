"""The compiled recursion as one node of torch's graph."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from jink.estimators import compiled
from jink.intent.torch_scan import Recursion

compiled.forget_stale_machine_code(Path(__file__).parent, Path(compiled.__file__).parent)

from jink.intent.adjoint.recursion import backward, forward  # noqa: E402  (after old machine code is gone)

__all__ = ["compiled_scan"]


def _parts(tracks: int, threads: int) -> list[tuple[int, int]]:
    cuts = np.linspace(0, tracks, max(1, min(threads, tracks)) + 1).astype(int)
    return list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))


def _array(value: Tensor) -> Any:
    return np.ascontiguousarray(value.detach().numpy())


class _Scan(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Any:
        """Inputs: tables, chain, births (2), initial, noise, start_cov; then data, temper, floor, threads."""
        tables, chain, birth_mean, birth_var, initial, noise, start_cov = (_array(value) for value in inputs[:7])
        z, dt, which, detected, start_mean, temper, floor, threads = inputs[7:]
        z, dt, which, detected, start_mean = (_array(value) for value in (z, dt, which, detected, start_mean))
        B, T, A = z.shape
        modes, own = birth_mean.shape
        n = 2 * A + own
        log_likelihood, failed = np.zeros((B, T)), np.zeros(B, dtype=np.bool_)
        probs, mean, cov = np.zeros((B, T, modes)), np.zeros((B, T, modes, n)), np.zeros((B, T, modes, n, n))

        def run(part: tuple[int, int]) -> None:
            forward(
                tables, chain, birth_mean, birth_var, initial, z, dt, which, noise, detected, start_mean, start_cov,
                temper, floor, log_likelihood, probs, mean, cov, failed, *part,
            )  # fmt: skip

        parts = _parts(B, threads)
        with ThreadPoolExecutor(len(parts)) as pool:
            list(pool.map(run, parts))
        log_likelihood[failed] = 0.0
        ctx.kept = (
            tables, chain, birth_mean, birth_var, z, dt, which, noise, detected, temper, floor, probs, mean, cov, failed
        )  # fmt: skip
        ctx.parts = parts
        outputs = tuple(torch.from_numpy(value) for value in (log_likelihood, probs, mean, cov, failed))
        ctx.mark_non_differentiable(*outputs[1:])
        return outputs

    @staticmethod
    def backward(ctx: Any, *bars: Any) -> Any:  # type: ignore[override]
        """Derivatives by the first seven inputs."""
        tables, chain, birth_mean, birth_var, z, _, _, noise = ctx.kept[:8]
        value_bar = _array(bars[0])
        B, A, modes = z.shape[0], z.shape[2], len(birth_mean)

        def run(part: tuple[int, int]) -> list[Any]:
            made = [np.zeros_like(value) for value in (tables, chain, birth_mean, birth_var)]
            made += [np.zeros(modes), np.zeros_like(noise), np.zeros((B, 2 * A, 2 * A))]
            backward(*ctx.kept, value_bar, *made, *part)
            return made

        with ThreadPoolExecutor(len(ctx.parts)) as pool:
            found = list(pool.map(run, ctx.parts))
        if not all(np.isfinite(value).all() for made in found for value in made):
            found = []
            failed = ctx.kept[-1]
            for b in range(B):  # track by track, without those whose derivatives are no numbers
                made = run((b, b + 1))
                if all(np.isfinite(value).all() for value in made):
                    found.append(made)
                else:
                    failed[b] = True
            found = found or [[np.zeros_like(value) for value in run((0, 0))]]
        gradients = [torch.from_numpy(sum(values[1:], values[0])) for values in zip(*found, strict=True)]
        return (*gradients, *([None] * 8))


def compiled_scan(
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
    threads: int = 1,
) -> Recursion:
    """As `torch_scan.scan`, on the processor; moments carry no gradient; tracks in trouble give none and 0."""
    log_likelihood, probs, mean, cov, failed = _Scan.apply(  # type: ignore[no-untyped-call]
        tables, chain, birth_mean, birth_var, initial, noise, start_cov,
        z, dt, which, detected, start_mean, float(temper), float(min_prob), int(threads),
    )  # fmt: skip
    if not moments:
        empty = torch.zeros((len(z), 0), dtype=z.dtype)
        return Recursion(log_likelihood, empty, empty, empty, failed)
    axes = z.shape[2]
    back = [2 * (i % axes) + i // axes for i in range(2 * axes)]
    place = mean[..., back]
    fused = (probs[..., None] * place).sum(2)
    away = place - fused[:, :, None]
    spread = cov[..., back, :][..., back] + away[..., :, None] * away[..., None, :]
    return Recursion(log_likelihood, probs, fused, (probs[..., None, None] * spread).sum(2), failed)
