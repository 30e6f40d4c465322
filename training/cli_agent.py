"""Command about agents: `jink train agent`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from jink.training.console import say_when_compiling, screen, stderr

__all__ = ["AGENT_HELP", "train_agent_command"]

_TASK, _LEARNING, _OUTPUT = "What happens", "Learning", "What comes out"

AGENT_HELP = """Learn how far to distrust each measurement, by reinforcement (PPO, DQN, or recurrent PPO).

The folder of --out gets the policy (JSON and safetensors), which runs without torch: 'jink track FILE --estimator agent
--policy FOLDER'. After a kill the same command goes on from the last round. Training, validation and test episodes
never share a seed.

Examples:

  jink train agent --out agent/

  jink train agent --discrete --out discrete/

  jink train agent --scenario joint-v0 --steps 2000000 --seed 3 --out joint/
"""


def train_agent_command(
    out: Annotated[Path, typer.Option(help="Folder of the policy.", rich_help_panel=_OUTPUT)] = Path("agent"),
    discrete: Annotated[
        bool, typer.Option("--discrete", help="Choose a factor instead of an inflation.", rich_help_panel=_TASK)
    ] = False,
    suite: Annotated[str | None, typer.Option(help="Suite of scenarios; default surge.", rich_help_panel=_TASK)] = None,
    scenario: Annotated[str | None, typer.Option(help="One scenario instead.", rich_help_panel=_TASK)] = None,
    reward: Annotated[
        str | None, typer.Option(help="log-regret (default), regret, distance, squared or log.", rich_help_panel=_TASK)
    ] = None,
    view: Annotated[
        str | None, typer.Option(help="What it sees: levels (default) or plain.", rich_help_panel=_TASK)
    ] = None,
    unseen: Annotated[
        str | None, typer.Option(help="Groups of the view levels to hide, comma between.", rich_help_panel=_TASK)
    ] = None,
    covariance: Annotated[str | None, typer.Option(help="mixture (default) or chosen.", rich_help_panel=_TASK)] = None,
    lookback: Annotated[
        bool | None,
        typer.Option(
            "--lookback/--no-lookback",
            help="Judge the last measurement again with the next; default with covariance mixture.",
            rich_help_panel=_TASK,
        ),
    ] = None,
    factors: Annotated[
        str | None, typer.Option(help="Of --discrete: names of 'jink list', comma between.", rich_help_panel=_TASK)
    ] = None,
    algorithm: Annotated[
        str | None, typer.Option(help="ppo (default), dqn or recurrent-ppo.", rich_help_panel=_LEARNING)
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="Environment steps, never more; default 1015808.", rich_help_panel=_LEARNING)
    ] = None,
    environments: Annotated[
        int | None, typer.Option(help="Targets side by side; default 1024.", rich_help_panel=_LEARNING)
    ] = None,
    horizon: Annotated[
        int | None, typer.Option(help="Steps between updates; default 32.", rich_help_panel=_LEARNING)
    ] = None,
    minibatch: Annotated[
        int | None, typer.Option(help="Samples a gradient; default 8192.", rich_help_panel=_LEARNING)
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(help="Passes over a batch; default 4.", rich_help_panel=_LEARNING)
    ] = None,
    learning_rate: Annotated[
        float | None, typer.Option(help="At the start; default 0.0003.", rich_help_panel=_LEARNING)
    ] = None,
    discount: Annotated[
        float | None, typer.Option(help="Of later rewards; default 0.98.", rich_help_panel=_LEARNING)
    ] = None,
    hidden: Annotated[int | None, typer.Option(help="Units of a layer; default 64.", rich_help_panel=_LEARNING)] = None,
    rounds: Annotated[
        int | None, typer.Option(help="Evaluations and checkpoints; default 5.", rich_help_panel=_LEARNING)
    ] = None,
    warm_start: Annotated[
        str | None, typer.Option(help="advice (default), oracle or none.", rich_help_panel=_LEARNING)
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything drawn.", rich_help_panel=_LEARNING)] = 0,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Begin anew whatever lies in --out.", rich_help_panel=_OUTPUT)
    ] = False,
) -> None:
    """Learn how far to distrust each measurement."""
    from jink.training.agent_config import AgentConfig, refuse_idle
    from jink.training.train_agent import AgentReport, train_agent

    given = {
        "reward": reward, "view": view, "covariance": covariance, "algorithm": algorithm, "steps": steps,
        "environments": environments, "horizon": horizon, "minibatch": minibatch, "epochs": epochs,
        "learning_rate": learning_rate, "discount": discount, "hidden": hidden, "rounds": rounds,
        "warm_start": warm_start, "lookback": lookback,
        "factors": None if factors is None else tuple(name.strip() for name in factors.split(",")),
        "unseen": None if unseen is None else tuple(name.strip() for name in unseen.split(",")),
    }  # fmt: skip
    options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if view == "plain" and covariance is None:
        options["covariance"] = "chosen"
    suite = "surge" if suite is None and scenario is None else suite
    fixed: dict[str, Any] = {"discrete": discrete, "suite": suite, "scenario": scenario, "seed": seed}
    config = AgentConfig(**fixed, **options)
    refuse_idle(config, options.keys())
    with say_when_compiling(), _Bar(config.rounds) as bar:
        report: AgentReport = train_agent(config, out, fresh=fresh, progress=bar.told)
    _print(report, out)


class _Bar:
    """A progress bar on a terminal, a line for every round elsewhere."""

    def __init__(self, rounds: int) -> None:
        import sys

        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        self.rounds, self.terminal = rounds, sys.stderr.isatty()
        self.bar = Progress(
            TextColumn("round {task.completed} of {task.total}"),
            BarColumn(),
            TextColumn("{task.fields[said]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=stderr(),
            transient=True,
            disable=not self.terminal,
        )
        self.task = self.bar.add_task("", total=rounds, said="")

    def __enter__(self) -> _Bar:
        self.bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.stop()

    def told(self, found: object) -> None:
        """One more round."""
        row = found
        said = f"{row.steps} steps, score {row.score:.4f}, mean {row.mean:.3f}"  # type: ignore[attr-defined]
        if self.terminal:
            self.bar.update(self.task, completed=row.round, said=said)  # type: ignore[attr-defined]
        else:
            stderr().print(f"round {row.round} of {self.rounds}: {said}", markup=False)  # type: ignore[attr-defined]


def _print(report: object, out: Path) -> None:
    from jink.training.summary import plain_table

    console = screen()
    table = plain_table("round", "steps", "score (IQM)", "mean score", "reward while learning")
    for row in report.rounds:  # type: ignore[attr-defined]
        table.add_row(str(row.round), str(row.steps), f"{row.score:.4f}", f"{row.mean:.4f}", f"{row.reward:.4f}")
    console.print(table)
    console.print(
        "score: 0 = filter with nominal noise, 1 = filter told the true noise; validation episodes", markup=False
    )
    if report.policy is None:  # type: ignore[attr-defined]
        console.print("a recurrent agent is trained for comparison and cannot be exported", markup=False)
    else:
        console.print(f"best policy in {out}", markup=False)
