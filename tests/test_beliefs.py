"""The belief about the noise level and the covariance that is honest about it, against sums of plain matrices."""

from __future__ import annotations

import numpy as np
import pytest

from jink.estimators.agent import beliefs
from jink.estimators.agent.beliefs import BACK, CALM, LEVEL_SCALES, LEVELS, STAY
from jink.estimators.compiled import kernel


@kernel
def principal(v, HPH, R, d, scratch, basis):
    """The kernel, called from Python."""
    return beliefs.principal(v, HPH, R, d, scratch, basis)


@kernel
def believe(basis, d, belief, scratch):
    """The kernel, called from Python."""
    beliefs.believe(basis, d, belief, scratch)


@kernel
def overconfidence(basis, d, chosen, belief, scratch, believed, excess):
    """The kernel, called from Python."""
    return beliefs.overconfidence(basis, d, chosen, belief, scratch, believed, excess)


OTHER = (1.0 - STAY) * (1.0 - BACK) / (LEVELS - 2)


def chain():
    """The transition of the belief, as a matrix; rows: from."""
    matrix = np.full((LEVELS, LEVELS), OTHER)
    matrix[np.arange(1, LEVELS), np.arange(1, LEVELS)] = STAY
    matrix[1:, 0] = (1.0 - STAY) * BACK
    matrix[0] = [CALM, *[beliefs.SURGE] * (LEVELS - 1)]
    return matrix


def problem(seed, d, size):
    """Innovation, H P H', R, a chosen noise and a belief, with correlations in everything."""
    rng = np.random.default_rng(seed)
    factors = rng.normal(size=(3, d, d))
    HPH, R, chosen = (factor @ factor.T + 0.1 * np.eye(d) for factor in factors)
    belief = rng.dirichlet(np.full(LEVELS, 0.5)) + 1e-9
    return size * rng.normal(size=d), size * HPH, R, 30.0 * chosen, belief / belief.sum()


def padded(matrix):
    """As kernels hold it."""
    out = np.zeros((max(len(matrix), 2), 8))
    out[: len(matrix), : len(matrix)] = matrix
    return out


CASES = [(seed, d, size) for d in (1, 2, 3, 4) for seed, size in enumerate((1e-3, 1.0, 40.0, 3000.0))]


@pytest.mark.parametrize(("seed", "d", "size"), CASES)
def test_a_belief_is_bayes_over_the_levels(seed, d, size):
    v, HPH, R, _, belief = problem(seed, d, size)
    expected = belief @ chain()
    logs = []
    for scale in LEVEL_SCALES:
        S = HPH + scale * R
        logs.append(-0.5 * v @ np.linalg.solve(S, v) - 0.5 * np.linalg.slogdet(S)[1])
    expected = expected * np.exp(np.array(logs) - max(logs))
    expected /= expected.sum()
    scratch, basis = np.full((2 * d, 8), np.nan), np.full((d + 2, 8), np.nan)
    square = principal(v, padded(HPH), padded(R), d, scratch, basis)
    assert square == pytest.approx(v @ np.linalg.solve(R, v), rel=1e-10)
    found = belief.copy()
    believe(basis, d, found, scratch)
    np.testing.assert_allclose(found, np.maximum(expected, 1e-12), rtol=1e-8)


@pytest.mark.parametrize(("seed", "d", "size"), CASES)
def test_the_honest_covariance_is_that_of_the_mixture(seed, d, size):
    v, HPH, R, chosen, belief = problem(seed, d, size)
    ours = np.linalg.inv(HPH + chosen)
    W = np.zeros((d, d))
    for weight, scale in zip(belief, LEVEL_SCALES, strict=True):
        theirs = np.linalg.inv(HPH + scale * R)
        off = (theirs - ours) @ v
        W += weight * (theirs - np.outer(off, off))
    scratch, basis = np.full((2 * d, 8), np.nan), np.full((d + 2, 8), np.nan)
    excess = np.full((max(d, 2), 8), np.nan)
    assert principal(v, padded(HPH), padded(R), d, scratch, basis) < np.inf
    believed = np.full((d + 1, 8), np.nan)
    assert overconfidence(basis, d, padded(chosen), belief, scratch, believed, excess)
    T = basis[:d, :d]
    np.testing.assert_allclose(T.T @ believed[:d, :d] @ T, W, rtol=1e-8, atol=1e-10 * np.abs(W).max())
    np.testing.assert_allclose(T.T @ believed[d, :d], ours @ v, rtol=1e-8, atol=1e-12 * size)
    expected = ours - W
    np.testing.assert_allclose(excess[:d, :d], expected, rtol=1e-8, atol=1e-10 * np.abs(W).max())


@pytest.mark.parametrize("spoilt", ["R", "HPH", "v", "chosen"])
def test_what_is_no_covariance_changes_nothing(spoilt):
    v, HPH, R, chosen, belief = problem(0, 2, 1.0)
    R = -R if spoilt == "R" else R
    HPH = HPH * np.nan if spoilt == "HPH" else HPH
    v = v * np.nan if spoilt == "v" else v
    chosen = -1e6 * chosen if spoilt == "chosen" else chosen
    scratch, basis, excess = np.zeros((4, 8)), np.zeros((4, 8)), np.ones((2, 8))
    found = principal(v, padded(HPH), padded(R), 2, scratch, basis)
    assert (found < np.inf) == (spoilt == "chosen")
    assert not overconfidence(basis, 2, padded(chosen), belief, scratch, np.zeros((3, 8)), excess)
    np.testing.assert_array_equal(excess[:2, :2], 0.0)


def test_a_huge_innovation_means_the_highest_level():
    belief = np.full(LEVELS, 1.0 / LEVELS)
    scratch, basis = np.zeros((4, 8)), np.zeros((4, 8))
    eye = padded(np.eye(2))
    assert principal(np.array([1e100, 0.0]), eye, eye, 2, scratch, basis) < np.inf
    believe(basis, 2, belief, scratch)
    assert belief[-1] == pytest.approx(1.0) and belief.min() == 1e-12
