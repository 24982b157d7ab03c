"""Calibration files: Qualisys XML, Pose2Sim TOML, OpenCV YAML, XML and JSON, and the cameras of an npz sequence.

A file is known by its content, not by its suffix. To add a format, write a module with a `CameraFormat` and name it in
``_FORMATS``.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from dousa.errors import CalibrationError, MotionFileError
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.cameras.camera_formats import (
    POSE2SIM,
    QUALISYS,
    CameraFormat,
    RawCamera,
    check_distance,
    find_up,
    format_cameras,
    read_npz_cameras,
    settle_camera,
)
from dousa.estimation.cameras.camera_sets import check_names, find_views
from dousa.estimation.cameras.opencv import OPENCV
from dousa.files.disk import atomic_write, read_bytes
from dousa.messages import Message
from dousa.motion.canonical.reference_frame import parse_unit, parse_up

_FORMATS = (QUALISYS, POSE2SIM, OPENCV)
_ARRAYS = CameraFormat("npz", lambda _content, _stem: None, unit=1.0, up="y", unit_is_sure=True)
_SUFFIXES = (".xml", ".txt", ".qca", ".toml", ".yml", ".yaml", ".json", ".npz")
_MOST_BYTES = 5_000_000
_MOST_FILES = 1000
_LONGEST_TEXT, _MOST_TEXTS = 80, 10  # of a file in a message

_Found = tuple[CameraFormat, list[RawCamera]]


def read_cameras(
    path: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    *,
    sizes: Sequence[tuple[int, int]] | None = None,
    unit: float | str | None = None,
    up: str | None = None,
) -> tuple[Camera, ...]:
    """Read calibrated cameras.

    Parameters
    ----------
    path : a calibration file, or a folder with one for each camera.
    names : (V,) which cameras, in which order, found as `match_cameras` does but never by their order; by default
        all, in the order of the file (in a folder, of the names of the files).
    sizes : (V,) width and height in pixels for cameras whose file tells none, in the order of ``names``. Other
        cameras keep the size of their calibration, see `fit_cameras`.
    unit : metres per unit of the file, or its name; by default Qualisys in mm, others in m.
    up : axis of the file's world that points up; by default Z for Qualisys and Pose2Sim, Y for npz. OpenCV has no
        habit: the axis that the cameras' own up directions are nearest to on average.

    Returns
    -------
    Cameras in metres with Y up. A world with Z up is turned by (x, y, z) -> (y, z, x), as Pose2Sim does.

    Raises
    ------
    CalibrationError : no such file, of no known format, damaged, numbers that make no camera, two cameras of one name,
        no size, no clear up axis, cameras further than 100 m from the origin with no unit given, a name without
        camera.
    OptionError : no such unit or axis.
    """
    metres = None if unit is None else parse_unit(unit)
    axis = None if up is None else parse_up(up)
    try:
        read = _read_folder(Path(path)) if os.path.isdir(path) else [_read_file(path)]
        found = [(raw, metres or shape.unit, axis or shape.up or find_up(raws)) for shape, raws in read for raw in raws]
        check_names([raw.name for raw, _, _ in found])
        if metres is None:
            check_distance([raw for shape, raws in read if not shape.unit_is_sure for raw in raws])
        if names is not None:
            found = [found[index] for index in find_views([raw.name for raw, _, _ in found], names)]
        if sizes is not None and len(sizes) != len(found):
            raise CalibrationError("camera_files.sizes", cameras=len(found), sizes=len(sizes))
        return tuple(
            settle_camera(raw, None if sizes is None else sizes[index], scale, up_axis)
            for index, (raw, scale, up_axis) in enumerate(found)
        )
    except CalibrationError as error:
        error.message = _tame(error.message)
        error.at(path)
        raise


def _tame(value: Any) -> Any:
    """A message in one short line, though names and values in it come from the file."""
    if isinstance(value, Message):
        return Message(value.code, **{name: _tame(part) for name, part in value.values.items()})
    if isinstance(value, tuple):
        return tuple(_tame(part) for part in value[:_MOST_TEXTS])
    if not isinstance(value, str):
        return value
    text = "".join(letter if letter.isprintable() else " " for letter in value[:_LONGEST_TEXT])
    return text if len(value) <= _LONGEST_TEXT else f"{text}..."


class _NoCalibrationError(CalibrationError):
    """The content is of no format that is known."""


def _read_folder(folder: Path) -> list[_Found]:
    """What the files of a folder hold; files that are no calibration are passed over."""
    try:
        paths = [entry for entry in folder.iterdir() if entry.suffix.lower() in _SUFFIXES]
    except OSError as error:
        raise CalibrationError("camera_files.folder_unreadable", reason=error) from error
    if len(paths) > _MOST_FILES:
        raise CalibrationError("camera_files.many_files", found=len(paths))
    found: list[_Found] = []
    for path in sorted(paths, key=_natural_key):
        if path.name.startswith(".") or not path.is_file():
            continue
        try:
            found.append(_read_file(path))
        except _NoCalibrationError:
            continue
        except CalibrationError as error:
            error.at(path)
            raise
    if not found:
        raise CalibrationError("camera_files.empty_folder")
    return found


def _natural_key(path: Path) -> list[tuple[int, str]]:
    """cam2 before cam10."""
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in re.split(r"(\d+)", path.name.lower())]


def _read_file(path: str | os.PathLike[str]) -> _Found:
    content = _read_content(path)
    if content is None:
        return _ARRAYS, read_npz_cameras(path)
    name = Path(path).name
    stem = name[: -len(".qca.txt")] if name.lower().endswith(".qca.txt") else Path(path).stem
    for shape in _FORMATS:
        try:
            raws = shape.parse(content, stem)
        except RecursionError:
            raise CalibrationError("camera_files.nested") from None
        if raws:
            return shape, raws
    raise _NoCalibrationError(Message("camera_files.unknown"))


def _read_content(path: str | os.PathLike[str]) -> bytes | None:
    """The bytes of a file of text; None for an npz, which may be large and is read in parts."""
    size = 0
    with suppress(OSError, ValueError):  # what cannot be opened is for read_bytes to name
        status = os.stat(path)
        size = status.st_size if stat.S_ISREG(status.st_mode) else 0  # opening a pipe may wait for ever
        if size:
            with open(path, "rb") as file:
                if file.read(4) == b"PK\x03\x04":
                    return None
    if size > _MOST_BYTES:
        raise _NoCalibrationError(Message("camera_files.too_large", megabytes=size / 1e6))
    try:
        return read_bytes(path)
    except MotionFileError as error:
        raise CalibrationError(error.message) from error


def write_cameras(path: str | os.PathLike[str], cameras: Sequence[Camera]) -> None:
    """Write cameras as a Pose2Sim TOML; the file appears whole or not at all.

    `read_cameras` reads the same cameras to rounding error. The world is written with Z up, (x, y, z) -> (z, x, y).
    Pose2Sim does not know orthographic cameras; they carry a key of their own.

    Parameters
    ----------
    path : the file to write or replace.
    cameras : one or more, of different names.

    Raises
    ------
    CalibrationError : no camera, two of one name, a name that is no text.
    MotionWriteError : the folder is missing or read-only, or the disk is full.
    """
    if not cameras:
        raise CalibrationError("camera_files.nothing_to_write").at(path)
    try:
        check_names([camera.name for camera in cameras])
        content = format_cameras(cameras)
    except CalibrationError as error:
        error.at(path)
        raise
    with atomic_write(path) as file:
        file.write(content)
