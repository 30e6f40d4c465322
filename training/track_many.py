"""`jink track` of many targets: read scans, choose numbers, track, write, plot, film, and say what came out."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jink.envs.reading.graph_file import NetworkPlan, read_graph
from jink.envs.recorded import read_tracks
from jink.estimators.metrics import Gospa, Identities, gospa, identities
from jink.estimators.multitarget.open_tracks import OpenTracks
from jink.estimators.multitarget.results import MultiTracks
from jink.estimators.multitarget.scans import Scans
from jink.estimators.tracks import Tracks
from jink.training.console import check_separate, check_writable, progress, say_when_compiling
from jink.training.doubts import doubts_about
from jink.training.many_choice import choose_many
from jink.training.many_estimators import MANY, NETWORKED
from jink.training.many_rows import network_frame, track_frame, write_frame
from jink.training.recording import SUFFIXES
from jink.training.running import raw_positions
from jink.training.track import Parameter, TrackRequest, interval_of, read
from jink.training.tuning import sensor_of
from jink.training.wording import in_own_words

__all__ = ["ManyReport", "ManyScores", "track_many"]

Array = NDArray[np.float64]
UNUSED = (
    "gate", "forecast", "shown", "drop_repeats", "rate_hz", "model", "policy", "surge_every", "surge_for",
)  # fmt: skip
"""Options of one target that say nothing here."""
OPTION_NAMES = {"shown": "show"}
WARM_SCANS = 30


class ManyScores(NamedTuple):
    """Against truth."""

    cutoff: float  # m
    origin: str  # given, or how it was chosen
    gospa: Gospa
    kept: Identities
    truth: Array  # (N, K, A)


class ManyReport(NamedTuple):
    """Everything the summary, the plot and the film need."""

    source: str
    estimator: str
    scans: Scans
    found: MultiTracks | OpenTracks
    frame: pd.DataFrame  # of all nodes where there is a network
    parameters: tuple[Parameter, ...]
    detections: Array | None  # positions of the rows in order of scans, NaN where they locate nothing; (N, A)
    locates: bool  # whether a detection of these sensors can begin a track
    plan: NetworkPlan | None
    scores: ManyScores | None
    seconds: float
    notes: tuple[str, ...]

    @property
    def tracks(self) -> tuple[NDArray[np.int64], Array]:
        """Ids (M,) and positions (M, K, A) of the tracks, of the first node where there is a network."""
        return self.found.sets()

    @property
    def times(self) -> Array:
        """Of the tracks; (K,)."""
        return self.found.times


def track_many(request: TrackRequest) -> ManyReport:
    """Run one request.

    Args:
        request: what was asked for; its estimator is one of `MANY`.

    Returns:
        what came out; files are written where they were asked for.

    Raises:
        ValueError: an option, a cell or a name that is refused, in one sentence.
        OSError: a file that cannot be read or written.
    """
    _check(request)
    plan = None
    if request.network is not None:
        with in_own_words("--network", files=[request.network.name]):
            plan = read_graph(request.network)
    tracks = _read(request)
    true = _read_truth(request, tracks.axes)
    with say_when_compiling():
        scans, scales, parameters = choose_many(request, tracks, plan)
        tracker = MANY[request.estimator](scales)
        with progress(f"{request.estimator}: {tracks.source}"):
            # As many scans as it takes to have tracks compile, so the clock need not.
            tracker.run(scans.select(np.arange(min(len(scans), WARM_SCANS))))
            began = time.perf_counter()
            found = tracker.run(scans)
            seconds = time.perf_counter() - began
    if isinstance(found, OpenTracks):
        assert plan is not None  # only a network gives these
        frame = network_frame(found, plan.nodes)
    else:
        frame = track_frame(found, scans, request.smooth)
    report = ManyReport(
        tracks.source, request.estimator, scans, found, frame, parameters, _places(tracks, scans),
        sensor_of(tracks).locate is not None, plan, _score(request, true, found), seconds,
        (*tracks.notes, *doubts_about(request, tracks, interval_of(tracks)), *_absent(plan, scans)),
    )  # fmt: skip
    _write(request, report)
    return report


def _write(request: TrackRequest, report: ManyReport) -> None:
    if request.out is not None:
        write_frame(request.out, report.frame)
    if request.plot is not None:
        from jink.training.many_plot import plot_many

        plot_many(request.plot, report)
    if request.film is not None:
        from jink.training.many_film import film_many

        with progress(f"drawing {request.film.name}"):
            film_many(request.film, report)


def _check(request: TrackRequest) -> None:
    """Refuse before anything is computed."""
    check_writable(request.out, "--out", (".parquet", ".csv"))
    check_writable(request.plot, "--plot", (".png", ".pdf", ".svg"))
    check_writable(request.film, "--film", SUFFIXES)
    inputs = {"the input file": request.file, "the file of --truth": request.truth, "the network": request.network}
    for path, option in ((request.out, "--out"), (request.plot, "--plot"), (request.film, "--film")):
        check_separate(path, option, inputs)
    networked = request.estimator in NETWORKED
    wrong = [name for name in UNUSED if getattr(request, name) not in (None, False)]
    if request.sojourn is not None and request.turn_rate is None:
        wrong.append("sojourn")
    if request.smooth and request.estimator != "pmht":
        wrong.append("smooth")
    if request.window is not None and request.estimator in ("gnn", "jpda"):
        wrong.append("window")
    if request.network is not None and not networked:
        wrong.append("network")
    for name in wrong:
        option = f"--{OPTION_NAMES.get(name, name).replace('_', '-')}"
        raise ValueError(
            f"{option}: option must be left out of {request.estimator}, which does not use it; got "
            f"{getattr(request, name)}. Leave it out."
        )
    if networked and request.network is None:
        raise ValueError(f"--network: file must be given for {request.estimator}; got none. Add --network graph.json.")
    for name, low, high, rule in (
        ("detection", 0.0, 0.999, "be above 0 and at most 0.999, or every miss would end a track"),
        ("clutter", -math.ulp(0.0), 1e9, "be from 0 to 1e9"),
        ("gate_size", 0.0, 1e6, "be above 0 and at most 1e6"), ("window", 0, 1000, "be from 1 to 1000"),
        ("acceleration", 0.0, 1e9, "be > 0 and finite"), ("speed", 0.0, 1e9, "be > 0 and finite"),
        ("turn_rate", 0.0, 100.0, "be > 0 and finite"), ("sojourn", 0.0, 1e9, "be > 0 and finite"),
        ("cutoff", 0.0, 1e12, "be above 0 and at most 1e12"),
    ):  # fmt: skip
        value = getattr(request, name)
        if value is not None and not low < value <= high:
            raise ValueError(f"--{name.replace('_', '-')}: value must {rule}; got {value:g}. Use SI units.")
    if request.axes not in (None, 2, 3):
        raise ValueError(f"--axes: value must be 2 or 3; got {request.axes}. Use 2 for a plane.")
    for option, value in (("--truth-columns", request.truth_columns), ("--cutoff", request.cutoff)):
        if value and request.truth is None:
            raise ValueError(f"{option}: value must come with --truth; got '{value}' alone. Add --truth FILE.")
    if request.truth is not None and not request.truth.is_file():
        raise FileNotFoundError(
            f"--truth: value must name an existing file; got {request.truth.name}. Check the spelling."
        )


def _read(request: TrackRequest) -> Tracks:
    """The rows of the file as one track in order of time; whatever names tracks in it is ignored."""
    columns = request.columns if "track=" in request.columns else ",".join(filter(None, [request.columns, "track="]))
    return read(replace(request, columns=columns, truth=None, truth_columns=""))


def _places(tracks: Tracks, scans: Scans) -> Array | None:
    """Positions of the detections, in the order of the scans."""
    model = scans.sensors[0].model
    if model.locate is None:
        return None
    own = replace(
        tracks,
        times=scans.times[scans.scan_of][None],
        measurements=scans.detections[None],
        noise=None,
        sensor_states=scans.sensor_states[scans.scan_of][None],
        sensor_ids=None,
        truth=None,
        truth_velocity=None,
        intents=None,
        lengths=np.array([len(scans.detections)]),
    ) if len(scans.detections) else None  # fmt: skip
    places = None if own is None else raw_positions(own)
    return None if places is None else places[0]


def _absent(plan: NetworkPlan | None, scans: Scans) -> tuple[str, ...]:
    """What the network names and the file has not."""
    names = {sensor.name for sensor in scans.sensors}
    found = [] if plan is None else [name for name in plan.sensors if name not in names]
    return (f"the network names sensors that have no scan: {', '.join(found)}",) if found else ()


def _read_truth(request: TrackRequest, axes: int) -> Tracks | None:
    """The tracks of the truth file."""
    if request.truth is None:
        return None
    with in_own_words("--truth", files=[request.truth.name]):
        from jink.envs.reading.columns import parse_columns

        true = read_tracks(request.truth, parse_columns(request.truth_columns) or None, axes=axes, sort=True)
    if true.sensor != "position" or any("latitude" in note for note in true.notes):
        raise ValueError(
            f"--truth: file must hold positions in metres, as many targets are compared in them; got "
            f"{Path(request.truth).name}. Map x and y with --truth-columns."
        )
    for one in true:
        again = np.flatnonzero(np.diff(one.times) == 0)
        if again.size:
            raise ValueError(
                f"--truth: file must give each time once per target; got {one.times[again[0]]:.9g} s twice in track "
                f"'{one.id}' of {Path(request.truth).name}. Add a column track, or name it with --truth-columns "
                "track=NAME."
            )
    return true


def _score(request: TrackRequest, true: Tracks | None, found: MultiTracks | OpenTracks) -> ManyScores | None:
    """Against the tracks of the truth file, interpolated linearly within their spans."""
    if true is None:
        return None
    A = true.axes
    truth = np.full((len(true), len(found.times), A), np.nan)
    for n, one in enumerate(true):
        good = np.isfinite(one.measurements).all(axis=1)
        if good.any():
            for a in range(A):
                truth[n, :, a] = np.interp(
                    found.times, one.times[good], one.measurements[good, a], left=np.nan, right=np.nan
                )
    cov = found.cov[0] if isinstance(found, OpenTracks) else found.cov
    sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2)[:, :A], 0.0)) if len(cov) else np.ones((1, A))
    # Ten standard deviations of an estimate: what is farther away is another target.
    cutoff, origin = float(np.clip(10.0 * np.median(sigma), 1e-3, 1e12)), "ten sd of this run; --cutoff compares runs"
    if request.cutoff is not None:
        cutoff, origin = request.cutoff, "given"
    positions = found.sets()[1]
    return ManyScores(cutoff, origin, gospa(positions, truth, cutoff), identities(positions, truth, cutoff), truth)
