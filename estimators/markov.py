"""How the mode changes: a Markov chain in continuous time, or one matrix per step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm, logm

from jink.estimators.compiled import kernel

__all__ = ["MarkovChain", "check_transition_matrix", "transition_matrix"]

_ROW_TOLERANCE = 1e-8


@kernel
def transition_matrix(generator, dt, modes, scratch, out):
    """``out = expm(generator dt)`` for a Markov generator, by uniformisation and squaring; rows sum to one.

    Only non-negative numbers are added, so no probability is lost to cancellation, for any ``dt >= 0``.
    Source: Jensen (1953), randomisation. Differs: squared ``2^k`` times so that the series stays short.
    """
    rate = 0.0
    for i in range(modes):
        rate = max(rate, -generator[i, i])
    halvings = 0
    scaled = rate * dt
    while scaled > 0.5 and halvings < 1000:
        scaled *= 0.5
        halvings += 1
    for i in range(modes):
        for j in range(modes):
            out[i, j] = 1.0 if i == j else 0.0
    if scaled > 0.0:
        step = scaled / rate
        for order in range(16, 0, -1):  # Horner: I + (A/1)(I + (A/2)(I + ...)) with A = generator step + scaled I
            for i in range(modes):
                for j in range(modes):
                    total = 0.0
                    for k in range(modes):
                        entry = generator[i, k] * step
                        if i == k:
                            entry = max(entry + scaled, 0.0)
                        total += entry * out[k, j]
                    scratch[i, j] = total / order
            for i in range(modes):
                for j in range(modes):
                    out[i, j] = scratch[i, j] + (1.0 if i == j else 0.0)
    _normalise_rows(out, modes)
    for _ in range(halvings):
        for i in range(modes):
            for j in range(modes):
                total = 0.0
                for k in range(modes):
                    total += out[i, k] * out[k, j]
                scratch[i, j] = total
        for i in range(modes):
            for j in range(modes):
                out[i, j] = scratch[i, j]
        _normalise_rows(out, modes)


@kernel
def _normalise_rows(matrix, modes):
    for i in range(modes):
        total = 0.0
        for j in range(modes):
            total += matrix[i, j]
        for j in range(modes):
            matrix[i, j] /= total


def check_transition_matrix(matrix: ArrayLike, modes: int, *, caller: str) -> NDArray[np.float64]:
    """A validated Markov matrix (or a stack of them); (..., M, M), rows = from, sum 1.

    Raises:
        ValueError: wrong shape, an entry outside [0, 1], or a row that does not sum to 1.
    """
    array = np.ascontiguousarray(matrix, dtype=np.float64)
    if array.ndim < 2 or array.shape[-2:] != (modes, modes):
        raise ValueError(
            f"{caller}: mode_transition must have shape ({modes}, {modes}), one row per mode; got {array.shape}. "
            "Row = from, column = to."
        )
    if not np.all((array >= 0) & (array <= 1)):
        raise ValueError(
            f"{caller}: mode_transition must have entries in [0, 1]; got {float(np.nanmin(array)):.6g} to "
            f"{float(np.nanmax(array)):.6g}. Give probabilities."
        )
    sums = array.sum(axis=-1)
    worst = np.abs(sums - 1.0) > _ROW_TOLERANCE
    if worst.any():
        row = np.argwhere(worst)[0]
        raise ValueError(
            f"{caller}: mode_transition must have rows (from) that sum to 1; got row {int(row[-1])} with sum "
            f"{float(sums[tuple(row)]):.9g}. Divide each row by its sum; transpose if columns sum to 1."
        )
    return array


@dataclass(frozen=True)
class MarkovChain:
    """The chain of the modes.

    Model: ``Pr(mode(t + dt) = j | mode(t) = i) = expm(generator dt)[i, j]``, or a fixed ``matrix`` per step
    whatever the step's length. Exactly one of the two is given. Row = from, column = to.

    Args:
        generator: rates 1/s, off-diagonal >= 0, rows sum to 0; (M, M).
        matrix: probabilities per step, rows sum to 1; (M, M).
        factors: set by `beside`: the two chains in continuous time that this one is the product of.

    Raises:
        ValueError: neither or both given, or the given one is no generator or no Markov matrix.
    """

    generator: tuple[tuple[float, ...], ...] | None = None
    matrix: tuple[tuple[float, ...], ...] | None = None
    factors: tuple[MarkovChain, MarkovChain] | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if (self.generator is None) == (self.matrix is None):
            raise ValueError(
                "MarkovChain: exactly one of generator and matrix must be given; got "
                f"{'neither' if self.matrix is None else 'both'}. Use from_sojourns, per_step or from_matrix."
            )
        if self.matrix is not None:
            check_transition_matrix(self.matrix, len(self.matrix), caller="MarkovChain")
            return
        rates = np.asarray(self.generator, dtype=np.float64)
        if rates.ndim != 2 or rates.shape[0] != rates.shape[1]:
            raise ValueError(f"MarkovChain: generator must be square (M, M); got {rates.shape}. One row per mode.")
        off = rates - np.diag(np.diag(rates))
        if (
            not np.all(np.isfinite(rates))
            or np.any(off < 0)
            or np.any(np.abs(rates.sum(axis=1)) > 1e-9 * (1 + off.max(initial=0.0)))
        ):
            raise ValueError(
                "MarkovChain: generator must have off-diagonal rates >= 0 and rows that sum to 0; got "
                f"{rates.tolist()}. Put minus the sum of the other rates on the diagonal."
            )

    @property
    def rates(self) -> NDArray[np.float64]:
        """Generator (M, M), 1/s; only of a chain in continuous time."""
        return np.array(self.generator, dtype=np.float64)

    @property
    def modes(self) -> int:
        """Number of modes M."""
        return len(self.matrix if self.matrix is not None else self.generator or ())

    @classmethod
    def from_sojourns(cls, sojourns: Sequence[float], targets: ArrayLike | None = None) -> MarkovChain:
        """A chain whose mode ``i`` lasts ``sojourns[i]`` seconds on average.

        Args:
            sojourns: mean sojourn times; s; (M,).
            targets: where a switch from ``i`` goes, zero diagonal, rows sum to 1; (M, M); None: evenly.

        Raises:
            ValueError: a sojourn is not positive.
        """
        times = np.asarray(sojourns, dtype=np.float64)
        if times.ndim != 1 or not np.all(times > 0):
            raise ValueError(
                f"from_sojourns: sojourns must be > 0 s, one per mode; got {list(sojourns)}. Give seconds."
            )
        count = len(times)
        if targets is None:
            jump = (np.ones((count, count)) - np.eye(count)) / max(count - 1, 1)
        else:
            jump = check_transition_matrix(targets, count, caller="from_sojourns")
        rates = jump / times[:, None]
        np.fill_diagonal(rates, 0.0)
        np.fill_diagonal(rates, -rates.sum(axis=1))
        return cls(generator=_rows(rates))

    @classmethod
    def per_step(cls, matrix: ArrayLike) -> MarkovChain:
        """A chain that applies ``matrix`` (M, M) once per step, however long the step (the textbook's IMM)."""
        array = np.asarray(matrix, dtype=np.float64)
        return cls(matrix=_rows(check_transition_matrix(array, len(array), caller="per_step")))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, dt: float) -> MarkovChain:
        """The continuous-time chain that equals ``matrix`` (M, M) every ``dt`` seconds.

        Raises:
            ValueError: no chain in continuous time has that matrix (then use `per_step`).
        """
        array = np.asarray(matrix, dtype=np.float64)
        array = check_transition_matrix(array, len(array), caller="from_matrix")
        if not dt > 0:
            raise ValueError(f"from_matrix: dt must be > 0 s; got {dt}. Give the interval the matrix belongs to.")
        rates = np.real(logm(array)) / dt
        off = rates - np.diag(np.diag(rates))
        if off.min() < -1e-9 * max(off.max(), 1e-300) or not np.allclose(expm(rates * dt), array, atol=1e-9):
            raise ValueError(
                f"from_matrix: matrix must be embeddable in continuous time; got {array.tolist()}. "
                "Use MarkovChain.per_step for this one."
            )
        off = np.maximum(off, 0.0)
        return cls(generator=_rows(off - np.diag(off.sum(axis=1))))

    def beside(self, other: MarkovChain) -> MarkovChain:
        """The chain of pairs (mode of this one, mode of ``other``), last index fastest, of two independent chains.

        The generator is the Kronecker sum of theirs, a matrix per step the Kronecker product.

        Raises:
            ValueError: one is in continuous time, the other per step.
        """
        if (self.matrix is None) != (other.matrix is None):
            raise ValueError(
                "MarkovChain.beside: other must be in continuous time if this one is, else per step; got one of each. "
                "Use from_matrix to make a matrix per step continuous."
            )
        if self.matrix is not None:
            return MarkovChain(matrix=_rows(np.kron(np.array(self.matrix), np.array(other.matrix))))
        ours, theirs = np.eye(self.modes), np.eye(other.modes)
        rates = np.kron(np.array(self.generator), theirs) + np.kron(ours, np.array(other.generator))
        return MarkovChain(generator=_rows(rates), factors=(self, other))

    def at(self, dt: float) -> NDArray[np.float64]:
        """Transition matrix (M, M) over ``dt`` seconds (the fixed matrix for a per-step chain)."""
        if self.matrix is not None:
            return np.array(self.matrix)
        out = np.zeros((self.modes, self.modes))
        transition_matrix(np.array(self.generator), float(dt), self.modes, np.zeros_like(out), out)
        return out

    def stationary(self) -> NDArray[np.float64]:
        """Long-run mode probabilities (M,): ``mu = Pi' mu``."""
        if self.matrix is not None:
            system = np.array(self.matrix).T - np.eye(self.modes)
        else:
            system = np.array(self.generator).T
        stacked = np.vstack([system, np.ones(self.modes)])
        right = np.append(np.zeros(self.modes), 1.0)
        solution = np.clip(np.linalg.lstsq(stacked, right, rcond=None)[0], 0.0, None)
        return solution / solution.sum()


def _rows(array: NDArray[np.float64]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in array)
