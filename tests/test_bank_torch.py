"""The differentiable twin against the compiled bank, its gradients against differences, its two recursions."""

import dataclasses

import numpy as np
import pytest
from numba.core import config

from jink.estimators.sensors import position
from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent, IntentModel

torch = pytest.importorskip("torch")

from jink.intent.adjoint import aside, recursion  # noqa: E402
from jink.intent.bank_torch import ModelParameters, filter_batch, log_likelihood, make_batch  # noqa: E402

SIGMA = 20.0


def plane(second=False):
    """Straight, mirrored turns of two births, a template; and a weave."""
    straight = Phase(Law(2, growth_noise=1e-8, turn_noise=1e-7, wobble=0.1), (Birth(1.0, 0, 0.001, 0, 0.001),))
    turn = Phase(
        Law(2, growth_rate=0.1, growth_noise=1e-6, turn_rate=0.05, turn_mean=0.1, turn_noise=1e-5, wobble=0.2),
        (Birth(0.6, 0, 0.01, 0.1, 0.05), Birth(0.4, 0.005, 0.01, 0.2, 0.05)),
        mirrored=True,
    )
    there = Phase(Law(2, turn_noise=1e-5), (Birth(1.0, 0, 0.01, 0.2, 0.02),), True, 5.0)
    back = Phase(Law(2, turn_noise=1e-5), (Birth(1.0, 0, 0.01, -0.2, 0.02),), True, 5.0)
    intents = (Intent("straight", straight), Intent("turn", turn, renewal=0.01), Intent("jink", (there, back)))
    rates = ((-0.05, 0.03, 0.02), (0.05, -0.05, 0), (0.2, 0, -0.2))
    if second:
        law = Law(2, growth_noise=1e-7, turn_noise=1e-4, swing=(0.7, 0.1))
        intents += (Intent("weave", Phase(law, (Birth(1.0, 0, 0.01, 0, 0.2, 0.2),))),)
        rates = ((-0.06, 0.03, 0.02, 0.01), (0.05, -0.05, 0, 0), (0.1, 0, -0.2, 0.1), (0.1, 0, 0, -0.1))
    return IntentModel(2, intents, rates, speed=100.0)


def space(second=False):
    straight = Phase(Law(3, growth_noise=1e-8, turn_noise=1e-7, wobble=0.1), (Birth(1.0, 0, 0.001, 0, 0.001),))
    law = Law(3, growth_rate=0.1, growth_noise=1e-6, turn_rate=0.05, turn_noise=1e-5, wobble=0.2)
    turn = Phase(law, (Birth(0.6, 0, 0.01, 0, 0.05), Birth(0.4, 0, 0.01, 0, 0.2)))
    intents, rates = (Intent("straight", straight), Intent("turn", turn, renewal=0.01)), ((-0.05, 0.05), (0.05, -0.05))
    if second:
        law = Law(3, growth_noise=1e-7, turn_noise=1e-4, swing=(0.7, 0.1))
        intents += (Intent("weave", Phase(law, (Birth(1.0, 0, 0.01, 0, 0.2, 0.2),))),)
        rates = ((-0.06, 0.03, 0.03), (0.05, -0.05, 0), (0.1, 0, -0.1))
    return IntentModel(3, intents, rates, speed=100.0)


def tracks(axes, count, rows, irregular, seed=0):
    """Straight, then turning, far from the origin, with rows missing anywhere."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.2, 2.0, (count, rows)) if irregular else np.full((count, rows), 1.0)
    course = rng.uniform(0, 6, (count, 1)) + np.cumsum(
        rng.normal(0, 0.1, (count, 1)) * dt * (np.arange(rows) > rows // 2), axis=1
    )
    v = 100 * np.stack([np.cos(course), np.sin(course), 0.1 * np.sin(course)][:axes], axis=-1)
    place = np.cumsum(v * dt[..., None], axis=1) + rng.normal(0, 1e4, (count, 1, axes))
    z = place + SIGMA * rng.standard_normal(place.shape)
    z[rng.random((count, rows)) < 0.15] = np.nan
    return z, np.cumsum(dt, axis=1)


CASES = [
    (make, second, irregular) for make in (plane, space) for second in (False, True) for irregular in (False, True)
]


@pytest.mark.parametrize(("make", "second", "irregular"), CASES)
@pytest.mark.parametrize("operations", [False, True])
def test_equals_the_compiled_bank(make, second, irregular, operations):
    model = make(second)
    z, times = tracks(model.axes, 3, 25, irregular)
    lengths = np.array([25, 25, 18])
    wanted = model.estimator(position(model.axes, SIGMA)).run(z, times, lengths=lengths)
    batch = make_batch(z, times, SIGMA, lengths, speed=model.speed)
    with torch.no_grad():
        found = filter_batch(ModelParameters(model), batch, moments=True, operations=operations)
    assert not found.failed.any()
    used = np.isfinite(z).all(axis=2).cumsum(axis=1) > 0
    used &= np.arange(25) < lengths[:, None]
    # positions are 1e4 m: 1e-9 is some hundred roundings
    np.testing.assert_allclose(found.log_likelihood.numpy(), wanted.log_likelihood, atol=1e-9)
    np.testing.assert_allclose(found.mode_probs.numpy()[used], wanted.mode_probs[used], atol=1e-9)
    np.testing.assert_allclose(found.mean.numpy()[..., : model.axes][used], wanted.position[used], atol=1e-9)
    np.testing.assert_allclose(found.mean.numpy()[..., model.axes :][used], wanted.velocity[used], atol=1e-9)
    scale = np.abs(wanted.covariance[used]).max()
    np.testing.assert_allclose(found.cov.numpy()[used] / scale, wanted.covariance[used] / scale, atol=1e-9)


def test_equals_the_compiled_bank_for_any_noise_and_one_mode():
    rng = np.random.default_rng(3)
    z, times = tracks(2, 2, 15, True, seed=4)
    root = rng.normal(0, 10, (2, 15, 2, 2))
    R = root @ root.swapaxes(2, 3) + 25 * np.eye(2)
    for model in (plane(), IntentModel(2, plane().intents[0], speed=80.0)):
        wanted = model.estimator(position(2, 1.0)).run(z, times, R)
        batch = make_batch(z, times, R, speed=model.speed)
        for operations in (False, True):
            found = filter_batch(ModelParameters(model), batch, operations=operations)
            np.testing.assert_allclose(found.log_likelihood.detach().numpy(), wanted.log_likelihood, atol=1e-9)


def test_equals_the_compiled_bank_where_shapes_are_certain():
    """No growth at all: variances of zero, zero pivots."""
    law = Law(2, turn_noise=1e-5)
    model = IntentModel(2, (Intent("a", Phase(law, (Birth(turn_sd=0.1),))), Intent("b", Phase(Law(2), (Birth(),)))),
                        ((-0.1, 0.1), (0.1, -0.1)), speed=50.0)  # fmt: skip
    z, times = tracks(2, 2, 15, False)
    wanted = model.estimator(position(2, SIGMA)).run(z, times)
    for operations in (False, True):
        parameters = ModelParameters(model)
        found = filter_batch(parameters, make_batch(z, times, SIGMA, speed=50.0), operations=operations)
        np.testing.assert_allclose(found.log_likelihood.detach().numpy(), wanted.log_likelihood, atol=1e-9)
        found.log_likelihood.sum().backward()
        assert all(p.grad is None or torch.isfinite(p.grad).all() for p in parameters.parameters())


# --- parameters


@pytest.mark.parametrize("make", [plane, space])
def test_round_trip(make):
    model = make(True).with_(noise_sd=(3.0, 4.0, 5.0)[: make().axes])
    parameters = ModelParameters.from_model(model)
    back = parameters.to_model(about={"seed": 1})
    assert [intent.name for intent in back.intents] == [intent.name for intent in model.intents]
    for name in ("generator", "initial", "noise_sd", "speed"):
        np.testing.assert_allclose(getattr(back, name), getattr(model, name), rtol=1e-12, atol=1e-15)
    for mode, other in zip(model.modes, back.modes, strict=True):
        assert mode == other
        for found, wanted in ((back.law_of(mode), model.law_of(mode)), (back.birth_of(mode), model.birth_of(mode))):
            for field in dataclasses.fields(wanted):
                a, b = getattr(found, field.name), getattr(wanted, field.name)
                if a is None or b is None:
                    assert a is b
                else:
                    np.testing.assert_allclose(a, b, rtol=1e-12, atol=0, err_msg=field.name)
    np.testing.assert_allclose(parameters.generator().detach().numpy(), model.mode_generator(), atol=1e-15)
    np.testing.assert_allclose(parameters.initial().detach().numpy(), model.mode_initial(), atol=1e-15)
    assert dict(back.about) == {"seed": 1}


def test_tables_are_the_steps_of_the_motions():
    """Every column, through the motion function and its noise at one state."""
    model = plane(True)
    for dt in (0.05, 1.0, 3.0, 30.0, 1e3):
        tables, chain = ModelParameters(model).tables(torch.tensor([dt], dtype=torch.float64))
        bank = model.bank(position(2, 1.0))
        np.testing.assert_allclose(chain[0].detach().numpy(), bank.chain.at(dt), atol=1e-12)
        for mode, row in zip(bank.modes, tables[0].detach().numpy(), strict=True):
            motion = mode.motion
            x = np.array([0, 0, 0, 0, 0.01, 0.2, 0.1])
            out, Q = np.zeros(7), np.zeros((7, 7))
            motion.transition(x, dt, np.array(motion.params), out)
            motion.noise(x, dt, np.array(motion.params), Q)
            wanted = [out[4], out[5], out[6], Q[4, 4], Q[5, 5], Q[5, 6], Q[6, 6], Q[0, 0], Q[0, 1], Q[1, 1]]
            found = [
                row[2] + row[3] * 0.01,
                row[7] + row[8] * 0.2 + row[9] * 0.1,
                row[10] + row[11] * 0.2 + row[12] * 0.1,
                *(row[18], row[26], row[27], row[28], row[29], row[30], row[31]),
            ]
            np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-14)


# --- gradients


@pytest.mark.parametrize("make", [plane, space])
def test_gradient_is_that_of_the_compiled_bank(make):
    """Central differences of the compiled likelihood of exported models, along every kind of parameter."""
    model = make(True).with_(noise_sd=(SIGMA,) * make().axes)
    z, times = tracks(model.axes, 2, 15, True, seed=1)
    parameters = ModelParameters(model)
    log_likelihood(parameters, make_batch(z, times, 1.0, speed=model.speed)).sum().backward()
    gradients = {name: p.grad.clone() for name, p in parameters.named_parameters() if p.grad is not None}
    rng = np.random.default_rng(0)

    def compiled() -> float:
        return parameters.to_model().estimator(threads=1).run(z, times).log_likelihood.sum()

    for name, gradient in gradients.items():
        value = dict(parameters.named_parameters())[name].data
        way = torch.as_tensor(rng.standard_normal(value.shape)) * (value > -600)
        if name == "log_rates":
            way.fill_diagonal_(0.0)
        keep, h, ends = value.clone(), 1e-3, []
        for k in (1, -1, 2, -2):
            value.copy_(keep + k * h * way)
            ends.append(compiled())
        value.copy_(keep)
        slope = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * h)
        # a likelihood of 200 nats carries 1e-12; differences leave 1e-8 beside their own h^4
        assert float((gradient * way).sum()) == pytest.approx(slope, rel=1e-5, abs=2e-7), name
    assert {"turn_mean", "log_noise", "log_natural"} <= set(gradients) or model.axes == 3


@pytest.mark.parametrize("temper", [1.0, 0.4])
@pytest.mark.parametrize(("make", "second", "irregular"), CASES)
def test_both_recursions_have_one_gradient(make, second, irregular, temper):
    model = make(second).with_(noise_sd=(SIGMA,) * make().axes)
    z, times = tracks(model.axes, 2, 9, irregular, seed=2)
    batch = make_batch(z, times, 1.0, speed=model.speed)
    weights = torch.linspace(0.5, 1.5, 9, dtype=torch.float64)
    found = []
    for operations in (True, False):
        parameters = ModelParameters(model)
        result = filter_batch(parameters, batch, temper=temper, operations=operations)
        (result.log_likelihood * weights).sum().backward()
        found.append({name: p.grad for name, p in parameters.named_parameters() if p.grad is not None})
    for name, gradient in found[0].items():
        scale = gradient.abs().max() + 1e-6
        np.testing.assert_allclose(found[1][name] / scale, gradient / scale, atol=1e-9, err_msg=name)


def test_temper_bounds_the_likelihood_from_below():
    model = plane()
    z, times = tracks(2, 4, 20, False)
    batch = make_batch(z, times, SIGMA, speed=model.speed)
    parameters = ModelParameters(model)
    first = [log_likelihood(parameters, batch, temper)[:, :6].sum().item() for temper in (1.0, 0.5, 0.1)]
    assert first[0] > first[1] > first[2]
    for temper in (0.0, 1.5):
        with pytest.raises(ValueError, match=r"temper must be in \(0, 1\]"):
            log_likelihood(parameters, batch, temper)


def test_learning_recovers_the_noise():
    """A few steps of an optimiser: likelihood rises and the learned R finds sigma within 10 %."""
    torch.manual_seed(0)
    model = IntentModel(2, plane().intents[0], noise_sd=(5.0, 60.0), speed=100.0)
    rng = np.random.default_rng(5)
    z = np.cumsum(np.full((25, 40, 2), 50.0), axis=1) + SIGMA * rng.standard_normal((25, 40, 2))
    batch = make_batch(z, np.arange(40.0), 1.0, speed=100.0)
    parameters = ModelParameters(model)
    optimiser = torch.optim.Adam([parameters.log_noise], lr=0.1)
    curve = []
    for _ in range(60):
        optimiser.zero_grad()
        loss = -log_likelihood(parameters, batch).sum() / batch.rows
        loss.backward()
        optimiser.step()
        curve.append(loss.item())
    assert curve[-1] < curve[0] - 0.5
    np.testing.assert_allclose(parameters.to_model().noise_sd, SIGMA, rtol=0.1)  # sd of the estimate is 2.2 %


# --- trouble


@pytest.mark.parametrize("operations", [False, True])
def test_a_track_in_trouble_is_dropped_and_counted(operations):
    model = plane()
    z, times = tracks(2, 3, 12, False)
    R = np.tile(SIGMA**2 * np.eye(2), (3, 12, 1, 1))
    R[1, 6:] = -1e9 * np.eye(2)
    batch = make_batch(z, times, R, speed=model.speed)
    batch.detected[1, 6:] = True
    parameters = ModelParameters(model)
    result = filter_batch(parameters, batch, operations=operations)
    assert result.failed.tolist() == [False, True, False]
    assert (result.log_likelihood[1] == 0).all() and torch.isfinite(result.log_likelihood).all()
    result.log_likelihood.sum().backward()
    found = {name: p.grad for name, p in parameters.named_parameters() if p.grad is not None}
    alone = ModelParameters(model)
    log_likelihood(alone, batch.subset(torch.tensor([0, 2]))).sum().backward()
    for name, p in alone.named_parameters():
        if p.grad is not None:
            np.testing.assert_allclose(found[name], p.grad, rtol=1e-9, atol=1e-12)


def test_all_in_trouble_is_no_exception():
    batch = make_batch(*tracks(2, 2, 6, False), SIGMA, speed=100.0)
    batch = batch._replace(z=batch.z * np.nan)
    for operations in (False, True):
        result = filter_batch(ModelParameters(plane()), batch, operations=operations)
        assert result.failed.all() and (result.log_likelihood == 0).all()


def test_batch_of_tracks_equals_tracks_alone():
    model = plane()
    z, times = tracks(2, 4, 15, True)
    batch = make_batch(z, times, SIGMA, speed=model.speed)
    parameters = ModelParameters(model)
    together = filter_batch(parameters, batch, threads=2).log_likelihood.detach()
    for b in range(4):
        alone = log_likelihood(parameters, make_batch(z[b], times[b], SIGMA, speed=model.speed)).detach()
        np.testing.assert_allclose(alone[0], together[b], atol=1e-10)


def test_threads_share_the_gradient():
    model, found = plane(), []
    batch = make_batch(*tracks(2, 5, 10, False), SIGMA, speed=100.0)
    for threads in (1, 2):
        parameters = ModelParameters(model)
        filter_batch(parameters, batch, threads=threads).log_likelihood.sum().backward()
        found.append(parameters.turn_mean.grad)
    np.testing.assert_allclose(*found, rtol=1e-10)


def test_the_recursion_is_compiled_for_the_types_it_is_compiled_for_beforehand():
    """Else a first run would compile once more, in this process, and may differ in the last bits."""
    if config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    batch = make_batch(*tracks(2, 2, 6, False), SIGMA, speed=100.0)
    log_likelihood(ModelParameters(plane()), batch).sum().backward()
    with torch.no_grad():
        filter_batch(ModelParameters(plane()), batch)
    assert recursion.backward.signatures == [aside.BACKWARD]
    assert recursion.forward.signatures == [aside.FORWARD]


def test_track_without_measurements_counts_nothing():
    z, times = tracks(2, 2, 10, False)
    z[1] = np.nan
    batch = make_batch(z, times, SIGMA, speed=100.0)
    result = filter_batch(ModelParameters(plane()), batch)
    assert not result.failed.any() and (result.log_likelihood[1] == 0).all()
    assert batch.rows == int(np.isfinite(z[0]).all(axis=1).sum()) - 1


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_device_gives_the_same_numbers():
    model = plane(True)
    batch = make_batch(*tracks(2, 3, 12, True), SIGMA, speed=100.0)
    here = log_likelihood(ModelParameters(model), batch).detach()
    there = log_likelihood(ModelParameters(model).to("cuda"), batch.to("cuda")).detach().cpu()
    np.testing.assert_allclose(there, here, atol=1e-8)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: make_batch(np.zeros((3, 4)), np.arange(3.0), 1.0, speed=1.0), r"A 2 or 3; got \(1, 3, 4\)"),
        (lambda: make_batch(np.zeros((3, 2)), np.arange(4.0), 1.0, speed=1.0), r"times must be \(3,\) or \(1, 3\)"),
        (lambda: make_batch(np.zeros((3, 2)), np.arange(3.0), np.ones(5), speed=1.0), r"got \(5,\)"),
        (lambda: make_batch(np.zeros((3, 2)), -np.arange(3.0), 1.0, speed=1.0), "times must not decrease"),
        (
            lambda: filter_batch(
                ModelParameters(plane()), make_batch(np.zeros((3, 3)), np.arange(3.0), 1.0, speed=1.0)
            ),
            "batch must have 2 axes; got 3",
        ),
    ],
)
def test_one_clear_sentence(make, words):
    with pytest.raises(ValueError, match=words):
        make()
