"""Calibration formats: common functions, Qualisys XML, Pose2Sim TOML, and arrays of an npz file.

Qualisys Track Manager exports XML (``.qca.txt``, ``.xml``). Intrinsic numbers are in 1/64 pixel, from the middle of the
sensor's first pixel; the image is the cut-out ``fov_video`` of the sensor. Positions are in mm, Z up. The camera's own
axes are x right, y up, z backwards: x_camera = diag(1, -1, -1) R (X - C). The distortion is OpenCV's, for normalised
coordinates and not in pixels (some converters divide it by 64 too).

Pose2Sim, Anipose and Caliscope write TOML, one section for each camera: ``size``, ``matrix``, ``distortions`` (k1, k2,
p1, p2), ``rotation`` (Rodrigues vector) and ``translation``, from the world to OpenCV's camera axes. Sections without a
matrix (``metadata``) are not cameras. Pose2Sim has metres, Z up and a ``fisheye``; an orthographic camera of ours has
``kind = "orthographic"``. Anipose (and FreeMoCap) has the unit of its board, mostly mm, the axes of a camera and no
``fisheye``. Caliscope has metres, a ``rotation_count``, mostly matrices for ``rotation``, and cameras to ``ignore``.

Arrays beside the masks of an npz sequence: ``camera_matrix`` (V, 3, 3), ``world_to_camera_rotation`` (V, 3, 3),
``world_to_camera_translation`` (V, 3) m with Y up, ``width`` and ``height`` of the largest image; optional
``camera_distortion`` (V, 5), ``camera_kind`` (V,), ``view_names`` (V,) and, for images of several sizes, ``view_sizes``
(V, 2). See also `mask_npz`.
"""

from __future__ import annotations

import functools
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError
from dousa.estimation.cameras.camera import Camera
from dousa.files.markup import parse_toml, parse_xml, quote_toml
from dousa.files.npz_arrays import open_npz
from dousa.messages import Message
from dousa.motion.rotations import from_axis_angle, from_matrix, to_axis_angle, to_matrix

# Geometry: half a turn about x, from y up and z backwards to y down and z forward.
_FLIP = np.diag([1.0, -1.0, -1.0])
# By definition (y, z, x), as Pose2Sim and OpenSim have it.
_Z_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
# Geometry: the columns are where the axes of the file go once the axis of the key points to +Y.
_Y_UP: dict[str, FloatArray] = {
    "y": np.eye(3),
    "z": _Z_UP,
    "x": _Z_UP.T,
    "-y": _FLIP,
    "-z": _Z_UP @ _FLIP,
    "-x": _Z_UP.T @ np.diag([-1.0, 1.0, -1.0]),
}


@dataclass(frozen=True, slots=True)
class RawCamera:
    """A camera in the units of its file.

    Parameters
    ----------
    name : of the camera.
    size : px, width and height; None where the file has none.
    matrix : (3, 3) px.
    rotation, translation : (3, 3), (3,) from the file's world to camera axes, in the file's unit.
    distortion : (5,) as in OpenCV.
    kind : ``"pinhole"`` or ``"orthographic"``.
    """

    name: str
    size: tuple[int, int] | None
    matrix: FloatArray
    rotation: FloatArray
    translation: FloatArray
    distortion: FloatArray = field(default_factory=lambda: np.zeros(5))
    kind: str = "pinhole"


@dataclass(frozen=True, slots=True)
class CameraFormat:
    """A calibration format.

    Parameters
    ----------
    name : for messages.
    parse : (content, name of the file without suffix) -> cameras, or None if the content is of another format.
    unit : metres per unit; None for metres, or mm where cameras were too far away otherwise.
    up : axis that points up; None if the format has no convention.
    unit_is_sure : the format fixes the unit, so that great distances are accepted.
    centred : the format has no sizes; where nothing else tells them, the principal point is the middle.
    """

    name: str
    parse: Callable[[bytes, str], list[RawCamera] | None]
    unit: float | None
    up: str | None
    unit_is_sure: bool = False
    centred: bool = False


def entry(camera: str, key: str) -> Message:
    """Return an entry of a file, for errors about it."""
    return Message("camera_files.entry", camera=camera, key=key)


def parse_number(text: object, what: str | Message, most: float = 1e100) -> float:
    """Return a number below ``most``, whose cube is finite, or raise CalibrationError about ``what``."""
    value = np.nan
    if isinstance(text, (int, float, str, np.number)) and not isinstance(text, bool) and "_" not in str(text):
        try:  # float() would take 1_000
            value = float(text)
        except (ValueError, OverflowError):
            value = np.nan
    if not abs(value) < most:  # nan neither
        raise CalibrationError("camera_files.number", what=what, found=str(text)[:40])
    return float(value)


def read_numbers(values: Any, shape: tuple[int, ...], what: str | Message) -> FloatArray:
    """Return finite numbers of a shape from nested lists, or raise CalibrationError about ``what``."""
    flat = flatten(values, what)
    if len(flat) != np.prod(shape):
        size = " x ".join(map(str, shape))
        raise CalibrationError("camera_files.count", what=what, expected=size, found=len(flat))
    return np.array(flat, np.float64).reshape(shape)


def flatten(values: Any, what: str | Message) -> list[float]:
    """Return finite numbers of nested lists, however uneven, or raise CalibrationError about ``what``."""
    if isinstance(values, np.ndarray):
        values = values.ravel().tolist()
    if not isinstance(values, (list, tuple)):
        return [parse_number(values, what)]
    return [number for value in values for number in flatten(value, what)]


def read_distortion(values: Any, what: str | Message) -> FloatArray:
    """Return (5,) k1, k2, p1, p2, k3 from four or five numbers, or from more whose rest is zero."""
    flat = flatten(values, what)
    if flat and not any(flat):
        return np.zeros(5)
    if len(flat) < 4 or any(flat[5:]):
        raise CalibrationError("camera_files.distortion", what=what, found=len(flat))
    return np.array([*flat[:4], flat[4] if len(flat) > 4 else 0.0])


def rotation_from_vector(vector: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) of a rotation vector (3,): axis times angle in rad (Rodrigues)."""
    return to_matrix(from_axis_angle(vector))


def find_up(raws: Sequence[RawCamera], clearly: float = 0.8) -> str:
    """Return the axis of the file's world nearest to the cameras' mean up direction.

    Raises CalibrationError if the cosine of the angle between the two is below ``clearly``.
    """
    mean = np.mean([-raw.rotation[1] for raw in raws], axis=0)
    mean = mean / max(float(np.linalg.norm(mean)), 1e-12)
    axis = int(np.argmax(np.abs(mean)))
    if abs(mean[axis]) < clearly:
        x, y, z = (round(float(value), 2) for value in mean)
        raise CalibrationError("camera_files.no_up", x=x, y=y, z=z)
    return ("" if mean[axis] > 0 else "-") + "xyz"[axis]


_FAR = 100.0  # m, units of the world: no studio is that wide


def check_distance(raws: Sequence[RawCamera]) -> None:
    """Raise CalibrationError if the cameras are farther away than any studio is wide."""
    if not raws:
        return
    distance = float(np.median([np.linalg.norm(raw.translation) for raw in raws]))
    if distance > _FAR:
        raise CalibrationError("camera_files.far", metres=distance)


def find_unit(raws: Sequence[RawCamera]) -> float:
    """Return metres per unit of a file in metres or millimetres: mm if the cameras were too far away otherwise."""
    return 0.001 if max(float(np.linalg.norm(raw.translation)) for raw in raws) > _FAR else 1.0


def settle_camera(raw: RawCamera, size: tuple[int, int] | None, unit: float, up: str, centred: bool = False) -> Camera:
    """Return a camera in metres with Y up; CalibrationError without a size or for invalid numbers.

    ``centred`` : the principal point is taken for the middle of the picture where nothing tells its size.
    """
    size = raw.size or size
    if size is None and centred:
        size = (round(2.0 * float(raw.matrix[0, 2])), round(2.0 * float(raw.matrix[1, 2])))
    if size is None:
        raise CalibrationError("camera_files.no_size", camera=raw.name)
    if np.abs(raw.matrix[2] - (0.0, 0.0, 1.0)).max() > 1e-9 or raw.matrix[1, 0] != 0.0:
        raise CalibrationError("camera_files.matrix", camera=raw.name, found=str(raw.matrix.tolist()))
    rotation = _nearest_rotation(raw.rotation) @ _Y_UP[up].T
    kind: Any = raw.kind
    return Camera(raw.name, size[0], size[1], raw.matrix, rotation, unit * raw.translation, raw.distortion, kind)


def _nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Return the rotation nearest to a matrix of few digits; other matrices stay unchanged."""
    off = np.abs(matrix @ matrix.T - np.eye(3)).max()
    if not 1e-12 < off <= 1e-3 or np.linalg.det(matrix) < 0:
        return matrix
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


_PER_PIXEL = 64.0  # by the definition of Qualisys


def _parse_qualisys(content: bytes, stem: str) -> list[RawCamera] | None:
    if not content.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return None
    root = parse_xml(content)
    if root.tag != "calibration":
        return None
    if "fisheye" in (root.get("type") or "").lower():
        raise CalibrationError("camera_files.fisheye", camera=stem)
    elements = [element for element in root.findall("cameras/camera") if element.get("active", "1") != "0"]
    if not elements:
        raise CalibrationError("camera_files.no_active")
    return [_read_qualisys(element, f"camera{number}") for number, element in enumerate(elements, 1)]


def _read_qualisys(element: ET.Element, otherwise: str) -> RawCamera:
    name = (element.get("serial") or "").strip() or otherwise
    transform, intrinsic = _child(element, "transform", name), _child(element, "intrinsic", name)
    size, corner = _read_view(element, intrinsic, name)
    pixels = {
        key: _attribute(intrinsic, key, name) / _PER_PIXEL
        for key in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
    }
    skew = _attribute(intrinsic, "skew", name, 0.0)
    if abs(skew) > 1e-6:  # its unit is not stated, and no camera of today has any
        raise CalibrationError("camera_files.skew", what=entry(name, "intrinsic skew"), found=skew)
    matrix = np.array(
        [
            [pixels["focalLengthU"], 0.0, pixels["centerPointU"] - corner[0]],
            [0.0, pixels["focalLengthV"], pixels["centerPointV"] - corner[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    radial = [_attribute(intrinsic, f"radialDistortion{k}", name, 0.0) for k in (1, 2, 3)]
    tangential = [_attribute(intrinsic, f"tangentalDistortion{k}", name, 0.0) for k in (1, 2)]
    turned = [[_attribute(transform, f"r{row}{column}", name) for column in (1, 2, 3)] for row in (1, 2, 3)]
    rotation = _FLIP @ np.array(turned)
    centre = np.array([_attribute(transform, axis, name) for axis in "xyz"])
    distortion = np.array([*radial[:2], *tangential, radial[2]])
    return RawCamera(name, size, matrix, rotation, -rotation @ centre, distortion)


def _child(element: ET.Element, tag: str, camera: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise CalibrationError("camera_files.no_element", camera=camera, element=tag)
    return child


def _attribute(element: ET.Element, key: str, camera: str, otherwise: float | None = None) -> float:
    text = element.get(key)
    if text is None:
        if otherwise is None:
            raise CalibrationError("camera_files.no_entry", camera=camera, key=f"{element.tag} {key}")
        return otherwise
    return parse_number(text, entry(camera, f"{element.tag} {key}"))


def _read_view(element: ET.Element, intrinsic: ET.Element, camera: str) -> tuple[tuple[int, int], tuple[float, float]]:
    """Return the size of the image in pixels, and the sensor's pixel at its upper left corner."""
    first = [_attribute(intrinsic, f"sensorMin{axis}", camera, 0.0) / _PER_PIXEL for axis in "UV"]
    last = [_attribute(intrinsic, f"sensorMax{axis}", camera, 0.0) / _PER_PIXEL for axis in "UV"]
    sensor = all(high > low for low, high in zip(first, last, strict=True))
    view = element.find("fov_video")
    if view is None:
        if not sensor:
            raise CalibrationError("camera_files.no_view", camera=camera)
        corner, end = first, last
    else:
        corner = [_attribute(view, side, camera) for side in ("left", "top")]
        end = [_attribute(view, side, camera) for side in ("right", "bottom")]
        if sensor and any(high > limit + 1.0 for high, limit in zip(end, last, strict=True)):
            raise CalibrationError(
                "camera_files.view_beyond", camera=camera, x=end[0], y=end[1], last_x=last[0], last_y=last[1]
            )
    width, height = (round(high - low) + 1 for low, high in zip(corner, end, strict=True))
    return (width, height), (corner[0], corner[1])


# Millimetres and Z up by the definition of Qualisys.
QUALISYS = CameraFormat("Qualisys XML", _parse_qualisys, unit=0.001, up="z", unit_is_sure=True)


_LIKE_TOML = re.compile(rb"^[ \t]*(matrix|rotation|translation)[ \t]*=", re.MULTILINE)


def _parse_toml_of(program: str, content: bytes, _stem: str) -> list[RawCamera] | None:
    found = _find_sections(content)
    if found is None or found[0] != program:
        return None
    return [_read_section(key, section) for key, section in found[1].items()]


@functools.lru_cache(maxsize=1)
def _find_sections(content: bytes) -> tuple[str, dict[str, Any]] | None:
    """Return the program that wrote a file, and its cameras; None for a file without."""
    try:
        tree = parse_toml(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        if _LIKE_TOML.search(content):
            raise CalibrationError("camera_files.broken_toml", reason=error) from error
        return None
    whole = tree.get("cameras", tree)
    places = {
        key: value
        for key, value in (whole.items() if isinstance(whole, dict) else ())
        if isinstance(value, dict) and {"matrix", "rotation", "translation"} & value.keys()
    }
    if any("rotation_count" in section for section in places.values()):
        used = {key: section for key, section in places.items() if section.get("ignore") is not True}
        return "caliscope", used or places
    if not places:
        return None
    named = any("fisheye" in section or "kind" in section for section in places.values())
    return "pose2sim" if named else "anipose", places


def _read_section(key: str, section: dict[str, Any]) -> RawCamera:
    if section.get("fisheye", False):
        raise CalibrationError("camera_files.fisheye", camera=key)
    for needed in ("matrix", "rotation", "translation"):
        if needed not in section:
            raise CalibrationError("camera_files.no_entry", camera=key, key=needed)
    size = None
    if "size" in section:
        width, height = read_numbers(section["size"], (2,), entry(key, "size"))
        size = (round(width), round(height))
    turned, what = section["rotation"], entry(key, "rotation")
    is_matrix = isinstance(turned, list) and len(turned) == 3 and all(isinstance(row, list) for row in turned)
    return RawCamera(
        str(section.get("name", key)),
        size,
        read_numbers(section["matrix"], (3, 3), entry(key, "matrix")),
        read_numbers(turned, (3, 3), what) if is_matrix else rotation_from_vector(read_numbers(turned, (3,), what)),
        read_numbers(section["translation"], (3,), entry(key, "translation")),
        read_distortion(section.get("distortions", [0.0] * 4), entry(key, "distortions")),
        str(section.get("kind", "pinhole")),
    )


# Metres and Z up by the definition of Pose2Sim.
POSE2SIM = CameraFormat("Pose2Sim TOML", functools.partial(_parse_toml_of, "pose2sim"), unit=1.0, up="z")
# The unit is that of the board; the world that of a camera, or of the board.
ANIPOSE = CameraFormat("Anipose TOML", functools.partial(_parse_toml_of, "anipose"), unit=None, up=None)
# Metres by the definition of Caliscope.
CALISCOPE = CameraFormat("Caliscope TOML", functools.partial(_parse_toml_of, "caliscope"), unit=1.0, up=None)


def format_cameras(cameras: Sequence[Camera]) -> bytes:
    """Format cameras in metres with Z up; the numbers keep all digits."""
    lines: list[str] = []
    for number, camera in enumerate(cameras, 1):
        rotation = camera.rotation @ _Y_UP["z"]
        distortion = camera.distortion if camera.distortion[4] else camera.distortion[:4]
        lines += [
            f"[cam_{number:02d}]",
            f"name = {quote_toml(camera.name)}",
            f"size = {_list((camera.width, camera.height))}",
            f"matrix = [ {', '.join(_list(row) for row in camera.matrix)}]",
            f"distortions = {_list(distortion)}",
            f"rotation = {_list(to_axis_angle(from_matrix(rotation)))}",
            f"translation = {_list(camera.translation)}",
            "fisheye = false",
            *(['kind = "orthographic"'] if camera.kind == "orthographic" else []),
            "",
        ]
    lines += ["[metadata]", "adjusted = false", "error = 0.0", ""]
    try:
        return "\n".join(lines).encode("utf-8")
    except UnicodeEncodeError as error:
        raise CalibrationError("camera_files.name", reason=error) from error


def _list(values: Sequence[float] | np.ndarray) -> str:
    return f"[ {', '.join(repr(float(value)) for value in values)}]"


_NEEDED = ("camera_matrix", "world_to_camera_rotation", "world_to_camera_translation")
_CAMERA_KEYS = (*_NEEDED, "width", "height", "camera_distortion", "camera_kind", "view_names", "view_sizes")


def read_npz_cameras(path: str | os.PathLike[str], most: int = 1_000_000) -> list[RawCamera]:
    """Read the cameras of an npz file; no other arrays are loaded.

    Each array may have ``most`` bytes; a thousand cameras need less.

    Raises
    ------
    CalibrationError : damaged, without cameras, or arrays that disagree.
    """
    with open_npz(path, CalibrationError) as file:
        kinds = {"view_names": "Ubiuf", "camera_kind": "Ubiuf"}
        arrays = {key: file.read(key, kinds.get(key, "biuf"), most=most) for key in _CAMERA_KEYS if key in file}
    return _raw_from_arrays(arrays)


def _raw_from_arrays(arrays: Mapping[str, Any]) -> list[RawCamera]:
    for key in _NEEDED:
        if key not in arrays:
            raise CalibrationError("camera_files.no_array", array=key)
    count = len(np.atleast_1d(arrays["camera_matrix"]))
    if not 1 <= count <= 1000:
        raise CalibrationError("camera_files.camera_count", found=count)
    shapes = {**dict.fromkeys(_NEEDED[:2], (3, 3)), _NEEDED[2]: (3,), "camera_distortion": (5,)}
    usual = {"camera_distortion": np.zeros((count, 5))}
    columns = [
        read_numbers(arrays[key] if key in arrays else usual[key], (count, *shape), key)
        for key, shape in shapes.items()
    ]
    kinds = _texts(arrays, "camera_kind", ["pinhole"] * count)
    names = _texts(arrays, "view_names", [f"view{view + 1}" for view in range(count)])
    sizes: list[tuple[int, int] | None] = [None] * count
    if "view_sizes" in arrays:
        rows = read_numbers(arrays["view_sizes"], (count, 2), "view_sizes")
        sizes = [(round(width), round(height)) for width, height in rows.tolist()]
    elif "width" in arrays and "height" in arrays:
        width, height = (float(read_numbers(arrays[key], (1,), key)[0]) for key in ("width", "height"))
        sizes = [(round(width), round(height))] * count
    return [RawCamera(*row) for row in zip(names, sizes, *columns, kinds, strict=True)]


def _texts(arrays: Mapping[str, Any], key: str, otherwise: list[str]) -> list[str]:
    if key not in arrays:
        return otherwise
    texts = [str(text) for text in np.atleast_1d(arrays[key]).ravel()]
    if len(texts) != len(otherwise):
        raise CalibrationError("camera_files.texts", array=key, expected=len(otherwise), found=len(texts))
    return texts


def cameras_to_arrays(cameras: Sequence[Camera]) -> dict[str, np.ndarray]:
    """Return arrays by name for `read_cameras` in an npz file; default distortion and kind are left out."""
    sizes = np.array([camera.size for camera in cameras], np.int64)
    arrays = {
        "camera_matrix": np.stack([camera.matrix for camera in cameras]),
        "world_to_camera_rotation": np.stack([camera.rotation for camera in cameras]),
        "world_to_camera_translation": np.stack([camera.translation for camera in cameras]),
        "view_names": np.array([camera.name for camera in cameras]),
        "width": sizes[:, 0].max(),
        "height": sizes[:, 1].max(),
    }
    if (sizes != sizes[0]).any():
        arrays["view_sizes"] = sizes
    if any(camera.distortion.any() for camera in cameras):
        arrays["camera_distortion"] = np.stack([camera.distortion for camera in cameras])
    if any(camera.kind != "pinhole" for camera in cameras):
        arrays["camera_kind"] = np.array([camera.kind for camera in cameras])
    return arrays
