"""Do large batches learn as well as small ones: trainings of the agent from nothing, by steps and by processor time.

Stable-baselines3 has 8 environments of 2048 steps, minibatches of 64 and ten passes by default; ours are 1024
environments of 32 steps, minibatches of 8192 and four passes. Both learn for the same number of steps, ours for
``--longer`` times as many (a third of the processor time of the small ones); 4096 and 16 384, and larger learning
rates, beside them. Processor time is that of the whole training, evaluations
included. The rate of learning falls with the steps asked for, so the middle of a long training is not a short one.
Rows are kept in ``--out`` as they come: a run that was stopped goes on.

python benchmarks/agent_batches.py --steps 327680 --seeds 3 --out docs/results/agent_batches.json
python benchmarks/agent_batches.py --show docs/results/agent_batches.json --picture docs/pictures/agent_batches.png
"""

from __future__ import annotations

import argparse
import hashlib
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from _timing import machine

from jink.training.agent_config import AgentConfig
from jink.training.train_agent import train_agent

SMALL, LARGE = "64 of 8 x 2048, 10 passes", "8192 of 1024 x 32, 4 passes"


def ways(steps: int, longer: int) -> dict[str, AgentConfig]:
    """The trainings that are compared, none with a warm start, none with look-back."""
    large = replace(AgentConfig(), steps=steps, warm_start="none", lookback=False)
    small = replace(large, environments=8, horizon=2048, minibatch=64, epochs=10)
    return {
        SMALL: small,
        LARGE: large,
        "4096 of 1024 x 32, 4 passes": replace(large, minibatch=4096),
        "16384 of 1024 x 32, 4 passes": replace(large, minibatch=16384),
        f"{LARGE}, rate 0.001": replace(large, learning_rate=1e-3),
        f"{LARGE}, rate 0.003": replace(large, learning_rate=3e-3),
        f"{LARGE}, {longer} x steps": replace(large, steps=steps * longer),
        f"{LARGE}, rate 0.003, {longer} x steps": replace(large, steps=steps * longer, learning_rate=3e-3),
    }


def learn(config: AgentConfig) -> list[dict[str, float]]:
    """Score of the validation episodes after each round, with its steps and the processor time until then."""
    rows: list[dict[str, float]] = []
    began = time.process_time()

    def note(found: Any) -> None:
        spent = time.process_time() - began
        rows.append({"steps": found.steps, "score": round(found.score, 5), "seconds": round(spent, 1)})

    with tempfile.TemporaryDirectory() as folder:
        train_agent(config, Path(folder) / "x", tensorboard=False, progress=note)
    return rows


def reached(seeds: dict[str, list[dict[str, float]]], what: str, budget: float) -> str:
    """Scores of the seeds after the last round that ended within 1.05 times so many steps or seconds (``what``)."""
    scores = []
    for rows in seeds.values():
        within = [row["score"] for row in rows if row[what] <= 1.05 * budget]
        scores.append(f"{within[-1]:.3f}" if within else "-")
    return ", ".join(scores)


def table(found: dict[str, Any]) -> list[str]:
    """Lines of a markdown table: scores of the seeds at the ends of trainings, then against processor time."""
    rows = found["rows"]
    lines = ["| training | steps | s | scores at its end | after 8 s | 16 s | 32 s | 90 s |"]
    lines += ["|---|---|---|---|---|---|---|---|"]
    for name, seeds in rows.items():
        last = [one[-1] for one in seeds.values()]
        spent = float(np.median([row["seconds"] for row in last]))
        ends = ", ".join(f"{row['score']:.3f}" for row in last)
        cells = [name, str(int(last[0]["steps"])), f"{spent:.0f}", ends]
        cells += [reached(seeds, "seconds", budget) if budget <= spent * 1.2 else "" for budget in (8, 16, 32, 90)]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def draw(found: dict[str, Any], path: Path) -> None:
    """Scores against steps and against processor time: the shipped batches, those of stable-baselines3, both longer."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    looks = (("#b84700", "o", SMALL), ("#0072B2", "s", LARGE))
    figure, axes = plt.subplots(1, 2, sharey=True, figsize=(9.6, 3.6), dpi=100, layout="constrained")
    for name, seeds in found["rows"].items():
        for colour, marker, kind in looks:
            if not name.startswith(kind) or "rate" in name:
                continue
            style = "-" if name == kind else "--"
            for number, rows in enumerate(seeds.values()):
                for axis, what in zip(axes, ("steps", "seconds"), strict=True):
                    axis.plot(
                        [row[what] for row in rows], [row["score"] for row in rows], color=colour, marker=marker,
                        linestyle=style, linewidth=1.2, markersize=4, label=name if number == 0 else None,
                    )  # fmt: skip
    for axis, title in zip(axes, ("environment steps", "processor time, s"), strict=True):
        axis.set_xscale("log")
        axis.set_xlabel(title)
        axis.grid(color="#d9dde1", linewidth=0.6)
        axis.set_ylim(-1.0, 1.0)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    axes[0].set_ylabel("score: 0 nominal noise, 1 oracle")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False, fontsize=9)
    figure.savefig(path, metadata={"Description": digest(found), "Software": None})
    plt.close(figure)


def digest(found: dict[str, Any]) -> str:
    """Says which rows a picture was drawn from; kept in it."""
    return hashlib.sha256(json.dumps(found["rows"], sort_keys=True).encode()).hexdigest()[:16]


def main() -> None:
    """Train and write, or show."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--steps", type=int, default=327_680)
    made.add_argument("--seeds", type=int, default=3)
    made.add_argument("--longer", type=int, default=8, help="times the steps, of ours once more")
    made.add_argument("--out", type=Path, help="rows, JSON")
    made.add_argument("--show", type=Path, help="print the table of such a file and stop")
    made.add_argument("--picture", type=Path, help="of --show: draw it too, PNG")
    given = made.parse_args()
    if given.show is not None:
        shown = json.loads(given.show.read_text())
        print(*table(shown), sep="\n")
        if given.picture is not None:
            draw(shown, given.picture)
        return
    command = f"python benchmarks/agent_batches.py --steps {given.steps} --seeds {given.seeds} --out {given.out}"
    found: dict[str, Any] = {"command": command, **machine(), "rows": {}}
    if given.out is not None and given.out.exists():
        found = json.loads(given.out.read_text())
    learn(replace(AgentConfig(), steps=32_768, rounds=1, critic_first=0.0))  # kernels are loaded before it counts
    for name, config in ways(given.steps, given.longer).items():
        for seed in range(given.seeds):
            if str(seed) in found["rows"].get(name, {}):
                continue
            rows = found["rows"].setdefault(name, {})[str(seed)] = learn(replace(config, seed=seed))
            print(name, seed, *(f"{row['score']:.3f}" for row in rows), f"{rows[-1]['seconds']:.0f} s", flush=True)
            if given.out is not None:
                given.out.write_text(json.dumps(found, indent=1) + "\n")
    print(*table(found), sep="\n")


if __name__ == "__main__":
    main()
