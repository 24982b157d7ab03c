"""A pickle of unknown origin: dictionaries, lists, numbers, texts and numpy arrays, and nothing else.

A pickle is a program. This reader runs only the instructions that build plain values, with stand-ins for the functions
that numpy's pickles call. It refuses anything else and trusts no size in the file.
"""

from __future__ import annotations

import io
import math
import os
import pickle
import struct
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes

_DAMAGE = (
    pickle.UnpicklingError, struct.error, EOFError, AttributeError, ImportError, LookupError, TypeError, ValueError,
    ArithmeticError, MemoryError, RecursionError, AssertionError,
)  # fmt: skip

_INSTRUCTIONS = (
    "PROTO FRAME STOP MARK POP POP_MARK NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 FLOAT BINFLOAT "
    "STRING BINSTRING SHORT_BINSTRING UNICODE BINUNICODE SHORT_BINUNICODE BINUNICODE8 BINBYTES SHORT_BINBYTES "
    "BINBYTES8 EMPTY_LIST APPEND APPENDS LIST EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_DICT DICT SETITEM SETITEMS "
    "PUT BINPUT LONG_BINPUT GET BINGET LONG_BINGET MEMOIZE GLOBAL STACK_GLOBAL REDUCE BUILD"
)


class _Refused(pickle.UnpicklingError):
    """The pickle needs something that no array needs."""


class _Type:
    """Stands for ``numpy.dtype``."""

    def __init__(self, code: object = "", *_rest: object) -> None:
        self.code, self.order = _text(code), "<"

    def __setstate__(self, state: object) -> None:
        if isinstance(state, tuple) and len(state) > 1 and _text(state[1]) in ("<", ">", "=", "|"):
            self.order = _text(state[1]).replace("|", "<").replace("=", "<")

    def build(self) -> np.dtype[Any]:
        code = self.code.lstrip("<>=|")
        if code[:1] not in tuple("biuf") or not code[1:].isdigit():
            raise _Refused(f"an array of type {self.code[:20]!r}")
        return np.dtype(self.order + code)


class _Array:
    """Stands for ``numpy.ndarray`` while it is made."""

    def __init__(self, *_shape: object) -> None:
        self.value: NDArray[Any] = np.empty(0)

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) == 5 and isinstance(state[2], _Type)):
            raise _Refused("an array without a type")
        _, shape, kind, fortran, data = state
        if isinstance(data, str):
            data = data.encode("latin-1")
        if not isinstance(shape, tuple) or not all(isinstance(n, int) and n >= 0 for n in shape):
            raise _Refused("an array without a shape")
        dtype = kind.build()
        if not isinstance(data, bytes) or len(shape) > 8 or math.prod(shape) * dtype.itemsize != len(data):
            raise _Refused("an array whose size is not that of its data")
        self.value = np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _text(value: object) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)


def _scalar(kind: object, data: object = b"") -> float:
    raw = data.encode("latin-1") if isinstance(data, str) else data
    if not isinstance(kind, _Type) or not isinstance(raw, bytes) or len(raw) != kind.build().itemsize:
        raise _Refused("a number without a type")
    return float(np.frombuffer(raw, kind.build())[0])


def _encode(text: object, _encoding: object = "latin-1") -> bytes:
    if not isinstance(text, str):
        raise _Refused("bytes that are no text")
    return text.encode("latin-1")


def _frombuffer(data: object, kind: object, shape: object, order: object = "C") -> _Array:
    array = _Array()
    array.__setstate__((1, shape, kind, order == "F", data))
    return array


def _reconstruct(*_arguments: object) -> _Array:
    return _Array()


_KNOWN: dict[tuple[str, str], Callable[..., Any]] = {
    **{
        (f"numpy.{core}.multiarray", name): function
        for core in ("core", "_core")
        for name, function in (("_reconstruct", _reconstruct), ("scalar", _scalar))
    },
    ("numpy._core.numeric", "_frombuffer"): _frombuffer,
    ("numpy.core.numeric", "_frombuffer"): _frombuffer,
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Type,
    ("_codecs", "encode"): _encode,
}


def _load_bytearray(unpickler: Any) -> None:
    """Load a bytearray without allocating missing bytes."""
    (size,) = struct.unpack("<Q", unpickler.read(8))
    unpickler.append(unpickler.read(size))


class _Unpickler(pickle._Unpickler):
    """Python's own unpickler, not that in C: its memory follows the file, not the numbers in it."""

    dispatch: ClassVar[dict[int, Callable[..., Any]]] = {
        code: pickle._Unpickler.dispatch[code] for code in [getattr(pickle, name)[0] for name in _INSTRUCTIONS.split()]
    } | {pickle.BYTEARRAY8[0]: _load_bytearray}

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _KNOWN[module, name]
        except KeyError:
            raise _Refused(f"{module}.{name}"[:80]) from None


def load_pickle(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Load the arrays (read-only), numbers, texts and lists of a pickled dictionary; keys other than text are dropped.

    MotionFileError for a file that is missing, damaged, or something other than a dictionary of plain values.
    """
    data = read_bytes(path)
    try:
        loaded = _Unpickler(io.BytesIO(data), encoding="latin1").load()
    except _Refused as error:
        raise MotionFileError(path, "pickles.refused", found=str(error)) from error
    except _DAMAGE as error:
        raise MotionFileError(path, "pickles.damaged", kind=type(error).__name__) from error
    if not isinstance(loaded, dict):
        raise MotionFileError(path, "pickles.no_dictionary", found=type(loaded).__name__)
    return {key: _plain(value) for key, value in loaded.items() if isinstance(key, str)}


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, _Array) else value
