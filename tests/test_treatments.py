"""Noise treatments inside the bank: frozen values, special cases, and the contract of every mode."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from linear_cases import given_motion, given_sensor
from scipy.stats import multivariate_t

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.factors import FACTORS
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motions import constant_acceleration, constant_velocity, coordinated_turn
from jink.estimators.robust import RobustFilter
from jink.estimators.sensors import position, range_bearing
from jink.estimators.treatment_tables import reset_by_divergence, reset_by_moments
from jink.estimators.treatments import Adaptive, BoundedTails, HeavyTails, Level, Uncertain

ERROR = ((0.02, 0.0), (0.0, 0.0), (0.0, 0.02), (0.0, 0.0))
EXCITED = ((0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
EVERY = {
    "level": Level(9.0),
    **{f"adaptive-{name}": Adaptive(name) for name in FACTORS},
    "adaptive-adapted": Adaptive("huber", "adapted", cap=1e3),
    "adaptive-nominal": Adaptive("mr", "nominal"),
    "bounded-tails": BoundedTails(),
    "heavy-tails": HeavyTails(4.0),
    "heavy-tails-unequal": HeavyTails(4.0, 3.0, 6.0, reset="divergence", mix_factor="plain"),
    "uncertain": Uncertain(ERROR, EXCITED),
    "uncertain-optimal": Uncertain(ERROR, EXCITED, EXCITED, optimise=True),
    "uncertain-adaptive-level": (Uncertain(ERROR, EXCITED, EXCITED), Adaptive("chang"), Level(2.0)),
}
ROWS = 40


def flight(seed=0, tracks=3):
    """Measurements with outliers, a gap and a missing component, at irregular times."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.1, 0.4, ROWS))
    z = 30.0 + np.cumsum(rng.normal(size=(tracks, ROWS, 2)), axis=1)
    z[:, 12] += 80.0
    z[0, 20:23] = np.nan
    z[-1, 25, 1] = np.nan
    return z, times


def seen_by(sensor, z):
    """Positions as that sensor measures them from the origin."""
    if sensor.name == "position":
        return z
    return np.stack([np.hypot(z[..., 0], z[..., 1]), np.arctan2(z[..., 1], z[..., 0])], axis=-1)


def bank_with(treatment, sensor=None, **options):
    """Two unlike modes, both treated where the treatment fits their components."""
    items = treatment if isinstance(treatment, tuple) else (treatment,)
    fits = treatment is not None and not any(isinstance(item, Uncertain) for item in items)
    modes = (
        Mode("straight", constant_velocity(2, acceleration_density=1.0), treatment),
        Mode("turn", coordinated_turn(rate_density=0.1), treatment if fits else None),
    )
    chain = MarkovChain.from_sojourns([4.0, 4.0])
    return Bank(modes, sensor or position(2, 1.0), chain=chain, **{"interaction": "birth", **options})


def single(motion, sensor, treatment):
    return BankEstimator(Bank((Mode("m", motion, treatment),), sensor))


def one_update(estimator, mean, cov, z):
    """Estimates after one prediction and update from a posterior (mean, cov)."""
    prior = Prior([np.array(mean)], [np.array(cov)], time=0.0, includes_first=True)
    nothing = np.full(len(np.atleast_1d(z)), np.nan)
    return estimator.run([nothing, np.atleast_1d(z)], [0.0, 1.0], prior=prior)


# --- Student-t


def t_case(**options):
    motion = given_motion([[1, 1], [0, 1]], [[0.25, 0.5], [0.5, 1.0]])
    estimator = single(motion, given_sensor([[1, 0]], [1.0]), HeavyTails(5.0, **options))
    cov = 5.0 / 3.0 * np.array([[4.0, 1.0], [1.0, 2.0]])
    return one_update(estimator, [0.0, 1.0], cov, 6.0)


def test_student_t_step_has_the_frozen_values():
    out = t_case()
    np.testing.assert_allclose([out.position[0, 1, 0], out.velocity[0, 1, 0]], [5.459459, 2.891892], atol=1e-6)
    np.testing.assert_allclose(
        out.covariance[0, 1] * 3.0 / 5.0, [[1.030497, 0.437180], [0.437180, 1.936085]], atol=1e-6
    )
    assert out.log_likelihood[0, 1] == pytest.approx(-3.377331, abs=1e-6)
    assert out.log_likelihood[0, 1] == pytest.approx(multivariate_t([1.0], [[9.25]], df=5).logpdf([6.0]), abs=1e-12)


def test_the_other_reset_scales_the_covariance_by_its_own_factor():
    moments, divergence = t_case(), t_case(reset="divergence")
    share = reset_by_divergence(5.0, 1, 2) / reset_by_moments(5.0, 1)
    np.testing.assert_allclose(divergence.covariance[0, 1], share * moments.covariance[0, 1], rtol=1e-12)


def test_covariance_matrices_are_scale_matrices_divided_by_their_spread():
    motion = given_motion([[1, 1], [0, 1]], 5.0 / 3.0 * np.array([[0.25, 0.5], [0.5, 1.0]]))
    sensor = given_sensor([[1, 0]], [math.sqrt(5.0 / 3.0)])
    other = one_update(
        single(motion, sensor, HeavyTails(5.0, matrices="covariance")), [0.0, 1.0],
        5.0 / 3.0 * np.array([[4.0, 1.0], [1.0, 2.0]]), 6.0,
    )  # fmt: skip
    np.testing.assert_allclose(other.covariance, t_case().covariance, rtol=1e-12)
    assert other.log_likelihood[0, 1] == pytest.approx(t_case().log_likelihood[0, 1], abs=1e-12)


@pytest.mark.parametrize(
    ("n", "risen", "dof", "moments", "divergence"),
    [
        (4, 7, 5, 0.840, 0.939),
        (4, 5, 3, 0.556, 0.892),
        (2, 7, 5, 0.840, 0.923),
        (6, 8, 5, 0.8, 0.934),
        (4, 6, 4, 0.75, 0.92),
    ],
)
def test_dof_resets_have_the_frozen_values(n, risen, dof, moments, divergence):
    assert reset_by_moments(dof, risen - dof) == pytest.approx(moments, abs=5e-4)
    assert reset_by_divergence(dof, risen - dof, n) == pytest.approx(divergence, abs=6e-4)  # 0.8915 is printed 0.892


@pytest.mark.parametrize(("mix_factor", "factor"), [("exact", 1.0), ("plain", 5.0 / 3.0)])
def test_student_t_mixture_has_the_frozen_moments(mix_factor, factor):
    still = given_motion(np.eye(2), np.zeros((2, 2)))
    tails = HeavyTails(5.0, mix_factor=mix_factor)
    modes = tuple(Mode(name, still, tails) for name in "ab")
    # Row sums of the chain give both modes the prior (.3, .7) of the two states.
    chain = MarkovChain.per_step([[0.5, 0.5], [0.5, 0.5]])
    bank = Bank(modes, given_sensor([[1, 0]], [1.0]), chain=chain, min_prob=0.0)
    means, covs = [np.zeros(2), np.array([2.0, 1.0])], [5 / 3 * np.eye(2), 5 / 3 * 2.0 * np.eye(2)]
    prior = Prior(means, covs, time=0.0, includes_first=True, mode_probs=(0.3, 0.7))
    out = BankEstimator(bank).run([[np.nan], [np.nan]], [0.0, 1.0], prior=prior)
    np.testing.assert_allclose([out.position[0, 1, 0], out.velocity[0, 1, 0]], [1.4, 0.7], atol=1e-12)
    spread = np.array([[0.84, 0.42], [0.42, 0.21]])
    expected = np.array([[2.204, 0.252], [0.252, 1.826]]) * 5 / 3 + (factor - 1.0) * spread
    np.testing.assert_allclose(out.covariance[0, 1], expected, atol=1e-9)


@pytest.mark.parametrize("sensor", [position(2, 1.0), range_bearing((1.0, 0.02))])
def test_a_million_degrees_of_freedom_are_gaussian(sensor):
    z, times = flight()
    z = seen_by(sensor, z)
    plain = BankEstimator(bank_with(None, sensor)).run(z, times)
    tails = BankEstimator(bank_with(HeavyTails(1e6, matrices="covariance"), sensor)).run(z, times)
    endless = BankEstimator(bank_with(HeavyTails(math.inf), sensor)).run(z, times)
    # Densities differ by about D^4 / (4 nu) and covariances by D^2 / nu: 1e-5 for ordinary measurements.
    np.testing.assert_allclose(tails.position[:, :12], plain.position[:, :12], rtol=0, atol=1e-4)
    farther = BankEstimator(bank_with(HeavyTails(1e9, matrices="covariance"), sensor)).run(z, times)
    np.testing.assert_allclose(farther.position[:, :12], plain.position[:, :12], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(endless.position, plain.position)


# --- model error


def b5(M=((0.0198,), (0.0,)), E=((0.0, 5.0),)):
    F, Q = [[0.9802, 0.0196], [0.0, 0.9802]], [[1.9608, 0.0195], [0.0195, 1.9605]]
    return single(given_motion(F, Q), given_sensor([[1, -1]], [1.0]), Uncertain(M, E))


def settled(estimator, rows=400):
    prior = Prior([np.zeros(2)], [np.eye(2)], time=0.0, includes_first=True)
    z = np.zeros((rows, 1))
    out = estimator.run(z, np.arange(rows), prior=prior)
    last = one_update(estimator, [0.0, 0.0], out.covariance[0, -1], 1.0)
    return out, last


def test_sayed_filter_settles_at_the_frozen_gain():
    _, last = settled(b5())
    gain = [last.position[0, 1, 0], last.velocity[0, 1, 0]]
    np.testing.assert_allclose(gain, [0.499346, -0.426742], atol=1e-6)


@pytest.mark.parametrize("quiet", [{"M": ((0.0,), (0.0,))}, {"E": ((0.0, 0.0),)}])
def test_no_model_error_is_the_kalman_filter(quiet):
    out, last = settled(b5(**quiet), rows=2000)
    np.testing.assert_allclose(out.covariance[0, -1], [[41.832422, 41.25081], [41.25081, 41.493159]], atol=2e-6)
    gain = [last.position[0, 1, 0], last.velocity[0, 1, 0]]
    np.testing.assert_allclose(gain, [0.581613, -0.242349], atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("driven", [False, True])
def test_an_uncertain_mode_is_the_robust_filter(seed, driven):
    rng = np.random.default_rng(seed)
    F = np.eye(2) + 0.3 * rng.normal(size=(2, 2))
    Q, P = np.eye(2) + 0.2, 2.0 * np.eye(2) + 0.3
    H, M, E_f = rng.normal(size=(2, 2)), 0.3 * rng.normal(size=(2, 3)), rng.normal(size=(2, 2))
    E_g = rng.normal(size=(2, 2)) if driven else np.zeros((2, 2))
    mean, z = rng.normal(size=2), rng.normal(size=2)
    peer = RobustFilter(F, H, Q, np.eye(2), M, E_f, noise_excitation=E_g).step_filtered(mean, P, z)
    treatment = Uncertain(M.tolist(), E_f.tolist(), E_g.tolist())
    out = one_update(single(given_motion(F, Q), given_sensor(H, [1.0, 1.0]), treatment), mean, P, z)
    np.testing.assert_allclose([out.position[0, 1, 0], out.velocity[0, 1, 0]], peer.mean, atol=1e-10)
    np.testing.assert_allclose(out.covariance[0, 1], peer.cov, atol=1e-10)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("driven", [False, True])
def test_an_optimal_regulation_is_that_of_the_robust_filter(seed, driven):
    rng = np.random.default_rng(seed)
    F = np.eye(2) + 0.3 * rng.normal(size=(2, 2))
    Q, P = np.eye(2) + 0.2, 2.0 * np.eye(2) + 0.3
    H, M, E_f = rng.normal(size=(2, 2)), 0.3 * rng.normal(size=(2, 3)), rng.normal(size=(2, 2))
    E_g = rng.normal(size=(2, 2)) if driven else np.zeros((2, 2))
    mean, z = 3.0 * rng.normal(size=2), 3.0 * rng.normal(size=2)
    given = (F, H, Q, np.eye(2), M, E_f)
    peer = RobustFilter(*given, noise_excitation=E_g, optimise=True).step_filtered(mean, P, z)
    treatment = Uncertain(M.tolist(), E_f.tolist(), E_g.tolist(), optimise=True)
    for points in (False, True):
        bank = Bank((Mode("m", given_motion(F, Q), treatment),), given_sensor(H, [1.0, 1.0]), every_sigma_point=points)
        out = one_update(BankEstimator(bank), mean, P, z)
        np.testing.assert_allclose([out.position[0, 1, 0], out.velocity[0, 1, 0]], peer.mean, atol=1e-9)
        np.testing.assert_allclose(out.covariance[0, 1], peer.cov, atol=1e-9)
    bound = RobustFilter(*given, noise_excitation=E_g).step_filtered(mean, P, z)
    assert np.abs(bound.mean - peer.mean).max() > 1e-6


def test_sigma_points_linearise_a_linear_model_error_exactly():
    z, times = flight()
    for treatment in (EVERY["uncertain"], EVERY["uncertain-adaptive-level"], EVERY["uncertain-optimal"]):
        mode = Mode("cv", constant_velocity(2), treatment)
        exact = Bank((mode,), position(2, 1.0))
        points = BankEstimator(exact.with_(every_sigma_point=True)).run(z, times)
        np.testing.assert_allclose(points.position, BankEstimator(exact).run(z, times).position, atol=1e-7)


# --- adaptive noise


@pytest.mark.parametrize("name", FACTORS)
@pytest.mark.parametrize("innovation", [(3.0, 4.0), (3.5, 0.0), (3.0, 0.0)])
def test_an_adaptive_mode_updates_with_the_noise_of_its_factor(name, innovation):
    # Prior position variance 1, no motion: H P H' = R = I as in the frozen table of factors.
    v = np.array(innovation)
    prior = Prior(np.zeros(4), np.eye(4))
    estimator = single(constant_velocity(2), position(2, 1.0), Adaptive(name, "adapted"))
    out = estimator.run([v], [0.0], prior=prior)
    R = FACTORS[name].adapt(v, np.eye(2), np.eye(2))
    np.testing.assert_allclose(out.position[0, 0], np.linalg.solve(np.eye(2) + R, v), atol=1e-9)
    S = np.eye(2) + R
    expected = -0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * np.pi * S)[1])
    assert out.log_likelihood[0, 0] == pytest.approx(expected, rel=1e-9)
    for likelihood, dof in (("t", 3.0), ("nominal", 1e8)):
        other = single(constant_velocity(2), position(2, 1.0), Adaptive(name, likelihood)).run([v], [0.0], prior=prior)
        np.testing.assert_array_equal(other.position, out.position)
        expected = multivariate_t(np.zeros(2), 2.0 * np.eye(2), df=dof).logpdf(v)
        assert other.log_likelihood[0, 0] == pytest.approx(expected, abs=1e-5)


def test_a_cap_bounds_the_adapted_noise():
    v = np.array([300.0, 0.0])
    estimator = single(constant_velocity(2), position(2, 1.0), Adaptive("mr", cap=50.0))
    out = estimator.run([v], [0.0], prior=Prior(np.zeros(4), np.eye(4)))
    assert out.position[0, 0, 0] == pytest.approx(300.0 / 51.0, rel=1e-12)


def test_bounded_tails_reach_the_fixed_point_and_bound_the_pull():
    prior = Prior(np.zeros(4), np.eye(4))
    estimator = single(constant_velocity(2), position(2, 1.0), BoundedTails(3.0, 50))
    out = estimator.run([[5.0, 1.0]], [0.0], prior=prior)
    e = np.array([5.0, 1.0]) - out.position[0, 0]
    share = 5.0 / (3.0 + e @ e + np.trace(out.covariance[0, 0, :2, :2]))
    np.testing.assert_allclose(out.covariance[0, 0, :2, :2], np.eye(2) / (1.0 + share), rtol=1e-9)
    pulls = [abs(estimator.run([[far, 0.0]], [0.0], prior=prior).position[0, 0, 0]) for far in (10.0, 100.0, 1e4)]
    assert pulls[0] > pulls[1] > pulls[2]


def test_a_level_is_a_filter_with_that_noise():
    z, times = flight()
    level = BankEstimator(bank_with(Level(9.0))).run(z, times)
    scaled = BankEstimator(bank_with(None)).run(z, times, 9.0 * np.eye(2))
    for ours, theirs in zip(level, scaled, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)


def test_identical_levels_are_one_filter():
    z, times = flight()
    motion = constant_velocity(2)
    alone = single(motion, position(2, 1.0), Level(4.0)).run(z, times)
    modes = tuple(Mode(name, motion, Level(4.0), "cv") for name in "abc")
    chain = MarkovChain.from_sojourns([1.0, 2.0, 3.0])
    many = BankEstimator(Bank(modes, position(2, 1.0), chain=chain, interaction="birth")).run(z, times)
    np.testing.assert_allclose(many.position, alone.position, atol=1e-9)
    np.testing.assert_allclose(many.covariance, alone.covariance, atol=1e-9)
    np.testing.assert_allclose(many.log_likelihood, alone.log_likelihood, atol=1e-9)


# --- every treatment keeps the bank's contract


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("sensor", [position(2, 1.0), range_bearing((1.0, 0.02))], ids=["position", "range-bearing"])
def test_streaming_equals_batch_bit_for_bit(name, sensor):
    estimator = BankEstimator(bank_with(EVERY[name], sensor))
    z, times = flight()
    z = seen_by(sensor, z)
    batch = estimator.run(z, times)
    assert np.isfinite(batch.position).all()
    assert np.linalg.eigvalsh(batch.covariance).min() > -1e-9
    for b in range(len(z)):
        state = estimator.start(z[b, 0], times[0])
        for t in range(1, ROWS):
            state, now = estimator.step(state, z[b, t], times[t])
            np.testing.assert_array_equal(now.position, batch.position[b, t])
            np.testing.assert_array_equal(now.covariance, batch.covariance[b, t])
            np.testing.assert_array_equal(now.mode_probs, batch.mode_probs[b, t])


@pytest.mark.parametrize("name", EVERY)
def test_missing_components_are_left_out(name):
    """A row of which one component is there is a row of a sensor that has that one only."""
    prior = Prior(np.zeros(4), np.diag([4.0, 1.0, 9.0, 1.0]))
    estimator = single(constant_velocity(2), position(2, 1.0), EVERY[name])
    partial = estimator.run([[2.5, np.nan], [np.nan, np.nan], [3.0, np.nan]], [0.0, 1.0, 2.0], prior=prior)
    huge = np.diag([1.0, 1e22])  # a component with boundless noise is as good as missing
    assert partial.nis_dof[0].tolist() == [1, 0, 1]
    assert partial.status[0, 1] == 2
    assert np.isfinite(partial.position).all()
    if isinstance(EVERY[name], Level):
        whole = estimator.run([[2.5, 0.0]], [0.0], huge, prior=prior)
        np.testing.assert_allclose(partial.position[0, 0], whole.position[0, 0], atol=1e-9)


def test_treated_and_untreated_modes_share_a_bank():
    z, times = flight()
    motion = constant_acceleration(2)
    modes = (Mode("a", motion), Mode("b", motion, Adaptive("huber")), Mode("c", motion, HeavyTails(3.0)))
    chain = MarkovChain.from_sojourns([3.0] * 3)
    alone = single(motion, position(2, 1.0), None).run(z, times)
    bank = Bank(
        modes,
        position(2, 1.0),
        chain=MarkovChain.per_step(np.eye(3)),
        interaction="none",
        initial_probs=(1.0, 0.0, 0.0),
    )
    first = BankEstimator(bank).run(z, times)
    np.testing.assert_array_equal(first.position, alone.position)
    mixed = BankEstimator(Bank(modes, position(2, 1.0), chain=chain)).run(z, times)
    assert np.isfinite(mixed.position).all()
    assert not np.allclose(mixed.position, alone.position)


def test_forecast_and_smoother_take_treated_modes():
    z, times = flight()
    for name in ("level", "heavy-tails", "uncertain"):
        estimator = BankEstimator(bank_with(EVERY[name]))
        smoothed = estimator.smooth(z, times)
        assert np.isfinite(smoothed.position).all()
        state = estimator.start(z[0, 0], times[0])
        mean, cov = estimator.forecast(state, 1.0)
        assert np.isfinite(mean).all()
        assert np.linalg.eigvalsh(cov).min() > 0


CODE = """
import numpy as np
from test_treatments import EVERY, bank_with, flight
from jink.estimators.api import BankEstimator
z, times = flight(tracks=1)
rows = 14
for name in ("adaptive-mahalanobis", "bounded-tails", "heavy-tails-unequal", "uncertain-adaptive-level"):
    out = BankEstimator(bank_with(EVERY[name])).run(z[:, :rows], times[:rows])
    print(" ".join(f"{value:.10g}" for value in (*out.position[0, -1], out.log_likelihood[0, -1])))
"""


def test_plain_python_agrees():
    """The kernels as ordinary Python give the same numbers (fused multiply-add aside)."""
    here = str(Path(__file__).parent)
    path = os.pathsep.join([here, *sys.path])
    found = []
    for disabled in ("0", "1"):
        environment = {**os.environ, "PYTHONPATH": path, "NUMBA_DISABLE_JIT": disabled}
        done = subprocess.run(
            [sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, check=True, cwd=here
        )
        found.append(np.array([[float(value) for value in line.split()] for line in done.stdout.splitlines()]))
    assert found[0].shape == (4, 3)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-8)


# --- errors


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Level(0.0), "Level: scale must be a number > 0"),
        (lambda: Adaptive("hubert"), "name must be one of none, mr"),
        (lambda: Adaptive(likelihood="x"), "Adaptive: likelihood must be one of nominal, adapted, t"),
        (lambda: Adaptive(cap=0.5), "Adaptive: cap must be a number > 1 and at most 1e+09"),
        (lambda: BoundedTails(iterations=0), "BoundedTails: iterations must be an integer"),
        (lambda: HeavyTails(2.0), "HeavyTails: dof must be a number > 2"),
        (lambda: HeavyTails(5.0, noise_dof=1.0), "HeavyTails: noise_dof must be a number > 2"),
        (lambda: HeavyTails(reset="kl"), "HeavyTails: reset must be one of moments, divergence"),
        (lambda: Uncertain(((1.0,),), ((1.0, 2.0),)), "noise_excitation must have shapes"),
        (lambda: Uncertain(((np.nan,),), ((1.0,),)), "Uncertain: error must be a finite matrix"),
        (lambda: Uncertain(ERROR, EXCITED, alpha=0.0), "Uncertain: alpha must be a number > 0"),
        (lambda: Level(None), "Level: scale must be a number > 0 and finite; got None"),
        (lambda: Level("4"), "Level: scale must be a number"),
        (lambda: Level(True), "Level: scale must be a number"),
        (lambda: Adaptive(cap=1e10), "Adaptive: cap must be a number > 1 and at most 1e+09; got 10000000000.0"),
        (lambda: Adaptive(dof=[3.0, 4.0]), "Adaptive: dof must be a number"),
        (lambda: Adaptive(likelihood=["t"]), "Adaptive: likelihood must be one of"),
        (lambda: Adaptive("huber", probabilities=0.9), "make_factor: probabilities of huber must have 1 entries"),
        (lambda: Adaptive("huber", probabilities=("x",)), "Factor: probabilities must be at most two"),
        (lambda: HeavyTails("x"), "HeavyTails: dof must be a number"),
        (lambda: HeavyTails(math.nan), "HeavyTails: dof must be a number > 2"),
        (lambda: HeavyTails(matrices=["scale"]), "HeavyTails: matrices must be one of"),
        (lambda: BoundedTails(None), "BoundedTails: dof must be a number"),
        (lambda: BoundedTails(iterations=math.nan), "BoundedTails: iterations must be an integer"),
        (lambda: BoundedTails(iterations="4"), "BoundedTails: iterations must be an integer"),
        (lambda: BoundedTails(iterations=True), "BoundedTails: iterations must be an integer"),
        (lambda: Uncertain(ERROR, EXCITED, alpha=None), "Uncertain: alpha must be a number"),
        (lambda: Uncertain(ERROR, EXCITED, optimise="yes"), "Uncertain: optimise must be True or False; got 'yes'"),
        (lambda: Mode("m", constant_velocity(2), (Adaptive(), HeavyTails())), "Mode: treatment of m must be one of"),
        (lambda: Mode("m", constant_velocity(2), "huber"), "Mode: treatment of m must be one of"),
        (lambda: Mode("m", constant_velocity(3), Uncertain(ERROR, EXCITED)), "must have error with 6 rows"),
    ],
)  # fmt: skip
def test_errors_are_one_sentence_and_a_remedy(make, sentence):
    with pytest.raises(ValueError, match="got") as error:
        make()
    assert sentence in str(error.value)
