"""Arrays in the columns of a library: raw little-endian numbers, checked when they come back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import LibraryDamagedError

__all__ = ["pack", "stack", "unpack"]

_REMEDY = "the library is damaged; remove the clip and add its file again"


def pack(values: ArrayLike, dtype: str) -> bytes:
    """The bytes of an array, C order.

    Parameters
    ----------
    values : any numbers.
    dtype : NumPy name with the byte order, such as ``"<f4"``.
    """
    return np.ascontiguousarray(values, dtype=dtype).tobytes()


def unpack(data: bytes, dtype: str, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    """The array that ``pack`` wrote.

    Raises
    ------
    LibraryDamagedError : another number of bytes than the shape asks for, or numbers that are not finite.
    """
    return stack([data], dtype, shape, what)[0]


def stack(blobs: Sequence[bytes], dtype: str, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    """Arrays of one shape that ``pack`` wrote, stacked to (N, *shape) with one copy.

    Raises
    ------
    LibraryDamagedError : one has another number of bytes, or numbers that are not finite.
    """
    expected = int(np.prod(shape)) * np.dtype(dtype).itemsize
    for blob in blobs:
        if len(blob) != expected:
            raise LibraryDamagedError(f"{what}: expected {expected} bytes, got {len(blob)}; {_REMEDY}")
    # A bytearray, so that the array is writable as one that was computed is: numba would compile again for another.
    array = np.frombuffer(bytearray().join(blobs), dtype=dtype).reshape(len(blobs), *shape)
    # A sum is finite unless a part is not (or the parts are absurd): cheaper than looking at every number.
    with np.errstate(over="ignore", invalid="ignore"):
        whole = array.dtype.kind != "f" or bool(np.isfinite(array.sum(dtype=np.float64)))
    if not whole:
        raise LibraryDamagedError(f"{what}: expected finite numbers, got NaN or infinity; {_REMEDY}")
    return array
