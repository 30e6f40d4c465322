"""Wrong input: each gives one clear sentence that names caller, argument, rule, value and remedy."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank, Mode
from jink.estimators.inputs import Prior
from jink.estimators.markov import MarkovChain
from jink.estimators.motion import Motion, motion
from jink.estimators.motions import constant_velocity, coordinated_turn, make_motion
from jink.estimators.recipes import Scales, make_estimator
from jink.estimators.sensor import Sensor
from jink.estimators.sensors import bearing, make_sensor, position, range_bearing, ranges

SENTENCE = re.compile(r"^\w[\w -]*: [^;]+ must [^;]+; .+\. [A-Z`].+\.$", re.DOTALL)
Z, T = np.zeros((3, 2)), np.arange(3.0)


def _estimator() -> BankEstimator:
    return make_estimator("kf-cv", position(2, 1.0))


def _imm() -> BankEstimator:
    return make_estimator("imm", position(2, 1.0))


def _cv(name: str = "cv", axes: int = 2) -> Mode:
    return Mode(name, constant_velocity(axes))


def _bank(**changes: object) -> Bank:
    options: dict[str, object] = {
        "modes": (_cv("a"), _cv("b")),
        "sensor": position(2),
        "chain": MarkovChain.from_sojourns([5.0, 5.0]),
    }
    return Bank(**{**options, **changes})  # type: ignore[arg-type]


def _motion(**changes: object) -> Motion:
    flow = constant_velocity(1).transition
    options: dict[str, object] = {"name": "m", "labels": ("x", "vx"), "axes": 1, "transition": flow}
    return Motion(**{**options, **changes})  # type: ignore[arg-type]


def _sensor(**changes: object) -> Sensor:
    options: dict[str, object] = {
        "name": "s",
        "labels": ("x",),
        "units": ("m",),
        "axes": 1,
        "observe": position(1).observe,
        "sigma": (1.0,),
    }
    return Sensor(**{**options, **changes})  # type: ignore[arg-type]


@motion("x vx", linear=True)
def _drift(x, dt, params, out):  # type: ignore[no-untyped-def]
    out[0] = x[0] + dt * x[1]
    out[1] = x[1]


KIN = np.zeros(4)
WRONG: dict[str, tuple[Callable[[], object], str]] = {
    # shapes and times of tracks
    "three columns": (lambda: _estimator().run(np.zeros((3, 3)), T), "measurements"),
    "flat measurements": (lambda: _estimator().run(np.zeros(3), T), "measurements"),
    "too few times": (lambda: _estimator().run(Z, T[:2]), "times"),
    "times of another batch": (lambda: _estimator().run(np.zeros((2, 3, 2)), np.zeros((3, 3))), "times"),
    "decreasing times": (lambda: _estimator().run(Z, T[::-1]), "times"),
    "time NaN": (lambda: _estimator().run(Z, [0.0, np.nan, 2.0]), "times"),
    "time inf": (lambda: _estimator().run(Z, [0.0, 1.0, np.inf]), "times"),
    "times of smooth": (lambda: _estimator().smooth(Z, T[::-1]), "times"),
    "lengths too long": (lambda: _estimator().run(Z[None], T, lengths=[4]), "lengths"),
    "lengths negative": (lambda: _estimator().run(Z[None], T, lengths=[-1]), "lengths"),
    "lengths of another batch": (lambda: _estimator().run(Z[None], T, lengths=[1, 2]), "lengths"),
    "lengths broken": (lambda: _estimator().run(Z[None], T, lengths=[1.5]), "lengths"),
    "sensor states short": (lambda: _estimator().run(Z, T, sensor_states=np.zeros(3)), "sensor_states"),
    "sensor states rows": (lambda: _estimator().run(Z, T, sensor_states=np.zeros((2, 4))), "sensor_states"),
    "not numbers": (lambda: _estimator().run([["a", "b"]], [0.0]), "measurements"),
    "ragged": (lambda: _estimator().run([[0.0, 1.0], [0.0]], [0.0, 1.0]), "measurements"),
    # noise
    "noise too large": (lambda: _estimator().run(Z, T, np.eye(3)), "noise"),
    "noise of two rows": (lambda: _estimator().run(Z, T, np.ones((2, 2, 2))), "noise"),
    "variance zero": (lambda: _estimator().run(Z, T, np.diag([1.0, 0.0])), "noise"),
    "variance negative": (lambda: _estimator().run(Z, T, np.diag([1.0, -1.0])), "noise"),
    "noise asymmetric": (lambda: _estimator().run(Z, T, [[1.0, 0.5], [0.0, 1.0]]), "noise"),
    # chains
    "rows not one": (lambda: MarkovChain.per_step([[0.9, 0.2], [0.1, 0.8]]), "mode_transition"),
    "negative probability": (lambda: MarkovChain.per_step([[1.1, -0.1], [0.0, 1.0]]), "mode_transition"),
    "not square": (lambda: MarkovChain.per_step([[0.5, 0.5]]), "mode_transition"),
    "probability NaN": (lambda: MarkovChain.per_step([[np.nan, 1.0], [0.0, 1.0]]), "mode_transition"),
    "nothing given": (MarkovChain, "generator"),
    "both given": (lambda: MarkovChain(((0.0,),), ((1.0,),)), "generator"),
    "generator rows": (lambda: MarkovChain(((-1.0, 0.5), (1.0, -1.0))), "generator"),
    "generator negative": (lambda: MarkovChain(((1.0, -1.0), (1.0, -1.0))), "generator"),
    "generator not square": (lambda: MarkovChain(((0.0, 0.0),)), "generator"),
    "generator NaN": (lambda: MarkovChain(((np.nan, 0.0), (0.0, 0.0))), "generator"),
    "sojourn zero": (lambda: MarkovChain.from_sojourns([1.0, 0.0]), "sojourns"),
    "not embeddable": (lambda: MarkovChain.from_matrix([[0.0, 1.0], [1.0, 0.0]], 1.0), "matrix"),
    "matrix dt": (lambda: MarkovChain.from_matrix(np.eye(2), 0.0), "dt"),
    "chain of run": (lambda: _imm().run(Z, T, mode_transition=np.eye(2)), "mode_transition"),
    "chain rows of run": (lambda: _imm().run(Z, T, mode_transition=np.ones((3, 3))), "mode_transition"),
    # priors
    "prior short": (lambda: _estimator().run(Z, T, prior=Prior(np.zeros(2), np.eye(2))), "mean"),
    "prior cov": (lambda: _estimator().run(Z, T, prior=Prior(KIN, np.eye(3))), "mean"),
    "prior NaN": (lambda: _estimator().run(Z, T, prior=Prior(KIN + np.nan, np.eye(4))), "mean"),
    "prior cov inf": (lambda: _estimator().run(Z, T, prior=Prior(KIN, np.eye(4) * np.inf)), "cov"),
    "prior variance": (lambda: _estimator().run(Z, T, prior=Prior(KIN, -np.eye(4))), "cov"),
    "prior indefinite": (lambda: _estimator().run(Z, T, prior=Prior(KIN, np.ones((4, 4)) * 2 - np.eye(4))), "cov"),
    "prior asymmetric": (lambda: _estimator().run(Z, T, prior=Prior(KIN, np.triu(np.ones((4, 4))))), "cov"),
    "prior modes": (lambda: _imm().run(Z, T, prior=Prior([KIN] * 3, np.eye(4))), "cov"),
    "prior of a mode": (lambda: _imm().run(Z, T, prior=Prior([KIN] * 3, [np.eye(4)] * 3)), "ca"),
    "prior probs": (lambda: _imm().run(Z, T, prior=Prior(KIN, np.eye(4), mode_probs=[0.5, 0.5])), "mode_probs"),
    "prior probs sum": (lambda: _imm().run(Z, T, prior=Prior(KIN, np.eye(4), mode_probs=[1, 1, 1])), "mode_probs"),
    "prior time": (lambda: _estimator().run(Z, T, prior=Prior(KIN, np.eye(4), time=np.nan)), "time"),
    "prior late": (lambda: _estimator().run(Z, T, prior=Prior(KIN, np.eye(4), time=1.0)), "time"),
    # one step, start, forecast
    "step short": (lambda: _estimator().step(_estimator().start(Z[0], 0.0), [1.0], 1.0), "measurement"),
    "step noise": (lambda: _estimator().step(_estimator().start(Z[0], 0.0), Z[0], 1.0, np.eye(3)), "measurement"),
    "start without place": (lambda: _estimator().start([np.nan, np.nan], 0.0), "measurements"),
    "start of bearing": (lambda: make_estimator("kf-cv", bearing(0.1)).start([0.1], 0.0), "measurements"),
    "horizon negative": (lambda: _estimator().forecast(_estimator().start(Z[0], 0.0), -1.0), "horizon"),
    "horizon inf": (lambda: _estimator().forecast(_estimator().start(Z[0], 0.0), np.inf), "horizon"),
    "weights": (lambda: _estimator().forecast(_estimator().start(Z[0], 0.0), 1.0, weights="W3"), "weights"),
    "steps": (lambda: _estimator().forecast(_estimator().start(Z[0], 0.0), 1.0, steps=0), "steps"),
    "forecast horizon": (lambda: _estimator().forecast_run(Z, T, -1.0), "horizon"),
    # banks and recipes
    "no modes": (lambda: _bank(modes=()), "modes"),
    "same names": (lambda: _bank(modes=(_cv(), _cv())), "modes"),
    "axes of a mode": (lambda: _bank(modes=(_cv("a"), _cv("b", 3))), "modes"),
    "no chain": (lambda: _bank(chain=None), "chain"),
    "chain of three": (lambda: _bank(chain=MarkovChain.from_sojourns([1.0] * 3)), "chain"),
    "interaction": (lambda: _bank(interaction="blend"), "interaction"),
    "probs": (lambda: _bank(initial_probs=(0.5, 0.6)), "initial_probs"),
    "probs NaN": (lambda: _bank(initial_probs=(np.nan, 1.0)), "initial_probs"),
    "speed": (lambda: _bank(speed=0.0), "speed"),
    "alpha": (lambda: _bank(alpha=-1.0), "alpha"),
    "beta": (lambda: _bank(beta=np.nan), "beta"),
    "kappa": (lambda: _bank(kappa=-5.0), "kappa"),
    "kappa inf": (lambda: _bank(kappa=np.inf), "kappa"),
    "floor": (lambda: _bank(min_prob=0.6), "min_prob"),
    "area": (lambda: _bank(area=((0.0,), 1.0)), "area"),
    "reset below": (lambda: _bank(reset_prob=-0.1), "reset_prob"),
    "reset NIS": (lambda: _bank(reset_nis=0.0), "reset_nis"),
    "recipe": (lambda: make_estimator("kalman", position()), "name"),
    "threads": (lambda: make_estimator("imm", position(), threads=-1), "threads"),
    "acceleration": (lambda: make_estimator("imm", position(), acceleration=-1.0), "acceleration"),
    "scale": (lambda: Scales(speed=np.inf), "speed"),
    "sojourn": (lambda: Scales(sojourn=0.0), "sojourn"),
    "turn rate": (lambda: Scales(turn_rate=np.nan), "turn_rate"),
    # sensors
    "sigma negative": (lambda: position(2, -1.0), "sigma"),
    "sigma NaN": (lambda: position(2, np.nan), "sigma"),
    "sigma short": (lambda: range_bearing((1.0,)), "sigma"),
    "axes": (lambda: position(4), "axes"),
    "anchors": (lambda: ranges([[0.0], [1.0]]), "anchors"),
    "ray": (lambda: bearing(0.1, range_prior=(-1.0, 1.0)), "range_prior"),
    "sensor name": (lambda: make_sensor("sonar"), "name"),
    "sensor option": (lambda: make_sensor("position", noise=1.0), "options"),
    "sensor units": (lambda: _sensor(units=("m", "m")), "units"),
    "sensor axes": (lambda: _sensor(axes=4), "axes"),
    "sensor sigma": (lambda: _sensor(sigma=(-1.0,)), "sigma"),
    # motions
    "motion name": (lambda: make_motion("straight"), "name"),
    "motion option": (lambda: make_motion("constant-velocity", noise=1.0), "options"),
    "density": (lambda: constant_velocity(2, acceleration_density=-1.0), "acceleration_density"),
    "rate": (lambda: coordinated_turn(rate=np.inf), "rate"),
    "labels twice": (lambda: _motion(labels=("x", "x")), "labels"),
    "label missing": (lambda: _motion(labels=("x", "w")), "components"),
    "motion axes": (lambda: _motion(axes=0), "axes"),
    "diffusion size": (lambda: _motion(diffusion=(1.0,)), "diffusion"),
    "diffusion": (lambda: _motion(diffusion=(0.0, -1.0)), "diffusion"),
    "angular": (lambda: _motion(angular=("psi",)), "angular"),
    "jet order": (lambda: _motion(jet_order=3), "jet_order"),
    "decorator": (lambda: motion("x vx", diffusion={"v": 1.0})(_drift.transition.function), "diffusion"),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_sentence(case: str) -> None:
    """ValueError, and a sentence of the house form that names the argument."""
    call, named = WRONG[case]
    with pytest.raises(ValueError) as caught:
        call()
    text = str(caught.value)
    assert SENTENCE.match(text), text
    assert re.search(rf"\b{re.escape(named)}\b", text), text
    assert "\n" not in text and len(text) < 400, text  # one sentence, not a dump of the input
