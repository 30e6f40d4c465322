"""Two threads for many rows: compiled kernels release the interpreter, and rows do not know each other."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from jink.envs.factor_kernels import WORK

__all__ = ["in_background", "in_halves"]

_WORTH_IT = 256
"""Rows from which handing half of them to a second thread gains more than it costs."""
_pools: dict[int, ThreadPoolExecutor] = {}
_own = threading.local()


def in_halves(kernel: Callable[..., Any], count: int, *arguments: Any) -> None:
    """``kernel(begin, end, *arguments, work)`` over all rows, each thread with scratch of its own."""
    if count < _WORTH_IT or _cores() < 2:
        _run(kernel, 0, count, arguments)
        return
    half = count // 2
    other = _pool().submit(_run, kernel, half, count, arguments)
    _run(kernel, 0, half, arguments)
    other.result()


def in_background(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    """``function(*arguments)`` in the second thread; it must not wait for that thread itself."""
    return _pool().submit(function, *arguments)


def _pool() -> ThreadPoolExecutor:
    process = os.getpid()  # a forked child inherits the pool but not its thread
    if process not in _pools:
        _pools[process] = ThreadPoolExecutor(1, "jink-rows")
    return _pools[process]


def _run(kernel: Callable[..., Any], begin: int, end: int, arguments: tuple[Any, ...]) -> None:
    if not hasattr(_own, "work"):
        _own.work = np.zeros((WORK, 16, 8))
    kernel(begin, end, *arguments, _own.work)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
