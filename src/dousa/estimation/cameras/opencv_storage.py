"""Cameras of OpenCV's FileStorage.

It is YAML, XML or JSON, one camera for each file, document or section, with the keys of OpenCV's calibration sample
(``camera_matrix``, ``distortion_coefficients``, ``image_width``, ``image_height``) or usual ones; case and underscores
do not count. The sample writes one pose for each view of the board; a camera needs one: ``R`` and ``T``, ``rvec`` and
``tvec``, or ``extrinsic_matrix``.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

import numpy as np
import yaml

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError
from dousa.estimation.cameras.camera_formats import (
    CameraFormat,
    RawCamera,
    entry,
    flatten,
    read_distortion,
    read_numbers,
    rotation_from_vector,
)
from dousa.files.markup import parse_xml
from dousa.messages import Message


def read_json(text: str) -> dict[str, Any]:
    """Parse a JSON object, else raise CalibrationError."""
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        raise CalibrationError("opencv.json", reason=error.msg).at(line=error.lineno) from error
    except (ValueError, RecursionError) as error:
        raise CalibrationError("opencv.json", reason=error) from error
    if not isinstance(found, dict):
        raise CalibrationError("opencv.no_mapping")
    return found


def read_xml(root: ET.Element) -> dict[str, Any]:
    """Return the document below ``<opencv_storage>``."""
    return {child.tag: _read_element(child, 20) for child in root}


def _read_element(element: ET.Element, deepest: int) -> Any:
    if deepest < 0:
        raise CalibrationError("opencv.deep")
    if len(element) == 0:
        text = (element.text or "").strip()
        words = [_scalar(word) for word in text.split()]
        if words and all(isinstance(word, float) for word in words):
            return words[0] if len(words) == 1 else words
        return text.strip('"')
    if all(child.tag == "_" for child in element):
        return [_read_element(child, deepest - 1) for child in element]
    return {child.tag: _read_element(child, deepest - 1) for child in element}


def _scalar(text: str) -> Any:
    """Return a number, or the text; None if empty."""
    text = text.strip()
    if text.lower() in (".nan", ".inf", "-.inf", "+.inf"):
        return float(text.lower().replace(".", "", 1))
    try:
        return text or None if "_" in text or not text else float(text)
    except ValueError:
        return text


def read_yaml(text: str) -> list[dict[str, Any]]:
    """Parse the documents of a YAML file; tags are ignored.

    Raises
    ------
    CalibrationError : no YAML, anchors or aliases, a repeated or non-text key, a document that is no mapping, deep
        nesting; with the line.
    """
    bare = re.sub(r"^%.*$", "", text, flags=re.MULTILINE)  # OpenCV's "%YAML:1.0" is no directive of YAML
    found = []
    try:
        events: Iterator[Any] = yaml.parse(bare, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent):
                value = _read_node(first := next(events), events, 20)
                if value is not None and not isinstance(value, dict):
                    raise CalibrationError("opencv.no_mapping").at(line=first.start_mark.line + 1)
                found.append(value or {})
    except yaml.YAMLError as error:
        mark = getattr(error, "context_mark", None) or getattr(error, "problem_mark", None)
        reason = getattr(error, "problem", None) or str(error)
        raise CalibrationError("opencv.yaml", reason=reason).at(line=mark and mark.line + 1) from error
    return found


def _read_node(event: Any, events: Iterator[Any], deepest: int) -> Any:
    """Return the value that begins with an event, in which others are nested ``deepest`` times at most."""
    line = event.start_mark.line + 1
    if deepest < 0:
        raise CalibrationError("opencv.deep").at(line=line)
    if event.anchor is not None:
        raise CalibrationError("opencv.alias").at(line=line)
    if isinstance(event, yaml.ScalarEvent):
        return event.value if event.style else _scalar(event.value)
    if isinstance(event, yaml.SequenceStartEvent):
        items = []
        while not isinstance(item := next(events), yaml.SequenceEndEvent):
            items.append(_read_node(item, events, deepest - 1))
        return items
    found: dict[str, Any] = {}
    while not isinstance(begun := next(events), yaml.MappingEndEvent):
        line = begun.start_mark.line + 1
        if not isinstance(begun, yaml.ScalarEvent):
            raise CalibrationError("opencv.key").at(line=line)
        key, value = begun.value, _read_node(next(events), events, deepest - 1)
        if value is None and ":" in key and not begun.style:  # OpenCV writes {width:640}
            key, _, text = key.partition(":")
            value = _scalar(text)
        if key in found:
            raise CalibrationError("opencv.twice", key=key).at(line=line)
        found[key] = value
    return found


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
        raise CalibrationError("opencv.encoding", reason=error) from error


def _looks_like_yaml(content: bytes) -> bool:
    key = re.compile(rb"^[ \t]*[\"']?(camera_?matrix|intrinsic_?matrix|mtx|K)[\"']?[ \t]*:", re.I | re.M)
    return key.search(content) is not None


def _plain(tree: dict[Any, Any]) -> _Keys:
    return {re.sub(r"[\W_]", "", str(key)).lower(): value for key, value in tree.items()}


def _find_cameras(tree: dict[str, Any], name: str) -> Iterator[tuple[str, _Keys]]:
    """Yield name and keys of each mapping with a camera matrix."""
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
    """Format a serial number, which may be parsed as a number."""
    return f"{value:.0f}" if isinstance(value, float) and value == round(value) else str(value)


def _pick(keys: _Keys, names: tuple[str, ...]) -> Any:
    return next((keys[name] for name in names if keys.get(name) is not None), None)


def read_array(value: Any, what: Message) -> Any:
    """Return the numbers of a value; matrices of OpenCV and ROS are mappings with rows, cols and data."""
    if not isinstance(value, dict):
        return value
    keys = _plain(value)
    if "data" not in keys:
        raise CalibrationError("opencv.no_data", what=what, keys=tuple(map(str, value))[:10])
    if "rows" in keys and "cols" in keys:
        channels = _DATA_TYPE.fullmatch(str(keys.get("dt", "d")))
        count = int(channels[1] or 1) if channels and len(channels[1]) < 4 else 1
        rows, cols = read_numbers([keys["rows"], keys["cols"]], (2,), what)
        if not (0 <= rows <= 10_000 and 0 <= cols <= 10_000):
            raise CalibrationError("opencv.matrix_size", what=what, rows=rows, columns=cols)
        return read_numbers(keys["data"], (int(rows), int(cols) * count), what)
    return keys["data"]


def _read_camera(name: str, keys: _Keys) -> RawCamera:
    if str(keys.get("distortionmodel", "")).lower() in ("equidistant", "fisheye") or keys.get("fisheye") in (
        1.0, True, "true",
    ):  # fmt: skip
        raise CalibrationError("camera_files.fisheye", camera=name)
    what = entry(name, "camera_matrix")
    matrix = read_numbers(read_array(_pick(keys, _MATRIX), what), (3, 3), what)
    rotation, translation = _read_pose(keys, name)
    bent, what = _pick(keys, _DISTORTION), entry(name, "distortion_coefficients")
    distortion = np.zeros(5) if bent is None else read_distortion(read_array(bent, what), what)
    return RawCamera(name, _read_size(keys, name), matrix, rotation, translation, distortion)


def _read_size(keys: _Keys, name: str) -> tuple[int, int] | None:
    sides, what = [_pick(keys, _WIDTH), _pick(keys, _HEIGHT)], entry(name, "image_size")
    if None in sides:
        both = _pick(keys, _SIZE)
        if both is None:
            return None
        sides = read_array(both, what)
    width, height = read_numbers(sides, (2,), what)
    return round(width), round(height)


def _read_pose(keys: _Keys, name: str) -> tuple[FloatArray, FloatArray]:
    """Return rotation (3, 3) and translation (3,) from world to camera."""
    turned, moved = _pick(keys, _ROTATION), _pick(keys, _TRANSLATION)
    if turned is not None and moved is not None:
        what = entry(name, "rotation")
        numbers = flatten(read_array(turned, what), what)
        shape: tuple[int, ...] = (3,) if len(numbers) == 3 else (3, 3)
        rotation, what = read_numbers(numbers, shape, what), entry(name, "translation")
        translation = read_numbers(read_array(moved, what), (3,), what)
        return (rotation_from_vector(rotation) if shape == (3,) else rotation), translation
    pose = _pick(keys, _POSE)
    if pose is not None:
        what = entry(name, "extrinsic_matrix")
        numbers = flatten(read_array(pose, what), what)
        whole = read_numbers(numbers, (4 if len(numbers) == 16 else 3, 4), what)
        return whole[:3, :3], whole[:3, 3]
    board = keys.get(_BOARD_POSES)
    if board is not None:
        what = entry(name, "extrinsic_parameters")
        numbers = flatten(read_array(board, what), what)
        if len(numbers) == 6:
            vectors = read_numbers(numbers, (6,), what)
            return rotation_from_vector(vectors[:3]), vectors[3:]
    raise CalibrationError("opencv.no_pose" if board is None else "opencv.board_poses", camera=name)


# OpenCV's FileStorage states no unit: metres are usual.
OPENCV = CameraFormat("OpenCV FileStorage", _parse, unit=1.0, up=None)
