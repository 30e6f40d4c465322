"""Sayed's robust filter: against the problem it solves, its published formulas, and the Kalman filter."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from jink.estimators.robust import RobustFilter

EXAMPLE = {
    "transition": [[0.9802, 0.0196], [0.0, 0.9802]],
    "observation": [[1.0, -1.0]],
    "process_noise": [[1.9608, 0.0195], [0.0195, 1.9605]],
    "measurement_noise": [[1.0]],
    "error": [[0.0198], [0.0]],
    "excitation": [[0.0, 5.0]],
}


def spd(rng, n):
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)


def random_filter(rng, n=3, m=2, d=2, q=2, t=2, **options):
    return RobustFilter(
        rng.normal(size=(n, n)), rng.normal(size=(d, n)), spd(rng, m), spd(rng, d), rng.normal(size=(n, q)),
        rng.normal(size=(t, n)), **{"noise_gain": rng.normal(size=(n, m)), "noise_excitation": rng.normal(size=(t, m)),
                                    **options},
    )  # fmt: skip


class Problem:
    """The regularised least squares problem with bounded uncertainty, solved as it stands."""

    def __init__(self, robust, x, P, y):
        F, G, H, M = robust.transition, robust.noise_gain, robust.observation, robust.error
        n, m = G.shape
        self.x, self.robust = x, robust
        self.weight = np.linalg.inv(np.block([[P, np.zeros((n, m))], [np.zeros((m, n)), robust.process_noise]]))
        self.A, self.b, self.HM = H @ np.hstack([F, G]), y - H @ F @ x, H @ M
        self.Ea, self.Eb = np.hstack([robust.excitation, robust.noise_excitation]), -robust.excitation @ x
        self.W = np.linalg.inv(robust.measurement_noise)

    def solve(self, regulation):
        inner = np.linalg.pinv(regulation * np.eye(self.HM.shape[1]) - self.HM.T @ self.W @ self.HM)
        W = self.W + self.W @ self.HM @ inner @ self.HM.T @ self.W
        left = self.weight + regulation * self.Ea.T @ self.Ea + self.A.T @ W @ self.A
        s = np.linalg.solve(left, self.A.T @ W @ self.b + regulation * self.Ea.T @ self.Eb)
        off, excited = self.A @ s - self.b, self.Ea @ s - self.Eb
        return s, s @ self.weight @ s + regulation * excited @ excited + off @ W @ off

    def mean(self, s):
        n = len(self.x)
        return self.robust.transition @ (self.x + s[:n]) + self.robust.noise_gain @ s[n:]

    def cost(self, s, delta):
        off = self.A @ s - self.b + self.HM @ delta @ (self.Ea @ s - self.Eb)
        return s @ self.weight @ s + off @ self.W @ off


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("driven", [True, False])
def test_a_step_solves_the_problem(seed, driven):
    rng = np.random.default_rng(seed)
    robust = random_filter(rng, **({} if driven else {"noise_excitation": None}))
    x, P, y = rng.normal(size=3), spd(rng, 3), rng.normal(size=2)
    step = robust.step_filtered(x, P, y)
    problem = Problem(robust, x, P, y)
    bound = np.linalg.norm(problem.HM.T @ problem.W @ problem.HM, 2)
    assert robust.bound == pytest.approx(bound, rel=1e-12)
    assert step.regulation == pytest.approx(1.5 * bound, rel=1e-12)
    s, cost = problem.solve(step.regulation)
    np.testing.assert_allclose(step.mean, problem.mean(s), atol=1e-12 * max(1.0, np.abs(step.mean).max()))
    assert step.cost == pytest.approx(cost, rel=1e-10)


def corrected(robust, P, regulation):
    """The corrected parameters as published (A4)."""
    F, G, H, M = robust.transition, robust.noise_gain, robust.observation, robust.error
    E, Eg, Q, R = robust.excitation, robust.noise_excitation, robust.process_noise, robust.measurement_noise
    inner = np.linalg.inv(np.eye(len(E)) + regulation * E @ P @ E.T)
    Q_hat = np.linalg.inv(np.linalg.inv(Q) + regulation * Eg.T @ inner @ Eg)
    P_hat = np.linalg.inv(np.linalg.inv(P) + regulation * E.T @ E)
    G_hat = G - regulation * F @ P_hat @ E.T @ Eg
    F_hat = (F - regulation * G_hat @ Q_hat @ Eg.T @ E) @ (np.eye(len(F)) - regulation * P_hat @ E.T @ E)
    return F_hat, G_hat, P_hat, Q_hat, R - H @ M @ M.T @ H.T / regulation


@pytest.mark.parametrize("seed", range(4))
def test_both_forms_are_the_published_formulas(seed):
    rng = np.random.default_rng(seed)
    robust = random_filter(rng)
    F, H = robust.transition, robust.observation
    x, P, y = rng.normal(size=3), spd(rng, 3), rng.normal(size=2)
    step = robust.step_filtered(x, P, y)
    F_hat, G_hat, P_hat, Q_hat, R_hat = corrected(robust, P, step.regulation)
    P_minus = F @ P_hat @ F.T + G_hat @ Q_hat @ G_hat.T
    scale = max(1.0, np.abs(P_minus).max())
    np.testing.assert_allclose(step.predicted_mean, F_hat @ x, atol=1e-12 * scale)
    np.testing.assert_allclose(step.predicted_cov, P_minus, atol=1e-12 * scale)
    P_plus = P_minus - P_minus @ H.T @ np.linalg.inv(R_hat + H @ P_minus @ H.T) @ H @ P_minus
    np.testing.assert_allclose(step.cov, P_plus, atol=1e-11 * scale)
    gain = P_plus @ H.T @ np.linalg.inv(R_hat)
    np.testing.assert_allclose(step.mean, F_hat @ x + gain @ (y - H @ F_hat @ x), atol=1e-10 * scale)

    step = robust.step_predicted(x, P, y)
    P_kk = P - P @ H.T @ np.linalg.inv(R_hat + H @ P @ H.T) @ H @ P
    x_kk = x + P_kk @ H.T @ np.linalg.inv(R_hat) @ (y - H @ x)
    F_hat, G_hat, P_hat, Q_hat, _ = corrected(robust, P_kk, step.regulation)
    np.testing.assert_allclose(step.mean, x_kk, atol=1e-10 * scale)
    np.testing.assert_allclose(step.predicted_mean, F_hat @ x_kk, atol=1e-10 * scale)
    np.testing.assert_allclose(step.predicted_cov, F @ P_hat @ F.T + G_hat @ Q_hat @ G_hat.T, atol=1e-10 * scale)


def test_the_optimal_regulation_gives_the_value_of_the_game():
    rng = np.random.default_rng(1)
    for _ in range(3):
        robust = random_filter(rng, q=1, t=1, optimise=True)
        x, P, y = rng.normal(size=3), spd(rng, 3), 3.0 * rng.normal(size=2)
        step, problem = robust.step_filtered(x, P, y), Problem(robust, x, P, y)
        s, cost = problem.solve(step.regulation)
        # For one number Delta in -1 .. 1 the cost is convex in it, so its largest value is at an end.
        worst = max(problem.cost(s, np.array([[delta]])) for delta in np.linspace(-1.0, 1.0, 201))
        assert step.cost == pytest.approx(cost, rel=1e-9)
        assert worst == pytest.approx(step.cost, rel=1e-6)  # the search stops at 1e-9 of ln(lambda)
        for _ in range(200):  # no other estimate does better
            other = s + 0.1 * rng.normal(size=len(s))
            assert max(problem.cost(other, np.array([[d]])) for d in (-1.0, 1.0)) >= worst - 1e-6 * abs(worst)


@pytest.mark.parametrize(
    "change", [{"error": np.zeros((2, 1))}, {"error": [[1.0], [1.0]]}, {"excitation": np.zeros((1, 2))}]
)
def test_an_error_nobody_sees_or_excites_leaves_the_kalman_filter(change):
    robust = RobustFilter(**{**EXAMPLE, **change})
    F, H, Q = (np.array(EXAMPLE[name]) for name in ("transition", "observation", "process_noise"))
    m, P = np.array([1.0, -2.0]), np.eye(2)
    for z in np.sin(np.arange(50.0)):
        step = robust.step_filtered(m, P, [z])
        m, P = F @ m, F @ P @ F.T + Q
        K = P @ H.T / (H @ P @ H.T + 1.0)
        m, P = m + K @ ([z] - H @ m), P - K @ H @ P
        assert step.regulation == 0.0
        np.testing.assert_allclose(step.mean, m, atol=1e-12)
        np.testing.assert_allclose(step.cov, P, atol=1e-12 * np.abs(P).max())
        m, P = step.mean, step.cov


def steady(robust):
    P = np.eye(2)
    for _ in range(3000):
        step = robust.step_filtered(np.zeros(2), P, [0.0])
        P = step.cov
    columns = [robust.step_filtered(unit, P, [0.0]) for unit in np.eye(2)]
    return step, np.array([column.predicted_mean for column in columns]).T


def true_error(F_hat, gain, delta):
    """Steady filtered mean square error (trace) of a fixed filter when the plant's Delta is ``delta``."""
    F, H = np.array(EXAMPLE["transition"]), np.array(EXAMPLE["observation"])
    plant = F + delta * np.array(EXAMPLE["error"]) @ np.array(EXAMPLE["excitation"])
    keep = np.eye(2) - gain @ H
    # Of (x, x - estimate): x+ = plant x + u; estimate+ = keep F^ estimate + gain (H x+ + v).
    A = np.block([[plant, np.zeros((2, 2))], [keep @ (plant - F_hat), keep @ F_hat]])
    drive = np.vstack([np.eye(2), keep])
    noise = np.zeros((4, 4))
    noise[2:, 2:] = gain @ gain.T
    cov = solve_discrete_lyapunov(A, drive @ np.array(EXAMPLE["process_noise"]) @ drive.T + noise)
    return np.trace(cov[2:, 2:])


def test_published_example():
    robust = RobustFilter(**EXAMPLE)
    step, F_hat = steady(robust)
    assert robust.bound == pytest.approx(3.9204e-4, rel=1e-12)
    np.testing.assert_allclose(step.predicted_cov, [[9.220773, 6.968793], [6.968793, 8.893336]], atol=1e-6)
    np.testing.assert_allclose(F_hat, [[0.9802, -0.084629], [0.0, 0.876218]], atol=1e-6)
    H = np.array(EXAMPLE["observation"])
    gain = step.predicted_cov @ H.T / (1.0 / 3.0 + H @ step.predicted_cov @ H.T)
    np.testing.assert_allclose(gain[:, 0], [0.499346, -0.426742], atol=1e-6)

    plain, F_plain = steady(RobustFilter(**{**EXAMPLE, "error": np.zeros((2, 1))}))
    np.testing.assert_allclose(plain.cov, [[41.832422, 41.25081], [41.25081, 41.493159]], atol=1e-5)
    plain_gain = plain.predicted_cov @ H.T / (1.0 + H @ plain.predicted_cov @ H.T)
    table = {
        -1.0: (90.74, 39.28),
        -0.8508: (66.94, 45.69),
        0.0: (83.33, 93.97),
        0.5: (213.71, 131.66),
        1.0: (433.48, 176.26),
    }
    for delta, (kalman, robust_error) in table.items():
        assert true_error(F_plain, plain_gain, delta) == pytest.approx(kalman, abs=0.006)
        assert true_error(F_hat, gain, delta) == pytest.approx(robust_error, abs=0.006)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"error": [[1.0]]}, r"RobustFilter: error must be finite with shape \(2, 1\); got shape \(1, 1\)"),
        ({"excitation": [[np.nan, 1.0]]}, "RobustFilter: excitation must be finite"),
        ({"alpha": 0.0}, "RobustFilter: alpha must be > 0"),
        ({"error": 1.0}, "RobustFilter: error must be finite with shape"),
        ({"transition": 3.0}, "RobustFilter: transition must be finite with shape"),
        ({"transition": "a"}, "RobustFilter: transition must be a matrix of numbers; got 'a'"),
        ({"alpha": "a"}, "RobustFilter: alpha must be > 0 and finite; got 'a'"),
        ({"optimise": "no"}, "RobustFilter: optimise must be True or False; got 'no'"),
        ({"measurement_noise": [[-1.0]]}, "RobustFilter: measurement_noise must be a covariance, positive definite"),
        ({"process_noise": [[1.0, 5.0], [5.0, 1.0]]}, "process_noise must be a covariance, positive semidefinite"),
        ({"process_noise": [[1.0, 0.5], [0.0, 1.0]]}, "got one that is not symmetric"),
    ],
)
def test_bad_models_are_refused(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        RobustFilter(**{**EXAMPLE, **change})


def test_bad_steps_are_refused():
    robust = RobustFilter(**EXAMPLE)
    with pytest.raises(ValueError, match=r"step_filtered: measurement must be finite with shape \(1,\)"):
        robust.step_filtered(np.zeros(2), np.eye(2), [np.nan])
    with pytest.raises(ValueError, match="step_predicted: cov must be a covariance, positive semidefinite; got eigenv"):
        robust.step_predicted(np.zeros(2), -np.eye(2), [0.0])
    with pytest.raises(ValueError, match=r"step_predicted: mean must be finite with shape \(2,\)"):
        robust.step_predicted(np.zeros(3), np.eye(2), [0.0])
