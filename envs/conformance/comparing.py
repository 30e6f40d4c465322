"""Where two results of an environment first differ, and whether they share memory: what the conformance test asks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

__all__ = ["arrays_of", "difference", "rows_of"]


def difference(a: Any, b: Any, place: str = "") -> str:
    """Where two results first differ: "" where they are the same to the bit and the dtype, NaN equal to NaN.

    Args:
        a, b: arrays, numbers, texts, dicts, tuples, lists.
        place: what they are called in the sentence.

    Returns:
        for instance ``infos['time'][3]: 0.5 against 0.25``.
    """
    if type(a) is not type(b):
        return f"{place}: {type(a).__name__} against {type(b).__name__}"
    if isinstance(a, dict):
        if a.keys() != b.keys():
            return f"{place}: only in one of them {sorted(map(str, a.keys() ^ b.keys()))}"
        return next((text for key in a if (text := difference(a[key], b[key], f"{place}[{key!r}]"))), "")
    if isinstance(a, tuple | list):
        if len(a) != len(b):
            return f"{place}: {len(a)} entries against {len(b)}"
        return next((text for i, (x, y) in enumerate(zip(a, b)) if (text := difference(x, y, f"{place}[{i}]"))), "")
    if isinstance(a, np.ndarray):
        return _array_difference(a, b, place)
    same = a == b or (isinstance(a, float | np.floating) and np.isnan(a) and np.isnan(b))
    return "" if same else f"{place}: {a!r} against {b!r}"


def _array_difference(a: Any, b: Any, place: str) -> str:
    if a.shape != b.shape or a.dtype != b.dtype:
        return f"{place}: {a.dtype} {a.shape} against {b.dtype} {b.shape}"
    if a.dtype == object:
        return difference(list(a), list(b), place)
    equal = a == b
    if a.dtype.kind in "fc":
        equal |= np.isnan(a) & np.isnan(b)
    if equal.all():
        return ""
    at = tuple(int(i) for i in np.argwhere(~equal)[0])
    return f"{place}[{', '.join(map(str, at))}]: {a[at]!r} against {b[at]!r}"


def arrays_of(result: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Every array in a result, with its place."""
    if isinstance(result, dict):
        for key, value in result.items():
            yield from arrays_of(value, f"{place}[{key!r}]")
    elif isinstance(result, tuple | list) or (isinstance(result, np.ndarray) and result.dtype == object):
        for i, value in enumerate(result):
            yield from arrays_of(value, f"{place}[{i}]")
    elif isinstance(result, np.ndarray):
        yield place, result


def rows_of(result: Any, row: int, count: int) -> Any:
    """What a batched result says of one environment."""
    if isinstance(result, dict):
        return {key: rows_of(value, row, count) for key, value in result.items()}
    if isinstance(result, tuple | list):
        return tuple(rows_of(value, row, count) for value in result)
    if isinstance(result, np.ndarray) and len(result) == count:
        return result[row]
    return result
