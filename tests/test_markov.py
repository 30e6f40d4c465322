"""How modes change: the compiled matrix exponential, and the ways to state a chain."""

import numpy as np
import pytest
from scipy.linalg import expm

from jink.estimators.markov import MarkovChain, check_transition_matrix


def generator(rng, modes, scale):
    rates = rng.exponential(scale, size=(modes, modes)) * (rng.random((modes, modes)) < 0.7)
    np.fill_diagonal(rates, 0.0)
    np.fill_diagonal(rates, -rates.sum(axis=1))
    return rates


@pytest.mark.parametrize("modes", [1, 2, 3, 6, 11])
@pytest.mark.parametrize("dt", [1e-9, 0.03, 1.0, 47.0, 1e4])
@pytest.mark.parametrize("scale", [1e-4, 0.1, 5.0])
def test_transition_over_any_interval_equals_scipy(modes, dt, scale):
    rates = generator(np.random.default_rng(modes), modes, scale)
    matrix = MarkovChain(generator=tuple(map(tuple, rates))).at(dt)
    # scipy squares too: both lose a digit or so per three doublings when rate * dt is large.
    np.testing.assert_allclose(matrix, expm(rates * dt), atol=1e-10)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-14)
    assert (matrix >= 0).all()


def test_no_time_means_no_switch_and_a_long_time_means_the_stationary_chain():
    chain = MarkovChain(generator=((-0.3, 0.2, 0.1), (0.5, -0.5, 0.0), (0.1, 0.4, -0.5)))
    np.testing.assert_array_equal(chain.at(0.0), np.eye(3))
    np.testing.assert_allclose(chain.at(1e4), np.tile(chain.stationary(), (3, 1)), atol=1e-12)


def test_small_probabilities_keep_their_digits():
    # 1 - exp(-1e-12) would lose four digits; nothing is subtracted here.
    assert MarkovChain.from_sojourns([1e6, 1e6]).at(1e-6)[0, 1] == pytest.approx(1e-12, rel=1e-11, abs=0.0)


def test_rows_are_from_and_columns_are_to():
    chain = MarkovChain(generator=((-0.1, 0.1), (0.0, 0.0)))  # mode 0 leaves, mode 1 is for ever
    matrix = chain.at(5.0)
    assert matrix[0, 1] == pytest.approx(1 - np.exp(-0.5), rel=1e-13)
    np.testing.assert_array_equal(matrix[1], [0.0, 1.0])
    np.testing.assert_allclose(chain.stationary(), [0.0, 1.0], atol=1e-12)


def test_a_generator_forgets_how_time_was_cut():
    chain = MarkovChain(generator=tuple(map(tuple, generator(np.random.default_rng(2), 4, 0.3))))
    np.testing.assert_allclose(chain.at(0.7) @ chain.at(2.6), chain.at(3.3), atol=1e-14)


def test_sojourns_are_mean_times_and_targets_say_where_to():
    chain = MarkovChain.from_sojourns([2.0, 5.0, 10.0], targets=[[0, 0.25, 0.75], [1, 0, 0], [0.5, 0.5, 0]])
    np.testing.assert_allclose(-1 / np.diag(chain.generator), [2.0, 5.0, 10.0])
    np.testing.assert_allclose(np.array(chain.generator)[0], [-0.5, 0.125, 0.375])
    even = np.array(MarkovChain.from_sojourns([4.0, 4.0, 4.0]).generator)
    np.testing.assert_allclose(even, [[-0.25, 0.125, 0.125], [0.125, -0.25, 0.125], [0.125, 0.125, -0.25]])
    assert MarkovChain.from_sojourns([3.0]).at(9.0) == pytest.approx(1.0)


def test_a_matrix_every_dt_comes_back_at_dt_and_at_twice_dt():
    matrix = np.array([[0.9, 0.08, 0.02], [0.1, 0.8, 0.1], [0.05, 0.05, 0.9]])
    chain = MarkovChain.from_matrix(matrix, 5.0)
    np.testing.assert_allclose(chain.at(5.0), matrix, atol=1e-12)
    np.testing.assert_allclose(chain.at(10.0), matrix @ matrix, atol=1e-12)
    np.testing.assert_array_equal(MarkovChain.per_step(matrix).at(123.0), matrix)
    stationary = MarkovChain.per_step(matrix).stationary()
    np.testing.assert_allclose(stationary @ matrix, stationary, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (MarkovChain, "exactly one"),
        (lambda: MarkovChain(generator=((0.0,),), matrix=((1.0,),)), "exactly one"),
        (lambda: MarkovChain(generator=((-1.0, 0.5), (0.0, 0.0))), "sum to 0"),
        (lambda: MarkovChain(generator=((1.0, -1.0), (0.0, 0.0))), ">= 0"),
        (lambda: MarkovChain(generator=((np.nan, 1.0), (0.0, 0.0))), "generator"),
        (lambda: MarkovChain(generator=((0.0, 0.0),)), "square"),
        (lambda: MarkovChain.per_step([[0.9, 0.2], [0.1, 0.8]]), "sum to 1"),
        (lambda: MarkovChain.per_step([[1.1, -0.1], [0.1, 0.9]]), r"\[0, 1\]"),
        (lambda: MarkovChain.per_step([[np.nan, 1.0], [0.1, 0.9]]), r"\[0, 1\]"),
        (lambda: MarkovChain.from_matrix([[0.0, 1.0], [1.0, 0.0]], 1.0), "embeddable"),
        (lambda: MarkovChain.from_matrix([[0.9, 0.1], [0.1, 0.9]], 0.0), "dt must be > 0"),
        (lambda: MarkovChain.from_sojourns([1.0, 0.0]), "> 0 s"),
        (lambda: check_transition_matrix(np.eye(3), 2, caller="here"), "here: .*shape"),
    ],
)
def test_what_is_no_chain_is_refused_in_one_sentence(make, words):
    with pytest.raises(ValueError, match=words):
        make()
