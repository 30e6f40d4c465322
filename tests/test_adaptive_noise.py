"""Filters that learn their noise: against plain transcriptions, on known noise, and at their limits."""

import pickle
import re

import numpy as np
import pytest

from jink.estimators.adaptive_cycle import LEARNT, WEIGHT
from jink.estimators.adaptive_estimator import METHODS, AdaptiveEstimator, NoiseAdaptation
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.factors import FACTORS
from jink.estimators.inputs import Prior
from jink.estimators.motions import constant_acceleration, constant_velocity, coordinated_turn
from jink.estimators.recipes import ADAPTATIONS, make_estimator
from jink.estimators.sensors import position, range_bearing
from jink.estimators.status import DIVERGED, MISSING, OK, REPAIRED
from jink.estimators.treatments import Adaptive

Q_DENSITY = 0.1
PEER = {"rtol": 1e-10, "atol": 1e-10}
BROAD = Prior(np.zeros(4), 100.0 * np.eye(4))
both = pytest.mark.parametrize("method", METHODS)


def bank(sigma=1.0, density=Q_DENSITY, axes=2):
    motion = constant_velocity(axes, acceleration_density=density)
    return Bank((Mode("cv", motion),), position(axes, sigma))


def adaptive(method="sage-husa", sigma=1.0, axes=2, density=Q_DENSITY, **options):
    return AdaptiveEstimator(bank(sigma, density, axes), NoiseAdaptation(method=method, **options))


def models(dt, axes, density=Q_DENSITY):
    F = np.kron([[1.0, dt], [0.0, 1.0]], np.eye(axes))
    return F, density * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(axes))


def world(seed, tracks, rows, R, density=Q_DENSITY):
    """Constant velocity at 1 s, start as `BROAD` says, noise R (2, 2) or (T, 2, 2); truth (B, T, 4) and positions."""
    rng = np.random.default_rng(seed)
    F, Q = models(1.0, 2, density)
    root, x = np.linalg.cholesky(Q), 10.0 * rng.normal(size=(tracks, 4))
    truth = np.empty((tracks, rows, 4))
    for t in range(rows):
        if t > 0:
            x = x @ F.T + rng.normal(size=(tracks, 4)) @ root.T
        truth[:, t] = x
    noise = np.linalg.cholesky(np.broadcast_to(R, (rows, 2, 2)))
    return truth, truth[..., :2] + np.einsum("tij,btj->bti", noise, rng.normal(size=(tracks, rows, 2)))


def nees(estimates, truth):
    error = np.concatenate([estimates.position, estimates.velocity], axis=-1) - truth
    return np.einsum("bti,btij,btj->bt", error, np.linalg.inv(estimates.covariance), error)


def clipped(R, given, floor):
    """R with the eigenvalues of its ratio to ``given`` at least ``floor``."""
    L = np.linalg.cholesky(given)
    values, vectors = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, R).T))
    return L @ vectors @ np.diag(np.maximum(values, floor)) @ vectors.T @ L.T


def plain_sage_husa(z, times, given, forgetting, floor, axes):
    H, R = np.eye(axes, 2 * axes), given.copy()
    m, P, last, out = np.zeros(2 * axes), 100.0 * np.eye(2 * axes), times[0], []
    for k, (row, now) in enumerate(zip(z, times, strict=True)):
        F, Q = models(now - last, axes)
        last, m, P = now, F @ m, F @ P @ F.T + Q
        e = row - H @ m
        d = (1 - forgetting) / (1 - forgetting ** (k + 1))
        R = clipped((1 - d) * R + d * (np.outer(e, e) - H @ P @ H.T), given, floor)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        m, P = m + K @ e, P - K @ H @ P
        out.append((m, P, R))
    return [np.array(column) for column in zip(*out, strict=True)]


def plain_variational(z, times, given, forgetting, iterations, weight, axes):
    """Sarkka & Hartikainen (2013) with parameters nu, V of the inverse Wishart."""
    H = np.eye(axes, 2 * axes)
    nu, V = weight + axes + 1, weight * given
    m, P, last, out = np.zeros(2 * axes), 100.0 * np.eye(2 * axes), times[0], []
    for row, now in zip(z, times, strict=True):
        F, Q = models(now - last, axes)
        last, m0, P0 = now, F @ m, F @ P @ F.T + Q
        nu, V0 = 1 + forgetting * (nu - axes - 1) + axes + 1, forgetting * V
        V = V0
        for _ in range(iterations):
            R = V / (nu - axes - 1)
            K = P0 @ H.T @ np.linalg.inv(H @ P0 @ H.T + R)
            m, P = m0 + K @ (row - H @ m0), P0 - K @ H @ P0
            V = V0 + np.outer(row - H @ m, row - H @ m) + H @ P @ H.T
        out.append((m, P, V / (nu - axes - 1)))
    return [np.array(column) for column in zip(*out, strict=True)]


def plain_variational_scalar(z, times, given, forgetting, iterations, weight):
    """Sarkka & Nummenmaa (2009) with parameters alpha, beta of one inverse gamma."""
    H, alpha, beta = np.eye(1, 2), weight / 2, weight / 2 * given[0, 0]
    m, P, last, out = np.zeros(2), 100.0 * np.eye(2), times[0], []
    for row, now in zip(z[:, 0], times, strict=True):
        F, Q = models(now - last, 1)
        last, m0, P0 = now, F @ m, F @ P @ F.T + Q
        alpha, beta0 = forgetting * alpha + 0.5, forgetting * beta
        beta = beta0
        for _ in range(iterations):
            S = P0[0, 0] + beta / alpha
            m, P = m0 + P0[:, 0] * (row - m0[0]) / S, P0 - np.outer(P0[:, 0], H @ P0) / S
            beta = beta0 + 0.5 * (row - m[0]) ** 2 + 0.5 * P[0, 0]
        out.append((m, P, np.array([[beta / alpha]])))
    return [np.array(column) for column in zip(*out, strict=True)]


def recorded(axes, seed=3, rows=60):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(axes, axes))
    times = np.cumsum(rng.uniform(0.2, 1.5, rows))
    scale = np.where((np.arange(rows) > 20) & (np.arange(rows) < 40), 6.0, 1.0)[:, None]
    return np.cumsum(rng.normal(size=(rows, axes)), axis=0) * 2 + scale * rng.normal(size=(rows, axes)), times, (
        root @ root.T + np.eye(axes)
    )  # fmt: skip


def compared(est, z, times, given, axes, mean, cov, R):
    prior = Prior(np.zeros(2 * axes), 100.0 * np.eye(2 * axes))
    run = est.run(z, times, given, prior=prior)
    np.testing.assert_allclose(np.hstack([run.position[0], run.velocity[0]]), mean, **PEER)
    np.testing.assert_allclose(run.covariance[0], cov, **PEER)
    np.testing.assert_allclose(est.noise_run(z, times, given, prior=prior)[0][0], R, **PEER)


@pytest.mark.parametrize("axes", [1, 2])
def test_sage_husa_is_its_transcription(axes):
    z, times, given = recorded(axes)
    est = adaptive(axes=axes, forgetting=0.93, start_weight=0.0, floor=0.05, ceiling=1e12)
    compared(est, z, times, given, axes, *plain_sage_husa(z, times, given, 0.93, 0.05, axes))


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("iterations", [1, 4])
def test_variational_is_its_transcription(axes, iterations):
    z, times, given = recorded(axes)
    est = adaptive("variational", axes=axes, forgetting=0.9, start_weight=7.0, iterations=iterations, floor=1e-9)
    compared(est, z, times, given, axes, *plain_variational(z, times, given, 0.9, iterations, 7.0, axes))


def test_variational_in_one_dimension_is_the_first_paper():
    z, times, given = recorded(1)
    est = adaptive("variational", axes=1, forgetting=0.9, start_weight=7.0, iterations=3, floor=1e-9)
    compared(est, z, times, given, 1, *plain_variational_scalar(z, times, given, 0.9, 3, 7.0))


@both
@pytest.mark.parametrize("sigma", [0.7, 3.0])
def test_a_constant_noise_is_found(method, sigma):
    # 300 tracks, memory of 50: the mean of the estimates scatters by 0.8 %, and each method leans by up to 5 %, as the
    # noise learnt decides the gain that the next innovation is judged with. A start 10 % off by itself would fail.
    R = np.array([[4.0, 1.0], [1.0, 2.0]])
    truth, z = world(1, 300, 500, R)
    est = adaptive(method, sigma, forgetting=0.98, floor=0.05)
    learnt = est.noise_run(z, np.arange(500.0), prior=BROAD)[0][:, -1].mean(axis=0)
    np.testing.assert_allclose(learnt[[0, 1], [0, 1]], [4.0, 2.0], rtol=0.08)
    assert abs(learnt[0, 1] - 1.0) < 0.1
    # Sum over 300 tracks of NEES with 4 degrees of freedom: sd of the mean 0.16; a noise known to 14 % costs 5 %.
    run = est.run(z, np.arange(500.0), prior=BROAD)
    assert 3.4 < nees(run, truth)[:, -1].mean() < 4.9
    plain = nees(BankEstimator(bank(sigma)).run(z, np.arange(500.0), prior=BROAD), truth)[:, -1].mean()
    assert not 3.4 < plain < 4.9


@both
def test_a_step_of_the_noise_is_followed_within_the_memory(method):
    rows = np.arange(300)
    scale = np.where((rows >= 100) & (rows < 200), 100.0, 1.0)
    _, z = world(2, 200, 300, scale[:, None, None] * np.eye(2))
    noise = adaptive(method, forgetting=0.9).noise_run(z, rows.astype(float), prior=BROAD)[0]
    R = noise[..., [0, 1], [0, 1]].mean(axis=(0, 2))
    assert 0.8 < R[99] < 1.5
    assert 50.0 < R[109] < 80.0  # one memory: 1 - exp(-1) of the way
    assert 85.0 < R[139] < 120.0  # four: there
    assert R[239] < 15.0
    assert R[299] < 2.0


def test_memory_is_what_forgetting_says():
    est = adaptive(forgetting=0.9, start_weight=0.0)
    state = est.start(np.zeros(2), 0.0, prior=BROAD)
    weights = [state.nis_average[0, LEARNT + WEIGHT]]
    for t in range(1, 4):
        state, _ = est.step(state, np.zeros(2), float(t))
        weights.append(state.nis_average[0, LEARNT + WEIGHT])
    np.testing.assert_allclose(weights, [1.0, 1.9, 2.71, 3.439], rtol=1e-14)


@both
def test_bounds_hold_whatever_is_measured(method):
    given = np.array([[2.0, 0.5], [0.5, 1.0]])
    line = np.stack([np.arange(80.0), 2.0 * np.arange(80.0)], axis=1)
    wild = line + 1e5 * np.random.default_rng(0).normal(size=line.shape)
    L = np.linalg.cholesky(given)
    reached = []
    for z in (line, wild):
        est = adaptive(method, forgetting=0.8, floor=0.2, ceiling=50.0)
        run = est.run(z, np.arange(80.0), given, prior=BROAD)
        noise, _ = est.noise_run(z, np.arange(80.0), given, prior=BROAD)
        values = np.linalg.eigvalsh(np.linalg.solve(L, np.swapaxes(np.linalg.solve(L, noise[0]), 1, 2)))
        assert values.min() > 0.2 * (1 - 1e-9)
        assert values.max() < 50.0 * (1 + 1e-9)
        reached.append((values.min(), values.max()))
        assert np.linalg.eigvalsh(run.covariance).min() > 0.0
    assert reached[0][0] == pytest.approx(0.2, rel=1e-9)
    assert reached[1][1] == pytest.approx(50.0, rel=1e-9)


def scene(seed=5, rows=40):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.3, 1.4, rows))
    ship = np.zeros((rows, 4))
    ship[:, 0] = -5.0 * times
    target = np.stack([200.0 + 8.0 * times, 100.0 - 3.0 * times], axis=1)
    gap = target - ship[:, :2]
    z = np.stack([np.hypot(*gap.T), np.arctan2(gap[:, 1], gap[:, 0])], axis=1) + rng.normal(size=(rows, 2)) * [
        3.0,
        0.02,
    ]
    z[7], z[11, 1], z[19:22, 0] = np.nan, np.nan, np.nan
    return z, times, ship


CURVED = {
    "turn, moving radar": (coordinated_turn(acceleration_density=0.5, rate_density=1e-4, rate_sd=0.1), True),
    "acceleration, moving radar": (constant_acceleration(2, jerk_density=0.1, acceleration_sd=1.0), True),
    "turn, position": (coordinated_turn(acceleration_density=0.5, rate_density=1e-4, rate_sd=0.1), False),
}


def curved(kind):
    motion, radar = CURVED[kind]
    z, times, ship = scene()
    sensor = range_bearing((3.0, 0.02)) if radar else position(2, 3.0)
    if not radar:
        z = np.stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0]], axis=1)
    return Bank((Mode("only", motion),), sensor), z, times, ship if radar else None


@both
@pytest.mark.parametrize("kind", CURVED)
def test_never_forgetting_and_a_full_start_is_the_plain_filter(method, kind):
    one, z, times, ship = curved(kind)
    plain = BankEstimator(one).run(z, times, sensor_states=ship)
    learning = AdaptiveEstimator(one, NoiseAdaptation(method=method, forgetting=1.0)).run(z, times, sensor_states=ship)
    for left, right in zip(plain, learning, strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", CURVED)
@pytest.mark.parametrize(
    "adaptation",
    [NoiseAdaptation(), NoiseAdaptation("sage-husa"), NoiseAdaptation("sage-husa", process=True)],
    ids=["variational", "sage-husa", "process"],
)
def test_one_row_at_a_time_is_the_run_bit_for_bit(kind, adaptation):
    one, z, times, ship = curved(kind)
    est = AdaptiveEstimator(one, adaptation)
    R = one.sensor.noise * np.random.default_rng(9).uniform(0.5, 2.0, (len(z), 1, 1))
    run = est.run(z, times, R, ship)
    noise, factor = est.noise_run(z, times, R, ship)
    first = 1 if ship is not None else 2
    here = slice(None, first)
    state = est.start(z[here], times[here], R[here], None if ship is None else ship[here])
    for t in range(first, len(z)):
        before = pickle.dumps(state)
        following, row = est.step(state, z[t], times[t], R[t], None if ship is None else ship[t])
        assert pickle.dumps(state) == before
        state = following
        for field, value in row._asdict().items():
            np.testing.assert_array_equal(value, getattr(run, field)[0, t], err_msg=field)
        np.testing.assert_array_equal(est.measurement_noise(state, R[t]), noise[0, t])
    assert (factor != 1.0).any() == adaptation.process
    assert np.ptp(noise[0, :, 0, 0] / R[:, 0, 0]) > 0.1


@both
def test_tracks_do_not_see_each_other(method):
    _, z = world(4, 5, 30, np.eye(2))
    z[2, 10] = 1e4
    est = adaptive(method)
    together = est.run(z, np.arange(30.0))
    for b in range(5):
        for left, right in zip(together, est.run(z[b], np.arange(30.0)), strict=True):
            np.testing.assert_array_equal(left[b], right[0])


@both
def test_missing_rows_teach_nothing(method):
    _, z = world(6, 1, 30, np.eye(2))
    z[0, 10:15] = np.nan
    est = adaptive(method)
    run = est.run(z, np.arange(30.0), prior=BROAD)
    noise, _ = est.noise_run(z, np.arange(30.0), prior=BROAD)
    assert (run.status[0, 10:15] == MISSING).all()
    np.testing.assert_array_equal(noise[0, 10:15], np.broadcast_to(noise[0, 9], (5, 2, 2)))
    assert not np.array_equal(noise[0, 15], noise[0, 9])
    short = est.run(z[0][~np.isnan(z[0, :, 0])], np.arange(30.0)[~np.isnan(z[0, :, 0])], prior=BROAD)
    np.testing.assert_allclose(run.position[0, -1], short.position[0, -1], rtol=1e-9)


@both
def test_a_component_that_is_missing_learns_by_correlation_alone(method):
    z = np.stack([np.random.default_rng(7).normal(size=40) * 5.0, np.full(40, np.nan)], axis=1)
    times = np.arange(40.0)
    alone, _ = adaptive(method).noise_run(z, times, np.eye(2), prior=BROAD)
    assert alone[0, -1, 0, 0] > 5.0
    np.testing.assert_array_equal(alone[0, :, 1], np.broadcast_to([0.0, 1.0], (40, 2)))
    # A start that is correlated in units of R, after which only the first component is seen.
    est = adaptive(method)
    state = est.start(np.zeros(2), 0.0, prior=Prior(np.zeros(4), 0.01 * np.eye(4)))
    A = np.array([[2.0, 0.8], [0.8, 1.0]])
    state.nis_average[0, LEARNT + 2 :] = A.ravel()
    following, _ = est.step(state, np.array([9.0, np.nan]), 1.0)
    after = est.measurement_noise(following)
    slope = A[0, 1] / A[0, 0]
    assert after[0, 0] > 2.1
    np.testing.assert_allclose(after[0, 1], slope * after[0, 0], rtol=1e-12)
    np.testing.assert_allclose(after[1, 1], 1.0 + slope**2 * (after[0, 0] - 2.0), rtol=1e-12)


@both
def test_a_noise_that_changes_from_row_to_row_keeps_its_meaning(method):
    given = np.where(np.arange(400) % 2, 9.0, 1.0)[:, None, None] * np.eye(2)
    _, z = world(8, 100, 400, 4.0 * given)  # every row four times as noisy as it says
    noise, _ = adaptive(method, forgetting=0.98).noise_run(z, np.arange(400.0), given, prior=BROAD)
    ratio = noise[:, -2:, [0, 1], [0, 1]].mean(axis=(0, 2)) / given[-2:, 0, 0]
    np.testing.assert_allclose(ratio, 4.0, rtol=0.08)
    assert ratio[0] == pytest.approx(ratio[1], rel=0.05)


def test_the_process_noise_alone_is_found():
    # Median over 200 tracks of a factor that scatters by 30 %: sd 3 %.
    for truth in (1.0, 25.0):
        _, z = world(9, 200, 300, np.eye(2), density=truth * Q_DENSITY)
        est = adaptive(forgetting=0.95, measurement=False, process=True)
        noise, factor = est.noise_run(z, np.arange(300.0), prior=BROAD)
        assert np.median(factor[:, -1]) == pytest.approx(truth, rel=0.15)
        np.testing.assert_array_equal(noise, np.broadcast_to(np.eye(2), noise.shape))


def test_a_forecast_knows_the_process_noise_learnt():
    _, z = world(10, 1, 60, np.eye(2), density=2.5)
    est = adaptive(forgetting=0.95, measurement=False, process=True)
    state = est.start(z[0], np.arange(60.0), prior=BROAD)
    factor = est.noise_run(z, np.arange(60.0), prior=BROAD)[1][0, -1]
    assert factor > 3.0
    F, Q = models(2.0, 2)
    ahead = F @ state.kin_cov[0] @ F.T + factor * Q
    mean, cov = est.forecast(state, 2.0)
    np.testing.assert_allclose(mean, (F @ state.kin_mean[0])[:2], rtol=1e-12)
    np.testing.assert_allclose(cov, ahead[:2, :2], rtol=1e-12)


@both
def test_outliers_of_any_size_are_reported_not_raised(method):
    truth, z = world(11, 1, 80, np.eye(2))
    for size in (1e4, 1e15, 1e29, np.inf):
        hit = z.copy()
        hit[0, 30] = size
        run = adaptive(method).run(hit, np.arange(80.0), prior=BROAD)
        for field in run:
            assert np.isfinite(field).all()
        assert np.linalg.eigvalsh(run.covariance).min() > 0.0
        assert run.status[0, 30] in ((REPAIRED, MISSING) if size == np.inf else (OK, REPAIRED, DIVERGED))
    R = np.broadcast_to(np.eye(2), (80, 2, 2)).copy()
    R[5], R[6, 0, 0], R[7] = np.nan, 1e-300, 1e29 * np.eye(2)
    R[8, 0, 1] = R[8, 1, 0] = 1.5
    run = adaptive(method).run(z, np.arange(80.0), R, prior=BROAD)
    assert all(np.isfinite(field).all() for field in run)
    assert (run.status[0, [5, 8]] == REPAIRED).all()
    still = adaptive(method).run(z, np.zeros(80), prior=BROAD)
    assert np.isfinite(still.covariance).all()


def test_surges_hurt_the_plain_filter_more():
    rows = np.arange(200)
    scale = np.where((rows % 100 > 40) & (rows % 100 < 70), 100.0, 1.0)
    truth, z = world(12, 60, 200, scale[:, None, None] * np.eye(2))

    def rms(est):
        run = est.run(z, rows.astype(float), prior=BROAD)
        return np.sqrt(((run.position - truth[..., :2]) ** 2).sum(axis=-1).mean())

    for method in METHODS:
        assert rms(adaptive(method)) < 0.85 * rms(BankEstimator(bank()))


def test_recipes_learn_and_travel():
    _, z = world(13, 1, 30, np.eye(2))
    for name, method in (("sage-husa", "sage-husa"), ("vb-noise", "variational")):
        est = make_estimator(name, position(2, 1.0), acceleration=0.3)
        assert isinstance(est, AdaptiveEstimator)
        assert est.adaptation == ADAPTATIONS[name] == NoiseAdaptation(method=method)
        copy = pickle.loads(pickle.dumps(est))
        for left, right in zip(est.run(z, np.arange(30.0)), copy.run(z, np.arange(30.0)), strict=True):
            np.testing.assert_array_equal(left, right)
        smooth = est.smooth(z, np.arange(30.0))
        assert np.trace(smooth.covariance[0, 10]) < np.trace(est.run(z, np.arange(30.0)).covariance[0, 10])


SENTENCE = re.compile(r"^\w+: .+ must .+; got .+\. [A-Z].+\.$", re.DOTALL)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"method": "guess"}, "method"),
        ({"method": ["x"]}, "method"),
        ({"forgetting": "x"}, "forgetting"),
        ({"forgetting": None}, "forgetting"),
        ({"start_weight": "x"}, "start_weight"),
        ({"floor": None}, "floor"),
        ({"ceiling": [1.0]}, "ceiling"),
        ({"iterations": np.nan}, "iterations"),
        ({"iterations": "5"}, "iterations"),
        ({"measurement": "no"}, "measurement"),
        ({"process": 1}, "process"),
        ({"forgetting": 0.0}, "forgetting"),
        ({"forgetting": 1.1}, "forgetting"),
        ({"forgetting": np.nan}, "forgetting"),
        ({"start_weight": -1.0}, "start_weight"),
        ({"floor": 0.0}, "floor"),
        ({"floor": 2.0}, "floor"),
        ({"ceiling": 0.5}, "ceiling"),
        ({"ceiling": np.inf}, "ceiling"),
        ({"iterations": 0}, "iterations"),
        ({"iterations": 2.5}, "iterations"),
        ({"process": True}, "measurement, process"),
        ({"measurement": False}, "measurement"),
    ],
)
def test_settings_out_of_range_are_named(options, word):
    with pytest.raises(ValueError, match=f"NoiseAdaptation: {word}") as caught:
        NoiseAdaptation(**options)
    assert SENTENCE.match(str(caught.value))


def test_what_is_not_offered_is_said_in_a_sentence():
    z, times = np.zeros((3, 2)), np.arange(3.0)
    learning = adaptive(process=True)
    state = learning.start(z, times)
    imm = make_estimator("imm", position(2, 1.0))
    cases = [
        (lambda: AdaptiveEstimator(imm.bank), "AdaptiveEstimator: bank"),
        (lambda: learning.smooth(z, times), "smooth: process"),
        (lambda: learning.forecast_run(z, times, 1.0), "forecast_run: process"),
        (lambda: adaptive().step(state, z[0], 4.0), "step: state"),
        (lambda: BankEstimator(bank()).step(state, z[0], 4.0), "step: state"),
        (lambda: learning.measurement_noise(imm.start(z, times)), "measurement_noise: state"),
        (lambda: learning.measurement_noise(state, -np.eye(2)), "measurement_noise: noise"),
        (lambda: learning.noise_run(z, times[:2]), "noise_run: times"),
    ]
    for call, words in cases:
        with pytest.raises(ValueError, match=words) as caught:
            call()
        assert SENTENCE.match(str(caught.value)), caught.value


def test_a_mode_with_a_treatment_of_its_own_is_refused():
    bank = Bank((Mode("cv", constant_velocity(2), Adaptive("mr")),), position(2, 1.0))
    with pytest.raises(ValueError, match="AdaptiveEstimator: bank must have a mode without treatment"):
        AdaptiveEstimator(bank)


@pytest.mark.parametrize("name", ["surge_probability", "noise_scale"])
def test_levels_are_not_read_from_a_learnt_noise(name):
    with pytest.raises(ValueError, match=f"{name}: bank must have noise levels"):
        getattr(make_estimator("sage-husa", position(2, 1.0)), name)(None)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [((3,), "factor must be a name"), ((FACTORS["mr"], "t", 3.0, 1e9, (0.2, 0.3)), "with the name")],
)
def test_adaptive_refuses_what_is_no_factor(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        Adaptive(*given)
