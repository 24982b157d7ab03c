"""Reading of a binary file value by value, without trust in its counts."""

from __future__ import annotations

import os
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import MotionFileError

MOST_BONES = 10_000


class Cursor:
    """A place in the bytes of a file, little endian.

    Parameters
    ----------
    path : for messages.
    data : all bytes.
    place : where to begin.
    """

    def __init__(self, path: str | os.PathLike[str], data: bytes, place: int = 0) -> None:
        self.path, self.data, self.place = path, data, place

    @property
    def left(self) -> int:
        """Number of bytes that follow."""
        return len(self.data) - self.place

    def fail(self, code: str, **values: Any) -> MotionFileError:
        """Return an error about this file."""
        return MotionFileError(self.path, code, **values)

    def take(self, size: int) -> bytes:
        """Return the next bytes."""
        if not 0 <= size <= self.left:
            raise self.fail("mmd.truncated", place=self.place)
        self.place += size
        return self.data[self.place - size : self.place]

    def unpack(self, form: str) -> tuple[Any, ...]:
        """Return values of a format of `struct`."""
        return struct.unpack("<" + form, self.take(struct.calcsize("<" + form)))

    def count(self, form: str, smallest: int) -> int:
        """Return a number of items of at least so many bytes each; no more than fit in the rest of the file."""
        (number,) = self.unpack(form)
        if number < 0 or number * smallest > self.left:
            raise self.fail("mmd.truncated", place=self.place)
        return int(number)

    def rows(self, dtype: np.dtype[Any], form: str = "I") -> NDArray[Any]:
        """Return a counted table of rows of one size."""
        number = self.count(form, dtype.itemsize)
        return np.frombuffer(self.take(number * dtype.itemsize), dtype)

    def index(self, size: int) -> int:
        """Return an index, -1 for none, in 1, 2 or 4 bytes."""
        return int(self.unpack({1: "b", 2: "h", 4: "i"}[size])[0])


def decode_name(raw: bytes) -> str:
    """Decode a name of a VMD or PMD file: Shift-JIS up to the first zero byte; a letter cut at the end is left out."""
    text = raw.split(b"\0", 1)[0]
    try:
        return text.decode("cp932")
    except UnicodeDecodeError as error:
        if error.end >= len(text):
            return text[: error.start].decode("cp932", "replace")
        return text.decode("cp932", "replace")
