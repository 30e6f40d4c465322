"""Pieces: kernels compiled once each and called through an address, so that no caller compiles them again.

Numba links and optimises the whole code of every function it calls, at every level of nesting. A bank built of
plain calls took 80 s to compile, most of it the same algebra optimised six times over. A piece is compiled as one
unit; its address travels in the ``pieces`` table of the program, and a call costs two nanoseconds.
"""

from __future__ import annotations

from collections.abc import Callable
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

__all__ = ["MATRIX", "PROGRAM", "STACK", "VECTOR", "WORK", "piece", "piece_addresses"]

VECTOR = types.Array(types.float64, 1, "C")
MATRIX = types.Array(types.float64, 2, "C")
STACK = types.Array(types.float64, 3, "C")
PROGRAM, WORK = "program", "work"
_registered: list[tuple[Callable[..., Any], Any, tuple[Any, ...]]] = []
_addresses: list[int] = []
_compiled: list[Any] = []


def piece(returns: Any, *arguments: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make a kernel into a piece; its first argument is the program.

    Args:
        returns: Numba type of the result.
        arguments: Numba types; names given to `record_type` stand for references to those records.

    Returns:
        A decorator; the decorated function is called like any kernel.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        number = len(_registered)
        _registered.append((function, returns, arguments))
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
        for function, returns, arguments in _registered:
            if config.DISABLE_JIT:
                _addresses.append(0)
                continue
            kinds = [reference_type(kind) if isinstance(kind, str) else kind for kind in arguments]
            compiled = cfunc(returns(*kinds), _nrt=False, **COMPILE_OPTIONS)(function)
            _compiled.append(compiled)
            _addresses.append(int(compiled.address))
    return np.array(_addresses or [0], dtype=np.int64)
