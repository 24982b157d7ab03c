"""Output files: a file of other content that is already there is not overwritten."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from dousa.errors import DousaError, OptionError

DATABASE_HEAD = b"SQLite format 3\0"

PICTURES = (".png", ".svg", ".pdf")

# How the files begin that dousa writes, by their suffix; the name of its first array shows what an npz holds.
_BEGINNINGS = {
    ".png": rb"\x89PNG",
    ".pdf": rb"%PDF",
    ".svg": rb"<\?xml|<svg",
    ".bvh": rb"HIERARCHY",
    ".trc": rb"PathFileType",
    ".c3d": rb".\x50",
    ".npz": rb"PK.{28}(kind|poses)\.npy",
    ".csv": rb"(\xef\xbb\xbf)?(Format Version|time_s,pelvis_tilt)",
    ".fbx": rb"Kaydara|; FBX",
    ".glb": rb"glTF",
    ".mp4": rb".{4}ftyp",
    ".avi": rb"RIFF",
    ".mkv": rb"\x1a\x45\xdf\xa3",
    ".html": rb"<!doctype html>",
}
ANYTHING = dict.fromkeys(_BEGINNINGS, b"")
"""For a command whose options let it write over any file but a library."""

SYNC = {".toml": rb"# A film's own time plus"}
CAMERAS = {".toml": rb"\[cam_01\]\nname = "}
KEYPOINTS = {".npz": rb"PK.{28}names\.npy"}
SILHOUETTES = {".npz": rb"PK.{28}mask_packed\.npy"}
CLIP_MAP = {".csv": rb"clip_id,path,"}
ANGLES = {".csv": rb"time_s,"}
REPORT = {".csv": rb"(\xef\xbb\xbf)?(time_s|kind|number,complete),"}


def check_targets(
    targets: Mapping[str, Path | None],
    inputs: Iterable[str | os.PathLike[str] | None] = (),
    begins: Mapping[str, bytes] | None = None,
) -> None:
    """Check that files may be written, before the long work: each is new, or what the same option writes.

    Parameters
    ----------
    targets : path by option; None where the option was not given.
    inputs : files that are read, of which none may be written over.
    begins : how the files begin that this command writes, where that differs from `_BEGINNINGS`.

    Raises
    ------
    OptionError : a file that is read, a library, or one of another content stands there; a picture of no format.
    """
    known = {**_BEGINNINGS, **(begins or {})}
    sources = [path for path in inputs if path is not None]
    for option, path in targets.items():
        if path is not None and option == "--picture":
            find_picture_format(path)
        if path is None or not _look_for_danger(option, path, sources):
            continue
        beginning = known.get(path.suffix.lower())
        head = _read_head(path)
        if beginning is not None and head and re.match(beginning, head, re.DOTALL) is None:
            raise OptionError("targets.other_content", option=option, path=path, suffix=path.suffix)


def find_picture_format(path: str | os.PathLike[str]) -> str:
    """The format of a picture by its suffix; OptionError if it is not .png, .svg or .pdf."""
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in PICTURES:
        raise OptionError("pictures.suffix", path=path, expected=PICTURES, found=suffix)
    return suffix[1:]


def check_table(option: str, path: Path | None, inputs: Iterable[str | os.PathLike[str] | None]) -> None:
    """Check that a table may be written that people correct by hand: not over another one.

    Raises
    ------
    OptionError : a file that is read, a library or a motion, or any file that holds something.
    """
    if path is None or not _look_for_danger(option, path, [source for source in inputs if source is not None]):
        return
    if holds_motion(path):
        raise OptionError("targets.is_motion", option=option, path=path)
    if os.path.getsize(path):
        raise OptionError("targets.exists", option=option, path=path)


def is_same_file(path: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    """Whether both are one file; no where one of them is not there."""
    try:
        return os.path.samefile(path, other)
    except (OSError, ValueError):
        return False


def _look_for_danger(option: str, path: Path, sources: Iterable[str | os.PathLike[str]]) -> bool:
    """Whether a file is there; OptionError where it is an input of this command, or a library."""
    if not os.path.isfile(path):
        return False
    if any(is_same_file(path, source) for source in sources):
        raise OptionError("targets.is_input", option=option, path=path)
    if _read_head(path).startswith(DATABASE_HEAD):
        raise OptionError("targets.is_library", option=option, path=path)
    return True


def _read_head(path: Path, n_bytes: int = 200) -> bytes:
    try:
        with open(path, "rb") as file:
            return file.read(n_bytes)
    except OSError:
        return b""  # writing it fails with an error of its own


def holds_motion(path: Path) -> bool:
    """Return whether a file, or a folder with one for each frame, is a motion; what may be anything is read."""
    from dousa.formats.registry import find_reader, read_motion

    if find_reader(path) is None:
        return False
    if not path.is_dir() and path.suffix.lower() not in (".csv", ".tsv", ".json"):
        return True
    try:
        read_motion(path)
    except DousaError:
        return False
    return True
