"""Consensus of nodes: frozen values, the centralised filter as a limit, round-by-round oracle, faults, consistency."""

import numpy as np
import pytest
from consensus_filter import A, H, Q, R, fly, nees, run_centre, run_nodes
from scipy import stats

from jink.envs.networks import complete, geometric, line, metropolis_weights, ring
from jink.estimators.metrics import disagreement
from jink.estimators.multitarget.consensus import (
    RULES,
    Consensus,
    Exchange,
    message_bytes,
    mixing_matrix,
    novelty_weights,
)
from jink.estimators.multitarget.faults import Faults
from jink.estimators.multitarget.information import (
    Information,
    consensus_update,
    from_moments,
    predict_information,
    to_moments,
)

SPARSE = geometric(12, 450.0, 1000.0, seed=3)
SENSING = (0, 3, 6, 9)
BAD_DAYS = Faults(
    message_loss=0.3, link_failure=0.2, broken=((0, 1, 4.0, 20.0),), dead=((3, 10.0, 24.0),), delays=((6, 2),), seed=5
)


def weights_of(network):
    return metropolis_weights(network)


def random_covariance(rng, n):
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)


# --- frozen values ---


def test_path_of_three_with_sensors_at_its_ends():
    mixing = Consensus(weights_of(line(3)), rounds=1).exchange(0.0, 0).mixing
    np.testing.assert_allclose(mixing @ [1.0, 0.0, 1.0], 2 / 3)
    np.testing.assert_allclose(novelty_weights("b", mixing, [1.0, 0.0, 1.0]), 1.5)


@pytest.mark.parametrize("n", [1, 3, 6])
def test_prediction_equals_the_form_with_the_inverse_of_q(n):
    rng = np.random.default_rng(n)
    Omega, W, F = random_covariance(rng, n), random_covariance(rng, n), rng.normal(size=(n, n))
    x = rng.normal(size=n)
    found = predict_information(Information(Omega @ x, Omega), F, np.linalg.inv(W))
    wanted = W - W @ F @ np.linalg.inv(Omega + F.T @ W @ F) @ F.T @ W
    np.testing.assert_allclose(found.matrix, wanted, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.vector, wanted @ F @ x, rtol=1e-8, atol=1e-9)


def test_prediction_with_singular_noise():
    """Held acceleration: Q = G G' has rank one; and no noise at all."""
    rng = np.random.default_rng(0)
    F, G = np.array([[1.0, 2.0], [0.0, 1.0]]), np.array([[2.0], [2.0]])
    P, x = random_covariance(rng, 2), rng.normal(size=2)
    for noise in (G @ G.T, np.zeros((2, 2))):
        mean, cov = to_moments(predict_information(from_moments(x, P), F, noise))
        np.testing.assert_allclose(cov, F @ P @ F.T + noise, rtol=1e-10)
        np.testing.assert_allclose(mean, F @ x, rtol=1e-10)


@pytest.mark.parametrize(("rule", "steady"), [("N", 0.207107), ("1", 0.618034), ("b", 0.618034), ("safe", 0.207107)])
def test_scalar_consensus_has_the_known_steady_variance(rule, steady):
    """F = Q = H = R = 1, four nodes that all see and all talk: (sqrt 2 - 1) / 2 against the golden section."""
    network = Consensus(np.full((4, 4), 0.25), rounds=1, rule=rule)
    pair = Information(np.zeros((4, 1, 1)), np.ones((4, 1, 1, 1)))
    for k in range(60):
        novelty = Information(np.zeros((4, 1, 1)), np.ones((4, 1, 1, 1)))
        pair = consensus_update(pair, novelty, np.ones((4, 1)), network.exchange(float(k), k), rule)
        cov = to_moments(pair)[1]
        pair = predict_information(pair, np.ones((1, 1)), np.ones((1, 1)))
    np.testing.assert_allclose(cov, steady, atol=5e-7)


def test_a_message_is_29_reals_per_target():
    assert message_bytes(4, 1, "b") == 29 * 8
    assert message_bytes(4, 3, "b") == 3 * message_bytes(4, 1, "b")
    assert message_bytes(4, 3, "N") == 3 * 28 * 8
    assert message_bytes(4, 3, "safe", nodes=50) == (3 * 28 + 50) * 8
    network = Consensus(weights_of(line(3)), rounds=7)
    assert network.exchange(0.0, 0).messages == 7 * 4
    # What is lost has been sent; a dead node sends nothing.
    assert Consensus(weights_of(line(3)), 7, "b", Faults(message_loss=0.9)).exchange(0.0, 0).messages == 7 * 4
    assert Consensus(weights_of(line(3)), 7, "b", Faults(dead=((1, 0.0, 9.0),))).exchange(0.0, 0).messages == 7 * 2


# --- limits ---


@pytest.mark.parametrize("rule", ["N", "safe"])
def test_complete_network_of_equals_is_the_centralised_filter(rule):
    _, seen = fly(2, 12, 5, seed=1)
    means, covs = run_nodes(Consensus(np.full((5, 5), 0.2), rounds=1, rule=rule), seen, range(5))
    centre, P = run_centre(seen)
    # Nine digits of the deviation, of numbers up to 4000: double precision leaves about eleven.
    np.testing.assert_allclose(means, np.broadcast_to(centre[:, None], means.shape), rtol=1e-9)
    np.testing.assert_allclose(covs, np.broadcast_to(P[:, None, None], covs.shape), rtol=1e-9)


def test_nodes_come_to_one_estimate_with_rounds():
    _, seen = fly(3, 6, len(SENSING), seed=2)
    centre, _ = run_centre(seen)
    apart, off = [], []
    for rounds in (1, 4, 16, 64, 256):
        means, _ = run_nodes(Consensus(weights_of(SPARSE), rounds, "N"), seen, SENSING)
        apart.append(disagreement(means[-1][..., [0, 2]]).mean())
        off.append(np.abs(means - centre[:, None]).max())
    assert (np.diff(np.log(apart)) < -1).all()
    assert apart[-1] < 1e-6
    assert off[-1] < 1e-3 < off[0]


def test_average_rules_tend_to_what_they_say():
    """b: the mean of the sensing nodes' information; 1: the mean of all; N and safe: the sum."""
    mixing = np.linalg.matrix_power(weights_of(SPARSE), 3000)
    holds = np.isin(np.arange(12), SENSING).astype(float)
    total = {rule: (novelty_weights(rule, mixing, holds) * (mixing @ holds))[0] for rule in RULES}
    assert total == pytest.approx({"b": 1.0, "N": 4.0, "1": 4 / 12, "safe": 4.0})


def test_safe_and_b_never_count_a_sensor_twice():
    rng = np.random.default_rng(0)
    holds = (rng.random((12, 5)) < 0.4).astype(float)
    for rounds in (0, 1, 3, 20):
        mixing = Consensus(weights_of(SPARSE), rounds, faults=BAD_DAYS).exchange(12.0, 3).mixing
        for rule in ("safe", "b"):
            omega = novelty_weights(rule, mixing, holds)
            counted = omega[:, None] * mixing[:, :, None] * holds
            assert counted.max() <= 1 + 1e-12
        assert (novelty_weights("safe", mixing, holds) >= novelty_weights("b", mixing, holds) - 1e-12).all()
        # Nothing heard of a target: its weight is no matter, but is a number.
        assert np.isfinite(novelty_weights("b", mixing, np.zeros((12, 1)))).all()


# --- rounds, one by one ---


def test_mixing_is_what_nodes_do_round_by_round():
    W, N, L = weights_of(SPARSE), 12, 6
    heard = BAD_DAYS.heard(12.0, 3, L, SPARSE.adjacency)
    lag = BAD_DAYS.lag(N)
    start = np.random.default_rng(0).normal(size=N)
    value, sent = list(start), []
    for turn in range(L):
        sent.append(list(value))
        fresh = []
        for i in range(N):
            total = rest = 0.0
            for j in np.flatnonzero(SPARSE.adjacency[i]):
                when = turn - lag[j]
                if when >= 0 and heard[when, i, j]:
                    total += W[i, j] * sent[when][j]
                    rest += W[i, j]
            fresh.append(total + (1.0 - rest) * value[i])
        value = fresh
    np.testing.assert_allclose(mixing_matrix(W, heard, lag) @ start, value, atol=1e-13)


def test_what_fails_is_what_was_said():
    rounds, adjacency = 400, SPARSE.adjacency
    heard = Faults(message_loss=0.3, seed=1).heard(0.0, 0, rounds, adjacency)
    assert not heard[:, ~adjacency].any()
    share = heard[:, adjacency].mean()
    assert abs(share - 0.7) < 4.5 * np.sqrt(0.21 / (rounds * adjacency.sum()))
    down = np.array([Faults(link_failure=0.2, seed=1).heard(0.0, k, 1, adjacency)[0] for k in range(400)])
    assert (down == down.transpose(0, 2, 1)).all()
    assert abs(down[:, adjacency].mean() - 0.8) < 4.5 * np.sqrt(0.16 / (400 * adjacency.sum() / 2))
    same = Faults(message_loss=0.3, seed=1).heard(0.0, 0, rounds, adjacency)
    other = Faults(message_loss=0.3, seed=2).heard(0.0, 0, rounds, adjacency)
    np.testing.assert_array_equal(same, heard)
    assert (other != heard).any()
    i, j = np.argwhere(adjacency)[0]
    single = Faults(lost=((2.0, 1, i, j),), broken=((i, j, 4.0, 6.0),)) if i < j else None
    assert single.heard(2.0, 0, 2, adjacency).sum() == 2 * adjacency.sum() - 1
    assert not single.heard(2.0, 0, 2, adjacency)[1, i, j]
    assert single.heard(4.0, 0, 2, adjacency).sum() == 2 * adjacency.sum() - 4
    assert single.heard(6.0, 0, 2, adjacency).sum() == 2 * adjacency.sum()


def test_links_that_fail_both_ways_keep_sums():
    mixing = Consensus(weights_of(SPARSE), 8, faults=Faults(link_failure=0.4)).exchange(0.0, 1).mixing
    np.testing.assert_allclose(mixing.sum(axis=0), 1.0)
    np.testing.assert_allclose(mixing.sum(axis=1), 1.0)
    cut = Consensus(weights_of(SPARSE), 8, faults=BAD_DAYS).exchange(12.0, 1)
    np.testing.assert_allclose(cut.mixing.sum(axis=1), 1.0)
    np.testing.assert_array_equal(cut.mixing[3], np.eye(12)[3])
    np.testing.assert_array_equal(cut.mixing[:, 3], np.eye(12)[3])
    assert not cut.alive[3]


def test_numbering_of_nodes_and_targets_is_no_matter():
    _, seen = fly(3, 5, len(SENSING), seed=4)
    rng = np.random.default_rng(0)
    order, runs = rng.permutation(12), rng.permutation(3)
    W = weights_of(SPARSE)
    means, covs = run_nodes(Consensus(W, 5, "safe"), seen, SENSING)
    back = np.argsort(order)
    moved, moved_covs = run_nodes(Consensus(W[np.ix_(order, order)], 5, "safe"), seen[runs], back[list(SENSING)])
    np.testing.assert_allclose(moved, means[:, order][:, :, runs], rtol=1e-10)
    np.testing.assert_allclose(moved_covs, covs[:, order][:, :, runs], rtol=1e-8)


# --- faults over time ---


@pytest.mark.parametrize("rule", ["b", "safe"])
@pytest.mark.parametrize("faults", [Faults(), BAD_DAYS], ids=["all is well", "faults"])
def test_nodes_never_claim_more_than_they_know(rule, faults):
    """Mean NEES of 400 runs is at most 4 at every node and scan; a filter that counted twice would exceed it."""
    states, seen = fly(400, 20, len(SENSING), seed=6)
    means, covs = run_nodes(Consensus(weights_of(SPARSE), 3, rule, faults), seen, SENSING)
    assert np.isfinite(means).all()
    found = nees(means, covs, states).mean(axis=2)
    # Mean of 400 values of chi-square(4): standard deviation 0.14; 240 of them are looked at.
    assert found.max() < 4 + 4.5 * np.sqrt(8 / 400)


def test_counting_twice_would_be_noticed():
    states, seen = fly(400, 20, len(SENSING), seed=6)
    means, covs = run_nodes(Consensus(weights_of(SPARSE), 1, "N"), seen, SENSING)
    assert nees(means, covs, states).mean(axis=2).max() > 4 + 15 * np.sqrt(8 / 400)


def test_a_centre_of_many_rounds_is_exactly_consistent():
    states, seen = fly(400, 8, len(SENSING), seed=7)
    means, covs = run_nodes(Consensus(weights_of(SPARSE), 200, "safe"), seen, SENSING)
    low, high = stats.chi2.ppf([1e-6, 1 - 1e-6], 4 * 400) / 400
    found = nees(means, covs, states).mean(axis=2)
    assert low < found.min()
    assert found.max() < high


def test_a_node_that_returns_recovers():
    """Node 3 is dead from 10 s to before 24 s: its error grows, and two scans after its return it is as before."""
    states, seen = fly(200, 20, len(SENSING), seed=8)
    faults = Faults(dead=((3, 10.0, 24.0),))
    network = Consensus(weights_of(SPARSE), 10, "safe", faults)
    means, covs = run_nodes(network, seen, SENSING)
    well, _ = run_nodes(Consensus(weights_of(SPARSE), 10, "safe"), seen, SENSING)
    error, usual = (
        np.sqrt((((m - states.transpose(1, 0, 2)[:, None])[:, 3, :, [0, 2]]) ** 2).sum(axis=0).mean(axis=-1))
        for m in (means, well)
    )
    assert error[11] > 3 * usual[11]  # the last scan of the gap, 22 s
    assert (error[13:] < 1.15 * usual[13:]).all()
    assert np.isfinite(covs).all()


def test_everybody_alone_is_still_a_filter():
    """Every message lost: sensing nodes filter by themselves, the others predict."""
    states, seen = fly(300, 10, len(SENSING), seed=9)
    network = Consensus(weights_of(SPARSE), 5, "safe", Faults(message_loss=1.0))
    means, covs = run_nodes(network, seen, SENSING)
    alone, P = run_centre(seen[:, :, :1])
    np.testing.assert_allclose(means[:, 0], alone, rtol=1e-9)
    np.testing.assert_allclose(covs[:, 0], np.broadcast_to(P[:, None], covs[:, 0].shape), rtol=1e-9)
    assert covs[-1, 1, 0, 0, 0] > 10 * covs[-1, 0, 0, 0, 0]
    assert nees(means, covs, states).mean(axis=2).max() < 4 + 5 * np.sqrt(8 / 300)


# --- numbers and refusals ---


def test_moments_and_back():
    rng = np.random.default_rng(0)
    for scale in (1e-9, 1.0, 1e9):
        units = np.diag([1.0, scale, 1.0, 1e-3])
        P = np.stack([units @ random_covariance(rng, 4) @ units for _ in range(6)]).reshape(2, 3, 4, 4)
        x = rng.normal(size=(2, 3, 4)) @ units
        pair = from_moments(x, P)
        mean, cov = to_moments(pair)
        np.testing.assert_allclose(mean, x, rtol=1e-8)
        np.testing.assert_allclose(cov, P, rtol=1e-8)
        np.testing.assert_array_equal(pair.matrix, np.swapaxes(pair.matrix, -1, -2))


def test_no_information_is_no_estimate():
    mean, cov = to_moments(Information(np.zeros((2, 4)), np.stack([np.zeros((4, 4)), np.eye(4)])))
    assert np.isnan(mean[0]).all()
    assert np.isnan(cov[0]).all()
    np.testing.assert_array_equal(mean[1], 0.0)
    with pytest.raises(ValueError, match="cov must be positive definite"):
        from_moments(np.zeros(2), -np.eye(2))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Consensus(np.eye(3)), "weights must be primitive"),
        (lambda: Consensus(np.ones((3, 3))), "rows that sum to 1"),
        (lambda: Consensus(weights_of(ring(3)), rounds=-1), "rounds must be an integer >= 0"),
        (lambda: Consensus(weights_of(ring(3)), rule="M"), "rule must be one of b, N, 1, safe; got 'M'"),
        (lambda: Consensus(weights_of(ring(3)), faults=Faults(dead=((3, 0.0, 1.0),))), r"nodes must lie in 0\.\.2"),
        (lambda: Faults(message_loss=1.5), "message_loss must be a number >= 0 and at most 1"),
        (lambda: Faults(dead=((0, 2.0, 1.0),)), "must end after they begin"),
        (lambda: Faults(broken=((0, 1, 2.0),)), "broken must have 4 numbers"),
        (lambda: Faults(delays=((0, -1),)), "delays must be >= 0"),
        (lambda: predict_information(Information(np.zeros((2, 4)), np.zeros((2, 3, 3))), A, Q), "matrix must have"),
        (lambda: predict_information(from_moments(np.zeros(3), np.eye(3)), A, Q), r"must have shape \(3, 3\)"),
        (lambda: novelty_weights("?", np.eye(2), np.ones(2)), "novelty_weights: rule must be one of"),
    ],
)
def test_refusals(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_dead_node_keeps_its_prior():
    prior = from_moments(np.zeros((2, 1, 4)), np.eye(4))
    novelty = Information(np.ones((2, 1, 4)), np.tile(H.T @ np.linalg.inv(R) @ H, (2, 1, 1, 1)))
    exchange = Exchange(np.eye(2), np.array([True, False]), 0)
    after = consensus_update(prior, novelty, np.ones((2, 1)), exchange, "safe")
    np.testing.assert_array_equal(after.matrix[1], prior.matrix[1])
    assert (after.matrix[0] != prior.matrix[0]).any()


def test_complete_graph_metropolis_is_equal_weights():
    np.testing.assert_allclose(Consensus(weights_of(complete(5)), 1).exchange(0.0, 0).mixing, 0.2)
