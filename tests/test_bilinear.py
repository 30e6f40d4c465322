"""The motion of learned intents against its differential equation, its special cases and its noise by quadrature."""

import math

import numpy as np
import pytest
from numba.core import config
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag

from jink.estimators.motions import bilinear, constant_velocity, coordinated_turn, make_motion, singer, spatial_turn
from jink.estimators.motions.bilinear import LARGEST_GROWTH, impulse_response, swing_noise

QUIET = {"growth_noise": 0.0, "turn_noise": 0.0, "wobble": 0.0}
CASES = {
    "2": bilinear(2),
    "2 memory": bilinear(2, growth_mean=0.01, growth_rate=0.3, turn_mean=0.2, turn_rate=0.5),
    "2 slope": bilinear(2, turn_rate=0.2, slope=True),
    "2 swing": bilinear(2, turn_mean=0.05, swing=(0.8, 0.1), turn_noise=0.01),
    "3": bilinear(3),
    "3 memory": bilinear(3, growth_rate=0.3, turn_rate=0.5),
    "3 swing": bilinear(3, swing=(0.8, 0.1), turn_noise=0.01),
}
CONSTANT = ("2", "3")
every = pytest.mark.parametrize("key", CASES)


def move(motion, x, dt):
    out = np.full(motion.size, np.nan)
    motion.transition(np.array(x, dtype=float), dt, np.array(motion.params), out)
    return out


def noise(motion, x, dt):
    out = np.zeros((motion.size, motion.size))
    motion.noise(np.array(x, dtype=float), dt, np.array(motion.params), out)
    return out


def states(motion, count=4):
    rng = np.random.default_rng(5)
    scale = {"m": 500.0, "m/s": 30.0, "1/s": 0.1, "rad/s": 0.4, "rad/s^2": 0.2}
    return rng.standard_normal((count, motion.size)) * [scale[unit] for unit in motion.units]


def shape_system(motion):
    """Matrix, constant and noise density of the shape parameters, written a second time."""
    gm, gr, gq, wm, wr, wq, _, natural, damping, _ = motion.params
    axes, turns = motion.axes, 1 if motion.axes == 2 else 3
    k = motion.size - 2 * axes
    a, c, q = np.zeros((k, k)), np.zeros(k), np.zeros(k)
    a[0, 0], c[0], q[0] = -gr, gr * gm, gq
    for i in range(1, 1 + turns):
        if k == 1 + turns or natural == 0.0:
            a[i, i], c[i], q[i] = -wr, wr * wm, wq
        if k > 1 + turns:
            j = i + turns
            if natural > 0.0:
                a[i, j], a[j, i], a[j, j], c[j], q[j] = 1.0, -(natural**2), -2 * damping * natural, natural**2 * wm, wq
            else:
                a[j, j], q[j] = -1.0, 2.0
    return a, c, q


def flow(motion, x, dt, tolerance=1e-13):
    """State after ``dt`` by integrating the law; also the integrals of g and w."""
    axes, turns = motion.axes, 1 if motion.axes == 2 else 3
    a, c, _ = shape_system(motion)

    def slope(_, y):
        v, own = y[1 : 2 * axes : 2], y[2 * axes : motion.size]
        if axes == 2:
            acceleration = own[0] * v + own[1] * np.array([-v[1], v[0]])
        else:
            acceleration = own[0] * v + np.cross(own[1:4], v)
        kinematics = np.column_stack([v, acceleration]).ravel()
        return np.concatenate([kinematics, a @ own + c, own[: 1 + turns]])

    start = np.concatenate([x, np.zeros(1 + turns)])
    end = solve_ivp(slope, (0.0, dt), start, method="DOP853", rtol=tolerance, atol=tolerance).y[:, -1]
    return end[: motion.size], end[motion.size :]


@pytest.mark.parametrize("key", CONSTANT)
@pytest.mark.parametrize("dt", [1e-3, 0.3, 1.7, 6.0])
def test_constant_shapes_move_exactly(key, dt):
    motion = CASES[key]
    for x in states(motion):
        x[:: 2 * motion.axes] /= 100.0  # places of metres: the tolerance is that of the integrator
        end, _ = flow(motion, x, dt)
        np.testing.assert_allclose(move(motion, x, dt), end, rtol=1e-11, atol=1e-11 * 500)


@every
@pytest.mark.parametrize("dt", [0.3, 2.0, 9.0])
def test_shapes_and_velocity_follow_their_law(key, dt):
    """With memory velocity is exact in the plane; in space where the axis of the turn stays."""
    motion = CASES[key]
    for x in states(motion):
        end, _ = flow(motion, x, dt)
        found, own = move(motion, x, dt), 2 * motion.axes
        turned = end[own:].copy()
        if key.endswith("slope"):
            assert found[own + 2] == pytest.approx(x[own + 2] * math.exp(-dt))
        np.testing.assert_allclose(found[own:], turned, rtol=1e-9, atol=1e-10)
        if key != "3 swing":
            np.testing.assert_allclose(found[1:own:2], end[1:own:2], rtol=1e-9, atol=1e-9 * np.abs(end).max())


@every
def test_place_is_first_order_in_the_change_of_shapes(key):
    """Position uses the mean rates of the step: the error falls with the cube of the step."""
    motion = CASES[key]
    if key in CONSTANT:
        return
    for x in states(motion, 2):
        place = slice(0, 2 * motion.axes, 2)
        errors = [np.abs(move(motion, x, dt)[place] - flow(motion, x, dt)[0][place]).max() for dt in (0.2, 0.1)]
        assert errors[1] < errors[0] / 6.0
        assert errors[0] < 0.2**3 * 30.0


@every
def test_no_time_no_motion(key):
    motion = CASES[key]
    for x in states(motion):
        np.testing.assert_array_equal(move(motion, x, 0.0), x)
        np.testing.assert_array_equal(noise(motion, x, 0.0), 0.0)


@pytest.mark.parametrize("key", CONSTANT)
def test_cutting_a_step_of_constant_shapes(key):
    motion = CASES[key]
    for x in states(motion):
        np.testing.assert_allclose(move(motion, move(motion, x, 0.7), 2.3), move(motion, x, 3.0), rtol=1e-10, atol=1e-9)


def test_special_cases():
    plane = bilinear(2, **QUIET)
    np.testing.assert_allclose(move(plane, [1, 2, 3, -4, 0, 0], 5.0), [11, 2, -17, -4, 0, 0])  # line
    circle = move(plane, [0, 2.0, 0, 0, 0, 0.5], math.pi)  # a quarter of a circle of 4 m, to the left
    np.testing.assert_allclose(circle, [4, 0, 4, 2, 0, 0.5], atol=1e-14)
    grown = move(plane, [0, 3.0, 0, 4.0, 0.1, 0], 2.0)  # speeding up along the course
    np.testing.assert_allclose(grown[[1, 3]], np.array([3, 4]) * math.exp(0.2))
    np.testing.assert_allclose(grown[[0, 2]], np.array([3, 4]) * math.expm1(0.2) / 0.1)
    rate = 0.1 + 0.5j  # spiral: M(c; t) = p + v (exp(l t) - 1) / l
    spiral = move(plane, [1, 2, 3, -4, 0.1, 0.5], 2.5)
    place = (1 + 3j) + (2 - 4j) * (np.exp(rate * 2.5) - 1) / rate
    np.testing.assert_allclose([spiral[0], spiral[2]], [place.real, place.imag], rtol=1e-13)
    turn = coordinated_turn()
    for x in states(turn):
        np.testing.assert_allclose(move(plane, [*x[:4], 0.0, x[4]], 1.3)[:4], move(turn, x, 1.3)[:4], rtol=1e-12)
    space, rodrigues = bilinear(3, **QUIET), spatial_turn()
    for x in states(rodrigues):
        found = move(space, [*x[:6], 0.0, *x[6:]], 1.3)
        np.testing.assert_allclose(found[:6], move(rodrigues, x, 1.3)[:6], rtol=1e-11, atol=1e-9)


def test_plane_is_a_slice_of_space():
    plane, space = (
        CASES["2 memory"].with_(params=(0.0, *CASES["2 memory"].params[1:3], 0.0, *CASES["2 memory"].params[4:])),
        CASES["3 memory"],
    )
    for x in states(plane):
        lifted = [*x[:4], 7.0, 0.0, x[4], 0.0, 0.0, x[5]]
        flat = [0, 1, 2, 3, 6, 9]
        np.testing.assert_allclose(move(space, lifted, 1.7)[flat], move(plane, x, 1.7), rtol=1e-12, atol=1e-10)
        q = noise(space, lifted, 1.7)[np.ix_(flat, flat)]
        np.testing.assert_allclose(q, noise(plane, x, 1.7), rtol=1e-10, atol=1e-12)


def test_tiny_and_large_rates_meet():
    """Either side of every switch between series and closed form."""
    motion = CASES["3"]
    x = np.array([0, 30.0, 0, -20.0, 0, 10.0, 0, 0, 0, 0])
    for size in (1e-12, 1e-6, 1e-3, 0.4999, 0.5001, 1.9):
        for share in (0.0, 1e-6, 0.3, 1.0):
            x[6], x[8] = size * math.sqrt(1 - share**2), size * share
            end, _ = flow(motion, x, 1.0)
            np.testing.assert_allclose(move(motion, x, 1.0), end, rtol=1e-11, atol=1e-10)


# --- noise


@pytest.mark.parametrize("x", [1e-6, 0.2, 0.999, 1.001, 3.0, 12.0])
@pytest.mark.parametrize("damping", [0.01, 0.3, 0.95])
def test_swing_moments_are_their_integrals(x, damping):
    nodes, weights = np.polynomial.legendre.leggauss(120)
    r, weights = (nodes + 1) / 2, weights / 2
    parts = np.array([impulse_response(x * value, damping) for value in r]).T[::-1] * r ** np.arange(3, -1, -1)[:, None]
    wanted = (parts * weights) @ parts.T
    found = np.zeros((4, 4))
    found[np.triu_indices(4)] = swing_noise(x, damping)
    sd = np.sqrt(np.diag(wanted))
    # the closed form cancels against the damping: eps / 0.01
    np.testing.assert_allclose(
        found[np.triu_indices(4)], wanted[np.triu_indices(4)], atol=1e-11 * np.outer(sd, sd).max()
    )
    correlation = np.triu(found) / np.outer(sd, sd)
    np.testing.assert_allclose(correlation, np.triu(wanted / np.outer(sd, sd)), atol=1e-10)


def test_impulse_response_solves_the_swing():
    for x, damping in ((0.5, 0.2), (2.0, 0.2), (9.0, 0.7)):
        found = impulse_response(x, damping)
        end = solve_ivp(lambda _, y, z=damping: [y[1], -y[0] - 2 * z * y[1], y[0], y[2]], (0, x), [0, 1, 0, 0],
                        rtol=1e-12, atol=1e-13).y[:, -1]  # fmt: skip
        np.testing.assert_allclose(found, [end[1], end[0] / x, end[2] / x**2, end[3] / x**3], atol=1e-10)


def shape_moments(motion, dt):
    """Covariance of (double integral, integral, value) of all shape parameters by integrating their moments."""
    a, _, q = shape_system(motion)
    k, turns = len(a), 1 if motion.axes == 2 else 3
    rates = 1 + turns
    big = np.zeros((k + 2 * rates, k + 2 * rates))
    big[:k, :k] = a
    big[k : k + rates, :rates] = np.eye(rates)
    big[k + rates :, k : k + rates] = np.eye(rates)
    drive = np.zeros(len(big))
    drive[:k] = q

    def slope(_, flat):
        p = flat.reshape(len(big), len(big))
        return (big @ p + p @ big.T + np.diag(drive)).ravel()

    end = solve_ivp(slope, (0, dt), np.zeros(big.size), method="DOP853", rtol=1e-12, atol=1e-17).y[:, -1]
    return end.reshape(big.shape), rates


@every
@pytest.mark.parametrize("dt", [0.01, 0.7, 4.0])
def test_noise_is_that_of_the_linearised_law(key, dt):
    """Moments by integrating the covariance of the shapes, laid along and across the velocities of the step."""
    motion = CASES[key]
    axes, own = motion.axes, 2 * motion.axes
    moments, rates = shape_moments(motion, dt)
    k = motion.size - own
    for x in states(motion, 3):
        moved = move(motion, x, dt)
        end, mean = moved[1:own:2], (moved[:own:2] - x[:own:2]) / dt

        def columns(v):
            if axes == 2:
                return np.column_stack([v, [-v[1], v[0]]])
            return np.column_stack([v, *(np.cross(axis, v) for axis in np.eye(3))])

        D = np.zeros((motion.size, len(moments)))
        D[:own:2, k + rates :] = columns(mean)
        D[1:own:2, k : k + rates] = columns(end)
        D[own:, :k] = np.eye(k)
        wanted = D @ moments @ D.T
        white = motion.params[6] * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        wanted[:own, :own] += block_diag(*[white] * axes)
        found = noise(motion, x, dt)
        sd = np.sqrt(np.diag(wanted))
        np.testing.assert_allclose(found / np.outer(sd, sd), wanted / np.outer(sd, sd), atol=1e-9)
        # position by differences of it costs digits at short steps, hence not 1e-12


def test_noise_in_known_limits():
    x = np.array([10.0, 30.0, -5.0, 12.0, 0.0, 0.0])
    straight = noise(bilinear(2, growth_noise=0.0, turn_noise=0.0, wobble=0.7), x, 2.0)[:4, :4]
    np.testing.assert_allclose(straight, noise(constant_velocity(2, acceleration_density=0.7), x[:4], 2.0), rtol=1e-14)
    # a turn of 1e-4 rad in one step: the noise of the coordinated turn to that order
    turn = coordinated_turn(acceleration_density=0.3, rate_density=0.02)
    kept = [0, 1, 2, 3, 5]
    x[5] = 1e-4
    found = noise(bilinear(2, growth_noise=0.0, turn_noise=0.02, wobble=0.3), x, 1.0)[np.ix_(kept, kept)]
    wanted = noise(turn, x[kept], 1.0)
    sd = np.sqrt(np.diag(wanted))
    np.testing.assert_allclose(found / np.outer(sd, sd), wanted / np.outer(sd, sd), atol=2e-4)
    # along the velocity the growth rate is Singer's acceleration per unit speed
    memory = noise(bilinear(2, growth_rate=0.2, growth_noise=0.5, turn_noise=0.0, wobble=0.0), [0, 1, 0, 0, 0, 0], 1.5)
    chain = noise(singer(1, time_constant=5.0, jerk_density=0.5), np.zeros(3), 1.5)
    np.testing.assert_allclose(memory[np.ix_([0, 1, 4], [0, 1, 4])], chain, rtol=1e-12)


@every
@pytest.mark.parametrize("dt", [1e-4, 0.5, 20.0, 1e4])
def test_noise_is_a_covariance_of_numbers(key, dt):
    motion = CASES[key]
    for x in states(motion):
        q = noise(motion, x, dt)
        assert np.isfinite(move(motion, x, dt)).all() and np.isfinite(q).all()
        np.testing.assert_array_equal(q, q.T)
        sd = np.sqrt(np.diag(q))
        assert np.linalg.eigvalsh(q / np.outer(sd, sd)).min() > -1e-11


def test_growth_over_a_gap_stays_a_number():
    grown = move(bilinear(2, **QUIET), [0, 1.0, 0, 0, 3.0, 0], 1e4)
    np.testing.assert_allclose(grown[1], math.exp(LARGEST_GROWTH))


# --- symmetry


@every
def test_mirrored_scene_mirrors_path_and_noise(key):
    motion = CASES[key]
    if motion.axes == 2:
        mirror = np.diag([1, 1, -1, -1, 1, -1, -1][: motion.size])
        params = list(motion.params)
        params[3] = -params[3]
        other = motion.with_(params=tuple(params))
    else:  # through the plane z = 0: the axis of a turn keeps its z component and loses the others
        mirror = np.diag([1, 1, 1, 1, -1, -1, 1, -1, -1, 1, -1, -1, 1][: motion.size])
        other = motion
    for x in states(motion):
        np.testing.assert_allclose(move(other, mirror @ x, 1.3), mirror @ move(motion, x, 1.3), rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(
            noise(other, mirror @ x, 1.3), mirror @ noise(motion, x, 1.3) @ mirror, rtol=1e-10, atol=1e-12
        )


@every
def test_turned_scene_turns_path_and_noise(key):
    motion = CASES[key]
    q, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((motion.axes, motion.axes)))
    turn = q * np.sign(np.linalg.det(q)) if motion.axes == 3 else np.array([[0.6, -0.8], [0.8, 0.6]])
    vectors = (motion.size - 2 * motion.axes - 1) // 3 if motion.axes == 3 else 0
    rest = motion.size - 2 * motion.axes - 1 - 3 * vectors
    whole = block_diag(np.kron(turn, np.eye(2)), np.eye(1 + rest), *[turn] * vectors)
    for x in states(motion):
        np.testing.assert_allclose(move(motion, whole @ x, 1.3), whole @ move(motion, x, 1.3), rtol=1e-9, atol=1e-9)
        turned = whole @ noise(motion, x, 1.3) @ whole.T
        sd = np.sqrt(np.diag(turned))
        np.testing.assert_allclose(
            noise(motion, whole @ x, 1.3) / np.outer(sd, sd), turned / np.outer(sd, sd), atol=1e-11
        )


# --- jets, options


@pytest.mark.parametrize("key", ["2", "3", "3 swing"])
def test_shapes_come_back_from_the_jet(key):
    motion = CASES[key]
    axes = motion.axes
    for x in states(motion):
        v, g, w = x[1 : 2 * axes : 2], x[2 * axes], x[2 * axes + 1 : 2 * axes + 2 if axes == 2 else 2 * axes + 4]
        across = w - v * (w @ v) / (v @ v) if axes == 3 else w
        acceleration = g * v + (np.cross(w, v) if axes == 3 else w[0] * np.array([-v[1], v[0]]))
        own = np.full(motion.size - 2 * axes, 123.0)
        motion.own_from_jet(np.concatenate([x[: 2 * axes : 2], v, acceleration]), np.array(motion.params), own)
        np.testing.assert_allclose(own[: 1 + len(w)], [g, *across], rtol=1e-10, atol=1e-12)
        assert (own[1 + len(w) :] == 123.0).all()  # a jet says nothing about the slope


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="math.sin(inf) raises in Python, not in compiled code")
@every
def test_compiled_callbacks_exist(key):
    motion = CASES[key]
    assert motion.transition.address and motion.noise.address and motion.own_from_jet.address


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"axes": 1}, "bilinear: axes must be 2 or 3; got 1"),
        ({"axes": 3, "turn_mean": 0.1}, "turn_mean and the mean of turn must be 0 with axes=3; got 0.1"),
        ({"swing": (0.5, 1.0)}, r"swing damping must be in \[0.001, 0.999\]; got 1.0"),
        ({"swing": 3.0}, r"swing must be \(natural rate, damping\); got 3.0"),
        ({"swing": (0.5, 0.1), "turn_rate": 0.1}, "turn_rate must be 0 with a swing; got 0.1"),
        ({"growth_noise": -1.0}, "growth_noise must be a finite number >= 0; got -1.0"),
    ],
)
def test_one_clear_sentence(options, words):
    with pytest.raises(ValueError, match=words):
        make_motion("bilinear", **options)
