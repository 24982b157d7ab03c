"""Motion files that are packed: gzip of one, or a zip archive of one with what belongs to it."""

from __future__ import annotations

import gzip
import io
import lzma
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes

_TIMES_LARGER, _SMALL = 200, 100_000_000  # bytes; numbers as text shrink ten times, and a thousand times never
_MOST_MEMBERS = 1000
_CHUNK = 1 << 20
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, EOFError, OSError, ValueError,
)  # fmt: skip


@contextmanager
def unpack(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Iterator[str]:
    """A packed motion file, unpacked into a temporary folder for as long as the block lasts.

    Parameters
    ----------
    path : file ending in ``.gz`` or ``.zip``.
    suffixes : what motion files end in.

    Returns
    -------
    The path of the motion file in the temporary folder.

    Raises
    ------
    MotionFileError : damaged, encrypted, larger than is plausible, no motion file inside, or several.
    """
    data = read_bytes(path)
    most = max(_TIMES_LARGER * len(data), _SMALL)
    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        try:
            if os.fspath(path).lower().endswith(".gz"):
                inner = os.path.join(folder, os.path.basename(os.fspath(path))[: -len(".gz")] or "motion")
                with gzip.open(io.BytesIO(data)) as source:
                    _copy(path, source, inner, most)
            else:
                inner = _unpack_zip(path, data, folder, suffixes, most)
        except _DAMAGE as error:
            raise MotionFileError(path, "packed.damaged", reason=error) from error
        yield inner


def _copy(path: str | os.PathLike[str], source: IO[bytes] | gzip.GzipFile, target: str, most: int) -> int:
    size = 0
    with open(target, "wb") as file:
        while chunk := source.read(_CHUNK):
            size += len(chunk)
            if size > most:
                raise MotionFileError(path, "packed.large", most=most / 1e6)
            file.write(chunk)
    return size


def _unpack_zip(path: str | os.PathLike[str], data: bytes, folder: str, suffixes: Sequence[str], most: int) -> str:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [member for member in archive.infolist() if not member.is_dir()]
        if len(members) > _MOST_MEMBERS:
            raise MotionFileError(path, "packed.many", found=len(members), most=_MOST_MEMBERS)
        # Names are flattened: nothing can be written outside the folder.
        names = {os.path.basename(member.filename.replace("\\", "/")): member for member in members}
        motions = [name for name in names if name.lower().endswith(tuple(suffixes)) and not name.startswith(".")]
        if len(motions) != 1:
            raise MotionFileError(path, "packed.motions", found=len(motions), names=motions[:5])
        if names[motions[0]].flag_bits & 1:
            raise MotionFileError(path, "packed.encrypted")
        for name, member in names.items():
            if not member.flag_bits & 1:
                with archive.open(member) as source:
                    most -= _copy(path, source, os.path.join(folder, name), most)
    return os.path.join(folder, motions[0])
