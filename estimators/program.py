"""A bank as plain arrays: what the compiled cycle reads (`Program`) and what it writes on the way (`Work`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.motion import Motion
from jink.estimators.pieces import PROGRAM, WORK, piece_addresses
from jink.estimators.reference import record_type, reference_reader
from jink.estimators.sensor import Sensor
from jink.estimators.treatment_kernels import ADAPTING
from jink.estimators.treatment_tables import treatment_tables
from jink.estimators.treatments import Treatment

__all__ = [
    "BIRTH",
    "INTERACTIONS",
    "JET",
    "MIX",
    "NONE",
    "RESET",
    "Program",
    "Work",
    "make_program",
    "make_work",
    "program_at",
    "work_at",
]

NONE, MIX, BIRTH, JET, RESET = range(5)
INTERACTIONS = {"none": NONE, "mix": MIX, "birth": BIRTH, "jet": JET, "reset": RESET}
_ORDER = {"": 0, "v": 1, "a": 2}

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Program(NamedTuple):
    """Tables of a bank of M modes with at most N state components (padded), K own parameters, D measured ones."""

    pieces: Ints  # addresses of separately compiled kernels
    sizes: Ints  # (M,) state sizes n
    own_counts: Ints  # (M,) own parameters
    kin_index: Ints  # (M, 2A) component of each position and velocity; -1: ask kinematics()
    own_index: Ints  # (M, K) component of each own parameter; -1: none
    linear: NDArray[np.bool_]  # (M,) transition is a matrix
    angular: NDArray[np.bool_]  # (M, N) components to wrap
    diffusion: Floats  # (M, N) white noise where noise() is missing
    params: Floats  # (M, Pm)
    param_counts: Ints  # (M,) constants of each motion
    birth_mean: Floats  # (M, K)
    birth_cov: Floats  # (M, K, K)
    transition: Ints  # (M,) addresses
    noise: Ints
    kinematics: Ints
    assemble: Ints
    own_from_jet: Ints
    rule: int  # interaction
    same_layout: bool  # every mode has the same components: mixing needs no gathering
    source: Ints  # (to, from, N) component of the old state; -1: filled from own parameters
    gathered: NDArray[np.bool_]  # (to, from) conversion is a choice of components (no sigma points)
    drawn: Ints  # (to, from) own parameters that are drawn on conversion
    use_acceleration: NDArray[np.bool_]  # (to, from) acceleration determines own parameters
    observe: int  # address
    sensor_params: Floats  # (Ps,)
    sensor_linear: bool
    sensor_matrix: Floats  # (D, 2A) of a linear sensor
    sensor_angular: NDArray[np.bool_]  # (D,)
    tuning: Floats  # (3,) alpha, beta, kappa
    per_step: bool  # chain is one matrix per step
    chain: Floats  # (M, M) matrix or generator
    min_prob: float
    reset_prob: float
    reset_nis: float
    shared: bool  # modes of one intent share their prediction
    leader: Ints  # (M,) first mode of the intent where they share; else the mode itself
    forgiving: bool  # R follows each innovation: isolated outliers are this bank's business
    levelled: bool  # modes differ in their factor on R
    watched: bool  # is the target where the bank thinks?
    restart: bool  # begin again where it is not
    calm: float  # the nominal noise: smallest factor on R
    start_probs: Floats  # (M,)
    outer_chain: Floats  # (I, I) and (L, L): generators whose Kronecker sum the chain is, or (0, 0)
    inner_chain: Floats
    treated: Ints  # (M,) noise treatments: see `TreatmentTables` for all of these
    noise_scale: Floats
    process_scale: Floats
    spread_scale: Floats
    factor: Ints
    thresholds: Floats
    cap: Floats
    density: Ints
    dof: Floats
    density_constant: Floats
    reset_scale: Floats
    error: Floats
    excitation: Floats
    noise_excitation: Floats
    error_count: Ints
    excitation_count: Ints
    alpha: Floats
    optimise: NDArray[np.bool_]


class Work(NamedTuple):
    """Scratch of one track; nothing in it outlives a call except the tables cached by time step."""

    cached_dt: Floats
    F_transposed: Floats
    Q: Floats
    weights: Floats
    mixed_mean: Floats
    mixed_cov: Floats
    part_mean: Floats
    part_cov: Floats
    predicted_mean: Floats
    predicted_cov: Floats
    product: Floats
    upper: Floats
    points: Floats
    moved: Floats
    scaled: Floats
    seen: Floats
    H: Floats
    R: Floats
    S: Floats
    S_modes: Floats
    S_calm: Floats
    innovation: Floats
    cross: Floats
    gain: Floats
    factor: Floats
    whitened: Floats
    kin: Floats
    jet: Floats
    sensed: Floats
    present: Ints
    log_density: Floats
    nis: Floats
    prior: Floats
    chain: Floats
    chain_scratch: Floats
    kin_modes: Floats
    kin_covs: Floats
    vector: Floats
    own: Floats
    own_mean: Floats
    own_cov: Floats
    own_factor: Floats
    joint_square: Floats
    ahead: Floats
    behind: Floats
    no_chains: Floats
    product_chains: Floats
    noise_kept: Floats
    noise_own: Floats
    noise_new: Floats
    HPH: Floats
    statistic: Floats
    regulation: Floats
    seen_error: Floats
    robust_noise: Floats
    robust: Floats
    hedge_cross: Floats
    hedge_gain: Floats
    hedge_noise: Floats
    hedge_seen: Floats
    hedge_factor: Floats
    hedge_whitened: Floats
    hedge_innovation: Floats
    game: Floats


def make_work(
    modes: int,
    states: int,
    own: int,
    measured: int,
    kin: int,
    errors: int = 1,
    excitations: int = 1,
    factors: int = 0,
) -> Work:
    """Scratch arrays for M modes, N padded states, K own parameters, D measured components, 2A kinematics.

    ``errors``, ``excitations``: columns of M and rows of E of uncertain modes; ``factors``: modes of the larger
    factor of a product chain.
    """
    joint = (states + own + 7) // 8 * 8
    wide = (measured + 7) // 8 * 8
    few = (own + 7) // 8 * 8
    seven = (kin + 7) // 8 * 8
    both = (kin + own + 7) // 8 * 8
    points = max(2 * joint + 1, modes)
    broad = (max(measured, errors) + 7) // 8 * 8
    excited = (excitations + 7) // 8 * 8
    stacked = measured + excitations
    cached_dt = np.full(modes + 1, np.nan)
    return Work(
        cached_dt,
        np.zeros((modes, states, states)),
        np.zeros((modes, states, states)),
        np.zeros(max(modes, 1)),
        np.zeros((modes, states)),
        np.zeros((modes, states, states)),
        np.zeros((modes, states)),
        np.zeros((modes, states, states)),
        np.zeros((modes, states)),
        np.zeros((modes, states, states)),
        np.zeros((states, states)),
        np.zeros((joint, joint)),
        np.zeros((points, joint)),
        np.zeros((points, joint)),
        np.zeros((points, joint)),
        np.zeros((points, wide)),
        np.zeros((measured, states)),
        np.zeros((measured, wide)),
        np.zeros((measured, wide)),
        np.zeros((modes, measured, wide)),
        np.zeros((modes, measured, wide)),
        np.zeros((modes, measured)),
        np.zeros((measured, states)),
        np.zeros((measured, states)),
        np.zeros((max(measured, kin), max(wide, seven))),
        np.zeros((max(measured, kin), 8)),
        np.zeros(kin),
        np.zeros(kin + kin // 2),
        np.zeros(measured),
        np.zeros(measured, np.int64),
        np.zeros(modes),
        np.zeros(modes),
        np.zeros(modes),
        np.zeros((modes, modes)),
        np.zeros((modes, modes)),
        np.zeros((modes, kin)),
        np.zeros((modes, kin, kin)),
        np.zeros(joint),
        np.zeros(own),
        np.zeros(own),
        np.zeros((own, few)),
        np.zeros((own, few)),
        np.zeros((kin + own, both)),
        np.zeros(kin),
        np.zeros(kin),
        np.zeros((0, modes, modes)),
        np.zeros((3, factors, factors)),
        np.zeros((measured, wide)),
        np.zeros((measured, wide)),
        np.zeros((measured, wide)),
        np.zeros((measured, wide)),
        np.zeros((2 * measured, wide)),
        np.zeros(modes),
        np.zeros((measured, broad)),
        np.zeros((measured, wide)),
        np.zeros((3, max(measured, errors), broad)),
        np.zeros((excitations, states)),
        np.zeros((excitations, states)),
        np.zeros((excitations, excited)),
        np.zeros((excitations, excited)),
        np.zeros((excitations, excited)),
        np.zeros((excitations, 8)),
        np.zeros(excitations),
        np.zeros((4, stacked, (stacked + 7) // 8 * 8)),
    )


def make_program(
    motions: tuple[Motion, ...],
    sensor: Sensor,
    *,
    rule: int,
    per_step: bool,
    chain: Floats,
    tuning: tuple[float, float, float],
    min_prob: float,
    reset_prob: float,
    reset_nis: float,
    every_sigma_point: bool,
    treatments: tuple[tuple[Treatment, ...], ...] = (),
    intents: tuple[str, ...] = (),
    shared: bool = False,
    chain_factors: tuple[Floats, Floats] | None = None,
    restart: bool | None = None,
    start_probs: Floats | None = None,
) -> Program:
    """The tables of a bank; every function of its motions is compiled (or loaded from the cache) here.

    Args:
        motions: one per mode; same ``axes``.
        sensor: what the bank is measured by; same ``axes``.
        rule: one of ``INTERACTIONS``.
        per_step: whether ``chain`` is a matrix per step (else a generator).
        chain: (M, M).
        tuning: alpha, beta, kappa of the unscented transform.
        min_prob: floor of mode probabilities.
        reset_prob: probability under which `RESET` starts a mode afresh.
        reset_nis: average of normalised innovation squared above which it does.
        every_sigma_point: use sigma points even where a matrix would do.
        treatments: noise treatments of each mode; empty: none.
        intents: what each mode is about: among modes of one intent all components carry over; empty: all differ.
        shared: modes of one intent share their prediction.
        chain_factors: generators (I, I), (L, L) whose Kronecker sum ``chain`` is; None: it is no product.
        restart: begin again where the target is lost; None: where noise is judged from innovations.
        start_probs: mode probabilities at the start; (M,); None: equal.

    Returns:
        The `Program`.
    """
    modes = len(motions)
    kin = 2 * sensor.axes
    states = (max(motion.size for motion in motions) + 7) // 8 * 8
    own = max(1, max(len(motion.own_labels) for motion in motions))
    width = max(1, max(len(motion.params) for motion in motions))

    def table(shape: tuple[int, ...], fill: float = 0.0) -> Floats:
        return np.full((modes, *shape), fill, dtype=np.float64)

    kin_index = np.full((modes, kin), -1, dtype=np.int64)
    own_index = np.full((modes, own), -1, dtype=np.int64)
    angular = np.zeros((modes, states), dtype=np.bool_)
    diffusion, params = table((states,)), table((width,))
    birth_mean, birth_cov = table((own,)), table((own, own))
    for j, motion in enumerate(motions):
        index = {label: i for i, label in enumerate(motion.labels)}
        if motion.cartesian:
            kin_index[j] = [index[label] for label in motion.kinematic_labels]
        for k, label in enumerate(motion.own_labels):
            own_index[j, k] = index[label]
        for label in motion.angular:
            angular[j, index[label]] = True
        diffusion[j, : motion.size] = motion.diffusion
        params[j, : len(motion.params)] = motion.params
        birth_mean[j, : len(motion.own_labels)] = motion.birth_mean
        birth_cov[j, range(len(motion.own_labels)), range(len(motion.own_labels))] = np.square(motion.birth_sd)
    intents = intents or tuple(str(j) for j in range(modes))
    source, gathered, drawn, use_acceleration = _conversions(motions, intents, rule, states)
    sizes = tuple(motion.size for motion in motions)
    treated = treatment_tables(treatments or ((),) * modes, sizes, states, sensor.size)
    levelled = bool(np.ptp(treated.noise_scale) > 0.0)
    adapting = bool((treated.treated & ADAPTING).any())
    judging = levelled or adapting
    matrix = np.zeros((sensor.size, kin))
    if sensor.linear:
        for i in range(kin):
            out = np.zeros(sensor.size)
            sensor.observe.function(np.eye(kin)[i], np.zeros(kin), np.array(sensor.params), out)
            matrix[:, i] = out

    def addresses(name: str) -> Ints:
        callbacks = [getattr(motion, name) for motion in motions]
        return np.array([0 if callback is None else callback.address for callback in callbacks], dtype=np.int64)

    return Program(
        pieces=piece_addresses(),
        sizes=np.array([motion.size for motion in motions], dtype=np.int64),
        own_counts=np.array([len(motion.own_labels) for motion in motions], dtype=np.int64),
        kin_index=kin_index,
        own_index=own_index,
        linear=np.array([motion.linear and not every_sigma_point for motion in motions], dtype=np.bool_),
        angular=angular,
        diffusion=diffusion,
        params=params,
        param_counts=np.array([len(motion.params) for motion in motions], dtype=np.int64),
        birth_mean=birth_mean,
        birth_cov=birth_cov,
        transition=addresses("transition"),
        noise=addresses("noise"),
        kinematics=addresses("kinematics"),
        assemble=addresses("assemble"),
        own_from_jet=addresses("own_from_jet"),
        rule=rule,
        same_layout=rule == MIX and len({motion.labels for motion in motions}) == 1 and not angular.any(),
        source=source,
        gathered=gathered,
        drawn=drawn,
        use_acceleration=use_acceleration,
        observe=sensor.observe.address,
        sensor_params=np.array(sensor.params or (0.0,), dtype=np.float64),
        sensor_linear=bool(sensor.linear and not every_sigma_point),
        sensor_matrix=matrix,
        sensor_angular=np.array(sensor.angular, dtype=np.bool_),
        tuning=np.array(tuning, dtype=np.float64),
        per_step=per_step,
        chain=np.ascontiguousarray(chain, dtype=np.float64),
        min_prob=float(min_prob),
        reset_prob=float(reset_prob),
        reset_nis=float(reset_nis),
        shared=shared,
        leader=np.array([intents.index(intent) if shared else j for j, intent in enumerate(intents)], dtype=np.int64),
        forgiving=adapting and not levelled,
        levelled=levelled,
        watched=judging or bool(restart),
        restart=judging if restart is None else restart,
        calm=float(treated.noise_scale.min()),
        start_probs=np.full(modes, 1.0 / modes) if start_probs is None else np.array(start_probs, dtype=np.float64),
        outer_chain=np.zeros((0, 0)) if chain_factors is None else np.ascontiguousarray(chain_factors[0]),
        inner_chain=np.zeros((0, 0)) if chain_factors is None else np.ascontiguousarray(chain_factors[1]),
        **treated._asdict(),
    )


def _conversions(
    motions: tuple[Motion, ...], intents: tuple[str, ...], rule: int, states: int
) -> tuple[Ints, NDArray[np.bool_], Ints, NDArray[np.bool_]]:
    """Which component of each other state a component continues, and where components alone do not tell.

    ``mix``: equal labels continue; others are filled from the receiving mode itself (unbiased mixing).
    ``birth``: position and velocity continue; others are born. ``jet``: as far as both states agree on the jet.
    """
    modes = len(motions)
    source = np.full((modes, modes, states), -1, dtype=np.int64)
    gathered = np.ones((modes, modes), dtype=np.bool_)
    drawn = np.zeros((modes, modes), dtype=np.int64)
    use_acceleration = np.zeros((modes, modes), dtype=np.bool_)
    for p, to in enumerate(motions):
        for q, old in enumerate(motions):
            carried = set(to.kinematic_labels)
            same = intents[p] == intents[q]
            if same or (rule == MIX and to.labels == old.labels):
                carried = set(to.labels)
            elif rule == MIX:
                carried |= set(to.labels) & set(old.labels)
            elif rule != BIRTH:
                use_acceleration[p, q] = old.jet_order == 2 and to.own_from_jet is not None
            alike = same or to.labels == old.labels
            gathered[p, q] = (alike and rule == MIX) or same or (to.cartesian and old.cartesian)
            gathered[p, q] = gathered[p, q] and not (use_acceleration[p, q] and p != q)
            for i, label in enumerate(to.labels):
                if label in carried and label in old.labels:
                    source[p, q, i] = old.labels.index(label)
            filled = bool((source[p, q, : to.size] < 0).any()) or not gathered[p, q]
            drawn[p, q] = len(to.own_labels) if filled else 0
    return source, gathered, drawn, use_acceleration


def _example() -> Program:
    """A program without modes: only its types matter."""
    ints, floats, flags = np.zeros(0, np.int64), np.zeros((0, 0)), np.zeros(0, np.bool_)
    tables = np.zeros((0, 0), np.int64)
    return Program(
        ints, ints, ints, tables, tables, flags, flags.reshape(0, 0), floats, floats, ints, floats,
        floats.reshape(0, 0, 0),
        ints, ints, ints, ints, ints, 0, False, tables.reshape(0, 0, 0), flags.reshape(0, 0), tables,
        flags.reshape(0, 0), 0, np.zeros(0), False, floats, flags, np.zeros(0), False, floats, 0.0, 0.0, 0.0, False,
        ints, False, False, False, False, 1.0, np.zeros(0), floats, floats, *treatment_tables((), (), 8, 1),
    )  # fmt: skip


record_type(PROGRAM, _example)
record_type(WORK, lambda: make_work(1, 8, 1, 1, 2))
program_at = reference_reader(PROGRAM)
work_at = reference_reader(WORK)
