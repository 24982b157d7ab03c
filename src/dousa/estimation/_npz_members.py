"""Arrays out of an npz file of unknown origin: nothing is pickled, and no size in it is believed.

A member may be compressed, and masks compress a thousandfold, so the size of the file bounds nothing. What a member
declares is therefore compared with a limit before a byte is unpacked, and with what comes while unpacking.
"""

from __future__ import annotations

import math
import os
import re
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import SilhouetteError

__all__ = ["Header", "NpzFile", "clear_npz_errors"]

_MOST_MEMBERS = 256
_MOST_AXES = 8
_SMALL_BYTES = 64_000_000  # what an array beside the masks may have: names, cameras, true joints
_MAGIC = b"\x93NUMPY"
_HEADER = re.compile(
    r"\{'descr': '([<>|=]?[biufU]\d{1,9})', 'fortran_order': (True|False), 'shape': \(([\d, ]{0,200})\), ?\}\s*"
)
# What zipfile and zlib raise on damaged archives.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
    RuntimeError,
    EOFError,
    ValueError,
    OverflowError,
)


@contextmanager
def clear_npz_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Whatever a damaged or unreadable archive raises becomes one SilhouetteError."""
    try:
        yield
    except SilhouetteError:
        raise
    except FileNotFoundError:
        raise SilhouetteError(f"{os.fspath(path)}: no such file; check the name and the folder") from None
    except PermissionError:
        raise SilhouetteError(
            f"{os.fspath(path)}: no permission to read; change the permissions of the file"
        ) from None
    except _DAMAGE as error:
        raise SilhouetteError(
            f"{os.fspath(path)}: damaged, or not an .npz file: {error}; was the copy or download interrupted?"
        ) from error
    except OSError as error:
        raise SilhouetteError(f"{os.fspath(path)}: cannot be read: {error.strerror or error}") from error
    except MemoryError:
        raise SilhouetteError(
            f"{os.fspath(path)}: does not fit into the memory of this machine; cut the sequence"
        ) from None


@dataclass(frozen=True, slots=True)
class Header:
    """What the head of an array says.

    Parameters
    ----------
    dtype, shape : of the array.
    fortran_order : whether the first axis runs fastest.
    start : bytes before the data.
    n_bytes : of the data; the member's size agrees with it.
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran_order: bool
    start: int
    n_bytes: int


class NpzFile:
    """The arrays of an npz file, each read when it is asked for.

    Use inside `clear_npz_errors`.

    Parameters
    ----------
    path : the file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        if os.path.isdir(path):
            raise SilhouetteError(f"{self.path}: expected an npz file, this is a folder")
        if not os.path.exists(path):
            raise FileNotFoundError(path)
        if not os.path.isfile(path):
            raise SilhouetteError(f"{self.path}: expected a file, this is a pipe or device")
        if os.path.getsize(path) == 0:
            raise SilhouetteError(f"{self.path}: the file is empty; was the copy or download interrupted?")
        self._archive = zipfile.ZipFile(path)
        members = self._archive.infolist()
        if len(members) > _MOST_MEMBERS:
            raise SilhouetteError(
                f"{self.path}: expected a few arrays, got an archive of {len(members)} files"
            )
        self._members = {member.filename.removesuffix(".npy"): member for member in members}

    def __enter__(self) -> NpzFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._archive.close()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays."""
        return tuple(self._members)

    def __contains__(self, name: object) -> bool:
        return name in self._members

    def fail(self, problem: str) -> SilhouetteError:
        """The error that says what is wrong with this file."""
        return SilhouetteError(f"{self.path}: {problem}")

    @contextmanager
    def open(self, name: str) -> Iterator[tuple[Header, IO[bytes]]]:
        """The head of an array and the stream of its data."""
        if name not in self._members:
            raise self.fail(f"expected an array '{name}', got {', '.join(self._members) or 'no array'}")
        member = self._members[name]
        with self._archive.open(member) as stream:
            yield self._read_header(name, stream, member.file_size), stream

    def _read_header(self, name: str, stream: IO[bytes], size: int) -> Header:
        head = stream.read(10)
        if len(head) < 10 or head[:6] != _MAGIC:
            raise self.fail(f"'{name[:40]}' is not a numpy array")
        length = head[8:10] if head[6] < 2 else head[8:10] + stream.read(2)
        start = 8 + len(length) + int.from_bytes(length, "little")
        if start > min(size, 10_000):
            raise self.fail(f"'{name[:40]}' is not a plain numpy array of numbers or text")
        found = _HEADER.fullmatch(stream.read(start - 8 - len(length)).decode("latin-1"))
        if found is None:
            raise self.fail(f"'{name[:40]}' is not a plain numpy array of numbers or text")
        try:
            dtype = np.dtype(found[1])
        except TypeError:
            raise self.fail(f"'{name[:40]}': no such kind of number: '{found[1]}'") from None
        shape = tuple(int(axis) for axis in found[3].replace(" ", "").split(",") if axis)
        n_bytes = math.prod(shape) * dtype.itemsize
        if n_bytes != size - start or len(shape) > _MOST_AXES:
            raise self.fail(
                f"'{name[:40]}' declares shape {shape}, {n_bytes} bytes, and holds {size - start}; damaged?"
            )
        return Header(dtype, shape, found[2] == "True", start, n_bytes)

    def read(self, name: str, kinds: str, ndim: int) -> NDArray[Any]:
        """A small array of the wanted kinds of dtype and number of axes."""
        with self.open(name) as (header, stream):
            if header.dtype.kind not in kinds or len(header.shape) != ndim:
                raise self.fail(
                    f"'{name}': expected {ndim} axes of kind '{kinds}', "
                    f"got {len(header.shape)} of '{header.dtype.kind}'"
                )
            if header.n_bytes > _SMALL_BYTES:
                raise self.fail(f"'{name}' declares {header.n_bytes} bytes, far more than it needs")
            flat = np.frombuffer(read_exactly(stream, header.n_bytes, self, name), header.dtype)
        return flat.reshape(header.shape, order="F" if header.fortran_order else "C")

    def read_number(self, name: str) -> float:
        """A single finite number."""
        value = float(self.read(name, "iuf", 0))
        if not math.isfinite(value):
            raise self.fail(f"'{name}': expected a finite number, got {value}")
        return value

    def read_texts(self, name: str) -> tuple[str, ...]:
        """A list of texts."""
        array = self.read(name, "U", 1)
        if array.size and array.astype(array.dtype.newbyteorder("=")).view(np.uint32).max() > 0x10FFFF:
            raise self.fail(f"'{name}' is not text")
        return tuple(str(text) for text in array)


def read_exactly(stream: IO[bytes], n_bytes: int, file: NpzFile, name: str) -> bytes:
    """So many bytes of a stream, or an error that it ended."""
    parts, left = [], n_bytes
    while left:
        part = stream.read(min(left, 1 << 20))
        if not part:
            raise file.fail(f"'{name}' ends {left} bytes early; is the file truncated?")
        parts.append(part)
        left -= len(part)
    stream.read(1)  # lets zipfile compare the checksum
    return b"".join(parts)
