"""Lower bounds and steady-state references that a tracker is judged against.

Bounds are covariances `(T, N, N)` of the filtered estimate at T measurement times; `k = 0` is the time of the
first measurement, where the prior is updated without a prediction (unless said otherwise).
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

Floats: TypeAlias = NDArray[np.float64]
Jacobian: TypeAlias = Callable[[Floats, int], ArrayLike]


class SteadyFilter(NamedTuple):
    """Steady Kalman filter.

    predicted_cov and filtered_cov (N, N); gain (N, D) of the update; innovation_cov (D, D).
    """

    predicted_cov: Floats
    filtered_cov: Floats
    gain: Floats
    innovation_cov: Floats


class MismatchedErrors(NamedTuple):
    """True steady error covariances (N, N) of a filter with wrong matrices: before and after the update."""

    predicted: Floats
    filtered: Floats


class BestFit(NamedTuple):
    """Best-fitting Gaussian model of a jump-Markov system and the bound that it gives.

    bound (T, N, N); mean (T, N) and cov (T, N, N) of the prior state; transition (T-1, N, N) and
    process_noise (T-1, N, N) of the fitted model; mode_probs (T, M) prior mode probabilities.
    """

    bound: Floats
    mean: Floats
    cov: Floats
    transition: Floats
    process_noise: Floats
    mode_probs: Floats


def _matrix(caller: str, name: str, value: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Float array of exactly this shape, all finite."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        got = array.shape if array.shape != shape else "values that are not finite"
        raise ValueError(f"{caller}: {name} must be finite with shape {shape}; got {got}. Check the model's sizes.")
    return array


def _square(caller: str, name: str, value: ArrayLike) -> Floats:
    array = np.asarray(value, dtype=np.float64)
    size = array.shape[0] if array.ndim == 2 else 0
    return _matrix(caller, name, array, (size, size) if size else (1, 1))


def _sequence(caller: str, name: str, value: ArrayLike, steps: int, shape: tuple[int, int]) -> Floats:
    """One matrix repeated `steps` times, or `steps` of them; `(steps, *shape)`."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 2:
        array = np.broadcast_to(array, (steps, *array.shape))
    return _matrix(caller, name, array, (steps, *shape))


def _probabilities(caller: str, name: str, rows: Floats) -> Floats:
    if np.any(rows < 0.0) or np.any(np.abs(rows.sum(axis=-1) - 1.0) > 1e-9):
        raise ValueError(
            f"{caller}: {name} must be >= 0 with rows that sum to 1; got sums {rows.sum(axis=-1).tolist()}. "
            "Rows are 'from', columns are 'to'; transpose if yours are the other way."
        )
    return rows


def _update(P: Floats, H: Floats, R: Floats) -> Floats:
    """Joseph-form covariance after one measurement."""
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    IKH = np.eye(P.shape[0]) - K @ H
    return np.asarray(IKH @ P @ IKH.T + K @ R @ K.T)


def _steps(caller: str, steps: int) -> int:
    if steps < 1:
        raise ValueError(f"{caller}: steps must be >= 1; got {steps}. Give the number of measurement times.")
    return int(steps)


def riccati_bound(
    transition: ArrayLike,
    process_noise: ArrayLike,
    observation: ArrayLike,
    measurement_noise: ArrayLike,
    prior_cov: ArrayLike,
    steps: int,
    detected: ArrayLike | None = None,
    predict_first: bool = False,
) -> Floats:
    """Posterior Cramer-Rao bound of a linear-Gaussian model: the covariance of its Kalman filter.

    Model: J_{k+1} = (Q + F J_k^-1 F')^-1 + H' R^-1 H, returned as J^-1. With F and Q taken along a known mode
    sequence this is the oracle (mode-known) bound of a jump-Markov system.

    Args:
        transition: F, (N, N) or (T-1, N, N); entry k leads from k to k+1.
        process_noise: Q, (N, N) or (T-1, N, N); may be singular.
        observation: H, (D, N) or (T, D, N).
        measurement_noise: R, (D, D) or (T, D, D), positive definite.
        prior_cov: (N, N), before the first measurement.
        steps: T, number of measurement times.
        detected: (T,) booleans, False = no measurement; None = all.
        predict_first: the prior belongs one step before the first measurement; F and Q then have T entries.
    Returns:
        (T, N, N), state units squared.
    Raises:
        ValueError: shapes do not fit.
    Source: Tichavsky, Muravchik, Nehorai (1998), linear case. Differs: covariance form.
    """
    caller = "riccati_bound"
    count = _steps(caller, steps)
    P = _square(caller, "prior_cov", prior_cov)
    n, moves = P.shape[0], count - 1 + int(predict_first)
    F = _sequence(caller, "transition", transition, moves, (n, n))
    Q = _sequence(caller, "process_noise", process_noise, moves, (n, n))
    d = np.shape(observation)[-2] if np.ndim(observation) >= 2 else 0
    H = _sequence(caller, "observation", observation, count, (d, n))
    R = _sequence(caller, "measurement_noise", measurement_noise, count, (d, d))
    seen = np.ones(count, dtype=np.bool_) if detected is None else np.asarray(detected, dtype=np.bool_)
    if seen.shape != (count,):
        raise ValueError(f"{caller}: detected must have shape ({count},); got {seen.shape}. Give one flag per step.")
    out = np.empty((count, n, n))
    shift = int(predict_first)
    for k in range(count):
        if k + shift > 0:
            move = k - 1 + shift
            P = F[move] @ P @ F[move].T + Q[move]
        if seen[k]:
            P = _update(P, H[k], R[k])
        P = 0.5 * (P + P.T)
        out[k] = P
    return out


def information_recursion(prior_information: ArrayLike, d11: ArrayLike, d12: ArrayLike, d22: ArrayLike) -> Floats:
    """Posterior information from given D matrices.

    Model: J_{k+1} = D22_k - D21_k (J_k + D11_k)^-1 D12_k with D21 = D12'; D22 includes the new measurement.

    Args:
        prior_information: J_0, (N, N), including the first measurement if there is one.
        d11: (T-1, N, N), E[-d2 ln p(x_{k+1}|x_k) / dx_k dx_k].
        d12: (T-1, N, N), rows x_k, columns x_{k+1}.
        d22: (T-1, N, N), prior part plus measurement part.
    Returns:
        J, (T, N, N); invert for the bound.
    Raises:
        ValueError: shapes do not fit.
    Source: Tichavsky, Muravchik, Nehorai (1998), eq. 21. Differs: none.
    """
    caller = "information_recursion"
    J = _square(caller, "prior_information", prior_information)
    moves = int(np.shape(d11)[0]) if np.ndim(d11) == 3 else 0
    shape = (moves, *J.shape)
    A, B, C = (_matrix(caller, k, v, shape) for k, v in (("d11", d11), ("d12", d12), ("d22", d22)))
    out = np.empty((moves + 1, *J.shape))
    out[0] = J
    for k in range(moves):
        J = C[k] - B[k].T @ np.linalg.solve(J + A[k], B[k])
        J = 0.5 * (J + J.T)
        out[k + 1] = J
    return out


def monte_carlo_bound(
    states: ArrayLike,
    transition_jacobian: Jacobian,
    process_noise: ArrayLike,
    observation_jacobian: Jacobian,
    measurement_noise: ArrayLike,
    prior_cov: ArrayLike,
) -> Floats:
    """Posterior Cramer-Rao bound of a nonlinear model, averaged over simulated truth.

    Model: x' = f_k(x) + w, w ~ N(0, Q); z = h_k(x) + v, v ~ N(0, R); D11 = E[F' Q^-1 F], D12 = -E[F'] Q^-1,
    D22 = Q^-1 + E[H' R^-1 H], F at x_k, H at x_{k+1}, expectations over the given trajectories. Q and R must
    not depend on x (other terms would appear). The trajectories must be draws from this very model, prior
    included.

    Args:
        states: truth, (R, T, N), R trajectories.
        transition_jacobian: (x (N,), k) -> F (N, N), derivative of the move from k to k+1.
        process_noise: Q, (N, N) or (T-1, N, N), positive definite.
        observation_jacobian: (x (N,), k) -> H (D, N).
        measurement_noise: R, (D, D) or (T, D, D), positive definite.
        prior_cov: (N, N), before the first measurement (Gaussian prior).
    Returns:
        bound, (T, N, N), after the measurement of each step.
    Raises:
        ValueError: shapes do not fit or Q is singular.
    Source: Tichavsky, Muravchik, Nehorai (1998), eq. 34-36. Differs: none.
    """
    caller = "monte_carlo_bound"
    x = np.asarray(states, dtype=np.float64)
    if x.ndim != 3 or not np.isfinite(x).all() or min(x.shape) < 1:
        raise ValueError(f"{caller}: states must be finite with shape (R, T, N); got {x.shape}. Simulate truth first.")
    runs, count, n = x.shape
    P0 = _matrix(caller, "prior_cov", prior_cov, (n, n))
    d = np.shape(measurement_noise)[-1]
    Q = _sequence(caller, "process_noise", process_noise, count - 1, (n, n))
    R = _sequence(caller, "measurement_noise", measurement_noise, count, (d, d))
    if any(np.linalg.matrix_rank(q, hermitian=True) < n for q in Q):
        raise ValueError(
            f"{caller}: process_noise must be positive definite; got a singular matrix. "
            "Add a small noise to every state, or use riccati_bound for a linear model."
        )
    seen = np.zeros((count, n, n))
    d11, d12 = np.zeros((count - 1, n, n)), np.zeros((count - 1, n, n))
    for k in range(count):
        Q_inv = np.linalg.inv(Q[k]) if k < count - 1 else np.zeros((n, n))
        for r in range(runs):
            H = _matrix(caller, "observation_jacobian", observation_jacobian(x[r, k], k), (d, n))
            seen[k] += H.T @ np.linalg.solve(R[k], H) / runs
            if k < count - 1:
                F = _matrix(caller, "transition_jacobian", transition_jacobian(x[r, k], k), (n, n))
                d11[k] += F.T @ Q_inv @ F / runs
                d12[k] -= F.T @ Q_inv / runs
    d22 = np.linalg.inv(Q) + seen[1:] if count > 1 else np.zeros((0, n, n))
    J = information_recursion(np.linalg.inv(P0) + seen[0], d11, d12, d22)
    return np.asarray(np.linalg.inv(J))


def stationary_mode_probs(mode_transition: ArrayLike) -> Floats:
    """Long-run mode probabilities of a Markov matrix, mu = Pi' mu.

    Args:
        mode_transition: Pi, (M, M), row = from, column = to.
    Returns:
        (M,), sums to 1. For a chain with several closed classes one of the many solutions (least norm).
    Raises:
        ValueError: Pi is not square or its rows do not sum to 1.
    Source: definition of a stationary distribution. Differs: none.
    """
    Pi = _square("stationary_mode_probs", "mode_transition", mode_transition)
    _probabilities("stationary_mode_probs", "mode_transition", Pi)
    m = Pi.shape[0]
    system = np.vstack([Pi.T - np.eye(m), np.ones((1, m))])
    solution = np.linalg.lstsq(system, np.append(np.zeros(m), 1.0), rcond=None)[0]
    clipped = np.maximum(solution, 0.0)
    return np.asarray(clipped / clipped.sum())


def best_fitting_gaussian(
    transitions: ArrayLike,
    inputs: ArrayLike,
    process_noises: ArrayLike,
    mode_transition: ArrayLike,
    mode_probs: ArrayLike,
    observation: ArrayLike,
    measurement_noise: ArrayLike,
    mean: ArrayLike,
    cov: ArrayLike,
    steps: int,
) -> BestFit:
    """Bound of a jump-Markov linear system through the linear-Gaussian model with the same moments.

    Model: x_{k+1} = F_r x_k + u_r + w, w ~ N(0, Q_r), mode r with prior p_k(r), p_{k+1} = Pi' p_k, taken as
    independent of x_k. Phi = sum p F_r; Sigma = E[cov of the move] so that first and second moments agree;
    J_{k+1} = (Sigma + Phi J_k^-1 Phi')^-1 + H' R^-1 H. Not a strict bound, and white: dwell times do not
    enter. Sigma is summed from deviations (F_r - Phi) and (F_r m + u_r - m'), which equals the literal
    second-moment formula with its input terms but does not cancel digits when positions are large.

    Args:
        transitions: F_r, (M, N, N).
        inputs: u_r, (M, N), state units.
        process_noises: Q_r, (M, N, N).
        mode_transition: Pi, (M, M), row = from, column = to.
        mode_probs: (M,), of the mode that drives the move from k = 0 to 1.
        observation: H, (D, N).
        measurement_noise: R, (D, D).
        mean: prior mean, (N,).
        cov: prior covariance before the first measurement, (N, N).
        steps: T, number of measurement times.
    Returns:
        BestFit.
    Raises:
        ValueError: shapes do not fit or probabilities do not sum to 1.
    Source: Hernandez et al. (2008). Differs: sum of deviations, same value.
    """
    caller = "best_fitting_gaussian"
    count = _steps(caller, steps)
    C = _square(caller, "cov", cov)
    n = C.shape[0]
    modes = int(np.shape(mode_transition)[0]) if np.ndim(mode_transition) == 2 else 1
    F = _matrix(caller, "transitions", transitions, (modes, n, n))
    u = _matrix(caller, "inputs", inputs, (modes, n))
    Q = _matrix(caller, "process_noises", process_noises, (modes, n, n))
    Pi = _matrix(caller, "mode_transition", mode_transition, (modes, modes))
    p = _matrix(caller, "mode_probs", mode_probs, (modes,))
    _probabilities(caller, "mode_transition", Pi)
    _probabilities(caller, "mode_probs", p)
    m = _matrix(caller, "mean", mean, (n,))
    means, covs, probs = np.empty((count, n)), np.empty((count, n, n)), np.empty((count, modes))
    Phi, Sigma = np.empty((count - 1, n, n)), np.empty((count - 1, n, n))
    for k in range(count):
        means[k], covs[k], probs[k] = m, C, p
        if k == count - 1:
            break
        ends = F @ m + u
        mean_next = p @ ends
        phi = np.einsum("r,rij->ij", p, F)
        spread, turn = ends - mean_next, F - phi
        sigma = np.einsum("r,ri,rj->ij", p, spread, spread) + np.einsum("r,rij->ij", p, Q)
        sigma += np.einsum("r,rij,jl,rml->im", p, turn, C, turn)
        Phi[k], Sigma[k] = phi, 0.5 * (sigma + sigma.T)
        C = phi @ C @ phi.T + Sigma[k]
        m, p = mean_next, Pi.T @ p
    bound = riccati_bound(Phi, Sigma, observation, measurement_noise, cov, count)
    return BestFit(bound, means, covs, Phi, Sigma, probs)


def scalar_steady_kf(process_noise: float, measurement_noise: float) -> tuple[float, float]:
    """Steady Kalman filter of a random walk seen directly (F = H = 1).

    Args:
        process_noise: Q > 0, unit squared.
        measurement_noise: R > 0, unit squared.
    Returns:
        (predicted variance P, gain K); Q = R = 1 gives the golden ratio 1.618034 and 0.618034.
    Raises:
        ValueError: Q or R is not positive.
    Source: closed form of P^2 - Q P - Q R = 0. Differs: none.
    """
    q, r = float(process_noise), float(measurement_noise)
    if not (q > 0.0 and r > 0.0):
        raise ValueError(f"scalar_steady_kf: both noises must be positive; got Q={q}, R={r}. Give variances.")
    P = 0.5 * (q + np.sqrt(q * q + 4.0 * q * r))
    return float(P), float(P / (P + r))


def alpha_beta_gains(tracking_index: float) -> tuple[float, float]:
    """Steady gains of the constant-velocity filter driven by piecewise constant white acceleration.

    Model: r = (4 + l - sqrt(8 l + l^2)) / 4, alpha = 1 - r^2, beta = 2 (2 - alpha) - 4 sqrt(1 - alpha).

    Args:
        tracking_index: l = sigma_a T^2 / sigma_z > 0; acceleration m/s^2, interval s, measurement sigma m.
    Returns:
        (alpha, beta): position gain alpha, velocity gain beta / T.
    Raises:
        ValueError: the index is not positive and finite.
    Source: Kalata (1984). Differs: none.
    """
    index = float(tracking_index)
    if not (0.0 < index < np.inf):
        raise ValueError(
            f"alpha_beta_gains: tracking_index must be positive and finite; got {index}. "
            "It is sigma_a * T**2 / sigma_z."
        )
    # (4 + l - sqrt(8 l + l^2)) / 4 without cancellation for large l.
    r = 4.0 / (4.0 + index + np.sqrt(index * (8.0 + index)))
    return float(1.0 - r * r), float(2.0 * (1.0 - r) ** 2)


def steady_kf(
    transition: ArrayLike, process_noise: ArrayLike, observation: ArrayLike, measurement_noise: ArrayLike
) -> SteadyFilter:
    """Steady Kalman filter from the discrete algebraic Riccati equation.

    Args:
        transition: F, (N, N).
        process_noise: Q, (N, N); may be singular.
        observation: H, (D, N).
        measurement_noise: R, (D, D), positive definite.
    Returns:
        SteadyFilter; `gain` multiplies the innovation in the update (F @ gain is the predictor gain).
    Raises:
        ValueError: shapes do not fit, or no steady state exists (a mode is undetectable).
    Source: Anderson and Moore (1979), 4.4. Differs: none.
    """
    F = _square("steady_kf", "transition", transition)
    n = F.shape[0]
    Q = _matrix("steady_kf", "process_noise", process_noise, (n, n))
    R = _square("steady_kf", "measurement_noise", measurement_noise)
    H = _matrix("steady_kf", "observation", observation, (R.shape[0], n))
    try:
        P = np.asarray(linalg.solve_discrete_are(F.T, H.T, Q, R), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "steady_kf: the model must be detectable and stabilisable; got one without a steady state. "
            "Observe every growing state and give it noise."
        ) from error
    S = H @ P @ H.T + R
    gain = np.asarray(np.linalg.solve(S, H @ P).T, dtype=np.float64)
    return SteadyFilter(P, _update(P, H, R), gain, S)


def mismatched_errors(
    transition: ArrayLike,
    process_noise: ArrayLike,
    observation: ArrayLike,
    measurement_noise: ArrayLike,
    gain: ArrayLike,
    filter_transition: ArrayLike,
    filter_observation: ArrayLike | None = None,
) -> MismatchedErrors:
    """True steady error covariance of a fixed-gain filter whose matrices differ from the system's.

    Model: system x' = F x + w, z = H x + v; filter e.g. of `steady_kf`, x^' = Ff (x^ + K (z - Hf x^)). The
    stacked (prediction error, state) obeys one linear recursion whose stationary covariance solves a
    Lyapunov equation. With Ff = F and Hf = H the state drops out, so an unstable system with a stable filter
    is allowed there only.

    Args:
        transition: true F, (N, N).
        process_noise: true Q, (N, N).
        observation: true H, (D, N).
        measurement_noise: true R, (D, D).
        gain: K of the update, (N, D).
        filter_transition: Ff, (N, N).
        filter_observation: Hf, (D, N); None = H.
    Returns:
        MismatchedErrors: covariance (second moment; the mean is zero) before and after the update.
    Raises:
        ValueError: shapes do not fit, or the error grows without limit.
    Source: Xie, Soh, de Souza (1994), whose example is judged so. Differs: none.
    """
    caller = "mismatched_errors"
    F = _square(caller, "transition", transition)
    n = F.shape[0]
    R = _square(caller, "measurement_noise", measurement_noise)
    d = R.shape[0]
    Q = _matrix(caller, "process_noise", process_noise, (n, n))
    H = _matrix(caller, "observation", observation, (d, n))
    K = _matrix(caller, "gain", gain, (n, d))
    Ff = _matrix(caller, "filter_transition", filter_transition, (n, n))
    Hf = H
    if filter_observation is not None:
        Hf = _matrix(caller, "filter_observation", filter_observation, (d, n))
    after = np.hstack([np.eye(n) - K @ Hf, -K @ (H - Hf)])
    top = np.hstack([Ff @ after[:, :n], F - Ff + Ff @ after[:, n:]])
    A = np.vstack([top, np.hstack([np.zeros((n, n)), F])])
    noise = Ff @ K @ R @ K.T @ Ff.T + Q
    W = np.block([[noise, Q], [Q, Q]])
    if not top[:, n:].any():
        A, W, after = A[:n, :n], W[:n, :n], after[:, :n]
    radius = float(np.max(np.abs(np.linalg.eigvals(A))))
    if radius >= 1.0:
        raise ValueError(
            f"{caller}: the stacked system must be stable; got spectral radius {radius:.6g}. "
            "The error has no steady state: choose a stable system, or a gain that stabilises the filter."
        )
    X = np.asarray(linalg.solve_discrete_lyapunov(A, W))
    filtered = after @ X @ after.T + K @ R @ K.T
    return MismatchedErrors(X[:n, :n], filtered)
