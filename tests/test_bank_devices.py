"""The bank in torch operations makes every tensor where its inputs lie, so that a GPU can run it; none is needed."""

import numpy as np
import pytest
from stand_in_learner import stand_in_model

from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent

torch = pytest.importorskip("torch")

FACTORIES = ("zeros", "ones", "empty", "full", "eye", "arange", "linspace", "tensor", "as_tensor", "from_numpy", "rand")


class Placed(torch.overrides.TorchFunctionMode):
    """Notes tensors that are made without being told where."""

    def __init__(self):
        super().__init__()
        self.made, self.astray = 0, []
        self.kinds = {getattr(torch, name): name for name in FACTORIES}

    def __torch_function__(self, function, types, arguments=(), options=None):
        options = options or {}
        if function in self.kinds:
            self.made += 1
            if options.get("device") is None:
                self.astray.append(self.kinds[function])
        return function(*arguments, **options)


def model_of(axes, swings):
    made = stand_in_model(axes)
    if not swings:
        return made
    weave = Intent("weave", (Phase(Law(axes, wobble=0.1, swing=(0.5, 0.1)), (Birth(turn_sd=0.1),)),))
    return made.with_(intents=(made.intents[0], weave))


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("swings", [False, True])
@pytest.mark.parametrize("learned", [False, True])
def test_every_tensor_is_told_where_it_lies(axes, swings, learned):
    from jink.intent.bank_torch import ModelParameters, filter_batch, make_batch

    model = model_of(axes, swings)
    if learned:
        model = model.with_(noise_sd=(2.0,) * axes)
    z = np.random.default_rng(0).normal(size=(2, 5, axes)).cumsum(axis=1)
    z[1, 3:] = np.nan
    batch = make_batch(z, np.arange(5.0), 1.0, np.array([5, 3]), speed=10.0)
    parameters = ModelParameters.from_model(model).to("cpu")
    with Placed() as placed:
        found = filter_batch(parameters, batch, operations=True, moments=True)
        found.log_likelihood.sum().backward()
    assert placed.made > 0 and not placed.astray, placed.astray
    assert any(value.grad is not None and value.grad.abs().sum() > 0 for value in parameters.parameters())


def test_what_is_astray_is_seen():
    with Placed() as placed:
        torch.zeros(3)
        torch.eye(2, device="cpu")
    assert placed.made == 2 and placed.astray == ["zeros"]
