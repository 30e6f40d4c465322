"""Motions and sensors as tables that kernels read: addresses of their functions, parameters, sizes.

Modes of one bank share a state layout, so states of unlike modes can be mixed component by component.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.estimators.motion import Motion
from jink.estimators.multitarget.scan_sensor import ScanSensor

__all__ = ["Moving", "Sensing", "make_moving", "make_sensing"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Moving(NamedTuple):
    """How targets move: J modes of n state components, A axes."""

    transition: Ints  # (J,) addresses
    noise: Ints  # (J,) addresses, 0: integral of the flow
    kinematics: Ints  # (1,) address, 0: components
    index: Ints  # type: ignore[assignment]  # (2 A,) components that are position and velocity
    params: Array  # (J, widest)
    counts: Ints  # (J,) parameters in use
    diffusion: Array  # (J, n)
    angular: Flags  # (n,)
    linear: Flags  # (J,)


class Sensing(NamedTuple):
    """How S sensors see; D components of the largest."""

    observe: Ints  # (S,) addresses
    params: Array  # (S, widest)
    counts: Ints  # (S,) parameters in use
    sizes: Ints  # (S,)
    angular: Flags  # (S, D)
    linear: Flags  # (S,)
    matrix: Array  # (S, D, 2 A), of linear sensors


def make_moving(modes: Sequence[Motion]) -> Moving:
    """Tables of one or several motions.

    Raises:
        ValueError: none given, states of unlike components, or several of which one is not linear.
    """
    modes = tuple(modes)
    layouts = {(mode.labels, mode.axes, mode.cartesian) for mode in modes}
    if len(layouts) != 1:
        raise ValueError(
            f"Pmht: motion must be one motion, or several with the same state; got "
            f"{[' '.join(mode.labels) for mode in modes]}. Combine for instance constant velocity and known turns."
        )
    if len(modes) > 1 and not all(mode.linear for mode in modes):
        names = [mode.name for mode in modes if not mode.linear]
        raise ValueError(
            f"Pmht: motion must be linear when there are several; got {', '.join(names)}. Use linear ones."
        )
    first = modes[0]
    index = [first.labels.index(label) for label in first.kinematic_labels] if first.cartesian else [0] * 2 * first.axes
    return Moving(
        np.array([mode.transition.address for mode in modes], dtype=np.int64),
        np.array([mode.noise.address if mode.noise else 0 for mode in modes], dtype=np.int64),
        np.array([first.kinematics.address if first.kinematics else 0], dtype=np.int64),
        np.array(index, dtype=np.int64),
        *_rows([mode.params for mode in modes]),
        np.array([mode.diffusion for mode in modes], dtype=np.float64),
        np.array([label in first.angular for label in first.labels]),
        np.array([mode.linear for mode in modes]),
    )


def make_sensing(sensors: Sequence[ScanSensor]) -> Sensing:
    """Tables of the sensors of scans."""
    models = [sensor.model for sensor in sensors]
    D, axes = max(model.size for model in models), models[0].axes
    angular = np.zeros((len(models), D), dtype=bool)
    matrix = np.zeros((len(models), D, 2 * axes))
    for s, model in enumerate(models):
        angular[s, : model.size] = model.angular
        if model.linear:
            for c, unit in enumerate(np.eye(2 * axes)):
                seen = np.zeros(model.size)
                model.observe(unit, np.zeros(2 * axes), np.array(model.params, dtype=np.float64), seen)
                matrix[s, : model.size, c] = seen
    return Sensing(
        np.array([model.observe.address for model in models], dtype=np.int64),
        *_rows([model.params for model in models]),
        np.array([model.size for model in models], dtype=np.int64),
        angular,
        np.array([model.linear for model in models]),
        matrix,
    )


def _rows(parameters: Sequence[tuple[float, ...]]) -> tuple[Array, Ints]:
    counts = np.array([len(row) for row in parameters], dtype=np.int64)
    table = np.zeros((len(parameters), max(int(counts.max()), 1)))
    for row, values in zip(table, parameters, strict=True):
        row[: len(values)] = values
    return table, counts
