"""A policy's network in the compiled core: a few dense layers, observation scaling inside."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.compiled import entry_kernel, inner_kernel

__all__ = ["ACTIVATIONS", "Network", "evaluate_batch", "evaluate_network", "make_network", "widest"]

Floats = NDArray[np.float64]
ACTIVATIONS = {"tanh": 0, "relu": 1}


class Network(NamedTuple):
    """Layers one after another, as arrays that a kernel reads.

    Model: ``x_0 = (features - shift) * gain``, ``x_{i+1} = act(W_i x_i + b_i)``, the last layer without ``act`` but
    with ``skip x_0`` added: a linear policy beside the network.
    """

    sizes: NDArray[np.int64]  # (L + 1,) inputs, hidden layers, outputs
    weights: Floats  # all W_i, (outputs, inputs), row by row, one after another
    biases: Floats  # all b_i
    skip: Floats  # (outputs, F)
    shift: Floats  # (F,)
    gain: Floats  # (F,)
    activation: int


def make_network(
    layers: tuple[tuple[Floats, Floats], ...], skip: Floats, shift: Floats, gain: Floats, activation: str
) -> Network:
    """A network of layers (W (out, in), b (out,)).

    The sizes are trusted: `Policy` has checked them.
    """
    sizes = [layers[0][0].shape[1], *(len(bias) for _, bias in layers)]
    return Network(
        np.array(sizes, dtype=np.int64),
        np.concatenate([np.ascontiguousarray(weight).ravel() for weight, _ in layers]),
        np.concatenate([np.ascontiguousarray(bias) for _, bias in layers]),
        np.array(skip, dtype=np.float64),
        np.array(shift, dtype=np.float64),
        np.array(gain, dtype=np.float64),
        ACTIVATIONS[activation],
    )


def widest(network: Network) -> int:
    """Columns of the scratch that `evaluate_network` needs."""
    return int(network.sizes.max())


@inner_kernel
def evaluate_network(network, features, scratch):
    """Outputs of the network; ``scratch`` (2, widest) holds them in the row returned."""
    sizes = network.sizes
    for i in range(sizes[0]):
        scratch[0, i] = (features[i] - network.shift[i]) * network.gain[i]
    row, weight, bias = 0, 0, 0
    for layer in range(sizes.size - 1):
        inputs, outputs = sizes[layer], sizes[layer + 1]
        last = layer == sizes.size - 2
        for o in range(outputs):
            total = network.biases[bias + o]
            for i in range(inputs):
                total += network.weights[weight + i] * scratch[row, i]
            weight += inputs
            if last:
                for i in range(sizes[0]):
                    total += network.skip[o, i] * ((features[i] - network.shift[i]) * network.gain[i])
            else:
                total = max(total, 0.0) if network.activation == 1 else math.tanh(total)
            scratch[1 - row, o] = total
        bias += outputs
        row = 1 - row
    return row


@entry_kernel
def evaluate_batch(network, features, out):
    """Outputs (B, O) of features (B, F)."""
    most = 0
    for size in network.sizes:
        most = max(most, size)
    scratch = np.zeros((2, most))
    for b in range(features.shape[0]):
        row = evaluate_network(network, features[b], scratch)
        for o in range(out.shape[1]):
            out[b, o] = scratch[row, o]
