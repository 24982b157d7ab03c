"""Boxes and centres of silhouettes, and poses moved onto them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, Mask
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import place_parts
from dousa.estimation.cameras.camera import Camera
from dousa.motion import rotations as rot


@dataclass(frozen=True, slots=True)
class Outline:
    """Box and centre of one silhouette, in image coordinates.

    Parameters
    ----------
    box : (4,) px, left, right, top, bottom.
    whole : (4,) whether that side lies inside the image.
    centre : (2,) px, centre of gravity.
    """

    box: FloatArray
    whole: NDArray[np.bool_]
    centre: FloatArray

    @property
    def extent(self) -> float:
        """Longer side of the box, px."""
        return float(max(self.box[1] - self.box[0], self.box[3] - self.box[2], 1.0))


def measure_outline(mask: Mask | None, least: float = 0.1) -> Outline | None:
    """Compute box and centre of a mask; None if it shows no person.

    Pieces below the share ``least`` of the largest one are specks and do not count.
    """
    if mask is None or not mask.any():
        return None
    from dousa.extras import cv2

    _, labels, stats, _ = cv2.connectedComponentsWithStats(np.ascontiguousarray(mask, np.uint8), connectivity=8)
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    kept = areas >= least * areas.max()
    kept[0] = False
    rows, columns = np.nonzero(kept[labels])
    height, width = mask.shape
    box = np.array([columns.min(), columns.max(), rows.min(), rows.max()], np.float64)
    whole = np.array([box[0] > 0, box[1] < width - 1, box[2] > 0, box[3] < height - 1])
    return Outline(box, whole, np.array([columns.mean(), rows.mean()]))


def shrink_mask(mask: Mask, size: tuple[int, int]) -> Mask:
    """Return a mask of another width and height; a pixel stays if more than half covered."""
    from dousa.extras import cv2

    return np.asarray(cv2.resize(mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) >= 128)


def shrink_views(
    cameras: Sequence[Camera], masks: Sequence[Mask | None], share: float
) -> tuple[tuple[Camera, ...], list[Mask | None]]:
    """Return cameras and masks at ``share`` of their size, which stay as they are from 1 on."""
    if share >= 1.0:
        return tuple(cameras), list(masks)
    small = tuple(camera.scaled(share) for camera in cameras)
    pairs = zip(masks, small, strict=True)
    return small, [None if mask is None else shrink_mask(mask, camera.size) for mask, camera in pairs]


def project_across(ways: FloatArray) -> FloatArray:
    """Return the projections (N, 3, 3) across directions (N, 3)."""
    return np.asarray(np.eye(3) - ways[:, :, None] * ways[:, None, :])


def _trace(pairs: Sequence[tuple[Camera, Outline]]) -> tuple[FloatArray, FloatArray]:
    """Return origins and directions (V, 3) of the lines of sight through the centres of gravity."""
    origins, ways = zip(*(camera.compute_rays(found.centre) for camera, found in pairs), strict=True)
    return np.array(origins), np.array(ways)


def do_meet(ways: FloatArray, least: float = 0.02) -> bool:
    """Return whether lines of these directions (N, 3) are far enough from parallel to meet.

    ``least`` is the least eigenvalue of the mean projection across them, 0 for parallel lines: 0.02 is some 16 degrees
    between two.
    """
    return bool(np.linalg.eigvalsh(project_across(ways).sum(axis=0))[0] > least * len(ways))


def lines_meet(cameras: Sequence[Camera], outlines: Sequence[Outline | None]) -> bool:
    """Return whether the views that see a person look from different enough directions to determine distance."""
    pairs = [(camera, found) for camera, found in zip(cameras, outlines, strict=True) if found is not None]
    return do_meet(_trace(pairs)[1])


def guess_place(
    cameras: Sequence[Camera], outlines: Sequence[Outline | None], stature: float, *, steps: int = 5, tall: float = 0.85
) -> FloatArray:
    """Estimate the middle of the body (3,) m.

    The point nearest to the lines of sight, outlying views weighed less in ``steps`` rounds; with one view, or views
    from nearly one side, at the depth where the silhouettes are ``tall`` statures high.
    """
    pairs = [(camera, found) for camera, found in zip(cameras, outlines, strict=True) if found is not None]
    origins, ways = _trace(pairs)
    weights, across = np.ones(len(pairs)), project_across(ways)
    if do_meet(ways):
        for _ in range(steps):
            normal = (weights[:, None, None] * across).sum(axis=0)
            place = np.linalg.solve(normal, (weights[:, None] * (across @ origins[:, :, None])[..., 0]).sum(axis=0))
            off = np.linalg.norm((across @ (place - origins)[:, :, None])[..., 0], axis=1)
            weights = 1.0 / (off + 0.05 * stature)
        return np.asarray(place)
    places = []
    for (camera, found), origin, way in zip(pairs, origins, ways, strict=True):
        focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
        depth = focal * tall * stature / found.extent if camera.kind == "pinhole" else 3.0 * stature
        places.append(origin + way * depth)
    return np.asarray(np.mean(places, axis=0))


def turn_about(poses: FloatArray, yaw: float) -> FloatArray:
    """Turn poses (N, 7 + A) by ``yaw`` rad about the vertical through the origin."""
    turn = rot.from_axis_angle(np.array([0.0, yaw, 0.0]))
    turned = poses.copy()
    turned[:, :3] = rot.rotate(turn, poses[:, :3])
    turned[:, 3:7] = rot.multiply(turn, poses[:, 3:7])
    return turned


def move_onto(
    body: BodyModel,
    poses: FloatArray,
    place: FloatArray,
    cameras: Sequence[Camera],
    outlines: Sequence[Outline | None],
    *,
    steps: int = 5,
    most: float = 0.5,
) -> FloatArray:
    """Shift poses so that boxes and centres of their projections match those of the silhouettes.

    Runs a few damped Gauss-Newton steps. Sides cut off by the image do not count; with a single view the height of the
    box determines the depth.

    Parameters
    ----------
    body : with A joint angles.
    poses : (N, 7 + A), anywhere.
    place : (3,) m, first guess of their middles.
    cameras, outlines : (V,); None if no person is seen.
    steps : Gauss-Newton steps.
    most : statures that one of them may shift a pose.
    """
    moved = poses.copy()
    rotations, positions = place_parts(body, moved)
    owner = np.repeat(np.arange(body.n_parts), np.diff(body.sphere_starts))
    centres = positions[:, owner] + np.einsum("nsij,sj->nsi", rotations[:, owner], body.spheres[:, :3])
    radii = body.spheres[:, 3]
    # A part weighs as much as its spheres' discs, so that the middle is about the centre of gravity of the outline.
    weights = np.maximum(radii, 1e-3 * body.stature)
    weights = weights / weights.sum()
    shift = place - np.einsum("nsi,s->ni", centres, weights)
    for _ in range(steps):
        square = np.tile(1e-4 * np.eye(3), (len(poses), 1, 1))
        gradient = np.zeros((len(poses), 3))
        for camera, outline in zip(cameras, outlines, strict=True):
            if outline is not None:
                _add_view(camera, outline, centres + shift[:, None], radii, weights, square, gradient)
        step = np.linalg.solve(square, gradient[..., None])[..., 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        shift += step * np.minimum(1.0, most * body.stature / np.maximum(length, 1e-9))
    moved[:, :3] += shift
    return moved


def _add_view(
    camera: Camera,
    outline: Outline,
    centres: FloatArray,
    radii: FloatArray,
    weights: FloatArray,
    square: FloatArray,
    gradient: FloatArray,
    centre: float = 2.0,
) -> None:
    """Add one view's normal equations in place, in shares of the silhouette's extent.

    The centre of gravity weighs ``centre`` times as much as a side of the box, and a tenth of that if cut off.
    """
    focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1]])
    depths = camera.compute_depths(centres)
    ahead = np.maximum(depths, 0.05) if camera.kind == "pinhole" else np.ones_like(depths)
    image = np.nan_to_num(camera.project(centres))
    discs = radii * np.sqrt(focal[0] * focal[1]) / ahead
    slopes = []
    for axis in (0, 1):
        slope = np.broadcast_to(focal[axis] * camera.rotation[axis], centres.shape)
        if camera.kind == "pinhole":
            beside = centres @ camera.rotation[axis] + camera.translation[axis]
            slope = (slope - (focal[axis] * beside / ahead)[..., None] * camera.rotation[2]) / ahead[..., None]
        slopes.append(slope)
    every = np.arange(len(centres))
    scale = 1.0 / outline.extent
    for side in range(4):
        if not outline.whole[side]:
            continue
        axis, sign = side // 2, 2.0 * (side % 2) - 1.0
        edges = image[..., axis] + sign * discs
        extreme = (sign * edges).argmax(axis=1)
        off = scale * (outline.box[side] + 0.5 * sign - edges[every, extreme])
        _add_row(off, scale * slopes[axis][every, extreme], 1.0, square, gradient)
    for axis in (0, 1):
        cut = not outline.whole[2 * axis : 2 * axis + 2].all()
        off = scale * (outline.centre[axis] - image[..., axis] @ weights)
        slope = scale * np.einsum("nsi,s->ni", slopes[axis], weights)
        _add_row(off, slope, 0.1 * centre if cut else centre, square, gradient)


def _add_row(off: FloatArray, slope: FloatArray, weight: float, square: FloatArray, gradient: FloatArray) -> None:
    square += weight * slope[:, :, None] * slope[:, None, :]
    gradient += weight * slope * off[:, None]
