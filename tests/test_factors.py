"""Adaptive factors: every rule against plain numpy; where each starts, stops and must not break."""

import numpy as np
import pytest
from scipy.stats import chi2

from jink.estimators.factors import FACTORS, LARGEST_INFLATION, Factor, make_factor

SIZES = [1, 2, 3, 5]
LIMIT = LARGEST_INFLATION


def spd(rng, d):
    root = rng.normal(size=(d, d))
    return root @ root.T + 0.3 * np.eye(d)


def textbook(name, v, HPH, R):
    """The rules as written on paper."""
    d = len(v)
    squared = v @ np.linalg.inv(HPH + R) @ v
    root, K = np.sqrt(squared), chi2.ppf(0.95, d)
    if name == "none":
        return R
    if name == "mr":
        low, high = chi2.ppf([0.9, 0.99], d)
        return R * (LIMIT if squared > high else np.sqrt(squared / low) if squared > low else 1.0)
    if name == "huber":
        return R * max(root / np.sqrt(K), 1.0)
    if name == "rma":
        limit = np.sqrt(chi2.ppf(chi2.cdf(2.5**2, 2), d))
        root = np.sqrt(squared + 1e-3)
        return R * root if root > limit else R
    if name == "mahalanobis":
        return np.diag(np.maximum(abs(v**2 / K - np.diag(HPH)), np.diag(R))) if squared > K else R
    if name == "igg3":
        low, high = np.sqrt(chi2.ppf([0.9, 0.9999], d))
        weight = 1.0 if root <= low else (low / root) * ((high - root) / (high - low)) ** 2 if root < high else 0.0
        return R * min(1.0 / weight, LIMIT) if weight else R * LIMIT
    if name == "chang-analytic":
        return max(squared / K, 1.0) * (HPH + R) - HPH
    low, high = 0.0, 1e9  # chang: bisection
    distance = lambda kappa: v @ np.linalg.inv(HPH + kappa * R) @ v  # noqa: E731
    if squared <= K:
        return R
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if distance(middle) > K else (low, middle)
    return R * high


@pytest.mark.parametrize("d", SIZES)
@pytest.mark.parametrize("name", FACTORS)
def test_every_rule_is_the_textbook_one(name, d):
    rng = np.random.default_rng(d)
    inflated = 0
    for length in np.geomspace(0.1, 300.0, 60):
        HPH, R = spd(rng, d), spd(rng, d)
        v = rng.normal(size=d)
        v *= length / np.linalg.norm(v)
        found = FACTORS[name].adapt(v, HPH, R)
        # Rounding of two 5 x 5 inversions and of the bisection.
        np.testing.assert_allclose(found, textbook(name, v, HPH, R), rtol=1e-9, atol=1e-9)
        inflated += not np.allclose(found, R)
    assert (inflated > 10) == (name != "none")


@pytest.mark.parametrize(
    ("innovation", "expected"),
    [
        # The published check values, which use thresholds of three decimals: hence 2e-4.
        ((3.0, 4.0), {"mr": LIMIT, "huber": 1.444254, "rma": 3.535675, "mahalanobis": (1.0, 1.670673)}),
        ((3.5, 0.0), {"mr": 1.153289, "huber": 1.010978, "rma": 1.0, "mahalanobis": (1.044734, 1.0)}),
        ((3.0, 0.0), {"mr": 1.0, "huber": 1.0, "rma": 1.0, "mahalanobis": 1.0}),
    ],
)
def test_published_values(innovation, expected):
    for name, value in expected.items():
        found = FACTORS[name].adapt(innovation, np.eye(2), np.eye(2))
        np.testing.assert_allclose(np.diag(found), value, rtol=2e-4)
        assert found[0, 1] == found[1, 0] == 0.0


def test_thresholds_are_the_inventors_for_two_components():
    published = {"mr": (4.605, 9.210), "huber": (2.448,), "rma": (2.5,), "mahalanobis": (5.991,)}
    for name, values in published.items():
        np.testing.assert_allclose(FACTORS[name].thresholds(2)[: len(values)], values, atol=5e-4)
    np.testing.assert_allclose(FACTORS["mr"].thresholds(3), [6.251, 11.345], atol=5e-4)
    np.testing.assert_allclose(FACTORS["mahalanobis"].thresholds(1)[0], 3.841, atol=5e-4)


@pytest.mark.parametrize("name", ["huber", "chang", "chang-analytic", "igg3", "mr"])
def test_continuous_where_claimed(name):
    """The noise starts to grow from R: no jump at the first threshold (the RMA rule has one, by design)."""
    factor = FACTORS[name]
    limit = factor.thresholds(2)[0] ** (2 if factor.root else 1)
    at = [np.sqrt(2.0 * limit * (1.0 + side)) for side in (-1e-9, 1e-9)]  # S = 2 I
    below, above = (factor.adapt((length, 0.0), np.eye(2), np.eye(2)) for length in at)
    np.testing.assert_array_equal(below, np.eye(2))
    np.testing.assert_allclose(above, below, atol=1e-8)


def test_rma_jumps():
    above = FACTORS["rma"].adapt((2.51 * np.sqrt(2.0), 0.0), np.eye(2), np.eye(2))
    assert above[0, 0] > 2.5


@pytest.mark.parametrize("d", SIZES)
@pytest.mark.parametrize("name", ["chang", "chang-analytic"])
def test_chang_brings_the_distance_to_the_quantile(name, d):
    rng = np.random.default_rng(d)
    K = chi2.ppf(0.95, d)
    for length in (30.0, 1e3, 1e4):
        HPH, R, v = spd(rng, d), spd(rng, d), rng.normal(size=d)
        v *= length / np.linalg.norm(v)
        noise = FACTORS[name].adapt(v, HPH, R)
        np.testing.assert_allclose(v @ np.linalg.solve(HPH + noise, v), K, rtol=1e-9)


def test_mahalanobis_brings_one_component_to_the_quantile():
    noise = FACTORS["mahalanobis"].adapt([9.0], [[2.0]], [[1.5]])
    np.testing.assert_allclose(81.0 / (2.0 + noise[0, 0]), chi2.ppf(0.95, 1), rtol=1e-12)


@pytest.mark.parametrize("name", FACTORS)
@pytest.mark.parametrize(
    ("innovation", "predicted", "noise"),
    [
        ((np.nan, 1.0), np.eye(2), np.eye(2)),
        ((np.inf, 1.0), np.eye(2), np.eye(2)),
        ((1e200, -1e200), np.eye(2), np.eye(2)),
        ((1e3, 1.0), np.full((2, 2), np.nan), np.eye(2)),
        ((1e3, 1.0), -np.eye(2), np.eye(2)),
        ((1e3, 1.0), np.zeros((2, 2)), np.diag([1e-18, 1e18])),
        ((0.0, 0.0), np.eye(2), np.eye(2)),
    ],
)
def test_trouble_gives_a_noise_all_the_same(name, innovation, predicted, noise):
    found = FACTORS[name].adapt(innovation, predicted, noise)
    assert np.isfinite(found).all()
    # Rounding of the analytic variant, which subtracts what it has added.
    assert (np.diag(found) >= np.diag(noise) * (1.0 - 1e-9)).all()


def test_units_do_not_matter():
    rng = np.random.default_rng(5)
    HPH, R = spd(rng, 2), spd(rng, 2)
    for name, factor in FACTORS.items():
        for v in ((1.0, 2.0), (4.0, -3.0), (40.0, 3.0)):
            metres = factor.adapt(v, HPH, R)
            microradians = factor.adapt(np.multiply(v, 1e6), HPH * 1e12, R * 1e12)
            np.testing.assert_allclose(microradians, metres * 1e12, rtol=1e-9, err_msg=name)


def test_other_probabilities_and_a_factor_of_ones_own():
    strict = make_factor("huber", (0.5,))
    assert strict.thresholds(2)[0] == pytest.approx(np.sqrt(chi2.ppf(0.5, 2)))
    assert FACTORS["huber"].probabilities == (0.95,)

    def double(v, HPH, R, nis, thresholds, work, out):
        for i in range(v.size):
            for j in range(v.size):
                out[i, j] = 2.0 * R[i, j]

    np.testing.assert_array_equal(Factor("double", double).adapt((1.0, 0.0), np.eye(2), np.eye(2)), 2.0 * np.eye(2))


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: make_factor("hubert"), "make_factor: name must be one of none, mr, huber"),
        (lambda: make_factor("mr", (0.9,)), "make_factor: probabilities of mr must have 2 entries; got 1"),
        (lambda: make_factor("mr", (0.99, 0.9)), "Factor: probabilities must be at most two increasing numbers"),
        (lambda: make_factor("huber", (1.5,)), "Factor: probabilities must be at most two increasing numbers"),
        (lambda: FACTORS["mr"].adapt((1.0,), np.eye(2), np.eye(2)), "Factor.adapt: innovation, predicted, noise"),
    ],
)
def test_bad_input_is_answered_in_one_sentence(build, sentence):
    with pytest.raises(ValueError, match=sentence):
        build()
