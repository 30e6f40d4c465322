"""How many intents there are: what fewer cost on tracks that were not fitted, and which number to believe."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.intent.joining import append, merge, shorter, without
from jink.intent.model import IntentModel

if TYPE_CHECKING:
    from jink.intent.bank_torch import Batch

__all__ = [
    "RESOLVABLE",
    "WORTH",
    "CurvePoint",
    "choose",
    "curve_of",
    "freedom",
    "gain_over_one",
    "row_scores",
    "shorter_models",
    "smaller_models",
    "track_scores",
]

Floats = NDArray[np.float64]

RESOLVABLE = 0.01
"""Nats per row that several intents must bring over one."""
WORTH = 0.003
"""Nats per row below which an intent is not worth having, however certain the gain."""
_DRAWS = 2000
_FOLLOWS = 0.5  # share of switches that must lead on for a template to be tried


class CurvePoint(NamedTuple):
    """One number of intents: mean held-out log-likelihood per measured row, nats.

    ``low`` and ``high``: 95 % interval of its difference to the best number, added to the best.
    """

    intents: int
    held_out: float
    low: float
    high: float


def row_scores(model: IntentModel, batch: Batch, threads: int = 1) -> Floats:
    """Log-likelihood of every row, 0 where nothing was measured; (B, T)."""
    import torch

    from jink.intent.bank_torch import ModelParameters, filter_batch

    with torch.no_grad():
        parameters = ModelParameters.from_model(model).to(batch.z.device)
        found = filter_batch(parameters, batch, threads=threads)
        density = torch.where(batch.detected, found.log_likelihood, torch.zeros_like(found.log_likelihood))
        density = torch.where(batch.detected & found.failed[:, None], torch.full_like(density, -50.0), density)
    return np.asarray(density.cpu().numpy())


def track_scores(model: IntentModel, batch: Batch, floor: float, threads: int = 1) -> tuple[Floats, Floats]:
    """Log-likelihood of every track, no row below ``floor``, and its measured rows; (B,) twice."""
    detected = batch.detected.cpu().numpy()
    scores = np.maximum(row_scores(model, batch, threads), floor)
    return np.where(detected, scores, 0.0).sum(axis=1), detected.sum(axis=1).astype(np.float64)


def smaller_models(model: IntentModel) -> Iterator[tuple[str, IntentModel]]:
    """Every model with one intent less that can be made of this one, and how."""
    count = len(model.intents)
    names = [intent.name for intent in model.intents]
    rates = np.array(model.generator)
    for i in range(count):
        yield f"without {names[i]}", without(model, i)
        for j in range(i + 1, count):
            for renewed, word in ((False, "and"), (True, "is")):
                joined = merge(model, i, j, renewed=renewed)
                if joined is not None:
                    yield f"{names[i]} {word} {names[j]}", joined
        for j in range(count):
            leaving = -rates[i, i]
            if i != j and leaving > 0 and rates[i, j] > _FOLLOWS * leaving:
                template = append(model, i, j)
                if template is not None:
                    yield f"{names[i]} then {names[j]}", template


def freedom(model: IntentModel) -> int:
    """How many numbers of a model are free."""
    count = len(model.intents)
    free = count * (count - 1)
    for intent in model.intents:
        free += len(intent.phases) - 1 + (intent.renewal > 0)
        for phase in intent.phases:
            law = phase.law
            free += 3 + (law.growth_rate > 0) + (law.turn_rate > 0) * (2 if phase.mirrored else 1)
            free += 2 * law.second_order
            free += len(phase.births) * (4 + phase.mirrored + law.second_order) - 1
    return free


def shorter_models(model: IntentModel) -> Iterator[tuple[str, IntentModel]]:
    """Every model in which one template has one phase less, and how."""
    for i, intent in enumerate(model.intents):
        for k in range(len(intent.phases) if len(intent.phases) > 1 and model.generator[i][i] < 0 else 0):
            yield f"{intent.name} less {k}", shorter(model, i, k)


def _bootstrap(difference: Floats, rows: Floats, seed: int) -> Floats:
    """Mean difference per row of tracks drawn with replacement; (draws,)."""
    rng = np.random.default_rng([seed, 17])
    chosen = rng.integers(0, len(rows), (_DRAWS, len(rows)))
    return np.asarray(difference[chosen].sum(axis=1) / np.maximum(rows[chosen].sum(axis=1), 1.0))


def choose(scores: dict[int, Floats], rows: Floats, seed: int) -> tuple[int, bool]:
    """The number of intents, and whether several can be told apart at all.

    The fewest whose held-out likelihood lies within one standard error of the best one's, or within `WORTH`; one, if
    the best brings less than `RESOLVABLE` over one intent.

    Args:
        scores: number of intents to held-out log-likelihood of each track (B,).
        rows: measured rows of each track; (B,).
        seed: of the bootstrap over tracks.

    Source: Breiman et al. (1984), one-standard-error rule, here for paired differences.
    """
    means = {count: float(score.sum() / rows.sum()) for count, score in scores.items()}
    best = max(means, key=lambda count: (means[count], -count))
    if 1 in means and means[best] - means[1] < RESOLVABLE:
        return 1, False
    for count in sorted(means):
        drop = means[best] - means[count]
        error = float(_bootstrap(scores[best] - scores[count], rows, seed).std())
        if drop <= max(error, WORTH) and (count > 1 or best == 1):
            return count, count > 1
    return best, best > 1


def curve_of(scores: dict[int, Floats], rows: Floats, seed: int) -> tuple[CurvePoint, ...]:
    """The whole selection curve, by number of intents."""
    means = {count: float(score.sum() / rows.sum()) for count, score in scores.items()}
    best = max(means, key=lambda count: (means[count], -count))
    points = []
    for count in sorted(means):
        draws = _bootstrap(scores[count] - scores[best], rows, seed)
        low, high = np.quantile(draws, (0.025, 0.975))
        points.append(CurvePoint(count, means[count], means[best] + float(low), means[best] + float(high)))
    return tuple(points)


def gain_over_one(curve: Sequence[tuple[float, ...]]) -> tuple[float, float, float] | None:
    """What the best of several intents brings over one, nats per row, with its 95 % interval.

    Args:
        curve: `CurvePoint` of every number, or rows like them.

    Returns:
        gain, low, high; None: the curve lacks one intent or has nothing else.
    """
    points = {int(point[0]): tuple(float(value) for value in point[1:4]) for point in curve}
    if 1 not in points or len(points) < 2:
        return None
    one = points.pop(1)
    several = max(points.values(), key=lambda point: point[0])
    if several[0] > one[0]:
        # The interval of one is that of its difference to the best.
        return several[0] - one[0], several[0] - one[2], several[0] - one[1]
    return several[0] - one[0], several[1] - one[0], several[2] - one[0]
