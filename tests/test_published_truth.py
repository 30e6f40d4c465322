"""Truth of the published scenarios: check points, recorded paths, random streams, published filter numbers.

The filters are the plain numpy ones of `reference_imm`, so a failure blames the truth, not the package.
"""

import csv
import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
import reference_imm as reference
from scipy.linalg import solve_discrete_are

from jink.envs.literature.published_legs import Leg
from jink.envs.published import ATC_TURNS, JUMP_LINEAR, SCENARIOS, UNCERTAIN, get_scenario

DEGREE = np.pi / 180
RECORDED = Path(os.environ.get("JINK_DATA", Path(__file__).parents[2] / "shared" / "data")) / "published_scenarios"


@pytest.mark.parametrize("name", SCENARIOS)
def test_data_keep_their_contract(name):
    data = get_scenario(name).simulate(runs=3, seed=4)
    runs, samples, n = data.state.shape
    axes = data.position.shape[-1]
    assert (runs, samples, n) == (3, data.times.size, len(data.state_labels))
    assert data.velocity.shape == data.position.shape == data.measurements.shape == (3, samples, axes)
    assert data.noise.shape == (axes, axes) and data.modes.shape == (3, samples)
    assert data.modes.min() >= 0 and data.modes.max() < len(data.mode_names)
    assert all(np.isfinite(a).all() for a in (data.state, data.measurements, data.times))
    if data.mode_transition is not None:
        np.testing.assert_allclose(data.mode_transition.sum(1), 1)
    sigma = np.sqrt(data.noise[0, 0])
    scatter = np.std(data.measurements - data.position) / sigma
    # 3 runs x >= 67 samples: 5 standard errors of a standard deviation.
    assert abs(scatter - 1) < 5 / np.sqrt(2 * data.measurements.size)


@pytest.mark.parametrize("name", SCENARIOS)
def test_randomness_is_data(name):
    scenario = get_scenario(name)
    few, many = scenario.simulate(2, seed=7), scenario.simulate(4, seed=7)
    np.testing.assert_array_equal(few.state, many.state[:2])
    np.testing.assert_array_equal(few.measurements, many.measurements[:2])
    np.testing.assert_array_equal(few.modes, many.modes[:2])
    assert np.all(many.measurements[0] != many.measurements[1])
    assert np.all(scenario.simulate(2, seed=8).measurements != few.measurements)
    louder = dataclasses.replace(scenario, sigma=3 * scenario.sigma).simulate(2, seed=7)
    np.testing.assert_array_equal(louder.state, few.state)
    # Adding and removing positions of 1e5 m leaves about 1e-11 m of rounding.
    np.testing.assert_allclose(louder.measurements - louder.position, 3 * (few.measurements - few.position), atol=1e-9)


def test_jump_streams_differ():
    data = JUMP_LINEAR.simulate(2, seed=3)
    assert np.any(data.modes[0] != data.modes[1])
    assert np.any(data.state[0, 1:] != data.state[1, 1:])


def test_jump_modes_follow_the_rows():
    transition = [[0.7, 0.3, 0.0], [0.0, 0.6, 0.4], [0.9, 0.0, 0.1]]
    modes = dataclasses.replace(JUMP_LINEAR, mode_transition=transition).simulate(30, seed=1).modes
    counts = np.zeros((3, 3))
    np.add.at(counts, (modes[:, :-1].ravel(), modes[:, 1:].ravel()), 1)
    # About 30 000 steps: 0.02 is more than five standard errors, and the matrix is not symmetric.
    np.testing.assert_allclose(counts / counts.sum(1, keepdims=True), transition, atol=0.02)


def test_jump_step_uses_the_mode_that_ends_there():
    data = JUMP_LINEAR.simulate(20, seed=2)
    gained = np.diff(data.velocity[..., 0], axis=1) - np.array([0.0, 20.0, -20.0])[data.modes[:, 1:]]
    assert abs(gained.mean()) < 0.1 and abs(gained.std() - 2) < 0.05
    position = data.position[..., 0]
    halfway = (data.velocity[:, 1:, 0] + data.velocity[:, :-1, 0]) / 2
    np.testing.assert_allclose(np.diff(position, axis=1), halfway, atol=1e-8)


def test_slow_fast_turns_are_right_angles():
    data = get_scenario("b1-slow-fast-turns-v0").simulate(1, seed=0)
    at = dict(zip(data.times, data.state[0], strict=True))
    np.testing.assert_allclose(at[400.0], [2000, 0, 4000, -15], atol=1e-9)
    np.testing.assert_allclose(at[600.0], [3500, 15, 2500, 0], atol=1e-9)
    np.testing.assert_allclose(at[660.0][[1, 3]], [0, -15], atol=1e-9)
    mode = dict(zip(data.times, data.modes[0], strict=True))
    assert [mode[t] for t in (400.0, 410.0, 600.0, 610.0, 620.0, 660.0, 670.0)] == [0, 1, 1, 0, 2, 2, 0]


def test_atc_check_points():
    data = ATC_TURNS.simulate(1, seed=0)
    at = dict(zip(data.times, data.state[0], strict=True))
    # The published check points have three decimals.
    np.testing.assert_allclose(at[125.0], [10000, -120, 10000, 0], atol=6e-4)
    np.testing.assert_allclose(at[215.0], [3124.506, 0, 3124.506, -120], atol=6e-4)
    np.testing.assert_allclose(at[340.0], [3124.506, 0, -11875.494, -120], atol=6e-4)
    np.testing.assert_allclose(at[370.0][[0, 2]], [832.675, -14167.325], atol=6e-4)
    np.testing.assert_allclose(at[495.0][2], -14167.325, atol=6e-4)
    np.testing.assert_allclose(np.hypot(*data.velocity[0].T), 120, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "file"),
    [(f"lbb-{case}-v0", f"lbb_scenario{case}.csv") for case in ("1", "2", "3", "3b", "3c")]
    + [("b2-atc-turns-v0", "atc_blk_target1.csv")],
)
def test_paths_equal_the_recorded_ones(name, file):
    if not (RECORDED / file).exists():
        pytest.skip("recorded data not found; set JINK_DATA to its folder")
    with (RECORDED / file).open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    data = get_scenario(name).simulate(1, seed=0)
    columns = np.array([[float(row[key]) for key in ("time", "x", "vx", "y", "vy")] for row in rows])
    # The files carry six decimals.
    np.testing.assert_allclose(np.column_stack([data.times, data.state[0]]), columns, atol=1e-6)
    # The files label the step that starts at a sample, the scenario the one that ends there.
    turning = np.array([float(row["turn_rate_deg_s"]) != 0 for row in rows])
    np.testing.assert_array_equal(data.modes[0, 1:] != 0, turning[:-1])


def test_propagation_splits():
    for leg in (Leg(9.0, "a", 0.3), Leg(9.0, "a", acceleration=(1.0, -2.0)), Leg(9.0, "a")):
        start = np.array([1.0, 2.0, 3.0, 4.0])
        halves = leg.propagate(leg.propagate(start, np.array([4.0]))[0], np.array([5.0]))
        np.testing.assert_allclose(halves, leg.propagate(start, np.array([9.0])), rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dt": 0.0}, "dt must be"),
        ({"sigma": float("nan")}, "sigma must be"),
        ({"legs": ()}, "legs must not be empty"),
        ({"legs": (Leg(1.0, "sideways"),)}, "must be one of straight, left-1, right-3; got 'sideways'"),
        ({"mode_transition": ((0.9, 0.1, 0.1),) * 3}, "rows that sum to 1"),
        ({"mode_probs0": None}, "given together"),
    ],
)
def test_bad_leg_scenarios_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(ATC_TURNS, **change)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"steps": 1}, "steps must be"),
        ({"drift": [[0.0, 0.0]]}, r"drift must be finite with shape \(3, 2\)"),
        ({"mode_transition": np.ones((3, 3))}, "rows that sum to 1"),
        ({"schedule": (0, 1, 5)}, "schedule must be 1000 mode indices"),
    ],
)
def test_bad_jump_scenarios_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(JUMP_LINEAR, **change)


def test_clear_sentences():
    with pytest.raises(ValueError, match=r"must be one of b1-.*; got 'b2-atc-turns'\. Did you mean 'b2-atc-turns-v0'"):
        get_scenario("b2-atc-turns")
    with pytest.raises(ValueError, match="runs must be an integer >= 1; got 0"):
        ATC_TURNS.simulate(0, seed=1)
    with pytest.raises(ValueError, match="seed must be an integer >= 0"):
        JUMP_LINEAR.simulate(1, seed=-1)
    with pytest.raises(ValueError, match=r"must be \(0, 0\) in a turn"):
        Leg(1.0, "a", 0.1, (1.0, 0.0))
    with pytest.raises(ValueError, match="delta must be within"):
        UNCERTAIN.transition_at(0.31)
    with pytest.raises(dataclasses.FrozenInstanceError):
        ATC_TURNS.dt = 1.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        np.asarray(JUMP_LINEAR.drift)[0, 0] = 1.0


def run_atc(data, rates, sigmas, pi, mu):
    """Position and velocity errors from the second sample on, of an IMM over known turn rates."""
    dt, runs = 5.0, data.state.shape[0]
    modes = reference.Modes(
        np.stack([reference.turn(dt, rate) for rate in rates]),
        np.zeros((len(rates), 4)),
        np.stack([reference.dwna(dt, sigma) for sigma in sigmas]),
        np.eye(4)[[0, 2]],
        data.noise,
    )
    mean, cov = reference.two_point(data.measurements, dt, 100.0)
    cov = np.broadcast_to(cov, (runs, 4, 4))
    estimate, _, _ = reference.run_imm(
        modes, np.array(pi), np.array(mu), data.measurements[:, 1:], mean, cov, start_used=True
    )
    error = estimate - data.state[:, 1:]
    return error[..., [0, 2]], error[..., [1, 3]]


ATC_FILTERS = {
    "kf-1": ([0.0], [1.0], [[1.0]], [1.0]),
    "kf-0.1": ([0.0], [0.1], [[1.0]], [1.0]),
    "imm-cv-cv": ([0.0, 0.0], [0.1, 2.0], [[0.9, 0.1], [0.1, 0.9]], [0.5, 0.5]),
    "imm-cv-ct": (
        [0.0, DEGREE, -3 * DEGREE],
        [0.1] * 3,
        ATC_TURNS.mode_transition,
        ATC_TURNS.mode_probs0,
    ),
}
# Standard deviation of one 200-run set, from eight sets; ours and the published one both vary.
ATC_SPREAD = {
    "kf-1": (0.52, 4.0, 1.6, 0.05),
    "kf-0.1": (0.9, 2.2, 1.8, 0.05),
    "imm-cv-cv": (0.4, 4.9, 1.6, 0.05),
    "imm-cv-ct": (0.45, 2.4, 2.0, 0.09),
}


@pytest.mark.parametrize("name", ATC_FILTERS)
def test_atc_numbers(name):
    data = ATC_TURNS.simulate(200, seed=1)
    position, velocity = run_atc(data, *ATC_FILTERS[name])
    times = data.times[1:]
    late, leg1 = times >= 30, (times >= 75) & (times <= 125)
    per_time = (position**2).sum(-1).mean(0)
    ours = {
        "position_rms": np.sqrt(per_time[late].mean()),
        "position_peak": np.sqrt(per_time[late].max()),
        "position_leg1": np.sqrt(per_time[leg1].mean()),
        "velocity_rms": np.sqrt((velocity[:, late] ** 2).sum(-1).mean()),
    }
    for (metric, value), spread in zip(ours.items(), ATC_SPREAD[name], strict=True):
        published = data.published[f"{name}/{metric}"].value
        # 3.3 joint standard errors, and half a unit of the last printed digit.
        assert abs(value - published) < 3.3 * np.sqrt(2) * spread + 0.05, metric


def make_modes(scenario):
    """The scenario's own model as reference modes."""
    return reference.Modes(
        np.asarray(scenario.transition),
        np.asarray(scenario.drift),
        scenario.process_noise,
        scenario.observation,
        scenario.sigma**2 * np.eye(len(scenario.position_index)),
    )


def broadcast_prior(data):
    """The prior for every run."""
    runs, n = data.state.shape[0], data.state.shape[-1]
    return np.broadcast_to(data.prior_mean, (runs, n)), np.broadcast_to(data.prior_cov, (runs, n, n))


def test_jump_linear_numbers():
    data = JUMP_LINEAR.simulate(50, seed=1)
    modes, prior = make_modes(JUMP_LINEAR), broadcast_prior(data)
    oracle, _ = reference.run_kalman(modes, data.measurements, *prior, mode=data.modes)
    imm, cov, mu = reference.run_imm(modes, data.mode_transition, data.mode_probs0, data.measurements, *prior)
    for name, estimate in (("oracle", oracle), ("imm", imm)):
        rmse = np.sqrt(((estimate - data.state) ** 2).sum(-1).mean(1)).mean()
        low, high = data.published[name].interval
        # Half-widths are one standard error of 50 runs; ours is as wide: 3.3 joint standard errors.
        assert abs(rmse - data.published[name].value) < 3.3 * np.sqrt(2) * (high - low) / 2
    error = imm - data.state
    nees = np.einsum("bti,bti->bt", error, np.linalg.solve(cov, error[..., None])[..., 0])
    assert abs(nees.mean() - 1.97) < 0.05
    assert abs(np.take_along_axis(mu, data.modes[..., None], -1).mean() - 0.388) < 0.006


def test_cv_ca_numbers():
    scenario = get_scenario("n4-cv-ca-v0")
    data = scenario.simulate(200, seed=1)
    modes, prior = make_modes(scenario), broadcast_prior(data)
    own = np.array([[True] * 4 + [False] * 2, [True] * 6])

    def run_imm(known):
        return reference.run_imm(modes, data.mode_transition, data.mode_probs0, data.measurements, *prior, known=known)[
            0
        ]

    always_ca = np.ones(data.modes.shape, dtype=int)
    estimates = {
        "kf-cv": reference.run_kalman(modes, data.measurements, *prior)[0],
        "kf-ca": reference.run_kalman(modes, data.measurements, *prior, mode=always_ca)[0],
        "imm": run_imm(own),
    }
    padded, unbiased = (((e[..., :2] - data.position) ** 2).mean() for e in (run_imm(None), estimates["imm"]))
    assert unbiased < padded < 1.02 * unbiased
    for name, estimate in estimates.items():
        mse = ((estimate[..., :2] - data.position) ** 2).mean()
        low, high = data.published[name].interval
        # Half-widths are one standard error of 200 runs; ours is as wide: 3.3 joint standard errors.
        assert abs(mse - data.published[name].value) < 3.3 * np.sqrt(2) * (high - low) / 2, name


def test_uncertain_system_is_analytic():
    f, g, h = (
        UNCERTAIN.transition_at(0.0),
        np.asarray(UNCERTAIN.noise_gain),
        np.asarray(UNCERTAIN.observation),
    )
    cov = solve_discrete_are(f.T, h.T, g @ g.T, np.eye(1))
    gain = f @ cov @ h.T / (h @ cov @ h.T + 1)
    for delta in (-0.3, 0.0, 0.3):
        true = UNCERTAIN.transition_at(delta)
        # Joint state (x, error of the fixed predictor); both are driven by the same noise.
        step = np.block([[true, np.zeros((2, 2))], [true - f, f - gain @ h]])
        drive = np.block([[g, np.zeros((2, 1))], [g, -gain]])
        joint = np.linalg.solve(np.eye(16) - np.kron(step, step), (drive @ drive.T).ravel()).reshape(4, 4)
        published = UNCERTAIN.published[f"kf/{delta:+g}"].value
        # The source prints four decimals; 1e-6 relative covers the solve at delta = 0.3.
        np.testing.assert_allclose(joint[2, 2], published, rtol=1e-6, atol=1e-4)
