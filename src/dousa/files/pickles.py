"""A pickle of unknown origin: dictionaries, lists, numbers, texts, arrays of numpy and tensors, and nothing else.

A pickle is a program. This reader runs only the instructions that build plain values, with stand-ins for the functions
that the pickles of numpy, joblib and torch call. It refuses anything else and trusts no size in the file.

joblib puts the bytes of an array behind the instruction that describes it, after a byte that counts the bytes of
padding (joblib, numpy_pickle.py), and packs the whole with zlib, gzip, bz2 or lzma. torch keeps the numbers of tensors
apart: in members ``data/KEY`` of a zip archive beside ``data.pkl`` (torch.save since 1.6), or, inside other pickles, as
five pickles in a row and the numbers (its legacy form).
"""

from __future__ import annotations

import bz2
import io
import lzma
import math
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes

_DAMAGE = (
    pickle.UnpicklingError, struct.error, EOFError, AttributeError, ImportError, LookupError, TypeError, ValueError,
    ArithmeticError, MemoryError, RecursionError, AssertionError, OSError,
    zlib.error, lzma.LZMAError, zipfile.BadZipFile, NotImplementedError, RuntimeError,
)  # fmt: skip

_INSTRUCTIONS = (
    "PROTO FRAME STOP MARK POP POP_MARK NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 FLOAT BINFLOAT "
    "STRING BINSTRING SHORT_BINSTRING UNICODE BINUNICODE SHORT_BINUNICODE BINUNICODE8 BINBYTES SHORT_BINBYTES "
    "BINBYTES8 EMPTY_LIST APPEND APPENDS LIST EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_DICT DICT SETITEM SETITEMS "
    "PUT BINPUT LONG_BINPUT GET BINGET LONG_BINGET MEMOIZE GLOBAL STACK_GLOBAL REDUCE BUILD NEWOBJ BINPERSID"
)


class _TooManyError(Exception):
    """More lists and dictionaries than are read."""


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
        self.value: Any = np.empty(0)

    def __setstate__(self, state: object) -> None:
        if not (isinstance(state, tuple) and len(state) == 5 and isinstance(state[2], _Type)):
            raise _Refused("an array without a type")
        _, shape, kind, fortran, data = state
        if isinstance(data, str):
            data = data.encode("latin-1")
        if not isinstance(shape, tuple) or not all(isinstance(n, int) and n >= 0 for n in shape):
            raise _Refused("an array without a shape")
        if kind.code == "O8" and isinstance(data, list) and len(shape) < 2 and len(data) == math.prod(shape):
            self.value = data if shape else data[0]
            return
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


class _Wrapper:
    """Stands for joblib's wrapper of an array, whose numbers follow in the file."""

    def __init__(self, *_arguments: object) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        self.state = state if isinstance(state, dict) else {}

    def read(self, file: io.BytesIO) -> _Array:
        shape, kind = self.state.get("shape"), self.state.get("dtype")
        array = _Array()
        if not isinstance(kind, _Type) or not isinstance(shape, tuple):
            raise _Refused("an array without a type")
        if kind.code.startswith("O"):
            array.value = _Unpickler(file, encoding="latin1").load()
            return array
        if self.state.get("numpy_array_alignment_bytes"):
            file.read(int.from_bytes(file.read(1), "little"))
        size = kind.build().itemsize * math.prod(n if isinstance(n, int) and n >= 0 else 0 for n in shape)
        array.__setstate__((1, shape, kind, self.state.get("order") == "F", file.read(max(size, 0))))
        return array


class _Storage:
    """Stands for the numbers of tensors, of one of torch's types."""

    def __init__(self, dtype: str, data: bytes = b"") -> None:
        self.dtype, self.data = dtype, data


class _StorageType:
    """Stands for a type of storage."""

    def __init__(self, code: str) -> None:
        self.code = code


# Names of torch's storages, and the types of their numbers by the definition of torch.
_STORAGES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8", "IntStorage": "<i4",
    "ShortStorage": "<i2", "CharStorage": "<i1", "ByteStorage": "<u1", "BoolStorage": "|b1",
}  # fmt: skip


def _rebuild_tensor(storage: object, offset: object, shape: object, steps: object, *_rest: object) -> _Array:
    """Take a tensor out of its numbers; ``offset`` and ``steps`` count numbers."""
    if not isinstance(storage, _Storage) or not (isinstance(shape, tuple) and isinstance(steps, tuple)):
        raise _Refused("a tensor without numbers")
    numbers = np.frombuffer(storage.data, storage.dtype)
    whole = [value for value in (offset, *shape, *steps) if isinstance(value, int) and value >= 0]
    if len(whole) != 1 + len(shape) + len(steps) or len(shape) != len(steps) or len(shape) > 8:
        raise _Refused("a tensor without a shape")
    last = whole[0] + sum((n - 1) * step for n, step in zip(shape, steps, strict=True))
    if math.prod(shape) > len(numbers) or (math.prod(shape) and last >= len(numbers)):
        raise _Refused("a tensor whose size is not that of its numbers")
    width, array = numbers.itemsize, _Array()
    array.value = np.lib.stride_tricks.as_strided(
        numbers[whole[0] :], shape, tuple(step * width for step in steps), writeable=False
    ).copy()
    return array


def _load_from_bytes(data: object) -> Any:
    """Load what torch.save wrote in its legacy form: five pickles, then the length and the numbers of each storage."""
    if not isinstance(data, bytes):
        raise _Refused("a tensor without numbers")
    file, found = io.BytesIO(data), dict[str, _Storage]()
    for _ in range(3):
        _Unpickler(file, encoding="latin1").load()
    loaded = _Unpickler(file, encoding="latin1", find=found.setdefault).load()
    for key in _Unpickler(file, encoding="latin1").load():
        storage, (count,) = found[str(key)], struct.unpack("<q", file.read(8))
        storage.data = file.read(max(count, 0) * np.dtype(storage.dtype).itemsize)
    return loaded


_KNOWN: dict[tuple[str, str], Any] = {
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
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _Wrapper,
    ("torch._utils", "_rebuild_tensor_v2"): _rebuild_tensor,
    ("torch.storage", "_load_from_bytes"): _load_from_bytes,
    **{("torch", name): _StorageType(code) for name, code in _STORAGES.items()},
    ("collections", "OrderedDict"): dict,
    ("collections", "defaultdict"): lambda *_: {},
}


def _load_bytearray(unpickler: Any) -> None:
    """Load a bytearray without allocating missing bytes."""
    (size,) = struct.unpack("<Q", unpickler.read(8))
    unpickler.append(unpickler.read(size))


def _load_object(unpickler: Any) -> None:
    """Make an object of joblib's wrapper, the only class whose pickles need this."""
    unpickler.stack.pop()
    if unpickler.stack[-1] is not _Wrapper:
        raise _Refused("an object")
    unpickler.stack[-1] = _Wrapper()


def _load_build(unpickler: Any) -> None:
    """Set the state of a stand-in; behind the description of an array of joblib stand its numbers."""
    state, target = unpickler.stack.pop(), unpickler.stack[-1]
    if not isinstance(target, _Type | _Array | _Wrapper):
        raise _Refused("the state of an object")
    target.__setstate__(state)
    if isinstance(target, _Wrapper):
        unpickler.stack[-1] = target.read(unpickler.file)


def _count(load: Callable[[Any], None], most: int = 3_000_000) -> Callable[[Any], None]:
    """Have an instruction load at most so many containers, some 300 MB."""

    def load_counted(unpickler: Any) -> None:
        unpickler.containers += 1
        if unpickler.containers > most:
            raise _TooManyError
        load(unpickler)

    return load_counted


class _Unpickler(pickle._Unpickler):
    """Python's own unpickler, not that in C: its memory follows the file, not the numbers in it."""

    dispatch: ClassVar[dict[int, Callable[..., Any]]] = (
        {
            code: pickle._Unpickler.dispatch[code]
            for code in [getattr(pickle, name)[0] for name in _INSTRUCTIONS.split()]
        }
        | {
            getattr(pickle, name)[0]: _count(pickle._Unpickler.dispatch[getattr(pickle, name)[0]])
            for name in ("EMPTY_LIST", "EMPTY_DICT", "EMPTY_TUPLE", "MARK")
        }
        | {pickle.BYTEARRAY8[0]: _load_bytearray, pickle.BUILD[0]: _load_build, pickle.NEWOBJ[0]: _load_object}
    )

    def __init__(
        self, file: io.BytesIO, *, encoding: str, find: Callable[[str, _Storage], _Storage] | None = None
    ) -> None:
        super().__init__(file, encoding=encoding)
        self.containers = 0
        self.file, self._find = file, find

    def persistent_load(self, pid: Any) -> Any:
        """Return the storage of a tensor: ("storage", its type, key, device, number of numbers ...)."""
        if self._find is None or not (isinstance(pid, tuple) and len(pid) > 4 and isinstance(pid[1], _StorageType)):
            raise _Refused("something outside of it")
        return self._find(str(pid[2]), _Storage(pid[1].code))

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _KNOWN[module, name]
        except KeyError:
            raise _Refused(f"{module}.{name}"[:80]) from None


def load_pickle(path: str | os.PathLike[str], data: bytes | None = None) -> dict[Any, Any]:
    """Load the arrays (read-only), numbers, texts, lists and dictionaries of a pickled dictionary, or list of such.

    An array alone, or lists of numbers that make one, is given under the name "".

    Parameters
    ----------
    path : a pickle, a dump of joblib, packed or not, or a file of torch.save; for the messages.
    data : of the pickle, if it has been read.

    Raises
    ------
    MotionFileError : missing, damaged, or something other than a dictionary of plain values.
    """
    data = read_bytes(path) if data is None else data
    try:
        loaded = _load(_unpack(path, data))
    except _Refused as error:
        raise MotionFileError(path, "pickles.refused", found=str(error)) from error
    except _TooManyError as error:
        raise MotionFileError(path, "pickles.many") from error
    except _DAMAGE as error:
        raise MotionFileError(path, "pickles.damaged", kind=type(error).__name__) from error
    loaded = _plain(loaded, {})
    if isinstance(loaded, list) and all(isinstance(item, dict) for item in loaded):
        loaded = dict(enumerate(loaded, 1))  # people
    if isinstance(loaded, list | np.ndarray):
        try:
            array = np.asarray(loaded)
        except ValueError:  # lists of unequal lengths
            array = np.empty(0)
        loaded = {"": array} if array.ndim > 1 and array.dtype.kind in "iuf" else loaded
    if not isinstance(loaded, dict):
        raise MotionFileError(path, "pickles.no_dictionary", found=type(loaded).__name__)
    return loaded


def _load(data: bytes) -> Any:
    if data[:2] != b"PK":
        return _Unpickler(io.BytesIO(data), encoding="latin1").load()
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        main = next((name for name in archive.namelist() if name.endswith("data.pkl")), None)
        if main is None or sum(member.file_size for member in archive.infolist()) > 2 * len(data):
            raise _Refused("members that torch.save does not write")  # it packs nothing

        def find(key: str, storage: _Storage) -> _Storage:
            return _Storage(storage.dtype, archive.read(f"{main.removesuffix('data.pkl')}data/{key}"))

        return _Unpickler(io.BytesIO(archive.read(main)), encoding="latin1", find=find).load()


_PACKERS: dict[bytes, Callable[[], Any]] = {
    b"\x1f\x8b": lambda: zlib.decompressobj(31),
    b"BZ": bz2.BZ2Decompressor,
    b"\x5d\x00": lzma.LZMADecompressor,
    b"\xfd7": lzma.LZMADecompressor,
    **{b"x" + level: zlib.decompressobj for level in (b"\x01", b"\x5e", b"\x9c", b"\xda")},
}
"""Decompressors by the first two bytes: those of RFC 1952, RFC 1950, bzip2 and xz."""


def _unpack(path: str | os.PathLike[str], data: bytes) -> bytes:
    """Unpack what joblib has packed, up to 200 times its size, as numbers never shrink more."""
    packer = _PACKERS.get(data[:2])
    if packer is None:
        return data
    most = max(200 * len(data), 100_000_000)
    unpacked: bytes = packer().decompress(data, most + 1)
    if len(unpacked) > most:
        raise MotionFileError(path, "packed.large", most=most / 1e6)
    return unpacked


def _plain(value: Any, done: dict[int, Any], depth: int = 0, deepest: int = 30) -> Any:
    """Put the arrays in the place of their stand-ins, in dictionaries and lists too."""
    if id(value) in done:
        return done[id(value)]
    if depth > deepest:
        return None
    plain = value
    if isinstance(value, _Array):
        plain = _plain(value.value, done, depth + 1)
    elif isinstance(value, dict):
        done[id(value)] = None  # of a value that holds itself
        plain = {key: _plain(item, done, depth + 1) for key, item in value.items()}
    elif isinstance(value, list | tuple):
        done[id(value)] = None
        plain = [_plain(item, done, depth + 1) for item in value]
    if isinstance(value, dict | list | tuple | _Array):
        done[id(value)] = plain
    return plain
