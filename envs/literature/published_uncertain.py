"""A linear system with one unknown number, whose steady errors are published in closed form."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from jink.envs.literature.published_truth import Array, PublishedValue, check_number, check_shape, freeze


@dataclass(frozen=True, eq=False)
class UncertainSystem:
    """A linear system with one unknown number in its transition, judged by steady-state variances.

    Model: x[k+1] = F(delta) x[k] + G w, z = H x + v, w and v unit white; F(delta) = F0 + delta F1.

    Args:
        id, title, source: name with version, one line, where it comes from.
        transition, perturbation: F0 and F1, (n, n).
        noise_gain, observation: G (n, q) and H (d, n).
        bound: largest |delta|.
        published: predicted error variance of the first component, by delta.
    Raises:
        ValueError: wrong shapes or a bound that is not positive.
    """

    id: str
    title: str
    source: str
    transition: ArrayLike
    perturbation: ArrayLike
    noise_gain: ArrayLike
    observation: ArrayLike
    bound: float
    published: Mapping[str, PublishedValue] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_number(self.id, "bound", self.bound)
        for name in ("transition", "perturbation", "noise_gain", "observation"):
            object.__setattr__(self, name, freeze(getattr(self, name)))
        n = np.shape(self.transition)[0]
        gain, observation = np.shape(self.noise_gain), np.shape(self.observation)
        for name, shape in (
            ("transition", (n, n)),
            ("perturbation", (n, n)),
            ("noise_gain", (n, gain[-1])),
            ("observation", (observation[0], n)),
        ):
            check_shape(self.id, name, getattr(self, name), shape)
        object.__setattr__(self, "published", MappingProxyType(dict(self.published)))

    def transition_at(self, delta: float) -> Array:
        """F(delta), (n, n).

        Raises:
            ValueError: |delta| above the bound.
        """
        if not abs(delta) <= self.bound:
            raise ValueError(
                f"{self.id}.transition_at: delta must be within +-{self.bound:g}; got {delta!r}. Use a smaller one."
            )
        return np.asarray(self.transition) + delta * np.asarray(self.perturbation)
