"""Packed motion files: gzip of one, or a zip archive of one with its companions."""

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

DAMAGE = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, EOFError, OSError, ValueError,
)  # fmt: skip


@contextmanager
def unpack(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Iterator[str]:
    """Unpack a ``.gz`` or ``.zip`` file into a temporary folder for the duration of the block and return its path.

    Of many JSON files, one for each frame, it is the path of their folder. ``suffixes`` : endings of motion files.

    Raises
    ------
    MotionFileError : damaged, encrypted, larger than is plausible, no motion file inside, or several.
    """
    data = read_bytes(path)
    most = max(200 * len(data), 100_000_000)  # numbers as text shrink ten times, and a thousand times never
    with tempfile.TemporaryDirectory(prefix="dousa-") as folder:
        try:
            if os.fspath(path).lower().endswith(".gz"):
                inner = os.path.join(folder, os.path.basename(os.fspath(path))[: -len(".gz")] or "motion")
                with gzip.open(io.BytesIO(data)) as source:
                    _copy(path, source, inner, most)
            else:
                inner = _unpack_zip(path, data, folder, suffixes, most)
        except DAMAGE as error:
            raise MotionFileError(path, "packed.damaged", reason=error) from error
        yield inner


def _copy(path: str | os.PathLike[str], source: IO[bytes] | gzip.GzipFile, target: str, most: int) -> int:
    size = 0
    with open(target, "wb") as file:
        while chunk := source.read(1 << 20):
            size += len(chunk)
            if size > most:
                raise MotionFileError(path, "packed.large", most=most / 1e6)
            file.write(chunk)
    return size


def _unpack_zip(
    path: str | os.PathLike[str],
    data: bytes,
    folder: str,
    suffixes: Sequence[str],
    most: int,
    most_members: int = 1000,
    most_frames: int = 200_000,
) -> str:
    """Unpack at most ``most`` bytes, so many members and files of one frame each; returns the path of the motion."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [member for member in archive.infolist() if not member.is_dir()]
        frames = sum(member.filename.lower().endswith(".json") for member in members)
        if len(members) - frames > most_members or frames > most_frames:
            raise MotionFileError(path, "packed.many", found=len(members), most=most_members)
        # Names are flattened: nothing can be written outside the folder.
        names = {os.path.basename(member.filename.replace("\\", "/")): member for member in members}
        motions = [name for name in names if name.lower().endswith(tuple(suffixes)) and not name.startswith(".")]
        if len(motions) > 1 and all(name.lower().endswith(".json") for name in motions):
            return _unpack_frames(path, archive, [names[name] for name in motions], folder, most)
        if len(motions) != 1:
            raise MotionFileError(path, "packed.motions", found=len(motions), names=motions[:5])
        if names[motions[0]].flag_bits & 1:
            raise MotionFileError(path, "packed.encrypted")
        for name, member in names.items():
            if not member.flag_bits & 1:
                with archive.open(member) as source:
                    most -= _copy(path, source, os.path.join(folder, name), most)
    return os.path.join(folder, motions[0])


def _unpack_frames(
    path: str | os.PathLike[str], archive: zipfile.ZipFile, members: list[zipfile.ZipInfo], folder: str, most: int
) -> str:
    """Folder of the files of the frames, which must come from one folder."""
    folders = sorted({os.path.dirname(member.filename.replace("\\", "/")) for member in members})
    if len(folders) > 1:
        raise MotionFileError(path, "packed.folders", found=len(folders), names=folders[:5])
    if any(member.flag_bits & 1 for member in members):
        raise MotionFileError(path, "packed.encrypted")
    place = os.path.join(folder, "frames")
    os.mkdir(place)
    for member in members:
        with archive.open(member) as source:
            most -= _copy(path, source, os.path.join(place, os.path.basename(member.filename.replace("\\", "/"))), most)
    return place
