"""Linear truth: noise against its exact covariance, model error within its bound and against a plain loop."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from jink.envs.flight.model_error import ModelError
from jink.envs.plants import LinearPlant, uncertain_plant
from jink.envs.robust_example import ROBUST_EXAMPLE, robust_example_need, simulate_robust_example
from jink.envs.streams import Draws

MODELS = ("constant-velocity", "constant-acceleration")


def draw(need, rows, seed=5):
    rng = np.random.default_rng(seed)
    return Draws(rng.random((rows, need.uniforms)), rng.standard_normal((rows, need.normals)))


def run(plant, times, rows, seed=5):
    times = np.broadcast_to(times, (rows, len(times)))
    return plant.simulate(times, draw(plant.need(times.shape[1], 1e3), rows, seed))


def states(plant, truth):
    """Position, velocity (, acceleration) axis after axis, (B, T, n)."""
    parts = truth[: 2 + (plant.model == "constant-acceleration")]
    return np.stack(parts, axis=-1).reshape(*truth.position.shape[:2], -1)


def exact(model, axes, density, dt):
    """Transition and noise covariance over ``dt`` by the matrix exponential of van Loan (1978)."""
    n = 1 + MODELS.index(model) + 1
    A = np.eye(n, k=1)
    L = np.zeros((n, n))
    L[-1, -1] = density
    block = expm(np.block([[-A, L], [np.zeros((n, n)), A.T]]) * dt)
    F = block[n:, n:].T
    return np.kron(np.eye(axes), F), np.kron(np.eye(axes), F @ block[:n, n:])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("axes", [2, 3])
def test_noise_has_its_exact_covariance_for_irregular_steps(model, axes):
    rows, density = 20_000, 2.5
    n = axes * (2 + MODELS.index(model))
    mean = tuple(np.arange(1.0, n + 1.0))
    plant = LinearPlant(axes=axes, model=model, density=density, start_mean=mean, start_sigma=(0.5,) * n)
    x = states(plant, run(plant, [0.0, 0.3, 1.7], rows))
    parts = [(x[:, 0] - mean, 0.25 * np.eye(n))]
    for k, dt in ((1, 0.3), (2, 1.4)):
        F, Q = exact(model, axes, density, dt)
        parts.append((x[:, k] - x[:, k - 1] @ F.T, Q))
    for w, Q in parts:
        scale = np.sqrt(np.diag(Q))
        # 4.5 standard errors are 4.5 % of a variance here: 10 % of density, or a wrong power of dt, is outside.
        error = 4.5 * np.sqrt((np.outer(scale, scale) ** 2 + Q**2) / rows)
        assert np.all(np.abs(w.T @ w / rows - Q) < error)
        assert np.all(np.abs(w.mean(0)) < 4.5 * scale / np.sqrt(rows))
    for i, (w, _) in enumerate(parts):
        for other, _ in parts[:i]:
            correlation = (w / w.std(0)).T @ (other / other.std(0)) / rows
            assert np.abs(correlation).max() < 4.5 / np.sqrt(rows)


def test_acceleration_is_the_mean_over_the_last_step_or_the_state():
    times = [0.0, 0.4, 0.4, 2.0]
    truth = run(LinearPlant(), times, 3)
    assert np.all(truth.acceleration[:, [0, 2]] == 0.0)
    assert truth.acceleration[:, 3] == pytest.approx((truth.velocity[:, 3] - truth.velocity[:, 2]) / 1.6)
    still = LinearPlant(model=MODELS[1], density=0.0)
    quiet = run(still, times, 3)
    assert quiet.acceleration[:, 3] == pytest.approx(quiet.acceleration[:, 0])
    assert quiet.velocity[:, 3] == pytest.approx(quiet.velocity[:, 0] + 2.0 * quiet.acceleration[:, 0])


def test_a_step_of_no_length_changes_nothing():
    plant = uncertain_plant()
    x = states(plant, run(plant, [0.0, 1.0, 1.0, 2.0], 4))
    assert np.array_equal(x[:, 1], x[:, 2])
    assert not np.array_equal(x[:, 2], x[:, 3])


@pytest.mark.parametrize("redraw", ["step", "episode"])
def test_the_uncertain_plant_errs_within_its_bound(redraw):
    rows, dt = 4000, 0.1
    plant = uncertain_plant(density=0.0, redraw=redraw, start_mean=(0.0, 40.0, 0.0, 30.0), start_sigma=(0.0,) * 4)
    truth = run(plant, np.arange(6) * dt, rows)
    error = np.diff(truth.position, axis=1) - dt * truth.velocity[:, :-1]
    assert error[..., 1] == pytest.approx(0.0, abs=1e-12)
    delta = error[..., 0] / (0.0198 * 40.0)
    assert np.abs(delta).max() <= 1.0 + 1e-9
    assert np.abs(delta).max() > 0.999
    assert delta[:, 0].mean() == pytest.approx(0.0, abs=4.5 / np.sqrt(3 * rows))
    # A mean square of 1/3 has a standard error of 0.0047: 10 % of gain, 20 % of this, is outside.
    assert np.square(delta[:, 0]).mean() == pytest.approx(1 / 3, abs=4.5 * 0.298 / np.sqrt(rows))
    if redraw == "episode":
        assert delta == pytest.approx(np.broadcast_to(delta[:, :1], delta.shape), abs=1e-9)
    else:
        assert np.abs(np.corrcoef(delta.T) - np.eye(5)).max() < 4.5 / np.sqrt(rows)


def full_error(**options):
    rng = np.random.default_rng(2)
    matrices = {"gain": (4, 2), "of_state": (3, 4), "of_noise": (3, 4)}
    if options.get("kind") == "scalar":
        matrices = {"gain": (4, 2), "of_state": (2, 4), "of_noise": (2, 4)}
    return ModelError(**{name: rng.standard_normal(shape) for name, shape in matrices.items()}, **options)


@pytest.mark.parametrize("kind", ["scalar", "matrix"])
@pytest.mark.parametrize("redraw", ["step", "episode"])
def test_the_plant_is_its_formula(kind, redraw):
    error = full_error(kind=kind, redraw=redraw, bound=0.3)
    plant = LinearPlant(density=1.5, error=error)
    T, times = 6, np.array([0.0, 0.5, 1.0, 1.2, 2.0, 5.0])
    block = draw(plant.need(T, 5.0), 3)
    x = states(plant, plant.simulate(np.broadcast_to(times, (3, T)), block))
    deltas = error.deltas(block.uniforms, block.normals[:, 4 * T :])
    assert deltas.shape == (3, T - 1 if redraw == "step" else 1, 2, len(error.of_state))
    M, Ef, Eg = (np.array(each) for each in (error.gain, error.of_state, error.of_noise))
    for b in range(3):
        state = np.array([1000.0, 30.0, 1000.0, 30.0]) * block.normals[b, :4]
        for k in range(T):
            assert x[b, k] == pytest.approx(state, rel=1e-12, abs=1e-9)
            if k < T - 1:
                F, Q = exact(plant.model, 2, 1.5, times[k + 1] - times[k])
                G, D = np.linalg.cholesky(Q), deltas[b, min(k, deltas.shape[1] - 1)]
                state = (F + M @ D @ Ef) @ state + (G + M @ D @ Eg) @ block.normals[b, 4 * (k + 1) : 4 * (k + 2)]


def test_matrix_errors_are_contractions_of_every_size():
    error = full_error(kind="matrix", bound=0.7)
    block = draw(error.need(50), 200)
    norm = np.linalg.norm(error.deltas(block.uniforms, block.normals), ord=2, axis=(-2, -1)).ravel()
    assert norm.max() <= 0.7 * (1 + 1e-12)
    assert norm.mean() == pytest.approx(0.35, abs=4.5 * 0.7 / np.sqrt(12 * norm.size))


@pytest.mark.parametrize("delta", [-1.0, 0.0, 1.0])
def test_the_robust_example_has_its_covariance(delta):
    rows, steps = 20_000, 60
    error = replace(ROBUST_EXAMPLE, fixed=delta)
    ran = simulate_robust_example(steps, draw(robust_example_need(steps, error), rows), error)
    F = np.array([[0.9802, 0.0196 + 0.0198 * delta * 5.0], [0.0, 0.9802]])
    Q = np.array([[1.9608, 0.0195], [0.0195, 1.9605]])
    H = np.array([1.0, -1.0])
    P = np.eye(2)
    for _ in range(steps - 1):
        P = F @ P @ F.T + Q
    x, z = ran.state[:, -1], ran.measurements[:, -1, 0]
    near = 4.5 * np.sqrt(2 / rows)  # standard errors of a variance
    assert np.diag(x.T @ x / rows) == pytest.approx(np.diag(P), rel=near)
    assert np.mean(z**2) == pytest.approx(H @ P @ H + 1.0, rel=near)
    assert np.var(z - x @ H) == pytest.approx(1.0, rel=near)
    assert np.all(ran.delta == delta)


def test_the_robust_example_is_its_formula():
    steps = 8
    block = draw(robust_example_need(steps), 2)
    ran = simulate_robust_example(steps, block)
    assert ran.delta.shape == (2, steps - 1)
    assert np.abs(ran.delta).max() <= 1.0
    L = np.linalg.cholesky([[1.9608, 0.0195], [0.0195, 1.9605]])
    for k in range(steps - 1):
        noise = block.normals[:, 2 * (k + 1) : 2 * (k + 2)] @ L.T
        x = ran.state[:, k]
        first = 0.9802 * x[:, 0] + (0.0196 + 0.099 * ran.delta[:, k]) * x[:, 1] + noise[:, 0]
        assert ran.state[:, k + 1, 0] == pytest.approx(first, rel=1e-12)
        assert ran.state[:, k + 1, 1] == pytest.approx(0.9802 * x[:, 1] + noise[:, 1], rel=1e-12)


@pytest.mark.parametrize("plant", [LinearPlant(axes=3, model=MODELS[1]), uncertain_plant(), uncertain_plant(3)])
def test_rows_are_bit_for_bit_alone_and_motions_pickle(plant):
    times = np.sort(np.random.default_rng(0).random((5, 40)) * 20.0, axis=1)
    block = draw(plant.need(40, 20.0), 5)
    together = plant.simulate(times, block)
    copy = pickle.loads(pickle.dumps(plant))
    assert copy == plant
    assert hash(copy) == hash(plant)
    for b in range(5):
        alone = copy.simulate(times[b : b + 1], Draws(block.uniforms[b : b + 1], block.normals[b : b + 1]))
        for x, y in zip(together, alone, strict=True):
            assert np.array_equal(x[b : b + 1], y, equal_nan=x.dtype.kind == "f")
    assert np.all(together.intent == 0)
    assert np.isnan(together.switch_times).all()
    assert np.isfinite(together.position).all()
    assert len(plant.intents) == 1


@pytest.mark.parametrize("model", MODELS)
def test_positions_stay_within_the_extent(model):
    plant = LinearPlant(model=model, density=3.0, start_mean=None)
    reached = np.abs(run(plant, np.arange(0.0, 50.0, 5.0), 5000).position).max()
    assert 0.4 * plant.extent(50.0) < reached < plant.extent(50.0)


COLUMN = ((0.1,), (0.0,), (0.0,), (0.0,))
ROW = ((0.0, 1.0, 0.0, 0.0),)
MISTAKES = {
    "LinearPlant: axes must be": lambda: LinearPlant(axes=1),
    "LinearPlant: model must be one of constant-velocity": lambda: LinearPlant(model="singer"),
    "LinearPlant: density must be": lambda: LinearPlant(density=-1.0),
    "LinearPlant: start_mean must be 4 finite": lambda: LinearPlant(start_mean=(0.0, 1.0)),
    "LinearPlant: start_sigma must be 4 finite numbers >= 0": lambda: LinearPlant(start_sigma=(-1.0, 1.0, 1.0, 1.0)),
    "LinearPlant: error must act on 6 states": lambda: LinearPlant(axes=3, error=ModelError(gain=COLUMN, of_state=ROW)),
    "LinearPlant.simulate: times must": lambda: run(LinearPlant(), [1.0, 0.5], 2),
    "LinearPlant.simulate: draws.normals must have 1 rows of 8 or more": lambda: LinearPlant().simulate(
        np.zeros((1, 2)), draw(LinearPlant().need(1, 1.0), 1)
    ),
    "ModelError: gain must be a matrix": lambda: ModelError(gain=(1.0, 2.0), of_state=ROW),
    "ModelError: of_state must have shape (1, 4)": lambda: ModelError(gain=COLUMN, of_state=((1.0,),)),
    "ModelError: of_noise must have shape (1, 4)": lambda: ModelError(gain=COLUMN, of_state=ROW, of_noise=((1.0,),)),
    "ModelError: kind must be one of scalar, matrix": lambda: ModelError(gain=COLUMN, of_state=ROW, kind="vector"),
    "ModelError: kind must be 'matrix'": lambda: ModelError(gain=COLUMN, of_state=ROW * 2),
    "ModelError: redraw must be one of": lambda: ModelError(gain=COLUMN, of_state=ROW, redraw="never"),
    "ModelError: bound must be": lambda: ModelError(gain=COLUMN, of_state=ROW, bound=1.5),
    "ModelError: fixed must be": lambda: ModelError(gain=COLUMN, of_state=ROW, fixed=-2.0),
    "uncertain_plant: axes must": lambda: uncertain_plant(axes=5),
    "simulate_robust_example: draws.uniforms must have 2 rows of 8": lambda: simulate_robust_example(
        9, draw(robust_example_need(5), 2)
    ),
    "simulate_robust_example: steps must": lambda: simulate_robust_example(0, draw(robust_example_need(5), 2)),
    "simulate_robust_example: error must act on 2": lambda: simulate_robust_example(
        5, draw(robust_example_need(5), 2), ModelError(gain=COLUMN, of_state=ROW)
    ),
}


@pytest.mark.parametrize("sentence", MISTAKES)
def test_mistakes_are_named(sentence):
    with pytest.raises(ValueError) as caught:
        MISTAKES[sentence]()
    said = str(caught.value)
    assert said.startswith(sentence)
    assert "; got " in said
    assert said.endswith(".")
