"""OpenCV's FileStorage: YAML, XML or JSON, one camera for each file, document or section.

Keys as OpenCV's calibration sample writes them (``camera_matrix``, ``distortion_coefficients``, ``image_width``,
``image_height``) or as people usually name them; upper and lower case and underscores do not count. The sample writes
one pose for each view of the board; a camera's place needs one: ``R`` and ``T``, ``rvec`` and ``tvec``, or
``extrinsic_matrix``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import CalibrationError
from dousa.estimation._camera_raw import (
    CameraFormat,
    RawCamera,
    read_distortion,
    read_numbers,
    rotation_from_vector,
)
from dousa.estimation._opencv_storage import read_json, read_xml, read_yaml
from dousa.estimation._safe_xml import parse_xml

__all__ = ["OPENCV"]

FloatArray = NDArray[np.float64]

_MATRIX = ("cameramatrix", "intrinsicmatrix", "intrinsics", "mtx", "k")
_DISTORTION = (
    "distortioncoefficients", "distcoeffs", "distcoeff", "distortions", "distortion", "dist", "d"
)  # fmt: skip
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_SIZE = ("imagesize", "size", "resolution", "imgsize")
_POSE = ("extrinsicmatrix", "extrinsics", "extrinsic", "worldtocamera", "rt")
_ROTATION = ("rotationmatrix", "rotation", "worldtocamerarotation", "r", "rvec", "rotationvector")
_TRANSLATION = ("translationvector", "translation", "worldtocameratranslation", "t", "tvec")
_BOARD_POSES = "extrinsicparameters"
_NAME = ("cameraname", "name", "serial")
_DATA_TYPE = re.compile(r"(\d*)[a-zA-Z]\w*")

_Keys = dict[str, Any]


def _parse(content: bytes, stem: str) -> list[RawCamera] | None:
    bare = content.lstrip(b"\xef\xbb\xbf \t\r\n")
    if bare.startswith(b"<"):
        root = parse_xml(content)
        if root.tag != "opencv_storage":
            return None
        documents = [read_xml(root)]
    elif bare.startswith(b"{"):
        documents = [read_json(_decode(content))]
    elif bare.startswith(b"%YAML") or _looks_like_yaml(content):
        documents = read_yaml(_decode(content))
    else:
        return None
    many = len(documents) > 1
    found = [
        camera
        for number, document in enumerate(documents, 1)
        for camera in _find_cameras(document, f"{stem}{number}" if many else stem)
    ]
    return [_read_camera(name, keys) for name, keys in found] or None


def _decode(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CalibrationError(f"expected text in UTF-8: {error}") from error


def _looks_like_yaml(content: bytes) -> bool:
    key = re.compile(rb"^[ \t]*[\"']?(camera_?matrix|intrinsic_?matrix|mtx|K)[\"']?[ \t]*:", re.I | re.M)
    return key.search(content) is not None


def _plain(tree: dict[Any, Any]) -> _Keys:
    return {re.sub(r"[\W_]", "", str(key)).lower(): value for key, value in tree.items()}


def _find_cameras(tree: dict[str, Any], name: str) -> Iterator[tuple[str, _Keys]]:
    """Name and keys of each mapping that has a camera matrix."""
    keys = _plain(tree)
    if _pick(keys, _MATRIX) is not None:
        given = next((keys[key] for key in _NAME if isinstance(keys.get(key), (str, int, float))), None)
        yield (name if given is None or str(given) == "" else _word(given)), keys
        return
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _find_cameras(value, str(key))
        elif isinstance(value, list):
            for number, item in enumerate(value, 1):
                if isinstance(item, dict):
                    yield from _find_cameras(item, f"{key}{number}")


def _word(value: Any) -> str:
    """A serial number is a word, though it looks like a number."""
    return f"{value:.0f}" if isinstance(value, float) and value == round(value) else str(value)


def _pick(keys: _Keys, names: tuple[str, ...]) -> Any:
    return next((keys[name] for name in names if keys.get(name) is not None), None)


def _array(value: Any, what: str) -> Any:
    """The numbers of a value; OpenCV's matrices and those of ROS are mappings with rows, cols and data."""
    if not isinstance(value, dict):
        return value
    keys = _plain(value)
    if "data" not in keys:
        raise CalibrationError(f"{what}: expected numbers, got the keys {', '.join(map(str, value))}"[:200])
    if "rows" in keys and "cols" in keys:
        channels = _DATA_TYPE.fullmatch(str(keys.get("dt", "d")))
        count = int(channels[1] or 1) if channels and len(channels[1]) < 4 else 1
        rows, cols = read_numbers([keys["rows"], keys["cols"]], (2,), what)
        if not (0 <= rows <= 10_000 and 0 <= cols <= 10_000):
            raise CalibrationError(f"{what}: expected a small matrix, got {rows:g} rows and {cols:g} columns")
        return read_numbers(keys["data"], (int(rows), int(cols) * count), what)
    return keys["data"]


def _read_camera(name: str, keys: _Keys) -> RawCamera:
    where = f"camera '{name}'"
    if str(keys.get("distortionmodel", "")).lower() in ("equidistant", "fisheye") or keys.get("fisheye") in (
        1.0, True, "true",
    ):  # fmt: skip
        raise CalibrationError(
            f"{where}: a fisheye lens; calibrate with the ordinary lens model, fisheye lenses cannot be read"
        )
    matrix = read_numbers(
        _array(_pick(keys, _MATRIX), f"{where}: camera_matrix"), (3, 3), f"{where}: camera_matrix"
    )
    rotation, translation = _read_pose(keys, where)
    bent = _pick(keys, _DISTORTION)
    distortion = (
        np.zeros(5)
        if bent is None
        else read_distortion(
            _array(bent, f"{where}: distortion_coefficients"), f"{where}: distortion_coefficients"
        )
    )
    return RawCamera(name, _read_size(keys, where), matrix, rotation, translation, distortion)


def _read_size(keys: _Keys, where: str) -> tuple[int, int] | None:
    sides = [_pick(keys, _WIDTH), _pick(keys, _HEIGHT)]
    if None in sides:
        both = _pick(keys, _SIZE)
        if both is None:
            return None
        sides = _array(both, f"{where}: image_size")
    width, height = read_numbers(sides, (2,), f"{where}: image size")
    return round(width), round(height)


def _read_pose(keys: _Keys, where: str) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) from world to camera."""
    turned, moved = _pick(keys, _ROTATION), _pick(keys, _TRANSLATION)
    if turned is not None and moved is not None:
        numbers = np.ravel(_listed(_array(turned, f"{where}: rotation")))
        shape: tuple[int, ...] = (3,) if numbers.size == 3 else (3, 3)
        rotation = read_numbers(numbers, shape, f"{where}: rotation")
        translation = read_numbers(_array(moved, f"{where}: translation"), (3,), f"{where}: translation")
        return (rotation_from_vector(rotation) if shape == (3,) else rotation), translation
    pose = _pick(keys, _POSE)
    if pose is not None:
        numbers = np.ravel(_listed(_array(pose, f"{where}: extrinsic_matrix")))
        rows = 4 if numbers.size == 16 else 3
        whole = read_numbers(numbers, (rows, 4), f"{where}: extrinsic_matrix")
        return whole[:3, :3], whole[:3, 3]
    board = keys.get(_BOARD_POSES)
    if board is not None:
        numbers = np.ravel(_listed(_array(board, f"{where}: extrinsic_parameters")))
        if numbers.size == 6:
            vectors = read_numbers(numbers, (6,), f"{where}: extrinsic_parameters")
            return rotation_from_vector(vectors[:3]), vectors[3:]
    poses = "a pose for each view of the board" if board is not None else "none"
    raise CalibrationError(
        f"{where}: expected the camera's place, got {poses}; add R and T, rvec and tvec, or extrinsic_matrix"
    )


def _listed(values: Any) -> Any:
    """Nested lists flattened, so that uneven ones are counted and not refused by numpy."""
    if isinstance(values, np.ndarray):
        return values
    if isinstance(values, (list, tuple)):
        flat: list[Any] = []
        for value in values:
            inner = _listed(value)
            flat.extend(inner if isinstance(inner, list) else [inner])
        return flat
    return values


OPENCV = CameraFormat("OpenCV FileStorage", _parse, unit=1.0, up=None)
