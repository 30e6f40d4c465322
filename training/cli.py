"""The `jink` command."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from jink.training.cli_intents import add_commands
from jink.training.console import run_command, say_when_compiling, screen

if TYPE_CHECKING:
    from jink.training.track import TrackRequest

__all__ = ["app", "main"]

app = typer.Typer(
    name="jink",
    help="Track targets that change their mind, and compare those who do it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(asked: bool) -> None:
    """Name and version, then Python's and Numba's: what a report of a fault needs."""
    if asked:
        from importlib.metadata import version
        from platform import python_version

        print(f"jink {version('jink')}, python {python_version()}, numba {version('numba')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Show versions and leave.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Track targets that change their mind, and compare those who do it."""


_TRACK_HELP = """Estimate the tracks of a CSV or Parquet file.

Columns are recognised by name; noise, acceleration and speed that are not given are estimated from the file.

Examples:

  jink track radar.csv --estimator intent-imm --plot track.png

  jink track fixes.csv --truth gnss.csv --axes 2 --out estimates.parquet

  jink track log.csv --columns t=time,x=east,y=north --sigma 15 --acceleration 2

  jink track radar.csv --sigma sigma_range=10,sigma_bearing=0.3 --degrees

  jink track flight.csv --where fresh=1 --columns z=alt_m --smooth --out flight.csv

  jink track radar.csv --estimator intent-imm --model model/

  jink track radar.csv --estimator mine.py:make

Many targets in clutter, from detections without names (rows that share time and sensor are a scan):

  jink track scans.csv --estimator pmht --sigma 5 --out tracks.csv --plot tracks.png --film tracks.gif

  jink track scans.csv --estimator distributed-pmht --network graph.json --out tracks.parquet
"""
_READING, _MODEL, _OUTPUT = "Reading the file", "What is assumed", "What comes out"
_MANY_MODEL = "What is assumed of many targets (pmht, gnn, jpda, distributed-pmht)"


@app.command("track", help=_TRACK_HELP)
def track_command(
    file: Annotated[Path, typer.Argument(help="CSV or Parquet file of measurements.", metavar="FILE")],
    estimator: Annotated[
        str, typer.Option("--estimator", "-e", help="Name from 'jink list', or FILE.py:NAME.")
    ] = "imm",
    model: Annotated[
        str | None,
        typer.Option(help="Learned intents: a folder of jink train, or a name.", rich_help_panel=_MODEL),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(help="Of agent: a folder of jink train agent, or a name.", rich_help_panel=_MODEL),
    ] = None,
    columns: Annotated[
        str, typer.Option(help="Our names to the file's: t=time,x=east,y=north.", rich_help_panel=_READING)
    ] = "",
    truth: Annotated[Path | None, typer.Option(help="File of true positions.", rich_help_panel=_READING)] = None,
    truth_columns: Annotated[str, typer.Option(help="As --columns, for the truth.", rich_help_panel=_READING)] = "",
    where: Annotated[
        list[str] | None,
        typer.Option(help="Keep rows whose column has a value: gps_new=1.", rich_help_panel=_READING),
    ] = None,
    bias: Annotated[
        list[str] | None,
        typer.Option(help="Known constant error, subtracted: range=2.8.", rich_help_panel=_READING),
    ] = None,
    axes: Annotated[int | None, typer.Option(help="Space dimensions, 2 or 3.", rich_help_panel=_READING)] = None,
    height: Annotated[
        float | None,
        typer.Option(help="Height of the target, m: slant ranges to horizontal.", rich_help_panel=_READING),
    ] = None,
    sort: Annotated[bool, typer.Option("--sort", help="Sort by time.", rich_help_panel=_READING)] = False,
    degrees: Annotated[
        bool,
        typer.Option("--degrees", help="Angles of the file and of --sigma are in degrees.", rich_help_panel=_READING),
    ] = False,
    compass: Annotated[
        bool, typer.Option("--compass", help="Bearings are clockwise from north.", rich_help_panel=_READING)
    ] = False,
    drop_repeats: Annotated[
        bool,
        typer.Option("--drop-repeats", help="Leave out stale repeated rows.", rich_help_panel=_READING),
    ] = False,
    rate_hz: Annotated[
        float | None, typer.Option(help="Rows per second, without a time column.", rich_help_panel=_READING)
    ] = None,
    sigma: Annotated[
        str | None,
        typer.Option(help="Standard deviation: 15, or sigma_range=1,sigma_bearing=.01.", rich_help_panel=_MODEL),
    ] = None,
    acceleration: Annotated[
        float | None, typer.Option(help="Typical acceleration, m/s^2.", rich_help_panel=_MODEL)
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="Typical speed along an axis, m/s.", rich_help_panel=_MODEL)
    ] = None,
    turn_rate: Annotated[float | None, typer.Option(help="Typical turn rate, rad/s.", rich_help_panel=_MODEL)] = None,
    sojourn: Annotated[
        float | None, typer.Option(help="Mean time between changes of mode, s.", rich_help_panel=_MODEL)
    ] = None,
    surge_every: Annotated[
        float | None,
        typer.Option(help="Mean time between noise surges, s (joint-imm).", rich_help_panel=_MODEL),
    ] = None,
    surge_for: Annotated[
        float | None, typer.Option(help="Mean duration of a noise surge, s (joint-imm).", rich_help_panel=_MODEL)
    ] = None,
    gate: Annotated[
        bool, typer.Option("--gate", help="Leave out measurements far from their own past.", rich_help_panel=_MODEL)
    ] = False,
    detection: Annotated[
        float | None, typer.Option(help="Chance that a target is detected in a scan.", rich_help_panel=_MANY_MODEL)
    ] = None,
    clutter: Annotated[
        float | None, typer.Option(help="False alarms per scan of a sensor.", rich_help_panel=_MANY_MODEL)
    ] = None,
    gate_size: Annotated[
        float | None,
        typer.Option(help="Detections farther away are no candidates; sd, default 5.", rich_help_panel=_MANY_MODEL),
    ] = None,
    window: Annotated[
        int | None,
        typer.Option(help="Scans explained together; default 10, in a network 5.", rich_help_panel=_MANY_MODEL),
    ] = None,
    network: Annotated[
        Path | None, typer.Option(help="Nodes, sensors and links: graph.json.", rich_help_panel=_MANY_MODEL)
    ] = None,
    cutoff: Annotated[
        float | None,
        typer.Option(
            help="With --truth: distance from which a track is of no target, m; default ten of the run's own sd.",
            rich_help_panel=_MANY_MODEL,
        ),
    ] = None,
    smooth: Annotated[
        bool,
        typer.Option("--smooth", help="Use later measurements too.", rich_help_panel=_OUTPUT),
    ] = False,
    forecast: Annotated[
        float | None,
        typer.Option(help="Say where each track will be, seconds after its end.", rich_help_panel=_OUTPUT),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Estimates to this .parquet or .csv.", rich_help_panel=_OUTPUT)
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Picture to this .png, .pdf or .svg.", rich_help_panel=_OUTPUT)
    ] = None,
    show: Annotated[
        str | None, typer.Option(help="Track to draw; default the longest.", rich_help_panel=_OUTPUT)
    ] = None,
    film: Annotated[
        Path | None, typer.Option(help="Many targets: playback to this .gif or .mp4.", rich_help_panel=_OUTPUT)
    ] = None,
) -> None:
    """Estimate the tracks of a file."""
    from jink.training.track import TrackRequest

    _track(
        TrackRequest(
            file=file,
            estimator=estimator,
            model=model,
            policy=policy,
            columns=columns,
            truth=truth,
            truth_columns=truth_columns,
            where=tuple(where or ()),
            bias=tuple(bias or ()),
            axes=axes,
            height=height,
            sort=sort,
            degrees=degrees,
            compass=compass,
            drop_repeats=drop_repeats,
            rate_hz=rate_hz,
            sigma=sigma,
            acceleration=acceleration,
            speed=speed,
            turn_rate=turn_rate,
            sojourn=sojourn,
            surge_every=surge_every,
            surge_for=surge_for,
            gate=gate,
            smooth=smooth,
            forecast=forecast,
            out=out,
            plot=plot,
            shown=show,
            detection=detection,
            clutter=clutter,
            gate_size=gate_size,
            window=window,
            network=network,
            cutoff=cutoff,
            film=film,
        )
    )


def _track(request: TrackRequest) -> None:
    """Run a request and print what came out."""
    from jink.training.many_estimators import MANY

    console = screen()
    if request.estimator in MANY:
        from jink.training.many_summary import print_many
        from jink.training.track_many import track_many

        print_many(console, track_many(request))
    else:
        from jink.training.summary import print_report
        from jink.training.track import track

        print_report(console, track(request))
    for path in (request.out, request.plot, request.film):
        if path is not None:
            console.print(f"wrote {path}", markup=False)


@app.command(
    "list",
    help="Name the estimators, motions, sensors, environments, scenarios and suites.\n\nExample:\n\n  jink list",
)
def list_command() -> None:
    """Name the estimators, motions, sensors, environments, scenarios and suites."""
    from jink.training.catalogue import print_catalogue

    print_catalogue(screen())


_BENCH_HELP = """Compare estimators and print tables; rows are written as they finish.

Without --suite: a first look at the ladder from raw measurement to bound. Rows already in --out are not computed
again, so an interrupted run goes on where it stopped. Every row holds the command that makes exactly its cell.

Examples:

  jink bench

  jink bench --suite surge --out rows.parquet --workers 2 --report report.html

  jink bench --suite joint --scenario joint-v0 --estimator imm --estimator mine.py:make

  jink bench --suite recorded --data DIR --out rows.parquet

  jink bench --suite all --out rows.parquet --backend dask --address tcp://head:8786 --workers 64
"""


@app.command("bench", help=_BENCH_HELP)
def bench_command(
    suite: Annotated[str | None, typer.Option(help="Name from 'jink list', or all; default a first look.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A first answer within a minute.")] = False,
    out: Annotated[Path | None, typer.Option(help="Rows to this .parquet; appended.")] = None,
    data: Annotated[Path | None, typer.Option(help="Folder of recorded tracks.")] = None,
    runs: Annotated[int | None, typer.Option(help="Monte-Carlo runs; default the suite's own number.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the first run; default 1, of the ladder 100000.")] = None,
    scenario: Annotated[list[str] | None, typer.Option(help="Only this one; may be repeated.")] = None,
    estimator: Annotated[
        list[str] | None, typer.Option(help="Only this one, or FILE.py:NAME of your own; may be repeated.")
    ] = None,
    backend: Annotated[str, typer.Option(help="local, dask or ray.")] = "local",
    workers: Annotated[int, typer.Option(help="Processes, or tasks at a time on a cluster.")] = 1,
    address: Annotated[str, typer.Option(help="Of a Dask scheduler or Ray head; default a new one here.")] = "",
    report: Annotated[Path | None, typer.Option(help="HTML page of these rows to this .html.")] = None,
) -> int:
    """Compare estimators."""
    from jink.training.bench import bench
    from jink.training.bench_request import BenchRequest
    from jink.training.ladder.backends import Place

    request = BenchRequest(
        suite=suite,
        quick=quick,
        out=out,
        data=data,
        runs=runs,
        seed=seed,
        scenarios=tuple(dict.fromkeys(scenario or ())),
        estimators=tuple(dict.fromkeys(estimator or ())),
        place=Place(backend, workers, address),
        report=report,
    )
    return bench(request, screen())


_REPORT_HELP = """Make one HTML page from rows of 'jink bench': leaderboards, ladders, curves, playback, failures.

The page needs no network and nothing beside it; it is made from the rows alone.

Examples:

  jink report rows.parquet --out report.html

  jink report surge.parquet joint.parquet --out report.html --title "Surges and switches"
"""


@app.command("report", help=_REPORT_HELP)
def report_command(
    files: Annotated[list[Path], typer.Argument(help="Parquet files of jink bench.", metavar="ROWS...")],
    out: Annotated[Path, typer.Option(help="To this .html.")] = Path("report.html"),
    title: Annotated[str, typer.Option(help="Heading of the page.")] = "Jink benchmark",
) -> None:
    """Make a page from rows."""
    from jink.training.reporting import report

    rows = report(files, out, title)
    screen().print(f"wrote {out} from {rows} rows", markup=False)


_PLAY_HELP = """Watch an episode of an environment in a window, or write it to a file.

Without a display, or with --out, the episode goes to a file: .mp4 or .gif (all frames) or .png (the last).

Examples:

  jink play ManoeuvringTarget-v0 --scenario joint-v0

  jink play jink/AdaptiveFactor-v0 --policy huber --seed 3 --out episode.gif

  jink play ManoeuvringTarget-v0 --scenario air-radar-v0 --policy kf-cv --out last.png
"""


@app.command("play", help=_PLAY_HELP)
def play_command(
    env: Annotated[str, typer.Argument(help="Id, with or without jink/.", metavar="ENV")],
    scenario: Annotated[str | None, typer.Option(help="Name from 'jink list'.")] = None,
    policy: Annotated[
        str | None,
        typer.Option(help="An estimator, FILE.py:NAME, a factor, none, random, or an agent: a folder or a name."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the episode; default a new one.")] = None,
    out: Annotated[Path | None, typer.Option(help="To this .mp4, .gif or .png.")] = None,
    steps: Annotated[int | None, typer.Option(help="Stop after so many decisions.")] = None,
) -> None:
    """Watch an episode of an environment, or write it to a file."""
    from gymnasium.error import DependencyNotInstalled

    from jink.training.play import PlayRequest, play, print_played

    request = PlayRequest(env=env, scenario=scenario, policy=policy, seed=seed, out=out, steps=steps)
    try:
        played = play(request)
    except DependencyNotInstalled as error:
        raise ValueError(str(error)) from error
    print_played(screen(), played)


_CHECK_HELP = """Examine an estimator, or the vector environment of an id.

An estimator: shapes, values, inputs untouched, same bits again, batches, neighbours, padding, causality, missing data,
odd times, outliers, run against step. What fails is said with how to mend it. FILE.py:NAME is a class or function.

An environment: spaces, seeds, autoreset modes, equality with single ones; any id that gymnasium.make_vec knows.

Examples:

  jink check mine.py:make

  jink check mine.py:make --sensor range-bearing

  jink check imm --axes 3

  jink check --env jink/AdaptiveFactor-v0

  jink check --env CartPole-v1 --num-envs 4
"""


@app.command("check", help=_CHECK_HELP)
def check_command(
    estimator: Annotated[
        str | None, typer.Argument(help="FILE.py:NAME, or a name from 'jink list'.", metavar="[ESTIMATOR]")
    ] = None,
    env: Annotated[str | None, typer.Option(help="Id of an environment; MODULE:ID imports a module first.")] = None,
    sensor: Annotated[str, typer.Option(help="What the estimator is put behind.")] = "position",
    axes: Annotated[int | None, typer.Option(help="Space dimensions of the sensor position; default 2.")] = None,
    num_envs: Annotated[int, typer.Option(help="How many environments.")] = 3,
    seed: Annotated[int, typer.Option(help="Seed of the tracks, or of the first environment.")] = 0,
    steps: Annotated[int, typer.Option(help="Random steps of a comparison of environments.")] = 300,
) -> int:
    """Examine an estimator or a vector environment."""
    if (estimator is None) == (env is None):
        raise ValueError(
            f"check: one thing must be named, ESTIMATOR or --env; got {'neither' if env is None else 'both'}. "
            "Write for example jink check mine.py:make."
        )
    if estimator is not None:
        return _check_estimator(estimator, sensor, axes, seed)
    return _check_env(str(env), num_envs, seed, steps)


def _check_estimator(estimator: str, sensor: str, axes: int | None, seed: int) -> int:
    from jink.training.checking import check_estimator, print_estimator_report

    if axes is not None and sensor != "position":
        raise ValueError(f"--axes: option must be left out of --sensor {sensor}; got {axes}. Its axes are fixed.")
    with say_when_compiling():
        report = check_estimator(estimator, sensor, 2 if axes is None else axes, seed)
    print_estimator_report(report, screen())
    return int(not report.ok)


def _check_env(env: str, num_envs: int, seed: int, steps: int) -> int:
    import gymnasium

    import jink.envs
    from jink.envs.checking import check_vector_env, print_check
    from jink.envs.registration import full_id

    gymnasium.register_envs(jink.envs)
    try:
        with say_when_compiling():
            report = check_vector_env(full_id(env), num_envs, seed, steps)
    except (gymnasium.error.Error, ModuleNotFoundError) as error:
        raise ValueError(f"--env: id must be one that Gymnasium knows; got '{env}'. {error}") from error
    print_check(report, screen())
    return int(not report.ok)


add_commands(app)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; None: those of the process.

    Returns:
        exit code: 0, 1 where a benchmark cell or a check failed, 2 for refused input, 130 after Ctrl-C.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    return run_command(lambda: app(args=given, prog_name="jink", standalone_mode=False))


if __name__ == "__main__":
    sys.exit(main())
