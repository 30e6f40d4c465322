"""A linear consensus filter in a few lines: the code under test does one scan, this does all of them."""

import numpy as np

from jink.estimators.multitarget.information import (
    Information,
    consensus_update,
    from_moments,
    predict_information,
    to_moments,
)

DT = 2.0
A = np.kron(np.eye(2), [[1.0, DT], [0.0, 1.0]])
Q = 4.0 * np.kron(np.eye(2), [[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
H = np.kron(np.eye(2), [[1.0, 0.0]])
R = np.array([[900.0, 200.0], [200.0, 400.0]])
MEAN = np.array([2000.0, 15.0, 4000.0, 5.0])
COV = np.diag([400.0, 4.0, 300.0, 9.0])


def fly(runs, steps, sensors, seed):
    """States (runs, steps, 4) and positions seen by each sensor (runs, steps, sensors, 2)."""
    rng = np.random.default_rng(seed)
    x = MEAN + rng.standard_normal((runs, 4)) @ np.linalg.cholesky(COV).T
    states = np.empty((runs, steps, 4))
    for k in range(steps):
        if k:
            x = x @ A.T + rng.standard_normal((runs, 4)) @ np.linalg.cholesky(Q).T
        states[:, k] = x
    noise = rng.standard_normal((runs, steps, sensors, 2)) @ np.linalg.cholesky(R).T
    return states, states[:, :, None] @ H.T + noise


def run_nodes(network, seen, sensing):
    """Means (steps, nodes, runs, 4) and covariances of all nodes; runs are independent targets here."""
    runs, steps = seen.shape[:2]
    pair = from_moments(np.tile(MEAN, (network.nodes, runs, 1)), COV)
    means, covs = [], []
    for k in range(steps):
        exchange = network.exchange(DT * k, k)
        holds = np.zeros((network.nodes, runs))
        novelty = Information(np.zeros_like(pair.vector), np.zeros_like(pair.matrix))
        for index, node in enumerate(sensing):
            if exchange.alive[node]:
                holds[node] = 1.0
                novelty.vector[node] = seen[:, k, index] @ np.linalg.inv(R) @ H
                novelty.matrix[node] = H.T @ np.linalg.inv(R) @ H
        pair = consensus_update(pair, novelty, holds, exchange, network.rule)
        mean, cov = to_moments(pair)
        means.append(mean)
        covs.append(cov)
        pair = predict_information(pair, A, Q)
    return np.array(means), np.array(covs)


def run_centre(seen):
    """Means (steps, runs, 4) and covariances (steps, 4, 4) of the Kalman filter that has every sensor's position."""
    runs, steps, sensors = seen.shape[:3]
    x, P = np.tile(MEAN, (runs, 1)), COV
    means, covs = [], []
    for k in range(steps):
        P = np.linalg.inv(np.linalg.inv(P) + sensors * H.T @ np.linalg.inv(R) @ H)
        x = x + (seen[:, k] - (x @ H.T)[:, None]).sum(axis=1) @ np.linalg.inv(R) @ H @ P
        means.append(x)
        covs.append(P)
        x, P = x @ A.T, A @ P @ A.T + Q
    return np.array(means), np.array(covs)


def nees(means, covs, states):
    """Squared error in units of the covariance; (steps, nodes, runs)."""
    error = means - states.transpose(1, 0, 2)[:, None]
    return np.einsum("knri,knrij,knrj->knr", error, np.linalg.inv(covs), error)
