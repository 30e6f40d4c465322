"""The bank of a model of intents, differentiable: marginal likelihood of many tracks, with gradients.

Equal to ``BankEstimator(model.bank(position))`` row by row; a test holds the two together to 1e-9. Laws, births, Markov
matrices and noise are torch operations over a few small tables; the recursion over rows is `intent.torch_scan` on any
device, or compiled code with a hand-written adjoint on the processor, which is what makes training quick.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from jink.estimators.sensors import position
from jink.estimators.starting import start_batch
from jink.intent.adjoint.function import compiled_scan
from jink.intent.torch_parameters import ModelParameters
from jink.intent.torch_scan import Recursion, scan

__all__ = ["Batch", "ModelParameters", "Recursion", "filter_batch", "log_likelihood", "make_batch"]

_QUANTUM = 2.0**-40
"""Time steps are told apart down to a picosecond: 0.1 k seconds are steps of equal length."""


class Batch(NamedTuple):
    """Tracks as tensors, with where each begins.

    ``z`` (B, T, A), ``times`` (B, T), ``noise`` (B or 1, T or 1, A, A), ``detected`` (B, T): rows to update with, the
    first measurement not among them (it is the start); ``dt`` (U,) the distinct time steps, ``which`` (B, T) the one
    that leads to each row (0 s before the start and after the end); ``start_mean`` (B, 2A), ``start_cov`` (B, 2A, 2A):
    position then velocity.
    """

    z: Tensor
    times: Tensor
    noise: Tensor
    detected: Tensor
    dt: Tensor
    which: Tensor
    start_mean: Tensor
    start_cov: Tensor

    @property
    def rows(self) -> int:
        """How many measurements are explained."""
        return int(self.detected.sum())

    def to(self, device: str | torch.device) -> Batch:
        """The same tracks on another device."""
        return Batch(*(value.to(device) for value in self))

    def subset(self, chosen: Tensor) -> Batch:
        """Some of the tracks (indices or a mask); (B,)."""
        cut = [value[chosen] if value.shape[0] == len(self.z) and len(self.z) > 1 else value for value in self]
        return self._replace(
            z=self.z[chosen],
            times=self.times[chosen],
            noise=cut[2],
            detected=self.detected[chosen],
            which=self.which[chosen],
            start_mean=self.start_mean[chosen],
            start_cov=self.start_cov[chosen],
        )


def make_batch(
    measurements: ArrayLike,
    times: ArrayLike,
    noise: ArrayLike,
    lengths: ArrayLike | None = None,
    *,
    speed: float,
    device: str | torch.device = "cpu",
) -> Batch:
    """Tracks as the twin takes them, started as the compiled estimator starts them.

    Args:
        measurements: positions (B, T, A) or (T, A); m; a row with a NaN is missing.
        times: (B, T) or (T,); s; increasing.
        noise: standard deviation (scalar or (A,)) or covariance (A, A), (T, A, A), (B, T, A, A).
        lengths: rows of each track; (B,); later rows are padding.
        speed: of the model: standard deviation of each velocity component at the start; m/s.
        device: where the tensors go.

    Raises:
        ValueError: shapes that do not fit.
    """
    z = np.array(measurements, dtype=np.float64, ndmin=3)
    if z.ndim != 3 or z.shape[2] not in (2, 3):
        raise ValueError(f"make_batch: measurements must be (B, T, A) with A 2 or 3; got {z.shape}. Positions in m.")
    B, T, A = z.shape
    clock = np.asarray(times, dtype=np.float64)
    if clock.shape not in ((T,), (B, T), (1, T)):
        raise ValueError(f"make_batch: times must be ({T},) or ({B}, {T}); got {clock.shape}. Seconds, increasing.")
    clock = np.array(np.broadcast_to(clock, (B, T)))
    R = _covariances(np.asarray(noise, dtype=np.float64), B, T, A)
    used = np.arange(T) < (np.full(B, T) if lengths is None else np.asarray(lengths))[:, None]
    present = np.isfinite(z).all(axis=2) & used
    z[~present] = np.nan
    start = start_batch(position(A, 1.0), z, clock, np.broadcast_to(R, (B, T, A, A)), None, speed)
    each = np.arange(T)
    begin = np.where(start.seen > 0, start.index, T)[:, None]
    step = np.diff(clock, axis=1, prepend=clock[:, :1])
    step = np.where((each > begin) & used, step, 0.0)
    if not (step >= 0).all():
        raise ValueError("make_batch: times must not decrease; got a step back. Sort the rows of each track.")
    which = np.zeros((B, T), dtype=np.int64)  # no step leads to row 0
    dt, index = np.unique(np.round(step[:, 1:] / _QUANTUM) * _QUANTUM, return_inverse=True)
    which[:, 1:] = index.reshape(B, T - 1)
    dt = dt if len(dt) else np.zeros(1)
    return Batch(
        *(
            torch.as_tensor(np.ascontiguousarray(value), device=device)
            for value in (
                np.where(present[..., None], z, 0.0),
                clock,
                R,
                present & (each > begin),
                dt,
                which,
                np.concatenate([start.position, start.velocity], 1),
                start.covariance,
            )
        )
    )


def _covariances(noise: NDArray[np.float64], B: int, T: int, A: int) -> NDArray[np.float64]:
    if noise.shape in ((), (A,)):
        noise = np.eye(A) * noise**2
    if noise.shape == (A, A):
        return noise[None, None]
    if noise.shape == (T, A, A):
        return noise[None]
    if noise.ndim == 4 and noise.shape[0] in (1, B) and noise.shape[1] in (1, T) and noise.shape[2:] == (A, A):
        return noise
    raise ValueError(
        f"make_batch: noise must be a standard deviation, ({A},), ({A}, {A}), ({T}, {A}, {A}) or ({B}, {T}, {A}, {A}); "
        f"got {noise.shape}. Metres, or metres squared."
    )


def filter_batch(
    parameters: ModelParameters,
    batch: Batch,
    *,
    temper: float = 1.0,
    min_prob: float = 1e-6,
    moments: bool = False,
    operations: bool | None = None,
    threads: int = 1,
) -> Recursion:
    """Run the bank over a batch.

    Args:
        parameters: the model.
        batch: of the model's axes.
        temper: see `log_likelihood`.
        min_prob: floor of mode probabilities, as in `Bank`.
        moments: also give mode probabilities, fused position and velocity with covariance.
        operations: torch operations instead of compiled code; None: only where the batch is not on the processor.
        threads: processor cores for the compiled code.

    Returns:
        `Recursion`; tracks in trouble have zeros in ``log_likelihood`` and True in ``failed``, and no gradient.

    Raises:
        ValueError: axes that do not fit, or a temper outside (0, 1].
    """
    axes = parameters.model.axes
    if batch.z.shape[2] != axes:
        raise ValueError(
            f"filter_batch: batch must have {axes} axes; got {batch.z.shape[2]}. Use a model of its space."
        )
    if not 0.0 < temper <= 1.0:
        raise ValueError(f"filter_batch: temper must be in (0, 1]; got {temper}. 1 is the likelihood itself.")
    tables, chain = parameters.tables(batch.dt)
    birth_mean, birth_var = parameters.births()
    initial = parameters.initial()

    def run(part: Batch) -> Recursion:
        noise, start_cov = part.noise, part.start_cov
        if parameters.log_noise is not None:
            noise = torch.diag(torch.exp(2.0 * parameters.log_noise))[None, None]
            place = torch.nn.functional.pad(noise[0], (0, axes, 0, axes))
            rest = torch.nn.functional.pad(start_cov[:, axes:, axes:], (axes, 0, axes, 0))
            start_cov = place + rest
        given = (
            tables, chain, birth_mean, birth_var, initial,
            part.z, part.dt, part.which, noise, part.detected, part.start_mean, start_cov,
            temper, min_prob, moments,
        )  # fmt: skip
        return scan(*given) if operations else compiled_scan(*given, threads=threads)

    if operations is None:
        operations = batch.z.device.type != "cpu"
    if not operations:
        return run(batch)
    result = run(batch)
    failed = result.failed
    for _ in range(3):
        if not bool(failed.any()) or bool(failed.all()):
            break
        # again without them: a gradient that meets one infinity on its way back is lost for every track
        kept = torch.nonzero(~failed)[:, 0]
        partial = run(batch.subset(kept))
        result = Recursion(
            _spread(partial.log_likelihood, kept, len(failed)),
            _spread(partial.mode_probs, kept, len(failed)),
            _spread(partial.mean, kept, len(failed)),
            _spread(partial.cov, kept, len(failed)),
            failed,
        )
        if not bool(partial.failed.any()):
            break
        failed = failed.clone()
        failed[kept[partial.failed]] = True
    if bool(failed.all()):
        nothing = [torch.zeros_like(value) for value in result[:4]]
        return Recursion(nothing[0], nothing[1], nothing[2], nothing[3], failed)
    return result._replace(failed=failed)


def _spread(value: Tensor, kept: Tensor, count: int) -> Tensor:
    out = torch.zeros((count, *value.shape[1:]), dtype=value.dtype, device=value.device)
    return out.index_copy(0, kept, value)


def log_likelihood(parameters: ModelParameters, batch: Batch, temper: float = 1.0) -> Tensor:
    """Log density of each measurement given those before it; (B, T), nats; 0 where nothing was measured.

    Model: ``(1 / temper) log sum_p prior_p density_p^temper``, with mode probabilities updated by the same power: below
    1 every mode takes part in explaining every row, which gives all of them a gradient early in training; a lower
    bound of the likelihood, which it is at 1. Source: Ueda & Nakano (1998), deterministic annealing.

    Tracks in numerical trouble count 0 (see `filter_batch` for which they are).
    """
    return filter_batch(parameters, batch, temper=temper).log_likelihood
