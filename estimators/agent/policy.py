"""`Policy`: what an agent sees, its network, and what its outputs mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jink.estimators.agent.looking import LARGEST_LOG_INFLATION, VIEWS, view_bounds
from jink.estimators.agent.network import ACTIVATIONS, Network, evaluate_batch, make_network
from jink.estimators.factors import FACTORS

__all__ = ["COVARIANCES", "Policy"]

Floats = NDArray[np.float64]
Layers = tuple[tuple[Floats, Floats], ...]
COVARIANCES = ("chosen", "mixture")
"""How sure an update makes the filter: as the noise chosen says, or as the belief about the noise level says."""
_MOST_LAYERS, _MOST_UNITS = 8, 1024


@dataclass(frozen=True, eq=False)
class Policy:
    """An agent that chooses the noise of each measurement.

    With factors, output i rates factor i and the best is taken; without, the one output is the action a of
    `jink/AdaptiveFactorContinuous-v0`: R is inflated by ``exp((a + 1) / 2 ln 1e6)``, a cut off at -1 .. 1.

    Args:
        layers: weights (out, in) and biases (out,) of each layer.
        skip: weights (O, F) from scaled features straight to the outputs.
        shift, gain: features are ``(x - shift) * gain`` before the first layer; (F,).
        view: what it sees: a key of `VIEWS`; ``plain`` fits sensors of ``components`` components only.
        factors: names of `FACTORS`, one per output; empty: the output is an inflation.
        covariance: one of `COVARIANCES`; ``mixture`` needs the view ``levels``.
        activation: "tanh" or "relu".
        components: of the sensor, for the view ``plain``.
        lookback: the last measurement is judged again with the next one (`jink.estimators.agent.lookback`); needs the
            covariance ``mixture``.
        about: where it comes from; JSON.

    Raises:
        ValueError: shapes that do not fit each other, an unknown name, numbers that are not finite.
    """

    layers: Layers
    skip: Floats
    shift: Floats
    gain: Floats
    view: str = "levels"
    factors: tuple[str, ...] = ()
    covariance: str = "chosen"
    activation: str = "tanh"
    components: int = 2
    lookback: bool = False
    about: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check_choice("view", self.view, VIEWS)
        _check_choice("covariance", self.covariance, COVARIANCES)
        _check_choice("activation", self.activation, ACTIVATIONS)
        for name in self.factors:
            _check_choice("factors", name, FACTORS)
        if len(self.factors) == 1:
            _refuse("factors", "be at least two, or none for an inflation", self.factors)
        if self.covariance == "mixture" and self.view != "levels":
            _refuse("covariance", "be chosen unless the view is levels", self.covariance)
        if type(self.lookback) is not bool:
            _refuse("lookback", "be True or False", repr(self.lookback))
        if self.lookback and self.covariance != "mixture":
            _refuse("lookback", "be False unless the covariance is mixture", self.lookback)
        if type(self.components) is not int or not 1 <= self.components <= 16:
            _refuse("components", "be an integer from 1 to 16", self.components)
        if not 1 <= len(self.layers) <= _MOST_LAYERS:
            _refuse("layers", f"be 1 to {_MOST_LAYERS}", len(self.layers))
        layers = tuple((_floats(weight, 2), _floats(bias, 1)) for weight, bias in self.layers)
        size = self.size_of(self.view, self.components, len(self.factors))
        for weight, bias in layers:
            if weight.shape != (len(bias), size) or not 1 <= len(bias) <= _MOST_UNITS:
                _refuse("layers", f"be (out, {size}) and (out,) with out at most {_MOST_UNITS}", weight.shape)
            size = len(bias)
        if size != max(len(self.factors), 1):
            _refuse("layers", f"end in {max(len(self.factors), 1)} outputs", size)
        for name in ("shift", "gain"):
            object.__setattr__(self, name, _floats(getattr(self, name), 1))
            if len(getattr(self, name)) != layers[0][0].shape[1]:
                _refuse(name, f"have {layers[0][0].shape[1]} numbers", len(getattr(self, name)))
        object.__setattr__(self, "skip", _floats(self.skip, 2))
        if self.skip.shape != (size, len(self.shift)):
            _refuse("skip", f"have shape {(size, len(self.shift))}", self.skip.shape)
        object.__setattr__(self, "layers", layers)
        object.__setattr__(self, "factors", tuple(self.factors))

    @staticmethod
    def size_of(view: str, components: int, factors: int) -> int:
        """Number of features F."""
        seen = len(view_bounds(VIEWS[view], components)[0])
        return seen + (max(factors, 1) if view == "plain" else 0)

    @cached_property
    def network(self) -> Network:
        """Its layers for the compiled core."""
        return make_network(self.layers, self.skip, self.shift, self.gain, self.activation)

    def outputs(self, features: ArrayLike) -> Floats:
        """What the network says; (B, O).

        Args:
            features: observations of the environment, (B, F).

        Raises:
            ValueError: another number of features.
        """
        seen = np.ascontiguousarray(features, dtype=np.float64)
        if seen.ndim != 2 or seen.shape[1] != len(self.shift):
            raise ValueError(
                f"Policy: features must have shape (B, {len(self.shift)}); got {seen.shape}. "
                f"Make the environment with view={self.view!r}."
            )
        out = np.empty((len(seen), max(len(self.factors), 1)))
        evaluate_batch(self.network, seen, out)
        return out

    def act(self, features: ArrayLike, first: ArrayLike | None = None) -> NDArray[Any]:
        """Actions for the environment: numbers of factors (B,), or (B, 1) in -1 .. 1; errors as `outputs`."""
        out = self.outputs(features)
        return out.argmax(axis=1) if self.factors else np.clip(out, -1.0, 1.0)

    def inflations(self, features: ArrayLike) -> Floats:
        """Factors on R (B,) of a policy without factors; errors as `outputs`."""
        return np.asarray(np.exp(0.5 * LARGEST_LOG_INFLATION * (self.act(features)[:, 0] + 1.0)))

    def environment(self) -> dict[str, Any]:
        """Keywords of ``gymnasium.make`` for the environment it plays."""
        told: dict[str, Any] = {"view": self.view, "covariance": self.covariance}
        if self.lookback:
            told["lookback"] = True
        return {**told, "factors": self.factors} if self.factors else told


def _floats(value: Any, dimensions: int) -> Floats:
    array = np.array(value, dtype=np.float64)
    if array.ndim != dimensions or not np.isfinite(array).all():
        _refuse("layers, shift, gain", "hold finite numbers in matrices and vectors", array.shape)
    array.setflags(write=False)
    return array


def _check_choice(name: str, value: Any, choices: Any) -> None:
    if not isinstance(value, str) or value not in choices:
        _refuse(name, f"be one of {', '.join(choices)}", repr(value))


def _refuse(name: str, rule: str, value: Any) -> None:
    raise ValueError(f"Policy: {name} must {rule}; got {value}. Export the policy again.")
