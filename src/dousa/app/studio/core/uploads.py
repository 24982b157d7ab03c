"""Receive files: count them while they come; look at them, and unpack archives, in a process with limits.

An upload is written to a new batch of its own. When all of it has been looked at, it stays there or goes to an earlier
one.
"""

from __future__ import annotations

import io
import os
import secrets
import stat
import zipfile
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool

from dousa.app.studio.core.answers import RefusedError, describe_disk
from dousa.app.studio.core.workspace import Settings, Workspace, place_below, safe_parts
from dousa.formats.annotations import LABEL_SUFFIXES, is_label_file
from dousa.formats.packed import DAMAGE
from dousa.formats.registry import is_motion_file, list_suffixes

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
class Taken:
    """A file that was taken in: its name in the batch, bytes, whether it is a motion; and of a table of labels
    ``labels_of``, the name without a suffix of the take that it belongs to."""

    name: str
    n_bytes: int
    is_motion: bool
    labels_of: str | None


@dataclass(frozen=True, slots=True)
class Received:
    """The files of an upload: the batch, those kept, and (name, error) of those refused."""

    batch: str
    files: tuple[Taken, ...]
    refused: tuple[tuple[str, RefusedError], ...]


async def receive(
    body: AsyncIterator[bytes],
    name: str,
    batch: str | None,
    workspace: Workspace,
    settings: Settings,
    run: Callable[..., Any],
) -> Received:
    """Keep an uploaded file, or the files of an uploaded zip archive.

    Raises RefusedError, and keeps nothing, for a name, kind, size or content that is not accepted.

    Parameters
    ----------
    body : its bytes.
    name : its path below the folder that was dropped.
    batch : where to put it; None for a new one.
    workspace, settings : of the studio.
    run : calls a function in a process with limits, as `Reader.run`.
    """
    safe_parts(name)
    _check_suffix(name)
    if batch is not None:
        workspace.batch_folder(batch)
    with workspace.fill_batch() as made:
        folder = workspace.batch_folder(made)
        path = await _write(body, folder, settings.most_bytes)
        most = settings.most_files, settings.most_unpacked_bytes
        came = Received(made, *await run_in_threadpool(run, take_in, path, name, folder, most, seconds=180.0))
        if batch is not None:
            came = await run_in_threadpool(_move, came, batch, workspace, most)
    if not came.files:
        raise came.refused[0][1]
    return came


async def _write(body: AsyncIterator[bytes], folder: Path, most: int) -> Path:
    """Write what comes to a hidden file, which the next studio removes if this one is killed."""
    path = folder / f".upload.{secrets.token_hex(6)}.part"
    size = 0
    with open(path, "xb") as file:
        async for chunk in body:
            size += len(chunk)
            if size > most:
                raise RefusedError(413, "studio_files.large", most=most / 1e6)
            file.write(chunk)
    return path


def _move(came: Received, batch: str, workspace: Workspace, most: tuple[int, int]) -> Received:
    """Move files into an earlier batch, all that fit there or, without room for all of them, none."""
    kept, refused = list(came.files), list(came.refused)
    n_bytes = sum(file.n_bytes for file in kept)
    if not workspace.grow(batch, len(kept), n_bytes, most):
        raise RefusedError(413, "studio_files.large_batch", files=most[0], most=most[1] / 1e6)
    for file in came.files:
        try:
            os.replace(workspace.batch_folder(came.batch) / file.name, workspace.place(batch, file.name))
        except RefusedError as error:
            kept.remove(file)
            refused.append((file.name, error))
            workspace.grow(batch, -1, -file.n_bytes, most)
    workspace.discard(came.batch)
    return Received(batch, tuple(kept), tuple(refused))


def take_in(
    path: Path, name: str, folder: Path, most: tuple[int, int]
) -> tuple[tuple[Taken, ...], tuple[tuple[str, RefusedError], ...]]:
    """Move an upload, or what a zip archive holds, to its places in an empty folder; for a `Reader`, as files lie.

    Returns what is there now, and (name, error) of members of an archive that were refused. Raises RefusedError if that
    is all of them, or the upload itself is not accepted.

    Parameters
    ----------
    path : of the upload, which is gone afterwards.
    name : as it came.
    folder : of the batch.
    most : files, and bytes of all of them.
    """
    refused: list[tuple[str, RefusedError]] = []
    kept = ["/".join(safe_parts(name))]
    if Path(name).suffix.lower() == _ARCHIVE:
        kept = _unpack(path, folder, most, refused)
        path.unlink()
        if not kept:
            raise RefusedError(415, "studio_files.archive_useless", first=refused[0][1].message)
    else:
        if path.stat().st_size > most[1]:
            raise RefusedError(413, "studio_files.large_batch", files=most[0], most=most[1] / 1e6)
        _check_content(path, name)
        os.replace(path, place_below(folder, name))
    return describe_files(folder, kept), tuple(refused)


def describe_files(folder: Path, names: Sequence[str]) -> tuple[Taken, ...]:
    """Look at files of a batch; for a `Reader`."""
    found = []
    for name in names:
        path = folder / name
        is_motion = is_motion_file(path)
        found.append(Taken(name, path.stat().st_size, is_motion, None if is_motion else _name_take(folder, name)))
    return tuple(found)


def _name_take(folder: Path, table: str) -> str | None:
    """The name of a take, without its suffix, whose labels are in a table beside it; None of what is no such table."""
    suffix = next((one for one in (*LABEL_SUFFIXES, ".csv", ".tsv") if table.lower().endswith(one)), None)
    return None if suffix is None or not is_label_file(folder / table) else table[: -len(suffix)]


def is_film(name: str) -> bool:
    """Whether a file is called like a film."""
    return Path(name).suffix.lower() in VIDEOS


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


class _Archive(io.FileIO):
    """The file of an archive, from which no more is read at once than an honest list of contents takes."""

    def read(self, size: int | None = -1) -> bytes:
        if size is None or size < 0:  # all that is left
            size = max(0, os.fstat(self.fileno()).st_size - self.tell())
        if size > _MOST_AT_ONCE:
            raise RefusedError(413, "studio_files.archive_lies")
        return super().read(size) or b""


def _unpack(archive: Path, folder: Path, most: tuple[int, int], refused: list[tuple[str, RefusedError]]) -> list[str]:
    kept: dict[str, None] = {}  # each once, also if an archive has it twice
    try:
        with _Archive(archive) as file, zipfile.ZipFile(file) as packed:
            members = [member for member in packed.infolist() if not member.is_dir()]
            _check_archive(members, archive.stat().st_size, most)
            for member in members:
                try:
                    kept[_unpack_one(packed, member, folder)] = None
                except RefusedError as error:
                    if error.status == 413:  # what lies about its size is not searched on
                        raise
                    refused.append((member.filename[:1_000], error))  # letters, of a name in an answer
    except DAMAGE as error:
        if isinstance(error, OSError) and describe_disk(error) is not None:
            raise
        raise RefusedError(415, "studio_files.archive_damaged", reason=error) from error
    return list(kept)


def _check_archive(members: list[zipfile.ZipInfo], packed_bytes: int, most: tuple[int, int]) -> None:
    if not members:
        raise RefusedError(415, "studio_files.archive_empty")
    if len(members) > most[0]:
        raise RefusedError(413, "studio_files.archive_files", most=most[0], found=len(members))
    total = sum(member.file_size for member in members)
    # an honest archive of motions shrinks them ten times at most
    if total > max(200 * packed_bytes, 20_000_000):
        raise RefusedError(413, "studio_files.archive_large", total=total / 1e6, packed=packed_bytes / 1e6)
    if total > most[1]:
        raise RefusedError(413, "studio_files.large_batch", files=most[0], most=most[1] / 1e6)


def _unpack_one(packed: zipfile.ZipFile, member: zipfile.ZipInfo, folder: Path, *, chunk_bytes: int = 1 << 20) -> str:
    name = "/".join(safe_parts(member.filename))
    if member.flag_bits & 1:
        raise RefusedError(415, "studio_files.encrypted")
    if stat.S_ISLNK(member.external_attr >> 16):
        raise RefusedError(415, "studio_files.link")
    if _check_suffix(name) == _ARCHIVE:
        raise RefusedError(415, "studio_files.archive_inside")
    path = folder / f".member.{secrets.token_hex(6)}.part"
    left = member.file_size
    try:
        with open(path, "xb") as file, packed.open(member) as source:
            while chunk := source.read(chunk_bytes):
                left -= len(chunk)
                if left < 0:
                    raise RefusedError(413, "studio_files.larger_than_said")
                file.write(chunk)
        _check_content(path, name)
        os.replace(path, place_below(folder, name))
    finally:
        path.unlink(missing_ok=True)
    return name
