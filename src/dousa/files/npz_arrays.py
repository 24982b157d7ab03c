"""Arrays of an npz file of unknown origin: no pickles, and no trust in its sizes.

A member may be compressed, and masks compress a thousandfold, so the size of the file is no limit. The declared size of
a member is compared with a limit before unpacking, and with the data while unpacking.
"""

from __future__ import annotations

import errno
import io
import lzma
import math
import os
import re
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from dousa.errors import DousaError, MotionFileError
from dousa.files.disk import read_bytes
from dousa.messages import Message

_MAGIC = b"\x93NUMPY"

# The header that numpy writes, taken apart without evaluating it.
_HEADER = re.compile(
    r"\{'descr': '([<>|=]?[biufU]\d{1,9})', 'fortran_order': (True|False), 'shape': \(([\d, ]{0,200})\), ?\}\s*"
)

# Errors of zipfile and its decompressors on damaged archives, found by fuzzing and in their source.
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, EOFError, ValueError,
    OverflowError,
)  # fmt: skip

Fail = Callable[[Message], DousaError]


@contextmanager
def open_npz(source: str | os.PathLike[str] | bytes, fail: Fail) -> Iterator[NpzFile]:
    """Open the arrays of an npz file, each read on demand.

    Parameters
    ----------
    source : the file, or its bytes.
    fail : makes an error of a message, such as ``lambda message: SilhouetteError(message).at(path)``.

    Raises
    ------
    By ``fail``: missing, a folder or device, empty, damaged, no archive of a few arrays. Errors of the block pass.
    """
    try:
        if not isinstance(source, bytes) and not (os.path.isfile(source) and os.path.getsize(source)):
            read_bytes(source)  # raises the error
        with zipfile.ZipFile(io.BytesIO(source) if isinstance(source, bytes) else source) as archive:
            yield NpzFile(archive, fail)
    except MotionFileError as error:
        raise fail(error.message) from None
    except DousaError:
        raise
    except MemoryError:
        raise fail(Message("npz.memory")) from None
    except _DAMAGE as error:
        raise fail(Message("npz.damaged", reason=error)) from error
    except OSError as error:
        if isinstance(source, bytes) or error.errno == errno.EINVAL:  # the list of the arrays points before the file
            raise fail(Message("npz.damaged", reason=Message("npz.no_list"))) from error
        raise fail(Message("npz.unreadable", reason=error)) from error


@dataclass(frozen=True, slots=True)
class Header:
    """Head of an array.

    Parameters
    ----------
    dtype, shape : of the array; a dtype of no bytes stands for one that numpy does not know.
    n_packed : bytes of the data in the file, perhaps compressed.
    order : ``"F"`` where the first axis runs fastest, else ``"C"``.
    n_bytes : of the data.
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    order: Literal["C", "F"]
    n_bytes: int
    n_packed: int = 0

    def shape_data(self, flat: NDArray[Any]) -> NDArray[Any]:
        """Give the numbers behind a head its shape."""
        return flat.reshape(self.shape, order=self.order)


def read_head(stream: IO[bytes], most: int = 10_000) -> bytes | None:
    """Read the head of an array, at most so many bytes of it; None if it is none of numpy."""
    head = stream.read(10)
    if len(head) < 10 or head[:6] != _MAGIC:
        return None
    if head[6] >= 2:
        head += stream.read(2)
    return head + stream.read(min(int.from_bytes(head[8:], "little"), most))


def parse_head(head: bytes) -> Header | None:
    """Parse the head of an array of numbers or texts; None for any other."""
    found = _HEADER.fullmatch(head[12 if head[6] >= 2 else 10 :].decode("latin-1"))
    if found is None:
        return None
    try:
        dtype = np.dtype(found[1])
    except (TypeError, ValueError, OverflowError):
        dtype = np.dtype("V0")
    shape = tuple(int(axis) for axis in found[3].replace(" ", "").split(",") if axis)
    return Header(dtype, shape, "F" if found[2] == "True" else "C", math.prod(shape) * dtype.itemsize)


class NpzFile:
    """The arrays of an open archive, see `open_npz`."""

    def __init__(self, archive: zipfile.ZipFile, fail: Fail) -> None:
        self._archive, self._fail = archive, fail
        members = archive.infolist()
        if len(members) > 256:
            raise fail(Message("npz.many_members", found=len(members)))
        self._members = {member.filename.removesuffix(".npy"): member for member in members}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays."""
        return tuple(self._members)

    @property
    def most(self) -> int:
        """Bytes that an array may have: those of real recordings do not shrink to a quarter."""
        return max(100_000_000, 4 * sum(member.compress_size for member in self._members.values()))

    @property
    def n_behind(self) -> int:
        """Bytes of the file behind the end of the archive."""
        file = self._archive.fp
        if file is None:
            return 0
        members = self._archive.infolist()
        heads = sum(46 + len(m.orig_filename.encode()) + len(m.extra) + len(m.comment) for m in members)
        return file.seek(0, io.SEEK_END) - self._archive.start_dir - heads - 22 - len(self._archive.comment)

    @property
    def compressed(self) -> tuple[str, ...]:
        """Names of the arrays that are compressed."""
        return tuple(name for name, member in self._members.items() if member.compress_type != zipfile.ZIP_STORED)

    def __contains__(self, name: object) -> bool:
        return name in self._members

    @contextmanager
    def open(self, name: str) -> Iterator[tuple[Header, IO[bytes]]]:
        """Open the head of an array and the stream of its data."""
        if name not in self._members:
            raise self._fail(Message("npz.no_array", array=name, found=self.names[:20]))
        member = self._members[name]
        with self._archive.open(member) as stream:
            header = self._read_header(name, stream, member.file_size)
            yield replace(header, n_packed=member.compress_size), stream

    def _read_header(self, name: str, stream: IO[bytes], size: int) -> Header:
        head = read_head(stream)
        if head is None:
            raise self._fail(Message("npz.no_numpy", array=name))
        header = parse_head(head)
        if header is None:
            raise self._fail(Message("npz.not_plain", array=name))
        if header.dtype.itemsize == 0:  # a thousand million empty texts would take no room in the file
            raise self._fail(Message("npz.no_dtype", array=name, found=head.split(b"'")[3].decode("latin-1")))
        left, shape = size - len(head), header.shape
        if header.n_bytes != left or len(shape) > 8 or max(shape, default=0) > 2**40:
            raise self._fail(
                Message("npz.size", array=name, shape=str(shape), declared=str(header.n_bytes), found=str(left))
            )
        return header

    def read_data(self, name: str, header: Header, stream: IO[bytes]) -> NDArray[Any]:
        """Read the array behind a head; read-only."""
        whole, done = np.empty(header.n_bytes, np.uint8), 0  # no memory is taken before something comes
        while done < header.n_bytes:
            part = stream.read(min(header.n_bytes - done, 1 << 20))
            if not part:
                raise self._fail(Message("npz.ends", array=name))
            whole[done : done + len(part)] = np.frombuffer(part, np.uint8)
            done += len(part)
        stream.read(1)  # lets zipfile compare the checksum
        whole.flags.writeable = False
        return header.shape_data(whole.view(header.dtype))

    def read(self, name: str, kinds: str, ndim: int | None = None, most: int = 64_000_000) -> NDArray[Any]:
        """Read an array; read-only.

        Parameters
        ----------
        name : of the array.
        kinds : letters of the wanted kinds of dtype: b bool, i and u whole numbers, f numbers, U text.
        ndim : number of axes; any by default.
        most : largest size in bytes.
        """
        with self.open(name) as (header, stream):
            if header.dtype.kind not in kinds:
                raise self._fail(Message("npz.kind", array=name, kinds=kinds, found=header.dtype.kind))
            if ndim not in (None, len(header.shape)):
                raise self._fail(Message("npz.axes", array=name, expected=ndim, found=len(header.shape)))
            if header.n_bytes > most:
                raise self._fail(Message("npz.large", array=name, most=most, found=header.n_bytes))
            array = self.read_data(name, header, stream)
        if array.dtype.kind == "U" and array.size:
            codes = np.ascontiguousarray(array, array.dtype.newbyteorder("=")).reshape(-1).view(np.uint32)
            if codes.max() > sys.maxunicode:
                raise self._fail(Message("npz.not_text", array=name))
        return array

    def read_pickled(self, name: str) -> bytes | None:
        """Read the pickle in the place of an array of objects; None where the array has numbers or texts."""
        member = self._members[name]
        with self._archive.open(member) as stream:
            head = read_head(stream)
            if head is None or b"'|O'" not in head:
                return None
            if member.file_size > self.most:
                raise self._fail(Message("npz.large", array=name, most=self.most, found=member.file_size))
            return stream.read()

    def read_number(self, name: str) -> float:
        """Read a single finite number."""
        value = float(self.read(name, "iuf", 0))
        if not math.isfinite(value):
            raise self._fail(Message("npz.not_finite", array=name, found=str(value)))
        return value

    def read_texts(self, name: str) -> tuple[str, ...]:
        """Read a list of texts."""
        return tuple(str(text) for text in self.read(name, "U", 1))
