"""Surges, sampling and detection do what their parameters say, to better than ten per cent.

Every statistic is one number per episode, and episodes are independent: its mean must lie within five standard errors
of the expected value, and farther away once any parameter is ten per cent off. Five errors: about 60 statistics with
fixed seeds, each beyond five with probability 6e-7.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy import stats

from jink.envs.sampling import SAMPLINGS, TICK, Irregular, Jittered, Regular
from jink.envs.sensing import Sensing
from jink.envs.streams import Draws
from jink.envs.surges import (
    SURGES,
    BiasDrift,
    BiasWalk,
    Contaminated,
    Dropouts,
    Glint,
    HeavyTails,
    IsolatedOutliers,
    MarkovBursts,
    PlacedBursts,
    Ramp,
)
from jink.envs.truth import Truth
from jink.estimators.sensors import position

DT = 0.1


def make_draws(need, episodes, seed):
    rng = np.random.default_rng(seed)
    return Draws(rng.random((episodes, need.uniforms)), rng.standard_normal((episodes, need.normals)))


def surged(surge, episodes=6000, steps=120, dt=DT, seed=1, D=2):
    times = np.tile(np.arange(steps) * dt, (episodes, 1))
    scale, bias = np.ones((episodes, steps)), np.zeros((episodes, steps, D))
    detected = np.ones((episodes, steps), bool)
    surge.apply(times, make_draws(surge.need(steps, steps * dt, D), episodes, seed), scale, bias, detected)
    return scale, bias, detected


def pair(values, lag):
    return (values[:, lag:] * values[:, :-lag]).mean(1)


def bursts_markov(scale, bias, detected):
    on = (scale > 1).astype(float)
    return on.mean(1), pair(on, 5), scale.mean(1), on[:, 0], detected.mean(1)


def markov_expected(on, off, level):
    p, rate = on / (on + off), 1 / on + 1 / off
    return p, p * (p + (1 - p) * math.exp(-rate * 0.5)), 1 + p * (level - 1), p, 1.0


def bursts_uniform(scale, bias, detected):
    on = (scale > 1).astype(float)
    log = np.where(on > 0, np.log(scale), 0.0)
    middle = 0.5 * math.log(4 * 1e4)
    return on.mean(1), pair(on, 4), on[:, 0] * on[:, 4], on[:, -1], (log - middle * on).mean(1), pair(log, 1)


def uniform_expected(on, off):
    # Within a lag shorter than the shortest dwell there is at most one switch, so P(on, on) = p - lag / cycle.
    p, both = on / (on + off), on / (on + off) - 0.4 / (on + off)
    low, high = math.log(4), math.log(1e4)
    return p, both, both, p, 0.0, (p - 0.1 / (on + off)) * (low**2 + low * high + high**2) / 3


def drift(scale, bias, detected):
    lagged, across = (bias[:, 20:] * bias[:, :-20]).mean((1, 2)), (bias[..., 0] * bias[..., 1]).mean(1)
    return (bias**2).mean((1, 2)), (bias[:, 0] ** 2).mean(1), lagged, across


def tails(scale, bias, detected):
    inverse = 1 / scale
    return inverse.mean(1), (inverse**2).mean(1), (inverse < 0.2).mean(1), pair(inverse, 1)


def tails_expected(dof):
    return 1.0, 1 + 2 / dof, stats.chi2(dof).cdf(0.2 * dof), 1.0


CASES = {
    "bursts": (MarkovBursts(1.0, 3.0, 25.0), bursts_markov, markov_expected(1.0, 3.0, 25.0)),
    "bursts-uniform": (MarkovBursts((0.5, 1.5), (2.0, 4.0), (4.0, 1e4)), bursts_uniform, uniform_expected(1.0, 3.0)),
    "dropouts": (
        Dropouts(1.0, 3.0),
        lambda s, b, d: (1 - d.mean(1), pair(1.0 - d, 5), s.mean(1)),
        (*markov_expected(1.0, 3.0, 1.0)[:2], 1.0),
    ),
    "outliers": (
        IsolatedOutliers(0.1, 100.0),
        lambda s, b, d: ((s > 1).mean(1), pair(s > 1, 1), s.mean(1)),
        (0.1, 0.01, 1 + 0.1 * 99),
    ),
    "outliers-spread": (
        IsolatedOutliers(0.1, (4.0, 1e4)),
        lambda s, b, d: ((s > 1).mean(1), np.log(s).mean(1), (np.log(s) ** 2).mean(1)),
        (0.1, 0.1 * math.log(200.0), 0.1 * (math.log(200.0) ** 2 + math.log(2500.0) ** 2 / 12)),
    ),
    "contaminated": (
        Contaminated(0.2, 9.0),
        lambda s, b, d: ((s > 1).mean(1), pair(s > 1, 1), s.mean(1)),
        (0.2, 0.04, 1 + 0.2 * 8),
    ),
    "placed-bursts": (
        PlacedBursts((4.0, 1.0), 25.0, 1.0),
        lambda s, b, d: ((s > 1).sum(1) * DT, s.mean(1)),
        (5.0, 1 + 24 * 5.0 / 12.0),
    ),
    "ramp": (
        Ramp(2.0, 3.0, 1.0, 3.0, 81.0),
        lambda s, b, d: ((s[:, 10] == 1).astype(float), (s[:, 20] == 1).astype(float)),
        (math.exp(-0.5), math.exp(-1.0)),
    ),
    "student-t": (HeavyTails(3.0), tails, tails_expected(3.0)),
    "student-t-below-two": (HeavyTails(1.2), tails, tails_expected(1.2)),
    "glint": (
        Glint(4.0, 0.5, 100.0),
        lambda s, b, d: ((s[:, :80] > 1).mean(1), s[:, :80].mean(1), pair(s > 1, 2), pair(s > 1, 40), s[:, 0] > 1),
        (0.125, 1 + 99 / 8, 0.075, 0.125, 0.125),
    ),
    "bias-drift": (BiasDrift(2.0, 2.0), drift, (4.0, 4.0, 4.0 * math.exp(-1.0), 0.0)),
    "bias-walk": (
        BiasWalk(0.5),
        lambda s, b, d: ((b[:, 100] ** 2).mean(1), ((b[:, 50] - b[:, 10]) ** 2).mean(1), b[:, 0, 0], b[:, 9].prod(1)),
        (2.5, 1.0, 0.0, 0.0),
    ),
}
NUMBERS = [
    (name, entry.name)
    for name, (surge, _, _) in CASES.items()
    for entry in dataclasses.fields(surge)
    if not (name == "ramp" and entry.name in ("rise", "hold", "fall", "scale"))  # exact, below
    and not (name == "placed-bursts" and entry.name == "earliest")
]


EPISODES = {
    "bursts-uniform": 25_000,
    "ramp": 25_000,
    "outliers-spread": 12_000,
    "student-t": 3000,
    "student-t-below-two": 3000,
}


def furthest(name, surge):
    _, measure, expected = CASES[name]
    worst = 0.0
    for values, wanted in zip(measure(*surged(surge, EPISODES.get(name, 6000))), expected, strict=True):
        error = values.std() / math.sqrt(len(values)) + 1e-12
        worst = max(worst, abs(values.mean() - wanted) / error)
    return worst


@pytest.mark.parametrize("name", CASES)
def test_surges_have_the_statistics_of_their_parameters(name):
    assert furthest(name, CASES[name][0]) < 5


@pytest.mark.parametrize(("name", "parameter"), NUMBERS)
def test_the_statistics_see_a_parameter_that_is_ten_per_cent_off(name, parameter):
    surge = CASES[name][0]
    value = getattr(surge, parameter)
    off = tuple(1.1 * end for end in value) if isinstance(value, tuple) else 1.1 * value
    assert furthest(name, dataclasses.replace(surge, **{parameter: off})) > 5


def test_every_kind_of_surge_has_a_case():
    assert {type(surge) for surge, _, _ in CASES.values()} == set(SURGES.values())


def test_uniform_dwells_are_uniform():
    scale, _, _ = surged(MarkovBursts((0.5, 1.5), (2.0, 4.0), 9.0), 200, 4000, 0.01)
    runs = []
    for row in scale > 1:
        edges = np.flatnonzero(np.diff(row.astype(int)))
        runs += [end - start for start, end in itertools.pairwise(edges) if row[end]]
    lengths = np.array(runs) * 0.01
    assert lengths.min() >= 0.49
    assert lengths.max() <= 1.51
    # Lengths are read from samples 0.01 s apart; the spread blurs the distribution by no more than that.
    assert (
        stats.kstest(lengths + np.random.default_rng(0).uniform(-0.01, 0.01, len(lengths)), "uniform", (0.5, 1)).pvalue
        > 1e-3
    )


def test_placed_bursts_are_of_the_given_lengths_and_apart():
    scale, _, _ = surged(PlacedBursts((4.0, 1.0), 25.0, 1.0), 3000)
    assert set(np.unique(scale)) == {1.0, 25.0}
    assert (scale[:, :10] == 1).all()
    ups = (np.diff(scale, axis=1) > 0).sum(1)
    assert set(ups) <= {1, 2}  # they may touch
    assert (np.abs((scale > 1).sum(1) - 50) <= 2).all()
    first = [np.flatnonzero(np.diff(row))[1] - np.flatnonzero(np.diff(row))[0] for row in scale[ups == 2]]
    assert abs(np.mean(np.array(first) > 25) - 0.5) < 5 * 0.5 / math.sqrt(len(first))


def test_a_ramp_is_a_trapezium_of_the_logarithm():
    scale, _, _ = surged(Ramp((2.0, 2.0), 3.0, 1.0, 2.0, 81.0), 2, 200)
    since = (np.arange(200) * DT) % 8.0 - 2.0
    shape = np.clip(np.minimum(since / 3.0, (6.0 - since) / 2.0), 0.0, 1.0)
    np.testing.assert_allclose(np.log(scale[0]), shape * math.log(81.0), atol=1e-9)


def test_student_t_errors_are_student_t():
    scale, _, _ = surged(HeavyTails(3.0), 2000)
    error = np.sqrt(scale).ravel() * np.random.default_rng(5).standard_normal(scale.size)
    assert stats.kstest(error, stats.t(3).cdf).pvalue > 1e-3
    assert stats.kstest(error, stats.t(3.6).cdf).pvalue < 1e-3


def test_surges_combine():
    kinds = (MarkovBursts(), Glint(), BiasDrift(), BiasWalk(), Dropouts())
    B, T = 3, 200
    times = np.tile(np.arange(T) * DT, (B, 1))
    alone = [surged(kind, B, T, seed=4) for kind in kinds]
    scale, bias, detected = np.ones((B, T)), np.zeros((B, T, 2)), np.ones((B, T), bool)
    for kind in kinds:
        kind.apply(times, make_draws(kind.need(T, T * DT, 2), B, 4), scale, bias, detected)
    np.testing.assert_allclose(scale, np.prod([one[0] for one in alone], axis=0), rtol=1e-12)
    np.testing.assert_allclose(bias, np.sum([one[1] for one in alone], axis=0), rtol=1e-12)
    np.testing.assert_array_equal(detected, np.all([one[2] for one in alone], axis=0))


@pytest.mark.parametrize("name", SURGES)
def test_rows_of_a_batch_are_single_episodes_bit_for_bit(name):
    surge = SURGES[name]()
    times = np.cumsum(np.random.default_rng(2).uniform(0.01, 0.3, (5, 150)), axis=1)
    need = surge.need(150, 45.0, 3)
    draws = make_draws(need, 5, 3)
    kept = [array.copy() for array in (*draws, times)]
    batch = np.ones((5, 150)), np.zeros((5, 150, 3)), np.ones((5, 150), bool)
    surge.apply(times, draws, *batch)
    for before, after in zip(kept, (*draws, times), strict=True):
        np.testing.assert_array_equal(before, after)
    for b in range(5):
        single = np.ones((1, 150)), np.zeros((1, 150, 3)), np.ones((1, 150), bool)
        row = Draws(draws.uniforms[b : b + 1].copy(), draws.normals[b : b + 1].copy())
        surge.apply(times[b : b + 1].copy(), row, *single)
        for one, many in zip(single, batch, strict=True):
            np.testing.assert_array_equal(one[0], many[b])
    assert np.isfinite(batch[0]).all()
    assert (batch[0] > 0).all()


def test_regular_gaps_are_one_number():
    times = Regular(400, 0.1).times(make_draws(Regular().need(), 2, 0))
    assert times.shape == (2, 400)
    assert set(np.diff(times[0])) == {round(0.1 / TICK) * TICK}
    assert abs(times[0, -1] - 39.9) < 400 * TICK


GAPS = {
    "jittered": (Jittered(50, 0.2, 0.05), lambda g: (g.mean(1), ((g - 0.2) ** 2).mean(1)), (0.2, 2 * 0.05**2 / 3)),
    "irregular": (
        Irregular(50, 0.2, 1.0),
        lambda g: (g.mean(1), (g > 0.4).mean(1), (g > 0.8).mean(1)),
        (
            0.2 - 1.0 * math.exp(-5) / (1 - math.exp(-5)),
            *((math.exp(-x / 0.2) - math.exp(-5)) / (1 - math.exp(-5)) for x in (0.4, 0.8)),
        ),
    ),
}


@pytest.mark.parametrize(
    ("name", "off"), [(name, off) for name in GAPS for off in (None, "dt", {"jittered": "jitter"}.get(name, "longest"))]
)
def test_gaps_have_the_statistics_of_their_parameters(name, off):
    sampling, measure, expected = GAPS[name]
    if off:
        sampling = dataclasses.replace(sampling, **{off: 1.1 * getattr(sampling, off)})
    gaps = np.diff(sampling.times(make_draws(sampling.need(), 40_000, 7)), axis=1)
    assert (gaps > 0).all()
    worst = max(
        abs(values.mean() - wanted) / (values.std() / math.sqrt(len(values)) + 1e-15)
        for values, wanted in zip(measure(gaps), expected, strict=True)
    )
    assert worst > 5 if off else worst < 5


@pytest.mark.parametrize("name", SAMPLINGS)
def test_sampled_rows_are_single_episodes_and_keep_to_the_duration(name):
    sampling = SAMPLINGS[name]()
    draws = make_draws(sampling.need(), 300, 11)
    times = sampling.times(draws)
    assert (times[:, 0] == 0).all()
    assert (np.diff(times, axis=1) > 0).all()
    assert times.max() <= sampling.duration
    np.testing.assert_array_equal(np.cumsum(np.diff(times, axis=1), axis=1), times[:, 1:])
    single = sampling.times(Draws(draws.uniforms[7:8].copy(), draws.normals[7:8].copy()))
    np.testing.assert_array_equal(single[0], times[7])


def test_an_irregular_episode_never_outlasts_its_duration():
    slow = Irregular(100, 0.1, 10.0)
    times = slow.times(Draws(np.full((1, 99), 0.999), np.empty((1, 0))))
    assert times[0, -1] <= slow.duration
    assert times[0, -1] > 0.999 * slow.duration


@pytest.mark.parametrize("off", [None, "detection_probability", "component_loss"])
def test_detections_and_components_are_lost_as_often_as_said(off):
    sensing = Sensing(position(2, 1.0), detection_probability=0.8, component_loss=0.3)
    if off:
        sensing = dataclasses.replace(sensing, **{off: 1.1 * getattr(sensing, off)})
    B, T = 2000, 50
    zeros = np.zeros((B, T, 2))
    truth = Truth(zeros, zeros, zeros, np.zeros((B, T), np.int8), np.full((B, 1), np.nan))
    detected = np.ones((B, T), bool)
    times = np.tile(np.arange(T) * DT, (B, 1))
    draws = make_draws(sensing.need(T), B, 3)
    sight = sensing.look(times, truth, draws, np.ones((B, T)), np.zeros((B, T, 2)), detected)
    there = ~np.isnan(sight.measurements)
    np.testing.assert_array_equal(detected, there.any(2))
    worst = max(
        abs(values.mean() - wanted) / (values.std() / math.sqrt(B))
        for values, wanted in ((there.mean((1, 2)), 0.8 * 0.7), (detected.mean(1), 0.8 * (1 - 0.3**2)))
    )
    assert worst > 5 if off else worst < 5


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: MarkovBursts(on=(5.0, 1.0)), "MarkovBursts: on must be > 0 or a range (low, high)"),
        (lambda: MarkovBursts(off=-1.0), "MarkovBursts: off must be"),
        (lambda: MarkovBursts(scale="big"), "MarkovBursts: scale must be"),
        (lambda: Dropouts(on=(1.0, 2.0, 3.0)), "Dropouts: on must be"),
        (lambda: IsolatedOutliers(probability=1.2), "IsolatedOutliers: probability must be in [0, 1]; got 1.2"),
        (lambda: Contaminated(scale=float("nan")), "Contaminated: scale must be"),
        (lambda: HeavyTails(0.0), "HeavyTails: dof must be > 0"),
        (lambda: Glint(period=1.0, width=2.0), "Glint: width must be in [0, 1]"),
        (lambda: Ramp(hold=-1.0), "Ramp: hold must be >= 0"),
        (lambda: BiasDrift(time_constant=float("inf")), "BiasDrift: time_constant must be > 0"),
        (lambda: BiasWalk(True), "BiasWalk: rate must be > 0"),
        (lambda: PlacedBursts(lengths=(0.0,)), "PlacedBursts: lengths must be > 0"),
        (lambda: PlacedBursts((30.0, 5.0)).need(100, 9.9, 2), "PlacedBursts: lengths must fit"),
        (lambda: Regular(1), "Regular: steps must be an integer >= 2; got 1"),
        (lambda: Regular(2.5), "Regular: steps must be an integer"),
        (lambda: Regular(10, 0.0), "Regular: dt must be > 0"),
        (lambda: Jittered(10, 0.1, 0.2), "Jittered: jitter must be in [0, 0.045]"),
        (lambda: Irregular(10, 0.1, 0.05), "Irregular: longest must be >= 0.1"),
        (lambda: Sensing(position(2), detection_probability=-0.1), "Sensing: detection_probability must be in [0, 1]"),
        (lambda: Sensing(position(2), latency=float("inf")), "Sensing: latency must be >= 0"),
        (lambda: Sensing("position"), "Sensing: sensor must be a Sensor"),
    ],
)
def test_bad_values_are_refused_in_one_sentence(build, message):
    with pytest.raises(ValueError) as caught:
        build()
    assert message in str(caught.value)
    assert "; got " in str(caught.value)
