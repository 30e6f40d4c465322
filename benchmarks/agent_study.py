"""How good is the agent: against tuned classical filters, on held-out episodes, where it was and was not trained.

Score of an episode: 0 for the filter with nominal noise, 1 for the filter told the true noise, by mean distance to the
truth. Interquartile means over episodes, 95 % bootstrap intervals (episodes, and training seeds where there are
several), paired: every estimator sees the same episodes. Classical filters are tuned on training episodes: process
noise, thresholds, forgetting, chain of levels, likelihood, each by the same score and about the same number of trials.

python benchmarks/agent_study.py tune --out tuned.json
python benchmarks/agent_study.py compare --tuned tuned.json --agents seed0 seed1 ... --out compare.json
python benchmarks/agent_study.py elsewhere --tuned tuned.json --agents seed0 --out elsewhere.json
python benchmarks/agent_study.py recorded --data DIR --out recorded.json
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from _paired import save, show

from jink.envs.episodes import Episodes
from jink.envs.scenarios import SUITES, make_scenario
from jink.estimators.adaptive_estimator import AdaptiveEstimator, NoiseAdaptation
from jink.estimators.agent.looking import LEVELS_SIZE
from jink.estimators.agent.policy import Policy
from jink.estimators.agent.policy_file import find_policy
from jink.estimators.agent_estimator import AgentEstimator
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.factors import FACTORS
from jink.estimators.inputs import Prior
from jink.estimators.joint import joint_bank
from jink.estimators.motions import constant_velocity
from jink.estimators.recipes import Scales, intent_imm, make_estimator, robust_imm
from jink.estimators.treatments import Adaptive
from jink.training.agent_scores import LEAST_GAIN, interquartile_mean, make_source, simulate_seeds
from jink.training.console import progress
from jink.training.intervals import Measured
from jink.training.running import run_tracks
from jink.training.track import TrackRequest, choose, read
from jink.training.train_agent import TEST_SEED, TRAINING_SEED

TRAINING = TRAINING_SEED - 10**6
"""Episodes to tune on: of the training distribution, and not those that judge."""
Q = (0.125, 0.25, 0.5, 1.0, 2.0)
SINGLE = (0.8, 0.9, 0.95, 0.975, 0.99)
DOUBLE = ((0.8, 0.95), (0.9, 0.99), (0.95, 0.999), (0.99, 0.99999), (0.9, 0.999999))
RESAMPLES = 2000
SHOWN = ("score", "gap closed, of four", "gap closed, of six", "error over oracle", "agent better")


def one_mode(source: Any, q: float, treatment: Any = None, **options: Any) -> Bank:
    """Constant velocity with q times the white acceleration that suits the source."""
    motion = constant_velocity(source.axes, acceleration_density=q * source.filter_noise)
    return Bank((Mode("cv", motion, treatment),), source.sensor, **options)


def make_row(kind: str, source: Any, setting: dict[str, Any]) -> BankEstimator:
    """An estimator of the study."""
    given = dict(setting)
    q = given.pop("q", 1.0)
    if kind == "kf-cv":
        bank = one_mode(source, q)
    elif kind in FACTORS:
        bank = one_mode(source, q, Adaptive(kind, probabilities=tuple(given["probabilities"])))
    elif kind == "robust-imm":
        scales = Scales(acceleration=float(np.sqrt(q * source.filter_noise)))
        bank = robust_imm(source.sensor, scales, likelihood=given["likelihood"], cap=given["cap"])
    elif kind == "joint-imm":
        bank = joint_bank(one_mode(source, q), calm=given["calm"], surge=given["surge"], back=given["back"])
    elif kind in ("sage-husa", "vb-noise"):
        method = "sage-husa" if kind == "sage-husa" else "variational"
        adaptation = NoiseAdaptation(method, forgetting=given["forgetting"], floor=given["floor"])
        return AdaptiveEstimator(one_mode(source, q, learns_noise=True), adaptation, name=kind, threads=1)
    else:
        return AgentEstimator(one_mode(source, q, learns_noise=True), find_policy(kind), threads=1)
    return BankEstimator(bank, name=kind, threads=1)


def advice(lookback: bool) -> Policy:
    """The policy that follows the belief about the noise, without any learning."""
    skip = np.zeros((1, LEVELS_SIZE))
    skip[0, LEVELS_SIZE - 2] = 2.0
    layers = ((np.zeros((1, LEVELS_SIZE)), -np.ones(1)),)
    still = np.zeros(LEVELS_SIZE), np.ones(LEVELS_SIZE)
    return Policy(layers, skip, *still, covariance="mixture", lookback=lookback)


def settings_of(kind: str) -> Iterator[dict[str, Any]]:
    """What is tried when a classical filter is tuned: about twenty settings of each."""
    if kind == "kf-cv":
        yield from ({"q": q} for q in np.geomspace(0.01, 100.0, 20).tolist())
    elif kind in FACTORS:
        two = len(FACTORS[kind].probabilities) == 2
        for q, level in itertools.product(Q, DOUBLE if two else SINGLE):
            yield {"q": q, "probabilities": list(level) if two else [level]}
    elif kind == "robust-imm":
        for q, likelihood, cap in itertools.product(Q[1:4], ("t", "nominal", "adapted"), (1e3, 1e9)):
            yield {"q": q, "likelihood": likelihood, "cap": cap}
    elif kind == "joint-imm":
        for calm, surge, back in itertools.product((1.0, 2.0, 5.0), (0.4, 0.75, 1.5), (0.4, 0.8)):
            yield {"calm": calm, "surge": surge, "back": back}
    else:
        for q, forgetting, floor in itertools.product((1.0, 2.0, 4.0), (0.5, 0.7, 0.8, 0.9, 0.95), (0.1, 1.0)):
            yield {"q": q, "forgetting": forgetting, "floor": floor}


FIXED = ("mr", "huber", "rma", "mahalanobis")
"""The four of the patent, which the discrete environment offers; chang and igg3 are offered by option."""
CLASSICAL = ("kf-cv", *FIXED, "igg3", "chang", "robust-imm", "sage-husa", "vb-noise", "joint-imm")


def errors_of(estimator: BankEstimator, episodes: Episodes, noise: Any = None) -> np.ndarray:
    """Mean distance to the truth in each episode, m; the environment judges all samples but the last."""
    prior = Prior(episodes.prior_mean, episodes.prior_cov)
    found = estimator.run(episodes.measurements, episodes.times, noise, episodes.sensor_states, prior=prior)
    return np.linalg.norm(found.position - episodes.truth.position, axis=2)[:, :-1].mean(axis=1)


class Judge:
    """Episodes with the errors of the two filters that scores are between."""

    def __init__(self, source: Any, seed: int, episodes: int) -> None:
        self.source, self.episodes = source, simulate_seeds(source, seed, episodes)
        plain = BankEstimator(one_mode(source, 1.0), threads=1)
        self.nominal = errors_of(plain, self.episodes)
        self.oracle = errors_of(plain, self.episodes, self.episodes.noise)
        self.gap = np.maximum(self.nominal - self.oracle, LEAST_GAIN * float(source.sensor.sigma[0]))

    def errors(self, kind: str, setting: dict[str, Any]) -> np.ndarray:
        """Errors (E,) of an estimator."""
        return errors_of(make_row(kind, self.source, setting), self.episodes)

    def scores(self, errors: np.ndarray) -> np.ndarray:
        """Scores (..., E) of errors (..., E)."""
        return (self.nominal - errors) / self.gap


def interval(statistic: Callable[[np.ndarray, np.ndarray], float], seeds: int, episodes: int, key: int = 0) -> Measured:
    """A statistic of (training seeds, episodes), with a bootstrap over both; resamples are the same for all."""
    rng = np.random.default_rng(key)
    value = statistic(np.arange(seeds), np.arange(episodes))
    draws = [
        statistic(rng.integers(seeds, size=seeds), rng.integers(episodes, size=episodes)) for _ in range(RESAMPLES)
    ]
    low, high = np.quantile(draws, (0.025, 0.975))
    return Measured(float(value), "", float(low), float(high), f"bootstrap over {seeds} seeds and {episodes} episodes")


def better(ours: np.ndarray, theirs: np.ndarray, seeds: np.ndarray, episodes: np.ndarray) -> float:
    """Probability that an episode's score is higher with ours; both (seeds, episodes)."""
    return float(np.mean(ours[np.ix_(seeds, episodes)] > theirs[np.ix_(seeds % len(theirs), episodes)]))


def over(errors: np.ndarray, base: np.ndarray, seeds: np.ndarray, episodes: np.ndarray) -> float:
    """Mean of errors (seeds, episodes) over that of a base (episodes,)."""
    return float(errors[np.ix_(seeds % len(errors), episodes)].mean() / base[episodes].mean())


def tune(given: argparse.Namespace) -> None:
    """Choose the setting of each classical filter."""
    judge = Judge(make_source("surge"), TRAINING, given.episodes)
    chosen: dict[str, Any] = json.loads(given.out.read_text()) if given.out.exists() else {}
    with progress("tuning", len(CLASSICAL)) as advance:
        for kind in CLASSICAL:
            if kind in chosen:
                continue
            tried = [
                (float(interquartile_mean(judge.scores(judge.errors(kind, setting)))), setting)
                for setting in settings_of(kind)
            ]
            best = max(tried, key=lambda pair: pair[0])
            chosen[kind] = {"setting": best[1], "score": best[0], "trials": len(tried)}
            print(kind, f"{best[0]:.4f}", best[1], flush=True)
            given.out.write_text(json.dumps(chosen, indent=1) + "\n")
            advance()


def compare(given: argparse.Namespace) -> None:
    """Scores on the held-out episodes of the surge suite."""
    tuned = json.loads(given.tuned.read_text())
    judge = Judge(make_source("surge"), TEST_SEED, given.episodes)
    errors, cost = {}, {}
    for kind in CLASSICAL:
        began = time.process_time()
        errors[kind] = judge.errors(kind, tuned[kind]["setting"])[None]
        cost[kind] = time.process_time() - began
    began = time.process_time()
    errors["agent"] = np.array([judge.errors(folder, {}) for folder in given.agents])
    cost["agent"] = (time.process_time() - began) / len(given.agents)
    for name, look in (("advice, no look-back", False), ("advice, not learnt", True)):
        began = time.process_time()
        estimator = AgentEstimator(one_mode(judge.source, 1.0, learns_noise=True), advice(look), threads=1)
        errors[name] = errors_of(estimator, judge.episodes)[None]
        cost[name] = time.process_time() - began
    samples = judge.episodes.times.size
    scores = {kind: judge.scores(value) for kind, value in errors.items()}
    fixed = max(FIXED, key=lambda kind: tuned[kind]["score"])
    any_fixed = max((*FIXED, "igg3", "chang"), key=lambda kind: tuned[kind]["score"])
    numbers: dict[str, Measured] = {}
    rows = []

    def iqm(kind: str, seeds: np.ndarray, episodes: np.ndarray) -> float:
        mine = scores[kind]
        return float(interquartile_mean(mine[np.ix_(seeds % len(mine), episodes)].ravel()))

    for kind, values in scores.items():
        count = len(values), values.shape[1]
        numbers[f"{kind}/score"] = interval(lambda s, e, kind=kind: iqm(kind, s, e), *count)
        for name, base in (("of four", fixed), ("of six", any_fixed)):
            numbers[f"{kind}/gap closed, {name}"] = interval(
                lambda s, e, kind=kind, base=base: (iqm(kind, s, e) - iqm(base, s, e)) / (1.0 - iqm(base, s, e)), *count
            )
        numbers[f"{kind}/agent better"] = interval(
            lambda s, e, values=values: better(scores["agent"], values, s, e), len(scores["agent"]), count[1]
        )
        numbers[f"{kind}/error over oracle"] = interval(
            lambda s, e, kind=kind: over(errors[kind], judge.oracle, s, e), *count
        )
        cells = [numbers[f"{kind}/{what}"] for what in SHOWN]
        told = [f"{cell.value:.3f} [{cell.low:.3f}, {cell.high:.3f}]" for cell in cells]
        rows.append([kind, *told, f"{1e6 * cost.get(kind, np.nan) / samples:.1f}"])
    head = ["estimator", "score (IQM)", f"gap closed from {fixed}", f"gap closed from {any_fixed}", "error / oracle",
            "agent better", "us a step"]  # fmt: skip
    show(f"surge suite, {given.episodes} held-out episodes", head, rows, given.markdown)
    each = [iqm("agent", np.array([s]), np.arange(given.episodes)) for s in range(len(scores["agent"]))]
    print("score of each training seed:", " ".join(f"{value:.4f}" for value in each))
    save(given.out, numbers, tuned=tuned, fixed=fixed, any_fixed=any_fixed, each=each, agents=len(given.agents))


def places() -> dict[str, Any]:
    """Where the agent was not trained, and where there is nothing to gain."""
    bursts = "surges.0."
    told: dict[str, Any] = {name: make_scenario(name) for name in SUITES["surge"]}
    told["no surges"] = make_scenario("surge-v0", surges=())
    told["scales 2 to 4"] = make_scenario("surge-v0", **{bursts + "scale": (2.0, 4.0)})
    told["scales 10^4 to 10^5"] = make_scenario("surge-v0", **{bursts + "scale": (1e4, 1e5)})
    told["dwells 0.1 to 0.5 s"] = make_scenario("surge-v0", **{bursts + "on": (0.1, 0.5), bursts + "off": (0.1, 0.5)})
    told["dwells 5 to 15 s"] = make_scenario("surge-v0", **{bursts + "on": (5.0, 15.0), bursts + "off": (5.0, 15.0)})
    for name in (*SUITES["joint"], "switch-v0", "heavy-tail-t3-v0", "heavy-tail-contaminated-v0"):
        told[name] = make_scenario(name)
    return told


def elsewhere(given: argparse.Namespace) -> None:
    """Errors over those of the oracle, scenario by scenario."""
    tuned = json.loads(given.tuned.read_text())
    fixed = max((*FIXED, "chang"), key=lambda kind: tuned[kind]["score"])
    rows, numbers = [], {}
    for name, source in places().items():
        judge = Judge(source, TEST_SEED, given.episodes)
        errors = {kind: judge.errors(kind, tuned[kind]["setting"])[None] for kind in (fixed, "robust-imm", "joint-imm")}
        errors["agent"] = np.array([judge.errors(folder, {}) for folder in given.agents])
        if name in SUITES["joint"] or name == "switch-v0":
            for kind, bank in (("intents", intent_imm), ("joint intents", None)):
                scales = Scales(acceleration=float(np.sqrt(source.filter_noise)), speed=15.0, sojourn=3.0)
                made = intent_imm(source.sensor, scales) if bank else joint_bank(intent_imm(source.sensor, scales))
                errors[kind] = errors_of(BankEstimator(made, threads=1), judge.episodes)[None]
        cells = [name, f"{judge.nominal.sum() / judge.oracle.sum():.3f}"]
        for kind in (fixed, "robust-imm", "joint-imm", "agent", "intents", "joint intents"):
            if kind not in errors:
                cells.append("")
                continue
            mine = errors[kind]
            ratio = interval(
                lambda s, e, mine=mine, base=judge.oracle: over(mine, base, s, e), len(mine), given.episodes
            )
            numbers[f"{name}/{kind}"] = ratio
            cells.append(f"{ratio.value:.3f} [{ratio.low:.3f}, {ratio.high:.3f}]")
        numbers[f"{name}/agent over nominal"] = interval(
            lambda s, e, mine=errors["agent"], base=judge.nominal: over(mine, base, s, e),
            len(errors["agent"]), given.episodes,
        )  # fmt: skip
        n = numbers[f"{name}/agent over nominal"]
        cells.append(f"{n.value:.3f} [{n.low:.3f}, {n.high:.3f}]")
        rows.append(cells)
        print(*cells, flush=True)
    head = ["scenario", "nominal", fixed, "robust-imm", "joint-imm", "agent", "intents", "joint intents"]
    head.append("agent / nominal")
    show(f"error over the oracle's, {given.episodes} episodes", head, rows, given.markdown)
    save(given.out, numbers, tuned=tuned, agents=len(given.agents))


def recorded(given: argparse.Namespace) -> None:
    """Real flights with stale rows and jumps, no truth: distance of the next new fix from where it was expected."""
    rows = []
    for file in sorted((given.data / "aircraft_adsb").glob("noisy_*.csv")):
        request = TrackRequest(file, axes=2, columns="x=east,y=north,t=time,track=aircraft")
        tracks = read(request)
        choice = choose(request, tracks)
        cells = []
        for name in ("kf-cv", "robust-imm", "sage-husa", "joint-imm", "agent"):
            options = {**choice.options, "policy": given.agents[0]} if name == "agent" else choice.options
            found = run_tracks(make_estimator(name, choice.sensor, **options), tracks, use_noise=choice.use_noise)
            step = np.diff(tracks.times, axis=1)[..., None]
            ahead = np.asarray(found.position)[:, :-1] + step * np.asarray(found.velocity)[:, :-1]
            wrong = np.linalg.norm(tracks.measurements[:, 1:] - ahead, axis=2)
            fresh = tracks.used[:, 1:] & (np.linalg.norm(np.diff(tracks.measurements, axis=1), axis=2) > 0.0)
            wrong = wrong[fresh & np.isfinite(wrong)][20:]
            cells.append(f"{np.median(wrong):.1f}, {np.quantile(wrong, 0.9):.1f}, {np.quantile(wrong, 0.99):.0f}")
        rows.append([file.stem, *cells])
    head = ["flight", "kf-cv", "robust-imm", "sage-husa", "joint-imm", "agent"]
    show("next fix, m: median, 90 %, 99 %", head, rows, given.markdown)
    save(given.out, {}, table=[head, *rows])


def main() -> None:
    """Run one part."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("part", choices=("tune", "compare", "elsewhere", "recorded"))
    made.add_argument("--data", type=Path, help="folder of recorded tracks, of the part recorded")
    made.add_argument("--episodes", type=int, default=200)
    made.add_argument("--tuned", type=Path, help="of the part tune")
    made.add_argument("--agents", nargs="+", default=["continuous"], help="folders of jink train agent, or names")
    made.add_argument("--out", type=Path, required=True)
    made.add_argument("--markdown", action="store_true")
    given = made.parse_args()
    {"tune": tune, "compare": compare, "elsewhere": elsewhere, "recorded": recorded}[given.part](given)


if __name__ == "__main__":
    main()
