"""How the simulator compiles: as the estimators do, with a check of its own for stale machine code."""

from __future__ import annotations

from pathlib import Path

from jink.estimators import compiled
from jink.estimators.compiled import entry_kernel, inner_kernel, kernel

__all__ = ["entry_kernel", "inner_kernel", "kernel"]

compiled.forget_stale_machine_code(Path(__file__).parent, Path(compiled.__file__).parent)
