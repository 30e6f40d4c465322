"""The compiled recursion as one node of torch's graph."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from jink.estimators import compiled
from jink.intent.torch_scan import Recursion

compiled.forget_stale_machine_code(Path(__file__).parent, Path(compiled.__file__).parent)

from jink.intent.adjoint.aside import compile_aside  # noqa: E402
from jink.intent.adjoint.recursion import backward, forward  # noqa: E402  (after old machine code is gone)

__all__ = ["compiled_scan"]


def _parts(tracks: int, threads: int) -> list[tuple[int, int]]:
    cuts = np.linspace(0, tracks, max(1, min(threads, tracks)) + 1).astype(int)
    return list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))


def _each(run: Callable[[tuple[int, int]], Any], parts: list[tuple[int, int]]) -> list[Any]:
    if len(parts) == 1:
        return [run(parts[0])]
    with ThreadPoolExecutor(len(parts)) as pool:
        return list(pool.map(run, parts))


def _array(value: Tensor) -> Any:
    return np.ascontiguousarray(value.detach().numpy())


def _gradients(given: tuple[Any, ...], value_bar: Any, log_likelihood: Any, failed: Any, threads: int) -> list[Any]:
    """Derivatives by the first seven inputs of `_Scan`; fills ``log_likelihood`` and ``failed`` on the way."""
    tables, chain, birth_mean, birth_var, initial, z, _, _, noise = given[:9]
    B, A = z.shape[0], z.shape[2]

    def run(part: tuple[int, int]) -> list[Any]:
        made = [np.zeros_like(value) for value in (tables, chain, birth_mean, birth_var, initial, noise)]
        made.append(np.zeros((B, 2 * A, 2 * A)))
        backward(*given, value_bar, log_likelihood, failed, *made, *part)
        return made

    found = _each(run, _parts(B, threads))
    if not all(np.isfinite(value).all() for made in found for value in made):
        found = [run((0, 0))]
        for b in range(B):  # track by track, without those whose derivatives are no numbers
            made = run((b, b + 1))
            if all(np.isfinite(value).all() for value in made):
                found.append(made)
            else:
                failed[b] = True
    return [torch.from_numpy(sum(values[1:], values[0])) for values in zip(*found, strict=True)]


class _Scan(torch.autograd.Function):
    """Where derivatives are wanted they are made on the way forward, for the sum of all rows.

    A loss that weighs all rows alike then only scales them; any other is filtered again with its own weights.
    """

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Any:
        """Inputs: tables, chain, births (2), initial, noise, start_cov; data; temper, floor, moments, threads."""
        tables, chain, birth_mean, birth_var, initial, noise, start_cov = (_array(value) for value in inputs[:7])
        z, dt, which, detected, start_mean = (_array(value) for value in inputs[7:12])
        temper, floor, moments, threads = inputs[12:]
        B, T, A = z.shape
        modes, own = birth_mean.shape
        n = 2 * A + own
        given = (
            tables, chain, birth_mean, birth_var, initial, z, dt, which, noise, detected, start_mean, start_cov,
            temper, floor,
        )  # fmt: skip
        log_likelihood, failed = np.zeros((B, T)), np.zeros(B, dtype=np.bool_)
        ctx.kept, ctx.threads = (given, failed, detected), threads
        shape = (B, T, modes) if moments else (0, 0, modes)
        probs, mean, cov = np.zeros(shape), np.zeros((*shape, n)), np.zeros((*shape, n, n))
        if any(ctx.needs_input_grad):
            ctx.gradients = _gradients(given, np.ones((B, T)), log_likelihood, failed, threads)
        elif not moments:
            probs, mean, cov = np.zeros((B, T, modes)), np.zeros((B, T, modes, n)), np.zeros((B, T, modes, n, n))
        if moments or not any(ctx.needs_input_grad):
            lost = failed.copy()
            _each(lambda part: forward(*given, log_likelihood, probs, mean, cov, failed, *part), _parts(B, threads))
            failed |= lost
        log_likelihood[failed] = 0.0
        outputs = tuple(torch.from_numpy(value) for value in (log_likelihood, probs, mean, cov, failed))
        ctx.mark_non_differentiable(*outputs[1:])
        return outputs

    @staticmethod
    def backward(ctx: Any, *bars: Any) -> Any:
        """Derivatives by the first seven inputs."""
        given, failed, detected = ctx.kept
        value_bar = _array(bars[0])
        used = value_bar[detected & ~failed[:, None]]
        if used.size == 0 or used.min() == used.max():
            scale = float(used[0]) if used.size else 0.0
            gradients = [scale * gradient for gradient in ctx.gradients]
        else:
            gradients = _gradients(given, value_bar, np.zeros(value_bar.shape), failed, ctx.threads)
        return (*gradients, *([None] * 9))


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
    compile_aside()
    log_likelihood, probs, mean, cov, failed = _Scan.apply(  # type: ignore[no-untyped-call]
        tables, chain, birth_mean, birth_var, initial, noise, start_cov,
        z, dt, which, detected, start_mean, float(temper), float(min_prob), bool(moments), int(threads),
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
