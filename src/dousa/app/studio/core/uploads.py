"""Receive files: count them while they come, check them before they are kept, and unpack archives with care."""

from __future__ import annotations

import io
import os
import secrets
import stat
import zipfile
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from starlette.concurrency import run_in_threadpool

from dousa.app.studio.core.answers import RefusedError, describe_disk
from dousa.app.studio.core.workspace import Settings, Workspace, safe_parts
from dousa.formats.packed import DAMAGE
from dousa.formats.registry import list_suffixes
from dousa.messages import Message

SKELETONS = frozenset({".asf"})
VIDEOS = frozenset({".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v"})
PICTURES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"})
SOUNDS = frozenset({".wav", ".mp3", ".flac", ".ogg", ".opus", ".m4a", ".aac"})
TABLES = frozenset({".toml", ".xml", ".yaml", ".yml", ".json", ".csv", ".txt"})
CALIBRATIONS = frozenset({".xcp", ".calib", ".pickle"})  # a pickle is read, not run: see `dousa.files.pickles`
LABELS = frozenset({".eaf", ".textgrid"})
_ARCHIVE = ".zip"

_BOXES = frozenset({b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot"})  # the first one of MP4 and MOV
# Bytes: a list of contents of 20,000 entries, each 46 (ZIP specification, 4.3.12) and the longest name that is taken.
_MOST_AT_ONCE = 25_000_000


@dataclass(frozen=True, slots=True)
class Received:
    """The files of an upload: the batch, (name, bytes) of those kept, and (name, reason) of those refused."""

    batch: str
    files: tuple[tuple[str, int], ...]
    refused: tuple[tuple[str, Message], ...]


async def receive(
    body: AsyncIterator[bytes], name: str, batch: str | None, workspace: Workspace, settings: Settings
) -> Received:
    """Keep an uploaded file, or the files of an uploaded zip archive.

    Raises RefusedError, and keeps nothing, for a name, kind, size or content that is not accepted.

    Parameters
    ----------
    body : its bytes.
    name : its path below the folder that was dropped.
    batch : where to put it; None for a new one.
    workspace, settings : of the studio.
    """
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
                    raise RefusedError(413, "studio_files.large", most=settings.most_bytes / 1e6)
                file.write(chunk)
            file.close()
            room = _Room(workspace, made, settings)
            take_in = _unpack if suffix == _ARCHIVE else _put
            return await run_in_threadpool(take_in, path, name, workspace, room)
    except BaseException:
        if batch is None:
            workspace.discard(made)
        raise


def _put(path: Path, name: str, workspace: Workspace, room: _Room) -> Received:
    _check_content(path, name)
    size = path.stat().st_size
    room.take(size)
    try:
        os.replace(path, workspace.place(room.batch, name))
    except BaseException:
        room.give_back(size)
        raise
    return Received(room.batch, (("/".join(safe_parts(name)), size),), ())


class _Room:
    """Counts what still fits into a batch."""

    def __init__(self, workspace: Workspace, batch: str, settings: Settings) -> None:
        self.batch, self._workspace = batch, workspace
        self.most = settings.most_files, settings.most_unpacked_bytes

    def take(self, size: int) -> None:
        if not self._workspace.grow(self.batch, 1, size, self.most):
            raise RefusedError(413, "studio_files.large_batch", files=self.most[0], most=self.most[1] / 1e6)

    def give_back(self, size: int) -> None:
        self._workspace.grow(self.batch, -1, -size, self.most)


def motion_suffixes() -> frozenset[str]:
    """The last suffixes of the motion files that can be read, those of plug-ins included."""
    return frozenset(Path(f"a{suffix}").suffix for suffix in list_suffixes())


def _check_suffix(name: str) -> str:
    suffix = Path(name).suffix.lower()
    if suffix not in motion_suffixes() | SKELETONS | VIDEOS | SOUNDS | PICTURES | TABLES | CALIBRATIONS | LABELS | {
        _ARCHIVE
    }:
        if suffix:
            raise RefusedError(415, "studio_files.other_kind", suffix=suffix)
        raise RefusedError(415, "studio_files.no_suffix")
    return suffix


def _check_content(path: Path, name: str) -> None:
    with open(path, "rb") as file:
        head = file.read(512)
    if not head:
        raise RefusedError(415, "studio_files.empty")
    suffix = Path(name).suffix.lower()
    starts = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    is_text = b"\0" not in head
    is_markup, is_box, is_glb = is_text and starts[:1] == b"<", head[4:8] in _BOXES, head[:4] == b"glTF"
    fits = {
        ".bvh": is_text and starts[:9].upper() == b"HIERARCHY",
        ".amc": is_text and starts[:1] in (b"#", b":", *(b"%d" % digit for digit in range(10))),
        ".asf": is_text and starts[:1] in (b"#", b":"),
        ".trc": is_text and starts[:12].lower().startswith(b"pathfiletype"),
        ".c3d": len(head) == 512 and head[1] == 0x50,
        ".npz": head[:2] == b"PK",
        ".npy": head[:6] == b"\x93NUMPY",
        ".json": is_text and starts[:1] in (b"{", b"["),
        ".gltf": is_text and starts[:1] == b"{",
        ".vmd": head[:20] == b"Vocaloid Motion Data",
        ".fbx": head[:18] == b"Kaydara FBX Binary" or (is_text and b"FBX" in head),
        ".tsv": is_text,
        ".textgrid": is_text or head[:2] in (b"\xff\xfe", b"\xfe\xff"),
        ".png": head[:4] == b"\x89PNG",
        ".bmp": head[:2] == b"BM",
        ".avi": head[:4] == b"RIFF" and head[8:12] == b"AVI ",
        ".wav": head[:4] in (b"RIFF", b"RF64") and head[8:12] == b"WAVE",
        ".flac": head[:4] == b"fLaC",
        **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), head.startswith((b"#usda", b"PXR-USDC", b"PK"))),
        **dict.fromkeys((".dae", ".mvnx", ".eaf", ".xcp"), is_markup),
        ".calib": is_text,
        ".pickle": head[:1] == b"\x80" or is_text,
        **dict.fromkeys((".glb", ".vrm", ".vrma"), is_glb),
        **dict.fromkeys((".jpg", ".jpeg"), head[:2] == b"\xff\xd8"),
        **dict.fromkeys((".tif", ".tiff"), head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")),
        # A list of addresses that calls itself a film would be followed by the decoder.
        **dict.fromkeys((".mp4", ".m4v", ".mov", ".m4a"), is_box),
        **dict.fromkeys((".mkv", ".webm"), head[:4] == b"\x1a\x45\xdf\xa3"),
        **dict.fromkeys((".ogg", ".opus"), head[:4] == b"OggS"),
        **dict.fromkeys((".mp3", ".aac"), head[:3] == b"ID3" or (head[0] == 0xFF and head[1:2] >= b"\xe0")),
    }
    if not fits.get(suffix, is_text or suffix not in TABLES):
        raise RefusedError(415, "studio_files.other_content", suffix=suffix)


@contextmanager
def _temporary(workspace: Workspace) -> Iterator[tuple[IO[bytes], Path]]:
    path = workspace.root / "files" / f".{secrets.token_hex(8)}.part"
    try:
        with open(path, "xb") as file:
            yield file, path
    finally:
        with suppress(OSError):
            path.unlink()


class _Archive(io.FileIO):
    """The file of an archive, from which no more is read at once than an honest list of contents takes."""

    def read(self, size: int | None = -1) -> bytes:
        if size is None or size < 0:  # all that is left
            size = max(0, os.fstat(self.fileno()).st_size - self.tell())
        if size > _MOST_AT_ONCE:
            raise RefusedError(413, "studio_files.archive_lies")
        return super().read(size) or b""


def _unpack(archive: Path, _name: str, workspace: Workspace, room: _Room) -> Received:
    kept: list[tuple[str, int]] = []
    refused: list[tuple[str, Message]] = []
    try:
        with _Archive(archive) as file, zipfile.ZipFile(file) as packed:
            members = [member for member in packed.infolist() if not member.is_dir()]
            _check_archive(members, archive.stat().st_size, room)
            for member in members:
                try:
                    kept.append(_unpack_one(packed, member, workspace, room))
                except RefusedError as error:
                    if error.status == 413:  # no more room: what lies about its size is not searched on
                        raise
                    refused.append((member.filename[:1_000], error.message))  # letters, of a name in an answer
    except BaseException as error:
        for name, size in kept:
            room.give_back(size)
            with suppress(OSError, RefusedError):
                workspace.find(room.batch, name).unlink()
        if isinstance(error, DAMAGE) and not _is_disk(error):
            raise RefusedError(415, "studio_files.archive_damaged", reason=error) from error
        raise
    if not kept and refused:
        raise RefusedError(415, "studio_files.archive_useless", first=refused[0][1])
    return Received(room.batch, tuple(kept), tuple(refused))


def _is_disk(error: BaseException) -> bool:
    return isinstance(error, OSError) and describe_disk(error) is not None


def _check_archive(members: list[zipfile.ZipInfo], packed_bytes: int, room: _Room) -> None:
    if not members:
        raise RefusedError(415, "studio_files.archive_empty")
    if len(members) > room.most[0]:
        raise RefusedError(413, "studio_files.archive_files", most=room.most[0], found=len(members))
    total = sum(member.file_size for member in members)
    # an honest archive of motions shrinks them ten times at most
    if total > max(200 * packed_bytes, 20_000_000):
        raise RefusedError(413, "studio_files.archive_large", total=total / 1e6, packed=packed_bytes / 1e6)


def _unpack_one(
    packed: zipfile.ZipFile, member: zipfile.ZipInfo, workspace: Workspace, room: _Room, *, chunk_bytes: int = 1 << 20
) -> tuple[str, int]:
    parts = safe_parts(member.filename)
    name = "/".join(parts)
    if member.flag_bits & 1:
        raise RefusedError(415, "studio_files.encrypted")
    if stat.S_ISLNK(member.external_attr >> 16):
        raise RefusedError(415, "studio_files.link")
    if _check_suffix(name) == _ARCHIVE:
        raise RefusedError(415, "studio_files.archive_inside")
    room.take(member.file_size)
    try:
        with _temporary(workspace) as (file, path):
            left = member.file_size
            with packed.open(member) as source:
                while chunk := source.read(chunk_bytes):
                    left -= len(chunk)
                    if left < 0:
                        raise RefusedError(413, "studio_files.larger_than_said")
                    file.write(chunk)
            file.close()
            _check_content(path, name)
            os.replace(path, workspace.place(room.batch, name))
    except BaseException:
        room.give_back(member.file_size)
        raise
    return name, member.file_size
