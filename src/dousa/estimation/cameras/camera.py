"""Cameras: how points of the world come to lie in an image.

A pinhole camera with the distortion of Brown (1966) in the form and order of OpenCV (k1, k2, p1, p2, k3), or an
orthographic one. Camera axes are x right, y down, z forward; x_camera = R x_world + t. The centre of the pixel in
column i and row j has the image coordinates (i, j).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import CalibrationError

CAMERA_ROW = 24
"""Numbers of a camera as the kernels take it: 0 pinhole or 1 orthographic, fx, fy, cx, cy, skew, R (9), t (3), k1, k2,
p1, p2, k3, and one unused."""

_NEWTON_STEPS = 20  # quadratic convergence: real lenses need four


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """One calibrated view; `dataclasses.replace` gives a changed copy.

    Parameters
    ----------
    name : of the view, such as ``"cam01"``.
    width, height : px, size of the image.
    matrix : (3, 3) px, rows (fx, skew, cx), (0, fy, cy), (0, 0, 1); for an orthographic camera fx and fy are px
        per metre.
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
        distortion = np.zeros(5) if self.distortion is None else self.distortion
        set_field(self, "matrix", self._checked(self.matrix, (3, 3), "matrix"))
        set_field(self, "rotation", self._checked(self.rotation, (3, 3), "rotation"))
        set_field(self, "translation", self._checked(self.translation, (3,), "translation"))
        set_field(self, "distortion", self._checked(distortion, (5,), "distortion"))
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
        """Depths (...) m of points (..., 3) m of the world, along the camera's z axis; negative behind the camera."""
        return np.asarray(np.asarray(points, np.float64) @ self.rotation[2] + self.translation[2])

    def project(self, points: ArrayLike) -> FloatArray:
        """Image coordinates of points of the world, distortion included.

        Parameters
        ----------
        points : (..., 3) m, in the world.

        Returns
        -------
        (..., 2) px, column and row; NaN for points that are not in front of a pinhole camera. Points far outside
        the field of view may come out inside the image where the distortion's polynomial folds back, as in OpenCV.
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
        """Where the lens puts the points (x / z, y / z).

        Parameters
        ----------
        normalised : (..., 2) coordinates on the plane at depth 1.

        Returns
        -------
        (..., 2) on the same plane, distorted (Brown 1966 in OpenCV's form); unchanged for an orthographic camera.
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

    def undistort(self, distorted: ArrayLike) -> FloatArray:
        """The inverse of `distort`.

        Parameters
        ----------
        distorted : (..., 2) coordinates on the plane at depth 1.

        Returns
        -------
        (..., 2) on the same plane; NaN where no point is imaged there. By Newton's method to rounding error, where
        OpenCV stops after a few fixed-point steps.
        """
        goal = np.asarray(distorted, np.float64)
        if self.kind == "orthographic" or not self.distortion.any():
            return goal.copy()
        found = goal.copy()
        with np.errstate(all="ignore"):  # what diverges becomes NaN below
            for _ in range(_NEWTON_STEPS):
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
        """Derivative of `distort`: dx'/dx, dx'/dy = dy'/dx, dy'/dy."""
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
        """The lines of the world that are imaged in pixels.

        Parameters
        ----------
        pixels : (..., 2) px, column and row.

        Returns
        -------
        Origins (..., 3) m, the camera's centre or a point of an orthographic camera's image plane, and directions
        (..., 3) of unit length, away from the camera; NaN where the lens images nothing.
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
        """The camera of the image stretched to another size: u' = (u + 1/2) s - 1/2.

        Parameters
        ----------
        width, height : px, new size of the image.

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
        """The camera of the image at another scale.

        Parameters
        ----------
        factor_x, factor_y : new size by old size, above 0; ``factor_y`` is ``factor_x`` by default. The new size is
            rounded to whole pixels, and the matrix fits the rounded size.

        Raises
        ------
        CalibrationError : factors that leave no pixel.
        """
        factor_y = factor_x if factor_y is None else factor_y
        if not (0 < factor_x < 1e5 and 0 < factor_y < 1e5):
            raise CalibrationError("camera.scale", camera=self.name, x=factor_x, y=factor_y)
        return self.resized(round(self.width * factor_x), round(self.height * factor_y))

    def in_world(self, rotation: ArrayLike, offset: ArrayLike = (0.0, 0.0, 0.0)) -> Camera:
        """The same camera, told in other axes of the world: x_new = A x_old + b.

        Parameters
        ----------
        rotation : (3, 3) A, a rotation.
        offset : (3,) m, b.

        Raises
        ------
        CalibrationError : A is no rotation.
        """
        turned = self.rotation @ np.asarray(rotation, np.float64).T
        moved = self.translation - turned @ np.asarray(offset, np.float64)
        return dataclasses.replace(self, rotation=turned, translation=moved)

    def to_row(self) -> FloatArray:
        """The camera as the kernels take it: (24,), see `CAMERA_ROW`."""
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
    """Width and height in pixels as people write them."""
    return f"{size[0]} x {size[1]}"


def pack_cameras(cameras: Sequence[Camera]) -> FloatArray:
    """Cameras as the kernels take them: (V, 24)."""
    return np.stack([camera.to_row() for camera in cameras])
