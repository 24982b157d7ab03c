"""Calibration files, and folders of them; the content determines the format.

To add a format, write a `CameraFormat` and add it to ``_FORMATS``.
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
from dousa.estimation.cameras.camera import Camera, check_names, find_views
from dousa.estimation.cameras.camera_formats import (
    ANIPOSE,
    CALISCOPE,
    POSE2SIM,
    QUALISYS,
    CameraFormat,
    RawCamera,
    check_distance,
    find_unit,
    find_up,
    format_cameras,
    read_npz_cameras,
    settle_camera,
)
from dousa.estimation.cameras.capture_formats import BIOCV, EASYMOCAP, OPENCAP, VICON, lacks_half
from dousa.estimation.cameras.opencv_storage import OPENCV
from dousa.files.disk import atomic_write, read_bytes
from dousa.messages import Message
from dousa.motion.canonical.reference_frame import parse_unit, parse_up

_FORMATS = (QUALISYS, VICON, POSE2SIM, ANIPOSE, CALISCOPE, OPENCAP, BIOCV, EASYMOCAP, OPENCV)
# By definition, see `mask_npz`.
_ARRAYS = CameraFormat("npz", lambda _content, _stem: None, unit=1.0, up="y", unit_is_sure=True)
_SUFFIXES = (
    ".xml", ".txt", ".qca", ".xcp", ".toml", ".yml", ".yaml", ".json", ".calib", ".pickle", ".pkl", ".npz"
)  # fmt: skip
_OPENCAP_STEM = "cameraintrinsicsextrinsics"

_Found = tuple[CameraFormat, list[RawCamera]]


def read_cameras(
    path: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    *,
    sizes: Sequence[tuple[int, int]] | None = None,
    unit: float | str | None = None,
    up: str | None = None,
) -> tuple[Camera, ...]:
    """Read calibrated cameras, in metres with Y up.

    A world with Z up is turned by (x, y, z) -> (y, z, x), as Pose2Sim does.

    Parameters
    ----------
    path : a calibration file, or a folder with one for each camera, or of folders of cameras.
    names : (V,) which cameras, in which order, matched as by `match_cameras` but never by order; by default all, in
        the order of the file (in a folder, of the names of the files).
    sizes : (V,) width and height in pixels for cameras without a size in the file, in the order of ``names``. Other
        cameras keep the size of their calibration, see `fit_cameras`.
    unit : metres per unit of the file, or its name; by default that of the format, see docs/cameras.md.
    up : axis of the file's world that points up; by default Z for Qualisys, Vicon, BioCV and Pose2Sim, Y for npz, and
        for others the axis nearest to the cameras' own mean up direction.

    Raises
    ------
    CalibrationError : no such file, an unknown format, damaged, invalid numbers, two cameras of one name, no size, no
        clear up axis, cameras further than 100 m from the origin with no unit given, a name without camera.
    OptionError : no such unit or axis.
    """
    metres = None if unit is None else parse_unit(unit)
    axis = None if up is None else parse_up(up)
    try:
        read = _read_folder(Path(path)) if os.path.isdir(path) else [_read_file(path)]
        found = [
            (raw, metres or shape.unit or find_unit(together), axis or shape.up or find_up(together), shape.centred)
            for shape, raws in read
            for together in [[raw for other, some in read if other is shape for raw in some]]
            for raw in raws
        ]
        check_names([raw.name for raw, *_ in found])
        if metres is None:
            check_distance([raw for shape, raws in read if shape.unit and not shape.unit_is_sure for raw in raws])
        if names is not None:
            found = [found[index] for index in find_views([raw.name for raw, *_ in found], names)]
        if sizes is not None and len(sizes) != len(found):
            raise CalibrationError("camera_files.sizes", cameras=len(found), sizes=len(sizes))
        return tuple(
            settle_camera(raw, None if sizes is None else sizes[index], scale, up_axis, centred)
            for index, (raw, scale, up_axis, centred) in enumerate(found)
        )
    except CalibrationError as error:
        error.message = _tame(error.message)
        error.at(path)
        raise


def _tame(value: Any, longest: int = 80, most: int = 10) -> Any:
    """Shorten a message, whose names and values come from the file, to ``most`` texts of ``longest`` letters each."""
    if isinstance(value, Message):
        return Message(value.code, **{name: _tame(part) for name, part in value.values.items()})
    if isinstance(value, tuple):
        return tuple(_tame(part) for part in value[:most])
    if not isinstance(value, str):
        return value
    text = "".join(letter if letter.isprintable() else " " for letter in value[:longest])
    return text if len(value) <= longest else f"{text}..."


class _NoCalibrationError(CalibrationError):
    """The content has no known format."""


def _read_folder(folder: Path) -> list[_Found]:
    """Read the calibration files of a folder, else those of the folders in it; other files are skipped."""
    try:
        inside = sorted(folder.iterdir(), key=_natural_key)
        found = _read_files(inside)
        if not found:
            cameras = [path for path in inside if path.is_dir() and not path.name.startswith(".")]
            found = _read_files([file for path in cameras for file in sorted(path.iterdir(), key=_natural_key)])
    except OSError as error:
        raise CalibrationError("camera_files.folder_unreadable", reason=error) from error
    if not found:
        raise CalibrationError("camera_files.empty_folder")
    return found


def _read_files(paths: Sequence[Path], most: int = 1000) -> list[_Found]:
    """Read those of the files that are calibrations, ``most`` at most."""
    paths = [path for path in paths if path.suffix.lower() in _SUFFIXES and not path.name.startswith(".")]
    if len(paths) > most:
        raise CalibrationError("camera_files.many_files", found=len(paths))
    found: list[_Found] = []
    for path in paths:
        try:
            shape, raws = _read_file(path) if path.is_file() else (None, [])
        except _NoCalibrationError:
            continue
        except CalibrationError as error:
            error.at(path)
            raise
        if shape is not None and not (shape is EASYMOCAP and any(other is EASYMOCAP for other, _ in found)):
            found.append((shape, raws))  # each half of EasyMocap has brought the other
    return found


def _natural_key(path: Path) -> list[tuple[int, str]]:
    """Sort cam2 before cam10."""
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in re.split(r"(\d+)", path.name.lower())]


def _read_file(path: str | os.PathLike[str]) -> _Found:
    content = _read_content(path)
    if content is None:
        return _ARRAYS, read_npz_cameras(path)
    place = Path(path)
    stem = place.name[: -len(".qca.txt")] if place.name.lower().endswith(".qca.txt") else place.stem
    if stem.lower() == _OPENCAP_STEM:
        stem = place.absolute().parent.name
    if place.suffix.lower() in (".yml", ".yaml") and lacks_half(content):
        content = b"\n".join([content, *_find_half(place)])
    for shape in _FORMATS:
        try:
            raws = shape.parse(content, stem)
        except RecursionError:
            raise CalibrationError("camera_files.nested") from None
        if raws:
            return shape, raws
    raise _NoCalibrationError(Message("camera_files.unknown"))


def _find_half(path: Path) -> list[bytes]:
    """Return the other file of EasyMocap, which lies beside; none if there is not exactly one."""
    lenses = path.parent / f"{'extri' if path.stem.lower().startswith('intri') else 'intri'}{path.suffix}"
    beside = [lenses] if lenses.is_file() else sorted(path.parent.glob(f"*{path.suffix}"))[:100]
    found = [_read_content(other) for other in beside if other != path and other.is_file()]
    halves = [content for content in found if content is not None and lacks_half(content)]
    return halves if len(halves) == 1 else []


def _read_content(path: str | os.PathLike[str], most: int = 5_000_000) -> bytes | None:
    """Return the bytes of a text file, ``most`` at most; None for an npz, which may be large and is read in parts."""
    size = 0
    with suppress(OSError, ValueError):  # what cannot be opened is for read_bytes to name
        status = os.stat(path)
        size = status.st_size if stat.S_ISREG(status.st_mode) else 0  # opening a pipe may wait for ever
        if size:
            with open(path, "rb") as file:
                if file.read(4) == b"PK\x03\x04":
                    return None
    if size > most:
        raise _NoCalibrationError(Message("camera_files.too_large", megabytes=size / 1e6))
    try:
        return read_bytes(path)
    except MotionFileError as error:
        raise CalibrationError(error.message) from error


def write_cameras(path: str | os.PathLike[str], cameras: Sequence[Camera]) -> None:
    """Write cameras as a Pose2Sim TOML; the file appears whole or not at all.

    `read_cameras` reads the same cameras to rounding error. The world has Z up, (x, y, z) -> (z, x, y). Orthographic
    cameras, unknown to Pose2Sim, have a key of their own.

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
