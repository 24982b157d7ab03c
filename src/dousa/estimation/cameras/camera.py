"""Cameras: the projection of points into images, and sets of cameras for demos and for videos.

A pinhole camera with the distortion of Brown (1966) in the form and order of OpenCV (k1, k2, p1, p2, k3), or an
orthographic one. Camera axes are x right, y down, z forward; x_camera = R x_world + t. The centre of the pixel in
column i and row j has the image coordinates (i, j).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError, OptionError
from dousa.messages import Message

CAMERA_ROW = 24
"""Numbers of a camera as the kernels take it, by definition: 0 pinhole or 1 orthographic, fx, fy, cx, cy, skew, R (9),
t (3), k1, k2, p1, p2, k3, and one unused."""


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """One calibrated view; `dataclasses.replace` returns a changed copy.

    Parameters
    ----------
    name : of the view, such as ``"cam01"``.
    width, height : px, size of the image.
    matrix : (3, 3) px, rows (fx, skew, cx), (0, fy, cy), (0, 0, 1); px per metre for an orthographic camera.
    rotation : (3, 3) from world axes to camera axes (x right, y down, z forward).
    translation : (3,) m: x_camera = R x_world + t.
    distortion : (5,) k1, k2, p1, p2, k3 as in OpenCV; none by default.
    kind : ``"pinhole"`` or ``"orthographic"``.

    Raises
    ------
    CalibrationError : a size below 1, numbers that are not finite, a focal length that is not positive, a matrix
        that is no rotation.
    """

    name: str
    width: int
    height: int
    matrix: FloatArray
    rotation: FloatArray
    translation: FloatArray
    distortion: FloatArray = None  # type: ignore[assignment]
    kind: Literal["pinhole", "orthographic"] = "pinhole"

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        if self.kind not in ("pinhole", "orthographic"):
            raise CalibrationError("camera.kind", camera=self.name, found=str(self.kind))
        for field in ("width", "height"):
            size = int(getattr(self, field))
            if not 1 <= size <= 100_000:
                raise CalibrationError("camera.side", camera=self.name, side=field, found=size)
            set_field(self, field, size)
        if self.distortion is None:
            set_field(self, "distortion", np.zeros(5))
        for field, shape in {"matrix": (3, 3), "rotation": (3, 3), "translation": (3,), "distortion": (5,)}.items():
            set_field(self, field, self._checked(getattr(self, field), shape, field))
        if not (self.matrix[0, 0] > 0 and self.matrix[1, 1] > 0):
            raise CalibrationError("camera.focal", camera=self.name, x=self.matrix[0, 0], y=self.matrix[1, 1])
        off = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if off > 1e-3 or np.linalg.det(self.rotation) < 0:
            raise CalibrationError("camera.rotation", camera=self.name)

    def _checked(self, values: ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
        try:
            array = np.array(values, np.float64)
        except (TypeError, ValueError) as error:
            raise CalibrationError("camera.numbers", camera=self.name, field=what) from error
        if array.shape != shape or not np.isfinite(array).all():
            raise CalibrationError(
                "camera.shape", camera=self.name, field=what, expected=str(shape), found=str(array.tolist())
            )
        array.flags.writeable = False
        return array

    @property
    def position(self) -> FloatArray:
        """Centre of projection (3,) m in the world (pinhole); any point of the image plane (orthographic)."""
        return np.asarray(-self.rotation.T @ self.translation)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image, px."""
        return self.width, self.height

    def compute_depths(self, points: ArrayLike) -> FloatArray:
        """Compute depths (...) m of points (..., 3) m along the camera's z axis; negative behind the camera."""
        return np.asarray(np.asarray(points, np.float64) @ self.rotation[2] + self.translation[2])

    def project(self, points: ArrayLike) -> FloatArray:
        """Project points (..., 3) m of the world to image coordinates (..., 2) px, distortion included.

        NaN for points that are not in front of a pinhole camera. As in OpenCV, points far outside the field of view may
        fall inside the image where the distortion's polynomial folds back.
        """
        local = np.asarray(points, np.float64) @ self.rotation.T + self.translation
        plane = local[..., :2]
        if self.kind == "pinhole":
            depth = local[..., 2:]
            plane = self.distort(plane / np.where(depth > 0, depth, np.nan))
        x, y = plane[..., 0], plane[..., 1]
        k = self.matrix
        return np.stack((k[0, 0] * x + k[0, 1] * y + k[0, 2], k[1, 1] * y + k[1, 2]), axis=-1)

    def distort(self, normalised: ArrayLike) -> FloatArray:
        """Distort points (..., 2) = (x / z, y / z) on the plane at depth 1 (Brown 1966 in OpenCV's form).

        An orthographic camera leaves them unchanged.
        """
        plane = np.asarray(normalised, np.float64)
        if self.kind == "orthographic" or not self.distortion.any():
            return plane.copy()
        k1, k2, p1, p2, k3 = self.distortion
        x, y = plane[..., 0], plane[..., 1]
        square = x * x + y * y
        gain = 1.0 + square * (k1 + square * (k2 + square * k3))
        return np.stack(
            (
                x * gain + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
                y * gain + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
            ),
            axis=-1,
        )

    def undistort(self, distorted: ArrayLike, steps: int = 20) -> FloatArray:
        """Invert `distort` for points (..., 2) on the plane at depth 1; NaN where no point is imaged there.

        Newton's method to rounding error, where OpenCV stops after a few fixed-point steps; real lenses need four of
        the ``steps``.
        """
        goal = np.asarray(distorted, np.float64)
        if self.kind == "orthographic" or not self.distortion.any():
            return goal.copy()
        found = goal.copy()
        with np.errstate(all="ignore"):  # what diverges becomes NaN below
            for _ in range(steps):
                rest = self.distort(found) - goal
                a, b, d = self._slope(found)
                found = found - (
                    np.stack((d * rest[..., 0] - b * rest[..., 1], a * rest[..., 1] - b * rest[..., 0]), axis=-1)
                    / (a * d - b * b)[..., None]
                )
            off = np.abs(self.distort(found) - goal).max(axis=-1, keepdims=True)
            settled = off <= 1e-9 * (1.0 + np.abs(goal).max(axis=-1, keepdims=True))
        return np.where(settled, found, np.nan)

    def _slope(self, plane: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the derivative of `distort`: dx'/dx, dx'/dy = dy'/dx, dy'/dy."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = plane[..., 0], plane[..., 1]
        square = x * x + y * y
        gain = 1.0 + square * (k1 + square * (k2 + square * k3))
        growth = 2.0 * (k1 + square * (2.0 * k2 + 3.0 * square * k3))
        return (
            gain + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
            gain + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        )

    def compute_rays(self, pixels: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Compute the lines of sight of pixels (..., 2), column and row; NaN where the lens images nothing.

        Returns origins (..., 3) m, the camera's centre or a point of an orthographic camera's image plane, and unit
        directions (..., 3) away from the camera.
        """
        image = np.asarray(pixels, np.float64)
        k = self.matrix
        y = (image[..., 1] - k[1, 2]) / k[1, 1]
        x = (image[..., 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
        plane = self.undistort(np.stack((x, y), axis=-1))
        if self.kind == "orthographic":
            flat = np.concatenate((plane, np.zeros_like(plane[..., :1])), axis=-1)
            origins = (flat - self.translation) @ self.rotation
            return origins, np.broadcast_to(self.rotation[2], origins.shape).copy()
        directions = np.concatenate((plane, np.ones_like(plane[..., :1])), axis=-1) @ self.rotation
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(self.position, directions.shape).copy(), directions

    def resized(self, width: int, height: int) -> Camera:
        """Return the camera of the image stretched to another size (px): u' = (u + 1/2) s - 1/2.

        Raises
        ------
        CalibrationError : a size below 1.
        """
        matrix = np.array(self.matrix)
        for axis, factor in enumerate((width / self.width, height / self.height)):
            matrix[axis, :2] *= factor
            matrix[axis, 2] = (matrix[axis, 2] + 0.5) * factor - 0.5
        return dataclasses.replace(self, width=width, height=height, matrix=matrix)

    def scaled(self, factor_x: float, factor_y: float | None = None) -> Camera:
        """Return the camera of the image at another scale, rounded to whole pixels.

        Parameters
        ----------
        factor_x, factor_y : new size by old size, above 0; ``factor_y`` is ``factor_x`` by default.

        Raises
        ------
        CalibrationError : factors outside 0 to 1e5, or that leave no pixel.
        """
        factor_y = factor_x if factor_y is None else factor_y
        if not (0 < factor_x < 1e5 and 0 < factor_y < 1e5):
            raise CalibrationError("camera.scale", camera=self.name, x=factor_x, y=factor_y)
        return self.resized(round(self.width * factor_x), round(self.height * factor_y))

    def to_row(self) -> FloatArray:
        """Return the camera as a row (24,) of the kernels, see `CAMERA_ROW`."""
        k = self.matrix
        return np.concatenate(
            (
                [float(self.kind == "orthographic"), k[0, 0], k[1, 1], k[0, 2], k[1, 2], k[0, 1]],
                self.rotation.ravel(),
                self.translation,
                self.distortion,
                [0.0],
            )
        )


def format_size(size: Sequence[int]) -> str:
    """Format width and height in pixels."""
    return f"{size[0]} x {size[1]}"


def pack_cameras(cameras: Sequence[Camera]) -> FloatArray:
    """Return cameras as rows (V, 24) of the kernels."""
    return np.stack([camera.to_row() for camera in cameras])


def make_view(
    position: ArrayLike,
    target: ArrayLike,
    *,
    size: tuple[int, int] = (320, 240),
    focal: float | None = None,
    name: str = "view1",
) -> Camera:
    """Create an upright pinhole camera without distortion that looks at a point.

    Looking straight up or down, the world's +X is to the right.

    Parameters
    ----------
    position : (3,) m, of the camera; Y is up.
    target : (3,) m, in the middle of the image.
    size : px, width and height.
    focal : px; by default 1.25 times the shorter side, so that a person with raised hands fits at 3.5 m.
    name : of the view.

    Raises
    ------
    CalibrationError : the camera stands on its target.
    """
    place, aim = np.asarray(position, np.float64), np.asarray(target, np.float64)
    distance = float(np.linalg.norm(aim - place)) if place.shape == aim.shape == (3,) else np.nan
    if not (np.isfinite(distance) and distance > 0):
        raise CalibrationError("camera.on_target", camera=name, position=str(place.tolist()), target=str(aim.tolist()))
    forward = (aim - place) / distance
    right = np.cross(forward, (0.0, 1.0, 0.0))
    length = float(np.linalg.norm(right))
    right = right / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    rotation = np.stack((right, np.cross(forward, right), forward))
    width, height = size
    focal = 1.25 * min(size) if focal is None else focal
    matrix = [[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]]
    return Camera(name, width, height, np.array(matrix), rotation, -rotation @ place)


def make_ring(
    n_views: int = 4,
    *,
    target: ArrayLike = (0.0, 0.9, 0.0),
    distance: float = 3.5,
    height: float = 1.4,
    size: tuple[int, int] = (320, 240),
    focal: float | None = None,
    first_angle: float = 0.0,
) -> tuple[Camera, ...]:
    """Create cameras ``"view1"``, ``"view2"`` and so on around a person at equal angles, the first in front.

    An even number takes a ring with one camera more and leaves the last out: two cameras that face each other see the
    same outline mirrored.

    Parameters
    ----------
    n_views : number of cameras, 1 to 100.
    target : (3,) m, in the middle of the images.
    distance : m, from the target, over the floor.
    height : m, of the cameras over the floor.
    size : px, width and height.
    focal : px; by default 1.25 times the shorter side.
    first_angle : rad, of the first camera, from +Z (the front) towards +X (the person's left).

    Raises
    ------
    OptionError : no or too many views.
    CalibrationError : a distance of zero below or above the target.
    """
    if not 1 <= n_views <= 100:
        raise OptionError("camera.ring", found=n_views)
    places = n_views + 1 - n_views % 2
    middle = np.asarray(target, np.float64)
    cameras = []
    for view in range(n_views):
        angle = first_angle + 2.0 * np.pi * view / places
        position = (middle[0] + distance * np.sin(angle), height, middle[2] + distance * np.cos(angle))
        cameras.append(make_view(position, middle, size=size, focal=focal, name=f"view{view + 1}"))
    return tuple(cameras)


def fit_cameras(
    cameras: Sequence[Camera], sizes: Sequence[tuple[int, int]], stretch: float = 0.02
) -> tuple[tuple[Camera, ...], tuple[Message, ...]]:
    """Fit cameras to images of other sizes than those of the calibration.

    Returns the stretched cameras, and a note for each image whose shape changes: it was probably cropped or turned,
    which no scale corrects.

    Parameters
    ----------
    cameras : V cameras.
    sizes : (V,) width and height of the actual images, px.
    stretch : share by which widths and heights may be scaled differently without a note.

    Raises
    ------
    CalibrationError : another number of sizes than of cameras.
    """
    if len(cameras) != len(sizes):
        raise CalibrationError("camera.count", cameras=len(cameras), views=len(sizes))
    fitted, notes = [], []
    for camera, (width, height) in zip(cameras, sizes, strict=True):
        if camera.size == (width, height):
            fitted.append(camera)
            continue
        fitted.append(camera.resized(width, height))
        ratio = (width / camera.width) / (height / camera.height)
        if max(ratio, 1.0 / ratio) > 1.0 + stretch:
            turned = (width > height) != (camera.width > camera.height) and camera.width != camera.height
            own, other = format_size(camera.size), format_size((width, height))
            code = "camera.turned" if turned else "camera.cropped"
            notes.append(Message(code, camera=camera.name, size=own, other=other))
    return tuple(fitted), tuple(notes)


def check_cameras(cameras: Sequence[Camera], names: Sequence[str], sizes: Sequence[tuple[int, int]]) -> None:
    """Raise CalibrationError unless there is one camera for each view, of the size (px) of its masks."""
    if len(cameras) != len(names):
        raise CalibrationError("camera.count", cameras=len(cameras), views=len(names))
    for camera, name, size in zip(cameras, names, sizes, strict=True):
        if camera.size != tuple(size):
            own = format_size(camera.size)
            raise CalibrationError("camera.size", view=name, size=format_size(size), other=own)


def match_cameras(cameras: Sequence[Camera], names: Sequence[str]) -> tuple[tuple[Camera, ...], tuple[Message, ...]]:
    """Return the camera of each view by name, and notes for the user.

    Case, spaces, dashes and leading zeros do not count; otherwise one name may contain the other (``int_cam01_img`` for
    ``cam01``). If no view has a match and there are as many cameras as views, they are taken in order, with a note.

    Parameters
    ----------
    cameras : of the calibration.
    names : (V,) of the views, such as the names of the videos without suffix.

    Raises
    ------
    CalibrationError : a view without camera or with several, two views with one camera.
    """
    has = [camera.name for camera in cameras]
    if len(has) == len(names) and not any(_find(has, name) for name in names):
        if len(names) == 1:
            return tuple(cameras), ()
        pairs = tuple(f"{name} = {camera}" for name, camera in zip(names, has, strict=True))
        return tuple(cameras), (Message("camera.by_order", pairs=pairs),)
    return tuple(cameras[index] for index in find_views(has, names)), ()


def find_views(cameras: Sequence[str], names: Sequence[str]) -> list[int]:
    """Return the index of the camera of each view by name; CalibrationError unless there is exactly one."""
    picked = []
    for name in names:
        found = _find(cameras, name)
        if len(found) != 1:
            if not found:
                raise CalibrationError("camera.none_for_view", view=name, cameras=cameras)
            several = tuple(cameras[index] for index in found)
            raise CalibrationError("camera.several_for_view", view=name, found=several, cameras=cameras)
        picked.append(found[0])
    if len(set(picked)) != len(picked):
        raise CalibrationError("camera.shared", views=names, cameras=cameras)
    return picked


def _plain(name: str) -> str:
    return re.sub(r"0+(?=\d)", "", re.sub(r"[\W_]+", "", name.casefold()))


def _find(cameras: Sequence[str], name: str) -> list[int]:
    """Return the indices of the cameras that match a name, by the strictest rule with a match."""

    def holds(outer: str, inner: str) -> bool:
        # not cam1 in cam12
        pattern = rf"(?<!\d){re.escape(inner)}(?!\d)" if inner[:1].isdigit() else rf"{re.escape(inner)}(?!\d)"
        return bool(inner) and re.search(pattern, outer) is not None

    plain = _plain(name)
    plains = [_plain(camera) for camera in cameras]
    rules = (
        [camera == name for camera in cameras],
        [other == plain for other in plains],
        [holds(other, plain) or holds(plain, other) for other in plains],
    )
    for rule in rules:
        if any(rule):
            return [index for index, fits in enumerate(rule) if fits]
    return []


def check_names(names: Sequence[str]) -> None:
    """Raise CalibrationError if two cameras have one name."""
    for number, name in enumerate(names):
        if name in names[:number]:
            raise CalibrationError("camera.same_name", camera=name)
