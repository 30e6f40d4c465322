"""Commands about intents: `jink train intents`, `jink show`, `jink segment`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from jink.training.cli_agent import AGENT_HELP, train_agent_command
from jink.training.console import screen

__all__ = ["add_commands"]

_READING, _SIMULATED, _LEARNING, _OUTPUT = "Reading files", "Simulated sources", "Learning", "What comes out"

_TRAIN_HELP = """Learn the intents behind tracks: how many, how each moves, how long it lasts, what follows it.

SOURCES are CSV or Parquet files, scenarios or suites of 'jink list'. The folder of --out gets the model (JSON and
safetensors), pictures and a README. After a kill the same command goes on from the last checkpoint.

Examples:

  jink train intents radar.csv --out model/

  jink train intents flights.parquet more.csv --noise learn --seconds 600

  jink train intents switch-loiter-v0 --tracks 64 --intents 3 --out loiter/
"""
_SHOW_HELP = """Print and draw the intents of a model.

Examples:

  jink show model/

  jink show model/ --plot intents.png
"""
_SEGMENT_HELP = """Label each row of a file with the intent it shows, and find where the intent changes.

Every row is judged by the whole track (a smoother). With --out each row gets its label, the probability of each
intent, and the probability that the intent changed since the row before.

Examples:

  jink segment radar.csv --model model/ --out labels.csv

  jink segment radar.csv --model model/ --plot track.png --show 7
"""

Columns = Annotated[str, typer.Option(help="Our names to the file's: t=time,x=east.", rich_help_panel=_READING)]
Where = Annotated[
    list[str] | None, typer.Option(help="Keep rows whose column has a value: gps_new=1.", rich_help_panel=_READING)
]
Axes = Annotated[int | None, typer.Option(help="Space dimensions, 2 or 3.", rich_help_panel=_READING)]
Sort = Annotated[bool, typer.Option("--sort", help="Sort by time.", rich_help_panel=_READING)]
Degrees = Annotated[
    bool, typer.Option("--degrees", help="Angles of the file and of --sigma are in degrees.", rich_help_panel=_READING)
]
Compass = Annotated[
    bool, typer.Option("--compass", help="Bearings are clockwise from north.", rich_help_panel=_READING)
]
DropRepeats = Annotated[
    bool, typer.Option("--drop-repeats", help="Leave out stale repeated rows.", rich_help_panel=_READING)
]
Rate = Annotated[float | None, typer.Option(help="Rows per second, without a time column.", rich_help_panel=_READING)]
Sigma = Annotated[
    str | None,
    typer.Option(help="Standard deviation: 15, or sigma_range=1,sigma_bearing=.01.", rich_help_panel=_READING),
]


def add_commands(app: typer.Typer) -> None:
    """Add the commands to the `jink` command."""
    train = typer.Typer(help="Learn intents from tracks, or an agent from simulations.", no_args_is_help=True)
    train.command("intents", help=_TRAIN_HELP)(_train_intents)
    train.command("agent", help=AGENT_HELP)(train_agent_command)
    app.add_typer(train, name="train")
    app.command("show", help=_SHOW_HELP)(_show)
    app.command("segment", help=_SEGMENT_HELP)(_segment)


def _train_intents(
    sources: Annotated[list[str], typer.Argument(help="Files, scenarios or suites.", metavar="SOURCES...")],
    out: Annotated[Path, typer.Option(help="Folder of the model.", rich_help_panel=_OUTPUT)] = Path("model"),
    intents: Annotated[
        int | None, typer.Option(help="How many; default: chosen by held-out likelihood.", rich_help_panel=_LEARNING)
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            help="Measurement noise per axis, m, or learn; default: that of the tracks.", rich_help_panel=_LEARNING
        ),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Time for fitting, s; default: the learner's.", rich_help_panel=_LEARNING)
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything drawn.", rich_help_panel=_LEARNING)] = 0,
    device: Annotated[str, typer.Option(help="cpu or cuda.", rich_help_panel=_LEARNING)] = "cpu",
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Begin anew whatever lies in --out.", rich_help_panel=_OUTPUT)
    ] = False,
    tracks: Annotated[int, typer.Option(help="Tracks of each scenario.", rich_help_panel=_SIMULATED)] = 128,
    steps: Annotated[
        int | None, typer.Option(help="Samples of each track; default the scenario's.", rich_help_panel=_SIMULATED)
    ] = None,
    columns: Columns = "",
    where: Where = None,
    axes: Axes = None,
    sigma: Sigma = None,
    sort: Sort = False,
    degrees: Degrees = False,
    compass: Compass = False,
    drop_repeats: DropRepeats = False,
    rate_hz: Rate = None,
) -> None:
    """Learn the intents of tracks."""
    from jink.training.intent_summary import print_trained
    from jink.training.track import TrackRequest
    from jink.training.train_intents import TrainRequest, train_intents

    reading = TrackRequest(
        Path(),
        columns=columns,
        where=tuple(where or ()),
        axes=axes,
        sigma=sigma,
        sort=sort,
        degrees=degrees,
        compass=compass,
        drop_repeats=drop_repeats,
        rate_hz=rate_hz,
    )
    request = TrainRequest(tuple(sources), out, intents, noise, seconds, tracks, steps, seed, device, fresh, reading)
    print_trained(screen(), train_intents(request))


def _show(
    model: Annotated[str, typer.Argument(help="Folder, or a name of 'jink list'.", metavar="MODEL")],
    plot: Annotated[Path | None, typer.Option(help="Picture to this .png, .pdf or .svg.")] = None,
) -> None:
    """Print and draw the intents of a model."""
    from jink.training.show import show

    show(model, plot, screen())


def _segment(
    file: Annotated[Path, typer.Argument(help="CSV or Parquet file of measurements.", metavar="FILE")],
    model: Annotated[str, typer.Option(help="Folder of jink train intents, or a name of 'jink list'.")],
    out: Annotated[Path | None, typer.Option(help="Labels to this .csv or .parquet.", rich_help_panel=_OUTPUT)] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Picture to this .png, .pdf or .svg.", rich_help_panel=_OUTPUT)
    ] = None,
    show: Annotated[
        str | None, typer.Option(help="Track to draw; default the longest.", rich_help_panel=_OUTPUT)
    ] = None,
    handed: Annotated[
        bool, typer.Option("--handed", help="Left and right are labels of their own.", rich_help_panel=_OUTPUT)
    ] = False,
    columns: Columns = "",
    where: Where = None,
    axes: Axes = None,
    sigma: Sigma = None,
    sort: Sort = False,
    degrees: Degrees = False,
    compass: Compass = False,
    drop_repeats: DropRepeats = False,
    rate_hz: Rate = None,
) -> None:
    """Label the rows of a file."""
    from jink.training.segment import SegmentRequest, print_segmented, segment_file
    from jink.training.track import TrackRequest

    reading = TrackRequest(
        file,
        columns=columns,
        where=tuple(where or ()),
        axes=axes,
        sigma=sigma,
        sort=sort,
        degrees=degrees,
        compass=compass,
        drop_repeats=drop_repeats,
        rate_hz=rate_hz,
    )
    print_segmented(screen(), segment_file(SegmentRequest(reading, model, out, plot, show, handed)))
