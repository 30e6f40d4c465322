"""Named tuples of arrays passed to kernels by reference.

Numba passes a tuple by value: a table of forty arrays is several hundred machine words copied at every call, which
costs more than the filter itself (measured: 11 us a step instead of 2, and minutes of compilation). A reference is
one pointer; its attributes read single fields. A reference made inside a kernel lives as long as that kernel runs; a
pinned record lives as long as its `Pinned` and enters kernels as an integer.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import typeof, types
from numba.core import cgutils, config
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
)

from jink.estimators.compiled import entry_kernel

__all__ = ["Pinned", "by_reference", "pin", "record_type", "reference_reader", "reference_type"]

_POINTER = ir.IntType(8).as_pointer()


class ReferenceType(types.Type):
    """Type of a pointer to a named tuple."""

    def __init__(self, record: Any) -> None:
        self.record = record
        super().__init__(name=f"Reference({record.name})")

    @property
    def key(self) -> Any:
        """Identity of the type."""
        return self.record


@register_model(ReferenceType)
class _ReferenceModel(models.PrimitiveModel):
    def __init__(self, manager: Any, front_type: Any) -> None:
        super().__init__(manager, front_type, _POINTER)


@infer_getattr
class _ReferenceAttribute(AttributeTemplate):
    key = ReferenceType

    def generic_resolve(self, reference: ReferenceType, attribute: str) -> Any:
        fields = reference.record.fields
        return reference.record.types[fields.index(attribute)] if attribute in fields else None


@lower_getattr_generic(ReferenceType)
def _load_field(context: Any, builder: Any, reference: ReferenceType, value: Any, attribute: str) -> Any:
    record = context.get_value_type(reference.record)
    zero, index = ir.IntType(32)(0), ir.IntType(32)(reference.record.fields.index(attribute))
    field = builder.gep(builder.bitcast(value, record.as_pointer()), [zero, index])
    found = reference.record.types[int(index.constant)]
    return impl_ret_borrowed(context, builder, found, builder.load(field))


_examples: dict[str, Callable[[], Any]] = {}


def record_type(name: str, example: Callable[[], Any]) -> str:
    """Name a kind of record; ``example`` makes one, to read its type from."""
    _examples[name] = example
    return name


def reference_type(name: str) -> ReferenceType:
    """Numba type of a reference to a named kind of record."""
    return ReferenceType(typeof(_examples[name]()))


class Pinned(NamedTuple):
    """A record laid out in memory for kernels: ``handle`` goes in, the rest keeps it alive."""

    handle: Any
    record: Any
    buffer: Any


if config.DISABLE_JIT:

    def pin(record: Any) -> Pinned:
        """The record itself is its handle."""
        return Pinned(record, record, None)

    def reference_reader(name: str) -> Callable[[Any], Any]:
        """From a handle to the record: nothing to do."""
        return lambda handle: handle

    def by_reference(record: Any) -> Any:
        """The tuple itself: plain Python passes references anyway."""
        return record

else:

    @intrinsic
    def by_reference(_: Any, record: Any) -> Any:
        """Reference to a named tuple, valid until the calling function returns; keep the tuple alive beyond it."""

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.bitcast(cgutils.alloca_once_value(builder, arguments[0]), _POINTER)

        return ReferenceType(record)(record), codegen

    @intrinsic
    def _store(_: Any, record: Any, buffer: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            value = arguments[0]
            for index, kind in enumerate(signature.args[0].types):
                if isinstance(kind, types.Array):  # borrowed: the pinned record, not Numba, keeps the array alive
                    array = context.make_array(kind)(context, builder, builder.extract_value(value, index))
                    array.meminfo = ir.Constant(array.meminfo.type, None)
                    array.parent = ir.Constant(array.parent.type, None)
                    value = builder.insert_value(value, array._getvalue(), index)
            data = context.make_array(signature.args[1])(context, builder, arguments[1]).data
            builder.store(value, builder.bitcast(data, value.type.as_pointer()))
            return context.get_dummy_value()

        return types.void(record, buffer), codegen

    @entry_kernel
    def _lay_out(record: Any, buffer: Any) -> None:
        _store(record, buffer)

    def pin(record: Any) -> Pinned:
        """Lay a named tuple of arrays and numbers out in memory."""
        buffer = np.zeros((len(record) + 1, 16), dtype=np.int64)
        _lay_out(record, buffer)
        return Pinned(buffer.ctypes.data, record, buffer)

    def reference_reader(name: str) -> Callable[[Any], Any]:
        """Function for kernels, from the handle of a pinned record to a reference."""

        @intrinsic
        def read(_: Any, handle: Any) -> Any:
            def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                return builder.inttoptr(arguments[0], _POINTER)

            return reference_type(name)(types.int64), codegen

        return read
