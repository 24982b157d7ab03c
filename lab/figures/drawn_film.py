"""A drawn film of a synthetic performer before a wall, for pictures that show the way from film to motion."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from dousa.estimation import BodyModel, Camera
from dousa.estimation.body.kinematics import compute_points
from dousa.estimation.raster.rasteriser import draw_parts

__all__ = ["draw_film", "draw_plate"]

Image = NDArray[np.uint8]

_SKIN, _SHIRT, _TROUSERS, _SHOES = (
    (122, 160, 214),
    (150, 98, 44),
    (82, 62, 54),
    (44, 40, 40),
)  # blue, green, red
_COLOURS = {
    "pelvis": _TROUSERS, "trunk": _SHIRT, "head": _SKIN, "upper_arm": _SHIRT, "forearm": _SKIN, "hand": _SKIN,
    "thigh": _TROUSERS, "shank": _TROUSERS, "foot": _SHOES,
}  # fmt: skip
_LIGHT = np.array([-0.45, -0.62, 0.64])
_GRAIN = 2.0  # grey levels of noise


def draw_plate(camera: Camera) -> Image:
    """(H, W, 3) the empty room: a wall, a skirting board, a floor, a window."""
    height, width = camera.height, camera.width
    floor = camera.project(np.array([[0.0, 0.0, 0.0]]))[0, 1] - 0.08 * height
    rows = np.arange(height)[:, None, None]
    wall = np.array([196.0, 206.0, 208.0]) * (0.86 + 0.14 * rows / height)
    boards = np.array([120.0, 150.0, 172.0]) * (0.8 + 0.25 * (rows - floor) / max(height - floor, 1.0))
    room = np.where(rows < floor, wall, boards) * np.ones((1, width, 1))
    room[int(floor) - 5 : int(floor)] = (228, 232, 232)
    left, top, wide, high = int(0.08 * width), int(0.1 * height), int(0.17 * width), int(0.3 * height)
    room[top : top + high, left : left + wide] = (238, 236, 228)
    cv2.rectangle(room, (left, top), (left + wide, top + high), (150, 160, 164), 3)
    cv2.line(room, (left + wide // 2, top), (left + wide // 2, top + high), (150, 160, 164), 2)
    return np.clip(room, 0, 255).astype(np.uint8)


def draw_film(body: BodyModel, poses: NDArray[np.float64], camera: Camera, seed: int) -> Iterator[Image]:
    """Frames (H, W, 3) of a body in these poses (T, 7 + A), lit from above, with a shadow and grain."""
    plate, rng = draw_plate(camera).astype(np.float32), np.random.default_rng(seed)
    for pose in poses:
        frame = plate.copy()
        _cast_shadow(frame, pose, camera)
        for colour, mask in _layers(body, pose, camera):
            _paint_part(frame, mask, colour)
        frame = cv2.GaussianBlur(frame, (0, 0), 0.7) + rng.normal(0.0, _GRAIN, frame.shape)
        yield np.clip(frame, 0, 255).astype(np.uint8)


def _layers(body: BodyModel, pose: NDArray[np.float64], camera: Camera) -> Iterator[tuple[tuple[int, ...], Image]]:
    """Colour and mask of each part from far to near."""
    masks = draw_parts(body, pose, camera)[0]
    places = compute_points(body, pose)[: body.n_parts]
    ends = places.copy()
    for part, parent in enumerate(body.parents):
        if parent >= 0:
            ends[parent] = places[part]
    for part in np.argsort(-camera.compute_depths((places + ends) / 2.0)):
        name = body.names[part].removeprefix("left_").removeprefix("right_")
        yield _COLOURS[name], masks[part].astype(np.uint8)


def _paint_part(frame: NDArray[np.float32], mask: Image, colour: tuple[int, ...]) -> None:
    """A part blown up like a balloon from its outline, shaded by the slope."""
    left, top, width, height = cv2.boundingRect(mask)
    if not width:
        return
    inner = cv2.copyMakeBorder(mask[top : top + height, left : left + width], 2, 2, 2, 2, cv2.BORDER_CONSTANT)
    depth = cv2.distanceTransform(inner, cv2.DIST_L2, 5)
    radius = float(depth.max()) + 0.5
    bulge = cv2.GaussianBlur(np.sqrt(np.maximum(depth * (2.0 * radius - depth), 0.0)), (0, 0), 1.0)
    normal = np.dstack((-cv2.Sobel(bulge, cv2.CV_32F, 1, 0) / 8, -cv2.Sobel(bulge, cv2.CV_32F, 0, 1) / 8, inner * 1.0))
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-6)
    shade = (0.55 + 0.55 * np.maximum(normal @ _LIGHT, 0.0))[2:-2, 2:-2, None]
    window = frame[top : top + height, left : left + width]
    np.copyto(window, shade * np.array(colour), where=inner[2:-2, 2:-2, None].astype(bool), casting="unsafe")


def _cast_shadow(frame: NDArray[np.float32], pose: NDArray[np.float64], camera: Camera) -> None:
    turns = np.linspace(0.0, 2.0 * np.pi, 40)
    rim = pose[:3] + 0.34 * np.stack((np.cos(turns), np.zeros(40), np.sin(turns)), axis=1)
    rim[:, 1] = 0.0
    weak = np.zeros(frame.shape[:2], np.float32)
    cv2.fillPoly(weak, [np.round(camera.project(rim)).astype(np.int32)], 1.0)
    frame *= 1.0 - 0.24 * cv2.GaussianBlur(weak, (0, 0), 5.0)[..., None]
