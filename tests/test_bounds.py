"""Bounds and steady-state references against published, closed-form and brute-force values."""

import numpy as np
import pytest

from jink.estimators.bounds import (
    alpha_beta_gains,
    best_fitting_gaussian,
    information_recursion,
    mismatched_errors,
    monte_carlo_bound,
    riccati_bound,
    scalar_steady_kf,
    stationary_mode_probs,
    steady_kf,
)

# Scenario N1 of the design notes: a position-velocity state with three accelerations.
N1_F = np.array([[1.0, 1.0], [0.0, 1.0]])
N1_G = np.array([[0.5], [1.0]])
N1_H = np.array([[1.0, 0.0]])
N1_R = np.array([[100.0**2]])
N1_PI = np.full((3, 3), 0.1) + 0.7 * np.eye(3)
N1_ACCELERATIONS = (0.0, 20.0, -20.0)

B5_F = np.array([[0.9802, 0.0196], [0.0, 0.9802]])
B5_Q = np.array([[1.9608, 0.0195], [0.0195, 1.9605]])
B5_H = np.array([[1.0, -1.0]])
B5_R = np.eye(1)


def n1_best_fit(steps: int, mode_probs: tuple[float, float, float] = (0.8, 0.1, 0.1)):
    noise = 4.0 * N1_G @ N1_G.T
    inputs = np.array([(N1_G * a)[:, 0] for a in N1_ACCELERATIONS])
    return best_fitting_gaussian(
        np.stack([N1_F] * 3),
        inputs,
        np.stack([noise] * 3),
        N1_PI,
        mode_probs,
        N1_H,
        N1_R,
        np.array([80000.0, 400.0]),
        np.diag([1e4, 1e4]),
        steps,
    )


def test_n1_oracle_and_best_fitting_gaussian():
    oracle = riccati_bound(N1_F, 4.0 * N1_G @ N1_G.T, N1_H, N1_R, np.diag([1e4, 1e4]), 200)
    assert np.sqrt(np.trace(oracle[-1])) == pytest.approx(43.01, abs=0.005)  # printed digits
    fit = n1_best_fit(200)
    assert np.sqrt(np.trace(fit.bound[-1])) == pytest.approx(71.92, abs=0.005)
    assert fit.mode_probs[1] == pytest.approx([0.66, 0.17, 0.17])


def test_best_fit_equals_the_literal_moment_formula():
    rng = np.random.default_rng(4)
    modes, n = 3, 2
    F = rng.normal(size=(modes, n, n))
    u = rng.normal(size=(modes, n))
    Q = np.stack([a @ a.T for a in rng.normal(size=(modes, n, n))])
    Pi = rng.dirichlet(np.ones(modes), size=modes)
    p, m, C = rng.dirichlet(np.ones(modes)), rng.normal(size=n), np.diag([2.0, 0.5])
    fit = best_fitting_gaussian(F, u, Q, Pi, p, np.eye(n), np.eye(n), m, C, 5)
    for k in range(4):
        phi = sum(p[r] * F[r] for r in range(modes))
        after = sum(p[r] * (F[r] @ m + u[r]) for r in range(modes))
        sigma = -phi @ C @ phi.T - np.outer(after, after)
        for r in range(modes):
            cross = np.outer(F[r] @ m, u[r])
            second = F[r] @ (C + np.outer(m, m)) @ F[r].T + cross + cross.T + np.outer(u[r], u[r])
            sigma = sigma + p[r] * (second + Q[r])
        assert fit.process_noise[k] == pytest.approx(sigma, rel=1e-9, abs=1e-9)
        C, m = phi @ C @ phi.T + sigma, after
        p = np.array([sum(p[i] * Pi[i, j] for i in range(modes)) for j in range(modes)])
        assert fit.cov[k + 1] == pytest.approx(C, rel=1e-9)
        assert fit.mean[k + 1] == pytest.approx(m, rel=1e-9)
        assert fit.mode_probs[k + 1] == pytest.approx(p)


def test_best_fit_matches_the_moments_of_simulated_jumps():
    # Two moves only: with one move per mode draw the independence of mode and state is exact.
    rng = np.random.default_rng(1)
    runs, p = 400_000, np.array([0.5, 0.3, 0.2])
    fit = n1_best_fit(2, tuple(p))
    mode = rng.choice(3, size=runs, p=p)
    x = rng.normal([80000.0, 400.0], 100.0, size=(runs, 2))
    push = np.asarray(N1_ACCELERATIONS)[mode] + rng.normal(0.0, 2.0, runs)
    x = x @ N1_F.T + push[:, None] * N1_G[:, 0]
    assert x.mean(axis=0) == pytest.approx(fit.mean[1], abs=5 * 142 / np.sqrt(runs))
    # Relative error of a sample covariance is about sqrt(2 / runs) = 0.002.
    assert np.cov(x.T) == pytest.approx(fit.cov[1], rel=0.012)


def test_best_fit_with_one_mode_is_the_riccati_bound():
    Q = np.array([[0.25, 0.5], [0.5, 1.0]])
    one = best_fitting_gaussian([N1_F], [[1.0, 2.0]], [Q], [[1.0]], [1.0], N1_H, N1_R, [5.0, 1.0], np.eye(2), 9)
    assert one.bound == pytest.approx(riccati_bound(N1_F, Q, N1_H, N1_R, np.eye(2), 9), rel=1e-12)


def test_riccati_bound_order_detection_and_shift():
    F, Q, H, R = np.array([[2.0]]), np.array([[3.0]]), np.array([[1.0]]), np.array([[4.0]])
    # Prior 12: update 12*4/16 = 3; predict 4*3+3 = 15; update 15*4/19.
    assert riccati_bound(F, Q, H, R, [[12.0]], 2)[:, 0, 0] == pytest.approx([3.0, 60.0 / 19.0])
    missed = riccati_bound(F, Q, H, R, [[12.0]], 2, detected=[True, False])
    assert missed[:, 0, 0] == pytest.approx([3.0, 15.0])
    # Prior 12 one step earlier: predict 51; update 51*4/55.
    assert riccati_bound(F, Q, H, R, [[12.0]], 1, predict_first=True)[0, 0, 0] == pytest.approx(204.0 / 55.0)


def test_riccati_bound_follows_time_varying_matrices():
    rng = np.random.default_rng(3)
    steps, n = 6, 2
    F = rng.normal(size=(steps - 1, n, n))
    Q = np.stack([np.eye(n) * s for s in rng.uniform(0.5, 2, steps - 1)])
    H = rng.normal(size=(steps, 1, n))
    R = rng.uniform(0.5, 2, size=(steps, 1, 1))
    bound = riccati_bound(F, Q, H, R, np.eye(n), steps)
    # Second opinion: condition the joint Gaussian of the last state on all measurements at once.
    mean_maps = [np.eye(n)]
    for f in F:
        mean_maps.append(f @ mean_maps[-1])
    noise = np.zeros((steps * n, steps * n))
    lower = np.zeros((steps * n, steps * n))
    for k in range(steps):
        noise[k * n : k * n + n, k * n : k * n + n] = np.eye(n) if k == 0 else Q[k - 1]
        block = np.eye(n)
        for j in range(k, -1, -1):
            lower[k * n : k * n + n, j * n : j * n + n] = block
            if j:
                block = block @ F[j - 1]
    joint = lower @ noise @ lower.T
    big_h = np.zeros((steps, steps * n))
    for k in range(steps):
        big_h[k, k * n : k * n + n] = H[k, 0]
    S = big_h @ joint @ big_h.T + np.diag(R[:, 0, 0])
    posterior = joint - joint @ big_h.T @ np.linalg.solve(S, big_h @ joint)
    assert bound[-1] == pytest.approx(posterior[-n:, -n:], rel=1e-9)


def test_information_recursion_is_a_schur_complement():
    rng = np.random.default_rng(8)
    n, moves = 2, 3
    d11 = np.stack([a @ a.T for a in rng.normal(size=(moves, n, n))])
    d12 = rng.normal(size=(moves, n, n))
    d22 = np.stack([20.0 * np.eye(n)] * moves)
    J0 = np.array([[10.0, 1.0], [1.0, 12.0]])
    full = np.zeros(((moves + 1) * n, (moves + 1) * n))
    full[:n, :n] = J0
    for k in range(moves):
        a, b = slice(k * n, k * n + n), slice(k * n + n, k * n + 2 * n)
        full[a, a] += d11[k]
        full[b, b] += d22[k]
        full[a, b] += d12[k]
        full[b, a] += d12[k].T
    want = np.linalg.inv(np.linalg.inv(full)[-n:, -n:])
    assert information_recursion(J0, d11, d12, d22)[-1] == pytest.approx(want, rel=1e-9)


def test_monte_carlo_bound_is_riccati_when_linear():
    Q, R, P0 = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([[3.0]]), np.diag([5.0, 2.0])
    states = np.random.default_rng(0).normal(size=(4, 7, 2))
    got = monte_carlo_bound(states, lambda x, k: N1_F, Q, lambda x, k: N1_H, R, P0)
    assert got == pytest.approx(riccati_bound(N1_F, Q, N1_H, R, P0, 7), rel=1e-9)


def test_monte_carlo_bound_averages_range_information():
    # One step, range from the origin: H = x'/|x|, so the mean information is that of the mean of H'H.
    states = np.array([[[3.0, 4.0]], [[0.0, 2.0]]])
    got = monte_carlo_bound(
        states,
        lambda x, k: np.eye(2),
        np.eye(2),
        lambda x, k: x[None] / np.linalg.norm(x),
        [[0.5]],
        np.eye(2),
    )
    seen = np.outer([0.6, 0.8], [0.6, 0.8]) + np.outer([0.0, 1.0], [0.0, 1.0])
    assert got[0] == pytest.approx(np.linalg.inv(np.eye(2) + seen))


def test_monte_carlo_bound_uses_each_jacobian_at_its_own_time():
    # Scalar, F depends on x_k and H on k; D11 and D12 must use x_0, not x_1.
    states = np.array([[[2.0], [5.0]], [[4.0], [7.0]]])
    got = monte_carlo_bound(states, lambda x, k: x[None], [[0.5]], lambda x, k: np.array([[1.0 + k]]), [[1.0]], [[1.0]])
    J0 = 1.0 + 1.0
    d11, d12, d22 = (4.0 + 16.0) / 2 / 0.5, -3.0 / 0.5, 1 / 0.5 + 4.0
    assert 1.0 / got[:, 0, 0] == pytest.approx([J0, d22 - d12**2 / (J0 + d11)])


def test_scalar_golden_ratio_and_general_riccati():
    assert scalar_steady_kf(1.0, 1.0) == pytest.approx((1.618034, 0.618034), abs=5e-7)
    for q, r in ((0.3, 2.0), (50.0, 0.1)):
        filter_ = steady_kf([[1.0]], [[q]], [[1.0]], [[r]])
        P, K = scalar_steady_kf(q, r)
        assert (filter_.predicted_cov[0, 0], filter_.gain[0, 0]) == pytest.approx((P, K), rel=1e-9)


@pytest.mark.parametrize(
    ("index", "alpha", "beta"),
    [(0.1, 0.36, 0.08), (0.5, 0.628373, 0.304806), (1.0, 0.75, 0.5), (2.0, 0.854102, 0.763932)],
)
def test_alpha_beta_table_and_riccati(index, alpha, beta):
    assert alpha_beta_gains(index) == pytest.approx((alpha, beta), abs=5e-7)
    T, sigma_z = 2.0, 3.0
    push = np.array([[0.5 * T * T], [T]]) * index * sigma_z / T**2
    filter_ = steady_kf([[1.0, T], [0.0, 1.0]], push @ push.T, [[1.0, 0.0]], [[sigma_z**2]])
    assert filter_.gain[:, 0] * [1.0, T] == pytest.approx(alpha_beta_gains(index), rel=1e-6)


@pytest.mark.parametrize(("delta", "want"), [(-0.3, 551.2255), (0.0, 36.0205), (0.3, 8352.7649)])
def test_n5_prediction_error_of_the_nominal_filter(delta, want):
    F = np.array([[0.0, -0.5], [1.0, 1.0]])
    G, H, R = np.array([[-6.0], [1.0]]), np.array([[-100.0, 10.0]]), np.eye(1)
    nominal = steady_kf(F, G @ G.T, H, R)
    true_F = F + np.array([[0.0, 0.0], [0.0, delta]])
    errors = mismatched_errors(true_F, G @ G.T, H, R, nominal.gain, F)
    assert errors.predicted[0, 0] == pytest.approx(want, abs=6e-5)  # printed digits


def test_b5_kalman_filter():
    got = steady_kf(B5_F, B5_Q, B5_H, B5_R)
    want = np.array([[41.832422, 41.25081], [41.25081, 41.493159]])
    assert got.filtered_cov == pytest.approx(want, abs=2e-6)
    assert got.gain[:, 0] == pytest.approx([0.581613, -0.242349], abs=1e-6)
    assert got.innovation_cov[0, 0] == pytest.approx(5.680584, abs=1e-6)


@pytest.mark.parametrize(
    ("delta", "optimal", "plain", "robust"),
    [
        (-1.0, 16.11, 90.74, 39.28),
        (-0.8508, 18.44, 66.94, 45.69),
        (-0.5, 28.22, 42.34, 63.17),
        (0.0, 83.33, 83.33, 93.97),
        (0.5, 88.56, 213.71, 131.66),
        (1.0, 65.42, 433.48, 176.26),
    ],
)
def test_b5_filtered_error_under_a_wrong_transition(delta, optimal, plain, robust):
    true_F = B5_F + delta * np.outer([0.0198, 0.0], [0.0, 5.0])
    best = steady_kf(true_F, B5_Q, B5_H, B5_R)
    assert np.trace(best.filtered_cov) == pytest.approx(optimal, abs=0.006)
    nominal = steady_kf(B5_F, B5_Q, B5_H, B5_R)
    kf = mismatched_errors(true_F, B5_Q, B5_H, B5_R, nominal.gain, B5_F)
    assert np.trace(kf.filtered) == pytest.approx(plain, abs=0.006)
    robust_F, gain = np.array([[0.9802, -0.084629], [0.0, 0.876218]]), np.array([[0.499346], [-0.426742]])
    sayed = mismatched_errors(true_F, B5_Q, B5_H, B5_R, gain, robust_F)
    assert np.trace(sayed.filtered) == pytest.approx(robust, abs=0.01)


def test_mismatched_errors_against_simulation():
    rng = np.random.default_rng(5)
    F, Ff = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.8, 0.3], [0.0, 0.9]])
    H, Hf, Q, R = np.array([[1.0, 0.3]]), np.array([[1.1, 0.0]]), np.diag([1.0, 0.5]), np.array([[2.0]])
    K = np.array([[0.4], [0.1]])
    want = mismatched_errors(F, Q, H, R, K, Ff, Hf)
    runs = 60_000
    x, guess = np.zeros((runs, 2)), np.zeros((runs, 2))
    for _ in range(80):
        error = x - guess
        z = x @ H.T + rng.normal(0.0, np.sqrt(2.0), (runs, 1))
        updated = guess + (z - guess @ Hf.T) @ K.T
        after = x - updated
        x = x @ F.T + rng.normal(size=(runs, 2)) * np.sqrt([1.0, 0.5])
        guess = updated @ Ff.T
    # Five standard errors of a sample variance, sqrt(2 / runs) = 0.0058, on the largest entry.
    for sample, exact in ((error, want.predicted), (after, want.filtered)):
        assert sample.T @ sample / runs == pytest.approx(exact, abs=0.029 * exact.max())


def test_mismatched_errors_without_mismatch_allow_an_unstable_system():
    F, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.eye(2)
    nominal = steady_kf(F, Q, N1_H, np.eye(1))
    errors = mismatched_errors(F, Q, N1_H, np.eye(1), nominal.gain, F)
    assert errors.predicted == pytest.approx(nominal.predicted_cov, rel=1e-9)
    assert errors.filtered == pytest.approx(nominal.filtered_cov, rel=1e-9)
    with pytest.raises(ValueError, match="spectral radius"):
        mismatched_errors(F, Q, N1_H, np.eye(1), nominal.gain, 0.9 * F)


def test_stationary_mode_probs_use_rows_as_from():
    # Leaves mode 0 rarely and mode 1 often: mu = (0.8, 0.2); the transpose would not even be stochastic.
    assert stationary_mode_probs([[0.9, 0.1], [0.4, 0.6]]) == pytest.approx([0.8, 0.2])
    with pytest.raises(ValueError, match=r"mode_transition must be .* transpose"):
        stationary_mode_probs([[0.9, 0.4], [0.1, 0.6]])


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: scalar_steady_kf(-1.0, 1.0), "scalar_steady_kf: both noises must be positive"),
        (lambda: alpha_beta_gains(0.0), "alpha_beta_gains: tracking_index must be positive"),
        (
            lambda: riccati_bound(np.eye(2), np.eye(3), N1_H, N1_R, np.eye(2), 3),
            "process_noise must be finite",
        ),
        (lambda: riccati_bound(np.eye(2), np.eye(2), N1_H, N1_R, np.eye(2), 0), "steps must be >= 1"),
        (lambda: riccati_bound(N1_F, np.eye(2), N1_H, N1_R, np.eye(2), 3, detected=[True]), "detected must"),
        (lambda: steady_kf(2 * np.eye(2), np.eye(2), N1_H, N1_R), "steady_kf: the model must be detectable"),
        (
            lambda: monte_carlo_bound(
                np.zeros((1, 2, 2)), lambda x, k: N1_F, N1_G @ N1_G.T, lambda x, k: N1_H, N1_R, np.eye(2)
            ),
            "process_noise must be positive definite",
        ),
    ],
)
def test_bad_input_is_one_clear_sentence(call, match):
    with pytest.raises(ValueError, match=match):
        call()
