"""Hidden Markov labels: forward-backward, most probable path, and draws of it, for tracks at irregular times.

Log-likelihoods of rows are (B, T, K). ``chain`` is a Markov matrix per row, or with ``rated`` a generator (1/s): then
over a step of ``dt`` seconds ``P_ii = exp(-q_i dt)`` and ``P_ij = (1 - P_ii) q_ij / q_i``, at most one switch per row.
Rows are from, columns to. Source: Rabiner (1989); draws: forward filtering, backward sampling.
"""

import numpy as np

from jink.estimators.compiled import entry_kernel, inner_kernel

__all__ = ["best_labels", "draw_labels", "smooth_labels"]


@inner_kernel
def _transition(chain, rated, dt, out):
    K = chain.shape[0]
    for i in range(K):
        if not rated:
            for j in range(K):
                out[i, j] = chain[i, j]
            continue
        rate = -chain[i, i]
        stay = np.exp(-rate * dt)
        for j in range(K):
            out[i, j] = stay if i == j else ((1.0 - stay) * chain[i, j] / rate if rate > 0.0 else 0.0)


@inner_kernel
def _forward(rows, steps, length, chain, rated, initial, alpha, moves):
    """Filtered probabilities into ``alpha``; returns the log evidence."""
    K = chain.shape[0]
    evidence = 0.0
    for t in range(length):
        top = -np.inf
        for j in range(K):
            top = max(top, rows[t, j])
        if t > 0:
            _transition(chain, rated, steps[t], moves)
        total = 0.0
        for j in range(K):
            prior = initial[j]
            if t > 0:
                prior = 0.0
                for i in range(K):
                    prior += alpha[t - 1, i] * moves[i, j]
            alpha[t, j] = prior * np.exp(rows[t, j] - top)
            total += alpha[t, j]
        for j in range(K):
            alpha[t, j] = alpha[t, j] / total if total > 0.0 else 1.0 / K
        evidence += top + np.log(max(total, 1e-300))
    return evidence


@entry_kernel
def smooth_labels(rows, steps, lengths, chain, rated, initial, probs, counts, evidence):
    """Smoothed probabilities (B, T, K), expected transitions summed over all rows (K, K), log evidence (B,)."""
    K = chain.shape[0]
    moves = np.zeros((K, K))
    beta, ahead = np.zeros(K), np.zeros(K)
    counts[:] = 0.0
    for b in range(rows.shape[0]):
        evidence[b] = _forward(rows[b], steps[b], lengths[b], chain, rated, initial, probs[b], moves)
        beta[:] = 1.0
        for t in range(lengths[b] - 2, -1, -1):
            _transition(chain, rated, steps[b, t + 1], moves)
            top = -np.inf
            for j in range(K):
                top = max(top, rows[b, t + 1, j])
            for j in range(K):
                ahead[j] = np.exp(rows[b, t + 1, j] - top) * beta[j]
            whole = 0.0
            for i in range(K):
                beta[i] = 0.0
                for j in range(K):
                    beta[i] += moves[i, j] * ahead[j]
                whole += probs[b, t, i] * beta[i]
            if not whole > 0.0:
                beta[:] = 1.0
                continue
            for i in range(K):
                for j in range(K):
                    counts[i, j] += probs[b, t, i] * moves[i, j] * ahead[j] / whole
            for i in range(K):
                beta[i] /= whole
                probs[b, t, i] *= beta[i]


@entry_kernel
def best_labels(rows, steps, lengths, chain, rated, initial, labels):
    """The most probable path of labels (B, T), by Viterbi; -1 beyond a track's length."""
    T, K = rows.shape[1], chain.shape[0]
    moves = np.zeros((K, K))
    score, moved = np.zeros(K), np.zeros(K)
    origin = np.zeros((T, K), dtype=np.int64)
    for b in range(rows.shape[0]):
        labels[b] = -1
        for t in range(lengths[b]):
            if t > 0:
                _transition(chain, rated, steps[b, t], moves)
            for j in range(K):
                best = np.log(max(initial[j], 1e-300))
                if t > 0:
                    best = -np.inf
                    for i in range(K):
                        value = score[i] + np.log(max(moves[i, j], 1e-300))
                        if value > best:
                            best = value
                            origin[t, j] = i
                moved[j] = best + rows[b, t, j]
            for j in range(K):
                score[j] = moved[j]
        last = lengths[b] - 1
        if last >= 0:
            labels[b, last] = np.argmax(score)
        for t in range(last, 0, -1):
            labels[b, t - 1] = origin[t, labels[b, t]]


@entry_kernel
def draw_labels(rows, steps, lengths, chain, rated, initial, uniforms, labels):
    """One path of labels (B, T) from its posterior; ``uniforms`` (B, T) in [0, 1). Returns the log evidence."""
    T, K = rows.shape[1], chain.shape[0]
    moves, alpha, weights = np.zeros((K, K)), np.zeros((T, K)), np.zeros(K)
    evidence = 0.0
    for b in range(rows.shape[0]):
        labels[b] = -1
        evidence += _forward(rows[b], steps[b], lengths[b], chain, rated, initial, alpha, moves)
        for t in range(lengths[b] - 1, -1, -1):
            if t < lengths[b] - 1:
                _transition(chain, rated, steps[b, t + 1], moves)
            total = 0.0
            for j in range(K):
                weights[j] = alpha[t, j] * (moves[j, labels[b, t + 1]] if t < lengths[b] - 1 else 1.0)
                total += weights[j]
            left = uniforms[b, t] * total
            labels[b, t] = K - 1
            for j in range(K):
                left -= weights[j]
                if left < 0.0:
                    labels[b, t] = j
                    break
    return evidence
