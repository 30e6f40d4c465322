"""`jink track`: read a file, choose parameters, estimate, write, plot, and say what came out."""

from __future__ import annotations

import math
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jink.envs.estimates_file import write_estimates
from jink.envs.reading.columns import parse_columns
from jink.envs.recorded import read_tracks
from jink.estimators.agent.policy_file import find_policy
from jink.estimators.metrics import errors, summary
from jink.estimators.sensor import Sensor
from jink.estimators.tracks import Tracks
from jink.training.console import check_separate, check_writable, progress, say_when_compiling
from jink.training.doubts import doubts_about
from jink.training.many_estimators import MANY
from jink.training.models import find_model
from jink.training.noise_reading import NoiseReading, judges_noise, read_noise
from jink.training.options import parse_numbers, parse_pairs, parse_sigma
from jink.training.outside import without_unreported
from jink.training.running import Forecast, forecast_ends, gate_tracks, raw_positions, run_tracks
from jink.training.tuning import sensor_of, tune
from jink.training.wording import in_own_words

__all__ = ["Choice", "Parameter", "TrackReport", "TrackRequest", "choose", "estimate", "interval_of", "read", "track"]

_SOJOURN_S, _WARM_ROWS = 10.0, 60
_SURGE_ROWS = 2.0
_MANY_ONLY = ("detection", "clutter", "gate_size", "window", "network", "cutoff", "film")
"""Options of trackers of many targets; see `jink.training.track_many`."""


@dataclass(frozen=True)
class TrackRequest:
    """What the command line asked for; None and empty mean "not given"."""

    file: Path
    estimator: str = "imm"
    columns: str = ""
    truth: Path | None = None
    truth_columns: str = ""
    where: tuple[str, ...] = ()
    bias: tuple[str, ...] = ()
    axes: int | None = None
    height: float | None = None
    sort: bool = False
    degrees: bool = False
    compass: bool = False
    drop_repeats: bool = False
    rate_hz: float | None = None
    sigma: str | None = None
    acceleration: float | None = None
    speed: float | None = None
    turn_rate: float | None = None
    sojourn: float | None = None
    surge_every: float | None = None
    surge_for: float | None = None
    gate: bool = False
    smooth: bool = False
    forecast: float | None = None
    model: str | None = None
    policy: str | None = None
    out: Path | None = None
    plot: Path | None = None
    shown: str | None = None
    detection: float | None = None
    clutter: float | None = None
    gate_size: float | None = None
    window: int | None = None
    network: Path | None = None
    cutoff: float | None = None
    film: Path | None = None


class Parameter(NamedTuple):
    """One parameter of the run, with where it came from: given, file, tuned or default."""

    name: str
    value: float | None
    unit: str
    origin: str


class Choice(NamedTuple):
    """Sensor, options of `make_estimator`, the same for print, and whether the file's own sigmas are used."""

    sensor: Sensor
    options: dict[str, Any]
    parameters: tuple[Parameter, ...]
    use_noise: bool


class TrackReport(NamedTuple):
    """Everything the summary and the plot need."""

    tracks: Tracks
    estimator: str
    modes: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    estimates: Any
    scores: dict[str, float]
    raw_scores: dict[str, float]
    forecasts: list[Forecast]
    seconds: float
    rejected: int
    doubts: tuple[str, ...] = ()
    noise: NoiseReading | None = None


def track(request: TrackRequest) -> TrackReport:
    """Run one request.

    Args:
        request: what was asked for.

    Returns:
        what came out; files are written where they were asked for.

    Raises:
        ValueError: an option, a cell or a name that is refused, in one sentence.
        OSError: a file that cannot be read or written.
    """
    from jink.estimators.recipes import LEARNED, RECIPES
    from jink.training.loading import is_spec, load_maker

    if is_spec(request.estimator):
        load_maker(request.estimator)  # refused before the file is read
    elif request.estimator not in RECIPES:
        raise ValueError(
            f"--estimator: name must be one of {', '.join((*RECIPES, *MANY))}, or FILE.py:NAME; got "
            f"'{request.estimator}'. See jink list."
        )
    if request.model is not None and request.estimator not in LEARNED:
        raise ValueError(
            f"--model: value must come with --estimator {' or '.join(LEARNED)}; got --estimator {request.estimator}. "
            "Change one of them."
        )
    if request.policy is not None:
        if request.estimator != "agent":
            raise ValueError(
                f"--policy: value must come with --estimator agent; got --estimator {request.estimator}. "
                "Change one of them."
            )
        find_policy(request.policy, "--policy")
    for name in ("surge_every", "surge_for"):
        if getattr(request, name) is not None and request.estimator != "joint-imm":
            raise ValueError(
                f"--{name.replace('_', '-')}: value must come with --estimator joint-imm, which has noise levels; got "
                f"--estimator {request.estimator}. Change one of them."
            )
    for name in _MANY_ONLY:
        if getattr(request, name) is not None:
            raise ValueError(
                f"--{name.replace('_', '-')}: option must be left out of {request.estimator}, which follows one target "
                f"per track; got {getattr(request, name)}. Use one of {', '.join(MANY)}."
            )
    check_writable(request.out, "--out", (".parquet", ".csv"))
    check_writable(request.plot, "--plot", (".png", ".pdf", ".svg"))
    inputs = {"the input file": request.file, "the file of --truth": request.truth}
    check_separate(request.out, "--out", inputs)
    check_separate(request.plot, "--plot", inputs)
    _check_numbers(request)
    tracks = read(request)
    if request.shown is not None and request.shown not in tracks.ids:
        names = ", ".join(tracks.ids[:10]) + (", ..." if len(tracks) > 10 else "")
        raise ValueError(f"--show: value must name a track; got '{request.shown}'. There are {names}.")
    with say_when_compiling():
        report = estimate(request, tracks, choose(request, tracks))
    if request.out is not None:
        readings = None if report.noise is None else report.noise.columns
        write_estimates(request.out, tracks, report.estimates, report.modes, readings)
    if request.plot is not None:
        from jink.training.plotting import plot_track

        plot_track(request.plot, report, request.shown)
    return report


def estimate(request: TrackRequest, tracks: Tracks, choice: Choice) -> TrackReport:
    """Gate if asked to, run or smooth, forecast, score.

    Args:
        request: what was asked for; its files are not touched.
        tracks: from `read`.
        choice: from `choose`.

    Returns:
        what came out.
    """
    with _named(request):
        return _estimate(request, tracks, choice)


def _estimate(request: TrackRequest, tracks: Tracks, choice: Choice) -> TrackReport:
    from jink.training.loading import make_named

    estimator = make_named(request.estimator, choice.sensor, **choice.options)
    for option, method in (("--smooth", "smooth"), ("--forecast", "forecast"), ("--gate", "step")):
        if getattr(request, option[2:]) and not (hasattr(estimator, method) and getattr(estimator, "streams", True)):
            raise ValueError(
                f"{option}: estimator must have {method}; got {estimator.name}, which has not. Leave {option} out."
            )
    rows, use_noise = float(tracks.lengths.sum()), choice.use_noise
    used, rejected = tracks, 0
    if request.gate:
        with progress(f"gate: {tracks.source}", rows) as advance:
            used, rejected = gate_tracks(estimator, tracks, use_noise=use_noise, advance=advance)
    head = replace(
        tracks.subset([0]),
        **{name: value[:1, :_WARM_ROWS] for name, value in _arrays(tracks).items()},
        lengths=np.minimum(tracks.lengths[:1], _WARM_ROWS),
    )
    run_tracks(estimator, head, use_noise=use_noise, smooth=request.smooth)  # compiles, so the clock need not
    with progress(f"{estimator.name}: {tracks.source}", rows) as advance:
        began = time.perf_counter()
        estimates = run_tracks(estimator, used, use_noise=use_noise, smooth=request.smooth, advance=advance)
        seconds = time.perf_counter() - began
    forecasts: list[Forecast] = []
    if request.forecast is not None:
        with progress(f"forecast: {tracks.source}", rows) as advance:
            forecasts = forecast_ends(estimator, used, request.forecast, use_noise=use_noise, advance=advance)
    return TrackReport(
        tracks=tracks,
        estimator=estimator.name,
        modes=tuple(estimator.modes),
        parameters=choice.parameters,
        estimates=estimates,
        scores=without_unreported(summary(estimates, tracks.truth, tracks.truth_velocity, tracks.lengths), estimates),
        raw_scores=score_raw(tracks, estimates),
        forecasts=forecasts,
        seconds=seconds,
        rejected=rejected,
        doubts=doubts_about(request, tracks, interval_of(tracks)) + _calm_sigma(estimator, choice),
        noise=read_noise(estimator, used, estimates, use_noise=use_noise),
    )


def _calm_sigma(estimator: Any, choice: Choice) -> tuple[str, ...]:
    """Who judges the noise needs that of calm rows; tuning takes that of all rows."""
    tuned = any(item.name.startswith("sigma_") and item.origin == "tuned" for item in choice.parameters)
    if not tuned or not judges_noise(estimator):
        return ()
    return (f"sigma was tuned on all rows, surges included; {estimator.name} wants that of calm rows: give --sigma",)


def _arrays(tracks: Tracks) -> dict[str, Any]:
    """The arrays of a container that have tracks and times in front."""
    names = ("times", "measurements", "noise", "sensor_states", "truth", "truth_velocity", "intents", "sensor_ids")
    return {name: value for name in names if (value := getattr(tracks, name)) is not None}


def _named(request: TrackRequest) -> AbstractContextManager[None]:
    """Refusals speak of the request's own options and files."""
    files = [file.name for file in (request.file, request.truth) if file is not None]
    return in_own_words(request.file.name, [field.name for field in fields(request)], files)


def _check_numbers(request: TrackRequest) -> None:
    """Physical options are positive; a horizon may be zero; an option that says how to read needs what it reads."""
    if request.axes not in (None, 2, 3):
        raise ValueError(f"--axes: value must be 2 or 3; got {request.axes}. Use 2 for a plane.")
    if request.height is not None and not math.isfinite(request.height):
        raise ValueError(f"--height: value must be finite; got {request.height:g}. Use metres.")
    if request.truth_columns and request.truth is None:
        raise ValueError(
            f"--truth-columns: value must come with --truth; got '{request.truth_columns}' alone. Add --truth FILE."
        )
    for name in ("acceleration", "speed", "turn_rate", "sojourn", "surge_every", "surge_for", "forecast"):
        value = getattr(request, name)
        low = -math.ulp(0.0) if name == "forecast" else 0.0
        if value is not None and not low < value < math.inf:
            raise ValueError(
                f"--{name.replace('_', '-')}: value must be {'>= 0' if name == 'forecast' else '> 0'} and finite; "
                f"got {value:g}. Use SI units."
            )


def read(request: TrackRequest) -> Tracks:
    """The tracks of the requested file."""
    columns = _columns(request.columns, "columns")
    truth_columns = _columns(request.truth_columns, "truth_columns")
    with progress(f"reading {request.file.name}"), _named(request):
        return read_tracks(
            request.file,
            columns,
            axes=request.axes,
            truth=request.truth,
            truth_columns=truth_columns,
            where=parse_pairs("--where", request.where) or None,
            sort=request.sort,
            drop_repeats=request.drop_repeats,
            rate_hz=request.rate_hz,
            height=request.height,
            compass=request.compass,
            degrees=request.degrees,
            bias=parse_numbers("--bias", request.bias) or None,
        )


def _columns(text: str, name: str) -> dict[str, str] | None:
    """A mapping of columns; refusals name its option."""
    option = f"--{name.replace('_', '-')}"
    with in_own_words(option):
        return parse_columns(text) or None


def choose(request: TrackRequest, tracks: Tracks) -> Choice:
    """Sensor and scales: given, from the file, learned, estimated from it, or a default."""
    with _named(request):
        return _choose(request, tracks) if request.model is None else _choose_learned(request, request.model, tracks)


def _choose_learned(request: TrackRequest, name: str, tracks: Tracks) -> Choice:
    """A model knows its own scales; what is left is the sensor."""
    model = find_model(name, axes=tracks.axes)
    for option in ("acceleration", "speed", "turn_rate", "sojourn"):
        if getattr(request, option) is not None:
            raise ValueError(
                f"--{option.replace('_', '-')}: option must be left out with --model, which has its own; got "
                f"{getattr(request, option):g}. Leave it out."
            )
    plain = sensor_of(tracks)
    use_noise = tracks.noise is not None and request.sigma is None
    if request.sigma is not None:
        sigma, origin = parse_sigma(request.sigma, plain, request.degrees), "given"
    elif use_noise:
        sigma, origin = (1.0,) * plain.size, "file"
    elif model.noise_sd is not None and tracks.sensor == "position":
        sigma, origin = model.noise_sd, "model"
    else:
        with progress("choosing noise from the file") as advance:
            sigma, origin = tune(tracks, advance=advance).sigma, "tuned"
    found = [
        Parameter(f"sigma_{label.replace(' ', '_')}", value, unit, origin)
        for label, value, unit in zip(plain.labels, sigma, plain.units, strict=True)
    ]
    found.append(Parameter("speed", model.speed, "m/s", "model"))
    found.append(Parameter("intents", float(len(model.intents)), "", "model"))
    surges = _surges(request, tracks)
    options = {"model": model} | {item.name: item.value for item in surges}
    return Choice(sensor_of(tracks, sigma), options, (*found, *surges), use_noise)


def _choose(request: TrackRequest, tracks: Tracks) -> Choice:
    plain = sensor_of(tracks)
    sigma = None if request.sigma is None else parse_sigma(request.sigma, plain, request.degrees)
    with progress("choosing noise and acceleration from the file") as advance:
        tuning = tune(tracks, sigma=sigma, acceleration=request.acceleration, speed=request.speed, advance=advance)
    use_noise = tracks.noise is not None and sigma is None
    origin = {
        name: "given" if getattr(request, name) is not None else "tuned" if name in tuning.tuned else "default"
        for name in ("sigma", "acceleration", "speed")
    }
    if use_noise:
        origin["sigma"] = "file"
    found = [
        Parameter(f"sigma_{label.replace(' ', '_')}", value, unit, origin["sigma"])
        for label, value, unit in zip(plain.labels, tuning.sigma, plain.units, strict=True)
    ]
    found.append(Parameter("acceleration", tuning.acceleration, "m/s^2", origin["acceleration"]))
    found.append(Parameter("speed", tuning.speed, "m/s", origin["speed"]))
    options: dict[str, Any] = {"acceleration": tuning.acceleration, "speed": tuning.speed}
    for name, unit in (("turn_rate", "rad/s"), ("sojourn", "s")):
        value, source = getattr(request, name), "given"
        if value is None and name == "sojourn":
            value, source = _default_sojourn(tracks)
        elif value is None:
            value, source = min(tuning.acceleration / tuning.speed, 1.0), "default"
        found.append(Parameter(name, value, unit, source))
        options[name] = value
    if request.policy is not None:
        options["policy"] = request.policy
    surges = _surges(request, tracks)
    found += surges
    options |= {item.name: item.value for item in surges}
    return Choice(sensor_of(tracks, tuning.sigma), options, tuple(found), use_noise)


def _surges(request: TrackRequest, tracks: Tracks) -> list[Parameter]:
    """How often the noise surges and for how long, s, for the estimator that has such parameters."""
    from jink.estimators.joint import CALM, SURGE

    if request.estimator != "joint-imm":
        return []
    # A surge of less than a row or two could not be told from an outlier, and the share of surges stays the same.
    least = _SURGE_ROWS * interval_of(tracks)
    surge, source = (request.surge_for, "given") if request.surge_for else (SURGE, "default")
    if request.surge_for is None and least > SURGE:
        surge, source = least, "interval"
    every, origin = (request.surge_every, "given") if request.surge_every else (surge * CALM / SURGE, source)
    return [Parameter("surge_every", every, "s", origin), Parameter("surge_for", surge, "s", source)]


def _default_sojourn(tracks: Tracks) -> tuple[float, str]:
    """Mean time between changes of mode, s, and what it was taken from."""
    interval = interval_of(tracks)
    # Shorter than some ten samples, an intent could not be told from noise; longer than a quarter, never seen to end.
    value, source = (_SOJOURN_S, "default") if 10.0 * interval <= _SOJOURN_S else (10.0 * interval, "interval")
    longest = max((float(track.times[-1] - track.times[0]) for track in tracks if len(track.times)), default=0.0)
    limit = max(longest / 4.0, interval)
    return (value, source) if not 0.0 < limit < value else (limit, "length")


def interval_of(tracks: Tracks) -> float:
    """Median time between rows that differ in time; s; 0 without any."""
    gaps = np.diff(tracks.times, axis=1)[tracks.used[:, 1:]]
    gaps = gaps[gaps > 0]
    return float(np.median(gaps)) if gaps.size else 0.0


def score_raw(tracks: Tracks, estimates: Any) -> dict[str, float]:
    """Errors of the measurements themselves, on the rows where both they and the estimates are scored."""
    raw = raw_positions(tracks)
    if raw is None or tracks.truth is None:
        return {}
    started = np.isfinite(np.asarray(estimates.position)).all(axis=2) & tracks.used
    values = errors(raw, tracks.truth, None, started & np.isfinite(raw).all(axis=2))
    values = values[np.isfinite(values)]
    if not values.size:
        return {}
    return {
        "scored_steps": float(values.size),
        "position_rmse_m": float(np.sqrt(np.mean(values**2))),
        "position_median_m": float(np.median(values)),
        "position_peak_m": float(values.max()),
    }
