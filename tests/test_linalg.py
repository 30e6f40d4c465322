"""Small matrices: every kernel against numpy, for sizes on both sides of a vector of eight."""

import numpy as np
import pytest
from random_problems import spd
from scipy import stats

from jink.estimators import linalg
from jink.estimators.kalman import gaussian_update, posterior_from_deviations, predict_linear
from jink.estimators.unscented import draw_points, point_weights, points_covariance, points_mean

SIZES = [1, 2, 5, 7, 8, 9, 13]


def pad(matrix):
    """The same matrix (or vector) with rows padded to eight columns."""
    matrix = np.asarray(matrix, dtype=float)
    extra = -matrix.shape[-1] % 8
    return np.pad(matrix, [(0, 0)] * (matrix.ndim - 1) + [(0, extra)])


@pytest.mark.parametrize("n", SIZES)
def test_cholesky_and_both_solves_equal_numpy(n):
    rng = np.random.default_rng(n)
    P, right = spd(rng, n), rng.normal(size=(n, 3))
    upper = np.full_like(pad(P), 7.0)  # what was there before must not matter
    assert linalg.cholesky(pad(P), n, upper)
    np.testing.assert_allclose(upper[:, :n], np.linalg.cholesky(P).T, atol=1e-13)
    rows = pad(right)
    linalg.solve_lower(upper, n, rows, 3)
    linalg.solve_upper(upper, n, rows, 3)
    np.testing.assert_allclose(rows[:, :3], np.linalg.solve(P, right), atol=1e-11)


def test_cholesky_takes_semidefinite_and_refuses_negative_matrices():
    a = np.array([[1.0, 0.0], [2.0, 0.0], [0.5, 1.0]])
    P = a @ a.T  # rank 2
    upper = np.zeros((3, 8))
    assert linalg.cholesky(pad(P), 3, upper)
    np.testing.assert_allclose(upper[:, :3].T @ upper[:, :3], P, atol=1e-12)
    assert linalg.cholesky(np.zeros((2, 8)), 2, np.zeros((2, 8)))
    upper = np.zeros((2, 8))
    assert not linalg.cholesky(pad([[1.0, 2.0], [2.0, 1.0]]), 2, upper)
    assert np.isfinite(upper).all()
    assert not linalg.cholesky(pad([[np.nan, 0.0], [0.0, 1.0]]), 2, upper)
    assert not linalg.cholesky(pad([[-1.0]]), 1, np.zeros((1, 8)))


@pytest.mark.parametrize("n", SIZES)
def test_products_equal_numpy(n):
    rng = np.random.default_rng(n)
    P, Q, F = spd(rng, n), spd(rng, n), rng.normal(size=(n, n))
    out, product, mean = np.zeros_like(pad(P)), np.zeros_like(pad(P)), np.zeros(pad(P).shape[1])
    m = rng.normal(size=n)
    predict_linear(pad(m), pad(P), pad(F.T), pad(Q), n, product, mean, out)
    np.testing.assert_allclose(out[:, :n], F @ P @ F.T + Q, atol=1e-12)
    np.testing.assert_allclose(mean[:n], F @ m, atol=1e-13)
    left, right = rng.normal(size=(4, n)), rng.normal(size=(4, n))
    linalg.outer_add(out, pad(left), pad(right), 1, 4, -0.5, n)
    np.testing.assert_allclose(out[:, :n], F @ P @ F.T + Q - 0.5 * left[1:].T @ right[1:], atol=1e-12)
    linalg.mirror(out, n)
    np.testing.assert_array_equal(out[:, :n], np.triu(out[:, :n]) + np.triu(out[:, :n], 1).T)
    stack = np.array([P, np.full((n, n), np.nan), Q])
    linalg.average(pad(stack), np.array([0.25, 0.0, 0.75]), 3, n, out)
    np.testing.assert_allclose(out[:, :n], 0.25 * P + 0.75 * Q, atol=1e-13)
    assert linalg.total(pad(P), n) == pytest.approx(P.sum(), abs=1e-11)
    assert not np.isfinite(linalg.total(pad(stack[1]), n))


def test_wrap_angle_is_the_same_angle_in_the_half_open_circle():
    for angle in [0.0, 3.0, -3.0, np.pi, -np.pi, 3.2, -3.2, 7 * np.pi, 1e4, -1e4]:
        wrapped = linalg.wrap_angle(angle)
        assert -np.pi < wrapped <= np.pi
        assert np.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)
    assert linalg.wrap_angle(-np.pi) == pytest.approx(np.pi)


def test_sigma_weights_equal_the_published_ones():
    # (n, alpha, beta, kappa) -> (radius^2, centre weight of the covariance, every other weight)
    for given, wanted in {
        (4, 0.01, 2.0, 0.0): (4e-4, -9996.0001, 1250.0),
        (3, 1.0, 0.0, 0.0): (3.0, 0.0, 1 / 6),
    }.items():
        radius, centre, other = point_weights(*given)
        assert (radius**2, centre, other) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("n", SIZES)
def test_points_keep_the_moments_they_were_drawn_from(n):
    rng = np.random.default_rng(n)
    P, m = spd(rng, n), rng.normal(size=n)
    upper, points = np.zeros_like(pad(P)), np.zeros((2 * n + 1, pad(m).size))
    linalg.cholesky(pad(P), n, upper)
    radius, centre, other = point_weights(n, 0.5, 2.0, 1.0)
    draw_points(pad(m), upper, n, radius, points)
    mean, cov = np.zeros(pad(m).size), np.zeros_like(pad(P))
    points_mean(points, 2 * n + 1, n, other, mean)
    points_covariance(points, 2 * n + 1, n, centre, other, cov)
    np.testing.assert_allclose(mean[:n], m, atol=1e-13)
    np.testing.assert_allclose(cov[:, :n], P, atol=1e-12)


def test_a_square_has_the_analytic_moments():
    m, P, beta = 1.3, 0.4, 2.0
    radius, centre, other = point_weights(1, 0.7, beta, 0.0)
    points = np.zeros((3, 8))
    draw_points(pad([m]), pad([[np.sqrt(P)]]), 1, radius, points)
    points **= 2
    mean, cov = np.zeros(8), np.zeros((1, 8))
    points_mean(points, 3, 1, other, mean)
    points_covariance(points, 3, 1, centre, other, cov)
    assert mean[0] == pytest.approx(m**2 + P, rel=1e-13)
    assert cov[0, 0] == pytest.approx(4 * m**2 * P + beta * P**2, rel=1e-12)


def gaussian(m, P, H, R, z):
    """`gaussian_update` with ordinary arrays, and the sum of squares where it says that digits were lost."""
    d, n = H.shape
    cross, S = pad(H @ P), pad(H @ P @ H.T + R)
    factor, gain = np.zeros((d, S.shape[1])), np.zeros_like(cross)
    m_out, P_out = np.zeros(n), np.zeros_like(pad(P))
    log_density, nis, good, lost = gaussian_update(
        m, pad(P), pad(R), cross, S, z - H @ m, d, n, factor, gain, np.zeros((d, 8)), m_out, P_out
    )
    if lost:
        root = np.zeros_like(pad(P))
        linalg.cholesky(pad(P), n, root)
        seen = pad(root[:, :n] @ H.T)
        posterior_from_deviations(root, seen, n, 1.0, 1.0, pad(R), cross, factor, d, n, gain, P_out)
    return m_out, P_out[:, :n], log_density, nis, good


@pytest.mark.parametrize(("n", "d"), [(1, 1), (4, 2), (7, 3), (9, 2), (13, 9)])
def test_update_equals_the_textbook(n, d):
    rng = np.random.default_rng(n)
    m, P, R, H, z = rng.normal(size=n), spd(rng, n), spd(rng, d), rng.normal(size=(d, n)), rng.normal(size=d)
    mean, cov, log_density, nis, good = gaussian(m, P, H, R, z)
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    assert good
    np.testing.assert_allclose(mean, m + K @ (z - H @ m), atol=1e-11)
    np.testing.assert_allclose(cov, (np.eye(n) - K @ H) @ P, atol=1e-11)
    np.testing.assert_array_equal(cov, cov.T)
    assert log_density == pytest.approx(stats.multivariate_normal(H @ m, S).logpdf(z), rel=1e-11)
    assert nis == pytest.approx((z - H @ m) @ np.linalg.solve(S, z - H @ m), rel=1e-11)


def test_both_forms_of_the_posterior_agree_where_nothing_cancels():
    rng = np.random.default_rng(0)
    n, d = 7, 2
    P, R, H = spd(rng, n), spd(rng, d), rng.normal(size=(d, n))
    root, factor, out = np.zeros_like(pad(P)), np.zeros((d, 8)), np.zeros_like(pad(P))
    linalg.cholesky(pad(P), n, root)
    linalg.cholesky(pad(H @ P @ H.T + R), d, factor)
    seen = pad(root[:, :n] @ H.T)
    posterior_from_deviations(root, seen, n, 1.0, 1.0, pad(R), pad(H @ P), factor, d, n, np.zeros((d, 8)), out)
    _, cov, *_ = gaussian(np.zeros(n), P, H, R, np.zeros(d))
    np.testing.assert_allclose(out[:, :n], cov, atol=1e-11)


def test_scalar_steady_state_is_the_golden_ratio():
    mean, cov = np.zeros(1), np.eye(1)
    for _ in range(60):
        mean, cov, *_ = gaussian(mean, cov + 1.0, np.eye(1), np.eye(1), np.ones(1))
    golden = (1 + np.sqrt(5)) / 2
    assert cov[0, 0] == pytest.approx(golden - 1, rel=1e-12)  # K = P with R = 1
    assert cov[0, 0] + 1.0 == pytest.approx(golden, rel=1e-12)


def test_a_sharp_measurement_of_a_vague_state_keeps_its_variance():
    # The short form P - K S K' leaves 1e-8 of rounding here, ten orders above the truth.
    P = np.array([[1e8, 5e7], [5e7, 1e8]])
    _, cov, *_ = gaussian(np.zeros(2), P, np.array([[1.0, 0.0]]), np.array([[1e-18]]), np.array([3.0]))
    assert cov[0, 0] == pytest.approx(1e-18, rel=1e-6, abs=0.0)
    assert cov[1, 1] == pytest.approx(7.5e7, rel=1e-9)
    assert cov[0, 1] == pytest.approx(0.5e-18, rel=1e-3, abs=0.0)


def test_an_impossible_innovation_covariance_is_reported_and_changes_nothing():
    P = np.eye(2)
    mean, cov, log_density, nis, good = gaussian(
        np.array([1.0, 2.0]), P, np.array([[1.0, 0.0]]), np.array([[-5.0]]), np.array([3.0])
    )
    assert not good and log_density == -np.inf and nis == 0.0
    np.testing.assert_array_equal(mean, [1.0, 2.0])
    np.testing.assert_array_equal(cov, P)
