"""The discrete agent against the best sequence of factors that somebody who knows the truth could choose.

Clairvoyant: a beam over sequences of factors that keeps the best by the sum of true errors so far; with a beam of 1 it
is greedy. Longer beams come nearer to the best sequence, whose error is at most what is printed. Constant velocity,
position sensor, axes that do not interact: the filter is written out per axis. Scores as in `agent_study.py`.

python benchmarks/clairvoyant_factors.py --agent discrete --episodes 60
"""

from __future__ import annotations

import argparse

import numba
import numpy as np
from _paired import show
from agent_study import Judge

from jink.envs.adaptive_factor import FACTORS_OFFERED
from jink.estimators.agent.policy_file import find_policy
from jink.estimators.factors import FACTORS
from jink.training.agent_scores import interquartile_mean, make_source, play_episodes
from jink.training.train_agent import TEST_SEED

CHOICES = len(FACTORS_OFFERED)


@numba.njit
def _noise(choice, v, p, thresholds, out):
    """R~ of each axis, R = 1: `jink.estimators.factors` for two components and a diagonal S."""
    nis = v[0] * v[0] / (p[0] + 1.0) + v[1] * v[1] / (p[1] + 1.0)
    inflation = 1.0
    if choice == 1:
        inflation = 1e9 if nis > thresholds[1, 1] else np.sqrt(nis / thresholds[1, 0])
    elif choice == 2:
        inflation = np.sqrt(nis) / thresholds[2, 0]
    elif choice == 3:
        root = np.sqrt(nis + 1e-3)
        inflation = root if root > thresholds[3, 0] else 1.0
    for a in range(2):
        out[a] = max(inflation, 1.0)
        if choice == 4 and nis > thresholds[4, 0]:
            out[a] = max(abs(v[a] * v[a] / thresholds[4, 0] - p[a]), 1.0)


@numba.njit
def follow(z, truth, dt, density, mean, variance, thresholds, width):
    """Mean error of the best sequence that a beam of this width finds."""
    steps, columns = z.shape[0] - 1, 10  # per axis position, velocity, three covariances
    beam, fresh = np.zeros((width, columns)), np.zeros((width * 5, columns))
    costs, totals = np.zeros(width), np.zeros(width * 5)
    noise, v, p = np.zeros(2), np.zeros(2), np.zeros(2)
    for a in range(2):
        beam[0, 5 * a], beam[0, 5 * a + 1] = mean[a], mean[2 + a]
        beam[0, 5 * a + 2], beam[0, 5 * a + 4] = variance[a], variance[2 + a]
    alive = 1
    for k in range(steps):
        measured = not np.isnan(z[k, 0])
        choices, count = (5 if measured else 1), 0
        for i in range(alive):
            for choice in range(choices):
                state, before = fresh[count], beam[i]
                for c in range(columns):
                    state[c] = before[c]
                if measured:
                    for a in range(2):
                        v[a], p[a] = z[k, a] - before[5 * a], before[5 * a + 2]
                    _noise(choice, v, p, thresholds, noise)
                    for a in range(2):
                        at = 5 * a
                        S = p[a] + noise[a]
                        gain, other = before[at + 2] / S, before[at + 3] / S
                        state[at] += gain * v[a]
                        state[at + 1] += other * v[a]
                        state[at + 2] = before[at + 2] - gain * before[at + 2]
                        state[at + 3] = before[at + 3] - gain * before[at + 3]
                        state[at + 4] = before[at + 4] - other * before[at + 3]
                totals[count] = costs[i] + np.hypot(state[0] - truth[k, 0], state[5] - truth[k, 1])
                count += 1
        order = np.argsort(totals[:count])
        alive = min(width, count)
        for i in range(alive):
            state = fresh[order[i]]
            costs[i] = totals[order[i]]
            for a in range(2):
                at = 5 * a
                beam[i, at] = state[at] + dt * state[at + 1]
                beam[i, at + 1] = state[at + 1]
                beam[i, at + 2] = state[at + 2] + 2 * dt * state[at + 3] + dt * dt * state[at + 4] + density * dt**3 / 3
                beam[i, at + 3] = state[at + 3] + dt * state[at + 4] + density * dt * dt / 2
                beam[i, at + 4] = state[at + 4] + density * dt
    return costs[0] / steps


def main() -> None:
    """Measure and print."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--agent", default="discrete", help="folder or name of a discrete policy")
    made.add_argument("--episodes", type=int, default=60)
    made.add_argument("--beams", type=int, nargs="+", default=[1, 16, 128])
    made.add_argument("--markdown", action="store_true")
    given = made.parse_args()
    source = make_source("surge")
    judge = Judge(source, TEST_SEED, given.episodes)
    episodes = judge.episodes
    thresholds = np.array([FACTORS[name].thresholds(2) for name in FACTORS_OFFERED])
    rows = []

    def note(name: str, errors: np.ndarray) -> None:
        scores = judge.scores(errors)
        rows.append([name, f"{float(interquartile_mean(scores)):.3f}", f"{errors.sum() / judge.oracle.sum():.3f}"])

    for number, name in enumerate(FACTORS_OFFERED):
        always = play_episodes(
            lambda seen, first, number=number: np.full(len(seen), number), source, episodes, continuous=False
        )
        note(f"always {name}", always.agent)
    note("discrete agent", play_episodes(find_policy(given.agent), source, episodes).agent)
    for width in given.beams:
        errors = [
            follow(
                episodes.measurements[b], episodes.truth.position[b], float(episodes.times[b, 1]), source.filter_noise,
                episodes.prior_mean[b], np.diag(episodes.prior_cov).copy(), thresholds, width,
            )
            for b in range(given.episodes)
        ]  # fmt: skip
        note(f"clairvoyant, beam of {width}", np.array(errors))
    show("discrete choices", ["who", "score (IQM)", "error / oracle"], rows, given.markdown)


if __name__ == "__main__":
    main()
