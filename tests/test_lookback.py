"""The last measurement judged again with the next: against all pairs of levels with whole filters."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from straight_source import Straight
from test_adaptive_factor import torn
from test_agent_policy import random_policy
from test_beliefs import chain

from jink.envs.adaptive_factor import AdaptiveFactorTask
from jink.estimators.agent.beliefs import LEVEL_SCALES, LEVELS
from jink.estimators.agent.looking import LEVELS_SIZE
from jink.estimators.agent.policy import Policy
from jink.estimators.agent.policy_file import POLICY_FILE, load_policy, save_policy
from jink.estimators.agent_estimator import AgentEstimator
from jink.estimators.inputs import Prior
from jink.estimators.recipes import make_estimator
from jink.estimators.sensors import make_sensor, position
from jink.training.agent_scores import interquartile_mean, make_source, play_episodes, score, simulate_seeds

ADVICE = LEVELS_SIZE - 2


def advice(lookback):
    """The advice and nothing else."""
    skip = np.zeros((1, LEVELS_SIZE))
    skip[0, ADVICE] = 2.0
    layers = ((np.zeros((1, LEVELS_SIZE)), -np.ones(1)),)
    return Policy(layers, skip, np.zeros(LEVELS_SIZE), np.ones(LEVELS_SIZE), covariance="mixture", lookback=lookback)


def flights(count=4, steps=50, seed=0, torn=True):
    """Straight flights with bursts and outliers; missing rows and components."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.choice([0.1, 0.2, 0.5], size=steps)) - 0.1
    truth = np.array([3.0, -2.0]) * times[None, :, None] + rng.normal(size=(count, 1, 2))
    scale = np.where(rng.random((count, steps)) < 0.1, 300.0, 1.0)
    scale[:, 20:30] = 100.0
    z = truth + np.sqrt(scale)[..., None] * rng.normal(size=truth.shape)
    if torn:
        z[rng.random((count, steps)) < 0.15] = np.nan
        z[rng.random(z.shape) < 0.1] = np.nan
    return times, truth, z


def moved(m, P, dt, density):
    """Constant velocity with white acceleration."""
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    one = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return F @ m, F @ P @ F.T + np.kron(one, np.eye(2))


def updated(m, P, v, H, R):
    """An ordinary Kalman update."""
    C = P @ H.T
    S = H @ C + R
    return m + C @ np.linalg.solve(S, v), P - C @ np.linalg.solve(S, C.T)


def spread_about(centre, weights, means, covs):
    """Covariance of a mixture about an estimate."""
    return sum(w * (P + np.outer(m - centre, m - centre)) for w, m, P in zip(weights, means, covs, strict=True))


def by_hand(times, z, mean, cov, density):
    """One filter that keeps, of the last detection, one whole filter per level: positions (T, 2)."""
    T, belief = chain(), np.r_[0.9, np.full(LEVELS - 1, 0.1 / (LEVELS - 1))]
    m, P, last, path = mean.copy(), cov.copy(), None, []
    for t in range(len(times)):
        if t > 0:
            dt = times[t] - times[t - 1]
            m, P = moved(m, P, dt, density)
            if last is not None:
                last["levels"] = [moved(*level, dt, density) for level in last["levels"]]
                last["since"].append(dt)
        H = np.eye(2, 4)[np.isfinite(z[t])]
        if len(H):
            seen, R = z[t][np.isfinite(z[t])], np.eye(len(H))
            surprise = (seen - H @ m) @ np.linalg.solve(H @ P @ H.T + R, seen - H @ m)
            if last is not None and not (belief[0] > 0.9 and surprise < 4.0 * len(H)):
                weights = np.zeros(LEVELS)
                for before, (ml, Pl) in enumerate(last["levels"]):
                    if belief[before] > 1e-4:
                        for now, scale in enumerate(LEVEL_SCALES):
                            S, v = H @ Pl @ H.T + scale * R, seen - H @ ml
                            density_of = np.exp(-0.5 * v @ np.linalg.solve(S, v)) / np.sqrt(np.linalg.det(S))
                            weights[before] += belief[before] * T[before, now] * density_of
                weights /= weights.sum()
                levels = [updated(*last["prior"], last["v"], last["H"], s * last["R"]) for s in LEVEL_SCALES]
                m = sum(w * level[0] for w, level in zip(weights, levels, strict=True))
                P = spread_about(m, weights, *zip(*levels, strict=True))
                for dt in last["since"]:
                    m, P = moved(m, P, dt, density)
            v, HPH = seen - H @ m, H @ P @ H.T
            belief = belief @ T
            logs = [
                -0.5 * v @ np.linalg.solve(HPH + s * R, v) - 0.5 * np.linalg.slogdet(HPH + s * R)[1]
                for s in LEVEL_SCALES
            ]
            belief = belief * np.exp(np.array(logs) - max(logs))
            belief = np.maximum(belief / belief.sum(), 1e-12)
            share = np.trace(HPH) / len(H)
            chosen = max(1.0 / sum(b / (share + s) for b, s in zip(belief, LEVEL_SCALES, strict=True)) - share, 1.0)
            levels = [updated(m, P, v, H, s * R) for s in LEVEL_SCALES]
            last = {"prior": (m, P), "v": v, "H": H, "R": R, "levels": levels, "since": []}
            m = updated(m, P, v, H, chosen * R)[0]
            P = spread_about(m, belief, *zip(*levels, strict=True))
        path.append(m[:2])
    return np.array(path)


@pytest.mark.parametrize("linear", [True, False])
def test_it_is_the_filter_that_keeps_one_filter_per_level(linear):
    """Also with a sensor whose H is known by sigma points alone."""
    times, _, z = flights()
    prior = Prior(np.tile([0.0, 0.0, 3.0, -2.0], (len(z), 1)), np.diag([4.0, 4.0, 1.0, 1.0]))
    sensor = position(2, 1.0) if linear else dataclasses.replace(position(2, 1.0), linear=False)
    estimator = make_estimator("agent", sensor, acceleration=0.5, policy=advice(True))
    estimator = AgentEstimator(estimator.bank.with_(restart=False), advice(True))
    found = estimator.run(z, times, prior=prior)
    plain = AgentEstimator(estimator.bank, advice(False)).run(z, times, prior=prior)
    for track in range(len(z)):
        expected = by_hand(times, z[track], prior.mean[track], prior.cov, 0.25)
        # Floors of 1e-12 meet in another order; what is taken back moves positions by metres.
        np.testing.assert_allclose(found.position[track], expected, rtol=0, atol=2e-6)
    assert np.abs(found.position - plain.position).max() > 0.5


def test_streaming_gives_the_bits_of_the_batch():
    times, _, z = flights(count=1)
    estimator = make_estimator(
        "agent", position(2, 1.0), acceleration=0.5, policy=random_policy(1, covariance="mixture")
    )
    policy = dataclasses.replace(estimator.policy, lookback=True)
    estimator = AgentEstimator(estimator.bank, policy)
    batch = estimator.run(z, times)
    first = int(np.argmax(np.isfinite(z[0]).all(axis=1)))
    state = estimator.start(z[0, first], times[first])
    for t in range(first + 1, len(times)):
        state, estimate = estimator.step(state, z[0, t], times[t])
        np.testing.assert_array_equal(estimate.position, batch.position[0, t])
        np.testing.assert_array_equal(estimate.covariance, batch.covariance[0, t])


def test_what_a_burst_began_with_is_taken_back():
    source = make_source("surge")
    episodes = simulate_seeds(source, 500, 150)
    scores = []
    for lookback in (False, True):
        played = play_episodes(advice(lookback), source, episodes)
        scores.append(score(played.agent, played.nominal, played.oracle, played.sigma))
    assert interquartile_mean(scores[1]) > interquartile_mean(scores[0]) + 0.005
    assert np.mean(scores[1] > scores[0]) > 0.55


def test_a_new_episode_does_not_look_back_on_the_last():
    source = Straight(sigma=2.0, steps=40, missed=0.5)
    episodes = torn(source, 20)
    task = AdaptiveFactorTask(source, 20, True, view="levels", covariance="mixture", lookback=True, lost_after=np.inf)
    seen, live = [], np.ones(20, dtype=np.bool_)
    for _ in range(2):
        task.begin(np.arange(20), episodes)
        first = [task.observe(np.zeros(20, dtype=np.int64))]
        for k in range(20):  # half of them end where nothing is measured: there is something left to take back
            task.step(task.check_actions(np.zeros((20, 1)), "step"), np.full(20, k), live)
            first.append(task.observe(np.full(20, k + 1)))
        seen.append(np.array(first))
    np.testing.assert_array_equal(seen[0], seen[1])


def test_a_filter_that_begins_again_does_not_look_back():
    z = np.random.default_rng(0).normal(size=(120, 2))
    z[60:] += 2000.0
    estimator = make_estimator("agent", position(2, 1.0), acceleration=1.0, policy=advice(True))
    state, kept, far = estimator.start(z[0], 0.0), [], []
    for t in range(1, 120):
        state, estimate = estimator.step(state, z[t], 0.1 * t)
        kept.append(state.nis_average[0, -1])  # components of the update that can be taken back
        far.append(np.linalg.norm(estimate.position - 2000.0) > 100.0)
    found = far[60:].index(False) + 60
    assert not any(far[found:])
    assert kept[found - 2 : found + 1] == [2.0, 0.0, 2.0]  # begun again in the row before


def test_other_sensors_and_wild_numbers_do_it_no_harm():
    for kind, size in (("range-bearing", 2), ("range-bearing-elevation", 3), ("range-bearing-rate", 3)):
        rng = np.random.default_rng(0)
        z = np.tile([1000.0, 0.5, 0.2][:size], (30, 1)) + 0.01 * rng.normal(size=(30, size))
        z[10] += [500.0, 0.3, 0.1][:size]
        z[20] = [1e150, 3.0, 1.0][:size]
        found = make_estimator("agent", make_sensor(kind), policy=advice(True)).run(z, np.arange(30.0))
        assert np.isfinite(found.position).all(), kind
        assert np.linalg.eigvalsh(found.covariance[0]).min() > 0.0


def test_what_cannot_look_back_is_refused():
    bank = make_estimator("ukf-ct", position(2, 1.0)).bank
    with pytest.raises(ValueError, match="AgentEstimator: bank must have a linear motion for a policy that looks back"):
        AgentEstimator(bank, advice(True))
    with pytest.raises(ValueError, match="Policy: lookback must be False unless the covariance is mixture"):
        dataclasses.replace(advice(True), covariance="chosen")
    with pytest.raises(ValueError, match="Policy: lookback must be True or False; got 1"):
        dataclasses.replace(advice(True), lookback=1)
    for options in ({"covariance": "chosen"}, {"covariance": "mixture", "loop_filter": "robust"}):
        with pytest.raises(ValueError, match="make: lookback must come with covariance mixture and the filter kf"):
            AdaptiveFactorTask(Straight(), 1, True, view="levels", lookback=True, **options)


def test_policies_written_before_still_load(tmp_path):
    save_policy(advice(True), tmp_path)
    assert load_policy(tmp_path).lookback
    document = json.loads((tmp_path / POLICY_FILE).read_text())
    del document["lookback"]
    (tmp_path / POLICY_FILE).write_text(json.dumps(document))
    with pytest.raises(ValueError, match="lookback"):
        load_policy(tmp_path)
    document["version"] = 1
    (tmp_path / POLICY_FILE).write_text(json.dumps(document))
    assert not load_policy(tmp_path).lookback
