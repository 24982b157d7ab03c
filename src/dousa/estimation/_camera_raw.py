"""What the calibration formats have in common: a camera in the unit and axes of its file, and the way from there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import CalibrationError
from dousa.estimation.camera import Camera
from dousa.motion.rotations import from_axis_angle, to_matrix

__all__ = [
    "CameraFormat",
    "RawCamera",
    "check_distance",
    "find_up",
    "parse_number",
    "read_distortion",
    "read_numbers",
    "rotation_from_vector",
    "settle_camera",
    "to_y_up",
]

FloatArray = NDArray[np.float64]

_FAR = 100.0  # m: no studio is wider, so that such a distance is in millimetres or centimetres
_CLEARLY_UP = 0.8  # cosine of the angle between the cameras' mean up direction and an axis

# Columns: where the axes of the file go once the axis of the key points to +Y. Z up becomes (y, z, x), as Pose2Sim and
# OpenSim have it.
_Z_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
_Y_UP: dict[str, FloatArray] = {
    "y": np.eye(3),
    "z": _Z_UP,
    "x": _Z_UP.T,
    "-y": np.diag([1.0, -1.0, -1.0]),
    "-z": _Z_UP @ np.diag([1.0, -1.0, -1.0]),
    "-x": _Z_UP.T @ np.diag([-1.0, 1.0, -1.0]),
}


@dataclass(frozen=True, slots=True)
class RawCamera:
    """A camera as its file has it.

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
    name : what people call it.
    parse : (content, name of the file without suffix) -> cameras, or None if the content is of another format.
    unit : metres per unit.
    up : axis that points up; None if the format has no habit.
    unit_is_sure : the format fixes the unit, so that great distances are believed.
    """

    name: str
    parse: Callable[[bytes, str], list[RawCamera] | None]
    unit: float
    up: str | None
    unit_is_sure: bool = False


def parse_number(text: object, what: str) -> float:
    """A finite number, or a CalibrationError that starts with ``what``."""
    value = np.nan
    if isinstance(text, (int, float, str, np.number)) and not isinstance(text, bool) and "_" not in str(text):
        try:  # float() would take 1_000
            value = float(text)
        except (ValueError, OverflowError):
            value = np.nan
    if not np.isfinite(value):
        raise CalibrationError(f"{what}: expected a finite number, got {str(text)[:40]!r}")
    return float(value)


def read_numbers(values: Any, shape: tuple[int, ...], what: str) -> FloatArray:
    """Finite numbers of a shape, from nested lists; a CalibrationError starts with ``what``."""
    flat = _flatten(values, what)
    if len(flat) != np.prod(shape):
        size = " x ".join(map(str, shape))
        raise CalibrationError(f"{what}: expected {size} numbers, got {len(flat)}")
    return np.array(flat, np.float64).reshape(shape)


def _flatten(values: Any, what: str) -> list[float]:
    if isinstance(values, np.ndarray):
        values = values.ravel().tolist()
    if not isinstance(values, (list, tuple)):
        return [parse_number(values, what)]
    return [number for value in values for number in _flatten(value, what)]


def read_distortion(values: Any, what: str) -> FloatArray:
    """(5,) k1, k2, p1, p2, k3 from four or five numbers, or from more whose rest is zero."""
    flat = _flatten(values, what)
    if flat and not any(flat):
        return np.zeros(5)
    if len(flat) < 4 or any(flat[5:]):
        raise CalibrationError(
            f"{what}: expected 4 or 5 distortion coefficients (k1, k2, p1, p2, k3), got {len(flat)}; calibrate without "
            "the rational, thin prism and tilted models"
        )
    return np.array([*flat[:4], flat[4] if len(flat) > 4 else 0.0])


def rotation_from_vector(vector: FloatArray) -> FloatArray:
    """(3, 3) of a rotation vector (3,): axis times angle in rad (Rodrigues)."""
    return to_matrix(from_axis_angle(vector))


def to_y_up(up: str) -> FloatArray:
    """(3, 3) rotation that takes a world whose ``up`` axis points up to one with Y up."""
    return _Y_UP[up]


def find_up(raws: Sequence[RawCamera]) -> str:
    """The axis of the file's world that points up, if cameras stand upright on average.

    Raises
    ------
    CalibrationError : the cameras do not agree on an axis.
    """
    mean = np.mean([-raw.rotation[1] for raw in raws], axis=0)
    mean = mean / max(float(np.linalg.norm(mean)), 1e-12)
    axis = int(np.argmax(np.abs(mean)))
    if abs(mean[axis]) < _CLEARLY_UP:
        x, y, z = (round(float(value), 2) for value in mean)
        raise CalibrationError(
            f"no axis is clearly up: the cameras' own up is ({x}, {y}, {z}) on average; "
            "say which axis is up (x, y, z, -x, -y, -z)"
        )
    return ("" if mean[axis] > 0 else "-") + "xyz"[axis]


def check_distance(raws: Sequence[RawCamera]) -> None:
    """CalibrationError where the cameras stand so far away that the numbers cannot be metres."""
    if not raws:
        return
    distance = float(np.median([np.linalg.norm(raw.translation) for raw in raws]))
    if distance > _FAR:
        raise CalibrationError(
            f"the cameras are {distance:.0f} m from the origin if the file is in metres; say its unit, such as mm"
        )


def settle_camera(raw: RawCamera, size: tuple[int, int] | None, unit: float, up: str) -> Camera:
    """A camera in metres with Y up.

    Raises
    ------
    CalibrationError : no size, or numbers that make no camera.
    """
    size = raw.size or size
    if size is None:
        raise CalibrationError(
            f"camera '{raw.name}': the file does not tell the size of the image; add image_width and image_height"
        )
    if np.abs(raw.matrix[2] - (0.0, 0.0, 1.0)).max() > 1e-9 or raw.matrix[1, 0] != 0.0:
        raise CalibrationError(
            f"camera '{raw.name}': expected a matrix (fx, skew, cx), (0, fy, cy), (0, 0, 1), got {raw.matrix.tolist()}"
        )
    rotation = _nearest_rotation(raw.rotation) @ _Y_UP[up].T
    kind: Any = raw.kind
    return Camera(
        raw.name, size[0], size[1], raw.matrix, rotation, unit * raw.translation, raw.distortion, kind
    )


def _nearest_rotation(matrix: FloatArray) -> FloatArray:
    """The rotation that a file with few digits means; what is no rotation stays as it is."""
    off = np.abs(matrix @ matrix.T - np.eye(3)).max()
    if not 1e-12 < off <= 1e-3 or np.linalg.det(matrix) < 0:
        return matrix
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)
