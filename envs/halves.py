"""Two threads for many rows: compiled kernels release the interpreter, and rows do not know each other."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from jink.envs.factor_kernels import WORK

__all__ = ["in_halves"]

_WORTH_IT = 256
"""Rows from which handing half of them to a second thread gains more than it costs."""
_pools: dict[int, ThreadPoolExecutor] = {}


def in_halves(kernel: Callable[..., Any], count: int, *arguments: Any) -> None:
    """``kernel(begin, end, *arguments, work)`` over all rows, each thread with scratch of its own."""
    if count < _WORTH_IT or _cores() < 2:
        kernel(0, count, *arguments, np.zeros((WORK, 16, 8)))
        return
    # Keyed by process: a forked child inherits the pool but not its thread.
    pool = _pools.setdefault(os.getpid(), ThreadPoolExecutor(1, "jink-rows"))
    half = count // 2
    other = pool.submit(kernel, half, count, *arguments, np.zeros((WORK, 16, 8)))
    kernel(0, half, *arguments, np.zeros((WORK, 16, 8)))
    other.result()


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
