"""The first compilation happens in a process of its own, so that a first run has the same bits as every later one.

The process that compiled the recursion was seen to differ from those that load it in the last bit, which a training
grows to another model. One explanation: it has the helpers in memory twice, alone and inside their callers, contracted
to fused operations differently. A process that loads the machine code from the disk sees one version only.
"""

from __future__ import annotations

import functools
import logging
import os
import subprocess
import sys
from pathlib import Path

from numba import types
from numba.core import config

__all__ = ["BACKWARD", "FORWARD", "compile_aside", "compile_here"]

_LOG = logging.getLogger("jink.compiled")
_F1, _F2, _F3, _F4, _F5 = (types.Array(types.float64, d, "C") for d in range(1, 6))
_B1, _B2 = (types.Array(types.bool_, d, "C") for d in (1, 2))
_I2 = types.Array(types.int64, 2, "C")
_GIVEN = (_F3, _F3, _F2, _F2, _F1, _F3, _F1, _I2, _F4, _B2, _F2, _F3, types.float64, types.float64)
_PART = (types.int64, types.int64)
FORWARD = (*_GIVEN, _F2, _F3, _F4, _F5, _B1, *_PART)
"""Types of `recursion.forward`."""
BACKWARD = (*_GIVEN, _F2, _F2, _B1, _F3, _F3, _F2, _F2, _F1, _F4, _F3, *_PART)
"""Types of `recursion.backward`."""


def compile_here() -> None:
    """Compile both directions into the cache on disk."""
    from jink.intent.adjoint.recursion import backward, forward

    backward.compile(BACKWARD)
    forward.compile(FORWARD)


@functools.cache
def compile_aside() -> None:
    """Have another process fill the cache where it is empty; where that fails, the caller compiles as it goes."""
    folder = Path(config.CACHE_DIR) if config.CACHE_DIR else Path(__file__).parent / "__pycache__"
    wanted = ("recursion.forward-*.nbi", "recursion.backward-*.nbi")
    if config.DISABLE_JIT or not sys.executable or all(any(folder.rglob(pattern)) for pattern in wanted):
        return
    code = "import jink.intent.adjoint.function\nfrom jink.intent.adjoint.aside import compile_here\ncompile_here()"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        subprocess.run(
            [sys.executable, "-c", code], env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=True
        )
    except (OSError, subprocess.CalledProcessError) as error:
        _LOG.debug("the recursion is compiled here, the last bits of a first run may differ: %s", error)
