"""The model that learning begins with: one intent per cluster of the encoder's features."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jink.estimators.tracks import Tracks
from jink.intent.clusters import Clusters, cluster, projected
from jink.intent.features import Features, encode
from jink.intent.laws import Birth, Law, Phase
from jink.intent.located import noise_sigma
from jink.intent.model import Intent, IntentModel
from jink.intent.window import choose_window

__all__ = ["first_model", "model_of_clusters"]

Floats = NDArray[np.float64]
_WOBBLE = 1.0 / 2520.0  # variance around the best parabola of white acceleration 1 over a window of 1 s
_STEADY = 2.0  # spells over which shape parameters forget where they began
_LEAST_DRIFT = 0.05  # of the spread between spells: no law is born exactly constant
_LEAST_WOBBLE = 1e-3  # of the speed, per spell


def first_model(
    tracks: Tracks,
    intents: int = 6,
    *,
    window: float | None = None,
    noise_sd: float | None = None,
    learn_noise: bool = False,
    seed: int = 0,
) -> IntentModel:
    """An overfitted model: features, clusters, and the laws that their spells show.

    Args:
        tracks: what was measured, of a sensor that locates the target alone.
        intents: how many; more than there are, as learning merges and drops.
        window: of the encoder, s; None: `choose_window`.
        noise_sd: standard deviation of a position per axis, m; None: the noise of the tracks, or an estimate from them.
        learn_noise: put the noise into the model: ``noise_sd`` or, without it, an estimate from the tracks.
        seed: of the clustering.

    Returns:
        the model, intents by falling share of time.

    Raises:
        ValueError: from `encode` and `cluster`; or noise to learn from a sensor that does not measure positions.
    """
    span = choose_window(tracks, noise_sd) if window is None else window
    features = encode(tracks, span, noise_sd)
    found = cluster(features, tracks.lengths, intents, seed=seed)
    model = model_of_clusters(features, tracks.lengths, found)
    if not learn_noise:
        return model
    if noise_sd is None and tracks.sensor != "position":
        raise ValueError(
            f"first_model: noise_sd must be given for a {tracks.sensor} sensor; got None. "
            "Only positions show their noise."
        )
    sigma = noise_sigma(tracks) if noise_sd is None else np.full(tracks.axes, noise_sd)
    return model.with_(noise_sd=tuple(sigma.tolist()))


def model_of_clusters(features: Features, lengths: NDArray[np.int64], found: Clusters) -> IntentModel:
    """Laws, births and chain of clusters.

    The spread of a component is that of its births. How shape parameters move within a spell shows in rows of one
    spell a window apart: their mean square difference, less the noise of both, over the time between them is the
    density of the noise on g and w. What a window's best arc leaves beyond the measurement noise is white acceleration.

    Args:
        features: from `encode`.
        lengths: rows of each track; (B,).
        found: from `cluster`.
    """
    axes, K = features.axes, len(found.mean)
    sure = projected(features)[2]
    speeds = np.linalg.norm(features.velocity[sure], axis=-1)
    speed = float(np.sqrt(np.mean(speeds**2) / axes))
    spells = -1.0 / np.minimum(np.diag(found.generator), -1e-12)
    drift = _drifts(features, lengths, found)
    excess = _excess(features, found)
    intents = []
    for k in range(K):
        growth_sd, turn_sd = (float(sd) for sd in found.sd[k])
        rate = 1.0 / (_STEADY * spells[k])
        growth_drift, turn_drift = (
            float(np.clip(value, (_LEAST_DRIFT * sd) ** 2 * 2.0 * rate, sd**2 * 2.0 * rate))
            for value, sd in zip(drift[k], (growth_sd, turn_sd), strict=True)
        )
        turning = float(found.mean[k, 1]) if axes == 2 else 0.0
        law = Law(
            axes,
            growth_mean=float(found.mean[k, 0]),
            growth_rate=float(rate),
            growth_noise=growth_drift,
            turn_mean=turning,
            turn_rate=float(rate),
            turn_noise=turn_drift,
            wobble=max(float(excess[k]), (_LEAST_WOBBLE * speed) ** 2 / float(spells[k])),
        )
        birth = Birth(1.0, law.growth_mean, growth_sd, turning, turn_sd)
        intents.append(Intent(f"intent {k + 1}", (Phase(law, (birth,), mirrored=axes == 2),)))
    chain = found.generator.copy()
    np.fill_diagonal(chain, 0.0)
    np.fill_diagonal(chain, -chain.sum(axis=1))
    return IntentModel(
        axes,
        tuple(intents),
        tuple(tuple(row) for row in chain.tolist()),
        tuple((found.initial / found.initial.sum()).tolist()),
        speed=max(speed, 1e-9),
    )


def _drifts(features: Features, lengths: NDArray[np.int64], found: Clusters) -> Floats:
    """Density of the noise on g and on w in each component; (K, 2)."""
    labels = found.probs.argmax(axis=2)
    sums, times = np.zeros((len(found.mean), 2)), np.zeros(len(found.mean))
    variances = np.diagonal(features.eta_cov, axis1=-2, axis2=-1)
    for b, length in enumerate(lengths):
        clock, label = features.times[b, :length], labels[b, :length]
        later = np.searchsorted(clock, clock + features.window)
        first = np.flatnonzero(later < length)
        second = later[first]
        switches = np.concatenate([[0], np.cumsum(label[1:] != label[:-1])])
        kept = (switches[first] == switches[second]) & features.valid[b, first] & features.valid[b, second]
        first, second = first[kept], second[kept]
        moved = (features.eta[b, second] - features.eta[b, first]) ** 2
        moved -= variances[b, first] + variances[b, second]
        np.add.at(sums, label[first], np.stack([moved[:, 0], moved[:, 1:].mean(axis=1)], axis=1))
        np.add.at(times, label[first], clock[second] - clock[first])
    return np.maximum(sums, 0.0) / np.maximum(times, 1e-12)[:, None]


def _excess(features: Features, found: Clusters) -> Floats:
    """White acceleration that windows of each component show beyond their noise, m^2/s^3; (K,)."""
    labels, A = found.probs.argmax(axis=2), features.axes
    out = np.zeros(len(found.mean))
    # the mean of a window of n rows has variance R / n, so n var(p) is about that of one measurement
    position = np.trace(features.cov[..., :A, :A], axis1=-2, axis2=-1) / A
    noise = position * (features.dof / A + 3.0) * (4.0 / 9.0)  # the value of a parabola at its middle: 9 / 4 R / n
    for k in range(len(out)):
        rows = features.valid & (labels == k)
        if np.count_nonzero(rows) > 10:
            beyond = max(float(np.median(features.misfit[rows])) - 1.0, 0.0)
            out[k] = beyond * float(np.median(noise[rows])) / (_WOBBLE * features.window**3)
    return out
