"""The encoder: exact on arcs of constant shape parameters, calibrated, at irregular times, in plane and space."""

import numpy as np
import pytest
from scipy.linalg import expm

from jink.estimators.tracks import Tracks
from jink.intent.features import encode
from jink.intent.located import noise_sigma
from jink.intent.window import choose_window, window_risks


def planar(times, growth, turn, speed=50.0, sigma=0.0, tracks=1, seed=0, heading=None):
    """Arcs v' = (g + i w) v from random headings; tracks, positions and velocities, measured with sigma."""
    generator = np.random.default_rng(seed)
    rate = growth + 1j * turn
    angle = generator.uniform(0, 2 * np.pi, tracks) if heading is None else np.full(tracks, heading)
    start = speed * np.exp(1j * angle)[:, None]
    p, v = start * (np.exp(rate * times) - 1) / rate, start * np.exp(rate * times)
    truth, velocity = (np.stack([c.real, c.imag], axis=-1) for c in (p, v))
    z = truth + sigma * generator.standard_normal(truth.shape)
    return Tracks.from_arrays(z, times, noise=np.eye(2) * max(sigma, 1e-3) ** 2), truth, velocity


def spatial(times, growth, turn, velocity):
    """An arc v' = g v + w x v in space by matrix exponentials; positions and velocities."""
    generator = growth * np.eye(3) + np.cross(np.eye(3), turn)  # rows e_i x w: the matrix of w x
    whole = np.zeros((6, 6))
    whole[:3, 3:], whole[3:, 3:] = np.eye(3), generator
    path = np.array([expm(whole * t) @ np.concatenate([np.zeros(3), velocity]) for t in times])
    return path[:, :3], path[:, 3:]


def nees(error, cov):
    return np.einsum("...i,...ij,...j->...", error, np.linalg.inv(cov), error)


@pytest.mark.parametrize("turn", [0.3, -0.05, 1e-7])
def test_arcs_of_constant_shape_are_recovered_at_irregular_times(turn):
    times = np.cumsum(np.random.default_rng(1).uniform(0.1, 0.9, 80))
    tracks, truth, velocity = planar(times, -0.03, turn, tracks=2)
    found = encode(tracks, 9.0)
    assert found.valid.all()
    # the refit ends within 1e-4 in chi-square: a hundredth of the 1 mm that the covariance claims
    np.testing.assert_allclose(found.mean[..., :2], truth, atol=1e-4)
    np.testing.assert_allclose(found.velocity, velocity, atol=1e-4)
    np.testing.assert_allclose(found.eta, np.broadcast_to([-0.03, turn], found.eta.shape), atol=2e-6)


def test_parabola_limit_of_short_windows():
    """Without the refit the error would still fall as the square of the window: the arc is its continuation."""
    errors = []
    for window in (4.0, 2.0):
        tracks, _, _ = planar(np.arange(200) * 0.02, 0.0, 2.5, speed=0.01)  # too slow for its noise: no refit
        errors.append(abs(encode(tracks, window).eta[0, 100, 1] - 2.5))
    assert errors[1] < 0.35 * errors[0]


def test_space_and_its_covariance():
    times = np.arange(60) * 0.5
    turn = np.array([0.02, -0.05, 0.11])
    start = np.array([40.0, 20.0, 0.0])
    start -= turn * (start @ turn) / (turn @ turn)  # turning about v itself does not show
    truth, velocity = spatial(times, 0.01, turn, start)
    tracks = Tracks.from_arrays(truth, times, noise=np.eye(3) * 1e-6)
    found = encode(tracks, 10.0)
    np.testing.assert_allclose(found.velocity[0], velocity, atol=1e-4)
    np.testing.assert_allclose(found.eta[0], np.broadcast_to([0.01, *turn], (60, 4)), atol=2e-6)
    noise = np.diag([4.0, 9.0, 16.0])
    draws = np.random.default_rng(2).multivariate_normal(np.zeros(3), noise, (200, 60))
    rows = np.tile(np.arange(60) == 30, (200, 1))
    noisy = encode(Tracks.from_arrays(truth + draws, times, noise=noise), 12.0, rows=rows)
    middle = noisy.mean[:, 30] - np.concatenate([truth[30], velocity[30], [0.01], turn])
    kept = [0, 1, 2, 3, 4, 5, 6, 8, 9]  # wx follows from the others: w is perpendicular to v
    value = nees(middle[:, kept], noisy.cov[:, 30][:, kept][:, :, kept]).mean()
    # 9 components, 200 windows: sd of the mean 0.3; the delta method costs a few hundredths
    assert 7.7 < value < 10.3
    along = np.einsum("bi,bi->b", noisy.eta[:, 30, 1:], noisy.velocity[:, 30])
    np.testing.assert_allclose(along, 0.0, atol=1e-9)


@pytest.mark.parametrize("turn", [0.1, 0.004])
def test_covariance_is_calibrated(turn):
    times = np.arange(90.0)
    tracks, truth, velocity = planar(times, -0.01, turn, sigma=5.0, tracks=300, seed=4)
    rows = np.isin(np.arange(90), (0, 1, 45, 89, *range(8, 88, 16))) & np.ones((300, 1), dtype=bool)
    found = encode(tracks, 15.0, rows=rows)
    true = np.concatenate([truth, velocity, np.broadcast_to([-0.01, turn], truth.shape)], axis=2)
    error = found.mean - true
    for row in (0, 1, 45, 89):  # ends too, where the row is reached along the arc
        # sd of the mean over 300 tracks: sqrt(2 x 6 / 300) = 0.2 and sqrt(2 x 2 / 300) = 0.12
        assert 5.2 < nees(error[:, row], found.cov[:, row]).mean() < 6.8
        assert 1.54 < nees(error[:, row, 4:], found.eta_cov[:, row]).mean() < 2.46
    # the fit leaves its degrees of freedom: 300 x 5 windows without common rows, sd 0.008
    assert 0.965 < found.misfit[:, 8:88:16].mean() < 1.035
    wrong = encode(tracks, 15.0, noise_sd=6.0, rows=rows)
    assert nees(error[:, 45], wrong.cov[:, 45]).mean() < 4.5  # 6 / 1.44: the band would notice


def test_covariances_per_row_and_missing_rows():
    generator = np.random.default_rng(7)
    times = np.arange(41.0)
    _, truth, _ = planar(times, 0.0, 0.06)
    sigma = generator.choice([1.0, 20.0], (400, 41))
    lean = np.array([[1.0, 0.7], [0.7, 1.0]])
    noise = sigma[..., None, None] ** 2 * lean
    draws = np.einsum("ij,btj->bti", np.linalg.cholesky(lean), generator.standard_normal((400, 41, 2)))
    z = np.broadcast_to(truth, (400, 41, 2)) + sigma[..., None] * draws
    z[generator.random((400, 41)) < 0.2] = np.nan
    z[:, 20] = np.nan
    z[:, 18, 1] = np.nan  # half a row
    found = encode(Tracks.from_arrays(z, np.broadcast_to(times, (400, 41)), noise=noise), 20.0)
    assert found.valid[:, 20].all()  # an estimate where nothing was measured
    error = found.eta[:, 20] - [0.0, 0.06]
    assert 1.6 < nees(error, found.eta_cov[:, 20]).mean() < 2.4
    blind = encode(Tracks.from_arrays(z, np.broadcast_to(times, (400, 41)), noise=np.eye(2) * 200.0), 20.0)
    assert np.mean(error[:, 1] ** 2) < 0.5 * np.mean((blind.eta[:, 20, 1] - 0.06) ** 2)  # weights are used


def test_rotation_mirror_and_translation():
    times = np.cumsum(np.random.default_rng(3).uniform(0.5, 1.5, 50))
    tracks, _, _ = planar(times, 0.01, 0.08, sigma=3.0, seed=5)
    turned = np.array([[np.cos(1.1), -np.sin(1.1)], [np.sin(1.1), np.cos(1.1)]])
    plain = encode(tracks, 12.0)
    moved = encode(Tracks.from_arrays(tracks.measurements @ turned.T + 1e5, times, noise=np.eye(2) * 9.0), 12.0)
    np.testing.assert_allclose(moved.eta, plain.eta, atol=1e-9)
    np.testing.assert_allclose(moved.eta_cov, plain.eta_cov, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(moved.velocity, plain.velocity @ turned.T, atol=1e-7)
    mirror = encode(Tracks.from_arrays(tracks.measurements * [1.0, -1.0], times, noise=np.eye(2) * 9.0), 12.0)
    np.testing.assert_allclose(mirror.eta, plain.eta * [1.0, -1.0], atol=1e-9)


def test_rotation_in_space():
    generator = np.random.default_rng(6)
    times = np.arange(30.0)
    truth, _ = spatial(times, 0.0, np.array([0.0, 0.05, 0.1]), np.array([30.0, 0.0, 5.0]))
    z = truth + generator.standard_normal(truth.shape)
    spin = expm(np.cross(np.eye(3), [0.3, -0.8, 0.5]))
    plain, turned = (encode(Tracks.from_arrays(part, times, noise=np.eye(3)), 10.0) for part in (z, z @ spin.T))
    np.testing.assert_allclose(turned.eta[..., 0], plain.eta[..., 0], atol=1e-9)
    np.testing.assert_allclose(turned.eta[..., 1:], plain.eta[..., 1:] @ spin.T, atol=1e-9)


def test_range_and_bearing_are_located():
    times = np.arange(60.0)
    _, truth, velocity = planar(times, 0.0, 0.05, heading=0.3)
    seen = truth[0] + [4000.0, 3000.0]
    generator = np.random.default_rng(8)
    z = np.stack([np.hypot(*seen.T), np.arctan2(seen[:, 1], seen[:, 0])], axis=1)
    z = z + generator.standard_normal((200, 60, 2)) * [5.0, 0.002]
    tracks = Tracks.from_arrays(z, times, sensor="range-bearing", noise=np.diag([25.0, 4e-6]))
    found = encode(tracks, 20.0, rows=np.tile(times == 30.0, (200, 1)))
    error = found.mean[:, 30] - np.concatenate([seen[30], velocity[0, 30], [0.0, 0.05]])
    assert 5.0 < nees(error, found.cov[:, 30]).mean() < 7.0  # sd of the mean 0.24
    with pytest.raises(ValueError, match="tracks of a range-bearing sensor must carry noise"):
        encode(Tracks.from_arrays(z, times, sensor="range-bearing"), 20.0)


def test_short_tracks_padding_and_wanted_rows():
    times = np.arange(12.0)
    tracks, _, _ = planar(times, 0.0, 0.1, sigma=1.0)
    both = Tracks.from_arrays([tracks.measurements[0], tracks.measurements[0, :4]], [times, times[:4]], noise=np.eye(2))
    found = encode(both, 6.0)
    assert found.valid[0].all() and not found.valid[1].any() and (found.dof[1] == 0).all()
    np.testing.assert_allclose(found.eta[0], encode(tracks, 6.0, noise_sd=1.0).eta[0], atol=1e-12)
    rows = np.zeros((2, 12), dtype=bool)
    rows[0, 5] = True
    few = encode(both, 6.0, rows=rows)
    assert few.valid.sum() == 1
    np.testing.assert_allclose(few.mean[0, 5], found.mean[0, 5], atol=1e-12)
    coincident = Tracks.from_arrays(np.zeros((8, 2)), np.zeros(8), noise=np.eye(2))
    assert not encode(coincident, 1.0).valid.any()  # no time passes: no velocity


@pytest.mark.filterwarnings("error")
def test_a_target_that_stops_and_jumps():
    z = np.zeros((60, 2))
    z[20:40, 0] = 3.0 * np.arange(20)  # stands, drives off, stands
    z[40:] = z[39]
    z[50] += 4000.0
    for axes in (2, 3):
        path = np.pad(z, ((0, 0), (0, axes - 2)))
        found = encode(Tracks.from_arrays(path, np.arange(60.0), noise=np.eye(axes) * 0.01), 9.0)
        np.testing.assert_allclose(found.mean[0, 30, : 2 * axes], [30.0, *[0.0] * (axes - 1), 3.0, *[0.0] * (axes - 1)],
                                   atol=1e-6)  # fmt: skip
        assert found.valid[0, 30] and found.speed_ratio[0, 30] > 3.0
        assert not (found.speed_ratio[0, :10] > 3.0).any()


def test_noise_is_estimated_where_none_is_given():
    tracks, _, _ = planar(np.arange(400) * 0.5, 0.0, 0.1, sigma=4.0, tracks=4, seed=9)
    bare = Tracks.from_arrays(tracks.measurements, tracks.times)
    np.testing.assert_allclose(noise_sigma(bare), 4.0, rtol=0.12)  # 3200 values, correlated: sd of the ratio 0.025
    assert encode(bare, 10.0).misfit.mean() == pytest.approx(1.0, abs=0.25)


def switching(sigma, speed=100.0, seed=0, dwell=25):
    """Turns of 6 deg/s either way and straights, every `dwell` s."""
    generator = np.random.default_rng(seed)
    times = np.arange(200.0)
    rates = np.repeat(generator.choice([0.0, 0.1, -0.1], (12, 200 // dwell)), dwell, axis=1)
    heading = np.cumsum(rates, axis=1)
    truth = np.cumsum(speed * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=1)
    return Tracks.from_arrays(truth + sigma * generator.standard_normal(truth.shape), times, noise=np.eye(2) * sigma**2)


def test_window_grows_with_noise_and_shrinks_with_speed():
    small, large = choose_window(switching(1.0)), choose_window(switching(60.0))
    assert small < large
    assert choose_window(switching(60.0, speed=6000.0)) == small  # the same path in other units
    risks = window_risks(switching(10.0))  # beyond six steps arcs of several turns would be needed
    assert (np.diff(risks.noise[:6]) < 0).all() and risks.bias[-1] > risks.bias[1]


def test_the_risk_is_the_error():
    tracks = switching(10.0, seed=3)
    risks = window_risks(tracks)
    generator = np.random.default_rng(3)
    rates = np.repeat(generator.choice([0.0, 0.1, -0.1], (12, 8)), 25, axis=1)
    for window, noise, bias in zip(risks.window[1:5], risks.noise[1:5], risks.bias[1:5], strict=True):
        found = encode(tracks, window)
        error = np.sum((found.eta - np.stack([0 * rates, rates], axis=-1)) ** 2, axis=2)[:, 10:-10]
        # the rule is right to a factor, enough to choose between windows a factor 1.4 apart (noise: a factor 5.4)
        assert 0.5 < (noise + bias) / error.mean() < 2.0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"window": 0.0}, "window must be > 0 s"),
        ({"window": 5.0, "noise_sd": -1.0}, "noise_sd must be > 0 and finite; got -1.0"),
    ],
)
def test_refusals(options, sentence):
    tracks, _, _ = planar(np.arange(20.0), 0.0, 0.1)
    with pytest.raises(ValueError, match=sentence):
        encode(tracks, **options)


def test_refused_tracks():
    with pytest.raises(ValueError, match="must have 2 or 3 axes; got 1"):
        encode(Tracks.from_arrays(np.zeros((9, 1)), np.arange(9.0)), 5.0)
    with pytest.raises(ValueError, match="must carry positions"):
        encode(Tracks.from_arrays(np.zeros((9, 1)), np.arange(9.0), sensor="bearing"), 5.0)
    with pytest.raises(ValueError, match="noise must be positive definite"):
        encode(Tracks.from_arrays(np.zeros((9, 2)), np.arange(9.0), noise=np.diag([1.0, -1.0])), 5.0)
    with pytest.raises(ValueError, match="two rows at different times"):
        choose_window(Tracks.from_arrays(np.zeros((9, 2)), np.zeros(9)))
