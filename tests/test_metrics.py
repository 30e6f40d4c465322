"""Metrics against hand-made numbers, naive loops and simulated chi-square laws."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

from jink.estimators import metrics, status

NAN = np.nan


class FakeEstimates(NamedTuple):
    """The output fields of an estimator, filled by hand."""

    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray
    mode_probs: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    nis_dof: np.ndarray
    status: np.ndarray


def two_tracks():
    """Errors 5, 0, 1 | 2, 12, 100; the last step of track 1 is padding, its second truth is unknown."""
    truth = np.zeros((2, 3, 2))
    estimate = np.array([[[3.0, 4.0], [0.0, 0.0], [0.0, 1.0]], [[2.0, 0.0], [12.0, 0.0], [100.0, 0.0]]])
    truth[1, 1] = (0.0, NAN)
    return estimate, truth, np.array([3, 2])


def test_errors_skip_unknown_truth_and_padding():
    estimate, truth, lengths = two_tracks()
    assert metrics.errors(estimate, truth, lengths) == pytest.approx(
        np.array([[5.0, 0.0, 1.0], [2.0, NAN, NAN]]), nan_ok=True
    )
    assert metrics.rmse(estimate, truth, lengths) == pytest.approx(np.sqrt((25 + 0 + 1 + 4) / 4))
    assert metrics.rmse_per_time(estimate, truth, lengths) == pytest.approx([np.sqrt(29 / 2), 0.0, 1.0])
    assert metrics.rmse_per_track(estimate, truth, lengths) == pytest.approx([np.sqrt(26 / 3), 2.0])
    assert metrics.peak_error(estimate, truth, lengths) == pytest.approx([5.0, 2.0])


def test_masks_and_phases():
    estimate, truth, lengths = two_tracks()
    phases = {"first": [True, False, False], "none": np.zeros((2, 3), bool), "late": [False, True, True]}
    got = metrics.phase_rmse(estimate, truth, phases, lengths)
    assert got == pytest.approx({"first": np.sqrt(29 / 2), "none": NAN, "late": np.sqrt(0.5)}, nan_ok=True)


def test_a_broken_estimate_is_an_infinite_error_not_a_gap():
    estimate, truth, lengths = two_tracks()
    estimate[0, 1, 0] = NAN
    assert metrics.rmse(estimate, truth, lengths) == np.inf
    estimate[1, 2] = NAN  # padding: not scored
    assert metrics.rmse_per_track(estimate, truth, lengths)[1] == 2.0
    assert metrics.peak_error(estimate, np.full_like(truth, NAN)) == pytest.approx([NAN, NAN], nan_ok=True)


def test_one_track_may_leave_out_its_track_axis():
    estimate, truth, _ = two_tracks()
    assert metrics.rmse(estimate[0], truth[0]) == metrics.rmse(estimate[:1], truth[:1])


def test_huge_errors_do_not_overflow():
    assert metrics.rmse([[3e160, 4e160]] * 3, [[0.0, 0.0]] * 3) == pytest.approx(5e160)
    assert metrics.rmse_per_time([[[1e120]], [[1e120]]], [[[0.0]], [[0.0]]])[0] == pytest.approx(1e120)


def test_forecasts_are_compared_with_the_later_truth():
    t = np.arange(6.0)
    truth = np.stack([t, t**2], axis=1)[None].repeat(2, axis=0)
    forecasts = np.full_like(truth, 1e9)
    forecasts[:, :4] = truth[:, 2:] + [3.0, 4.0]
    got = metrics.forecast_errors(forecasts, truth, 2, lengths=[6, 4])
    want = np.array([[5.0, 5.0, 5.0, 5.0, NAN, NAN], [5.0, 5.0, NAN, NAN, NAN, NAN]])
    assert got == pytest.approx(want, nan_ok=True)
    assert metrics.forecast_rmse(forecasts, truth, 2) == pytest.approx(5.0)
    assert np.isnan(metrics.forecast_rmse(forecasts, truth, 6))


def test_nees_equals_a_naive_loop_and_keeps_the_order_of_blocks():
    rng = np.random.default_rng(0)
    B, T, A = 2, 4, 3
    x, known = rng.normal(size=(B, T, 2 * A)), rng.normal(size=(B, T, 2 * A))
    root = rng.normal(size=(B, T, 2 * A, 2 * A))
    cov = root @ root.swapaxes(-1, -2) + np.eye(2 * A)
    full = metrics.nees(x[..., :A], x[..., A:], cov, known[..., :A], known[..., A:])
    part = metrics.position_nees(x[..., :A], cov, known[..., :A])
    for b in range(B):
        for k in range(T):
            e = x[b, k] - known[b, k]
            assert full[b, k] == pytest.approx(e @ np.linalg.inv(cov[b, k]) @ e, rel=1e-9)
            want = e[:A] @ np.linalg.inv(cov[b, k][:A, :A]) @ e[:A]
            assert part[b, k] == pytest.approx(want, rel=1e-9)
    assert metrics.position_nees(x[..., :A], cov[..., :A, :A], known[..., :A]) == pytest.approx(part)


def test_squared_distance_survives_scales_and_marks_bad_matrices():
    # Kilometres beside micrometres per second: condition number 1e18 before scaling.
    assert metrics.squared_distance([2e3, 3e-6], np.diag([1e6, 1e-12])) == pytest.approx(13.0)
    cov = np.stack([np.eye(2), np.array([[1.0, 2.0], [2.0, 1.0]]), np.full((2, 2), NAN), np.zeros((2, 2))])
    got = metrics.squared_distance(np.ones((4, 2)), cov)
    assert got == pytest.approx([2.0, np.inf, np.inf, np.inf])
    assert np.isnan(metrics.squared_distance([NAN, 1.0], np.eye(2)))


def test_chi_square_band_known_numbers():
    # Bar-Shalom's example: 50 runs of a 2-state filter, 95 %: [1.5, 2.6].
    assert metrics.chi_square_band(2, 50) == pytest.approx((1.4844, 2.5912), abs=1e-3)
    # 90 % two-sided upper end = one-sided 95 % quantile of the table.
    assert metrics.chi_square_band(3, level=0.90)[1] == pytest.approx(7.815, abs=5e-4)


def test_average_nees_inside_when_matched_and_outside_when_mistuned():
    rng = np.random.default_rng(2)
    truth, position = np.zeros((100, 200, 2)), rng.normal(size=(100, 200, 2))
    cov = np.broadcast_to(np.eye(2), (100, 200, 2, 2))
    good = metrics.average_nees(metrics.position_nees(position, cov, truth), 2)
    assert good.low < good.mean < good.high
    assert good.samples == 20_000
    assert good.share_inside == pytest.approx(0.95, abs=0.047)  # three binomial sigmas over 200 times
    bad = metrics.average_nees(metrics.position_nees(position, 0.5 * cov, truth), 2)
    assert bad.mean > bad.high
    assert bad.share_inside < 0.05


def test_average_nees_uses_the_number_of_runs_scored_at_each_time():
    values = np.array([[6.0, 6.0], [6.0, NAN]])
    # 6 is inside the one-run band of chi2_2 (0.051 to 7.378) and outside the two-run band (up to 5.572).
    got = metrics.average_nees(values, 2)
    assert got.share_inside == 0.5
    assert got.samples == 3
    empty = metrics.average_nees(np.full((2, 2), NAN), 2)
    assert np.isnan(empty.mean)
    assert empty.samples == 0


def test_nis_pools_partial_measurements():
    rng = np.random.default_rng(3)
    dof = rng.integers(0, 4, size=(5, 400))
    nis = np.where(dof > 0, rng.chisquare(np.maximum(dof, 1)), 0.0)
    got = metrics.nis_consistency(nis, dof)
    assert got.samples == (dof > 0).sum()
    assert got.mean == pytest.approx(nis.sum() / dof.sum())
    assert got.low == pytest.approx(stats.chi2.ppf(0.025, dof.sum()) / dof.sum())
    assert got.low < got.mean < got.high
    assert got.share_inside == pytest.approx(0.95, abs=0.017)  # three binomial sigmas
    wrong = metrics.nis_consistency(nis, np.where(dof > 0, 3, 0))
    assert wrong.mean < wrong.low
    only = metrics.nis_consistency([[1.0, 9.0, 50.0]], [[2, 0, 1]], lengths=[2])
    assert (only.mean, only.samples) == (0.5, 1)
    assert np.isnan(metrics.nis_consistency([[0.0]], [[0]]).mean)


def test_normalised_innovations_square_to_the_nis():
    S = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]])
    v = np.array([[1.0, -2.0, 0.5], [1.0, NAN, 0.5]])
    white = metrics.normalise_innovations(v, np.stack([S, S]))
    assert np.sum(white[0] ** 2) == pytest.approx(v[0] @ np.linalg.inv(S) @ v[0])
    keep = [0, 2]
    assert np.nansum(white[1] ** 2) == pytest.approx(v[1, keep] @ np.linalg.inv(S[np.ix_(keep, keep)]) @ v[1, keep])
    assert np.isnan(white[1, 1])
    with pytest.raises(ValueError, match="positive definite"):
        metrics.normalise_innovations(v[:1], -S[None])


def test_whiteness_tells_white_from_coloured():
    rng = np.random.default_rng(6)
    white = rng.normal(size=(4, 3000, 2))
    white[0, 100:200, 1] = NAN
    got = metrics.whiteness(white, lags=(1, 2, 5))
    assert np.all(np.abs(got.correlation) < 1.5 * got.band)
    assert got.band[0] == pytest.approx(1.96 / np.sqrt(4 * 2999 * 2 - 101), rel=1e-4)
    coloured = white.copy()
    coloured[:, 1:] += 0.5 * white[:, :-1]
    # MA(1) with coefficient 0.5: rho(1) = 0.5 / 1.25 = 0.4, rho(2) = 0.
    rho = metrics.whiteness(np.nan_to_num(coloured), lags=(1, 2)).correlation
    assert rho == pytest.approx([0.4, 0.0], abs=0.03)
    assert np.isnan(metrics.whiteness(white[:, :3], lags=(9,)).correlation[0])


def test_whiteness_ignores_padding():
    e = np.array([[1.0, -1.0, 1.0, 1e6]])[:, :, None]
    assert metrics.whiteness(e, lengths=[3]).correlation == pytest.approx([-1.0])


def test_mode_scores_by_hand():
    probs = np.array([[[0.7, 0.2, 0.1], [0.1, 0.3, 0.6], [0.5, 0.5, 0.0], [0.0, 1.0, 0.0]]])
    modes = np.array([[0, 1, -1, 0]])
    assert metrics.mode_accuracy(probs, modes) == pytest.approx(1 / 3)
    brier = ((0.3**2 + 0.2**2 + 0.1**2) + (0.1**2 + 0.7**2 + 0.6**2) + 2.0) / 3
    assert metrics.brier_score(probs, modes) == pytest.approx(brier)
    assert metrics.true_mode_probability(probs, modes) == pytest.approx(1.0 / 3)
    assert metrics.log_score(probs, modes, lengths=[3]) == pytest.approx(-np.log(0.7 * 0.3) / 2)
    assert metrics.log_score(probs, modes) == pytest.approx(-np.log(0.7 * 0.3 * 1e-12) / 3)
    assert metrics.brier_score(np.full((1, 4, 4), 0.25), [[0, 1, 2, 3]]) == pytest.approx(0.75)
    assert np.isnan(metrics.mode_accuracy(probs, -np.ones((1, 4))))


def test_encode_modes():
    got = metrics.encode_modes([["turn", "", "straight", "other"]], ("straight", "turn"))
    assert got.tolist() == [[1, -1, 0, -1]]


def test_switch_delays():
    modes = np.array([[0, 0, 1, 1, 1, 2, 2, 0], [0, 1, 1, -1, 0, 0, 1, 1]])
    top = np.array([[0, 0, 0, 0, 1, 1, 1, 0], [1, 1, 0, 0, 0, 0, 0, 1]])
    probs = np.eye(3)[top] * 0.7 + 0.1
    times = np.cumsum(np.array([0.0, 1, 1, 2, 3, 1, 1, 1]))
    got = metrics.switch_delays(probs, modes, times)
    # Track 0: seen at t=7 of a switch at t=2; mode 2 never seen; last one at once. Track 1: at once; the step
    # out of an unknown label is no switch; the last one is seen one step late.
    assert got.track.tolist() == [0, 0, 0, 1, 1]
    assert got.step.tolist() == [2, 5, 7, 1, 6]
    assert got.delay_s == pytest.approx([5.0, NAN, 0.0, 0.0, 1.0], nan_ok=True)
    short = metrics.switch_delays(probs, modes, times, lengths=[3, 7])
    assert short.delay_s == pytest.approx([NAN, 0.0, NAN], nan_ok=True)
    assert np.isnan(metrics.switch_delays(probs, modes, times, threshold=0.9).delay_s).all()
    assert metrics.switch_delays(probs, modes, times, threshold=0.75).delay_s[0] == 5.0


def test_smoothness_of_a_parabola_and_gaps():
    t = np.array([0.0, 1.0, 3.0, 3.5, 6.0])
    path = np.stack([1.5 * t**2, 2.0 * t**2], axis=1)
    # Acceleration (3, 4): the divided second difference of a parabola is exact for any spacing.
    assert metrics.smoothness(path, t) == pytest.approx(5.0)
    steps = np.arange(5.0)[:, None] ** 2
    assert metrics.smoothness(steps) == pytest.approx(2.0)
    broken = steps.copy()
    broken[4] = NAN
    assert metrics.smoothness(broken) == pytest.approx(2.0)
    assert metrics.smoothness(np.vstack([steps, [[1e9]]]), lengths=[5]) == pytest.approx(2.0)
    assert np.isnan(metrics.smoothness(steps[:2]))
    repeated = metrics.smoothness(path[[0, 1, 1, 2, 3, 4]], t[[0, 1, 1, 2, 3, 4]])
    assert repeated == pytest.approx(5.0)


def test_lost_tracks_need_every_one_of_the_last_scored_steps():
    error = np.array(
        [
            [0.0, 9.0, 9.0, 9.0, NAN],  # lost; the last truth is unknown
            [9.0, 9.0, 9.0, 0.0, 9.0],  # came back
            [0.0, 0.0, 9.0, 9.0, 9.0],  # lost, unless the track ends before
            [NAN, NAN, NAN, NAN, NAN],  # nothing known
            [9.0, NAN, NAN, NAN, NAN],  # judged by the one step it has
        ]
    )
    truth = np.where(np.isnan(error), NAN, 0.0)[:, :, None]
    estimate = np.nan_to_num(error)[:, :, None]
    lost = metrics.lost_tracks(estimate, truth, gate=5.0, last=3)
    assert lost == pytest.approx([1.0, 0.0, 1.0, NAN, 1.0], nan_ok=True)
    assert metrics.lost_track_rate(estimate, truth, gate=5.0, last=3) == pytest.approx(0.75)
    assert metrics.lost_track_rate(estimate, truth, 5.0, 3, lengths=[5, 5, 4, 5, 5]) == pytest.approx(0.5)


def fake_estimates():
    rng = np.random.default_rng(9)
    B, T, A, M = 2, 5, 2, 2
    cov = np.broadcast_to(np.diag([1.0, 4.0, 0.25, 0.25]), (B, T, 2 * A, 2 * A)).copy()
    probs = rng.dirichlet(np.ones(M), size=(B, T))
    dof = np.array([[2, 2, 0, 1, 2], [2, 2, 2, 2, 0]])
    status = np.array([[4, 0, 2, 0, 1], [0, 0, 3, 0, 2]], dtype=np.int8)
    position = rng.normal(size=(B, T, A))
    position[0, 0] = NAN
    nis = np.where(dof > 0, rng.chisquare(2, size=(B, T)), 0.0)
    times = np.tile(np.arange(float(T)), (B, 1))
    return FakeEstimates(
        times, position, rng.normal(size=(B, T, A)), cov, probs, rng.normal(size=(B, T)), nis, dof, status
    )


def test_summary_agrees_with_the_single_measures():
    e = fake_estimates()
    truth, lengths = np.zeros((2, 5, 2)), np.array([5, 4])
    modes = np.array([[0, 0, 1, 1, 1], [1, 1, 0, 0, 0]])
    got = metrics.summary(e, truth, truth, lengths, true_modes=modes, gate=3.0, last=2)
    assert all(isinstance(value, float) for value in got.values())
    counts = {k: got[k] for k in got if k.endswith("_steps")}
    assert counts == {
        "measured_steps": 8,
        "missing_steps": 1,
        "repaired_steps": 1,
        "diverged_steps": 1,
        "starting_steps": 1,
        "scored_steps": 8,
    }
    assert (got["tracks"], got["steps"], got["switches"]) == (2, 9, 2)
    started = np.ones((2, 5), bool)
    started[0, 0] = False
    assert got["position_rmse_m"] == metrics.rmse(e.position, truth, lengths, started)
    assert got["position_peak_m"] == np.nanmax(metrics.peak_error(e.position, truth, lengths, started))
    assert got["velocity_rmse_m_s"] == metrics.rmse(e.velocity, truth, lengths, started)
    full = metrics.nees(e.position, e.velocity, e.covariance, truth, truth, lengths, started)
    assert got["nees"] == pytest.approx(np.nanmean(full))
    assert got["nis_per_dof"] == metrics.nis_consistency(e.nis, e.nis_dof, lengths).mean
    assert got["mode_brier"] == metrics.brier_score(e.mode_probs, modes, lengths)
    used = (np.arange(5) < lengths[:, None]) & (e.nis_dof > 0)
    assert got["log_likelihood_per_step"] == pytest.approx(e.log_likelihood[used].mean())


def test_status_names_stand_in_the_order_of_their_codes():
    for code, name in enumerate(status.STATUS_NAMES):
        assert getattr(status, name.upper()) == code


def test_summary_without_truth_and_with_unknown_truth():
    e = fake_estimates()
    plain = metrics.summary(e)
    assert not any(key.startswith(("position", "velocity", "mode", "nees", "lost")) for key in plain)
    blind = metrics.summary(e, np.full((2, 5, 2), NAN), gate=1.0)
    assert blind["scored_steps"] == 0
    assert np.isnan([blind["position_rmse_m"], blind["position_nees"], blind["lost_track_rate"]]).all()


def test_a_started_track_without_a_position_is_an_infinite_error_in_the_summary():
    e = fake_estimates()
    e.position[1, 1] = NAN
    got = metrics.summary(e, np.zeros((2, 5, 2)))
    assert got["position_rmse_m"] == np.inf
    assert got["position_nees"] == np.inf


def test_inputs_are_left_alone():
    e = fake_estimates()
    before = [np.array(field) for field in e]
    metrics.summary(e, np.zeros((2, 5, 2)), np.zeros((2, 5, 2)), [5, 4], true_modes=np.zeros((2, 5)), gate=1.0)
    for field, copy in zip(e, before, strict=True):
        np.testing.assert_array_equal(field, copy)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: metrics.rmse(np.zeros((1, 3, 2)), np.zeros((1, 4, 2))), r"errors: estimate must have shape"),
        (lambda: metrics.rmse(np.zeros(3), np.zeros(3)), r"truth must have shape \(B, T, A\)"),
        (lambda: metrics.step_mask((2, 3), [1, 4]), r"lengths must be \(2,\) integers in \[0, 3\]"),
        (lambda: metrics.step_mask((2, 3), None, np.ones(2)), "mask must have shape"),
        (lambda: metrics.forecast_errors(np.zeros((2, 1)), np.zeros((2, 1)), -1), "steps must be >= 0"),
        (lambda: metrics.chi_square_band(2, 0), "dof and runs must be positive"),
        (lambda: metrics.chi_square_band(2, 1, 95), r"level must lie in \(0, 1\)"),
        (lambda: metrics.whiteness(np.zeros((3, 1)), (0,)), "lags must be >= 1"),
        (lambda: metrics.mode_accuracy(np.ones((1, 2, 2)), [[0, 2]]), "true_modes must be below"),
        (lambda: metrics.brier_score(np.ones((1, 2, 2)), [[0, 1, 1]]), "true_modes must have shape"),
        (
            lambda: metrics.switch_delays(np.ones((1, 2, 2)), [[0, 1]], [0, 1], threshold=2),
            "threshold must lie",
        ),
        (lambda: metrics.lost_tracks(np.zeros((2, 1)), np.zeros((2, 1)), gate=0.0), "gate must be positive"),
        (lambda: metrics.squared_distance(np.zeros(2), np.eye(3)), "cov must have shape"),
    ],
)
def test_bad_input_is_one_clear_sentence(call, match):
    with pytest.raises(ValueError, match=match):
        call()
