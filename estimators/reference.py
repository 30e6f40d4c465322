"""Named tuples of arrays passed to kernels by reference.

Numba passes a tuple by value: a table of forty arrays is several hundred machine words copied at every call, which
costs more than the filter itself (measured: 11 us a step instead of 2, and minutes of compilation). A reference is
one pointer; its attributes read single fields. It lives only as long as the function that took it.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
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

__all__ = ["by_reference"]

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


if config.DISABLE_JIT:

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
