"""Climbing the marginal likelihood of the bank: quasi-Newton steps along the gradients of the differentiable twin.

The twin gives every slope for little more than the price of the value, so a whole batch with curvature remembered over
a few steps beats mini-batches: there is no noise to average away and no learning rate to choose.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from jink.intent.model import IntentModel
from jink.intent.sizes import Sizes

if TYPE_CHECKING:
    from jink.intent.bank_torch import Batch, ModelParameters

__all__ = ["Climb", "climb"]

Floats = NDArray[np.float64]

_NOTHING = -699.0
_WIDTH = {
    "log_growth_noise": 3.0, "log_turn_noise": 3.0, "log_wobble": 3.0, "log_growth_rate": 2.0, "log_turn_rate": 2.0,
    "log_natural": 0.7, "damping_logit": 1.5, "log_duration": 1.5, "birth_logit": 1.5, "birth_growth": 2.0,
    "log_birth_growth_sd": 2.0, "birth_turn": 2.0, "log_birth_turn_sd": 2.0, "log_birth_swing_sd": 2.0,
    "log_rates": 1.5, "log_renewal": 1.5, "initial_logit": 1.5, "log_noise": 1.0, "growth_mean": 2.0, "turn_mean": 2.0,
}  # fmt: skip
"""Width of the prior of every kind of number around where a climb begins, in its unit."""
_LOST = -50.0  # nats per row of a track whose filter failed
_MEMORY = 20


class Climb(NamedTuple):
    """Where a climb ended: model, mean log-likelihood per measured row, evaluations, trace of that mean."""

    model: IntentModel
    value: float
    evaluations: int
    trace: tuple[float, ...]


class _Column(NamedTuple):
    """One tensor of the parameters within the vector: its free entries, unit, bounds and prior."""

    name: str
    free: NDArray[np.bool_]
    unit: float
    low: Floats
    high: Floats


def _columns(parameters: ModelParameters, sizes: Sizes, held: frozenset[str]) -> list[_Column]:
    model = parameters.model
    single = len(model.intents) == 1
    phases = [phase for intent in model.intents for phase in intent.phases]
    births = [phase for phase in phases for _ in phase.births]
    mirrored = np.array([phase.mirrored for phase in births])
    lone = np.array([len(phase.births) == 1 for phase in births])
    swings = np.array([phase.law.second_order for phase in phases])
    swinging = np.array([phase.law.second_order for phase in births])
    last = np.array([k == len(i.phases) - 1 for i in model.intents for k in range(len(i.phases))])
    masks = {
        "growth_mean": np.zeros(len(phases), np.bool_),
        "turn_mean": np.array([phase.mirrored and phase.law.turn_rate > 0.0 for phase in phases]),
        "log_natural": swings,
        "damping_logit": swings,
        "log_duration": ~last,
        "birth_logit": ~lone,
        "birth_turn": mirrored,
        "log_birth_swing_sd": swinging,
        "initial_logit": np.full(len(model.intents), not single),
        "log_rates": ~np.eye(len(model.intents), dtype=np.bool_),
    }
    floors, ceilings = sizes.floors(), sizes.ceilings()
    found = []
    for name, tensor in parameters.named_parameters():
        values = tensor.detach().cpu().numpy()
        mask = masks.get(name)
        free = np.ones(values.shape, np.bool_) if mask is None else mask.reshape(values.shape)
        free = free & (values > _NOTHING) & tensor.requires_grad
        if name in held:
            free[...] = False
        unit = sizes.units().get(name, 1.0)
        low = np.full(values.shape, floors.get(name, -math.inf))
        high = np.full(values.shape, ceilings.get(name, math.inf))
        found.append(_Column(name, free, unit, low, high))
    return found


def climb(
    model: IntentModel,
    batch: Batch,
    sizes: Sizes,
    *,
    steps: int = 30,
    tolerance: float = 1e-5,
    temper: float = 1.0,
    held: frozenset[str] = frozenset(),
    floor: float = -math.inf,
    threads: int = 1,
    report: Callable[[int, float], bool] | None = None,
) -> Climb:
    """Improve every number of a model; its structure stays.

    Model: maximise ``sum_rows max(l, floor) - 0.5 |(x - x_0) / width|^2``: a row no intent explains is an outlier and
    pulls at nothing; the prior keeps what the data do not tell near where it was.

    Args:
        model: where to begin.
        batch: tracks to fit.
        sizes: typical sizes, that make numbers comparable.
        steps: at most so many quasi-Newton steps.
        tolerance: stop where a step gains less; nats per row.
        temper: of the mode likelihoods, see `log_likelihood`.
        held: names of parameters that stay.
        floor: nats; what a row costs at most.
        threads: processor cores.
        report: called with the step and the mean log-likelihood; True ends the climb.

    Source: Byrd, Lu, Nocedal, Zhu (1995), L-BFGS-B.
    """
    import torch

    from jink.intent.bank_torch import ModelParameters, filter_batch

    parameters = ModelParameters.from_model(model).to(batch.z.device)
    columns = _columns(parameters, sizes, held)
    tensors = dict(parameters.named_parameters())
    start = np.concatenate([tensors[c.name].detach().cpu().numpy()[c.free] / c.unit for c in columns])
    if start.size == 0 or batch.rows == 0:
        return Climb(model, math.nan, 0, ())
    width = np.concatenate([np.full(int(c.free.sum()), _WIDTH[c.name]) for c in columns])
    low = np.concatenate([c.low[c.free] / c.unit for c in columns])
    high = np.concatenate([c.high[c.free] / c.unit for c in columns])
    start = np.clip(start, low, high)
    rows = batch.rows
    latest: dict[str, float] = {}
    trace: list[float] = []

    def put(vector: Floats) -> None:
        at = 0
        with torch.no_grad():
            for c in columns:
                count = int(c.free.sum())
                values = tensors[c.name].detach().cpu().numpy().copy()
                values[c.free] = vector[at : at + count] * c.unit
                tensors[c.name].copy_(torch.as_tensor(values))
                at += count

    def cost(vector: Floats) -> tuple[float, Floats]:
        put(vector)
        parameters.zero_grad()
        found = filter_batch(parameters, batch, temper=temper, threads=threads)
        density = torch.where(batch.detected, found.log_likelihood, torch.zeros_like(found.log_likelihood))
        density = torch.where(density < floor, torch.full_like(density, floor), density)
        lost = found.failed
        total = (density * (~lost)[:, None]).sum()
        if total.requires_grad:
            total.backward()  # type: ignore[no-untyped-call]
        value = float(total.detach()) + _LOST * float(batch.detected[lost].sum())
        slopes = []
        for c in columns:
            grad = tensors[c.name].grad
            whole = np.zeros(c.free.shape) if grad is None else grad.cpu().numpy()
            slopes.append(whole[c.free] * c.unit)
        slope = np.nan_to_num(np.concatenate(slopes), nan=0.0, posinf=0.0, neginf=0.0)
        offset = (vector - start) / width
        latest["value"] = value / rows
        return -(value - 0.5 * float(offset @ offset)) / rows, -(slope - offset / width) / rows

    def note(_: Floats) -> None:
        trace.append(latest["value"])
        if report is not None and report(len(trace), trace[-1]):
            raise StopIteration

    found = minimize(
        cost,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=np.stack([low, high], axis=1),
        callback=note,
        options={"maxiter": steps, "maxcor": _MEMORY, "ftol": tolerance, "gtol": 1e-7, "maxls": 12},
    )
    put(np.asarray(found.x))
    value = -float(cost(np.asarray(found.x))[0])
    return Climb(parameters.to_model(), latest.get("value", value), int(found.nfev), tuple(trace))
