"""Arrays without a reference count inside compiled code.

Every array that a compiled function takes out of a tuple is counted as in use, and counted back, with an atomic
operation that all threads wait for. Where a function draws a few dozen pixels that costs more than the work.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = ["borrow"]


def _strip(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """The value with the owner of every array in it forgotten."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value=value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        kinds: Any = kind
        items = zip(tuple(kinds), cgutils.unpack_tuple(builder, value), strict=True)
        stripped = [_strip(context, builder, item_kind, item) for item_kind, item in items]
        return context.make_tuple(builder, kind, stripped)
    return value


@intrinsic
def borrow(_context, value):  # type: ignore[no-untyped-def]
    """The same array, or tuple of arrays, uncounted: the caller must keep it alive, as a caller does."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return _strip(context, builder, signature.args[0], arguments[0])

    return value(value), generate
