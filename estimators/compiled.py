"""How this package compiles: one decorator for kernels, one type for functions that users write.

Kernels are pure Numba functions for one track, cached on disk. A motion or a sensor is a set of small functions
of fixed signatures; each is compiled on first use to a C callback, and kernels call it through its address. An
address is a plain integer, so a bank of unlike motions is an int64 array: it compiles once and caches.

Measured against Numba's first-class functions in a typed list: 8-12 ns a call instead of 20-40, 0.6 us of
dispatch instead of 2-4, and no list type to compile in each process.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from llvmlite import ir
from numba import cfunc, njit, types
from numba.core import config
from numba.extending import intrinsic

__all__ = [
    "ASSEMBLE",
    "KINEMATICS",
    "NOISE",
    "OBSERVE",
    "OWN",
    "TRANSITION",
    "Callback",
    "address_caller",
    "entry_kernel",
    "forget_stale_machine_code",
    "inner_kernel",
    "kernel",
]

if "NUMBA_SLP_VECTORIZE" not in os.environ:  # off in Numba by default; halves the time of the 4-column blocks
    config.SLP_VECTORIZE = 1

_LOG = logging.getLogger("jink.compiled")
COMPILE_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract"}}

kernel = njit(nogil=True, _nrt=False, **COMPILE_OPTIONS)
"""Decorator for compiled functions: cached, without the GIL, IEEE division, fused multiply-add allowed.

They allocate nothing (no reference counting: atomic counters cost more than the algebra of a small matrix).
"""

inner_kernel = njit(nogil=True, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True, **COMPILE_OPTIONS)
"""As `kernel`, for functions that only other kernels call: no Python entry point is compiled."""

entry_kernel = njit(nogil=True, **COMPILE_OPTIONS)
"""As `kernel`, for the few functions that Python calls and that allocate."""

_VECTOR = types.Array(types.float64, 1, "C")
_MATRIX = types.Array(types.float64, 2, "A")

TRANSITION = types.void(_VECTOR, types.float64, _VECTOR, _VECTOR)
"""``transition(x, dt, params, out)``: state (n,) after ``dt`` seconds into ``out`` (n,)."""
NOISE = types.void(_VECTOR, types.float64, _VECTOR, _MATRIX)
"""``noise(x, dt, params, out)``: process noise covariance over ``dt`` into ``out`` (n, n), which starts at zero."""
KINEMATICS = types.void(_VECTOR, _VECTOR, _VECTOR)
"""``kinematics(x, params, out)``: position and velocity of a state into ``out`` (2 A,), positions first."""
ASSEMBLE = types.void(_VECTOR, _VECTOR, _VECTOR, _VECTOR)
"""``assemble(kin, own, params, out)``: the state with kinematics ``kin`` (2 A,) and own parameters ``own`` (K,)."""
OWN = types.void(_VECTOR, _VECTOR, _VECTOR)
"""``own_from_jet(jet, params, own)``: overwrite those of ``own`` (K,) that ``jet`` = p, v, a (3 A,) determines."""
OBSERVE = types.void(_VECTOR, _VECTOR, _VECTOR, _VECTOR)
"""``observe(kin, sensor, params, out)``: noise-free measurement (D,) of kinematics (2 A,) from a sensor (2 A,)."""

_python_functions: dict[int, Callable[..., None]] = {}


class Callback:
    """A small function of a fixed signature, compiled on first use and called by address.

    Args:
        function: Python function in Numba's subset; it writes into its last argument and returns nothing.
        signature: one of the signatures of this module.

    Raises:
        TypeError: ``function`` is not callable or does not take the arguments of ``signature``.
    """

    __slots__ = ("__dict__", "function", "signature")

    def __init__(self, function: Callable[..., None], signature: Any) -> None:
        function = getattr(function, "py_func", function)
        if not callable(function):
            raise TypeError(f"Callback: function must be callable; got {function!r}. Pass a plain Python function.")
        wanted = len(signature.args)
        found = len(inspect.signature(function).parameters)
        if found != wanted:
            raise TypeError(
                f"Callback: {function.__name__} must take {wanted} arguments; got {found}. "
                "See the signatures in jink.estimators.compiled."
            )
        self.function = function
        self.signature = signature

    @functools.cached_property
    def address(self) -> int:
        """Address of the compiled function (with compilation disabled: a key of the Python function)."""
        if config.DISABLE_JIT:
            _python_functions[id(self.function)] = self.function
            return id(self.function)
        return int(self._compiled.address)

    @functools.cached_property
    def _compiled(self) -> Any:
        options = dict(COMPILE_OPTIONS)
        try:
            return cfunc(self.signature, **options)(self.function)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            options["cache"] = False  # a function typed at a prompt has no file to cache beside
            return cfunc(self.signature, **options)(self.function)

    def __call__(self, *arguments: Any) -> None:
        """Run the Python function itself."""
        self.function(*arguments)

    def __repr__(self) -> str:
        return f"Callback({self.function.__module__}.{self.function.__qualname__})"

    def __reduce__(self) -> tuple[Any, ...]:
        return Callback, (self.function, self.signature)


def _emit_call(signature: Any) -> Callable[..., Any]:
    def codegen(context: Any, builder: Any, typed: Any, values: Any) -> Any:
        argument_types = [context.get_value_type(kind) for kind in typed.args[1:]]
        function_type = ir.FunctionType(context.get_value_type(types.none), argument_types)
        builder.call(builder.inttoptr(values[0], function_type.as_pointer()), values[1:])
        return context.get_dummy_value()

    return codegen


def address_caller(signature: Any) -> Callable[..., None]:
    """``call(address, *arguments)`` for functions of one signature given by address, usable inside kernels."""
    typed = types.void(types.int64, *signature.args)
    if config.DISABLE_JIT:

        def call(address: int, *arguments: Any) -> None:
            _python_functions[int(address)](*arguments)

        return call

    # Numba's intrinsics take no *arguments, so the right number of them is written out.
    names = ", ".join(f"a{i}" for i in range(len(signature.args)))
    namespace: dict[str, Any] = {"found": (typed, _emit_call(typed))}
    exec(f"def call_by_address(context, address, {names}):\n    return found\n", namespace)
    return intrinsic(namespace["call_by_address"])


call_transition = address_caller(TRANSITION)
call_noise = address_caller(NOISE)
call_kinematics = address_caller(KINEMATICS)
call_assemble = address_caller(ASSEMBLE)
call_own = address_caller(OWN)
call_observe = address_caller(OBSERVE)


def forget_stale_machine_code(folder: Path, *used: Path) -> None:
    """Remove a package's cached machine code when its sources, or those of packages whose kernels it calls, changed.

    Numba compares only the file of the outermost function, so a kernel that calls a changed helper of another
    file would keep running the old one.

    Args:
        folder: the package; its ``__pycache__`` folders hold the machine code.
        used: further packages whose kernels it calls.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for package in (folder, *used):
        for source in sorted(package.rglob("*.py")):
            stat = source.stat()
            digest.update(f"{source.relative_to(package)}:{stat.st_mtime_ns}:{stat.st_size};".encode())
    stamp = folder / "__pycache__" / "jink-kernels.stamp"
    try:
        if stamp.exists() and stamp.read_text() == digest.hexdigest():
            return
        stamp.parent.mkdir(exist_ok=True)
        for pattern in ("*.nbi", "*.nbc"):
            for cached in folder.rglob(f"__pycache__/{pattern}"):
                cached.unlink(missing_ok=True)
        partial = stamp.with_suffix(f".{os.getpid()}")
        partial.write_text(digest.hexdigest())
        partial.replace(stamp)
    except OSError as error:  # read-only installation: Numba caches elsewhere and looks at its own stamps
        _LOG.debug("kernel cache not checked: %s", error)


forget_stale_machine_code(Path(__file__).parent)
