"""Files that come in: counted while they come, looked at before they are kept, archives unpacked with care."""

from __future__ import annotations

import os
import secrets
import stat
import zipfile
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from dousa.app.studio.problems import RefusedError
from dousa.app.studio.settings import Settings
from dousa.app.studio.workspace import Workspace, safe_parts

__all__ = ["MOTIONS", "Received", "receive"]

MOTIONS = frozenset({".bvh", ".amc", ".c3d", ".trc", ".npz"})
SKELETONS = frozenset({".asf"})
VIDEOS = frozenset({".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v"})
PICTURES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"})
TABLES = frozenset({".toml", ".xml", ".yaml", ".yml", ".json", ".csv", ".txt"})
_ARCHIVE = ".zip"

_TIMES_LARGER, _SMALL = 200, 20_000_000  # an honest archive of motions shrinks them ten times at most
_CHUNK = 1 << 20


@dataclass(frozen=True, slots=True)
class Received:
    """What came of an upload.

    Parameters
    ----------
    batch : where the files are.
    files : (name in the batch, bytes) of those kept.
    refused : (name, reason) of the others.
    """

    batch: str
    files: tuple[tuple[str, int], ...]
    refused: tuple[tuple[str, str], ...]


async def receive(
    body: AsyncIterator[bytes], name: str, batch: str | None, workspace: Workspace, settings: Settings
) -> Received:
    """Keep an uploaded file, or the files of an uploaded zip archive.

    Parameters
    ----------
    body : its bytes.
    name : its path below the folder that was dropped.
    batch : where to put it; None for a new one.
    workspace, settings : of the studio.

    Raises
    ------
    RefusedError : the name, kind, size or content is not one that the studio takes. Nothing is kept then.
    """
    from starlette.concurrency import run_in_threadpool

    safe_parts(name)
    suffix = _check_suffix(name)
    made = workspace.new_batch() if batch is None else batch
    workspace.batch_folder(made)
    try:
        with _temporary(workspace) as (file, path):
            size = 0
            async for chunk in body:
                size += len(chunk)
                if size > settings.most_bytes:
                    raise RefusedError(413, f"{name}: expected at most {settings.most_bytes / 1e6:g} MB")
                file.write(chunk)
            file.close()
            room = _Room(workspace, made, settings)
            if suffix == _ARCHIVE:
                return await run_in_threadpool(_unpack, path, made, workspace, room)
            _check_content(path, name)
            room.take(name, size)
            os.replace(path, workspace.place(made, name))
    except BaseException:
        if batch is None:
            workspace.discard(made)
        raise
    return Received(made, (("/".join(safe_parts(name)), size),), ())


class _Room:
    """What still fits into a batch."""

    def __init__(self, workspace: Workspace, batch: str, settings: Settings) -> None:
        self._most_files, self._most_bytes = settings.most_files, settings.most_unpacked_bytes
        there = workspace.files(batch)
        self._files, self._bytes = len(there), sum(path.stat().st_size for path in there)

    def take(self, name: str, size: int) -> None:
        self._files += 1
        self._bytes += size
        if self._files > self._most_files:
            raise RefusedError(
                413, f"{name}: expected at most {self._most_files} files at a time; send them in parts"
            )
        if self._bytes > self._most_bytes:
            raise RefusedError(
                413, f"{name}: expected at most {self._most_bytes / 1e6:g} MB at a time; send them in parts"
            )


def _check_suffix(name: str) -> str:
    suffix = Path(name).suffix.lower()
    if suffix not in MOTIONS | SKELETONS | VIDEOS | PICTURES | TABLES | {_ARCHIVE}:
        raise RefusedError(
            415,
            f"{name}: expected a motion (.bvh, .amc with .asf, .c3d, .trc, .npz), masks, a video, a calibration or a "
            f".zip of them, got {suffix or 'a file without a suffix'}",
        )
    return suffix


def _check_content(path: Path, name: str) -> None:
    """Whether a file can be what its name says; whether it is, its reader finds out."""
    with open(path, "rb") as file:
        head = file.read(512)
    if not head:
        raise RefusedError(415, f"{name}: the file is empty; was the copy interrupted?")
    suffix = Path(name).suffix.lower()
    starts = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    is_text = b"\0" not in head
    fits = {
        ".bvh": is_text and starts[:9].upper() == b"HIERARCHY",
        ".amc": is_text and starts[:1] in (b"#", b":", *(b"%d" % digit for digit in range(10))),
        ".asf": is_text and starts[:1] in (b"#", b":"),
        ".trc": is_text and starts[:12].lower().startswith(b"pathfiletype"),
        ".c3d": len(head) == 512 and head[1] == 0x50,
        ".npz": head[:2] == b"PK",
        ".png": head[:4] == b"\x89PNG",
    }
    if not fits.get(suffix, is_text or suffix not in TABLES):
        raise RefusedError(415, f"{name}: the content is not that of a {suffix} file")


@contextmanager
def _temporary(workspace: Workspace) -> Iterator[tuple[IO[bytes], Path]]:
    path = workspace.root / "files" / f".{secrets.token_hex(8)}.part"
    try:
        with open(path, "xb") as file:
            yield file, path
    finally:
        with suppress(OSError):
            path.unlink()


def _unpack(archive: Path, batch: str, workspace: Workspace, room: _Room) -> Received:
    kept: list[tuple[str, int]] = []
    refused: list[tuple[str, str]] = []
    try:
        with zipfile.ZipFile(archive) as packed:
            members = [member for member in packed.infolist() if not member.is_dir()]
            _check_archive(members, archive.stat().st_size, room)
            for member in members:
                try:
                    kept.append(_unpack_one(packed, member, batch, workspace, room))
                except RefusedError as error:
                    if (
                        error.status == 413
                    ):  # there is no more room: what lies about its size is not searched on
                        raise
                    refused.append((member.filename, error.problem))
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, ValueError) as error:
        raise RefusedError(415, f"the zip archive cannot be read: {error}") from error
    except RefusedError:
        for name, _ in kept:
            with suppress(OSError):
                workspace.find(batch, name).unlink()
        raise
    if not kept and refused:
        raise RefusedError(415, f"nothing in this archive can be used; the first: {refused[0][1]}")
    return Received(batch, tuple(kept), tuple(refused))


def _check_archive(members: list[zipfile.ZipInfo], packed_bytes: int, room: _Room) -> None:
    """What the archive says of itself; whether that is true is seen while it is unpacked."""
    if not members:
        raise RefusedError(415, "the zip archive is empty")
    total = sum(member.file_size for member in members)
    if total > max(_TIMES_LARGER * packed_bytes, _SMALL):
        raise RefusedError(
            413,
            f"this archive says it holds {total / 1e6:,.0f} MB in {packed_bytes / 1e6:.1f} MB; unpack it first",
        )


def _unpack_one(
    packed: zipfile.ZipFile, member: zipfile.ZipInfo, batch: str, workspace: Workspace, room: _Room
) -> tuple[str, int]:
    parts = safe_parts(member.filename)
    name = "/".join(parts)
    if member.flag_bits & 1:
        raise RefusedError(415, f"{name}: encrypted; unpack the archive first")
    if stat.S_ISLNK(member.external_attr >> 16):
        raise RefusedError(415, f"{name}: a link, not a file")
    if _check_suffix(name) == _ARCHIVE:
        raise RefusedError(415, f"{name}: an archive inside an archive; unpack it first")
    room.take(name, member.file_size)
    with _temporary(workspace) as (file, path):
        left = member.file_size
        with packed.open(member) as source:
            while chunk := source.read(_CHUNK):
                left -= len(chunk)
                if left < 0:
                    raise RefusedError(413, f"{name}: larger than the archive says it is")
                file.write(chunk)
        file.close()
        _check_content(path, name)
        os.replace(path, workspace.place(batch, name))
    return name, member.file_size
