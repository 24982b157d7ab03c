"""Plain arrays as the bytes of an .npz file, checked so that no bytes can crash a reader."""

from __future__ import annotations

import io
import tokenize
import zipfile
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import DousaError

__all__ = ["check", "pack_arrays", "unpack_arrays"]


def check(condition: bool | np.bool_, what: str, problem: str) -> None:
    """DousaError unless a condition holds; ``what`` should have been there."""
    if not condition:
        raise DousaError(f"expected {what}, got damaged or other data: {problem}; train again")


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of some arrays; the same arrays give the same bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def unpack_arrays(data: bytes, names: Collection[str], what: str) -> dict[str, NDArray[Any]]:
    """The arrays of exactly these names; DousaError if the bytes are anything else."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            check(
                {entry.filename for entry in entries} == {f"{name}.npy" for name in names},
                what,
                "other arrays",
            )
            # We store plainly, so nothing that unpacks to more than it weighs can be ours.
            plain = all(entry.compress_type == zipfile.ZIP_STORED for entry in entries)
            check(plain and sum(entry.file_size for entry in entries) <= len(data), what, "it is compressed")
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            return {name: archive[name] for name in names}
    except (
        ValueError,
        TypeError,
        OSError,
        EOFError,
        KeyError,
        zipfile.BadZipFile,
        NotImplementedError,
    ) as error:
        raise DousaError(f"expected {what}, got damaged or other data: {error}; train again") from error
    except (MemoryError, OverflowError, RuntimeError, SyntaxError, tokenize.TokenError) as error:
        raise DousaError(f"expected {what}, got damaged data; train again") from error
