"""Policies: the compiled network, their files, and the estimator that runs them beside the environment."""

import json
import pickle

import numpy as np
import pytest
from safetensors.numpy import load, save
from straight_source import Straight
from test_adaptive_factor import Played, episodes_of, torn

from jink.estimators.agent.beliefs import LEVEL_SCALES
from jink.estimators.agent.looking import LEVELS_SIZE
from jink.estimators.agent.policy import Policy
from jink.estimators.agent.policy_file import POLICY_FILE, find_policy, load_policy, pretrained_policies, save_policy
from jink.estimators.agent_estimator import AgentEstimator
from jink.estimators.inputs import Prior
from jink.estimators.motions import constant_velocity
from jink.estimators.recipes import RECIPES, Scales, make_estimator
from jink.estimators.sensors import make_sensor, position

ADVICE = LEVELS_SIZE - 2


def random_policy(
    seed=0, view="levels", factors=(), covariance="chosen", components=2, scale=0.7, lookback=False, **about
):
    """A network of two layers with weights large enough to choose differently from row to row."""
    rng = np.random.default_rng(seed)
    size, out = Policy.size_of(view, components, len(factors)), max(len(factors), 1)
    shapes = [(16, size), (8, 16), (out, 8)]
    layers = tuple((scale * rng.normal(size=shape), scale * rng.normal(size=shape[0])) for shape in shapes)
    skip, shift = 0.1 * rng.normal(size=(out, size)), 0.3 * rng.normal(size=size)
    return Policy(
        layers, skip, shift, np.full(size, 0.5), view=view, factors=factors, covariance=covariance,
        components=components, lookback=lookback, about=about,
    )  # fmt: skip


def by_hand(policy, features):
    """The same network in plain numpy."""
    start = x = (features - policy.shift) * policy.gain
    for number, (weight, bias) in enumerate(policy.layers):
        x = x @ weight.T + bias
        if number < len(policy.layers) - 1:
            x = np.tanh(x) if policy.activation == "tanh" else np.maximum(x, 0.0)
    return x + start @ policy.skip.T


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_the_compiled_network_is_the_one_of_the_book(activation):
    policy = random_policy()
    policy = Policy(policy.layers, policy.skip, policy.shift, policy.gain, activation=activation)
    features = np.random.default_rng(1).normal(size=(50, LEVELS_SIZE))
    # Sums of twenty terms in another order.
    np.testing.assert_allclose(policy.outputs(features), by_hand(policy, features), rtol=1e-12, atol=1e-13)


def test_actions_are_within_the_space_and_the_best_factor_wins():
    features = 5.0 * np.random.default_rng(1).normal(size=(200, LEVELS_SIZE))
    wild = random_policy(scale=3.0)
    actions = wild.act(features)
    assert actions.shape == (200, 1) and np.abs(actions).max() == 1.0
    np.testing.assert_allclose(wild.inflations(features), 1e3 ** (1.0 + actions[:, 0]))
    choosing = random_policy(factors=("none", "huber", "rma"))
    np.testing.assert_array_equal(choosing.act(features), by_hand(choosing, features).argmax(axis=1))
    assert set(choosing.act(features)) == {0, 1, 2}


def test_a_saved_policy_comes_back_to_the_bit(tmp_path):
    for policy in (random_policy(command="x"), random_policy(factors=("none", "chang"), view="plain")):
        again = load_policy(save_policy(policy, tmp_path / policy.view))
        assert again.about == policy.about and again.factors == policy.factors and again.view == policy.view
        features = np.random.default_rng(2).normal(size=(20, len(policy.shift)))
        np.testing.assert_array_equal(again.outputs(features), policy.outputs(features))
        assert find_policy(tmp_path / policy.view).factors == policy.factors


def edit(folder, **changes):
    document = json.loads((folder / POLICY_FILE).read_text())
    (folder / POLICY_FILE).write_text(json.dumps({**document, **changes}))


def poison(folder):
    """Weights that are no numbers, under a hash that fits."""
    import hashlib

    (path,) = folder.glob("weights-*.safetensors")
    tensors = {name: np.array(value) for name, value in load(path.read_bytes()).items()}
    tensors["bias_0"][0] = np.nan
    content = save(tensors)
    digest = hashlib.sha256(content).hexdigest()
    (folder / f"weights-{digest[:16]}.safetensors").write_bytes(content)
    edit(folder, weights=digest)


def pickled(folder):
    (path,) = folder.glob("weights-*.safetensors")
    path.write_bytes(pickle.dumps({"weight_0": 1}))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: edit(folder, version=3), "must have format 'jink policy' and version 1 or 2"),
        (lambda folder: edit(folder, extra=1), "unknown 'extra'"),
        (lambda folder: edit(folder, sizes=[22, 16, 8, 10**6]), "must have sizes"),
        (lambda folder: edit(folder, sizes=[22, 16, 4, 1]), "with shape"),
        (lambda folder: edit(folder, factors=["os.system", "none"]), "factors must be one of"),
        (lambda folder: edit(folder, weights="../" + "0" * 61), "must name its weights by a SHA-256"),
        (lambda folder: edit(folder, view="all"), "view must be one of"),
        (poison, "finite numbers"),
        (pickled, "SHA-256"),
    ],
)
def test_files_of_strangers_are_refused_in_one_sentence(tmp_path, spoil, said):
    folder = save_policy(random_policy(), tmp_path)
    spoil(folder)
    with pytest.raises(ValueError, match="load_policy: ") as caught:
        load_policy(folder)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_policies_that_cannot_be_are_refused():
    good = random_policy()
    parts = good.layers, good.skip, good.shift, good.gain
    for options, said in (
        ({"view": "everything"}, "view must be one of plain, levels"),
        ({"factors": ("none",)}, "factors must be at least two"),
        ({"factors": ("none", "magic")}, "factors must be one of"),
        ({"factors": ("none", "rma")}, "layers must end in 2 outputs"),
        ({"view": "plain", "covariance": "mixture"}, "covariance must be chosen unless"),
        ({"view": "plain"}, "layers must be"),
    ):
        with pytest.raises(ValueError, match="Policy: ") as caught:
            Policy(*parts, **options)
        assert said in str(caught.value)
    with pytest.raises(ValueError, match=r"features must have shape \(B, 22\)"):
        good.outputs(np.zeros((3, 5)))
    with pytest.raises(ValueError, match=r"policy must be one of .*continuous.*; got 'nobody'"):
        find_policy("nobody")


SOURCES = {
    "plane": Straight(sigma=2.0, steps=40, missed=0.3),
    "space": Straight(sigma=2.0, steps=40, missed=0.3, axes=3),
}
KINDS = {
    "inflation": {},
    "honest": {"covariance": "mixture"},
    "looking back": {"covariance": "mixture", "lookback": True},
    "factors looking back": {"factors": ("none", "chang"), "covariance": "mixture", "lookback": True},
    "factors": {"factors": ("none", "mr", "huber", "rma", "mahalanobis")},
    "honest factors": {"factors": ("none", "chang"), "covariance": "mixture"},
    "plain inflation": {"view": "plain"},
    "plain factors": {"view": "plain", "factors": ("none", "huber", "rma")},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SOURCES)
def test_the_estimator_is_the_environment(name, kind):
    """Torn measurements, missing rows and components: what the environment's filter does, the estimator does."""
    source = SOURCES[name]
    policy = random_policy(3, components=source.axes, **KINDS[kind])
    episodes = torn(source, 4)
    run = Played(
        source, episodes, lambda o, i, k: policy.act(o), not policy.factors, lost_after=np.inf, **policy.environment()
    )
    assert np.ptp(run.told("inflation")) > 1.0  # it does not choose the same all the time
    bank = RECIPES["agent"](source.sensor, Scales(acceleration=np.sqrt(source.filter_noise)))
    # The environment ends a lost episode; the estimator would begin again.
    estimator = AgentEstimator(bank.with_(restart=False), policy, threads=1)
    found = estimator.run(episodes.measurements, episodes.times, prior=Prior(episodes.prior_mean, episodes.prior_cov))
    # Two updates and two predictions that round differently, next to positions of some 100 m.
    np.testing.assert_allclose(np.swapaxes(found.position, 0, 1)[:-1], run.told("estimate"), rtol=1e-6, atol=1e-5)
    scale, surge = estimator.noise_run(
        episodes.measurements, episodes.times, prior=Prior(episodes.prior_mean, episodes.prior_cov)
    )
    measured = np.isfinite(episodes.measurements).any(axis=2)[:, :-1]
    np.testing.assert_allclose(scale[:, :-1][measured], run.told("inflation").T[measured].clip(1.0, 1e6), rtol=1e-4)
    assert np.isnan(surge).all() if policy.view == "plain" else ((surge >= 0.0) & (surge <= 1.0)).all()


def test_the_belief_finds_the_level_of_the_noise():
    source = Straight(sigma=2.0, steps=120)
    episodes = episodes_of(source, 20)
    rng = np.random.default_rng(0)
    scale = np.ones((20, 120))
    scale[:, 50:] = LEVEL_SCALES[3]
    z = episodes.truth.position + 2.0 * np.sqrt(scale)[..., None] * rng.normal(size=episodes.measurements.shape)
    skip = np.zeros((1, LEVELS_SIZE))
    skip[0, ADVICE] = 2.0
    advice = Policy(
        ((np.zeros((1, LEVELS_SIZE)), -np.ones(1)),), skip, np.zeros(LEVELS_SIZE), np.ones(LEVELS_SIZE),
        covariance="mixture",
    )  # fmt: skip
    estimator = make_estimator("agent", source.sensor, acceleration=np.sqrt(source.filter_noise), policy=advice)
    chosen, surge = estimator.noise_run(z, episodes.times, prior=Prior(episodes.prior_mean, episodes.prior_cov))
    assert surge[:, 30:50].mean() < 0.1
    assert surge[:, 60:].mean() > 0.85
    assert np.median(chosen[:, 30:50]) < 1.5
    assert 30.0 < np.median(chosen[:, 60:]) < 120.0  # the truth is 64
    told = estimator.run(z, episodes.times, prior=Prior(episodes.prior_mean, episodes.prior_cov))
    plain = make_estimator("kf-cv", source.sensor, acceleration=np.sqrt(source.filter_noise)).run(
        z, episodes.times, prior=Prior(episodes.prior_mean, episodes.prior_cov)
    )
    late = episodes.truth.position[:, 60:]
    ours, nominal = (np.linalg.norm(e.position[:, 60:] - late, axis=2).mean() for e in (told, plain))
    assert ours < 0.75 * nominal


def test_one_policy_serves_every_sensor():
    policy = random_policy()
    for kind, size in (("range-bearing", 2), ("range-bearing-elevation", 3), ("range-bearing-rate", 3)):
        sensor = make_sensor(kind)
        z = np.tile([1000.0, 0.5, 0.2][:size], (30, 1)) + 0.01 * np.random.default_rng(0).normal(size=(30, size))
        found = make_estimator("agent", sensor, policy=policy).run(z, np.arange(30.0))
        assert np.isfinite(found.position).all(), kind


def test_a_plain_policy_refuses_another_sensor_and_names_the_remedy():
    with pytest.raises(ValueError, match="policy must be for 3 components of a measurement; got one for 2"):
        make_estimator("agent", position(3, 1.0), policy=random_policy(view="plain"))
    with pytest.raises(ValueError, match="policy must be left out for imm"):
        make_estimator("imm", position(2, 1.0), policy=random_policy())


def test_states_of_another_policy_are_refused():
    sensor = position(2, 1.0)
    ours, other = (make_estimator("agent", sensor, policy=random_policy(seed)) for seed in (1, 2))
    state = ours.start([0.0, 0.0], 0.0)
    with pytest.raises(ValueError, match="step: state must come from"):
        other.step(state, [0.0, 0.0], 1.0)
    pickled_copy = pickle.loads(pickle.dumps(ours))
    a, b = (one.step(state, [0.1, 0.2], 1.0)[1].position for one in (ours, pickled_copy))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", pretrained_policies())
def test_policies_that_ship_say_where_they_come_from(name):
    policy = find_policy(name)
    assert str(policy.about["command"]).startswith("jink train agent")
    assert policy.about["config"]["seed"] >= 0
    assert policy.view == "levels"  # any sensor


def test_an_agent_that_lost_its_target_says_so_and_begins_again():
    sensor = position(2, 1.0)
    rejects = Policy(
        ((np.zeros((1, LEVELS_SIZE)), np.zeros(1)),), np.zeros((1, LEVELS_SIZE)), np.zeros(LEVELS_SIZE),
        np.ones(LEVELS_SIZE),
    )  # fmt: skip  # R times a thousand, whatever it sees
    rng = np.random.default_rng(0)
    times = np.arange(120) * 0.1
    z = rng.normal(size=(120, 2))
    z[60:] += 2000.0  # the target jumps
    found = make_estimator("agent", sensor, policy=rejects).run(z, times)
    assert (found.status[0, 60:] == 3).any()
    assert np.linalg.norm(found.position[0, -1] - 2000.0) < 20.0
    assert constant_velocity(2).axes == sensor.axes
