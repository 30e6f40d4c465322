"""A first compilation shared with a second process: the estimators that learn their noise are compiled there.

Half a minute of one core, and nothing in it depends on what the command compiles meanwhile. Both processes write to
the same cache on disk; the command then loads what the other one compiled.
"""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numba import int64, typeof
from numba.core import config

__all__ = ["LEARNING", "Aside", "compile_learning", "learning_signature", "warm_aside"]

LEARNING = ("sage-husa", "vb-noise", "agent")
"""Rungs that learn their noise; they share one compiled recursion."""
_LOG = logging.getLogger("jink.compiled")


def learning_signature() -> tuple[object, ...]:
    """Types of `jink.estimators.adaptive_cycle.advance` in a run of any of `LEARNING`."""
    from jink.estimators.adaptive_estimator import NoiseAdaptation
    from jink.estimators.agent.updating import IDLE
    from jink.estimators.records import History, Inputs, make_outputs, make_state

    indices = np.zeros(0, dtype=np.int64)
    two, three, four, five = (np.zeros((0,) * d) for d in (2, 3, 4, 5))
    records = (
        make_state(0, 0, 0, 0, 0),
        Inputs(two, three, four, three, four, indices, indices),
        make_outputs(0, 0, 0, 0),
        History(four, five),
        three,
    )
    return (typeof(NoiseAdaptation().settings), typeof(IDLE), int64, int64, *map(typeof, records), int64, int64)


def compile_learning() -> None:
    """Compile that recursion into the cache on disk."""
    from jink.estimators.adaptive_cycle import advance

    advance.compile(learning_signature())


class Aside:
    """The other process, if there is one; `wait` before computing one of `LEARNING`."""

    def __init__(self, process: subprocess.Popen[bytes] | None = None) -> None:
        self._process = process

    def busy(self, estimator: str) -> bool:
        """Whether this rung needs what the other process has not finished."""
        return estimator in LEARNING and self._process is not None and self._process.poll() is None

    def wait(self) -> None:
        """Until it has finished, or given up."""
        if self._process is not None:
            self._process.wait()


@contextlib.contextmanager
def warm_aside(estimators: Iterable[str]) -> Iterator[Aside]:
    """Another process compiles while this one goes on; none where the cache has everything, or on a single core.

    Whatever the other process could not do is compiled here afterwards, so its failure costs time and nothing else.

    Args:
        estimators: rungs that will be computed.

    Yields:
        the other process.
    """
    process = _start() if set(estimators) & set(LEARNING) and _cold() else None
    try:
        yield Aside(process)
    finally:
        if process is not None:
            process.kill()
            process.wait()


def _cold() -> bool:
    """Whether a second process would help: two cores, and a cache that both can write and that does not have it."""
    if config.DISABLE_JIT or (os.cpu_count() or 1) < 2 or not sys.executable:
        return False
    import jink.estimators.adaptive_cycle as learning

    folder = Path(config.CACHE_DIR) if config.CACHE_DIR else Path(str(learning.__file__)).parent / "__pycache__"
    return os.access(folder, os.W_OK) and not any(folder.rglob("adaptive_cycle.advance-*.nbi"))


def _start() -> subprocess.Popen[bytes] | None:
    code = "from jink.training.ladder.warming import compile_learning\ncompile_learning()"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    quiet = subprocess.DEVNULL
    try:
        return subprocess.Popen([sys.executable, "-c", code], env=environment, stdin=quiet, stdout=quiet, stderr=quiet)
    except OSError as error:
        _LOG.debug("no second process to compile in: %s", error)
        return None
