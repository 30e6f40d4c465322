"""How the simulator compiles: as the estimators do, with a check of its own for stale machine code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import config
from numba.extending import intrinsic

from jink.estimators import compiled
from jink.estimators.compiled import entry_kernel, inner_kernel, kernel

__all__ = ["entry_kernel", "fetch", "inner_kernel", "kernel"]

compiled.forget_stale_machine_code(Path(__file__).parent, Path(compiled.__file__).parent)


def _emit_fetch(context: Any, builder: Any, typed: Any, values: Any) -> Any:
    """``llvm.prefetch`` of one item: for writing, to stay in the caches, data."""
    data = context.make_array(typed.args[0])(context, builder, values[0]).data
    place = builder.bitcast(builder.gep(data, [values[1]]), ir.IntType(8).as_pointer())
    word = ir.IntType(32)
    wanted = ir.FunctionType(ir.VoidType(), [place.type, word, word, word])
    function = builder.module.globals.get("llvm.prefetch.p0") or ir.Function(builder.module, wanted, "llvm.prefetch.p0")
    builder.call(function, [place, word(1), word(3), word(1)])
    return context.get_dummy_value()


def _fetch(context: Any, array: Any, item: Any) -> Any:
    return types.void(array, types.intp), _emit_fetch


def _leave(array: Any, item: Any) -> None:
    """Python waits for memory anyway."""


fetch = _leave if config.DISABLE_JIT else intrinsic(_fetch)
"""``fetch(array, item)`` inside a kernel: the cache line of an item (counted flat, C order) is on its way from memory.

Targets that step together are at unlike samples of their episodes, each a miss of a hundred nanoseconds.
"""
