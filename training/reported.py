"""What a third-party estimator says of a target, read whatever its form and laid out in arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Reported", "read_reported", "track_arrays"]

_FIELDS = ("position", "velocity", "covariance", "mode_probs", "log_likelihood", "nis", "nis_dof", "status")
_UNKNOWN = -1
"""Status of rows about which nothing was said."""


class Reported(NamedTuple):
    """Columns with any leading axes; NaN (status -1, dof 0) where nothing was said."""

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    covariance: NDArray[np.float64]
    mode_probs: NDArray[np.float64]
    log_likelihood: NDArray[np.float64]
    nis: NDArray[np.float64]
    nis_dof: NDArray[np.int64]
    status: NDArray[np.int64]

    def cut(self, track: int, rows: int) -> Reported:
        """The first rows of one track of a batch."""
        columns: tuple[Any, ...] = tuple(column[track, :rows] for column in self)
        return Reported(*columns)

    def lifted(self) -> Reported:
        """With one leading axis of length 1."""
        columns: tuple[Any, ...] = tuple(np.asarray(column)[None] for column in self)
        return Reported(*columns)


def read_reported(found: Any, lead: tuple[int, ...], axes: int, modes: Sequence[str], name: str) -> Reported:
    """Read one estimate, or many.

    Args:
        found: a position, or a mapping or object with ``position`` and others of its fields.
        lead: leading axes: (), (T,) or (B, T).
        axes: A.
        modes: M names.
        name: of the estimator, for errors.

    Returns:
        the columns; a position covariance (A, A) leaves the velocity's unknown.

    Raises:
        ValueError: no position, a field of another shape, something that is no number, or an unknown status.
    """
    fields = _fields(found, name)
    kin, count = 2 * axes, len(modes)
    shapes = {
        "position": (axes,),
        "velocity": (axes,),
        "covariance": (kin, kin),
        "mode_probs": (count,),
        "log_likelihood": (),
        "nis": (),
        "nis_dof": (),
        "status": (),
    }
    columns: dict[str, Any] = {key: np.full(lead + shape, np.nan) for key, shape in shapes.items()}
    columns["mode_probs"] = np.full((*lead, count), 1.0 / count)
    for key, value in fields.items():
        array = _numbers(value, key, name)
        wanted = lead + shapes[key]
        if key == "covariance" and array.shape == (*lead, axes, axes):
            columns[key][..., :axes, :axes] = array
            continue
        if array.shape != wanted:
            also = f" or {(*lead, axes, axes)}" if key == "covariance" else ""
            raise ValueError(f"{name}: {key} must have shape {wanted}{also}; got {array.shape}. {_hint(key, lead)}")
        columns[key] = array
    dof, status = columns["nis_dof"], columns["status"]
    columns["nis_dof"] = np.where(np.isfinite(dof), dof, 0).astype(np.int64)
    columns["status"] = np.where(np.isfinite(status), status, _UNKNOWN).astype(np.int64)
    given = status[np.isfinite(status)] if "status" in fields else np.zeros(0)
    if not np.isin(given, (0, 1, 2, 3, 4)).all():
        raise ValueError(
            f"{name}: status must be 0 ok, 1 repaired, 2 missing, 3 diverged or 4 starting; got "
            f"{np.setdiff1d(given, (0, 1, 2, 3, 4))[:3].tolist()}. Leave it out if there is nothing to say."
        )
    return Reported(*(np.array(columns[key]) for key in _FIELDS))


def track_arrays(rows: Sequence[Reported], axes: int, modes: Sequence[str], before: int = 0) -> Reported:
    """Rows of one track under each other, with ``before`` unknown ones in front of them."""
    blank = read_reported({"position": np.full((before, axes), np.nan)}, (before,), axes, modes, "")
    if not rows:
        return blank
    stacked = (np.stack(column) for column in zip(*rows, strict=True))
    return Reported(*(np.concatenate(pair) for pair in zip(blank, stacked, strict=True)))


def _fields(found: Any, name: str) -> dict[str, Any]:
    if isinstance(found, Mapping):
        unknown = [str(key) for key in found if key not in (*_FIELDS, "times")]
        if unknown:
            raise ValueError(
                f"{name}: estimate must hold {', '.join(_FIELDS)}; got {', '.join(unknown)}. Rename or drop it."
            )
        fields = {key: found[key] for key in _FIELDS if found.get(key) is not None}
    elif hasattr(found, "position"):
        fields = {key: getattr(found, key) for key in _FIELDS if getattr(found, key, None) is not None}
    else:
        fields = {"position": found}
    if fields.get("position") is None:
        raise ValueError(f"{name}: estimate must hold a position; got {type(found).__name__}. Return one.")
    return fields


def _numbers(value: Any, key: str, name: str) -> NDArray[np.float64]:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: {key} must be numbers; got {type(value).__name__}. Return an array.") from None


def _hint(key: str, lead: tuple[int, ...]) -> str:
    if len(lead) == 1:
        return f"Return one {key} for each row."
    if len(lead) == 2:
        return f"Return one {key} for each row of each track."
    return f"Return the {key} of this row."
