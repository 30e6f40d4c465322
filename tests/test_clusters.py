"""From features to clusters and a first model: noise taken away, mirror images tied, laws that a filter can run."""

import numpy as np
import pytest
from scipy.linalg import expm
from switching_tracks import switching_tracks

from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks
from jink.intent.clusters import cluster, projected
from jink.intent.features import Features, encode
from jink.intent.hidden_chain import best_labels, draw_labels, smooth_labels
from jink.intent.initialise import first_model


def naive_labels(rows, dts, generator):
    """Posterior label probabilities of one track by summing over every path."""
    T, K = rows.shape
    rates = -np.diag(generator)
    moves = []
    for dt in dts[1:]:
        stay = np.exp(-rates * dt)
        moves.append(np.where(np.eye(K) > 0, stay[:, None], (1 - stay)[:, None] * generator / rates[:, None]))
    weights = {}
    for path in np.ndindex(*(K,) * T):
        value = rows[0, path[0]] + np.log(1 / K)
        for t in range(1, T):
            value += np.log(moves[t - 1][path[t - 1], path[t]]) + rows[t, path[t]]
        weights[path] = value
    total = np.logaddexp.reduce(list(weights.values()))
    probs = np.zeros((T, K))
    for path, value in weights.items():
        for t, label in enumerate(path):
            probs[t, label] += np.exp(value - total)
    return probs, total, max(weights, key=weights.get)


def test_hidden_chain_equals_the_sum_over_paths():
    generator = np.random.default_rng(0)
    rows = generator.normal(size=(2, 5, 3))
    rates = np.array([[-0.3, 0.2, 0.1], [0.4, -0.5, 0.1], [0.05, 0.6, -0.65]])  # not symmetric: rows are from
    steps = np.array([[0.0, 1.0, 0.3, 2.0, 0.5]] * 2)
    lengths = np.array([5, 3])
    probs, counts, evidence = np.zeros((2, 5, 3)), np.zeros((3, 3)), np.zeros(2)
    labels = np.zeros((2, 5), dtype=np.int64)
    uniform = np.full(3, 1 / 3)
    smooth_labels(rows, steps, lengths, rates, True, uniform, probs, counts, evidence)
    best_labels(rows, steps, lengths, rates, True, uniform, labels)
    expected = 0.0
    for b, length in enumerate(lengths):
        wanted, total, path = naive_labels(rows[b, :length], steps[b, :length], rates)
        np.testing.assert_allclose(probs[b, :length], wanted, atol=1e-12)
        assert evidence[b] == pytest.approx(total, abs=1e-12)
        assert tuple(labels[b, :length]) == path and (labels[b, length:] == -1).all()
        expected += length - 1
    assert counts.sum() == pytest.approx(expected)
    drawn = np.zeros((2, 5, 3))
    for _ in range(1500):
        draw_labels(rows, steps, lengths, rates, True, uniform, generator.random((2, 5)), labels)
        drawn[np.arange(2)[:, None], np.arange(5), np.maximum(labels, 0)] += labels >= 0
    np.testing.assert_allclose(drawn / 1500, np.where(np.arange(5)[None, :, None] < lengths[:, None, None], probs, 0.0),
                               atol=0.06)  # sd at most 0.013  # fmt: skip


def synthetic(sizes, mean, sd, noise, seed=0):
    """Features of one row each: eta of known components, seen with known noise."""
    generator = np.random.default_rng(seed)
    parts = [generator.normal(m, s, (n, 2)) for n, m, s in zip(sizes, mean, sd, strict=True)]
    eta = np.concatenate(parts)
    sides = generator.choice([-1.0, 1.0], len(eta))
    eta[:, 1] *= sides
    C = noise**2 * generator.choice([0.3, 1.7], (len(eta), 2))
    x = eta + np.sqrt(C) * generator.standard_normal(eta.shape)
    B = len(eta)
    full = np.concatenate([np.tile([0.0, 0.0, 1e3, 0.0], (B, 1)), x], axis=1)[:, None]
    cov = np.zeros((B, 1, 6, 6))
    cov[..., range(4), range(4)] = 1.0
    cov[:, 0, 4, 4], cov[:, 0, 5, 5] = C.T
    return Features(full, cov, np.ones((B, 1)), np.full((B, 1), 9), 1.0, np.zeros((B, 1)), np.ones((B, 1), dtype=bool))


def test_noise_is_taken_away_and_sides_are_folded():
    features = synthetic((1500, 2500), [(0.0, 0.0), (0.02, 0.13)], [(0.002, 0.002), (0.01, 0.03)], noise=0.02)
    found = cluster(features, np.ones(4000, dtype=int), 2)
    np.testing.assert_allclose(found.shares, [0.625, 0.375], atol=0.03)
    np.testing.assert_allclose(found.mean[0], [0.02, 0.13], atol=0.003)
    # the observed spread is 0.036: without the deconvolution 0.03 would not come out; sd of an sd 0.0006
    np.testing.assert_allclose(found.sd[0], [0.01, 0.03], atol=0.0025)
    assert (found.sd[1] < 0.006).all() and abs(found.mean[1]).max() < 0.004


def test_clusters_separate_the_laws_and_repeat():
    tracks, _, labels = switching_tracks(seed=1)
    features = encode(tracks, 10.0)
    found = cluster(features, tracks.lengths, 6, seed=3)
    table = np.zeros((6, 3))
    np.add.at(table, (found.probs.argmax(axis=2).ravel(), labels.ravel()), 1)
    assert table.max(axis=1).sum() / table.sum() > 0.85  # 0.90; one law alone holds 0.4
    again = cluster(features, tracks.lengths, 6, seed=3)
    other = cluster(features, tracks.lengths, 6, seed=4)
    assert again.score == found.score and (again.mean == found.mean).all()
    assert not np.array_equal(other.mean, found.mean)


def test_mirrored_and_turned_tracks_give_the_same_clusters():
    tracks, _, _ = switching_tracks(tracks=10, seed=2)
    turned = np.array([[0.0, -1.0], [1.0, 0.0]]) @ np.diag([1.0, -1.0])
    moved = Tracks.from_arrays(tracks.measurements @ turned.T, tracks.times, noise=tracks.noise)
    one, two = (cluster(encode(part, 10.0), part.lengths, 4) for part in (tracks, moved))
    np.testing.assert_allclose(one.mean, two.mean, atol=1e-8)
    np.testing.assert_allclose(one.probs, two.probs, atol=1e-5)


def test_first_model_runs_and_describes():
    tracks, _, labels = switching_tracks(seed=5)
    model = first_model(tracks, 6, learn_noise=True)
    assert len(model.intents) == 6 and model.noise_sd == pytest.approx((5.0, 5.0), rel=0.25)
    assert "turn" in model.describe() and "straight" in model.describe()
    estimator = model.estimator(position(2, 5.0), threads=1)
    found = estimator.run(tracks.measurements, tracks.times, tracks.noise)
    error = np.sqrt(np.mean(np.sum((found.position - tracks.truth) ** 2, axis=2)))
    assert error < 6.0  # the measurements: 7.1
    assert 1.6 < found.nis[:, 10:].mean() < 2.6
    table = np.zeros((6, 3))
    probs = model.intent_probs(found.mode_probs)
    np.add.at(table, (probs.argmax(axis=2).ravel(), labels.ravel()), 1)
    assert table.max(axis=1).sum() / table.sum() > 0.75


def test_first_model_in_space():
    generator = np.random.default_rng(0)
    paths = []
    for _ in range(12):
        p, v, path = np.zeros(3), 100.0 * np.linalg.qr(generator.normal(size=(3, 3)))[0][0], []
        for _ in range(4):
            turn = generator.choice([0.0, 0.15]) * np.cross(v / 100.0, generator.normal(size=3))
            step = expm(np.cross(np.eye(3), turn))
            for _ in range(20):
                path.append(p)
                p, v = p + v, step @ v
        paths.append(np.array(path) + generator.standard_normal((80, 3)))
    tracks = Tracks.from_arrays(np.array(paths), np.arange(80.0), noise=np.eye(3))
    model = first_model(tracks, 3)
    sizes = sorted(intent.phases[0].births[0].turn_sd for intent in model.intents)
    assert sizes[0] < 0.01 and sizes[-1] > 0.06
    found = model.estimator(position(3, 1.0), threads=1).run(tracks.measurements, tracks.times)
    assert np.isfinite(found.log_likelihood).all()


def test_rows_without_direction_are_left_out():
    still = Tracks.from_arrays(np.random.default_rng(0).standard_normal((3, 50, 2)), np.arange(50.0), noise=np.eye(2))
    features = encode(still, 10.0)
    assert projected(features)[2].mean() < 0.1
    with pytest.raises(ValueError, match="rows with a known direction"):
        cluster(features, still.lengths, 40)
    with pytest.raises(ValueError, match="noise_sd must be given for a range-bearing sensor"):
        moving, _, _ = switching_tracks(tracks=4)
        seen = moving.measurements + 1e4
        polar = np.stack([np.hypot(seen[..., 0], seen[..., 1]), np.arctan2(seen[..., 1], seen[..., 0])], axis=-1)
        first_model(
            Tracks.from_arrays(polar, moving.times, sensor="range-bearing", noise=np.diag([25.0, 1e-7])),
            2, window=10.0, learn_noise=True,
        )  # fmt: skip
