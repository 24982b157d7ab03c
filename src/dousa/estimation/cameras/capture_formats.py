"""Calibrations of programs for motion capture: EasyMocap, OpenCap, Vicon and BioCV.

EasyMocap writes two YAML files of OpenCV's FileStorage: ``intri.yml`` with ``K_NAME`` and ``dist_NAME``, ``extri.yml``
with ``Rot_NAME`` (or the vector ``R_NAME``) and ``T_NAME``, from the world to OpenCV's camera axes. The size of the
pictures is in neither; where nothing else tells it, the principal point is taken for their middle.

OpenCap pickles a dictionary for each camera: ``intrinsicMat`` (3, 3), ``distortion`` (1, 5), ``imageSize`` (height,
then width), ``rotation`` (3, 3) and ``translation`` (3, 1) from the axes of the board to OpenCV's, in mm. All files
have one name; the folder has the camera's.

Vicon's ``.xcp`` is XML: a ``Camera`` has ``DEVICEID`` and ``SENSOR_SIZE``, its ``KeyFrame`` the ``FOCAL_LENGTH`` and
``PRINCIPAL_POINT`` in pixels, the ``POSITION`` in mm and the ``ORIENTATION``, a quaternion (x, y, z, w) that turns the
world, Z up, to OpenCV's camera axes. ``VICON_RADIAL2`` (centre x, y and three coefficients) and ``VICON_RADIAL`` (two)
lead from the picture to straight lines, in pixels: q - c = (p - c) (1 + a d^2 + b d^4 + e d^6) with d = |p - c|.
OpenCV's coefficients lead the other way and are fitted.

BioCV's ``.calib`` is a text of numbers: width, height, the camera matrix (3 x 3), the matrix (4 x 4) from the world, in
mm with Z up, to OpenCV's camera axes, and four or five distortion coefficients as in OpenCV.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError, MotionFileError
from dousa.estimation.cameras.camera_formats import (
    CameraFormat,
    RawCamera,
    entry,
    read_distortion,
    read_numbers,
    rotation_from_vector,
)
from dousa.estimation.cameras.opencv_storage import read_array, read_yaml
from dousa.files.markup import parse_xml
from dousa.files.pickles import load_pickle
from dousa.motion.rotations import to_matrix

_LENSES = re.compile(rb"^K_(\w+)[ \t]*:", re.MULTILINE)
_POSES = re.compile(rb"^T_(\w+)[ \t]*:", re.MULTILINE)


def lacks_half(content: bytes) -> bool:
    """Return whether a file is one of EasyMocap's two: lenses without poses, or poses without lenses."""
    return (_LENSES.search(content) is None) != (_POSES.search(content) is None)


def _parse_easymocap(content: bytes, _stem: str) -> list[RawCamera] | None:
    if _LENSES.search(content) is None and _POSES.search(content) is None:
        return None
    try:
        documents = read_yaml(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise CalibrationError("opencv.encoding", reason=error) from error
    keys = {key: value for document in documents for key, value in document.items()}
    names = [key.removeprefix("K_") for key in keys if key.startswith("K_")]
    if not names:
        raise CalibrationError("easymocap.lenses")
    return [_read_easymocap(name, keys) for name in names]


def _read_easymocap(name: str, keys: Mapping[str, Any]) -> RawCamera:
    def read(key: str, shape: tuple[int, ...]) -> FloatArray:
        what = entry(name, key)
        if keys.get(key) is None:
            raise CalibrationError("easymocap.entry", camera=name, key=key)
        return read_numbers(read_array(keys[key], what), shape, what)

    matrix, translation = read(f"K_{name}", (3, 3)), read(f"T_{name}", (3,))
    whole = f"Rot_{name}" in keys
    rotation = read(f"Rot_{name}", (3, 3)) if whole else rotation_from_vector(read(f"R_{name}", (3,)))
    bent, what = keys.get(f"dist_{name}"), entry(name, f"dist_{name}")
    distortion = np.zeros(5) if bent is None else read_distortion(read_array(bent, what), what)
    sides = [keys.get(f"{side}_{name}") for side in "WH"]
    size = None
    if None not in sides:
        width, height = read_numbers(sides, (2,), entry(name, "W and H"))
        size = (round(width), round(height))
    return RawCamera(name, size, matrix, rotation, translation, distortion)


# Metres by the definition of EasyMocap; no size, and no convention about which axis is up.
EASYMOCAP = CameraFormat("EasyMocap YAML", _parse_easymocap, unit=1.0, up=None, centred=True)


def _parse_opencap(content: bytes, stem: str) -> list[RawCamera] | None:
    if not content.startswith(b"\x80") or b"intrinsicMat" not in content:
        return None
    try:
        keys = load_pickle(stem, content)
    except MotionFileError as error:
        raise CalibrationError(error.message) from error

    def read(key: str, shape: tuple[int, ...]) -> FloatArray:
        if key not in keys:
            raise CalibrationError("camera_files.no_entry", camera=stem, key=key)
        return read_numbers(keys[key], shape, entry(stem, key))

    height, width = read("imageSize", (2,))
    distortion = read_distortion(keys.get("distortion", [0.0] * 4), entry(stem, "distortion"))
    pose = read("rotation", (3, 3)), read("translation", (3,))
    return [RawCamera(stem, (round(width), round(height)), read("intrinsicMat", (3, 3)), *pose, distortion)]


# Millimetres by the definition of OpenCap; the board that makes the world may stand or lie.
OPENCAP = CameraFormat("OpenCap pickle", _parse_opencap, unit=0.001, up=None, unit_is_sure=True)


def _parse_vicon(content: bytes, _stem: str) -> list[RawCamera] | None:
    if not content.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return None
    root = parse_xml(content)
    elements = root.findall("Camera")
    if root.tag != "Cameras" or not elements:
        return None
    placed = [element for element in elements if element.find("KeyFrames/KeyFrame") is not None]
    films = [element for element in placed if _shows_pictures(element)]
    if not placed:
        raise CalibrationError("vicon.no_frames")
    return [_read_vicon(element) for element in films or placed]


def _shows_pictures(element: ET.Element) -> bool:
    """Whether a camera films, and does not see markers alone."""
    kinds = f"{element.get('TYPE', '')} {element.get('DISPLAY_TYPE', '')}".lower()
    return "video" in kinds or "vue" in kinds


def _read_vicon(element: ET.Element) -> RawCamera:
    name = (element.get("DEVICEID") or element.get("USERID") or "").strip() or "camera"
    frame = element.find("KeyFrames/KeyFrame")
    assert frame is not None

    def read(owner: ET.Element, key: str, shape: tuple[int, ...]) -> FloatArray:
        if owner.get(key) is None:
            raise CalibrationError("camera_files.no_entry", camera=name, key=key)
        return read_numbers((owner.get(key) or "").split(), shape, entry(name, key))

    width, height = read(element, "SENSOR_SIZE", (2,))
    (focal,), centre = read(frame, "FOCAL_LENGTH", (1,)), read(frame, "PRINCIPAL_POINT", (2,))
    aspect = read(element, "PIXEL_ASPECT_RATIO", (1,))[0] if element.get("PIXEL_ASPECT_RATIO") else 1.0
    skew = read(element, "SKEW", (1,))[0] if element.get("SKEW") else 0.0
    if not (focal > 0 and aspect > 0):
        raise CalibrationError("camera.focal", camera=name, x=focal, y=focal / aspect if aspect else 0.0)
    x, y, z, w = read(frame, "ORIENTATION", (4,))
    length = float(np.linalg.norm((w, x, y, z)))
    if not 0.99 < length < 1.01:
        raise CalibrationError("camera.rotation", camera=name)
    rotation = to_matrix(np.array([w, x, y, z]) / length)
    matrix = np.array([[focal, skew, centre[0]], [0.0, focal / aspect, centre[1]], [0.0, 0.0, 1.0]])
    size = (round(width), round(height))
    place = -rotation @ read(frame, "POSITION", (3,))
    return RawCamera(name, size, matrix, rotation, place, _read_radial(frame, name, matrix, size))


def _read_radial(frame: ET.Element, name: str, matrix: FloatArray, size: tuple[int, int]) -> FloatArray:
    key = "VICON_RADIAL2" if frame.get("VICON_RADIAL2") else "VICON_RADIAL"
    words = [word for word in (frame.get(key) or "").split() if not word.lower().startswith("vicon")]
    numbers = read_numbers(words, (len(words),), entry(name, key))
    centre, terms = (matrix[:2, 2], numbers) if key == "VICON_RADIAL" else (numbers[:2], numbers[2:])
    return fit_distortion(name, matrix, size, centre, [*terms, 0.0, 0.0, 0.0][:3])


def fit_distortion(
    name: str, matrix: FloatArray, size: tuple[int, int], centre: FloatArray, terms: Sequence[float], most: float = 0.5
) -> FloatArray:
    """Return OpenCV's coefficients (5,) of a lens that is described the other way, from the picture to straight lines.

    Parameters
    ----------
    name : of the camera.
    matrix, size : (3, 3) px, and px.
    centre, terms : (2,) px, and (3,) of the second, fourth and sixth power of the distance to it in px.
    most : px that the fitted lens may differ anywhere in the picture.

    Raises
    ------
    CalibrationError : a lens that OpenCV's coefficients do not describe.
    """
    if not np.any(terms):
        return np.zeros(5)
    columns, rows = np.meshgrid(np.linspace(0, size[0] - 1, 25), np.linspace(0, size[1] - 1, 25))
    seen = np.stack([columns.ravel(), rows.ravel()], axis=1)
    square = ((seen - centre) ** 2).sum(axis=1, keepdims=True)
    straight = centre + (seen - centre) * (1.0 + square * (terms[0] + square * (terms[1] + square * terms[2])))
    inverse = np.linalg.inv(matrix)
    (x, y), (u, v) = (inverse[:2, :2] @ points.T + inverse[:2, 2:] for points in (straight, seen))
    r = x * x + y * y
    design = np.concatenate(
        [
            np.stack([x * r, x * r**2, 2 * x * y, r + 2 * x * x, x * r**3], axis=1),
            np.stack([y * r, y * r**2, r + 2 * y * y, 2 * x * y, y * r**3], axis=1),
        ]
    )
    found: FloatArray = np.linalg.lstsq(design, np.concatenate([u - x, v - y]), rcond=None)[0]
    off = float(np.abs(design @ found - np.concatenate([u - x, v - y])).max() * matrix[0, 0])
    if not off <= most:
        raise CalibrationError("vicon.lens", camera=name, pixels=off)
    return found


# Millimetres and Z up by the definition of Vicon.
VICON = CameraFormat("Vicon XCP", _parse_vicon, unit=0.001, up="z", unit_is_sure=True)

_NUMBERS = re.compile(rb"[-+0-9.eE \t\r\n]+")


def _parse_biocv(content: bytes, stem: str) -> list[RawCamera] | None:
    if len(content) > 10_000 or _NUMBERS.fullmatch(content) is None:
        return None
    words = content.decode("ascii").split()
    if len(words) not in (31, 32):  # by definition 2 + 9 + 16, and 4 or 5 coefficients
        return None
    numbers = read_numbers(words, (len(words),), entry(stem, "numbers"))
    matrix, pose = numbers[2:11].reshape(3, 3), numbers[11:27].reshape(4, 4)
    if np.abs(pose[3] - (0.0, 0.0, 0.0, 1.0)).max() > 0:
        return None
    name = re.sub(r"\.(mp4|avi|mov|mkv)$", "", stem, flags=re.IGNORECASE)
    size = (round(float(numbers[0])), round(float(numbers[1])))
    bent = read_distortion(numbers[27:], entry(name, "distortion"))
    return [RawCamera(name, size, matrix, pose[:3, :3], pose[:3, 3], bent)]


# Millimetres and Z up by the definition of BioCV.
BIOCV = CameraFormat("BioCV calib", _parse_biocv, unit=0.001, up="z", unit_is_sure=True)
