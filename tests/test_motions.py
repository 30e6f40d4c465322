"""Laws every motion obeys, and an independent differential equation for each."""

import math

import numpy as np
import pytest
from numba import njit
from numba.core import config
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag, expm

from jink.estimators import compiled
from jink.estimators.motion import Motion
from jink.estimators.motions import MOTIONS, make_motion

CASES = {
    "constant-velocity": make_motion("constant-velocity"),
    "constant-velocity/1": make_motion("constant-velocity", axes=1),
    "constant-velocity/3": make_motion("constant-velocity", axes=3, acceleration_density=0.3),
    "constant-acceleration": make_motion("constant-acceleration"),
    "constant-acceleration/3": make_motion("constant-acceleration", axes=3),
    "singer": make_motion("singer"),
    "singer/quick": make_motion("singer", axes=3, time_constant=0.1),
    "singer/inf": make_motion("singer", time_constant=math.inf, jerk_density=1.0),
    "jerk": make_motion("jerk"),
    "jerk/quick": make_motion("jerk", axes=1, time_constant=0.1),
    "known-turn": make_motion("known-turn"),
    "known-turn/right": make_motion("known-turn", rate=-1.3),
    "coordinated-turn": make_motion("coordinated-turn", rate_density=0.02),
    "polar-turn": make_motion("polar-turn", rate_density=0.02),
    "circle": make_motion("circle"),
    "weave": make_motion("weave"),
    "swing": make_motion("swing", rate=1.1),
    "swing/0": make_motion("swing", axes=3, rate=0.0),
    "drag-coast": make_motion("drag-coast"),
    "drag-coast/3": make_motion("drag-coast", axes=3, drag=0.02),
    "spatial-turn": make_motion("spatial-turn", rate_density=0.02),
    "helix": make_motion("helix"),
    "bilinear": make_motion("bilinear", turn_noise=0.02, growth_noise=0.001),
}
FIRST_ORDER_NOISE = ("bilinear",)
"""Noise that is exact to first order in the turn of one step only; see tests/test_bilinear.py."""
LINEAR = {key: motion for key, motion in CASES.items() if motion.linear}
SCALES = {
    "m": 500.0,
    "m/s": 30.0,
    "m/s^2": 3.0,
    "m/s^3": 1.0,
    "rad": 2.0,
    "rad/s": 0.4,
    "1/s": 0.05,
}
every = pytest.mark.parametrize("key", CASES)


def test_every_registered_motion_has_a_case():
    assert {key.split("/")[0] for key in CASES} == set(MOTIONS)


def states(motion: Motion, count: int = 4) -> np.ndarray:
    """Random states with positive radius, speed and amplitude, and a course fast enough for its weave."""
    rng = np.random.default_rng(7)
    x = rng.standard_normal((count, motion.size)) * [SCALES[unit] for unit in motion.units]
    for i, label in enumerate(motion.labels):
        if label in ("rho", "s", "A"):
            x[:, i] = rng.uniform(5.0, 40.0, count)
        if label == "vxl":
            x[:, i] = rng.choice([-1, 1], count) * rng.uniform(60.0, 90.0, count)
        if label == "w" and motion.name in ("circle", "helix"):
            x[:, i] = rng.choice([-1, 1], count) * rng.uniform(0.1, 0.8, count)
    return x


def params(motion: Motion) -> np.ndarray:
    return np.array(motion.params, dtype=float)


def move(motion: Motion, x: np.ndarray, dt: float) -> np.ndarray:
    out = np.full(motion.size, np.nan)
    motion.transition(np.array(x), dt, params(motion), out)
    return out


def noise(motion: Motion, x: np.ndarray, dt: float) -> np.ndarray:
    out = np.zeros((motion.size, motion.size))
    motion.noise(np.array(x), dt, params(motion), out)
    return out


def kinematics(motion: Motion, x: np.ndarray) -> np.ndarray:
    if motion.cartesian:
        return np.array([x[motion.labels.index(label)] for label in motion.kinematic_labels])
    out = np.full(2 * motion.axes, np.nan)
    motion.kinematics(np.array(x), params(motion), out)
    return out


def assemble(motion: Motion, kin: np.ndarray, own: np.ndarray) -> np.ndarray:
    out = np.full(motion.size, np.nan)
    if motion.cartesian:
        values = dict(zip(motion.kinematic_labels + motion.own_labels, [*kin, *own], strict=True))
        return np.array([values[label] for label in motion.labels])
    motion.assemble(np.array(kin), np.array(own), params(motion), out)
    return out


def own_of(motion: Motion, x: np.ndarray) -> np.ndarray:
    return np.array([x[motion.labels.index(label)] for label in motion.own_labels])


def jacobian(motion: Motion, x: np.ndarray, dt: float) -> np.ndarray:
    columns = []
    for i, unit in enumerate(motion.units):
        step = np.zeros(motion.size)
        step[i] = 1e-5 * SCALES[unit]
        columns.append((move(motion, x + step, dt) - move(motion, x - step, dt)) / (2 * step[i]))
    return np.array(columns).T


def assert_covariances_close(found: np.ndarray, wanted: np.ndarray, rtol: float) -> None:
    """Errors relative to the standard deviations of row and column."""
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.all(np.abs(found - wanted) <= rtol * scale + 1e-300)


# --- differential equations, written a second time --------------------------------------------------------


def chain(motion: Motion, order: int, last: list[float]) -> np.ndarray:
    """Integrators in series on each axis; ``last`` is the row of the last link."""
    block = np.diag(np.ones(order - 1), 1)
    block[-1] = last
    return block_diag(*[block] * motion.axes)


def linear_system(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """``A`` and the diagonal of the noise intensity of a linear motion."""
    p = (*motion.params, 0.0, 0.0)
    n = motion.size
    intensity = np.zeros(n)
    if motion.name == "constant_velocity":
        a = chain(motion, 2, [0, 0])
        intensity[1::2] = p[0]
    elif motion.name == "constant_acceleration":
        a = chain(motion, 3, [0, 0, 0])
        intensity[2::3] = p[0]
    elif motion.name == "singer":
        a = chain(motion, 3, [0, 0, -p[0]])
        intensity[2::3] = p[1]
    elif motion.name == "jerk":
        a = chain(motion, 4, [0, 0, 0, -p[0]])
        intensity[3::4] = p[1]
    elif motion.name == "swing":
        a = chain(motion, 4, [0, 0, -(p[0] ** 2), 0])
        intensity[3::4] = p[1]
    elif motion.name == "known_turn":
        a = np.array([[0, 1, 0, 0], [0, 0, 0, -p[0]], [0, 0, 0, 1], [0, p[0], 0, 0]], dtype=float)
        intensity[1::2] = p[1]
    else:
        a = np.zeros((n, n))
        rates = {"xl": "vxl", "yl": "vyl", "phi": "Omega", "theta": "w", "z": "vz"}
        for label, rate in rates.items():
            if label in motion.labels:
                a[motion.labels.index(label), motion.labels.index(rate)] = 1.0
        densities = {
            "circle": {"xc": p[0], "yc": p[0], "rho": p[1], "w": p[2]},
            "helix": {"xc": p[0], "yc": p[0], "rho": p[1], "w": p[2], "vz": p[3]},
            "weave": {"vxl": p[0], "vyl": p[0], "A": p[1], "Omega": p[2]},
        }[motion.name]
        for label, density in densities.items():
            intensity[motion.labels.index(label)] = density
    return a, intensity


def derivative(motion: Motion, x: np.ndarray) -> np.ndarray:
    if motion.linear:
        return linear_system(motion)[0] @ x
    if motion.name == "coordinated_turn":
        _, vx, _, vy, w = x
        return np.array([vx, -w * vy, vy, w * vx, 0.0])
    if motion.name == "polar_turn":
        _, _, s, psi, w = x
        return np.array([s * np.cos(psi), s * np.sin(psi), 0.0, w, 0.0])
    if motion.name == "spatial_turn":
        v = x[1:6:2]
        acceleration = np.cross(x[6:], v)
        return np.array([*np.column_stack([v, acceleration]).ravel(), 0.0, 0.0, 0.0])
    if motion.name == "bilinear":
        _, vx, _, vy, g, w = x
        return np.array([vx, g * vx - w * vy, vy, w * vx + g * vy, 0.0, 0.0])
    assert motion.name == "drag_coast"
    v = x[1::2]
    return np.column_stack([v, -motion.params[0] * np.linalg.norm(v) * v]).ravel()


INTENSITY = {
    "coordinated_turn": lambda p: [0, p[0], 0, p[0], p[1]],
    "polar_turn": lambda p: [0, 0, p[0], 0, p[1]],
    "spatial_turn": lambda p: [0, p[0], 0, p[0], 0, p[0], p[1], p[1], p[1]],
    "drag_coast": lambda p: [0, p[1], 0, p[1], 0, p[1]],
}


# --- transition -------------------------------------------------------------------------------------------


@every
def test_description_fits_the_state(key):
    motion = CASES[key]
    assert motion.name == key.split("/")[0].replace("-", "_")
    assert len(motion.labels) == len(motion.units) == motion.size
    assert set(motion.units) <= set(SCALES)
    assert len(motion.birth_mean) == len(motion.birth_sd) == len(motion.own_labels)
    assert all(sd > 0 for sd in motion.birth_sd)
    assert 2 * motion.axes + len(motion.own_labels) == motion.size
    assert motion.noise is not None
    assert (motion.own_from_jet is not None) == (bool(motion.own_labels) and motion.name != "weave")


@every
@pytest.mark.parametrize(("a", "b"), [(0.5, 0.25), (0.0, 2.0), (3.0, 10.0), (1e-6, 1e-3)])
def test_flow_law(key, a, b):
    motion = CASES[key]
    for x in states(motion):
        # round-off of the longer path only
        np.testing.assert_allclose(move(motion, move(motion, x, a), b), move(motion, x, a + b), rtol=1e-9, atol=1e-9)


@every
def test_no_time_no_motion(key):
    motion = CASES[key]
    for x in states(motion):
        np.testing.assert_array_equal(move(motion, x, 0.0), x)
        np.testing.assert_array_equal(noise(motion, x, 0.0), 0.0)


@every
def test_transition_solves_its_equation(key):
    motion = CASES[key]
    for x in states(motion, 3):
        found = solve_ivp(lambda _, y: derivative(motion, y), (0.0, 2.5), x, method="DOP853", rtol=1e-11, atol=1e-11).y[
            :, -1
        ]
        np.testing.assert_allclose(move(motion, x, 2.5), found, rtol=1e-8, atol=1e-7)


@pytest.mark.parametrize("key", LINEAR)
def test_linear_motions_are_linear(key):
    motion = LINEAR[key]
    matrix = np.array([move(motion, row, 0.7) for row in np.eye(motion.size)]).T
    for x in states(motion):
        np.testing.assert_allclose(matrix @ x, move(motion, x, 0.7), rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("key", [key for key in CASES if key not in LINEAR])
def test_other_motions_are_not(key):
    motion = CASES[key]
    x = states(motion, 1)[0]
    assert np.abs(move(motion, 2 * x, 0.7) - 2 * move(motion, x, 0.7)).max() > 1e-3


def test_counter_clockwise_is_positive():
    quarter = 2 / math.pi
    eastward = np.array([0.0, 1.0, 0.0, 0.0])
    left = move(make_motion("known-turn", rate=math.pi / 2), eastward, 1.0)
    np.testing.assert_allclose(left, [quarter, 0.0, quarter, 1.0], atol=1e-15)
    estimated = move(CASES["coordinated-turn"], np.array([*eastward, -math.pi / 2]), 1.0)
    np.testing.assert_allclose(estimated[:4], [quarter, 0.0, -quarter, -1.0], atol=1e-15)
    polar = move(CASES["polar-turn"], np.array([0.0, 0.0, 1.0, 0.0, math.pi / 2]), 1.0)
    np.testing.assert_allclose(polar, [quarter, quarter, 1.0, math.pi / 2, math.pi / 2], atol=1e-15)
    circle = assemble(CASES["circle"], np.array([0.0, 0.0, 1.0, 0.0]), np.array([0.5]))
    np.testing.assert_allclose(circle[:3], [0.0, 2.0, 2.0])  # centre to the left
    spatial = move(CASES["spatial-turn"], np.array([0, 1.0, 0, 0, 0, 0, 0, 0, math.pi / 2]), 1.0)
    np.testing.assert_allclose(spatial[:6], [quarter, 0, quarter, 1, 0, 0], atol=1e-15)
    up = move(CASES["spatial-turn"], np.array([0, 1.0, 0, 0, 0, 0, 0, -math.pi / 2, 0]), 1.0)
    np.testing.assert_allclose(up[:6], [quarter, 0, 0, 0, quarter, 1], atol=1e-15)  # -y axis lifts +x to +z


def test_published_left_turn():
    # Bar-Shalom, Li, Kirubarajan (2001), 11.7: 90 s at 1 degree/s to the left, and back at 3 degree/s
    first = move(make_motion("known-turn", rate=math.radians(1)), np.array([1e4, -120.0, 1e4, 0.0]), 90.0)
    np.testing.assert_allclose(first, [3124.506, 0.0, 3124.506, -120.0], atol=1e-3)
    second = move(make_motion("known-turn", rate=-math.radians(3)), np.array([3124.506, 0.0, -11875.494, -120.0]), 30.0)
    np.testing.assert_allclose(second, [832.675, -120.0, -14167.325, 0.0], atol=1e-3)


def test_drag_never_reverses():
    out = move(make_motion("drag-coast", drag=10.0), np.array([0.0, 1e6, 0.0, -1e6]), 1e4)
    assert 0 < out[1] < 1 and -1 < out[3] < 0
    free = move(make_motion("drag-coast", drag=0.0), np.array([0.0, 3.0, 0.0, -4.0]), 2.0)
    np.testing.assert_array_equal(free, [6.0, 3.0, -8.0, -4.0])


# --- noise ------------------------------------------------------------------------------------------------


@every
@pytest.mark.parametrize("dt", [1e-4, 0.05, 1.0, 7.0, 100.0, 1e4])
def test_noise_is_a_covariance(key, dt):
    motion = CASES[key]
    for x in states(motion):
        q = noise(motion, x, dt)
        np.testing.assert_array_equal(q, q.T)
        sd = np.sqrt(np.diag(q))
        used = sd > 0
        correlation = (q / np.outer(sd, sd).clip(1e-300))[np.ix_(used, used)]
        assert np.isfinite(q).all()
        assert np.linalg.eigvalsh(correlation).min() > -1e-12


def van_loan(a: np.ndarray, intensity: np.ndarray, dt: float) -> np.ndarray:
    """Van Loan over a short step, then doubled: in one step it loses digits where exp(-A dt) is large."""
    n = len(a)
    doublings = max(0, int(np.ceil(np.log2(max(dt * np.abs(np.linalg.eigvals(a)).max(), 1e-300)))) + 1)
    short = dt / 2**doublings
    big = expm(short * np.block([[-a, np.diag(intensity)], [np.zeros((n, n)), a.T]]))
    moved, noise = big[n:, n:].T, big[n:, n:].T @ big[:n, n:]
    for _ in range(doublings):
        noise = moved @ noise @ moved.T + noise
        moved = moved @ moved
    return noise


@pytest.mark.parametrize("key", LINEAR)
@pytest.mark.parametrize("dt", [0.19, 0.21, 1.0, 1.9])
def test_linear_noise_equals_van_loan(key, dt):
    motion = LINEAR[key]
    a, intensity = linear_system(motion)
    assert_covariances_close(noise(motion, np.zeros(motion.size), dt), van_loan(a, intensity, dt), 1e-9)


@pytest.mark.parametrize("key", LINEAR)
@pytest.mark.parametrize(("a", "b"), [(0.3, 0.5), (1e-3, 2.0), (5.0, 30.0)])
def test_cutting_a_step_changes_nothing(key, a, b):
    motion = LINEAR[key]
    x = np.zeros(motion.size)
    matrix = np.array([move(motion, row, b) for row in np.eye(motion.size)]).T
    cut = matrix @ noise(motion, x, a) @ matrix.T + noise(motion, x, b)
    assert_covariances_close(cut, noise(motion, x, a + b), 1e-9)


@pytest.mark.parametrize("key", [key for key in CASES if key not in LINEAR and key not in FIRST_ORDER_NOISE])
def test_cutting_a_step_changes_nothing_to_first_order(key):
    motion = CASES[key]
    for x in states(motion):
        matrix = jacobian(motion, move(motion, x, 0.4), 0.8)
        cut = matrix @ noise(motion, x, 0.4) @ matrix.T + noise(motion, move(motion, x, 0.4), 0.8)
        assert_covariances_close(cut, noise(motion, x, 1.2), 1e-6)  # the Jacobian is by differences


@pytest.mark.parametrize("key", [key for key in CASES if key not in LINEAR and key not in FIRST_ORDER_NOISE])
@pytest.mark.parametrize("dt", [0.02, 1.0, 3.5])
def test_nonlinear_noise_is_the_integral_of_the_flow(key, dt):
    motion = CASES[key]
    intensity = np.array(INTENSITY[motion.name](motion.params)[: motion.size], dtype=float)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    for x in states(motion, 3):
        wanted = np.zeros((motion.size, motion.size))
        for node, weight in zip(dt * (nodes + 1) / 2, dt * weights / 2, strict=True):
            phi = jacobian(motion, move(motion, x, dt - node), node)
            wanted += weight * (phi * intensity) @ phi.T
        assert_covariances_close(noise(motion, x, dt), wanted, 1e-6)


def test_singer_between_its_limits():
    x = np.zeros(6)
    slow = make_motion("singer", time_constant=1e9, jerk_density=0.7)
    assert_covariances_close(
        noise(slow, x, 3.0), noise(make_motion("constant-acceleration", jerk_density=0.7), x, 3), 1e-8
    )
    tau = 1e-6
    quick = noise(make_motion("singer", time_constant=tau, jerk_density=0.7 / tau**2), x, 3.0)
    kept = np.ix_([0, 1, 3, 4], [0, 1, 3, 4])
    straight = noise(make_motion("constant-velocity", acceleration_density=0.7), np.zeros(4), 3.0)
    assert_covariances_close(quick[kept], straight, 1e-5)  # the difference is of the order of tau / dt
    np.testing.assert_allclose(noise(make_motion("singer", time_constant=2.0, acceleration_sd=3.0), x, 1e3)[2, 2], 9.0)


def test_held_acceleration_is_the_textbook_matrix():
    motion = make_motion("constant-velocity", acceleration_density=0.0, held_acceleration=2.0)
    gain = np.array([[12.5], [5.0]])
    np.testing.assert_allclose(noise(motion, np.zeros(4), 5.0), block_diag(4 * gain @ gain.T, 4 * gain @ gain.T))
    turn = make_motion("known-turn", rate=0.2, acceleration_density=0.0, held_acceleration=2.0)
    np.testing.assert_allclose(noise(turn, np.zeros(4), 5.0), noise(motion, np.zeros(4), 5.0))


# --- kinematics and jets ----------------------------------------------------------------------------------


@every
def test_velocity_is_the_rate_of_position(key):
    motion = CASES[key]
    h = 1e-4
    for x in states(motion):
        ahead, behind = kinematics(motion, move(motion, x, h)), kinematics(motion, move(motion, x, -h))
        slope = (ahead - behind)[: motion.axes] / (2 * h)
        # differences: h^2 of the third derivative, and round-off of positions / h
        np.testing.assert_allclose(slope, kinematics(motion, x)[motion.axes :], rtol=1e-5, atol=1e-5)


@every
def test_assemble_inverts_kinematics(key):
    motion = CASES[key]
    for x in states(motion):
        back = assemble(motion, kinematics(motion, x), own_of(motion, x))
        difference = back - x
        for i, label in enumerate(motion.labels):
            if label in motion.angular:
                difference[i] = math.remainder(difference[i], 2 * math.pi)
        np.testing.assert_allclose(difference, 0.0, atol=1e-9 * 500)


@every
def test_assembled_state_keeps_position_and_velocity(key):
    """Whatever the own parameters, even where they cannot hold."""
    motion = CASES[key]
    rng = np.random.default_rng(3)
    for scale in (1.0, 30.0, 0.0):
        kin = np.concatenate([rng.normal(0, 500, motion.axes), rng.normal(0, 1, motion.axes) * scale])
        for own in (np.zeros(len(motion.own_labels)), rng.normal(0, 20, len(motion.own_labels))):
            np.testing.assert_allclose(kinematics(motion, assemble(motion, kin, own)), kin, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("key", [key for key, motion in CASES.items() if motion.own_from_jet])
def test_own_parameters_come_back_from_the_jet(key):
    motion = CASES[key]
    h = 1e-4
    for x in states(motion):
        ahead, behind = kinematics(motion, move(motion, x, h)), kinematics(motion, move(motion, x, -h))
        kin = kinematics(motion, x)
        jet = np.concatenate([kin, (ahead - behind)[motion.axes :] / (2 * h)])
        own = np.full(len(motion.own_labels), 123.0)
        motion.own_from_jet(jet, params(motion), own)
        wanted = own_of(motion, x)
        if motion.name == "spatial_turn":  # the part of the rate along the velocity leaves no trace in the jet
            along = kin[3:] / np.linalg.norm(kin[3:])
            wanted = wanted - along * (wanted @ along)
        if len(own) == 2 * motion.axes:  # acceleration and jerk: a jet says nothing about jerk
            wanted[1::2] = 123.0
        np.testing.assert_allclose(own, wanted, rtol=1e-5, atol=1e-6)


def test_slow_target_gets_no_wild_rate():
    own = np.array([123.0])
    motion = make_motion("coordinated-turn", speed_floor=2.0)
    motion.own_from_jet(np.array([0.0, 0.0, 1e-3, 0.0, 0.0, 5.0]), params(motion), own)
    np.testing.assert_allclose(own, 5e-3 / 4)


# --- symmetry ---------------------------------------------------------------------------------------------


def turn_matrix(angle: float, axes: int) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    matrix = np.eye(axes)
    matrix[:2, :2] = [[c, -s], [s, c]]
    return matrix


@pytest.mark.parametrize("key", [key for key, motion in CASES.items() if motion.axes > 1])
def test_turned_scene_turns_the_path(key):
    motion = CASES[key]
    turn = turn_matrix(1.1, motion.axes)
    both = block_diag(turn, turn)
    own_count = len(motion.own_labels)
    own_turn = np.eye(own_count)
    if own_count and own_count % motion.axes == 0 and motion.own_labels[0] in ("ax", "wx"):
        own_turn = np.kron(turn, np.eye(own_count // motion.axes))
    for x in states(motion):
        kin, own = kinematics(motion, x), own_of(motion, x)
        path = kinematics(motion, move(motion, assemble(motion, kin, own), 1.7))
        turned = kinematics(motion, move(motion, assemble(motion, both @ kin, own_turn @ own), 1.7))
        np.testing.assert_allclose(turned, both @ path, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "key", ["known-turn", "coordinated-turn", "drag-coast", "drag-coast/3", "spatial-turn", "bilinear"]
)
def test_turned_scene_turns_the_noise(key):
    motion = CASES[key]
    turn = turn_matrix(1.1, motion.axes)
    whole = np.kron(turn, np.eye(2))
    if motion.own_labels:
        whole = block_diag(whole, turn if len(motion.own_labels) == 3 else np.eye(len(motion.own_labels)))
    for x in states(motion):
        assert_covariances_close(noise(motion, whole @ x, 1.3), whole @ noise(motion, x, 1.3) @ whole.T, 1e-9)


def test_turns_agree_with_each_other():
    """The same target, five descriptions."""
    kin = np.array([100.0, -50.0, 12.0, 9.0])
    rate = -0.37
    paths = [
        kinematics(motion, move(motion, assemble(motion, kin, [rate]), 4.0))
        for motion in (CASES["coordinated-turn"], CASES["polar-turn"], CASES["circle"])
    ]
    known = make_motion("known-turn", rate=rate)
    paths.append(kinematics(known, move(known, assemble(known, kin, []), 4.0)))
    spatial = CASES["spatial-turn"]
    lifted = assemble(spatial, np.array([100.0, -50.0, 3.0, 12.0, 9.0, 0.0]), [0.0, 0.0, rate])
    paths.append(kinematics(spatial, move(spatial, lifted, 4.0))[[0, 1, 3, 4]])
    for path in paths[1:]:
        np.testing.assert_allclose(path, paths[0], rtol=1e-12)


# --- compiled ---------------------------------------------------------------------------------------------


@njit
def run_compiled(transition, noise_address, x, dt, parameters, out, covariance):
    compiled.call_transition(transition, x, dt, parameters, out)
    compiled.call_noise(noise_address, x, dt, parameters, covariance)


@njit
def run_maps(kinematics_address, assemble_address, x, own, parameters, kin, out):
    compiled.call_kinematics(kinematics_address, x, parameters, kin)
    compiled.call_assemble(assemble_address, kin, own, parameters, out)


@njit
def run_own(address, jet, parameters, own):
    compiled.call_own(address, jet, parameters, own)


@every
def test_compiled_equals_python(key):
    motion = CASES[key]
    n = motion.size
    for x in states(motion, 2):
        out, covariance = np.full(n, np.nan), np.zeros((n, n))
        run_compiled(motion.transition.address, motion.noise.address, x, 0.83, params(motion), out, covariance)
        # fused multiply-add may change the last digits
        np.testing.assert_allclose(out, move(motion, x, 0.83), rtol=1e-12, atol=1e-10)
        assert_covariances_close(covariance, noise(motion, x, 0.83), 1e-12)
        if not motion.cartesian:
            kin, own = np.full(2 * motion.axes, np.nan), own_of(motion, x)
            run_maps(motion.kinematics.address, motion.assemble.address, x, own, params(motion), kin, out)
            np.testing.assert_allclose(kin, kinematics(motion, x), rtol=1e-12, atol=1e-10)
            np.testing.assert_allclose(out, assemble(motion, kin, own), rtol=1e-12, atol=1e-10)
        if motion.own_from_jet:
            jet = np.random.default_rng(0).normal(size=3 * motion.axes)
            own, wanted = np.zeros(len(motion.own_labels)), np.zeros(len(motion.own_labels))
            run_own(motion.own_from_jet.address, jet, params(motion), own)
            motion.own_from_jet(jet, params(motion), wanted)
            np.testing.assert_allclose(own, wanted, rtol=1e-12)


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="math.sin(inf) raises in Python, not in compiled code")
@every
def test_compiled_never_raises(key):
    motion = CASES[key]
    n = motion.size
    for value in (0.0, 1e-300, 1e9, -1e150, np.inf, np.nan):
        for dt in (0.0, 1e-9, 1e4):
            out, covariance = np.zeros(n), np.zeros((n, n))
            x = np.full(n, value)
            run_compiled(motion.transition.address, motion.noise.address, x, dt, params(motion), out, covariance)
            if abs(value) < 1e10:
                assert np.isfinite(out).all() and np.isfinite(covariance).all()


# --- errors -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("constant-velocty", {}, "Did you mean 'constant-velocity'"),
        ("hover", {}, "must be one of constant-velocity, .*; got 'hover'"),
        ("weave", {"axes": 3}, "options of weave must be among .*; got axes"),
        ("constant-velocity", {"axes": 4}, "constant_velocity: axes must be 1 or 2 or 3; got 4"),
        ("singer", {"time_constant": 0}, "singer: time_constant must be a finite number > 0; got 0"),
        ("coordinated-turn", {"rate_density": -1.0}, "rate_density must be a finite number >= 0; got -1.0"),
        ("known-turn", {"rate": "fast"}, "rate must be a finite number; got 'fast'"),
        ("drag-coast", {"drag": math.nan}, "drag must be a finite number >= 0; got nan"),
    ],
)
def test_one_clear_sentence(name, options, words):
    with pytest.raises(ValueError, match=words):
        make_motion(name, **options)
