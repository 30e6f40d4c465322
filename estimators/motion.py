"""What a motion is: how a state moves, and how it meets other states.

A mode of the bank moves its *own* state vector. Two unlike states meet in kinematics (position and velocity):
a motion says which of its components are position and velocity, and what its *own* parameters are (turn rate,
acceleration, weave amplitude). States whose components carry the usual labels need no further function.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from jink.estimators.compiled import ASSEMBLE, KINEMATICS, NOISE, OWN, TRANSITION, Callback

__all__ = ["Motion", "motion"]

_AXES = "xyz"
_UNITS = {"": "m", "v": "m/s", "a": "m/s^2", "j": "m/s^3"}


@dataclass(frozen=True)
class Motion:
    """How one intent moves: a transition of its own state, process noise, and the way to and from kinematics.

    Model: ``x(t + dt) = transition(x(t), dt) + w``, ``w ~ N(0, Q(dt))``. Without ``noise``, ``Q`` is the integral
    of the flow: ``Q = int_0^dt Phi(s) diag(diffusion) Phi(s)' ds`` with ``Phi`` the Jacobian of the transition.
    Order 1 of the jet is (position, velocity); own parameters are everything else.

    Args:
        name: short name, shown in tables.
        labels: one label per component; ``x y z`` are positions, ``vx vy vz`` velocities, ``ax ay az``
            accelerations, anything else an own parameter.
        axes: number of space dimensions A (1, 2 or 3).
        transition: ``transition(x, dt, params, out)``.
        params: constants handed to every function of this motion.
        units: one unit per component; derived from the labels where it can be.
        diffusion: intensity of the white noise on each component; unit^2/s; ignored when ``noise`` is given.
        noise: ``noise(x, dt, params, out)``; None: the integral above.
        kinematics: ``kinematics(x, params, out)``; needed when positions or velocities are not components.
        assemble: ``assemble(kin, own, params, out)``, the inverse; needed with ``kinematics``.
        own: labels of the own parameters, in the order of ``birth_mean``.
        own_from_jet: ``own_from_jet(jet, params, own)``, own parameters from position, velocity, acceleration.
        jet_order: how many derivatives of position this state leaves free: 1 if its acceleration is pinned by
            the model (constant velocity, known turn rate), 2 if the state carries it (turn rate, acceleration).
        birth_mean, birth_sd: prior of the own parameters when this intent begins; (K,); units of ``own``.
        linear: the transition is a matrix times the state (the filter then needs no sigma points).
        angular: labels of components that are angles (rad), wrapped before they are mixed.

    Raises:
        ValueError: the parts do not fit together; the sentence says which.

    Source: CN202211553542 claims 4-6 (a state of motion parameters per intent); Yuan et al. (2012), unbiased mixing
    of unequal states. Differs: the parameters that kinematics leave open are named (``own``).
    """

    name: str
    labels: tuple[str, ...]
    axes: int
    transition: Callback
    params: tuple[float, ...] = ()
    units: tuple[str, ...] = ()
    diffusion: tuple[float, ...] = ()
    noise: Callback | None = None
    kinematics: Callback | None = None
    assemble: Callback | None = None
    own: tuple[str, ...] | None = None
    own_from_jet: Callback | None = None
    jet_order: int = 1
    birth_mean: tuple[float, ...] = ()
    birth_sd: tuple[float, ...] = ()
    linear: bool = False
    angular: tuple[str, ...] = ()
    _size: int = field(init=False, repr=False, default=0)

    def __post_init__(self) -> None:
        put = object.__setattr__
        n = len(self.labels)
        put(self, "_size", n)
        if n == 0 or len(set(self.labels)) != n:
            raise ValueError(f"Motion: labels must be distinct and at least one; got {self.labels}. Name each once.")
        if self.axes not in (1, 2, 3):
            raise ValueError(f"Motion: axes must be 1, 2 or 3; got {self.axes}. Leave it out to count x, y, z.")
        kinematic = self.kinematic_labels
        missing = [label for label in kinematic if label not in self.labels]
        if missing and (self.kinematics is None or self.assemble is None):
            raise ValueError(
                f"Motion: {self.name} must have components {', '.join(kinematic)}; missing {', '.join(missing)}. "
                "Add them, or pass kinematics= and assemble=."
            )
        if self.own is None:
            skip = set(kinematic) if self.kinematics is None else set()
            put(self, "own", tuple(label for label in self.labels if label not in skip))
        if not self.units:
            put(self, "units", tuple(_unit(label) for label in self.labels))
        if not self.diffusion:
            put(self, "diffusion", (0.0,) * n)
        if not self.birth_mean:
            put(self, "birth_mean", (0.0,) * len(self.own_labels))
        if not self.birth_sd:
            put(self, "birth_sd", (1.0,) * len(self.own_labels))
        self._check_sizes()

    def _check_sizes(self) -> None:
        for name, wanted in (
            ("units", self.size),
            ("diffusion", self.size),
            ("birth_mean", len(self.own_labels)),
            ("birth_sd", len(self.own_labels)),
        ):
            value = getattr(self, name)
            if len(value) != wanted:
                raise ValueError(
                    f"Motion: {name} must have {wanted} entries; got {len(value)}. State is {self.labels}, "
                    f"own parameters are {self.own_labels}."
                )
        for name in ("diffusion", "birth_sd"):
            if any(not value >= 0 for value in getattr(self, name)):
                raise ValueError(f"Motion: {name} must be >= 0; got {getattr(self, name)}. Use 0 for none.")
        unknown = (set(self.own_labels) | set(self.angular)) - set(self.labels)
        if unknown:
            raise ValueError(f"Motion: own and angular must name components; got {sorted(unknown)}. Use {self.labels}.")
        if self.jet_order not in (1, 2):
            raise ValueError(f"Motion: jet_order must be 1 or 2; got {self.jet_order}. Use 1 if in doubt.")

    @property
    def size(self) -> int:
        """Number of state components n."""
        return self._size

    @property
    def own_labels(self) -> tuple[str, ...]:
        """Labels of the own parameters."""
        return self.own or ()

    @property
    def kinematic_labels(self) -> tuple[str, ...]:
        """Labels of position then velocity, as kinematics orders them."""
        axes = _AXES[: self.axes]
        return tuple(axes) + tuple(f"v{axis}" for axis in axes)

    @property
    def cartesian(self) -> bool:
        """Position and velocity are components of the state."""
        return self.kinematics is None

    def with_(self, **changes: object) -> Motion:
        """A copy with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


def _unit(label: str) -> str:
    found = re.fullmatch(r"([vaj]?)([xyz])", label)
    return _UNITS[found.group(1)] if found else "-"


def motion(
    labels: str | Sequence[str],
    *,
    name: str | None = None,
    diffusion: Mapping[str, float] | None = None,
    birth: Mapping[str, tuple[float, float]] | None = None,
    params: Sequence[float] = (),
    linear: bool = False,
    angular: Sequence[str] = (),
    jet_order: int = 1,
) -> Callable[[Callable[..., None]], Motion]:
    """Make a motion out of one small function.

    Args:
        labels: the state's components, for instance ``"x vx y vy w"``.
        name: shown in tables; default: the function's name.
        diffusion: intensity of white noise by label; unit^2/s; others 0.
        birth: mean and standard deviation by own label when the intent begins; others (0, 1).
        params: constants handed to the function.
        linear: the function is a matrix times the state.
        angular: labels of angles (rad).
        jet_order: see `Motion`.

    Returns:
        A decorator from ``f(x, dt, params, out)`` to a `Motion`.

    Raises:
        ValueError: labels repeat, or a mapping names an unknown component.
    """
    names = tuple(labels.split()) if isinstance(labels, str) else tuple(labels)

    def decorate(function: Callable[..., None]) -> Motion:
        axes = max(1, sum(axis in names for axis in _AXES))
        bare = Motion(name or function.__name__, names, axes, Callback(function, TRANSITION))
        for argument, mapping in (("diffusion", diffusion or {}), ("birth", birth or {})):
            unknown = set(mapping) - set(names)
            if unknown:
                raise ValueError(f"motion: {argument} must name components; got {sorted(unknown)}. Use {names}.")
        births = birth or {}
        return bare.with_(
            params=tuple(float(value) for value in params),
            diffusion=tuple(float((diffusion or {}).get(label, 0.0)) for label in names),
            birth_mean=tuple(float(births.get(label, (0.0, 1.0))[0]) for label in bare.own_labels),
            birth_sd=tuple(float(births.get(label, (0.0, 1.0))[1]) for label in bare.own_labels),
            linear=linear,
            angular=tuple(angular),
            jet_order=jet_order,
        )

    return decorate


def callbacks(
    *,
    noise: Callable[..., None] | None = None,
    kinematics: Callable[..., None] | None = None,
    assemble: Callable[..., None] | None = None,
    own_from_jet: Callable[..., None] | None = None,
) -> dict[str, Callback]:
    """The optional functions of a motion as callbacks, ready for ``Motion(..., **callbacks(...))``."""
    given = {
        "noise": (noise, NOISE),
        "kinematics": (kinematics, KINEMATICS),
        "assemble": (assemble, ASSEMBLE),
        "own_from_jet": (own_from_jet, OWN),
    }
    return {key: Callback(function, kind) for key, (function, kind) in given.items() if function is not None}
