"""Textbook unscented filter, smoother and interacting multiple models in plain numpy: the second opinion.

Written from Julier and Uhlmann (2004), Sarkka (2008) and Blom and Bar-Shalom (1988) alone, one track, slow on
purpose; it shares no code with the package. Functions ``f`` and ``h`` map one state vector.
"""

import numpy as np

TUNING = (1.0, 2.0, 0.0)


def sigma_points(mean, cov, tuning=TUNING):
    """Points (2n + 1, n) and their weights for means and for covariances."""
    alpha, beta, kappa = tuning
    n = len(mean)
    lam = alpha**2 * (n + kappa) - n
    root = np.linalg.cholesky((n + lam) * cov)
    points = np.vstack([mean, mean + root.T, mean - root.T])
    wm = np.full(2 * n + 1, 0.5 / (n + lam))
    wm[0] = lam / (n + lam)
    wc = wm.copy()
    wc[0] += 1 - alpha**2 + beta
    return points, wm, wc


def transform(function, mean, cov, tuning=TUNING):
    """Mean and covariance of ``function(x)`` and the cross covariance with ``x``."""
    points, wm, wc = sigma_points(mean, cov, tuning)
    images = np.array([function(p) for p in points])
    out = wm @ images
    d = images - out
    return out, (wc[:, None] * d).T @ d, (wc[:, None] * (points - mean)).T @ d


def predict(f, Q, mean, cov, tuning=TUNING):
    out, spread, _ = transform(f, mean, cov, tuning)
    return out, spread + Q


def update(h, R, mean, cov, z, tuning=TUNING):
    """Posterior and log likelihood; points are drawn anew from the prediction."""
    seen, S, cross = transform(h, mean, cov, tuning)
    S = S + R
    v = z - seen
    K = np.linalg.solve(S, cross.T).T
    log_l = -0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * np.pi * S)[1])
    return mean + K @ v, cov - K @ S @ K.T, log_l


def run_filter(f, Q, h, R, mean, cov, z, tuning=TUNING):
    """Filter from a posterior at row 0; means (T, n), covariances, log likelihoods of rows 1 and on."""
    means, covs, logs = [mean], [cov], []
    for row in z[1:]:
        mean, cov = predict(f, Q, mean, cov, tuning)
        mean, cov, log_l = update(h, R, mean, cov, row, tuning)
        means.append(mean)
        covs.append(cov)
        logs.append(log_l)
    return np.array(means), np.array(covs), np.array(logs)


def run_smoother(f, Q, means, covs, tuning=TUNING):
    """Rauch-Tung-Striebel over filtered means (T, n) and covariances."""
    means, covs = means.copy(), covs.copy()
    for k in range(len(means) - 2, -1, -1):
        ahead, P, cross = transform(f, means[k], covs[k], tuning)
        P = P + Q
        G = np.linalg.solve(P, cross.T).T
        means[k] = means[k] + G @ (means[k + 1] - ahead)
        covs[k] = covs[k] + G @ (covs[k + 1] - P) @ G.T
    return means, covs


def moments(weights, means, covs):
    """Mean and covariance of a mixture."""
    mean = np.einsum("j,jn->n", weights, means)
    d = np.asarray(means) - mean
    return mean, np.einsum("j,jab->ab", weights, covs) + np.einsum("j,ja,jb->ab", weights, d, d)


def run_imm(modes, h, R, chain, probs, means, covs, z, tuning=TUNING):
    """IMM from a posterior at row 0; ``modes`` holds ``(f, Q)``.

    Returns fused means, covariances, mode probabilities, log likelihoods, squared innovations.
    """
    M = len(modes)
    means, covs, probs = [np.array(m) for m in means], [np.array(p) for p in covs], np.array(probs)
    out = [(*moments(probs, means, covs), probs, 0.0, 0.0)]
    for row in z[1:]:
        prior = probs @ chain
        mixed = [moments(chain[:, j] * probs / prior[j], means, covs) for j in range(M)]
        log_l, seen = np.zeros(M), []
        for j, (f, Q) in enumerate(modes):
            means[j], covs[j] = predict(f, Q, *mixed[j], tuning)
            seen.append(transform(h, means[j], covs[j], tuning)[:2])
            means[j], covs[j], log_l[j] = update(h, R, means[j], covs[j], row, tuning)
        expected, S = moments(prior, [m for m, _ in seen], [c + R for _, c in seen])
        nis = (row - expected) @ np.linalg.solve(S, row - expected)
        joint = np.exp(log_l) * prior
        probs = joint / joint.sum()
        out.append((*moments(probs, means, covs), probs, np.log(joint.sum()), nis))
    return tuple(np.array(column) for column in zip(*out, strict=True))
