"""Are the covariances of treated modes what they say? Mean NEES on noise the mode assumes, and on noise it does not."""

from __future__ import annotations

import numpy as np
import pytest

from jink.envs.scenarios import make_scenario
from jink.envs.simulate import simulate
from jink.envs.streams import make_streams
from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.joint import joint_bank
from jink.estimators.motions import constant_velocity
from jink.estimators.sensors import position
from jink.estimators.treatments import HeavyTails

MOTION = constant_velocity(2, acceleration_density=1.0)


def mean_nees(estimates, position_truth, velocity_truth):
    """Average of ``e' P^-1 e`` of position and velocity, and its standard error over episodes."""
    state = np.concatenate([estimates.position - position_truth, estimates.velocity - velocity_truth], axis=2)
    nees = np.einsum("btn,btn->bt", state, np.linalg.solve(estimates.covariance, state[..., None])[..., 0]).mean(axis=1)
    return nees.mean(), nees.std() / np.sqrt(len(nees))


@pytest.mark.parametrize(
    "make",
    [
        lambda sensor: Bank((Mode("cv", MOTION),), sensor),
        lambda sensor: Bank((Mode("cv", MOTION, HeavyTails(1e6)),), sensor),
    ],
)
@pytest.mark.parametrize(("believed", "consistent"), [(1.0, True), (0.8, False), (1.25, False)])
def test_gaussian_noise(make, believed, consistent):
    streams = [make_streams(np.random.default_rng((5, run))) for run in range(200)]
    episodes = simulate(make_scenario("surge-v0", surges=(), steps=100), streams)
    prior = Prior(mean=episodes.prior_mean, cov=episodes.prior_cov)
    found = BankEstimator(make(position(2, believed)), threads=1).run(
        episodes.measurements, episodes.times, prior=prior
    )
    mean, error = mean_nees(found, episodes.truth.position, episodes.truth.velocity)
    assert (abs(mean - 4.0) < 4.0 * error) == consistent, (mean, error)


@pytest.mark.parametrize(("believed", "consistent"), [(1.0, True), (0.8, False), (1.25, False)])
def test_jointly_t_noise(believed, consistent):
    """State and noise share one mixing variable, as the filter assumes: one update is then exact."""
    rng = np.random.default_rng(3)
    runs, dof = 40000, 9.0
    mixing = np.sqrt(dof / rng.chisquare(dof, size=(runs, 1)))
    start = np.diag([4.0, 4.0, 1.0, 1.0])  # covariance; the mode's scale matrix is (nu - 2) / nu of it
    shrink = np.sqrt((dof - 2.0) / dof)
    truth = shrink * mixing * rng.standard_normal((runs, 4)) @ np.sqrt(start)
    measured = truth[:, :2] + shrink * mixing * rng.standard_normal((runs, 2))
    mode = Mode("cv", MOTION, HeavyTails(dof, matrices="covariance"))
    estimator = BankEstimator(Bank((mode,), position(2, believed)), threads=1)
    found = estimator.run(measured[:, None], np.zeros(1), prior=Prior(mean=np.zeros(4), cov=start))
    mean, error = mean_nees(found, truth[:, None, :2], truth[:, None, 2:])
    assert (abs(mean - 4.0) < 4.0 * error) == consistent, (mean, error)


def test_the_joint_bank_knows_its_error_in_surges():
    """A Gaussian mixture fused to one covariance is near, not exact: within a quarter; told nothing it is far off."""
    streams = [make_streams(np.random.default_rng((6, run))) for run in range(100)]
    episodes = simulate(make_scenario("surge-v0", steps=150), streams)
    prior = Prior(mean=episodes.prior_mean, cov=episodes.prior_cov)
    plain = Bank((Mode("cv", MOTION),), position(2, 1.0))
    means = [
        mean_nees(
            BankEstimator(bank, threads=1).run(episodes.measurements, episodes.times, prior=prior),
            episodes.truth.position,
            episodes.truth.velocity,
        )[0]
        for bank in (joint_bank(plain), plain)
    ]
    assert 3.0 < means[0] < 5.0 and means[1] > 100.0, means
