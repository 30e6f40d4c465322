"""Pieces: kernels compiled once each and called through an address, so that no caller compiles them again.

Numba links and optimises the whole code of every function it calls, at every level of nesting. A bank built of
plain calls took 80 s to compile, most of it the same algebra optimised six times over. A piece is compiled as one
unit; its address travels in the ``pieces`` table of the program, and a call costs two nanoseconds.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba import cfunc, types
from numba.core import config
from numba.core.typing.templates import Signature
from numba.extending import intrinsic
from numpy.typing import NDArray

from jink.estimators.compiled import COMPILE_OPTIONS
from jink.estimators.reference import reference_type

__all__ = ["MATRIX", "PROGRAM", "STACK", "VECTOR", "WORK", "compile_pieces", "piece", "piece_addresses"]

VECTOR = types.Array(types.float64, 1, "C")
MATRIX = types.Array(types.float64, 2, "C")
STACK = types.Array(types.float64, 3, "C")
PROGRAM, WORK = "program", "work"
_ORDER = (
    "predict_mode", "measure_mode", "careful_covariance", "update_mode", "mode_kinematics", "prepare_noise",
    "adapt_noise", "finish_treated", "hedge", "convert", "birth", "interact", "fuse", "_restart_poor_modes", "step",
)  # fmt: skip
"""A piece's number is in the machine code of its callers, so it may not depend on which module is imported first."""
_registered: dict[int, tuple[Callable[..., Any], Any, tuple[Any, ...]]] = {}
_LONGEST = ("predict_mode", "step")  # half of all compile time
_addresses: list[int] = []
_compiled: dict[int, Any] = {}
_LOG = logging.getLogger("jink.compiled")


def piece(returns: Any, *arguments: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make a kernel into a piece; its first argument is the program, its name is listed in ``_ORDER``.

    Args:
        returns: Numba type of the result.
        arguments: Numba types; names given to `record_type` stand for references to those records.

    Returns:
        A decorator; the decorated function is called like any kernel.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        number = _ORDER.index(function.__name__)
        _registered[number] = (function, returns, arguments)
        if config.DISABLE_JIT:
            return function

        def codegen(context: Any, builder: Any, signature: Signature, values: Any) -> Any:
            record = signature.args[0].record
            table = record.fields.index("pieces")
            program = builder.bitcast(values[0], context.get_value_type(record).as_pointer())
            field = builder.load(builder.gep(program, [ir.IntType(32)(0), ir.IntType(32)(table)]))
            array = context.make_array(record.types[table])(context, builder, field)
            address = builder.load(builder.gep(array.data, [ir.IntType(64)(number)]))
            kinds = [context.get_value_type(kind) for kind in signature.args]
            kind = ir.FunctionType(context.get_value_type(signature.return_type), kinds)
            return builder.call(builder.inttoptr(address, kind.as_pointer()), values)

        names = [f"a{i}" for i in range(len(arguments))]
        namespace: dict[str, Any] = {"resolve": lambda given: (_signature(returns, arguments, given), codegen)}
        source = f"def {function.__name__}(context, {', '.join(names)}):\n    return resolve(({', '.join(names)},))\n"
        exec(source, namespace)
        return intrinsic(namespace[function.__name__])

    return decorate


def _signature(returns: Any, arguments: tuple[Any, ...], given: tuple[Any, ...]) -> Any:
    kinds = [given[i] if isinstance(kind, str) else kind for i, kind in enumerate(arguments)]
    return returns(*kinds)


def piece_addresses() -> NDArray[np.int64]:
    """Addresses of all pieces, compiled (or loaded from the cache) on the first call."""
    if not _addresses:
        importlib.import_module("jink.estimators.cycle")  # which imports the modules of all pieces
        numbers = list(range(len(_ORDER)))
        if not config.DISABLE_JIT:
            with _second_compiler(numbers) as mine:
                for number in mine:
                    _compile(number)
        for number in numbers:
            _addresses.append(0 if config.DISABLE_JIT else int(_compile(number).address))
    return np.array(_addresses or [0], dtype=np.int64)


def compile_pieces(numbers: list[int]) -> None:
    """Compile some pieces into the cache on disk."""
    for number in numbers:
        _compile(number)


def _compile(number: int) -> Any:
    if number not in _compiled:
        function, returns, arguments = _registered[number]
        kinds = [reference_type(kind) if isinstance(kind, str) else kind for kind in arguments]
        _compiled[number] = cfunc(returns(*kinds), _nrt=False, **COMPILE_OPTIONS)(function)
    return _compiled[number]


@contextlib.contextmanager
def _second_compiler(numbers: list[int]) -> Iterator[list[int]]:
    """Share a first compilation with a second process; yields the numbers that are left for this one.

    Whatever the other process could not do is compiled here afterwards, so its failure costs time and nothing else.
    """
    folder = Path(__file__).parent / "__pycache__"
    cached = config.CACHE_DIR or any(folder.glob("modes.predict_mode-*.nbi"))
    if cached or (os.cpu_count() or 1) < 2 or not sys.executable or not os.access(folder, os.W_OK):
        yield numbers
        return
    mine = [number for number in numbers if _registered[number][0].__name__ in _LONGEST]
    theirs = [number for number in numbers if number not in mine]
    imports = "import jink.estimators.api\nfrom jink.estimators.pieces import compile_pieces"
    code = f"{imports}\ncompile_pieces({theirs})"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    quiet = subprocess.DEVNULL
    try:
        other = subprocess.Popen([sys.executable, "-c", code], env=environment, stdin=quiet, stdout=quiet, stderr=quiet)
    except OSError as error:
        _LOG.debug("no second process to compile in: %s", error)
        yield numbers
        return
    try:
        yield mine
        other.wait()
    finally:
        other.kill()
        other.wait()
