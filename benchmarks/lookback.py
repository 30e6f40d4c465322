"""How much it is worth to judge more than the last measurement again, with how many levels, and what pruning costs.

The look-back of `jink.estimators.agent.lookback` written out with one whole filter for every sequence of noise levels
of the last measurements: of any number of them, of levels in any steps, with sequences left away that are less probable
than a share of the best. Every measurement but the present one is taken in again with the mixture of its levels; the
level of the present one comes from the sequences too. Constant velocity in the plane; the advice, no network.

python benchmarks/lookback.py --episodes 400 --markdown --out lookback.json
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from _paired import save, show
from agent_study import Judge
from numba import njit

from jink.estimators.agent.beliefs import BACK, CALM, STAY
from jink.training.agent_scores import interquartile_mean, make_source
from jink.training.intervals import Measured
from jink.training.train_agent import VALIDATION_SEED

TRIED = (  # measurements judged again, levels, their step, least share of a sequence
    (0, 8, 4.0, 0.0), (1, 8, 4.0, 0.0), (1, 8, 4.0, 1e-3), (2, 8, 4.0, 1e-3), (2, 8, 4.0, 1e-2), (3, 8, 4.0, 1e-2),
    (0, 15, 2.0, 0.0), (1, 15, 2.0, 1e-4), (2, 15, 2.0, 1e-2),
)  # fmt: skip


def chain(levels: int) -> np.ndarray:
    """The agent's chain for another number of levels; (levels, levels)."""
    moves = np.full((levels, levels), (1.0 - STAY) * (1.0 - BACK) / (levels - 2))
    moves[:, 0], moves[0] = (1.0 - STAY) * BACK, (1.0 - CALM) / (levels - 1)
    np.fill_diagonal(moves, STAY)
    moves[0, 0] = CALM
    return moves


@njit
def predict(m, P, dt, q):
    """Constant velocity with white acceleration of density q, in place."""
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    m[:] = F @ m
    P[:] = F @ P @ F.T
    for a in range(2):
        P[a, a] += q * dt**3 / 3.0
        P[a, a + 2] += q * dt * dt / 2.0
        P[a + 2, a] += q * dt * dt / 2.0
        P[a + 2, a + 2] += q * dt


@njit
def inverse(P, r):
    """Inverse of the position covariance plus ``r I``, as three numbers, and its determinant."""
    a, b, c = P[0, 0] + r, P[0, 1], P[1, 1] + r
    determinant = a * c - b * b
    return c / determinant, -b / determinant, a / determinant, determinant


@njit
def update(m, P, z, noises, weights, m_out, P_out):
    """Mean and covariance of the mixture of updates with ``noises``."""
    v = z - m[:2]
    gains = np.zeros((len(noises), 2))
    mean, W = np.zeros(2), np.zeros((2, 2))
    for level in range(len(noises)):
        a, b, c, _ = inverse(P, noises[level])
        gains[level, 0], gains[level, 1] = a * v[0] + b * v[1], b * v[0] + c * v[1]
        mean += weights[level] * gains[level]
        W += weights[level] * np.array([[a, b], [b, c]])
    for level in range(len(noises)):
        off = gains[level] - mean
        W -= weights[level] * np.outer(off, off)
    C = np.ascontiguousarray(P[:, :2])
    m_out[:] = m + C @ mean
    P_out[:] = P - C @ W @ C.T


@njit
def run(z, times, means, cov, q, R, scales, moves, back, least, truth):
    """Mean distances to the truth (E,), and densities computed per row."""
    n, window = len(scales), back + 1
    most = n**window
    m, P, log, labels = np.zeros((most, 4)), np.zeros((most, 4, 4)), np.zeros(most), np.zeros((most, window), np.int64)
    m_new, P_new, log_new, labels_new = m.copy(), P.copy(), log.copy(), labels.copy()
    errors, one, count = np.zeros(len(z)), np.ones(1), 0
    calm = np.full(n, 0.1 / (n - 1))
    calm[0] = 0.9
    for e in range(len(z)):
        base, P_base, at = means[e].copy(), cov.copy(), times[e, 0]
        now, P_now, prior = base.copy(), P_base.copy(), calm @ moves
        seen, when, filtered, kept = np.zeros((window, 2)), np.zeros(window), np.zeros((window, n)), 0
        steps = z.shape[1] - 1
        for k in range(steps):
            if k > 0:
                predict(now, P_now, times[e, k] - times[e, k - 1], q)
            if not math.isnan(z[e, k, 0]):
                if kept == window:
                    for i in range(back):
                        seen[i], when[i], filtered[i] = seen[i + 1], when[i + 1], filtered[i + 1]
                    kept -= 1
                seen[kept], when[kept] = z[e, k], times[e, k]
                kept += 1
                sequences, time = 1, at
                m[0], P[0], log[0] = base, P_base, 0.0
                for i in range(kept):
                    made, best = 0, -np.inf
                    for s in range(sequences):
                        predict(m[s], P[s], when[i] - time, q)
                        v = seen[i] - m[s, :2]
                        for level in range(n):
                            a, b, c, determinant = inverse(P[s], scales[level] * R)
                            chance = prior[level] if i == 0 else moves[labels[s, i - 1], level]
                            distance = a * v[0] * v[0] + 2.0 * b * v[0] * v[1] + c * v[1] * v[1]
                            log_new[made] = log[s] + math.log(chance) - 0.5 * (distance + math.log(determinant))
                            best = max(best, log_new[made])
                            if i < kept - 1:
                                update(
                                    m[s], P[s], seen[i], scales[level : level + 1] * R, one, m_new[made], P_new[made]
                                )
                            labels_new[made] = labels[s]
                            labels_new[made, i] = level
                            made += 1
                            count += 1
                    sequences, time = 0, when[i]
                    for s in range(made):
                        if i == kept - 1 or math.exp(log_new[s] - best) >= least:
                            m[sequences], P[sequences] = m_new[s], P_new[s]
                            log[sequences], labels[sequences] = log_new[s], labels_new[s]
                            sequences += 1
                weights = np.exp(log[:sequences] - log[:sequences].max())
                weights /= weights.sum()
                levels = np.full((kept, n), 1e-12)
                for s in range(sequences):
                    for i in range(kept):
                        levels[i, labels[s, i]] += weights[s]
                filtered[kept - 1] = levels[kept - 1]
                now[:], P_now[:], time = base, P_base, at
                for i in range(kept):
                    predict(now, P_now, when[i] - time, q)
                    update(now, P_now, seen[i], scales * R, levels[i], now, P_now)
                    time = when[i]
                    if i == 0 and kept == window:
                        base[:], P_base[:], at, prior = now, P_now, time, filtered[0] @ moves
            errors[e] += math.hypot(now[0] - truth[e, k, 0], now[1] - truth[e, k, 1]) / steps
    return errors, count / (z.shape[0] * z.shape[1])


def main() -> None:
    """Score all that is tried on validation episodes of the surge suite."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--episodes", type=int, default=400)
    made.add_argument("--out", type=Path, required=True)
    made.add_argument("--markdown", action="store_true")
    given = made.parse_args()
    committed = Path(__file__).parent.parent / "docs" / "results" / "agent_compare.json"
    tuned: dict[str, Any] = json.loads(committed.read_text())["tuned"]
    source = make_source("surge")
    judge = Judge(source, VALIDATION_SEED, given.episodes)
    episodes = judge.episodes
    means = np.broadcast_to(episodes.prior_mean, (given.episodes, 4)).copy()
    from_chang = float(interquartile_mean(judge.scores(judge.errors("chang", tuned["chang"]["setting"]))))
    found = {"joint-imm": (judge.errors("joint-imm", tuned["joint-imm"]["setting"]), math.nan)}
    for back, levels, step, least in TRIED:
        errors, densities = run(
            episodes.measurements, episodes.times, means, np.ascontiguousarray(episodes.prior_cov), source.filter_noise,
            float(source.sensor.sigma[0]) ** 2, step ** np.arange(levels), chain(levels), back, least,
            np.ascontiguousarray(episodes.truth.position),
        )  # fmt: skip
        found[f"{back} judged again, {levels} levels, pruned at {least:g}"] = errors, densities
    rows, numbers = [], {}
    for name, (errors, densities) in found.items():
        score = float(interquartile_mean(judge.scores(errors)))
        closed, ratio = (score - from_chang) / (1.0 - from_chang), float(errors.mean() / judge.oracle.mean())
        rows.append([name, f"{score:.4f}", f"{closed:.3f}", f"{ratio:.3f}", f"{densities:.0f}"])
        for what, value in (("score", score), ("gap closed from Chang", closed), ("error over oracle", ratio)):
            numbers[f"{name}/{what}"] = Measured(value, "")
    head = ["state", "score (IQM)", "gap closed from Chang", "error / oracle", "densities a row"]
    show(f"surge suite, {given.episodes} validation episodes", head, rows, given.markdown)
    save(given.out, numbers)


if __name__ == "__main__":
    main()
