"""Hostile input through every door of the estimators, and the edges that chance rarely draws."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

import numpy as np
import pytest
from conftest import ROOT

from jink.estimators.api import BankEstimator, Estimates
from jink.estimators.inputs import Prior
from jink.estimators.recipes import RECIPES, make_estimator
from jink.estimators.sensors import bearing, position, range_bearing
from jink.estimators.status import MISSING, OK, REPAIRED

QUICK, LONG = 30_000, 1_000_000


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz", ROOT / "benchmarks" / "fuzz.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fuzz"] = module
    spec.loader.exec_module(module)
    return module


FUZZ = _load()


def _break(steps: int, seed: int) -> list[str]:
    made, number, found = 0, 0, []
    while made < steps:
        problem = FUZZ.draw_round(number, seed, 4, 80)
        with np.errstate(all="ignore"):
            done, broken = FUZZ.check_round(problem, np.random.default_rng([seed, number, 1]))
        found += [f"round {number} ({problem.title}): {text}" for text in broken]
        made, number = made + max(done, 1), number + 1
    return found


def test_hostile_tracks() -> None:
    """No exception, no NaN, no indefinite covariance, trouble visible, `run` equal to `step`."""
    assert _break(QUICK, seed=1) == []


@pytest.mark.slow
def test_a_million_hostile_steps() -> None:
    """The bar of the project: 10^6 steps."""
    assert _break(LONG, seed=2) == []


def _small() -> Estimates:
    estimator = make_estimator("imm", position(2, 1.0))
    return estimator.run(np.cumsum(np.ones((2, 6, 2)), axis=1), np.arange(6.0))


@pytest.mark.parametrize(
    ("field", "value", "word"),
    [
        ("position", np.nan, "position not finite"),
        ("covariance", np.inf, "covariance not finite"),
        ("mode_probs", 0.9, "mode_probs"),
        ("nis", -1.0, "nis"),
        ("status", 7, "status"),
    ],
)
def test_checks_see_a_broken_number(field: str, value: float, word: str) -> None:
    """The checks themselves can fail."""
    estimates = _small()
    assert FUZZ.broken(estimates) == []
    spoilt = getattr(estimates, field).copy()
    spoilt[0, 3] = value
    assert any(word in text for text in FUZZ.broken(estimates._replace(**{field: spoilt})))


@pytest.mark.parametrize(
    ("matrix", "word"),
    [
        ([[1.0, 1.1], [1.1, 1.0]], "indefinite"),
        ([[1.0, 0.2], [0.1, 1.0]], "asymmetric"),
        ([[-1.0, 0.0], [0.0, 1.0]], "negative"),
        ([[0.0, 0.1], [0.1, 1.0]], "certain"),
    ],
)
def test_checks_see_a_broken_covariance(matrix: list[list[float]], word: str) -> None:
    """Each rule of a covariance is checked."""
    assert any(word in text for text in FUZZ.covariance_broken(np.array(matrix)))
    assert FUZZ.covariance_broken(np.eye(2) * 1e-18) == []


@pytest.mark.parametrize("name", RECIPES)
@pytest.mark.parametrize("shape", [(1, 0), (0, 5), (0, 0)])
def test_empty_tracks(name: str, shape: tuple[int, int]) -> None:
    """No rows or no tracks give empty estimates, with or without a prior."""
    estimator = make_estimator(name, position(2, 1.0))
    z, t = np.zeros((*shape, 2)), np.zeros(shape)
    for prior in (None, Prior(np.zeros(4), np.eye(4))):
        for estimates in (estimator.run(z, t, prior=prior), estimator.smooth(z, t, prior=prior)):
            assert estimates.status.shape == shape
            assert estimates.covariance.shape == (*shape, 4, 4)


@pytest.mark.parametrize("name", RECIPES)
def test_nothing_ever_measured(name: str) -> None:
    """A track of gaps is MISSING or STARTING, finite, and wide."""
    estimates = make_estimator(name, position(2, 1.0)).run(np.full((1, 5, 2), np.nan), np.arange(5.0))
    assert FUZZ.broken(estimates) == []
    assert not (estimates.status == OK).any()
    assert (np.diagonal(estimates.covariance[0, 0])[:2] > 1e6).all()


def test_a_single_row() -> None:
    """One row is a start."""
    for sensor in (position(2, 1.0), range_bearing((1.0, 0.1)), bearing(0.1)):
        estimates = make_estimator("imm", sensor).run(np.ones((1, 1, sensor.size)), [0.0])
        assert FUZZ.broken(estimates) == []


@pytest.mark.parametrize("bad", [np.inf, -np.inf, 1e300])
def test_broken_measurement_is_reported_and_ignored(bad: float) -> None:
    """A component out of this world is as good as missing, and REPAIRED says so."""
    z = np.cumsum(np.ones((6, 2)), axis=0)
    gap = z.copy()
    z[3], gap[3] = bad, np.nan
    estimator = make_estimator("imm", position(2, 1.0))
    broken, missing = (estimator.run(rows, np.arange(6.0)) for rows in (z, gap))
    assert broken.status[0, 3] == REPAIRED and missing.status[0, 3] == MISSING
    np.testing.assert_array_equal(broken.position, missing.position)


@pytest.mark.parametrize("when", [np.nan, np.inf, -np.inf, 1.0])
def test_step_at_no_time(when: float) -> None:
    """A time that is none, or lies in the past, counts as the present one and is reported."""
    estimator = make_estimator("imm", position(2, 1.0))
    state = estimator.start([0.0, 0.0], 5.0)
    following, estimates = estimator.step(state, [1.0, 0.0], when)
    _, expected = estimator.step(state, [1.0, 0.0], 5.0)
    assert estimates.status == REPAIRED and estimates.times == 5.0 and following.time[0] == 5.0
    np.testing.assert_array_equal(estimates.position, expected.position)


@pytest.mark.parametrize(
    "noise",
    [np.diag([-1.0, 1.0]), np.diag([np.nan, 1.0]), [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [-0.5, 1.0]]],
)
def test_step_with_no_covariance(noise: object) -> None:
    """A noise matrix that is none is reported."""
    estimator: BankEstimator = make_estimator("imm", position(2, 1.0))
    _, estimates = estimator.step(estimator.start([0.0, 0.0], 0.0), [1.0, 0.0], 1.0, np.array(noise))
    assert estimates.status == REPAIRED


def test_many_digits_cancel() -> None:
    """A thousand kilometres of prior and a nanometre of noise: the posterior is a covariance, and the noise's."""
    estimator = make_estimator("ukf-ct", range_bearing((1e-9, 1e-15)))
    prior = Prior([1e6, 1e6, 0.0, 0.0], np.diag([1e12, 1e12, 1.0, 1.0]))
    estimates = estimator.run([[np.hypot(1e6, 1e6), np.pi / 4]], [0.0], prior=prior)
    assert FUZZ.broken(estimates) == []
    # The bearing of a target whose place is unknown by its whole distance is far from linear: metres would be
    # luck, but the short form of the update leaves a negative variance here.
    assert (np.diagonal(estimates.covariance[0, 0])[:2] < 1e12).all()
