"""`Pmht`: many targets in clutter by expectation-maximisation over a sliding window of scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.checks import check_array, check_choice, check_count, check_kind, check_number
from jink.estimators.inputs import check_moments
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion
from jink.estimators.multitarget.em import fit_window, foresee
from jink.estimators.multitarget.initiation import Initiation, Tentative, initiate, no_tentatives
from jink.estimators.multitarget.results import Fit, Found, MultiTracks, Outcome, gather
from jink.estimators.multitarget.scan_sensor import ScanSensor
from jink.estimators.multitarget.scans import Scan, Scans, check_scan, check_sensors
from jink.estimators.multitarget.tables import Moving, Sensing, make_moving, make_sensing
from jink.estimators.multitarget.tracked import (
    TrackSet,
    Window,
    empty_tracks,
    empty_window,
    fresh_tracks,
    state_moments,
    with_scan,
    without_first,
)

__all__ = ["KnownTracks", "Pmht", "PmhtState", "check_annealing", "check_homothetic", "check_motions"]

Array = NDArray[np.float64]
RULES = ("fixed", "updated"), ("share", "missed"), ("exclusive", "independent")


@dataclass(frozen=True, eq=False)
class KnownTracks:
    """Targets known beforehand, as Gaussians of position and velocity at one time.

    Args:
        mean: position then velocity, m and m/s; (M, 2 A).
        cov: (2 A, 2 A) for all or (M, 2 A, 2 A).
        time: s; not after the first scan.

    Raises:
        ValueError: shapes that do not fit, numbers that are not finite, or a matrix that is no covariance.
    """

    mean: Array
    cov: Array
    time: float

    def __post_init__(self) -> None:
        me = "KnownTracks"
        mean = np.atleast_2d(check_array(me, "mean", self.mean, "Give position then velocity."))
        cov = check_array(me, "cov", self.cov, "Give one matrix, or one per target.")
        M, width = mean.shape if mean.ndim == 2 else (0, 0)
        if width not in (2, 4, 6) or cov.shape not in ((width, width), (1, width, width), (M, width, width)):
            raise ValueError(
                f"KnownTracks: mean must have shape (M, 2 A) and cov (M, 2 A, 2 A); got {mean.shape} and {cov.shape}. "
                "Give position then velocity."
            )
        check_moments(mean, cov, me)
        check_number(me, "time", self.time, remedy="Give seconds.")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "cov", np.array(np.broadcast_to(cov, (M, width, width))))
        object.__setattr__(self, "time", float(self.time))


class PmhtState(NamedTuple):
    """Everything between two scans."""

    sensors: tuple[ScanSensor, ...]
    sensing: Sensing
    time: float
    scans: int
    window: Window
    tracks: TrackSet
    tentative: Tentative
    next_id: int


@dataclass(frozen=True, eq=False)
class Pmht:
    """Probabilistic multi-hypothesis tracker: soft association and fixed-interval smoothing in turns.

    Model: each detection of a scan is of target m with probability pi_m or clutter with pi_0, independently of the
    others; E-step weights with the smoothed states, M-step one smoother per target through its centroids, over a
    window that slides with the scans. The window starts from the filter's prediction of its first scan, so no
    detection counts twice. Several modes make the M-step an interacting-multiple-model filter and smoother.
    By default weights know that a target gives one detection at most and that a prediction is uncertain;
    ``assignment="independent", adaptive=0, correction=False`` is PMHT as published.

    Args:
        motion: how targets move; several linear ones with the same state: modes.
        chain: Markov chain of the modes; None: each lasts 10 s on average.
        window: scans that are explained together, T_b, at least 1.
        slide: full EM at every such scan, one iteration in between.
        iterations: most EM iterations, at least 1.
        tolerance: relative change of the objective that ends them.
        priors: "fixed", or "updated" from the weights in every iteration.
        clutter_prior: "share": pi_0 in proportion to lambda V; "missed": to (1 - P_D) lambda V.
        annealing: factors on R in the first iterations, decreasing to 1; (): none.
        homothetic: shares rho_g, which sum to 1, and factors kappa_g^2 on R of the target density; None: plain.
        gate: D^2 beyond which a detection is no candidate; None: all are. A sensor's own gate comes first.
        correction: covariances get the uncertainty of the assignment, ``K [sum w e e' - e e'] K'``.
        assignment: "exclusive": at most one detection per target and scan; or "independent": PMHT as published, in
            which close targets share their detections and merge.
        adaptive: so many first iterations weigh detections by the prediction, ``N(z; h(x), H P H' + R)``, instead of
            R alone; 0: PMHT as published.
        extrinsic: with exclusive assignment and without a homothetic density, later iterations weigh a scan by what all
            others say (turbo PMHT), and the smoother takes soft detections as probabilistic data association does.
        initiation: how tracks begin and end; None: the known ones stay, no others come.
        rounds: exchanges of messages of the exclusive assignment.

    Raises:
        ValueError: an option out of range.

    Source: Streit, Luginbuhl (1995); Willett, Ruan, Streit (2002); CN115508822B S1-S3. Differs: information form
    without division by the weights; the variants named above are options.
    """

    motion: Motion | Sequence[Motion]
    chain: MarkovChain | None = None
    window: int = 10
    slide: int = 1
    iterations: int = 10
    tolerance: float = 1e-4
    priors: str = "fixed"
    clutter_prior: str = "share"
    annealing: tuple[float, ...] = ()
    homothetic: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    gate: float | None = 25.0
    correction: bool = True
    assignment: str = "exclusive"
    adaptive: int = 1
    extrinsic: bool = True
    initiation: Initiation | None = field(default_factory=Initiation)
    rounds: int = 20

    def __post_init__(self) -> None:
        me = self._caller
        object.__setattr__(self, "motion", check_motions(me, self.motion, self.chain))
        for name in ("window", "slide", "iterations", "rounds"):
            check_count(me, name, getattr(self, name), 1, remedy="Give a count.")
        for name, known in zip(("priors", "clutter_prior", "assignment"), RULES, strict=True):
            check_choice(me, name, getattr(self, name), known)
        check_annealing(me, self.annealing)
        check_count(me, "adaptive", self.adaptive, 0, remedy="Give iterations.")
        check_number(me, "tolerance", self.tolerance, 0.0, least=True, remedy="Use 1e-4.")
        if self.gate is not None:
            check_number(me, "gate", self.gate, 0.0, infinite=True, remedy="Use 25, or None for none.")
        check_homothetic(me, self.homothetic)
        kinds = (Initiation, type(None))
        check_kind(me, "initiation", self.initiation, kinds, "an Initiation, or None", "Use Initiation(speed=20.0).")
        _ = self.moving

    @property
    def _caller(self) -> str:
        return "Pmht"

    @property
    def modes(self) -> tuple[Motion, ...]:
        """The motions."""
        return tuple(self.motion)  # type: ignore[arg-type]

    @property
    def _components(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return ((1.0,), (1.0,)) if self.homothetic is None else self.homothetic

    @cached_property
    def _mixture(self) -> tuple[Array, Array]:
        shares, scales = self._components
        return np.log(np.asarray(shares, dtype=np.float64)), np.asarray(scales, dtype=np.float64)

    @cached_property
    def moving(self) -> Moving:
        """Tables of the motions."""
        return make_moving(self.modes)

    @cached_property
    def _markov(self) -> MarkovChain:
        count = len(self.modes)
        if self.chain is None:
            return MarkovChain.from_sojourns([10.0] * count) if count > 1 else MarkovChain.per_step([[1.0]])
        return self.chain

    @cached_property
    def _long_run(self) -> Array:
        return self._markov.stationary()

    def _chain_at(self, dt: float) -> Array:
        return self._markov.at(dt) if dt > 0 else np.eye(len(self.modes))

    def start(
        self, sensors: ScanSensor | Sequence[ScanSensor], time: float, known: KnownTracks | None = None
    ) -> PmhtState:
        """Begin before the first scan.

        Args:
            sensors: the sensors that will scan; a scan names its own by index.
            time: s; of the known tracks where there are any.
            known: targets known beforehand.

        Raises:
            ValueError: no sensors, no time, or motion, sensors and known tracks of unlike space dimensions.
        """
        me = f"{self._caller}.start"
        all_sensors = check_sensors(me, sensors)
        kinds = (KnownTracks, type(None))
        check_kind(me, "known", known, kinds, "KnownTracks, or None", "Give their mean, cov and time.")
        check_number(me, "time", time, remedy="Give seconds.")
        axes, first = all_sensors[0].model.axes, self.modes[0]
        widths = {first.axes, axes, *(sensor.model.axes for sensor in all_sensors)}
        if len(widths) > 1 or (known is not None and known.mean.shape[1] != 2 * axes):
            raise ValueError(
                f"{me}: motion, sensors and known tracks must have the same space dimensions; got {widths}. "
                "Use 2 or 3 for all."
            )
        J, n, next_id = len(self.modes), first.size, 1
        time = float(time) if known is None else known.time
        tracks = empty_tracks(0, J, n)
        if known is not None:
            mean, cov = state_moments(first, known.mean, known.cov)
            M = len(mean)
            probs = np.tile(self._long_run, (M, 1))
            last = np.repeat(mean[:, None], J, axis=1), np.repeat(cov[:, None], J, axis=1), probs
            tracks = fresh_tracks(np.arange(1, M + 1), 0, last, np.full(M, time))
            next_id = M + 1
        return PmhtState(
            all_sensors, make_sensing(all_sensors), time, 0,
            empty_window(time, axes, max(sensor.size for sensor in all_sensors)),
            tracks, no_tentatives(J, n), next_id,
        )  # fmt: skip

    def step(self, state: PmhtState, scan: Scan) -> tuple[PmhtState, Found]:
        """Take in one scan.

        Args:
            state: of `start` or the last step.
            scan: not older than the last one; as `Scans` gives it (sorted, finite).

        Returns:
            the new state and what was found.

        Raises:
            ValueError: the scan is older than the last one, of an unknown sensor, or not what its sensor measures.
        """
        check_scan(f"{self._caller}.step", scan, state.sensors, state.time)
        return self._taken(state, scan)

    def _taken(self, state: PmhtState, scan: Scan) -> tuple[PmhtState, Found]:
        """`step` with a scan that has been checked."""
        window, tracks, retired = state.window, state.tracks, None
        if len(window.times) == self.window:
            retired = Outcome.of(self.moving, tracks, 0)
            window, tracks = without_first(window), _slid(tracks)
        dt = scan.time - state.time
        chain = self._chain_at(dt)
        ahead = foresee(self.moving, chain, dt, tracks.last_mean, tracks.last_cov, tracks.last_probs)
        window = with_scan(window, scan)
        sensor = state.sensors[scan.sensor]
        tracks = _extended(tracks, ahead, self._in_view(sensor, scan, ahead[3]))
        fitted = self._fit(state, window, tracks, 1 if state.scans % self.slide else self.iterations)
        tracks = fitted.apply(tracks)
        newest = fitted.newest(window)
        counted = state._replace(window=window, tracks=tracks, time=scan.time, scans=state.scans + 1)
        if self.initiation is not None:
            counted, ended, begun = initiate(self, counted, scan, ahead, newest)
        else:
            ended, begun = tracks.ids[:0], tracks.ids[:0]
        now = Outcome.of(self.moving, counted.tracks, len(window.times) - 1, self.modes)
        return counted, Found(scan.time, now, retired, ended, begun, newest, fitted.counts, fitted.objective)

    def run(self, scans: Scans, known: KnownTracks | None = None) -> MultiTracks:
        """Take in all scans; equal to a loop of `step`.

        Args:
            scans: in time order.
            known: targets known beforehand; their time is not after the first scan.

        Returns:
            tracks as they stood at each scan, and smoothed by the scans that followed within the window.
        """
        me = f"{self._caller}.run"
        check_kind(me, "scans", scans, Scans, "Scans", "Make them with Scans.from_arrays or Scans.from_frame.")
        if not len(scans):
            return gather([], None, scans)
        state = self.start(scans.sensors, float(scans.times[0]), known)
        if scans.times[0] < state.time:
            raise ValueError(
                f"{me}: known must be of {scans.times[0]:g} s, the first scan, or before; got {state.time:g} s. Leave "
                "earlier scans out."
            )
        found = []
        for scan in scans:
            state, one = self._taken(state, scan)
            found.append(one)
        rest = [Outcome.of(self.moving, state.tracks, k) for k in range(len(state.window.times))]
        return gather(found, rest, scans)

    def _in_view(self, sensor: ScanSensor, scan: Scan, means: Array) -> Array:
        if sensor.watches is None:
            return np.full(len(means), float(sensor.detection))
        return sensor.detected(positions_of(self.moving, means), scan.sensor_state)

    def gate_of(self, sensor: ScanSensor) -> float:
        """D^2 gate of a sensor; inf: none."""
        own = sensor.gate if sensor.gate is not None else self.gate
        return np.inf if own is None else float(own)

    def _fit(self, state: PmhtState, window: Window, tracks: TrackSet, iterations: int) -> Fit:
        sensors = [state.sensors[index] for index in window.sensor]
        K, modes = len(window.times), len(self.modes)
        if modes == 1:
            chain = np.ones((K, 1, 1))
        else:
            steps = np.concatenate([[0.0], window.times[1:] - window.times[:-1]])
            chain = np.stack([self._chain_at(dt) for dt in steps])
        found = fit_window(
            self.moving, state.sensing, window.times, float(window.times[0]), window.sensor, window.places,
            window.noise, window.detections, window.offsets, tracks.begin, tracks.prior_mean, tracks.prior_cov,
            tracks.prior_probs, chain, tracks.means, tracks.covs,
            np.array([self.gate_of(sensor) for sensor in sensors]), np.ascontiguousarray(tracks.detected.T),
            np.array([sensor.density for sensor in sensors]), np.array([sensor.volume for sensor in sensors]),
            iterations, self.tolerance, np.asarray(self.annealing[:iterations - 1], dtype=np.float64),
            *self._mixture,
            self.priors == "updated", self.clutter_prior == "missed",
            self.rounds if self.assignment == "exclusive" else 0, self.correction, self.adaptive,
            self.extrinsic and self.assignment == "exclusive" and self.homothetic is None,
        )  # fmt: skip
        return Fit(*found)


def check_motions(caller: str, motion: Motion | Sequence[Motion], chain: MarkovChain | None) -> tuple[Motion, ...]:
    """One motion or several as a tuple, and a chain that fits them.

    Raises:
        ValueError: something else, or a chain of another number of modes.
    """
    every = (motion,) if isinstance(motion, Motion) else tuple(motion) if isinstance(motion, Sequence) else ()
    if not every or not all(isinstance(one, Motion) for one in every):
        raise ValueError(f"{caller}: motion must be one Motion, or several; got {motion!r}. Use constant_velocity().")
    remedy = "Use MarkovChain.from_sojourns."
    check_kind(caller, "chain", chain, (MarkovChain, type(None)), "a MarkovChain, or None", remedy)
    if chain is not None and chain.modes != len(every):
        raise ValueError(
            f"{caller}: chain must have one state per motion, {len(every)}; got {chain.modes}. Give one row per motion."
        )
    return every


def check_annealing(caller: str, annealing: tuple[float, ...]) -> None:
    """Factors on R that never increase down to 1.

    Raises:
        ValueError: something else.
    """
    remedy = "Use for instance (16, 8, 4, 2)."
    steps = check_array(caller, "annealing", annealing, remedy)
    if steps.ndim != 1 or not (np.isfinite(steps) & (steps >= 1)).all() or (np.diff(steps) > 0).any():
        raise ValueError(f"{caller}: annealing must hold factors >= 1 that never increase; got {annealing!r}. {remedy}")


def check_homothetic(caller: str, homothetic: tuple[tuple[float, ...], tuple[float, ...]] | None) -> None:
    """Shares and factors of a homothetic density; None: plain.

    Raises:
        ValueError: something else.
    """
    if homothetic is None:
        return
    remedy = "Use for instance ((0.6, 0.3, 0.1), (1, 4, 16))."
    table = check_array(caller, "homothetic", homothetic, remedy)
    good = table.ndim == 2 and len(table) == 2 and table.shape[1] > 0 and np.isfinite(table).all()
    if not good or not (table > 0).all() or abs(table[0].sum() - 1) > 1e-9:
        raise ValueError(
            f"{caller}: homothetic must give as many shares > 0 that sum to 1 as factors > 0; got {homothetic!r}. "
            f"{remedy}"
        )


def positions_of(moving: Moving, means: Array) -> Array:
    """Positions (M, A) of states (M, n)."""
    from jink.estimators.multitarget.results import kinematic_moments

    M, n = means.shape
    return kinematic_moments(moving, means, np.zeros((M, n, n)))[0][:, : len(moving.index) // 2]


def _slid(tracks: TrackSet) -> TrackSet:
    """Tracks of the window without its first scan: the filter's prediction of the second is the new prior."""
    first = tracks.begin == 0
    prior_mean, prior_cov, prior_probs = tracks.prior_mean, tracks.prior_cov, tracks.prior_probs
    begin = np.maximum(tracks.begin - 1, 0)
    if tracks.means.shape[1] > 1:
        prior_mean = np.where(first[:, None, None], tracks.ahead_mean[:, 1], prior_mean)
        prior_cov = np.where(first[:, None, None, None], tracks.ahead_cov[:, 1], prior_cov)
        prior_probs = np.where(first[:, None], tracks.ahead_probs[:, 1], prior_probs)
    cut = {
        name: np.ascontiguousarray(getattr(tracks, name)[:, 1:])
        for name in ("means", "covs", "ahead_mean", "ahead_cov", "ahead_probs", "detected", "hits")
    }
    return tracks._replace(begin=begin, prior_mean=prior_mean, prior_cov=prior_cov, prior_probs=prior_probs, **cut)


def _extended(tracks: TrackSet, ahead: tuple[Array, ...], detected: Array) -> TrackSet:
    """Tracks of the window with one more scan, which every track is predicted to."""
    jm, jP, probs, mean, cov = ahead
    K = tracks.means.shape[1]
    new = tracks.begin == K
    grown = {
        "means": mean, "covs": cov, "ahead_mean": jm, "ahead_cov": jP, "ahead_probs": probs, "detected": detected,
        "hits": np.zeros(len(mean)),
    }  # fmt: skip
    wide = {name: np.concatenate([getattr(tracks, name), part[:, None]], axis=1) for name, part in grown.items()}
    return tracks._replace(
        prior_mean=np.where(new[:, None, None], jm, tracks.prior_mean),
        prior_cov=np.where(new[:, None, None, None], jP, tracks.prior_cov),
        prior_probs=np.where(new[:, None], probs, tracks.prior_probs),
        **wide,
    )
