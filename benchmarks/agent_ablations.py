"""What matters when an agent is trained: one option changed at a time, several seeds, held-out episodes.

Score of an episode: 0 for the filter with nominal noise, 1 for the filter told the true noise. Of every variant:
interquartile mean over seeds and episodes with a 95 % bootstrap interval over both, what it has more than the base of
its group (the same episodes), probability that it beats the base (pairs of seeds, the same episode; ties count half),
processor seconds of a training. Options that are
searched (`CHOICES`) are chosen by the validation score of one seed; held-out episodes are seen once, by the round that
validation chose. All without look-back, which asks less of the agent. Trainings are kept in ``--work``: a run that was
stopped goes on; ``--as-is`` makes the rows of what is there, with as many seeds as each variant has.

python benchmarks/agent_ablations.py --seeds 5 --work WORK --out docs/results/agent_ablations.json
python benchmarks/agent_ablations.py --show docs/results/agent_ablations.json
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from _timing import machine
from agent_study import interval
from numpy.typing import NDArray

from jink.estimators.agent.policy import Policy
from jink.training import sb3
from jink.training.agent_checkpoint import load_checkpoint
from jink.training.agent_config import AgentConfig
from jink.training.agent_scores import Played, interquartile_mean, make_source, play_episodes, score, simulate_seeds
from jink.training.agent_seen import GROUPS
from jink.training.train_agent import CHECKPOINT, TEST_SEED, train_agent

EPISODES = 300
ADVICE, NOTHING, FACTORS = "from the advice", "from nothing", "factors"
SHIPPED = {
    "discrete": True, "covariance": "chosen", "factors": ("none", "huber", "rma", "mahalanobis", "chang"),
    "learning_rate": 5e-4, "horizon": 16, "minibatch": 2048, "discount": 0.95, "hidden": 32,
}  # fmt: skip
"""Options of the discrete policy that ships."""


class Variant(NamedTuple):
    """A training: the group whose first variant is its base, its name, options of `AgentConfig`, seeds at most."""

    group: str
    name: str
    options: dict[str, Any]
    seeds: int = 100


def hide_all_but(*names: str) -> tuple[str, ...]:
    """Groups to hide."""
    return tuple(name for name in GROUPS if name not in names)


BARE = {"warm_start": "none"}
VARIANTS = [
    Variant(ADVICE, "default", {}),
    Variant(NOTHING, "default", BARE),
    Variant(FACTORS, "default", SHIPPED),
    *(
        Variant(group, f"reward {name}", {**options, "reward": name})
        for name in ("regret", "log", "distance", "squared")
        for group, options in ((ADVICE, {}), (NOTHING, BARE))
    ),
    Variant(ADVICE, "copies the oracle", {"warm_start": "oracle"}),
    *(Variant(ADVICE, f"without {name}", {"unseen": (name,)}) for name in ("averages", "belief", "advice")),
    Variant(ADVICE, "without belief, advice", {"unseen": ("belief", "advice")}),
    *(Variant(NOTHING, f"without {name}", {**BARE, "unseen": (name,)}) for name in GROUPS),
    Variant(NOTHING, "without belief, advice", {**BARE, "unseen": ("belief", "advice")}),
    Variant(NOTHING, "advice alone", {**BARE, "unseen": hide_all_but("advice")}),
    Variant(NOTHING, "belief alone", {**BARE, "unseen": hide_all_but("belief")}),
    Variant(NOTHING, "innovation and share alone", {**BARE, "unseen": hide_all_but("innovation", "share")}),
    Variant(NOTHING, "covariance chosen", {**BARE, "covariance": "chosen"}),
    Variant(NOTHING, "view plain, covariance chosen", {**BARE, "view": "plain", "covariance": "chosen"}),
    Variant(NOTHING, "2.6 x the steps", {**BARE, "steps": 2_621_440}),
    Variant(NOTHING, "2.6 x the steps, rate 0.003", {**BARE, "steps": 2_621_440, "learning_rate": 3e-3}),
    Variant(NOTHING, "critic not told the truth", {**BARE, "informed": False}),
    Variant(ADVICE, "critic not told the truth", {"informed": False}),
    Variant(ADVICE, "critic not first", {"critic_first": 0.0}),
    Variant(ADVICE, "covariance chosen", {"covariance": "chosen"}),
    Variant(ADVICE, "first deviation 0.14", {"log_std": -2.0}),
    Variant(ADVICE, "first deviation 0.37", {"log_std": -1.0}),
    Variant(ADVICE, "copies the oracle, reward log", {"warm_start": "oracle", "reward": "log"}),
    *(Variant(NOTHING, f"first deviation {d}", {**BARE, "log_std": v}) for d, v in (("0.14", -2.0), ("1", 0.0))),
    Variant(FACTORS, "the patent's four", {**SHIPPED, "factors": AgentConfig().factors}),
    Variant(FACTORS, "covariance mixture", {**SHIPPED, "covariance": "mixture"}),
    Variant(FACTORS, "DQN", {**SHIPPED, "algorithm": "dqn"}, 3),
    Variant(NOTHING, "recurrent PPO", {**BARE, "algorithm": "recurrent-ppo"}, 3),
]
CHOICES: dict[str, list[dict[str, Any]]] = {
    "recurrent PPO": [{"log_std": value} for value in (-1.0, 0.0, 1.0, -2.0, -3.0)],
    "DQN": [{"horizon": 32, "minibatch": size} for size in (256, 1024, 8192)],
}
"""What is searched on validation episodes, seed 0, with a half of the steps."""


def config_of(variant: Variant, chosen: dict[str, Any], seed: int) -> AgentConfig:
    """The training."""
    return replace(AgentConfig(), **{"lookback": False, **variant.options, **chosen.get(variant.name, {})}, seed=seed)


def choose(variant: Variant, file: Path) -> dict[str, Any]:
    """The searched options with the best validation score; every trial is kept in a file."""
    tried: list[dict[str, Any]] = json.loads(file.read_text()) if file.exists() else []
    for options in CHOICES[variant.name][len(tried) :]:
        config = config_of(variant, {variant.name: options}, 0)
        rounds = train_agent(
            replace(config, steps=config.steps // 2), file.with_suffix("") / str(len(tried)), tensorboard=False
        ).rounds
        tried.append({"options": options, "score": max(row.score for row in rounds)})
        print(variant.name, tried[-1], flush=True)
        file.write_text(json.dumps(tried))
    return dict(max(tried, key=lambda row: row["score"])["options"])


def play_recurrent(config: AgentConfig, folder: Path, source: Any, episodes: Any) -> Played:
    """Play the model of a checkpoint, which cannot be exported."""
    model = sb3.make_model(config, sb3.make_env(config))
    load_checkpoint(folder, model)
    act = sb3.act_with_memory(model)
    return play_episodes(act, source, episodes, continuous=not config.discrete, **config.environment())


def run(config: AgentConfig, folder: Path, source: Any, episodes: Any) -> dict[str, Any]:
    """One training and its errors on held-out episodes."""
    kept: list[Played] = []
    best, spent = -np.inf, time.process_time()
    playing = 0.0

    def look(row: Any) -> None:
        nonlocal best, playing
        if config.algorithm == "recurrent-ppo" and row.score >= best:
            began = time.process_time()
            kept[:] = [play_recurrent(config, folder / CHECKPOINT, source, episodes)]
            playing += time.process_time() - began
        best = max(best, row.score)

    report = train_agent(config, folder, tensorboard=False, progress=look, fresh=True)
    spent = time.process_time() - spent - playing
    if isinstance(report.policy, Policy):
        kept = [play_episodes(report.policy, source, episodes)]
    played = kept[0]
    return {
        "seconds": spent, "validation": best, "steps": report.rounds[-1].steps,
        "scores": np.round(score(played.agent, played.nominal, played.oracle, played.sigma), 5).tolist(),
        "rounds": [row.score for row in report.rounds],
    }  # fmt: skip


def wins(
    ours: NDArray[np.float64], base: NDArray[np.float64], seeds: NDArray[np.int64], episodes: NDArray[np.int64]
) -> float:
    """Probability that a training of ours beats one of the base on an episode; ties count half."""
    mine = ours[np.ix_(seeds, episodes)][:, None]
    theirs = base[np.ix_(seeds % len(base), episodes)][None]
    return float(np.mean(mine > theirs) + 0.5 * np.mean(mine == theirs))


def middle_gap(
    ours: NDArray[np.float64], base: NDArray[np.float64], seeds: NDArray[np.int64], episodes: NDArray[np.int64]
) -> float:
    """Interquartile mean of ours minus that of the base, the same episodes in both."""
    mine, theirs = ours[np.ix_(seeds, episodes)], base[np.ix_(seeds % len(base), episodes)]
    return float(interquartile_mean(mine.ravel()) - interquartile_mean(theirs.ravel()))


def summarise(found: dict[str, dict[str, list[dict[str, Any]]]]) -> list[dict[str, Any]]:
    """A row of each variant that has a seed."""
    rows = []
    for group, variants in found.items():
        names = list(variants)
        base = np.array([one["scores"] for one in variants[names[0]]])
        for name, trainings in variants.items():
            values = np.array([one["scores"] for one in trainings])
            size = values.shape
            middle = interval(
                lambda s, e, values=values: float(interquartile_mean(values[np.ix_(s, e)].ravel())), *size
            )
            row: dict[str, Any] = {"group": group, "variant": name, "seeds": size[0]}
            row |= {"score": [round(v, 4) for v in (middle.value, middle.low, middle.high)]}
            if name != names[0]:
                won = interval(lambda s, e, values=values, base=base: wins(values, base, s, e), *size)
                row["beats base"] = [round(v, 3) for v in (won.value, won.low, won.high)]
                more = interval(lambda s, e, values=values, base=base: middle_gap(values, base, s, e), *size)
                row["more"] = [round(v, 4) for v in (more.value, more.low, more.high)]
            row["each"] = [round(float(interquartile_mean(one)), 4) for one in values]
            row["steps"] = trainings[0]["steps"]
            row["seconds"] = round(float(np.median([one["seconds"] for one in trainings])), 1)
            rows.append(row)
    return rows


def cells(row: dict[str, Any]) -> list[str]:
    """Cells of the page's table."""
    value, low, high = row["score"]
    told = [row["variant"], str(row["seeds"]), f"{value:.3f} [{low:.3f}, {high:.3f}]"]
    told.append(f"{min(row['each']):.3f} to {max(row['each']):.3f}")
    for name, form in (("more", "+.3f"), ("beats base", ".2f")):
        low_to_high = row.get(name)
        told.append("{:{f}} [{:{f}}, {:{f}}]".format(*low_to_high, f=form) if low_to_high else "")
    return [*told, f"{row['seconds']:.0f}"]


def table(kept: dict[str, Any]) -> list[str]:
    """Lines of the page's tables, a table a group."""
    lines = []
    for group in dict.fromkeys(row["group"] for row in kept["rows"]):
        lines += ["", f"| {group} | seeds | score (IQM) | of one seed | more than the first | beats the first | s |"]
        lines += ["|---|---|---|---|---|---|---|"]
        lines += ["| " + " | ".join(cells(row)) + " |" for row in kept["rows"] if row["group"] == group]
    return lines


def main() -> None:
    """Train what is missing and write the rows, or show them."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--seeds", type=int, default=5)
    made.add_argument("--work", type=Path, help="folder of trainings")
    made.add_argument("--out", type=Path, help="rows, JSON")
    made.add_argument("--as-is", action="store_true", help="train nothing")
    made.add_argument("--only", help="variants with this in their name")
    made.add_argument("--show", type=Path, help="print the tables of such a file and stop")
    given = made.parse_args()
    if given.show is not None:
        print(*table(json.loads(given.show.read_text())), sep="\n")
        return
    if given.work is None or given.out is None:
        made.error("--work and --out are needed")
    given.work.mkdir(parents=True, exist_ok=True)
    source = make_source("surge")
    episodes = simulate_seeds(source, TEST_SEED, EPISODES)
    chosen: dict[str, Any] = {}
    for seed in range(given.seeds):
        for number, variant in enumerate(VARIANTS):
            if seed >= variant.seeds or (given.only and given.only not in variant.name):
                continue
            if variant.name in CHOICES and variant.name not in chosen:
                chosen[variant.name] = choose(variant, given.work / f"choice-{variant.name.replace(' ', '-')}.json")
            folder = given.work / f"{variant.group}-{variant.name}".replace(" ", "-").replace(",", "") / str(seed)
            file = folder.with_suffix(".json")
            if not file.exists() and not given.as_is:
                done = run(config_of(variant, chosen, seed), folder, source, episodes)
                file.write_text(json.dumps(done))
                middle = interquartile_mean(np.array(done["scores"]))
                print(number, variant.group, variant.name, seed, f"{middle:.4f} {done['seconds']:.0f} s", flush=True)
    found: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for variant in VARIANTS:
        folder = given.work / f"{variant.group}-{variant.name}".replace(" ", "-").replace(",", "")
        files = [folder / f"{seed}.json" for seed in range(min(given.seeds, variant.seeds))]
        there = itertools.takewhile(Path.exists, files)
        trainings = [json.loads(file.read_text()) for file in there]
        if trainings:
            found.setdefault(variant.group, {})[variant.name] = trainings
    command = f"python benchmarks/agent_ablations.py --seeds {given.seeds} --work WORK --out {given.out.name}"
    kept = {"command": command, "episodes": EPISODES, "chosen": chosen, "machine": machine()}
    kept["rows"] = summarise(found)
    given.out.write_text(json.dumps(kept, indent=1) + "\n")
    print(*table(kept), sep="\n")


if __name__ == "__main__":
    main()
